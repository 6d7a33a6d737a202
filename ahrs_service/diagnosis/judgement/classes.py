"""Which effects a recording cannot tell apart: by how it came out, and by what was to be expected.

Chance may part two hypotheses that the excitation does not. So a class holds also what would stand
in for the effect nearly as well on the average of all recordings of this excitation.
"""

from typing import Final

from ahrs_service.diagnosis.hypotheses.candidates import Candidate, Library
from ahrs_service.diagnosis.hypotheses.hypothesis import Step, best_forms, extend
from ahrs_service.diagnosis.hypotheses.model import Model, added_rows
from ahrs_service.diagnosis.hypotheses.score_test import gain_of, grams, screen
from ahrs_service.diagnosis.input.misfit import Residual

ALIKE: Final = 4.0
"""Difference [nats] of surprise, gain or expected gain below which two hypotheses are not told
apart: odds of 50."""

SHARE_OF_MAIN: Final = 0.004
"""Of a gain, what is beyond telling at any size: so well are response and motion known."""

_EXPECTED_SHARE: Final = 0.25
"""A choice: of a gain below 16 nats (ALIKE over it), what another may lose and still stand in."""
TRIED: Final = 5
"""A choice: hypotheses, best screened first, that are fitted; the search takes as many."""
_WORTH: Final = 0.4
"""Of the screened surprise, from which a rival is worth its fit. Searched from 0.2 to 0.8: flat, on
the four blind recordings that forward_search._CLOSE names."""
_ALIKE_SHARE: Final = 0.7
"""Of the surprise fitted, from which a rival's noise is fitted too. Searched from 0.35 to 0.9:
flat, on the same."""


def expected_losses(
    residual: Residual, library: Library, shorter: Model, model: Model, place: int
) -> dict[str, float]:
    """Return what each hypothesis would gain less than a term of `model`, were that the truth.

    The gain [nats] of a hypothesis h for a response s is half the square of s projected on the
    responses of h, whitened and beside the nuisances of `shorter`: its mean over the noise, but
    for half a nat per number. Nonlinear parameters as searched over.
    """
    others = model.terms[:place] + model.terms[place + 1 :]
    added = added_rows(residual, model.terms) - added_rows(residual, others)
    gram, target, share = grams(residual, model.noise, library, shorter.base, added)
    best: dict[str, float] = {}
    for candidate in library.candidates:
        if candidate.effect is not None:
            gain = float(gain_of(candidate, gram, target, share))
            best[candidate.name] = max(gain, best.get(candidate.name, 0.0))
    own = best[model.terms[place].effect.id]
    return {name: own - gain for name, gain in best.items()}


def _is_near(losses: dict[str, float], name: str, own: str, gain: float) -> bool:
    return name != own and losses[name] < min(ALIKE, _EXPECTED_SHARE * gain)


def alike(
    residual: Residual, library: Library, shorter: Model, model: Model, place: int, step: Step
) -> tuple[tuple[str, ...], tuple[str, float] | None]:
    """Return the ids that explain as much as a step's effect in its place, and the next best.

    `shorter` is `model` without the term at `place`, which is the step's.
    """
    name, taken = step.candidate.name, {term.effect.id for term in shorter.terms}
    gains = screen(residual, shorter.noise, library, shorter.base, shorter.misfit)
    ranking = [
        (c, v)
        for c, v in best_forms(library, gains)
        if c.effect is not None and c.name not in taken
    ]
    own = next((value for c, value in ranking if c.name == name), step.surprise)
    losses = expected_losses(residual, library, shorter, model, place)
    reach = ALIKE + SHARE_OF_MAIN * step.gain
    others = [(c, v) for c, v in ranking if c.name != name and v > _WORTH * own][:TRIED]
    same = [(v, c.name) for c, v in ranking if _is_near(losses, c.name, name, step.gain)]
    mine = extend(residual, library, shorter, step.candidate, has_noise=False)
    rival = None
    for candidate, value in others:
        other = _fitted(residual, library, shorter, candidate, mine.surprise)
        if rival is None or other.gain > rival[1]:
            rival = (candidate.name, other.gain)
        # Chance prefers the one with fewer numbers; the data do not, where both fit as well.
        more = max(other.surprise - step.surprise, other.gain - step.gain)
        if more > -reach and (value, candidate.name) not in same:
            same.append((value, candidate.name))
    same.sort(reverse=True)
    return (name, *(identifier for _, identifier in same)), rival


def _fitted(
    residual: Residual, library: Library, shorter: Model, candidate: Candidate, against: float
) -> Step:
    """Return a rival fitted, with its noise too where it comes near the surprise `against`."""
    other = extend(residual, library, shorter, candidate, has_noise=False)
    if other.surprise > _ALIKE_SHARE * against:
        other = extend(residual, library, shorter, candidate, has_noise=True)
    return other
