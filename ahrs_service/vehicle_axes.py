"""From the axes of the autopilot's board to those of the vehicle, by the trim as it is heard."""

import math
from typing import Final

import numpy as np

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats, Record, Rows
from ahrs_service.rotation import from_euler, matrix

TRIM_FIELDS: Final = [
    ("trim_rad", "f8", 2),
    ("vehicle_from_board", "f8", (3, 3)),
    ("trim_system", "i8"),
    ("trim_component", "i8"),
]
"""Fields of the intake's state that this module keeps."""


def new_trim(state: Rows) -> None:
    """Begin with the board's axes as the vehicle's."""
    state["trim_rad"] = 0.0
    state["vehicle_from_board"] = np.eye(3)


@kernel
def take_trim(state: Record, reading: Record) -> None:
    """Keep how the board stands in the vehicle, from the next sample on.

    Before an autopilot is adopted anybody's is kept, for parameters may come before the heartbeat.
    """
    trim, sender = state["trim_rad"], reading["system"]
    if sender != state["trim_system"] or reading["component"] != state["trim_component"]:
        state["trim_system"], state["trim_component"] = sender, reading["component"]
        trim[0] = trim[1] = 0.0
    for i in range(2):
        if math.isfinite(reading["trim_rad"][i]):
            trim[i] = reading["trim_rad"][i]
    q = np.empty(4)
    from_euler(trim[0], trim[1], 0.0, q)
    matrix(q, state["vehicle_from_board"])


@kernel
def write_axes(state: Record, sample: Record) -> None:
    """Write the board's orientation, NaN where its axes are the vehicle's; rotate the field.

    Rate and force stay in the board's axes, in which the sensor's calibration holds.
    """
    dcm, out = state["vehicle_from_board"], sample["vehicle_from_board"]
    is_known = (
        state["trim_system"] == state["system"] and state["trim_component"] == state["component"]
    )
    has_trim = state["trim_rad"][0] != 0.0 or state["trim_rad"][1] != 0.0
    for i in range(3):
        for j in range(3):
            out[i, j] = dcm[i, j] if is_known and has_trim else math.nan
    rotate_to_vehicle(out, sample["mag_ut"])


@kernel
def rotate_to_vehicle(vehicle_from_board: Floats, v: Floats) -> None:
    """Turn `v` [3] into the vehicle's axes, in place; NaN for the matrix leaves it."""
    dcm = vehicle_from_board
    if math.isnan(dcm[0, 0]):
        return
    x, y, z = v[0], v[1], v[2]
    for i in range(3):
        v[i] = dcm[i, 0] * x + dcm[i, 1] * y + dcm[i, 2] * z
