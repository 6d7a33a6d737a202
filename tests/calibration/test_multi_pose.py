"""Any poses without a table: known matrices, standard errors over many benches, numeric slopes."""

import itertools
import math

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ahrs_service.calibration.multi_pose import (
    fit_accelerometer,
    judge_accelerometer,
    norm_residuals,
)
from ahrs_service.calibration.pose_rotations import (
    fit_gyro,
    judge_gyro,
    rotation_residuals,
    rotations_between,
)
from ahrs_service.calibration.poses import directions, find_poses, rest_bias
from ahrs_service.calibration.rotating import rotation_and_leverage
from ahrs_service.calibration.verdict import judge
from tests.calibration.conftest import poses_of

G = 9.80665
C = np.array([[0.98, 0.004, -0.003], [0.004, 1.03, 0.002], [-0.003, 0.002, 1.01]])
B = np.array([0.1, -0.2, 0.3])


def spread(count, seed=1):
    up = np.random.default_rng(seed).normal(size=(count, 3))
    return up / np.linalg.norm(up, axis=1, keepdims=True)


def test_without_noise_the_known_matrix_is_found_exactly():
    force = G * spread(24) @ np.linalg.inv(C).T + B
    fit = fit_accelerometer(poses_of(force))
    assert np.linalg.inv(fit.matrix) == pytest.approx(C, abs=1e-10)
    assert fit.bias == pytest.approx(B, abs=1e-9)


def test_a_rotation_of_all_axes_is_unobservable_and_left_alone():
    """N = K A with any K: the fit gives its symmetric part in the polar decomposition."""
    matrix = Rotation.from_rotvec([0.01, -0.02, 0.005]).as_matrix() @ np.linalg.inv(C)
    force = G * spread(24) @ matrix.T + B
    fit = fit_accelerometer(poses_of(force))
    assert np.linalg.norm(fit.compensate(force), axis=1) == pytest.approx(G, abs=1e-9)
    inverse = np.linalg.inv(fit.matrix)
    assert inverse == pytest.approx(inverse.T, abs=1e-12)
    assert inverse @ inverse == pytest.approx(np.linalg.inv(matrix @ matrix.T), abs=1e-9)


def test_the_standard_errors_are_those_of_many_benches():
    rng = np.random.default_rng(3)
    up = spread(30)
    inside, squares = [], []
    for _ in range(200):
        noise = rng.normal(0.0, 0.01, up.shape)
        fit = fit_accelerometer(poses_of(G * up @ np.linalg.inv(C).T + B + noise))
        error = np.concatenate([(fit.matrix - np.linalg.inv(C)).ravel(), fit.bias - B])
        inside.append(np.abs(error) < np.sqrt(np.diag(fit.covariance)))
        free = [0, 4, 8, 1, 2, 5, 9, 10, 11]
        part = fit.covariance[np.ix_(free, free)]
        squares.append(error[free] @ np.linalg.solve(part, error[free]))
    assert 0.62 < np.mean(inside) < 0.72
    # F(9, 21): its mean is 21/19, its standard error over 200 draws some 4 %.
    assert np.mean(squares) / 9 == pytest.approx(21 / 19, rel=0.15)


def test_the_norm_jacobian_is_the_slope():
    evaluate = norm_residuals(G * spread(15) + B, G)
    at = np.array([1.01, 0.99, 1.02, 0.01, -0.02, 0.005, 0.1, 0.2, -0.1])
    _, jacobian = evaluate(at)
    for p in range(9):
        step = np.zeros(9)
        step[p] = 1e-6
        slope = (evaluate(at + step)[0] - evaluate(at - step)[0]) / 2e-6
        assert jacobian[:, p] == pytest.approx(slope, abs=1e-7)


def test_rotation_steps_add_up_to_the_rotation_of_scipy():
    rng = np.random.default_rng(4)
    t = np.arange(200) / 100.0
    rates = np.cumsum(rng.normal(0.0, 0.1, (200, 3)), axis=0)
    turn, leverage = np.empty((3, 3)), np.empty((3, 9))
    rotation_and_leverage(t, rates, np.eye(3), np.zeros(3), turn, leverage)
    expected = Rotation.identity()
    for a, b in itertools.pairwise(rates):
        expected = expected * Rotation.from_rotvec(0.5 * (a + b) / 100.0)
    assert turn == pytest.approx(expected.as_matrix(), abs=1e-12)


