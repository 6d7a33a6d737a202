"""Recognise the vehicle profile of plain arrays from the correlation of force and rate.

From means of the specific force f and the rate w in body axes:

- a fixed wing flies along its nose at a speed V, so its centripetal acceleration is measured:
  -f_z = g + V w_y, a line whose slope is V;
- a multirotor's force is its thrust, which stays along one body axis at any tilt, and
  changes along it;
- a hand-held sensor measures gravity, in any direction, and is accelerated in any direction.

In ../shared fixed wings have V of 6.6 to 16 m/s with a correlation of 0.76 to 0.93, all else less
than 1.2 m/s or 0.2; the force of multirotors stays within 12 deg of its mean for nine tenths of the
time, that of sensors rotated by hand within 23 to 134. A sensor held upright is within 6 to 8, but
changes across as much as along, 1.1 to 1.7 times, where thrust does 0.17 to 0.50 times
(tests/benchmarks/recognition.py).
"""

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from ahrs_service.app.estimate.sample_columns import Columns
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.records import Floats, Integers

SLOWEST_FLIGHT_M_S: Final = 3.0
FASTEST_FLIGHT_M_S: Final = 60.0
FLOWN_LIKENESS: Final = 0.5
LEAST_RATE_RAD_S: Final = 0.03
"""Below this there is no usable motion, only drift with temperature on the ground [rad/s]."""
THRUST_WITHIN_RAD: Final = math.radians(17.0)
THRUST_SHARE: Final = 0.9
THRUST_SIDEWAYS: Final = 0.74
"""Geometric mean between thrust and hand."""
MEANS_NS: Final = 200_000_000
SLOW_MEANS: Final = 10
"""A hand accelerates over less than 2 s; over longer, tilt and drag change a force sideways."""
PUSHED_M_S2: Final = 0.1
"""Smaller changes are noise, which has no axis."""
FALLING_M_S2: Final = 0.5 * STANDARD_GRAVITY_M_S2
"""A smaller force has no usable direction."""
LEAST_S: Final = 20
"""In less time nothing is recognised."""


Recognised = Literal["fixed_wing", "multirotor", "hand_held"]


@dataclass(frozen=True, slots=True)
class Signs:
    """Features of the samples.

    The speed along the nose [m/s], how well its line fits (a correlation), within which angle of
    its mean the force stays for nine tenths of the time [rad], and how many times as much it
    changes across the body's z as along.
    """

    speed_m_s: float = 0.0
    likeness: float = 0.0
    spread_rad: float = 0.0
    sideways: float = 0.0


def profile_of(signs: Signs) -> Recognised:
    """Return the name of the profile for these features."""
    flies = SLOWEST_FLIGHT_M_S < signs.speed_m_s < FASTEST_FLIGHT_M_S
    if flies and signs.likeness > FLOWN_LIKENESS:
        return "fixed_wing"
    is_thrust = signs.spread_rad < THRUST_WITHIN_RAD and signs.sideways < THRUST_SIDEWAYS
    return "multirotor" if is_thrust else "hand_held"


def signs_of(columns: Columns, frame: str) -> Signs:
    """Return the features of all samples together; none if they are too few."""
    samples = columns.samples(0, len(columns.time_ns), frame, magnetometer=False)
    gyro, accel = samples["gyro_rad_s"], samples["accel_m_s2"]
    known = np.isfinite(gyro).all(axis=1) & np.isfinite(accel).all(axis=1)
    second = columns.time_ns[known] // 1_000_000_000
    if len(np.unique(second)) < LEAST_S:
        return Signs()
    rate, force = _means(second, gyro[known]), _means(second, accel[known])
    moves = rate[:, 1].std() > LEAST_RATE_RAD_S
    speed_m_s, likeness = _line(rate[:, 1], -force[:, 2]) if moves else (0.0, 0.0)
    fine = _means(columns.time_ns[known] // MEANS_NS, accel[known])
    return Signs(speed_m_s, likeness, _spread(force), _sideways(fine))


def _means(span: Integers, values: Floats) -> Floats:
    """Means [M, 3] of `values` [N, 3] over each span of time that has any."""
    _, place, counts = np.unique(span, return_inverse=True, return_counts=True)
    sums = [np.bincount(place, column) for column in values.T]
    return np.stack(sums, axis=1) / counts[:, None]


def _line(x: Floats, y: Floats) -> tuple[float, float]:
    """Slope of y [M] over x [M] and their correlation; 0 where one of them is constant."""
    x, y = x - x.mean(), y - y.mean()
    xx, xy, yy = float(x @ x), float(x @ y), float(y @ y)
    return (xy / xx, xy / math.sqrt(xx * yy)) if xx > 0.0 and yy > 0.0 else (0.0, 0.0)


def _spread(force: Floats) -> float:
    """Angle from their mean within which forces [M, 3] point for most of the time [rad]."""
    length = np.linalg.norm(force, axis=1)
    points = length > FALLING_M_S2
    if not points.any():
        return 0.0
    direction = force[points] / length[points, None]
    mean = direction.mean(axis=0)
    along = direction @ mean / max(float(np.linalg.norm(mean)), 1e-9)
    return float(np.quantile(np.arccos(np.clip(along, -1.0, 1.0)), THRUST_SHARE))


def _sideways(force: Floats) -> float:
    """Return how many times as much means of force [M, 3] change along x or y as along z.

    0 where less than 20 s of them change at all.
    """
    box = np.full(SLOW_MEANS, 1.0 / SLOW_MEANS)
    change = force - np.stack([np.convolve(column, box, "same") for column in force.T], axis=1)
    change = change[SLOW_MEANS:-SLOW_MEANS]
    change = change[np.linalg.norm(change, axis=1) > PUSHED_M_S2]
    if len(change) * MEANS_NS < LEAST_S * 1_000_000_000:
        return 0.0
    across = np.median(np.linalg.norm(change[:, :2], axis=1)) / math.sqrt(2.0)
    return float(across / max(float(np.median(np.abs(change[:, 2]))), 1e-9))
