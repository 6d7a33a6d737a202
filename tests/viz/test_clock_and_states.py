"""Time since the first sample across clock jumps, and states kept on change only."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ahrs_service.records import ESTIMATE_DTYPE, Flag, Gate, Phase, empty
from ahrs_service.viz import state_lanes
from ahrs_service.viz.clock import Clock

S = 1_000_000_000


def rows(time_s, received_s=None):
    made = empty(ESTIMATE_DTYPE, len(time_s))
    made["time_ns"] = np.round(np.array(time_s) * S)
    made["received_ns"] = np.round(np.array(time_s if received_s is None else received_s) * S)
    return made


def test_t_is_time_since_the_first_sample():
    clock = Clock()
    assert clock.estimates(rows([100.0, 100.5, 130.0])).tolist() == [0, S // 2, 30 * S]
    assert clock.now_ns == 30 * S
    assert clock.live(np.array([129 * S])).tolist() == [29 * S]


def test_after_a_reboot_t_goes_on_by_the_receivers_clock():
    clock = Clock()
    t = clock.estimates(rows([500.0, 501.0, 2.0, 3.0], [10.0, 11.0, 15.0, 16.0]))
    assert t.tolist() == [0, S, 5 * S, 6 * S]
    assert clock.whole(np.array([500, 501, 3, 4]) * S).tolist() == [0, S, 6 * S, 7 * S]


def test_a_clock_set_to_the_date_is_no_flight_of_fifty_years():
    clock = Clock()
    assert clock.estimates(rows([5.0], [0.0])).tolist() == [0]
    assert clock.estimates(rows([1.7e9, 1.7e9 + 1], [0.5, 1.5])).tolist() == [S // 2, 3 * S // 2]
    assert clock.live(np.array([6 * S])).tolist() == [3 * S // 2]


def test_a_late_sample_is_no_jump():
    assert Clock().estimates(rows([5.0, 4.9, 5.1])).tolist() == [0, -S // 10, S // 10]


@given(
    st.lists(st.integers(-20, 900), min_size=1, max_size=60),
    st.lists(st.integers(0, 59), max_size=5),
)
def test_pieces_make_no_difference_to_t(steps, cuts):
    made = rows(np.cumsum(steps) * 1.0, np.arange(len(steps)) * 0.5)
    whole, pieces = Clock(), Clock()
    bounds = sorted({0, len(made), *(min(cut, len(made)) for cut in cuts)})
    joined = [pieces.estimates(made[a:b]) for a, b in pairwise(bounds)]
    assert np.concatenate(joined).tolist() == whole.estimates(made).tolist()


def test_a_reading_before_any_sample_is_at_zero():
    assert Clock().live(np.array([5 * S])).tolist() == [0]
    assert Clock().whole(np.array([5 * S])).tolist() == [0]


def test_every_reason_has_its_words_and_colour():
    assert (
        len(state_lanes.GATE_TEXTS)
        == len(set(state_lanes.GATE_TEXTS))
        == len(state_lanes.GATE_COLOURS)
    )
    assert state_lanes.GATE_TEXTS[Gate.NORM | Gate.RATE] == "closed: norm + rate"
    assert state_lanes.GATE_TEXTS[Gate.STALE] == "closed: stale"
    assert state_lanes.GATE_COLOURS[Gate.OPEN] == state_lanes.GREEN
    assert state_lanes.GATE_COLOURS[Gate.ANGULAR_ACCELERATION] == state_lanes.AMBER
    assert state_lanes.GATE_COLOURS[Gate.INNOVATION | Gate.RATE] == state_lanes.ORANGE
    assert state_lanes.GATE_COLOURS[Gate.SATURATION | Gate.INNOVATION] == state_lanes.RED
    for flag in Gate:
        assert state_lanes.GATE_COLOURS[flag] != state_lanes.GREEN


def test_phase_comes_before_gate():
    made = empty(ESTIMATE_DTYPE, 3)
    made["phase"] = [Phase.WAITING, Phase.ALIGNING, Phase.RUNNING]
    made["gate"] = Gate.STALE
    texts = [state_lanes.GATE_TEXTS[code] for code in state_lanes.gate_codes(made)]
    assert texts == ["waiting", "aligning", "closed: stale"]


def test_flags_are_named():
    assert state_lanes.flag_text(0) == "good"
    assert state_lanes.flag_text(Flag.CLOCK_JUMP | Flag.LOW_RATE) == "clock jump + low rate"


@given(st.lists(st.integers(0, 2), max_size=40), st.integers(0, 40))
def test_changes_are_kept_and_nothing_else(codes, cut):
    array, changes = np.array(codes, np.int64), state_lanes.Changes()
    cut = min(cut, len(codes))
    kept = [*changes.of(array[:cut]), *(changes.of(array[cut:]) + cut)]
    assert kept == [i for i in range(len(codes)) if i == 0 or codes[i] != codes[i - 1]]
