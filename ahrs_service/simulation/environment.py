"""What surrounds the sensors: air, magnetic field, warmth of the box, and the propeller."""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

import numpy as np
from annotated_types import Ge, Gt, Le

from ahrs_service.records import Floats, Rows
from ahrs_service.rotation import inverse_columns, rotate_columns
from ahrs_service.sensor.noise import first_order

HOME_ALTITUDE_M: Final = 120.0
FIELD_NED_UT: Final = np.array([20.1, 1.1, 44.6])
"""Magnetic field of middle Europe [uT], rounded."""

_LAPSE_K_M: Final = 0.0065
_SEA_LEVEL_PA: Final = 101325.0
_SEA_LEVEL_K: Final = 288.15
_EXPONENT: Final = 5.25588
_DENSITY_KG_M3: Final = 1.225


def pressure_pa(altitude_m: Floats) -> Floats:
    """Static pressure [Pa] of the standard atmosphere at altitudes [m] (ISO 2533)."""
    return _SEA_LEVEL_PA * (1.0 - _LAPSE_K_M * altitude_m / _SEA_LEVEL_K) ** _EXPONENT


def dynamic_pressure_pa(airspeed_m_s: Floats) -> Floats:
    """Dynamic pressure [Pa] at sea level density."""
    return 0.5 * _DENSITY_KG_M3 * airspeed_m_s**2


def magnetic_field_ut(truth: Rows) -> Floats:
    """Magnetic field in body axes [N, 3] [uT]."""
    return rotate_columns(inverse_columns(truth["ned_from_body"]), FIELD_NED_UT)


def battery_current_a(throttle: Floats) -> Floats:
    """Battery current [A]: electronics and, in proportion to the throttle, the motor."""
    return 1.0 + 25.0 * throttle


@dataclass(frozen=True, slots=True)
class Warmth:
    """Temperatures: ambient at home [degC], self-heating of the box [K], its time constant [s]."""

    __pydantic_config__: ClassVar = {"extra": "forbid"}
    ambient_degc: Annotated[float, Ge(-80.0), Le(85.0)] = 18.0
    heating_k: Annotated[float, Ge(-80.0), Le(80.0)] = 15.0
    time_constant_s: Annotated[float, Gt(0.0)] = 15.0

    def ambient(self, truth: Rows) -> Floats:
        """Air temperature [N] [degC], falling with altitude."""
        return self.ambient_degc + _LAPSE_K_M * truth["position_ned_m"][:, 2]

    def of_imu(self, truth: Rows, rate_hz: float) -> Floats:
        """IMU temperature [N] [degC]: from ambient, first order to ambient plus self-heating."""
        keep = math.exp(-1.0 / (self.time_constant_s * rate_hz))
        drive = (1.0 - keep) * (self.ambient(truth) + self.heating_k)
        drive[0] = self.ambient_degc
        return first_order(drive[:, None], keep)[:, 0]


@dataclass(frozen=True, slots=True)
class Propeller:
    """Vibration of engine and propeller at the IMU, behind the autopilot's own low-pass.

    `accel_m_s2` and `gyro_rad_s` are 1-sigma per axis at full throttle; the shaft turns at
    `idle_hz` to `full_hz`. `harmonics` are the relative sizes of once, twice... per turn. Sampled
    below the vibration's frequency, it aliases as it does in a real recording.
    """

    __pydantic_config__: ClassVar = {"extra": "forbid"}
    accel_m_s2: Annotated[float, Ge(0.0)] = 0.8
    gyro_rad_s: Annotated[float, Ge(0.0)] = 0.02
    idle_hz: Annotated[float, Gt(0.0)] = 28.0
    full_hz: Annotated[float, Gt(0.0)] = 118.0
    harmonics: tuple[float, ...] = (0.6, 1.0, 0.3)

    def level_m_s2(self, throttle: Floats) -> Floats:
        """Return the 1-sigma of the specific force on each axis [N] [m/s^2]."""
        return self.accel_m_s2 * _size(throttle)

    def shake(
        self, throttle: Floats, rate_hz: float, rng: np.random.Generator
    ) -> tuple[Floats, Floats]:
        """Return the vibration of rate [rad/s] and specific force [m/s^2], both [N, 3]."""
        shaft_hz = self.idle_hz + (self.full_hz - self.idle_hz) * throttle
        turn = 2.0 * np.pi * np.cumsum(shaft_hz) / rate_hz
        size = _size(throttle)
        total = np.zeros((len(throttle), 6))
        for k, share in enumerate(self.harmonics, start=1):
            phase = rng.uniform(0.0, 2.0 * np.pi, 6)
            total += share * np.sin(k * turn[:, None] + phase)
        # A sine of amplitude 1 has a standard deviation of sqrt(1/2).
        total *= size[:, None] * math.sqrt(2.0 / sum(share**2 for share in self.harmonics))
        return self.gyro_rad_s * total[:, :3], self.accel_m_s2 * total[:, 3:]


def _size(throttle: Floats) -> Floats:
    """Return the vibration relative to that at full throttle: thrust grows with its square."""
    return 0.1 + 0.9 * throttle**2
