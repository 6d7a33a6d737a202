"""The filter's likelihood against that of the whole covariance matrix, and its regression."""

import numpy as np
import pytest

from ahrs_service.diagnosis.kalman import whiten_channel, whiten_flight
from ahrs_service.diagnosis.likelihood import solve


def dense_likelihood(covariance, rows):
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, rows)
    return white, 2.0 * np.log(np.diag(root)).sum()


def test_a_channel_has_the_likelihood_of_its_covariance():
    rng = np.random.default_rng(3)
    count, white, wander, keep = 60, 0.3, 0.7, 0.9
    lags = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    covariance = white * np.eye(count) + wander * keep**lags
    rows = rng.normal(size=(count, 2))
    out, log_variance = np.empty(rows.shape), np.empty(count)
    whiten_channel(rows, np.zeros(count), white, wander, keep, out, log_variance)
    expected, log_det = dense_likelihood(covariance, rows)
    np.testing.assert_allclose(out.T @ out, expected.T @ expected, rtol=1e-10)
    assert log_variance.sum() == pytest.approx(log_det, rel=1e-10)


def test_missing_rows_are_as_if_never_asked():
    rng = np.random.default_rng(4)
    count, white, wander, keep = 40, 0.3, 0.7, 0.9
    lags = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    covariance = white * np.eye(count) + wander * keep**lags
    missing = np.zeros(count)
    missing[10:17] = 1.0
    there = missing == 0.0
    rows = rng.normal(size=(count, 1))
    out, log_variance = np.empty(rows.shape), np.empty(count)
    whiten_channel(rows, missing, white, wander, keep, out, log_variance)
    expected, log_det = dense_likelihood(covariance[np.ix_(there, there)], rows[there])
    assert np.sum(out**2) == pytest.approx(np.sum(expected**2))
    assert log_variance.sum() == pytest.approx(log_det)


def flight_covariance(count, step_s, keep, drive, start, white):
    """Covariance of level, unturned flight [6 N, 6 N] by running the model's matrices."""
    transition = np.eye(18)
    for i in range(3):
        transition[i, i], transition[6 + i, 6 + i] = keep[0], keep[1]
        transition[9 + i, 9 + i], transition[15 + i, 15 + i] = keep[2], keep[3]
        transition[3 + i, 6 + i] = transition[12 + i, 15 + i] = step_s
    noise = np.diag(np.repeat(drive, 3))
    state = np.diag(np.repeat(start, 3))
    measure = np.zeros((6, 18))
    for i in range(3):
        measure[i, 3 + i], measure[i, i] = 1.0, -1.0
        measure[3 + i, 12 + i], measure[3 + i, 9 + i] = 1.0, -1.0
    states = [state]
    for _ in range(count - 1):
        states.append(transition @ states[-1] @ transition.T + noise)
    total = np.zeros((6 * count, 6 * count))
    for a in range(count):
        carried = states[a]
        for b in range(a, count):
            block = measure @ carried @ measure.T
            total[6 * b : 6 * b + 6, 6 * a : 6 * a + 6] = block
            total[6 * a : 6 * a + 6, 6 * b : 6 * b + 6] = block.T
            carried = transition @ carried
        total[6 * a : 6 * a + 6, 6 * a : 6 * a + 6] += np.diag(np.repeat(white, 3))
    return total


def test_a_flight_has_the_likelihood_of_its_covariance():
    rng = np.random.default_rng(5)
    count, step_s = 12, 0.1
    keep = np.array([0.9, 0.99, 0.8, 0.98])
    drive = np.array([0.2, 0.1, 0.05, 0.3, 0.2, 0.04])
    start = np.array([1.0, 2.0, 0.5, 1.5, 3.0, 0.4])
    white = np.array([0.3, 0.6])
    rows = rng.normal(size=(count, 6, 2))
    out, log_variance = np.empty(rows.shape), np.empty(rows.shape[:2])
    unturned = np.broadcast_to(np.eye(3), (count, 3, 3)).copy()
    nothing = np.zeros((count, 3, 3))
    none = np.zeros(count)
    whites = np.tile(np.repeat(white, 3), (count, 1))
    steps_s, keeps, drives = (np.tile(one, (count, 1)) for one in (step_s, keep, drive))
    steps_s = steps_s[:, 0]
    whiten_flight(
        rows, unturned, nothing, unturned, none, none, steps_s, keeps, drives, start, whites, out,
        log_variance,
    )  # fmt: skip
    covariance = flight_covariance(count, step_s, keep, drive, start, white)
    expected, log_det = dense_likelihood(covariance, rows.reshape(6 * count, 2))
    flat = out.reshape(-1, 2)
    np.testing.assert_allclose(flat.T @ flat, expected.T @ expected, rtol=1e-9)
    assert log_variance.sum() == pytest.approx(log_det, rel=1e-9)


def test_columns_without_energy_are_left_out():
    gram = np.array([[4.0, 0.0], [0.0, 0.0]])
    solution, inverse, log_det = solve(gram, np.array([2.0, 0.0]))
    np.testing.assert_allclose(solution, [0.5, 0.0])
    np.testing.assert_allclose(inverse, [[0.25, 0.0], [0.0, 0.0]])
    assert log_det == pytest.approx(np.log(4.0))
