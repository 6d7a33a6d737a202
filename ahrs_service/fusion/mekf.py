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
def tilt_variance(p: Floats) -> float:
    """Larger principal variance of the tilt [rad^2]; it does not depend on where north is."""
    half, cross = 0.5 * (p[0, 0] - p[1, 1]), p[0, 1]
    return p[1, 1] + half + math.sqrt(half * half + cross * cross)


@kernel
def _correct(p: Floats, correction: Floats, ph: Floats, s: float, innovation: float) -> None:
    """Take one scalar innovation of variance `s`, `ph` [9] being P h, into both."""
    for i in range(ERROR_STATES):
        gain = ph[i] / s
        correction[i] += gain * innovation
        for j in range(i, ERROR_STATES):
            p[i, j] -= gain * ph[j]
            p[j, i] = p[i, j]


@kernel
def correct_state(
    p: Floats, correction: Floats, state: int, measured: float, variance: float
) -> None:
    """Measure one error state directly."""
    ph = np.empty(ERROR_STATES)
    for i in range(ERROR_STATES):
        ph[i] = p[i, state]
    _correct(p, correction, ph, p[state, state] + variance, measured - correction[state])


@kernel
def correct_body_velocity(
    p: Floats,
    correction: Floats,
    axis: Floats,
    velocity: Floats,
    innovation_m_s: float,
    variance: float,
) -> None:
    """Measure the velocity along one body axis, `axis` [3] being that axis in earth axes.

    v_body = axis . v, so h = (axis x v, 0, axis) for the error states (psi, bias, velocity).
    """
    h = np.empty(ERROR_STATES)
    h[0] = axis[1] * velocity[2] - axis[2] * velocity[1]
    h[1] = axis[2] * velocity[0] - axis[0] * velocity[2]
    h[2] = axis[0] * velocity[1] - axis[1] * velocity[0]
    for i in range(3):
        h[3 + i] = 0.0
        h[6 + i] = axis[i]
    ph = np.empty(ERROR_STATES)
    s, expected = variance, 0.0
    for i in range(ERROR_STATES):
        ph[i] = 0.0
        for j in range(3):
            ph[i] += p[i, j] * h[j] + p[i, 6 + j] * h[6 + j]
        s += h[i] * ph[i]
        expected += h[i] * correction[i]
    _correct(p, correction, ph, s, innovation_m_s - expected)


@kernel
def apply_correction(
    q: Floats, gyro_bias: Floats, velocity: Floats, force_ned: Floats, correction: Floats
) -> None:
    """Move the correction [9] into the state; the averaged force [3] turns with the attitude."""
    x, y, z = correction[0], correction[1], correction[2]
    multiply(from_rotation_vector(x, y, z), q, q)
    normalise(q)
    a, b, c = force_ned[0], force_ned[1], force_ned[2]
    force_ned[0] = a + y * c - z * b
    force_ned[1] = b + z * a - x * c
    force_ned[2] = c + x * b - y * a
    for i in range(3):
        gyro_bias[i] += correction[3 + i]
        velocity[i] += correction[6 + i]
