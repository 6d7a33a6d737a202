import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ahrs_service.links.component.attitude_messages import (
    Cadence,
    Publisher,
    attitude_quaternion,
    boot_ms,
    named_values,
)
from ahrs_service.links.mavlink.codec import Encoder, decode_frame
from ahrs_service.records import ESTIMATE_DTYPE, empty
from ahrs_service.rotation import quaternion_columns
from ahrs_service.settings import PublishSettings

MS = 1_000_000
S = 1_000_000_000


def sent_at(rate_hz, stamps_ns):
    cadence = Cadence(rate_hz)
    return [int(stamp) for stamp in stamps_ns if cadence.due(int(stamp))]


def test_50_hz_out_of_200_hz_is_every_fourth_sample():
    stamps = np.arange(4000) * 5 * MS
    assert sent_at(50.0, stamps) == list(range(0, 20 * S, 20 * MS))


def test_stamps_in_microseconds_with_jitter_cost_no_period():
    rng = np.random.default_rng(5)
    stamps = np.arange(20_000) * 5 * MS + rng.integers(-400_000, 400_000, 20_000)
    assert len(sent_at(50.0, stamps)) == 5000
    assert np.diff(sent_at(50.0, stamps)).max() <= 26 * MS


@pytest.mark.parametrize("rate_hz", [50.0, 25.0, 10.0, 30.0])
def test_the_mean_rate_holds_on_a_loop_of_400_hz_that_sends_333(rate_hz):
    """ArduPilot at 333 Hz: steps of 2.5 and 5 ms, whole periods of its loop."""
    turn = np.ceil(np.arange(33_300) * 3.0 / 2.5)
    stamps = (turn * 2.5 * MS).astype(np.int64)
    assert set(np.diff(stamps)) == {2_500_000, 5_000_000}
    sent = sent_at(rate_hz, stamps)
    assert len(sent) == pytest.approx(rate_hz * stamps[-1] / S, abs=2)
    assert max(np.diff(sent)) <= S / rate_hz + 5 * MS


@pytest.mark.parametrize("rate_hz", [201.0, 1000.0, 1e6, 1e12])
def test_a_rate_above_the_samples_sends_each_once(rate_hz):
    stamps = np.arange(1000) * 5 * MS
    assert sent_at(rate_hz, stamps) == stamps.tolist()


@pytest.mark.parametrize("rate_hz", [0.0, -1.0])
def test_a_rate_of_zero_sends_nothing(rate_hz):
    assert sent_at(rate_hz, range(0, S, MS)) == []


@pytest.mark.parametrize("rate_hz", [0.1, 0.5, 1.0, 1e-30])
def test_slow_rates_keep_their_period(rate_hz):
    sent = sent_at(rate_hz, np.arange(6000) * 10 * MS)
    assert len(sent) == max(1, round(60 * rate_hz))
    assert np.diff(sent).tolist() == [round(S / rate_hz)] * (len(sent) - 1)


@pytest.mark.parametrize("jump_s", [-1e6, -3600.0, -1.0, -0.05, 0.3, 0.999, 1.0, 3600.0, 1e9])
def test_after_a_clock_jump_it_goes_on_within_three_periods(jump_s):
    before = np.arange(200) * 5 * MS + 2_000_000 * S
    after = before + S + int(jump_s * S)
    sent = sent_at(50.0, np.concatenate([before, after]))
    assert sent[:50] == before[::4].tolist()
    assert sent[50] - after[0] <= 60 * MS
    assert 47 <= len(sent) - 50 <= 51
    assert set(np.diff(sent[51:])) == {20 * MS}


def test_a_sample_given_twice_is_sent_once():
    assert sent_at(50.0, np.repeat(np.arange(100) * 20 * MS, 2)) == list(range(0, 2 * S, 20 * MS))


@given(
    st.floats(0.01, 2000.0),
    st.lists(st.integers(-(2**62), 2**62), max_size=50),
)
def test_any_stamps_give_the_same_twice_and_the_first_is_sent(rate_hz, stamps):
    sent = sent_at(rate_hz, stamps)
    assert sent == sent_at(rate_hz, stamps)
    assert sent[:1] == stamps[:1]


