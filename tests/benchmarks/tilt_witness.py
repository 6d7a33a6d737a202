"""Residual accelerations of an attitude against a velocity that no attitude filter made.

The equation and what is fitted are in reference_witness.py. Horizontal vectors are complex: north
plus i east.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from gps_velocity import GpsVelocity
from numba import njit

from ahrs_service.records import Floats
from ahrs_service.rotation import inverse_columns, multiply_columns, rotate_columns

WINDOW_S = 0.5
LONGEST_WINDOW_S = 2.5
STILL_WINDOW_S = 20.0
STILL_STEP_S = 1.0
HEADING_SIGMA_S = 5.0
GYRO_STEP_S = 0.5
LAGS_S = np.arange(-0.2, 0.81, 0.02)
MOVING_M_S = 1.0
"""Slower than this a GPS's course says nothing and a plane stands on the ground."""


@dataclass(frozen=True)
class Track:
    """One attitude at the IMU's instants `t_s` [N]: integrals of R f [N] and of R's axes [N, 3]."""

    t_s: Floats
    force: Any
    axes: Any


@dataclass(frozen=True)
class Windows:
    """Windows [K] [s] by the GPS's stamps and the mean acceleration in them [m/s^2]."""

    start_s: Floats
    stop_s: Floats
    accel: Any

    @property
    def middle_s(self) -> Floats:
        """Middle of each window [K] [s]."""
        return 0.5 * (self.start_s + self.stop_s)

    def chosen(self, mask: Any) -> "Windows":
        """Those of the windows that `mask` [K] names."""
        return Windows(self.start_s[mask], self.stop_s[mask], self.accel[mask])


@njit(cache=True)
def _integrate(dt_s: Floats, gyro: Floats, down: Floats, keep_tilt: bool, q: Floats) -> None:
    """Integrate the gyro [N, 3] from q[0] on; with `keep_tilt` each q [N, 4] gets `down`'s tilt."""
    for n in range(1, len(q)):
        x0 = 0.25 * (gyro[n, 0] + gyro[n - 1, 0]) * dt_s[n]
        y0 = 0.25 * (gyro[n, 1] + gyro[n - 1, 1]) * dt_s[n]
        z0 = 0.25 * (gyro[n, 2] + gyro[n - 1, 2]) * dt_s[n]
        half = math.sqrt(x0 * x0 + y0 * y0 + z0 * z0)
        cosine = math.cos(half)
        sine = math.sin(half) / half if half > 0.0 else 1.0
        x0, y0, z0 = sine * x0, sine * y0, sine * z0
        a = q[n - 1]
        w = a[0] * cosine - a[1] * x0 - a[2] * y0 - a[3] * z0
        x = a[0] * x0 + a[1] * cosine + a[2] * z0 - a[3] * y0
        y = a[0] * y0 - a[1] * z0 + a[2] * cosine + a[3] * x0
        z = a[0] * z0 + a[1] * y0 - a[2] * x0 + a[3] * cosine
        c0 = c1 = c2 = 0.0
        s = 1.0
        if keep_tilt:
            # The shortest turn from `down` to the vertical that the gyro led to, in body axes.
            d0, d1 = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x)
            d2 = 1.0 - 2.0 * (x * x + y * y)
            s += d0 * down[n, 0] + d1 * down[n, 1] + d2 * down[n, 2]
            c0 = down[n, 1] * d2 - down[n, 2] * d1
            c1 = down[n, 2] * d0 - down[n, 0] * d2
            c2 = down[n, 0] * d1 - down[n, 1] * d0
        q[n, 0] = w * s - x * c0 - y * c1 - z * c2
        q[n, 1] = w * c0 + x * s + y * c2 - z * c1
        q[n, 2] = w * c1 - x * c2 + y * s + z * c0
        q[n, 3] = w * c2 + x * c1 - y * c0 + z * s
        norm = math.sqrt(q[n, 0] ** 2 + q[n, 1] ** 2 + q[n, 2] ** 2 + q[n, 3] ** 2)
        for i in range(4):
            q[n, i] /= norm


def _steps(t_s: Floats) -> Floats:
    dt = np.diff(t_s, prepend=t_s[0])
    return np.where(dt < LONGEST_WINDOW_S, dt, 0.0)


