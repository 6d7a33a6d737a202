"""From a recording to its diagnosis."""

import math
from typing import Final

import numpy as np

from ahrs_service.diagnosis.bench import BenchResidual
from ahrs_service.diagnosis.explain import explanation
from ahrs_service.diagnosis.flight import FlightResidual, is_flight
from ahrs_service.diagnosis.holdout import free_run, held_out
from ahrs_service.diagnosis.hypotheses import Step
from ahrs_service.diagnosis.library import Library, Term, library_of
from ahrs_service.diagnosis.locate import against_covariates, where_it_acts
from ahrs_service.diagnosis.model import Model, Number, added_body, free_numbers
from ahrs_service.diagnosis.recorded import Recorded
from ahrs_service.diagnosis.reference import reference_of
from ahrs_service.diagnosis.residual import CHANNELS, Residual
from ahrs_service.diagnosis.result import (
    Diagnosis,
    Estimated,
    Finding,
    NotObservable,
    ResidualSeries,
    Rival,
    Unexplained,
    Where,
)
from ahrs_service.diagnosis.screen import unseen
from ahrs_service.diagnosis.search import Progress, Search, search
from ahrs_service.diagnosis.whiteness import whiteness
from ahrs_service.records import Floats

_AXIS_SIGMA: Final = 3.0
_GENERAL: Final = dict.fromkeys(("roll", "pitch", "heading"), "attitude") | {"altitude": "pressure"}
_FALLBACK: Final = "whole recording"
_COMPARED, _PROJECTED, _SEARCH, _JUDGED = 0.06, 0.24, 0.56, 0.85
"""Shares of the whole time: compared, responses projected, the search's own, findings judged."""


def compare(recorded: Recorded) -> Residual:
    """Return the misfit of a recording and its reference; ValueError says what is missing."""
    reference = reference_of(recorded)
    if is_flight(reference):
        return FlightResidual(recorded, reference)
    return BenchResidual(recorded, reference)


def diagnose(recorded: Recorded, progress: Progress | None = None) -> Diagnosis:
    """Locate and name what makes a recording differ from an ideal IMU.

    What a twin knows is taken out of the readings before (diagnosis.known). `progress` is called
    with the share done, 0 to 1.
    """
    tell = progress or (lambda share: None)
    residual = compare(recorded)
    tell(_COMPARED)
    library = library_of(residual)
    tell(_PROJECTED)
    found = search(residual, library, lambda share: tell(_PROJECTED + _SEARCH * share))
    tell(_PROJECTED + _SEARCH)
    model = found.model
    findings = tuple(
        _finding(residual, found, step, place) for place, step in enumerate(found.steps)
    )
    left = tuple(
        Unexplained(
            _channels(name), _covariates(found.telling[name]), (), math.exp(-min(value, 700.0))
        )
        for name, value in found.unknown.items()
    )
    verdict = "unexplained" if left else "explained" if findings else "no_mismatch"
    triad = findings[0].effect.split("_")[0] if findings else "gyro"
    whole = held_out(residual, found.bare, model, triad) if model.terms else None
    tell(_JUDGED)
    noise = dict(zip(residual.noise_names, np.exp(model.noise).tolist(), strict=True))
    return Diagnosis(
        verdict=verdict,  # type: ignore[arg-type]
        findings=findings,
        unexplained=left,
        not_observable=_not_observable(residual, library, model),
        holdout=whole,
        free_run=free_run(residual, found.bare, model),
        noise=noise,
        whiteness=whiteness(residual, model),
        covariates=against_covariates(residual, found.bare, model),
        series=_series(residual, model),
    )


def _channels(name: str) -> str:
    triad = name.split(" ", maxsplit=1)[0]
    return triad if triad in ("gyro", "accel") else CHANNELS[0]


def _covariates(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the covariates, each with the more general word for it."""
    words = [word for name in names for word in (name, _GENERAL.get(name, name))]
    return tuple(dict.fromkeys(words))


def _series(residual: Residual, model: Model) -> ResidualSeries:
    before = residual.body
    return ResidualSeries(residual.time_s, before, before - added_body(residual, model.terms))


def _finding(residual: Residual, found: Search, step: Step, place: int) -> Finding:
    term = found.model.terms[place]
    parameters, axes = _parameters(found.model, place)
    rival = found.rivals[place]
    alike = found.alike[place]
    held = held_out(residual, step.model, found.model, term.effect.triad)
    size = _sizes(residual, term)
    where = where_it_acts(residual, added_body(residual, (term,))) or (
        Where(float(residual.time_s[0]), float(residual.time_s[-1]), _FALLBACK),
    )
    return Finding(
        effect=term.effect.id,
        alike=alike,
        axes=axes,
        where=where,
        parameters=parameters,
        p_value=math.exp(-min(step.surprise, 700.0)),
        log_evidence=step.gain,
        rival=None if rival is None else Rival(*rival),
        holdout=held,
        explanation=explanation(term, size, alike),
        separating_manoeuvre=term.effect.separated_by if len(alike) > 1 else None,
    )


def _sizes(residual: Residual, term: Term) -> Floats:
    """Return the rms of what a term adds per channel [6], without its mean."""
    added = added_body(residual, (term,))
    return np.asarray(np.std(added, axis=0))


def _parameters(model: Model, place: int) -> tuple[dict[str, Estimated], tuple[str, ...]]:
    """Return the parameters of a term with their sigmas, and the axes that stand out."""
    term = model.terms[place]
    stds = {p.name: np.zeros(p.shape) for p in term.effect.parameters}
    numbers = free_numbers(model.terms)
    variances = np.maximum(np.diag(model.covariance), 0.0)
    axes: set[int] = set()
    for number, variance in zip(numbers, variances, strict=True):
        if number.term == place:
            stds[number.parameter.name][number.index] = math.sqrt(variance)
            axes |= _axis(term, number, math.sqrt(variance))
    parameters = {
        p.name: Estimated(term.values[p.name].tolist(), stds[p.name].tolist(), p.unit)
        for p in term.effect.parameters
    }
    return parameters, tuple("xyz"[axis] for axis in sorted(axes)) or ("x", "y", "z")


def _axis(term: Term, number: Number, std: float) -> set[int]:
    value = abs(float(term.values[number.parameter.name][number.index]))
    stands_out = bool(number.index) and value > _AXIS_SIGMA * std
    return {number.index[0]} if stands_out else set()


def _not_observable(
    residual: Residual, library: Library, model: Model
) -> tuple[NotObservable, ...]:
    hidden = unseen(residual, model.noise, library, model.base, model.misfit)
    named = {term.effect.id for term in model.terms}
    reasons = library.refused | {name: why for name, why in hidden.items() if name not in named}
    return tuple(NotObservable(name, why) for name, why in reasons.items())
