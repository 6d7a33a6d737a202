import itertools
import pickle
import struct

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ahrs_service.records import ESTIMATE_DTYPE, Phase, empty
from ahrs_service.settings import IntakeSettings, LinkSettings, PublishSettings, Settings
from links.component import Component
from links.mavlink_codec import Encoder, decode_frame, dialect
from links.status_texts import StatusTexts

ARDUPILOT, INVALID = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, dialect.MAV_AUTOPILOT_INVALID
BOOT_WRAP_MS = 2**32


def heartbeat(autopilot=ARDUPILOT, kind=dialect.MAV_TYPE_FIXED_WING):
    return dialect.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3)


@pytest.fixture
def adopted(arrived):
    """Function that makes a component which has adopted 1/1."""

    def make(settings=None):
        component = Component(settings or Settings())
        component.on_message(arrived(heartbeat()), 0.0)
        return component

    return make


def estimate():
    row = empty(ESTIMATE_DTYPE)[0]
    row["phase"], row["ned_from_body"] = Phase.RUNNING, [1.0, 0.0, 0.0, 0.0]
    for name in ("rate_rad_s", "residual_m_s2", "attitude_sigma_rad"):
        row[name] = 0.0
    return row


# -- identity ----------------------------------------------------------------------------------


@pytest.mark.parametrize("sender", [(1, 1), (1, 191), (7, 42), (255, 190), (3, 0)])
@pytest.mark.parametrize(
    ("autopilot", "name"), [(ARDUPILOT, "ARDUPILOTMEGA"), (12, "PX4"), (0, "GENERIC"), (250, "")]
)
def test_an_autopilot_is_known_by_its_heartbeat_alone(arrived, sender, autopilot, name):
    component = Component(Settings())
    component.on_message(arrived(heartbeat(autopilot), *sender), 0.0)
    assert component.vehicle == sender
    assert component.system == sender[0]
    assert component.component == 191
    ((level, text),) = component.drain_events()
    assert level == "info"
    assert text == f"adopted vehicle {sender[0]}/{sender[1]} ({name or 'autopilot'})"


@pytest.mark.parametrize(
    ("sender", "kind"),
    [
        ((255, 190), dialect.MAV_TYPE_GCS),
        ((1, 154), dialect.MAV_TYPE_GIMBAL),
        ((1, 1), dialect.MAV_TYPE_ONBOARD_CONTROLLER),
        ((1, 1), dialect.MAV_TYPE_FIXED_WING),
    ],
)
def test_who_is_no_autopilot_is_not_adopted(arrived, sender, kind):
    component = Component(Settings())
    component.on_message(arrived(heartbeat(INVALID, kind), *sender), 0.0)
    assert component.system == 0
    assert component.tick(1.0, "boot") == component.publish(estimate()) == []
    assert component.drain_events() == []


def test_no_other_message_makes_a_vehicle(arrived):
    component = Component(Settings())
    for message in (
        dialect.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0),
        dialect.MAVLink_timesync_message(0, 5),
        dialect.MAVLink_system_time_message(0, 5),
    ):
        for sender in ((1, 1), (0, 0)):
            foreign = arrived(message, *sender)
            assert component.on_message(foreign, 0.0) == []
            assert not component.is_vehicle(foreign)
    assert (component.system, component.traffic.vehicle) == (0, 0)


def test_a_vehicle_that_calls_itself_the_address_of_all_is_refused_once(arrived):
    component = Component(Settings(link=LinkSettings(system=5)))
    for _ in range(100):
        component.on_message(arrived(heartbeat(), 0, 1), 0.0)
    assert component.system == 0
    assert [level for level, _ in component.drain_events()] == ["warning"]


def test_the_system_of_the_settings_is_waited_for(arrived):
    component = Component(Settings(intake=IntakeSettings(system=4, component=1)))
    for sender in ((1, 1), (4, 2), (1, 1)):
        component.on_message(arrived(heartbeat(), *sender), 0.0)
    assert component.system == 0
    assert component.drain_events() == [
        ("info", "autopilot 1/1 is not the one of intake.system; ignored"),
        ("info", "autopilot 4/2 is not the one of intake.system; ignored"),
    ]
    component.on_message(arrived(heartbeat(), 4, 1), 0.0)
    assert component.vehicle == (4, 1)


