"""From sample to sample: attitude and velocity move at once, the covariance once per update.

An update comes about every 120 ms; between updates the integrals that the covariance needs add up,
so a fast IMU costs little more than a slow one.
"""

import math
from typing import Final

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.fusion import mekf, plausibility, strapdown
from ahrs_service.fusion.filter_state import bound_attitude
from ahrs_service.fusion.states import (
    ACCEL_BIAS,
    AIDED,
    ERROR_STATES,
    GATED,
    GYRO_BIAS,
    VELOCITY,
    WIND,
)
from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Flag, Floats, Record
from ahrs_service.rotation import matrix

PROPAGATION_FIELDS: Final = [
    ("update_s", "f8"),
    ("update_rotation_s", "f8", (3, 3)),
    ("delta_velocity_m_s", "f8", 3),
    ("delta_angle_rad", "f8", 3),
    ("update_force_m_s", "f8", 3),
    ("update_force_s", "f8"),
    ("update_angle_variance", "f8"),
    ("update_shake_variance", "f8"),
    ("update_velocity_variance", "f8"),
    ("update_bias_variance", "f8"),
    ("update_degc", "f8"),
    ("rate_rad_s", "f8", 3),
    ("rate_before_rad_s", "f8", 3),
    ("rate_earlier_rad_s", "f8", 3),
    ("smooth_rate_rad_s", "f8", 3),
    ("angular_acceleration_rad_s2", "f8", 3),
    ("force_ned_m_s2", "f8", 3),
    ("accel_before_m_s2", "f8", 3),
    ("force_before_ned_m_s2", "f8", 3),
    ("force_now_ned_m_s2", "f8", 3),
    ("arc_force_m_s2", "f8", 3),
    ("interval_before_s", "f8"),
    ("unobserved_variance", "f8", 3),
]
"""Fields of the pipeline's state that this module keeps."""

UPDATE_S: Final = 0.12
"""Corrections 8 times a second follow what drifts over seconds; shorter updates gain nothing."""
GAP_RATE_SIGMA_RAD_S: Final = 1.0
"""How far a small UAV may have rotated, per second that no sample came [rad/s]."""
GAP_FORCE_SIGMA_M_S2: Final = 3.0
"""And how it may have accelerated [m/s^2]."""
ALIASED: Final = 1.0 / 36.0
"""Of the rate's second differences, squared and summed over the axes, half is assumed to be
aliased vibration: an error of each sample, which this sum has in it 18 times."""
REST_FORCE_CORRELATION_S: Final = 0.1
"""How long a vibration at rest pushes one way [s]."""
WIND_WALK_M_S_RTS: Final = 0.1
"""Wind changes by 2 m/s in some 6 minutes of flight or with 100 m of height [m/s per sqrt(s)]."""
ACCEL_BIAS_WALK: Final = 1e-3
"""Of the accelerometer, by warm-up: 0.02 m/s^2 in some minutes [m/s^2 per sqrt(s)]."""

_GAP = int(Flag.GAP)
_ACCEL_MISSING = int(Flag.ACCEL_MISSING)
_SATURATED = int(Flag.SATURATED)


@inlined_kernel
def move(
    settings: Record,
    state: Record,
    airframe: int,
    gyro: Floats,
    accel: Floats,
    dt_s: float,
    flags: int,
) -> None:
    """Integrate one sample and add it to the integrals of the update.

    The rate between two samples is known to half of what it changed, so a slow or irregular
    stream widens the covariance by itself; so does shake (`ALIASED`).
    """
    before, rate = state["rate_before_rad_s"], state["rate_rad_s"]
    earlier, dcm = state["rate_earlier_rad_s"], state["dcm"]
    unknown2, rate2 = _take_rate(state, gyro, dt_s)
    state["update_angle_variance"] += settings["gyro_scale_error_rts"] ** 2 * rate2 * dt_s
    if flags & _GAP:
        state["update_angle_variance"] += (GAP_RATE_SIGMA_RAD_S * dt_s) ** 2
        state["interval_before_s"] = 0.0
    else:
        state["update_shake_variance"] += unknown2 * dt_s * dt_s
        before_s, is_mean = state["interval_before_s"], settings["samples_are_means"] != 0
        state["interval_before_s"] = dt_s
        strapdown.rotate(state["ned_from_body"], earlier, before, rate, before_s, dt_s, is_mean)
    if flags & _SATURATED:
        _count_unobserved(state, dt_s)
    pull_per_s = 1.0 / (settings["smoothing_s"] + dt_s)
    _smooth_rate(state, rate, pull_per_s, dt_s)
    matrix(state["ned_from_body"], dcm)
    for i in range(3):
        for j in range(3):
            state["update_rotation_s"][i, j] += dcm[i, j] * dt_s
    state["update_s"] += dt_s
    if flags & (_GAP | _ACCEL_MISSING):
        state["update_velocity_variance"] += (GAP_FORCE_SIGMA_M_S2 * dt_s) ** 2
    else:
        norm2 = _average_force(state, accel, pull_per_s * dt_s)
        if settings["use_velocity"] != 0:
            _move_velocity(settings, state, airframe, accel, dt_s, norm2)


