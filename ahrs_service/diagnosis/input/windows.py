"""Window means of a signal, and of the earth-axes integral of a body-axes signal, in one pass."""

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
def _integral_means(
    axes: Floats, added: Floats, steps: Floats, window: int, parts: int, out: Floats
) -> None:
    count = added.shape[0]
    rotated = np.empty(count)
    for i in range(3):
        for m in range(count):
            rotated[m] = (
                axes[m, i, 0] * added[m, 0]
                + axes[m, i, 1] * added[m, 1]
                + axes[m, i, 2] * added[m, 2]
            )
        integral = 0.0
        for n in range(out.shape[0]):
            total = 0.0
            first, last = max(0, (n * window - 1) * parts + 1), ((n + 1) * window - 1) * parts
            for m in range(first, last + 1):
                if m > 0:
                    step = steps[m - 1]
                    integral += 0.5 * (rotated[m - 1] + rotated[m]) * step
                    if 1 < m < count - 1:
                        slope = (rotated[m] - rotated[m - 2]) / (step + steps[m - 2])
                        next_slope = (rotated[m + 1] - rotated[m - 1]) / (step + steps[m])
                        integral -= (next_slope - slope) * step * step / 12.0
                if m % parts == 0:
                    total += integral
            out[n, i] = total / window


def means(values: Floats, window: int) -> Floats:
    """Return the means [M // window, ...] of successive windows of `values` [M, ...]."""
    count = len(values) // window
    shape = values.shape[1:]
    flat = np.ascontiguousarray(values, np.float64).reshape(len(values), -1)
    out = np.empty((count, flat.shape[1]))
    _means(flat, window, out)
    return out.reshape(count, *shape)


def integral_means(
    axes: Floats, added: Floats, steps_s: Floats, window: int, parts: int = 1
) -> Floats:
    """Return the window means of the integral of `added` [M, 3] in earth axes.

    By the trapezoid rule with the end correction, slopes by central differences: of fourth order on
    an even grid. `axes` [M, 3, 3] rotates body into earth axes, `steps_s` [M-1] the intervals. The
    means are of every `parts`-th value of the integral, `window` of them each.
    """
    count = (len(added) + parts - 1) // parts // window
    out = np.empty((count, 3))
    added = np.ascontiguousarray(added, np.float64)
    _integral_means(axes, added, steps_s, window, parts, out)
    return out