def test_our_own_system_number_may_be_set(arrived):
    component = Component(Settings(link=LinkSettings(system=9, component=195)))
    component.on_message(arrived(heartbeat(), 4, 1), 0.0)
    assert (component.system, component.component, component.vehicle) == (9, 195, (4, 1))
    requests = [m for m in component.tick(0.0, "boot") if m.get_type() == "COMMAND_LONG"]
    assert (requests[0].target_system, requests[0].target_component) == (4, 1)
    ping = dialect.MAVLink_command_long_message(9, 195, 400, 0, 0, 0, 0, 0, 0, 0, 0)
    assert len(component.on_message(arrived(ping, 4, 1), 0.0)) == 1
    ping.target_system = 4
    assert component.on_message(arrived(ping, 4, 1), 0.0) == []


def test_a_second_vehicle_is_ignored_counted_and_told_once(adopted, arrived):
    component = adopted()
    component.drain_events()
    for _ in range(50):
        component.on_message(arrived(heartbeat(), 2, 1), 1.0)
        component.on_message(arrived(dialect.MAVLink_timesync_message(0, 5), 2, 1), 1.0)
        component.on_message(arrived(heartbeat(INVALID), 1, 154), 1.0)
    assert component.vehicle == (1, 1)
    assert component.drain_events() == [("info", "autopilot 2/1 is also on this link; ignored")]
    traffic = component.traffic
    assert (traffic.vehicle, traffic.same_system, traffic.foreign) == (0, 50, 100)
    assert traffic.by_stranger == {(2, 1): 100, (1, 154): 50}


def test_a_flood_of_systems_takes_no_memory(adopted, arrived):
    component = adopted()
    for system, number in itertools.product(range(256), range(0, 256, 5)):
        if (system, number) != (1, 1):
            component.on_message(arrived(heartbeat(), system, number), 1.0)
    assert len(component.traffic.by_stranger) == 16
    assert component.traffic.foreign + component.traffic.same_system == 256 * 52
    assert len(component.drain_events()) <= 17
    assert component.vehicle == (1, 1)


def test_another_component_of_our_number_is_told_once(adopted, arrived):
    component = adopted()
    component.drain_events()
    for _ in range(5):
        component.on_message(arrived(heartbeat(INVALID), 2, 191), 1.0)
    assert component.drain_events() == []
    for _ in range(5):
        component.on_message(arrived(heartbeat(INVALID), 1, 191), 1.0)
    ((level, text),) = component.drain_events()
    assert level == "warning"
    assert "another component 191 speaks on system 1" in text
    assert "set link.component" in text


def test_no_announcement_hides_a_second_vehicle(adopted, arrived):
    component = adopted()
    component.drain_events()
    for n in range(40):
        component.announce(f"state {n}", True, 0.1 * n)
    component.on_message(arrived(heartbeat(), 2, 1), 5.0)
    assert len(component.drain_events()) == 1


# -- heartbeat ---------------------------------------------------------------------------------


def test_the_heartbeat_comes_once_a_second_with_the_true_state(converse):
    flight = converse()
    flight.run(10.0, "boot")
    flight.run(10.0, "active")
    flight.run(10.0, "critical")
    beats = flight.named("HEARTBEAT")
    assert len(beats) == 30
    assert {round(b - a, 6) for (a, _), (b, _) in itertools.pairwise(beats)} <= {0.95, 1.0, 1.05}
    assert [message.system_status for _, message in beats] == [
        *[dialect.MAV_STATE_BOOT] * 10,
        *[dialect.MAV_STATE_ACTIVE] * 10,
        *[dialect.MAV_STATE_CRITICAL] * 10,
    ]
    assert {(m.type, m.autopilot, m.base_mode, m.mavlink_version) for _, m in beats} == {
        (dialect.MAV_TYPE_ONBOARD_CONTROLLER, INVALID, 0, 3)
    }


