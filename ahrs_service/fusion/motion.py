"""What is known of the vehicle's velocity: bounded by its class, zero at rest, or measured.

The filter integrates the specific force to a velocity. A wrong tilt makes it run away by g psi t,
which the bound on the velocity shows; the acceleration of a turn does not, since it comes with the
velocity that turns. A fixed wing moves along its nose, so its velocity along y and z is about 0
and the centripetal force in a turn is explained without any speed sensor.
"""

import math
from typing import Final

import numpy as np

from ahrs_service.fusion.mekf import correct_body_velocity, correct_state
from ahrs_service.fusion.rest import CONFIRM_S
from ahrs_service.kernel import kernel
from ahrs_service.records import Airframe, Floats, Record

MOTION_FIELDS: Final = [
    ("velocity_ned_m_s", "f8", 3),
    ("airspeed_m_s", "f8"),
    ("airspeed_time_ns", "i8"),
    ("at_rest", "i8"),
]
"""Fields of the pipeline's state that this module keeps."""

WIND_SIGMA_M_S: Final = 5.0
"""Velocity is that over ground at rest and through the air in flight; the wind lies between."""
REST_VELOCITY_SIGMA_M_S: Final = 0.1
REST_VELOCITY_CORRELATION_S: Final = 0.1
REST_RATE_CORRELATION_S: Final = 0.2
REST_BIAS_GATE: Final = 3.0
REST_BIAS_FLOOR_RAD_S: Final = 0.01
"""A bias may step by this between power-on and flight and is still learnt [rad/s]."""
AIRSPEED_SIGMA_M_S: Final = 2.0
"""Position error of a pitot tube, scale included, on a small UAV [m/s]."""
AIRSPEED_CORRELATION_S: Final = 1.0
AIRSPEED_VALID_NS: Final = 1_000_000_000
AIRSPEED_MIN_M_S: Final = 3.0
"""A pitot tube shows nothing below this [m/s]."""

_FIXED_WING = int(Airframe.FIXED_WING)


@kernel
def hear_airspeed(state: Record, sample: Record) -> None:
    """Keep the newest airspeed [m/s] and its time."""
    if math.isfinite(sample["airspeed_m_s"]):
        state["airspeed_m_s"] = sample["airspeed_m_s"]
        state["airspeed_time_ns"] = sample["time_ns"]


@kernel
def come_to_rest(state: Record) -> bool:
    """Return whether the vehicle is at rest; a change of that brings the wind into the velocity."""
    at_rest = state["rest_s"] > CONFIRM_S
    if at_rest != (state["at_rest"] != 0):
        state["at_rest"] = 1 if at_rest else 0
        for i in range(2):
            state["covariance"][6 + i, 6 + i] += WIND_SIGMA_M_S**2
    return bool(at_rest)


@kernel
def hold_at_rest(state: Record, correction: Floats, dt_s: float, rate_sigma: float) -> None:
    """Measure velocity 0 and, where the rate is within its bounds, the gyro bias."""
    p = state["covariance"]
    slow = max(1.0, REST_VELOCITY_CORRELATION_S / dt_s)
    axis, velocity = np.zeros(3), state["velocity_ned_m_s"]
    for i in range(3):
        # As a bound along an axis, not as a velocity to the north: that would tell the heading.
        axis[i] = 1.0
        variance = REST_VELOCITY_SIGMA_M_S**2 * slow
        correct_body_velocity(p, correction, axis, velocity, -velocity[i], variance)
        axis[i] = 0.0
    slow = max(1.0, REST_RATE_CORRELATION_S / dt_s)
    for i in range(3):
        rate = state["mean_rate_rad_s"][i] - state["gyro_bias_rad_s"][i]
        bound2 = p[3 + i, 3 + i] + REST_BIAS_FLOOR_RAD_S**2
        if rate * rate < REST_BIAS_GATE**2 * bound2:
            correct_state(p, correction, 3 + i, rate, rate_sigma**2 * slow)


@kernel
def bound_velocity(
    settings: Record,
    state: Record,
    airframe: int,
    correction: Floats,
    dt_s: float,
) -> None:
    """Measure the velocity along each body axis by what the airframe can do, or by airspeed."""
    axis = np.empty(3)
    velocity = state["velocity_ned_m_s"]
    for i in range(3):
        along = 0.0
        for j in range(3):
            axis[j] = state["dcm"][j, i]
            along += axis[j] * velocity[j]
        expected = settings["forward_speed_m_s"][airframe] if i == 0 else 0.0
        sigma = settings["velocity_sigma_m_s"][airframe, i]
        correlation_s = settings["velocity_correlation_s"][airframe, i]
        if i == 0 and _airspeed_is_usable(settings, state, airframe):
            expected = state["airspeed_m_s"]
            sigma, correlation_s = AIRSPEED_SIGMA_M_S, AIRSPEED_CORRELATION_S
        variance = sigma * sigma * max(1.0, correlation_s / dt_s)
        correct_body_velocity(
            state["covariance"], correction, axis, velocity, expected - along, variance
        )


@kernel
def _airspeed_is_usable(settings: Record, state: Record, airframe: int) -> bool:
    fresh = state["time_ns"] - state["airspeed_time_ns"] < AIRSPEED_VALID_NS
    flown = settings["use_airspeed"] != 0 and airframe == _FIXED_WING
    return flown and fresh and state["airspeed_m_s"] > AIRSPEED_MIN_M_S
