"""Every effect of the catalogue: zero at its neutral parameters, else equal to its equation."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ahrs_service.effects.base import Columns, apply
from ahrs_service.effects.catalogue import EFFECTS, effect_of, often_taken_for
from ahrs_service.effects.undo import added_to, ideal_motion
from ahrs_service.rotation import quaternion_columns

LOST = ("time_offset", "clock_drift", "low_pass", "saturation")
"""Effects that are invertible only for smooth motion, or not at all."""

INVERTIBLE = [effect for effect in EFFECTS.values() if effect.name not in LOST]


def columns_of(seed=1, count=200, step_s=0.02):
    rng = np.random.default_rng(seed)
    time_s = 5.0 + step_s * np.arange(count)
    rate = rng.normal(0.0, 1.0, (count, 3))
    rate[0] = -0.0
    return Columns(
        time_s=time_s,
        since_power_on_s=time_s,
        rate_rad_s=rate,
        force_m_s2=rng.normal(0.0, 5.0, (count, 3)),
        angular_acceleration_rad_s2=rng.normal(0.0, 2.0, (count, 3)),
        temperature_degc=30.0 + 10.0 * np.sin(time_s),
        temperature_slope_degc_s=10.0 * np.cos(time_s),
        vibration_m_s2=np.abs(rng.normal(0.5, 0.1, count)),
        current_a=rng.uniform(1.0, 10.0, count),
        throttle=rng.uniform(0.0, 1.0, count),
        airspeed_m_s=rng.uniform(0.0, 20.0, count),
        ned_from_body=quaternion_columns(rng.uniform(-1.0, 1.0, (count, 3))),
    )


@pytest.mark.parametrize("name", EFFECTS)
@given(seed=st.integers(0, 2**16))
@settings(max_examples=5, deadline=None)
def test_a_neutral_effect_leaves_the_reading_bit_for_bit(name, seed):
    columns = columns_of(seed)
    effect = effect_of(name)
    gyro, accel = apply(columns, [(effect, effect.neutral())])
    assert gyro.tobytes() == columns.rate_rad_s.tobytes()
    assert accel.tobytes() == columns.force_m_s2.tobytes()


@pytest.mark.parametrize("effect", INVERTIBLE, ids=lambda effect: effect.id)
@given(seed=st.integers(0, 2**16))
@settings(max_examples=5, deadline=None)
def test_what_an_effect_adds_is_taken_away_again(effect, seed):
    columns = columns_of(seed)
    rng = np.random.default_rng(seed)
    values = effect.neutral()
    for p in effect.parameters:
        if p.step:
            values[p.name] = rng.uniform(-0.2, 0.2, p.shape) * p.plausible
        elif p.grid:
            values[p.name] = np.asarray(rng.choice(p.grid))
    gyro, accel = apply(columns, [(effect, values)])
    measured = replace(columns, rate_rad_s=gyro, force_m_s2=accel)
    gyro_added, accel_added = added_to(measured, [(effect, values)], 12)
    rate, force = gyro - gyro_added, accel - accel_added
    np.testing.assert_allclose(rate, columns.rate_rad_s, atol=1e-9)
    np.testing.assert_allclose(force, columns.force_m_s2, atol=1e-9)


def test_late_and_filtered_readings_give_back_the_motion():
    """A wave of 0.5 Hz, 13 ms late behind a filter of 10 Hz: within the spline's and its edges."""
    columns = smooth_columns(50.0)
    offset, filtered = effect_of("imu_time_offset"), effect_of("gyro_low_pass")
    late = [(offset, {"offset_s": np.asarray(0.013)})]
    slow = [(filtered, {"cutoff_hz": np.asarray(10.0), "order": np.asarray(1.0)})]
    gyro, accel = apply(columns, slow)
    gyro, accel = apply(replace(columns, rate_rad_s=gyro, force_m_s2=accel), late)
    reading = replace(columns, rate_rad_s=gyro, force_m_s2=accel)
    assert np.abs(gyro - columns.rate_rad_s)[50:-50].max() > 0.05
    found = ideal_motion(reading, late + slow, 12)
    middle = slice(50, -50)
    np.testing.assert_allclose(found.rate_rad_s[middle], columns.rate_rad_s[middle], atol=2e-4)
    np.testing.assert_allclose(found.force_m_s2[middle], columns.force_m_s2[middle], atol=2e-4)
    np.testing.assert_array_equal(found.time_s, columns.time_s)


