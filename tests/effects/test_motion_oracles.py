"""Effects of the IMU's motion and mounting, each against numbers worked out by hand."""

import math

import numpy as np
import pytest

from tests.effect_columns import added, columns, on_own_triad

G = 9.80665
RIGHT_ANGLE = math.sqrt(0.5)

# W = 7.292115e-5 rad/s; cos(52 deg) = 0.61566148, sin(52 deg) = 0.78801075.
LEVEL_52 = 4.4894743e-5
UP_52 = 5.7462650e-5


@pytest.mark.parametrize(
    ("stands", "ned_from_body", "expected"),
    [
        # The axis points north and up: body z is down, so z reads it negative.
        ("level, north", (1.0, 0.0, 0.0, 0.0), (LEVEL_52, 0.0, -UP_52)),
        # Facing east, north is to the left.
        ("level, east", (RIGHT_ANGLE, 0.0, 0.0, RIGHT_ANGLE), (0.0, -LEVEL_52, -UP_52)),
        ("level, south", (0.0, 0.0, 0.0, 1.0), (-LEVEL_52, 0.0, -UP_52)),
        # Nose straight up, belly to the north: x is up, z north.
        ("nose up", (RIGHT_ANGLE, 0.0, RIGHT_ANGLE, 0.0), (UP_52, 0.0, LEVEL_52)),
        # Right wing down, facing north: y is down.
        ("rolled right", (RIGHT_ANGLE, RIGHT_ANGLE, 0.0, 0.0), (LEVEL_52, -UP_52, 0.0)),
    ],
)
def test_the_rate_of_the_earth_at_52_deg_north(stands, ned_from_body, expected):
    found = on_own_triad("gyro_earth_rate", columns(ned_from_body=ned_from_body), latitude_deg=52.0)
    np.testing.assert_allclose(found, [expected], rtol=1e-7, atol=1e-18, err_msg=stands)


def test_south_of_the_equator_the_axis_points_into_the_ground():
    """At 30 deg south: cos = 0.8660254, sin = -0.5, so z reads +W / 2."""
    found = on_own_triad("gyro_earth_rate", columns(), latitude_deg=-30.0)
    np.testing.assert_allclose(found, [[6.3151569e-5, 0.0, 3.6460575e-5]], rtol=1e-7)


@pytest.mark.parametrize(
    ("alpha", "rate", "arm", "expected"),
    [
        # Nose turning right faster and faster, the IMU ahead: it is pushed to the right.
        ((0.0, 0.0, 2.0), (0.0, 0.0, 0.0), (0.05, 0.0, 0.0), (0.0, 0.1, 0.0)),
        # Rolling right faster, the IMU on the right wing: pushed down.
        ((3.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.3)),
        # Nose going up faster, the IMU ahead: pushed up.
        ((0.0, 4.0, 0.0), (0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.0, -0.4)),
        # What goes round is pulled to the centre: -w^2 r.
        ((0.0, 0.0, 0.0), (0.0, 0.0, 3.0), (0.0, 0.2, 0.0), (0.0, -1.8, 0.0)),
        # w = (1, 2, 0), r = (0, 0, 1): w x r = (2, -1, 0), w x (w x r) = (0, 0, -1 - 4).
        ((0.0, 0.0, 0.0), (1.0, 2.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -5.0)),
        # w = (1, 0, 2), r = (1, 0, 0): w x r = (0, 2, 0), w x (w x r) = (0 - 4, 0, 2 - 0).
        ((0.0, 0.0, 0.0), (1.0, 0.0, 2.0), (1.0, 0.0, 0.0), (-4.0, 0.0, 2.0)),
    ],
)
def test_a_lever_arm_by_hand(alpha, rate, arm, expected):
    acting = columns(angular_acceleration_rad_s2=alpha, rate_rad_s=rate, force_m_s2=(1.0, 2.0, 3.0))
    found = on_own_triad("accel_lever_arm", acting, arm_m=arm)
    np.testing.assert_allclose(found, [expected], atol=1e-15)


