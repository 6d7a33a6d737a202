"""Rest: neither rotation nor vibration means that the vehicle stands, and its gyro shows bias."""

import math
from typing import Final

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.fusion import filter_state, ground_velocity, mekf
from ahrs_service.fusion.states import AIDED, GYRO_BIAS, VELOCITY
from ahrs_service.fusion.velocity_constraints import airspeed_is_fresh
from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Floats, Record

REST_FIELDS: Final = [
    ("mean_rate_rad_s", "f8", 3),
    ("mean_force_m_s2", "f8", 3),
    ("rate_variance", "f8"),
    ("force_variance", "f8"),
    ("rest_s", "f8"),
    ("at_rest", "i8"),
]
"""Fields of the pipeline's state that this module keeps."""

AVERAGE_S: Final = 0.5
"""A choice: memory of the means and variances of rate and force [s]."""
CONFIRM_S: Final = 1.0
"""A choice: two AVERAGE_S, by when a spread of before is forgotten to 0.14 (e^-2) [s]."""
FORCE_SIGMA_M_S2: Final = 0.2
"""An idle engine or a hand on the wing shake more than this [m/s^2]."""
RATE_RAD_S: Final = 0.1
"""A choice: 6 deg/s, freed of bias; alignment.REST_RATE_RAD_S has the bias still in it."""
FORCE_ERROR_M_S2: Final = 1.2
"""No accelerometer's error is larger: force_scale.LARGEST of g, 1.18, rounded up [m/s^2]."""
MOVING_AIRSPEED_M_S: Final = 6.0
"""Gusts on a pitot tube of a standing vehicle stay below this [m/s]."""
MOVING_SPEED_M_S: Final = 2.0
"""And the noise of a velocity by satellites below this [m/s]."""
MOVING_SIGMA: Final = 3.0
"""Noise exceeds it in 0.27 % of cases, each axis [1]."""
BRAKING_M_S2: Final = 0.1
"""What an accelerometer and a floor may show of a tilt that was not there in motion [m/s^2]."""
STILL_S: Final = 20.0
"""Nothing flies so long without a shake, whatever velocity is thought [s]."""
VELOCITY_SIGMA_M_S: Final = 0.1
"""A choice, with the next: how far from 0 a vibrating vehicle at rest moves [m/s],"""
VELOCITY_CORRELATION_S: Final = 0.1
"""for so long one way; as propagation.REST_FORCE_CORRELATION_S [s]."""
FORCE_FLOOR_M_S2: Final = 0.02
"""A choice: 2 mg, 0.12 deg of tilt, however quiet it is [m/s^2]."""
FORCE_CORRELATION_S: Final = 0.4
"""The averaged force forgets over this [s]."""
RATE_CORRELATION_S: Final = 0.2
"""A choice, below AVERAGE_S, over which the mean rate forgets [s]."""
BIAS_GATE: Final = 3.0
"""Noise exceeds it in 0.27 % of cases; not MOVING_SIGMA: one judges motion, one a bias."""
BIAS_FLOOR_RAD_S: Final = 0.01
"""A bias may step by this between power-on and flight and is still learnt [rad/s]."""
START_DOUBT_M2_S4: Final = 7.4 * FORCE_SIGMA_M_S2**2
"""Variance of the force before any is known: forgotten to that of rest after two averages."""
LONG_REST_S: Final = 5.0
"""After so much stillness a rate is a bias that has stepped, however well it was known [s]."""


@kernel
def start(state: Record, accel: Floats) -> None:
    """Begin the average of the force with the first one, and with the doubt of having no other."""
    for i in range(3):
        state["mean_force_m_s2"][i] = accel[i]
    state["force_variance"] = START_DOUBT_M2_S4


@kernel
def break_off(state: Record) -> None:
    """Count a rest anew: nobody saw what happened over a gap."""
    state["rest_s"] = 0.0


@kernel
def rescale_force(state: Record, factor: float) -> None:
    """Scale the mean force as all that is measured from here on."""
    for i in range(3):
        state["mean_force_m_s2"][i] *= factor


