"""The search for what was left out: forward by likelihood, with swaps, then back.

Every hypothesis is screened by its gain under the noise as it is; the best few are then fitted in
full, nonlinear parameters and noise with them, because an effect that is there inflates the noise
of a model without it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.diagnosis.agreement import scatter_of_term, scatter_of_unknown
from ahrs_service.diagnosis.holdout import held_out
from ahrs_service.diagnosis.library import Candidate, Library, Term, limits
from ahrs_service.diagnosis.model import (
    Model,
    bare,
    choose,
    free_numbers,
    gain_between,
    is_plausible,
    refit,
    settle,
)
from ahrs_service.diagnosis.residual import Residual
from ahrs_service.diagnosis.screen import Gains, screen, surprise

ALARM: Final = 8.8
"""Surprise [nats] from which a hypothesis is believed: see tests/benchmarks/mismatch_nulls.py."""

SHARE_OF_MAIN: Final = 0.004
"""A further effect must gain this share of the first: so well are response and motion known."""

UNKNOWN_ALARM: Final = 16.0
"""The same for a smooth unknown dependence: higher, because noise that goes with the motion (a
jittered reference) raises these tests, of which there are twenty of twelve numbers each."""

ALIKE: Final = 4.0
"""Difference of surprise [nats] below which two hypotheses are not told apart: odds of 50."""

_TRIED: Final = 5
_CLOSE: Final = 0.6
_MOST_STEPS: Final = 5
_KEPT_SHARE: Final = 0.25
_APART: Final = 0.15
_ALIKE_SHARE: Final = 0.7
_FAR_MORE: Final = 1.15
_FREED: Final = 6.0
"""More surprise [nats] asked of a gain that is there only once the wander is fitted again: its size
and time are badly known, and a smaller wander makes more of any slow regressor."""
_SHARE_OF_UNKNOWN: Final = 0.3
_NO_TIES: Final = 12.0
"""Less surprise [nats] of a limit at which no readings end: it acts on the few largest alone, where
the reference is worst."""

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class Step:
    """A hypothesis fitted: its model, gain over the model before [nats], and surprise."""

    candidate: Candidate
    model: Model
    gain: float
    surprise: float


@dataclass(frozen=True, slots=True)
class Search:
    """What the search found.

    `steps` one per term of `model`, in its order, each with gain and surprise against the model
    without it; `alike` per term the ids that explain as much; `rivals` per term the next best
    with its gain; `unknown` surprise per unknown dependence left or taken; `scatter` per term by
    how much its variances are larger than the noise says, see diagnosis.agreement.
    """

    bare: Model
    model: Model
    steps: tuple[Step, ...]
    alike: tuple[tuple[str, ...], ...]
    rivals: tuple[tuple[str, float] | None, ...]
    unknown: dict[str, float]
    scatter: tuple[float, ...]


def best_forms(library: Library, gains: Gains) -> list[tuple[Candidate, float]]:
    """Return the best form of each hypothesis with its surprise, the most surprising first."""
    best: dict[str, tuple[Candidate, float]] = {}
    for candidate, value in zip(library.candidates, gains.surprise, strict=True):
        if candidate.name not in best or value > best[candidate.name][1]:
            best[candidate.name] = (candidate, float(value))
    return sorted(best.values(), key=lambda item: -item[1])


def term_of(candidate: Candidate) -> Term:
    """Return the term that a candidate begins with: its form, and nil numbers."""
    assert candidate.effect is not None
    values = candidate.effect.neutral()
    return Term(
        candidate.effect, values | {name: np.asarray(v) for name, v in candidate.form.items()}
    )


def extend(
    residual: Residual, library: Library, model: Model, candidate: Candidate, has_noise: bool
) -> Step:
    """Return `model` with a candidate more, fitted; with the noise fitted again if `has_noise`."""
    terms, unknown, rows = model.terms, model.unknown, model.unknown_rows
    if candidate.effect is None:
        unknown = (*unknown, candidate.name)
        rows = np.concatenate([rows, library.rows[:, :, candidate.columns]], axis=2)
    else:
        terms = (*terms, term_of(candidate))
    longer = settle(residual, terms, model.noise, unknown, rows)
    if has_noise:
        longer = refit(residual, longer)
    return _step(residual, model, candidate, longer)


def _step(residual: Residual, before: Model, candidate: Candidate, after: Model) -> Step:
    gain = gain_between(residual, before, after)
    value = surprise(gain, candidate.freedom)
    if candidate.effect is not None and candidate.effect.name == "saturation":
        low, high = limits(residual, candidate.effect)
        value -= 0.0 if low == high else _NO_TIES
    return Step(candidate, after, gain, value)


def _named(ranking: list[tuple[Candidate, float]], model: Model) -> list[tuple[Candidate, float]]:
    taken = {term.effect.id for term in model.terms}
    return [(c, value) for c, value in ranking if c.effect is not None and c.effect.id not in taken]


def best_step(residual: Residual, library: Library, model: Model, least: float) -> Step | None:
    """Return the best further effect, None where no hypothesis reaches the surprise `least`.

    Screened, then settled, then those within reach of the best fitted with their noise. Where a
    smooth unknown dependence explains far more than any of them, that is returned instead.
    """
    gains = screen(residual, model.noise, library, model.base, model.misfit)
    forms = best_forms(library, gains)
    ranking = [(c, value) for c, value in _named(forms, model) if value > 0.5 * least][:_TRIED]
    best = None
    if ranking:
        steps = [extend(residual, library, model, c, has_noise=False) for c, _ in ranking]
        top = max(step.surprise for step in steps)
        close = sorted(steps, key=lambda step: -step.surprise)[:3]
        close = [step for step in close if step.surprise >= _CLOSE * top]
        fitted = [
            _step(residual, model, step.candidate, refit(residual, step.model)) for step in close
        ]
        fitted = [step for step in fitted if is_plausible(step.model)]
        best = max(fitted, key=lambda step: step.surprise, default=None)
    if best is not None:
        held = {step.candidate.name: step.surprise for step in steps}[best.candidate.name]
        if held < least and best.surprise < least + _FREED:
            best = None
    unknown = _best_unknown(residual, library, model, forms, best)
    if unknown is not None:
        return unknown
    return best if best is not None and best.surprise > least else None


def _best_unknown(
    residual: Residual,
    library: Library,
    model: Model,
    forms: list[tuple[Candidate, float]],
    named: Step | None,
) -> Step | None:
    """Return the best unknown dependence where it explains far more than the best name."""
    beside = 0.0 if named is None else named.surprise
    least = max(UNKNOWN_ALARM, _FAR_MORE * beside + UNKNOWN_ALARM)
    ranking = [(c, v) for c, v in forms if c.effect is None and c.name not in model.unknown]
    steps = [
        extend(residual, library, model, c, has_noise=True) for c, v in ranking[:2] if v > least / 2
    ]
    best = max(steps, key=lambda step: step.surprise, default=None)
    return best if best is not None and best.surprise > least else None


def _without(residual: Residual, model: Model, place: int) -> Model:
    terms = model.terms[:place] + model.terms[place + 1 :]
    return refit(residual, settle(residual, terms, model.noise, model.unknown, model.unknown_rows))


def search(residual: Residual, library: Library, progress: Progress | None = None) -> Search:
    """Find the effects that explain a misfit, and what else it depends on."""
    tell = progress or (lambda share: None)
    empty = bare(residual)
    tell(0.25)
    model, taken, unknown, main = empty, list[Step](), dict[str, float](), 0.0
    unknowns: list[Step] = []
    for turn in range(_MOST_STEPS):
        step = best_step(residual, library, model, ALARM + SHARE_OF_MAIN * main)
        if step is None or step.gain < _beside_unknown(step, unknowns):
            break
        main = max(main, step.gain)
        model = step.model
        choose(residual, model.noise, model.base, model.misfit, model.prior)
        if step.candidate.effect is None:
            unknown[step.candidate.name] = step.surprise
            unknowns.append(step)
        else:
            taken.append(step)
            model, taken = _swap(residual, library, model, taken)
        tell(0.25 + 0.1 * (turn + 1))
    model, taken, unknown = _agreed(residual, model, taken, unknown)
    model, taken, unknown = _pruned(residual, model, taken, unknown)
    model, taken = _confirmed(residual, model, taken)
    tell(0.8)
    scatter = tuple(scatter_of_term(residual, model, place) for place in range(len(taken)))
    steps, alike, rivals = [], [], []
    for place, step in enumerate(taken):
        shorter = _without(residual, model, place)
        gain = gain_between(residual, shorter, model)
        freedom = step.candidate.freedom
        steps.append(Step(step.candidate, shorter, gain, surprise(gain, freedom)))
        same, rival = _alike(residual, library, shorter, steps[-1])
        alike.append(same)
        rivals.append(rival)
    return Search(empty, model, tuple(steps), tuple(alike), tuple(rivals), unknown, scatter)


def _overlap(model: Model, place: int) -> float:
    """Return the largest correlation between the numbers of one term and those of the others."""
    own = np.array([number.term == place for number in free_numbers(model.terms)])
    sigma = np.sqrt(np.maximum(np.diag(model.covariance), 1e-300))
    correlation = model.covariance / sigma[:, None] / sigma[None, :]
    return float(np.abs(correlation[np.ix_(own, ~own)]).max(initial=0.0))


def _beside_unknown(step: Step, unknowns: list[Step]) -> float:
    """Return the gain that a step needs where something unknown acts on its triad.

    What a smooth form leaves of the unknown imitates much; only a part of its size is believed.
    """
    triad = step.candidate.name.split(" ")[0].split("_")[0]
    there = [u.gain for u in unknowns if triad in (u.candidate.name.split(" ")[0], "imu")]
    return _SHARE_OF_UNKNOWN * max(there, default=0.0)


def _swap(
    residual: Residual, library: Library, model: Model, taken: list[Step]
) -> tuple[Model, list[Step]]:
    """Put another effect in the place of each but the last where that explains more.

    Only where their numbers are correlated could the first have stood in for both.
    """
    for place in range(len(taken) - 1):
        if _overlap(model, place) < _APART:
            continue
        shorter = _without(residual, model, place)
        step = best_step(residual, library, shorter, ALARM)
        if step is None or step.candidate.effect is None:
            continue
        name, freedom = taken[place].candidate.name, taken[place].candidate.freedom
        own = surprise(gain_between(residual, shorter, model), freedom)
        if step.surprise > own + ALIKE and step.candidate.name != name:
            return step.model, [*taken[:place], *taken[place + 1 :], step]
    return model, taken


def _pruned(
    residual: Residual, model: Model, taken: list[Step], unknown: dict[str, float]
) -> tuple[Model, list[Step], dict[str, float]]:
    """Leave out what explains little beside the rest: unknown dependences first, then effects."""
    if len(taken) + len(unknown) < 2:
        return model, taken, unknown
    for name in tuple(unknown):
        shorter = _without_unknown(residual, model, name)
        gain = gain_between(residual, shorter, model)
        freedom = _columns_of(model, name)
        if surprise(gain, freedom) < UNKNOWN_ALARM:
            model = shorter
            unknown = {key: value for key, value in unknown.items() if key != name}
    place = 0
    while place < len(taken):
        shorter = _without(residual, model, place)
        gain = gain_between(residual, shorter, model)
        step = taken[place]
        is_small = unknown and gain < _KEPT_SHARE * step.gain
        if is_small or surprise(gain, step.candidate.freedom) < ALARM:
            model, taken = shorter, taken[:place] + taken[place + 1 :]
        else:
            place += 1
    return model, taken, unknown


def _confirmed(residual: Residual, model: Model, taken: list[Step]) -> tuple[Model, list[Step]]:
    """Leave out every further effect by which blocks that it was not fitted to get worse."""
    place = 1
    while place < len(taken):
        shorter = _without(residual, model, place)
        triad = model.terms[place].effect.triad
        if held_out(residual, shorter, model, triad).log_likelihood_gain < 0.0:
            model, taken = shorter, taken[:place] + taken[place + 1 :]
        else:
            place += 1
    return model, taken


def _agreed(
    residual: Residual, model: Model, taken: list[Step], unknown: dict[str, float]
) -> tuple[Model, list[Step], dict[str, float]]:
    """Leave out what parts of the recording contradict each other on, the weakest first.

    The strongest effect stays: what the others leave of it makes its parts differ.
    """
    for name in reversed(model.unknown):
        ratio = scatter_of_unknown(residual, model, model.unknown.index(name))
        if ratio > 1.0:
            shorter = _without_unknown(residual, model, name)
            gain = gain_between(residual, shorter, model)
            if surprise(gain / ratio, _columns_of(model, name)) < UNKNOWN_ALARM:
                model = shorter
                unknown = {key: value for key, value in unknown.items() if key != name}
    while len(taken) > 1:
        ratios = [scatter_of_term(residual, model, place) for place in range(len(taken))]
        if max(ratios) == 1.0:
            break
        others = [_without(residual, model, place) for place in range(len(taken))]
        gains = [gain_between(residual, one, model) for one in others]
        left = [
            surprise(gain / ratio, step.candidate.freedom) if gain < max(gains) else np.inf
            for gain, ratio, step in zip(gains, ratios, taken, strict=True)
        ]
        weakest = int(np.argmin(left))
        if left[weakest] >= ALARM or ratios[weakest] == 1.0:
            break
        model, taken = others[weakest], taken[:weakest] + taken[weakest + 1 :]
    return model, taken, unknown


def _columns_of(model: Model, name: str) -> int:
    return model.unknown_rows.shape[2] // len(model.unknown)


def _without_unknown(residual: Residual, model: Model, name: str) -> Model:
    width, place = _columns_of(model, name), model.unknown.index(name)
    rows = np.delete(model.unknown_rows, slice(place * width, (place + 1) * width), axis=2)
    names = tuple(other for other in model.unknown if other != name)
    return refit(residual, settle(residual, model.terms, model.noise, names, rows))


def _alike(
    residual: Residual, library: Library, shorter: Model, step: Step
) -> tuple[tuple[str, ...], tuple[str, float] | None]:
    """Return the ids that explain as much as a step's effect in its place, and the next best."""
    gains = screen(residual, shorter.noise, library, shorter.base, shorter.misfit)
    ranking = _named(best_forms(library, gains), shorter)
    name = step.candidate.name
    own = next((value for c, value in ranking if c.name == name), step.surprise)
    others = [(c, v) for c, v in ranking if c.name != name and v > 0.4 * own][:_TRIED]
    mine = extend(residual, library, shorter, step.candidate, has_noise=False)
    same, rival = [], None
    for candidate, _ in others:
        other = extend(residual, library, shorter, candidate, has_noise=False)
        if other.surprise > _ALIKE_SHARE * mine.surprise:
            other = extend(residual, library, shorter, candidate, has_noise=True)
        if rival is None or other.gain > rival[1]:
            rival = (candidate.name, other.gain)
        # Chance prefers the one with fewer numbers; the data do not, where both fit as well.
        if max(other.surprise - step.surprise, other.gain - step.gain) > -ALIKE:
            same.append((other.surprise, candidate.name))
    same.sort(reverse=True)
    return (name, *(identifier for _, identifier in same)), rival
