import numpy as np
import pytest

from ahrs_service.sensor.noise import TriadNoise, gauss_markov, sensor_noise

RATE_HZ = 100.0
COUNT = 200_000


def allan_deviation(values, rate_hz, tau_s):
    """Overlapping Allan deviation of a rate signal, from its definition (IEEE Std 952, C.1)."""
    m = round(tau_s * rate_hz)
    angle = np.concatenate([[0.0], np.cumsum(values)]) / rate_hz
    second = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
    return float(np.sqrt(np.mean(second**2) / (2.0 * tau_s**2)))


@pytest.mark.parametrize("tau_s", [0.1, 1.0, 10.0])
def test_white_noise_has_its_allan_deviation(tau_s):
    noise = sensor_noise(np.random.default_rng(3), COUNT, RATE_HZ, TriadNoise(density=0.002))
    for axis in range(3):
        deviation = allan_deviation(noise[:, axis], RATE_HZ, tau_s)
        assert deviation == pytest.approx(0.002 / np.sqrt(tau_s), rel=0.1)


@pytest.mark.parametrize("tau_s", [1.0, 10.0])
def test_a_bias_walk_has_its_allan_deviation(tau_s):
    noise = sensor_noise(np.random.default_rng(4), COUNT, RATE_HZ, TriadNoise(walk=1e-3))
    deviation = np.mean([allan_deviation(noise[:, axis], RATE_HZ, tau_s) for axis in range(3)])
    assert deviation == pytest.approx(1e-3 * np.sqrt(tau_s / 3.0), rel=0.1)


def test_gauss_markov_has_its_deviation_and_correlation():
    wander = gauss_markov(np.random.default_rng(5), (COUNT, 3), 0.5, 2.0, RATE_HZ)
    assert np.std(wander) == pytest.approx(0.5, rel=0.05)
    lag = round(2.0 * RATE_HZ)
    correlation = np.mean(wander[lag:] * wander[:-lag]) / np.mean(wander**2)
    assert correlation == pytest.approx(np.exp(-1.0), abs=0.05)


def test_the_same_seed_gives_the_same_noise():
    noise = TriadNoise(0.01, 0.001, 0.1, 5.0)
    first, second = (sensor_noise(np.random.default_rng(9), 50, 50.0, noise) for _ in range(2))
    np.testing.assert_array_equal(first, second)
