"""Against PX4's own arithmetic, reimplemented from its sources in 32-bit floats."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ahrs_service.calibration.autopilots.board_rotation import body_from_sensor
from ahrs_service.calibration.autopilots.px4_params import (
    forms_of_px4,
    from_px4,
    thermal_slot,
    to_px4,
)
from ahrs_service.sensor.compensation import compensate_columns
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import Calibration, TriadCalibration, coefficients

F = np.float32
IDS = {"accel": 4259850, "gyro": 4325386}
"""As in the log of a real FMUv6C."""


def px4(parameters, triad, raw, temperature, imu=0):
    """calc_thermal_offsets_3D, then Correct of Accelerometer.hpp or Gyroscope.hpp."""
    tc, cal = {"accel": ("A", "ACC"), "gyro": ("G", "GYRO")}[triad]
    own, thermal = parameters[f"CAL_{cal}{imu}_ID"], np.zeros(3, F)
    slots = [n for n in range(3) if parameters.get(f"TC_{tc}{n}_ID") == own]
    if parameters.get(f"TC_{tc}_ENABLE") == 1 and slots:
        low, high, reference = (
            F(parameters[f"TC_{tc}{slots[0]}_{name}"]) for name in ("TMIN", "TMAX", "TREF")
        )
        t = F(min(max(F(temperature), low), high)) - reference
        for axis in range(3):
            x = [F(parameters[f"TC_{tc}{slots[0]}_X{k}_{axis}"]) for k in range(4)]
            thermal[axis] = x[0] + x[1] * t + x[2] * (t * t) + x[3] * (t * t * t)
    offset = np.array([parameters[f"CAL_{cal}{imu}_{a}OFF"] for a in "XYZ"], F)
    left = np.array(raw, F) - thermal - offset
    if triad == "accel":
        left = left * np.array([parameters[f"CAL_ACC{imu}_{a}SCALE"] for a in "XYZ"], F)
    return left.astype(np.float64)


def floats(low, high):
    return st.floats(low, high, width=32)


@st.composite
def parameter_sets(draw, x0=0.0):
    """What PX4 may hold for its first IMU; its X0 up to `x0` [unit]."""
    values = {"TC_A_ENABLE": 1, "TC_G_ENABLE": 1}
    low = draw(floats(-60.0, 40.0))
    high = float(F(low + draw(floats(5.0, 100.0))))
    reference = draw(floats(low, high))
    for triad, (tc, cal) in {"accel": ("A", "ACC"), "gyro": ("G", "GYRO")}.items():
        values |= {f"TC_{tc}0_ID": IDS[triad], f"CAL_{cal}0_ID": IDS[triad]}
        for name, value in (("TMIN", low), ("TMAX", high), ("TREF", reference)):
            values[f"TC_{tc}0_{name}"] = value
        for axis in range(3):
            values[f"CAL_{cal}0_{'XYZ'[axis]}OFF"] = draw(floats(-0.5, 0.5))
            values[f"TC_{tc}0_X0_{axis}"] = draw(floats(-x0, x0))
            for k, size in ((1, 2.0**-6), (2, 2.0**-12), (3, 2.0**-19)):
                values[f"TC_{tc}0_X{k}_{axis}"] = draw(floats(-size, size))
    for axis in "XYZ":
        values[f"CAL_ACC0_{axis}SCALE"] = draw(floats(0.875, 1.125))
    return values


def test_by_hand():
    """t = 10: X0 + 10 X1 + 100 X2 + 1000 X3 = 0.01 + 0.02 + 0.03 + 0.04 = 0.1; OFF 0.3; SCALE 1.1:
    a raw 1.0 is 0.6 rad/s and 0.66 m/s^2."""
    values = {"TC_A_ENABLE": 1, "TC_G_ENABLE": 1}
    for tc, cal, triad in (("A", "ACC", "accel"), ("G", "GYRO", "gyro")):
        values |= {f"TC_{tc}0_ID": IDS[triad], f"CAL_{cal}0_ID": IDS[triad]}
        values |= {f"TC_{tc}0_TMIN": -20.0, f"TC_{tc}0_TMAX": 70.0, f"TC_{tc}0_TREF": 25.0}
        for axis in range(3):
            values[f"CAL_{cal}0_{'XYZ'[axis]}OFF"] = 0.3
            for k, x in enumerate((0.01, 0.002, 0.0003, 0.00004)):
                values[f"TC_{tc}0_X{k}_{axis}"] = x
    values |= {f"CAL_ACC0_{axis}SCALE": 1.1 for axis in "XYZ"}
    one = np.ones((1, 3))
    gyro, accel = compensate_columns(coefficients(from_px4(values)), one, one, np.array([35.0]))
    np.testing.assert_allclose(gyro, 0.6, atol=1e-12)
    np.testing.assert_allclose(accel, 0.66, atol=1e-12)
    assert px4(values, "accel", (1.0, 1.0, 1.0), 35.0)[0] == pytest.approx(0.66, abs=1e-6)


@settings(deadline=None, max_examples=25)
@given(
    parameter_sets(0.5),
    st.tuples(*[floats(-20.0, 20.0)] * 3),
    floats(-80.0, 120.0),
    st.sampled_from([0, 4, 8, 16, 24]),
)
def test_an_import_compensates_as_px4_does(parameters, raw, temperature, orientation):
    turn = body_from_sensor(orientation)
    rows = coefficients(from_px4(parameters, 1, turn))
    body = (turn @ np.array(raw))[None]
    gyro, accel = compensate_columns(rows, body, body, np.array([temperature]))
    for triad, ours in (("gyro", gyro), ("accel", accel)):
        theirs = turn @ px4(parameters, triad, raw, temperature)
        np.testing.assert_allclose(ours[0], theirs, atol=3e-5)


@settings(deadline=None, max_examples=25)
@given(parameter_sets())
def test_import_then_export_gives_the_same_parameters(parameters):
    """To the last bit, except coefficients with an effect over the span below 1e-5 [unit]."""
    export = to_px4(from_px4(parameters), device_ids=IDS)
    own = {"CAL_ACC0_ID": IDS["accel"], "CAL_GYRO0_ID": IDS["gyro"]}
    back = export.values | own
    assert back.keys() == parameters.keys()
    reference = parameters["TC_A0_TREF"]
    reach = max(abs(parameters[f"TC_A0_{end}"] - reference) for end in ("TMIN", "TMAX"))
    for name, value in parameters.items():
        unit = reach ** int(name[-3]) if "_X" in name and name.startswith("TC_") else 1.0
        if unit * abs(value) > 1e-5:
            assert back[name] == value, name
        else:
            assert unit * abs(back[name] - value) < 1e-11, name
    for loss in export.losses.values():
        assert loss.largest.max() < 1e-6


def ramp(low=-10.0, high=60.0):
    curve = Curve((low, high), (((0.002 * (low - 25.0), 0.002), (0.0,), (0.0,)),))
    return Calibration(accel=TriadCalibration(bias=(0.05, 0.0, 0.0), c=curve), room_degc=25.0)


def test_a_line_and_a_gyro_that_temperature_leaves_alone():
    export = to_px4(ramp(), imu=2, device_ids=IDS)
    values = export.values
    assert values["CAL_ACC1_XOFF"] == F(0.05)
    assert (values["TC_A1_TREF"], values["TC_A1_X1_0"]) == (25.0, F(0.002))
    assert values["TC_A1_X0_0"] == values["TC_A1_X2_0"] == 0.0
    assert (values["TC_A1_ID"], values["TC_A_ENABLE"]) == (4259850, 1)
    assert export.switches == ("TC_A_ENABLE",)
    assert not [name for name in values if name.startswith(("TC_G", "CAL_GYRO"))]
    assert "says nothing of the gyro" in " ".join(export.remarks)
    plain = replace(ramp(), gyro=TriadCalibration(bias=(0.01, 0.0, 0.0)))
    export = to_px4(plain, imu=2, device_ids=IDS)
    assert (export.values["TC_G1_ID"], export.values["CAL_GYRO1_XOFF"]) == (0, F(0.01))
    assert "TC_G_ENABLE" not in export.values
    assert "gyro calibration has no thermal part: TC_G1_ID is set to 0" in " ".join(export.remarks)
    assert all(len(name) <= 16 for name in values)


def test_without_the_sensor_s_id_what_is_to_be_done_is_reported():
    export = to_px4(ramp())
    assert "TC_A0_ID" not in export.values
    assert "set it to CAL_ACC0_ID" in " ".join(export.remarks)


def test_thermal_calibration_goes_by_the_id_of_the_sensor():
    values = to_px4(ramp(), imu=2, device_ids=IDS).values | {
        "CAL_ACC0_ID": IDS["accel"],
        "CAL_ACC1_ID": 77,
        "CAL_GYRO0_ID": IDS["gyro"],
        **{f"CAL_{cal}0_{a}OFF": 0.0 for cal in ("ACC", "GYRO") for a in "XYZ"},
        **{f"CAL_ACC0_{a}SCALE": 1.0 for a in "XYZ"},
    }
    assert thermal_slot(values, "accel", 1) == 2
    assert thermal_slot(values, "accel", 2) is None
    form = forms_of_px4(values, 1)["accel"]
    assert form.bias(np.array([35.0]))[0, 0] == pytest.approx(0.02, abs=1e-7)
    assert px4(values, "accel", (1.0, 0.0, 0.0), 35.0)[0] == pytest.approx(0.98, abs=1e-6)
    assert thermal_slot(values | {"TC_A_ENABLE": 0}, "accel", 1) is None


def test_the_scale_of_gyros_of_old_releases_is_taken():
    values = {
        "CAL_ACC0_ID": 1,
        "CAL_GYRO0_ID": 2,
        **{f"CAL_{cal}0_{a}OFF": 0.1 for cal in ("ACC", "GYRO") for a in "XYZ"},
        **{f"CAL_{cal}0_{a}SCALE": 1.25 for cal in ("ACC", "GYRO") for a in "XYZ"},
    }
    one = np.ones((1, 3))
    gyro, _ = compensate_columns(coefficients(from_px4(values)), one, one, np.array([math.nan]))
    np.testing.assert_allclose(gyro, 0.9 * 1.25)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"CAL_ACC0_XOFF": None}, "CAL_ACC0_XOFF is missing"),
        ({"TC_A0_X2_1": None}, "TC_A0_X2_1 is missing"),
        ({"CAL_ACC0_XSCALE": 0.0}, "CAL_ACC0_XSCALE = 0"),
        ({"TC_A0_TMAX": -50.0}, "TC_A0_TMIN = -10 is not below"),
    ],
)
def test_damaged_parameters_are_named(change, words):
    made = to_px4(ramp(), device_ids=IDS).values | {"CAL_ACC0_ID": IDS["accel"]}
    values = {k: v for k, v in (made | change).items() if v is not None}
    with pytest.raises(ValueError, match=words):
        from_px4(values)


def test_an_imu_that_px4_cannot_have():
    with pytest.raises(ValueError, match="IMU 5"):
        to_px4(ramp(), imu=5)
