"""A warm-up counts from power-on, for any part of the flight in a recording or a reference."""

import math

import numpy as np
import pytest

from ahrs_service.diagnosis.input.diagnosis_input import Recorded, Series
from ahrs_service.diagnosis.input.effect_removal import with_effects
from ahrs_service.diagnosis.input.reference_motion import covariates
from ahrs_service.effects.catalogue import effect_of
from ahrs_service.records import empty
from ahrs_service.simulation.effect_inputs import columns_of
from ahrs_service.simulation.trajectory import TRUTH_DTYPE

WARM_UP = effect_of("gyro_warm_up")
VALUES = WARM_UP.checked({"amplitude": [0.1, -0.2, 0.0], "time_constant_s": 30.0})


def begun_late(start_s=60.0):
    """A minute at rest, recorded from a minute after power-on: stamps count from power-on."""
    time_s = start_s + np.arange(3000) / 50.0
    still = np.tile([1.0, 0.0, 0.0, 0.0], (len(time_s), 1))
    zeros = np.zeros((len(time_s), 3))
    known = [Series(time_s, still)] + [Series() for _ in range(7)]
    return Recorded("late", time_s, zeros, zeros - [0.0, 0.0, 9.8], *known)


def test_a_recording_begun_a_minute_after_power_on_has_little_warm_up_left():
    """exp(-60 / 30) = 0.1353 of it at first, exp(-120 / 30) = 0.0183 a minute later."""
    felt = with_effects(begun_late(), [(WARM_UP, VALUES)]).gyro_rad_s
    np.testing.assert_allclose(felt[0], [0.1 * math.exp(-2.0), -0.2 * math.exp(-2.0), 0.0])
    assert felt[-1, 0] == pytest.approx(0.1 * math.exp(-119.98 / 30.0))


def test_the_columns_of_a_reference_count_from_power_on():
    recorded = begun_late()
    at_s, zeros = recorded.imu_time_s[500:1000], np.zeros((500, 3))
    columns = covariates(recorded, at_s, zeros, zeros, recorded.attitude.values[500:1000])
    # 10 s into the recording, 70 s after power-on.
    assert WARM_UP.add(columns, VALUES).gyro[0, 0] == pytest.approx(0.1 * math.exp(-70.0 / 30.0))


def test_a_simulated_flight_begins_3_s_after_power_on():
    truth = empty(TRUTH_DTYPE, 5)
    truth["time_s"], truth["rate_rad_s"] = np.arange(5) * 0.1, 0.0
    columns = columns_of(truth, np.full(5, 30.0), 10.0, None, np.zeros(5))
    left = WARM_UP.add(columns, VALUES).gyro[:, 0]
    expected = 0.1 * np.exp(-(3.0 + 0.1 * np.arange(5)) / 30.0)
    np.testing.assert_allclose(left, expected, rtol=1e-12)