def test_late_ticks_cost_no_rate_and_a_stall_gives_no_burst(adopted):
    component = adopted()
    times = [n * 0.27 for n in range(400)] + [500.0 + n * 0.05 for n in range(200)]
    beats = [
        now_s
        for now_s in times
        for message in component.tick(now_s, "active")
        if message.get_type() == "HEARTBEAT"
    ]
    early = [now_s for now_s in beats if now_s < 200.0]
    assert len(early) == 108
    assert [now_s for now_s in beats if now_s > 200.0] == pytest.approx(
        [500.0 + n for n in range(10)], abs=0.051
    )


def test_before_the_adoption_there_is_only_the_call(arrived):
    component = Component(Settings())
    for now_s in range(100):
        component.announce("no vehicle heard", False, now_s)
        assert component.tick(float(now_s), "boot") == []
    call = arrived(component.call(), 1, 191)
    assert (call.type, call.autopilot, call.system_status) == (18, 8, dialect.MAV_STATE_BOOT)


def test_nothing_but_attitudes_is_published(adopted):
    component = adopted(Settings(publish=PublishSettings(0.0, 0.0, 0.0)))
    assert component.publish(estimate()) == []
    component = adopted()
    assert [m.get_type() for m in component.publish(estimate())] == ["ATTITUDE"]


# -- restarts ----------------------------------------------------------------------------------


def system_time(component, arrived, boot_ms, sender=(1, 1), now_s=100.0):
    message = dialect.MAVLink_system_time_message(0, boot_ms)
    component.on_message(arrived(message, *sender), now_s)
    return [text for _, text in component.drain_events() if "restarted" in text]


def test_time_since_boot_that_goes_back_is_a_restart(adopted, arrived):
    component = adopted()
    for boot_ms in (60_000, 61_000, 60_500, 62_000):
        assert system_time(component, arrived, boot_ms) == []
    assert system_time(component, arrived, 500, (2, 1)) == []
    assert len(system_time(component, arrived, 500)) == 1
    assert system_time(component, arrived, 1500) == []


def test_time_since_boot_that_wraps_is_no_restart(adopted, arrived):
    component = adopted()
    for boot_ms in (BOOT_WRAP_MS - 1500, BOOT_WRAP_MS - 500, 500, 1500):
        assert system_time(component, arrived, boot_ms) == []
    component = adopted()
    assert system_time(component, arrived, BOOT_WRAP_MS - 100_000) == []
    assert len(system_time(component, arrived, 500)) == 1


def test_a_restart_is_told_with_the_jump_of_its_clock(converse):
    flight = converse()
    flight.run(60.0)
    flight.withhold = {"SYSTEM_TIME"}
    flight.boot()
    flight.run(20.0)
    (text,) = flight.texts("clock jumped")
    assert text == "the autopilot's clock jumped by -60.0 s against ours"
    assert len(flight.texts("the autopilot restarted")) == 1
    assert flight.component.timesync.jumps == 1


def test_a_clock_that_leaps_ahead_is_no_restart(converse):
    flight = converse()
    flight.run(30.0)
    asked = len(flight.named("COMMAND_LONG"))
    flight.boot_s -= 100.0
    flight.run(20.0)
    assert flight.texts("clock jumped") == ["the autopilot's clock jumped by +100.0 s against ours"]
    assert flight.texts("restarted") == []
    assert len(flight.named("COMMAND_LONG")) == asked


def test_two_restarts_are_two(converse):
    flight = converse()
    for _ in range(3):
        flight.run(25.0)
        flight.boot()
    flight.run(10.0)
    assert len(flight.texts("the autopilot restarted")) == 3


def test_the_vehicle_comes_and_goes_often(converse):
    flight = converse()
    for _ in range(5):
        flight.run(12.0)
        flight.cut = True
        flight.run(8.0)
        flight.cut = False
    flight.run(12.0)
    assert len(flight.texts("no heartbeat")) == len(flight.texts("heard again")) == 5
    for rate in flight.component.rates():
        assert rate.granted_hz == rate.wanted_hz
    assert flight.texts("asking again") == []


@pytest.mark.parametrize("start_s", [0.0, 3e7, 1.7e9])
def test_the_zero_of_the_clock_does_not_matter(converse, start_s):
    flight = converse()
    flight.now_s = start_s
    flight.boot()
    flight.run(10.0)
    assert len(flight.named("HEARTBEAT")) == 10
    assert {rate.state for rate in flight.component.rates()} == {"granted"}
    assert flight.component.timesync.offset_ns is not None


