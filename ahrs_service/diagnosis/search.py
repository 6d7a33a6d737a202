"""The search for what was left out: forward by likelihood, with swaps, then back.

Every hypothesis is screened by its gain under the noise as it is; the best few are then fitted in
full, nonlinear parameters and noise with them, because an effect that is there inflates the noise
of a model without it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from ahrs_service.diagnosis.library import Candidate, Library, Term
from ahrs_service.diagnosis.model import Model, bare, refit, settle
from ahrs_service.diagnosis.residual import Residual
from ahrs_service.diagnosis.screen import Gains, screen, surprise

ALARM: Final = 9.0
"""Surprise [nats] from which a hypothesis is believed: see tests/benchmarks/mismatch_nulls.py."""

SHARE_OF_MAIN: Final = 0.004
"""A further effect must gain this share of the first: so well are response and motion known."""

UNKNOWN_ALARM: Final = 12.0
ALIKE: Final = 4.0
"""Difference of surprise [nats] below which two hypotheses are not told apart: odds of 50."""

_TRIED: Final = 5
_CLOSE: Final = 0.6
_MOST_EFFECTS: Final = 4
_KEPT_SHARE: Final = 0.25

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
    with its gain; `unknown` surprise per unknown dependence left or taken.
    """

    bare: Model
    model: Model
    steps: tuple[Step, ...]
    alike: tuple[tuple[str, ...], ...]
    rivals: tuple[tuple[str, float] | None, ...]
    unknown: dict[str, float]


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


def extend(residual: Residual, model: Model, candidate: Candidate, has_noise: bool) -> Step:
    """Return `model` with a candidate more, fitted; with the noise fitted again if `has_noise`."""
    terms = (*model.terms, term_of(candidate))
    longer = settle(residual, terms, model.noise, model.unknown, model.unknown_rows)
    if has_noise:
        longer = refit(residual, longer)
    gain = longer.log_likelihood - model.log_likelihood
    return Step(candidate, longer, gain, surprise(gain, candidate.freedom))


def _named(ranking: list[tuple[Candidate, float]], model: Model) -> list[tuple[Candidate, float]]:
    taken = {term.effect.id for term in model.terms}
    return [(c, value) for c, value in ranking if c.effect is not None and c.effect.id not in taken]


def best_step(residual: Residual, library: Library, model: Model, least: float) -> Step | None:
    """Return the best further effect, None where no hypothesis reaches the surprise `least`.

    Screened, then settled, then those within reach of the best fitted with their noise.
    """
    gains = screen(residual, model.noise, library, model.base, model.misfit)
    ranking = _named(best_forms(library, gains), model)[:_TRIED]
    ranking = [(c, value) for c, value in ranking if value > 0.5 * least]
    if not ranking:
        return None
    steps = [extend(residual, model, c, has_noise=False) for c, _ in ranking]
    steps.sort(key=lambda step: -step.surprise)
    top = steps[0].surprise
    close = [step for step in steps if step.surprise > _CLOSE * top]
    fitted = []
    for step in close[:3]:
        whole = refit(residual, step.model)
        gain = whole.log_likelihood - model.log_likelihood
        fitted.append(Step(step.candidate, whole, gain, surprise(gain, step.candidate.freedom)))
    best = max(fitted, key=lambda step: step.surprise)
    return best if best.surprise > least else None


def _without(residual: Residual, model: Model, place: int) -> Model:
    terms = model.terms[:place] + model.terms[place + 1 :]
    return refit(residual, settle(residual, terms, model.noise, model.unknown, model.unknown_rows))


def _with_unknown(
    residual: Residual, library: Library, model: Model, candidate: Candidate
) -> Model:
    rows = np.concatenate([model.unknown_rows, library.rows[:, :, candidate.columns]], axis=2)
    names = (*model.unknown, candidate.name)
    return refit(residual, settle(residual, model.terms, model.noise, names, rows))


