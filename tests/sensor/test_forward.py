from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ahrs_service.records import Flag
from ahrs_service.sensor.compensation import compensate
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.forward import forward, forward_columns
from ahrs_service.sensor.parameters import Calibration, TriadCalibration, coefficients

SEGMENTS_OF_THE_PAPER = np.linspace(-40.0, 70.0, 23)


def floats(low, high):
    return st.floats(low, high, allow_nan=False)


@st.composite
def curves(draw, columns, size):
    """Steps, lines that meet, lines that jump, or cubics, within `size` over -40..70 degC."""
    breaks = draw(
        st.sampled_from([np.array([-40.0, 70.0]), SEGMENTS_OF_THE_PAPER, np.r_[-40.0, 11.3, 70.0]])
    )
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = len(breaks) - 1
    kind = draw(st.sampled_from(["none", "steps", "meeting lines", "jumping lines", "cubics"]))
    if kind == "none":
        return Curve()
    if kind == "steps":
        return Curve.steps(breaks, rng.uniform(-size, size, (count, columns)))
    if kind == "meeting lines":
        return Curve.linear(breaks, rng.uniform(-size, size, (count + 1, columns)))
    powers = 2 if kind == "jumping lines" else 4
    c = rng.uniform(-size, size, (powers, count, columns)) / powers
    return Curve.from_ppoly(
        breaks, c / np.diff(breaks)[:, None] ** np.arange(powers)[::-1, None, None]
    )


@st.composite
def triads(draw, largest):
    """A triad with a drift that is a small part of its output range `largest`."""
    matrix = np.eye(3) + np.array(
        draw(st.lists(floats(-0.1, 0.1), min_size=9, max_size=9))
    ).reshape(3, 3)
    return TriadCalibration(
        matrix=tuple(map(tuple, matrix.tolist())),
        bias=draw(st.tuples(*[floats(-0.1 * largest, 0.1 * largest)] * 3)),
        a=draw(curves(3, 0.1 / largest)),
        b=draw(curves(3, 0.1)),
        c=draw(curves(3, 0.1 * largest)),
        matrix_drift=draw(curves(9, 0.05)),
    )


g_sensitivities = st.tuples(*[st.tuples(*[floats(-0.01, 0.01)] * 3)] * 3)


@settings(max_examples=100, deadline=None)
@given(
    triads(35.0),
    g_sensitivities,
    triads(160.0),
    st.tuples(*[floats(-35.0, 35.0)] * 3),
    st.tuples(*[floats(-160.0, 160.0)] * 3),
    st.one_of(floats(-60.0, 90.0), st.sampled_from(SEGMENTS_OF_THE_PAPER.tolist())),
    floats(-60.0, 90.0),
)
def test_compensation_undoes_the_forward_model(
    gyro, sensitivity, accel, rate, force, gyro_degc, accel_degc
):
    """Of every model, at temperatures inside, on the borders and beyond.

    The tolerance is 1e-12 of the range: K^-1 of these matrices enlarges rounding some ten times,
    the cofactors and the parabola's root add a few units in the last place each.
    """
    gyro = replace(gyro, g_sensitivity=sensitivity)
    rows = coefficients(Calibration(gyro=gyro, accel=accel))
    rate, force = np.array(rate), np.array(force)
    gyro_raw, accel_raw, back_rate, back_force = (np.zeros(3) for _ in range(4))
    forward(rows, rate, force, gyro_degc, accel_degc, gyro_raw, accel_raw)
    flags = compensate(rows[0], gyro_raw, accel_raw, gyro_degc, accel_degc, back_rate, back_force)
    np.testing.assert_allclose(back_rate, rate, rtol=0.0, atol=35.0 * 1e-12)
    np.testing.assert_allclose(back_force, force, rtol=0.0, atol=160.0 * 1e-12)
    is_outside = any(
        triad.span_degc is not None and not -40.0 <= temperature <= 70.0
        for triad, temperature in ((gyro, gyro_degc), (accel, accel_degc))
    )
    assert flags == (Flag.TEMPERATURE_OUT_OF_RANGE if is_outside else 0)


def example():
    nodes = (-40.0, 25.0, 70.0)
    drift = np.array(((0.1, -0.2, 0.3), (0.0, 0.0, 0.0), (0.2, 0.1, -0.4)))
    triad = TriadCalibration(
        matrix=((1.02, 0.01, 0.0), (0.0, 0.98, 0.02), (-0.01, 0.0, 1.0)),
        bias=(0.3, -0.2, 0.1),
        a=Curve.linear(nodes, ((1e-3, 0.0, -1e-3), (0.0, 0.0, 0.0), (-1e-3, 2e-3, 1e-3))),
        b=Curve.linear(nodes, 0.1 * drift),
        c=Curve.linear(nodes, drift),
        matrix_drift=Curve.steps((-40.0, 0.0, 70.0), np.outer((0.01, 0.02), np.arange(9) - 4.0)),
    )
    gyro = replace(triad, g_sensitivity=((1e-3, 0.0, 2e-3), (0.0, -1e-3, 0.0), (0.0, 0.0, 1e-3)))
    return Calibration(gyro=gyro, accel=triad)


