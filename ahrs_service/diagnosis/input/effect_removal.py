"""Effects added to, or removed from, the readings of a recording.

The effects of a twin are removed before recording and reference are compared; tests plant effects
by adding them. Both use effects.undo. The motion that an effect depends on is the IMU's own,
smoothed over 50 ms to suppress noise; timing effects change the timestamps.
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
"""A mean over 50 ms passes motion below 8.9 Hz (-3 dB), which includes all below MOTION_HZ."""
_ITERATIONS: Final = 3
"""A choice: each pass multiplies the error by the effect's size; 3e-5 is left of a 3 % scale."""


def effect_inputs(recorded: Recorded) -> Columns:
    """Return the inputs of effects on the IMU of a recording, with the motion from the IMU."""
    time_s = recorded.imu_time_s
    width = max(1, round(_SMOOTHED_S / float(np.median(np.diff(time_s)))))
    rate, force = (
        uniform_filter1d(values, width, axis=0, mode="nearest")
        for values in (recorded.gyro_rad_s, recorded.accel_m_s2)
    )
    temperature = recorded.temperature_degc.at(time_s)
    vibration = recorded.vibration_m_s2
    level = Series(vibration.time_s, vibration.values.mean(axis=1)) if len(vibration) else vibration
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
    """Return the recording with `effects` added."""
    gyro, accel = added(_known(effect_inputs(recorded), effects), effects)
    return replace(
        recorded,
        imu_time_s=recorded.imu_time_s + delay_s(recorded.imu_time_s, effects),
        gyro_rad_s=recorded.gyro_rad_s + gyro,
        accel_m_s2=recorded.accel_m_s2 + accel,
    )


def without_effects(recorded: Recorded, effects: Acting) -> Recorded:
    """Return the recording with `effects` removed; ValueError names a missing input of theirs.

    What was clipped or filtered is restored to first order at most.
    """
    if not effects:
        return recorded
    time_s = recorded.imu_time_s - delay_s(recorded.imu_time_s, effects)
    recorded = replace(recorded, imu_time_s=time_s)
    gyro, accel = added_to(_known(effect_inputs(recorded), effects), effects, _ITERATIONS)
    return replace(
        recorded, gyro_rad_s=recorded.gyro_rad_s - gyro, accel_m_s2=recorded.accel_m_s2 - accel
    )


def _known(columns: Columns, effects: Acting) -> Columns:
    """Return the columns if they have all that the effects need; ValueError names what is not."""
    for effect, _ in effects:
        name = effect.unknown_need(columns)
        if name is not None:
            raise DiagnosisError(
                f"the twin's {effect.id} needs {name}, which the recording lacks; "
                "remove the effect from the twin"
            )
    return columns
