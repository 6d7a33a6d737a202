"""The multiplicative error-state Kalman filter's correction (Lefferts, Markley, Shuster 1982).

The error angle is about earth axes: q_true = dq(psi) * q. Specific force turned to earth axes by
the estimate then reads psi_E g north and -psi_N g east while nothing but gravity acts, so each
tilt angle is measured alone and the update is two scalar ones.
"""

import math

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.kernel import kernel
from ahrs_service.records import Floats
from ahrs_service.rotation import from_rotation_vector, multiply, normalise


@kernel
def tilt_from_force(force_ned: Floats, tilt: Floats) -> None:
    """Error angle about north and east [rad] that explains `force_ned` [3] by gravity alone.

    `tilt` [2] is exact for large angles: the angle between the force and up, about the axis
    normal to both.
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
def correct_axis(
    p: Floats, correction: Floats, axis: int, measured_rad: float, variance: float
) -> None:
    """Measure error angle `axis` once: update the covariance `p` [6, 6] and `correction` [6]."""
    s = p[axis, axis] + variance
    innovation = measured_rad - correction[axis]
    gain = np.empty(6)
    for i in range(6):
        gain[i] = p[i, axis] / s
    for i in range(6):
        correction[i] += gain[i] * innovation
        for j in range(i, 6):
            p[i, j] -= gain[i] * gain[j] * s
            p[j, i] = p[i, j]


@kernel
def apply_correction(q: Floats, gyro_bias: Floats, force_ned: Floats, correction: Floats) -> None:
    """Move the correction [6] into `q` [4], `gyro_bias` [3] and the averaged `force_ned` [3]."""
    turn = np.empty(4)
    x, y, z = correction[0], correction[1], correction[2]
    from_rotation_vector(x, y, z, turn)
    multiply(turn, q, q)
    normalise(q)
    a, b, c = force_ned[0], force_ned[1], force_ned[2]
    force_ned[0] = a + y * c - z * b
    force_ned[1] = b + z * a - x * c
    force_ned[2] = c + x * b - y * a
    for i in range(3):
        gyro_bias[i] += correction[3 + i]
