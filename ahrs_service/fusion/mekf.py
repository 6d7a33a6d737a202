"""The multiplicative error-state Kalman filter (Lefferts, Markley, Shuster 1982).

The error angle psi is about earth axes: q_true = dq(psi) * q. Every measurement is a scalar, taken
one after the other into a correction vector that is moved into the state at the end of an update.
Only the first `states` of the error states are in use; the variances of the others are 0, so that
the loops over many run over 6 or over all, numbers that the compiler knows.
"""

import math
from typing import Final

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
from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Floats, Record
from ahrs_service.rotation import from_rotation_vector, matrix, multiply, normalise

MEKF_FIELDS: Final = [
    ("correction", "f8", ERROR_STATES),
    ("measured", "f8", ERROR_STATES),
    ("gain", "f8", ERROR_STATES),
    ("gains", "f8", (4, ERROR_STATES)),
    ("pending", "i8"),
    ("row_sums", "f8", (3, ERROR_STATES)),
]
"""Fields of the pipeline's state that this module keeps: what an update corrected so far, h of a
measurement h . x, which comes and goes zero, gains whose products the covariance has yet to lose,
as many as are `pending`, zeros else, and room to work in."""


@inlined_kernel
def propagate(
    p: Floats, states: int, rotation_s: Floats, rate: Floats, impulse: Floats, sums: Floats
) -> None:
    """Propagate the covariance `p` [n, n] over an interval, without noise.

    `rotation_s` [3, 3] is the integral of C_nb [s], `rate` [3] the mean measured rate [rad/s],
    `impulse` [3] the integral of the specific force in earth axes [m/s], `sums` [3, n] room:

        psi' = psi - rotation_s (bias + matrix rate)
        v'   = v + psi x impulse - rotation_s accelerometer_bias

    The transition is applied to the rows for all columns; of the columns only where row and column
    change both.
    """
    transition_rows(p, states, rotation_s, rate, impulse, sums)
    if states > GATED:
        for row in range(3):
            _transition_velocity_of_row(p, row, rotation_s, impulse)
        for row in range(VELOCITY, VELOCITY + 3):
            _transition_velocity_of_row(p, row, rotation_s, impulse)
    for row in range(3):
        _transition_angle_of_row(p, row, states, rotation_s, rate)
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


@inlined_kernel
def transition_rows(
    p: Floats, states: int, rotation_s: Floats, rate: Floats, impulse: Floats, sums: Floats
) -> None:
    """Apply the transition to the rows of `p` [n, n] alone: the covariance of after and before."""
    if states > GATED:
        _transition_velocity_rows(p, rotation_s, impulse, sums)
        _transition_angle_rows(p, rotation_s, rate, sums)
    else:
        _transition_gated_rows(p, rotation_s, sums)


# Sums of rows go to `sums` first: only where what is read is not what is written can the compiler
# take several columns at once.


@inlined_kernel
def _transition_velocity_rows(p: Floats, rotation_s: Floats, impulse: Floats, sums: Floats) -> None:
    v, w = VELOCITY, ACCEL_BIAS
    for i in range(3):
        k, m = (i + 1) % 3, (i + 2) % 3
        a, b = impulse[m], -impulse[k]
        d, e, f = rotation_s[i, 0], rotation_s[i, 1], rotation_s[i, 2]
        for j in range(ERROR_STATES):
            sums[i, j] = (a * p[k, j] + b * p[m, j]) - (
                d * p[w, j] + e * p[w + 1, j] + f * p[w + 2, j]
            )
    for i in range(3):
        for j in range(ERROR_STATES):
            p[v + i, j] += sums[i, j]


@inlined_kernel
def _transition_angle_rows(p: Floats, rotation_s: Floats, rate: Floats, sums: Floats) -> None:
    a, b, c = rate[0], rate[1], rate[2]
    for i in range(3):
        n, m = GYRO_BIAS + i, GYRO_MATRIX + 3 * i
        for j in range(ERROR_STATES):
            sums[i, j] = p[n, j] + (a * p[m, j] + b * p[m + 1, j] + c * p[m + 2, j])
    for i in range(3):
        a, b, c = rotation_s[i, 0], rotation_s[i, 1], rotation_s[i, 2]
        for j in range(ERROR_STATES):
            p[i, j] -= a * sums[0, j] + b * sums[1, j] + c * sums[2, j]


