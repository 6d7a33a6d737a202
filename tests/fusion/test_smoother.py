"""The backward pass over the history against the dense solution of the same linear problem."""

import numpy as np
import pytest

from ahrs_service import pipeline
from ahrs_service.fusion import mekf, smoother
from ahrs_service.fusion.smoother_history import CHAINED, NODE_DTYPE, START
from ahrs_service.fusion.states import (
    AIDED,
    ERROR_STATES,
    GATED,
    GYRO_BIAS,
    UNAIDED,
    VELOCITY,
    WIND,
)
from ahrs_service.records import ESTIMATE_DTYPE, empty
from ahrs_service.rotation import multiply_columns

SMALL = 1e-7
"""Angles so small that rotations about different axes add."""
LOWER = np.tril_indices(ERROR_STATES)


class Problem:
    """x' = F x + noise, y = H x + noise, from a known covariance, over few updates.

    With `wind_at` the velocity before that node is the one through the air, after it the one over
    ground; only then wind and lag are states of the filter.
    """

    def __init__(self, states, updates, seed, wind_at=0):
        rng = np.random.default_rng(seed)
        self.n, self.rng, self.wind_at = states, rng, wind_at
        self.start = np.diag(rng.uniform(0.5, 2.0, states)) * SMALL**2
        self.ways, self.noises, self.measured = [], [], []
        for _ in range(updates):
            rotation_s, rate, impulse = rng.normal(size=(3, 3)), *rng.normal(size=(2, 3))
            self.ways.append((rotation_s, rate, impulse))
            noise = rng.uniform(0.0, 0.3, states) * SMALL**2
            # The same along north and east, hence the same in rotated axes.
            for n in (1, VELOCITY + 1, WIND + 1):
                if n < states:
                    noise[n] = noise[n - 1]
            h = rng.normal(size=(2, states))
            if len(self.ways) <= wind_at:
                noise[UNAIDED:] = h[:, UNAIDED:] = 0.0
            self.noises.append(noise)
            self.measured.append((h, rng.normal(size=2) * SMALL, 0.1 * SMALL**2))

    def transition(self, way, update=0):
        f = np.zeros((ERROR_STATES, ERROR_STATES))
        np.fill_diagonal(f, 1.0)
        if self.wind_at and update == self.wind_at:
            f[VELOCITY, WIND] = f[VELOCITY + 1, WIND + 1] = 1.0
        mekf.transition_rows(f, self.n, *way, np.empty((3, ERROR_STATES)))
        return f[: self.n, : self.n]

    def dense(self):
        """States [updates + 1, n] and covariances given all measurements, in one piece."""
        n, updates = self.n, len(self.ways)
        size = n * (updates + 1)
        joint = np.zeros((size, size))
        joint[:n, :n] = self.start
        for k, (way, noise) in enumerate(zip(self.ways, self.noises, strict=True)):
            f, now, new = self.transition(way, k), k * n, (k + 1) * n
            joint[new : new + n, :new] = f @ joint[now : now + n, :new]
            joint[:new, new : new + n] = joint[new : new + n, :new].T
            joint[new : new + n, new : new + n] = f @ joint[now:new, now:new] @ f.T + np.diag(noise)
        h = np.zeros((2 * updates, size))
        for k, (one, _, _) in enumerate(self.measured):
            h[2 * k : 2 * k + 2, (k + 1) * n : (k + 2) * n] = one
        y = np.concatenate([y for _, y, _ in self.measured])
        r = np.diag(np.repeat([r for _, _, r in self.measured], 2))
        gain = np.linalg.solve(h @ joint @ h.T + r, h @ joint).T
        cov = joint - gain @ h @ joint
        blocks = [cov[k * n : (k + 1) * n, k * n : (k + 1) * n] for k in range(updates + 1)]
        return (gain @ y).reshape(updates + 1, n), np.array(blocks)

    def history(self):
        """The nodes that a Kalman filter leaves, and its estimates."""
        updates, n = len(self.ways), self.n
        nodes, rows = np.zeros(updates + 2, NODE_DTYPE), empty(ESTIMATE_DTYPE, updates + 1)
        x, p = np.zeros(n), self.start
        self._leave(nodes[1], rows[0], 0, x, p, np.zeros(n))
        into_wind = np.eye(n)
        if self.wind_at:
            into_wind[[VELOCITY, VELOCITY + 1], [WIND, WIND + 1]] = 1.0
        nodes[1]["kind"] = START
        for k, (way, noise) in enumerate(zip(self.ways, self.noises, strict=True)):
            # The filter brings the wind into the velocity as soon as it knows of one.
            f, node = self.transition(way), nodes[k + 2]
            x, p = f @ x, f @ p @ f.T + np.diag(noise)
            node["kind"], node["in_wind"] = CHAINED, 1
            node["states_before"] = n if k >= self.wind_at else UNAIDED
            node["rotation_s"], node["rate_rad_s"], node["impulse_m_s"] = way
            node["variance"][:n] = np.diag(p)
            h, y, r = self.measured[k]
            gain = np.linalg.solve(h @ p @ h.T + r * np.eye(2), h @ p).T
            correction = gain @ (y - h @ x)
            x, p = x + correction, p - gain @ h @ p
            if k + 1 == self.wind_at:
                p = into_wind @ p @ into_wind.T
            self._leave(node, rows[k + 1], k + 1, x, p, correction)
        return nodes, rows

    def _leave(self, node, row, sample, x, p, correction):
        n = self.n
        # Part of a correction may come late, as the magnetometer's does between two updates.
        share = self.rng.uniform()
        node["sample"], node["states"] = sample, n if sample >= self.wind_at else UNAIDED
        node["applied"][:n], node["late"][:n] = share * correction, (1.0 - share) * correction
        whole = np.zeros((ERROR_STATES, ERROR_STATES))
        whole[:n, :n] = p
        if node["states"] < n:
            whole[UNAIDED:] = whole[:, UNAIDED:] = 0.0
        node["covariance"] = whole[LOWER]
        held = x - node["late"][:n]
        row["time_ns"] = sample * 50_000_000
        row["ned_from_body"] = (1.0, *(0.5 * held[:3]))
        row["gyro_bias_rad_s"] = held[GYRO_BIAS : GYRO_BIAS + 3]
        row["rate_rad_s"] = row["accel_m_s2"] = 0.0
        row["attitude_sigma_rad"] = np.sqrt(np.diag(p)[:3])


