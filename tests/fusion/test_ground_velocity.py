"""A measured velocity over ground: found its heading and lag, doubted, lost, and let go."""

import numpy as np
import pytest

from ahrs_service.estimator import Estimator
from ahrs_service.fusion import ground_velocity, heading, states
from ahrs_service.records import Airframe, Flag
from ahrs_service.rotation import inverse_columns, multiply_columns
from ahrs_service.simulation.samples import samples_of
from ahrs_service.simulation.scenario import make_flight

RATE_HZ = 100
EVERY = 20


@pytest.fixture(scope="module")
def flight():
    return make_flight("flight", 90.0, seed=3, rate_hz=RATE_HZ)


def heard(flight, lag_s=0.0, airframe=Airframe.FIXED_WING, rotated_rad=0.0, magnetometer=False):
    """Samples [N] with a receiver's velocity at 5 Hz, with this delay and axes rotated by this."""
    samples = samples_of(flight, airframe, magnetometer=magnetometer).copy()
    now = np.arange(0, len(samples), EVERY)
    then = np.maximum(now - round(lag_s * RATE_HZ), 0)
    north, east = flight.rows["velocity_ned_m_s"][then, :2].T
    c, s = np.cos(rotated_rad), np.sin(rotated_rad)
    samples["velocity_ned_m_s"][now, 0] = c * north - s * east
    samples["velocity_ned_m_s"][now, 1] = s * north + c * east
    return samples


def noisy(samples, seed):
    """The same with white noise [m/s] in each velocity."""
    samples, rng = samples.copy(), np.random.default_rng(seed)
    samples["velocity_ned_m_s"][:, :2] += rng.normal(
        0.0, ground_velocity.SIGMA_M_S, (len(samples), 2)
    )
    return samples


def run(samples):
    estimator = Estimator()
    return estimator.run(samples), estimator.state[0]


def errors_deg(estimates, truth):
    """Tilt error and heading error [N] [deg]."""
    e = multiply_columns(estimates["ned_from_body"], inverse_columns(truth))
    tilt = 2.0 * np.arccos(np.minimum(np.hypot(e[:, 0], e[:, 3]), 1.0))
    turn = 2.0 * np.arctan2(e[:, 3], e[:, 0])
    return np.degrees(tilt), np.degrees(np.arctan2(np.sin(turn), np.cos(turn)))


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("lag_s", [0.0, 0.1, 0.3])
def test_the_lag_is_learnt_and_the_attitude_better_for_it(flight, lag_s):
    truth = flight.rows["ned_from_body"]
    estimates, state = run(heard(flight, lag_s))
    alone, _ = run(samples_of(flight, Airframe.FIXED_WING))
    assert state["states"] == states.AIDED
    assert state["velocity_lag_s"] == pytest.approx(lag_s, abs=0.06)
    tilt, turn = errors_deg(estimates, truth)
    assert rms(tilt[2000:]) < rms(errors_deg(alone, truth)[0][2000:])
    assert state["heading_source"] == heading.VELOCITY
    assert rms(turn[6000:]) < 10.0
    sigma = estimates["attitude_sigma_rad"][6000:, 2]
    assert np.mean(np.abs(turn[6000:]) < 2.0 * np.degrees(sigma)) > 0.9


def test_a_velocity_with_every_sample_counts_no_more_than_that_of_a_receiver(flight):
    """A hundred a second share their error: the filter may not be surer for them than for 5."""
    samples = heard(flight)
    often = samples.copy()
    often["velocity_ned_m_s"][:, :2] = flight.rows["velocity_ned_m_s"][:, :2]
    (_, state), (_, state_often) = run(samples), run(often)
    assert state_often["states"] == states.AIDED
    for first in (states.ANGLE, states.VELOCITY):
        sigma, sigma_often = (
            np.sqrt(np.diag(one["covariance"])[first : first + 2]) for one in (state, state_often)
        )
        assert (sigma_often > 0.7 * sigma).all()


def test_the_wind_is_reported_from_the_airspeed(flight):
    samples = heard(flight)
    samples["airspeed_m_s"][::EVERY] = flight.rows["airspeed_m_s"][::EVERY]
    _, state = run(samples)
    assert 1.0 < np.hypot(*state["wind_ned_m_s"][:2]) < 7.0


def test_without_a_nose_the_heading_comes_from_how_both_velocities_change(flight):
    """From the middle of the flight, in a turn: the course is never used as the heading."""
    start = 3000
    samples = heard(flight, 0.1, Airframe.OTHER)[start:]
    estimates, state = run(samples)
    assert state["heading_source"] == heading.VELOCITY
    _, turn = errors_deg(estimates, flight.rows["ned_from_body"][start:])
    assert rms(turn[-1000:]) < 20.0


