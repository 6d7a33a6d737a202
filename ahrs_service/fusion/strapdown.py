"""Strapdown integration of attitude and its covariance (Liu et al., sec. 4; Savage 1998)."""

from typing import Final

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats
from ahrs_service.rotation import from_rotation_vector, multiply, normalise

ERROR_STATES: Final = 9
"""Error angle about north, east, down [rad], gyro bias x, y, z [rad/s], velocity n, e, d [m/s]."""


@kernel
def rotate(q: Floats, rate_before: Floats, rate: Floats, dt_s: float, share: float) -> None:
    """Turn `q` [4] by two successive gyro samples [rad/s].

    rotation vector = dt ((1 - share) w0 + share w1) + dt^2 (w0 x w1) / 12, the second term being
    coning (Savage 1998, eq. 33, two-sample form). `share` is 1/2 where a sample is the rate of one
    instant, and 1 where it is the mean since the sample before.
    """
    old, new = (1.0 - share) * dt_s, share * dt_s
    coning = dt_s * dt_s / 12.0
    x = (
        old * rate_before[0]
        + new * rate[0]
        + coning * (rate_before[1] * rate[2] - rate_before[2] * rate[1])
    )
    y = (
        old * rate_before[1]
        + new * rate[1]
        + coning * (rate_before[2] * rate[0] - rate_before[0] * rate[2])
    )
    z = (
        old * rate_before[2]
        + new * rate[2]
        + coning * (rate_before[0] * rate[1] - rate_before[1] * rate[0])
    )
    multiply(q, from_rotation_vector(x, y, z), q)
    normalise(q)


@kernel
def grow_covariance(
    p: Floats, rotation_s: Floats, impulse: Floats, angle: float, bias: float, velocity: float
) -> None:
    """Propagate the covariance `p` [9, 9] over an interval of integrals.

    `rotation_s` [3, 3] is the integral of C_nb [s], `impulse` [3] that of the specific force in
    earth axes [m/s]. With psi' = psi - rotation_s bias and v' = v + psi x impulse the rows, then
    the columns are turned; `angle`, `bias`, `velocity` are the variances that noise added.
    """
    for column in range(ERROR_STATES):
        _shear(p[:, column], rotation_s, impulse)
    for row in range(ERROR_STATES):
        _shear(p[row, :], rotation_s, impulse)
    for i in range(3):
        p[i, i] += angle
        p[3 + i, 3 + i] += bias
        p[6 + i, 6 + i] += velocity
    for i in range(ERROR_STATES):
        for j in range(i):
            p[i, j] = p[j, i]


@kernel
def _shear(x: Floats, rotation_s: Floats, impulse: Floats) -> None:
    """Apply the transition to one error vector [9]; velocity first, by the angle before."""
    x[6] += x[1] * impulse[2] - x[2] * impulse[1]
    x[7] += x[2] * impulse[0] - x[0] * impulse[2]
    x[8] += x[0] * impulse[1] - x[1] * impulse[0]
    for i in range(3):
        x[i] -= rotation_s[i, 0] * x[3] + rotation_s[i, 1] * x[4] + rotation_s[i, 2] * x[5]
