"""Strapdown integration of attitude and its covariance (Liu et al., sec. 4; Savage 1998)."""

from typing import Final

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats
from ahrs_service.rotation import from_rotation_vector, multiply, normalise

ERROR_STATES: Final = 24
"""Error angle about north, east, down [rad], gyro bias x, y, z [rad/s], velocity n, e, d [m/s],
accelerometer bias x, y, z [m/s^2], gyro matrix row by row [1], wind n, e [m/s], lag of velocity [s]."""

BIAS: Final = 3
VELOCITY: Final = 6
ACCEL_BIAS: Final = 9
MATRIX: Final = 12
WIND: Final = 21
LAG: Final = 23

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
    p: Floats, states: int, rotation_s: Floats, angle_rad: Floats, impulse: Floats, turn_s: float
) -> None:
    """Propagate the covariance `p` over an interval of integrals, `states` of its rows.

    `rotation_s` [3, 3] is the integral of C_nb [s], `angle_rad` [3] that of the measured rate,
    `impulse` [3] that of the specific force in earth axes [m/s]. The error angle goes on by
    psi' = psi - rotation_s (bias + matrix rate), the velocity by
    v' = v + psi x impulse - rotation_s accelerometer_bias.
    """
    gx, gy, gz = angle_rad[0] / turn_s, angle_rad[1] / turn_s, angle_rad[2] / turn_s
    has_matrix, has_accel_bias = states > MATRIX, states > ACCEL_BIAS
    has_velocity = states > VELOCITY
    for j in range(states):
        _shear(
            p, j, 1, rotation_s, impulse, gx, gy, gz, has_velocity, has_accel_bias, has_matrix
        )
    for i in range(states):
        _shear(
            p, i, 0, rotation_s, impulse, gx, gy, gz, has_velocity, has_accel_bias, has_matrix
        )
    for i in range(states):
        for j in range(i):
            p[i, j] = p[j, i]


@kernel
def _shear(p, n, column, rotation_s, impulse, gx, gy, gz, has_velocity, has_accel_bias, has_matrix):
    x = p[:, n] if column else p[n, :]
    if has_velocity:
        x[6] += x[1] * impulse[2] - x[2] * impulse[1]
        x[7] += x[2] * impulse[0] - x[0] * impulse[2]
        x[8] += x[0] * impulse[1] - x[1] * impulse[0]
    if has_accel_bias:
        for i in range(3):
            x[6 + i] -= rotation_s[i, 0] * x[9] + rotation_s[i, 1] * x[10] + rotation_s[i, 2] * x[11]
    a, b, c = x[3], x[4], x[5]
    if has_matrix:
        a += gx * x[12] + gy * x[13] + gz * x[14]
        b += gx * x[15] + gy * x[16] + gz * x[17]
        c += gx * x[18] + gy * x[19] + gz * x[20]
    for i in range(3):
        x[i] -= rotation_s[i, 0] * a + rotation_s[i, 1] * b + rotation_s[i, 2] * c
