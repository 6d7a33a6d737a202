"""Known rates and an encoder: exact without noise, within their errors with it, lags found."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.rate_table import (
    Mounting,
    fit_encoder,
    fit_plateaus,
    judge_encoder,
    judge_plateaus,
    plateaus,
)
from ahrs_service.calibration.verdict import judge
from ahrs_service.errors import CalibrationError

K = np.array([[1.01, 0.004, -0.002], [0.003, 0.985, 0.005], [-0.006, 0.001, 1.02]])
B = np.array([0.004, -0.002, 0.006])
AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
STEPS = np.radians([-200.0, -100.0, -30.0, 30.0, 100.0, 200.0])


def staircase(axis, seed=1, sigma=1e-3, rate_hz=100.0):
    """A table that rests, keeps each rate for five seconds, and ramps between in one."""
    rng = np.random.default_rng(seed)
    corners_s, rates = [0.0], [0.0]
    for rate in [0.0, *STEPS, 0.0]:
        corners_s += [corners_s[-1] + 1.0, corners_s[-1] + 6.0]
        rates += [rate, rate]
    t = np.arange(round(corners_s[-1] * rate_hz)) / rate_hz
    rate = np.interp(t, corners_s, rates)
    unit = np.array(axis) / np.linalg.norm(axis)
    gyro = rate[:, None] * unit @ K.T + B + rng.normal(0.0, sigma, (len(t), 3))
    accel = np.array([0.0, 0.0, -9.8]) + rng.normal(0.0, 0.02, (len(t), 3))
    return ImuColumns(t, gyro, accel, np.full(len(t), 25.0))


def swing(axis, lag_s, seed=1, sigma=1e-3, rate_hz=100.0, seconds=20.0):
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    reference_s = np.arange(0.0, seconds, 0.002)

    def rate(at):
        return 3.0 * np.sin(2.0 * np.pi * 0.4 * at) + 0.5 * np.sin(2.0 * np.pi * 0.13 * at)

    unit = np.array(axis) / np.linalg.norm(axis)
    gyro = rate(t - lag_s)[:, None] * unit @ K.T + B + rng.normal(0.0, sigma, (len(t), 3))
    columns = ImuColumns(t, gyro, np.zeros((len(t), 3)), np.full(len(t), np.nan))
    return Mounting(axis, columns, reference_s, rate(reference_s))


def all_plateaus(seed=1):
    parts = [plateaus(staircase(axis, seed + k), axis, STEPS) for k, axis in enumerate(AXES)]
    return tuple(np.concatenate(columns) for columns in zip(*parts, strict=True))


def test_every_rate_of_the_staircase_is_found():
    truth, measured = plateaus(staircase(AXES[1]), AXES[1], STEPS)
    assert np.degrees(truth[:, 1]).round(6).tolist() == [0, -200, -100, -30, 30, 100, 200, 0]
    assert measured == pytest.approx(truth @ K.T + B, abs=5e-4)


def test_steady_rates_give_the_matrix():
    truth, measured = all_plateaus()
    fit = fit_plateaus(truth, measured)
    error = np.concatenate([(fit.matrix - K).ravel(), fit.bias - B])
    assert error @ np.linalg.solve(fit.covariance, error) < chi2.ppf(0.999, 12)
    verdict = judge("rate-table", (judge_plateaus(truth, measured, fit),))
    assert verdict.words == "use"
    assert verdict.triads[0].gain > 0.95


def test_an_encoder_gives_the_matrix_and_how_late_it_is():
    lags = (0.013, -0.021, 0.004)
    mountings = tuple(swing(axis, lag) for axis, lag in zip(AXES, lags, strict=True))
    fit, found = fit_encoder(mountings)
    assert found == pytest.approx(lags, abs=2e-5)
    error = np.concatenate([(fit.matrix - K).ravel(), fit.bias - B])
    assert error @ np.linalg.solve(fit.covariance, error) < chi2.ppf(0.999, 12)
    triad = judge_encoder(mountings, fit, found)
    assert triad.held_out_after == pytest.approx(1e-3, rel=0.1)
    assert triad.gain > 0.9


def test_the_encoders_standard_errors_are_those_of_many_runs():
    squares = []
    for seed in range(8):
        mountings = tuple(swing(axis, 0.013, 10 * seed + k) for k, axis in enumerate(AXES))
        fit, _ = fit_encoder(mountings)
        error = np.concatenate([(fit.matrix - K).ravel(), fit.bias - B])
        squares.append(error @ np.linalg.solve(fit.covariance, error))
    low, high = chi2.ppf([0.0005, 0.9995], 12 * 8)
    assert low < sum(squares) < high


@pytest.mark.parametrize("axes", [AXES[:2], (AXES[0], AXES[0], (1.0, 0.01, 0.0))])
def test_mountings_that_leave_a_direction_out_are_refused(axes):
    with pytest.raises(CalibrationError, match="do not turn the unit about three directions"):
        fit_encoder(tuple(swing(axis, 0.0) for axis in axes))


def test_a_wrong_axis_or_sign_is_refused():
    with pytest.raises(CalibrationError, match="check the axis, its sign, and the rates"):
        plateaus(staircase(AXES[0]), AXES[0], np.radians([50.0]))
    first = replace(swing(AXES[0], 0.0), axis=AXES[1])
    second = replace(swing(AXES[1], 0.0), axis=AXES[0])
    with pytest.raises(CalibrationError, match="do not follow the reference"):
        fit_encoder((first, second, swing(AXES[2], 0.0)))


def test_a_table_that_never_turns_is_refused():
    columns = staircase(AXES[0])
    rest = replace(columns, gyro_rad_s=columns.gyro_rad_s * 0.001)
    with pytest.raises(CalibrationError, match="no steady turn"):
        plateaus(rest, AXES[0], STEPS)


def test_a_reference_on_another_clock_is_refused():
    late = swing(AXES[0], 0.0)
    late = replace(late, time_s=late.time_s + 1000.0)
    with pytest.raises(CalibrationError, match="on the recording's clock"):
        fit_encoder((late, swing(AXES[1], 0.0), swing(AXES[2], 0.0)))
