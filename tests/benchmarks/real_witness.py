"""What real recordings show without the diagnosis: plain regressions to hold its findings against.

Static logs: bias against temperature; two IMUs of one board: their difference; a reference with its
own sensor: time offset, lever arm and gyro matrix, each on both halves apart.
"""

from dataclasses import dataclass

import numpy as np

from ahrs_service.attitude_interpolation import rotation_vectors
from ahrs_service.diagnosis.input.diagnosis_input import Recorded
from ahrs_service.records import Floats
from ahrs_service.rotation import rotate_columns

OFFSETS_S = np.arange(-0.12, 0.1201, 0.002)
_SWEEPS = 20
_GRAVITY = np.array([0.0, 0.0, 9.80665])


@dataclass(frozen=True)
class Fit:
    """Coefficients with 1-sigma, lag-one correlation and rms of the residual."""

    value: Floats
    sigma: Floats
    correlation: float
    rms: float


def coloured_fit(design: Floats, values: Floats) -> Fit:
    """Least squares [N, K] in first-order Gauss-Markov noise (Cochrane and Orcutt, to the end)."""
    rho = 0.0
    for _ in range(_SWEEPS):
        x, y = _whitened(design, rho), _whitened(values[:, None], rho)[:, 0]
        value = np.linalg.lstsq(x, y, rcond=None)[0]
        left = values - design @ value
        rho = float(np.clip(left[1:] @ left[:-1] / (left[:-1] @ left[:-1]), -0.99, 0.99))
    error = y - x @ value
    variance = error @ error / max(1, len(y) - design.shape[1])
    sigma = np.sqrt(variance * np.diag(np.linalg.inv(x.T @ x)))
    return Fit(value, sigma, rho, float(left.std()))


def _whitened(columns: Floats, rho: float) -> Floats:
    first = columns[:1] * np.sqrt(1.0 - rho * rho)
    return np.concatenate([first, columns[1:] - rho * columns[:-1]])


def slope(against: Floats, values: Floats) -> Fit:
    """Return the slope of values [N] on `against` [N], with a constant fitted beside it."""
    design = np.stack([against - against.mean(), np.ones(len(values))], axis=1)
    fit = coloured_fit(design, values)
    return Fit(fit.value[:1], fit.sigma[:1], fit.correlation, fit.rms)


def held_out_gain(against: Floats, values: Floats) -> float:
    """Share of the variance of the second half that the first half's slope takes away."""
    half = len(values) // 2
    k = float(slope(against[:half], values[:half]).value[0])
    rest = values[half:] - k * against[half:]
    before = float(values[half:].var())
    return 1.0 - float(rest.var()) / before if before > 0.0 else 0.0


def blocks(values: Floats, count: int) -> Floats:
    """Return means [M, ...] of `count` rows each."""
    whole = len(values) // count
    return values[: whole * count].reshape(whole, count, *values.shape[1:]).mean(axis=1)


def _increments(recorded: Recorded) -> tuple[Floats, Floats, Floats]:
    """Return begin and end [s] of the reference's intervals and its mean rates in them [M, 3]."""
    time_s, q = recorded.attitude.time_s, recorded.attitude.values
    step = np.diff(time_s)
    good = (step > 0.5 * np.median(step)) & (step < 2.5 * np.median(step))
    rate = rotation_vectors(q)[good] / step[good, None]
    sane = np.linalg.norm(rate, axis=1) * step[good] < 1.0
    return time_s[:-1][good][sane], time_s[1:][good][sane], rate[sane]


def time_offset(recorded: Recorded) -> float:
    """Return by how much [s] the IMU's stamps are late against the reference's.

    The IMU's mean rate over each interval of the reference, moved by an offset, is fitted by a
    matrix and a bias on the reference's; the offset with the least squares left, by a parabola.
    """
    begin, end, rate = _increments(recorded)
    t, gyro = recorded.imu_time_s, recorded.gyro_rad_s
    steps = 0.5 * (gyro[1:] + gyro[:-1]) * np.diff(t)[:, None]
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    inside = (begin + OFFSETS_S[0] > t[0]) & (end + OFFSETS_S[-1] < t[-1])
    begin, end, rate = begin[inside], end[inside], rate[inside]
    design = np.column_stack([rate, np.ones(len(rate))])
    left = []
    for offset in OFFSETS_S:
        turned = np.stack(
            [np.interp(end + offset, t, c) - np.interp(begin + offset, t, c) for c in angle.T], 1
        )
        mean = turned / (end - begin)[:, None]
        fitted = design @ np.linalg.lstsq(design, mean, rcond=None)[0]
        left.append(float(np.square(mean - fitted).sum()))
    k = int(np.argmin(left))
    if k in (0, len(left) - 1):
        return float("nan")
    low, middle, high = left[k - 1 : k + 2]
    bend = low - 2.0 * middle + high
    step = float(OFFSETS_S[1] - OFFSETS_S[0])
    return float(OFFSETS_S[k] + step * 0.5 * (low - high) / bend)


def lever_arm(recorded: Recorded, position_s: Floats, position_ned_m: Floats, late_s: float) -> Fit:
    """Return the arm [3] [m] from the markers to the sensor, and the accelerometer's own delay [s].

    A second difference of positions over 28 ms weighs the acceleration by a triangle, and so the
    accelerometer is weighed; stamps are `late_s` behind, the delay (positive: later still) is
    beside that. Biases of the sensor and gravity are fitted with them.
    """
    t = recorded.imu_time_s
    rate_hz = 1.0 / float(np.median(np.diff(t)))
    taken = t - late_s
    rate, force = (
        np.stack([np.interp(t, taken, c) for c in x.T], axis=1)
        for x in (recorded.gyro_rad_s, recorded.accel_m_s2)
    )
    spin_up = np.gradient(rate, t, axis=0)
    q = np.stack(
        [np.interp(t, recorded.attitude.time_s, c) for c in recorded.attitude.values.T], axis=1
    )
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    columns = [rotate_columns(q, force) + _GRAVITY]
    for unit in np.eye(3):
        arm = np.broadcast_to(unit, rate.shape)
        columns.append(
            rotate_columns(q, np.cross(spin_up, arm) + np.cross(rate, np.cross(rate, arm)))
        )
        columns.append(rotate_columns(q, arm))
    columns.append(rotate_columns(q, np.gradient(force, t, axis=0)))
    half = max(2, round(0.028 * rate_hz))
    triangle = np.convolve(np.ones(half), np.ones(half)) / half**2
    weighed = [
        np.stack([np.convolve(c, triangle, "same") for c in column.T], 1) for column in columns
    ]
    place = np.stack([np.interp(t, position_s, c) for c in position_ned_m.T], axis=1)
    at = np.arange(2 * half, len(t) - 2 * half, half)
    gap = np.abs(
        position_s[np.searchsorted(position_s, t[at]).clip(0, len(position_s) - 1)] - t[at]
    )
    at = at[gap < 2.0 / rate_hz]
    second = (place[at + half] - 2.0 * place[at] + place[at - half]) * (rate_hz / half) ** 2
    values = (weighed[0][at] - second).T.ravel()
    design = np.stack([column[at].T.ravel() for column in weighed[1:]], axis=1)
    gravity = np.repeat([0.0, 0.0, 1.0], len(at))
    fit = coloured_fit(np.column_stack([design, gravity]), values)
    value, sigma = fit.value[[0, 2, 4, 6]], fit.sigma[[0, 2, 4, 6]]
    return Fit(value * [1.0, 1.0, 1.0, -1.0], sigma, fit.correlation, fit.rms)
