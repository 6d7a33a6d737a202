"""Where each error stands in the filter's state vector."""

from typing import Final

ANGLE: Final = 0
"""Error angle about north, east, down [rad]."""
GYRO_BIAS: Final = 3
"""About body x, y, z [rad/s]."""
VELOCITY: Final = 6
"""North, east, down [m/s]: through the air, or over ground once that is measured."""
ACCEL_BIAS: Final = 9
"""Along body x, y, z [m/s^2]."""
GYRO_MATRIX: Final = 12
"""Scale and cross-axis errors of the gyro, row by row [1]."""
WIND: Final = 21
"""North, east [m/s]."""
LAG: Final = 23
"""How late a measured velocity is [s]."""
ERROR_STATES: Final = LAG + 1
"""The lag is the last of them."""

GATED: Final = GYRO_BIAS + 3
"""How many of them the gated filter has,"""
UNAIDED: Final = WIND
"""the filter that knows of the vehicle's velocity only by its class,"""
AIDED: Final = ERROR_STATES
"""and the one whose velocity over ground is measured."""
