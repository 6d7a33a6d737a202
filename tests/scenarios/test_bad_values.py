"""Values that no sensor should send."""

import math

import numpy as np
import pytest

from ahrs_service.records import Flag, Gate

IMU = ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU")
AXES = ("x", "y", "z")


def setting(**fields):
    def alter(message):
        for name, value in fields.items():
            setattr(message, name, value)

    return alter


def test_one_gyro_spike_is_held_back(base, unedited):
    original = unedited(base)
    outcome = base.change(("HIGHRES_IMU",), setting(ygyro=25.0), 20.0, count=1).replay()
    assert outcome.new_flags(original) == {"spike": 1}
    assert outcome.turn_from(original) < 2.0
    assert outcome.tilt_from(original, 21.0) < 1.0
    assert "degraded; gyro spike held back" in [text for _, text in outcome.health()]


def test_a_spike_that_the_radio_sends_twice_is_still_one_spike(base, unedited):
    spiked = base.change(("HIGHRES_IMU",), setting(xgyro=25.0), 20.0, count=1)
    doubled = spiked.edit(lambda frame: [frame, frame], 15.0, 25.0).replay()
    assert doubled.new_flags(unedited(base))["spike"] == 2
    assert doubled.turn_from(unedited(base)) < 2.0


def test_a_spike_of_the_accelerometer_moves_next_to_nothing(base, unedited):
    original = unedited(base)
    outcome = base.change(("HIGHRES_IMU",), setting(xacc=100.0), 20.0, count=1).replay()
    assert outcome.new_flags(original) == {}
    assert outcome.turn_from(original) < 2.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_rate_that_is_no_number_moves_nothing(base, unedited, value):
    original = unedited(base)
    start_s = base.calm_s
    bad = base.change(("HIGHRES_IMU",), setting(ygyro=value), start_s, start_s + 0.2)
    outcome = bad.replay()
    found = outcome.with_flag(Flag.NOT_FINITE)
    assert set(outcome.new_flags(original)) == {"not_finite"}
    assert len(found) == outcome.new_flags(original)["not_finite"] >= 9
    held = found["ned_from_body"]
    assert (held == held[0]).all()
    assert np.isfinite(outcome.estimates["ned_from_body"]).all()
    assert np.isfinite(outcome.estimates["attitude_sigma_rad"]).all()
    assert outcome.tilt_from(original, start_s + 0.2) < 2.0
    assert any("IMU values are not finite" in text for _, text in outcome.health())


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_force_that_is_no_number_is_not_used(base, unedited, value):
    original = unedited(base)
    bad = base.change(("HIGHRES_IMU",), setting(yacc=value), 20.0, 20.2)
    outcome = bad.replay()
    found = outcome.with_flag(Flag.ACCEL_MISSING)
    assert len(found) >= 9
    assert (found["gate"] & Gate.STALE != 0).all()
    assert np.isfinite(outcome.estimates["ned_from_body"]).all()
    assert outcome.turn_from(original) < 2.0


def test_all_imu_values_no_number_from_the_start_and_then_good(base, unedited):
    names = [f"{axis}{kind}" for axis in AXES for kind in ("gyro", "acc")]
    bad = base.change(("HIGHRES_IMU",), setting(**dict.fromkeys(names, math.nan)), 0.0, 1.0)
    outcome = bad.replay()
    assert np.isfinite(outcome.estimates["ned_from_body"]).all()
    assert outcome.tilt_from(unedited(base), base.calm_s + 8.0) < 5.0


def test_another_message_steps_in_for_a_gyro_that_sends_no_numbers(flight, unedited):
    bad = flight.change(("HIGHRES_IMU",), setting(zgyro=math.nan), 20.0, 30.0)
    outcome = bad.replay()
    assert outcome.when(Flag.NOT_FINITE).max() < 20.5
    assert outcome.summary.sources["RAW_IMU"] > 450
    assert outcome.tilt_from(unedited(flight), 20.0) < 5.0


@pytest.mark.parametrize("field", ["zacc", "xgyro"])
def test_a_clipping_sensor_is_flagged_and_not_used_as_the_vertical(base, unedited, field):
    value = {"zacc": -157.0, "xgyro": 34.95}[field]
    original = unedited(base)
    start_s = base.calm_s
    outcome = base.change(
        ("HIGHRES_IMU",), setting(**{field: value}), start_s, start_s + 0.5
    ).replay()
    found = outcome.with_flag(Flag.SATURATED)
    expected = (original.t_s >= start_s) & (original.t_s < start_s + 0.5)
    assert len(found) == np.count_nonzero(expected)
    # The first sample of a clipping gyro is held back as a spike.
    assert (found["gate"][1:] & Gate.SATURATION != 0).all()
    assert any("IMU out of its range" in text for _, text in outcome.health())
    if field == "zacc":
        assert outcome.tilt_from(original, start_s, start_s + 3.0) < 1.0
        assert outcome.tilt_from(original) < 5.0