@inlined_kernel
def follow(state: Record, gyro: Floats, accel: Floats, dt_s: float, rate_sigma: float) -> None:
    """Follow mean and variance of rate and force; `rest_s` is how long all were those of rest."""
    weight = dt_s / (AVERAGE_S + dt_s)
    rate2 = force2 = spread_rate2 = spread_force2 = 0.0
    for i in range(3):
        state["mean_rate_rad_s"][i] += weight * (gyro[i] - state["mean_rate_rad_s"][i])
        state["mean_force_m_s2"][i] += weight * (accel[i] - state["mean_force_m_s2"][i])
        spread_rate2 += (gyro[i] - state["mean_rate_rad_s"][i]) ** 2
        spread_force2 += (accel[i] - state["mean_force_m_s2"][i]) ** 2
        rate2 += state["rate_rad_s"][i] ** 2
        force2 += state["mean_force_m_s2"][i] ** 2
    state["rate_variance"] += weight * (spread_rate2 - state["rate_variance"])
    state["force_variance"] += weight * (spread_force2 - state["force_variance"])
    still = (
        state["rate_variance"] < rate_sigma * rate_sigma
        and state["force_variance"] < FORCE_SIGMA_M_S2**2
        and rate2 < RATE_RAD_S**2
        and abs(math.sqrt(force2) - STANDARD_GRAVITY_M_S2) < FORCE_ERROR_M_S2
    )
    state["rest_s"] = state["rest_s"] + dt_s if still else 0.0


@inlined_kernel
def come_to_rest(state: Record) -> bool:
    """Return whether the vehicle is at rest; a change of that brings the wind into the velocity.

    Velocity is that over ground at rest and through the air in flight; the wind lies between.
    """
    at_rest = state["rest_s"] > CONFIRM_S and not _moves(state)
    if at_rest != (state["at_rest"] != 0):
        state["at_rest"] = 1 if at_rest else 0
        if state["states"] != AIDED:
            for i in range(2):
                filter_state.widen(state, VELOCITY + i, ground_velocity.WIND_SIGMA_M_S**2)
    return bool(at_rest)


@kernel
def _moves(state: Record) -> bool:
    """Return whether a speed is measured or known that no vehicle at rest has."""
    if airspeed_is_fresh(state) and state["airspeed_m_s"] > MOVING_AIRSPEED_M_S:
        return True
    if ground_velocity.is_fresh(state) and state["states"] == AIDED:
        measured = state["measured_velocity_m_s"]
        if measured[0] * measured[0] + measured[1] * measured[1] > MOVING_SPEED_M_S**2:
            return True
    if state["rest_s"] > STILL_S:
        return False
    tilt, force_sigma = state["tilt_innovation_rad"], BRAKING_M_S2 / STANDARD_GRAVITY_M_S2
    variance = mekf.tilt_variance(state["covariance"]) + force_sigma * force_sigma
    if tilt[0] * tilt[0] + tilt[1] * tilt[1] > MOVING_SIGMA * MOVING_SIGMA * variance:
        return True
    for i in range(3):
        velocity = state["velocity_ned_m_s"][i]
        variance = state["covariance"][VELOCITY + i, VELOCITY + i]
        if velocity * velocity > MOVING_SIGMA**2 * variance:
            return True
    return False


@kernel
def doubt_bias(state: Record, dt_s: float) -> None:
    """Let the bias be uncertain again where a long rest shows another."""
    if state["rest_s"] <= LONG_REST_S:
        return
    for i in range(3):
        n = GYRO_BIAS + i
        rate = state["mean_rate_rad_s"][i] - state["gyro_bias_rad_s"][i]
        if rate * rate > BIAS_GATE**2 * state["covariance"][n, n]:
            filter_state.widen(state, n, rate * rate / BIAS_GATE**2 * dt_s)


@kernel
def hold(state: Record, dt_s: float, rate_sigma: float) -> None:
    """Measure velocity 0, the tilt by the force, and the gyro's bias.

    Velocity 0 along an earth axis a is a . v = 0 whatever the heading: h = (a x v, a).
    """
    h, velocity = state["measured"], state["velocity_ned_m_s"]
    variance = VELOCITY_SIGMA_M_S**2 * max(1.0, VELOCITY_CORRELATION_S / dt_s)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        h[VELOCITY + i] = 1.0
        h[j], h[k] = -velocity[k], velocity[j]
        mekf.correct(state, -velocity[i], variance)
        h[VELOCITY + i] = h[j] = h[k] = 0.0
    force2 = state["force_variance"] / 3.0 + FORCE_FLOOR_M_S2**2
    variance = force2 / STANDARD_GRAVITY_M_S2**2 * max(1.0, FORCE_CORRELATION_S / dt_s)
    for axis in range(2):
        mekf.correct_tilt(state, axis, variance)
    variance = rate_sigma * rate_sigma * max(1.0, RATE_CORRELATION_S / dt_s)
    for i in range(3):
        n = GYRO_BIAS + i
        rate = state["mean_rate_rad_s"][i] - state["gyro_bias_rad_s"][i]
        if rate * rate < BIAS_GATE**2 * (mekf.variance_of(state, n) + BIAS_FLOOR_RAD_S**2):
            mekf.correct_state(state, n, rate, variance)
