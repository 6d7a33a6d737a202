"""The search for missing effects: forward selection by likelihood, with swaps, then pruning.

Every hypothesis is screened by its gain under the current noise; the best few are then fitted in
full, including nonlinear parameters and noise, because an effect that is present inflates the
noise of a model without it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.diagnosis.hypotheses.candidates import Candidate, Dependence, Library
from ahrs_service.diagnosis.hypotheses.hypothesis import (
    Step,
    best_forms,
    extend,
    step_between,
    without,
    without_unknown,
)
from ahrs_service.diagnosis.hypotheses.model import (
    Model,
    bare,
    choose,
    free_numbers,
    gain_between,
    is_plausible,
    refit,
)
from ahrs_service.diagnosis.hypotheses.named_vs_unknown import (
    FITTED,
    IN_REACH,
    best_unknown,
    covariates_alike,
    is_clearer_than,
)
from ahrs_service.diagnosis.hypotheses.score_test import screen, surprise
from ahrs_service.diagnosis.input.misfit import Residual
from ahrs_service.diagnosis.judgement.agreement import scatter_of_term
from ahrs_service.diagnosis.judgement.classes import ALIKE, SHARE_OF_MAIN, TRIED, alike
from ahrs_service.diagnosis.search.explained import Explained
from ahrs_service.diagnosis.search.revision import agreed, confirmed, pruned, reformed
from ahrs_service.diagnosis.search.search_threshold import (
    ALARM,
    UNKNOWN_ALARM,
    hypotheses,
    maxima,
)

_CLOSE: Final = 0.6
"""A choice: share of the best surprise from which an effect's noise is fitted too. Not the 0.7 of
classes.py: there the best is the effect itself, whose noise is fitted. Searched from 0.3 to 0.9:
flat, on four blind recordings (cases 1, 3, 6 and 8 of plan(14, 4711, 120)), as _APART from 0.07
to 0.3."""
_MOST_STEPS: Final = 5  # A choice: at most so many effects and unknowns in a recording
_APART: Final = 0.15
"""Correlation below which one effect cannot have replaced two (searched: see _CLOSE)."""
_FREED: Final = 11.0
"""Extra surprise [nats] required of a gain that appears only when the wander is refitted: its size
and time are poorly known, and a smaller wander favours any slow regressor. In 100 recordings of
noise the largest surprises of this kind were 17.2 and 15.1, both for wander that follows
temperature, and 5.3 without the refit. Not required of a rotated mounting, which is no slow
regressor: there the largest was 4.4, in the 66 recordings in motion."""
_SHARE_OF_UNKNOWN: Final = 0.3
"""A choice: share of an unknown dependence's gain that its unmodelled rest may imitate (see
_least_beside_unknown)."""
_SOME: Final = 1.5  # A choice: noise alone exceeds it for 22 % of the hypotheses (e^-1.5)
Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class Search:
    """The result of the search.

    `steps` one per term of `model`, in its order, each with gain and surprise against the model
    without it; `alike` per term the ids that explain as much; `rivals` per term the next best
    effect with its gain; `unknown` surprise of each unknown dependence; `covariates` per unknown
    dependence the covariates that explain as much, its own first; `hypotheses` the number of
    independent hypotheses; `scatter` per term the ratio of its true variances to those of the
    noise model, see judgement.agreement.
    """

    bare: Model
    model: Model
    steps: tuple[Step, ...]
    alike: tuple[tuple[str, ...], ...]
    rivals: tuple[tuple[str, float] | None, ...]
    unknown: dict[Dependence, float]
    covariates: dict[Dependence, tuple[str, ...]]
    hypotheses: float
    scatter: tuple[float, ...]


def _named(ranking: list[tuple[Candidate, float]], model: Model) -> list[tuple[Candidate, float]]:
    taken = {term.effect.id for term in model.terms}
    return [(c, value) for c, value in ranking if c.effect is not None and c.effect.id not in taken]


def best_step(residual: Residual, library: Library, model: Model, least: float) -> Step | None:
    """Return the best further effect, None where no hypothesis reaches the surprise `least`.

    A smooth unknown dependence is returned instead where it explains clearly more.
    """
    gains = screen(residual, model.noise, library, model.base, model.misfit)
    forms = best_forms(library, gains)
    named = _best_named(residual, library, model, forms, least)
    least_unknown = max(UNKNOWN_ALARM, 0.0 if named is None else IN_REACH * named.surprise)
    unknown = best_unknown(residual, library, model, forms, least_unknown)
    if unknown is not None and (
        named is None or is_clearer_than(residual, unknown, named.model, named.candidate.freedom)
    ):
        return unknown
    return named if named is not None and named.surprise > least else None


def _is_possible(library: Library, step: Step) -> bool:
    """Whether an IMU can have a step's parameters; an effect too large is noted in `library`."""
    if is_plausible(step.model):
        return True
    library.implausible[step.candidate.name] = step.model.terms[-1], step.gain
    return False


def _may_be_absorbed(candidate: Candidate, value: float) -> bool:
    """Whether the noise of a model without a candidate may have absorbed what it explains.

    Only a joint fit with the noise separates a constant error from a slow error of the reference.
    """
    return candidate.is_constant and value > _SOME


