"""Preintegration between sparse, uneven or interrupted references, and their jumps."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.diagnosis.input.diagnosis_input import Recorded, Series
from ahrs_service.diagnosis.input.flight_misfit import FlightResidual
from ahrs_service.diagnosis.input.preintegrated_misfit import preintegrated
from ahrs_service.diagnosis.input.reference import excursions, jumps, reference_of
from ahrs_service.diagnosis.input.sparse_velocity import instants_on
from ahrs_service.effects.catalogue import effect_of

RADIANS, TURNS_S = 1.2, 2.5


def attitude(time_s):
    """A roll that swings by 1.2 rad at 0.4 Hz."""
    return Rotation.from_rotvec(
        np.outer(RADIANS * np.sin(2.0 * np.pi * time_s / TURNS_S), [1.0, 0.0, 0.0])
    )


def imu(time_s):
    """Rate and force of a sensor that hangs still in the axis of the swing."""
    speed = 2.0 * np.pi / TURNS_S
    gyro = np.outer(RADIANS * speed * np.cos(speed * time_s), [1.0, 0.0, 0.0])
    return gyro, attitude(time_s).inv().apply([0.0, 0.0, -STANDARD_GRAVITY_M_S2])


def wxyz(rotation):
    return rotation.as_quat()[:, [3, 0, 1, 2]]


def recorded_at(at_s, late_s=0.0, velocity_s=None, step_s=0.005):
    imu_s = np.arange(0.0, 40.0, step_s)
    gyro, accel = imu(imu_s - late_s)
    velocity_s = at_s if velocity_s is None else velocity_s
    none = Series()
    return Recorded(
        name="swing",
        imu_time_s=imu_s,
        gyro_rad_s=gyro,
        accel_m_s2=accel,
        attitude=Series(at_s, wxyz(attitude(at_s))),
        velocity_ned_m_s=Series(velocity_s, np.zeros((len(velocity_s), 3))),
        body_rate_rad_s=none,
        temperature_degc=none,
        vibration_m_s2=none,
        current_a=none,
        throttle=none,
        airspeed_m_s=none,
    )


def uneven(rng, step_s, share):
    steps_s = step_s * rng.uniform(1.0 - share, 1.0 + share, 4000)
    at_s = 0.5 + np.cumsum(steps_s)
    return at_s[at_s < 39.5]


def test_a_perfect_imu_gathers_what_uneven_references_tell():
    at_s = uneven(np.random.default_rng(1), 0.1, 0.5)
    recorded = recorded_at(at_s)
    gathered = preintegrated(recorded, reference_of(recorded))
    assert gathered.parts == 5
    np.testing.assert_allclose(gathered.misfit, 0.0, atol=6e-5)
    np.testing.assert_allclose(gathered.ned_from_body, wxyz(attitude(gathered.time_s)), atol=2e-5)


def test_a_slow_imu_is_followed_along_its_bends():
    at_s = np.arange(0.5, 39.5, 0.1)
    recorded = recorded_at(at_s, step_s=0.04)
    # Straight lines would miss 1e-3 m/s per tenth of a second at 25 Hz.
    found = preintegrated(recorded, reference_of(recorded))
    np.testing.assert_allclose(found.misfit, 0.0, atol=6e-5)


def test_late_stamps_enter_the_velocity_through_the_force_alone():
    """The response is to the delay of the force alone, whatever the gyro's delay."""
    late_s = 0.013
    recorded = recorded_at(uneven(np.random.default_rng(2), 0.1, 0.3), late_s)
    reference = reference_of(recorded)
    residual = FlightResidual(recorded, reference)
    effect = effect_of("imu_time_offset")
    rate, force = imu(residual.columns.time_s)
    columns = replace(residual.columns, rate_rad_s=rate, force_m_s2=force)
    expected = residual.project(effect.add(columns, {"offset_s": np.array(late_s)}))
    inner = (residual.time_s > 2.0) & (residual.time_s < 38.0)
    punctual = FlightResidual(recorded_at(reference.time_s), reference)
    left = (residual.rows - punctual.rows - expected)[inner]
    # The lateness itself: 40 mrad and 50 mm/s.
    assert np.ptp(expected[inner], axis=0).max() > 0.04
    assert np.ptp(left[:, :3], axis=0).max() < 2e-4
    # Followed by the gyro alone it would be 20 mm/s off.
    assert np.ptp(left[:, 3:], axis=0).max() < 4e-3


