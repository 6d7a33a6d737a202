"""Revision of the findings: inconsistent, small, misnamed or harmful ones are removed."""

from typing import Final

import numpy as np

from ahrs_service.diagnosis.hypotheses.hypothesis import without, without_unknown
from ahrs_service.diagnosis.hypotheses.model import Model, gain_between
from ahrs_service.diagnosis.hypotheses.named_vs_unknown import unknown_instead
from ahrs_service.diagnosis.hypotheses.score_test import surprise
from ahrs_service.diagnosis.judgement.agreement import scatter_of_term, scatter_of_unknown
from ahrs_service.diagnosis.judgement.held_out_gain import held_out
from ahrs_service.diagnosis.search.explained import Explained
from ahrs_service.diagnosis.search.search_threshold import ALARM, UNKNOWN_ALARM

_KEPT_SHARE: Final = 0.25
"""A choice: next to an unknown dependence a named effect must keep this share of its gain."""


def pruned(found: Explained) -> Explained:
    """Remove what explains little next to the rest: unknown dependences first, then effects."""
    if found.count < 2:
        return found
    residual = found.residual
    for one in tuple(found.unknown):
        shorter = without_unknown(residual, found.model, one)
        gain = gain_between(residual, shorter, found.model)
        if surprise(gain, found.model.unknown.count(one)) < UNKNOWN_ALARM:
            found = found.without_unknown(shorter, one)
    place = 0
    while place < len(found.taken):
        shorter = without(residual, found.model, place)
        gain = gain_between(residual, shorter, found.model)
        step = found.taken[place]
        is_small = found.unknown and gain < _KEPT_SHARE * step.gain
        if is_small or surprise(gain, step.candidate.freedom) < ALARM:
            found = found.without_effect(place, shorter)
        else:
            place += 1
    return found


def reformed(found: Explained) -> Explained:
    """Replace every effect by an unknown dependence that explains clearly more, if there is one."""
    if found.count < 2:
        return found
    place = 0
    while place < len(found.taken):
        better = unknown_instead(found.residual, found.library, found.model, place, UNKNOWN_ALARM)
        if better is None:
            place += 1
            continue
        step, replaced = better
        rest = found.without_effect(place, step.model).without_unknown(step.model, *replaced)
        found = rest.with_unknown(step)
    return pruned(found)


def confirmed(found: Explained) -> Explained:
    """Remove every effect after the first that makes held-out blocks worse."""
    place = 1
    while place < len(found.taken):
        shorter = without(found.residual, found.model, place)
        triad = found.model.terms[place].effect.triad
        if held_out(found.residual, shorter, found.model, triad).log_likelihood_gain < 0.0:
            found = found.without_effect(place, shorter)
        else:
            place += 1
    return found


def agreed(found: Explained) -> Explained:
    """Remove explanations on which parts of the recording disagree, the weakest first.

    The strongest effect stays: what the others leave of it makes its parts differ.
    """
    residual = found.residual
    for one in reversed(tuple(found.unknown)):
        ratio = scatter_of_unknown(residual, found.model, one)
        if ratio > 1.0:
            shorter = without_unknown(residual, found.model, one)
            gain = gain_between(residual, shorter, found.model)
            if surprise(gain / ratio, found.model.unknown.count(one)) < UNKNOWN_ALARM:
                found = found.without_unknown(shorter, one)
    while len(found.taken) > 1:
        weakest = _most_contradicted(found)
        if weakest is None:
            break
        found = found.without_effect(*weakest)
    return found


def _most_contradicted(found: Explained) -> tuple[int, Model] | None:
    """Return the weakest effect on which parts disagree, and the model without it."""
    residual, model, taken = found.residual, found.model, found.taken
    ratios = [scatter_of_term(residual, model, place) for place in range(len(taken))]
    if max(ratios) == 1.0:
        return None
    others = [without(residual, model, place) for place in range(len(taken))]
    gains = [gain_between(residual, one, model) for one in others]
    left = [
        surprise(gain / ratio, step.candidate.freedom) if gain < max(gains) else np.inf
        for gain, ratio, step in zip(gains, ratios, taken, strict=True)
    ]
    weakest = int(np.argmin(left))
    if left[weakest] >= ALARM or ratios[weakest] == 1.0:
        return None
    return weakest, others[weakest]
