"""Instructions to the operator while a unit warms up."""

import numpy as np
import pytest

from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.thermal.soak_guide import guide_thermal

RATE_HZ = 10.0


def warming(seconds, degc_per_min=6.0, degc=5.0, shaking_from=np.inf):
    rng = np.random.default_rng(1)
    time = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    gyro = rng.normal(0.0, 1e-3, (len(time), 3))
    accel = rng.normal(0.0, 5e-3, (len(time), 3)) - [0.0, 0.0, 9.80665]
    shake = np.where(time >= shaking_from, 1.0, 0.0)[:, None]
    return ImuColumns(
        time,
        gyro + shake * rng.normal(0.0, 0.5, gyro.shape),
        accel + shake * rng.normal(0.0, 2.0, accel.shape),
        degc + degc_per_min / 60.0 * time,
    )


def test_it_begins_with_putting_the_unit_down():
    for seconds, state in ((0.0, "waiting for samples"), (30.0, "moving")):
        guidance = guide_thermal(warming(seconds, shaking_from=0.0), 20.0)
        assert guidance.instruction == "put it down on something solid and leave it alone"
        assert guidance.state == state
        assert not guidance.done


def test_it_reports_how_far_the_temperature_is():
    guidance = guide_thermal(warming(61.0), 20.0)
    assert guidance.instruction.startswith("leave it alone while it warms or cools: 6.0 of 20 degC")
    assert guidance.state.startswith("still, 11.0 degC, +6.00 degC a minute")
    assert dict(guidance.progress)["span"] == "5.0 to 11.0 degC"
    assert not guidance.done
    assert guidance.refusals == ()


def test_it_ends_when_the_span_is_there():
    guidance = guide_thermal(warming(205.0), 20.0)
    assert guidance.done
    assert guidance.instruction == "all is there"


def test_it_sees_that_somebody_moves_the_unit():
    assert guide_thermal(warming(80.0, shaking_from=60.0), 20.0).state.startswith("moving")


def test_it_says_when_waiting_is_of_no_use():
    guidance = guide_thermal(warming(600.0, degc_per_min=0.02), 20.0)
    assert "hardly changes any more (+0.02 degC a minute)" in guidance.refusals[0].why


def test_it_says_when_no_temperature_comes():
    guidance = guide_thermal(warming(30.0, degc=np.nan), 20.0)
    assert "tells no temperature of the IMU" in guidance.refusals[0].why


@pytest.mark.parametrize("seconds", [0.1, 0.7, 1.5])
def test_a_few_samples_are_no_trouble(seconds):
    assert not guide_thermal(warming(seconds), 20.0).done