@pytest.mark.parametrize("states", [GATED, UNAIDED, AIDED])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_way_back_finds_what_one_dense_solution_finds(states, seed):
    problem = Problem(states, 6, seed)
    nodes, rows = problem.history()
    smoother.smooth(nodes, len(nodes), rows)
    expected, covariances = problem.dense()
    angle, bias = 2.0 * rows["ned_from_body"][:, 1:], rows["gyro_bias_rad_s"]
    np.testing.assert_allclose(angle, expected[:, :3], atol=1e-5 * SMALL)
    np.testing.assert_allclose(bias, expected[:, 3:6], atol=1e-5 * SMALL)
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    np.testing.assert_allclose(rows["attitude_sigma_rad"] ** 2, variances[:, :3], rtol=1e-6)
    np.testing.assert_allclose(rows["gyro_bias_sigma_rad_s"] ** 2, variances[:, 3:6], rtol=1e-6)


def test_the_wind_that_is_found_later_parts_from_the_velocity_before():
    problem = Problem(AIDED, 6, 5, wind_at=3)
    nodes, rows = problem.history()
    smoother.smooth(nodes, len(nodes), rows)
    expected, covariances = problem.dense()
    np.testing.assert_allclose(
        2.0 * rows["ned_from_body"][:, 1:], expected[:, :3], atol=1e-5 * SMALL
    )
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    np.testing.assert_allclose(rows["attitude_sigma_rad"] ** 2, variances[:, :3], rtol=1e-6)


def rotated_about_down(angle):
    """Matrix [3, 3] of the rotation and the one [n, n] of all error states."""
    c, s = np.cos(angle), np.sin(angle)
    rotation, whole = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.eye(ERROR_STATES)
    for n in (0, VELOCITY, WIND):
        whole[n : n + 2, n : n + 2] = rotation[:2, :2]
    return rotation, whole


def covariance_of(node):
    p = np.zeros((ERROR_STATES, ERROR_STATES))
    p[LOWER] = node["covariance"]
    return p + np.tril(p, -1).T