def test_the_rotation_jacobian_is_the_slope(bench):
    columns, _ = bench("multi-pose", 150.0, rate_hz=200.0)
    poses = find_poses(columns)
    turns = rotations_between(columns, poses)
    evaluate = rotation_residuals(
        columns, turns, directions(poses["accel_m_s2"]), rest_bias(poses)[0]
    )
    at = np.eye(3).ravel() + np.random.default_rng(5).normal(0.0, 0.01, 9)
    _, jacobian = evaluate(at)
    for p in range(9):
        step = np.zeros(9)
        step[p] = 1e-5
        slope = (evaluate(at + step)[0] - evaluate(at - step)[0]) / 2e-5
        # The leverage is summed with the mean of both ends of a step: second order in its angle.
        assert jacobian[:, p] == pytest.approx(slope, abs=1e-4 * np.abs(jacobian).max())


def test_both_triads_of_the_bench_are_found(bench):
    columns, flight = bench("multi-pose", 150.0, rate_hz=200.0)
    poses = find_poses(columns)
    accel = fit_accelerometer(poses)
    gyro = fit_gyro(columns, poses, accel)
    truth = np.array(flight.calibration.accel.matrix)
    # In the accelerometers' symmetric axes the gyros' matrix is rotated like theirs.
    u, _, vt = np.linalg.svd(truth)
    turned = u @ vt
    symmetric = truth @ turned.T
    assert accel.matrix == pytest.approx(symmetric, abs=8e-4)
    assert accel.bias == pytest.approx(flight.calibration.accel.bias, abs=6e-3)
    gyro_truth = np.array(flight.calibration.gyro.matrix) @ turned.T
    assert np.abs(gyro.matrix - gyro_truth).max() < 6e-4
    verdict = judge(
        "multi-pose",
        (judge_accelerometer(poses, accel), judge_gyro(columns, poses, accel, gyro)),
    )
    assert verdict.words == "use"
    assert all(triad.gain > 0.5 for triad in verdict.triads)


def test_the_gyros_standard_errors_are_those_of_many_benches(bench):
    """Nine normalised errors over ten benches, the accelerometers taken as found."""
    inside, squares = [], []
    for seed in range(10):
        columns, flight = bench("multi-pose", 130.0, seed=seed)
        poses = find_poses(columns)
        accel = fit_accelerometer(poses)
        gyro = fit_gyro(columns, poses, accel)
        u, _, vt = np.linalg.svd(np.array(flight.calibration.accel.matrix))
        error = (gyro.matrix - np.array(flight.calibration.gyro.matrix) @ (u @ vt).T).ravel()
        part = gyro.covariance[:9, :9]
        inside.append(np.abs(error) < np.sqrt(np.diag(part)))
        squares.append(error @ np.linalg.solve(part, error) / 9)
    assert 0.5 < np.mean(inside) < 0.85
    assert 0.5 < np.mean(squares) < 1.8


def test_the_gyros_fit_is_that_of_scipy(bench):
    columns, _ = bench("multi-pose", 130.0)
    poses = find_poses(columns)
    accel = fit_accelerometer(poses)
    gyro = fit_gyro(columns, poses, accel)
    up = directions(accel.compensate(poses["accel_m_s2"]))
    evaluate = rotation_residuals(columns, rotations_between(columns, poses), up, gyro.bias)
    theirs = least_squares(lambda p: evaluate(p)[0], np.eye(3).ravel(), xtol=1e-13, ftol=1e-13)
    assert np.linalg.inv(gyro.matrix).ravel() == pytest.approx(theirs.x, abs=1e-6)


def test_held_out_directions_stay_out_of_the_fit():
    """Poses with the same error in one direction cannot confirm each other."""
    up = spread(14)
    force = G * up @ np.linalg.inv(C).T + B
    doubled = np.concatenate([force, force])
    verdict = judge_accelerometer(poses_of(doubled), fit_accelerometer(poses_of(doubled)))
    single = judge_accelerometer(poses_of(force), fit_accelerometer(poses_of(force)))
    assert verdict.held_out_after == pytest.approx(single.held_out_after, abs=1e-9)
    assert math.isclose(verdict.coverage, single.coverage)
