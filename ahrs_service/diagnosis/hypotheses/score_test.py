"""How much each candidate would add to the likelihood, all at once from one Gram matrix."""

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
"""A choice: one number of 3 sigma surprises by 5.9 nats; ALARM asks 8.3 (3.7 sigma)."""
_OWN_SHARE: Final = 1e-8
"""Of a response's whitened energy that the nuisances must leave: less is rounding."""


@dataclass(frozen=True, slots=True)
class Gains:
    """Gain in log-likelihood of each candidate [nats], and its surprise -log p."""

    gain: Floats
    surprise: Floats


def surprise(gain: float, freedom: int) -> float:
    """Return -log of the chance of a gain this large by noise alone: Wilks' chi-squared tail.

    Beyond what a double holds, by the first two terms of the tail (Abramowitz, Stegun 26.4.12).
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
    """Return the candidates' Gram [K, K], its target [K] and what of the energy is their own [K].

    All after the nuisances `base` [N, 6, B] are fitted, under `noise`, to `rows` [N, 6].
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
    """Return the gain in log-likelihood [nats] of one candidate: of `target` [K, ...] an [...]."""
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
    """Return why effects would stay below the noise here even at the largest plausible size.

    By each number's sigma, were it alone beside the nuisances; an effect is not observable where
    for all of its numbers three sigmas exceed what data sheets give.
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
