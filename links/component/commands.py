"""COMMAND_LONG and COMMAND_INT that are meant for us, and their answers."""

import dataclasses
import math
from typing import Any, Final

from ahrs_service.links.component.attitude_messages import (
    Publisher,
    attitude_quaternion,
    named_values,
)
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.records import Record
from ahrs_service.settings import PublishSettings, Settings

_RATE_OF: Final = {
    int(dialect.MAVLINK_MSG_ID_ATTITUDE): "attitude_rate_hz",
    int(dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION): "attitude_quaternion_rate_hz",
    int(dialect.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT): "named_value_rate_hz",
}
"""Messages of ours whose rate can be set, by the setting that holds it."""
_FASTEST_HZ: Final = 1000.0
_LONGEST_INTERVAL_US: Final = (1 << 31) - 1
_ACCEPTED: Final = int(dialect.MAV_RESULT_ACCEPTED)
_DENIED: Final = int(dialect.MAV_RESULT_DENIED)
_NOT_NOW: Final = int(dialect.MAV_RESULT_TEMPORARILY_REJECTED)
_UNSUPPORTED: Final = int(dialect.MAV_RESULT_UNSUPPORTED)

Answer = tuple[int, list[Any], Settings]


def answer(
    message: Any,
    sender: tuple[int, int],
    settings: Settings,
    heartbeat: Any,
    estimate: Record | None,
) -> tuple[list[Any], Settings]:
    """Return the COMMAND_ACK with what was asked for, and the settings from now on."""
    command = int(message.command)
    if command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
        result, extra, settings = _set_interval(message, settings)
    elif command == dialect.MAV_CMD_GET_MESSAGE_INTERVAL:
        result, extra = _get_interval(message, settings.publish)
    elif command == dialect.MAV_CMD_REQUEST_MESSAGE:
        result, extra = _request(message, heartbeat, estimate)
    else:
        result, extra = _UNSUPPORTED, []
    ack = dialect.MAVLink_command_ack_message(command, result, 0, 0, *sender)
    return [ack, *extra], settings


def _message_id(message: Any) -> int:
    value = float(message.param1)
    return int(value) if value.is_integer() else -1


def _set_interval(message: Any, settings: Settings) -> Answer:
    """Change the rate of one of our messages; -1 switches it off, 0 gives the default."""
    key = _RATE_OF.get(_message_id(message))
    interval_us = float(message.param2)
    if key is None:
        return _UNSUPPORTED, [], settings
    if interval_us == -1.0:
        rate_hz = 0.0
    elif interval_us == 0.0:
        rate_hz = float(getattr(PublishSettings(), key))
    else:
        rate_hz = 1e6 / interval_us if interval_us > 0.0 else math.nan
    if not 0.0 <= rate_hz <= _FASTEST_HZ:
        return _DENIED, [], settings
    publish = dataclasses.replace(settings.publish, **{key: rate_hz})
    return _ACCEPTED, [], dataclasses.replace(settings, publish=publish)


def _get_interval(message: Any, publish: PublishSettings) -> tuple[int, list[Any]]:
    message_id = _message_id(message)
    key = _RATE_OF.get(message_id)
    if key is None:
        return _UNSUPPORTED, []
    rate_hz = float(getattr(publish, key))
    interval_us = round(min(1e6 / rate_hz, _LONGEST_INTERVAL_US)) if rate_hz else -1
    return _ACCEPTED, [dialect.MAVLink_message_interval_message(message_id, interval_us)]


def _request(message: Any, heartbeat: Any, estimate: Record | None) -> tuple[int, list[Any]]:
    """Send one message once."""
    message_id = _message_id(message)
    if message_id == dialect.MAVLINK_MSG_ID_HEARTBEAT:
        return _ACCEPTED, [heartbeat]
    if message_id == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
        return _ACCEPTED, [_version()]
    if message_id not in _RATE_OF:
        return _UNSUPPORTED, []
    if estimate is None:
        return _NOT_NOW, []
    if message_id == dialect.MAVLINK_MSG_ID_ATTITUDE:
        return _ACCEPTED, [Publisher(PublishSettings()).attitude(estimate)]
    if message_id == dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION:
        return _ACCEPTED, [attitude_quaternion(estimate)]
    return _ACCEPTED, named_values(estimate)


def _capabilities() -> int:
    return int(
        dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    )


def _version() -> Any:
    nothing = [0] * 8
    return dialect.MAVLink_autopilot_version_message(
        _capabilities(), 0, 0, 0, 0, nothing, nothing, nothing, 0, 0, 0
    )