# -- texts -------------------------------------------------------------------------------------


def said(texts, start_s, end_s):
    """(time, severity, text) put together from the chunks, tick by tick."""
    out = []
    for n in range(round((end_s - start_s) / 0.05)):
        now_s = start_s + 0.05 * n
        parts = texts.tick(now_s)
        frames = [decode_frame(Encoder(1, 191).pack(part)) for part in parts]
        if frames:
            assert [frame.chunk_seq for frame in frames] == list(range(len(frames)))
            assert len({(frame.id, frame.severity) for frame in frames}) == 1
            assert (frames[0].id == 0) == (len(frames) == 1)
            assert all(len(frame.text) == 50 for frame in frames[:-1])
            text = "".join(frame.text for frame in frames)
            out.append((round(now_s, 3), frames[0].severity, text))
    return out


@pytest.mark.parametrize("length", [1, 43, 44, 45, 94, 95, 200, 244])
def test_long_texts_come_in_chunks_of_50_bytes(length):
    texts = StatusTexts()
    text = ("0123456789" * 30)[:length]
    texts.announce(text, True, 0.0)
    assert said(texts, 0.0, 0.1) == [(0.0, dialect.MAV_SEVERITY_INFO, f"AHRS: {text}")]


def test_a_text_without_end_is_cut_and_others_letters_are_marked():
    texts = StatusTexts()
    texts.announce("x" * 20_000, False, 0.0)
    texts.announce("zu heiß", False, 0.0)
    (_, severity, cut), (_, _, marked) = said(texts, 0.0, 2.0)
    assert (severity, cut) == (dialect.MAV_SEVERITY_WARNING, "AHRS: " + "x" * 244)
    assert marked == "AHRS: zu hei?"


def test_chunks_of_one_text_share_a_number_that_no_neighbour_has():
    texts = StatusTexts()
    numbers = []
    for n in range(66_000):
        texts.announce(f"{n:060}", True, float(n))
        numbers += [part.id for part in texts.tick(float(n))]
    assert len(numbers) == 132_000
    assert (min(numbers), max(numbers)) == (1, 65535)
    assert numbers[::2] == numbers[1::2]
    assert all(a != b for a, b in itertools.pairwise(numbers[::2]))


def test_one_text_a_second_and_a_burst_keeps_the_newest():
    texts = StatusTexts()
    for n in range(20):
        texts.announce(f"text {n}", True, 0.0)
    heard = said(texts, 0.0, 30.0)
    assert [at_s for at_s, _, _ in heard] == pytest.approx(list(range(8)), abs=0.3)
    assert [text for _, _, text in heard] == [f"AHRS: text {n}" for n in range(12, 20)]


def test_the_same_text_comes_at_most_every_30_s():
    texts = StatusTexts()
    heard = []
    for n in range(100):
        texts.announce("good", True, float(n))
        heard += said(texts, float(n), n + 1.0)
    assert [at_s for at_s, _, _ in heard] == [0.0, 30.0, 60.0, 90.0]


def test_the_last_word_is_what_holds_after_states_that_flicker():
    texts = StatusTexts()
    heard = []
    for n in range(11):
        texts.announce("good" if n % 2 == 0 else "degraded", n % 2 == 0, 2.0 * n)
        heard += said(texts, 2.0 * n, 2.0 * n + 2.0)
    assert [text for _, _, text in heard] == ["AHRS: good", "AHRS: degraded"]
    heard = said(texts, 22.0, 100.0)
    assert heard == [(30.0, dialect.MAV_SEVERITY_INFO, "AHRS: good")]


def test_announcements_reach_the_ground_through_the_tick(converse):
    flight = converse()
    flight.run(5.0)
    flight.component.announce("degraded; gap in the IMU data", False, flight.now_s)
    flight.run(5.0)
    ((_, message),) = flight.named("STATUSTEXT")
    assert message.text == "AHRS: degraded; gap in the IMU data"
    assert message.severity == dialect.MAV_SEVERITY_WARNING


# -- anything at all ---------------------------------------------------------------------------