@given(st.floats(1.0, 400.0), st.lists(st.integers(500_000, 20 * MS), min_size=2, max_size=300))
def test_a_forward_clock_never_gets_more_than_the_rate(rate_hz, steps):
    stamps = np.cumsum(steps)
    sent = sent_at(rate_hz, stamps)
    assert len(sent) <= (stamps[-1] - stamps[0]) * rate_hz / S + 2


@pytest.fixture
def estimate():
    row = empty(ESTIMATE_DTYPE)[0]
    row["time_ns"] = 12_345_678_901
    row["ned_from_body"] = quaternion_columns([[0.1, -0.2, 2.5]])[0]
    row["rate_rad_s"] = [0.3, -0.4, 0.5]
    row["residual_m_s2"] = [1.0, -2.0, 2.0]
    row["attitude_sigma_rad"] = [0.03, 0.02, 0.9]
    row["gate"] = 5
    return row


def over_the_wire(message):
    return decode_frame(Encoder(1, 191).pack(message))


def test_attitude_is_the_estimate_in_32_bits(estimate):
    (message,) = Publisher(PublishSettings()).messages(estimate)
    message = over_the_wire(message)
    assert message.get_type() == "ATTITUDE"
    assert message.time_boot_ms == 12_345
    angles = [message.roll, message.pitch, message.yaw]
    np.testing.assert_allclose(angles, [0.1, -0.2, 2.5], rtol=1e-6)
    rates = [message.rollspeed, message.pitchspeed, message.yawspeed]
    np.testing.assert_allclose(rates, [0.3, -0.4, 0.5], rtol=1e-6)


def test_attitude_quaternion_is_w_x_y_z(estimate):
    message = over_the_wire(attitude_quaternion(estimate))
    found = [message.q1, message.q2, message.q3, message.q4]
    np.testing.assert_allclose(found, estimate["ned_from_body"], rtol=1e-6)
    assert message.yawspeed == np.float32(0.5)


def test_named_values_tell_gate_residual_and_tilt_sigma(estimate):
    values = {}
    for message in map(over_the_wire, named_values(estimate)):
        assert message.time_boot_ms == 12_345
        values[message.name] = message.value
    assert values == {"AhrsGate": 5.0, "AhrsResid": 3.0, "AhrsSigma": np.float32(0.03)}


def test_each_message_has_its_own_rate(estimate):
    publisher = Publisher(PublishSettings(50.0, 10.0, 2.0))
    names = []
    for n in range(2000):
        estimate["time_ns"] = n * 5 * MS
        names += [message.get_type() for message in publisher.messages(estimate)]
    counts = {name: names.count(name) for name in set(names)}
    assert counts == {"ATTITUDE": 500, "ATTITUDE_QUATERNION": 100, "NAMED_VALUE_FLOAT": 60}


@pytest.mark.parametrize(
    ("time_ns", "time_ms"),
    [(0, 0), (2**32 * MS, 0), (1_700_000_000 * S, 1_700_000_000_000 % 2**32), (-MS, 2**32 - 1)],
)
def test_time_wraps_as_32_bits_do(estimate, time_ns, time_ms):
    estimate["time_ns"] = time_ns
    assert boot_ms(estimate) == time_ms
    assert over_the_wire(Publisher(PublishSettings()).attitude(estimate)).time_boot_ms == time_ms


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e39, -1e300, 3.4e38])
def test_values_beyond_32_bits_are_sent_nonetheless(estimate, value):
    for name in ("rate_rad_s", "residual_m_s2", "attitude_sigma_rad"):
        estimate[name] = value
    settings = PublishSettings(50.0, 50.0, 50.0)
    frames = [over_the_wire(message) for message in Publisher(settings).messages(estimate)]
    assert len(frames) == 5
    if not math.isnan(value):
        assert math.copysign(frames[0].rollspeed, value) == frames[0].rollspeed != 0.0
