"""The benchmarks' reference smoother against its own derivatives and a known flight."""

import sys
from pathlib import Path

import numpy as np
import pytest

from ahrs_service.records import Airframe
from ahrs_service.rotation import inverse_columns, multiply_columns, quaternion_columns
from ahrs_service.simulation.samples import samples_of
from ahrs_service.simulation.scenario import make_flight

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
RATE_HZ = 50.0
LAG_S = 0.23


@pytest.fixture
def smoother(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import gps_smoother

    yield gps_smoother
    for name in ("gps_smoother", "tilt_witness", "gps_velocity"):
        sys.modules.pop(name, None)


def tilt_deg(q, truth):
    """Angle between the verticals of attitudes [N, 4]."""
    error = multiply_columns(q, inverse_columns(truth))
    return np.degrees(2.0 * np.arccos(np.minimum(np.hypot(error[:, 0], error[:, 3]), 1.0)))


def test_transition_is_the_derivative_of_the_integration(smoother):
    dice = np.random.default_rng(3)
    count, small = 20, 1e-6
    dt, gyro = np.full(count, 0.02), dice.normal(0.0, 1.0, (count, 3))
    force = dice.normal(0.0, 3.0, (count, 3)) - [0.0, 0.0, 9.8]
    attitude, state = smoother._exp(0.3, 0.5, -0.7), dice.normal(0.0, 0.01, smoother.STATES)
    transition, unused = np.zeros((2, smoother.STATES, smoother.STATES))
    end = smoother._between(dt, gyro, force, attitude, state, transition)
    for i in range(smoother.STATES):
        turned, moved = attitude, state.copy()
        if i < smoother.VEL:
            turned = smoother._exp(*(small * np.eye(3)[i])) @ attitude
        else:
            moved[i] += small
        other = smoother._between(dt, gyro, force, turned, moved, unused)
        turn = smoother._log(other[0] @ end[0].T) / small
        push = (other[1] - end[1]) / small
        np.testing.assert_allclose(transition[:3, i], turn, atol=2e-5)
        # Steps of 20 ms: rotation within a step is neglected in the derivative.
        np.testing.assert_allclose(transition[3:6, i], push, atol=1e-3)


def test_finds_attitude_biases_and_lag_from_a_start_that_leans(smoother):
    made = make_flight("calm", 90.0, 5, RATE_HZ)
    samples, truth = samples_of(made, Airframe.FIXED_WING), made.rows
    t_s, q = truth["time_s"], truth["ned_from_body"]
    bias = np.array([0.01, -0.02, 0.015])
    fix_s, velocity = t_s[::10] + LAG_S, truth["velocity_ned_m_s"][::10]
    fix = np.concatenate([velocity, np.full((len(velocity), 1), np.nan)], axis=1)
    gyro, force = samples["gyro_rad_s"] + bias, samples["accel_m_s2"]
    one = smoother.GpsSmoother(t_s, gyro, force, fix_s, fix, 0.1)
    start = multiply_columns(quaternion_columns(np.radians([[6.0, -4.0, 25.0]])), q)
    found = one.smooth(start)
    error = tilt_deg(one.attitude(found), q)
    assert tilt_deg(start, q).min() > 6.0
    assert np.sqrt(np.mean(error**2)) < 0.1
    np.testing.assert_allclose(found.state[-1, smoother.GYRO : smoother.FORCE], bias, atol=5e-4)
    assert 0.1 + found.state[-1, smoother.LAG] == pytest.approx(LAG_S, abs=0.01)


def test_a_fix_that_is_left_out_is_not_heard(smoother):
    made = make_flight("calm", 30.0, 5, RATE_HZ)
    samples, truth = samples_of(made, Airframe.FIXED_WING), made.rows
    t_s = truth["time_s"]
    velocity = truth["velocity_ned_m_s"][::10]
    fix = np.concatenate([velocity, np.full((len(velocity), 1), np.nan)], axis=1)
    used = np.arange(len(fix)) % 3 > 0
    spoilt = fix.copy()
    spoilt[~used, :3] += 50.0
    answers = []
    for one in (fix, spoilt):
        judge = smoother.GpsSmoother(
            t_s, samples["gyro_rad_s"], samples["accel_m_s2"], t_s[::10], one, 0.0
        )
        inside = used[judge.inside]
        answers.append(judge.smooth(truth["ned_from_body"], used=inside).matrix)
    np.testing.assert_array_equal(*answers)
