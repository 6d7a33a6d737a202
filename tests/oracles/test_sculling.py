"""Sculling at low rate: a velocity known in closed form, against the filter left to its sensors.

A force that swings in step with the rotation has a mean in earth axes that it has not in body
axes. P. G. Savage: Strapdown Inertial Navigation Integration Algorithm Design Part 2, J. Guidance
21(2), 1998.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from ahrs_service.estimator import Estimator
from ahrs_service.settings import OTHER, FusionSettings, GateSettings, Settings

SECONDS = 12.0


def velocity_error_m_s(motion, t, sample):
    """Error of the velocity at the last of the times [s]; it is unbounded once moving."""
    unbounded = replace(
        OTHER,
        velocity_sigma_m_s=(1e6, 1e6, 1e6),
        velocity_correlation_s=(1e15, 1e15, 1e15),
        climb_sigma_m_s=1e6,
        climb_correlation_s=1e15,
        gyro_matrix_sigma=0.0,
        accel_bias_sigma_m_s2=0.0,
    )
    settings = Settings(
        gate=GateSettings(norm_m_s2=1e-9),
        # Never at rest: zero-velocity updates stop only some samples after it moves.
        fusion=FusionSettings(airframe="other", gyro_sample=sample, gyro_rest_sigma_rad_s=1e-9),
        other=unbounded,
    )
    estimator = Estimator(settings)
    estimator.run(motion.samples(t, sample == "mean"))
    state = estimator.state
    return float(np.linalg.norm(state["velocity_ned_m_s"][0] - motion.velocity(t[-1:])[0]))


def regular(rate_hz):
    return np.arange(int(SECONDS * rate_hz) + 1) / rate_hz


def scull(swing, frequency_hz, angle_rad, acceleration_m_s2):
    """Roll and a push to the right in step."""
    still = [[0.0, 1.0, 0.0]]
    push = acceleration_m_s2 / (2 * math.pi * frequency_hz)
    return swing(
        [[[angle_rad, frequency_hz, 0.0]], still, still],
        [still, [[push, frequency_hz, -math.pi / 2]], still],
    )


def shake(swing, fastest_hz, rate_rad_s, acceleration_m_s2, seed):
    """Rotation about all axes and forces along all, band limited."""
    rng = np.random.default_rng(seed)
    frequency = rng.uniform(0.2 * fastest_hz, fastest_hz, (2, 3, 6))
    size = np.array([rate_rad_s, acceleration_m_s2])[:, None, None]
    amplitude = size * math.sqrt(2 / 6) / (2 * math.pi * frequency)
    return swing(*np.stack([amplitude, frequency, rng.uniform(0.0, 6.3, (2, 3, 6))], axis=-1))


def test_the_oracle_agrees_with_its_own_derivative(swing):
    motion, t, h = shake(swing, 3.0, 1.0, 5.0, 1), np.linspace(1.9, 9.0, 50), 1e-5
    slope = (motion.velocity(t + h) - motion.velocity(t - h)) / (2 * h)
    force = np.linalg.norm(slope - [0.0, 0.0, 9.80665], axis=1)
    np.testing.assert_allclose(np.linalg.norm(motion.sense(t)[:, 3:], axis=1), force, rtol=1e-8)


@pytest.mark.parametrize(
    ("sample", "samples_a_cycle", "limit_m_s"),
    [("instant", 10, 0.04), ("instant", 40, 2e-3), ("mean", 10, 0.04), ("mean", 40, 2e-4)],
)
@pytest.mark.parametrize("frequency_hz", [1.0, 2.0, 5.0])
def test_sculling_adds_little_velocity(swing, frequency_hz, sample, samples_a_cycle, limit_m_s):
    """If unresolved, it is half of angle times acceleration: 0.5 m/s^2 for nine seconds."""
    motion = scull(swing, frequency_hz, 0.2, 5.0)
    error = velocity_error_m_s(motion, regular(samples_a_cycle * frequency_hz), sample)
    assert error < limit_m_s


@pytest.mark.parametrize(("sample", "order"), [("instant", 1.8), ("mean", 2.8)])
def test_the_error_falls_with_the_rate_by_its_order(swing, sample, order):
    motion = shake(swing, 2.0, 2.0, 5.0, seed=2)
    errors = [velocity_error_m_s(motion, regular(rate), sample) for rate in (50.0, 100.0, 200.0)]
    assert np.log2(np.array(errors[:-1]) / errors[1:]).min() > order


@pytest.mark.parametrize(
    ("sample", "limits_m_s"),
    [
        ("instant", {10.0: 0.8, 20.0: 0.15, 50.0: 0.015, 200.0: 5e-4}),
        ("mean", {10.0: 1.2, 20.0: 0.2, 50.0: 0.015, 200.0: 2e-4}),
    ],
)
def test_shaking_at_two_hertz_is_followed_at_low_rate(swing, sample, limits_m_s):
    motion = shake(swing, 2.0, 2.0, 5.0, seed=0)
    for rate_hz, limit_m_s in limits_m_s.items():
        assert velocity_error_m_s(motion, regular(rate_hz), sample) < limit_m_s, rate_hz