def gyro_attitude(t_s: Floats, gyro: Floats) -> Floats:
    """Attitudes [N, 4] by integrating the gyro [N, 3] [rad/s] alone, from the identity on."""
    q = np.zeros((len(t_s), 4))
    q[0, 0] = 1.0
    _integrate(_steps(t_s), np.ascontiguousarray(gyro), np.zeros_like(gyro), False, q)
    return q


def tilted(t_s: Floats, gyro: Floats, q: Floats) -> Floats:
    """Attitudes [N, 4] with the tilt of `q` [N, 4] and a heading by the gyro [N, 3] alone."""
    down = rotate_columns(inverse_columns(q), np.broadcast_to([0.0, 0.0, 1.0], gyro.shape))
    out = np.array(q, np.float64, order="C")
    _integrate(_steps(t_s), np.ascontiguousarray(gyro), np.ascontiguousarray(down), True, out)
    return out


def interpolated(t_s: Floats, q: Floats, at_s: Floats) -> Floats:
    """Attitudes [M, 4] at `at_s` [M] between those [N, 4] of `t_s` [N]."""
    sign = np.where((q[1:] * q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    smooth = q * np.concatenate([[1.0], np.cumprod(sign)])[:, None]
    out = np.stack([np.interp(at_s, t_s, smooth[:, i]) for i in range(4)], axis=1)
    return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))


def carried(t_s: Floats, gyro: Floats, at_s: Floats, q: Floats) -> Floats:
    """Attitude `q` [M, 4] of `at_s` [M] at `t_s` [N]: the gyro [N, 3] tells what lies between."""
    carrier = gyro_attitude(t_s, gyro)
    # Between the gyro's earth and the reference's lies a turn that changes slowly.
    apart = multiply_columns(q, inverse_columns(interpolated(t_s, carrier, at_s)))
    return np.asarray(multiply_columns(interpolated(at_s, apart, t_s), carrier))


def track(t_s: Floats, force: Floats, q: Floats) -> Track:
    """Integrals over the samples of the horizontal force and of the axes' horizontal parts."""
    columns = [rotate_columns(q, force)]
    columns += [rotate_columns(q, np.broadcast_to(axis, force.shape)) for axis in np.eye(3)]
    flat = np.stack([column[:, 0] + 1j * column[:, 1] for column in columns], axis=1)
    steps = 0.5 * (flat[1:] + flat[:-1]) * _steps(t_s)[1:, None]
    sums = np.concatenate([np.zeros((1, 4)), np.cumsum(steps, axis=0)])
    return Track(t_s, sums[:, 0], sums[:, 1:])


def gps_windows(gps: GpsVelocity, origin_ns: int) -> Windows:
    """Windows of at least half a second between fixes, in motion, without gaps."""
    t_s = (gps.time_ns - origin_ns) * 1e-9
    v = gps.ned_m_s[:, 0] + 1j * gps.ned_m_s[:, 1]
    stop = np.searchsorted(t_s, t_s + WINDOW_S - 0.01)
    start = np.flatnonzero(stop < len(t_s))
    stop = stop[start]
    span = t_s[stop] - t_s[start]
    kept = (span < LONGEST_WINDOW_S) & (np.minimum(abs(v[start]), abs(v[stop])) > MOVING_M_S)
    start, stop, span = start[kept], stop[kept], span[kept]
    return Windows(t_s[start], t_s[stop], (v[stop] - v[start]) / span)


def still_windows(t_s: Floats) -> Windows:
    """Windows of 20 s in which the velocity is taken not to change."""
    start = np.arange(t_s[0], t_s[-1] - STILL_WINDOW_S, STILL_STEP_S)
    return Windows(start, start + STILL_WINDOW_S, np.zeros(len(start), complex))


def _means(one: Track, windows: Windows, lag_s: float) -> tuple[Any, Any]:
    """Mean force [K] and axes [K, 3] over each window."""
    span = windows.stop_s - windows.start_s

    def mean(column: Any) -> Any:
        first = np.interp(windows.start_s - lag_s, one.t_s, column)
        return (np.interp(windows.stop_s - lag_s, one.t_s, column) - first) / span

    return mean(one.force), np.stack([mean(one.axes[:, i]) for i in range(3)], axis=1)


