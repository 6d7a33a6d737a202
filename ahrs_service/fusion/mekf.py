"""The multiplicative error-state Kalman filter's corrections (Lefferts, Markley, Shuster 1982).

The error angle psi is about earth axes: q_true = dq(psi) * q. Every measurement is a scalar, taken
one after the other into a correction vector that is moved into the state at the end of a turn.
"""

import math

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.fusion.strapdown import ERROR_STATES
from ahrs_service.kernel import kernel
from ahrs_service.records import Floats
from ahrs_service.rotation import from_rotation_vector, multiply, normalise


@kernel
def tilt_from_force(force_ned: Floats, tilt: Floats) -> None:
    """Error angle about north and east [rad] that explains `force_ned` [3] by gravity alone.

    To first order the force reads psi_E g north and -psi_N g east. `tilt` [2] is exact for large
    angles: the angle between the force and up, about the axis normal to both.
    """
    north, east, up = force_ned[0], force_ned[1], -force_ned[2]
    horizontal = math.sqrt(north * north + east * east)
    if horizontal > 0.0:
        scale = math.atan2(horizontal, up) / horizontal
    else:
        scale = 1.0 / STANDARD_GRAVITY_M_S2
    tilt[0] = -scale * east
    tilt[1] = scale * north


@kernel
def _correct(p: Floats, correction: Floats, states: int, ph: Floats, s: float, innovation: float) -> None:
    """Take one scalar innovation of variance `s`, `ph` being P h, into both."""
    scale = 1.0 / s
    for i in range(states):
        a = ph[i]
        correction[i] += a * scale * innovation
        for j in range(states):
            # In this order the product is the same for (i, j) and (j, i).
            p[i, j] -= (a * ph[j]) * scale


@kernel
def correct_state(
    p: Floats, correction: Floats, states: int, state: int, measured: float, variance: float
) -> None:
    """Measure one error state directly."""
    ph = np.empty(ERROR_STATES)
    for i in range(states):
        ph[i] = p[i, state]
    _correct(p, correction, states, ph, p[state, state] + variance, measured - correction[state])


@kernel
def correct_by(
    p: Floats, correction: Floats, states: int, h: Floats, innovation: float, variance: float, limit: float
) -> float:
    """Measure h . x; return the normalised innovation squared. Beyond `limit` sigmas the variance is widened to that."""
    ph = np.zeros(ERROR_STATES)
    expected = 0.0
    for j in range(states):
        if h[j] != 0.0:
            expected += h[j] * correction[j]
            for i in range(states):
                ph[i] += p[j, i] * h[j]
    s = variance
    for j in range(states):
        s += h[j] * ph[j]
    nu = innovation - expected
    nis = nu * nu / s
    if nis > limit * limit:
        s = max(s, abs(nu) / limit * math.sqrt(s))
    _correct(p, correction, states, ph, s, nu)
    return nis


@kernel
def correct_body_velocity(
    p: Floats,
    correction: Floats,
    states: int,
    axis: Floats,
    velocity: Floats,
    innovation_m_s: float,
    variance: float,
    drag_s: float,
    number: int,
    limit: float,
) -> float:
    """Measure the air velocity along one body axis, `axis` [3] being that axis in earth axes.

    v_body = axis . (v - wind), so h = (axis x v, 0, axis) for the error states (psi, bias, velocity).
    Where drag tells it, v = -T f, accelerometer bias comes in by T.
    """
    h = np.zeros(ERROR_STATES)
    h[0] = axis[1] * velocity[2] - axis[2] * velocity[1]
    h[1] = axis[2] * velocity[0] - axis[0] * velocity[2]
    h[2] = axis[0] * velocity[1] - axis[1] * velocity[0]
    for i in range(3):
        h[6 + i] = axis[i]
    if states > 9:
        # measured -T (f + ba) = v  ->  innovation = v - v_est  - T dba
        h[9 + number] = -drag_s
    if states > 21:
        h[21] = -axis[0]
        h[22] = -axis[1]
    return correct_by(p, correction, states, h, innovation_m_s, variance, limit)


@kernel
def correct_tilt(p: Floats, correction: Floats, states: int, dcm: Floats, axis: int, measured: float, variance: float) -> None:
    """Measure the error angle about north (0) or east (1) by gravity, accelerometer bias included."""
    h = np.zeros(ERROR_STATES)
    h[axis] = 1.0
    if states > 9:
        for i in range(3):
            h[9 + i] = (-dcm[1, i] if axis == 0 else dcm[0, i]) / STANDARD_GRAVITY_M_S2
    correct_by(p, correction, states, h, measured, variance, 1e9)


@kernel
def apply_correction(state, states: int, correction: Floats
) -> None:
    """Move the correction into the state; the averaged force [3] turns with the attitude."""
    x, y, z = correction[0], correction[1], correction[2]
    q = state["ned_from_body"]
    multiply(from_rotation_vector(x, y, z), q, q)
    normalise(q)
    force_ned = state["force_ned_m_s2"]
    a, b, c = force_ned[0], force_ned[1], force_ned[2]
    force_ned[0] = a + y * c - z * b
    force_ned[1] = b + z * a - x * c
    force_ned[2] = c + x * b - y * a
    for i in range(3):
        state["gyro_bias_rad_s"][i] += correction[3 + i]
        state["velocity_ned_m_s"][i] += correction[6 + i]
        state["accel_bias_m_s2"][i] += correction[9 + i]
        for j in range(3):
            state["gyro_matrix"][i, j] += correction[12 + 3 * i + j]
    state["wind_m_s"][0] += correction[21]
    state["wind_m_s"][1] += correction[22]
    state["lag_s"] = min(max(state["lag_s"] + correction[23], 1e-6), 1.0)