@pytest.mark.parametrize("k", [1, 4])
def test_what_was_in_other_axes_before_a_heading_was_found_is_rotated_to_north(k):
    """The same history, up to node k in axes rotated by -angle."""
    angle = 2.0
    nodes, rows = Problem(AIDED, 6, 6).history()
    other, other_rows = nodes.copy(), rows.copy()
    rotation, whole = rotated_about_down(-angle)
    for n in range(1, k + 3):
        node = other[n]
        node["rotation_s"] = rotation @ node["rotation_s"]
        node["impulse_m_s"] = rotation @ node["impulse_m_s"]
        if n == k + 2:
            break
        for name in ("applied", "late"):
            node[name] = whole @ node[name]
        node["covariance"] = (whole @ covariance_of(node) @ whole.T)[LOWER]
        q = other_rows["ned_from_body"][n - 1]
        back = (np.cos(-0.5 * angle), 0.0, 0.0, np.sin(-0.5 * angle))
        other_rows["ned_from_body"][n - 1] = multiply_columns(back, q)
    other[k + 2]["rotated_rad"] = angle
    for n in range(2, k + 3):
        _predict(other[n], other[n - 1], nodes[n], nodes[n - 1])
    smoother.smooth(nodes, len(nodes), rows)
    smoother.smooth(other, len(other), other_rows)
    np.testing.assert_allclose(
        2.0 * other_rows["ned_from_body"][:, 1:],
        2.0 * rows["ned_from_body"][:, 1:],
        atol=1e-5 * SMALL,
    )
    np.testing.assert_allclose(
        other_rows["gyro_bias_sigma_rad_s"], rows["gyro_bias_sigma_rad_s"], rtol=1e-6
    )


def _predict(rotated, rotated_before, node, before):
    """Bring the variances predicted at `node` to `rotated`, whose noise is the same."""
    predicted = []
    for one, start in ((node, before), (rotated, rotated_before)):
        p = covariance_of(start)
        way = one["rotation_s"], one["rate_rad_s"], one["impulse_m_s"]
        mekf.propagate(p, AIDED, *way, np.empty((3, ERROR_STATES)))
        predicted.append(np.diag(p))
    rotated["variance"] = node["variance"] - predicted[0] + predicted[1]


def test_corrections_and_a_later_rotation_about_down_add_up():
    state = pipeline.new_state()[0]
    state["states"] = AIDED
    correction = state["correction"][:] = np.linspace(0.01, 0.24, ERROR_STATES)
    mekf.apply_correction(state)
    mekf.rotate_about_down(state, 0.7)
    _, whole = rotated_about_down(0.7)
    np.testing.assert_allclose(state["applied"], whole @ correction, atol=1e-15)
    assert state["rotated_rad"] == 0.7


def test_states_without_variance_take_no_part():
    """With a gyro matrix given as perfect, results are the same with and without these states."""
    problem = Problem(UNAIDED, 6, 3)
    problem.start[12:, 12:] = 0.0
    for noise in problem.noises:
        noise[12:] = 0.0
    nodes, rows = problem.history()
    smoother.smooth(nodes, len(nodes), rows)
    expected, _ = problem.dense()
    np.testing.assert_allclose(
        2.0 * rows["ned_from_body"][:, 1:], expected[:, :3], atol=1e-5 * SMALL
    )


def test_between_two_nodes_the_change_is_even():
    problem = Problem(UNAIDED, 2, 4)
    nodes, at_nodes = problem.history()
    nodes["sample"][1:] *= 5
    rows = empty(ESTIMATE_DTYPE, 11)
    for name in ("ned_from_body", "gyro_bias_rad_s", "rate_rad_s", "accel_m_s2"):
        # Between nodes the filter keeps what it had, here with a transition that keeps it too.
        rows[name] = np.repeat(at_nodes[name], 5, axis=0)[: len(rows)]
    rows["attitude_sigma_rad"] = np.repeat(at_nodes["attitude_sigma_rad"], 5, axis=0)[: len(rows)]
    rows["time_ns"] = np.arange(11) * 10_000_000
    before = rows.copy()
    smoother.smooth(nodes, len(nodes), rows)
    moved = (rows["ned_from_body"] - before["ned_from_body"])[:, 1:]
    bias = (rows["gyro_bias_rad_s"] - before["gyro_bias_rad_s"])[1:5]
    np.testing.assert_allclose(np.diff(moved[1:5], n=2, axis=0), 0.0, atol=1e-4 * SMALL)
    np.testing.assert_allclose(np.diff(bias, n=2, axis=0), 0.0, atol=1e-4 * SMALL)
    assert np.abs(np.diff(moved[1:5], axis=0)).min() > 1e-3 * SMALL
