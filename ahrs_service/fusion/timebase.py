"""What the samples' own time stamps say: the step, gaps, duplicates, late samples, clock jumps.

Time is data: nothing here reads a clock, so a replay sees what the live service saw.
"""

from typing import Final

from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Flag, Record

TIME_FIELDS: Final = [
    ("time_ns", "i8"),
    ("received_ns", "i8"),
    ("late_time_ns", "i8"),
    ("late_samples", "i8"),
    ("interval_s", "f8"),
    ("samples", "i8"),
    ("gaps", "i8"),
    ("duplicates", "i8"),
    ("reordered", "i8"),
    ("clock_jumps", "i8"),
]
"""Fields of the pipeline's state that this module keeps."""

_GAP = int(Flag.GAP)
_DUPLICATE = int(Flag.DUPLICATE)
_REORDERED = int(Flag.REORDERED)
_CLOCK_JUMP = int(Flag.CLOCK_JUMP)
_LOW_RATE = int(Flag.LOW_RATE)
NOT_INTEGRATED: Final = _DUPLICATE | _REORDERED
"""A sample with one of these flags moves nothing."""

LATE_LIMIT_S: Final = 1.0
"""A stamp further back than this is a clock that jumped, not a sample that came late [s]."""
LATE_SAMPLES: Final = 5
"""So many late samples in a row still are of one overtaken datagram."""
FORWARD_LIMIT_S: Final = 60.0
"""A stamp further ahead than this is a clock that jumped [s]."""
LOW_RATE_INTERVAL_S: Final = 0.05
"""Slower than 20 Hz the rotation between two samples is not known [s]."""
UNKNOWN_GAP_S: Final = 60.0
"""Assumed for a gap of unknown length [s]."""
_INTERVAL_WEIGHT = 0.05
"""A choice: the usual step is a mean over 20, as in the intake."""
_GAP_INTERVALS = 5.0
"""A choice: where five usual steps are longer than `gap_s`, they are what makes a gap."""


@kernel
def _follow_interval(state: Record, dt_s: float) -> None:
    """Follow the usual step; one long gap moves it little."""
    if state["interval_s"] == 0.0:
        state["interval_s"] = dt_s
    else:
        limited = min(dt_s, 3.0 * state["interval_s"])
        state["interval_s"] += _INTERVAL_WEIGHT * (limited - state["interval_s"])


@kernel
def _step_back(state: Record, time_ns: int) -> int:
    """Judge a stamp before the newest one: late samples are few, a stepped clock goes on.

    A datagram that was overtaken brings some late samples in a row; more than `LATE_SAMPLES`
    with rising stamps and none ahead of the newest are a clock that was set back.
    """
    back_s = (state["time_ns"] - time_ns) * 1e-9
    rises = time_ns > state["late_time_ns"]
    state["late_samples"] = state["late_samples"] + 1 if rises else 1
    state["late_time_ns"] = time_ns
    if back_s < LATE_LIMIT_S and state["late_samples"] <= LATE_SAMPLES:
        state["reordered"] += 1
        return _REORDERED
    return _CLOCK_JUMP


@kernel
def _is_gap(state: Record, step_s: float, gap_s: float) -> bool:
    return bool(step_s > max(gap_s, _GAP_INTERVALS * state["interval_s"]))


@kernel
def _jump(
    state: Record, time_ns: int, received_ns: int, receipt_s: float, gap_s: float
) -> tuple[float, int]:
    """Follow a clock that jumped: the receipts show whether samples were missed meanwhile."""
    # Samples assumed to be late did arrive but were not integrated: add their rotation now.
    taken_for_late = max(state["late_samples"] - 1, 0)
    late_s = taken_for_late * state["interval_s"]
    state["clock_jumps"] += 1
    state["late_samples"] = 0
    state["time_ns"] = time_ns
    state["received_ns"] = received_ns
    if receipt_s >= 0.0 and not _is_gap(state, receipt_s - late_s, gap_s):
        return float(late_s + state["interval_s"]), _CLOCK_JUMP
    state["gaps"] += 1
    return (receipt_s if receipt_s > 0.0 else UNKNOWN_GAP_S), _CLOCK_JUMP | _GAP


@inlined_kernel
def advance(state: Record, time_ns: int, received_ns: int, gap_s: float) -> tuple[float, int]:
    """Take the stamp of a sample; return the step [s] and what was found (records.Flag).

    The step is 0 for the first sample and for one that moves nothing; over a clock jump it is
    the usual interval if the samples kept coming, else the time between the receipts of this
    sample and the last that moved anything.
    """
    receipt_s = (received_ns - state["received_ns"]) * 1e-9
    state["samples"] += 1
    if state["samples"] == 1:
        state["time_ns"] = time_ns
        state["received_ns"] = received_ns
        return 0.0, 0
    dt_s = (time_ns - state["time_ns"]) * 1e-9
    if dt_s == 0.0:
        state["duplicates"] += 1
        return 0.0, _DUPLICATE
    if dt_s < 0.0:
        if _step_back(state, time_ns) == _REORDERED:
            return 0.0, _REORDERED
        return _jump(state, time_ns, received_ns, receipt_s, gap_s)
    state["late_samples"] = 0
    if dt_s > FORWARD_LIMIT_S and receipt_s < FORWARD_LIMIT_S:
        return _jump(state, time_ns, received_ns, receipt_s, gap_s)
    state["time_ns"] = time_ns
    state["received_ns"] = received_ns
    usual_s = state["interval_s"]
    flags = _LOW_RATE if usual_s > LOW_RATE_INTERVAL_S else 0
    if usual_s > 0.0 and _is_gap(state, dt_s, gap_s):
        state["gaps"] += 1
        return dt_s, flags | _GAP
    _follow_interval(state, dt_s)
    return dt_s, flags
