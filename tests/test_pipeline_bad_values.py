"""Values that no sensor means: spikes, no numbers, states beyond all sense."""

import numpy as np
import pytest

from ahrs_service import pipeline
from ahrs_service.records import Flag, Phase
from ahrs_service.rotation import (
    euler_columns,
)
from tests.streams import run, still


def test_one_gyro_spike_is_held_back_and_a_real_fast_rotation_is_not():
    spiked = still(400)
    spiked["gyro_rad_s"][300, 0] = 25.0
    estimates = run(spiked)
    assert estimates["flags"][300] & Flag.SPIKE
    roll = euler_columns(estimates["ned_from_body"])[:, 0]
    assert abs(roll[-1]) < 1e-6

    fast = still(400)
    fast["gyro_rad_s"][300:, 2] = 15.0
    flags = run(fast)["flags"]
    assert np.count_nonzero(flags & Flag.SPIKE) == 1


def test_not_a_number_moves_nothing():
    samples = still(400)
    samples["gyro_rad_s"][300] = np.nan
    estimates = run(samples)
    assert estimates["flags"][300] & Flag.NOT_FINITE
    assert np.isfinite(estimates["ned_from_body"]).all()
    np.testing.assert_allclose(euler_columns(estimates["ned_from_body"])[-1], 0.0, atol=1e-9)


@pytest.mark.parametrize("value", [1e3, 3e38, -np.inf, np.nan])
def test_impossible_values_move_nothing(value):
    samples = still(600)
    samples["gyro_rad_s"][300:310] = value
    samples["accel_m_s2"][400:410] = 10.0 * value
    estimates = run(samples)
    assert (estimates["flags"][300:310] & Flag.NOT_FINITE).all()
    assert (estimates["flags"][400:410] & Flag.ACCEL_MISSING).all()
    np.testing.assert_allclose(euler_columns(estimates["ned_from_body"])[350:], 0.0, atol=1e-6)


@pytest.mark.parametrize("field", ["ned_from_body", "covariance", "gyro_bias_rad_s"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_wrecked_state_aligns_anew(field, value):
    state = pipeline.new_state()
    run(still(400), state)
    state[field] = value
    estimate = run(still(1000, roll=0.3)[400:], state)[-1]
    assert estimate["phase"] == Phase.RUNNING
    assert euler_columns(estimate["ned_from_body"])[0] == pytest.approx(0.3, abs=0.02)
