"""Means over windows of a grid, and what a body-axes addition gathers until then: one pass each."""

import numpy as np

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats


@kernel
def _means(values: Floats, window: int, out: Floats) -> None:
    for n in range(out.shape[0]):
        for j in range(out.shape[1]):
            total = 0.0
            for m in range(n * window, (n + 1) * window):
                total += values[m, j]
            out[n, j] = total / window


@kernel
def _gathered_means(axes: Floats, added: Floats, steps: Floats, window: int, out: Floats) -> None:
    for i in range(3):
        before, gathered = 0.0, 0.0
        for n in range(out.shape[0]):
            total = 0.0
            for m in range(n * window, (n + 1) * window):
                now = (
                    axes[m, i, 0] * added[m, 0]
                    + axes[m, i, 1] * added[m, 1]
                    + axes[m, i, 2] * added[m, 2]
                )
                if m > 0:
                    gathered += 0.5 * (before + now) * steps[m - 1]
                before = now
                total += gathered
            out[n, i] = total / window


def means(values: Floats, window: int) -> Floats:
    """Return the means [M // window, ...] of successive windows of `values` [M, ...]."""
    count = len(values) // window
    shape = values.shape[1:]
    flat = np.ascontiguousarray(values, np.float64).reshape(len(values), -1)
    out = np.empty((count, flat.shape[1]))
    _means(flat, window, out)
    return out.reshape(count, *shape)


def gathered_means(axes: Floats, added: Floats, steps_s: Floats, window: int) -> Floats:
    """Return the window means [M // window, 3] of the integral of `added` [M, 3] in earth axes.

    `axes` [M, 3, 3] turns body into earth axes, `steps_s` [M-1] the intervals: trapezoid rule.
    """
    out = np.empty((len(added) // window, 3))
    _gathered_means(axes, np.ascontiguousarray(added, np.float64), steps_s, window, out)
    return out