def _heading(estimate: Any, windows: Windows) -> Any:
    """The turn [K] about the vertical, as a complex number, that fits best around each window."""
    step_s = float(np.median(np.diff(windows.start_s)))
    reach = int(np.ceil(3.0 * HEADING_SIGMA_S / step_s))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step_s / HEADING_SIGMA_S) ** 2)
    product = np.convolve(windows.accel * np.conj(estimate), weights)[reach:-reach]
    return np.exp(1j * np.angle(product))


def residuals(one: Track, windows: Windows, lag_s: float) -> Any:
    """Residual acceleration [K] [m/s^2], with heading and accelerometer bias fitted."""
    force, axes = _means(one, windows, lag_s)
    bias = np.zeros(3)
    for _ in range(5):
        free = force - axes @ bias
        heading = _heading(free, windows)
        r = windows.accel - heading * free
        # Soft weights: a glitch of the GPS is not the accelerometer's bias.
        weight = 1.0 / np.hypot(1.0, np.abs(r) / (2.0 * float(np.median(np.abs(r)))))
        matrix, wanted = -(heading * weight)[:, None] * axes, weight * r
        bias += np.linalg.lstsq(
            np.concatenate([matrix.real, matrix.imag]),
            np.concatenate([wanted.real, wanted.imag]),
            rcond=None,
        )[0]
    free = force - axes @ bias
    return windows.accel - _heading(free, windows) * free


def best_lag(tracks: list[Track], windows: Windows) -> float:
    """Lag of the GPS [s] at which all attitudes together fit best."""
    sizes = [
        sum(float(np.median(np.abs(residuals(one, windows, lag)))) for one in tracks)
        for lag in LAGS_S
    ]
    return float(LAGS_S[int(np.argmin(sizes))])


def gyro_corrections(t_s: Floats, gyro: Floats, at_s: Floats, q: Floats) -> tuple[Floats, Floats]:
    """What an attitude `q` [M, 4] of `at_s` [M] turned about horizontal axes and the gyro did not.

    Returns times [K] [s] and rates [K] [deg/s] over half a second each. The bias and matrix of the
    gyro that fit the whole flight are taken out.
    """
    good = np.isfinite(gyro).all(axis=1)
    good[1:] &= t_s[1:] > np.maximum.accumulate(t_s)[:-1]
    t_s, gyro = t_s[good], gyro[good]
    order = np.argsort(at_s, kind="stable")
    order = order[(at_s[order] > t_s[0]) & (at_s[order] < t_s[-1])]
    stride = max(1, round(GYRO_STEP_S / float(np.median(np.diff(at_s[order])))))
    at_s, q = at_s[order[::stride]], q[order[::stride]]
    carrier = interpolated(t_s, gyro_attitude(t_s, gyro), at_s)
    seen = multiply_columns(inverse_columns(carrier[:-1]), carrier[1:])
    turned = multiply_columns(inverse_columns(q[:-1]), q[1:])
    unseen = multiply_columns(inverse_columns(seen), turned)
    apart = 2.0 * unseen[:, 1:] * np.where(unseen[:, :1] < 0.0, -1.0, 1.0)
    span = np.diff(at_s)
    steps = gyro[1:] * np.diff(t_s)[:, None]
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    sums = np.stack([np.interp(at_s, t_s, column) for column in angle.T], axis=1)
    known = np.concatenate([span[:, None], np.diff(sums, axis=0)], axis=1)
    kept = (span > 0.0) & (span < 2.0 * GYRO_STEP_S)
    left = apart
    for _ in range(5):
        size = np.linalg.norm(left, axis=1)
        weight = (kept / np.hypot(1.0, size / (2.0 * np.median(size[kept]))))[:, None]
        left = apart - known @ np.linalg.lstsq(known * weight, apart * weight, rcond=None)[0]
    earth = rotate_columns(q[1:], left)[kept] / span[kept, None]
    return at_s[1:][kept], np.degrees(np.hypot(earth[:, 0], earth[:, 1]))
