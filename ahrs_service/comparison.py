"""Errors of an estimated attitude against a reference attitude: pure columns, no files.

The rules, which the report repeats:

- ours is interpolated to the instants of the reference (slerp), and only where both our
  neighbours are of phase RUNNING and lie closer together than 0.5 s or 2.5 usual intervals;
- roll and pitch errors are differences of Euler angles (ours minus reference, wrapped), without
  the instants where the reference's pitch is beyond 75 deg; the tilt error, the angle between
  both verticals, has no such limit;
- steady flight: the reference's roll and pitch stay within 25 deg, and by the gyro: over a
  second to either side a mean rate below 0.15 rad/s, which is no manoeuvre, and a 1-sigma about it
  above 0.02 rad/s, which nothing on the ground has that stands; for at least 2 s;
- heading error is ours minus reference with its mean taken off, since the reference's north
  (declination) need not be ours.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.attitude_interpolation import (
    Mask,
    at_instants,
    gap_limit,
    pairs,
    rotation_vectors,
)
from ahrs_service.records import Floats, Integers, Rows
from ahrs_service.rotation import euler_columns, inverse_columns, rotate_columns

PITCH_LIMIT_RAD: Final = float(np.radians(75.0))
STEADY_RATE_RAD_S: Final = 0.15
STEADY_ANGLE_RAD: Final = float(np.radians(25.0))
STEADY_DURATION_S: Final = 2.0
FLOWN_RATE_RAD_S: Final = 0.02
"""What real multirotors and fixed wings wobble by in the air is 0.04 and more, with motors that
idle on the ground 0.005 to 0.02."""
LAG_LIMIT_S: Final = 0.3
_LAG_STEP_S: Final = 0.01
_LAG_INSTANTS: Final = 5_000
_LAG_CORRELATION: Final = 0.5


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """Statistics of one axis [rad] over `count` instants; NaN where there are none."""

    count: int
    mean: float
    sigma: float
    rms: float
    max: float


@dataclass(frozen=True, slots=True)
class HeadingError:
    """Heading error with its mean `offset_rad` taken off, and its drift [rad/s]."""

    offset_rad: float
    sigma_rad: float
    max_rad: float
    drift_rad_s: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Our attitude against one reference; `tilt` counts `compared` instants.

    `out_of_reach` instants of the reference had no estimate of phase RUNNING close by,
    `steep` ones had a pitch beyond 75 deg. `lag_s` is how much later the reference shows a
    motion than we do, NaN where it is not known. `heading` is None where it runs free.
    """

    compared: int
    out_of_reach: int
    steep: int
    roll: ErrorStatistics
    pitch: ErrorStatistics
    tilt: ErrorStatistics
    steady_s: float
    steady_roll: ErrorStatistics
    steady_pitch: ErrorStatistics
    heading: HeadingError | None
    lag_s: float


def compare(
    estimates: Rows, time_ns: Integers, ned_from_body: Floats, heading_is_measured: bool
) -> Comparison:
    """Compare `estimates` [N] with a reference: `time_ns` [M], `ned_from_body` [M, 4] wxyz.

    Where a clock was set back both columns are cut there, and the pieces compared in pairs.
    """
    ours, found = at_instants(estimates, time_ns, ned_from_body)
    steady, steady_s = steady_flight(time_ns, ned_from_body, *motion(estimates, time_ns))
    euler = euler_columns(ned_from_body)
    error = _wrap(euler_columns(ours) - euler)
    gentle = found & (np.abs(euler[:, 1]) <= PITCH_LIMIT_RAD)
    heading = None
    if heading_is_measured and gentle.sum() > 2:
        heading = _heading_error(time_ns[gentle], error[gentle, 2])
    return Comparison(
        compared=int(found.sum()),
        out_of_reach=int((~found).sum()),
        steep=int((found & ~gentle).sum()),
        roll=statistics(error[gentle, 0]),
        pitch=statistics(error[gentle, 1]),
        tilt=statistics(_tilt_error(ours[found], ned_from_body[found])),
        steady_s=steady_s,
        steady_roll=statistics(error[gentle & steady, 0]),
        steady_pitch=statistics(error[gentle & steady, 1]),
        heading=heading,
        lag_s=_lag(estimates, time_ns, ned_from_body),
    )


def statistics(error: Floats) -> ErrorStatistics:
    """Mean, 1-sigma, rms and largest magnitude of `error` [N]."""
    if not len(error):
        return ErrorStatistics(0, np.nan, np.nan, np.nan, np.nan)
    return ErrorStatistics(
        count=len(error),
        mean=float(error.mean()),
        sigma=float(error.std()),
        rms=float(np.sqrt(np.mean(error * error))),
        max=float(np.abs(error).max()),
    )


def motion(estimates: Rows, time_ns: Integers) -> tuple[Floats, Floats]:
    """Norm of the mean rate [M] [rad/s] around each instant, and the 1-sigma about that mean."""
    rate, wobble = np.zeros(len(time_ns)), np.zeros(len(time_ns))
    for ours, theirs in pairs(estimates["time_ns"], time_ns):
        piece = estimates[ours]
        piece = piece[np.argsort(piece["time_ns"], kind="stable")]
        rate[theirs], wobble[theirs] = rate_around(
            piece["time_ns"], piece["rate_rad_s"], time_ns[theirs]
        )
    return rate, wobble


