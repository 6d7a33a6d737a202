import itertools
import math

import numpy as np
import pytest

from ahrs_service.links.mavlink.codec import Decoder, Encoder, dialect
from ahrs_service.links.simulated.autopilot import (
    DEFAULT_RATES_HZ,
    SimulatedAutopilot,
    granted_interval_ms,
)
from ahrs_service.links.simulated.autopilot_messages import BOOT_US
from ahrs_service.simulation.scenario import make_flight

RATE_HZ = 200.0


@pytest.fixture(scope="module")
def flight():
    return make_flight("flight", 40.0, seed=5, rate_hz=RATE_HZ)


@pytest.fixture
def autopilot(flight):
    return SimulatedAutopilot(flight.rows, RATE_HZ)


def decode(frames):
    decoder = Decoder()
    messages = [message for frame in frames for message, _ in decoder.feed(frame)]
    assert decoder.counts["frames"] == len(frames)
    return messages


def received(message, system=1, component=191):
    """The message as it arrives from another component."""
    return decode([Encoder(system, component).pack(message)])[0]


def command(autopilot, number, *parameters, now_s=0.0, system=1, component=1):
    parameters = [*parameters, *[0.0] * (7 - len(parameters))]
    message = dialect.MAVLink_command_long_message(system, component, number, 0, *parameters)
    return decode(autopilot.on_message(received(message), now_s))


def set_interval(autopilot, name, interval_us, now_s=0.0):
    number = getattr(dialect, f"MAVLINK_MSG_ID_{name}")
    (ack,) = command(
        autopilot, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, number, interval_us, now_s=now_s
    )
    assert (ack.target_system, ack.target_component) == (1, 191)
    return ack.result


def test_unasked_it_sends_slowly_and_never_highres_imu(autopilot):
    messages = decode(autopilot.due(10.0))
    names = [message.get_type() for message in messages]
    assert {name: names.count(name) for name in set(names)} == {
        name: 10 * rate + 1 for name, rate in DEFAULT_RATES_HZ.items()
    }
    heartbeat = messages[names.index("HEARTBEAT")]
    assert heartbeat.autopilot == dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
    assert heartbeat.type == dialect.MAV_TYPE_FIXED_WING
    assert (heartbeat.get_srcSystem(), heartbeat.get_srcComponent()) == (1, 1)


def test_frames_come_when_next_due_says_and_only_then(autopilot):
    assert autopilot.next_due() == 0.0
    assert autopilot.due(0.0)
    assert autopilot.next_due() == 0.5
    assert autopilot.due(0.499) == []
    assert autopilot.due(0.5)


def test_truth_follows_the_raw_imu_of_its_instant(flight):
    autopilot = SimulatedAutopilot(
        flight.rows, RATE_HZ, {"HEARTBEAT": 1, "HIGHRES_IMU": 100, "RAW_IMU": 50, "SIM_STATE": 50}
    )
    messages = decode(autopilot.due(20.0))
    pairs = [
        (before, message)
        for before, message in itertools.pairwise(messages)
        if message.get_type() == "SIM_STATE"
    ]
    assert len(pairs) == 20 * 50 + 1
    for raw, truth in pairs:
        assert raw.get_type() == "RAW_IMU"
        row = flight.rows[round((raw.time_usec - BOOT_US) * RATE_HZ / 1e6)]
        quaternion = [truth.q1, truth.q2, truth.q3, truth.q4]
        np.testing.assert_allclose(quaternion, row["ned_from_body"], atol=1e-6)
        np.testing.assert_allclose([truth.vn, truth.ve, truth.vd], row["velocity_ned_m_s"], 1e-6)


def test_units_and_quirks_of_the_imu_messages(flight):
    rates = {"RAW_IMU": 10, "SCALED_IMU": 10, "HIGHRES_IMU": 10}
    raw, scaled, highres = decode(SimulatedAutopilot(flight.rows, RATE_HZ, rates).due(20.0))[-3:]
    row = flight.rows[round(20.0 * RATE_HZ)]
    milli_g = np.trunc(row["accel_m_s2"] / 9.80665e-3)
    for message in (raw, scaled):
        assert [message.xacc, message.yacc, message.zacc] == milli_g.tolist()
        assert [message.xgyro, message.ygyro, message.zgyro] == np.trunc(
            row["gyro_rad_s"] * 1e3
        ).tolist()
        assert message.temperature == int(row["imu_degc"] * 100.0)
    np.testing.assert_allclose(
        [highres.xacc, highres.yacc, highres.zacc], row["accel_m_s2"], rtol=1e-6
    )
    assert highres.temperature == row["air_degc"]
    assert abs(highres.temperature - raw.temperature / 100.0) > 1.0
    assert highres.time_usec == raw.time_usec == scaled.time_boot_ms * 1000


@pytest.mark.parametrize(
    ("loop_hz", "asked_hz", "granted_ms"),
    [
        (50, 25, 40),
        (50, 40, 25),
        (50, 50, None),
        (300, 250, 4),
        (400, 333, 3),
        (400, 200, 5),
        (400, 400, None),
        (1000, 1000, 1),
    ],
)
def test_intervals_are_granted_as_measured_on_ardupilot(loop_hz, asked_hz, granted_ms):
    assert granted_interval_ms(int(1e6 / asked_hz), loop_hz) == granted_ms


