"""Rate error of an autopilot's clock, from the GPS time in its log.

A quartz is off by 1e-4 at most. A firmware that uses its loop counter as a clock loses the loops
that ran late, and angles integrated from its gyro and stamps are too small by the same share.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

Integers = npt.NDArray[np.int64]

WEEK_MS: Final = 604_800_000
_LEAST_SPAN_S: Final = 60.0
_LEAST_FIXES: Final = 60
_LEAST_ERROR: Final = 2e-3
"""A smaller error in a log of a minute is hidden by the delays of its fixes, some 10 ms; and a
scale error of 2 in 1000 is within that of a gyro."""
_SPREAD: Final = 0.1
"""Largest interquartile range of the slopes, as a share of the error, for a valid rate."""


def clock_rate(own_ns: Integers, of_week_ms: Integers) -> float:
    """Return the GPS seconds per second of the autopilot's clock; 1.0 where unknown.

    `own_ns` [N] are the stamps of fixes on the autopilot's clock, `of_week_ms` [N] the GPS
    time of the week. The median of the slopes between fixes half a log apart (Theil 1950, Sen 1968,
    over N/2 pairs) is robust to outliers.
    """
    satellites_s = 1e-3 * np.unwrap(of_week_ms.astype(np.float64), period=WEEK_MS)
    own_s = 1e-9 * own_ns.astype(np.float64)
    half = len(own_s) // 2
    if half < _LEAST_FIXES // 2 or own_s[-1] - own_s[0] < _LEAST_SPAN_S:
        return 1.0
    passed_s = own_s[half:] - own_s[: len(own_s) - half]
    known = passed_s > 0.25 * _LEAST_SPAN_S
    if not known.any():
        return 1.0
    slopes = (satellites_s[half:] - satellites_s[: len(own_s) - half])[known] / passed_s[known]
    low, rate, high = np.quantile(slopes, (0.25, 0.5, 0.75))
    error = abs(rate - 1.0)
    is_one = error < _LEAST_ERROR or high - low > _SPREAD * error or not 0.5 < rate < 2.0
    return 1.0 if is_one else float(rate)
