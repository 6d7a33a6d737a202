"""Against ArduPilot's own arithmetic, reimplemented from its sources in 32-bit floats."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ahrs_service.calibration.autopilots.ardupilot_params import (
    Names,
    forms_of_ardupilot,
    from_ardupilot,
    to_ardupilot,
)
from ahrs_service.calibration.autopilots.board_rotation import body_from_sensor
from ahrs_service.sensor.compensation import compensate_columns
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import Calibration, TriadCalibration, coefficients

G = 9.80665
F = np.float32


GYRO_OFFSETS = {f"INS_GYROFFS_{axis}": 0.0 for axis in "XYZ"} | {
    f"INS_TCAL1_GYR{k}_{axis}": 0.0 for k in (1, 2, 3) for axis in "XYZ"
} | {"INS_GYR1_CALTEMP": 25.0}  # fmt: skip


def clamp(value, low, high):
    return min(max(value, low), high)


def polynomial_eval(tdiff, c1, c2, c3):
    """AP_InertialSensor_tempcal.cpp: (c[0] + (c[1] + c[2]*tdiff)*tdiff)*tdiff*1e-6."""
    return (c1 + (c2 + c3 * tdiff) * tdiff) * tdiff * F(1e-6)


def ardupilot(parameters, triad, raw, temperature, imu=""):
    """_rotate_and_correct_accel and _gyro with correct_sensor, one sample, sensor axes."""
    n, out = imu or "1", []
    letters = {"accel": "ACC", "gyro": "GYR"}[triad]
    p = {name: F(value) for name, value in parameters.items()}
    for axis, value in zip("XYZ", raw, strict=True):
        v = F(value)
        if p[f"INS_TCAL{n}_ENABLE"] == 1:
            low, high = p[f"INS_TCAL{n}_TMIN"], p[f"INS_TCAL{n}_TMAX"]
            t = clamp(F(temperature), low, high)
            cal = clamp(p[f"INS_{letters}{n}_CALTEMP"], low, high)
            c = [p[f"INS_TCAL{n}_{letters}{k}_{axis}"] for k in (1, 2, 3)]
            v -= polynomial_eval(t - F(35.0), *c)
            v += polynomial_eval(cal - F(35.0), *c)
        v -= p[f"INS_{letters}{imu}OFFS_{axis}"]
        if triad == "accel":
            v *= p[f"INS_{letters}{imu}SCAL_{axis}"]
        out.append(v)
    return np.array(out, np.float64)


def floats(low, high):
    return st.floats(low, high, width=32)


@st.composite
def parameter_sets(draw):
    """What ArduPilot may hold for its first IMU: bias drifts to some m/s^2 over the span."""
    low = draw(floats(-60.0, 40.0))
    high = float(F(low + draw(floats(10.5, 100.0))))
    values = {"INS_TCAL1_ENABLE": 1, "INS_TCAL1_TMIN": low, "INS_TCAL1_TMAX": high}
    caltemp = draw(floats(-300.0, 80.0))
    for letters in ("ACC", "GYR"):
        values[f"INS_{letters}1_CALTEMP"] = caltemp
        for axis in "XYZ":
            values[f"INS_{letters}OFFS_{axis}"] = draw(floats(-0.5, 0.5))
            for k, size in ((1, 1e4), (2, 200.0), (3, 2.0)):
                values[f"INS_TCAL1_{letters}{k}_{axis}"] = draw(floats(-size, size))
    for axis in "XYZ":
        values[f"INS_ACCSCAL_{axis}"] = draw(floats(0.875, 1.125))
    return values


def test_by_hand():
    """P(t) = 1e-6 (2000 t + 10 t^2 + 0.5 t^3); at 45 degC, t = 10: 0.0215; at 25 degC, t = -10:
    -0.0195. So a raw 1.0 at 45 degC, calibrated at 25: (1 - 0.0215 - 0.0195 - 0.1) 1.01 =
    0.86759 m/s^2."""
    values = dict.fromkeys(Names(1).vector("gyro", "OFFS"), 0.0)
    for letters in ("ACC", "GYR"):
        values[f"INS_{letters}1_CALTEMP"] = 25.0
        for axis in "XYZ":
            values |= {f"INS_{letters}OFFS_{axis}": 0.1, f"INS_{letters}SCAL_{axis}": 1.01}
            for k, c in ((1, 2000.0), (2, 10.0), (3, 0.5)):
                values[f"INS_TCAL1_{letters}{k}_{axis}"] = c
    values |= {"INS_TCAL1_ENABLE": 1, "INS_TCAL1_TMIN": 0.0, "INS_TCAL1_TMAX": 70.0}
    rows = coefficients(from_ardupilot(values))
    one = np.ones((1, 3))
    gyro, accel = compensate_columns(rows, one, one, np.array([45.0]))
    np.testing.assert_allclose(accel, 0.86759, atol=1e-12)
    np.testing.assert_allclose(gyro, 0.859, atol=1e-12)
    assert ardupilot(values, "accel", (1.0, 1.0, 1.0), 45.0)[0] == pytest.approx(0.86759, abs=1e-6)


@settings(deadline=None, max_examples=25)
@given(
    parameter_sets(),
    st.tuples(*[floats(-20.0, 20.0)] * 3),
    floats(-80.0, 120.0),
    st.sampled_from([0, 4, 8, 16, 24]),
)
def test_an_import_compensates_as_ardupilot_does(parameters, raw, temperature, orientation):
    """In body axes, for rotations by multiples of 90 degrees; beyond TMIN and TMAX too."""
    turn = body_from_sensor(orientation)
    rows = coefficients(from_ardupilot(parameters, 1, turn))
    body = (turn @ np.array(raw))[None]
    gyro, accel = compensate_columns(rows, body, body, np.array([temperature]))
    for triad, ours in (("gyro", gyro), ("accel", accel)):
        theirs = turn @ ardupilot(parameters, triad, raw, temperature)
        # 32-bit arithmetic on ArduPilot's side, of powers of up to 120 degC.
        np.testing.assert_allclose(ours[0], theirs, atol=3e-5)


@settings(deadline=None, max_examples=25)
@given(parameter_sets())
def test_import_then_export_gives_the_same_parameters(parameters):
    """To the last bit, except coefficients with an effect over the span below 1e-5 [unit]."""
    low, high = parameters["INS_TCAL1_TMIN"], parameters["INS_TCAL1_TMAX"]
    caltemp = clamp(parameters["INS_ACC1_CALTEMP"], low, high)
    expected = parameters | {"INS_ACC1_CALTEMP": caltemp, "INS_GYR1_CALTEMP": caltemp}
    back = to_ardupilot(from_ardupilot(parameters)).values
    assert back.keys() == expected.keys()
    reach = max(abs(low - 35.0), abs(high - 35.0))
    for name, value in expected.items():
        power = int(name[-3]) if "_TCAL1_ACC" in name or "_TCAL1_GYR" in name else 0
        unit = 1e-6 * reach**power if power else 1.0
        if unit * abs(value) > 1e-5:
            assert back[name] == value, name
        else:
            assert unit * abs(back[name] - value) < 1e-11, name


@settings(deadline=None, max_examples=25)
@given(parameter_sets())
def test_an_export_of_what_ardupilot_can_hold_loses_nothing(parameters):
    for loss in to_ardupilot(from_ardupilot(parameters)).losses.values():
        # What rounding coefficients of t^3 to 32 bits leaves over some 100 degC.
        assert loss.largest.max() < 1e-6


@pytest.mark.parametrize(
    ("imu", "names"),
    [
        (1, ["INS_ACCOFFS_X", "INS_ACC1_CALTEMP", "INS_TCAL1_ENABLE", "INS_TCAL1_GYR3_X"]),
        (2, ["INS_ACC2OFFS_X", "INS_ACC2_CALTEMP", "INS_TCAL2_ENABLE", "INS_TCAL2_GYR3_X"]),
        (3, ["INS_ACC3OFFS_X", "INS_ACC3_CALTEMP", "INS_TCAL3_ENABLE", "INS_TCAL3_GYR3_X"]),
        (4, ["INS4_ACCOFFS_X", "INS4_ACC_CALTEMP", "INS4_TCAL_ENABLE", "INS4_TCAL_GYR3_X"]),
        (5, ["INS5_ACCOFFS_X", "INS5_ACC_CALTEMP", "INS5_TCAL_ENABLE", "INS5_TCAL_GYR3_X"]),
    ],
)
def test_the_names_of_each_imu(imu, names):
    """AP_InertialSensor.cpp: ACC2SCAL, _TCAL2_, _ACC2_CALTEMP; beyond three groups 4_ and 5_."""
    values = to_ardupilot(ramp(), imu).values
    assert set(names) <= values.keys()
    assert all(len(name) <= 16 for name in values)
    with pytest.raises(ValueError, match="from 1 to 5"):
        Names(6)


def ramp(low=-10.0, high=60.0, **accel):
    """Bias of the accelerometer's x: 0.05 m/s^2 + 0.002 per degC from 25 on."""
    slopes = [[[0.002 * (low - 25.0), 0.002], [0.0], [0.0]]]
    curve = Curve((low, high), tuple(tuple(map(tuple, piece)) for piece in slopes))
    return Calibration(
        accel=TriadCalibration(bias=(0.05, 0.0, 0.0), c=curve, **accel), room_degc=25.0
    )


