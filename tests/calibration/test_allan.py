"""The Allan deviation against allantools, and against noise of known coefficients."""

import math

import allantools
import numpy as np
import pytest

from ahrs_service.calibration.allan import (
    averaging_factors,
    fit_coefficients,
    overlapping_deviation,
    random_walk_at,
)
from ahrs_service.errors import CalibrationError
from ahrs_service.sensor.noise import TriadNoise, sensor_noise


def noise(count=40_000, rate_hz=100.0, seed=1, **kinds):
    return sensor_noise(np.random.default_rng(seed), count, rate_hz, TriadNoise(**kinds))[:, 0]


@pytest.mark.parametrize("seed", [1, 2])
def test_the_deviation_is_that_of_allantools(seed):
    values = noise(20_000, seed=seed, density=1e-3, walk=1e-4) + 0.3
    curve = overlapping_deviation(values, 0.01)
    taus, deviation, _, counts = allantools.oadev(
        values, rate=100.0, data_type="freq", taus=curve.tau_s
    )
    assert curve.tau_s[: len(taus)] == pytest.approx(taus)
    assert curve.deviation[: len(taus)] == pytest.approx(deviation, rel=1e-9)
    assert len(taus) == len(curve.tau_s)
    assert (counts > 0).all()


def test_the_degrees_of_freedom_are_those_of_allantools_at_their_least():
    values = noise(5_000, density=1.0)
    curve = overlapping_deviation(values, 1.0, averaging_factors(5_000))
    for m, freedom in zip(averaging_factors(5_000).tolist(), curve.freedom, strict=True):
        # Theirs for flicker noise at m = 1 lacks the square of N - 2: less than one degree.
        kinds = (0, -1, -2) if m > 1 else (0, -2)
        theirs = [allantools.edf_simple(5_001, m, alpha) for alpha in kinds]
        assert freedom == pytest.approx(max(min(theirs), 1.0), rel=1e-6)


def test_white_noise_falls_with_the_root_of_time_and_a_walk_rises():
    for kinds, slope in (({"density": 1e-3}, -0.5), ({"walk": 1e-3}, 0.5)):
        curve = overlapping_deviation(noise(**kinds), 0.01)
        use = (curve.tau_s > 0.1) & (curve.tau_s < 10.0)
        fitted = np.polyfit(np.log(curve.tau_s[use]), np.log(curve.deviation[use]), 1)[0]
        assert fitted == pytest.approx(slope, abs=0.06)


def test_rounding_falls_with_time():
    """Quantisation Q: a step D of the summed output has Q = D / sqrt(12) (IEEE Std 952)."""
    rng = np.random.default_rng(3)
    angle = np.cumsum(rng.normal(0.0, 30.0, 20_001))
    step = 20.0
    values = np.diff(np.round(angle / step) * step - angle)
    found = fit_coefficients(values, 1.0)
    assert found.quantisation == pytest.approx(step / math.sqrt(12.0), rel=0.15)


def test_the_coefficients_come_back_and_their_confidence_is_honest():
    """Many records of one sensor: errors of N and K in units of their reported sigmas."""
    density, walk = 1e-3, 1e-3
    errors = []
    for seed in range(40):
        found = fit_coefficients(noise(20_000, seed=seed, density=density, walk=walk), 0.01)
        errors.append(
            (
                (found.random_walk - density) / found.random_walk_sigma,
                (found.rate_random_walk - walk) / found.rate_random_walk_sigma,
            )
        )
        assert found.random_walk == pytest.approx(density, rel=0.05)
    white, walking = np.array(errors).T
    assert 0.5 < np.sqrt(np.mean(white**2)) < 1.6
    assert 0.5 < np.sqrt(np.mean(walking**2)) < 1.6
    assert abs(np.mean(white)) < 0.6
    assert abs(np.mean(walking)) < 0.6


def test_what_is_not_there_is_not_seen():
    seen = [
        fit_coefficients(noise(20_000, seed=seed, density=1e-3), 0.01).is_seen("rate_random_walk")
        for seed in range(20)
    ]
    assert sum(seen) <= 3
    assert fit_coefficients(noise(20_000, density=1e-3), 0.01).is_seen("random_walk")


def test_the_curve_holds_the_truth_in_its_confidence():
    inside = []
    for seed in range(30):
        curve = overlapping_deviation(noise(10_000, seed=seed, density=1e-3), 0.01)
        truth = 1e-3 / np.sqrt(curve.tau_s)
        inside.append((curve.low < truth) & (truth < curve.high))
    # 68 % and no less: the degrees of freedom are the least of three kinds of noise.
    assert 0.63 < np.mean(inside) < 0.95


def test_data_sheet_figures_are_read_off_the_curve():
    curve = overlapping_deviation(noise(density=1e-3), 0.01)
    assert random_walk_at(curve) == pytest.approx(1e-3, rel=0.1)


def test_too_few_samples_are_refused():
    with pytest.raises(CalibrationError, match="leave the unit still for ten minutes"):
        overlapping_deviation(np.zeros(50), 0.01)
    assert fit_coefficients(np.zeros(500), 0.01).random_walk == 0.0
