"""Oracle of the reference track: a flight's truth, sampled at the rate of a reference."""

import dataclasses

import numpy as np
import pytest

from ahrs_service.simulation.reference_track import ReferenceTrack, continuous, smooth
from ahrs_service.simulation.scenario import make_flight

RATE_HZ = 400.0
NONE, NO_ROWS = np.zeros(0), np.zeros((0, 3))


@pytest.fixture(scope="module")
def truth():
    return make_flight("calm", 60.0, 1, RATE_HZ).rows


def track_of(rows):
    time_s = rows["time_s"]
    return ReferenceTrack(
        time_s, rows["ned_from_body"], time_s, rows["velocity_ned_m_s"], NONE, NO_ROWS
    )


def errors(truth, reference_hz):
    """RMS of rate and force [rad/s, m/s^2] while airborne, away from the ends."""
    seen = truth[:: round(RATE_HZ / reference_hz)]
    inside = truth[(truth["airborne"] > 0.99)]
    motion = track_of(seen).motion(inside["time_s"])
    return [
        float(np.sqrt(np.mean((motion[name] - inside[name]) ** 2)))
        for name in ("rate_rad_s", "force_m_s2")
    ]


def test_rate_and_force_come_at_third_order_from_an_exact_reference(truth):
    coarse, middle, fine = (np.array(errors(truth, hz)) for hz in (12.5, 25.0, 50.0))
    assert (fine < [1e-6, 1e-5]).all()
    # Exact references are interpolated: halving the interval divides by eight or more.
    assert (np.log2(middle / fine) > 2.9).all()
    assert (np.log2(coarse / middle) > 2.9).all()


def test_velocity_and_position_are_those_of_the_reference(truth):
    seen = truth[::8]
    motion = track_of(seen).motion(seen["time_s"])
    np.testing.assert_allclose(motion["ned_from_body"], seen["ned_from_body"], atol=1e-9)
    np.testing.assert_allclose(motion["velocity_ned_m_s"], seen["velocity_ned_m_s"], atol=1e-9)
    np.testing.assert_allclose(motion["position_ned_m"], seen["position_ned_m"], atol=2e-3)


def test_positions_serve_where_no_velocity_is_known(truth):
    seen = truth[::8]
    time_s = seen["time_s"]
    by_velocity = track_of(seen)
    by_position = dataclasses.replace(
        by_velocity,
        velocity_s=NONE,
        velocity_ned_m_s=NO_ROWS,
        position_s=time_s,
        position_ned_m=seen["position_ned_m"],
    )
    inside = time_s[seen["airborne"] > 0.99]
    expected, found = by_velocity.motion(inside), by_position.motion(inside)
    np.testing.assert_allclose(found["velocity_ned_m_s"], expected["velocity_ned_m_s"], atol=1e-3)
    np.testing.assert_allclose(found["force_m_s2"], expected["force_m_s2"], atol=0.01)


def test_without_velocity_it_is_at_rest(truth):
    seen = truth[::8]
    still = dataclasses.replace(track_of(seen), velocity_s=NONE, velocity_ned_m_s=NO_ROWS)
    motion = still.motion(seen["time_s"])
    np.testing.assert_allclose(np.linalg.norm(motion["force_m_s2"], axis=1), 9.80665)
    assert not motion["velocity_ned_m_s"].any()


def test_noise_is_smoothed_away_better_than_by_interpolation(truth):
    seen = truth[::8].copy()
    dice = np.random.default_rng(3)
    seen["ned_from_body"] += dice.normal(0.0, 5e-4, (len(seen), 4))
    seen["velocity_ned_m_s"] += dice.normal(0.0, 0.03, (len(seen), 3))
    inside = seen[(seen["airborne"] > 0.99)]
    exact = truth[::8][(seen["airborne"] > 0.99)]
    motion = track_of(seen).motion(inside["time_s"])
    error = motion["rate_rad_s"] - exact["rate_rad_s"]
    # White noise of s per component differentiated over 2 h: 2 s / h sqrt(1/2) [rad/s].
    assert error.std() < 0.5 * 2.0 * 5e-4 * 50.0 * np.sqrt(0.5)


def test_signs_of_quaternions_do_not_matter(truth):
    seen = truth[::8]
    flipped = seen.copy()
    flipped["ned_from_body"][1::2] *= -1.0
    np.testing.assert_array_equal(
        continuous(flipped["ned_from_body"]), continuous(seen["ned_from_body"])
    )


def test_the_span_is_what_all_parts_cover(truth):
    seen = truth[::8]
    track = dataclasses.replace(track_of(seen), velocity_s=seen["time_s"] + 1.0)
    assert track.span_s() == (1.0, 60.0)


def test_too_few_samples_are_refused(truth):
    with pytest.raises(ValueError, match=r"11 samples of attitude, 12 are needed"):
        smooth(truth["time_s"][:11], truth["ned_from_body"][:11], "attitude")