def test_a_line_becomes_its_slope_and_the_offset_at_room_temperature():
    values = to_ardupilot(ramp()).values
    assert values["INS_TCAL1_ENABLE"] == 1
    assert (values["INS_TCAL1_TMIN"], values["INS_TCAL1_TMAX"]) == (-10.0, 60.0)
    assert values["INS_ACC1_CALTEMP"] == 25.0
    assert values["INS_ACCOFFS_X"] == F(0.05)
    assert values["INS_TCAL1_ACC1_X"] == 2000.0
    assert values["INS_TCAL1_ACC2_X"] == values["INS_TCAL1_ACC3_X"] == 0.0
    assert to_ardupilot(ramp(), caltemp_degc=35.0).values["INS_ACCOFFS_X"] == F(0.07)


def test_another_temperature_of_the_offsets_changes_the_numbers_not_the_result():
    made = [to_ardupilot(ramp(), caltemp_degc=t).values for t in (-40.0, 0.0, 35.0, 90.0)]
    assert [values["INS_ACC1_CALTEMP"] for values in made] == [-10.0, 0.0, 35.0, 60.0]
    for temperature in (-30.0, 10.0, 55.0):
        results = [ardupilot(values, "accel", (1.0, 2.0, 3.0), temperature) for values in made]
        np.testing.assert_allclose(results, results[0][None].repeat(4, 0), atol=1e-6)


