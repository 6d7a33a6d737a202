"""Preintegrated rotation and velocity between two references (Forster et al. 2017, sec. V)."""

import numpy as np

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats
from ahrs_service.rotation import from_rotation_vector, multiply


@kernel
def _rotate(q: Floats, x: float, y: float, z: float, out: Floats) -> None:
    """Rotate (x, y, z) by `q` [4] into `out` [3]."""
    a = q[2] * z - q[3] * y + q[0] * x
    b = q[3] * x - q[1] * z + q[0] * y
    c = q[1] * y - q[2] * x + q[0] * z
    out[0] = x + 2.0 * (q[2] * c - q[3] * b)
    out[1] = y + 2.0 * (q[3] * a - q[1] * c)
    out[2] = z + 2.0 * (q[1] * b - q[2] * a)


@kernel
def preintegrate(
    imu_s: Floats,
    gyro: Floats,
    accel: Floats,
    at_s: Floats,
    excess: Floats,
    rotations: Floats,
    speeds: Floats,
) -> None:
    """Write rotation [N-1, 4] and velocity [N-1, 3] [m/s] preintegrated between `at_s` [N].

    `imu_s` [M], `gyro` [M, 3] [rad/s] and `accel` [M, 3] [m/s^2] are linear between samples;
    `excess` [N-1, 3] [rad/s] is subtracted from the gyro in each interval. The velocity is in the
    body axes at the start of the interval. Midpoint rule over each piece between samples: errors
    of second order in the step. The instants lie within `imu_s`.
    """
    q, step = np.empty(4), np.empty(4)
    part, rate, force = np.empty(3), np.empty(3), np.empty(3)
    i = 0
    for n in range(at_s.shape[0] - 1):
        q[0], q[1], q[2], q[3] = 1.0, 0.0, 0.0, 0.0
        speeds[n, 0], speeds[n, 1], speeds[n, 2] = 0.0, 0.0, 0.0
        now = at_s[n]
        while now < at_s[n + 1]:
            while i < imu_s.shape[0] - 2 and imu_s[i + 1] <= now:
                i += 1
            stop = min(at_s[n + 1], imu_s[i + 1])
            if stop <= now:
                stop = at_s[n + 1]
            length = stop - now
            share = (now + 0.5 * length - imu_s[i]) / (imu_s[i + 1] - imu_s[i])
            for j in range(3):
                rate[j] = gyro[i, j] + share * (gyro[i + 1, j] - gyro[i, j]) - excess[n, j]
                force[j] = accel[i, j] + share * (accel[i + 1, j] - accel[i, j])
            half = 0.5 * length
            w, x, y, z = from_rotation_vector(rate[0] * half, rate[1] * half, rate[2] * half)
            step[0], step[1], step[2], step[3] = w, x, y, z
            multiply(q, step, q)
            _rotate(q, force[0], force[1], force[2], part)
            for j in range(3):
                speeds[n, j] += part[j] * length
            multiply(q, step, q)
            now = stop
        for j in range(4):
            rotations[n, j] = q[j]
