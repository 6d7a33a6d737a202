"""Both triads from any twelve or more still poses, without a table.

Accelerometer: wherever the unit lies, the compensated force has the length of gravity. Gauss-Newton
on that length gives A = C (N - B); a length cannot see a turn of all axes, so C is the symmetric
one, the smallest change. Gyros: from one pose to the next they must turn the direction of
gravity as the calibrated accelerometers see it turned, which gives all nine elements of their
matrix in the accelerometers' axes; the bias is their mean at rest (Tedaldi, Pretto, Menegatti, "A
robust and easy to implement method for IMU calibration without external equipments", ICRA 2014).
"""

import itertools
import math
from collections.abc import Callable
from typing import Final

import numpy as np

from ahrs_service.calibration.columns import AXES, ImuColumns, check_force_unit
from ahrs_service.calibration.errors import CalibrationError
from ahrs_service.calibration.least_squares import Fit, gauss_newton
from ahrs_service.calibration.poses import (
    directions,
    groups_of,
    rest_bias,
    span_of,
    sphere_coverage,
)
from ahrs_service.calibration.triad import TriadFit, check_matrix, check_sigma, from_inverse, vector
from ahrs_service.calibration.turning import turn_and_leverage
from ahrs_service.calibration.verdict import TriadVerdict, Vector
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.records import Floats, Integers, Rows

LEAST_POSES: Final = 12
"""Different directions asked for: nine unknowns, and a few that can contradict."""

LARGEST_SIGMA_M_S2: Final = 0.3
"""Residual of 3 % of gravity: sensors without any calibration are as good."""

_FOLDS: Final = 6
_PAIRS: Final = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_LEAST_TURN_RAD: Final = math.radians(20.0)
_GAP: Final = 5.0
_LEAST_TURNS: Final = 6
_IDENTITY: Final[Floats] = np.eye(3).ravel()


def fit_accelerometer(poses: Rows, gravity_m_s2: float = STANDARD_GRAVITY_M_S2) -> TriadFit:
    """Return K and B of the accelerometer from poses [K] POSE_DTYPE in 12 directions or more.

    CalibrationError for too few of them, and for data in another unit.
    """
    force = poses["accel_m_s2"]
    check_force_unit(force)
    count = int(groups_of(directions(force)).max(initial=-1)) + 1
    if count < LEAST_POSES:
        raise CalibrationError(
            f"{len(poses)} still poses in {count} different directions: take {LEAST_POSES} or "
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
    for chosen in folds(groups_of(directions(force)), _FOLDS):
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


# -- gyros ----------------------------------------------------------------------------------------


def turns_between(columns: ImuColumns, poses: Rows) -> list[tuple[int, int, int]]:
    """Return (pose before, first sample, sample after the last) for each usable turn.

    From the middle of one pose to that of the next, where gravity turned by 20 deg or more
    and no sample is missing on the way.
    """
    up = directions(poses["accel_m_s2"])
    turns = []
    for k in range(len(poses) - 1):
        first, last = int(poses["last"][k]) - 1, int(poses["first"][k + 1]) + 1
        angle = math.acos(float(np.clip(up[k] @ up[k + 1], -1.0, 1.0)))
        longest = float(np.diff(columns.time_s[first:last]).max())
        if angle >= _LEAST_TURN_RAD and longest < _GAP * columns.interval_s:
            turns.append((k, first, last))
    return turns


def fit_gyro(columns: ImuColumns, poses: Rows, accel: TriadFit) -> TriadFit:
    """Return K and B of the gyros from the turns between the poses.

    `accel` is the accelerometers' fit, whose axes become the gyros'. CalibrationError for too
    few turns or gyro axes that are not the accelerometers'.
    """
    turns = turns_between(columns, poses)
    if len(turns) < _LEAST_TURNS:
        raise CalibrationError(
            f"{len(turns)} turns of 20 degrees or more between still poses: the gyros need "
            f"{_LEAST_TURNS} or more, without a gap in the recording; turn the unit further from "
            "pose to pose, about all its axes"
        )
    bias, variance = rest_bias(poses)
    up = directions(accel.compensate(poses["accel_m_s2"]))
    _check_axes(turn_residuals(columns, turns, up, bias))
    fit = _fit_turns(columns, turns, up, bias)
    covariance = np.zeros((12, 12))
    covariance[:9, :9] = fit.covariance
    covariance[9:, 9:] = np.diag(variance)
    inverse = fit.parameters.reshape(3, 3)
    gyro = from_inverse(inverse, bias, covariance, fit.sigma, fit.condition)
    check_matrix(
        "gyro",
        gyro,
        "are the poses held still, and the gyros in their range?",
    )
    return gyro


def _check_axes(evaluate: Callable[[Floats], tuple[Floats, Floats]]) -> None:
    """Raise CalibrationError where gyro axes in another order or sign explain the turns better."""
    costs = {}
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            inverse = np.array(signs)[:, None] * np.eye(3)[list(order)]
            costs[order, signs] = float(np.sum(evaluate(inverse.ravel())[0] ** 2))
    order, signs = min(costs, key=lambda key: costs[key])
    if costs[order, signs] < 0.5 * costs[(0, 1, 2), (1.0, 1.0, 1.0)]:
        seen = ", ".join(
            f"{'-' if sign < 0.0 else ''}{AXES[k]}" for k, sign in zip(order, signs, strict=True)
        )
        raise CalibrationError(
            f"gyro: its axes are not those of the accelerometer, whose x, y, z are {seen} of the "
            "gyro (swapped or mirrored): correct the orientation of the sensor and record again"
        )


def _fit_turns(
    columns: ImuColumns, turns: list[tuple[int, int, int]], up: Floats, bias: Floats
) -> Fit:
    return gauss_newton(turn_residuals(columns, turns, up, bias), _IDENTITY)


def turn_residuals(
    columns: ImuColumns, turns: list[tuple[int, int, int]], up: Floats, bias: Floats
) -> Callable[[Floats], tuple[Floats, Floats]]:
    """Return the function from C by rows [9] to the residuals [2 M] and their Jacobian [2 M, 9].

    Each turn R must take the direction up at its end to that at its beginning: the residual is
    R u1 - u0 along the two directions square to u0, and its change [G dC] x u0.
    """
    across = [_across(up[k]) for k, _, _ in turns]
    pieces = [
        (
            np.ascontiguousarray(columns.time_s[first:last]),
            np.ascontiguousarray(columns.gyro_rad_s[first:last]),
        )
        for _, first, last in turns
    ]

    def evaluate(parameters: Floats) -> tuple[Floats, Floats]:
        inverse = parameters.reshape(3, 3)
        residuals, jacobian = np.empty(2 * len(turns)), np.empty((2 * len(turns), 9))
        turn, leverage = np.empty((3, 3)), np.empty((3, 9))
        for m, (k, _, _) in enumerate(turns):
            turn_and_leverage(*pieces[m], inverse, bias, turn, leverage)
            place = slice(2 * m, 2 * m + 2)
            seen = turn @ up[k + 1]
            residuals[place] = across[m] @ (seen - up[k])
            jacobian[place] = across[m] @ np.cross(leverage.T, seen).T
        return residuals, jacobian

    return evaluate


def _across(up: Floats) -> Floats:
    """Two unit vectors [2, 3] square to `up` and to each other."""
    other = np.eye(3)[int(np.argmin(np.abs(up)))]
    first = np.cross(up, other)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(up, first)])


