"""Which effects a recording cannot separate: by the gains found, and by those to be expected.

Noise may favour one of two hypotheses that the excitation does not separate. A class therefore also
contains the effects that would fit nearly as well on average over recordings of this excitation.
"""

from typing import Final

from ahrs_service.diagnosis.hypotheses.candidates import Candidate, Library
from ahrs_service.diagnosis.hypotheses.hypothesis import Step, best_forms, extend
from ahrs_service.diagnosis.hypotheses.model import Model, added_rows
from ahrs_service.diagnosis.hypotheses.score_test import gain_of, grams, screen
from ahrs_service.diagnosis.input.misfit import Residual

ALIKE: Final = 4.0
"""Difference [nats] of surprise, gain or expected gain below which two hypotheses are not
separated: odds of 50."""

SHARE_OF_MAIN: Final = 0.004
"""Share of a gain that is never significant: response and motion are known no better."""

_EXPECTED_SHARE: Final = 0.25
"""A choice: share of a gain below 16 nats (ALIKE over it) that another effect may lose and still
count as alike."""
TRIED: Final = 5
"""A choice: how many hypotheses are fitted, in the order of screening; as many in the search."""
_WORTH: Final = 0.4
"""Share of the screened surprise from which a rival is fitted. Searched from 0.2 to 0.8: flat, on
the four blind recordings that forward_search._CLOSE names."""
_ALIKE_SHARE: Final = 0.7
"""Share of the fitted surprise from which a rival's noise is fitted too. Searched from 0.35 to 0.9:
flat, on the same."""


def expected_losses(
    residual: Residual, library: Library, shorter: Model, model: Model, place: int
) -> dict[str, float]:
    """Return how much less each hypothesis would gain than a term of `model`, were that the truth.

    The gain [nats] of a hypothesis h for a response s is half the square of s projected on the
    responses of h, whitened and with the nuisances of `shorter` fitted: its mean over the noise,
    less half a nat per parameter. Nonlinear parameters are those of the search grid.
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
        # The surprise favours fewer parameters; where both fit equally well the data do not.
        more = max(other.surprise - step.surprise, other.gain - step.gain)
        if more > -reach and (value, candidate.name) not in same:
            same.append((value, candidate.name))
    same.sort(reverse=True)
    return (name, *(identifier for _, identifier in same)), rival


def _fitted(
    residual: Residual, library: Library, shorter: Model, candidate: Candidate, against: float
) -> Step:
    """Return a rival fitted, with its noise too where it comes close to the surprise `against`."""
    other = extend(residual, library, shorter, candidate, has_noise=False)
    if other.surprise > _ALIKE_SHARE * against:
        other = extend(residual, library, shorter, candidate, has_noise=True)
    return other
