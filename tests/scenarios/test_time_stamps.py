"""Clocks that jump, frames that come twice or late."""

import numpy as np
import pytest

from ahrs_service.pipeline import REALIGN_GAP_S
from ahrs_service.records import Flag, Phase
from ahrs_service.settings import IntakeSettings, Settings

IMU = ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU")
UNIX_US = 1_767_261_597_000_000


def moved(frames, order):
    """The frames' bytes in another order; the times of receipt stay where they are."""
    kind = type(frames[0])
    return [
        kind(frame.t_s, frame.received_us, frames[n].data, frames[n].message)
        for frame, n in zip(frames, order, strict=True)
    ]


def reordered(recorded, order, every=None, start_s=5.0):
    """Every `every` HIGHRES_IMU frames (once if None), take `order` of those that follow."""
    frames = list(recorded.frames)
    places = [n for n, one in enumerate(frames) if one.name == "HIGHRES_IMU" and one.t_s >= start_s]
    for first in range(0, len(places) - len(order), every or len(places)):
        block = places[first : first + len(order)]
        for n, frame in zip(block, moved([frames[n] for n in block], order), strict=True):
            frames[n] = frame
    return recorded._with(frames)


def received(recorded, shift_s, start_s):
    """The host's clock is set at `start_s`."""
    frames = [
        type(one)(one.t_s, one.received_us + round(shift_s * 1e6), one.data, one.message)
        if one.t_s >= start_s
        else one
        for one in recorded.frames
    ]
    return recorded._with(frames)


@pytest.mark.parametrize("seconds", [-4.0, 3600.0])
def test_a_clock_that_jumps_while_samples_keep_coming_keeps_the_attitude(base, unedited, seconds):
    original, start_s = unedited(base), base.calm_s
    if seconds < 0.0:
        # A clock cannot go below zero.
        base = base.shift_clock(10.0, 0.0)
    outcome = base.shift_clock(seconds, start_s).replay()
    assert outcome.new_flags(original) == {"clock_jump": 1}
    assert outcome.counters() == original.counters() | {"clock_jumps": 1}
    assert outcome.when(Flag.CLOCK_JUMP) == pytest.approx([start_s], abs=0.05)
    assert outcome.estimates["phase"].tobytes() == original.estimates["phase"].tobytes()
    assert outcome.is_as(original, 0.0, start_s)
    assert outcome.turn_from(original, start_s) < 0.2
    sigma = outcome.estimates["attitude_sigma_rad"]
    # Turns end at other samples now, and so does the moment when rest is found.
    alike = np.isclose(sigma, original.estimates["attitude_sigma_rad"], rtol=0.05)
    assert alike.mean() > 0.99
    said = [text for t_s, text in outcome.health() if start_s <= t_s < start_s + 4.0]
    assert said == ["degraded; the autopilot's clock jumped", "good"]


@pytest.mark.parametrize("back_s", [100.0, 0.5])
@pytest.mark.parametrize("away_s", [1.0, 3.0, 8.0])
def test_a_reboot_with_the_imu_away_is_a_gap_of_the_time_between_receipts(
    base, unedited, away_s, back_s
):
    """The clock begins at an earlier time, by a lot or so little that samples look late."""
    original, start_s = unedited(base), base.calm_s
    away = base.shift_clock(100.0, 0.0).drop(IMU, start_s, start_s + away_s)
    unbroken = away.replay()
    outcome = away.shift_clock(-away_s - back_s, start_s + away_s).replay()
    found, late = outcome.new_flags(original), 5 if back_s < 1.0 else 0
    expected = unbroken.new_flags(original) | {"clock_jump": 1}
    assert found == expected | ({"reordered": late} if late else {})
    assert found["gap"] == 1
    assert found.get("realigned", 0) == (away_s > REALIGN_GAP_S)
    (jump,) = np.flatnonzero(outcome.estimates["flags"] & Flag.CLOCK_JUMP)
    row = outcome.estimates[jump]
    assert row["flags"] & Flag.GAP
    assert (row["phase"] == Phase.ALIGNING) == (away_s > REALIGN_GAP_S)
    assert row["attitude_sigma_rad"][0] > 2.0 * outcome.estimates["attitude_sigma_rad"][jump - 1, 0]
    assert outcome.t_s[jump - late] == pytest.approx(start_s + away_s, abs=0.05)
    # From the jump on it is as after the same gap under a clock that went on.
    soon_s = outcome.t_s[jump]
    # Late samples cost it 25 ms of motion, and an alignment begins with another force.
    bound_deg = 0.2 if not late else 4.0 if away_s < REALIGN_GAP_S else 15.0
    assert outcome.tilt_from(unbroken, soon_s, soon_s + 4.0) < bound_deg
    assert np.isfinite(outcome.estimates["ned_from_body"]).all()


def test_one_wild_stamp_costs_two_intervals_and_no_more(base, unedited):
    def ahead(message):
        message.time_usec += 1_000_000_000

    original, start_s = unedited(base), base.calm_s
    outcome = base.change(("HIGHRES_IMU",), ahead, start_s, count=1).replay()
    assert outcome.new_flags(original) == {"clock_jump": 2}
    assert np.diff(np.flatnonzero(outcome.estimates["flags"] & Flag.CLOCK_JUMP)) == [1]
    assert outcome.estimates["phase"].tobytes() == original.estimates["phase"].tobytes()
    assert outcome.turn_from(original) < 0.2


