"""Effects put into, or taken out of, the readings of a recording itself.

What a twin knows is taken out before recording and reference are compared; what a test plants is
put in. The motion by which an effect acts is the IMU's own, smoothed over 50 ms, so that noise is
not taken for motion; timing is in the stamps.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.ndimage import uniform_filter1d

from ahrs_service.diagnosis.input.diagnosis_input import Recorded, Series
from ahrs_service.effects.base import Columns, Effect, Values
from ahrs_service.records import Floats

Known = Sequence[tuple[Effect, Values]]

_SMOOTHED_S: Final = 0.05
_ITERATIONS: Final = 3
_TIMING: Final = ("time_offset", "clock_drift")


def acting(recorded: Recorded) -> Columns:
    """Return what acts on the IMU of a recording, the motion by the IMU itself."""
    time_s = recorded.imu_time_s
    width = max(1, round(_SMOOTHED_S / float(np.median(np.diff(time_s)))))
    rate, force = (
        uniform_filter1d(values, width, axis=0, mode="nearest")
        for values in (recorded.gyro_rad_s, recorded.accel_m_s2)
    )
    temperature = recorded.temperature_degc.at(time_s)
    shaken = recorded.vibration_m_s2
    level = Series(shaken.time_s, shaken.values.mean(axis=1)) if len(shaken) else shaken
    attitude = recorded.attitude
    q = np.stack([np.interp(time_s, attitude.time_s, c) for c in attitude.values.T], axis=1)
    return Columns(
        time_s=time_s,
        since_power_on_s=time_s,
        rate_rad_s=rate,
        force_m_s2=force,
        angular_acceleration_rad_s2=np.gradient(rate, time_s, axis=0),
        temperature_degc=temperature,
        temperature_slope_degc_s=np.gradient(temperature, time_s),
        vibration_m_s2=level.at(time_s),
        current_a=recorded.current_a.at(time_s),
        throttle=recorded.throttle.at(time_s),
        airspeed_m_s=recorded.airspeed_m_s.at(time_s),
        ned_from_body=q / np.linalg.norm(q, axis=1, keepdims=True),
    )


def with_effects(recorded: Recorded, effects: Known) -> Recorded:
    """Return the recording of an IMU on which `effects` act as well."""
    gyro, accel = _added(acting(recorded), effects)
    return replace(
        recorded,
        imu_time_s=recorded.imu_time_s + _late_s(recorded.imu_time_s, effects),
        gyro_rad_s=recorded.gyro_rad_s + gyro,
        accel_m_s2=recorded.accel_m_s2 + accel,
    )


def without_effects(recorded: Recorded, effects: Known) -> Recorded:
    """Return the recording with `effects` taken out of it; ValueError names what they need.

    u <- measured - added(u), a few turns; what was cut off or filtered away comes back to first
    order at most.
    """
    if not effects:
        return recorded
    time_s = recorded.imu_time_s - _late_s(recorded.imu_time_s, effects)
    recorded = replace(recorded, imu_time_s=time_s)
    columns = acting(recorded)
    measured = columns.rate_rad_s, columns.force_m_s2
    for _ in range(_ITERATIONS):
        gyro, accel = _added(columns, effects)
        rate = measured[0] - gyro
        columns = replace(
            columns,
            rate_rad_s=rate,
            force_m_s2=measured[1] - accel,
            angular_acceleration_rad_s2=np.gradient(rate, time_s, axis=0),
        )
    return replace(
        recorded, gyro_rad_s=recorded.gyro_rad_s - gyro, accel_m_s2=recorded.accel_m_s2 - accel
    )


def _late_s(time_s: Floats, effects: Known) -> Floats:
    """Return how late the stamps [N] are [s]."""
    late = np.zeros(len(time_s))
    for effect, values in effects:
        if effect.name == "time_offset":
            late += values["offset_s"]
        elif effect.name == "clock_drift":
            late += 1e-6 * values["ppm"] * (time_s - time_s[0])
    return late


def _added(columns: Columns, effects: Known) -> tuple[Floats, Floats]:
    gyro, accel = np.zeros(columns.rate_rad_s.shape), np.zeros(columns.force_m_s2.shape)
    for effect, values in effects:
        if effect.name in _TIMING:
            continue
        for name in effect.needs:
            if not columns.knows(name):
                raise ValueError(
                    f"the twin's {effect.id} needs {name}, which the recording has not; "
                    "leave the effect out of the twin"
                )
        addition = effect.add(columns, values)
        gyro += 0.0 if addition.gyro is None else addition.gyro
        accel += 0.0 if addition.accel is None else addition.accel
    return gyro, accel
