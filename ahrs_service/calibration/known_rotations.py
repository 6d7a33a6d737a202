"""Gyros from turns of known angle about the vertical, as on a table with an edge or a turntable.

Before and after such a turn the same face is up. The unit turns about one of its axes, which is
where the accelerometer sees up, so the summed output is K u theta + B T (S5 of the seed has known
rates in its place). Full circles need no protractor: an edge to come back to will do.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.calibration.columns import AXES, ImuColumns, flat_tops
from ahrs_service.calibration.poses import directions, rest_bias, span_of
from ahrs_service.calibration.triad import (
    TriadFit,
    check_matrix,
    fit_matrix,
    rms,
    with_rest_bias,
)
from ahrs_service.calibration.verdict import TriadVerdict
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats, Rows

_SAME_FACE_RAD: Final = math.radians(3.0)
"""A choice: a table off level by 1.5 deg shows as much after half a turn."""
_LEAST_RAD: Final = math.radians(45.0)
"""A choice: half of the quarter circle that a table's edges give; less is none on purpose."""
_LARGEST_MISS: Final = 0.1
"""A choice: data sheets allow a gyro 3 % of scale; 10 % off is another angle."""
_LEAST_ALONG: Final = 0.9  # A choice: the turn's axis lies within 26 deg (acos 0.9) of the vertical
_LEAST_ROTATIONS: Final = 4
"""One about each of three axes determines K, and one more can contradict."""


@dataclass(frozen=True, slots=True)
class Turns:
    """True and measured rotation vectors [M, 3] [rad], and why other turns were left out."""

    truth: Floats
    measured: Floats
    left_out: tuple[str, ...] = ()


def find_rotations(columns: ImuColumns, poses: Rows, accel: TriadFit, unit_deg: float) -> Turns:
    """Return the turns about the vertical between one pose and the next.

    The true angle is the multiple of `unit_deg` next to the measured one; a turn by another angle
    is left out. CalibrationError where the gyros measure another axis than the accelerometers.
    """
    bias, _ = rest_bias(poses)
    up = directions(accel.compensate(poses["accel_m_s2"]))
    clipped = np.any(flat_tops(columns.gyro_rad_s), axis=1)
    truth, measured, left_out = [], [], []
    for k in range(len(poses) - 1):
        if up[k] @ up[k + 1] < math.cos(_SAME_FACE_RAD):
            continue
        axis = directions(up[k : k + 1] + up[k + 1]).ravel()
        turned = _sum_up(columns, int(poses["last"][k]) - 1, int(poses["first"][k + 1]) + 1, bias)
        if np.linalg.norm(turned) < _LEAST_RAD:
            continue
        begin_s = float(poses["stop_s"][k])
        if clipped[poses["last"][k] : poses["first"][k + 1]].any():
            left_out.append(
                f"turn at {begin_s:.0f} s: the gyro ran into the end of its range, so it does not "
                "count: turn more slowly, or set the gyro to a wider range"
            )
            continue
        _check_axis(turned, axis, begin_s)
        angle = float(turned @ axis)
        turns = round(math.degrees(angle) / unit_deg)
        true = turns * math.radians(unit_deg)
        if turns == 0 or abs(angle / true - 1.0) > _LARGEST_MISS:
            left_out.append(
                f"turn at {begin_s:.0f} s: the gyro shows {math.degrees(angle):.0f} deg, which is "
                f"no multiple of {unit_deg:g} deg, so it does not count: turn back to the same "
                "edge exactly, or say by how much you turn with --turn"
            )
            continue
        truth.append(true * axis)
        measured.append(turned)
    return Turns(np.reshape(truth, (-1, 3)), np.reshape(measured, (-1, 3)), tuple(left_out))


def _sum_up(columns: ImuColumns, first: int, last: int, bias: Floats) -> Floats:
    """Integral [3] [rad] of the output less its bias over samples, by the trapezoid rule."""
    output = columns.gyro_rad_s[first:last] - bias
    steps = np.diff(columns.time_s[first:last])
    total: Floats = steps @ (0.5 * (output[1:] + output[:-1]))
    return total


def _check_axis(turned: Floats, axis: Floats, begin_s: float) -> None:
    if abs(float(turned @ axis)) < _LEAST_ALONG * float(np.linalg.norm(turned)):
        seen, real = AXES[int(np.argmax(np.abs(turned)))], AXES[int(np.argmax(np.abs(axis)))]
        raise CalibrationError(
            f"turn at {begin_s:.0f} s: {real} was vertical by the accelerometer, but the gyro "
            f"turned about {seen} most: an axis is swapped, or the unit was tilted on the way; "
            "turn it flat on the table"
        )


def fit_gyro(poses: Rows, turns: Turns) -> TriadFit:
    """Return K and B of the gyros from the turns of `find_rotations`; B is the mean at rest.

    CalibrationError where the turns are too few or not about three axes.
    """
    truth, measured = turns.truth, turns.measured
    if len(truth) < _LEAST_ROTATIONS or np.linalg.matrix_rank(truth, tol=_LEAST_RAD) < 3:
        raise CalibrationError(
            f"{len(truth)} turns about the vertical: the gyros need {_LEAST_ROTATIONS} or more, "
            "with each of the unit's three axes vertical in turn; lie the unit on a face, turn it "
            "a full circle and let it rest, on three faces, to the left and to the right"
        )
    bias, variance = rest_bias(poses)
    fit = fit_matrix(truth, measured)
    gyro = with_rest_bias(fit, fit.parameters.reshape(3, 3), bias, variance)
    check_matrix("gyro", gyro, "an axis is swapped or mirrored; check the unit's orientation")
    return gyro


def judge_gyro(poses: Rows, turns: Turns, fit: TriadFit) -> TriadVerdict:
    """Return the figures of the fit, in rad per turn; each turn is predicted by the others."""
    truth, measured = turns.truth, turns.measured
    held_out = np.empty_like(truth)
    for k in range(len(truth)):
        rest = np.arange(len(truth)) != k
        matrix = fit_matrix(truth[rest], measured[rest]).parameters.reshape(3, 3)
        held_out[k] = np.linalg.lstsq(matrix, measured[k], rcond=None)[0]
    after = measured @ np.linalg.inv(fit.matrix).T
    return TriadVerdict(
        triad="gyro",
        unit="rad",
        count=len(truth),
        rms_before=rms(measured - truth),
        rms_after=rms(after - truth),
        span_degc=span_of(poses),
        condition=fit.condition,
        standard_errors=fit.standard_errors(),
        held_out_before=float(np.sqrt(np.mean((measured - truth) ** 2))),
        held_out_after=float(np.sqrt(np.mean((held_out - truth) ** 2))),
    )
