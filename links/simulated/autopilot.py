"""A simulated autopilot: sends a flight as MAVLink 2 and answers as ArduPilot does.

Sans I/O: frames go out by `due`, messages come in by `on_message`, time is given by the caller.
"""

import heapq
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from ahrs_service.errors import InvalidValueError
from ahrs_service.links.logs.param_files import ParamValue
from ahrs_service.links.mavlink.codec import Encoder, Signer, dialect
from ahrs_service.links.simulated.autopilot_messages import BOOT_US, FlightMessages
from ahrs_service.links.simulated.autopilot_parameters import AutopilotParameters, ardupilot_ins
from ahrs_service.records import Rows

DEFAULT_RATES_HZ: Final[Mapping[str, float]] = {
    "HEARTBEAT": 1.0,
    "SYSTEM_TIME": 1.0,
    "RAW_IMU": 2.0,
    "SIM_STATE": 2.0,
    "SCALED_IMU": 1.0,
    "ATTITUDE": 2.0,
    "LOCAL_POSITION_NED": 1.0,
    "GPS_RAW_INT": 1.0,
    "VFR_HUD": 2.0,
    "SCALED_PRESSURE": 1.0,
    "VIBRATION": 1.0,
    "BATTERY_STATUS": 1.0,
}
"""What is sent while nobody has asked for anything [Hz]; what is not named is off."""

_SHARE_OF_LOOP: Final = 800.0
_SLOWEST_MS: Final = 60_000
_ATTITUDES: Final = frozenset({"ATTITUDE", "ATTITUDE_QUATERNION", "NAMED_VALUE_FLOAT"})
_ACCEPTED: Final = int(dialect.MAV_RESULT_ACCEPTED)
_DENIED: Final = int(dialect.MAV_RESULT_DENIED)


@dataclass(slots=True)
class AutopilotCounts:
    """Messages sent by name, attitudes heard from other components by name, commands by result."""

    sent: Counter[str] = field(default_factory=Counter)
    received: Counter[str] = field(default_factory=Counter)
    commands: Counter[str] = field(default_factory=Counter)


