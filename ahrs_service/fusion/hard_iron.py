"""Hard iron, which rotates with the sensor, separated from the Earth's field by rotation.

In earth axes a reading is e = E + C b: the field E stands still, hard iron b [uT] rotates with the
body. From one window to the next e2 - e1 = (C2 - C1) b, whatever E, its norm and the heading are.
b walks, so that a magnet that is put on or taken off is followed. A field that changes from place
to place looks like a b as well, so b is used only while the field without it agrees far better
with the reference than the field as read.
"""

from typing import Final

import numpy as np

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats, Record

IRON_FIELDS: Final = [
    ("window_count", "i8"),
    ("window_s", "f8"),
    ("window_field_ut", "f8", 3),
    ("window_dcm", "f8", (3, 3)),
    ("before_s", "f8"),
    ("before_field_ut", "f8", 3),
    ("before_dcm", "f8", (3, 3)),
    ("iron_ut", "f8", 3),
    ("iron_covariance", "f8", (3, 3)),
    ("read_misfit_ut2", "f8"),
    ("freed_misfit_ut2", "f8"),
]
"""Fields of the pipeline's state: means over this window and the one before, b, its covariance
[uT^2], and the mean square by which the field as read, and freed of b, misses the reference."""

WINDOW_S: Final = 1.5
"""Long enough that a hand or a turn changes the attitude, too short for a full turn [s]."""
IRON_SIGMA_UT: Final = 2.0
"""What calibration leaves [uT]."""
IRON_LARGEST_UT: Final = 50.0
"""A choice: keeps the covariance bounded; about the Earth's field itself (22 to 67 uT) [uT]."""
IRON_WALK_UT_RTS: Final = 0.3
"""Currents and loads change; 2.5 uT in a minute [uT/sqrt(s)]."""
FIELD_CHANGE_UT: Final = 1.0
"""By which the field of a building differs between neighbouring places [uT]."""
MISFIT_S: Final = 5.0
"""A choice: both misfits are averaged over about three WINDOW_S [s]."""
MISFIT_SHARE: Final = 0.5
"""A choice, with the next: 0.5 of misfit^2 is 0.7 of the misfit."""
MISFIT_FLOOR_UT2: Final = 1.0
"""b is used where misfit^2 without it is below this share of that with it, by 1 uT^2 at least."""


@kernel
def start(state: Record) -> None:
    """Forget all iron."""
    state["read_misfit_ut2"] = state["freed_misfit_ut2"] = 0.0
    state["before_s"] = 0.0
    for i in range(3):
        state["iron_ut"][i] = 0.0
        for j in range(3):
            state["iron_covariance"][i, j] = IRON_SIGMA_UT**2 if i == j else 0.0
    _begin_window(state)


@kernel
def _begin_window(state: Record) -> None:
    state["window_s"] = 0.0
    state["window_count"] = 0
    for i in range(3):
        state["window_field_ut"][i] = 0.0
        for j in range(3):
            state["window_dcm"][i, j] = 0.0


@kernel
def gather(state: Record, field_ned: Floats, dcm: Floats, share: float, dt_s: float) -> None:
    """Add sums of the field in earth axes [3] and the matrix [3, 3], each times `share`."""
    for i in range(3):
        state["window_field_ut"][i] += field_ned[i] * share
        for j in range(3):
            state["window_dcm"][i, j] += dcm[i, j] * share
    state["window_count"] += 1
    state["window_s"] += dt_s
    if state["window_s"] >= WINDOW_S:
        _compare_windows(state)


@kernel
def _compare_windows(state: Record) -> None:
    """Correct b by the change since the window before, and begin the next window."""
    share = 1.0 / state["window_count"]
    p, change = state["iron_covariance"], np.empty(3)
    for i in range(3):
        p[i, i] = min(p[i, i] + IRON_WALK_UT_RTS**2 * state["window_s"], IRON_LARGEST_UT**2)
        state["window_field_ut"][i] *= share
        for j in range(3):
            state["window_dcm"][i, j] *= share
    gap = state["window_s"] > 2.0 * WINDOW_S or state["before_s"] == 0.0
    for row in range(3):
        for j in range(3):
            change[j] = state["window_dcm"][row, j] - state["before_dcm"][row, j]
        if not gap:
            moved = state["window_field_ut"][row] - state["before_field_ut"][row]
            _correct(state["iron_ut"], p, change, moved)
    state["before_s"] = state["window_s"]
    for i in range(3):
        state["before_field_ut"][i] = state["window_field_ut"][i]
        for j in range(3):
            state["before_dcm"][i, j] = state["window_dcm"][i, j]
    _begin_window(state)


@kernel
def _correct(iron: Floats, p: Floats, h: Floats, measured: float) -> None:
    """Take one row of e2 - e1 = (C2 - C1) b; both windows have a field of their own."""
    ph = np.empty(3)
    s = 2.0 * FIELD_CHANGE_UT**2
    innovation = measured
    for i in range(3):
        ph[i] = p[i, 0] * h[0] + p[i, 1] * h[1] + p[i, 2] * h[2]
        s += h[i] * ph[i]
        innovation -= h[i] * iron[i]
    for i in range(3):
        iron[i] += ph[i] / s * innovation
        for j in range(3):
            p[i, j] -= ph[i] * ph[j] / s


@kernel
def judge(state: Record, read2: float, freed2: float, dt_s: float) -> bool:
    """Follow the misfits [uT^2] of the field as read and freed of b; return whether b is used."""
    weight = dt_s / (MISFIT_S + dt_s)
    state["read_misfit_ut2"] += weight * (read2 - state["read_misfit_ut2"])
    state["freed_misfit_ut2"] += weight * (freed2 - state["freed_misfit_ut2"])
    limit = MISFIT_SHARE * state["read_misfit_ut2"]
    return bool(state["freed_misfit_ut2"] + MISFIT_FLOOR_UT2 < limit)


@kernel
def variance_along(state: Record, axis: tuple[float, float, float]) -> float:
    """Variance of b [uT^2] along a body axis."""
    p = state["iron_covariance"]
    variance = 0.0
    for i in range(3):
        for j in range(3):
            variance += axis[i] * p[i, j] * axis[j]
    return variance