def test_without_a_thermal_part_ardupilot_s_own_is_switched_off():
    calibration = Calibration(accel=TriadCalibration(bias=(0.1, 0.0, 0.0)))
    export = to_ardupilot(calibration)
    assert export.values["INS_TCAL1_ENABLE"] == 0
    assert not [name for name in export.values if "ACC1_X" in name or "CALTEMP" in name]
    assert export.values["INS_ACCOFFS_X"] == F(0.1)
    assert export.values["INS_ACCOFFS_Y"] == 0.0
    assert "INS_TCAL1_ENABLE is set to 0" in " ".join(export.remarks)


def test_a_calibration_made_on_top_of_ardupilot_s_replaces_both():
    """The autopilot subtracted 0.3 m/s^2 and scaled by 1.02; the result was then calibrated."""
    below = forms_of_ardupilot(
        {
            "INS_TCAL1_ENABLE": 0,
            **{f"INS_GYROFFS_{a}": 0.01 for a in "XYZ"},
            **{f"INS_ACCOFFS_{a}": 0.3 for a in "XYZ"},
            **{f"INS_ACCSCAL_{a}": 1.02 for a in "XYZ"},
        }
    )
    calibration = replace(
        ramp(matrix=((1.01, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))),
        gyro=TriadCalibration(bias=(0.002, 0.0, -0.001)),
    )
    values = to_ardupilot(calibration, below=below).values
    rng = np.random.default_rng(3)
    for raw, temperature in zip(rng.uniform(-20, 20, (9, 3)), rng.uniform(-20, 70, 9), strict=True):
        left = (raw - 0.3) * 1.02
        gyro, accel = compensate_columns(
            coefficients(calibration), (raw - 0.01)[None], left[None], np.array([temperature])
        )
        np.testing.assert_allclose(
            ardupilot(values, "accel", raw, temperature), accel[0], atol=1e-5
        )
        np.testing.assert_allclose(ardupilot(values, "gyro", raw, temperature), gyro[0], atol=1e-5)


