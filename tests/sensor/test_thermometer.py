"""The element temperature, against the analytic answers of first-order lags."""

import numpy as np
import pytest

from ahrs_service.sensor.parameters import Calibration, TriadCalibration, coefficients
from ahrs_service.sensor.thermometer import LEAD_GAIN, acting_columns

RATE_HZ = 50.0
LAG_S = 20.0
TIME_S = np.arange(0.0, 200.0, 1.0 / RATE_HZ)


def with_lags(gyro_s, accel_s):
    return coefficients(
        Calibration(
            gyro=TriadCalibration(thermal_lag_s=gyro_s),
            accel=TriadCalibration(thermal_lag_s=accel_s),
        )
    )


def test_a_sensing_element_that_warms_later_follows_a_step_as_an_exponential():
    reported = np.where(TIME_S > 0.0, 40.0, 20.0)
    acting = acting_columns(with_lags(LAG_S, 0.0), reported, TIME_S)
    np.testing.assert_allclose(acting[:, 0], 40.0 - 20.0 * np.exp(-TIME_S / LAG_S), rtol=1e-12)
    np.testing.assert_array_equal(acting[:, 1], reported)


def test_of_a_thermometer_that_lags_the_lag_is_undone():
    """On a ramp of r degC/s a lag of tau reads r tau too low; this is fully corrected."""
    slope = 0.1
    shown = 20.0 + slope * (TIME_S - LAG_S * (1.0 - np.exp(-TIME_S / LAG_S)))
    acting = acting_columns(with_lags(0.0, -LAG_S), shown, TIME_S)
    late = 20.0 + slope * TIME_S - acting[:, 1]
    assert late[-1] == pytest.approx(0.0, abs=0.01 * slope * LAG_S)


def test_after_a_step_the_lead_goes_too_far_by_a_ninth_at_most():
    """With x = tau s, (1 + 4/3 x) / ((1 + x) (1 + x / 3)) gives 1 + exp(-t) / 2 - 3/2 exp(-3 t)."""
    shown = 40.0 - 20.0 * np.exp(-TIME_S / LAG_S)
    acting = acting_columns(with_lags(0.0, -LAG_S), shown, TIME_S)[:, 1]
    assert acting.max() == pytest.approx(40.0 + 20.0 / 9.0, abs=0.05)


def test_a_step_of_the_thermometer_is_enlarged_by_the_gain_and_no_more():
    reported = np.where(TIME_S < 100.0, 20.0, 20.1)
    acting = acting_columns(with_lags(-LAG_S, 0.0), reported, TIME_S)[:, 0]
    assert np.ptp(acting) == pytest.approx(0.1 * LEAD_GAIN, rel=0.01)
    assert acting[-1] == pytest.approx(20.1, abs=1e-3)


def test_after_a_time_without_temperature_the_next_one_is_used_for_all_of_it():
    reported = np.full(100, 30.0)
    reported[0], reported[10:20] = 20.0, np.nan
    rows = with_lags(LAG_S, -LAG_S)
    acting = acting_columns(rows, reported, TIME_S[:100])
    assert np.isnan(acting[10:20]).all()
    whole = acting_columns(rows, np.where(np.isnan(reported), 30.0, reported), TIME_S[:100])
    np.testing.assert_allclose(acting[20:], whole[20:], rtol=1e-12)
