"""A sensor's model and its inverse, each against numbers worked out by hand."""

import numpy as np
import pytest

from ahrs_service.pipeline import new_state
from ahrs_service.sensor.compensation import compensate_columns
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.forward import forward_columns
from ahrs_service.sensor.parameters import Calibration, TriadCalibration, coefficients
from ahrs_service.sensor.thermometer import acting_columns, read_thermometer

NODES = (0.0, 20.0, 40.0)
ZERO = np.zeros((1, 3))


def drifting():
    """At 30 degC, half way from 20 to 40: a = 0.01, b = 0.1, c = 0.5 of x; of y and z nothing."""
    return TriadCalibration(
        bias=(0.2, -0.1, 0.0),
        a=Curve.linear(NODES, ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.02, 0.0, 0.0))),
        b=Curve.linear(NODES, ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.2, 0.0, 0.0))),
        c=Curve.linear(NODES, ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))),
    )


@pytest.mark.parametrize("triad", ["gyro", "accel"])
def test_the_drift_of_an_output_of_2_at_30_degc(triad):
    """E = 0.01 * 4 + 0.1 * 2 + 0.5 = 0.74: of 2 there are left 2 - 0.74 - 0.2 = 1.06."""
    rows = coefficients(Calibration(**{triad: drifting()}))
    output = np.array([[2.0, 1.0, -1.0]])
    found = compensate_columns(rows, output, output, np.array([30.0]))[triad == "accel"]
    np.testing.assert_allclose(found, [[1.06, 1.1, -1.0]], rtol=1e-12)
    given = forward_columns(rows, found, found, np.array([30.0]))[triad == "accel"]
    np.testing.assert_allclose(given, output, rtol=1e-12)


def test_gyros_and_accelerometers_have_temperatures_of_their_own():
    """Of a step from 20 to 40 degC a lag of 10 s reads 1 - 1 / e after 10 s, 12.642 degC.

    c is 1 per 20 degC above 20: 0.63212 on the gyros, 1 on the accelerometers, that lag not.
    """
    rows = coefficients(
        Calibration(
            gyro=TriadCalibration(c=drifting().c, thermal_lag_s=10.0),
            accel=TriadCalibration(c=drifting().c),
        )
    )
    reported, time_s = np.array([20.0, 40.0]), np.array([0.0, 10.0])
    np.testing.assert_allclose(
        acting_columns(rows, reported, time_s)[1], [40.0 - 20.0 / np.e, 40.0], rtol=1e-12
    )
    zeros = np.zeros((2, 3))
    gyro, accel = compensate_columns(rows, zeros, zeros, reported, time_s)
    assert gyro[1, 0] == pytest.approx(-(1.0 - 1.0 / np.e))
    assert accel[1, 0] == pytest.approx(-1.0)


def test_a_thermometer_that_lags_is_led():
    """p = 12 / 3 = 4 s: 4 s after a step from 20 to 21 the memory has 1 - 1 / e of it.

    21 + 3 * (21 - 20.632) = 22.104 degC.
    """
    rows = coefficients(Calibration(accel=TriadCalibration(thermal_lag_s=-12.0)))
    found = acting_columns(rows, np.array([20.0, 21.0]), np.array([0.0, 4.0]))
    np.testing.assert_allclose(found[1], [21.0, 21.0 + 3.0 / np.e], rtol=1e-12)


def test_a_matrix_that_drifts_is_inverted_at_its_temperature():
    """K + dK at 30 degC: rows (1, 0.1, 0), (0, 1, -0.2), (0.3, 0, 1), of A = (1, 2, 3)."""
    drift = np.zeros((3, 9))
    drift[2] = 2.0 * np.array([0.0, 0.1, 0.0, 0.0, 0.0, -0.2, 0.3, 0.0, 0.0])
    rows = coefficients(Calibration(gyro=TriadCalibration(matrix_drift=Curve.linear(NODES, drift))))
    output = np.array([[1.0 + 0.2, 2.0 - 0.6, 3.0 + 0.3]])
    rate, _ = compensate_columns(rows, output, ZERO, np.array([30.0]))
    np.testing.assert_allclose(rate, [[1.0, 2.0, 3.0]], rtol=1e-12)
    given, _ = forward_columns(rows, rate, ZERO, np.array([30.0]))
    np.testing.assert_allclose(given, output, rtol=1e-12)


def test_what_gyros_feel_of_the_force_is_taken_off():
    """G f with f = (1, 2, -10): 0.01 * -10 in x, 0.02 * 1 in y, -0.03 * 2 in z."""
    g = ((0.0, 0.0, 0.01), (0.02, 0.0, 0.0), (0.0, -0.03, 0.0))
    rows = coefficients(Calibration(gyro=TriadCalibration(g_sensitivity=g)))
    force = np.array([[1.0, 2.0, -10.0]])
    rate, same = compensate_columns(rows, ZERO, force, np.array([25.0]))
    np.testing.assert_allclose(rate, [[0.1, -0.02, 0.06]], rtol=1e-12)
    np.testing.assert_array_equal(same, force)
    given, _ = forward_columns(rows, ZERO, force, np.array([25.0]))
    np.testing.assert_allclose(given, [[-0.1, 0.02, -0.06]], rtol=1e-12)


def test_a_matrix_has_outputs_in_rows():
    """Output y has 0.02 of input x: for (1, 0, 0) it reads 0.02."""
    matrix = ((1.0, 0.0, 0.0), (0.02, 1.0, 0.0), (0.0, 0.0, 0.5))
    rows = coefficients(Calibration(accel=TriadCalibration(matrix=matrix)))
    output = np.array([[1.0, 0.02, 2.0]])
    _, force = compensate_columns(rows, ZERO, output, np.array([25.0]))
    np.testing.assert_allclose(force, [[1.0, 0.0, 4.0]], rtol=1e-12, atol=1e-15)
    _, given = forward_columns(rows, ZERO, force, np.array([25.0]))
    np.testing.assert_allclose(given, output, rtol=1e-12)


def test_the_same_polynomial_from_a_border_further_on():
    """1 + 2 x + 3 x^2 + 4 x^3 from 10 degC on: at 12 degC 1 + 4 + 12 + 32, slope 2 + 12 + 48."""
    curve = Curve((10.0, 20.0), (((1.0, 2.0, 3.0, 4.0),),)).on((10.0, 12.0, 20.0))
    np.testing.assert_allclose(curve.table()[1, 0], [49.0, 62.0, 27.0, 4.0])
    np.testing.assert_allclose(curve.at([11.0, 13.0])[:, 0], [10.0, 142.0])
    line = Curve.linear((0.0, 10.0), ((1.0,), (3.0,)))
    np.testing.assert_allclose(line.at([0.0, 5.0, 10.0])[:, 0], [1.0, 2.0, 3.0])


def test_live_each_triad_remembers_a_temperature_of_its_own():
    """10 s after a step from 20 to 40 degC: lags of 10 and 20 s read 1 - 1 / e and 1 - e^-0.5."""
    rows = coefficients(
        Calibration(
            gyro=TriadCalibration(thermal_lag_s=10.0), accel=TriadCalibration(thermal_lag_s=20.0)
        )
    )
    state = new_state()
    assert read_thermometer(rows[0], state[0], 10**9, 20.0) == (20.0, 20.0)
    found = read_thermometer(rows[0], state[0], 11 * 10**9, 40.0)
    assert found == pytest.approx((40.0 - 20.0 / np.e, 40.0 - 20.0 / np.sqrt(np.e)))
