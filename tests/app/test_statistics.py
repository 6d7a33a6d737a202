"""Latency percentiles and the gate's shares of time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ahrs_service.app.statistics import GateShares, Latency, gate_shares, gate_text
from ahrs_service.records import ESTIMATE_DTYPE, Gate, Phase, empty


def estimates(steps_ns, phases, gates):
    rows = empty(ESTIMATE_DTYPE, len(steps_ns))
    rows["time_ns"] = 5_000_000_000 + np.cumsum(steps_ns)
    rows["phase"], rows["gate"] = phases, gates
    return rows


def test_percentiles_are_of_what_was_added():
    latency = Latency()
    assert np.isnan(latency.percentiles_ms()).all()
    for value in range(1, 1001):
        latency.add(value * 1e-6)
    p50, p99, most = latency.percentiles_ms()
    assert p50 == pytest.approx(0.5005)
    assert p99 == pytest.approx(0.99001)
    assert most == pytest.approx(1.0)
    assert latency.count == 1000


def test_only_the_last_latencies_count():
    latency = Latency()
    latency.add(10.0)
    for _ in range(65536):
        latency.add(0.001)
    assert latency.percentiles_ms() == pytest.approx((1.0, 1.0, 1.0))
    assert latency.count == 65537


@pytest.mark.parametrize(
    ("phase", "gate", "text"),
    [
        (Phase.RUNNING, Gate.OPEN, "open"),
        (Phase.RUNNING, Gate.NORM, "closed: norm"),
        (Phase.RUNNING, Gate.NORM | Gate.STALE, "closed: norm + stale"),
        (Phase.RUNNING, Gate.ANGULAR_ACCELERATION, "closed: angular acceleration"),
        (Phase.ALIGNING, Gate.NORM, "aligning"),
        (Phase.WAITING, Gate.OPEN, "waiting"),
    ],
)  # fmt: skip
def test_the_gate_in_words(phase, gate, text):
    assert gate_text(phase, gate) == text


def test_shares_by_hand():
    rows = estimates(
        [0, 100, 100, 300, 500], [2, 2, 2, 2, 2], [0, 0, Gate.NORM, Gate.NORM, 0]
    )  # fmt: skip
    assert gate_shares(rows) == pytest.approx({"open": 0.6, "closed: norm": 0.4})


def test_gaps_and_steps_back_take_no_time():
    rows = estimates([0, 100, 2_000_000_000, -500, 100], [2] * 5, [0, 0, 1, 1, 0])
    assert gate_shares(rows) == {"open": 1.0}


def test_states_of_one_name_are_added_up():
    rows = estimates([0, 100, 100, 200], [1, 1, 1, 2], [0, 0, Gate.NORM, 0])
    assert gate_shares(rows) == pytest.approx({"aligning": 0.5, "open": 0.5})


@settings(deadline=None)
@given(
    rows=st.lists(
        st.tuples(
            st.integers(-2_000_000_000, 2_000_000_000) | st.integers(1, 10_000_000),
            st.sampled_from(list(Phase)),
            st.integers(0, 63),
        ),
        min_size=1,
        max_size=60,
    )
)
def test_live_and_recorded_shares_agree(rows):
    table = estimates(*(np.array(column) for column in zip(*rows, strict=True)))
    live = GateShares()
    for row in table:
        live.add(row)
    recorded = gate_shares(table)
    assert live.shares() == pytest.approx(recorded)
    total = sum(recorded.values())
    assert total == pytest.approx(1.0) or not recorded


def test_no_estimates_have_no_shares():
    assert gate_shares(empty(ESTIMATE_DTYPE, 0)) == {}
    assert GateShares().shares() == {}
