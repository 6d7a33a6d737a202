"""Coloured residuals against their closed forms: a first-order process of known correlation."""

import numpy as np
import pytest

from ahrs_service.calibration.thermal.coloured import hysteresis, inflation
from ahrs_service.sensor.noise import first_order


def first_order_noise(rng, count, keep):
    return first_order(rng.normal(size=(count, 1)), keep)[:, 0]


@pytest.mark.parametrize("keep", [0.0, 0.5, 0.9])
def test_inflation_of_a_first_order_process(keep):
    """Its rho is keep^k, so 1 + 2 sum rho = (1 + keep) / (1 - keep)."""
    rng = np.random.default_rng(1)
    found = np.mean([inflation(first_order_noise(rng, 4000, keep)) for _ in range(20)])
    assert found == pytest.approx((1.0 + keep) / (1.0 - keep), rel=0.1)


def test_inflation_of_little_or_nothing():
    assert inflation(np.zeros(50)) == 1.0
    assert inflation(np.array([1.0, 2.0])) == 1.0
    assert inflation(np.array([1.0, -1.0] * 40)) == 1.0


def test_inflation_gives_the_scatter_of_a_mean():
    """Means of coloured noise scatter by sigma sqrt(inflation / n)."""
    rng = np.random.default_rng(2)
    runs = [first_order_noise(rng, 2000, 0.8) for _ in range(200)]
    observed = np.mean([np.sqrt(run.var() * inflation(run) / len(run)) for run in runs])
    assert observed == pytest.approx(np.std([run.mean() for run in runs]), rel=0.15)


def loop(amplitude, noise=0.0):
    phase = np.linspace(0.0, 4.0 * np.pi, 4000)
    temperature = 20.0 + 30.0 * np.sin(phase)
    rate = np.cos(phase)
    rng = np.random.default_rng(3)
    residual = amplitude * np.sign(rate)[:, None] + rng.normal(0.0, noise, (4000, 3))
    return temperature, rate, residual


def test_hysteresis_is_heating_minus_cooling():
    found = hysteresis(*loop(0.5))
    assert found.difference == pytest.approx(1.0, abs=1e-9)
    assert len(found.temperature_degc) == 12
    assert found.largest == pytest.approx([1.0, 1.0, 1.0])


def test_without_a_loop_hysteresis_is_within_its_error():
    found = hysteresis(*loop(0.0, noise=0.1))
    assert (np.abs(found.difference) < 4.5 * found.sigma).all()


def test_heating_alone_shows_no_hysteresis():
    temperature = np.linspace(0.0, 50.0, 400)
    found = hysteresis(temperature, np.ones(400), np.zeros((400, 3)))
    assert found.largest is None