@kernel
def _count_unobserved(state: Record, dt_s: float) -> None:
    """Widen the angle about an axis whose rate is not known, and stays so: by time squared."""
    for i in range(3):
        if state["gyro_is_unobserved"][i] != 0:
            grown_s2 = plausibility.count_blind(state, i, dt_s)
            state["unobserved_variance"][i] += GAP_RATE_SIGMA_RAD_S**2 * grown_s2


@inlined_kernel
def _take_rate(state: Record, gyro: Floats, dt_s: float) -> tuple[float, float]:
    """Correct the rate; return the variance of the rate between this and the last, and its square.

    Both summed over the axes, as if one axis had it all.
    """
    before, rate = state["rate_before_rad_s"], state["rate_rad_s"]
    earlier, m = state["rate_earlier_rad_s"], state["gyro_matrix"]
    change2 = bend2 = rate2 = 0.0
    for i in range(3):
        earlier[i] = before[i]
        before[i] = rate[i]
        crossed = m[i, 0] * gyro[0] + m[i, 1] * gyro[1] + m[i, 2] * gyro[2]
        rate[i] = gyro[i] - state["gyro_bias_rad_s"][i] - crossed
        state["delta_angle_rad"][i] += gyro[i] * dt_s
        change = rate[i] - before[i]
        bend = change - (before[i] - earlier[i])
        change2 += change * change
        bend2 += bend * bend
        rate2 += rate[i] * rate[i]
    return change2 * (1.0 / 48.0) + bend2 * ALIASED, rate2


@kernel
def _smooth_rate(state: Record, rate: Floats, pull_per_s: float, dt_s: float) -> None:
    """Follow the smoothed rate and its derivative, which the gates look at."""
    smooth, derivative = state["smooth_rate_rad_s"], state["angular_acceleration_rad_s2"]
    for i in range(3):
        derivative[i] = pull_per_s * (rate[i] - smooth[i])
        smooth[i] += derivative[i] * dt_s


@kernel
def _average_force(state: Record, accel: Floats, weight: float) -> float:
    """Average the force in earth axes, where gravity stands still; return its squared norm."""
    dcm, average, now = state["dcm"], state["force_ned_m_s2"], state["force_now_ned_m_s2"]
    norm2 = 0.0
    for i in range(3):
        now[i] = dcm[i, 0] * accel[0] + dcm[i, 1] * accel[1] + dcm[i, 2] * accel[2]
        norm2 += now[i] * now[i]
        average[i] += weight * (now[i] - average[i])
    return norm2


@inlined_kernel
def _move_velocity(
    settings: Record, state: Record, airframe: int, accel: Floats, dt_s: float, norm2: float
) -> None:
    """Integrate the mean force of the interval: of both its ends, or of two means."""
    dcm, arc = state["dcm"], state["arc_force_m_s2"]
    before, now = state["force_before_ned_m_s2"], state["force_now_ned_m_s2"]
    are_means = settings["samples_are_means"] != 0
    if are_means:
        _follow_arc(state, accel, dt_s, arc)
    shake2 = 0.0
    for i in range(3):
        shake2 += 0.5 * (now[i] - before[i]) ** 2
        if are_means:
            mean = dcm[i, 0] * arc[0] + dcm[i, 1] * arc[1] + dcm[i, 2] * arc[2]
        else:
            mean = 0.5 * (before[i] + now[i])
        before[i] = now[i]
        state["update_force_m_s"][i] += accel[i] * dt_s
        state["delta_velocity_m_s"][i] += mean * dt_s
        state["velocity_ned_m_s"][i] += mean * dt_s
    state["velocity_ned_m_s"][2] += STANDARD_GRAVITY_M_S2 * dt_s
    state["update_force_s"] += dt_s
    state["update_velocity_variance"] += _velocity_noise2(settings, state, airframe, norm2) * dt_s
    bias_walk_rts = settings["shaken_bias_walk_s_m_rts"][airframe]
    state["update_bias_variance"] += bias_walk_rts * bias_walk_rts * shake2 * dt_s


