"""The multiplicative error-state Kalman filter (Lefferts, Markley, Shuster 1982).

The error angle psi is about earth axes: q_true = dq(psi) * q. Every measurement is a scalar, taken
one after the other into a correction vector that is moved into the state at the end of a turn.
Only the first `states` of the error states are in use; that number is a multiple of 3.
"""

import math

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.fusion.states import (
    ACCEL_BIAS,
    ANGLE,
    ERROR_STATES,
    GATED,
    GYRO_BIAS,
    GYRO_MATRIX,
    LAG,
    VELOCITY,
    WIND,
)
from ahrs_service.kernel import kernel
from ahrs_service.records import Floats, Record
from ahrs_service.rotation import from_rotation_vector, matrix, multiply, normalise


@kernel
def propagate(p: Floats, states: int, rotation_s: Floats, rate: Floats, impulse: Floats) -> None:
    """Propagate the covariance `p` [n, n] over an interval, without noise.

    `rotation_s` [3, 3] is the integral of C_nb [s], `rate` [3] the mean measured rate [rad/s],
    `impulse` [3] the integral of the specific force in earth axes [m/s]:

        psi' = psi - rotation_s (bias + matrix rate)
        v'   = v + psi x impulse - rotation_s accelerometer_bias

    The rows are turned for all columns; of the columns only where row and column change both.
    """
    turn_rows(p, states, rotation_s, rate, impulse)
    for row in range(3):
        _turn_row(p, row, states, rotation_s, rate, impulse)
    if states > GATED:
        for row in range(VELOCITY, VELOCITY + 3):
            _turn_row(p, row, states, rotation_s, rate, impulse)
    for row in range(3):
        for j in range(row):
            p[row, j] = p[j, row]
        for j in range(3, states):
            p[j, row] = p[row, j]
    if states > GATED:
        for row in range(VELOCITY, VELOCITY + 3):
            for j in range(GYRO_BIAS, VELOCITY):
                p[j, row] = p[row, j]
            for j in range(row + 1, states):
                p[j, row] = p[row, j]


@kernel
def turn_rows(p: Floats, states: int, rotation_s: Floats, rate: Floats, impulse: Floats) -> None:
    """Apply the transition to the rows of `p` [n, n] alone: the covariance of after and before."""
    turned = np.empty((3, ERROR_STATES))
    if states > GATED:
        _turn_velocity_rows(p, states, rotation_s, impulse, turned)
    _turn_angle_rows(p, states, rotation_s, rate, turned)


# Sums of rows go to `turned` first: only where what is read is not what is written can the compiler
# take several columns at once.


@kernel
def _turn_velocity_rows(
    p: Floats, states: int, rotation_s: Floats, impulse: Floats, turned: Floats
) -> None:
    v, w = VELOCITY, ACCEL_BIAS
    for i in range(3):
        k, m = (i + 1) % 3, (i + 2) % 3
        a, b = impulse[m], -impulse[k]
        d, e, f = rotation_s[i, 0], rotation_s[i, 1], rotation_s[i, 2]
        for j in range(states):
            turned[i, j] = (a * p[k, j] + b * p[m, j]) - (
                d * p[w, j] + e * p[w + 1, j] + f * p[w + 2, j]
            )
    for i in range(3):
        for j in range(states):
            p[v + i, j] += turned[i, j]


@kernel
def _turn_angle_rows(
    p: Floats, states: int, rotation_s: Floats, rate: Floats, turned: Floats
) -> None:
    a, b, c = rate[0], rate[1], rate[2]
    for i in range(3):
        n, m = GYRO_BIAS + i, GYRO_MATRIX + 3 * i
        if states > GATED:
            for j in range(states):
                turned[i, j] = p[n, j] + (a * p[m, j] + b * p[m + 1, j] + c * p[m + 2, j])
        else:
            for j in range(states):
                turned[i, j] = p[n, j]
    for i in range(3):
        a, b, c = rotation_s[i, 0], rotation_s[i, 1], rotation_s[i, 2]
        for j in range(states):
            p[i, j] -= a * turned[0, j] + b * turned[1, j] + c * turned[2, j]


