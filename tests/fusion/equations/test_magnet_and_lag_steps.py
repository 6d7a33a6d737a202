"""Lag of a magnetometer and its attached field, against numbers worked out by hand."""

import math

import numpy as np
import pytest

from ahrs_service.fusion import field_lag, hard_iron
from tests.error_state import attitude, matrix_of
from tests.magnetic_field import FIELD, facing


def lag_state():
    state = facing()
    state["iron_covariance"], state["iron_ut"] = 4.0 * np.eye(3), 0.0
    field_lag.start(state)
    return state


def test_the_lag_is_the_motion_of_the_field_over_its_rate():
    """D changes by 10 uT/s to the east, e by 0.2 uT: 20 ms, of which K 10 with 0.03 s, 2 * 1 uT^2.

    V / (V 100 + 2) = 9e-4 / 2.09: 0.861 ms, and V becomes 2 of that.
    """
    state, still = lag_state(), np.eye(3)
    field_lag.learn(state, FIELD, np.zeros(3), still, 1.0, 0.1)
    assert state["field_lag_s"] == 0.0
    moved, turning = np.add(FIELD, [0.0, 0.2, 0.0]), np.array([0.0, 10.0, 0.0])
    field_lag.learn(state, 2.0 * moved, 2.0 * turning, 2.0 * still, 0.5, 0.1)
    share = 9e-4 / (9e-4 * 100.0 + 2.0)
    assert state["field_lag_s"] == pytest.approx(share * 2.0, rel=1e-9)
    assert state["field_lag_variance_s2"] == pytest.approx(share * 2.0, rel=1e-9)
    # Back again: -10 uT/s and -0.2 uT, of which the lag so far explains its part.
    lag, variance = state["field_lag_s"], state["field_lag_variance_s2"] + 4e-8 * 0.1
    field_lag.learn(state, FIELD, np.zeros(3), still, 1.0, 0.1)
    share = variance / (variance * 100.0 + 2.0)
    left = lag + share * 10.0 * (0.2 - 10.0 * lag)
    assert state["field_lag_s"] == pytest.approx(left, rel=1e-9)


def test_what_the_attached_magnet_moves_is_no_lag():
    """A quarter turn to the right moves a magnet of 5 uT ahead from north to east.

    Its own 4 uT^2 along (C2 - C1), rows (-1, -1, 0) and (1, -1, 0), make (8 + 8 + 0) / 3 of noise.
    """
    state = lag_state()
    state["iron_ut"] = (5.0, 0.0, 0.0)
    north, east = np.eye(3), matrix_of(attitude([0.0, 0.0, 0.5 * math.pi]))
    field_lag.learn(state, np.add(FIELD, [5.0, 0.0, 0.0]), np.zeros(3), north, 1.0, 0.1)
    turning = np.array([0.0, 10.0, 0.0])
    field_lag.learn(state, np.add(FIELD, [0.0, 5.2, 0.0]), turning, east, 1.0, 0.1)
    share = 9e-4 / (9e-4 * 100.0 + 2.0 + 16.0 / 3.0)
    assert state["field_lag_s"] == pytest.approx(share * 2.0, rel=1e-9)


def test_an_outlier_of_the_lag_counts_less():
    """30 uT: 900 / (4 (9e-4 * 100 + 3 * 2)) = 36.945 times the noise of 2."""
    state = lag_state()
    field_lag.learn(state, FIELD, np.zeros(3), np.eye(3), 1.0, 0.1)
    turning = np.array([0.0, 10.0, 0.0])
    field_lag.learn(state, np.add(FIELD, [0.0, 30.0, 0.0]), turning, np.eye(3), 1.0, 0.1)
    noise = 2.0 * 900.0 / (4.0 * 6.09)
    share = 9e-4 / (0.09 + noise)
    assert state["field_lag_s"] == pytest.approx(share * 300.0, rel=1e-9)


def windows(state, *fields_and_matrices):
    for field, dcm in fields_and_matrices:
        for _ in range(3):
            hard_iron.gather(state, 2.0 * np.asarray(field, np.float64), 2.0 * dcm, 0.5, 0.51)


def test_a_magnet_is_what_moves_with_the_matrix_from_window_to_window():
    """(C2 - C1) b = e2 - e1, each row in its turn: dense, with 2 uT^2 of the fields and a walk.

    A quarter turn to the right of (6, -2, 1): C2 - C1 has the rows (-1, -1, 0), (1, -1, 0), 0.
    """
    state, b = lag_state(), np.array([6.0, -2.0, 1.0])
    north, east = np.eye(3), matrix_of(attitude([0.0, 0.0, 0.5 * math.pi]))
    windows(state, (FIELD + north @ b, north), (FIELD + east @ b, east))
    # 0.3 uT per root of a second, over two windows of 1.53 s.
    p = (4.0 + 2.0 * 0.09 * 1.53) * np.eye(3)
    h = east - north
    gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + 2.0 * np.eye(3))
    np.testing.assert_allclose(state["iron_ut"], gain @ h @ b, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(state["iron_covariance"], p - gain @ h @ p, rtol=1e-9, atol=1e-12)
    windows(state, (FIELD + north @ b, north))
    p, first = p - gain @ h @ p + 0.09 * 1.53 * np.eye(3), gain @ h @ b
    gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + 2.0 * np.eye(3))
    np.testing.assert_allclose(state["iron_ut"], first + gain @ h @ (b - first), rtol=1e-9)


def test_iron_is_used_where_the_field_is_far_better_without():
    """Averages over 5 s: after 5 s half of each. 10 as read and 3 freed: 3 + 1 < 0.5 * 10."""
    for read, freed, is_used in ((20.0, 6.0, True), (20.0, 9.0, False), (20.0, 8.1, False)):
        state = lag_state()
        assert hard_iron.judge(state, read, freed, 5.0) == is_used
        assert state["read_misfit_ut2"] == pytest.approx(10.0)
        assert state["freed_misfit_ut2"] == pytest.approx(0.5 * freed)
