"""Kernels that whiten: the same filter runs over a residual and over what effects add to it.

A Kalman filter of the noise is linear, and its gains depend on the noise alone. So the innovations
of the residual and of every regressor, over their sigmas, turn generalised into ordinary least
squares, in a time linear in the number of samples (Harvey, Forecasting, Structural Time Series
Models and the Kalman Filter, sec. 3.4).
"""

import math

import numpy as np

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats

STATES = 18
"""Attitude error of the reference 3, integrated gyro error 3, gyro wander 3, and likewise velocity
error 3, integrated accelerometer error 3, accelerometer wander 3."""


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
    """Whiten `rows` [N, K] of white noise and a first-order Gauss-Markov bias into `out`.

    Variances `white` and `wander` of one row, `keep` exp(-step / time). Rows where `missing` [N]
    is not 0 give no innovation. `log_variance` [N] of the innovations, 0 where there is none.
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


@kernel
def _propagate_rows(p: Floats, turn: Floats, tilt: Floats, keep: Floats, step_s: float) -> None:
    """P <- F P of the noise model, in place, for [18, any] rows."""
    for k in range(p.shape[1]):
        for i in range(3):
            into = 0.0
            speed = 0.0
            for j in range(3):
                into += turn[i, j] * p[6 + j, k]
                speed += turn[i, j] * p[15 + j, k] * step_s + tilt[i, j] * p[j, k]
            p[3 + i, k] += into * step_s
            p[12 + i, k] += speed
        for i in range(3):
            p[i, k] *= keep[0]
            p[6 + i, k] *= keep[1]
            p[9 + i, k] *= keep[2]
            p[15 + i, k] *= keep[3]


@kernel
def _propagate(
    p: Floats, turn: Floats, tilt: Floats, keep: Floats, drive: Floats, step_s: float
) -> None:
    """P <- F P F' + Q."""
    _propagate_rows(p, turn, tilt, keep, step_s)
    _propagate_rows(p.T, turn, tilt, keep, step_s)
    for i in range(3):
        for part in range(6):
            p[3 * part + i, 3 * part + i] += drive[part]


@kernel
def _forget(p: Floats, mean: Floats, first: int, variance: float) -> None:
    """Make three states unknown again."""
    for i in range(first, first + 3):
        for j in range(STATES):
            p[i, j] = 0.0
            p[j, i] = 0.0
        p[i, i] = variance
        for k in range(mean.shape[1]):
            mean[i, k] = 0.0


@kernel
def whiten_flight(
    rows: Floats,
    turn: Floats,
    tilt: Floats,
    frame: Floats,
    begins: Floats,
    missing: Floats,
    step_s: Floats,
    keep: Floats,
    drive: Floats,
    start: Floats,
    white: Floats,
    out: Floats,
    log_variance: Floats,
) -> None:
    """Whiten integrated residuals [N, 6, K] (angle [rad], velocity [m/s], earth axes).

    With e the reference's attitude error, v its velocity error, b and c the wander of gyros and
    accelerometers in body axes:

        angle    = I - e + white    dI/dt = R b + white
        velocity = J - v + white    dJ/dt = R c + e x f + white

    `turn` [N, 3, 3] R and `tilt` [N, 3, 3] the integral of -[f x], both of the step that ends at
    the row, of length `step_s` [N]. `keep` [N, 4] of e, b, v, c; `drive` [N, 6], `start` [6]
    variances added in the step and at first, of the six state vectors; `white` [N, 6] of the
    measurements. Rows with `begins` not 0 start from unknown angle and velocity, rows with
    `missing` not 0 give no innovation. `log_variance` [N, 6] of the innovations, 0 where there is
    none.
    """
    count, columns = rows.shape[0], rows.shape[2]
    p = np.zeros((STATES, STATES))
    mean = np.zeros((STATES, columns))
    gain = np.zeros(STATES)
    for part in range(6):
        for i in range(3):
            p[3 * part + i, 3 * part + i] = start[part]
    for n in range(count):
        if n > 0:
            _propagate(p, turn[n], tilt[n], keep[n], drive[n], step_s[n])
            _propagate_rows(mean, turn[n], tilt[n], keep[n], step_s[n])
        if begins[n] != 0.0:
            _forget(p, mean, 3, start[1])
            _forget(p, mean, 12, start[4])
        for m in range(6):
            if missing[n] != 0.0:
                for k in range(columns):
                    out[n, m, k] = 0.0
                log_variance[n, m] = 0.0
                continue
            whole, error = (3 + m, m) if m < 3 else (9 + m, 6 + m)
            for i in range(STATES):
                gain[i] = p[i, whole]
                if m < 3:
                    for j in range(3):
                        gain[i] -= p[i, j] * frame[n, m, j]
                else:
                    gain[i] -= p[i, error]
            total = gain[whole] + white[n, m]
            if m < 3:
                for j in range(3):
                    total -= frame[n, m, j] * gain[j]
            else:
                total -= gain[error]
            scale = 1.0 / math.sqrt(total)
            log_variance[n, m] = math.log(total)
            for i in range(STATES):
                gain[i] *= scale
            for k in range(columns):
                innovation = rows[n, m, k] - mean[whole, k]
                if m < 3:
                    for j in range(3):
                        innovation += frame[n, m, j] * mean[j, k]
                else:
                    innovation += mean[error, k]
                innovation *= scale
                out[n, m, k] = innovation
                for i in range(STATES):
                    mean[i, k] += gain[i] * innovation
            for i in range(STATES):
                for j in range(STATES):
                    p[i, j] -= gain[i] * gain[j]
