"""Our attitude at the instants of a reference: pieces of one clock, gaps, interpolation."""

import itertools
from typing import Final

import numpy as np
import numpy.typing as npt

from ahrs_service.records import Floats, Integers, Phase, Rows
from ahrs_service.rotation import inverse_columns, multiply_columns

Mask = npt.NDArray[np.bool_]

GAP_S: Final = 0.5
"""A choice: steps up to this are bridged at any rate [s]."""
GAP_INTERVALS: Final = 2.5
"""A choice: one missing stamp (2 steps) and jitter are bridged, two missing (3) are not."""
_CLOCK_BACK_S: Final = 1.0
"""As timebase.LATE_LIMIT_S, written again: this module needs no kernels [s]."""


def gap_limit(dt_s: Floats) -> float:
    """Longest step [s] to interpolate over: 0.5 s or 2.5 usual steps of `dt_s`."""
    forward = dt_s[dt_s > 0.0]
    usual_s = float(np.median(forward)) if len(forward) else 0.0
    return max(GAP_S, GAP_INTERVALS * usual_s)


def rotation_vectors(q: Floats) -> Floats:
    """Rotation in body axes [M-1, 3] [rad] from each attitude [M, 4] to the next."""
    step = multiply_columns(inverse_columns(q[:-1]), q[1:])
    step *= np.where(step[:, :1] < 0.0, -1.0, 1.0)
    sine = np.linalg.norm(step[:, 1:], axis=1)
    angle = 2.0 * np.arctan2(sine, step[:, 0])
    scale = np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 2.0)
    return step[:, 1:] * scale[:, None]


def _pieces(time_ns: Integers) -> list[tuple[int, int]]:
    """Cut a column of stamps where the clock was set back: (start, stop) of each piece."""
    back = np.flatnonzero(np.diff(time_ns) < -_CLOCK_BACK_S * 1e9) + 1
    bounds = [0, *back.tolist(), len(time_ns)]
    return [(a, b) for a, b in itertools.pairwise(bounds) if b > a]


def _overlap_ns(a: Integers, b: Integers) -> int:
    return int(min(a.max(), b.max()) - max(a.min(), b.min()))


def pairs(ours_ns: Integers, theirs_ns: Integers) -> list[tuple[slice, slice]]:
    """Pair the pieces of both columns: one by one, or by overlap where their numbers differ."""
    ours, theirs = _pieces(ours_ns), _pieces(theirs_ns)
    found = []
    first = 0
    for n, (start, stop) in enumerate(theirs):
        chosen = n
        if len(ours) != len(theirs):
            overlaps = [_overlap_ns(ours_ns[a:b], theirs_ns[start:stop]) for a, b in ours[first:]]
            if not overlaps:
                break
            chosen = first + int(np.argmax(overlaps))
            first = chosen
        found.append((slice(*ours[chosen]), slice(start, stop)))
    return found


def at_instants(estimates: Rows, time_ns: Integers, q: Floats) -> tuple[Floats, Mask]:
    """Our attitude [M, 4] at the reference's instants, and where [M] there is one."""
    out = np.tile([1.0, 0.0, 0.0, 0.0], (len(time_ns), 1))
    found = np.zeros(len(time_ns), bool)
    for ours, theirs in pairs(estimates["time_ns"], time_ns):
        piece = estimates[ours]
        order = np.argsort(piece["time_ns"], kind="stable")
        out[theirs], found[theirs] = _interpolated(piece[order], time_ns[theirs])
    found &= np.isfinite(q).all(axis=1)
    return out, found


def _interpolated(estimates: Rows, time_ns: Integers) -> tuple[Floats, Mask]:
    stamps = estimates["time_ns"]
    if len(stamps) < 2:
        return np.tile([1.0, 0.0, 0.0, 0.0], (len(time_ns), 1)), np.zeros(len(time_ns), bool)
    after = np.clip(np.searchsorted(stamps, time_ns), 1, len(stamps) - 1)
    before = after - 1
    dt_ns = stamps[after] - stamps[before]
    running = estimates["phase"] == Phase.RUNNING
    found = running[before] & running[after] & (dt_ns * 1e-9 < gap_limit(np.diff(stamps) * 1e-9))
    found &= (stamps[before] <= time_ns) & (time_ns <= stamps[after])
    share = (time_ns - stamps[before]) / np.maximum(dt_ns, 1)
    q = estimates["ned_from_body"]
    return _slerp(q[before], q[after], np.clip(share, 0.0, 1.0)), found


def _slerp(a: Floats, b: Floats, share: Floats) -> Floats:
    dot = (a * b).sum(axis=1, keepdims=True)
    b = np.where(dot < 0.0, -b, b)
    angle = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    sine = np.sin(angle)
    near = sine < 1e-6
    safe = np.where(near, 1.0, sine)
    s = share[:, None]
    weight_a = np.where(near, 1.0 - s, np.sin((1.0 - s) * angle) / safe)
    weight_b = np.where(near, s, np.sin(s * angle) / safe)
    q = weight_a * a + weight_b * b
    unit: Floats = q / np.linalg.norm(q, axis=1, keepdims=True)
    return unit
