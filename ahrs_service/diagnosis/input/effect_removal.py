"""Effects put into, or taken out of, the readings of a recording itself.

What a twin knows is taken out before recording and reference are compared; what a test plants is
put in, both by effects.undo. The motion by which an effect acts is the IMU's own, smoothed over
50 ms, so that noise is not taken for motion; timing is in the stamps.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from scipy.ndimage import uniform_filter1d

from ahrs_service.diagnosis.input.diagnosis_input import Recorded, Series
from ahrs_service.effects.base import Columns
from ahrs_service.effects.undo import Acting, added, added_to, delay_s
from ahrs_service.errors import DiagnosisError

_SMOOTHED_S: Final = 0.05
"""A mean of 50 ms passes motion below 8.9 Hz (-3 dB), so all below MOTION_HZ."""
_ITERATIONS: Final = 3
"""A choice: each pass leaves of the error the effect's share, of a scale of 3 % 3e-5 in all."""


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


def with_effects(recorded: Recorded, effects: Acting) -> Recorded:
    """Return the recording of an IMU on which `effects` act as well."""
    gyro, accel = added(_known(acting(recorded), effects), effects)
    return replace(
        recorded,
        imu_time_s=recorded.imu_time_s + delay_s(recorded.imu_time_s, effects),
        gyro_rad_s=recorded.gyro_rad_s + gyro,
        accel_m_s2=recorded.accel_m_s2 + accel,
    )


def without_effects(recorded: Recorded, effects: Acting) -> Recorded:
    """Return the recording with `effects` taken out of it; ValueError names what they need.

    What was cut off or filtered away comes back to first order at most.
    """
    if not effects:
        return recorded
    time_s = recorded.imu_time_s - delay_s(recorded.imu_time_s, effects)
    recorded = replace(recorded, imu_time_s=time_s)
    gyro, accel = added_to(_known(acting(recorded), effects), effects, _ITERATIONS)
    return replace(
        recorded, gyro_rad_s=recorded.gyro_rad_s - gyro, accel_m_s2=recorded.accel_m_s2 - accel
    )


def _known(columns: Columns, effects: Acting) -> Columns:
    """Return the columns if they hold what the effects need; ValueError names what they lack."""
    for effect, _ in effects:
        name = effect.unknown_need(columns)
        if name is not None:
            raise DiagnosisError(
                f"the twin's {effect.id} needs {name}, which the recording has not; "
                "leave the effect out of the twin"
            )
    return columns
