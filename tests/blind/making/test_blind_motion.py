"""Motion of blind recordings: attitude, rate, force, velocity and place agree."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ahrs_service.blind.making.motion import table_path
from ahrs_service.blind.making.vehicles import fixed_wing, multirotor

STEP_S = 0.0005
G = 9.80665


def path_of(kind, seed=3, seconds=120):
    rng = np.random.default_rng(seed)
    if kind == "bench":
        return table_path(rng, seconds)
    return (fixed_wing if kind == "flight" else multirotor)(rng, seconds).path


def turned(motion):
    return Rotation.from_quat(motion.ned_from_body, scalar_first=True)


@pytest.mark.parametrize("kind", ["bench", "flight", "copter"])
def test_rates_and_forces_are_slopes_of_attitude_and_velocity(kind):
    path = path_of(kind)
    time = np.linspace(1.0, 118.0, 4001)
    now, before, after = path.at(time), path.at(time - STEP_S), path.at(time + STEP_S)
    rate = (turned(before).inv() * turned(after)).as_rotvec() / (2 * STEP_S)
    # Central differences err by step^2 / 6 of the third derivative.
    assert np.abs(rate - now.rate_rad_s).max() < 1e-5
    push = (after.velocity_ned_m_s - before.velocity_ned_m_s) / (2 * STEP_S)
    force = turned(now).inv().apply(push - [0.0, 0.0, G])
    assert np.abs(force - now.force_m_s2).max() < 1e-4
    moved = (after.position_ned_m - before.position_ned_m) / (2 * STEP_S)
    assert np.abs(moved - now.velocity_ned_m_s).max() < 1e-4


def test_the_table_rests_swings_and_shows_every_axis():
    motion = path_of("bench", seconds=400).at(np.arange(0.0, 400.0, 0.01))
    turning = np.abs(motion.rate_rad_s).max(axis=1)
    assert 0.3 < np.mean(turning == 0.0) < 0.8
    assert 1.5 < turning.max() < 2.5
    assert (np.abs(motion.rate_rad_s).max(axis=0) > 0.5).all()
    assert np.allclose(np.linalg.norm(motion.force_m_s2, axis=1), G)


def test_a_turning_aircraft_banks_without_side_force():
    motion = path_of("flight", seconds=240).at(np.arange(30.0, 230.0, 0.01))
    # Gusts roll it a little besides the turn that it flies.
    assert np.sqrt(np.mean(motion.force_m_s2[:, 1] ** 2)) < 0.4
    assert np.abs(turned(motion).as_euler("ZYX")[:, 2]).max() > 0.25