def _best_named(
    residual: Residual,
    library: Library,
    model: Model,
    forms: list[tuple[Candidate, float]],
    least: float,
) -> Step | None:
    """Return the effect of highest surprise: all fitted, the best of them again with the noise."""
    ranking = [(c, value) for c, value in _named(forms, model) if value > IN_REACH * least][:TRIED]
    ranking += [(c, v) for c, v in forms if _may_be_absorbed(c, v) and (c, v) not in ranking]
    if not ranking:
        return None
    steps = [extend(residual, library, model, c, has_noise=False) for c, _ in ranking]
    held = {step.candidate.name: step.surprise for step in steps}
    top = max(held.values())
    close = sorted(steps, key=lambda step: -step.surprise)
    fitted = [
        step_between(residual, model, step.candidate, refit(residual, step.model))
        for rank, step in enumerate(close)
        if (rank < FITTED and step.surprise >= _CLOSE * top)
        or _may_be_absorbed(step.candidate, step.surprise)
    ]
    fitted = [step for step in fitted if _is_possible(library, step)]
    best = max(fitted, key=lambda step: step.surprise, default=None)
    if best is None or held[best.candidate.name] >= least:
        return best
    freed = 0.0 if best.candidate.is_constant else _FREED
    if best.surprise >= least + freed:
        return best
    return None


def search(residual: Residual, library: Library, progress: Progress | None = None) -> Search:
    """Find the effects that explain a misfit, and the unknown dependences that remain."""
    report = progress or (lambda share: None)
    empty = bare(residual)
    count = hypotheses(maxima(residual, library, empty))
    report(0.25)
    found = _forward(Explained(residual, library, empty), report)
    for stage in (agreed, pruned, reformed, confirmed):
        found = stage(found)
    report(0.8)
    return _judged(found, empty, count)


def _forward(found: Explained, report: Progress) -> Explained:
    """Add the best explanation, one after the other, until none is significant."""
    main, unknowns = 0.0, list[Step]()
    for number in range(_MOST_STEPS):
        step = best_step(found.residual, found.library, found.model, ALARM + SHARE_OF_MAIN * main)
        if step is None or step.gain < _least_beside_unknown(step, unknowns):
            break
        main = max(main, step.gain)
        model = step.model
        choose(found.residual, model.noise, model.base, model.misfit, model.prior)
        if step.candidate.effect is None:
            found = found.with_unknown(step)
            unknowns.append(step)
        else:
            found = _swap(found.with_effect(step))
        report(0.25 + 0.1 * (number + 1))
    return found


def _judged(found: Explained, empty: Model, count: float) -> Search:
    """Return what was found with the gain of each effect over the model without it."""
    residual, library, model = found.residual, found.library, found.model
    covariates = {
        one: covariates_alike(residual, library, without_unknown(residual, model, one), one)
        for one in found.unknown
    }
    scatter = tuple(scatter_of_term(residual, model, place) for place in range(len(found.taken)))
    steps, classes, rivals = [], [], []
    for place, step in enumerate(found.taken):
        shorter = without(residual, model, place)
        gain = gain_between(residual, shorter, model)
        freedom = step.candidate.freedom
        steps.append(Step(step.candidate, shorter, gain, surprise(gain, freedom)))
        same, rival = alike(residual, library, shorter, model, place, steps[-1])
        classes.append(same)
        rivals.append(rival)
    return Search(
        empty,
        model,
        tuple(steps),
        tuple(classes),
        tuple(rivals),
        dict(found.unknown),
        covariates,
        count,
        scatter,
    )


def _overlap(model: Model, place: int) -> float:
    """Return the largest correlation between the numbers of one term and those of the others."""
    own = np.array([number.term == place for number in free_numbers(model.terms)])
    sigma = np.sqrt(np.maximum(np.diag(model.covariance), 1e-300))
    correlation = model.covariance / sigma[:, None] / sigma[None, :]
    return float(np.abs(correlation[np.ix_(own, ~own)]).max(initial=0.0))


def _least_beside_unknown(step: Step, unknowns: list[Step]) -> float:
    """Return the gain that a step needs where its triad has an unknown dependence.

    What a smooth form leaves of the unknown can imitate an effect with a part of its gain.
    """
    there = [u.gain for u in unknowns if step.candidate.triad in (u.candidate.triad, "imu")]
    return _SHARE_OF_UNKNOWN * max(there, default=0.0)


def _swap(found: Explained) -> Explained:
    """Replace each effect but the last by another where that explains more.

    Only where their parameters are correlated can the first have replaced both.
    """
    residual, model = found.residual, found.model
    for place, own_step in enumerate(found.taken[:-1]):
        if _overlap(model, place) < _APART:
            continue
        shorter = without(residual, model, place)
        step = best_step(residual, found.library, shorter, ALARM)
        if step is None or step.candidate.effect is None:
            continue
        name, freedom = own_step.candidate.name, own_step.candidate.freedom
        own = surprise(gain_between(residual, shorter, model), freedom)
        if step.surprise > own + ALIKE and step.candidate.name != name:
            return found.without_effect(place, shorter).with_effect(step)
    return found
