"""Whose error a difference of two attitudes is, by their residuals; see reference_witness.py."""

from typing import Any

import numpy as np
from peers import G0, Floats
from tilt_witness import Windows

SPAN_S = 5.0
SHORTEST_SPAN_S = 2.0
BLOCK_S = 10.0
DOUBT_RAD = np.radians(2.0)
DOUBT_SIGMA = 3.0


def fault(r_ref: Any, r_other: Any, middle_s: Floats) -> tuple[float, float]:
    """Return the reference's share of the squared difference, and its 1-sigma (bootstrap)."""
    d = r_ref - r_other
    block, inverse = np.unique((middle_s // BLOCK_S).astype(int), return_inverse=True)
    top = np.bincount(inverse, (r_ref * np.conj(d)).real)
    bottom = np.bincount(inverse, np.abs(d) ** 2)
    drawn = np.random.default_rng(1).integers(0, len(block), (1000, len(block)))
    spread = (top[drawn].sum(axis=1) / bottom[drawn].sum(axis=1)).std()
    return float(top.sum() / bottom.sum()), float(spread)


def doubtful(r_ref: Any, r_other: Any, windows: Windows) -> Any:
    """Mark [K] the windows around which the other attitude is right, by the rule above."""
    d = r_ref - r_other
    step_s = float(np.median(np.diff(windows.start_s)))
    count = max(1, round(SPAN_S / step_s))
    ones = np.ones(count) / count

    def mean(values: Any) -> Any:
        return np.convolve(values, ones, "same")

    power = mean(np.abs(d) ** 2)
    share = mean((r_ref * np.conj(d)).real) / np.maximum(power, 1e-12)
    left = mean(np.abs(r_ref) ** 2) - share**2 * power
    # Windows overlap: only as many are independent as fit side by side.
    independent = SPAN_S / max(step_s, float(np.median(windows.stop_s - windows.start_s)))
    sigma = np.sqrt(np.maximum(left, 0.0) / 2.0 / np.maximum(power * independent, 1e-12))
    return (np.sqrt(power) > DOUBT_RAD * G0) & (share - DOUBT_SIGMA * sigma > 0.5)


def spans(marked: Any, middle_s: Floats) -> list[tuple[float, float]]:
    """Time spans [s] of the marked windows, the short ones left out, near ones joined."""
    found: list[tuple[float, float]] = []
    for t in middle_s[marked].tolist():
        if found and t - found[-1][1] < SHORTEST_SPAN_S:
            found[-1] = (found[-1][0], t)
        else:
            found.append((t, t))
    return [(a, b) for a, b in found if b - a >= SHORTEST_SPAN_S]


def nearer(share: float, sigma: float) -> str:
    """Who is nearer to the truth, where two sigma tell."""
    if share - 2.0 * sigma > 0.5:
        return "ours"
    return "reference" if share + 2.0 * sigma < 0.5 else "even"
