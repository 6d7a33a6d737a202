"""An IMU rate too low for a vehicle's rotation is refused, with advice on what to record."""

import numpy as np
import pytest

from ahrs_service.diagnosis.diagnose import compare
from ahrs_service.diagnosis.input.diagnosis_input import Recorded, Series


def swinging(rate_hz, seconds=300.0, turn_rad_s=0.5):
    """A vehicle at rest that swings about its x axis at 0.2 Hz, seen by an ideal IMU."""
    omega = 2.0 * np.pi * 0.2
    imu_s, reference_s = np.arange(0.0, seconds, 1.0 / rate_hz), np.arange(0.0, seconds, 0.02)
    roll = turn_rad_s / omega * np.sin(omega * reference_s)
    gyro, accel = np.zeros((len(imu_s), 3)), np.zeros((len(imu_s), 3))
    gyro[:, 0] = turn_rad_s * np.cos(omega * imu_s)
    at_imu = turn_rad_s / omega * np.sin(omega * imu_s)
    accel[:, 1], accel[:, 2] = -9.80665 * np.sin(at_imu), -9.80665 * np.cos(at_imu)
    zero = np.zeros(len(roll))
    attitude = np.stack([np.cos(0.5 * roll), np.sin(0.5 * roll), zero, zero], axis=1)
    velocity = np.stack([zero + 1e-3, zero, zero], axis=1)
    return Recorded(
        "a.tlog",
        imu_s,
        gyro,
        accel,
        Series(reference_s, attitude),
        Series(reference_s, velocity),
        *(Series() for _ in range(6)),
    )


def test_one_sample_a_second_is_refused_and_ten_are_not():
    with pytest.raises(ValueError, match=r"recorded at 1 Hz, too slow .* HIGHRES_IMU at 25 Hz"):
        compare(swinging(1.0))
    assert np.abs(compare(swinging(10.0)).rows[:, :3]).max() < 1e-3


def test_at_rest_one_sample_a_second_is_enough():
    assert np.isfinite(compare(swinging(1.0, turn_rad_s=1e-3)).rows).all()
