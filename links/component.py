"""The service as a MAVLink component: identity, heartbeat, requests, answers. Sans I/O.

Messages go in by `on_message`, what is to be sent comes out of it and of `tick`; time is what the
caller says. Only the adopted autopilot is believed; whoever else speaks on the link is counted.
"""

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any, Final

from ahrs_service.records import Record
from ahrs_service.settings import Settings
from links import commands
from links.attitude_messages import Publisher
from links.intervals import Intervals, Rate
from links.mavlink_codec import dialect
from links.parameters import ParameterServer
from links.timesync import TimeSync

HEARTBEAT_S: Final = 1.0
VEHICLE_LOST_S: Final = 5.0
STATUSTEXT_S: Final = 1.0
REPEAT_S: Final = 30.0
_TEXT_BYTES: Final = 50
_STRANGERS: Final = 16
_INVALID: Final = int(dialect.MAV_AUTOPILOT_INVALID)
_IMU_FALLBACK: Final = {"HIGHRES_IMU": "SCALED_IMU", "SCALED_IMU": "RAW_IMU"}
_STATES: Final = {
    "boot": int(dialect.MAV_STATE_BOOT),
    "active": int(dialect.MAV_STATE_ACTIVE),
    "critical": int(dialect.MAV_STATE_CRITICAL),
}


@dataclass(slots=True)
class Traffic:
    """Messages by who sent them: the adopted autopilot, others of its system, strangers."""

    vehicle: int = 0
    same_system: int = 0
    foreign: int = 0
    by_stranger: Counter[tuple[int, int]] = field(default_factory=Counter)


