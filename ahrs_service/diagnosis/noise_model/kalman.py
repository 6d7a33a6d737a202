"""A kernel that whitens a channel: one filter for the residual and for the responses of effects.

A Kalman filter of the noise is linear, and its gains depend only on the noise. The innovations of
the residual and of every regressor, divided by their sigmas, therefore reduce generalised to
ordinary least squares, in a time linear in the number of samples (Harvey, Forecasting, Structural
Time Series Models and the Kalman Filter, sec. 3.4).
"""

import math

import numpy as np

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats


@kernel
def whiten_channel(
    rows: Floats,
    missing: Floats,
    white: float,
    wander: float,
    keep: float,
    out: Floats,
    log_variance: Floats,
) -> None:
    """Whiten `rows` [N, K] with white noise and a first-order Gauss-Markov bias into `out`.

    Variances `white` and `wander` of one row, `keep` exp(-step / time). Rows where `missing` [N]
    is not 0 have no innovation. `log_variance` [N] of the innovations, 0 where there is none.
    """
    count, columns = rows.shape
    mean = np.zeros(columns)
    variance, drive = wander, wander * (1.0 - keep * keep)
    for i in range(count):
        if missing[i] != 0.0:
            for k in range(columns):
                out[i, k] = 0.0
                mean[k] *= keep
            log_variance[i] = 0.0
            variance = keep * keep * variance + drive
            continue
        total = variance + white
        gain, scale = variance / total, 1.0 / math.sqrt(total)
        log_variance[i] = math.log(total)
        for k in range(columns):
            innovation = rows[i, k] - mean[k]
            out[i, k] = innovation * scale
            mean[k] = keep * (mean[k] + gain * innovation)
        variance = keep * keep * (variance - gain * variance) + drive
