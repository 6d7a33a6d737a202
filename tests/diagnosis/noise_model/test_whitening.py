"""The filter's likelihood against that of the whole covariance matrix, and its regression."""

import numpy as np
import pytest

from ahrs_service.diagnosis.hypotheses.likelihood import solve
from ahrs_service.diagnosis.noise_model.flight_filter import STATES, flight_gains, whiten_flight
from ahrs_service.diagnosis.noise_model.kalman import whiten_channel


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


def whitened_flight(rows, path, steps, missing, drive, start, white):
    count = len(rows)
    gains, roots = np.empty((count, STATES, 6)), np.empty((count, 6, 6))
    variances, out = np.empty((count, 6)), np.empty(rows.shape)
    flight_gains(*path, *steps, missing, drive, start, white, gains, roots, variances)
    whiten_flight(rows, *path, *steps, gains, roots, out)
    return out, np.log(variances)


@pytest.mark.parametrize("columns", [2, 37])
def test_a_flight_has_the_likelihood_of_its_covariance(columns):
    rng = np.random.default_rng(5)
    count, step_s = 12, 0.1
    keep = np.array([0.9, 0.99, 0.8, 0.98])
    drive = np.array([0.2, 0.1, 0.05, 0.3, 0.2, 0.04])
    start = np.array([1.0, 2.0, 0.5, 1.5, 3.0, 0.4])
    white = np.array([0.3, 0.6])
    rows = rng.normal(size=(count, 6, columns))
    unturned = np.broadcast_to(np.eye(3), (count, 3, 3)).copy()
    nothing = np.zeros((count, 3, 3))
    none, both = np.zeros(count), np.zeros((count, 2))
    out, log_variance = whitened_flight(
        rows,
        (unturned, nothing, unturned, none),
        (np.full(count, step_s), np.tile(keep, (count, 1))),
        both,
        np.tile(drive, (count, 1)),
        start,
        np.tile(np.repeat(white, 3), (count, 1)),
    )
    covariance = flight_covariance(count, step_s, keep, drive, start, white)
    expected, log_det = dense_likelihood(covariance, rows.reshape(6 * count, columns))
    flat = out.reshape(-1, columns)
    np.testing.assert_allclose(flat.T @ flat, expected.T @ expected, rtol=1e-9, atol=1e-9)
    assert log_variance.sum() == pytest.approx(log_det, rel=1e-9)


def model_matrices(turn, tilt, frame, keep, step_s):
    """Transition [18, 18] and measurement [6, 18] of the noise model of one row."""
    transition, measure = np.eye(18), np.zeros((6, 18))
    for first, kept in zip((0, 6, 9, 15), keep, strict=True):
        transition[first : first + 3, first : first + 3] *= kept
    transition[3:6, 6:9] = transition[12:15, 15:18] = turn * step_s
    transition[12:15, 0:3] = tilt
    measure[:3, 3:6] = measure[3:, 12:15] = np.eye(3)
    measure[:3, :3], measure[3:, 9:12] = -frame, -np.eye(3)
    return transition, measure


def test_a_turning_flight_with_gaps_is_whitened_as_by_dense_matrices():
    """The textbook filter in matrices, with tilt, uneven steps, a new begin and missing rows."""
    rng = np.random.default_rng(6)
    count = 15
    turn, frame = (np.linalg.qr(rng.normal(size=(count, 3, 3)))[0] for _ in range(2))
    tilt, rows = rng.normal(size=(count, 3, 3)), rng.normal(size=(count, 6, 9))
    begins, missing = np.zeros(count), np.zeros((count, 2))
    missing[6:8] = begins[8] = missing[3, 0] = missing[11:13, 1] = 1.0
    step_s, keep = rng.uniform(0.05, 0.2, count), rng.uniform(0.5, 1.0, (count, 4))
    drive, white = rng.uniform(0.1, 1.0, (count, 6)), rng.uniform(0.1, 1.0, (count, 6))
    start = rng.uniform(0.5, 2.0, 6)
    path, steps = (turn, tilt, frame, begins), (step_s, keep)
    out, log_variance = whitened_flight(rows, path, steps, missing, drive, start, white)
    p, x = np.diag(np.repeat(start, 3)), np.zeros((18, 9))
    for n in range(count):
        f, h = model_matrices(turn[n], tilt[n], frame[n], keep[n], step_s[n])
        if n > 0:
            p, x = f @ p @ f.T + np.diag(np.repeat(drive[n], 3)), f @ x
        if begins[n]:
            for first, variance in ((3, start[1]), (12, start[4])):
                part = slice(first, first + 3)
                p[part], p[:, part], x[part] = 0.0, 0.0, 0.0
                p[part, part] = variance * np.eye(3)
        seen = np.repeat(missing[n] == 0.0, 3)
        assert not out[n, ~seen].any()
        assert not log_variance[n, ~seen].any()
        h, innovation = h[seen], (rows[n] - h @ x)[seen]
        s = h @ p @ h.T + np.diag(white[n, seen])
        root = np.linalg.cholesky(s)
        np.testing.assert_allclose(out[n, seen], np.linalg.solve(root, innovation), rtol=1e-8)
        variances = 2.0 * np.log(np.diag(root))
        np.testing.assert_allclose(log_variance[n, seen], variances, rtol=1e-8)
        gain = np.linalg.solve(s, h @ p).T
        x = x + gain @ innovation
        p = p - gain @ h @ p


def test_columns_without_energy_are_left_out():
    gram = np.array([[4.0, 0.0], [0.0, 0.0]])
    solution, inverse, log_det = solve(gram, np.array([2.0, 0.0]))
    np.testing.assert_allclose(solution, [0.5, 0.0])
    np.testing.assert_allclose(inverse, [[0.25, 0.0], [0.0, 0.0]])
    assert log_det == pytest.approx(np.log(4.0))
