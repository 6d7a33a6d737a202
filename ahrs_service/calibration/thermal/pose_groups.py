"""Rows for a thermal fit out of a recording: the windows in which the unit was still, by pose."""

import math
from typing import Final

import numpy as np
from scipy.ndimage import median_filter

from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.poses import Booleans, Stillness, windows_of
from ahrs_service.calibration.thermal.rows import ThermalRows
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats, Integers

WINDOW_S: Final = 1.0  # A choice: a mean over it has a hundredth of the noise's variance at 100 Hz
MOST_ROWS: Final = 4000
"""A row per window; of longer recordings the windows are longer."""
TURN_RAD_S: Final = Stillness().turn_rad_s
"""As of any pose, but about the windows around, for the bias drifts."""
NEAR_M_S2: Final = 0.05
"""A pose that comes back within 5 mg, as a table or a fixture brings it, is the same pose."""
BUMP_M_S2: Final = 0.01  # A choice: 1 mg; a pose that shifts by less is taken to drift
APART_M_S2: Final = 1.7
"""A tenth of a turn: between two visits of one pose the unit was clearly elsewhere."""

_SIGMAS: Final = 4.0  # A choice: by chance one value in 16000 is so far off (Gauss, two-sided)
_AROUND: Final = 61
"""A choice: the median of a minute's windows is not moved by a turn of less than half of it."""
_RECENT: Final = 5
"""A choice: windows whose mean is a pose's last or first force: 2.2 times less noise than one."""


def still_rows(columns: ImuColumns, session: int = 0) -> tuple[ThermalRows, ThermalRows]:
    """Return the rows of gyros and accelerometers of one session: its still windows.

    The gyro's input is zero in all of them; the accelerometer's is numbered by pose. The sensor may
    drift by far more than poses differ, so a pose ends with motion, never with drift.
    CalibrationError where the unit was hardly ever still.
    """
    span_s = float(columns.time_s[-1] - columns.time_s[0]) if len(columns.time_s) else 0.0
    window_s = max(WINDOW_S, span_s / MOST_ROWS)
    windows = windows_of(columns, Stillness(window_s=window_s, turn_rad_s=math.inf))
    size, count = windows.length, len(windows.is_still)
    time, temperature = (
        x[: count * size].reshape(count, size).mean(axis=1)
        for x in (columns.time_s, columns.temperature_degc)
    )
    still = np.flatnonzero(windows.is_still & np.isfinite(temperature))
    still = still[~_turns(windows.gyro[still])]
    if len(still) < 5:
        raise CalibrationError(
            f"of {count} windows of {size} samples only {len(still)} are still and have a "
            "temperature: put the unit down while its temperature changes, and record again"
        )
    noise = windows.accel_scatter[still] / math.sqrt(size)
    level = _number_poses(still, windows.accel[still], np.median(noise, axis=0))
    shared = (time[still], temperature[still])
    sessions = np.full(len(still), session)
    gyro = ThermalRows(*shared, windows.gyro[still], np.zeros(len(still), np.int64), sessions)
    return gyro, ThermalRows(*shared, windows.accel[still], level, sessions)


def _turns(gyro: Floats) -> Booleans:
    """Return which windows turn steadily: their rate differs from that of the windows around."""
    around = median_filter(gyro, size=(min(_AROUND, max(len(gyro), 1)), 1), mode="nearest")
    turns: Booleans = (np.abs(gyro - around) > TURN_RAD_S).any(axis=1)
    return turns


def _number_poses(place: Integers, force: Floats, noise: Floats) -> Integers:
    """Number the poses of still windows [N]; `place` [N] counts all windows, `noise` [3] of one.

    Windows on end are one pose. After a motion it is the same one if the force is that of before,
    or an earlier one if the unit was clearly elsewhere and the force is that pose's last one.
    """
    level = np.zeros(len(place), np.int64)
    begins = np.flatnonzero(np.diff(place, prepend=place[0] - 2) > 1)
    ends = np.append(begins[1:], len(place))
    bump = np.maximum(BUMP_M_S2, _SIGMAS * noise)
    last: list[Floats] = []
    for begin, end in zip(begins, ends, strict=True):
        start = force[begin : min(begin + _RECENT, end)].mean(axis=0)
        off = np.array([np.abs(start - one).max() for one in last])
        now = int(level[begin - 1]) if begin else -1
        if begin and (np.abs(start - last[now]) < bump).all():
            number = now
        elif begin and off[now] > APART_M_S2 and off.min() < NEAR_M_S2:
            number = int(off.argmin())
        else:
            number = len(last)
            last.append(start)
        level[begin:end] = number
        last[number] = force[max(begin, end - _RECENT) : end].mean(axis=0)
    return level


def joined(parts: list[ThermalRows], same_levels: bool) -> ThermalRows:
    """Return the rows of several sessions as one; `same_levels` where level 0 is one input."""
    first, levels = 0, []
    for part in parts:
        levels.append(part.level + first)
        first += 0 if same_levels else part.levels
    return ThermalRows(
        time_s=np.concatenate([part.time_s for part in parts]),
        temperature_degc=np.concatenate([part.temperature_degc for part in parts]),
        output=np.concatenate([part.output for part in parts]),
        level=np.concatenate(levels),
        session=np.concatenate([part.session for part in parts]),
    )