def rate_around(stamps: Integers, rate: Floats, time_ns: Integers) -> tuple[Floats, Floats]:
    """Do that for rates [N, 3] at rising `stamps` [N]."""
    half_ns = int(0.5e9 * STEADY_DURATION_S)
    first = np.searchsorted(stamps, time_ns - half_ns)
    last = np.searchsorted(stamps, time_ns + half_ns, side="right")
    count = np.maximum(last - first, 1)[:, None]
    rate = np.nan_to_num(rate)
    sums, squares = (
        np.concatenate([np.zeros((1, 3)), np.cumsum(column, axis=0)]) for column in (rate, rate**2)
    )
    mean = (sums[last] - sums[first]) / count
    variance = (squares[last] - squares[first]) / count - mean**2
    wobble = np.sqrt(np.maximum(variance, 0.0).sum(axis=1))
    return np.linalg.norm(mean, axis=1), wobble


def steady_flight(
    time_ns: Integers, ned_from_body: Floats, rate: Floats, wobble: Floats
) -> tuple[Mask, float]:
    """Mark [M] the instants of steady flight by the rule above, and give their duration [s]."""
    if len(time_ns) < 2:
        return np.zeros(len(time_ns), bool), 0.0
    dt_s = np.diff(time_ns) * 1e-9
    calm: Mask = (dt_s > 0.0) & (dt_s < gap_limit(dt_s))
    level = np.abs(euler_columns(ned_from_body)[:, :2]).max(axis=1) < STEADY_ANGLE_RAD
    level &= (rate < STEADY_RATE_RAD_S) & (wobble > FLOWN_RATE_RAD_S)
    calm &= level[:-1] & level[1:]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], calm, [False]]).astype(np.int8)))
    mask = np.zeros(len(time_ns), bool)
    total_s = 0.0
    for start, stop in edges.reshape(-1, 2):
        duration_s = float(time_ns[stop] - time_ns[start]) * 1e-9
        if duration_s >= STEADY_DURATION_S:
            mask[start : stop + 1] = True
            total_s += duration_s
    return mask, total_s


def _wrap(angle: Floats) -> Floats:
    wrapped: Floats = np.arctan2(np.sin(angle), np.cos(angle))
    return wrapped


def _tilt_error(ours: Floats, reference: Floats) -> Floats:
    down = np.array([0.0, 0.0, 1.0])
    a = rotate_columns(inverse_columns(ours), np.broadcast_to(down, (len(ours), 3)))
    b = rotate_columns(inverse_columns(reference), np.broadcast_to(down, (len(ours), 3)))
    error: Floats = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))
    return error


def _heading_error(time_ns: Integers, error: Floats) -> HeadingError:
    offset = float(np.angle(np.exp(1j * error).mean()))
    free = _wrap(error - offset)
    t_s = (time_ns - time_ns[0]) * 1e-9
    centred = t_s - t_s.mean()
    spread = float(centred @ centred)
    drift = float(centred @ np.unwrap(error)) / spread if spread > 0.0 else np.nan
    return HeadingError(offset, float(free.std()), float(np.abs(free).max()), drift)


def _lag(estimates: Rows, time_ns: Integers, q: Floats) -> float:
    """How much later [s] the reference shows a motion, by the best correlation of body rates.

    Means of our rate over the reference's own intervals are correlated with its mean rates, for
    shifts within 0.3 s; a parabola through the best three gives the rest.
    """
    paired = pairs(estimates["time_ns"], time_ns)
    if not paired:
        return np.nan
    ours, theirs = max(paired, key=lambda pair: pair[1].stop - pair[1].start)
    piece = estimates[ours]
    piece = piece[np.argsort(piece["time_ns"], kind="stable")]
    stamps = time_ns[theirs]
    dt_s = np.diff(stamps) * 1e-9
    good = np.flatnonzero((dt_s > 0.0) & (dt_s < LAG_LIMIT_S))
    good = good[:: max(1, len(good) // _LAG_INSTANTS)]
    if len(good) < 50 or len(piece) < 50 or np.median(np.diff(piece["time_ns"])) > 0.1e9:
        return np.nan
    rates = rotation_vectors(q[theirs])[good] / dt_s[good, None]
    origin = stamps[0]
    t_ours = (piece["time_ns"] - origin) * 1e-9
    angle = _integral(t_ours, np.nan_to_num(piece["rate_rad_s"]))
    start, stop = (stamps[good] - origin) * 1e-9, (stamps[good + 1] - origin) * 1e-9
    shifts = np.arange(-LAG_LIMIT_S, LAG_LIMIT_S + 1e-9, _LAG_STEP_S)
    scores = np.array([_score(rates, t_ours, angle, start - s, stop - s) for s in shifts])
    best = int(np.argmax(scores))
    if not scores[best] > _LAG_CORRELATION or best in (0, len(shifts) - 1):
        return np.nan
    low, high = scores[best - 1], scores[best + 1]
    curvature = 2.0 * scores[best] - low - high
    offset = 0.5 * (high - low) / curvature if curvature > 0.0 else 0.0
    return float(shifts[best] + offset * _LAG_STEP_S)


def _integral(t_s: Floats, rate: Floats) -> Floats:
    """Integral [3, N] of rates [N, 3] over time, one contiguous row per axis."""
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t_s)[:, None]
    return np.ascontiguousarray(np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]).T)


def _score(rates: Floats, t_s: Floats, angle: Floats, start: Floats, stop: Floats) -> float:
    product = power = own = 0.0
    for axis in range(3):
        column = angle[axis]
        mean = (np.interp(stop, t_s, column) - np.interp(start, t_s, column)) / (stop - start)
        mean = mean - mean.mean()
        theirs = rates[:, axis] - rates[:, axis].mean()
        product += float(mean @ theirs)
        power += float(theirs @ theirs)
        own += float(mean @ mean)
    return product / np.sqrt(power * own) if power * own > 0.0 else 0.0
