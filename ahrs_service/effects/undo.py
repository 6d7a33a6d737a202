"""The way back: what effects have added to readings, and the ideal motion behind these.

Late stamps are set right first; for the rest u <- reading - added(u), which gains a factor of the
effects' slope per iteration: 2 % or less by the data sheets, 1 - H for a filter H. What was
cut off is lost.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from ahrs_service.effects.base import Columns, Effect, Values
from ahrs_service.effects.timing import late
from ahrs_service.records import Floats

Acting = Sequence[tuple[Effect, Values]]

_SLOPE: Final = "angular_acceleration_rad_s2"


def delay_s(time_s: Floats, effects: Acting) -> Floats:
    """Return how late the stamps `time_s` [N] are [N] [s], all effects together."""
    total = np.zeros(len(time_s))
    for effect, values in effects:
        total += effect.delay_s(time_s, values)
    return total


def added(columns: Columns, effects: Acting) -> tuple[Floats, Floats]:
    """Return what effects add to ideal gyro and accelerometer [N, 3]; late stamps add nothing."""
    gyro, accel = np.zeros(columns.rate_rad_s.shape), np.zeros(columns.force_m_s2.shape)
    for effect, values in effects:
        if not effect.is_timing:
            addition = effect.add(columns, values)
            gyro += 0.0 if addition.gyro is None else addition.gyro
            accel += 0.0 if addition.accel is None else addition.accel
    return gyro, accel


def added_to(reading: Columns, effects: Acting, iterations: int) -> tuple[Floats, Floats]:
    """Return what effects have added to a reading whose stamps are right, [N, 3] each."""
    has_slope = any(_SLOPE in effect.needs for effect, _ in effects)
    gyro, accel = added(reading, effects)
    for _ in range(iterations - 1):
        ideal = _less(reading, gyro, accel)
        if has_slope:
            turned = reading.angular_acceleration_rad_s2 - np.gradient(gyro, reading.time_s, axis=0)
            ideal = replace(ideal, angular_acceleration_rad_s2=turned)
        gyro, accel = added(ideal, effects)
    return gyro, accel


def ideal_motion(reading: Columns, effects: Acting, iterations: int) -> Columns:
    """Return `reading`, of an IMU with `effects`, with the ideal rate and force in its place."""
    for effect, values in effects:
        if effect.is_timing:
            gyro, accel = late(reading, -effect.delay_s(reading.time_s, values))
            reading = _less(reading, -gyro, -accel)
    there = [(effect, values) for effect, values in effects if not effect.is_timing]
    return _less(reading, *added_to(reading, there, iterations)) if there else reading


def _less(columns: Columns, gyro: Floats, accel: Floats) -> Columns:
    rate, force = columns.rate_rad_s - gyro, columns.force_m_s2 - accel
    return replace(columns, rate_rad_s=rate, force_m_s2=force)