def test_a_message_asked_for_comes_at_the_granted_rate(autopilot):
    autopilot.due(5.0)
    assert set_interval(autopilot, "HIGHRES_IMU", 10_999, now_s=5.001) == (
        dialect.MAV_RESULT_ACCEPTED
    )
    times = [
        message.time_usec
        for message in decode(autopilot.due(6.0))
        if message.get_type() == "HIGHRES_IMU"
    ]
    assert len(times) == 100
    assert set(np.diff(times).tolist()) == {10_000}
    assert set_interval(autopilot, "HIGHRES_IMU", -1.0, now_s=6.0) == dialect.MAV_RESULT_ACCEPTED
    assert "HIGHRES_IMU" not in {m.get_type() for m in decode(autopilot.due(7.0))}


def test_zero_restores_the_default(autopilot):
    set_interval(autopilot, "ATTITUDE", 20_000)
    set_interval(autopilot, "ATTITUDE", 0)
    names = [message.get_type() for message in decode(autopilot.due(10.0))]
    assert names.count("ATTITUDE") == 20


@pytest.mark.parametrize(
    ("name", "interval_us"),
    [("HIGHRES_IMU", 5000.0), ("HIGHRES_IMU", math.nan), ("OPTICAL_FLOW", 1e6)],
)
def test_too_fast_no_number_and_unknown_are_denied(autopilot, name, interval_us):
    assert set_interval(autopilot, name, interval_us) == dialect.MAV_RESULT_DENIED


def test_commands_are_answered_by_what_they_are(autopilot):
    ack, interval = command(
        autopilot, dialect.MAV_CMD_GET_MESSAGE_INTERVAL, dialect.MAVLINK_MSG_ID_ATTITUDE
    )
    assert ack.result == dialect.MAV_RESULT_ACCEPTED
    assert interval.interval_us == 500_000
    ack, version = command(
        autopilot, dialect.MAV_CMD_REQUEST_MESSAGE, dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
    )
    assert ack.result == dialect.MAV_RESULT_ACCEPTED
    assert version.capabilities & dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    (ack,) = command(autopilot, dialect.MAV_CMD_REQUEST_MESSAGE, 9999)
    assert ack.result == dialect.MAV_RESULT_FAILED
    (ack,) = command(autopilot, dialect.MAV_CMD_NAV_TAKEOFF)
    assert ack.result == dialect.MAV_RESULT_UNSUPPORTED
    assert command(autopilot, dialect.MAV_CMD_REQUEST_MESSAGE, 30, system=2) == []
    assert autopilot.counts.commands == {
        "GET_MESSAGE_INTERVAL ACCEPTED": 1,
        "REQUEST_MESSAGE ACCEPTED": 1,
        "REQUEST_MESSAGE FAILED": 1,
        "NAV_TAKEOFF UNSUPPORTED": 1,
    }


def test_timesync_is_answered_with_its_own_stamp(autopilot):
    asked = received(dialect.MAVLink_timesync_message(0, 12345))
    (answer,) = decode(autopilot.on_message(asked, 2.5))
    assert answer.ts1 == 12345
    assert answer.tc1 == (BOOT_US + 2_500_000) * 1000
    foreign_answer = received(dialect.MAVLink_timesync_message(7, 12345))
    assert autopilot.on_message(foreign_answer, 2.5) == []


def test_parameters_are_listed_read_and_set(autopilot):
    asked = received(dialect.MAVLink_param_request_list_message(1, 1))
    listed = decode(autopilot.on_message(asked, 0.0))
    assert [value.param_index for value in listed] == list(range(listed[0].param_count))
    by_name = {value.param_id: value.param_value for value in listed}
    assert by_name["SCHED_LOOP_RATE"] == RATE_HZ

    change = dialect.MAVLink_param_set_message(1, 1, b"INS_GYRO_FILTER", 35.0, 9)
    (echo,) = decode(autopilot.on_message(received(change), 0.0))
    assert (echo.param_id, echo.param_value) == ("INS_GYRO_FILTER", 35.0)
    for read in (
        dialect.MAVLink_param_request_read_message(1, 1, b"INS_GYRO_FILTER", -1),
        dialect.MAVLink_param_request_read_message(1, 1, b"", echo.param_index),
    ):
        (value,) = decode(autopilot.on_message(received(read), 0.0))
        assert (value.param_id, value.param_value) == ("INS_GYRO_FILTER", 35.0)
    unknown = dialect.MAVLink_param_set_message(1, 1, b"NOT_THERE", 1.0, 9)
    assert autopilot.on_message(received(unknown), 0.0) == []


def test_attitudes_of_other_components_of_its_system_are_counted(autopilot):
    attitude = dialect.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0)
    for system, component in ((1, 191), (1, 191), (1, 1), (2, 191)):
        assert autopilot.on_message(received(attitude, system, component), 0.0) == []
    assert autopilot.counts.received == {"ATTITUDE": 2}


def test_the_flight_ends(autopilot, flight):
    duration_s = (len(flight.rows) - 1) / RATE_HZ
    assert autopilot.duration_s == duration_s
    frames = autopilot.due(duration_s + 100.0)
    assert decode(frames)[-1].get_type() == "BATTERY_STATUS"
    assert autopilot.next_due() == math.inf
    assert autopilot.due(duration_s + 200.0) == []


@pytest.mark.parametrize(
    ("rates", "words"), [({"PING": 1.0}, "PING"), ({"ATTITUDE": 200.0}, "ATTITUDE at 200 Hz")]
)
def test_rates_that_cannot_be_are_refused(flight, rates, words):
    with pytest.raises(ValueError, match=words):
        SimulatedAutopilot(flight.rows, RATE_HZ, rates)
