import math

import numpy as np
import pytest

from ahrs_service.links.component.component import Component
from ahrs_service.links.mavlink.codec import Encoder, decode_frame, dialect
from ahrs_service.records import ESTIMATE_DTYPE, Phase, empty
from ahrs_service.settings import PublishSettings, Settings

GROUND = (255, 190)
ACCEPTED = dialect.MAV_RESULT_ACCEPTED
DENIED = dialect.MAV_RESULT_DENIED
NOT_NOW = dialect.MAV_RESULT_TEMPORARILY_REJECTED
UNSUPPORTED = dialect.MAV_RESULT_UNSUPPORTED
ATTITUDE = dialect.MAVLINK_MSG_ID_ATTITUDE
QUATERNION = dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION
NAMED = dialect.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT
SET = dialect.MAV_CMD_SET_MESSAGE_INTERVAL
GET = dialect.MAV_CMD_GET_MESSAGE_INTERVAL
REQUEST = dialect.MAV_CMD_REQUEST_MESSAGE
STRANGE = [math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, -1.0, 0.5, 2.0**31, 16777216.0]


def estimate(time_s=12.0, phase=Phase.RUNNING):
    row = empty(ESTIMATE_DTYPE)[0]
    row["time_ns"], row["phase"] = int(time_s * 1e9), phase
    row["ned_from_body"] = [math.cos(0.1), math.sin(0.1), 0.0, 0.0]
    row["rate_rad_s"] = [0.1, 0.2, 0.3]
    row["residual_m_s2"] = [1.0, 2.0, 2.0]
    row["attitude_sigma_rad"] = [0.01, 0.02, 0.5]
    row["gate"] = 3
    return row


@pytest.fixture
def component(arrived):
    component = Component(Settings())
    component.on_message(arrived(dialect.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3)), 0.0)
    component.tick(0.0, "critical")
    return component


@pytest.fixture(params=["COMMAND_LONG", "COMMAND_INT"])
def command(component, arrived, request):
    """Function that sends a command from the ground and returns the replies on the link."""

    def command(number, first=0.0, second=0.0, target=(1, 191)):
        if request.param == "COMMAND_LONG":
            message = dialect.MAVLink_command_long_message(
                *target, number, 0, first, second, 0, 0, 0, 0, 0
            )
        else:
            message = dialect.MAVLink_command_int_message(
                *target, 0, number, 0, 0, first, second, 0, 0, 0, 0, 0
            )
        answers = component.on_message(arrived(message, *GROUND), 1.0)
        ours = Encoder(component.system, component.component)
        return [decode_frame(ours.pack(answer)) for answer in answers]

    return command


def result_of(answers, number):
    ack = answers[0]
    assert ack.get_type() == "COMMAND_ACK"
    assert (ack.command, ack.target_system, ack.target_component) == (number, *GROUND)
    return ack.result


@pytest.mark.parametrize(
    ("number", "key"),
    [
        (ATTITUDE, "attitude_rate_hz"),
        (QUATERNION, "attitude_quaternion_rate_hz"),
        (NAMED, "named_value_rate_hz"),
    ],
)
def test_the_rate_of_our_messages_is_set_reported_and_reset(component, command, number, key):
    for interval_us, rate_hz, told_us in (
        (40_000.0, 25.0, 40_000),
        (-1.0, 0.0, -1),
        (1000.0, 1000.0, 1000),
        (3e9, 1 / 3000.0, 2**31 - 1),
        (3.4e38, pytest.approx(0.0, abs=1e-30), 2**31 - 1),
    ):
        (ack,) = command(SET, number, interval_us)
        assert ack.result == ACCEPTED
        assert getattr(component.settings.publish, key) == rate_hz
        answers = command(GET, number)
        assert result_of(answers, GET) == ACCEPTED
        assert (answers[1].message_id, answers[1].interval_us) == (number, told_us)
    assert result_of(command(SET, number, 0.0), SET) == ACCEPTED
    assert component.settings == Settings()


@pytest.mark.parametrize("interval_us", [math.nan, -math.inf, -2.0, 999.0, 1e-30])
def test_an_interval_that_makes_no_sense_is_denied(component, command, interval_us):
    assert result_of(command(SET, ATTITUDE, interval_us), SET) == DENIED
    assert component.settings == Settings()


def test_an_endless_interval_switches_off(component, command):
    assert result_of(command(SET, ATTITUDE, math.inf), SET) == ACCEPTED
    assert component.settings.publish.attitude_rate_hz == 0.0


