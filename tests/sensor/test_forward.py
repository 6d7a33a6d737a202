import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ahrs_service.records import Flag
from ahrs_service.sensor.compensation import compensate
from ahrs_service.sensor.forward import forward, forward_columns
from ahrs_service.sensor.parameters import Calibration, TriadCalibration, coefficients


def floats(low, high):
    return st.floats(low, high, allow_nan=False)


@st.composite
def triads(draw, largest):
    """A triad whose drift stays a small part of the output over its range `largest`."""
    matrix = np.eye(3) + np.array(
        draw(st.lists(floats(-0.1, 0.1), min_size=9, max_size=9))
    ).reshape(3, 3)
    count = draw(st.sampled_from([0, 2, 3, 23, 32]))
    rows = st.lists(st.tuples(*[floats(-1.0, 1.0)] * 3), min_size=count, max_size=count)
    return TriadCalibration(
        matrix=tuple(map(tuple, matrix.tolist())),
        bias=draw(st.tuples(*[floats(-0.1 * largest, 0.1 * largest)] * 3)),
        temperature_degc=tuple(np.linspace(-40.0, 70.0, count).tolist()),
        a=tuple(map(tuple, (np.reshape(draw(rows), (-1, 3)) * 0.1 / largest).tolist())),
        b=tuple(map(tuple, (np.reshape(draw(rows), (-1, 3)) * 0.1).tolist())),
        c=tuple(map(tuple, (np.reshape(draw(rows), (-1, 3)) * 0.1 * largest).tolist())),
    )


@settings(max_examples=200, deadline=None)
@given(
    triads(35.0),
    triads(160.0),
    st.tuples(*[floats(-35.0, 35.0)] * 3),
    st.tuples(*[floats(-160.0, 160.0)] * 3),
    floats(-60.0, 90.0),
)
def test_compensation_undoes_the_forward_model(gyro, accel, rate, force, temperature):
    rows = coefficients(Calibration(gyro=gyro, accel=accel))
    rate, force = np.array(rate), np.array(force)
    gyro_raw, accel_raw, back_rate, back_force = (np.zeros(3) for _ in range(4))
    forward(rows, rate, force, temperature, gyro_raw, accel_raw)
    flags = compensate(rows, gyro_raw, accel_raw, temperature, back_rate, back_force)
    np.testing.assert_allclose(back_rate, rate, rtol=0.0, atol=35.0 * 1e-12)
    np.testing.assert_allclose(back_force, force, rtol=0.0, atol=160.0 * 1e-12)
    has_nodes = bool(gyro.temperature_degc or accel.temperature_degc)
    is_outside = has_nodes and not -40.0 <= temperature <= 70.0
    assert flags == (Flag.TEMPERATURE_OUT_OF_RANGE if is_outside else 0)


def example():
    node = ((1e-3, 0.0, -1e-3), (0.0, 0.0, 0.0), (-1e-3, 2e-3, 1e-3))
    drift = ((0.1, -0.2, 0.3), (0.0, 0.0, 0.0), (0.2, 0.1, -0.4))
    triad = TriadCalibration(
        matrix=((1.02, 0.01, 0.0), (0.0, 0.98, 0.02), (-0.01, 0.0, 1.0)),
        bias=(0.3, -0.2, 0.1),
        temperature_degc=(-40.0, 25.0, 70.0),
        a=node,
        b=tuple(tuple(0.1 * x for x in row) for row in drift),
        c=drift,
    )
    return coefficients(Calibration(gyro=triad, accel=triad))


def test_the_output_satisfies_the_equation_of_the_paper():
    """N - (a N^2 + b N + c) = K A + B with hand-interpolated coefficients, a third of the way."""
    rows = example()
    temperature = 40.0
    inputs = np.array([3.0, -2.0, -9.0])
    output, _ = forward_columns(rows, inputs[None], inputs[None], np.array([temperature]))
    share = (40.0 - 25.0) / 45.0
    drift = share * rows["gyro"]["drift"][0, :, 2]
    n = output[0]
    left = n - (drift[2] * n**2 + drift[1] * n + drift[0])
    right = rows["gyro"]["matrix"][0] @ inputs + rows["gyro"]["bias"][0]
    np.testing.assert_allclose(left, right, rtol=1e-14)


def test_the_drift_is_continuous_over_a_node_and_holds_beyond_the_last():
    rows = example()
    inputs = np.tile([3.0, -2.0, -9.0], (4, 1))
    output, _ = forward_columns(
        rows, inputs, inputs, np.array([25.0 - 1e-9, 25.0 + 1e-9, 70.0, 95.0])
    )
    np.testing.assert_allclose(output[0], output[1], atol=1e-9)
    np.testing.assert_array_equal(output[2], output[3])


def test_without_a_temperature_only_matrix_and_bias_act():
    rows = example()
    inputs = np.array([3.0, -2.0, -9.0])
    output, back, unused = np.zeros(3), np.zeros(3), np.zeros(3)
    forward(rows, inputs, inputs, np.nan, output, unused)
    np.testing.assert_allclose(
        output, rows["gyro"]["matrix"][0] @ inputs + rows["gyro"]["bias"][0], rtol=1e-15
    )
    assert compensate(rows, output, output, np.nan, back, unused) == 0
    np.testing.assert_allclose(back, inputs, rtol=1e-14)


def test_an_ideal_sensor_gives_its_input_bit_for_bit():
    rows = coefficients(Calibration.ideal())
    inputs = np.array([0.1, -0.7, 9.80665])
    output, back, unused = np.zeros(3), np.zeros(3), np.zeros(3)
    forward(rows, inputs, inputs, 55.0, output, unused)
    assert compensate(rows, output, output, 55.0, back, unused) == 0
    np.testing.assert_array_equal(back, inputs)


def test_undecorated_code_gives_the_same_bytes():
    rows = example()
    rng = np.random.default_rng(1)
    for temperature in (-70.0, -11.0, 25.0, 70.0, np.nan):
        rate, force = rng.normal(0.0, 9.0, 3), rng.normal(0.0, 9.0, 3)
        compiled, plain = np.zeros((4, 3)), np.zeros((4, 3))
        forward(rows, rate, force, temperature, compiled[0], compiled[1])
        flags = compensate(rows, compiled[0], compiled[1], temperature, compiled[2], compiled[3])
        forward.py_func(rows, rate, force, temperature, plain[0], plain[1])
        assert flags == compensate.py_func(
            rows, plain[0], plain[1], temperature, plain[2], plain[3]
        )
        assert compiled.tobytes() == plain.tobytes()


def test_an_output_that_the_drift_cannot_reach_is_nan():
    zero = ((0.0, 0.0, 0.0),) * 2
    steep = TriadCalibration(temperature_degc=(0.0, 50.0), a=((1.0, 0.0, 0.0),) * 2, b=zero, c=zero)
    rows = coefficients(Calibration(gyro=steep))
    inputs = np.full((1, 3), 1.0)
    output, _ = forward_columns(rows, inputs, inputs, np.array([20.0]))
    assert np.isnan(output[0, 0])
    assert output[0, 1] == pytest.approx(1.0)
