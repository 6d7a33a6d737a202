"""The input of a diagnosis: columns in SI units on one clock, from any file format."""

from dataclasses import dataclass, field

import numpy as np

from ahrs_service.records import Floats


@dataclass(frozen=True, slots=True)
class Series:
    """Values [N] or [N, M] at `time_s` [N]; empty where the recording has none."""

    time_s: Floats = field(default_factory=lambda: np.empty(0))
    values: Floats = field(default_factory=lambda: np.empty(0))

    def __len__(self) -> int:
        return len(self.time_s)

    def at(self, time_s: Floats) -> Floats:
        """Return the values at `time_s`, linear between, held beyond the ends; NaN if empty."""
        if not len(self):
            return np.full(len(time_s), np.nan)
        return np.interp(time_s, self.time_s, self.values)


@dataclass(frozen=True, slots=True)
class Recorded:
    """The columns of a recording, all times [s] since power-on of the sender.

    `gyro_rad_s`, `accel_m_s2` at `imu_time_s` as measured; the reference: `attitude`
    (ned_from_body wxyz), `velocity_ned_m_s`, and `body_rate_rad_s` from the same source (in flight
    possibly this same IMU, which is detected); covariates: the IMU's own
    `temperature_degc`, `vibration_m_s2` [N, 3], `current_a`, `throttle` 0 to 1, `airspeed_m_s`,
    `supply_v`.
    """

    name: str
    imu_time_s: Floats
    gyro_rad_s: Floats
    accel_m_s2: Floats
    attitude: Series
    velocity_ned_m_s: Series
    body_rate_rad_s: Series = field(default_factory=Series)
    temperature_degc: Series = field(default_factory=Series)
    vibration_m_s2: Series = field(default_factory=Series)
    current_a: Series = field(default_factory=Series)
    throttle: Series = field(default_factory=Series)
    airspeed_m_s: Series = field(default_factory=Series)
    supply_v: Series = field(default_factory=Series)
