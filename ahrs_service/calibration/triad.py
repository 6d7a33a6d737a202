"""A fitted triad: matrix and bias of N = K A + B with covariance, however they were found."""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from ahrs_service.calibration.columns import AXES
from ahrs_service.calibration.least_squares import Fit, linear_fit
from ahrs_service.calibration.verdict import Vector
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats

LARGEST_DEVIATION: Final = 0.3
"""No matrix of a sound sensor in SI units is further from the identity than this, per element."""

NAMES: Final = (
    *(f"matrix {row}{column}" for row in AXES for column in AXES),
    *(f"bias {axis}" for axis in AXES),
)
"""The parameters in the order of the covariance: K by rows, then B."""


@dataclass(frozen=True, slots=True)
class TriadFit:
    """K [3, 3], B [3] of N = K A + B and their covariance [12, 12] (`NAMES`), Liu et al., eq. (1).

    `sigma` is the 1-sigma of the residual per value, `condition` that of the scaled Jacobian.
    """

    matrix: Floats
    bias: Floats
    covariance: Floats
    sigma: float
    condition: float
    residuals: Floats = field(default_factory=lambda: np.zeros(0))

    def compensate(self, output: Floats) -> Floats:
        """Return the inputs A = K^-1 (N - B) [N, 3] of the outputs [N, 3]."""
        return (output - self.bias) @ np.linalg.inv(self.matrix).T

    def standard_errors(self) -> dict[str, float]:
        """1-sigma by name; what was not fitted (variance 0) is left out."""
        errors = np.sqrt(np.diag(self.covariance)).tolist()
        return {name: error for name, error in zip(NAMES, errors, strict=True) if error > 0.0}


def ideal() -> TriadFit:
    """Return the triad whose output is its input."""
    return TriadFit(np.eye(3), np.zeros(3), np.zeros((12, 12)), 0.0, 1.0)


def fit_triad(design: Floats, output: Floats) -> TriadFit:
    """Return K and B of output [M, 3] = design [M, 4] [K B]^T by least squares, all axes alike.

    The design holds the inputs along x, y, z and what multiplies the bias (1, or a time).
    """
    fit = linear_fit(_for_each_axis(design), output.T.ravel())
    rows = fit.parameters.reshape(3, 4)
    order = [*(4 * row + column for row in range(3) for column in range(3)), 3, 7, 11]
    return TriadFit(
        matrix=rows[:, :3],
        bias=rows[:, 3],
        covariance=fit.covariance[np.ix_(order, order)],
        sigma=fit.sigma,
        condition=fit.condition,
        residuals=fit.residuals.reshape(3, -1).T,
    )


def fit_matrix(inputs: Floats, outputs: Floats) -> Fit:
    """Return the fit of outputs [M, 3] = inputs [M, 3] K^T; parameters are K by rows [9]."""
    return linear_fit(_for_each_axis(inputs), outputs.T.ravel())


def _for_each_axis(design: Floats) -> Floats:
    return np.asarray(np.kron(np.eye(3), design), np.float64)


def with_rest_bias(fit: Fit, matrix: Floats, bias: Floats, variance: Floats) -> TriadFit:
    """Return the triad of a `fit` of K alone, given the bias at rest [3] and its variance [3]."""
    covariance = np.zeros((12, 12))
    covariance[:9, :9] = fit.covariance
    covariance[9:, 9:] = np.diag(variance)
    return TriadFit(matrix, bias, covariance, fit.sigma, fit.condition, fit.residuals)


def from_inverse(
    inverse: Floats, bias: Floats, covariance: Floats, sigma: float, condition: float
) -> TriadFit:
    """Return the fit of A = C (N - B), given the covariance [12, 12] of C by rows and B.

    K = C^-1 and dK = -K dC K, so vec(dK) = -(K kron K^T) vec(dC) for rows.
    """
    matrix = np.asarray(np.linalg.inv(inverse), np.float64)
    turn = np.eye(12)
    turn[:9, :9] = -np.kron(matrix, matrix.T)
    with np.errstate(invalid="ignore"):
        turned = turn @ covariance @ turn.T
    if not np.isfinite(covariance).all():
        turned = np.full((12, 12), np.inf)
    return TriadFit(matrix, bias, turned, sigma, condition)


def check_matrix(name: str, fit: TriadFit, what_to_do: str) -> None:
    """Raise CalibrationError where K is no matrix of a sound sensor: axes are mixed up."""
    deviation = np.abs(fit.matrix - np.eye(3))
    if np.isfinite(fit.matrix).all() and deviation.max() < LARGEST_DEVIATION:
        return
    row, column = np.unravel_index(int(np.argmax(deviation)), (3, 3))
    raise CalibrationError(
        f"{name}: the fit asks for {fit.matrix[row, column]:.2f} where the input along "
        f"{AXES[column]} meets the output of {AXES[row]}: {what_to_do}"
    )


def check_sigma(name: str, fit: TriadFit, largest: float, unit: str) -> None:
    """Raise CalibrationError where the fit leaves a residual [unit] larger than `largest`."""
    if math.isfinite(fit.sigma) and fit.sigma > largest:
        raise CalibrationError(
            f"{name}: the best fit still leaves {fit.sigma:.2g} {unit} where a sound sensor held "
            "still leaves a tenth of it: is an axis dead, or was the unit moving? record again"
        )


def vector(values: Floats) -> Vector:
    """Return three numbers as the records hold them."""
    x, y, z = values.tolist()
    return x, y, z


def rms(values: Floats) -> Vector:
    """Return the RMS per axis of errors [N, 3]."""
    return vector(np.sqrt(np.mean(values**2, axis=0)))
