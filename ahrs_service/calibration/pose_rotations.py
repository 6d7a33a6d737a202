"""Gyros from the turns between still poses, without a table: gravity is the reference.

From one pose to the next the summed rates must rotate the direction of gravity as the calibrated
accelerometers measure it. That gives all nine elements of the gyros' matrix in the
accelerometers' axes; the bias is their mean at rest (Tedaldi, Pretto, Menegatti, "A robust and easy
to implement method for IMU calibration without external equipments", ICRA 2014).
"""

import itertools
import math
from collections.abc import Callable
from typing import Final

import numpy as np

from ahrs_service.calibration.columns import AXES, ImuColumns, flat_tops
from ahrs_service.calibration.least_squares import Fit, gauss_newton
from ahrs_service.calibration.multi_pose import FOLDS, folds
from ahrs_service.calibration.poses import directions, rest_bias, span_of, sphere_coverage
from ahrs_service.calibration.rotating import rotation_and_leverage
from ahrs_service.calibration.triad import TriadFit, check_matrix, from_inverse, vector
from ahrs_service.calibration.verdict import TriadVerdict, Vector
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats, Rows

_LEAST_ROTATION_RAD: Final = math.radians(20.0)
"""A choice: 0.1 deg of error in a pose is then 0.5 % of the turn."""
_GAP: Final = 5.0
"""A choice: a step so many usual ones long is a gap, over which no turn is summed up."""
_LEAST_ROTATIONS: Final = 6
"""Two equations a turn: five determine nine numbers, and one more can contradict."""
_IDENTITY: Final[Floats] = np.eye(3).ravel()


def rotations_between(columns: ImuColumns, poses: Rows) -> list[tuple[int, int, int]]:
    """Return (pose before, first sample, sample after the last) for each usable turn.

    From the middle of one pose to that of the next, where gravity rotated by 20 deg or more, no
    sample is missing on the way, and the gyros are within their range.
    """
    clipped = np.any(flat_tops(columns.gyro_rad_s), axis=1)
    up = directions(poses["accel_m_s2"])
    turns = []
    for k in range(len(poses) - 1):
        first, last = int(poses["last"][k]) - 1, int(poses["first"][k + 1]) + 1
        angle = math.acos(float(np.clip(up[k] @ up[k + 1], -1.0, 1.0)))
        longest = float(np.diff(columns.time_s[first:last]).max())
        whole = longest < _GAP * columns.interval_s and not clipped[first:last].any()
        if angle >= _LEAST_ROTATION_RAD and whole:
            turns.append((k, first, last))
    return turns


def fit_gyro(columns: ImuColumns, poses: Rows, accel: TriadFit) -> TriadFit:
    """Return K and B of the gyros from the turns between the poses.

    `accel` is the accelerometers' fit, whose axes become the gyros'. CalibrationError for too
    few turns or gyro axes that are not the accelerometers'.
    """
    turns = rotations_between(columns, poses)
    if len(turns) < _LEAST_ROTATIONS:
        raise CalibrationError(
            f"{len(turns)} turns of 20 degrees or more between still poses: the gyros need "
            f"{_LEAST_ROTATIONS} or more, without a gap in the recording and within their range; "
            "turn the unit further from pose to pose, about all its axes, and not too fast"
        )
    bias, variance = rest_bias(poses)
    up = directions(accel.compensate(poses["accel_m_s2"]))
    _check_axes(rotation_residuals(columns, turns, up, bias))
    fit = _fit_rotations(columns, turns, up, bias)
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


def _fit_rotations(
    columns: ImuColumns, turns: list[tuple[int, int, int]], up: Floats, bias: Floats
) -> Fit:
    return gauss_newton(rotation_residuals(columns, turns, up, bias), _IDENTITY)


def rotation_residuals(
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
            rotation_and_leverage(*pieces[m], inverse, bias, turn, leverage)
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
    turns = rotations_between(columns, poses)
    up = directions(accel.compensate(poses["accel_m_s2"]))

    def errors(some: list[tuple[int, int, int]], parameters: Floats) -> Floats:
        return rotation_residuals(columns, some, up, gyro.bias)(parameters)[0].reshape(-1, 2)

    held_out = np.empty((len(turns), 2))
    for chosen in folds(np.arange(len(turns)), FOLDS):
        seen = [turn for turn, out in zip(turns, chosen, strict=True) if not out]
        rest = [turn for turn, out in zip(turns, chosen, strict=True) if out]
        held_out[chosen] = errors(rest, _fit_rotations(columns, seen, up, gyro.bias).parameters)
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
