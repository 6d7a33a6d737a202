"""Streams of samples with a known attitude, and the pipeline over them."""

import numpy as np

from ahrs_service import pipeline
from ahrs_service.constants import STANDARD_GRAVITY_M_S2 as G
from ahrs_service.records import ESTIMATE_DTYPE, SAMPLE_DTYPE, empty
from ahrs_service.rotation import (
    inverse_columns,
    quaternion_columns,
    rotate_columns,
)
from ahrs_service.sensor.parameters import Calibration, coefficients
from ahrs_service.settings import Settings

PARAMETERS = pipeline.parameters(Settings())
IDEAL = coefficients(Calibration.ideal())


def still(count, roll=0.0, pitch=0.0, rate_hz=100.0):
    """Samples of a sensor at rest at the given tilt [rad]."""
    samples = empty(SAMPLE_DTYPE, count)
    samples["time_ns"] = np.round(np.arange(count) * 1e9 / rate_hz).astype(np.int64) + 10**9
    samples["gyro_rad_s"] = 0.0
    ned_from_body = quaternion_columns(np.array([[roll, pitch, 0.0]]))
    samples["accel_m_s2"] = rotate_columns(inverse_columns(ned_from_body), [[0.0, 0.0, -G]])
    samples["flags"] = 0
    samples["source"] = 1
    return samples


def run(samples, state=None, parameters=PARAMETERS):
    estimates = empty(ESTIMATE_DTYPE, len(samples))
    state = pipeline.new_state() if state is None else state
    pipeline.batch(parameters, IDEAL, state, samples, estimates)
    return estimates


def moving(count, seed=3):
    """A rough ride: every branch of the estimator is visited."""
    rng = np.random.default_rng(seed)
    samples = still(count)
    samples["gyro_rad_s"] = rng.normal(0.0, 0.3, (count, 3)).cumsum(axis=0) * 0.05
    samples["accel_m_s2"] += rng.normal(0.0, 1.0, (count, 3))
    samples["time_ns"] += rng.integers(0, 3_000_000, count)
    samples["time_ns"][count // 2 :] += 700_000_000
    samples["gyro_rad_s"][count // 3] = np.nan
    samples["accel_m_s2"][count // 4] = np.nan
    samples["time_ns"][count // 5] = samples["time_ns"][count // 5 - 1]
    samples["mag_ut"][::10] = (22.0, 3.0, 42.0)
    return samples
