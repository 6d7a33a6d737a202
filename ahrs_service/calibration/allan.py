"""Overlapping Allan deviation, and the noise coefficients that it shows (IEEE Std 952, annex C).

    sigma^2(t) = 3 Q^2 / t^2 + N^2 / t + (2 ln 2 / pi) B^2 + K^2 t / 3

Q quantisation, N angle or velocity random walk, B bias instability, K rate random walk. Each
estimate's degrees of freedom follow Riley, NIST SP 1065, sec. 5.4, and give its confidence.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import nnls
from scipy.stats import chi2

from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats, Integers

_FLOOR: Final = math.sqrt(2.0 * math.log(2.0) / math.pi)
"""Of a flat Allan deviation over B: sqrt(2 ln 2 / pi) = 0.664 (IEEE 952, annex C)."""
_LEAST_CLUSTERS: Final = 9
"""Averaging times are at most a ninth of the record, where one sigma is a third (IEEE 952)."""

_LEAST_SAMPLES: Final = 100
"""A choice: four octaves of averaging times (1, 2, 4, 8) below a ninth of them."""
_SEEN_SIGMA: Final = 2.0  # A choice: 95 % that a coefficient is not zero
_CONFIDENCE: Final = 0.68
"""One sigma of Gauss, as Allan deviations are usually given (NIST SP 1065)."""
_OCTAVES_SHARE: Final = 2.0
"""VehicleAdoption an octave apart share half of their differences: half as many count."""


@dataclass(frozen=True, slots=True)
class AllanDeviation:
    """Overlapping Allan deviation of one axis, at averaging times `tau_s` [T] [s].

    `deviation` [T] in the output's unit, `low` and `high` [T] its 68 % confidence, `freedom` [T]
    its degrees of freedom.
    """

    tau_s: Floats
    deviation: Floats
    low: Floats
    high: Floats
    freedom: Floats


@dataclass(frozen=True, slots=True)
class NoiseCoefficients:
    """What a fit of the four slopes finds for one axis, each with 1-sigma.

    `random_walk` N [unit/sqrt(Hz)] (rad/sqrt(s) for gyros: ARW; m/s/sqrt(s): VRW),
    `bias_instability` B [unit], `rate_random_walk` K [unit/s/sqrt(Hz)], `quantisation` Q [unit s].
    """

    random_walk: float
    bias_instability: float
    rate_random_walk: float
    quantisation: float
    random_walk_sigma: float
    bias_instability_sigma: float
    rate_random_walk_sigma: float
    quantisation_sigma: float

    def is_seen(self, name: str) -> bool:
        """Whether a coefficient stands out of its own uncertainty by two sigmas."""
        value, sigma = getattr(self, name), getattr(self, f"{name}_sigma")
        return bool(value > _SEEN_SIGMA * sigma)


def averaging_factors(count: int, per_octave: int = 1) -> Integers:
    """Return the averaging factors m [T] for `count` samples, evenly spaced in octaves."""
    largest = count // _LEAST_CLUSTERS
    if largest < 1:
        return np.zeros(0, np.int64)
    octaves = np.arange(0.0, math.log2(largest) + 1e-9, 1.0 / per_octave)
    factors: Integers = np.unique(np.round(2.0**octaves).astype(np.int64))
    return factors


def overlapping_deviation(
    values: Floats, interval_s: float, factors: Integers | None = None
) -> AllanDeviation:
    """Return the overlapping Allan deviation of `values` [N], evenly spaced by `interval_s` [s].

    With x the running sum: sigma^2 = sum (x[k+2m] - 2 x[k+m] + x[k])^2 / (2 (m dt)^2 (N - 2m + 1)).
    CalibrationError for fewer than 100 samples.
    """
    count = len(values)
    if count < _LEAST_SAMPLES:
        raise CalibrationError(
            f"{count} samples at rest are too few for an Allan deviation: leave the unit still for "
            "ten minutes or longer"
        )
    chosen = averaging_factors(count, 4) if factors is None else factors
    # The mean has no part in second differences, but costs the sum its last digits.
    x = np.concatenate([[0.0], np.cumsum(values - np.mean(values))])
    variance = np.empty(len(chosen))
    for k, m in enumerate(chosen.tolist()):
        second = x[2 * m :] - 2.0 * x[m:-m] + x[: -2 * m]
        variance[k] = np.mean(second**2) / (2.0 * m * m)
    freedom = degrees_of_freedom(count + 1, chosen)
    tail = 0.5 * (1.0 - _CONFIDENCE)
    return AllanDeviation(
        tau_s=chosen.astype(np.float64) * interval_s,
        deviation=np.sqrt(variance),
        low=np.sqrt(variance * freedom / chi2.ppf(1.0 - tail, freedom)),
        high=np.sqrt(variance * freedom / chi2.ppf(tail, freedom)),
        freedom=freedom,
    )


def degrees_of_freedom(points: int, factors: Integers) -> Floats:
    """Return the degrees of freedom [T] of estimates from `points` of the summed output.

    The least of those for white, flicker and random-walk noise of the output (frequency, in the
    words of NIST SP 1065, table 5), so the confidence is never too narrow.
    """
    n, m = float(points), factors.astype(np.float64)
    white = (3.0 * (n - 1.0) / (2.0 * m) - 2.0 * (n - 2.0) / n) * 4.0 * m**2 / (4.0 * m**2 + 5.0)
    flicker = np.where(
        factors == 1, 2.0 * (n - 2.0) ** 2 / (2.3 * n - 4.9), 5.0 * n**2 / (4.0 * m * (n + 3.0 * m))
    )
    walk = (n - 2.0) / m * ((n - 1.0) ** 2 - 3.0 * m * (n - 1.0) + 4.0 * m**2) / (n - 3.0) ** 2
    freedom: Floats = np.maximum(np.minimum(np.minimum(white, flicker), walk), 1.0)
    return freedom


def fit_coefficients(values: Floats, interval_s: float) -> NoiseCoefficients:
    """Return N, B, K and Q of `values` [N] from octave-spaced overlapping Allan variances.

    Non-negative least squares of the squares, each variance weighted by its own uncertainty
    sigma^2 sqrt(2 / freedom), and by another sqrt(2) since estimates an octave apart share half of
    their differences.
    """
    curve = overlapping_deviation(values, interval_s, averaging_factors(len(values)))
    tau, variance = curve.tau_s, curve.deviation**2
    model = np.stack([1.0 / tau, np.full(len(tau), _FLOOR**2), tau / 3.0, 3.0 / tau**2], axis=1)
    spread = variance * np.sqrt(2.0 / curve.freedom)
    if not (spread > 0.0).all():
        return NoiseCoefficients(*([0.0] * 8))
    squares, _ = nnls(model / spread[:, None], variance / spread)
    # A second round weights by the fitted curve, for a low estimate must not weigh more.
    spread = (model @ squares) * np.sqrt(_OCTAVES_SHARE * 2.0 / curve.freedom)
    squares, sigmas = _seen(model / spread[:, None], variance / spread)
    found = [_root_and_sigma(*pair) for pair in zip(squares.tolist(), sigmas.tolist(), strict=True)]
    (n, n_sigma), (b, b_sigma), (k, k_sigma), (q, q_sigma) = found
    return NoiseCoefficients(n, b, k, q, n_sigma, b_sigma, k_sigma, q_sigma)


def _seen(weighted: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """Return the squares [4] and their 1-sigma, of the terms that stand out of their own sigma.

    A term that does not is left out and the others are fitted anew: it would only take away from
    them, for none of them can be negative. Its sigma is then that of having it alone in addition.
    """
    lengths = np.linalg.norm(weighted, axis=0)
    free = np.ones(weighted.shape[1], np.bool_)
    while True:
        squares, sigmas = np.zeros(len(free)), 1.0 / lengths
        squares[free], _ = nnls(weighted[:, free], variance)
        part = weighted[:, free] / lengths[free]
        sigmas[free] = np.sqrt(np.diag(np.linalg.pinv(part.T @ part))) / lengths[free]
        score = np.where(free, squares / sigmas, np.inf)
        weakest = int(np.argmin(score))
        if score[weakest] >= _SEEN_SIGMA or free.sum() == 1:
            return squares, sigmas
        free[weakest] = False


def _root_and_sigma(square: float, sigma: float) -> tuple[float, float]:
    """Return the coefficient of a square and its 1-sigma: sigma / 2c, but of zero its root."""
    root = math.sqrt(square)
    return root, sigma / (2.0 * root) if square > 0.0 else math.sqrt(sigma)


def random_walk_at(curve: AllanDeviation, tau_s: float = 1.0) -> float:
    """Return N as it is read off a data sheet's curve: the deviation at `tau_s`, times its root."""
    near = int(np.argmin(np.abs(np.log(curve.tau_s / tau_s))))
    return float(curve.deviation[near] * math.sqrt(curve.tau_s[near]))