def search(residual: Residual, library: Library, progress: Progress | None = None) -> Search:
    """Find the effects that explain a misfit, and what else it depends on."""
    tell = progress or (lambda share: None)
    empty = bare(residual)
    tell(0.25)
    model, candidates, main = empty, list[Candidate](), 0.0
    while len(model.terms) < _MOST_EFFECTS:
        least = ALARM + SHARE_OF_MAIN * main
        step = best_step(residual, library, model, least)
        if step is None:
            break
        main = max(main, step.gain)
        model, candidates = step.model, [*candidates, step.candidate]
        if len(candidates) > 1:
            model, candidates = _swap(residual, library, model, candidates)
        tell(0.25 + 0.12 * len(candidates))
    model, candidates, unknown = _unknowns(residual, library, model, candidates, main)
    tell(0.8)
    steps, alike, rivals = [], [], []
    for place, candidate in enumerate(candidates):
        shorter = _without(residual, model, place)
        gain = model.log_likelihood - shorter.log_likelihood
        steps.append(Step(candidate, shorter, gain, surprise(gain, candidate.freedom)))
        same, rival = _alike(residual, library, shorter, steps[-1])
        alike.append(same)
        rivals.append(rival)
    return Search(empty, model, tuple(steps), tuple(alike), tuple(rivals), unknown)


def _swap(
    residual: Residual, library: Library, model: Model, candidates: list[Candidate]
) -> tuple[Model, list[Candidate]]:
    """Put another effect in the place of each but the last where that explains more."""
    for place in range(len(candidates) - 1):
        shorter = _without(residual, model, place)
        step = best_step(residual, library, shorter, ALARM)
        if step is None:
            continue
        own = surprise(model.log_likelihood - shorter.log_likelihood, candidates[place].freedom)
        if step.surprise > own + ALIKE and step.candidate.name != candidates[place].name:
            kept = candidates[:place] + candidates[place + 1 :]
            return step.model, [*kept, step.candidate]
    return model, candidates


def _unknowns(
    residual: Residual,
    library: Library,
    model: Model,
    candidates: list[Candidate],
    main: float,
) -> tuple[Model, list[Candidate], dict[str, float]]:
    """Test what is left against smooth dependences, and drop effects that only stood in for one."""
    found: dict[str, float] = {}
    for _ in range(2):
        gains = screen(residual, model.noise, library, model.base, model.misfit)
        ranking = [(c, v) for c, v in best_forms(library, gains) if c.effect is None]
        ranking = [(c, v) for c, v in ranking if c.name not in model.unknown]
        if not ranking or ranking[0][1] < UNKNOWN_ALARM + SHARE_OF_MAIN * main:
            break
        models = [_with_unknown(residual, library, model, c) for c, _ in ranking[:2]]
        best = max(range(len(models)), key=lambda n: models[n].log_likelihood)
        gain = models[best].log_likelihood - model.log_likelihood
        value = surprise(gain, ranking[best][0].freedom)
        if value < UNKNOWN_ALARM + SHARE_OF_MAIN * main:
            break
        found[ranking[best][0].name] = value
        model, candidates = _drop(residual, models[best], candidates, model)
    return model, candidates, found


def _drop(
    residual: Residual, model: Model, candidates: list[Candidate], before: Model
) -> tuple[Model, list[Candidate]]:
    """Leave out effects that gain little now of what they gained before."""
    place = 0
    while place < len(candidates):
        shorter = _without(residual, model, place)
        gain = model.log_likelihood - shorter.log_likelihood
        old = before.log_likelihood - _without(residual, before, place).log_likelihood
        least = max(_KEPT_SHARE * old, 0.0)
        if gain < least or surprise(gain, candidates[place].freedom) < ALARM:
            model = shorter
            before = replace(before, terms=before.terms[:place] + before.terms[place + 1 :])
            candidates = candidates[:place] + candidates[place + 1 :]
        else:
            place += 1
    return model, candidates


def _alike(
    residual: Residual, library: Library, shorter: Model, step: Step
) -> tuple[tuple[str, ...], tuple[str, float] | None]:
    """Return the ids that explain as much as a step's effect in its place, and the next best."""
    gains = screen(residual, shorter.noise, library, shorter.base, shorter.misfit)
    ranking = _named(best_forms(library, gains), shorter)
    name = step.candidate.name
    own = next((value for c, value in ranking if c.name == name), step.surprise)
    others = [(c, v) for c, v in ranking if c.name != name and v > 0.5 * own][:_TRIED]
    same, rival = [], None
    for candidate, _ in others:
        other = extend(residual, shorter, candidate, has_noise=False)
        if other.surprise > 0.5 * step.surprise:
            other = extend(residual, shorter, candidate, has_noise=True)
        if rival is None or other.gain > rival[1]:
            rival = (candidate.name, other.gain)
        if other.surprise > step.surprise - ALIKE:
            same.append((other.surprise, candidate.name))
    same.sort(reverse=True)
    return (name, *(identifier for _, identifier in same)), rival
