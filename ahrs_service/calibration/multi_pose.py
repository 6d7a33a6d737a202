"""Accelerometer from any twelve or more still poses, without a table.

Wherever the unit lies, the compensated force has the length of gravity. Gauss-Newton on that length
gives A = C (N - B); a length cannot observe a rotation of C, so C is chosen symmetric, the
smallest change (Tedaldi et al., ICRA 2014, fix the axes in another way).
The gyros: calibration.pose_rotations.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from ahrs_service.calibration.columns import check_force_unit
from ahrs_service.calibration.least_squares import gauss_newton
from ahrs_service.calibration.poses import directions, groups_of, span_of, sphere_coverage
from ahrs_service.calibration.triad import TriadFit, check_matrix, check_sigma, from_inverse, vector
from ahrs_service.calibration.verdict import TriadVerdict, Vector
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats, Integers, Rows

LEAST_POSES: Final = 12
"""Different directions asked for: nine unknowns, and a few that can contradict."""

LARGEST_SIGMA_M_S2: Final = 0.3
"""Residual of 3 % of gravity: sensors without any calibration are as good."""

FOLDS: Final = 6
"""Parts of which one is held out in turn."""

_PAIRS: Final = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Elements (row, column) of a symmetric matrix by its six parameters."""


def fit_accelerometer(poses: Rows, gravity_m_s2: float = STANDARD_GRAVITY_M_S2) -> TriadFit:
    """Return K and B of the accelerometer from poses [K] POSE_DTYPE in 12 directions or more.

    CalibrationError for too few of them, and for data in another unit.
    """
    force = poses["accel_m_s2"]
    check_force_unit(force)
    count = int(groups_of(directions(force)).max(initial=-1)) + 1
    if count < LEAST_POSES:
        directions_seen = f"{count} different direction{'s' * (count != 1)}"
        raise CalibrationError(
            f"{len(poses)} still poses in {directions_seen}: take {LEAST_POSES} or "
            "more, each 10 degrees from the others and held still for two seconds on something "
            "solid; tilt the unit against a book for those between the faces"
        )
    fit = _fit_norm(force, gravity_m_s2)
    check_matrix("accelerometer", fit, "is an axis swapped or dead? check the sensor")
    check_sigma("accelerometer", fit, LARGEST_SIGMA_M_S2, "m/s^2")
    return fit


def _fit_norm(force: Floats, gravity_m_s2: float) -> TriadFit:
    start = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    fit = gauss_newton(norm_residuals(force, gravity_m_s2), start)
    spread = _spread()
    covariance = np.full((12, 12), np.inf)
    if np.isfinite(fit.covariance).all():
        covariance = spread @ fit.covariance @ spread.T
    inverse = (spread @ fit.parameters)[:9].reshape(3, 3)
    return from_inverse(inverse, fit.parameters[6:], covariance, fit.sigma, fit.condition)


def norm_residuals(force: Floats, gravity_m_s2: float) -> Callable[[Floats], tuple[Floats, Floats]]:
    """Return the function from p [9] to abs(C (N - B)) - g [K] and its Jacobian [K, 9].

    p holds C xx, yy, zz, xy, xz, yz and B x, y, z.
    """

    def evaluate(parameters: Floats) -> tuple[Floats, Floats]:
        inverse = (_spread()[:9, :6] @ parameters[:6]).reshape(3, 3)
        shifted = force - parameters[6:]
        inputs = shifted @ inverse.T
        length = np.linalg.norm(inputs, axis=1)
        unit = inputs / length[:, None]
        jacobian = np.empty((len(force), 9))
        for p, (j, k) in enumerate(_PAIRS):
            jacobian[:, p] = unit[:, j] * shifted[:, k]
            if j != k:
                jacobian[:, p] += unit[:, k] * shifted[:, j]
        jacobian[:, 6:] = -unit @ inverse
        return length - gravity_m_s2, jacobian

    return evaluate


def _spread() -> Floats:
    """Matrix [12, 9] from the parameters of the norm fit to C by rows and B."""
    spread = np.zeros((12, 9))
    for p, (j, k) in enumerate(_PAIRS):
        spread[3 * j + k, p] = spread[3 * k + j, p] = 1.0
    spread[9:, 6:] = np.eye(3)
    return spread


def judge_accelerometer(
    poses: Rows, fit: TriadFit, gravity_m_s2: float = STANDARD_GRAVITY_M_S2
) -> TriadVerdict:
    """Return the figures of the fit; directions are held out by sixths.

    The residual is one of length; it counts for an axis by the share that the axis has in gravity.
    """
    force = poses["accel_m_s2"]
    held_out = np.empty(len(force))
    for chosen in folds(groups_of(directions(force)), FOLDS):
        part = _fit_norm(force[~chosen], gravity_m_s2)
        held_out[chosen] = _excess(part.compensate(force[chosen]), gravity_m_s2)
    before, after = force, fit.compensate(force)
    return TriadVerdict(
        triad="accel",
        unit="m/s^2",
        count=len(force),
        rms_before=_rms_by_axis(before, gravity_m_s2),
        rms_after=_rms_by_axis(after, gravity_m_s2),
        span_degc=span_of(poses),
        coverage=sphere_coverage(directions(force)),
        condition=fit.condition,
        standard_errors=fit.standard_errors(),
        held_out_before=float(np.sqrt(np.mean(_excess(before, gravity_m_s2) ** 2))),
        held_out_after=float(np.sqrt(np.mean(held_out**2))),
    )


def _excess(force: Floats, gravity_m_s2: float) -> Floats:
    excess: Floats = np.linalg.norm(force, axis=1) - gravity_m_s2
    return excess


def _rms_by_axis(force: Floats, gravity_m_s2: float) -> Vector:
    squares = directions(force) ** 2
    weighted = (_excess(force, gravity_m_s2) ** 2) @ squares
    return vector(np.sqrt(weighted / squares.sum(axis=0)))


def folds(groups: Integers, count: int) -> list[np.ndarray]:
    """Return masks [K] of `count` parts or fewer that keep each group of poses together."""
    parts = groups % min(count, int(groups.max(initial=0)) + 1)
    return [parts == part for part in np.unique(parts)]
