"""An accelerometer that reads gravity too large: its scale is estimated, and the gates open."""

import numpy as np
import pytest

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.estimator import Estimator
from ahrs_service.records import SAMPLE_DTYPE, Airframe, empty
from ahrs_service.rotation import euler_columns

RATE_HZ = 50


def lying(seconds, scale, airframe, roll=-0.24):
    """Samples [N] of a vehicle at rest with a roll; its accelerometer reads `scale` times g."""
    samples = empty(SAMPLE_DTYPE, round(seconds * RATE_HZ))
    rng, count = np.random.default_rng(1), len(samples)
    samples["time_ns"] = 10**9 + np.arange(count) * (10**9 // RATE_HZ)
    samples["gyro_rad_s"] = rng.normal(0.0, 2e-3, (count, 3))
    up = np.array([0.0, -np.sin(roll), -np.cos(roll)])
    force = scale * STANDARD_GRAVITY_M_S2 * up
    samples["accel_m_s2"] = force + rng.normal(0.0, 0.02, (count, 3))
    samples["airframe"] = airframe
    return samples


def run(samples):
    estimator = Estimator()
    return estimator.run(samples), estimator.state[0]


@pytest.mark.parametrize("airframe", [Airframe.FIXED_WING, Airframe.MULTIROTOR])
@pytest.mark.parametrize("scale", [0.92, 1.0, 1.06])
def test_at_rest_the_norm_of_gravity_determines_the_scale(scale, airframe):
    estimates, state = run(lying(20.0, scale, airframe))
    # A bias of 0.1 m/s^2, 1-sigma, takes its part of a multirotor's.
    rel = 2e-3 if airframe == Airframe.FIXED_WING else 6e-3
    assert state["force_scale"] == pytest.approx(1.0 / scale, rel=rel)
    assert state["at_rest"] == 1
    late = estimates[len(estimates) // 2 :]
    assert (late["gate"] == 0).all()
    roll = euler_columns(late["ned_from_body"])[:, 0]
    np.testing.assert_allclose(np.degrees(roll), np.degrees(-0.24), atol=0.3)
    norm = np.linalg.norm(late["accel_m_s2"], axis=1).mean()
    assert norm == pytest.approx(STANDARD_GRAVITY_M_S2, rel=3e-3)


@pytest.mark.parametrize("scale", [0.7, 1.4])
def test_what_no_sensor_is_wrong_by_is_an_acceleration(scale):
    _, state = run(lying(20.0, scale, Airframe.FIXED_WING))
    assert state["force_scale"] == 1.0


def test_a_class_with_a_calibrated_sensor_keeps_its_scale():
    _, state = run(lying(20.0, 1.01, Airframe.HAND_HELD))
    assert state["force_scale"] == 1.0


def test_vibration_does_not_determine_the_scale():
    samples = lying(20.0, 1.05, Airframe.FIXED_WING)
    rng = np.random.default_rng(2)
    samples["accel_m_s2"] += rng.normal(0.0, 1.0, samples["accel_m_s2"].shape)
    _, state = run(samples)
    assert abs(state["force_scale"] - 1.0) < 1e-3
