"""Each measurement's row, variance and innovation against the truth that it measures."""

import numpy as np
import pytest

from ahrs_service import pipeline
from ahrs_service.fusion import ground_velocity, mekf, velocity_constraints, zero_velocity
from ahrs_service.fusion.states import AIDED, ERROR_STATES, UNAIDED, VELOCITY
from ahrs_service.records import Airframe
from ahrs_service.settings import Settings
from tests.error_state import flying, rows_of, tilt_of, update

G = 9.80665
TURN_S = 0.12


def settings_of(airframe, drag_s):
    settings = pipeline.parameters(Settings())[0]
    settings["forward_speed_m_s"][airframe] = 14.0
    settings["velocity_sigma_m_s"][airframe] = (3.0, 2.0, 1.5)
    settings["velocity_correlation_s"][airframe] = (2.0, 1.0, 0.05)
    settings["drag_s"][airframe] = drag_s
    settings["climb_sigma_m_s"][airframe] = 1.2
    settings["climb_correlation_s"][airframe] = 3.0
    return settings


def air_velocity(state):
    return state["velocity_ned_m_s"] - state["wind_ned_m_s"]


def assert_updated(state, before, h, innovations, variances):
    mekf.settle(state)
    x, p = update(before["covariance"], h, innovations, variances)
    np.testing.assert_allclose(state["correction"], x, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(state["covariance"], p, rtol=1e-6, atol=1e-8)
    np.testing.assert_array_equal(state["measured"], 0.0)


def at_60_s(state):
    """Nothing was heard of the velocity or the airspeed so far."""
    state["time_ns"] = 60 * 10**9
    state["measured_time_ns"] = state["airspeed_time_ns"] = 0
    return state


@pytest.mark.parametrize("heard", ["nothing", "velocity", "airspeed"])
@pytest.mark.parametrize("airframe", [Airframe.FIXED_WING, Airframe.MULTIROTOR])
@pytest.mark.parametrize("drag_s", [(0.0, 0.0, 0.0), (0.0, 3.0, 0.4), (4.0, 3.5, 0.3)])
@pytest.mark.parametrize("agrees", [False, True])
def test_the_velocity_through_the_air_is_measured_along_the_body(drag_s, airframe, heard, agrees):
    """What the class expects, and drag, v = -T (f - f0), against C' (v - wind).

    sigma^2 + (0.3 v)^2 + (v u / 4 sigma)^2: T may be wrong by 0.3; of v and of what it is unlike
    (its own size for a wing, what was integrated for a rotor) the smaller counts.
    """
    settings = settings_of(airframe, drag_s)
    state = at_60_s(flying(11, UNAIDED if heard == "nothing" else AIDED))
    if heard == "velocity":
        state["measured_time_ns"] = state["time_ns"] - 10**9
    if heard == "airspeed":
        state["airspeed_m_s"], state["airspeed_time_ns"] = 17.0, state["time_ns"] - 10**8
    state["update_force_s"] = TURN_S
    state["update_force_m_s"] = TURN_S * np.array([0.8, -1.1, -9.3])
    if agrees:
        # About the prediction of 14 m/s and the drag of 4, 3.5 and 0.3 s.
        state["velocity_ned_m_s"] = state["wind_ned_m_s"] + state["dcm"] @ [11.5, 3.0, -0.3]
    before = state.copy()
    pitot = heard == "airspeed" and airframe == Airframe.FIXED_WING
    expected = np.array([17.0 if pitot else 14.0, 0.0, 0.0])
    drags = np.array(drag_s) * [0.0 if pitot else 1.0, 1.0, 1.0]
    level = np.array([0.0, 0.0, -G])

    def by_drag(truth):
        felt = state["update_force_m_s"] / TURN_S
        force = felt - (truth["accel_bias_m_s2"] - before["accel_bias_m_s2"])
        return -drags * (force - level)

    def missed(truth):
        return expected + by_drag(truth) - truth["dcm"].T @ air_velocity(truth)

    variances = []
    for i, (sigma, stays_s) in enumerate(((3.0, 2.0), (2.0, 1.0), (1.5, 0.05))):
        spread, lasts_s = (2.0, 20.0) if pitot and i == 0 else (sigma, stays_s)
        v = by_drag(before)[i]
        integrated = (before["dcm"].T @ air_velocity(before))[i]
        unlike = v if airframe == Airframe.FIXED_WING else expected[i] + v - integrated
        large = min(v * v, unlike * unlike) / (4.0 * spread)
        if drags[i] > 0.0:
            spread = np.sqrt(spread**2 + (0.3 * v) ** 2 + large**2)
        lasts_s = max(lasts_s, 60.0) if heard == "velocity" else lasts_s
        variances.append(spread**2 * max(1.0, lasts_s / TURN_S))
    h, innovations = -rows_of(missed, before), list(missed(before))
    if heard != "velocity":
        # Without a measured velocity nothing climbs for long.
        down = np.zeros(ERROR_STATES)
        down[VELOCITY + 2] = 1.0
        h = np.vstack([h, down])
        innovations.append(-before["velocity_ned_m_s"][2])
        variances.append(1.2**2 * 3.0 / TURN_S)
    velocity_constraints.bound_velocity(settings, state, airframe, TURN_S)
    assert_updated(state, before, h, innovations, variances)


def tilt_seen(state, before, felt):
    """The tilt measured by `before` where `state` is the truth: gravity plus its bias."""
    body = felt + state["accel_bias_m_s2"] - before["accel_bias_m_s2"]
    return tilt_of(before["dcm"] @ body)


@pytest.mark.parametrize("count", [UNAIDED, AIDED])
@pytest.mark.parametrize("axis", [0, 1])
def test_the_tilt_that_gravity_shows_is_that_of_attitude_and_bias(count, axis):
    state = flying(12, count)
    before = state.copy()

    def measure(truth):
        return tilt_seen(truth, before, truth["dcm"].T @ [0.0, 0.0, -G])[axis : axis + 1]

    # At no error the force points straight up: the row is that of a small one.
    h = rows_of(measure, before)
    state["tilt_innovation_rad"][axis] = 0.02
    mekf.correct_tilt(state, axis, 3e-4)
    assert_updated(state, before, h, [0.02], [3e-4])


def test_at_rest_velocity_tilt_and_rate_are_measured():
    """Velocity 0, for any heading: that of the truth in the estimated axes, C C_t' v.

    Tilt by the force, (0.12 / 3 + 0.02^2) / g^2 over 0.4 s; the gyro's bias by the mean rate.
    """
    state = flying(13, UNAIDED, sigma=0.02)
    state["velocity_ned_m_s"] = (0.3, -0.2, 0.1)
    state["mean_rate_rad_s"] = state["gyro_bias_rad_s"] + [0.004, -0.003, 0.002]
    state["tilt_innovation_rad"] = (0.01, -0.02)
    state["force_variance"] = 0.12
    before = state.copy()

    def measure(truth):
        velocity = before["dcm"] @ truth["dcm"].T @ truth["velocity_ned_m_s"]
        tilt = tilt_seen(truth, before, truth["dcm"].T @ [0.0, 0.0, -G])
        return np.concatenate([velocity, tilt, truth["gyro_bias_rad_s"]])

    innovations = [-0.3, 0.2, -0.1, 0.01, -0.02, 0.004, -0.003, 0.002]
    variances = [0.01] * 3 + [0.0404 / G**2 * 0.4 / TURN_S] * 2 + [0.003**2 * 0.2 / TURN_S] * 3
    zero_velocity.hold(state, TURN_S, 0.003)
    assert_updated(state, before, rows_of(measure, before), innovations, variances)


def remembered(state, velocity, slope, seconds=2.0):
    """Let the filter have flown with an even acceleration [m/s^2] until now, update by update."""
    now_ns, step_ns = 60 * 10**9, 120_000_000
    for k in range(round(seconds / TURN_S), -1, -1):
        state["time_ns"] = now_ns - k * step_ns
        state["velocity_ned_m_s"] = velocity - slope * (k * TURN_S)
        ground_velocity.remember(state)


@pytest.mark.parametrize("share", [0.2, 1.0])
def test_a_measured_velocity_is_that_of_a_lag_ago(share):
    """m = v(t - lag): where the vehicle speeds up, a larger lag means less velocity.

    1-sigma 0.5 m/s; an innovation beyond 4 of its sigmas counts less by its square.
    """
    state = flying(14, AIDED, sigma=0.05)
    velocity, slope = np.array([6.0, -3.0, 0.5]), np.array([3.0, -2.0, 1.0])
    remembered(state, velocity, slope)
    # In the middle between two stored updates, 90 ms and 210 ms ago.
    state["velocity_lag_s"] = 0.2
    missed = share * np.array([0.5, -0.4, 0.3])
    state["measured_velocity_m_s"] = velocity - 0.2 * slope + missed
    state["measured_time_ns"], state["measured_new"] = state["time_ns"], 1
    before = state.copy()

    def measure(truth):
        shifted = truth["velocity_ned_m_s"] - before["velocity_ned_m_s"]
        return velocity + shifted - truth["velocity_lag_s"] * slope

    settings = pipeline.parameters(Settings())[0]
    ground_velocity.correct_velocity(settings, state, Airframe.FIXED_WING)
    assert_updated(state, before, rows_of(measure, before), missed, [0.25] * 3)
    assert state["measured_new"] == 0


def test_a_velocity_far_out_counts_less_by_its_square():
    """20 m/s off, expected 1 + 0.25: 320 sigma^2, so the variance is 0.25 * 320 / 16 = 5.

    The correction is 20 * 1 / (1 + 5) = 3.33 m/s instead of 16. With a lag uncertain by 0.1 s at
    5 m/s^2 0.25 more is expected: 400 / 1.5 = 266.67 sigma^2, a variance of 4.1667 and so
    20 / (1 + 0.25 + 4.1667) = 3.692.
    """
    settings = pipeline.parameters(Settings())[0]
    for slope, expected in ((0.0, 20.0 / 6.0), (5.0, 20.0 / 5.4166667)):
        state = flying(15, AIDED)
        state["covariance"] = np.diag([0.0] * 6 + [1.0] * 3 + [0.0] * 14 + [0.01])
        remembered(state, np.zeros(3), np.array([slope, 0.0, 0.0]))
        state["measured_velocity_m_s"] = (20.0, np.nan, np.nan)
        state["measured_time_ns"], state["measured_new"] = state["time_ns"] - 120_000_000, 1
        state["measured_velocity_m_s"][0] -= 0.12 * slope
        ground_velocity.correct_velocity(settings, state, Airframe.OTHER)
        assert state["correction"][VELOCITY] == pytest.approx(expected, rel=1e-6)
        # The mean square, bounded by 50, of which 0.05 is taken.
        assert state["velocity_nis"] == pytest.approx(2.5)
