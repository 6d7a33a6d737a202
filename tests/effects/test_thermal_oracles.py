"""Effects of temperature, each against numbers worked out by hand."""

import numpy as np
import pytest

from tests.effect_columns import columns, on_own_triad

TRIADS = pytest.mark.parametrize("triad", ["gyro", "accel"])
ONE_OVER_E = 0.36787944117144233


@TRIADS
@pytest.mark.parametrize(
    ("degc", "expected"),
    [
        # 10 degC above: 0.001 * 10 + 0.0002 * 100 = 0.03; -0.002 * 10 + 0.0001 * 100 = -0.01.
        (35.0, [0.03, -0.01, 0.0]),
        # 10 degC below: -0.01 + 0.02 = 0.01; 0.02 + 0.01 = 0.03. The square does not change sign.
        (15.0, [0.01, 0.03, 0.0]),
        (25.0, [0.0, 0.0, 0.0]),
    ],
)
def test_thermal_bias_is_a_parabola_about_25_degc(triad, degc, expected):
    found = on_own_triad(
        f"{triad}_thermal_bias",
        columns(temperature_degc=degc),
        linear=[0.001, -0.002, 0.0],
        quadratic=[0.0002, 0.0001, 0.0],
    )
    np.testing.assert_allclose(found, [expected], atol=1e-15)


@TRIADS
def test_thermal_bias_is_zero_at_its_own_reference(triad):
    """At 30 degC, 10 above a reference of 20: 0.001 * 10; 5 above the usual 25 would be half."""
    found = on_own_triad(
        f"{triad}_thermal_bias",
        columns(temperature_degc=30.0),
        linear=[0.001, 0.0, 0.0],
        reference_degC=20.0,
    )
    np.testing.assert_allclose(found, [[0.01, 0.0, 0.0]], atol=1e-15)


@TRIADS
@pytest.mark.parametrize(("degc", "sign"), [(45.0, 1.0), (5.0, -1.0)])
def test_thermal_scale_multiplies_the_reading_of_its_own_triad(triad, degc, sign):
    """20 degC above 25 at 0.001 and -0.0005 per degC: +2 % of 3, -1 % of -2; below the reverse."""
    mine, others = [3.0, -2.0, 5.0], [70.0, 80.0, 90.0]
    rate, force = (mine, others) if triad == "gyro" else (others, mine)
    found = on_own_triad(
        f"{triad}_thermal_scale",
        columns(temperature_degc=degc, rate_rad_s=rate, force_m_s2=force),
        per_degC=[0.001, -0.0005, 0.0],
    )
    np.testing.assert_allclose(found, [[sign * 0.06, sign * 0.02, 0.0]], atol=1e-15)


@TRIADS
def test_thermal_rate_follows_the_slope_with_its_sign(triad):
    """0.4 per degC/s at 0.05 degC/s gives 0.02; cooling at 0.1 degC/s gives -0.04."""
    found = on_own_triad(
        f"{triad}_thermal_rate",
        columns(2, temperature_slope_degc_s=[0.05, -0.1]),
        per_degC_per_s=[0.4, -0.2, 0.0],
    )
    np.testing.assert_allclose(found, [[0.02, -0.01, 0.0], [-0.04, 0.02, 0.0]], atol=1e-15)


@TRIADS
@pytest.mark.parametrize("slope", [0.1, -0.1])
def test_thermal_lag_stays_behind_a_ramp(triad, slope):
    """T = 25 + r t: Td - 25 = r (t - tau (1 - exp(-t / tau))), at t = tau r tau / e.

    With r = 0.1 degC/s and tau = 10 s that is 0.3679 degC where the sensor reads 1 degC.
    """
    time_s = np.arange(0.0, 20.5, 0.5)
    found = on_own_triad(
        f"{triad}_thermal_lag",
        columns(len(time_s), time_s=time_s, temperature_degc=25.0 + slope * time_s),
        linear=[0.01, -0.02, 0.0],
        time_constant_s=10.0,
    )
    at_tau = slope * 10.0 * ONE_OVER_E
    expected = [0.01 * at_tau, -0.02 * at_tau, 0.0]
    np.testing.assert_allclose(found[20], expected, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(found[0], 0.0, atol=1e-15)


def test_thermal_lag_begins_in_equilibrium_and_counts_from_its_reference():
    """Held at 35 degC from the start it is fully in effect: 0.01 * (35 - 20) = 0.15."""
    found = on_own_triad(
        "gyro_thermal_lag",
        columns(5, temperature_degc=35.0),
        linear=[0.01, 0.0, 0.0],
        time_constant_s=10.0,
        reference_degC=20.0,
    )
    np.testing.assert_allclose(found[:, 0], 0.15, rtol=1e-12)


@TRIADS
def test_thermal_hysteresis_crosses_over_within_its_width(triad):
    """dh = 2 dT / 4: half a unit per degC.

    From the start, h = 0: 1 degC up 0.5, 2 up 1, and no more. Then 1 down 0.5, 2 down 0, 4 down -1.
    """
    degc = [20.0, 21.0, 22.0, 30.0, 29.0, 28.0, 26.0, 20.0, 21.0]
    h = np.array([0.0, 0.5, 1.0, 1.0, 0.5, 0.0, -1.0, -1.0, -0.5])
    found = on_own_triad(
        f"{triad}_thermal_hysteresis",
        columns(9, temperature_degc=degc),
        half_amplitude=[0.02, -0.01, 0.0],
        width_degC=4.0,
    )
    expected = np.stack([0.02 * h, -0.01 * h, 0.0 * h], axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-15)


@TRIADS
def test_warm_up_counts_from_power_on(triad):
    """A recording that begins at 500 s on its clock, 30 s after power-on, with tau = 30 s: a / e.

    30 s later a / e^2; counted from the recording's start it would be a.
    """
    found = on_own_triad(
        f"{triad}_warm_up",
        columns(2, time_s=[500.0, 530.0], since_power_on_s=[30.0, 60.0]),
        amplitude=[0.1, -0.2, 0.0],
        time_constant_s=30.0,
    )
    expected = [[0.1 * ONE_OVER_E, -0.2 * ONE_OVER_E, 0.0]] * np.array([[1.0], [ONE_OVER_E]])
    np.testing.assert_allclose(found, expected, rtol=1e-12)
