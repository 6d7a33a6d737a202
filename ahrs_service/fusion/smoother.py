"""Back over the nodes of the history: later measurements correct earlier estimates.

Rauch, Tung, Striebel (1965), over the error state. At a node the filter holds the state X with
covariance P; the smoothed state is X moved by d, with covariance Ps. From a node back to the one
before it (P, F, and P- = F P F^T + Q as predicted):

    C = P F^T inverse(P-),    d <- C d-,    Ps <- P + C (Ps- - P-) C^T

d- is what leads from the predicted state to the smoothed one: d after the corrections that the
filter applied there. Between two nodes the filter integrated without correction, so what leads to
the smoothed state goes evenly from its value after the one to that before the other.
"""

import math
from typing import Final

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.fusion import mekf
from ahrs_service.fusion.smoother_history import CHAINED, NONE
from ahrs_service.fusion.states import (
    ACCEL_BIAS,
    ERROR_STATES,
    GYRO_BIAS,
    GYRO_MATRIX,
    VELOCITY,
    WIND,
)
from ahrs_service.kernel import kernel
from ahrs_service.records import Floats, Record, Rows
from ahrs_service.rotation import from_rotation_vector, multiply, normalise

_HEADING: Final = 5
"""Where a node's lower triangle holds the variance of the angle about down."""
DEPENDENT: Final = 1e-12
"""Share of a variance that others must leave unexplained for the state to count as its own."""


@kernel
def smooth(nodes: Rows, used: int, estimates: Rows) -> None:
    """Smooth `estimates` [N] in place by the first `used` of `nodes`, the last of them first."""
    d, ps = np.zeros(ERROR_STATES), np.zeros((ERROR_STATES, ERROR_STATES))
    after, before = np.zeros(ERROR_STATES), np.zeros(ERROR_STATES)
    work = np.zeros((4, ERROR_STATES, ERROR_STATES))
    end, yaw = np.zeros(ERROR_STATES), 0.0
    chained = False
    for j in range(used - 1, 0, -1):
        node, n = nodes[j], nodes[j]["sample"]
        if node["kind"] == NONE:
            chained = False
            continue
        if not chained:
            yaw = 0.0
            d[:] = 0.0
            _unpack(node["covariance"], ps)
        field = _variance_of_the_field(estimates[n], node)
        for i in range(ERROR_STATES):
            end[i] = ps[i, i]
        _add(d, node["late"], after)
        _write(estimates[n], after, yaw, end, field)
        chained = node["kind"] == CHAINED and nodes[j - 1]["kind"] != NONE
        if chained:
            earlier = nodes[j - 1]
            _undo(node, after, ps, before)
            yaw += node["rotated_rad"]
            for i in range(ERROR_STATES):
                end[i] = ps[i, i]
            _step_back(node, earlier, before, d, ps, work)
            _add(d, earlier["late"], after)
            _fill(estimates, earlier["sample"], n, after, before, yaw, end, ps, field)


@kernel
def _variance_of_the_field(estimate: Record, node: Record) -> float:
    """What the heading's variance has beyond the filter's own: where the field itself points."""
    own = node["covariance"][_HEADING]
    return max(0.0, float(estimate["attitude_sigma_rad"][2] ** 2 - own))


@kernel
def _unpack(kept: Floats, p: Floats) -> None:
    n = 0
    for i in range(ERROR_STATES):
        for j in range(i + 1):
            p[i, j] = p[j, i] = kept[n]
            n += 1


@kernel
def _add(second: Floats, first: Floats, out: Floats) -> None:
    """Two corrections one after the other as one: rotations multiply, velocities rotate."""
    q = np.empty(4)
    rotation = from_rotation_vector(second[0], second[1], second[2])
    multiply(rotation, from_rotation_vector(first[0], first[1], first[2]), q)
    a, b, c = second[0], second[1], second[2]
    u, v, w = first[VELOCITY], first[VELOCITY + 1], first[VELOCITY + 2]
    for i in range(3, ERROR_STATES):
        out[i] = first[i] + second[i]
    out[VELOCITY] += b * w - c * v
    out[VELOCITY + 1] += c * u - a * w
    out[VELOCITY + 2] += a * v - b * u
    normalise(q)
    sine = math.sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    scale = 2.0 * math.atan2(sine, q[0]) / sine if sine > 1e-9 else 2.0
    for i in range(3):
        out[i] = scale * q[1 + i]


@kernel
def _undo(node: Record, after: Floats, ps: Floats, before: Floats) -> None:
    """From the corrected node back to the predicted: `before` leads from that to the smoothed.

    Where the wind became a state, the velocity before it was that through the air, v - wind; where
    a heading was found, all is rotated back about down.
    """
    _add(after, node["applied"], before)
    if node["states"] > node["states_before"]:
        for i in range(2):
            v, w = VELOCITY + i, WIND + i
            if node["in_wind"] != 0:
                before[v] -= before[w]
                for k in range(ERROR_STATES):
                    ps[v, k] -= ps[w, k]
                for k in range(ERROR_STATES):
                    ps[k, v] -= ps[k, w]
        for i in range(node["states_before"], ERROR_STATES):
            before[i] = 0.0
            for k in range(ERROR_STATES):
                ps[i, k] = ps[k, i] = 0.0
    if node["rotated_rad"] != 0.0:
        _rotate_back(node["rotated_rad"], ps, before)


@kernel
def _rotate_back(angle_rad: float, ps: Floats, before: Floats) -> None:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    for k in (0, VELOCITY, WIND):
        x, y = before[k], before[k + 1]
        before[k], before[k + 1] = c * x + s * y, c * y - s * x
        for i in range(ERROR_STATES):
            x, y = ps[k, i], ps[k + 1, i]
            ps[k, i], ps[k + 1, i] = c * x + s * y, c * y - s * x
        for i in range(ERROR_STATES):
            x, y = ps[i, k], ps[i, k + 1]
            ps[i, k], ps[i, k + 1] = c * x + s * y, c * y - s * x