class Component:
    """Our end of the MAVLink conversation.

    `system` is 0 until an autopilot was adopted (by HEARTBEAT.autopilot, never by its component
    id); nothing but `call` is sent before. `settings` are those in force: PARAM_SET and
    SET_MESSAGE_INTERVAL change them.
    """

    def __init__(self, settings: Settings) -> None:
        link = settings.link
        self.system = 0
        self.component = link.component
        self.vehicle = (0, 0)
        self.traffic = Traffic()
        self.timesync = TimeSync()
        self.intervals = Intervals(_wanted(settings))
        self._wanted_system = settings.intake.system
        self._wanted_component = settings.intake.component
        self._own_system = link.system
        self._parameters = ParameterServer(settings)
        self._publisher = Publisher(settings.publish)
        self._events: list[tuple[str, str]] = []
        self._texts: deque[tuple[int, str]] = deque(maxlen=8)
        self._said: dict[str, float] = {}
        self._text_id = 0
        self._next_heartbeat_s = float("-inf")
        self._next_text_s = float("-inf")
        self._heard_s = float("-inf")
        self._lost = False
        self._boot_ms = 0
        self._fallen_back: set[str] = set()
        self._collision = False
        self._latest: Record | None = None
        self._handlers = {
            int(dialect.MAVLINK_MSG_ID_HEARTBEAT): self._on_heartbeat,
            int(dialect.MAVLINK_MSG_ID_SYSTEM_TIME): self._on_system_time,
            int(dialect.MAVLINK_MSG_ID_TIMESYNC): self._on_timesync,
            int(dialect.MAVLINK_MSG_ID_COMMAND_ACK): self._on_ack,
            int(dialect.MAVLINK_MSG_ID_COMMAND_LONG): self._on_command,
            int(dialect.MAVLINK_MSG_ID_COMMAND_INT): self._on_command,
            int(dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST): self._on_parameter,
            int(dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ): self._on_parameter,
            int(dialect.MAVLINK_MSG_ID_PARAM_SET): self._on_parameter,
        }

    @property
    def settings(self) -> Settings:
        """The settings in force."""
        return self._parameters.settings

    def is_vehicle(self, message: Any) -> bool:
        """Return whether the adopted autopilot sent this message."""
        return (message.get_srcSystem(), message.get_srcComponent()) == self.vehicle

    # -- in -----------------------------------------------------------------------------------

    def on_message(self, message: Any, now_s: float) -> list[Any]:
        """Take one message; return the answers."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        message_id = message.get_msgId()
        if sender == self.vehicle:
            self.traffic.vehicle += 1
            self.intervals.heard(message_id)
        elif self.system:
            self._count_stranger(sender)
        handler = self._handlers.get(message_id)
        return [] if handler is None else handler(message, sender, now_s)

    def _count_stranger(self, sender: tuple[int, int]) -> None:
        traffic = self.traffic
        if sender[0] == self.vehicle[0]:
            traffic.same_system += 1
        else:
            traffic.foreign += 1
        if sender in traffic.by_stranger or len(traffic.by_stranger) < _STRANGERS:
            traffic.by_stranger[sender] += 1

    def _on_heartbeat(self, message: Any, sender: tuple[int, int], now_s: float) -> list[Any]:
        if sender == (self.system, self.component) and not self._collision:
            self._collision = True
            self._tell(
                "warning",
                f"another component {self.component} speaks on system {self.system} "
                "(or our own frames come back); set link.component to a free number",
            )
        if message.autopilot == _INVALID:
            return []
        if self.system == 0:
            self._adopt(message, sender)
        elif sender != self.vehicle:
            self._tell_once(f"autopilot {sender[0]}/{sender[1]} is also on this link; ignored")
        if sender == self.vehicle:
            self._heard_s = now_s
            if self._lost:
                self._lost = False
                self._tell("info", "vehicle heard again; asking for its messages anew")
                self.intervals.forget()
        return []

    def _adopt(self, message: Any, sender: tuple[int, int]) -> None:
        if self._wanted_system not in (0, sender[0]) or self._wanted_component not in (
            0,
            sender[1],
        ):
            self._tell_once(
                f"autopilot {sender[0]}/{sender[1]} is not the one of intake.system; ignored"
            )
            return
        self.vehicle = sender
        self.system = self._own_system or sender[0]
        name = dialect.enums["MAV_AUTOPILOT"].get(message.autopilot)
        kind = "autopilot" if name is None else name.name.removeprefix("MAV_AUTOPILOT_")
        self._tell("info", f"adopted vehicle {sender[0]}/{sender[1]} ({kind})")

    def _on_system_time(self, message: Any, sender: tuple[int, int], now_s: float) -> list[Any]:
        """See a reboot: the time since boot went back."""
        del now_s
        if sender == self.vehicle:
            if message.time_boot_ms + 1000 < self._boot_ms:
                self._tell("warning", "the autopilot restarted; asking for its messages anew")
                self.intervals.forget()
            self._boot_ms = message.time_boot_ms
        return []

    def _on_timesync(self, message: Any, sender: tuple[int, int], now_s: float) -> list[Any]:
        return self.timesync.on_message(message, now_s) if sender == self.vehicle else []

    def _on_ack(self, message: Any, sender: tuple[int, int], now_s: float) -> list[Any]:
        target = (message.target_system, message.target_component)
        if sender == self.vehicle and target in ((self.system, self.component), (0, 0)):
            self.intervals.on_ack(message.command, message.result, now_s)
        return []

    def _is_for_us(self, message: Any) -> bool:
        return (
            self.system != 0
            and message.target_system == self.system
            and message.target_component == self.component
        )

    def _on_command(self, message: Any, sender: tuple[int, int], now_s: float) -> list[Any]:
        del now_s
        if not self._is_for_us(message):
            return []
        answers, self._parameters.settings = commands.answer(
            message, sender, self.settings, self._heartbeat("active"), self._latest
        )
        return answers

    def _on_parameter(self, message: Any, sender: tuple[int, int], now_s: float) -> list[Any]:
        del sender, now_s
        everyone = message.target_system == self.system and message.target_component == 0
        listing = message.get_type() == "PARAM_REQUEST_LIST"
        if self._is_for_us(message) or (everyone and listing and self.system):
            self._parameters.on_message(message)
        return []

    # -- out ----------------------------------------------------------------------------------

    def publish(self, estimate: Record) -> list[Any]:
        """Return the messages of this estimate that are due by its own time."""
        if self.system == 0:
            return []
        self._latest = estimate
        publish = self.settings.publish
        if publish is not self._publisher.settings:
            self._publisher = Publisher(publish)
        return self._publisher.messages(estimate)

    def tick(self, now_s: float, state: str) -> list[Any]:
        """Return what is due by time; `state` is boot, active or critical."""
        if self.system == 0:
            return []
        out: list[Any] = []
        if now_s >= self._next_heartbeat_s:
            self._next_heartbeat_s = now_s + HEARTBEAT_S
            out.append(self._heartbeat(state))
        if now_s - self._heard_s > VEHICLE_LOST_S:
            self._lose()
        else:
            self._fall_back_on_imu(now_s)
            out += self.intervals.tick(now_s, *self.vehicle)
            out += self.timesync.tick(now_s)
        out += self._parameters.tick()
        return out + self._next_text(now_s)

    def call(self) -> Any:
        """Return the heartbeat for a link on which nobody speaks before we do."""
        return self._heartbeat("boot")

    def _heartbeat(self, state: str) -> Any:
        return dialect.MAVLink_heartbeat_message(
            dialect.MAV_TYPE_ONBOARD_CONTROLLER, _INVALID, 0, 0, _STATES[state], 3
        )

    def _lose(self) -> None:
        if not self._lost:
            self._lost = True
            self._tell("warning", f"no heartbeat of the vehicle for {VEHICLE_LOST_S:.0f} s")

    def _fall_back_on_imu(self, now_s: float) -> None:
        """Where an IMU message is refused or never comes, want the next one as fast."""
        for name, fallback in _IMU_FALLBACK.items():
            rate = self.intervals.find(name)
            if rate is None or name in self._fallen_back:
                continue
            silent = rate.granted_hz is not None and now_s > rate.settled_s and not rate.measured_hz
            if rate.state in ("unsupported", "denied") or silent:
                self._fallen_back.add(name)
                self._tell("warning", f"{name} does not come ({rate.state}); asking for {fallback}")
                self.intervals.want(fallback, rate.wanted_hz)

    def announce(self, text: str, is_good: bool, now_s: float) -> None:
        """Queue a STATUSTEXT for the ground station; the same text at most every 30 s."""
        if now_s - self._said.get(text, float("-inf")) < REPEAT_S:
            return
        if len(self._said) > _STRANGERS:
            self._said.clear()
        self._said[text] = now_s
        severity = dialect.MAV_SEVERITY_INFO if is_good else dialect.MAV_SEVERITY_WARNING
        self._texts.append((int(severity), f"AHRS: {text}"))

    def _next_text(self, now_s: float) -> list[Any]:
        if not self._texts or now_s < self._next_text_s:
            return []
        self._next_text_s = now_s + STATUSTEXT_S
        severity, text = self._texts.popleft()
        data = text.encode("ascii", "replace")
        parts = [data[i : i + _TEXT_BYTES] for i in range(0, len(data), _TEXT_BYTES)]
        self._text_id = self._text_id % 65535 + 1
        text_id = self._text_id if len(parts) > 1 else 0
        return [
            dialect.MAVLink_statustext_message(severity, part, text_id, index)
            for index, part in enumerate(parts)
        ]

    def rates(self) -> list[Rate]:
        """Return what was asked, granted and measured per message."""
        return list(self.intervals.rates.values())

    def drain_events(self) -> list[tuple[str, str]]:
        """Return (level, sentence) of what happened since the last call."""
        events = self._events + self.intervals.events + self._parameters.events
        self._events, self.intervals.events, self._parameters.events = [], [], []
        return events

    def _tell(self, level: str, text: str) -> None:
        self._events.append((level, text))

    def _tell_once(self, text: str) -> None:
        if text not in self._said and len(self._said) <= _STRANGERS:
            self._said[text] = float("inf")
            self._tell("info", text)


def _wanted(settings: Settings) -> dict[str, float]:
    """Return the messages to ask for [Hz]: IMU, its temperature, aiding, the reference."""
    link = settings.link
    return {
        "HIGHRES_IMU": link.imu_rate_hz,
        "SCALED_IMU": link.temperature_rate_hz,
        "ATTITUDE": link.aiding_rate_hz,
        "VFR_HUD": link.aiding_rate_hz,
        "LOCAL_POSITION_NED": link.aiding_rate_hz,
        "SYSTEM_TIME": 1.0,
        "SCALED_PRESSURE": 1.0,
    }
