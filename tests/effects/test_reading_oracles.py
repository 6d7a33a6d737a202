"""Effects on the sensor's readings and stamps, each against numbers worked out by hand."""

import math

import numpy as np
import pytest

from ahrs_service.effects.base import apply
from ahrs_service.effects.catalogue import effect_of
from ahrs_service.effects.undo import ideal_motion
from tests.effect_columns import added, columns, on_own_triad

TRIADS = pytest.mark.parametrize("triad", ["gyro", "accel"])


def readings(triad, mine, others=(77.0, 88.0, 99.0), count=1, **given):
    rate, force = (mine, others) if triad == "gyro" else (others, mine)
    return columns(count, rate_rad_s=rate, force_m_s2=force, **given)


@TRIADS
def test_a_scale_error_of_1_percent_shows_1_percent_more(triad):
    found = on_own_triad(
        f"{triad}_scale_factor", readings(triad, (3.0, -2.0, 5.0)), scale_error=[0.01, 0.02, -0.03]
    )
    np.testing.assert_allclose(found, [[0.03, -0.04, -0.15]], atol=1e-15)


def test_a_gyros_nonlinearity_is_odd():
    """k w |w|: 0.01 * 4 to the right, -0.01 * 4 to the left, -0.02 * 9."""
    found = on_own_triad(
        "gyro_scale_nonlinearity", readings("gyro", (2.0, -2.0, -3.0)), k=[0.01, 0.01, 0.02]
    )
    np.testing.assert_allclose(found, [[0.04, -0.04, -0.18]], atol=1e-15)


def test_an_accelerometers_nonlinearity_is_even():
    """k f^2: the same up and down, which rectifies vibration into bias."""
    found = on_own_triad(
        "accel_scale_nonlinearity", readings("accel", (10.0, -10.0, -5.0)), k=[0.001, 0.001, 0.002]
    )
    np.testing.assert_allclose(found, [[0.1, 0.1, 0.05]], atol=1e-15)


@TRIADS
def test_saturation_cuts_at_both_ends_of_the_range(triad):
    found = on_own_triad(f"{triad}_saturation", readings(triad, (5.0, -6.0, 3.0)), limit=4.0)
    np.testing.assert_allclose(found, [[-1.0, 2.0, 0.0]], atol=1e-15)


@TRIADS
def test_at_the_limit_scatter_cuts_0_4_of_its_sigma(triad):
    """Half of a normal variable lies beyond: its mean there is sigma / sqrt(2 pi) = 0.39894 sigma.

    Each triad has its own sigmas. At 0, between two equal limits, nothing is clipped on average.
    """
    mine, others = [0.1, 0.2, 0.3], [10.0, 20.0, 30.0]
    scatter = mine + others if triad == "gyro" else others + mine
    acting = readings(triad, (4.0, -4.0, 0.0), scatter=scatter)
    found = on_own_triad(f"{triad}_saturation", acting, limit=4.0)
    np.testing.assert_allclose(found, [[-0.039894228, 0.079788456, 0.0]], rtol=1e-8, atol=1e-15)


@TRIADS
def test_scatter_within_the_range_is_cut_by_the_normal_tail(triad):
    """One sigma below the limit: sigma (phi(1) - Phi(-1)) = 0.24197072 - 0.15865525 sigma."""
    scatter = [0.5] * 3 + [7.0] * 3 if triad == "gyro" else [7.0] * 3 + [0.5] * 3
    acting = readings(triad, (9.5, -9.5, 10.5), scatter=scatter)
    found = on_own_triad(f"{triad}_saturation", acting, limit=10.0)
    tail = 0.5 * 0.08331547
    np.testing.assert_allclose(found, [[-tail, tail, -tail - 0.5]], rtol=1e-6)


@TRIADS
def test_a_first_order_low_pass_answers_a_ramp_late(triad):
    """u = 2 t: H u - u = -2 tau (1 - exp(-t / tau)), tau = 1 / (2 pi 2 Hz) = 79.577 ms."""
    time_s = np.arange(0.0, 0.5, 0.01)
    ramp = np.outer(time_s, [2.0, -2.0, 0.0])
    found = on_own_triad(
        f"{triad}_low_pass",
        readings(triad, ramp, count=len(time_s), time_s=time_s),
        cutoff_hz=2.0,
        order=1.0,
    )
    late = -2.0 * 0.0795774715 * (1.0 - np.exp(-time_s / 0.0795774715))
    np.testing.assert_allclose(found[:, 0], late, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found[:, 1], -late, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found[:, 2], 0.0, atol=1e-15)


