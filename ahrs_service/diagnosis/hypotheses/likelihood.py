"""The likelihood of a misfit: generalised least squares with fitted noise parameters."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.diagnosis.input.misfit import Noise, Residual
from ahrs_service.records import Floats

_RIDGE: Final = 1e-10
"""A choice: added to a diagonal of ones: a million times rounding, negligible as information."""
_NO_ENERGY: Final = 1e-200  # A choice: only columns of zeros or underflow are below it
_PROBE: Final = 1e-3
"""A choice: step [log] of one-sided differences, whose relative error is half of it."""
_PRIOR_SIGMA: Final = 2.0
"""A choice: a first guess is right to a factor of e^2 = 7. Not flat: at 1 one of four blind
recordings (see forward_search._CLOSE) loses a second name, a wrong one; above 2 not searched."""
_SETTLED_NATS: Final = 0.02  # A choice: a last step worth 1/400 of ALARM
_LONGEST_STEP: Final = 1.5
"""A choice: a noise parameter changes by at most a factor of 4.5 (e^1.5) in one step."""
_DAMPINGS: Final = 6
"""A choice: six, from _FIRST_DAMPING on, reach 780 times the information (0.1 * 6^5)."""
_FIRST_DAMPING: Final = 0.1  # A choice: share of the information's diagonal, after an overshoot


@dataclass(frozen=True, slots=True)
class Fit:
    """Regressors fitted to a misfit under one noise.

    `coefficients` [K], `covariance` [K, K]; `log_likelihood` at its maximum over them, and
    `restricted` the likelihood with them integrated out (REML), both without constants.
    """

    noise: Noise
    coefficients: Floats
    covariance: Floats
    log_likelihood: float
    restricted: float


def solve(gram: Floats, target: Floats) -> tuple[Floats, Floats, float]:
    """Return the solution of gram x = target, the inverse, and log det; scaled and regularised.

    Columns without energy are left out: zero in the solution and in the inverse.
    """
    energy = np.diag(gram)
    lives = energy > _NO_ENERGY
    scale = np.where(lives, 1.0 / np.sqrt(np.where(lives, energy, 1.0)), 0.0)
    scaled = gram * scale[:, None] * scale[None, :]
    scaled[np.diag_indices_from(scaled)] = np.where(lives, 1.0 + _RIDGE, 1.0)
    inverse = np.asarray(np.linalg.inv(scaled), np.float64) * scale[:, None] * scale[None, :]
    # Too long a step gives NaN; a likelihood of NaN compares as higher than no other.
    with np.errstate(invalid="ignore"):
        _, log_det = np.linalg.slogdet(scaled)
    return (
        np.asarray(inverse @ target),
        np.asarray(inverse),
        float(log_det - 2.0 * np.log(scale[lives]).sum()),
    )


def fit(residual: Residual, noise: Noise, regressors: Floats, target: Floats, prior: Floats) -> Fit:
    """Fit `regressors` [N, 6, K] to `target` [N, 6] under `noise`.

    `prior` [K+1, K+1] is the prior information, as a Gram matrix of rows (coefficient, target).
    """
    rows = np.concatenate([regressors, target[:, :, None]], axis=2)
    gram, log_det = residual.grams(rows)(noise)
    return _solved(noise, gram + prior, log_det)


def _solved(noise: Noise, gram: Floats, log_det: float) -> Fit:
    coefficients, covariance, gram_log_det = solve(gram[:-1, :-1], gram[:-1, -1])
    misfit = gram[-1, -1] - coefficients @ gram[:-1, -1]
    log_likelihood = -0.5 * float(misfit + log_det)
    return Fit(noise, coefficients, covariance, log_likelihood, log_likelihood - 0.5 * gram_log_det)


class Posterior:
    """Posterior of the noise parameters: restricted likelihood and prior, slope, information."""

    def __init__(self, residual: Residual, rows: Floats, prior: Floats) -> None:
        self._residual, self._rows = residual, np.ascontiguousarray(rows)
        self._prior = prior
        self._centre = residual.first_noise()

    def cost(self, noise: Noise) -> tuple[float, Fit, Floats, Floats]:
        """Return minus the log posterior, the fit, whitened rows, log variances."""
        white, log_variance = self._residual.whiten(noise, self._rows)
        flat = white.reshape(-1, white.shape[2])
        found = _solved(noise, flat.T @ flat + self._prior, float(log_variance.sum()))
        apart = (noise - self._centre) / _PRIOR_SIGMA
        return 0.5 * float(apart @ apart) - found.restricted, found, flat, log_variance.ravel()

    def slope(self, noise: Noise) -> tuple[float, Floats, Floats]:
        """Return cost, gradient and information (Harvey 1989, eq. (3.4.69)) by differences."""
        here, found, white, log_variance = self.cost(noise)
        weights = np.append(-found.coefficients, 1.0)
        left = white @ weights
        gradient, moves, spreads = np.empty(len(noise)), [], []
        for n in range(len(noise)):
            moved = noise.copy()
            moved[n] += _PROBE
            there, _, moved_white, moved_variance = self.cost(moved)
            gradient[n] = (there - here) / _PROBE
            spreads.append((moved_variance - log_variance) / _PROBE)
            moves.append((moved_white @ weights - left) / _PROBE + 0.5 * left * spreads[-1])
        move, spread = np.array(moves), np.array(spreads)
        # Observed rather than expected information where the misfit exceeds the noise.
        weighted = spread * np.maximum(np.abs(left), 1.0)
        information = move @ move.T + 0.5 * weighted @ weighted.T
        information[np.diag_indices_from(information)] += _PRIOR_SIGMA**-2
        return here, gradient, information


def fit_noise(
    residual: Residual,
    regressors: Floats,
    target: Floats,
    prior: Floats,
    start: Noise,
    iterations: int = 25,
) -> Noise:
    """Return the noise of highest restricted likelihood with `regressors` [N, 6, K] in the model.

    Fisher scoring, damped where it overshoots (Levenberg-Marquardt), on the logarithms of the
    parameters, under a weak prior: each within a factor of e^2 of its first guess. The restricted
    likelihood accounts for the regressors' degrees of freedom, which otherwise bias the noise low
    (Harville 1977).
    """
    score = Posterior(residual, np.concatenate([regressors, target[:, :, None]], axis=2), prior)
    low, high = np.array(residual.noise_bounds()).T
    noise = np.clip(start, low, high)
    damping = 0.0
    for _ in range(iterations):
        here, gradient, information = score.slope(noise)
        free = ~(((noise <= low) & (gradient > 0.0)) | ((noise >= high) & (gradient < 0.0)))
        scale = np.diag(np.diag(information)[free])
        for _ in range(_DAMPINGS):
            step = np.zeros(len(noise))
            damped = information[np.ix_(free, free)] + damping * scale
            step[free] = -np.linalg.solve(damped, gradient[free])
            moved = np.clip(noise + np.clip(step, -_LONGEST_STEP, _LONGEST_STEP), low, high)
            gain = here - score.cost(moved)[0]
            if gain > 0.0:
                break
            damping = max(_FIRST_DAMPING, 6.0 * damping)
        else:
            break
        noise, damping = moved, 0.2 * damping
        if gain < _SETTLED_NATS:
            break
    return noise
