"""When the unit is still, and what it measures there: poses out of a stream of IMU samples.

A window is still where the scatter of each axis is that of the sensor's own noise, which the
quietest windows of the same recording give. The mean rate separates a slow steady turn from rest.
"""

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from ahrs_service.calibration.columns import AXES, ImuColumns
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats, Integers, Rows, empty

Booleans = npt.NDArray[np.bool_]

POSE_DTYPE: Final[np.dtype[Any]] = np.dtype(
    [
        ("start_s", "f8"),
        ("stop_s", "f8"),
        ("first", "i8"),
        ("last", "i8"),
        ("gyro_rad_s", "f8", 3),
        ("accel_m_s2", "f8", 3),
        ("gyro_error_rad_s", "f8", 3),
        ("accel_error_m_s2", "f8", 3),
        ("gyro_scatter_rad_s", "f8", 3),
        ("accel_scatter_m_s2", "f8", 3),
        ("temperature_degc", "f8"),
    ]
)
"""One still pose: samples `first` up to `last` (not with it), their means, the standard errors of
the means and the scatter (1-sigma) of the samples, and the mean temperature."""

_FALSE_ALARM: Final = 1e-6
"""A choice: of an hour's 43000 scatters (half seconds, six axes) 0.04 exceed it by chance."""
_WANDERS: Final = 0.99  # A choice: 99 % of chi-squared, as `rest_bias` says
_LEAST_SAMPLES: Final = 8
"""A choice: a scatter from eight samples is right to 27 % (1 / sqrt(2 * 7))."""
_LEAST_WINDOWS: Final = 5
"""A choice: quietest windows of a short recording whose median is the noise."""
_LATTICE: Final = 1000
"""A choice: directions 6 deg apart (sqrt(4 pi / 1000)), a tenth of a per cent each."""
_FLAT: Final = 1e-12  # A choice: a scatter of zero, but for rounding
_NEAR_RAD: Final = math.radians(45.0)  # A choice: such that the six faces cover 88 % of the sphere


@dataclass(frozen=True, slots=True)
class Stillness:
    """What counts as still.

    `scatter` is how often the noise of the quietest windows a scatter may be, beyond chance: noise
    is not white. Windows of `window_s` [s], poses of at least `least_s` [s]. `gyro_cap_rad_s` and
    `accel_cap_m_s2` are the largest scatter that can be noise: MEMS at full bandwidth stay below
    them, a hand does not (tremor of 8 to 12 Hz, some 2 deg/s). `turn_rad_s` is how far the mean
    rate may lie from that of the other poses, `shift_m_s2` the mean force within one (0.3 deg).
    """

    scatter: float = 2.0
    window_s: float = 0.5
    least_s: float = 1.5
    gyro_cap_rad_s: float = 0.02
    accel_cap_m_s2: float = 0.3
    turn_rad_s: float = math.radians(1.0)
    shift_m_s2: float = 0.05


@dataclass(frozen=True, slots=True)
class Windows:
    """Mean and scatter [W, 3] of rate and force in windows of `length` samples, one by one.

    `is_still` [W] is true where the scatter is noise and the rate that of rest; `gyro_limit` and
    `accel_limit` [3] are what scatter may reach, `accel_floor` [3] is the noise of a sample.
    """

    length: int
    gyro: Floats
    accel: Floats
    gyro_scatter: Floats
    accel_scatter: Floats
    gyro_limit: Floats
    accel_limit: Floats
    accel_floor: Floats
    is_still: Booleans