def test_gaps_of_either_begin_anew():
    at_s = np.arange(0.5, 39.5, 0.02)
    at_s = at_s[(at_s < 10.0) | (at_s > 13.0)]
    recorded = recorded_at(at_s)
    there = (recorded.imu_time_s < 20.0) | (recorded.imu_time_s > 20.5)
    cut = replace(
        recorded,
        imu_time_s=recorded.imu_time_s[there],
        gyro_rad_s=recorded.gyro_rad_s[there],
        accel_m_s2=recorded.accel_m_s2[there],
    )
    gathered = preintegrated(cut, reference_of(cut))
    begins = at_s[:-1][gathered.is_broken]
    assert np.all(((begins > 9.9) & (begins < 13.0)) | ((begins > 19.9) & (begins < 20.51)))
    assert len(begins) > 20
    np.testing.assert_allclose(gathered.misfit[~gathered.is_broken], 0.0, atol=2e-5)


def test_a_velocity_reported_seldom_is_compared_at_its_own_instants():
    at_s = np.arange(0.5, 39.5, 0.1)
    velocity_s = np.arange(0.63, 39.0, 1.0)
    recorded = recorded_at(at_s, velocity_s=velocity_s)
    rows = FlightResidual(recorded, reference_of(recorded)).rows
    measured = np.flatnonzero(np.any(rows[:, 3:] != 0.0, axis=1))
    assert set(measured) <= set(np.searchsorted(at_s + 0.05, velocity_s))
    np.testing.assert_allclose(rows[measured, 3:], 0.0, atol=6e-3)


def test_instants_lie_between_those_of_the_finer_grid():
    fine_s = np.linspace(0.0, 10.0, 501)
    at_s = np.array([0.333, 4.01, 9.99])
    instants = instants_on(np.linspace(0.0, 10.0, 11), fine_s, at_s)
    np.testing.assert_array_equal(instants.rows, [0, 4, 10])
    found = instants.measured(np.stack([fine_s, 2.0 * fine_s, 0.0 * fine_s], axis=1))
    np.testing.assert_allclose(found[instants.rows, 0], at_s)
    np.testing.assert_allclose(found[instants.rows, 1], 2.0 * at_s)
    assert not found[[1, 2, 3, 5]].any()


def test_a_manoeuvre_is_no_jump_and_a_spell_away_is():
    rng = np.random.default_rng(5)
    count = 3000
    time_s = 0.02 * np.arange(count)
    increments = 1e-4 * rng.normal(size=(count, 6))
    increments[1000:1200] *= 60.0
    assert not jumps(increments).any()
    leap = np.array([0.03, -0.02, 0.01, 0.8, -0.5, 0.3])
    increments[2000] += leap
    increments[2050] -= leap
    jumped = jumps(increments)
    np.testing.assert_array_equal(np.flatnonzero(jumped), [2000, 2050])
    away = excursions(time_s, increments, jumped)
    np.testing.assert_array_equal(np.flatnonzero(away), np.arange(2000, 2051))


def test_steps_of_a_filter_that_is_aided_do_not_undo_each_other():
    rng = np.random.default_rng(6)
    increments = 1e-4 * rng.normal(size=(3000, 6))
    increments[500::50, 2] += 0.03
    jumped = jumps(increments)
    np.testing.assert_array_equal(np.flatnonzero(jumped), np.arange(500, 3000, 50))
    assert not excursions(0.02 * np.arange(3000), increments, jumped).any()
