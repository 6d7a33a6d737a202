"""Each step from a magnetic field to the heading against numbers worked out by hand."""

import math

import numpy as np
import pytest

from ahrs_service.fusion import heading
from tests.error_state import attitude, matrix_of
from tests.magnetic_field import FIELD, OF_A_TURN, TURN_S, facing, settings_of, taken


def turned(angle):
    """The field as measured with a heading that is too large by `angle`."""
    return np.array([20.0 * math.cos(angle), 20.0 * math.sin(angle), 40.0])


@pytest.mark.parametrize("yaw", [0.0, 2.0])
@pytest.mark.parametrize(("seen", "declination"), [(0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.3, 0.2)])
def test_a_field_seen_east_of_its_direction_rotates_the_heading_back(seen, declination, yaw):
    """K = P / (P + R), R = (0.06^2 + (40 / 20)^2 * 1e-4) over 10 s, P = 0.04 rad^2."""
    variance = (0.0036 + 4.0 * 1e-4) * OF_A_TURN
    found = taken(facing(yaw), turned(seen), settings_of(declination))
    assert found == pytest.approx((declination - seen) * 0.04 / (0.04 + variance), rel=1e-9)


def test_a_field_that_misses_the_reference_is_trusted_less():
    """It differs by d = 5 uT along the meridian or down, so d / sqrt(2) may hide across 20 uT.

    The limit is a tenth of the norm, squared 20: 0.5 * 25 * (1 + 25 / 20) = 28.125 uT^2.
    """
    variance = (0.0036 + 28.125 / 400.0 + 4e-4) * OF_A_TURN
    for field in ((15.0, 0.0, 40.0), (20.0, 0.0, 45.0), (17.0, 0.0, 44.0)):
        state = facing()
        found = taken(state, field, settings_of(0.1))
        assert found == pytest.approx(0.1 * 0.04 / (0.04 + variance), rel=1e-9)


def test_an_azimuth_far_out_counts_less_by_its_square():
    """1 rad against 3 sigma of P + 0.004: 1 / (9 * 0.044) = 2.525 times the variance."""
    variance = 0.004 * OF_A_TURN / (9.0 * 0.044)
    found = taken(facing(), turned(-1.0))
    assert found == pytest.approx(0.04 / (0.04 + variance), rel=1e-9)


def test_a_magnetic_error_does_not_tilt_the_horizon():
    state = facing()
    state["covariance"][0, 2] = state["covariance"][2, 0] = 1e-3
    state["covariance"][1, 2] = state["covariance"][2, 1] = -5e-4
    before = state["covariance"].copy()
    taken(state, turned(0.1))
    np.testing.assert_array_equal(state["correction"][:2], 0.0)
    p = state["covariance"] - sum(np.outer(g, g) for g in state["gains"])
    np.testing.assert_allclose(p[:2, :2], before[:2, :2], atol=1e-15)
    variance = 0.004 * OF_A_TURN
    assert p[2, 2] == pytest.approx(0.04 * variance / (0.04 + variance), rel=1e-9)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("yaw", [0.0, 0.9])
def test_a_late_reading_belongs_to_the_attitude_of_then(axis, yaw):
    """The vehicle rotated for 20 ms since: at 2 rad/s by 40 mrad, 0.8 mrad of it of 2nd order.

    C (w x m) is how fast the reading rotates in earth axes.
    """
    state, lag_s = facing(yaw), 0.02
    rate = np.zeros(3)
    rate[axis] = 2.0
    state["rate_rad_s"], state["field_lag_s"] = rate, lag_s
    then = matrix_of(attitude([0.0, 0.0, yaw])) @ matrix_of(attitude(-lag_s * rate))
    reading = then.T @ FIELD
    heading.gather(state, reading, TURN_S)
    now = state["mag_field_ut"].copy()
    moved = now - lag_s * state["mag_turning_ut_s"]
    # Uncorrected it misses by 0.04 times the part of the field across the axis, 20 uT at least.
    assert np.linalg.norm(now - FIELD) > 0.75
    np.testing.assert_allclose(moved, FIELD, atol=0.04)
    heading.correct(settings_of(), state)
    assert abs(state["correction"][2]) < 1e-4


