"""The pipeline on streams with a known attitude."""

import math

import numpy as np
import pytest

from ahrs_service.estimator import Estimator
from ahrs_service.records import Flag, Gate, Phase
from ahrs_service.rotation import (
    euler_columns,
    inverse_columns,
    quaternion_columns,
    rotate_columns,
)
from tests.streams import run, still


@pytest.mark.parametrize("roll", [-2.8, -0.7, 0.0, 0.4, 3.1])
@pytest.mark.parametrize("pitch", [-1.3, 0.0, 0.6])
def test_rest_at_any_tilt_is_found(roll, pitch):
    estimate = run(still(300, roll, pitch))[-1:]
    found = euler_columns(estimate["ned_from_body"])[0]
    np.testing.assert_allclose(found[:2], [roll, pitch], atol=1e-6)
    assert estimate["phase"] == Phase.RUNNING
    assert estimate["gate"] == Gate.OPEN


def test_gyro_bias_is_taken_at_rest():
    samples = still(3000)
    bias = np.array([0.02, -0.01, 0.03])
    samples["gyro_rad_s"] = bias
    estimate = run(samples)[-1]
    np.testing.assert_allclose(estimate["gyro_bias_rad_s"], bias, atol=5e-4)
    np.testing.assert_allclose(estimate["rate_rad_s"], 0.0, atol=5e-4)


def test_bias_that_appears_in_flight_is_learnt_about_the_horizontal_axes():
    samples = still(30_000)
    samples["gyro_rad_s"][3000:] = (0.01, -0.02, 0.0)
    estimate = run(samples)[-1]
    np.testing.assert_allclose(estimate["gyro_bias_rad_s"][:2], [0.01, -0.02], atol=2e-3)


def test_a_turn_is_integrated():
    samples = still(500)
    samples["gyro_rad_s"][200:300] = (0.0, 0.0, math.pi / 2)
    yaw = euler_columns(run(samples)["ned_from_body"])[:, 2]
    assert math.degrees(yaw[-1]) == pytest.approx(90.0, abs=0.01)


def test_each_motion_closes_the_gate_for_its_own_reason():
    pushed = still(400)
    pushed["accel_m_s2"][300:, 2] -= 3.0
    assert run(pushed)["gate"][-1] & Gate.NORM

    turning = still(400)
    turning["gyro_rad_s"][300:, 2] = 1.0
    assert run(turning)["gate"][-1] == Gate.RATE

    started = still(410)
    started["gyro_rad_s"][390:, 2] = 1.0
    assert np.any(run(started)["gate"][390:] & Gate.ANGULAR_ACCELERATION)

    clipped = still(400)
    clipped["accel_m_s2"][399, 0] = 170.0
    assert run(clipped)["gate"][-1] & Gate.SATURATION

    missing = still(400)
    missing["accel_m_s2"][399] = np.nan
    last = run(missing)[-1]
    assert last["gate"] & Gate.STALE
    assert last["flags"] & Flag.ACCEL_MISSING


def test_a_tilt_the_filter_cannot_believe_is_rejected_by_innovation():
    samples = still(4000)
    samples["accel_m_s2"][3000:] = still(1, roll=0.5)["accel_m_s2"]
    assert run(samples)["gate"][3100] & Gate.INNOVATION


def test_heading_follows_the_magnetic_field_and_ignores_a_disturbed_one():
    field_ned = np.array([22.0, 0.0, 42.0])
    yaw = 1.2
    samples = still(3000)
    body = rotate_columns(inverse_columns(quaternion_columns([[0.0, 0.0, yaw]])), field_ned[None])
    samples["mag_ut"] = body
    samples["mag_ut"][2000:] = (0.0, 60.0, 60.0)
    found = euler_columns(run(samples)["ned_from_body"])[:, 2]
    assert found[1999] == pytest.approx(yaw, abs=1e-3)
    assert found[-1] == pytest.approx(yaw, abs=1e-2)


def test_a_vehicle_that_stands_is_at_rest_within_three_seconds():
    """One second aligns, two averages forget the doubt of the start, the last confirms."""
    samples = still(300)
    estimator = Estimator()
    estimates = estimator.run(samples)
    assert estimator.state["at_rest"][0] == 1
    assert np.degrees(estimates["attitude_sigma_rad"][-1, :2]).max() < 1.0
