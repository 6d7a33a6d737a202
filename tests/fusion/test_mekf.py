"""The filter's sparse kernels against the same in dense matrices."""

import math

import numpy as np
import pytest

from ahrs_service.fusion import mekf, states
from ahrs_service.pipeline import new_state
from ahrs_service.rotation import matrix, rotate_columns

COUNTS = [states.GATED, states.UNAIDED, states.AIDED]


def covariance(rng, count):
    p = np.zeros((states.ERROR_STATES, states.ERROR_STATES))
    root = rng.normal(size=(count, count))
    p[:count, :count] = root @ root.T
    return p


def cross(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


@pytest.mark.parametrize("count", COUNTS)
def test_the_covariance_goes_on_as_by_the_dense_transition(count):
    rng = np.random.default_rng(3)
    p = covariance(rng, count)
    rotation_s = 0.05 * np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rate, impulse = rng.normal(size=3), rng.normal(size=3)
    f = np.eye(states.ERROR_STATES)
    f[0:3, 3:6] = -rotation_s
    if count > states.GATED:
        f[0:3, 12:21] = -rotation_s @ np.kron(np.eye(3), rate)
        f[6:9, 0:3] = -cross(impulse)
        f[6:9, 9:12] = -rotation_s
    expected = f @ p @ f.T
    mekf.propagate(p, count, rotation_s, rate, impulse, np.empty((3, states.ERROR_STATES)))
    np.testing.assert_allclose(p, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(p, p.T)


def filter_state(rng, count):
    """State of a filter of `count` error states, of the others the variances are 0."""
    state = new_state()[0]
    state["states"] = count
    state["covariance"][:] = covariance(rng, count)
    return state


@pytest.mark.parametrize("measurements", [1, 2, 3, 4, 6])
@pytest.mark.parametrize("count", COUNTS)
def test_measurements_correct_as_the_dense_filter_does(count, measurements):
    rng = np.random.default_rng(4)
    state = filter_state(rng, count)
    expected_p, expected_x = state["covariance"].copy(), np.zeros(states.ERROR_STATES)
    for _ in range(measurements):
        h = np.zeros(states.ERROR_STATES)
        h[:count] = rng.normal(size=count) * (rng.random(count) < 0.3)
        innovation, variance = rng.normal(), 0.7
        s = h @ expected_p @ h + variance
        surprise = innovation - h @ expected_x
        gain = expected_p @ h / s
        expected_x = expected_x + gain * surprise
        expected_p = expected_p - np.outer(gain, h @ expected_p)
        state["measured"][:] = h
        mekf.correct(state, innovation, variance)
        for which in range(count):
            assert mekf.variance_of(state, which) == pytest.approx(expected_p[which, which])
    mekf.settle(state)
    p = state["covariance"]
    np.testing.assert_allclose(p, expected_p, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(state["correction"], expected_x, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(p, p.T)


@pytest.mark.parametrize("pending", [0, 1, 3])
@pytest.mark.parametrize("count", COUNTS)
def test_one_state_measured_directly_is_the_row_of_a_unit_vector(count, pending):
    directly, by_row = (filter_state(np.random.default_rng(5), count) for _ in range(2))
    for state in (directly, by_row):
        for which in range(pending):
            mekf.correct_state(state, which, 0.1, 0.4)
    which = count - 1
    mekf.correct_state(directly, which, 0.3, 0.5)
    by_row["measured"][which] = 1.0
    mekf.correct(by_row, 0.3, 0.5)
    for state in (directly, by_row):
        mekf.settle(state)
    np.testing.assert_allclose(directly["covariance"], by_row["covariance"], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(directly["correction"], by_row["correction"], rtol=1e-9)


@pytest.mark.parametrize("force", [(0.1, -0.2, -9.8), (5.0, 3.0, -8.0), (-2.0, 1.0, 6.0)])
def test_the_tilt_of_a_force_rotates_it_upright(force):
    tilt = np.empty(2)
    mekf.tilt_from_force(np.array(force), tilt)
    angle = float(np.linalg.norm(tilt))
    q = np.array([math.cos(angle / 2), *(math.sin(angle / 2) * np.array([*tilt, 0.0]) / angle)])
    upright = rotate_columns(q[None], np.array([force]))[0]
    np.testing.assert_allclose(upright, [0.0, 0.0, -np.linalg.norm(force)], atol=1e-12)


def test_rotation_about_down_rotates_state_and_covariance_alike():
    """A measurement along the rotated axis before equals one along the axis after."""
    rng = np.random.default_rng(6)
    state = new_state()[0]
    state["covariance"][:] = covariance(rng, states.AIDED)
    state["velocity_ned_m_s"] = (3.0, 4.0, 5.0)
    before = state["covariance"].copy()
    mekf.rotate_about_down(state, math.pi / 2)
    np.testing.assert_allclose(state["velocity_ned_m_s"], [-4.0, 3.0, 5.0], atol=1e-12)
    expected = np.zeros((3, 3))
    matrix(state["ned_from_body"], expected)
    np.testing.assert_allclose(state["dcm"], expected, atol=1e-12)
    after = state["covariance"]
    for k in (0, states.VELOCITY, states.WIND):
        assert after[k + 1, k + 1] == pytest.approx(before[k, k])
        assert after[k, 12] == pytest.approx(-before[k + 1, 12])
    np.testing.assert_allclose(np.linalg.eigvalsh(after), np.linalg.eigvalsh(before), rtol=1e-6)
