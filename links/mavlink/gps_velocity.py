"""The velocity over ground that a GPS receiver measured, before any filter of the autopilot.

A receiver's velocity comes from Doppler shifts: it is independent of the vehicle's attitude, and it
does not run away.
"""

import math
from typing import Final

import numpy as np

from ahrs_service.records import Floats, Rows

LEAST_FIX: Final = 3
"""A fix in three dimensions; less measures no velocity worth the name."""
_UNKNOWN: Final = 0xFFFF
_MOVING_CM_S: Final = 300
_LONGEST_STEP_US: Final = 3_000_000
_SHORTEST_STEP_US: Final = 700_000
_TRACK_FIXES: Final = 30
_LEAST_LIKENESS: Final = 0.5
"""Mean cosine between course and track: 0.9 and more in flight, about 0 where they are unrelated"""
_METRES_PER_UNIT: Final = 1e-7 * 111_195.0


def velocity_of_raw_int(fix_type: int, vel: int, cog: int) -> tuple[float, float] | None:
    """Velocity north, east [m/s] of a GPS_RAW_INT, None without a fix.

    `vel` ground speed [cm/s], `cog` course over ground [cdeg], both 65535 where unknown.
    """
    if fix_type < LEAST_FIX or _UNKNOWN in (vel, cog):
        return None
    speed, course = vel * 1e-2, math.radians(cog * 1e-2)
    return speed * math.cos(course), speed * math.sin(course)


def velocity_columns(speed_m_s: Floats, course_deg: Floats, down_m_s: Floats) -> Floats:
    """Velocity north, east, down [N, 3] of speed [N] and course over ground [N]."""
    course = np.radians(course_deg)
    return np.stack([speed_m_s * np.cos(course), speed_m_s * np.sin(course), down_m_s], axis=1)


def course_likeness(table: Rows) -> float:
    """Mean cosine between the course of GPS_RAW_INTs [N] and the track of their positions.

    NaN where the vehicle hardly moved.
    """
    table = table[(table["fix_type"] >= LEAST_FIX) & (table["vel"] != _UNKNOWN)]
    stamps_us = np.maximum.accumulate(table["received_us"])
    later = np.searchsorted(stamps_us, stamps_us + _SHORTEST_STEP_US)
    now = np.flatnonzero(later < len(table))
    later = later[now]
    steps_us = table["received_us"][later] - table["received_us"][now]
    north = (table["lat"][later] - table["lat"][now].astype(np.float64)) * _METRES_PER_UNIT
    east = (table["lon"][later] - table["lon"][now].astype(np.float64)) * _METRES_PER_UNIT
    east *= np.cos(np.radians(1e-7 * table["lat"][now]))
    # The course at mid-interval, so a turn does not matter.
    between = (now + later) // 2
    apart = np.hypot(north, east) > 1e-2 * _MOVING_CM_S * 1e-6 * _SHORTEST_STEP_US
    moving = apart & (table["vel"][between] >= _MOVING_CM_S) & (steps_us < _LONGEST_STEP_US)
    moving &= steps_us > 0
    if np.count_nonzero(moving) < _TRACK_FIXES:
        return math.nan
    course = np.radians(1e-2 * table["cog"][between])
    return float(np.mean(np.cos(course - np.arctan2(east, north))[moving]))


def course_is_doubtful(likeness: float) -> bool:
    """Return whether the course disagrees with the track too much to be one; false for NaN."""
    return likeness < _LEAST_LIKENESS
