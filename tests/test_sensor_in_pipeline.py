"""What the pipeline does with a sensor's output before it integrates it."""

from dataclasses import replace

import numpy as np
import pytest

from ahrs_service import pipeline
from ahrs_service.records import (
    ESTIMATE_DTYPE,
    SAMPLE_DTYPE,
    Flag,
    ImuSource,
    empty,
)
from ahrs_service.sensor.compensation import compensate_columns
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.forward import forward_columns
from ahrs_service.sensor.parameters import Calibration, TriadCalibration, coefficients
from ahrs_service.sensor.thermometer import acting_columns
from ahrs_service.settings import Settings

COUNT, RATE_HZ = 400, 100.0
RATE, FORCE = np.array([0.02, -0.01, 0.03]), np.array([0.3, -0.2, -9.8])
DRIFT = Curve.linear((0.0, 40.0), ((-0.02, 0.01, 0.0), (0.02, -0.01, 0.01)))


def known(lag_s=0.0, **fields):
    triad = TriadCalibration(bias=(0.1, -0.2, 0.05), c=DRIFT, thermal_lag_s=lag_s)
    return Calibration(gyro=triad, accel=triad, **fields)


def samples_of(calibration, temperature, gap=None):
    """A steady motion as the sensor gives it, at the thermometer's `temperature` [N]."""
    rows = empty(SAMPLE_DTYPE, COUNT)
    time_s = np.arange(COUNT) / RATE_HZ
    if gap is not None:
        time_s[gap:] += 3.0
    rows["time_ns"] = rows["received_ns"] = np.rint(time_s * 1e9)
    rows["temperature_degc"] = temperature
    still = np.ones((COUNT, 1))
    rows["gyro_rad_s"], rows["accel_m_s2"] = forward_columns(
        coefficients(calibration), still * RATE, still * FORCE, rows["temperature_degc"], time_s
    )
    rows["source"] = ImuSource.HIGHRES_IMU
    return rows


def compensated(calibration, samples, state=None):
    """Rate and force as used by the pipeline: the estimates' less the estimated biases."""
    state = pipeline.new_state() if state is None else state
    gyro, accel = np.empty((len(samples), 3)), np.empty((len(samples), 3))
    estimates = empty(ESTIMATE_DTYPE, len(samples))
    parameters, row = pipeline.parameters(Settings()), coefficients(calibration)
    for n in range(len(samples)):
        pipeline.step(parameters, row, state, samples[n : n + 1], estimates[n : n + 1])
        gyro[n], accel[n] = state["gyro_rad_s"][0], state["accel_m_s2"][0]
        accel[n] += state["accel_bias_m_s2"][0]
    return gyro, accel, estimates


@pytest.mark.parametrize("lag_s", [0.0, 2.0, -2.0])
@pytest.mark.parametrize("gap", [None, 250])
def test_the_step_undoes_the_forward_model_with_its_lags_and_over_gaps(lag_s, gap):
    calibration = known(lag_s)
    temperature = np.where(np.arange(COUNT) < 100, 10.0, 25.0)
    gyro, accel, _ = compensated(calibration, samples_of(calibration, temperature, gap))
    np.testing.assert_allclose(gyro, np.tile(RATE, (COUNT, 1)), atol=1e-12)
    # The bias that the filter learns is added again: of the force half a digit is lost.
    np.testing.assert_allclose(accel[:1], FORCE[None], atol=1e-12)
    assert np.abs(accel - FORCE).max() < 0.02


def test_the_memory_of_the_lag_is_part_of_the_state():
    calibration = known(5.0)
    samples = samples_of(calibration, np.where(np.arange(COUNT) < 100, 10.0, 25.0))
    state = pipeline.new_state()
    first, _, _ = compensated(calibration, samples[:150], state)
    saved = np.frombuffer(state.tobytes(), pipeline.STATE_DTYPE).copy()
    rest, _, _ = compensated(calibration, samples[150:], saved)
    whole, _, _ = compensated(calibration, samples)
    np.testing.assert_array_equal(np.concatenate([first, rest]), whole)
    fresh, _, _ = compensated(calibration, samples[150:])
    assert np.abs(fresh - whole[150:]).max() > 1e-3