@kernel
def _turn_row(
    p: Floats, n: int, states: int, rotation_s: Floats, rate: Floats, impulse: Floats
) -> None:
    """Apply the transition to row `n`; velocity first, by the angle before."""
    x, y, z = p[n, 0], p[n, 1], p[n, 2]
    a, b, c = p[n, GYRO_BIAS], p[n, GYRO_BIAS + 1], p[n, GYRO_BIAS + 2]
    if states > GATED:
        u, v, w = p[n, ACCEL_BIAS], p[n, ACCEL_BIAS + 1], p[n, ACCEL_BIAS + 2]
        p[n, VELOCITY] += (y * impulse[2] - z * impulse[1]) - (
            rotation_s[0, 0] * u + rotation_s[0, 1] * v + rotation_s[0, 2] * w
        )
        p[n, VELOCITY + 1] += (z * impulse[0] - x * impulse[2]) - (
            rotation_s[1, 0] * u + rotation_s[1, 1] * v + rotation_s[1, 2] * w
        )
        p[n, VELOCITY + 2] += (x * impulse[1] - y * impulse[0]) - (
            rotation_s[2, 0] * u + rotation_s[2, 1] * v + rotation_s[2, 2] * w
        )
        u, v, w = rate[0], rate[1], rate[2]
        m = GYRO_MATRIX
        a += u * p[n, m] + v * p[n, m + 1] + w * p[n, m + 2]
        b += u * p[n, m + 3] + v * p[n, m + 4] + w * p[n, m + 5]
        c += u * p[n, m + 6] + v * p[n, m + 7] + w * p[n, m + 8]
    p[n, 0] = x - (rotation_s[0, 0] * a + rotation_s[0, 1] * b + rotation_s[0, 2] * c)
    p[n, 1] = y - (rotation_s[1, 0] * a + rotation_s[1, 1] * b + rotation_s[1, 2] * c)
    p[n, 2] = z - (rotation_s[2, 0] * a + rotation_s[2, 1] * b + rotation_s[2, 2] * c)


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
def tilt_variance(p: Floats) -> float:
    """Larger principal variance of the tilt [rad^2]; it does not depend on where north is."""
    half, cross = 0.5 * (p[0, 0] - p[1, 1]), p[0, 1]
    return p[1, 1] + half + math.sqrt(half * half + cross * cross)


@kernel
def correct(
    p: Floats, correction: Floats, states: int, h: Floats, innovation: float, variance: float
) -> None:
    """Measure h . x, `innovation` by the state as it was.

    `h` [n] is looked at by threes, so one of few parts costs little.
    """
    ph = np.zeros(ERROR_STATES)
    for j in range(0, states, 3):
        x, y, z = h[j], h[j + 1], h[j + 2]
        if x != 0.0 or y != 0.0 or z != 0.0:
            for i in range(states):
                ph[i] += x * p[j, i] + y * p[j + 1, i] + z * p[j + 2, i]
            innovation -= x * correction[j] + y * correction[j + 1] + z * correction[j + 2]
    for j in range(states):
        variance += h[j] * ph[j]
    _take(p, correction, states, ph, innovation, variance)


@kernel
def correct_state(
    p: Floats, correction: Floats, states: int, state: int, measured: float, variance: float
) -> None:
    """Measure one error state directly."""
    ph = np.zeros(ERROR_STATES)
    for i in range(states):
        ph[i] = p[state, i]
    _take(p, correction, states, ph, measured - correction[state], p[state, state] + variance)


@kernel
def _take(
    p: Floats, correction: Floats, states: int, ph: Floats, innovation: float, variance: float
) -> None:
    """Take one innovation of `variance`, `ph` [n] being P h, into correction and covariance."""
    # Scaled by the root, row i times column j is the product of j times i to the last bit.
    scale = 1.0 / math.sqrt(variance)
    for i in range(states):
        ph[i] *= scale
    for i in range(states):
        x = ph[i]
        correction[i] += x * (scale * innovation)
        for j in range(states):
            p[i, j] -= x * ph[j]


