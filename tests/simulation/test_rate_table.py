"""The rate table's motion against its equations: the swing, and the effect of an arm."""

import math

import numpy as np
import pytest

from ahrs_service.constants import STANDARD_GRAVITY_M_S2 as G
from ahrs_service.rotation import euler_columns, inverse_columns, rotate_columns
from ahrs_service.simulation.scenario import SCENARIOS, make_flight
from ahrs_service.simulation.table_swings import Swing, table_phases

TABLES = [name for name in SCENARIOS if name.startswith("rate-table")]
RATE_HZ = 1000.0


@pytest.fixture(scope="module", params=TABLES)
def swung(request):
    return SCENARIOS[request.param].bench, make_flight(request.param, 40.0, 1, RATE_HZ).rows


def test_amplitude_and_rate_are_the_papers():
    """80 deg and 200 deg/s; the swing is a sine of 200 / 80 rad/s in between."""
    rows = make_flight("rate-table", 60.0, 1, RATE_HZ).rows
    roll = np.degrees(euler_columns(rows["ned_from_body"])[:, 0])
    rate = np.degrees(rows["rate_rad_s"][:, 0])
    full = (rows["time_s"] > 20.0) & (rows["time_s"] < 45.0)
    assert np.abs(roll[full]).max() == pytest.approx(80.0, abs=0.01)
    assert np.abs(rate[full]).max() == pytest.approx(200.0, abs=0.02)
    np.testing.assert_allclose((roll[full] / 80.0) ** 2 + (rate[full] / 200.0) ** 2, 1.0, atol=1e-9)
    assert np.abs(roll).max() < 80.01
    assert np.abs(rate).max() < 201.0


def test_it_begins_and_ends_at_rest_without_a_jerk(swung):
    _, rows = swung
    for rest in (rows["time_s"] < 8.0, rows["time_s"] > 36.0):
        assert np.abs(rows["rate_rad_s"][rest]).max() == 0.0
        np.testing.assert_allclose(rows["force_m_s2"][rest], [[0.0, 0.0, -G]] * rest.sum())
    # Steps of the angular acceleration stay those of a continuous function sampled at 1 kHz.
    assert np.abs(np.diff(rows["rate_rad_s"], n=2, axis=0)).max() * RATE_HZ**2 < 100.0


def test_rates_are_those_of_the_attitude(swung):
    """A central difference of the body axes: dR/dt = R [w x], of second order."""
    _, rows = swung
    for axis in np.eye(3):
        seen = rotate_columns(rows["ned_from_body"], axis)
        slope = (seen[2:] - seen[:-2]) * RATE_HZ / 2.0
        spun = rotate_columns(rows["ned_from_body"], np.cross(rows["rate_rad_s"], axis))
        np.testing.assert_allclose(slope, spun[1:-1], atol=1e-4)


def test_force_is_that_of_the_motion(swung):
    """Second differences of the position, rotated to body axes, less gravity."""
    _, rows = swung
    place = rows["position_ned_m"]
    acceleration = (place[2:] - 2.0 * place[1:-1] + place[:-2]) * RATE_HZ**2
    felt = rotate_columns(
        inverse_columns(rows["ned_from_body"][1:-1]), acceleration - [0.0, 0.0, G]
    )
    np.testing.assert_allclose(felt, rows["force_m_s2"][1:-1], atol=1e-4)
    velocity = (place[2:] - place[:-2]) * RATE_HZ / 2.0
    np.testing.assert_allclose(velocity, rows["velocity_ned_m_s"][1:-1], atol=1e-4)


def test_the_arm_adds_its_centripetal_acceleration():
    """Through the middle at 200 deg/s an arm of 0.1 m across the axis feels w^2 L = 1.218 m/s^2."""
    swing = Swing((1.0, 0.0, 0.0), arm_m=(0.0, 0.1, 0.0))
    time_s = np.arange(0.0, 60.0, 1e-3)
    rows = swing.truth(table_phases(60.0), 0.0, time_s)
    fastest = np.argmax(np.abs(rows["rate_rad_s"][:, 0]) * ((time_s > 20.0) & (time_s < 40.0)))
    inward = -(math.radians(200.0) ** 2) * 0.1
    tilted = rotate_columns(inverse_columns(rows["ned_from_body"][fastest]), [0.0, 0.0, -G])
    assert rows["force_m_s2"][fastest, 1] - tilted[1] == pytest.approx(inward, rel=1e-3)


@pytest.mark.parametrize("seconds", [5.0, 40.0, 300.0])
def test_a_plan_takes_its_time_and_stays_within_its_amplitude(seconds):
    assert sum(phase.seconds for phase in table_phases(seconds)) == pytest.approx(seconds)
    rows = make_flight("rate-table", seconds, 1, 200.0).rows
    reached = np.degrees(np.abs(euler_columns(rows["ned_from_body"])[:, 0]).max())
    assert 79.0 < reached <= 80.0 + 1e-9
    assert np.abs(rows["rate_rad_s"][-1]).max() == 0.0
