"""Named or unknown: whether an effect of the catalogue fits as well as a smooth dependence.

Some effect explains a part of any misfit. An effect is named only where no smooth unknown
dependence, with all the parameters that it needs, explains clearly more.
"""

from typing import Final

import numpy as np

from ahrs_service.diagnosis.hypotheses.candidates import Candidate, Dependence, Library
from ahrs_service.diagnosis.hypotheses.hypothesis import (
    Step,
    best_forms,
    extend,
    without,
    without_unknown,
)
from ahrs_service.diagnosis.hypotheses.model import Model, gain_between
from ahrs_service.diagnosis.hypotheses.score_test import screen
from ahrs_service.diagnosis.input.misfit import Residual

CLEARLY: Final = 3.0
"""Difference of evidence [nats] from which one explanation is preferred to another: odds of 20."""

_FORM_SHARE: Final = 0.05
"""Share of an effect's gain that may remain because the true form differs from the catalogue's."""

FITTED: Final = 3
"""A choice: hypotheses fitted with their noise, the costly part; for named and unknown ones."""
IN_REACH: Final = 0.5
"""A choice: share of the surprise to be beaten from which a hypothesis is fitted in full: screened
under the noise that it has inflated itself, its surprise is lower."""


def evidence(gain: float, freedom: int) -> float:
    """Return the log Bayes factor [nats] of `freedom` parameters with this gain in likelihood.

    Gaussian prior about zero with g times the variance of the estimate, at the g of highest
    evidence: gain - K/2 (1 + ln(2 gain / K)) (George, Foster 2000, eq. (14); Liang et al. 2008,
    sec. 2.4).
    """
    if 2.0 * gain <= freedom:
        return 0.0
    return gain - 0.5 * freedom * (1.0 + float(np.log(2.0 * gain / freedom)))


def is_clearer(gain: float, freedom: int, named_gain: float, named_freedom: int) -> bool:
    """Whether an unknown dependence explains clearly more than what is named in its place."""
    more = evidence(gain, freedom) - evidence(named_gain, named_freedom)
    return more > CLEARLY and gain > (1.0 + _FORM_SHARE) * named_gain


def is_clearer_than(residual: Residual, unknown: Step, named: Model, freedom: int) -> bool:
    """Whether an unknown dependence explains clearly more than `named` with `freedom` parameters.

    Each is evaluated under the better of both noises: a fit of the noise may miss its optimum.
    """
    named_gain = unknown.gain - gain_between(residual, named, unknown.model)
    return is_clearer(unknown.gain, unknown.candidate.freedom, named_gain, freedom)


def best_unknown(
    residual: Residual,
    library: Library,
    model: Model,
    forms: list[tuple[Candidate, float]],
    least: float,
) -> Step | None:
    """Return the unknown dependence of highest evidence, None if none reaches a surprise `least`.

    `forms` with their surprise as screened; the best are fitted with their noise.
    """
    ranking = [(c, v) for c, v in forms if c.effect is None and c.dependence not in model.unknown]
    steps = [
        extend(residual, library, model, candidate, has_noise=True)
        for candidate, value in ranking[:FITTED]
        if value > IN_REACH * least
    ]
    steps = [step for step in steps if step.surprise > least]
    return max(steps, key=lambda s: evidence(s.gain, s.candidate.freedom), default=None)


def acts_on(triad: str, unknown: Candidate | Dependence) -> bool:
    """Whether an unknown dependence belongs to a triad, `imu` being both."""
    return triad in (unknown.triad, "imu")


def unknown_instead(
    residual: Residual, library: Library, model: Model, place: int, least: float
) -> tuple[Step, tuple[Dependence, ...]] | None:
    """Return the unknown dependence that explains clearly more than a term, and what it replaces.

    It is compared with the term together with all unknown dependences of the term's triad: an
    effect of the wrong form leaves a misfit that depends on the same covariates.
    """
    term = model.terms[place]
    beside = tuple(dict.fromkeys(n for n in model.unknown if acts_on(term.effect.triad, n)))
    shorter = without(residual, model, place)
    if beside:
        shorter = without_unknown(residual, shorter, *beside)
    gain = gain_between(residual, shorter, model)
    freedom = model.base.shape[2] - shorter.base.shape[2]
    gains = screen(residual, shorter.noise, library, shorter.base, shorter.misfit)
    forms = [(c, v) for c, v in best_forms(library, gains) if acts_on(term.effect.triad, c)]
    step = best_unknown(
        residual, library, shorter, forms, max(least, IN_REACH * evidence(gain, freedom))
    )
    if step is None or not is_clearer_than(residual, step, model, freedom):
        return None
    return step, beside


def covariates_alike(
    residual: Residual, library: Library, shorter: Model, unknown: Dependence
) -> tuple[str, ...]:
    """Return the covariates that explain as much as an unknown dependence.

    `shorter` is the model without it. Its own covariate is first; all are for the same triad.
    """
    gains = screen(residual, shorter.noise, library, shorter.base, shorter.misfit)
    value: dict[str, float] = {}
    for candidate, gain in zip(library.candidates, gains.gain, strict=True):
        if candidate.effect is None and candidate.triad == unknown.triad:
            found = evidence(float(gain), candidate.freedom)
            value[candidate.covariate] = max(found, value.get(candidate.covariate, 0.0))
    own = unknown.covariate
    near = [other for other, found in value.items() if found > value[own] - CLEARLY]
    near.sort(key=lambda other: (other != own, -value[other]))
    return tuple(near)