def test_what_is_lost_is_stated_by_its_cause():
    """1 % of scale over the span, 2 % cross-axis and a step of bias: each part by hand."""
    breaks = (-10.0, 25.0, 60.0)
    drift = np.zeros((2, 9))
    drift[:, 0] = (-0.005, 0.005)
    steps = np.array([[0.0, 0.0, 0.0], [0.0, 0.1, 0.0]])
    accel = TriadCalibration(
        matrix=((1.0, 0.0, 0.02), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        matrix_drift=Curve.steps(breaks, drift),
        c=Curve.steps(breaks, steps),
    )
    loss = to_ardupilot(Calibration(accel=accel)).losses["accel"]
    assert (loss.unit, loss.size) == ("m/s^2", G)
    assert loss.scale[0] == pytest.approx(0.005 * G, rel=0.05)
    assert loss.scale[1:].max() < 1e-6
    assert loss.cross[0] == pytest.approx(0.02 * G, rel=0.02)
    assert loss.cross[1:].max() < 1e-6
    # A step of 0.1 in the middle: the best odd cubic misses by half of it at the step.
    assert loss.bias[1] == pytest.approx(0.05, rel=0.05)
    assert (loss.rms <= loss.largest).all()
    assert loss.largest[0] < loss.bias[0] + loss.scale[0] + loss.cross[0] + 1e-9
    assert loss.largest[1] == pytest.approx(loss.bias[1], rel=1e-6)


def test_gyro_terms_that_no_autopilot_has_are_counted_at_100_deg_s():
    gyro = TriadCalibration(
        matrix=((1.02, 0.0, 0.0), (0.0, 1.0, 0.01), (0.0, 0.0, 1.0)),
        g_sensitivity=((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1e-3, 0.0, 0.0)),
    )
    loss = to_ardupilot(Calibration(gyro=gyro)).losses["gyro"]
    assert (loss.unit, loss.size) == ("rad/s", math.radians(100.0))
    np.testing.assert_allclose(loss.scale, [0.02 * loss.size, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(loss.cross, [0.0, 0.01 * loss.size, 0.0], atol=1e-6)
    np.testing.assert_allclose(loss.force, [0.0, 0.0, 1e-3 * G], atol=1e-6)
    assert loss.bias.max() < 1e-6


def test_the_fit_is_best_where_the_unit_works():
    """A bend at 25 degC: restricted to temperatures above, the cubic follows the line there."""
    nodes = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.35, 0.0, 0.0]])
    curve = Curve.linear((-10.0, 25.0, 60.0), nodes)
    calibration = Calibration(accel=TriadCalibration(c=curve))
    hot = np.linspace(30.0, 60.0, 31)
    misses = []
    for works_at in (None, (25.0, 60.0)):
        values = to_ardupilot(calibration, works_at=works_at).values
        bias = forms_of_ardupilot(values | GYRO_OFFSETS)["accel"].bias(hot)
        misses.append(np.abs(bias[:, 0] - 0.01 * (hot - 25.0)).max())
    assert misses[0] > 5e-3
    assert misses[1] < 0.2 * misses[0]


