"""Least squares with their diagnostics: covariance, condition, convergence."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats

_STEPS: Final = 60  # A choice: a bound; _TOLERANCE ends a fit that settles before it
_HALVINGS: Final = 12  # A choice: steps down to 2^-12 = 2e-4 of Gauss-Newton's are tried
_TOLERANCE: Final = 1e-10
"""A choice: of the parameters' rms; rounding leaves 1e-12 at a condition of 100."""
_LARGEST_CONDITION: Final = 1e6
"""Squared in the normal equations it leaves four of a double's sixteen digits."""


@dataclass(frozen=True, slots=True)
class Fit:
    """Parameters [P] with covariance [P, P]; `sigma` 1-sigma of the residuals [M].

    The covariance is s^2 (J^T J)^-1 with s^2 = sum r^2 / (M - P), infinite where the data do not
    determine the parameters; `condition` is that of J with its columns scaled to length 1.
    """

    parameters: Floats
    covariance: Floats
    residuals: Floats
    sigma: float
    condition: float

    @property
    def standard_errors(self) -> Floats:
        """1-sigma of each parameter [P]."""
        return np.sqrt(np.diag(self.covariance))


def linear_fit(design: Floats, observed: Floats) -> Fit:
    """Return the least-squares solution p of design [M, P] p = observed [M]."""
    parameters = _solved(design, observed)
    return _fit(parameters, design @ parameters - observed, design)


def gauss_newton(evaluate: Callable[[Floats], tuple[Floats, Floats]], start: Floats) -> Fit:
    """Return the p [P] that makes the residuals smallest, by Gauss-Newton with step halving.

    `evaluate(p)` returns residuals [M] and their Jacobian [M, P]; `start` is near the solution.
    CalibrationError where it does not converge (Nocedal & Wright, sec. 10.3).
    """
    parameters = np.array(start, np.float64)
    residuals, jacobian = evaluate(parameters)
    for _ in range(_STEPS):
        step = _solved(jacobian, -residuals)
        share, cost = 1.0, residuals @ residuals
        for _ in range(_HALVINGS):
            there, slopes = evaluate(parameters + share * step)
            if there @ there <= cost:
                break
            share *= 0.5
        else:
            # No shorter step helps: this is the bottom to rounding, or nothing is.
            return _fit(parameters, residuals, jacobian)
        parameters = parameters + share * step
        residuals, jacobian = there, slopes
        scale = np.sqrt(np.mean(parameters**2)) or 1.0
        if np.abs(share * step).max() <= _TOLERANCE * scale:
            return _fit(parameters, residuals, jacobian)
    raise CalibrationError(
        "the fit does not settle: the poses or turns contradict each other; record them again, "
        "each held still on something solid"
    )


def _normal(design: Floats) -> tuple[Floats, Floats]:
    """Return the normal matrix [P, P] of a design with columns of length 1, and their lengths."""
    lengths = np.linalg.norm(design, axis=0)
    lengths[lengths == 0.0] = 1.0
    scaled = design / lengths
    return scaled.T @ scaled, lengths


def _solved(design: Floats, observed: Floats) -> Floats:
    """Return the least-squares solution by the normal equations of scaled columns.

    Long recordings have few parameters: a decomposition of all their rows would cost ten times as
    much. Directions that the data do not determine stay at zero.
    """
    normal, lengths = _normal(design)
    right = design.T @ observed / lengths
    solution = np.linalg.lstsq(normal, right, rcond=1.0 / _LARGEST_CONDITION**2)[0]
    # One step of refinement takes out what the squared condition costs in digits.
    right = design.T @ (observed - design @ (solution / lengths)) / lengths
    solution = solution + np.linalg.lstsq(normal, right, rcond=1.0 / _LARGEST_CONDITION**2)[0]
    return np.asarray(solution / lengths, np.float64)


def _fit(parameters: Floats, residuals: Floats, jacobian: Floats) -> Fit:
    rows, columns = jacobian.shape
    covariance: Floats = np.full((columns, columns), np.inf)
    spare = rows - columns
    sigma = float(np.sqrt(residuals @ residuals / spare)) if spare > 0 else np.inf
    normal, lengths = _normal(jacobian)
    values = np.linalg.eigvalsh(normal)
    condition = float(np.sqrt(values[-1] / values[0])) if values[0] > 0.0 else np.inf
    if condition > _LARGEST_CONDITION:
        return Fit(parameters, covariance, residuals, sigma, np.inf)
    if np.isfinite(sigma):
        covariance = sigma**2 * np.linalg.inv(normal) / np.outer(lengths, lengths)
    return Fit(parameters, covariance, residuals, sigma, condition)