def test_a_missing_temperature_leaves_the_drift_out_and_is_reported():
    calibration = known(5.0)
    temperature = np.full(COUNT, 35.0)
    temperature[100:200] = np.nan
    gyro, _, estimates = compensated(calibration, samples_of(calibration, temperature))
    np.testing.assert_allclose(gyro, np.tile(RATE, (COUNT, 1)), atol=1e-12)
    observed = (estimates["flags"] & Flag.UNCOMPENSATED) != 0
    np.testing.assert_array_equal(observed, np.isnan(temperature))


def test_stale_temperature_is_gone_on_with():
    """The intake keeps the last temperature and flags it; the step uses the one given."""
    calibration = known(1.0)
    rows = samples_of(calibration, np.r_[np.full(50, 10.0), np.full(COUNT - 50, 20.0)])
    rows["flags"][100:] = Flag.TEMPERATURE_STALE
    gyro, _, estimates = compensated(calibration, rows)
    np.testing.assert_allclose(gyro, np.tile(RATE, (COUNT, 1)), atol=1e-12)
    assert ((estimates["flags"][100:] & Flag.TEMPERATURE_STALE) != 0).all()


def test_another_imu_begins_with_its_own_temperature():
    calibration = known(5.0)
    rows = samples_of(calibration, 10.0)
    rows["temperature_degc"][200:] = 30.0
    rows["flags"][200] = Flag.IMU_CHANGED
    gyro, _, _ = compensated(calibration, rows)
    at_once, _ = compensate_columns(
        coefficients(replace(calibration, gyro=replace(calibration.gyro, thermal_lag_s=0.0))),
        rows["gyro_rad_s"],
        rows["accel_m_s2"],
        rows["temperature_degc"],
    )
    np.testing.assert_allclose(gyro[200:], at_once[200:], atol=1e-12)


@pytest.mark.parametrize(
    ("imu", "source", "holds"),
    [
        (None, ImuSource.SCALED_IMU2, True),
        (0, ImuSource.HIGHRES_IMU, True),
        (0, ImuSource.SCALED_IMU2, False),
        (1, ImuSource.SCALED_IMU2, True),
        (2, ImuSource.HIGHRES_IMU_2, True),
        (1, ImuSource.ULOG, False),
    ],
)
def test_only_its_own_imu_is_compensated(imu, source, holds):
    calibration = known(imu=imu)
    rows = samples_of(calibration, 20.0)
    rows["source"] = source
    gyro, _, estimates = compensated(calibration, rows)
    expected = np.tile(RATE, (COUNT, 1)) if holds else rows["gyro_rad_s"]
    np.testing.assert_allclose(gyro, expected, atol=1e-12)
    observed = (estimates["flags"] & Flag.UNCOMPENSATED) != 0
    assert observed.all() if not holds else not observed.any()


def test_compensation_comes_before_the_rotation_to_vehicle_axes():
    calibration = known()
    rows = samples_of(calibration, 20.0)
    dcm = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rows["vehicle_from_board"] = dcm
    gyro, _, _ = compensated(calibration, rows)
    np.testing.assert_allclose(gyro, np.tile(dcm @ RATE, (COUNT, 1)), atol=1e-12)


def test_a_clipped_axis_is_seen_although_it_is_rotated():
    rows = samples_of(Calibration(), 20.0)
    x = 0.1
    rows["vehicle_from_board"] = np.array(
        [[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]]
    )
    rows["accel_m_s2"][50] = (0.0, -156.9, -9.8)
    _, _, estimates = compensated(Calibration(), rows)
    assert np.flatnonzero(estimates["flags"] & Flag.SATURATED).tolist() == [50]


def test_columns_and_the_step_hold_the_same_temperature():
    calibration = known(3.0)
    temperature = 20.0 + 10.0 * np.sin(np.arange(COUNT) / 50.0)
    rows = samples_of(calibration, temperature)
    acting = acting_columns(coefficients(calibration), temperature, rows["time_ns"] * 1e-9)
    state = pipeline.new_state()
    compensated(calibration, rows, state)
    np.testing.assert_allclose(state["filtered_degc"][0], acting[-1], rtol=1e-12)