@kernel
def _step_back(
    node: Record, earlier: Record, before: Floats, d: Floats, ps: Floats, work: Floats
) -> None:
    """From `before` and `ps` at `node`, before its corrections, to `d` and `ps` at `earlier`."""
    n = node["states_before"]
    p, predicted, gain, change = work[0], work[1], work[2], work[3]
    _unpack(earlier["covariance"], p)
    predicted[:] = p
    gain[:] = p
    rotation_s, rate, impulse = node["rotation_s"], node["rate_rad_s"], node["impulse_m_s"]
    # `change` is written only afterwards: room till then.
    mekf.transition_rows(gain, n, rotation_s, rate, impulse, change)
    mekf.propagate(predicted, n, rotation_s, rate, impulse, change)
    _add_noise(predicted, gain, n, node["variance"])
    for i in range(n):
        for j in range(n):
            change[i, j] = ps[i, j] - predicted[i, j]
    _solve(predicted, gain, n)
    d[:] = 0.0
    ps[:] = p
    for i in range(n):
        for j in range(n):
            d[j] += gain[i, j] * before[i]
    smoothed = predicted
    for i in range(n):
        smoothed[i, :n] = 0.0
        for k in range(n):
            x = change[i, k]
            for j in range(n):
                smoothed[i, j] += x * gain[k, j]
    for k in range(n):
        for i in range(n):
            x = gain[k, i]
            for j in range(n):
                ps[i, j] += x * smoothed[k, j]


@kernel
def _add_noise(predicted: Floats, gain: Floats, n: int, variance: Floats) -> None:
    """Bring F P F^T and F P to the variances that were: noise adds, a bound scales."""
    for i in range(n):
        if variance[i] < predicted[i, i]:
            scale = math.sqrt(variance[i] / predicted[i, i])
            for j in range(n):
                gain[i, j] *= scale
                predicted[i, j] *= scale
                predicted[j, i] *= scale
        predicted[i, i] = variance[i]


@kernel
def _solve(a: Floats, b: Floats, n: int) -> None:
    """Solve a x = b in place of `b` [n, n], by the Cholesky factor in place of `a` [n, n].

    Each state is scaled to unit variance; one without variance takes no part.
    """
    scale = np.zeros(ERROR_STATES)
    for i in range(n):
        scale[i] = 1.0 / math.sqrt(a[i, i]) if a[i, i] > 0.0 else 0.0
    for i in range(n):
        for j in range(n):
            b[i, j] *= scale[i]
    for i in range(n):
        for j in range(i + 1):
            total = a[i, j] * scale[i] * scale[j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            if j < i:
                a[i, j] = total * a[j, j]
            else:
                a[i, i] = 1.0 / math.sqrt(total) if total > DEPENDENT else 0.0
        for k in range(i):
            x = a[i, k]
            for j in range(n):
                b[i, j] -= x * b[k, j]
        for j in range(n):
            b[i, j] *= a[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x = a[k, i]
            for j in range(n):
                b[i, j] -= x * b[k, j]
        for j in range(n):
            b[i, j] *= a[i, i]
    for i in range(n):
        for j in range(n):
            b[i, j] *= scale[i]


@kernel
def _fill(
    estimates: Rows,
    first: int,
    last: int,
    after: Floats,
    before: Floats,
    yaw: float,
    end: Floats,
    ps: Floats,
    field: float,
) -> None:
    """Write the samples between the nodes of samples `first` and `last`."""
    delta, variance = np.empty(ERROR_STATES), np.empty(ERROR_STATES)
    start_ns = estimates[first]["time_ns"]
    span_ns = estimates[last]["time_ns"] - start_ns
    for n in range(first + 1, last):
        share = 1.0
        if span_ns > 0:
            share = min(max((estimates[n]["time_ns"] - start_ns) / span_ns, 0.0), 1.0)
        for i in range(ERROR_STATES):
            delta[i] = after[i] + share * (before[i] - after[i])
            variance[i] = ps[i, i] + share * (end[i] - ps[i, i])
        _write(estimates[n], delta, yaw, variance, field)


@kernel
def _write(row: Record, delta: Floats, yaw: float, variance: Floats, field: float) -> None:
    """Smooth one row: `delta` leads from estimate to smoothed, then a rotation about down."""
    q, rate = row["ned_from_body"], row["rate_rad_s"]
    multiply(from_rotation_vector(delta[0], delta[1], delta[2]), q, q)
    multiply(from_rotation_vector(0.0, 0.0, yaw), q, q)
    normalise(q)
    w, x, y, z = q[0], q[1], q[2], q[3]
    down = (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z)
    a, b, c = rate[0], rate[1], rate[2]
    for i in range(3):
        m = GYRO_MATRIX + 3 * i
        crossed = delta[m] * a + delta[m + 1] * b + delta[m + 2] * c
        rate[i] -= delta[GYRO_BIAS + i] + crossed
        row["gyro_bias_rad_s"][i] += delta[GYRO_BIAS + i]
        row["accel_m_s2"][i] -= delta[ACCEL_BIAS + i]
        row["residual_m_s2"][i] = row["accel_m_s2"][i] + STANDARD_GRAVITY_M_S2 * down[i]
        added = field if i == 2 else 0.0
        row["attitude_sigma_rad"][i] = math.sqrt(max(variance[i], 0.0) + added)
        row["gyro_bias_sigma_rad_s"][i] = math.sqrt(max(variance[GYRO_BIAS + i], 0.0))
