"""A million samples: quaternion and covariance stay valid, and nothing degrades."""

import math

import numpy as np
import pytest

from ahrs_service.estimator import Estimator
from ahrs_service.records import Phase
from ahrs_service.rotation import inverse_columns, multiply_columns
from ahrs_service.settings import FusionSettings, Settings

RATE_HZ = 1000
LAP_S = 10
LAPS = 100
GYRO_BIAS_RAD_S = np.array([0.004, -0.003, 0.002])


@pytest.fixture(scope="module")
def lap(swing):
    """Ten seconds that can be flown again and again, and their true attitude.

    All frequencies are multiples of 0.1 Hz, and the swell of the motion is over.
    """
    rng = np.random.default_rng(11)
    frequency = rng.integers(1, 15, (2, 3, 4)) / LAP_S
    amplitude = np.array([1.0, 1.0])[:, None, None] / (2 * math.pi * frequency) / math.sqrt(2.0)
    motion = swing(*np.stack([amplitude, frequency, rng.uniform(0.0, 6.3, (2, 3, 4))], axis=-1))
    t = LAP_S + np.arange(LAP_S * RATE_HZ) / RATE_HZ
    samples = motion.samples(t)
    samples["gyro_rad_s"] += rng.normal(0.0, 0.02, (len(t), 3)) + GYRO_BIAS_RAD_S
    samples["accel_m_s2"] += rng.normal(0.0, 0.3, (len(t), 3))
    return samples, motion.attitude(t)


def tilts_deg(p, q):
    """Angle between the two verticals [N]."""
    error = multiply_columns(p, inverse_columns(q))
    cosine = np.hypot(error[:, 0], error[:, 3])
    return np.degrees(2.0 * np.arctan2(np.hypot(error[:, 1], error[:, 2]), cosine))


def flown(samples, mode, airframe):
    """Yield the state and the estimates of each lap, and the lap's number."""
    chosen = Settings(fusion=FusionSettings(mode=mode, airframe=airframe))
    estimator = Estimator(chosen)
    for number in range(LAPS):
        estimates = estimator.run(samples)
        yield number, estimator.state, estimates
        samples["time_ns"] += LAP_S * 10**9
        samples["received_ns"] += LAP_S * 10**9


def assert_sound(state, estimates):
    covariance = state["covariance"][0]
    np.testing.assert_array_equal(covariance, covariance.T)
    # A state that is switched off has no variance.
    used = np.flatnonzero(np.diag(covariance))
    assert set(range(9)) <= set(used)
    covariance = covariance[np.ix_(used, used)]
    scale = np.sqrt(np.diag(covariance))
    assert np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() > 0.0
    assert np.abs(np.linalg.norm(estimates["ned_from_body"], axis=1) - 1.0).max() < 1e-12
    assert not estimates["flags"].any()
    assert (estimates["attitude_sigma_rad"] <= math.pi * (1.0 + 1e-12)).all()


@pytest.mark.parametrize(("mode", "airframe"), [("velocity", "hand_held"), ("gated", "multirotor")])
def test_a_million_samples_leave_rotation_and_covariance_sound(lap, mode, airframe):
    samples, truth = lap[0].copy(), lap[1]
    worst = []
    for number, state, estimates in flown(samples, mode, airframe):
        assert_sound(state, estimates)
        worst.append(tilts_deg(truth, estimates["ned_from_body"]).max())
        assert number == 0 or (estimates["phase"] == Phase.RUNNING).all()
    # The sigma has not shrunk to nothing.
    assert (estimates["attitude_sigma_rad"][-1, :2] > 1e-4).all()
    if mode == "velocity":
        assert max(worst[20:]) < 3.0


@pytest.mark.parametrize("mode", ["velocity", "gated"])
def test_minutes_without_accelerometer_are_doubt_and_no_damage(lap, mode):
    """The tilt is lost and its sigma covers it; with the accelerometer it is found again."""
    samples, truth, force = lap[0].copy(), lap[1], lap[0]["accel_m_s2"]
    for number, state, estimates in flown(samples, mode, "hand_held"):
        assert (estimates["attitude_sigma_rad"] <= math.pi * (1.0 + 1e-12)).all()
        covariance = state["covariance"][0]
        np.testing.assert_array_equal(covariance, covariance.T)
        sigma_deg = math.degrees(estimates["attitude_sigma_rad"][-1, :2].max())
        tilt_deg = tilts_deg(truth, estimates["ned_from_body"])[-1]
        assert number > 30 or tilt_deg < 3.0 * sigma_deg + 0.1, number
        samples["accel_m_s2"] = np.nan if number < 30 else force
        assert number != 30 or sigma_deg > 80.0
        if number == 45:
            break
    assert tilt_deg < 5.0 or mode == "gated"