@inlined_kernel
def _transition_gated_rows(p: Floats, rotation_s: Floats, sums: Floats) -> None:
    for i in range(3):
        for j in range(GATED):
            sums[i, j] = p[GYRO_BIAS + i, j]
    for i in range(3):
        a, b, c = rotation_s[i, 0], rotation_s[i, 1], rotation_s[i, 2]
        for j in range(GATED):
            p[i, j] -= a * sums[0, j] + b * sums[1, j] + c * sums[2, j]


@inlined_kernel
def _transition_velocity_of_row(p: Floats, n: int, rotation_s: Floats, impulse: Floats) -> None:
    """Apply the transition to the velocity in row `n`, by its angle before."""
    x, y, z = p[n, 0], p[n, 1], p[n, 2]
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


@inlined_kernel
def _transition_angle_of_row(
    p: Floats, n: int, states: int, rotation_s: Floats, rate: Floats
) -> None:
    """Apply the transition to the angle in row `n`."""
    a, b, c = p[n, GYRO_BIAS], p[n, GYRO_BIAS + 1], p[n, GYRO_BIAS + 2]
    if states > GATED:
        u, v, w = rate[0], rate[1], rate[2]
        m = GYRO_MATRIX
        a += u * p[n, m] + v * p[n, m + 1] + w * p[n, m + 2]
        b += u * p[n, m + 3] + v * p[n, m + 4] + w * p[n, m + 5]
        c += u * p[n, m + 6] + v * p[n, m + 7] + w * p[n, m + 8]
    p[n, 0] -= rotation_s[0, 0] * a + rotation_s[0, 1] * b + rotation_s[0, 2] * c
    p[n, 1] -= rotation_s[1, 0] * a + rotation_s[1, 1] * b + rotation_s[1, 2] * c
    p[n, 2] -= rotation_s[2, 0] * a + rotation_s[2, 1] * b + rotation_s[2, 2] * c


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
def correct(state: Record, innovation: float, variance: float) -> None:
    """Measure h . x of the state's `measured` h [n], `innovation` by the state as it was.

    h is looked at by threes, so one of few parts costs little.
    """
    p, h, ph, g = state["covariance"], state["measured"], state["gain"], state["gains"]
    states, correction = state["states"], state["correction"]
    a = b = c = 0.0
    for i in range(ERROR_STATES):
        ph[i] = 0.0
    for j in range(0, states, 3):
        x, y, z = h[j], h[j + 1], h[j + 2]
        if x != 0.0 or y != 0.0 or z != 0.0:
            for i in range(states):
                ph[i] += x * p[j, i] + y * p[j + 1, i] + z * p[j + 2, i]
            innovation -= x * correction[j] + y * correction[j + 1] + z * correction[j + 2]
            a += x * g[0, j] + y * g[0, j + 1] + z * g[0, j + 2]
            b += x * g[1, j] + y * g[1, j + 1] + z * g[1, j + 2]
            c += x * g[2, j] + y * g[2, j + 1] + z * g[2, j + 2]
    _lose_pending(state, a, b, c)
    for j in range(0, states, 3):
        x, y, z = h[j], h[j + 1], h[j + 2]
        if x != 0.0 or y != 0.0 or z != 0.0:
            variance += x * ph[j] + y * ph[j + 1] + z * ph[j + 2]
    _take(state, innovation, variance)


@kernel
def correct_state(state: Record, which: int, measured: float, variance: float) -> None:
    """Measure one error state directly."""
    p, ph, g = state["covariance"], state["gain"], state["gains"]
    for i in range(ERROR_STATES):
        ph[i] = p[which, i]
    _lose_pending(state, g[0, which], g[1, which], g[2, which])
    _take(state, measured - state["correction"][which], ph[which] + variance)


