"""The reported 1-sigma against the true error, over flights with a different sensor each.

tests/benchmarks/consistency.py runs more and longer ones, and explains what is drawn.
"""

import functools

import numpy as np
import pytest
from scipy.stats import chi2

from ahrs_service.estimator import Estimator
from ahrs_service.records import Airframe, Phase
from ahrs_service.rotation import inverse_columns, multiply_columns
from ahrs_service.settings import FusionSettings, Settings
from ahrs_service.simulation.samples import samples_of
from ahrs_service.simulation.scenario import SCENARIOS, make_flight
from tests.benchmarks.ensemble.class_ensemble import draw

RUNS = 12
DRAWN_RUNS, DRAWN_S = 20, 60.0


def estimate(samples, settings):
    return Estimator(settings).run(samples)


def tilt_in_sigmas(estimates, ned_from_body):
    """True tilt about the estimated north and east over the reported sigma [K, 2], at 2 Hz.

    truth = dq(rotation about down) dq(tilt) estimate: six axes do not observe the heading.
    """
    running = np.flatnonzero(estimates["phase"] == Phase.RUNNING)[::50]
    ours, truth = estimates[running], ned_from_body[running]
    error = multiply_columns(truth, inverse_columns(ours["ned_from_body"]))
    turn = error * [1.0, 0.0, 0.0, 1.0]
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    tilt = 2.0 * np.arcsin(multiply_columns(inverse_columns(turn), error)[:, 1:3])
    return tilt / ours["attitude_sigma_rad"][:, :2]


def fly(scenario, mode, seed):
    imu = SCENARIOS[scenario].imu.sibling(np.random.default_rng([seed, 99]))
    flight = make_flight(scenario, 90.0, seed, 100.0, imu)
    samples = samples_of(flight, Airframe.FIXED_WING)
    estimates = estimate(samples, Settings(fusion=FusionSettings(mode=mode)))
    return tilt_in_sigmas(estimates, flight.rows["ned_from_body"])


@pytest.fixture(scope="module")
def ratios():
    """Every run of a case, put together [K, 2]."""

    @functools.cache
    def run(scenario, mode):
        return np.concatenate([fly(scenario, mode, seed) for seed in range(1, RUNS + 1)])

    return run


@pytest.mark.parametrize("mode", ["velocity", "gated"])
@pytest.mark.parametrize("scenario", ["flight", "circling"])
def test_the_sigma_covers_the_error(ratios, scenario, mode):
    """68, 95 and 99.7 % of a normal error, less what so few flights may miss by chance."""
    size = np.abs(ratios(scenario, mode))
    assert np.mean(size < 1.0) > 0.62
    assert np.mean(size < 2.0) > 0.92
    assert np.mean(size < 3.0) > 0.99
    assert np.mean(size**2) < 1.3


@pytest.mark.parametrize("mode", ["velocity", "gated"])
@pytest.mark.parametrize("scenario", ["flight", "circling"])
def test_the_sigma_is_no_more_than_twice_the_error(ratios, scenario, mode):
    assert np.mean(ratios(scenario, mode) ** 2) > 0.25


@pytest.mark.parametrize(
    ("profile", "scenario"),
    [("fixed_wing", "flight"), ("multirotor", "moved"), ("hand_held", "moved")],
)
def test_over_the_ensemble_that_its_settings_state_the_filter_is_consistent(profile, scenario):
    """NEES within the 95 % interval of a chi-square of independent flights; NIS no more than 1.

    The gate's variance bounds what accelerates a vehicle, so its NIS has no lower bound.
    """
    ratios, innovation2 = [], []
    for seed in range(1, DRAWN_RUNS + 1):
        flight = draw(profile, scenario, DRAWN_S, seed)
        estimates = estimate(flight.samples, flight.settings)
        ratios.append(tilt_in_sigmas(estimates, flight.ned_from_body))
        is_open = (estimates["gate"] == 0) & (estimates["phase"] == Phase.RUNNING)
        innovation2.append(estimates["gate_innovation"][is_open] ** 2)
    size = np.abs(np.concatenate(ratios))
    low, high = chi2.interval(0.95, 2 * DRAWN_RUNS) / np.float64(2 * DRAWN_RUNS)
    assert low < np.mean(size**2) < high
    assert np.mean(size < 2.0) > 0.92
    assert np.mean(size < 3.0) > 0.985
    assert np.mean(np.concatenate(innovation2)) / 2.0 < 1.0
