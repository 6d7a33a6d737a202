"""Strapdown integration of attitude and its covariance (Liu et al., sec. 4; Savage 1998)."""

from typing import Final

import numpy as np

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats
from ahrs_service.rotation import from_rotation_vector, multiply, normalise

ERROR_STATES: Final = 6
"""Error angle about north, east, down [rad], then gyro bias about x, y, z [rad/s]."""


@kernel
def rotate(q: Floats, rate_before: Floats, rate: Floats, dt_s: float) -> None:
    """Turn `q` [4] by the body rates at both ends of an interval [rad/s].

    The rate is taken as linear in time: rotation vector = dt (w0 + w1) / 2 + dt^2 (w0 x w1) / 12,
    the second term being coning (Savage 1998, eq. 33, two-sample form).
    """
    half = 0.5 * dt_s
    coning = dt_s * dt_s / 12.0
    x = half * (rate_before[0] + rate[0]) + coning * (
        rate_before[1] * rate[2] - rate_before[2] * rate[1]
    )
    y = half * (rate_before[1] + rate[1]) + coning * (
        rate_before[2] * rate[0] - rate_before[0] * rate[2]
    )
    z = half * (rate_before[2] + rate[2]) + coning * (
        rate_before[0] * rate[1] - rate_before[1] * rate[0]
    )
    turn = np.empty(4)
    from_rotation_vector(x, y, z, turn)
    multiply(q, turn, q)
    normalise(q)


@kernel
def grow_covariance(
    p: Floats, ned_from_body: Floats, dt_s: float, angle_variance: float, bias_variance: float
) -> None:
    """Propagate the covariance `p` [6, 6] over `dt_s`.

    Error angle in earth axes: d(psi)/dt = -C_nb d(bias), so with M = C_nb dt the blocks become
    A - M B' - B M' + M C M' + Q, B - M C, C + Q. `angle_variance` [rad^2] and `bias_variance`
    [(rad/s)^2] are what the noise adds in this step.
    """
    m = np.empty((3, 3))
    mc = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            m[i, j] = ned_from_body[i, j] * dt_s
    for i in range(3):
        for j in range(3):
            mc[i, j] = m[i, 0] * p[3, 3 + j] + m[i, 1] * p[4, 3 + j] + m[i, 2] * p[5, 3 + j]
    for i in range(3):
        for j in range(i, 3):
            mb_ij = m[i, 0] * p[j, 3] + m[i, 1] * p[j, 4] + m[i, 2] * p[j, 5]
            mb_ji = m[j, 0] * p[i, 3] + m[j, 1] * p[i, 4] + m[j, 2] * p[i, 5]
            mcm = mc[i, 0] * m[j, 0] + mc[i, 1] * m[j, 1] + mc[i, 2] * m[j, 2]
            p[i, j] = p[i, j] - mb_ij - mb_ji + mcm
            p[j, i] = p[i, j]
        p[i, i] += angle_variance
    for i in range(3):
        for j in range(3):
            p[i, 3 + j] -= mc[i, j]
            p[3 + j, i] = p[i, 3 + j]
        p[3 + i, 3 + i] += bias_variance
