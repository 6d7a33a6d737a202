"""Coning at low rate: an attitude known in closed form, against the filter left to its gyro.

P. G. Savage: Strapdown Inertial Navigation Integration Algorithm Design Part 1, J. Guidance 21(1),
1998; M. B. Ignagni: Optimal Strapdown Attitude Integration Algorithms, J. Guidance 13(2), 1990.
"""

import math

import numpy as np
import pytest

from ahrs_service.estimator import Estimator
from ahrs_service.rotation import inverse_columns, multiply_columns
from ahrs_service.settings import FusionSettings, GateSettings, Settings

SECONDS = 12.0


def estimates_of(samples, gyro_sample):
    """The gate never opens once it moves: from then on it is strapdown integration alone.

    By the rate, since at the onset of a motion the norm of the force changes to second order only.
    """
    settings = Settings(
        gate=GateSettings(norm_m_s2=1e-9, rate_rad_s=1e-9),
        fusion=FusionSettings(mode="gated", airframe="other", gyro_sample=gyro_sample),
    )
    return Estimator(settings).run(samples)


def angles_deg(p, q):
    error = multiply_columns(inverse_columns(p), q)
    return np.degrees(2.0 * np.arctan2(np.linalg.norm(error[:, 1:], axis=1), np.abs(error[:, 0])))


def cone(swing, frequency_hz, angle_rad):
    """Roll and pitch 90 degrees out of phase: the tilt axis rotates."""
    still = [0.0, 1.0, 0.0]
    roll, pitch = [angle_rad, frequency_hz, 0.0], [angle_rad, frequency_hz, math.pi / 2]
    return swing([[roll], [pitch], [still]])


def tumble(swing, fastest_hz, rate_rad_s, seed):
    """All axes at once, band limited."""
    rng = np.random.default_rng(seed)
    frequency = rng.uniform(0.2 * fastest_hz, fastest_hz, (3, 6))
    amplitude = rate_rad_s * math.sqrt(2 / 6) / (2 * math.pi * frequency)
    return swing(np.stack([amplitude, frequency, rng.uniform(0.0, 6.3, (3, 6))], axis=-1))


def error_deg(motion, rate_hz, gyro_sample):
    """Largest error of the last three seconds."""
    t = np.arange(int(SECONDS * rate_hz) + 1) / rate_hz
    estimates = estimates_of(motion.samples(t, gyro_sample == "mean"), gyro_sample)
    last = t > SECONDS - 3.0
    return float(angles_deg(motion.attitude(t), estimates["ned_from_body"])[last].max())


def test_the_oracle_agrees_with_its_own_derivative(swing):
    motion, t, h = tumble(swing, 3.0, 1.0, 1), np.linspace(1.9, 9.0, 50), 1e-5
    step = multiply_columns(inverse_columns(motion.attitude(t - h)), motion.attitude(t + h))
    turned = 2.0 * step[:, 1:] * np.sign(step[:, :1])
    np.testing.assert_allclose(turned / (2 * h), motion.sense(t)[:, :3], atol=1e-6)


# The axis of the first cone drifts by 100 deg in the ten seconds where coning is not seen at all.
CONES = [(5.0, 0.1), (2.0, 0.2), (1.0, 0.3)]


@pytest.mark.parametrize(("frequency_hz", "angle_rad"), CONES)
@pytest.mark.parametrize(
    ("gyro_sample", "samples_a_cycle", "limit_deg"),
    [("instant", 10, 0.2), ("instant", 40, 3e-3), ("mean", 10, 0.08), ("mean", 40, 5e-4)],
)
def test_coning_drifts_little(
    swing, frequency_hz, angle_rad, gyro_sample, samples_a_cycle, limit_deg
):
    motion = cone(swing, frequency_hz, angle_rad)
    rate_hz = samples_a_cycle * frequency_hz
    # The drift is proportional to the solid angle of the cone and the number of cycles.
    size = (angle_rad / 0.1) ** 2 * frequency_hz / 5.0
    assert error_deg(motion, rate_hz, gyro_sample) < limit_deg * size


@pytest.mark.parametrize(("gyro_sample", "order"), [("instant", 2.9), ("mean", 2.9)])
def test_the_error_falls_with_the_rate_by_its_order(swing, gyro_sample, order):
    motion = tumble(swing, 2.0, 2.0, seed=2)
    errors = [error_deg(motion, rate, gyro_sample) for rate in (50.0, 100.0, 200.0)]
    assert np.log2(np.array(errors[:-1]) / errors[1:]).min() > order


@pytest.mark.parametrize(
    ("gyro_sample", "limits_deg"),
    [
        ("instant", {10.0: 1.5, 20.0: 0.25, 50.0: 0.015, 200.0: 3e-4}),
        ("mean", {10.0: 0.8, 20.0: 0.07, 50.0: 5e-3, 200.0: 1e-4}),
    ],
)
def test_tumbling_at_two_hertz_is_followed_at_low_rate(swing, gyro_sample, limits_deg):
    motion = tumble(swing, 2.0, 2.0, seed=0)
    for rate_hz, limit_deg in limits_deg.items():
        assert error_deg(motion, rate_hz, gyro_sample) < limit_deg, rate_hz


@pytest.mark.parametrize("gyro_sample", ["instant", "mean"])
def test_uneven_steps_and_lost_samples_are_integrated_by_their_stamps(swing, gyro_sample):
    motion, rng = tumble(swing, 2.0, 2.0, seed=0), np.random.default_rng(4)
    t = np.sort(np.arange(int(SECONDS * 100)) + rng.uniform(-0.3, 0.3, int(SECONDS * 100))) / 100.0
    t = np.rint(t[rng.random(len(t)) > 0.1] * 1e9) / 1e9
    estimates = estimates_of(motion.samples(t, gyro_sample == "mean"), gyro_sample)
    errors = angles_deg(motion.attitude(t), estimates["ned_from_body"])
    assert errors.max() < {"instant": 0.15, "mean": 0.02}[gyro_sample]
