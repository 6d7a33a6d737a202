"""Instructions while a unit warms up or cools down: whether it lies still, how far it is.

Like the other guides it goes by the samples so far alone, so a session and its recording say the
same.
"""

from typing import Final

import numpy as np

from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.guide import Guidance, Refusal
from ahrs_service.calibration.poses import directions, sphere_coverage
from ahrs_service.calibration.thermal.pose_groups import still_rows
from ahrs_service.calibration.thermal.rows import ThermalRows
from ahrs_service.errors import CalibrationError

MOVING_S: Final = 5.0  # A choice: five windows of WINDOW_S without rest are motion, not a bump
STALE_S: Final = 300.0  # A choice: at SLOWEST_DEGC_MIN the slope then stands on half a degree
SLOWEST_DEGC_MIN: Final = 0.1
"""Slower than this, another degree takes ten minutes."""


def guide_thermal(columns: ImuColumns, wanted_degc: float) -> Guidance:
    """Return what to do until the still windows span `wanted_degc` [degC]."""
    try:
        gyro, accel = still_rows(columns)
    except CalibrationError:
        return _not_yet(columns)
    low, high = gyro.span_degc
    span, now = high - low, float(gyro.temperature_degc[-1])
    rate = _rate_degc_min(gyro)
    done = span >= wanted_degc
    asked = f"leave it alone while it warms or cools: {span:.1f} of {wanted_degc:g} degC"
    state = "still" if columns.time_s[-1] - gyro.time_s[-1] < MOVING_S else "moving"
    return Guidance(
        instruction="all is there" if done else asked,
        state=f"{state}, {now:.1f} degC, {rate:+.2f} degC a minute",
        progress=(
            ("span", f"{low:.1f} to {high:.1f} degC"),
            ("means", str(len(gyro))),
            ("poses", str(accel.levels)),
        ),
        refusals=() if done else _on_pace(gyro, rate),
        coverage=sphere_coverage(directions(accel.output)),
        done=done,
    )


def _not_yet(columns: ImuColumns) -> Guidance:
    """Return what to say before there is a still window with a temperature."""
    heard = len(columns.time_s) > 0
    refusals: tuple[Refusal, ...] = ()
    if heard and columns.time_s[-1] > 10.0 and not np.isfinite(columns.temperature_degc).any():
        why = "this message tells no temperature of the IMU: choose another one (--imu)"
        refusals = (Refusal(float(columns.time_s[-1]), why),)
    return Guidance(
        instruction="put it down on something solid and leave it alone",
        state="moving" if heard else "waiting for samples",
        progress=(("span", "-"),),
        refusals=refusals,
        coverage=0.0,
        done=False,
    )


def _rate_degc_min(rows: ThermalRows) -> float:
    """Return how fast the temperature changes now, over the last STALE_S at most [degC/min]."""
    recent = rows.time_s > rows.time_s[-1] - STALE_S
    if np.ptp(rows.time_s[recent]) <= 0.0:
        return 0.0
    return 60.0 * float(np.polyfit(rows.time_s[recent], rows.temperature_degc[recent], 1)[0])


def _on_pace(rows: ThermalRows, rate_degc_min: float) -> tuple[Refusal, ...]:
    """Say where waiting on is of no use."""
    if np.ptp(rows.time_s) < STALE_S or abs(rate_degc_min) >= SLOWEST_DEGC_MIN:
        return ()
    why = (
        f"the temperature hardly changes any more ({rate_degc_min:+.2f} degC a minute): "
        "begin colder, or warm the unit from outside"
    )
    return (Refusal(float(rows.time_s[-1]), why),)