@kernel
def correct_tilt(state: Record, correction: Floats, h: Floats, axis: int, variance: float) -> None:
    """Measure the error angle about north (0) or east (1) by gravity; `h` [n] comes and goes zero.

    What the accelerometer's bias adds: -(C b)_E / g about north, (C b)_N / g about east.
    """
    dcm = state["dcm"]
    h[axis] = 1.0
    for i in range(3):
        bias = -dcm[1, i] if axis == 0 else dcm[0, i]
        h[ACCEL_BIAS + i] = bias / STANDARD_GRAVITY_M_S2
    measured = state["tilt_innovation_rad"][axis]
    correct(state["covariance"], correction, state["states"], h, measured, variance)
    h[axis] = 0.0
    h[ACCEL_BIAS] = h[ACCEL_BIAS + 1] = h[ACCEL_BIAS + 2] = 0.0


@kernel
def apply_correction(state: Record, correction: Floats) -> None:
    """Move the correction into the state; the averaged force turns with the attitude."""
    for i in range(state["states"]):
        state["applied"][i] += correction[i]
    x, y, z = correction[0], correction[1], correction[2]
    multiply(from_rotation_vector(x, y, z), state["ned_from_body"], state["ned_from_body"])
    normalise(state["ned_from_body"])
    matrix(state["ned_from_body"], state["dcm"])
    force = state["force_ned_m_s2"]
    a, b, c = force[0], force[1], force[2]
    force[0] = a + y * c - z * b
    force[1] = b + z * a - x * c
    force[2] = c + x * b - y * a
    for i in range(3):
        state["gyro_bias_rad_s"][i] += correction[GYRO_BIAS + i]
    if state["states"] == GATED:
        return
    for i in range(3):
        added = correction[VELOCITY + i]
        state["velocity_ned_m_s"][i] += added
        # The velocity that a correction adds turns with the attitude as that of an impulse does
        # (the error state of an invariant filter: Barrau, Bonnabel 2017).
        state["turn_impulse_m_s"][i] += added
        state["accel_bias_m_s2"][i] += correction[ACCEL_BIAS + i]
        for j in range(3):
            state["gyro_matrix"][i, j] += correction[GYRO_MATRIX + 3 * i + j]
    state["wind_ned_m_s"][0] += correction[WIND]
    state["wind_ned_m_s"][1] += correction[WIND + 1]
    state["velocity_lag_s"] += correction[LAG]


@kernel
def turn_about_down(state: Record, angle_rad: float) -> None:
    """Turn all that is told in earth axes: attitude, velocity, force and their covariance."""
    q, c, s = state["ned_from_body"], math.cos(angle_rad), math.sin(angle_rad)
    multiply(from_rotation_vector(0.0, 0.0, angle_rad), q, q)
    normalise(q)
    matrix(q, state["dcm"])
    for vector in (
        state["velocity_ned_m_s"],
        state["wind_ned_m_s"],
        state["force_ned_m_s2"],
        state["force_before_ned_m_s2"],
    ):
        vector[0], vector[1] = c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]
    for n in range(len(state["history_m_s"])):
        v = state["history_m_s"][n]
        v[0], v[1] = c * v[0] - s * v[1], s * v[0] + c * v[1]
    state["turned_rad"] += angle_rad
    p, applied = state["covariance"], state["applied"]
    for k in (ANGLE, VELOCITY, WIND):
        x, y = applied[k], applied[k + 1]
        applied[k], applied[k + 1] = c * x - s * y, s * x + c * y
        for i in range(ERROR_STATES):
            p[k, i], p[k + 1, i] = c * p[k, i] - s * p[k + 1, i], s * p[k, i] + c * p[k + 1, i]
        for i in range(ERROR_STATES):
            p[i, k], p[i, k + 1] = c * p[i, k] - s * p[i, k + 1], s * p[i, k] + c * p[i, k + 1]


@kernel
def forget(p: Floats, state: int, variance: float) -> None:
    """Set one error state to `variance`, independent of all others."""
    for i in range(ERROR_STATES):
        p[state, i] = p[i, state] = 0.0
    p[state, state] = variance
