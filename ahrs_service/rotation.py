"""Rotations: quaternion kernels and column helpers.

Convention, stated once: `ned_from_body` is a Hamilton quaternion (w, x, y, z) that rotates body
coordinates (forward, right, down) into earth coordinates (north, east, down):
v_ned = q * v_body * conj(q). Euler angles are intrinsic Z-Y-X: yaw, then pitch, then roll [rad].
"""

import math

import numpy as np
import numpy.typing as npt

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats

Quaternion = tuple[float, float, float, float]
"""w, x, y, z as plain numbers, for what lives only inside a kernel."""


@kernel
def multiply(p: Floats | Quaternion, q: Floats | Quaternion, out: Floats) -> None:
    """Hamilton product out = p * q, each [4]; `out` may be `p` or `q`."""
    w = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3]
    x = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2]
    y = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1]
    z = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0]
    out[0], out[1], out[2], out[3] = w, x, y, z


@kernel
def from_rotation_vector(x: float, y: float, z: float) -> Quaternion:
    """Quaternion of the rotation vector (x, y, z) [rad]; below 0.1 rad by series, as exact."""
    angle2 = x * x + y * y + z * z
    if angle2 < 0.01:
        # The first terms left out are angle^8 / 1e7 and angle^8 / 2e8.
        w = 1.0 - angle2 * (1.0 / 8.0 - angle2 * (1.0 / 384.0 - angle2 * (1.0 / 46080.0)))
        scale = 0.5 - angle2 * (1.0 / 48.0 - angle2 * (1.0 / 3840.0 - angle2 * (1.0 / 645120.0)))
    else:
        angle = math.sqrt(angle2)
        w = math.cos(0.5 * angle)
        scale = math.sin(0.5 * angle) / angle
    return w, scale * x, scale * y, scale * z


@kernel
def normalise(q: Floats) -> None:
    """Scale `q` [4] to unit length in place, with w >= 0."""
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    scale = 1.0 / norm if q[0] >= 0.0 else -1.0 / norm
    for i in range(4):
        q[i] *= scale


@kernel
def keep_normal(q: Floats) -> None:
    """Do what `normalise` does to `q` [4] that has left unit length by rounding alone.

    One step of Newton's for 1 / sqrt: of an error e of the squared length it leaves 3 e^2 / 4.
    """
    scale = 1.5 - 0.5 * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if q[0] < 0.0:
        scale = -scale
    for i in range(4):
        q[i] *= scale


@kernel
def matrix(q: Floats, out: Floats) -> None:
    """Direction cosine matrix [3, 3] of `q` [4]: v_ned = out @ v_body."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    out[0, 0] = w * w + x * x - y * y - z * z
    out[0, 1] = 2.0 * (x * y - w * z)
    out[0, 2] = 2.0 * (x * z + w * y)
    out[1, 0] = 2.0 * (x * y + w * z)
    out[1, 1] = w * w - x * x + y * y - z * z
    out[1, 2] = 2.0 * (y * z - w * x)
    out[2, 0] = 2.0 * (x * z - w * y)
    out[2, 1] = 2.0 * (y * z + w * x)
    out[2, 2] = w * w - x * x - y * y + z * z


@kernel
def from_euler(roll: float, pitch: float, yaw: float, out: Floats) -> None:
    """Quaternion [4] of roll, pitch, yaw [rad]."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    out[0] = cr * cp * cy + sr * sp * sy
    out[1] = sr * cp * cy - cr * sp * sy
    out[2] = cr * sp * cy + sr * cp * sy
    out[3] = cr * cp * sy - sr * sp * cy


@kernel
def to_euler(q: Floats, out: Floats) -> None:
    """Roll, pitch, yaw [rad] of `q` [4]; pitch is clamped to +-90 deg."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    out[0] = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    out[1] = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    out[2] = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def euler_columns(q: npt.ArrayLike) -> Floats:
    """Roll, pitch, yaw [N, 3] [rad] of quaternions [N, 4]."""
    w, x, y, z = np.asarray(q, np.float64).T
    return np.stack(
        [
            np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
            np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)),
            np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        ],
        axis=-1,
    )


def quaternion_columns(euler: npt.ArrayLike) -> Floats:
    """Quaternions [N, 4] of roll, pitch, yaw [N, 3] [rad]."""
    half = 0.5 * np.asarray(euler, np.float64)
    (cr, cp, cy), (sr, sp, sy) = np.cos(half).T, np.sin(half).T
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def rotate_columns(q: npt.ArrayLike, vectors: npt.ArrayLike) -> Floats:
    """Turn body vectors [N, 3] into earth axes by `ned_from_body` [N, 4]."""
    q = np.asarray(q, np.float64)
    v = np.asarray(vectors, np.float64)
    u, w = q[..., 1:], q[..., :1]
    return np.asarray(v + 2.0 * np.cross(u, np.cross(u, v) + w * v), np.float64)


def inverse_columns(q: npt.ArrayLike) -> Floats:
    """Conjugates [N, 4] of unit quaternions [N, 4]."""
    return np.asarray(q, np.float64) * np.array([1.0, -1.0, -1.0, -1.0])


def multiply_columns(p: npt.ArrayLike, q: npt.ArrayLike) -> Floats:
    """Hamilton products [N, 4] of quaternions [N, 4]."""
    pw, px, py, pz = np.moveaxis(np.asarray(p, np.float64), -1, 0)
    qw, qx, qy, qz = np.moveaxis(np.asarray(q, np.float64), -1, 0)
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )
