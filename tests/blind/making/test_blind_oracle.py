"""The oracle's gain against the exact Gaussian one, and effects scaled to it."""

import numpy as np
import pytest
from scipy.linalg import toeplitz

from ahrs_service.blind.making.case import Request, make
from ahrs_service.blind.making.oracle import LEVEL_NATS, gain, share_of_gain
from ahrs_service.blind.making.recording_noise import ENCODER, NoiseLaw, Wander

RATE_HZ = 10.0


def law(sigma, time_s):
    wander, none = Wander(sigma, time_s), Wander(0.0, 1.0)
    return NoiseLaw(1e-3, 1e-2, wander, none, np.zeros(3), np.zeros(3), ENCODER, 0.0)


def shape(count):
    time = np.arange(count) / RATE_HZ
    values = np.zeros((count, 3))
    values[:, 0] = 1e-3 * np.tanh((time - 40.0) / 5.0)
    values[:, 2] = 5e-4 * np.sin(0.7 * time)
    return values, np.zeros((count, 3))


def exact(values, sigma, time_s, white):
    """1/2 s' C^-1 s with the constant, of any size, among the nuisances."""
    count = len(values)
    cov = sigma**2 * toeplitz(np.exp(-np.arange(count) / RATE_HZ / time_s))
    cov += white**2 * np.eye(count)
    solved = np.linalg.solve(cov, np.column_stack([values, np.ones(count)]))
    one = np.ones(count)
    plain = np.einsum("ni,ni->i", values, solved[:, :-1])
    return 0.5 * np.sum(plain - (one @ solved[:, :-1]) ** 2 / (one @ solved[:, -1]))


@pytest.mark.parametrize(("sigma", "time_s"), [(0.0, 1.0), (2e-4, 20.0), (1e-3, 5.0)])
def test_the_gain_is_the_exact_one(sigma, time_s):
    signals = shape(1000)
    white = 1e-3 * np.sqrt(0.5 * RATE_HZ)
    found = gain(signals, law(sigma, time_s), RATE_HZ)
    # The cosine transform diagonalises a stationary covariance but for its ends: 10 % here, where
    # the record is five correlation times long.
    assert found == pytest.approx(exact(signals[0], sigma, time_s, white), rel=0.12)


def test_half_of_an_effect_has_three_quarters_of_its_gain():
    gyro, accel = shape(500)
    known = law(1e-4, 30.0)
    assert share_of_gain((0.5 * gyro, accel), (gyro, accel), known, RATE_HZ) == pytest.approx(0.75)
    assert share_of_gain((gyro, accel), (gyro, accel), known, RATE_HZ) == 1.0
    assert share_of_gain((-gyro, accel), (gyro, accel), known, RATE_HZ) == pytest.approx(-3.0)


@pytest.mark.parametrize("level", [1, 2, 3])
@pytest.mark.parametrize(
    ("kind", "effect"),
    [
        ("bench", "gyro_thermal_hysteresis"),
        ("flight", "accel_vibration_rectification"),
        ("copter", "imu_time_offset"),
        ("copter", "gyro_saturation"),
    ],
)
def test_effects_are_scaled_to_their_level(kind, effect, level):
    case = make(Request("a", kind, 5, 120, level=level, effects=(effect,)))
    (entry,) = case.truth["effects"]
    assert entry["oracle_nats"] == pytest.approx(LEVEL_NATS[level], rel=0.02)
    assert gain(case.hidden, case.law, case.scene.rate_hz) == pytest.approx(entry["oracle_nats"])


def test_an_oracle_gains_on_average_what_it_expects():
    """On noise as drawn, the log-likelihood ratio of the shape has mean G and variance 2 G."""
    gyro, accel = shape(1000)
    known = law(2e-4, 20.0)
    white = 1e-3 * np.sqrt(0.5 * RATE_HZ)
    expected = gain((gyro, accel), known, RATE_HZ)
    rng = np.random.default_rng(1)
    ratios = []
    for _ in range(400):
        noise = known.gyro_wander.draw(rng, 1000, 1.0 / RATE_HZ)
        noise += rng.normal(0.0, white, (1000, 3))
        before = gain((noise + gyro, accel), known, RATE_HZ)
        after = gain((noise, accel), known, RATE_HZ)
        ratios.append(before - after)
    error = np.sqrt(2.0 * expected / len(ratios))
    assert np.mean(ratios) == pytest.approx(expected, abs=4.0 * error)
    assert np.var(ratios) == pytest.approx(2.0 * expected, rel=0.3)
