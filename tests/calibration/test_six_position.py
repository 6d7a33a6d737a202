"""Six positions: the closed form, its standard errors, the simulated bench, known rotations."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from ahrs_service.calibration import known_rotations
from ahrs_service.calibration.poses import find_poses
from ahrs_service.calibration.six_position import (
    FACES,
    faces_of,
    fit_accelerometer,
    judge_accelerometer,
)
from ahrs_service.calibration.verdict import judge
from tests.calibration.conftest import poses_of

G = 9.80665
UP = np.concatenate([np.eye(3), -np.eye(3)])
K = np.array([[1.02, 0.01, -0.005], [0.002, 0.98, 0.004], [-0.003, 0.006, 1.01]])
B = np.array([0.1, -0.2, 0.3])


def test_six_poses_give_the_closed_form():
    force = G * UP @ K.T + B + np.random.default_rng(1).normal(0.0, 0.02, (6, 3))
    fit = fit_accelerometer(poses_of(force))
    plus, minus = force[:3], force[3:]
    assert pytest.approx((plus - minus) / (2 * G)) == fit.matrix.T
    assert fit.bias == pytest.approx(force.mean(axis=0))


def test_without_noise_the_truth_is_found_exactly():
    force = G * UP @ K.T + B
    fit = fit_accelerometer(poses_of(force))
    assert fit.matrix == pytest.approx(K, abs=1e-12)
    assert fit.bias == pytest.approx(B, abs=1e-11)
    assert fit.compensate(force) == pytest.approx(G * UP, abs=1e-11)


def test_the_standard_errors_are_those_of_many_benches():
    """The twelve normalised errors over 300 benches: chi-square by the fitted covariance."""
    rng = np.random.default_rng(2)
    up = np.concatenate([UP] * 4)
    inside, squares = [], []
    for _ in range(300):
        fit = fit_accelerometer(poses_of(G * up @ K.T + B + rng.normal(0.0, 0.02, up.shape)))
        error = np.concatenate([(fit.matrix - K).ravel(), fit.bias - B])
        inside.append(np.abs(error) < np.sqrt(np.diag(fit.covariance)))
        squares.append(error @ np.linalg.solve(fit.covariance, error))
    # 60 degrees of freedom of sigma make t of the normal: 68 % within one sigma, nearly.
    assert 0.65 < np.mean(inside) < 0.71
    # F(12, 60) has the mean 60/58 and, over 300 draws, a standard error of about 2.6 %.
    assert np.mean(squares) / 12 == pytest.approx(60 / 58, abs=0.1)


def test_the_bench_gives_the_sensor_back(bench):
    columns, flight = bench("six-position", 120.0)
    poses = find_poses(columns)
    fit = fit_accelerometer(poses)
    truth = flight.calibration.accel
    error = np.concatenate([(fit.matrix - truth.matrix).ravel(), fit.bias - truth.bias])
    assert error @ np.linalg.solve(fit.covariance, error) < chi2.ppf(0.999, 12)
    verdict = judge("six-position", (judge_accelerometer(poses, fit),))
    (triad,) = verdict.triads
    assert verdict.words == "use"
    assert triad.gain > 0.9
    assert max(triad.rms_after) < 0.1 * max(triad.rms_before)
    assert len(triad.standard_errors) == 12


def test_full_circles_give_the_gyros(bench):
    columns, flight = bench("six-position", 120.0)
    poses = find_poses(columns)
    accel = fit_accelerometer(poses)
    turns = known_rotations.find_rotations(columns, poses, accel, 360.0)
    assert len(turns.truth) == 6
    assert np.linalg.norm(turns.truth, axis=1) == pytest.approx(2 * math.pi)
    assert turns.left_out == ()
    gyro = known_rotations.fit_gyro(poses, turns)
    truth = flight.calibration.gyro
    error = (gyro.matrix - truth.matrix).ravel()
    # Nine parameters of eighteen sums leave nine degrees of freedom to sigma.
    limit = 9 * f_distribution.ppf(0.999, 9, 9)
    assert error @ np.linalg.solve(gyro.covariance[:9, :9], error) < limit
    assert np.abs(error).max() < 5e-4
    assert gyro.bias == pytest.approx(truth.bias, abs=1e-4)
    triad = known_rotations.judge_gyro(poses, turns, gyro)
    assert triad.gain > 0.7


def test_a_sensor_without_errors_is_not_made_worse_unnoticed(bench, perfect):
    """Nothing to gain: either the held-out data are no worse, or the verdict refuses."""
    noisy = replace(perfect, accel_noise=replace(perfect.accel_noise, density=2e-3))
    columns, _ = bench("six-position", 120.0, imu=noisy)
    poses = find_poses(columns)
    triad = judge_accelerometer(poses, fit_accelerometer(poses))
    verdict = judge("six-position", (triad,))
    assert verdict.is_refused == (triad.held_out_after > triad.held_out_before)
    assert verdict.is_refused
    assert "held out got worse" in verdict.words


def test_faces_are_reported_by_what_is_up():
    faces, tilt = faces_of(9.8 * UP)
    assert [FACES[k] for k in faces] == ["+x", "+y", "+z", "-x", "-y", "-z"]
    assert tilt == pytest.approx(0.0, abs=1e-7)
    _, tilt = faces_of(np.array([[1.0, 1.0, 0.0]]))
    assert tilt == pytest.approx(math.pi / 4)