@TRIADS
def test_a_second_order_low_pass_is_a_quarter_late_and_3_db_down_at_its_cutoff(triad):
    """Butterworth: at the cutoff sin(w t) comes out as sin(w t - pi / 2) / sqrt(2)."""
    time_s = np.arange(0.0, 2.0, 0.001)
    wave = np.outer(np.sin(2.0 * math.pi * 5.0 * time_s), [1.0, -1.0, 0.0])
    acting = readings(triad, wave, count=len(time_s), time_s=time_s)
    found = on_own_triad(f"{triad}_low_pass", acting, cutoff_hz=5.0, order=2.0) + wave
    late = -np.cos(2.0 * math.pi * 5.0 * time_s) / math.sqrt(2.0)
    np.testing.assert_allclose(found[1500:, 0], late[1500:], atol=2e-4)
    np.testing.assert_allclose(found[1500:, 1], -late[1500:], atol=2e-4)


def test_a_late_stamp_shows_the_past_of_both_triads():
    """At 3 rad/s^2 and 2 m/s^3 a stamp 20 ms late reads 0.06 rad/s and 0.04 m/s^2 too low."""
    time_s = np.arange(7.0, 9.0, 0.01)
    rate, force = np.outer(time_s, [3.0, -3.0, 0.0]), np.outer(time_s, [2.0, 0.0, -2.0])
    acting = columns(len(time_s), time_s=time_s, rate_rad_s=rate, force_m_s2=force)
    found = added("imu_time_offset", acting, offset_s=0.02)
    np.testing.assert_allclose(found.gyro[5:], [[-0.06, 0.06, 0.0]] * 195, atol=1e-12)
    np.testing.assert_allclose(found.accel[5:], [[-0.04, 0.0, 0.04]] * 195, atol=1e-12)
    early = added("imu_time_offset", acting, offset_s=-0.02)
    np.testing.assert_allclose(early.gyro[:-5], [[0.06, -0.06, 0.0]] * 195, atol=1e-12)


def test_a_clock_of_1000_ppm_is_late_by_1_ms_a_second_from_the_beginning_on():
    """10 s after the beginning by 10 ms: 0.03 rad/s less at 3 rad/s^2, 0.02 less at 2 m/s^3."""
    time_s = np.arange(100.0, 110.005, 0.01)
    rate, force = np.outer(time_s, [3.0, 0.0, 0.0]), np.outer(time_s, [0.0, 2.0, 0.0])
    acting = columns(len(time_s), time_s=time_s, rate_rad_s=rate, force_m_s2=force)
    found = added("imu_clock_drift", acting, ppm=1000.0)
    np.testing.assert_allclose(found.gyro[[0, 500, 1000], 0], [0.0, -0.015, -0.03], atol=1e-9)
    np.testing.assert_allclose(found.accel[[0, 500, 1000], 1], [0.0, -0.01, -0.02], atol=1e-9)


@TRIADS
def test_vibration_becomes_bias_by_its_square(triad):
    """0.05 per (m/s^2)^2 at 3 m/s^2 gives 0.45, at 6 m/s^2 four times as much."""
    found = on_own_triad(
        f"{triad}_vibration_rectification",
        columns(2, vibration_m_s2=[3.0, 6.0]),
        per_vibration_variance=[0.05, -0.02, 0.0],
    )
    np.testing.assert_allclose(found, [[0.45, -0.18, 0.0], [1.8, -0.72, 0.0]], atol=1e-15)


@TRIADS
def test_current_couples_in_from_its_reference_on(triad):
    """0.002 per A: 12 A against 2 A gives 0.02; at 0 A it is 2 A less than the reference."""
    found = on_own_triad(
        f"{triad}_current_coupling",
        columns(2, current_a=[12.0, 0.0]),
        per_ampere=[0.002, -0.001, 0.0],
        reference_a=2.0,
    )
    np.testing.assert_allclose(found, [[0.02, -0.01, 0.0], [-0.004, 0.002, 0.0]], atol=1e-15)


def test_effects_add_up_and_each_acts_on_the_ideal_reading():
    """2 rad/s with 10 % of scale and 0.01 w |w|: 2 + 0.2 + 0.04, not 2.2 + 0.01 * 2.2^2."""
    effects = [
        (effect_of(name), effect_of(name).checked(values))
        for name, values in (
            ("gyro_scale_factor", {"scale_error": [0.1, 0.0, 0.0]}),
            ("gyro_scale_nonlinearity", {"k": [0.01, 0.0, 0.0]}),
        )
    ]
    acting = columns(rate_rad_s=(2.0, 1.0, 1.0))
    gyro, _ = apply(acting, effects)
    np.testing.assert_allclose(gyro, [[2.24, 1.0, 1.0]], atol=1e-15)
    back = ideal_motion(columns(rate_rad_s=(2.24, 1.0, 1.0)), effects, 12).rate_rad_s
    np.testing.assert_allclose(back, [[2.0, 1.0, 1.0]], atol=1e-9)