def test_the_output_satisfies_the_equation_of_the_paper():
    """N - (a N^2 + b N + c) = (K + dK) A + B + G f with coefficients taken from the curves."""
    known = example()
    rate, force = np.array([3.0, -2.0, -9.0]), np.array([1.0, 2.0, -9.5])
    temperature = 40.0
    outputs = forward_columns(coefficients(known), rate[None], force[None], np.array([temperature]))
    for triad, n, a in zip((known.gyro, known.accel), outputs, (rate, force), strict=True):
        left = n[0] - sum(
            curve.at(temperature) * n[0] ** power
            for power, curve in enumerate((triad.c, triad.b, triad.a))
        )
        matrix = np.array(triad.matrix) + triad.matrix_drift.at(temperature).reshape(3, 3)
        right = matrix @ a + triad.bias + np.array(triad.g_sensitivity) @ force
        np.testing.assert_allclose(left, right, rtol=1e-14)


def test_the_drift_is_continuous_over_a_node_and_holds_beyond_the_last():
    rows = coefficients(example())
    inputs = np.tile([3.0, -2.0, -9.0], (4, 1))
    output, _ = forward_columns(
        rows, inputs, inputs, np.array([25.0 - 1e-9, 25.0 + 1e-9, 70.0, 95.0])
    )
    np.testing.assert_allclose(output[0], output[1], atol=1e-9)
    np.testing.assert_array_equal(output[2], output[3])


def test_without_a_temperature_only_what_holds_at_room_temperature_acts():
    known = example()
    rows = coefficients(known)
    rate, force = np.array([3.0, -2.0, -9.0]), np.array([1.0, 2.0, -9.5])
    gyro_raw, accel_raw, back_rate, back_force = (np.zeros(3) for _ in range(4))
    forward(rows, rate, force, np.nan, np.nan, gyro_raw, accel_raw)
    matrix, g = np.array(known.gyro.matrix), np.array(known.gyro.g_sensitivity)
    np.testing.assert_allclose(accel_raw, matrix @ force + known.accel.bias, rtol=1e-15)
    np.testing.assert_allclose(gyro_raw, matrix @ rate + known.gyro.bias + g @ force, rtol=1e-14)
    assert compensate(rows[0], gyro_raw, accel_raw, np.nan, np.nan, back_rate, back_force) == 0
    np.testing.assert_allclose(back_rate, rate, rtol=1e-14)
    np.testing.assert_allclose(back_force, force, rtol=1e-14)


@pytest.mark.parametrize("missing", [np.nan, np.inf, -np.inf])
def test_a_missing_force_takes_no_rate_with_it(missing):
    rows = coefficients(example())
    rate, force = np.zeros(3), np.zeros(3)
    compensate(rows[0], np.ones(3), np.array([1.0, missing, 2.0]), 30.0, 30.0, rate, force)
    assert not np.isfinite(force).all()
    at_rest, free = np.zeros(3), example()
    free = coefficients(replace(free, gyro=replace(free.gyro, g_sensitivity=((0.0,) * 3,) * 3)))
    compensate(free[0], np.ones(3), np.ones(3), 30.0, 30.0, at_rest, force)
    np.testing.assert_array_equal(rate, at_rest)


def test_an_ideal_sensor_gives_its_input_bit_for_bit():
    rows = coefficients(Calibration.ideal())
    inputs = np.array([0.1, -0.7, 9.80665])
    gyro_raw, accel_raw, rate, force = (np.zeros(3) for _ in range(4))
    forward(rows, inputs, inputs, 55.0, 55.0, gyro_raw, accel_raw)
    assert compensate(rows[0], gyro_raw, accel_raw, 55.0, 55.0, rate, force) == 0
    np.testing.assert_array_equal(rate, inputs)
    np.testing.assert_array_equal(force, inputs)


def test_undecorated_code_gives_the_same_bytes():
    rows = coefficients(example())
    rng = np.random.default_rng(1)
    for t in (-70.0, -11.0, 25.0, 70.0, np.nan):
        rate, force = rng.normal(0.0, 9.0, 3), rng.normal(0.0, 9.0, 3)
        compiled, plain = np.zeros((4, 3)), np.zeros((4, 3))
        forward(rows, rate, force, t, t, compiled[0], compiled[1])
        flags = compensate(rows[0], compiled[0], compiled[1], t, t, compiled[2], compiled[3])
        forward.py_func(rows, rate, force, t, t, plain[0], plain[1])
        assert flags == compensate.py_func(rows[0], plain[0], plain[1], t, t, plain[2], plain[3])
        assert compiled.tobytes() == plain.tobytes()


def test_an_output_that_the_drift_cannot_reach_is_nan():
    steep = TriadCalibration(a=Curve.steps((0.0, 50.0), ((1.0, 0.0, 0.0),)))
    rows = coefficients(Calibration(gyro=steep))
    inputs = np.full((1, 3), 1.0)
    output, _ = forward_columns(rows, inputs, inputs, np.array([20.0]))
    assert np.isnan(output[0, 0])
    assert output[0, 1] == pytest.approx(1.0)
