"""The sensor's environment: temperatures, vibration, current, supply, airspeed."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.signal import lfilter

from ahrs_service.blind.making.vehicles import Flight
from ahrs_service.records import Floats

LAPSE_K_M: Final = 0.0065
"""The standard atmosphere's lapse rate [K/m]."""

POWER_ON_S: Final = 5.0
"""Time since power-on of the first sample [s]: the clock of every message."""

_START_DEGC: Final = 20.0  # A choice: room temperature
_CHAMBER_AT: Final = (0.0, 0.05, 0.45, 0.55, 0.9, 1.0)
"""A choice: corners of cold, hot, cold as shares of the length, both slopes 40 and 35 %."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Columns [N] at the sensor's samples.

    `imu_degc` the sensor's own temperature and its slope [degC/s], `baro_degc` that of the air at
    the board; `vibration_m_s2` the amplitude A: 0.8, 0.8 and 1.4 A (rms) on the three axes.
    """

    imu_degc: Floats
    imu_degc_s: Floats
    baro_degc: Floats
    vibration_m_s2: Floats
    current_a: Floats
    voltage_v: Floats
    throttle: Floats
    airspeed_m_s: Floats


def chamber(rng: np.random.Generator, time_s: Floats, seconds: float) -> Surroundings:
    """Draw a thermal chamber's profile: cold, hot, cold; the sensor lags by 30..60 s."""
    low, high = rng.uniform(-20.0, 0.0), rng.uniform(45.0, 65.0)
    corners = np.array(_CHAMBER_AT) * seconds
    air = np.interp(time_s, corners, (_START_DEGC, low, high, high, low, low))
    own, slope = _follow(air, time_s, rng.uniform(30.0, 60.0), _START_DEGC)
    still = np.zeros_like(time_s)
    return Surroundings(own, slope, air, still, still + 0.5, still + 11.8, still, still)


def airborne(
    rng: np.random.Generator, time_s: Floats, altitude_m: Floats, flight: Flight, sags: bool
) -> Surroundings:
    """Draw a flight's environment: the board self-heats, the motors vibrate and draw current.

    Vibration grows with throttle and has a resonance at one throttle. A payload switches on and
    off: the current does not depend on throttle alone.
    """
    throttle = np.interp(time_s, flight.knots_s, flight.throttle)
    air = 22.0 - LAPSE_K_M * altitude_m
    warm = rng.uniform(13.0, 22.0) + 1.5 * throttle
    own, slope = _follow(air + warm, time_s, rng.uniform(140.0, 240.0), rng.uniform(19.0, 23.0))
    strength, centre = rng.uniform(0.6, 1.8), rng.uniform(0.35, 0.6)
    bump = np.exp(-(((throttle - centre) / rng.uniform(0.04, 0.08)) ** 2))
    shake = 0.35 * throttle + 0.7 * throttle**2 + rng.uniform(0.1, 0.3) * bump
    period = rng.uniform(90.0, 130.0)
    payload = 3.5 * ((time_s / period + rng.random()) % 1.0 > 0.5) * (time_s > 20.0)
    current = 0.6 + 22.3 * throttle**1.8 + payload
    volts = np.full_like(time_s, 11.8)
    if sags:
        # Another load with its own on and off times: voltage does not depend on current alone.
        other = (time_s / rng.uniform(25.0, 50.0) + rng.random()) % 1.0 > rng.uniform(0.3, 0.7)
        volts -= 0.005 * (current - 0.6) + 0.25 * other + 2e-4 * time_s
    vibration = 0.05 + strength * 1.25 * shake
    airspeed = np.interp(time_s, flight.knots_s, flight.airspeed_m_s)
    return Surroundings(own, slope, air, vibration, current, volts, throttle, airspeed)


def _follow(air: Floats, time_s: Floats, lag_s: float, start: float) -> tuple[Floats, Floats]:
    """Temperature [N] that follows `air` with a first-order lag [s], and its slope."""
    own = lag(air, time_s[1] - time_s[0], lag_s, start)
    return own, (air - own) / lag_s


def lag(values: Floats, step_s: float, lag_s: float, start: float) -> Floats:
    """Solve tau dy/dt = u - y from y = `start`, exact for `values` [N] linear between samples."""
    decay = np.exp(-step_s / lag_s)
    mean = (1.0 - decay) * lag_s / step_s
    b = np.array([1.0 - mean, mean - decay])
    # lfilter's state is chosen so that the first output is `start`.
    solved, _ = lfilter(b, [1.0, -decay], values, zi=[start - b[0] * values[0]])
    return np.asarray(solved, np.float64)