NUMBERS = sorted(dialect.mavlink_map)
HANDLED = [
    dialect.MAVLINK_MSG_ID_HEARTBEAT,
    dialect.MAVLINK_MSG_ID_SYSTEM_TIME,
    dialect.MAVLINK_MSG_ID_TIMESYNC,
    dialect.MAVLINK_MSG_ID_COMMAND_ACK,
    dialect.MAVLINK_MSG_ID_COMMAND_LONG,
    dialect.MAVLINK_MSG_ID_COMMAND_INT,
    dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST,
    dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
    dialect.MAVLINK_MSG_ID_PARAM_SET,
]
SENDERS = [(1, 1), (1, 1), (255, 190), (1, 191), (2, 1), (0, 0)]
COMMANDS = [510, 511, 512, 520]
LIKELY = {
    "target_system": st.sampled_from([0, 1]),
    "target_component": st.sampled_from([0, 191]),
    "command": st.sampled_from(COMMANDS),
    "param_id": st.sampled_from(["AHRS_PUB_ATT", "AHRS_GATE_NORM", "X"]),
    "param1": st.sampled_from([0.0, 30.0, 31.0, 148.0, 251.0]),
    "param_index": st.integers(-1, 8),
    "autopilot": st.sampled_from([3, 8, 12]),
    "tc1": st.just(0),
}


@st.composite
def arrivals(draw):
    """One message of any type with any bytes, often of a kind that we answer."""
    number = draw(st.one_of(st.sampled_from(HANDLED), st.sampled_from(NUMBERS)))
    size = dialect.mavlink_map[number].unpacker.size
    payload = draw(st.binary(min_size=size, max_size=size))
    header = struct.pack(
        "<BBBBBBBHB",
        0xFD,
        size,
        0,
        0,
        0,
        *draw(st.sampled_from(SENDERS)),
        number & 0xFFFF,
        number >> 16,
    )
    message = decode_frame(header + payload + b"\0\0")
    for field, likely in LIKELY.items():
        if hasattr(message, field) and draw(st.booleans()):
            setattr(message, field, draw(likely))
    return message


STEPS = st.tuples(
    st.lists(arrivals(), max_size=4),
    st.floats(0.0, 20.0),
    st.sampled_from(["boot", "active", "critical"]),
    st.booleans(),
)


@settings(max_examples=300, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(STEPS, min_size=1, max_size=12), st.booleans())
def test_no_message_raises_or_takes_memory(steps, is_adopted):
    component = Component(Settings(publish=PublishSettings(50.0, 50.0, 50.0)))
    ours = Encoder(1, 191)
    now_s, row = 0.0, estimate()
    if is_adopted:
        component.on_message(decode_frame(Encoder(1, 1).pack(heartbeat())), 0.0)
    for messages, elapsed_s, state, has_estimate in steps:
        now_s += elapsed_s
        row["time_ns"] = int(now_s * 1e9)
        out = component.publish(row) if has_estimate else []
        for message in messages:
            out += component.on_message(message, now_s)
        component.announce(str(now_s), True, now_s)
        out += component.tick(now_s, state)
        for answer in out:
            assert len(ours.pack(answer)) <= 280
        assert component.system or not out
        assert len(component.drain_events()) <= 4 * 64
        assert 0.0 < component.settings.gate.norm_m_s2 <= 50.0
        assert 0.0 <= component.settings.publish.attitude_rate_hz <= 1000.0
    assert len(pickle.dumps(component)) < 20_000


def test_a_flood_of_requests_takes_no_memory(adopted, arrived):
    component = adopted()
    messages = [
        arrived(dialect.MAVLink_param_set_message(1, 191, b"NO", 1.0, 9)),
        arrived(dialect.MAVLink_param_request_list_message(1, 191)),
        arrived(dialect.MAVLink_param_request_read_message(1, 191, b"AHRS_PUB_ATT", -1)),
        arrived(dialect.MAVLink_timesync_message(77, 77)),
        arrived(dialect.MAVLink_command_ack_message(511, 4, 0, 0, 1, 191)),
        arrived(heartbeat(INVALID), 1, 191),
    ]
    for _ in range(3000):
        for message in messages:
            component.on_message(message, 1.0)
    assert len(pickle.dumps(component)) < 20_000
    assert len(component.drain_events()) <= 4 * 64
