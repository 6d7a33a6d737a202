"""AHRS_TRIM: the rotation between ArduPilot's vehicle and its board.

ArduPilot logs and sends the IMU in the board's axes, and the attitude of the vehicle:
v_vehicle = R(AHRS_TRIM_X about x, then AHRS_TRIM_Y about y) v_board. Source: ArduPilot
libraries/AP_AHRS, set_trim and get_rotation_autopilot_body_to_vehicle_body.
"""

import math
from typing import Final

import numpy as np

from ahrs_service.records import Kind, Rows

TRIM_NAMES: Final = ("AHRS_TRIM_X", "AHRS_TRIM_Y")
TRIM_LIMIT_RAD: Final = math.radians(10.01)
"""ArduPilot holds the trim within 10 deg; more is a damaged value."""
_NAN: Final = math.nan


def trim_of_parameter(name: str | bytes, value: float) -> tuple[float, float] | None:
    """Trim about x, y [rad] of one parameter, NaN for the other; None where it is no trim."""
    text = name.decode("ascii", "replace") if isinstance(name, bytes) else name
    text = text.split("\0")[0]
    if text not in TRIM_NAMES or not abs(value) <= TRIM_LIMIT_RAD:
        return None
    return (value, _NAN) if text == TRIM_NAMES[0] else (_NAN, value)


def trim_notes(readings: Rows) -> tuple[str, ...]:
    """Return a note on each vehicle's rotated samples, by the last values in the readings."""
    senders = readings["system"].astype(np.int64) << 8 | readings["component"]
    is_trim, is_imu = readings["kind"] == Kind.TRIM, readings["kind"] == Kind.IMU
    notes = []
    for sender in np.intersect1d(senders[is_trim], senders[is_imu]).tolist():
        values = readings["trim_rad"][is_trim & (senders == sender)]
        last = [column[np.isfinite(column)][-1:].sum() for column in values.T]
        if any(last):
            x, y = np.degrees(last)
            notes.append(
                f"IMU of vehicle {sender >> 8}/{sender & 0xFF} turned by AHRS_TRIM "
                f"{x:+.2f} deg about x, {y:+.2f} deg about y"
            )
    return tuple(notes)
