"""Rotation by the gyros over a turn: kernels that integrate rate over time."""

import math

import numpy as np

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats


@kernel
def rotation_and_leverage(
    time_s: Floats, output: Floats, inverse: Floats, bias: Floats, turn: Floats, leverage: Floats
) -> None:
    """Add up the rate A = C (N - B) over a turn, and how it depends on C.

    `time_s` [N] [s], gyro output [N, 3] [rad/s], `inverse` C [3, 3], `bias` B [3]. Writes `turn`
    R [3, 3], from the axes at the end to those at the beginning, and `leverage` G [3, 3],
    G[i, k] = sum of R(t)[i, :] times d[k] dt, flattened to [3, 9] with index 3 j + k for the
    element C[j, k]: dR R^T = [G dC]x for a small change dC. Rates are averaged between samples;
    each step is an exact rotation (Rodrigues).
    """
    for i in range(3):
        for j in range(3):
            turn[i, j] = 1.0 if i == j else 0.0
        for j in range(9):
            leverage[i, j] = 0.0
    step, d, w = np.empty((3, 3)), np.empty(3), np.empty(3)
    for n in range(time_s.shape[0] - 1):
        dt = time_s[n + 1] - time_s[n]
        for k in range(3):
            d[k] = (0.5 * (output[n, k] + output[n + 1, k]) - bias[k]) * dt
        for j in range(3):
            w[j] = inverse[j, 0] * d[0] + inverse[j, 1] * d[1] + inverse[j, 2] * d[2]
        rodrigues(w, step)
        # R at the middle of the step, to second order: the mean of both ends.
        for i in range(3):
            x, y, z = turn[i, 0], turn[i, 1], turn[i, 2]
            for j in range(3):
                before = turn[i, j]
                turn[i, j] = x * step[0, j] + y * step[1, j] + z * step[2, j]
                for k in range(3):
                    leverage[i, 3 * j + k] += 0.5 * (before + turn[i, j]) * d[k]


@kernel
def rodrigues(w: Floats, matrix: Floats) -> None:
    """Write the rotation [3, 3] by the vector w [3] [rad]."""
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle = math.sqrt(angle2)
    if angle < 1e-8:
        a, b = 1.0, 0.5
    else:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    x, y, z = w[0], w[1], w[2]
    matrix[0, 0] = 1.0 - b * (y * y + z * z)
    matrix[0, 1] = b * x * y - a * z
    matrix[0, 2] = b * x * z + a * y
    matrix[1, 0] = b * x * y + a * z
    matrix[1, 1] = 1.0 - b * (x * x + z * z)
    matrix[1, 2] = b * y * z - a * x
    matrix[2, 0] = b * x * z - a * y
    matrix[2, 1] = b * y * z + a * x
    matrix[2, 2] = 1.0 - b * (x * x + y * y)
