"""No message, however strange, raises or takes memory."""

import pickle
import struct

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ahrs_service.links.component.component import Component
from ahrs_service.links.mavlink.codec import Encoder, decode_frame, dialect
from ahrs_service.settings import PublishSettings, Settings
from tests.links.messages import INVALID, estimate, heartbeat

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
    """One message of any type with any bytes, often of a kind that we respond to."""
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