def test_an_attached_magnet_is_removed_before_the_lag():
    """w x (m - b): an attached field does not rotate."""
    state = facing()
    state["iron_ut"], state["rate_rad_s"] = (5.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    heading.gather(state, np.array([5.0, 0.0, 0.0]), TURN_S)
    np.testing.assert_array_equal(state["mag_turning_ut_s"], 0.0)
    heading.gather(state, np.array([8.0, 0.0, 0.0]), TURN_S)
    # 3 uT ahead: turning right, it turns from north to east.
    np.testing.assert_allclose(state["mag_turning_ut_s"], [0.0, 3.0, 0.0])


@pytest.mark.parametrize("yaw", [0.0, 1.2])
def test_a_field_without_the_attached_magnet_gives_the_heading(yaw):
    """30 uT to the right and 15 up: the field as read misses by far, without them by nothing."""
    state = facing(yaw)
    state["iron_ut"], state["read_misfit_ut2"] = (0.0, 30.0, -15.0), 500.0
    field = FIELD + state["dcm"] @ state["iron_ut"]
    assert abs(taken(state, field)) < 1e-12
    assert state["freed_misfit_ut2"] == pytest.approx(0.0, abs=1e-12)
    # The reference has followed the field without the magnet.
    np.testing.assert_allclose(state["reference_ut"], [20.0, 40.0], atol=1e-12)


@pytest.mark.parametrize(
    ("yaw", "azimuth", "across"),
    [
        (0.0, 0.0, (0.0, 1.0, 0.0)),
        (0.0, 0.5 * math.pi, (-1.0, 0.0, 0.0)),
        (0.5 * math.pi, 0.0, (1.0, 0.0, 0.0)),
        (0.5 * math.pi, 0.5 * math.pi, (0.0, 1.0, 0.0)),
        (0.0, 0.25 * math.pi, (-math.sqrt(0.5), math.sqrt(0.5), 0.0)),
        (0.3, 0.8, (-math.sin(0.5), math.cos(0.5), 0.0)),
    ],
)
def test_a_magnet_rotates_the_field_by_its_part_across_the_meridian(yaw, azimuth, across):
    """Facing north, iron to the right rotates a field that points north."""
    state = facing(yaw)
    root = np.array([[1.0, 0.2, 0.0], [0.0, 2.0, -0.5], [0.3, 0.0, 1.5]])
    state["iron_covariance"] = root @ root.T
    heading.gather(state, np.zeros(3), TURN_S)
    heading.gather(state, np.zeros(3), TURN_S)
    found = heading._iron_across2(state, 20.0 * math.cos(azimuth), 20.0 * math.sin(azimuth), 0.5)
    expected = np.array(across) @ state["iron_covariance"] @ np.array(across)
    assert found == pytest.approx(expected, rel=1e-9)


def test_the_variance_of_iron_and_lag_widens_that_of_the_azimuth():
    """Iron of 2 uT to the right 4 uT^2; 10 ms of lag at 20 uT and 3 rad/s 0.36 uT^2."""
    state = facing()
    state["read_misfit_ut2"] = 500.0
    state["iron_ut"], state["iron_covariance"][1, 1] = (0.0, 0.0, 30.0), 4.0
    state["rate_rad_s"], state["field_lag_variance_s2"] = (0.0, 0.0, 3.0), 1e-4
    state["lag_before_s"] = 0.0
    found = taken(state, np.add(FIELD, [0.0, 0.0, 30.0]), settings_of(0.1))
    variance = (0.0036 + 4.36 / 400.0 + 4e-4) * OF_A_TURN
    assert found == pytest.approx(0.1 * 0.04 / (0.04 + variance), rel=1e-3)


@pytest.mark.parametrize(
    ("field", "turning", "across"),
    [
        ((20.0, 0.0), (7.0, 3.0), 3.0),
        ((0.0, 20.0), (7.0, 3.0), -7.0),
        ((12.0, 16.0), (7.0, 3.0), 0.6 * 3.0 - 0.8 * 7.0),
    ],
)
def test_a_lag_rotates_the_field_by_its_motion_across_the_meridian(field, turning, across):
    state = facing()
    state["field_lag_variance_s2"] = 1e-4
    state["mag_turning_ut_s"] = (2.0 * turning[0], 2.0 * turning[1], 9.0)
    found = heading._lag_across2(state, *field, 0.5)
    assert found == pytest.approx(1e-4 * across**2, rel=1e-9)


def test_the_sigma_covers_the_direction_of_the_field_itself():
    state = facing(variance=0.0064)
    assert heading.sigma(state) == pytest.approx(0.1)
    state["heading_source"] = heading.VELOCITY
    assert heading.sigma(state) == pytest.approx(0.08)


def test_a_first_heading_is_as_good_as_a_reading_and_the_tilt():
    """0.2^2 + (40 / 20)^2 * 0.01 rad^2; it rotates to the declination from any heading."""
    state = facing(1.0, tilt_variance=0.01)
    state["heading_source"] = heading.NONE
    heading.gather(state, np.array([20.0, 0.0, 40.0]), TURN_S)
    heading.find(settings_of(0.2), state)
    # A field straight ahead: the nose points to magnetic north.
    assert math.atan2(state["dcm"][1, 0], state["dcm"][0, 0]) == pytest.approx(0.2)
    assert state["covariance"][2, 2] == pytest.approx(0.08)
    np.testing.assert_allclose(state["reference_ut"], [20.0, 40.0])


def test_the_reference_follows_over_half_a_minute():
    """By 0.12 / 30 of 1 uT more along the meridian and 2 less down."""
    state = facing()
    taken(state, (21.0, 0.0, 38.0))
    np.testing.assert_allclose(state["reference_ut"], [20.0 + 0.004, 40.0 - 0.008], rtol=1e-12)


def test_another_field_is_averaged_beside_it_while_the_vehicle_turns():
    state = facing()
    state["smooth_rate_rad_s"] = (0.0, 0.0, 0.5)
    taken(state, (30.0, 0.0, 20.0))
    np.testing.assert_allclose(state["other_ut"], [30.0, 20.0])
    taken(state, (31.0, 0.0, 18.0))
    weight = TURN_S / (30.0 + TURN_S)
    np.testing.assert_allclose(state["other_ut"], [30.0 + weight, 20.0 - 2.0 * weight])
    np.testing.assert_allclose(state["reference_ut"], [20.0, 40.0])