def test_every_frame_twice_changes_nothing(base, unedited):
    original = unedited(base)
    outcome = base.edit(lambda frame: [frame, frame], 5.0).replay()
    twice = outcome.estimates["flags"] & Flag.DUPLICATE != 0
    assert outcome.counters()["duplicates"] == np.count_nonzero(twice)
    assert np.count_nonzero(~twice) == len(original.estimates)
    same = outcome.estimates[~twice]
    for field in ("time_ns", "ned_from_body", "attitude_sigma_rad", "gate", "phase", "flags"):
        assert same[field].tobytes() == original.estimates[field].tobytes(), field
    repeated = outcome.estimates["ned_from_body"][twice]
    assert repeated.tobytes() == outcome.estimates["ned_from_body"][
        np.flatnonzero(twice) - 1
    ].tobytes()  # fmt: skip


@pytest.mark.parametrize(
    ("order", "every", "late"),
    [((1, 0), 50, 1), ((1, 0), 4, 1), ((3, 4, 5, 0, 1, 2), None, 3), ((2, 1, 0), None, 2)],
    ids=["now and then", "in a row", "overtaken datagram", "backwards"],
)
def test_frames_out_of_order_are_left_out(base, unedited, order, every, late):
    original = unedited(base)
    outcome = reordered(base, order, every, base.calm_s).replay()
    found = outcome.new_flags(original)
    assert set(found) == {"reordered"}
    assert outcome.counters()["reordered"] == found["reordered"]
    assert found["reordered"] % late == 0
    assert (found["reordered"] == late) == (every is None)
    assert outcome.tilt_from(original) < 5.0
    if every is None:
        assert outcome.tilt_from(original) < 2.0


def test_a_clock_set_back_a_little_is_found_after_a_few_samples(base, unedited):
    original, start_s = unedited(base), base.calm_s
    outcome = base.shift_clock(-0.5, start_s).replay()
    assert outcome.new_flags(original) == {"reordered": 5, "clock_jump": 1}
    (jump,) = np.flatnonzero(outcome.estimates["flags"] & Flag.CLOCK_JUMP)
    late = np.flatnonzero(outcome.estimates["flags"] & Flag.REORDERED)[-5:]
    assert late.tolist() == list(range(jump - 5, jump))
    assert outcome.estimates["phase"].tobytes() == original.estimates["phase"].tobytes()
    # The rotation of the missing samples is bridged, and little is left to correct.
    soon_s = outcome.t_s[jump]
    assert outcome.tilt_from(original, soon_s, soon_s + 2.0) < 1.5
    assert outcome.tilt_from(original, soon_s + 2.0, soon_s + 4.0) < 1.0


def test_stamps_since_1970_serve_as_well_as_those_since_boot(base, unedited):
    def unix(message):
        message.time_usec += UNIX_US

    original = unedited(base)
    outcome = base.change(("HIGHRES_IMU", "RAW_IMU"), unix).replay()
    assert outcome.new_flags(original) == {}
    assert outcome.is_as(original)
    assert (outcome.estimates["time_ns"] - original.estimates["time_ns"] == UNIX_US * 1000).all()


def test_two_messages_with_different_clocks_alternate_without_realignment(flight, unedited):
    def unix(message):
        message.time_usec += UNIX_US

    stopped = flight.drop(("HIGHRES_IMU",), 20.0, 25.0)
    same_clock, two_clocks = stopped.replay(), stopped.change(("HIGHRES_IMU",), unix)
    settings = Settings(intake=IntakeSettings(imu_source="highres_imu"))
    assert two_clocks.replay(settings).counters()["clock_jumps"] == 0
    outcome = two_clocks.replay()
    # At the start RAW_IMU comes first; then to RAW_IMU and back.
    assert outcome.new_flags(same_clock) == {"clock_jump": 3}
    jumped = outcome.with_flag(Flag.CLOCK_JUMP)
    assert (jumped["flags"] & Flag.SOURCE_CHANGED != 0).all()
    assert (outcome.estimates["phase"][outcome.t_s > 5.0] == Phase.RUNNING).all()
    # Turns end at other samples: 0.5 deg apart at 20 s, four times that in the manoeuvre after it.
    assert outcome.tilt_from(same_clock, 0.0, 20.0) < 1.0
    assert outcome.tilt_from(same_clock, 20.0, 26.0) < 2.0


@pytest.mark.parametrize("shift_s", [3600.0, -3600.0])
def test_the_hosts_clock_may_be_set(base, unedited, shift_s):
    original = unedited(base)
    outcome = received(base, shift_s, 20.0).replay()
    assert set(outcome.new_flags(original)) <= {"temperature_stale"}
    attitudes = outcome.estimates["ned_from_body"]
    assert attitudes.tobytes() == original.estimates["ned_from_body"].tobytes()
