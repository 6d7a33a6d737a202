"""The recording's reference on one grid: attitude, velocity, and independent rates if any."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d, median_filter

from ahrs_service.diagnosis.input.diagnosis_input import Recorded, Series
from ahrs_service.errors import DiagnosisError
from ahrs_service.records import Floats
from ahrs_service.rotation import inverse_columns, multiply_columns, rotate_columns

LEAST_REFERENCES: Final = 200
"""Four seconds at 50 Hz: with fewer a bias is not separable from noise."""

_JUMP_SIGMA: Final = 9.0  # Exceeded by 2e-19 of increments of Gaussian noise: see `jumps`
_NEIGHBOURS: Final = 5  # The median of five is not affected by a jump of one or two intervals
_LONGEST_EXCURSION_S: Final = 20.0
"""A choice: longest excursion between a jump and the jump back."""
_RETURN_SHARE: Final = 0.4  # A choice: share of a jump that may be left after the jump back
_STILL_M_S: Final = 1e-9  # A choice: zero velocity within rounding
_SPARSE: Final = 1.5
"""Half-way between a velocity as frequent as the attitude and one half as frequent."""
_NEAR: Final = 20
"""A choice: half of the 40 neighbouring intervals from which the roughness is estimated."""
_ONCE: Final = 3.0
"""A choice: 3 robust sigmas of the increments, the allowance for noise in what is left."""


@dataclass(frozen=True, slots=True)
class Reference:
    """What the IMU is compared with.

    `time_s` [N]; `ned_from_body` [N, 4], without sign jumps; `velocity_ned_m_s` [N, 3],
    interpolated linearly where it is reported far less often, at the instants of `velocity`;
    `rate_rad_s` [N, 3] where the reference has its own sensor (an encoder), else None;
    `is_at_rest` where the reference point never moves.
    """

    time_s: Floats
    ned_from_body: Floats
    velocity_ned_m_s: Floats
    rate_rad_s: Floats | None
    is_at_rest: bool
    velocity: Series = field(default_factory=Series)


def reference_of(recorded: Recorded) -> Reference:
    """Return the reference inside the span of the IMU; ValueError says what is missing."""
    time_s, attitude = recorded.attitude.time_s, recorded.attitude.values
    inside = (time_s >= recorded.imu_time_s[0]) & (time_s <= recorded.imu_time_s[-1])
    if inside.sum() < LEAST_REFERENCES:
        raise DiagnosisError(
            f"{recorded.name}: only {int(inside.sum())} attitudes within the IMU's samples, too "
            f"few to compare with; record ATTITUDE_QUATERNION or ATTITUDE at 10 Hz or more"
        )
    time_s, attitude = time_s[inside], _continuous(attitude[inside])
    if len(recorded.velocity_ned_m_s):
        velocity = np.column_stack(
            [
                np.interp(time_s, recorded.velocity_ned_m_s.time_s, column)
                for column in recorded.velocity_ned_m_s.values.T
            ]
        )
    else:
        velocity = np.full((len(time_s), 3), np.nan)
    rate = None
    if len(recorded.body_rate_rad_s) and is_independent(recorded):
        rates = recorded.body_rate_rad_s
        rate = np.column_stack([np.interp(time_s, rates.time_s, c) for c in rates.values.T])
    is_at_rest = bool(np.nanmax(np.abs(velocity), initial=0.0) < _STILL_M_S) and bool(
        np.isfinite(velocity).all()
    )
    sparse = _sparse_velocity(recorded.velocity_ned_m_s, time_s)
    return Reference(time_s, attitude, velocity, rate, is_at_rest, sparse)


def _sparse_velocity(velocity: Series, time_s: Floats) -> Series:
    """Return the velocity inside the span of the attitudes if it is reported far less often."""
    inside = (velocity.time_s >= time_s[0]) & (velocity.time_s <= time_s[-1])
    if inside.sum() < 2:
        return Series()
    own = Series(velocity.time_s[inside], velocity.values[inside])
    is_sparse = np.median(np.diff(own.time_s)) > _SPARSE * np.median(np.diff(time_s))
    return own if is_sparse else Series()


def is_independent(recorded: Recorded) -> bool:
    """Whether the reference's body rates come from another sensor than this IMU.

    Rates that come from the same IMU carry its noise: the second difference of rate minus gyro is
    then far smaller than that of the gyro. Judged on the quieter half of the recording.
    """
    time_s = recorded.body_rate_rad_s.time_s
    gyro = np.column_stack(
        [np.interp(time_s, recorded.imu_time_s, c) for c in recorded.gyro_rad_s.T]
    )
    rates = recorded.body_rate_rad_s.values
    turning = np.linalg.norm(rates, axis=1)[1:-1]
    quiet = turning <= np.median(turning)
    apart = np.diff(gyro - rates, 2, axis=0)[quiet]
    alone = np.diff(gyro, 2, axis=0)[quiet]
    return bool(np.median(np.abs(apart)) > 0.5 * np.median(np.abs(alone)))


def _continuous(attitude: Floats) -> Floats:
    """Return the unit quaternions without changes of sign between neighbours."""
    attitude = attitude / np.linalg.norm(attitude, axis=1, keepdims=True)
    flips = np.sum(attitude[1:] * attitude[:-1], axis=1) < 0.0
    signs = np.where(np.concatenate([[0], np.cumsum(flips)]) % 2 == 1, -1.0, 1.0)
    return attitude * signs[:, None]


def rotation_vectors(q: Floats) -> Floats:
    """Return the rotation vectors [N, 3] [rad] of quaternions [N, 4], below 180 deg."""
    q = np.where(q[:, :1] < 0.0, -q, q)
    sine = np.linalg.norm(q[:, 1:], axis=1)
    angle = 2.0 * np.arctan2(sine, q[:, 0])
    scale = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)
    return np.asarray(q[:, 1:] * scale[:, None])


def rotations(reference: Reference) -> Floats:
    """Return the rotation vectors [N-1, 3] [rad] between references, in body axes."""
    q = reference.ned_from_body
    return rotation_vectors(multiply_columns(inverse_columns(q[:-1]), q[1:]))


def body_vectors(ned_from_body: Floats, vectors_ned: Floats) -> Floats:
    """Return earth vectors [N, 3] or [3] in body axes."""
    return rotate_columns(inverse_columns(ned_from_body), vectors_ned)


def jumps(increments: Floats) -> npt.NDArray[np.bool_]:
    """Return which of the increments [N, M] of a misfit are jumps of the reference.

    A jump differs from the median of its neighbours by nine robust sigmas, which one increment of
    Gaussian noise in 1e18 does. A real misfit of the IMU lasts longer than one interval, so sigma
    is taken from second differences (sqrt(6) times that of white noise), which exclude it. Where
    40 intervals nearby are rougher than the rest their sigma is used: in hard manoeuvres the lag of
    the reference and the errors of the IMU are as rough as the motion.
    """
    size = (min(_NEIGHBOURS, len(increments) | 1), 1)
    apart = np.abs(increments - median_filter(increments, size=size, mode="nearest"))
    bends = np.abs(np.diff(increments, 2, axis=0)) if len(increments) > 2 else np.abs(increments)
    everywhere = np.median(bends, axis=0)
    near = median_filter(bends, size=(min(2 * _NEAR, len(bends)) | 1, 1), mode="nearest")
    near = maximum_filter1d(near, 2 * _NEAR + 1, axis=0, mode="nearest")
    near = np.vstack([near[:1], near, near[-1:]])[: len(increments)]
    sigma = 1.4826 * np.maximum(near, everywhere) / np.sqrt(6.0)
    scale = np.maximum(sigma, np.finfo(np.float64).tiny)
    return np.asarray((apart > _JUMP_SIGMA * scale).any(axis=1))


def excursions(
    time_s: Floats,
    increments: Floats,
    jumped: npt.NDArray[np.bool_],
    ned_from_body: Floats | None = None,
) -> npt.NDArray[np.bool_]:
    """Return which of the intervals lie between a jump and the jump back.

    `increments` [N, 3 or 6] angle and velocity. A jump back reverses both: the angle in these
    axes or, with `ned_from_body` [N, 4] given, in those of the body, which has rotated meanwhile. A
    filter also steps at each aiding update, but one step does not reverse another.
    """
    within = np.zeros(len(increments), np.bool_)
    places = np.flatnonzero(jumped)
    scale = np.maximum(1.4826 * np.median(np.abs(increments), axis=0), 1e-300)
    speeds, level = increments[:, 3:] / scale[3:], float(scale[:3].mean())
    angles = [increments[:, :3] / level]
    if ned_from_body is not None:
        angles.append(body_vectors(ned_from_body, angles[0]))
    for n, start in enumerate(places):
        for stop in places[n + 1 : n + 4]:
            if time_s[stop] - time_s[start] > _LONGEST_EXCURSION_S:
                break
            is_back = any(_goes_back(angle[start], angle[stop]) for angle in angles)
            if is_back and _goes_back(speeds[start], speeds[stop]):
                within[start : stop + 1] = True
                break
    return within


def _goes_back(there: Floats, back: Floats) -> bool:
    left = np.linalg.norm(there + back)
    return bool(left < _RETURN_SHARE * np.linalg.norm(there) + _ONCE)
