"""Score test: the gain in likelihood of every candidate at once, from one Gram matrix."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2

from ahrs_service.diagnosis.hypotheses.candidates import Candidate, Library, linear_entries
from ahrs_service.diagnosis.hypotheses.likelihood import solve
from ahrs_service.diagnosis.hypotheses.model import SIZES
from ahrs_service.diagnosis.input.misfit import Noise, Residual
from ahrs_service.records import Floats

_LEAST_SIGMA: Final = 3.0
"""A choice: one parameter at 3 sigma has a surprise of 5.9 nats; ALARM requires 8.3 (3.7 sigma)."""
_OWN_SHARE: Final = 1e-8
"""Least share of a response's whitened energy not explained by nuisances: less is rounding."""


@dataclass(frozen=True, slots=True)
class Gains:
    """Gain in log-likelihood of each candidate [nats], and its surprise -ln p [nats]."""

    gain: Floats
    surprise: Floats


def surprise(gain: float, freedom: int) -> float:
    """Return the surprise: -ln of the chance of this gain under noise, by Wilks' chi-squared tail.

    Beyond the range of a double, by the first two terms of the tail (Abramowitz, Stegun 26.4.12).
    """
    gain = max(gain, 0.0)
    if gain < 300.0:
        return float(-chi2.logsf(2.0 * gain, freedom))
    half = 0.5 * freedom
    tail = (half - 1.0) * np.log(gain) - gammaln(half) + np.log1p((half - 1.0) / gain)
    return float(gain - tail)


def grams(
    residual: Residual, noise: Noise, library: Library, base: Floats, rows: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the candidates' Gram [K, K], its target [K] and the share of their own energy [K].

    All with the nuisances `base` [N, 6, B] projected out, under `noise`; target is `rows` [N, 6].
    """
    stack = np.concatenate([base, library.rows, rows[:, :, None]], axis=2)
    gram, _ = residual.grams(stack)(noise)
    count = base.shape[2]
    _, inverse, _ = solve(gram[:count, :count], gram[:count, -1])
    cross = gram[count:, :count]
    own = gram[count:, count:] - cross @ inverse @ cross.T
    energy = np.maximum(np.diag(gram)[count:-1], 1e-300)
    return own[:-1, :-1], own[:-1, -1], np.diag(own)[:-1] / energy


def gain_of(candidate: Candidate, gram: Floats, target: Floats, share: Floats) -> Floats:
    """Return the gain in log-likelihood [nats] of one candidate, [...] for `target` [K, ...]."""
    place = candidate.columns
    if candidate.is_whole:
        return np.asarray(target[place][0] - 0.5 * gram[place, place][0, 0])
    kept = np.flatnonzero(share[place] > _OWN_SHARE) + place.start
    if not len(kept):
        return np.zeros(target.shape[1:])
    own = gram[np.ix_(kept, kept)]
    if candidate.effect is not None:
        sizes = np.array([SIZES * p.plausible for p, _ in linear_entries(candidate.effect)])
        own = own + np.diag(sizes[kept - place.start] ** -2.0)
    solution, _, _ = solve(own, target[kept])
    return np.asarray(0.5 * np.sum(solution * target[kept], axis=0))


def screen(residual: Residual, noise: Noise, library: Library, base: Floats, rows: Floats) -> Gains:
    """Return the gains of all candidates of the library under one noise."""
    gram, target, share = grams(residual, noise, library, base, rows)
    gains = np.array([float(gain_of(c, gram, target, share)) for c in library.candidates])
    surprises = [
        surprise(gain, candidate.freedom)
        for gain, candidate in zip(gains, library.candidates, strict=True)
    ]
    return Gains(gains, np.array(surprises))


def unseen(
    residual: Residual, noise: Noise, library: Library, base: Floats, rows: Floats
) -> dict[str, str]:
    """Return the effects that stay below the noise even at the largest plausible size, and why.

    By the sigma of each parameter fitted alone with the nuisances; an effect is not observable
    where three sigmas of each of its parameters exceed the largest in data sheets.
    """
    gram, _, _ = grams(residual, noise, library, base, rows)
    energy = np.maximum(np.diag(gram), 1e-300)
    best: dict[str, float] = {}
    for candidate in library.candidates:
        if candidate.effect is None:
            continue
        sizes = [1.0]
        if not candidate.is_whole:
            sizes = [p.plausible for p, _ in linear_entries(candidate.effect)]
        ratio = float(np.max(np.array(sizes) * np.sqrt(energy[candidate.columns])))
        best[candidate.name] = max(ratio, best.get(candidate.name, 0.0))
    return {
        name: f"the largest plausible size would be {ratio:.1f} sigma of the noise"
        for name, ratio in best.items()
        if ratio < _LEAST_SIGMA
    }