def test_g_sensitivity_has_gyros_in_rows_and_forces_in_columns():
    """f = (1, 2, -10): x 0.001 * 1 + 0.003 * -10, y 0.004 * 2, z 0.002 * 1 - 0.001 * 2."""
    found = on_own_triad(
        "gyro_g_sensitivity",
        columns(force_m_s2=(1.0, 2.0, -10.0), rate_rad_s=(7.0, 8.0, 9.0)),
        matrix_rad_s_per_m_s2=[[0.001, 0.0, 0.003], [0.0, 0.004, 0.0], [0.002, -0.001, 0.0]],
    )
    np.testing.assert_allclose(found, [[-0.029, 0.008, 0.0]], atol=1e-15)


def test_a_gyro_at_rest_with_0_1_deg_s_per_g_along_x_shows_minus_0_1_deg_s():
    """Level at rest the force is -g along z."""
    matrix = np.zeros((3, 3))
    matrix[0, 2] = math.radians(0.1) / G
    found = on_own_triad(
        "gyro_g_sensitivity",
        columns(force_m_s2=(0.0, 0.0, -G)),
        matrix_rad_s_per_m_s2=matrix,
    )
    np.testing.assert_allclose(np.degrees(found), [[-0.1, 0.0, 0.0]], atol=1e-15)


@pytest.mark.parametrize("triad", ["gyro", "accel"])
def test_misalignment_shows_in_each_axis_its_share_of_the_others(triad):
    """u = (1, 2, 4): x 0.01 * 2 + 0.02 * 4, y 0.03 * 1 + 0.04 * 4, z 0.05 * 1 - 0.06 * 2.

    A diagonal would be a scale factor and has no effect.
    """
    mine, others = (1.0, 2.0, 4.0), (50.0, 60.0, 70.0)
    rate, force = (mine, others) if triad == "gyro" else (others, mine)
    found = on_own_triad(
        f"{triad}_misalignment",
        columns(rate_rad_s=rate, force_m_s2=force),
        off_diagonal=[[9.0, 0.01, 0.02], [0.03, 9.0, 0.04], [0.05, -0.06, 9.0]],
    )
    np.testing.assert_allclose(found, [[0.10, 0.19, -0.07]], atol=1e-15)


@pytest.mark.parametrize(
    ("rotvec", "rate", "expected"),
    [
        # A quarter turn about z takes x to y, about x takes y to z, about y takes z to x.
        ((0.0, 0.0, math.pi / 2), (2.0, 0.0, 0.0), (-2.0, 2.0, 0.0)),
        ((math.pi / 2, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, -2.0, 2.0)),
        ((0.0, math.pi / 2, 0.0), (0.0, 0.0, 2.0), (2.0, 0.0, -2.0)),
        # A small one adds rho x u: (0.01, 0, 0) x (0, 0, 1) = (0, -0.01, 0).
        ((0.01, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -math.sin(0.01), math.cos(0.01) - 1.0)),
    ],
)
def test_a_mounting_rotation_rotates_both_readings(rotvec, rate, expected):
    acting = columns(rate_rad_s=rate, force_m_s2=3.0 * np.array(rate))
    found = added("imu_mounting_rotation", acting, rotvec_rad=rotvec)
    np.testing.assert_allclose(found.gyro, [expected], atol=1e-15)
    np.testing.assert_allclose(found.accel, [3.0 * np.array(expected)], atol=1e-15)


def test_an_imu_rotated_by_0_1_rad_about_x_reads_a_level_vehicle_as_tilted():
    """rho = (0.1, 0, 0), f = (0, 0, -g): y gets -sin(0.1) * -g = +0.979 m/s^2."""
    found = added("imu_mounting_rotation", columns(force_m_s2=(0, 0, -G)), rotvec_rad=(0.1, 0, 0))
    np.testing.assert_allclose(found.accel, [[0.0, 0.97903136, 0.04899242]], rtol=1e-6, atol=1e-12)
