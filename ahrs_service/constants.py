"""Constants of physics, each with its source."""

from typing import Final

STANDARD_GRAVITY_M_S2: Final = 9.80665
"""Standard acceleration of free fall (CGPM 1901, resolution 2) [m/s^2]."""