def windows_of(columns: ImuColumns, stillness: Stillness | None = None) -> Windows:
    """Return the windows of a recording and which of them are still."""
    limits = stillness or Stillness()
    interval_s = columns.interval_s
    length = _LEAST_SAMPLES
    if interval_s > 0.0:
        length = max(length, round(limits.window_s / interval_s))
    gyro, gyro_scatter = _moments(columns.gyro_rad_s, length)
    accel, accel_scatter = _moments(columns.accel_m_s2, length)
    gyro_floor = _floor(columns.gyro_rad_s, gyro_scatter)
    accel_floor = _floor(columns.accel_m_s2, accel_scatter)
    wide = limits.scatter * math.sqrt(chi2.ppf(1.0 - _FALSE_ALARM, length - 1) / (length - 1))
    gyro_limit = np.minimum(wide * gyro_floor, limits.gyro_cap_rad_s)
    accel_limit = np.minimum(wide * accel_floor, limits.accel_cap_m_s2)
    is_still = ((gyro_scatter <= gyro_limit) & (accel_scatter <= accel_limit)).all(axis=1)
    is_still &= _is_whole(columns.time_s, length, interval_s)
    if is_still.any():
        rest = np.median(gyro[is_still], axis=0)
        is_still &= (np.abs(gyro - rest) < limits.turn_rad_s).all(axis=1)
    return Windows(
        length=length,
        gyro=gyro,
        accel=accel,
        gyro_scatter=gyro_scatter,
        accel_scatter=accel_scatter,
        gyro_limit=gyro_limit,
        accel_limit=accel_limit,
        accel_floor=accel_floor,
        is_still=is_still,
    )


def find_poses(columns: ImuColumns, stillness: Stillness | None = None) -> Rows:
    """Return the still poses [K] POSE_DTYPE of a recording, in order of time.

    The first and last window of a longer pose are left out, for there the unit still settles.
    """
    limits = stillness or Stillness()
    windows = windows_of(columns, limits)
    poses = []
    shift = limits.shift_m_s2 + 6.0 * windows.accel_floor * math.sqrt(2.0 / windows.length)
    for first, last in find_runs(windows.is_still, windows.accel, shift):
        trim = 1 if last - first >= 4 else 0
        begin, end = (first + trim) * windows.length, (last - trim) * windows.length
        if (last - first) * windows.length * columns.interval_s >= limits.least_s:
            poses.append(_pose(columns, begin, end, windows.length))
    return np.concatenate([empty(POSE_DTYPE, 0), *poses])


def _moments(values: Floats, length: int) -> tuple[Floats, Floats]:
    count = len(values) // length
    blocks = values[: count * length].reshape(count, length, 3)
    return blocks.mean(axis=1), blocks.std(axis=1, ddof=1)


