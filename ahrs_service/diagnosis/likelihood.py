"""The likelihood of a misfit: generalised least squares with a fitted noise."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import minimize

from ahrs_service.diagnosis.residual import Noise, Residual
from ahrs_service.records import Floats

_RIDGE: Final = 1e-10
_NO_ENERGY: Final = 1e-200


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
    _, log_det = np.linalg.slogdet(scaled)
    return (
        np.asarray(inverse @ target),
        np.asarray(inverse),
        float(log_det - 2.0 * np.log(scale[lives]).sum()),
    )


def fit(residual: Residual, noise: Noise, regressors: Floats, target: Floats) -> Fit:
    """Fit `regressors` [N, 6, K] to `target` [N, 6] under `noise`."""
    rows = np.concatenate([regressors, target[:, :, None]], axis=2)
    white, log_det = residual.whiten(noise, rows)
    white = white.reshape(-1, rows.shape[2])
    gram = white.T @ white
    coefficients, covariance, gram_log_det = solve(gram[:-1, :-1], gram[:-1, -1])
    misfit = gram[-1, -1] - coefficients @ gram[:-1, -1]
    log_likelihood = -0.5 * float(misfit + log_det)
    return Fit(noise, coefficients, covariance, log_likelihood, log_likelihood - 0.5 * gram_log_det)


def prior(noise: Noise, centre: Noise) -> float:
    """Return the log of a weak prior: every parameter within a factor e^2 of its first guess."""
    return float(-0.5 * np.sum(((noise - centre) / 2.0) ** 2))


def fit_noise(
    residual: Residual, regressors: Floats, target: Floats, start: Noise, turns: int = 60
) -> Noise:
    """Return the noise of highest restricted likelihood with `regressors` [N, 6, K] in the model.

    Quasi-Newton on the logarithms of the parameters (L-BFGS-B), to 0.01 nats; a restricted
    likelihood does not take the regressors' freedom for a smaller noise (Harville 1977).
    """
    centre = residual.first_noise()

    def cost(noise: Noise) -> float:
        return -fit(residual, noise, regressors, target).restricted - prior(noise, centre)

    done = minimize(
        cost,
        start,
        method="L-BFGS-B",
        bounds=residual.noise_bounds(),
        options={"maxiter": turns, "ftol": 1e-7, "gtol": 0.3, "eps": 1e-3},
    )
    return np.asarray(done.x)
