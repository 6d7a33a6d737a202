"""Rotation and velocity preintegrated between references, against closed-form motions."""

import numpy as np
from scipy.spatial.transform import Rotation

from ahrs_service.diagnosis.input.preintegration import preintegrate


def preintegrated(imu_s, gyro, accel, at_s, excess=(0.0, 0.0, 0.0)):
    turns, speeds = np.empty((len(at_s) - 1, 4)), np.empty((len(at_s) - 1, 3))
    preintegrate(imu_s, gyro, accel, at_s, np.tile(excess, (len(at_s) - 1, 1)), turns, speeds)
    return turns, speeds


def test_a_steady_rotation_is_exact_between_instants_off_the_grid():
    imu_s = np.arange(0.0, 2.0, 0.005)
    rate = np.array([0.3, -0.8, 1.2])
    gyro, accel = np.tile(rate, (len(imu_s), 1)), np.zeros((len(imu_s), 3))
    at_s = np.array([0.0131, 0.2, 0.777, 1.9])
    turns, speeds = preintegrated(imu_s, gyro, accel, at_s)
    for turn, length in zip(turns, np.diff(at_s), strict=True):
        x, y, z, w = Rotation.from_rotvec(rate * length).as_quat()
        np.testing.assert_allclose(turn, [w, x, y, z], atol=1e-12)
    np.testing.assert_array_equal(speeds, 0.0)


def coning_error(rate_hz):
    """Error of a second of coning of 10 deg at 2 Hz, whose axis turns 0.19 rad/s."""
    imu_s = np.arange(0.0, 1.0 + 2.0 / rate_hz, 1.0 / rate_hz)
    half, w = np.radians(10.0), 4.0 * np.pi
    q = np.stack(
        [
            np.cos(half / 2.0) * np.ones_like(imu_s),
            np.sin(half / 2.0) * np.cos(w * imu_s),
            np.sin(half / 2.0) * np.sin(w * imu_s),
            0.0 * imu_s,
        ],
        axis=1,
    )
    gyro = np.stack(
        [
            -w * np.sin(half) * np.sin(w * imu_s),
            w * np.sin(half) * np.cos(w * imu_s),
            -2.0 * w * np.sin(half / 2.0) ** 2 * np.ones_like(imu_s),
        ],
        axis=1,
    )
    turns, _ = preintegrated(imu_s, gyro, np.zeros_like(gyro), np.array([0.0, 0.9]))
    n = round(0.9 * rate_hz)
    expected = Rotation.from_quat(q[0][[1, 2, 3, 0]]).inv() * Rotation.from_quat(q[n][[1, 2, 3, 0]])
    found = Rotation.from_quat(turns[0][[1, 2, 3, 0]])
    return (expected.inv() * found).magnitude()


def test_coning_converges_with_the_square_of_the_step():
    coarse, fine = coning_error(100.0), coning_error(200.0)
    assert coarse < 2e-3
    assert 3.5 < coarse / fine < 4.5


def test_force_in_a_rotating_body_is_resolved_in_axes_at_the_interval_start():
    imu_s = np.arange(0.0, 2.01, 0.01)
    rate = 0.5
    gyro = np.tile([0.0, 0.0, rate], (len(imu_s), 1))
    accel = np.stack([np.cos(rate * imu_s), -np.sin(rate * imu_s), 0.0 * imu_s], axis=1)
    _, speeds = preintegrated(imu_s, gyro, accel, np.array([0.0, 2.0]))
    np.testing.assert_allclose(speeds[0], [2.0, 0.0, 0.0], atol=1e-4)
    biased = preintegrated(
        imu_s, gyro + np.array([0.1, 0.0, -0.2]), accel, np.array([0.0, 2.0]), [0.1, 0.0, -0.2]
    )
    np.testing.assert_allclose(biased[1][0], [2.0, 0.0, 0.0], atol=1e-4)