def _floor(values: Floats, scatter: Floats) -> Floats:
    """Noise of a sample [3]: the scatter of the quietest tenth, at least that of its rounding.

    Windows without any scatter do not count: they are rounded flat, or at an end of the range.
    """
    floor = resolution(values) / math.sqrt(12.0)
    for axis in range(3):
        alive = np.sort(scatter[scatter[:, axis] > _FLAT, axis])
        if len(alive):
            quiet = alive[: max(_LEAST_WINDOWS, len(alive) // 10)]
            floor[axis] = max(floor[axis], float(np.median(quiet)))
    return floor


def resolution(values: Floats) -> Floats:
    """Smallest step [3] between different values of each axis of `values` [N, 3]."""
    steps = [np.diff(np.unique(values[:, axis])) for axis in range(3)]
    return np.array([float(step.min()) if len(step) else 0.0 for step in steps])


def _is_whole(time_s: Floats, length: int, interval_s: float) -> Booleans:
    """Return which windows have no gap: at most one and a half times their nominal length."""
    count = len(time_s) // length
    blocks = time_s[: count * length].reshape(count, length)
    whole: Booleans = (blocks[:, -1] - blocks[:, 0]) < 1.5 * length * interval_s
    return whole


def find_runs(flags: Booleans, means: Floats, shift: float | Floats) -> list[tuple[int, int]]:
    """Return windows from..to (not with it) that are flagged on end, of like mean.

    `flags` [W], `means` [W, 3]; a run ends where a mean lies `shift` or more from its first one.
    """
    runs: list[tuple[int, int]] = []
    begin = -1
    for k, flag in enumerate([*flags.tolist(), False]):
        if begin >= 0 and (not flag or (np.abs(means[k] - means[begin]) > shift).any()):
            runs.append((begin, k))
            begin = -1
        if flag and begin < 0:
            begin = k
    return runs


def _pose(columns: ImuColumns, begin: int, end: int, length: int) -> Rows:
    pose = empty(POSE_DTYPE, 1)
    pose["first"], pose["last"] = begin, end
    pose["start_s"], pose["stop_s"] = columns.time_s[begin], columns.time_s[end - 1]
    parts = (("gyro", "rad_s", columns.gyro_rad_s), ("accel", "m_s2", columns.accel_m_s2))
    for name, unit, values in parts:
        inside = values[begin:end]
        pose[f"{name}_{unit}"] = inside.mean(axis=0)
        scatter = inside.std(axis=0, ddof=1)
        pose[f"{name}_scatter_{unit}"] = scatter
        # Means of windows scatter more than white noise would let them where noise is coloured.
        white = scatter / math.sqrt(len(inside))
        means, _ = _moments(inside, length)
        batch = means.std(axis=0, ddof=1) / math.sqrt(len(means)) if len(means) > 2 else white
        pose[f"{name}_error_{unit}"] = np.maximum(white, batch)
    temperature = columns.temperature_degc[begin:end]
    known = temperature[np.isfinite(temperature)]
    pose["temperature_degc"] = known.mean() if len(known) else np.nan
    return pose


def directions(force: Floats) -> Floats:
    """Return the unit vectors [K, 3] of forces [K, 3]: which way is up, in body axes."""
    return force / np.linalg.norm(force, axis=1, keepdims=True)


def groups_of(up: Floats, apart_rad: float = math.radians(10.0)) -> Integers:
    """Number directions [K, 3] so that like ones (nearer than `apart_rad`) have one number."""
    kinds: list[Floats] = []
    numbers = np.zeros(len(up), np.int64)
    for k, one in enumerate(up):
        near = [n for n, other in enumerate(kinds) if one @ other > math.cos(apart_rad)]
        numbers[k] = near[0] if near else len(kinds)
        if not near:
            kinds.append(one)
    return numbers


def sphere_coverage(up: Floats) -> float:
    """Share of all directions that lie within 45 deg of one of `up` [K, 3].

    Six poses along the axes cover 6 (1 - cos 45) / 2 = 88 %. Counted on a Fibonacci lattice.
    """
    return float(((lattice() @ up.T).max(axis=1) > math.cos(_NEAR_RAD)).mean()) if len(up) else 0.0


def lattice() -> Floats:
    """Return 1000 directions [1000, 3] spread evenly over the sphere (Fibonacci lattice)."""
    k = np.arange(_LATTICE) + 0.5
    z = 1.0 - 2.0 * k / _LATTICE
    turn = np.pi * (1.0 + math.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - z**2)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


def rest_bias(poses: Rows) -> tuple[Floats, Floats]:
    """Return the gyro's mean at rest [3] and its variance [3], poses weighted by their length.

    The variance is that of the mean; where the poses differ by more than their noise explains
    (99 % of chi-square), the bias wanders, and its variance is how far it wandered: what a mean
    over the session is good for afterwards.
    """
    seconds = poses["stop_s"] - poses["start_s"]
    weights = seconds / seconds.sum()
    bias = weights @ poses["gyro_rad_s"]
    scatter = weights @ (poses["gyro_rad_s"] - bias) ** 2
    spare = max(1, len(poses) - 1)
    noise = weights @ poses["gyro_error_rad_s"] ** 2
    wanders = scatter > noise * chi2.ppf(_WANDERS, spare) / spare
    return bias, np.where(wanders, scatter, scatter / spare)


def span_of(poses: Rows) -> tuple[float, float] | None:
    """Return the lowest and highest temperature of the poses [degC], None where not known."""
    known = poses["temperature_degc"][np.isfinite(poses["temperature_degc"])]
    return (float(known.min()), float(known.max())) if len(known) else None


def check_clipped_poses(columns: ImuColumns, poses: Rows) -> None:
    """Raise CalibrationError where an axis is dead flat in some poses and noisy in the others.

    A sensor at the end of its range gives the same number again and again; so does a coarse one
    that is quiet, but then its noise is nowhere above its resolution.
    """
    parts = (
        ("gyro", columns.gyro_rad_s, poses["gyro_scatter_rad_s"]),
        ("accelerometer", columns.accel_m_s2, poses["accel_scatter_m_s2"]),
    )
    for name, values, scatter in parts:
        step = resolution(values)
        for axis in range(3):
            flat = scatter[:, axis] < _FLAT
            noisy = scatter[~flat, axis]
            if flat.any() and len(noisy) and np.median(noisy) > step[axis]:
                raise CalibrationError(
                    f"{name} {AXES[axis]} does not move at all in {int(flat.sum())} of "
                    f"{len(scatter)} poses: it is saturated or stuck; set the sensor to a wider "
                    "range, or have it looked at, and record again"
                )
