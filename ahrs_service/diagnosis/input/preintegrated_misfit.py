"""The IMU preintegrated between references, minus the references' change, and the path between."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.interpolate import Akima1DInterpolator

from ahrs_service.diagnosis.input.diagnosis_input import Recorded, Series
from ahrs_service.diagnosis.input.preintegration import preintegrate
from ahrs_service.diagnosis.input.reference import Reference, rotation_vectors
from ahrs_service.diagnosis.input.reference_motion import GRAVITY_NED
from ahrs_service.records import Floats
from ahrs_service.rotation import inverse_columns, multiply_columns, rotate_columns

_FINE_S: Final = 0.02
"""The trapezoid rule over such steps is accurate to 1 % at 3 Hz."""

_DENSE_S: Final = 0.005
"""Linear interpolation over this step errs by 2e-4 m/s^2 for gravity rotating at 200 deg/s."""

_GAP: Final = 4.0  # A choice: a gap is longer than this many usual steps: samples are lost
_SHORTEST_GAP_S: Final = 0.1  # A choice: no shorter step is a gap, however fast the sensor


@dataclass(frozen=True, slots=True)
class Preintegrated:
    """The IMU preintegrated between successive references, in earth axes.

    `misfit` [N-1, 6] preintegrated angle [rad] and velocity [m/s] minus the reference's, `speeds`
    [N-1, 3] [m/s] the integrated force; `is_broken` [N-1] where there is a gap. `time_s` [M] and
    `ned_from_body` [M, 4] the references and `parts` - 1 instants between neighbours,
    M = (N - 1) parts + 1. `velocity` [K, 3] the velocity misfit since the start, at the velocity's
    own instants, where it is reported less often than the attitude.
    """

    time_s: Floats
    ned_from_body: Floats
    parts: int
    misfit: Floats
    speeds: Floats
    is_broken: npt.NDArray[np.bool_]
    velocity: Series


def preintegrated(recorded: Recorded, reference: Reference) -> Preintegrated:
    """Return the IMU preintegrated between references.

    The force is resolved along the references' attitude: within an interval the gyro's rate is
    corrected by its excess over the references' rotation. Otherwise gyro errors, late timestamps
    above all, would enter the velocity.
    """
    at_s, q = reference.time_s, reference.ned_from_body
    steps_s = np.diff(at_s)[:, None]
    parts = max(1, round(float(np.median(steps_s)) / _FINE_S))
    dense = _dense(recorded)
    rotations, _ = _integrated(dense, at_s, np.zeros((len(q) - 1, 3)))
    expected = multiply_columns(inverse_columns(q[:-1]), q[1:])
    apart = rotation_vectors(multiply_columns(inverse_columns(expected), rotations))
    fine_s = _between(at_s, parts)
    rotations, speeds = _integrated(dense, fine_s, np.repeat(apart / steps_s, parts, axis=0))
    path = _path(q, rotations, parts)
    pushed = rotate_columns(path[:-1], speeds)
    forces = pushed.reshape(-1, parts, 3).sum(axis=1)
    own = reference.velocity
    if len(own):
        speed = _columns_at(fine_s, np.vstack([np.zeros((1, 3)), np.cumsum(pushed, axis=0)]), own)
        speed += GRAVITY_NED * (own.time_s - at_s[0])[:, None] - own.values
        own = Series(own.time_s, speed)
        gained = np.diff(_columns_at(own.time_s, speed, Series(at_s, at_s)), axis=0)
    else:
        gained = forces + GRAVITY_NED * steps_s - np.diff(reference.velocity_ned_m_s, axis=0)
    misfit = np.hstack([rotate_columns(q[1:], apart), gained])
    return Preintegrated(fine_s, path, parts, misfit, forces, _gaps(recorded, at_s), own)


def _columns_at(time_s: Floats, values: Floats, at: Series) -> Floats:
    return np.stack([np.interp(at.time_s, time_s, column) for column in values.T], axis=1)


def _dense(recorded: Recorded) -> Recorded:
    """Return a slow IMU resampled by Akima interpolation; linear interpolation cuts the peaks."""
    imu_s = recorded.imu_time_s
    parts = round(float(np.median(np.diff(imu_s))) / _DENSE_S)
    if parts < 2:
        return recorded
    dense_s = _between(imu_s, parts)
    gyro, accel = (
        Akima1DInterpolator(imu_s, values)(dense_s)
        for values in (recorded.gyro_rad_s, recorded.accel_m_s2)
    )
    return replace(recorded, imu_time_s=dense_s, gyro_rad_s=gyro, accel_m_s2=accel)


def _integrated(recorded: Recorded, at_s: Floats, excess_rad_s: Floats) -> tuple[Floats, Floats]:
    rotations, speeds = np.empty((len(at_s) - 1, 4)), np.empty((len(at_s) - 1, 3))
    gyro, accel = recorded.gyro_rad_s, recorded.accel_m_s2
    preintegrate(recorded.imu_time_s, gyro, accel, at_s, excess_rad_s, rotations, speeds)
    return rotations, speeds


def _between(time_s: Floats, parts: int) -> Floats:
    shares = np.arange(parts) / parts
    fine_s = time_s[:-1, None] + shares * np.diff(time_s)[:, None]
    return np.append(fine_s.ravel(), time_s[-1])


def _path(q: Floats, rotations: Floats, parts: int) -> Floats:
    """Return the attitudes [M, 4]: each reference's, propagated until the next."""
    path = np.empty((len(q) - 1, parts, 4))
    path[:, 0] = q[:-1]
    for part in range(1, parts):
        path[:, part] = multiply_columns(path[:, part - 1], rotations[part - 1 :: parts])
    return np.vstack([path.reshape(-1, 4), q[-1:]])


def _gaps(recorded: Recorded, at_s: Floats) -> npt.NDArray[np.bool_]:
    """Return which intervals [N-1] are far longer than usual, or contain such an IMU step."""
    imu_s = recorded.imu_time_s
    far = np.flatnonzero(_is_long(np.diff(imu_s)))
    holds = np.zeros(len(at_s) - 1, np.bool_)
    for place in far:
        holds |= (at_s[1:] > imu_s[place]) & (at_s[:-1] < imu_s[place + 1])
    return np.asarray(holds | _is_long(np.diff(at_s)))


def _is_long(steps_s: Floats) -> npt.NDArray[np.bool_]:
    return np.asarray(steps_s > max(_GAP * float(np.median(steps_s)), _SHORTEST_GAP_S))
