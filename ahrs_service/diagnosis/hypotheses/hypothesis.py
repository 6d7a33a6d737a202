"""A hypothesis tested by likelihood: a candidate of the library added to a model and fitted."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from ahrs_service.diagnosis.hypotheses.candidates import (
    Candidate,
    Dependence,
    Library,
    Term,
    limits,
)
from ahrs_service.diagnosis.hypotheses.model import Model, gain_between, refit, settle
from ahrs_service.diagnosis.hypotheses.score_test import Gains, surprise
from ahrs_service.diagnosis.input.misfit import Residual

_NO_TIES: Final = 12.0
"""Deduction [nats] from the surprise of a limit at which no readings saturate: it affects only the
few largest, where the reference is worst."""


@dataclass(frozen=True, slots=True)
class Step:
    """A hypothesis fitted: its model, gain over the model before [nats], and surprise."""

    candidate: Candidate
    model: Model
    gain: float
    surprise: float


def best_forms(library: Library, gains: Gains) -> list[tuple[Candidate, float]]:
    """Return the best form of each hypothesis with its surprise, the largest first."""
    best: dict[str, tuple[Candidate, float]] = {}
    for candidate, value in zip(library.candidates, gains.surprise, strict=True):
        if candidate.name not in best or value > best[candidate.name][1]:
            best[candidate.name] = (candidate, float(value))
    return sorted(best.values(), key=lambda item: -item[1])


def term_of(candidate: Candidate) -> Term:
    """Return the initial term of a candidate: its form, with linear parameters at zero."""
    assert candidate.effect is not None
    values = candidate.effect.neutral()
    return Term(
        candidate.effect, values | {name: np.asarray(v) for name, v in candidate.form.items()}
    )


def extend(
    residual: Residual, library: Library, model: Model, candidate: Candidate, has_noise: bool
) -> Step:
    """Return `model` with one more candidate, fitted; the noise is refitted if `has_noise`."""
    terms, unknown, rows = model.terms, model.unknown, model.unknown_rows
    if candidate.effect is None:
        unknown = (*unknown, *candidate.freedom * (candidate.dependence,))
        rows = np.concatenate([rows, library.rows[:, :, candidate.columns]], axis=2)
    else:
        terms = (*terms, term_of(candidate))
    longer = settle(residual, terms, model.noise, unknown, rows)
    if has_noise:
        longer = refit(residual, longer)
    return step_between(residual, model, candidate, longer)


def step_between(residual: Residual, before: Model, candidate: Candidate, after: Model) -> Step:
    """Return the step from one model to another with one more candidate."""
    gain = gain_between(residual, before, after)
    value = surprise(gain, candidate.freedom)
    if candidate.effect is not None and candidate.effect.is_limit:
        low, high = limits(residual, candidate.effect)
        value -= 0.0 if low == high else _NO_TIES
    return Step(candidate, after, gain, value)


@lru_cache(maxsize=8)
def without(residual: Residual, model: Model, place: int) -> Model:
    """Return the model without one of its terms, parameters and noise refitted.

    Cached: pruning, confirming and judging need the same models.
    """
    terms = model.terms[:place] + model.terms[place + 1 :]
    return refit(residual, settle(residual, terms, model.noise, model.unknown, model.unknown_rows))


def without_unknown(residual: Residual, model: Model, *left_out: Dependence) -> Model:
    """Return the model without unknown dependences, parameters and noise refitted."""
    kept = [n for n, one in enumerate(model.unknown) if one not in left_out]
    unknown = tuple(model.unknown[n] for n in kept)
    rows = model.unknown_rows[:, :, kept]
    return refit(residual, settle(residual, model.terms, model.noise, unknown, rows))