@pytest.mark.parametrize("seed", [0, 1])
def test_a_receiver_as_noisy_as_assumed_gives_the_heading(flight, seed):
    """Its changes are mostly noise, but many of them together determine the heading."""
    start = 3000
    samples = noisy(heard(flight, 0.1, Airframe.OTHER)[start:], seed)
    estimates, state = run(samples)
    assert state["states"] == states.AIDED
    _, turn = errors_deg(estimates, flight.rows["ned_from_body"][start:])
    assert rms(turn[-1000:]) < 20.0


@pytest.mark.parametrize("seed", [0, 1])
def test_noise_alone_gives_no_heading(flight, seed):
    samples = heard(flight, 0.1, Airframe.OTHER)
    samples["velocity_ned_m_s"] *= 0.0
    _, state = run(noisy(samples, seed))
    assert state["states"] == states.UNAIDED


def test_a_velocity_in_other_axes_than_the_compass_is_let_go(flight):
    """The tilt is hardly worse than without, and the service goes on."""
    truth = flight.rows["ned_from_body"]
    wrong = heard(flight, rotated_rad=2.0, magnetometer=True)
    estimates, state = run(wrong)
    alone, _ = run(samples_of(flight, Airframe.FIXED_WING))
    assert state["states"] == states.UNAIDED
    assert rms(errors_deg(estimates, truth)[0][2000:]) < 1.5 + 2.0 * rms(
        errors_deg(alone, truth)[0][2000:]
    )


def test_a_magnetometer_that_comes_later_takes_over_where_the_velocity_vanishes(flight):
    """The heading is that of the velocity as long as there is one, and does not run free then."""
    samples = heard(flight)
    fields = samples_of(flight, Airframe.FIXED_WING, magnetometer=True)["mag_ut"]
    samples["mag_ut"][3000:] = fields[3000:]
    _, early = run(samples[:5000])
    assert early["heading_source"] == heading.VELOCITY
    samples["velocity_ned_m_s"][5000:] = np.nan
    estimates, state = run(samples)
    assert state["heading_source"] == heading.FIELD
    free = samples.copy()
    free["mag_ut"] = np.nan
    sigma, sigma_free = (one["attitude_sigma_rad"][-1, 2] for one in (estimates, run(free)[0]))
    assert sigma < sigma_free
    turn = errors_deg(estimates, flight.rows["ned_from_body"])[1][6000:]
    assert rms(turn) < 10.0


def test_numbers_without_sense_move_nothing_for_long(flight):
    truth, rng = flight.rows["ned_from_body"], np.random.default_rng(1)
    samples = heard(flight)
    known = np.isfinite(samples["velocity_ned_m_s"][:, 0])
    samples["velocity_ned_m_s"][known, :2] = rng.normal(0.0, 15.0, (known.sum(), 2))
    tilt, _ = errors_deg(run(samples)[0], truth)
    assert rms(tilt[2000:]) < 6.0


def test_where_it_vanishes_the_class_takes_over(flight):
    samples = heard(flight, 0.1)
    samples["velocity_ned_m_s"][4000:] = np.nan
    tilt, _ = errors_deg(run(samples)[0], flight.rows["ned_from_body"])
    assert rms(tilt[4000:]) < 3.0


@pytest.mark.parametrize("magnetometer", [False, True])
@pytest.mark.parametrize("start_s", [21, 24, 38])
@pytest.mark.parametrize("away_s", [0.7, 2.0, 4.0])
def test_over_a_gap_in_a_manoeuvre_the_velocity_does_no_harm(flight, magnetometer, start_s, away_s):
    keep = np.ones(len(flight.rows), bool)
    keep[start_s * RATE_HZ : int((start_s + away_s) * RATE_HZ)] = False
    samples = heard(flight, magnetometer=magnetometer)[keep]
    estimates, state = run(samples)
    tilt, _ = errors_deg(estimates, flight.rows["ned_from_body"][keep])
    assert tilt[start_s * RATE_HZ + 1000 :].max() < 15.0
    assert state["states"] == states.AIDED


def test_another_imu_gives_up_what_was_compared_before(flight):
    """The rotation to the heading found once is not repeated."""
    samples = heard(flight, 0.1, Airframe.OTHER)
    samples["flags"][6500] = int(Flag.IMU_CHANGED)
    estimates, _ = run(samples)
    _, turn = errors_deg(estimates, flight.rows["ned_from_body"])
    assert np.abs(turn[6510:7000] - turn[6400]).max() < 15.0


def test_an_airspeed_that_nothing_flies_moves_nothing(flight):
    samples = samples_of(flight, Airframe.FIXED_WING).copy()
    without, _ = run(samples)
    samples["airspeed_m_s"][::10] = 1e6
    absurd, _ = run(samples)
    assert absurd["ned_from_body"].tobytes() == without["ned_from_body"].tobytes()
