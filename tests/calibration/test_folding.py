"""Folded effects are removed by the estimator's own compensation, and nothing is added."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ahrs_service.calibration.folding import fold
from ahrs_service.effects.base import Effect, apply
from ahrs_service.effects.catalogue import EFFECTS, effect_of
from ahrs_service.effects.thermal_lag import lagged
from ahrs_service.sensor.compensation import compensate_columns
from ahrs_service.sensor.forward import forward_columns
from ahrs_service.sensor.parameters import Calibration, coefficients
from ahrs_service.simulation.effect_inputs import columns_of
from ahrs_service.simulation.imu import consumer_grade
from ahrs_service.simulation.scenario import make_flight

RATE_HZ = 50.0
EXACT = [
    "gyro_scale_factor",
    "accel_scale_factor",
    "gyro_misalignment",
    "accel_misalignment",
    "imu_mounting_rotation",
    "gyro_thermal_bias",
    "accel_thermal_bias",
    "gyro_thermal_scale",
    "accel_thermal_scale",
    "gyro_g_sensitivity",
]


@pytest.fixture(scope="module")
def motion():
    """A flight with tight turns and a temperature that rises from 5 to 65 degC."""
    truth = make_flight("flight", 40.0, 3, RATE_HZ).rows
    return truth, 5.0 + 60.0 * truth["time_s"] / 40.0


def drawn(effect, shares):
    """Parameters of an effect, up to their plausible size, from shares of -1 to 1."""
    dice = iter(shares)
    values = {}
    for p in effect.parameters:
        if p.step:
            size = [next(dice) * p.plausible for _ in range(math.prod(p.shape))]
            values[p.name] = np.reshape(size, p.shape)
        elif p.grid:
            values[p.name] = p.grid[len(p.grid) // 2]
        else:
            values[p.name] = p.default
    return effect.checked(values)


def reading(motion, base, effects):
    truth, temperature = motion
    still = np.zeros(len(truth))
    columns = columns_of(truth, temperature, RATE_HZ, still, still)
    rate, force = apply(columns, effects)
    return forward_columns(coefficients(base), rate, force, temperature, truth["time_s"])


def left_after(motion, base, effects):
    """Largest error of rate and force [rad/s, m/s^2] that the folded calibration leaves."""
    truth, temperature = motion
    gyro, accel = reading(motion, base, effects)
    folded = fold(base, effects).calibration
    rate, force = compensate_columns(
        coefficients(folded), gyro, accel, temperature, truth["time_s"]
    )
    errors = rate - truth["rate_rad_s"], force - truth["force_m_s2"]
    return [float(np.abs(error).max()) for error in errors]


BASES = {"ideal": Calibration.ideal(), "a sensor with drift": consumer_grade().calibration}


@pytest.mark.parametrize("base", BASES)
@settings(max_examples=8, deadline=None)
@given(
    names=st.lists(st.sampled_from(EXACT), min_size=1, max_size=5, unique=True),
    shares=st.lists(st.floats(-1.0, 1.0), min_size=60, max_size=60),
)
def test_any_of_the_linear_and_thermal_effects_are_undone_exactly(motion, base, names, shares):
    parts = np.array_split(shares, len(names))
    effects = [(effect_of(n), drawn(effect_of(n), p)) for n, p in zip(names, parts, strict=True)]
    folded = fold(BASES[base], effects)
    assert set(folded.taken) == set(names)
    assert folded.left == ()
    # The consumer sensor's slope b in N makes its forward a root: rounding, not more.
    assert max(left_after(motion, BASES[base], effects)) < 1e-10


def test_a_lag_of_the_temperature_is_the_calibrations_own(motion):
    effect = effect_of("gyro_thermal_lag")
    values = effect.checked({"time_constant_s": 12.0, "linear": [1e-3, -2e-3, 5e-4]})
    truth, temperature = motion
    folded = fold(Calibration.ideal(), [(effect, values)])
    assert folded.calibration.gyro.thermal_lag_s == 12.0
    rate_error, force_error = left_after(motion, Calibration.ideal(), [(effect, values)])
    # Both lags are first order, one holds the temperature within a step, the other draws a line.
    step_degc = np.ptp(temperature) / len(temperature)
    assert rate_error < 2e-3 * step_degc
    assert force_error == 0.0
    acting = lagged(truth["time_s"], temperature, 12.0)
    assert np.abs(acting - temperature).max() > 10.0


def test_a_triad_has_one_lag(motion):
    lag = effect_of("accel_thermal_lag")
    bias = effect_of("accel_thermal_bias")
    both = [(lag, drawn(lag, [0.1] * 9)), (bias, drawn(bias, [0.1] * 9))]
    folded = fold(Calibration.ideal(), both)
    assert folded.taken == ("accel_thermal_bias",)
    assert "one lag" in dict(folded.left)["accel_thermal_lag"]


def test_the_accelerometers_nonlinearity_is_undone_to_first_order(motion):
    effect = effect_of("accel_scale_nonlinearity")
    errors = []
    for k in (4e-4, 2e-4):
        values = effect.checked({"k": [k, -k, k]})
        errors.append(left_after(motion, Calibration.ideal(), [(effect, values)])[1])
    largest = np.abs(motion[0]["force_m_s2"]).max()
    assert errors[0] < 2.5 * 4e-4**2 * largest**3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def test_each_effect_is_either_folded_or_says_why_not(motion):
    foldable = {*EXACT, "gyro_thermal_lag", "accel_thermal_lag", "accel_scale_nonlinearity"}
    for identifier, effect in EFFECTS.items():
        folded = fold(Calibration.ideal(), [(effect, effect.neutral())])
        assert (identifier in folded.taken) == (identifier in foldable), identifier
        assert (effect.why_not_live is None) == (identifier in foldable)
        if identifier not in foldable:
            ((name, why),) = folded.left
            assert name == identifier
            assert why == effect.why_not_live
            assert len(why) > 20
            assert why != Effect.not_live


def test_effects_at_zero_leave_the_compensation_as_it_was(motion):
    effects = [(effect_of(n), effect_of(n).neutral()) for n in EXACT]
    base = consumer_grade().calibration
    folded = fold(base, effects).calibration
    truth, temperature = motion
    gyro, accel = reading(motion, base, [])
    for calibration in (base, folded):
        rate, _ = compensate_columns(
            coefficients(calibration), gyro, accel, temperature, truth["time_s"]
        )
        assert np.abs(rate - truth["rate_rad_s"]).max() < 1e-12
