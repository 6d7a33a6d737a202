"""How late a magnetometer is, estimated while the vehicle rotates.

A reading m that comes a lag tau after it was taken belongs to the attitude of then. In earth axes,
with D = C (w x m) [uT/s] by which rotation changes the reading,

    E = C(t - tau) m = C m - tau D

From one update of the filter to the next the field E and its disturbances hardly change, so
e2 - e1 = tau (D2 - D1) + (C2 - C1) b, b the hard iron. 15 ms of lag turn the azimuth by 9 deg in a
turn at 10 rad/s, always one way.
"""

from typing import Final

import numpy as np

from ahrs_service.fusion import hard_iron
from ahrs_service.kernel import kernel
from ahrs_service.records import Floats, Record

LAG_FIELDS: Final = [
    ("field_lag_s", "f8"),
    ("field_lag_variance_s2", "f8"),
    ("lag_before_s", "f8"),
    ("lag_before_field_ut", "f8", 3),
    ("lag_before_turning_ut_s", "f8", 3),
    ("lag_before_dcm", "f8", (3, 3)),
]
"""Fields of the pipeline's state: tau and its variance; whether there are means of an update before
(its length [s], else 0), and they."""

LAG_SIGMA_S: Final = 0.03
"""Filters and buses of a magnetometer read 20 to 100 times a second [s]."""
LAG_LARGEST_S: Final = 0.2
"""A choice: four periods of the slowest, read 20 times a second; it only keeps tau bounded [s]."""
LAG_WALK_S_RTS: Final = 2e-4
"""The beat of two clocks; 1.5 ms in a minute [s per sqrt(s)]."""
READING_SIGMA_UT: Final = 1.0
"""Of the mean of an update: noise, scale, what changes from place to place [uT]."""
LONGEST_S: Final = 0.5
"""Turns further apart see the field of different places [s]."""
OUTLIER: Final = 4.0
"""Noise exceeds so many times its mean square, over three axes, in one update of 500."""


@kernel
def start(state: Record) -> None:
    """Know nothing of the lag."""
    state["field_lag_s"] = 0.0
    state["field_lag_variance_s2"] = LAG_SIGMA_S**2
    state["lag_before_s"] = 0.0


@kernel
def learn(
    state: Record, field_ned: Floats, turning_ned: Floats, dcm: Floats, share: float, dt_s: float
) -> None:
    """Correct tau by sums over an update: field, its change by rotation (earth axes) and matrix.

    Squares are summed over the axes and weigh as a whole, so that north may be anywhere.
    """
    known = state["lag_before_s"] > 0.0 and dt_s < LONGEST_S
    iron, row = state["iron_ut"], np.empty(3)
    rotated2 = moved2 = product = iron2 = 0.0
    for i in range(3):
        turned = turning_ned[i] * share - state["lag_before_turning_ut_s"][i]
        moved = field_ned[i] * share - state["lag_before_field_ut"][i]
        for j in range(3):
            row[j] = dcm[i, j] * share - state["lag_before_dcm"][i, j]
            moved -= row[j] * iron[j]
            state["lag_before_dcm"][i, j] = dcm[i, j] * share
        moved -= state["field_lag_s"] * turned
        rotated2 += turned * turned
        moved2 += moved * moved
        product += turned * moved
        iron2 += hard_iron.variance_along(state, (row[0], row[1], row[2]))
        state["lag_before_turning_ut_s"][i] = turning_ned[i] * share
        state["lag_before_field_ut"][i] = field_ned[i] * share
    state["lag_before_s"] = dt_s
    if known:
        _correct(state, rotated2, moved2, product, 2.0 * READING_SIGMA_UT**2 + iron2 / 3.0, dt_s)


@kernel
def _correct(
    state: Record, rotated2: float, moved2: float, product: float, noise2: float, dt_s: float
) -> None:
    """Take e2 - e1 = tau (D2 - D1) with noise along each axis; an outlier counts less."""
    variance = min(state["field_lag_variance_s2"] + LAG_WALK_S_RTS**2 * dt_s, LAG_SIGMA_S**2)
    noise2 *= max(1.0, moved2 / (OUTLIER * (variance * rotated2 + 3.0 * noise2)))
    share = variance / (variance * rotated2 + noise2)
    lag_s = state["field_lag_s"] + share * product
    state["field_lag_s"] = min(max(lag_s, -LAG_LARGEST_S), LAG_LARGEST_S)
    state["field_lag_variance_s2"] = share * noise2