def granted_interval_ms(interval_us: int, loop_rate_hz: float) -> int | None:
    """Return the interval [ms] that ArduPilot grants for one asked, None where it denies.

    Whole milliseconds, at most one minute, and no more than 0.8 messages per cycle of the loop.
    """
    asked_ms = min(max(interval_us // 1000, 1), _SLOWEST_MS)
    return asked_ms if asked_ms >= int(1e6 / loop_rate_hz / _SHARE_OF_LOOP) else None


class SimulatedAutopilot:
    """A fixed wing under ArduPilot that flies a precomputed flight; component 1 of its system.

    `rows` [N] are the flight at `rate_hz`, which is also the rate of the autopilot's loop: every
    message goes out at a cycle of the loop with the values and the time of that cycle, so truth
    and measurements of one message agree exactly. Times are seconds since the flight began.
    """

    def __init__(
        self,
        rows: Rows,
        rate_hz: float,
        rates_hz: Mapping[str, float] = DEFAULT_RATES_HZ,
        signer: Signer | None = None,
        system: int = 1,
    ) -> None:
        self.system, self.component = system, 1
        self.counts = AutopilotCounts()
        self._rate_hz = rate_hz
        self._turns = len(rows)
        self._messages = FlightMessages(rows, rate_hz)
        self._encoder = Encoder(self.system, self.component, signer)
        self._order = {name: k for k, name in enumerate(self._messages.names)}
        self._name_of_id = {
            getattr(dialect, f"MAVLINK_MSG_ID_{name}"): name for name in self._messages.names
        }
        self._interval_us: dict[str, int] = {}
        self._default_us = {name: self._checked(name, hz) for name, hz in rates_hz.items()}
        self._queue: list[tuple[int, int, int, str]] = []
        self.parameters = AutopilotParameters(
            {
                "SYSID_THISMAV": ParamValue(float(self.system)),
                "SCHED_LOOP_RATE": ParamValue(rate_hz),
                "INS_ACCEL_FILTER": ParamValue(20.0),
                "INS_GYRO_FILTER": ParamValue(20.0),
                "AHRS_TRIM_X": ParamValue(0.0),
                "AHRS_TRIM_Y": ParamValue(0.0),
                **ardupilot_ins(),
            }
        )
        for name, interval_us in self._default_us.items():
            self._set_interval(name, interval_us, 0)

    def _checked(self, name: str, rate_hz: float) -> int:
        if name not in self._order:
            raise InvalidValueError(f"{name}: the simulated autopilot does not send it")
        if rate_hz == 0.0:
            return 0
        interval_ms = granted_interval_ms(int(1e6 / rate_hz), self._rate_hz)
        if interval_ms is None:
            raise InvalidValueError(
                f"{name} at {rate_hz:g} Hz: a loop of {self._rate_hz:g} Hz cannot send so often"
            )
        return interval_ms * 1000

    def _set_interval(self, name: str, interval_us: int, now_us: int) -> None:
        """Send `name` at multiples of the interval from now on, so equal rates coincide."""
        self._interval_us[name] = interval_us
        self._queue = [entry for entry in self._queue if entry[3] != name]
        heapq.heapify(self._queue)
        if interval_us:
            self._schedule(name, -(-now_us // interval_us) * interval_us)

    def _schedule(self, name: str, due_us: int) -> None:
        turn = math.ceil(due_us * self._rate_hz / 1e6)
        heapq.heappush(self._queue, (turn, self._order[name], due_us, name))

    def _pack(self, message: Any) -> bytes:
        self.counts.sent[message.get_type()] += 1
        return self._encoder.pack(message)

    @property
    def duration_s(self) -> float:
        """Length of the flight [s]."""
        return (self._turns - 1) / self._rate_hz

    def next_due(self) -> float:
        """Time of the next frame [s]; infinite when the flight is over or nothing is asked."""
        if not self._queue or self._queue[0][0] >= self._turns:
            return math.inf
        return self._queue[0][0] / self._rate_hz

    def due(self, now_s: float) -> list[bytes]:
        """Return the frames due up to now, in order."""
        last = min(math.floor(now_s * self._rate_hz + 1e-6), self._turns - 1)
        frames = []
        while self._queue and self._queue[0][0] <= last:
            turn, order, due_us, name = self._queue[0]
            due_us += self._interval_us[name]
            next_turn = math.ceil(due_us * self._rate_hz / 1e6)
            heapq.heapreplace(self._queue, (next_turn, order, due_us, name))
            frames.append(self._pack(self._messages.build(name, turn)))
        return frames

    def on_message(self, message: Any, now_s: float) -> list[bytes]:
        """Take a message from the link and return the frames that answer it."""
        name = message.get_type()
        if name in _ATTITUDES:
            if (
                message.get_srcSystem() == self.system
                and message.get_srcComponent() != self.component
            ):
                self.counts.received[name] += 1
        elif name == "TIMESYNC":
            if message.tc1 == 0:
                now_ns = (BOOT_US + int(now_s * 1e6)) * 1000
                return [self._pack(dialect.MAVLink_timesync_message(now_ns, message.ts1))]
        elif getattr(message, "target_system", -1) in (0, self.system) and (
            message.target_component in (0, self.component)
        ):
            if name == "COMMAND_LONG":
                return self._command(message, now_s)
            if name.startswith("PARAM_"):
                return [self._pack(answer) for answer in self.parameters.on_message(message)]
        return []

    def _command(self, command: Any, now_s: float) -> list[bytes]:
        result, replies = int(dialect.MAV_RESULT_UNSUPPORTED), []
        asked = self._name_of_id.get(int(command.param1)) if math.isfinite(command.param1) else None
        if command.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
            result = self._set_message_interval(asked, command.param2, now_s)
        elif command.command == dialect.MAV_CMD_GET_MESSAGE_INTERVAL:
            result = _ACCEPTED if asked else int(dialect.MAV_RESULT_FAILED)
            interval_us = (self._interval_us.get(asked, 0) or -1) if asked else 0
            if asked:
                replies.append(
                    dialect.MAVLink_message_interval_message(int(command.param1), interval_us)
                )
        elif command.command == dialect.MAV_CMD_REQUEST_MESSAGE:
            result = _ACCEPTED if asked else int(dialect.MAV_RESULT_FAILED)
            if asked:
                turn = min(max(int(now_s * self._rate_hz), 0), self._turns - 1)
                replies.append(self._messages.build(asked, turn))
        self._count_command(command.command, result)
        ack = dialect.MAVLink_command_ack_message(
            command.command, result, 0, 0, command.get_srcSystem(), command.get_srcComponent()
        )
        return [self._pack(reply) for reply in (ack, *replies)]

    def _set_message_interval(self, asked: str | None, interval: float, now_s: float) -> int:
        if asked is None or not math.isfinite(interval):
            return _DENIED
        interval_us = int(interval)
        if interval_us < 0:
            granted_us = 0
        elif interval_us == 0:
            granted_us = self._default_us.get(asked, 0)
        else:
            interval_ms = granted_interval_ms(interval_us, self._rate_hz)
            if interval_ms is None:
                return _DENIED
            granted_us = interval_ms * 1000
        self._set_interval(asked, granted_us, int(now_s * 1e6) + 1)
        return _ACCEPTED

    def _count_command(self, command: int, result: int) -> None:
        names = dialect.enums["MAV_CMD"], dialect.enums["MAV_RESULT"]
        what, how = (
            entries[value].name if value in entries else str(value)
            for entries, value in zip(names, (command, result), strict=True)
        )
        self.counts.commands[
            f"{what.removeprefix('MAV_CMD_')} {how.removeprefix('MAV_RESULT_')}"
        ] += 1