def test_a_lever_arm_uses_the_rate_after_a_scale_error_is_removed():
    """d(1.1 w)/dt is read where the arm felt dw/dt: 0.1 m of 2 rad/s^2 about z are 0.2 m/s^2."""
    base = columns_of()
    spin = np.outer(base.time_s - base.time_s[0], [0.0, 0.0, 2.0])
    still = np.zeros_like(spin)
    ideal = replace(
        base,
        rate_rad_s=spin,
        force_m_s2=still,
        angular_acceleration_rad_s2=np.tile([0.0, 0.0, 2.0], (len(spin), 1)),
    )
    scale, arm = effect_of("gyro_scale_factor"), effect_of("accel_lever_arm")
    effects = [
        (scale, {"scale_error": np.array([0.0, 0.0, 0.1])}),
        (arm, {"arm_m": np.array([0.1, 0.0, 0.0])}),
    ]
    gyro, accel = apply(ideal, effects)
    np.testing.assert_allclose(accel[:, 1], 0.2, atol=1e-12)
    read = replace(
        ideal,
        rate_rad_s=gyro,
        force_m_s2=accel,
        angular_acceleration_rad_s2=np.tile([0.0, 0.0, 2.2], (len(spin), 1)),
    )
    _, felt = added_to(read, effects, 14)
    np.testing.assert_allclose(felt, accel, atol=1e-9)


@pytest.mark.parametrize("name", EFFECTS)
def test_confusable_effects_are_on_the_same_sensor(name):
    effect = effect_of(name)
    others = [effect_of(one) for one in often_taken_for(effect)]
    assert others
    assert effect not in others
    for one in effect.taken_for:
        assert one in EFFECTS or f"{effect.triad}_{one}" in EFFECTS, one
    assert all("imu" in (effect.triad, one.triad) or one.triad == effect.triad for one in others)


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_touches_its_own_triad(name):
    effect, columns = effect_of(name), columns_of()
    addition = effect.add(columns, effect.neutral())
    assert (addition.gyro is not None) == (effect.triad in ("gyro", "imu"))
    assert (addition.accel is not None) == (effect.triad in ("accel", "imu"))


def smooth_columns(rate_hz, frequency_hz=0.5):
    count = int(20.0 * rate_hz)
    base = columns_of(count=count, step_s=1.0 / rate_hz)
    wave = np.sin(2.0 * np.pi * frequency_hz * base.time_s)
    zeros = np.zeros((count, 3))
    return replace(base, rate_rad_s=zeros + wave[:, None], force_m_s2=zeros + wave[:, None])


def test_a_low_pass_has_the_gain_and_phase_of_the_analog_one():
    columns = smooth_columns(50.0, frequency_hz=1.0)
    effect = effect_of("gyro_low_pass")
    values = {"cutoff_hz": np.asarray(10.0), "order": np.asarray(1.0)}
    filtered = (columns.rate_rad_s + effect.add(columns, values).gyro)[300:, 0]
    phase = math.atan(0.1)
    expected = math.cos(phase) * np.sin(2.0 * np.pi * columns.time_s[300:] - phase)
    np.testing.assert_allclose(filtered, expected, atol=3e-3)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("uneven_s", [0.0, 2e-3])
def test_a_low_pass_of_a_ramp_lags_as_the_analog_one(order, uneven_s):
    """A ramp of unit slope is delayed by the delay of the filter."""
    rng = np.random.default_rng(9)
    time_s = np.arange(100) * 0.02 + uneven_s * rng.uniform(size=100)
    base = columns_of(count=100, step_s=0.02)
    ramp = np.tile(np.maximum(time_s - time_s[10], 0.0)[:, None], 3)
    columns = replace(base, time_s=time_s, rate_rad_s=ramp, force_m_s2=ramp)
    values = {"cutoff_hz": np.asarray(4.0), "order": np.asarray(float(order))}
    late = -effect_of("gyro_low_pass").add(columns, values).gyro[-1, 1]
    delay_s = (1.0 if order == 1 else math.sqrt(2.0)) / (2.0 * math.pi * 4.0)
    assert late == pytest.approx(delay_s, rel=1e-9 if uneven_s == 0.0 else 1e-6)


