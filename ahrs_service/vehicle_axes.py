"""From the axes of the autopilot's board to those of the vehicle, by the trim as it is heard."""

import math
from typing import Final

import numpy as np

from ahrs_service.kernel import kernel
from ahrs_service.records import Flag, Floats, Record, Rows
from ahrs_service.rotation import from_euler, matrix

TRIM_FIELDS: Final = [("trim_rad", "f8", 2), ("vehicle_from_board", "f8", (3, 3))]
"""Fields of the intake's state that this module keeps."""
RANGE_FIELDS: Final = [("gyro_range_rad_s", "f8"), ("accel_range_m_s2", "f8")]
"""Parameters of the intake that this module reads."""

_SATURATED = int(Flag.SATURATED)


def new_trim(state: Rows) -> None:
    """Begin with the board's axes as the vehicle's."""
    state["trim_rad"] = 0.0
    state["vehicle_from_board"] = np.eye(3)


@kernel
def take_trim(state: Record, reading: Record) -> None:
    """Keep how the board stands in the vehicle, from the next sample on."""
    trim = state["trim_rad"]
    for i in range(2):
        if math.isfinite(reading["trim_rad"][i]):
            trim[i] = reading["trim_rad"][i]
    q = np.empty(4)
    from_euler(trim[0], trim[1], 0.0, q)
    matrix(q, state["vehicle_from_board"])


@kernel
def turn_sample(parameters: Record, state: Record, sample: Record) -> int:
    """Turn the vectors of a sample into the vehicle's axes; return the flag of a clipped axis.

    Clipping is seen here, for after the turn no axis stands at the end of its range.
    """
    if state["trim_rad"][0] == 0.0 and state["trim_rad"][1] == 0.0:
        return 0
    gyro, accel, dcm = sample["gyro_rad_s"], sample["accel_m_s2"], state["vehicle_from_board"]
    flags = 0
    for i in range(3):
        gyro_clipped = abs(gyro[i]) >= parameters["gyro_range_rad_s"]
        if gyro_clipped or abs(accel[i]) >= parameters["accel_range_m_s2"]:
            flags = _SATURATED
    _turn(dcm, gyro)
    _turn(dcm, accel)
    _turn(dcm, sample["mag_ut"])
    return flags


@kernel
def _turn(dcm: Floats, v: Floats) -> None:
    x, y, z = v[0], v[1], v[2]
    for i in range(3):
        v[i] = dcm[i, 0] * x + dcm[i, 1] * y + dcm[i, 2] * z
