"""Hidden physics against closed forms and independent solvers."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ahrs_service.blind.making.case import Request, make
from ahrs_service.blind.making.hidden_catalogue import HIDEABLE
from ahrs_service.blind.making.motion_physics import filtered, place_acceleration
from ahrs_service.blind.making.outside_physics import OUTSIDE
from ahrs_service.blind.making.surroundings import lag
from ahrs_service.blind.making.thermal_physics import hysteresis_state, play


@pytest.fixture(scope="module")
def scenes():
    kinds = {"bench": 200, "flight": 120, "copter": 120}
    return {kind: make(Request("s", kind, 8, seconds)).scene for kind, seconds in kinds.items()}


def hidden(scenes, name, kind, seed=4):
    made = OUTSIDE[name] if name in OUTSIDE else HIDEABLE[name]
    return made[0](np.random.default_rng(seed), kind, scenes[kind])


def test_a_play_drags_behind_by_its_half_width():
    triangle = np.concatenate([np.linspace(0, 10, 101), np.linspace(10, -10, 201)])
    out = play(triangle, 2.0)
    assert out[100] == pytest.approx(8.0)
    # Held until the pin has crossed the slot, then dragged the other way.
    assert out[140] == pytest.approx(8.0)
    assert out[-1] == pytest.approx(-8.0)


def test_a_play_equals_its_recursion():
    rng = np.random.default_rng(0)
    values = np.cumsum(rng.standard_normal(3000))
    expected = [values[0]]
    for value in values[1:]:
        expected.append(min(max(expected[-1], value - 1.5), value + 1.5))
    assert np.allclose(play(values, 1.5), expected)


def test_hysteresis_closes_a_loop_between_its_branches():
    up_and_down = 25.0 + 20.0 * np.sin(np.linspace(0.0, 4.0 * np.pi, 4001))
    state = hysteresis_state(up_and_down, 5.0)
    assert state[500:1000].max() == pytest.approx(1.0)
    assert state[1500:2900].min() == pytest.approx(-1.0)
    # The second turn repeats the first: a closed loop that encloses an area.
    assert np.allclose(state[3000:4001], state[1000:2001])
    assert abs(np.trapezoid(state[1000:3001], up_and_down[1000:3001])) > 40.0


def test_lag_solves_its_equation():
    time = np.arange(0.0, 100.0, 0.1)
    drive = 20.0 + 5.0 * np.sin(0.1 * time)
    solved = solve_ivp(
        lambda t, y: (np.interp(t, time, drive) - y) / 30.0,
        (0.0, time[-1]),
        [22.0],
        t_eval=time,
        rtol=1e-9,
        atol=1e-9,
        max_step=0.02,
    )
    assert np.abs(lag(drive, 0.1, 30.0, 22.0) - solved.y[0]).max() < 1e-6


def test_the_filter_has_butterworth_s_gain_and_phase():
    time = np.arange(0.0, 20.0, 0.005)
    wave = np.exp(2j * np.pi * 3.0 * time)
    parts = [filtered(part[:, None], 10.0, 0.005)[:, 0] for part in (wave.real, wave.imag)]
    ratio = ((parts[0] + 1j * parts[1]) / wave)[2000:]
    s = 1j * 3.0 / 10.0
    # A line between samples loses (pi f dt)^2 / 3 = 7e-4 of a sine.
    assert np.abs(ratio - 1.0 / (s**2 + np.sqrt(2.0) * s + 1.0)).max() < 1e-3


def test_a_lever_arm_is_tangential_and_centripetal(scenes):
    scene, arm = scenes["copter"], np.array([0.1, -0.05, 0.2])
    w = scene.motion.rate_rad_s
    step = 1e-4
    slope = scene.path.at(scene.time_s + step).rate_rad_s
    slope = (slope - scene.path.at(scene.time_s - step).rate_rad_s) / (2 * step)
    expected = np.cross(slope, arm) + np.cross(w, np.cross(w, arm))
    assert np.abs(place_acceleration(scene, arm) - expected).max() < 1e-4


def test_a_late_sample_is_the_motion_of_an_earlier_instant(scenes):
    scene = scenes["copter"]
    offset = hidden(scenes, "imu_time_offset", "copter")
    seconds = offset.params(1.0)["offset_s"]
    gyro, _ = offset.signals(scene, 1.0)
    earlier = scene.path.at(scene.time_s - seconds).rate_rad_s
    assert np.allclose(scene.motion.rate_rad_s + gyro, earlier, rtol=0.0, atol=1e-15)
    slope = np.gradient(scene.motion.rate_rad_s, scene.time_s, axis=0)
    small = offset.signals(scene, 1e-3)[0]
    assert np.abs(small + 1e-3 * seconds * slope).max() < 2e-3 * np.abs(small).max()


def test_the_earth_turns_once_a_sidereal_day(scenes):
    gyro, accel = hidden(scenes, "gyro_earth_rate", "bench").signals(scenes["bench"], 1.0)
    assert np.allclose(np.linalg.norm(gyro, axis=1), 2.0 * np.pi / 86164.0905)
    assert not accel.any()


def test_mounting_keeps_the_length_of_what_it_rotates(scenes):
    scene = scenes["flight"]
    gyro, accel = hidden(scenes, "imu_mounting_rotation", "flight").signals(scene, 3.0)
    for ideal, added in ((scene.motion.rate_rad_s, gyro), (scene.motion.force_m_s2, accel)):
        assert np.allclose(np.linalg.norm(ideal + added, axis=1), np.linalg.norm(ideal, axis=1))


@pytest.mark.parametrize("name", [*HIDEABLE, *OUTSIDE])
def test_every_effect_acts_on_its_own_sensor_in_every_kind(scenes, name):
    for kind in (OUTSIDE[name] if name in OUTSIDE else HIDEABLE[name])[1]:
        if name == "voltage":
            # The scenes' supply does not sag.
            continue
        effect = hidden(scenes, name, kind)
        gyro, accel = effect.signals(scenes[kind], 1.0)
        acts = {"gyro": gyro.any(), "accel": accel.any()}
        sensor = name.split("_")[0]
        if sensor in acts:
            assert acts.pop(sensor)
            assert not any(acts.values())
        else:
            assert any(acts.values())
        assert effect.params(1.0)