@kernel
def _velocity_noise2(settings: Record, state: Record, airframe: int, norm2: float) -> float:
    """What shakes, and what error of scale, adds to the velocity's variance [m^2/s^3]."""
    if state["at_rest"] != 0:
        return float(state["force_variance"] * REST_FORCE_CORRELATION_S)
    excess = settings["accel_scale_error"][airframe] * (math.sqrt(norm2) - STANDARD_GRAVITY_M_S2)
    return float(settings["velocity_noise_m_s_rts"][airframe] ** 2 + excess * excess)


@kernel
def _follow_arc(state: Record, accel: Floats, dt_s: float, arc: Floats) -> None:
    """Refer the mean force of the interval to the body axes at its end."""
    before = state["accel_before_m_s2"]
    strapdown.mean_force(state["rate_before_rad_s"], state["rate_rad_s"], before, accel, dt_s, arc)
    for i in range(3):
        before[i] = accel[i]


@inlined_kernel
def grow(settings: Record, state: Record, degc: float, is_compensated: bool) -> None:
    """Propagate the covariance over the update.

    `degc` is the sensor's temperature, NaN if unknown; `is_compensated` whether its drift is taken
    away by a calibration, where there is one.
    """
    p, states, update_s = state["covariance"], state["states"], state["update_s"]
    rate = state["delta_angle_rad"]
    state["rotated_rad"] = 0.0
    for i in range(ERROR_STATES):
        state["applied"][i] = state["correction"][i] = 0.0
    for i in range(3):
        rate[i] /= update_s
    rotation_s, impulse = state["update_rotation_s"], state["delta_velocity_m_s"]
    mekf.propagate(p, states, rotation_s, rate, impulse, state["row_sums"])
    # The shake that was seen has the gyro's noise in it.
    noise = max(settings["gyro_noise_rad_s_rthz"] ** 2 * update_s, state["update_shake_variance"])
    angle = noise + state["update_angle_variance"]
    bias = settings["gyro_bias_walk_rad_s2_rthz"] ** 2 * update_s + state["update_bias_variance"]
    per_rtdegc = settings["gyro_bias_per_rtdegc_rad_s"]
    if is_compensated:
        per_rtdegc = settings["compensated_bias_per_rtdegc_rad_s"]
    bias += per_rtdegc**2 * _warmed(state, degc)
    dcm, blind = state["dcm"], state["unobserved_variance"]
    for i in range(3):
        p[i, i] += angle
        if blind[i] > 0.0:
            for j in range(3):
                for k in range(3):
                    p[j, k] += blind[i] * dcm[j, i] * dcm[k, i]
        p[GYRO_BIAS + i, GYRO_BIAS + i] += bias
        if states > GATED:
            p[VELOCITY + i, VELOCITY + i] += state["update_velocity_variance"]
            p[ACCEL_BIAS + i, ACCEL_BIAS + i] += ACCEL_BIAS_WALK**2 * update_s
        if states == AIDED and i < 2:
            p[WIND + i, WIND + i] += WIND_WALK_M_S_RTS**2 * update_s
    bound_attitude(p, states)


@kernel
def _warmed(state: Record, degc: float) -> float:
    """By how much the temperature changed since the last update [degC]."""
    if math.isnan(degc):
        return 0.0
    change = abs(degc - state["update_degc"])
    state["update_degc"] = degc
    return 0.0 if math.isnan(change) else change


@kernel
def first_rate(state: Record, gyro: Floats) -> None:
    """Take a first rate [3] [rad/s], with none before it."""
    for i in range(3):
        state["rate_rad_s"][i] = gyro[i] - state["gyro_bias_rad_s"][i]
        state["smooth_rate_rad_s"][i] = state["rate_rad_s"][i]
    state["interval_before_s"] = 0.0


@kernel
def first_force(state: Record, accel: Floats) -> None:
    """Take a first specific force [3] [m/s^2] at the attitude there is, with none before it."""
    dcm = state["dcm"]
    for i in range(3):
        state["accel_before_m_s2"][i] = accel[i]
        state["force_ned_m_s2"][i] = (
            dcm[i, 0] * accel[0] + dcm[i, 1] * accel[1] + dcm[i, 2] * accel[2]
        )
        state["force_before_ned_m_s2"][i] = state["force_ned_m_s2"][i]


@kernel
def begin_update(state: Record) -> None:
    """Set the update's integrals to zero."""
    state["update_s"] = 0.0
    state["update_angle_variance"] = state["update_shake_variance"] = 0.0
    state["update_velocity_variance"] = 0.0
    state["update_bias_variance"] = 0.0
    state["update_force_s"] = 0.0
    for i in range(3):
        state["unobserved_variance"][i] = 0.0
        state["delta_velocity_m_s"][i] = 0.0
        state["delta_angle_rad"][i] = 0.0
        state["update_force_m_s"][i] = 0.0
        for j in range(3):
            state["update_rotation_s"][i, j] = 0.0
