"""An autopilot's clock judged by the satellites' time that its log holds beside it.

A quartz errs by 1e-4 at most. A firmware that counts its loops for a clock loses the loops that
came late, and whoever integrates its gyro by its stamps turns as much too little.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

Integers = npt.NDArray[np.int64]

WEEK_MS: Final = 604_800_000
_LEAST_SPAN_S: Final = 60.0
_LEAST_FIXES: Final = 60
_LEAST_ERROR: Final = 2e-3
"""Below this a log of a minute tells it not from the delays of its fixes, some 10 ms; and an
error of scale of 2 in 1000 is a gyro's own."""
_SPREAD: Final = 0.1
"""The middle half of the slopes lies within this share of the error, or they tell no rate."""


def clock_rate(own_ns: Integers, of_week_ms: Integers) -> float:
    """How many seconds of the satellites pass in one of the autopilot's; 1.0 where none is known.

    `own_ns` [N] are the stamps of fixes by the autopilot's clock, `of_week_ms` [N] the satellites'
    time of the week. The median of the slopes between fixes half a log apart (Theil 1950, Sen 1968,
    over N/2 pairs) minds no outlier.
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