def test_what_the_calibration_does_not_know_stays_as_it_is():
    """Of gyros alone: the accelerometer keeps its offsets, and has no drift."""
    export = to_ardupilot(Calibration(gyro=ramp().accel))
    assert not [n for n in export.values if ("OFFS" in n and "ACC" in n) or "SCAL" in n]
    assert {v for n, v in export.values.items() if "_ACC" in n} == {0.0}
    assert export.losses.keys() == {"gyro"}
    assert "says nothing of the accel" in " ".join(export.remarks)
    assert to_ardupilot(Calibration()).values == {"INS_TCAL1_ENABLE": 0}
    plain = forms_of_ardupilot(to_ardupilot(ramp()).values | GYRO_OFFSETS | {"INS_TCAL1_ENABLE": 0})
    assert not [n for n in to_ardupilot(Calibration(), below=plain).values if "OFFS" in n]
    warm = forms_of_ardupilot(to_ardupilot(ramp()).values | GYRO_OFFSETS)
    kept = to_ardupilot(Calibration(), below=warm).values
    assert kept == to_ardupilot(ramp()).values | GYRO_OFFSETS


def test_offsets_of_exactly_nothing_are_remarked_on():
    accel = TriadCalibration(matrix=((1.01, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    assert "never calibrated" in " ".join(to_ardupilot(Calibration(accel=accel)).remarks)


def test_a_lag_of_the_thermometer_is_reported_with_its_size():
    """0.002 m/s^2 per degC, 90 s, 1 degC a minute: 0.003 m/s^2."""
    (remark,) = [t for t in to_ardupilot(ramp(thermal_lag_s=90.0)).remarks if "lag" in t]
    assert "lag of 90 s" in remark
    assert "0.003 m/s^2" in remark


@pytest.mark.parametrize(
    ("calibration", "words"),
    [
        (ramp(20.0, 28.0), "spans 20.0..28.0 degC and ArduPilot wants 10"),
        (
            Calibration(accel=TriadCalibration(bias=(9.8, 0.0, 0.0))),
            r"offsets \[9.8, 0.0, 0.0\] m/s\^2: .* at most 3.5",
        ),
        (
            Calibration(
                accel=TriadCalibration(
                    matrix=((101.97, 0.0, 0.0), (0.0, 101.97, 0.0), (0.0, 0.0, 101.97))
                )
            ),
            "scales .* 0.8 to 1.2",
        ),
        (
            Calibration(accel=ramp().accel, gyro=ramp(61.0, 90.0).accel),
            "nothing in common",
        ),
    ],
)
def test_what_ardupilot_cannot_hold_is_refused(calibration, words):
    with pytest.raises(ValueError, match=words):
        to_ardupilot(calibration)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"INS_ACCOFFS_X": None}, "INS_ACCOFFS_X is missing"),
        ({"INS_ACCSCAL_X": 0.0}, "INS_ACCSCAL_X = 0: .* no IMU 1"),
        ({"INS_TCAL1_TMAX": -50.0}, "INS_TCAL1_TMIN = -10 is not below"),
        ({"INS_TCAL1_GYR3_Z": math.nan}, "INS_TCAL1_GYR3_Z = nan"),
    ],
)
def test_damaged_parameters_are_named(change, words):
    made = to_ardupilot(ramp()).values | GYRO_OFFSETS | change
    values = {name: value for name, value in made.items() if value is not None}
    with pytest.raises(ValueError, match=words):
        from_ardupilot(values)
