"""Kernels that whiten the misfit of a flight: filter gains once, then any number of columns.

The gains of a Kalman filter depend only on the noise (see noise_model.kalman), so they are computed
once per noise; whitening a further column with them costs little.
"""

import math

import numpy as np

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats

STATES = 18
"""Attitude error of the reference 3, integrated gyro error 3, gyro wander 3, and likewise velocity
error 3, integrated accelerometer error 3, accelerometer wander 3."""

_LANES = 32
"""Columns that are whitened together: their states stay in the nearest cache."""

_STRIDE = 8
"""Lanes are padded to a multiple of this, which avoids remainder loops."""


@kernel
def _propagate(
    p: Floats, rotation: Floats, tilt: Floats, keeps: Floats, drive: Floats, step_s: float
) -> None:
    """P <- F P F' + Q with F = D (1 + C), `keeps` [18] the diagonal of D."""
    for i in range(3):
        w0, w1, w2 = rotation[i, 0] * step_s, rotation[i, 1] * step_s, rotation[i, 2] * step_s
        t0, t1, t2 = tilt[i, 0], tilt[i, 1], tilt[i, 2]
        for k in range(STATES):
            p[3 + i, k] += w0 * p[6, k] + w1 * p[7, k] + w2 * p[8, k]
        for k in range(STATES):
            p[12 + i, k] += (
                w0 * p[15, k]
                + w1 * p[16, k]
                + w2 * p[17, k]
                + t0 * p[0, k]
                + t1 * p[1, k]
                + t2 * p[2, k]
            )
    # Only the columns between integrals are computed; the others follow by symmetry.
    for i in range(3):
        w0, w1, w2 = rotation[i, 0] * step_s, rotation[i, 1] * step_s, rotation[i, 2] * step_s
        t0, t1, t2 = tilt[i, 0], tilt[i, 1], tilt[i, 2]
        for j in range(3):
            p[3 + j, 3 + i] += w0 * p[3 + j, 6] + w1 * p[3 + j, 7] + w2 * p[3 + j, 8]
        for a in range(6):
            r = 3 + a if a < 3 else 9 + a
            p[r, 12 + i] += (
                w0 * p[r, 15]
                + w1 * p[r, 16]
                + w2 * p[r, 17]
                + t0 * p[r, 0]
                + t1 * p[r, 1]
                + t2 * p[r, 2]
            )
    for i in range(STATES):
        for k in range(STATES):
            p[i, k] *= keeps[i] * keeps[k]
    for i in range(3):
        for k in range(STATES):
            p[k, 3 + i] = p[3 + i, k]
    for i in range(3):
        for k in range(STATES):
            p[k, 12 + i] = p[12 + i, k]
    for i in range(STATES):
        p[i, i] += drive[i // 3]


@kernel
def _forget(p: Floats, first: int, variance: float) -> None:
    """Reset three states to unknown."""
    for i in range(first, first + 3):
        for j in range(STATES):
            p[i, j] = 0.0
            p[j, i] = 0.0
        p[i, i] = variance


@kernel
def _innovate(
    p: Floats,
    frame: Floats,
    missing: Floats,
    white: Floats,
    g: Floats,
    s: Floats,
    root: Floats,
    variances: Floats,
) -> None:
    """Write S = H P H' + R = L L' as `root`, `g` [6, 18] = L^-1 H P, and L's squared diagonal.

    `root` [6, 6] has L below its diagonal and 1 / L on it; rows that are `missing` [2] are 0.
    """
    for m in range(3):
        f0, f1, f2 = frame[m, 0], frame[m, 1], frame[m, 2]
        for k in range(STATES):
            g[m, k] = p[3 + m, k] - (f0 * p[0, k] + f1 * p[1, k] + f2 * p[2, k])
        for k in range(STATES):
            g[3 + m, k] = p[12 + m, k] - p[9 + m, k]
    for m in range(6):
        for i in range(3):
            tilted = frame[i, 0] * g[m, 0] + frame[i, 1] * g[m, 1] + frame[i, 2] * g[m, 2]
            s[m, i] = g[m, 3 + i] - tilted
            s[m, 3 + i] = g[m, 12 + i] - g[m, 9 + i]
        s[m, m] += white[m]
    for m in range(6):
        for i in range(m):
            shared = s[m, i]
            for j in range(i):
                shared -= root[m, j] * root[i, j]
            shared *= root[i, i]
            root[m, i] = shared
            for k in range(STATES):
                g[m, k] -= shared * g[i, k]
        total = s[m, m]
        for j in range(m):
            total -= root[m, j] * root[m, j]
        variances[m] = total
        root[m, m] = 1.0 / math.sqrt(total)
        if missing[m // 3] != 0.0:
            variances[m] = 1.0
            for j in range(m + 1):
                root[m, j] = 0.0
        for k in range(STATES):
            g[m, k] *= root[m, m]


@kernel
def flight_gains(
    rotation: Floats,
    tilt: Floats,
    frame: Floats,
    begins: Floats,
    step_s: Floats,
    keep: Floats,
    missing: Floats,
    drive: Floats,
    start: Floats,
    white: Floats,
    gains: Floats,
    roots: Floats,
    variances: Floats,
) -> None:
    """Write the gains that whiten integrated residuals (angle [rad], velocity [m/s], earth axes).

    With e the reference's attitude error, v its velocity error, b and c the wander of gyros and
    accelerometers in body axes:

        angle    = I - e + white    dI/dt = R b + white
        velocity = J - v + white    dJ/dt = R c + e x f + white

    `rotation` [N, 3, 3] R and `tilt` [N, 3, 3] the integral of -[f x], both of the step that ends
    at the row, of length `step_s` [N]; `frame` [N, 3, 3] rotates e into the rows' axes. `keep`
    [N, 4] of e, b, v, c; `drive` [N, 6], `start` [6] variances of the six state vectors, added in
    the step and initial; `white` [N, 6] of the measurements. Rows with `begins` not 0 start from
    unknown angle and velocity; where `missing` [N, 2] is not 0 there is no angle or velocity.

    `gains` [N, 18, 6] map whitened innovations to the states, `roots` [N, 6, 6] as `_innovate`
    writes them; `variances` [N, 6] of the innovations in sequence, 1 where there is none.
    """
    p, keeps = np.zeros((STATES, STATES)), np.ones(STATES)
    g, s = np.zeros((6, STATES)), np.zeros((6, 6))
    for i in range(STATES):
        p[i, i] = start[i // 3]
    for n in range(rotation.shape[0]):
        if n > 0:
            for i in range(3):
                keeps[i], keeps[6 + i] = keep[n, 0], keep[n, 1]
                keeps[9 + i], keeps[15 + i] = keep[n, 2], keep[n, 3]
            _propagate(p, rotation[n], tilt[n], keeps, drive[n], step_s[n])
        if begins[n] != 0.0:
            _forget(p, 3, start[1])
            _forget(p, 12, start[4])
        _innovate(p, frame[n], missing[n], white[n], g, s, roots[n], variances[n])
        for i in range(STATES):
            g0, g1, g2, g3, g4, g5 = g[0, i], g[1, i], g[2, i], g[3, i], g[4, i], g[5, i]
            for k in range(STATES):
                p[i, k] -= (
                    g0 * g[0, k]
                    + g1 * g[1, k]
                    + g2 * g[2, k]
                    + g3 * g[3, k]
                    + g4 * g[4, k]
                    + g5 * g[5, k]
                )
        for m in range(6):
            for i in range(STATES):
                gains[n, i, m] = g[m, i]


@kernel
def _propagate_lanes(
    x: Floats, lanes: int, rotation: Floats, tilt: Floats, keep: Floats, step_s: float
) -> None:
    """X <- F X."""
    for i in range(3):
        w0, w1, w2 = rotation[i, 0] * step_s, rotation[i, 1] * step_s, rotation[i, 2] * step_s
        t0, t1, t2 = tilt[i, 0], tilt[i, 1], tilt[i, 2]
        for k in range(lanes):
            x[3 + i, k] += w0 * x[6, k] + w1 * x[7, k] + w2 * x[8, k]
        for k in range(lanes):
            x[12 + i, k] += (
                w0 * x[15, k]
                + w1 * x[16, k]
                + w2 * x[17, k]
                + t0 * x[0, k]
                + t1 * x[1, k]
                + t2 * x[2, k]
            )
    for k in range(lanes):
        for i in range(3):
            x[i, k] *= keep[0]
            x[6 + i, k] *= keep[1]
            x[9 + i, k] *= keep[2]
            x[15 + i, k] *= keep[3]


@kernel
def _update_lanes(x: Floats, lanes: int, frame: Floats, root: Floats, gain: Floats) -> None:
    """Replace measurements in the rows 18 to 23 of X by whitened innovations, and update X."""
    for m in range(3):
        f0, f1, f2 = frame[m, 0], frame[m, 1], frame[m, 2]
        for k in range(lanes):
            x[18 + m, k] -= x[3 + m, k] - (f0 * x[0, k] + f1 * x[1, k] + f2 * x[2, k])
        for k in range(lanes):
            x[21 + m, k] -= x[12 + m, k] - x[9 + m, k]
    for m in range(6):
        for i in range(m):
            shared = root[m, i]
            for k in range(lanes):
                x[18 + m, k] -= shared * x[18 + i, k]
        scale = root[m, m]
        for k in range(lanes):
            x[18 + m, k] *= scale
    for i in range(STATES):
        g0, g1, g2 = gain[i, 0], gain[i, 1], gain[i, 2]
        g3, g4, g5 = gain[i, 3], gain[i, 4], gain[i, 5]
        for k in range(lanes):
            x[i, k] += (
                g0 * x[18, k]
                + g1 * x[19, k]
                + g2 * x[20, k]
                + g3 * x[21, k]
                + g4 * x[22, k]
                + g5 * x[23, k]
            )


@kernel
def whiten_flight(
    rows: Floats,
    rotation: Floats,
    tilt: Floats,
    frame: Floats,
    begins: Floats,
    step_s: Floats,
    keep: Floats,
    gains: Floats,
    roots: Floats,
    out: Floats,
) -> None:
    """Whiten integrated residuals `rows` [N, 6, K] into `out` with the gains of `flight_gains`."""
    count, columns = rows.shape[0], rows.shape[2]
    x = np.zeros((STATES + 6, _LANES))
    for first in range(0, columns, _LANES):
        used = min(_LANES, columns - first)
        lanes = (used + _STRIDE - 1) // _STRIDE * _STRIDE
        for i in range(STATES + 6):
            for k in range(_LANES):
                x[i, k] = 0.0
        for n in range(count):
            if n > 0:
                _propagate_lanes(x, lanes, rotation[n], tilt[n], keep[n], step_s[n])
            if begins[n] != 0.0:
                for i in range(3):
                    for k in range(lanes):
                        x[3 + i, k] = 0.0
                        x[12 + i, k] = 0.0
            for m in range(6):
                for k in range(used):
                    x[18 + m, k] = rows[n, m, first + k]
            _update_lanes(x, lanes, frame[n], roots[n], gains[n])
            for m in range(6):
                for k in range(used):
                    out[n, m, first + k] = x[18 + m, k]
