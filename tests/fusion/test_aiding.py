"""What counts as a measured velocity over ground."""

import numpy as np
import pytest

from ahrs_service import pipeline
from ahrs_service.fusion import aiding
from ahrs_service.records import SAMPLE_DTYPE, empty


def heard(state, *velocity, time_ns=5):
    sample = empty(SAMPLE_DTYPE)[0]
    sample["velocity_ned_m_s"], sample["time_ns"] = velocity, time_ns
    state["measured_new"] = 0
    aiding.hear_velocity(state, sample)
    return bool(state["measured_new"])


@pytest.mark.parametrize("down", [np.nan, 0.0, -5.0])
def test_a_velocity_is_new_until_it_comes_again(down):
    state = pipeline.new_state()[0]
    assert heard(state, 30.0, -40.0, down)
    assert not heard(state, 30.0, -40.0, down)
    assert heard(state, 30.5, -40.0, down, time_ns=7)
    np.testing.assert_array_equal(state["measured_velocity_m_s"], [30.5, -40.0, down])
    assert state["measured_time_ns"] == 7


@pytest.mark.parametrize(
    "velocity",
    [
        (60.1, 0.0, 0.0),
        (50.0, -40.0, np.nan),
        (1.0, 2.0, 500.0),
        (1.0, 2.0, np.inf),
        (-np.inf, 2.0, 0.0),
        (np.nan, 2.0, 0.0),
        (2.0, np.nan, 0.0),
        (1e200, 1e200, 0.0),
    ],
)
def test_what_no_small_uav_does_is_no_measurement(velocity):
    state = pipeline.new_state()[0]
    assert not heard(state, *velocity)
    assert heard(state, 59.0, 0.0, 0.0)
