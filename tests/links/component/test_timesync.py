import random

import pytest

from ahrs_service.links.component.timesync import TimeSync
from ahrs_service.links.mavlink.codec import dialect

BOOT_NS = 5_000_000_000
"""The autopilot's clock when ours says 1000 s."""


def autopilot_ns(now_s):
    return round((now_s - 1000.0) * 1e9) + BOOT_NS


def exchange(sync, now_s, there_s, back_s, clock=autopilot_ns):
    (question,) = sync.tick(now_s)
    assert question.tc1 == 0
    reply = dialect.MAVLink_timesync_message(clock(now_s + there_s), question.ts1)
    assert sync.on_message(reply, now_s + there_s + back_s) == []


TRUE_OFFSET_NS = BOOT_NS - 1_000_000_000_000


def test_it_asks_once_a_second():
    sync = TimeSync()
    asked = [now for now in range(0, 100) if sync.tick(1000.0 + now * 0.05)]
    assert asked == [0, 20, 40, 60, 80]
    assert sync.offset_ns is None


def test_equal_delays_give_the_offset_itself():
    sync = TimeSync()
    exchange(sync, 1000.0, 0.01, 0.01)
    assert sync.offset_ns == pytest.approx(TRUE_OFFSET_NS, abs=1000)
    assert sync.round_trip_ns == pytest.approx(20_000_000, abs=1000)


@pytest.mark.parametrize(("there_s", "back_s"), [(0.02, 0.001), (0.001, 0.02), (0.3, 0.1)])
def test_unequal_delays_cost_at_most_half_the_round_trip(there_s, back_s):
    sync = TimeSync()
    exchange(sync, 1000.0, there_s, back_s)
    error_ns = sync.offset_ns - TRUE_OFFSET_NS
    assert error_ns == pytest.approx((there_s - back_s) / 2 * 1e9, abs=1000)
    assert abs(error_ns) <= sync.round_trip_ns / 2 + 1000


def test_the_shortest_round_trip_is_believed():
    sync = TimeSync()
    chance = random.Random(4)
    for second in range(9):
        exchange(sync, 1000.0 + second, chance.uniform(0.02, 0.2), chance.uniform(0.02, 0.2))
    exchange(sync, 1009.0, 0.002, 0.002)
    assert sync.offset_ns == pytest.approx(TRUE_OFFSET_NS, abs=1000)
    for second in range(10, 19):
        exchange(sync, 1000.0 + second, 0.2, 0.01)
        assert sync.round_trip_ns == pytest.approx(4_000_000, abs=1000)
    exchange(sync, 1020.0, 0.2, 0.01)
    assert sync.round_trip_ns == pytest.approx(210_000_000, abs=1000)


def test_foreign_repeated_late_and_early_replies_are_not_taken():
    sync = TimeSync()
    (question,) = sync.tick(1000.0)
    reply = dialect.MAVLink_timesync_message(BOOT_NS, question.ts1 + 1)
    sync.on_message(reply, 1000.01)
    assert sync.offset_ns is None
    reply.ts1 = question.ts1
    sync.on_message(reply, 1000.51)
    assert sync.offset_ns is None
    (question,) = sync.tick(1001.0)
    reply.ts1 = question.ts1
    sync.on_message(reply, 1000.9)
    assert sync.offset_ns is None
    exchange(sync, 1002.0, 0.1, 0.1)
    taken = sync.offset_ns
    reply.ts1, reply.tc1 = int(1002.0 * 1e9), 77
    sync.on_message(reply, 1002.3)
    assert (sync.offset_ns, sync.jumps) == (taken, 0)


def test_replies_to_questions_long_ago_are_forgotten():
    sync = TimeSync()
    questions = [sync.tick(1000.0 + second)[0] for second in range(1000)]
    for question in questions[:-10]:
        sync.on_message(dialect.MAVLink_timesync_message(BOOT_NS, question.ts1), 1000.0)
    assert sync.offset_ns is None


def test_a_restart_gives_a_new_offset_at_once():
    sync = TimeSync()
    for second in range(5):
        exchange(sync, 1000.0 + second, 0.002, 0.002)
    exchange(sync, 1005.0, 0.1, 0.1, lambda now_s: round((now_s - 1005.0) * 1e9) + 1)
    assert sync.jumps == 1
    assert sync.jump_ns == pytest.approx(-10e9, abs=1e6)
    assert sync.offset_ns == pytest.approx(-1005e9, abs=1e6)
    exchange(sync, 1006.0, 0.1, 0.1, lambda now_s: round((now_s - 1005.0) * 1e9))
    assert sync.jumps == 1


def test_drift_is_followed_and_is_no_restart():
    sync = TimeSync()
    for second in range(600):
        exchange(sync, 1000.0 + second, 0.01, 0.01, lambda now_s: round(now_s * 1.0001e9))
    assert sync.jumps == 0
    assert sync.offset_ns == pytest.approx(1600.0 * 1e5, abs=2e6)


def test_the_autopilots_own_question_is_answered():
    sync = TimeSync()
    (answer,) = sync.on_message(dialect.MAVLink_timesync_message(0, 123456789), 1000.5)
    assert (answer.tc1, answer.ts1) == (1_000_500_000_000, 123456789)
    assert sync.offset_ns is None
