"""The thermometer's lag: the element's temperature in closed form, and its estimate."""

import numpy as np
import pytest

from ahrs_service.calibration.thermal.lag import LARGEST_LAG_S, Lag, estimate_lag
from ahrs_service.calibration.thermal.rows import ThermalRows, element_degc
from ahrs_service.calibration.thermal.smooth_choice import level_outputs
from ahrs_service.calibration.thermal.smooth_drift import Structure

LAG_S = 40.0
CUBIC = (Structure(bias=(3, 1)),) * 3


def test_an_element_that_follows_a_ramp_is_late_by_the_lag():
    time = np.arange(0.0, 1000.0, 7.0)
    element = element_degc(time, 20.0 + 0.02 * time, LAG_S)
    exact = 20.0 + 0.02 * (time - LAG_S * (1.0 - np.exp(-time / LAG_S)))
    assert element == pytest.approx(exact, abs=1e-9)


def test_a_thermometer_that_follows_is_undone():
    time = np.arange(0.0, 2000.0, 5.0)
    element = 30.0 * np.sin(2.0 * np.pi * time / 2000.0)
    thermometer = element_degc(time, element, LAG_S)
    undone = element_degc(time, thermometer, -LAG_S)
    assert np.abs(thermometer - element)[50:].max() > 2.0
    # The rate is that of a line through 30 s; the curvature within them remains.
    assert np.abs(undone - element)[50:-10].max() < 0.1


def test_rows_of_sessions_follow_their_own_clock():
    time = np.tile(np.arange(0.0, 500.0, 5.0), 2)
    temperature = np.concatenate([np.full(100, 10.0), np.full(100, 50.0)])
    rows = ThermalRows(
        time, temperature, np.zeros((200, 3)), np.zeros(200, int), np.repeat([0, 1], 100)
    )
    assert rows.at_element(60.0).temperature_degc == pytest.approx(temperature)
    assert rows.rate_degc_s() == pytest.approx(0.0, abs=1e-12)


def bench_rows(lag_s, heating_and_cooling=True, noise=2e-3, seed=1):
    """A cubic drift with the element's temperature; the thermometer reads another one."""
    time = np.arange(0.0, 7200.0, 10.0)
    corners = [-20.0, 60.0, -20.0] if heating_and_cooling else [-20.0, 20.0, 60.0]
    first = np.interp(time, [0.0, 3600.0, 7200.0], corners)
    second = element_degc(time, first, abs(lag_s)) if lag_s else first
    element, shown = (second, first) if lag_s >= 0.0 else (first, second)
    t = (element[:, None] - 20.0) / 40.0
    rng = np.random.default_rng(seed)
    output = t * [0.5, -0.3, 0.2] + t**3 * [0.1, 0.3, -0.2]
    zero = np.zeros(len(time), int)
    return ThermalRows(time, shown, output + rng.normal(0.0, noise, (len(time), 3)), zero, zero)


@pytest.mark.parametrize("lag_s", [LAG_S, -LAG_S, 5.0])
def test_the_lag_is_found_either_way(lag_s):
    rows = bench_rows(lag_s)
    found = estimate_lag(rows, CUBIC, 20.0, level_outputs(rows))
    assert found.is_reported
    assert found.low_s < lag_s < found.high_s or found.lag_s == pytest.approx(lag_s, abs=1.0)
    assert found.lag_s == pytest.approx(lag_s, abs=1.5)


def test_no_lag_is_none():
    rows = bench_rows(0.0)
    found = estimate_lag(rows, CUBIC, 20.0, level_outputs(rows))
    assert not found.is_reported
    assert found.lag_s == 0.0
    assert found.high_s - found.low_s < 2.0


def test_one_steady_ramp_does_not_tell_it():
    """There a lag is a shift of the temperature, but for the first minutes."""
    ramp = bench_rows(LAG_S, heating_and_cooling=False, noise=2e-2)
    late = ramp.part(np.arange(100, len(ramp)))
    found = estimate_lag(late, CUBIC, 20.0, level_outputs(late))
    loop = bench_rows(LAG_S, noise=2e-2)
    both = estimate_lag(loop, CUBIC, 20.0, level_outputs(loop))
    assert found.high_s - found.low_s > 10.0 * (both.high_s - both.low_s)


def test_an_absent_drift_gives_no_lag():
    rows = bench_rows(LAG_S)
    found = estimate_lag(rows, (Structure(),) * 3, 20.0, level_outputs(rows))
    assert (found.low_s, found.high_s) == (-LARGEST_LAG_S, LARGEST_LAG_S)
    assert not found.is_reported


def test_the_standard_error_is_that_of_a_95_percent_interval():
    """Half of it is 1.96 sigma: 40 s from 30.2 to 49.8 s is 40 s with a sigma of 5 s."""
    assert Lag(40.0, 30.2, 49.8, True).sigma_s == pytest.approx(5.0, rel=1e-9)