def test_an_offset_shows_the_past():
    columns = smooth_columns(50.0)
    added = effect_of("imu_time_offset").add(columns, {"offset_s": np.asarray(0.013)})
    expected = np.sin(np.pi * (columns.time_s - 0.013))
    np.testing.assert_allclose((columns.rate_rad_s + added.gyro)[5:, 1], expected[5:], atol=1e-5)


def test_a_drifting_clock_ends_late_by_its_rate():
    columns = smooth_columns(50.0)
    added = effect_of("imu_clock_drift").add(columns, {"ppm": np.asarray(1000.0)})
    late_s = 1e-3 * (columns.time_s - columns.time_s[0])
    expected = np.sin(np.pi * (columns.time_s - late_s))
    np.testing.assert_allclose((columns.force_m_s2 + added.accel)[5:, 2], expected[5:], atol=1e-5)


def test_a_lag_answers_a_step_by_an_exponential():
    from ahrs_service.effects.thermal_lag import lagged

    time_s = np.arange(0.0, 300.0, 0.1)
    step = np.where(time_s > 0.0, 1.0, 0.0)
    np.testing.assert_allclose(lagged(time_s, step, 60.0), 1.0 - np.exp(-time_s / 60.0), atol=1e-3)


def test_a_branch_turns_over_within_its_width():
    from ahrs_service.effects.thermal_hysteresis import branch

    heat = np.concatenate([np.linspace(20.0, 60.0, 401), np.linspace(60.0, 20.0, 401)])
    h = branch(heat, 4.0)
    assert h[400] == 1.0
    assert h[401 + 20] == pytest.approx(0.0, abs=0.06)
    assert h[-1] == -1.0


def test_hysteresis_is_searched_only_as_wide_as_the_temperature_reverses():
    effect, columns = effect_of("accel_thermal_hysteresis"), columns_of()
    rises = replace(columns, temperature_degc=np.linspace(20.0, 40.0, 200))
    assert effect.grid(rises) == []
    turns = np.concatenate([np.linspace(20.0, 40.0, 150), np.linspace(40.0, 37.0, 50)])
    found = effect.grid(replace(columns, temperature_degc=turns))
    assert [form["width_degC"] for form in found] == [0.5, 1.0, 2.0]


def test_the_earth_turns_by_15_deg_an_hour_about_its_axis():
    columns = columns_of()
    added = effect_of("gyro_earth_rate").add(columns, {"latitude_deg": np.asarray(48.0)}).gyro
    np.testing.assert_allclose(
        np.degrees(np.linalg.norm(added, axis=1)) * 3600.0, 15.041, atol=1e-3
    )


def test_five_centimetres_at_200_deg_s_are_0_61_m_s2():
    """../shared/mismatch/README.md, magnitudes."""
    columns = columns_of()
    zeros = np.zeros_like(columns.rate_rad_s)
    spin = zeros + np.array([0.0, 0.0, np.radians(200.0)])
    columns = replace(columns, rate_rad_s=spin, angular_acceleration_rad_s2=zeros)
    added = effect_of("accel_lever_arm").add(columns, {"arm_m": np.array([0.05, 0.0, 0.0])}).accel
    np.testing.assert_allclose(added[:, 0], -0.61, atol=5e-3)


def test_unknown_names_are_refused():
    with pytest.raises(ValueError, match="gyro_scale_factor"):
        effect_of("gyro_scale")
    with pytest.raises(ValueError, match="no parameter slope"):
        effect_of("gyro_thermal_bias").checked({"slope": [0.0, 0.0, 0.0]})
    with pytest.raises(ValueError, match=r"give \(3,\)"):
        effect_of("gyro_thermal_bias").checked({"linear": 0.1})