def test_a_rate_set_is_the_rate_published(component, command):
    command(SET, ATTITUDE, 200_000.0)
    command(SET, QUATERNION, 100_000.0)
    sent = [m.get_type() for n in range(200) for m in component.publish(estimate(n * 0.005))]
    assert (sent.count("ATTITUDE"), sent.count("ATTITUDE_QUATERNION")) == (5, 10)


@pytest.mark.parametrize("number", [SET, GET, REQUEST])
@pytest.mark.parametrize("strange", STRANGE)
def test_strange_message_numbers_are_unsupported(component, command, number, strange):
    (ack,) = command(number, strange, 1e5)
    assert ack.result == UNSUPPORTED
    assert component.settings == Settings()


@pytest.mark.parametrize("number", [0, 65535, 400, dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN])
def test_other_commands_are_unsupported(command, number):
    answers = command(number, 1.0, 1.0)
    assert result_of(answers, number) == UNSUPPORTED
    assert len(answers) == 1


def test_the_messages_of_others_are_not_ours_to_set(command):
    for number in (dialect.MAVLINK_MSG_ID_HIGHRES_IMU, dialect.MAVLINK_MSG_ID_HEARTBEAT):
        assert result_of(command(SET, number, 1e5), SET) == UNSUPPORTED
        assert result_of(command(GET, number), GET) == UNSUPPORTED
    assert result_of(command(REQUEST, dialect.MAVLINK_MSG_ID_GPS_RAW_INT), REQUEST) == UNSUPPORTED


def test_the_heartbeat_asked_for_has_the_state_of_the_last_tick(component, command):
    for now_s, state, number in (
        (2.0, "critical", dialect.MAV_STATE_CRITICAL),
        (3.0, "active", dialect.MAV_STATE_ACTIVE),
    ):
        component.tick(now_s, state)
        ack, heartbeat = command(REQUEST, dialect.MAVLINK_MSG_ID_HEARTBEAT)
        assert ack.result == ACCEPTED
        assert (heartbeat.type, heartbeat.autopilot) == (18, 8)
        assert heartbeat.system_status == number


def test_the_version_reports_mavlink_2_and_the_parameter_encoding(command):
    ack, version = command(REQUEST, dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    assert ack.result == ACCEPTED
    assert version.capabilities == (
        dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    )


@pytest.mark.parametrize("number", [ATTITUDE, QUATERNION, NAMED])
def test_our_attitude_is_sent_when_there_is_one(component, command, number):
    assert result_of(command(REQUEST, number), REQUEST) == NOT_NOW
    component.publish(estimate())
    answers = command(REQUEST, number)
    assert result_of(answers, REQUEST) == ACCEPTED
    assert {answer.get_msgId() for answer in answers[1:]} == {number}
    assert answers[1].time_boot_ms == 12_000
    if number == ATTITUDE:
        assert answers[1].roll == np.float32(0.2)
        assert answers[1].yawspeed == np.float32(0.3)


def test_an_attitude_of_the_past_is_not_sent(component, command):
    row = estimate()
    component.publish(row)
    component.tick(1.0, "active")
    component.tick(1.9, "active")
    assert result_of(command(REQUEST, ATTITUDE), REQUEST) == ACCEPTED
    row["phase"] = Phase.ALIGNING
    assert result_of(command(REQUEST, ATTITUDE), REQUEST) == NOT_NOW
    row["phase"] = Phase.RUNNING
    component.tick(2.1, "critical")
    assert result_of(command(REQUEST, ATTITUDE), REQUEST) == NOT_NOW


@pytest.mark.parametrize("target", [(0, 0), (1, 0), (0, 191), (1, 1), (2, 191), (255, 190)])
def test_commands_to_all_or_to_others_get_no_answer(component, command, target):
    for number in (SET, GET, REQUEST, 400):
        assert command(number, ATTITUDE, 1e5, target) == []
    assert component.settings == Settings()


def test_nothing_is_answered_before_a_vehicle_is_adopted(arrived):
    component = Component(Settings())
    for target in ((0, 191), (0, 0), (1, 191)):
        message = dialect.MAVLink_command_long_message(
            *target, REQUEST, 0, dialect.MAVLINK_MSG_ID_HEARTBEAT, 0, 0, 0, 0, 0, 0
        )
        for sender in (GROUND, (0, 0), (1, 1)):
            assert component.on_message(arrived(message, *sender), 0.0) == []


def test_the_defaults_are_those_of_the_settings(component):
    assert component.settings.publish == PublishSettings()