def judge_gyro(columns: ImuColumns, poses: Rows, accel: TriadFit, gyro: TriadFit) -> TriadVerdict:
    """Return the figures of the gyros' fit, as errors of the turns' directions [rad].

    Turns are held out by sixths; the bias is that of all poses, before and after, so that what is
    shown is the gain of the matrix.
    """
    turns = turns_between(columns, poses)
    up = directions(accel.compensate(poses["accel_m_s2"]))

    def errors(some: list[tuple[int, int, int]], parameters: Floats) -> Floats:
        return turn_residuals(columns, some, up, gyro.bias)(parameters)[0].reshape(-1, 2)

    held_out = np.empty((len(turns), 2))
    for chosen in folds(np.arange(len(turns)), _FOLDS):
        seen = [turn for turn, out in zip(turns, chosen, strict=True) if not out]
        rest = [turn for turn, out in zip(turns, chosen, strict=True) if out]
        held_out[chosen] = errors(rest, _fit_turns(columns, seen, up, gyro.bias).parameters)
    before = errors(turns, _IDENTITY)
    after = errors(turns, np.asarray(np.linalg.inv(gyro.matrix), np.float64).ravel())
    frames = np.stack([_across(up[k]) for k, _, _ in turns])
    return TriadVerdict(
        triad="gyro",
        unit="rad",
        count=len(turns),
        rms_before=_rms_in_body(before, frames),
        rms_after=_rms_in_body(after, frames),
        span_degc=span_of(poses),
        coverage=sphere_coverage(directions(poses["accel_m_s2"])),
        condition=gyro.condition,
        standard_errors=gyro.standard_errors(),
        held_out_before=float(np.sqrt(np.mean(before**2))),
        held_out_after=float(np.sqrt(np.mean(held_out**2))),
    )


def _rms_in_body(errors: Floats, frames: Floats) -> Vector:
    """RMS per body axis of errors [M, 2] along the directions `frames` [M, 2, 3]."""
    return vector(np.sqrt(np.mean(np.einsum("mi,mij->mj", errors, frames) ** 2, axis=0)))