@kernel
def _lose_pending(state: Record, a: float, b: float, c: float) -> None:
    """Take from `gain` what the covariance has yet to lose; fewer than four are pending."""
    ph, g = state["gain"], state["gains"]
    if state["pending"] > 0:
        for i in range(ERROR_STATES):
            ph[i] -= a * g[0, i] + b * g[1, i] + c * g[2, i]


@kernel
def _take(state: Record, innovation: float, variance: float) -> None:
    """Take one innovation of `variance`, `gain` [n] being P h, into correction and covariance."""
    p, ph, g, correction = state["covariance"], state["gain"], state["gains"], state["correction"]
    # Scaled by the root, row i times column j is the product of j times i to the last bit.
    scale = 1.0 / math.sqrt(variance)
    step = innovation * scale
    if state["states"] == GATED:
        for i in range(GATED):
            ph[i] *= scale
            correction[i] += ph[i] * step
        for i in range(GATED):
            for j in range(GATED):
                p[i, j] -= ph[i] * ph[j]
        return
    n = state["pending"]
    for i in range(ERROR_STATES):
        ph[i] *= scale
        g[n, i] = ph[i]
        correction[i] += ph[i] * step
    state["pending"] = n + 1
    if n == 3:
        settle(state)


@kernel
def settle(state: Record) -> None:
    """Take from the covariance the products of the pending gains: four at once, read once."""
    if state["pending"] == 0:
        return
    p, g = state["covariance"], state["gains"]
    for i in range(ERROR_STATES):
        a, b, c, d = g[0, i], g[1, i], g[2, i], g[3, i]
        for j in range(ERROR_STATES):
            p[i, j] -= a * g[0, j] + b * g[1, j] + c * g[2, j] + d * g[3, j]
    for k in range(4):
        for i in range(ERROR_STATES):
            g[k, i] = 0.0
    state["pending"] = 0


@kernel
def variance_of(state: Record, which: int) -> float:
    """Variance of one error state, all that was measured taken into account."""
    g = state["gains"]
    pending = g[0, which] ** 2 + g[1, which] ** 2 + g[2, which] ** 2
    return float(state["covariance"][which, which] - pending)


@kernel
def correct_tilt(state: Record, axis: int, variance: float) -> None:
    """Measure the error angle about north (0) or east (1) by gravity.

    What the accelerometer's bias adds: -(C b)_E / g about north, (C b)_N / g about east.
    """
    dcm, h = state["dcm"], state["measured"]
    h[axis] = 1.0
    for i in range(3):
        bias = -dcm[1, i] if axis == 0 else dcm[0, i]
        h[ACCEL_BIAS + i] = bias / STANDARD_GRAVITY_M_S2
    correct(state, state["tilt_innovation_rad"][axis], variance)
    h[axis] = 0.0
    h[ACCEL_BIAS] = h[ACCEL_BIAS + 1] = h[ACCEL_BIAS + 2] = 0.0


@inlined_kernel
def apply_correction(state: Record) -> None:
    """Move the correction into the state; the averaged force rotates with the attitude."""
    correction = state["correction"]
    for i in range(ERROR_STATES):
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
        state["delta_velocity_m_s"][i] += added
        state["accel_bias_m_s2"][i] += correction[ACCEL_BIAS + i]
        for j in range(3):
            state["gyro_matrix"][i, j] += correction[GYRO_MATRIX + 3 * i + j]
    state["wind_ned_m_s"][0] += correction[WIND]
    state["wind_ned_m_s"][1] += correction[WIND + 1]
    state["velocity_lag_s"] += correction[LAG]


@kernel
def rotate_about_down(state: Record, angle_rad: float) -> None:
    """Rotate all that is given in earth axes: attitude, velocity, force and their covariance."""
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
    v = state["history_m_s"]
    for n in range(v.shape[1]):
        v[0, n], v[1, n] = c * v[0, n] - s * v[1, n], s * v[0, n] + c * v[1, n]
    state["rotated_rad"] += angle_rad
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
