"""The records that pass between rooms: SI units, int64 nanoseconds, body axes forward-right-down.

Every record has one numpy dtype. A live sample is an array of length 1, a recording is an array of
length N of the same dtype, so the same kernels serve both. Missing numbers are NaN.
"""

from enum import IntEnum, IntFlag
from typing import Any, Final

import numpy as np
import numpy.typing as npt

Rows = npt.NDArray[Any]
"""A structured array of one of the dtypes below."""

Record = Any
"""One row of such an array, as the kernels see it."""

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


class Kind(IntEnum):
    """What a reading carries.

    Of the velocities GPS is the receiver's own, the others are those of the autopilot's filter.
    """

    HEARTBEAT = 1
    IMU = 2
    AIRSPEED = 3
    VELOCITY = 4
    GPS = 5
    GLOBAL_VELOCITY = 6
    TRIM = 7


class ImuSource(IntEnum):
    """Where an IMU reading came from; at like rates a lower number is the better source.

    HIGHRES_IMU comes in SI floats, the SCALED_IMU family and RAW_IMU in int16 of 1 mG and
    1 mrad/s. SCALED_IMU and RAW_IMU are the first IMU, SCALED_IMU2 the second and so on.
    """

    NONE = 0
    HIGHRES_IMU = 1
    ULOG = 2
    DATAFLASH = 3
    SCALED_IMU = 4
    RAW_IMU = 5
    SCALED_IMU2 = 6
    SCALED_IMU3 = 7
    HIGHRES_IMU_1 = 8
    HIGHRES_IMU_2 = 9


IMU_OF_SOURCE: Final = {
    ImuSource.HIGHRES_IMU_1: 1,
    ImuSource.HIGHRES_IMU_2: 2,
    ImuSource.SCALED_IMU2: 1,
    ImuSource.SCALED_IMU3: 2,
}
"""Which IMU of the autopilot a source is, counted from 0; those not named are 0."""


class Airframe(IntEnum):
    """The class of vehicle: how it can move. By HEARTBEAT.type; HAND_HELD only by settings."""

    OTHER = 0
    FIXED_WING = 1
    MULTIROTOR = 2
    HAND_HELD = 3


class Gate(IntFlag):
    """Why the averaged force was not used as the vertical; 0 is an open gate.

    Judged once per update, in both modes. While aligning and at rest the force counts all the same.
    """

    OPEN = 0
    NORM = 1
    RATE = 2
    ANGULAR_ACCELERATION = 4
    INNOVATION = 8
    SATURATION = 16
    STALE = 32


class Phase(IntEnum):
    """What the estimator is doing."""

    WAITING = 0
    ALIGNING = 1
    RUNNING = 2


class Flag(IntFlag):
    """What was found wrong with a sample, or done about it."""

    NONE = 0
    GAP = 1
    DUPLICATE = 2
    REORDERED = 4
    CLOCK_JUMP = 8
    NOT_FINITE = 16
    SPIKE = 32
    SATURATED = 64
    SOURCE_CHANGED = 128
    TEMPERATURE_STALE = 256
    TEMPERATURE_OUT_OF_RANGE = 512
    LOW_RATE = 1024
    REALIGNED = 2048
    ACCEL_MISSING = 4096
    IMU_CHANGED = 8192
    UNCOMPENSATED = 16384


READING_DTYPE: Final = np.dtype(
    [
        ("received_ns", "i8"),
        ("time_ns", "i8"),
        ("gyro_rad_s", "f8", 3),
        ("accel_m_s2", "f8", 3),
        ("mag_ut", "f8", 3),
        ("temperature_degc", "f8"),
        ("velocity_ned_m_s", "f8", 3),
        ("airspeed_m_s", "f8"),
        ("trim_rad", "f8", 2),
        ("kind", "u1"),
        ("source", "u1"),
        ("system", "u1"),
        ("component", "u1"),
        ("autopilot", "u1"),
        ("vehicle", "u1"),
        ("reserved", "u1", 2),
    ]
)
"""One message from a link or a recording, in SI units, before a source is chosen.

`received_ns` host clock at receipt, `time_ns` the sender's clock (0 if the message has none). IMU
readings fill gyro, accel, and where there are new values mag and temperature; a
`HIGHRES_IMU` temperature is the barometer's or the air's, never the IMU's. `trim_rad` [2] about
x, y rotate the board's axes into the vehicle's, NaN leaves one as it was. `autopilot` and `vehicle`
are HEARTBEAT.autopilot and HEARTBEAT.type.
"""

SAMPLE_DTYPE: Final = np.dtype(
    [
        ("time_ns", "i8"),
        ("received_ns", "i8"),
        ("gyro_rad_s", "f8", 3),
        ("accel_m_s2", "f8", 3),
        ("temperature_degc", "f8"),
        ("mag_ut", "f8", 3),
        ("airspeed_m_s", "f8"),
        ("velocity_ned_m_s", "f8", 3),
        ("vehicle_from_board", "f8", (3, 3)),
        ("flags", "u4"),
        ("source", "u4"),
        ("airframe", "u4"),
        ("reserved", "u4"),
    ]
)
"""One IMU sample of the chosen source, with what else came since the sample before (else NaN).

`time_ns` sensor clock, `gyro_rad_s` [3] angular rate [rad/s], `accel_m_s2` [3] specific force
[m/s^2] (level at rest: z = -9.81), both as the sensor gave them, in the board's axes;
`vehicle_from_board` [3, 3] rotates these into the vehicle's, NaN where they are the same;
`temperature_degc` of the IMU itself [degC], last known; `mag_ut` [3] in the vehicle's axes.
"""

ESTIMATE_DTYPE: Final = np.dtype(
    [
        ("time_ns", "i8"),
        ("received_ns", "i8"),
        ("ned_from_body", "f8", 4),
        ("rate_rad_s", "f8", 3),
        ("accel_m_s2", "f8", 3),
        ("gyro_bias_rad_s", "f8", 3),
        ("attitude_sigma_rad", "f8", 3),
        ("gyro_bias_sigma_rad_s", "f8", 3),
        ("residual_m_s2", "f8", 3),
        ("innovation_rad", "f8", 3),
        ("gate_norm_m_s2", "f8"),
        ("gate_rate_rad_s", "f8"),
        ("gate_angular_acceleration_rad_s2", "f8"),
        ("gate_innovation", "f8"),
        ("temperature_degc", "f8"),
        ("gate", "u4"),
        ("flags", "u4"),
        ("phase", "u4"),
        ("source", "u4"),
    ]
)
"""One output of the estimator, one per sample.

`ned_from_body` [4] Hamilton quaternion w, x, y, z; `rate_rad_s` and `accel_m_s2` compensated, rate
also free of the estimated bias; `attitude_sigma_rad` [3] 1-sigma of the error angle about north,
east, down; `residual_m_s2` [3] measured specific force minus that of gravity alone, body axes;
`innovation_rad` [3] tilt innovation about body axes; the `gate_*` columns are the values that the
gate compared at the end of the last update (mean f in earth axes, w smoothed): abs(norm(f) - g0),
norm(w), norm(dw/dt), and the normalised innovation (sigmas).
"""


def empty(dtype: np.dtype[Any], count: int = 1) -> Rows:
    """Return `count` rows of `dtype`, floats NaN and everything else 0."""
    rows = np.zeros(count, dtype)
    for name in dtype.names or ():
        if dtype[name].base.kind == "f":
            rows[name] = np.nan
    return rows
