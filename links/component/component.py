"""The service as a MAVLink component: identity, heartbeat, requests, answers. Sans I/O.

Messages go in by `on_message`, what is to be sent comes out of it and of `tick`; time is what the
caller says. Only the adopted autopilot is believed; other senders on the link are counted.
"""

from collections import deque
from typing import Any, Final

from ahrs_service.links.component import commands
from ahrs_service.links.component.attitude_messages import Publisher
from ahrs_service.links.component.message_rates import Intervals, Rate
from ahrs_service.links.component.own_parameters import ParameterServer
from ahrs_service.links.component.status_texts import StatusTexts
from ahrs_service.links.component.timesync import TimeSync
from ahrs_service.links.component.trim_request import TrimRequest
from ahrs_service.links.component.unit_request import UnitRequest
from ahrs_service.links.component.vehicle_adoption import Sender, Traffic, VehicleAdoption
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.records import Phase, Record
from ahrs_service.settings import Settings

HEARTBEAT_S: Final = 1.0
VEHICLE_LOST_S: Final = 5.0
HEARTBEAT_LATE_S: Final = 2.5
"""The link stalls: it is no time to ask for anything, nor to judge what comes."""
ESTIMATE_STALE_S: Final = 1.0
RESTART_SIGNS_S: Final = 10.0
"""Two signs of one restart (SYSTEM_TIME, TIMESYNC) come within this time."""
_EVENTS: Final = 64
_BOOT_WRAP_MS: Final = 1 << 32
_NEAR_WRAP_MS: Final = 60_000
_INVALID: Final = int(dialect.MAV_AUTOPILOT_INVALID)
_IMU_FALLBACK: Final = {"HIGHRES_IMU": "SCALED_IMU", "SCALED_IMU": "RAW_IMU"}
_STATES: Final = {
    "boot": int(dialect.MAV_STATE_BOOT),
    "active": int(dialect.MAV_STATE_ACTIVE),
    "critical": int(dialect.MAV_STATE_CRITICAL),
}


class Component:
    """Our end of the MAVLink conversation.

    `system` is 0 until an autopilot was adopted (by HEARTBEAT.autopilot, never by its component
    id); nothing but `call` is sent before. `settings` are those in force: PARAM_SET and
    SET_MESSAGE_INTERVAL change them. Every `now_s` is of one steady clock [s].
    """

    def __init__(self, settings: Settings) -> None:
        self.component = settings.link.component
        self.timesync = TimeSync()
        self.intervals = Intervals(_wanted(settings))
        self._neighbours = VehicleAdoption(settings)
        self._parameters = ParameterServer(settings)
        self._publisher = Publisher(settings.publish)
        self._events: deque[tuple[str, str]] = deque(maxlen=_EVENTS)
        self._texts = StatusTexts()
        self._trim = TrimRequest()
        self._unit = UnitRequest()
        # A recording that names its unit makes a calibration that does.
        self._wants_unit = bool(settings.sensor.calibration or settings.recorder.directory)
        self._autopilot = _INVALID
        self._state = "boot"
        self._next_heartbeat_s = float("-inf")
        self._heard_s = float("-inf")
        self._restarted_s = float("-inf")
        self._lost = False
        self._boot_ms = 0
        self._latest: Record | None = None
        self._published = False
        self._published_s = float("-inf")
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
            int(dialect.MAVLINK_MSG_ID_PARAM_VALUE): self._on_parameter_value,
            int(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION): self._on_version,
        }

    @property
    def system(self) -> int:
        """Our system number, 0 before an autopilot was adopted."""
        return self._neighbours.system

    @property
    def vehicle(self) -> Sender:
        """System and component number of the adopted autopilot, (-1, -1) before."""
        return self._neighbours.vehicle

    @property
    def unit(self) -> str:
        """The number of the autopilot's board, as unit_request writes it; "" before."""
        return self._unit.unit

    @property
    def traffic(self) -> Traffic:
        """Messages received, by sender."""
        return self._neighbours.traffic

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
        neighbours = self._neighbours
        if sender == neighbours.vehicle:
            neighbours.traffic.vehicle += 1
            self.intervals.heard(message_id, now_s)
        elif neighbours.system:
            neighbours.count(sender)
        handler = self._handlers.get(message_id)
        return [] if handler is None else handler(message, sender, now_s)

    def _on_heartbeat(self, message: Any, sender: Sender, now_s: float) -> list[Any]:
        if self._neighbours.heartbeat(message, sender):
            self._heard_s = now_s
            if self._autopilot == _INVALID:
                self._autopilot = message.autopilot
                self._trim.begin(self._autopilot)
                if self._wants_unit:
                    self._unit.begin()
            if self._lost:
                self._lost = False
                self._report("info", "vehicle heard again; asking for its messages anew")
                self._trim.begin(self._autopilot)
        return []

    def _on_system_time(self, message: Any, sender: Sender, now_s: float) -> list[Any]:
        """See a restart: the time since boot went back (and not round, after 49.7 days)."""
        if sender == self.vehicle:
            boot_ms, last_ms = message.time_boot_ms, self._boot_ms
            wrapped = last_ms > _BOOT_WRAP_MS - _NEAR_WRAP_MS and boot_ms < _NEAR_WRAP_MS
            if boot_ms + 1000 < last_ms and not wrapped:
                self._restart(now_s)
            self._boot_ms = boot_ms
        return []

    def _on_timesync(self, message: Any, sender: Sender, now_s: float) -> list[Any]:
        if sender != self.vehicle:
            return []
        jumps = self.timesync.jumps
        answers = self.timesync.on_message(message, now_s)
        if self.timesync.jumps != jumps:
            jump_s = self.timesync.jump_ns / 1e9
            self._report("warning", f"the autopilot's clock jumped by {jump_s:+.1f} s against ours")
            if jump_s < 0.0:
                self._restart(now_s)
        return answers

    def _restart(self, now_s: float) -> None:
        """Start again with an autopilot that lost our requests."""
        if now_s - self._restarted_s < RESTART_SIGNS_S:
            return
        self._restarted_s = now_s
        self._report("warning", "the autopilot restarted; asking for its messages anew")
        self.intervals.forget()
        self._trim.begin(self._autopilot)

    def _on_ack(self, message: Any, sender: Sender, now_s: float) -> list[Any]:
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

    def _on_command(self, message: Any, sender: Sender, now_s: float) -> list[Any]:
        del now_s
        if not self._is_for_us(message):
            return []
        latest = self._latest
        # The record is the estimator's own and may have changed since it was published.
        if latest is not None and latest["phase"] != Phase.RUNNING:
            latest = None
        answers, self._parameters.settings = commands.answer(
            message, sender, self.settings, self._heartbeat(), latest
        )
        return answers

    def _on_parameter(self, message: Any, sender: Sender, now_s: float) -> list[Any]:
        del sender
        # A request to all components for their lists includes us.
        is_list = message.get_type() == "PARAM_REQUEST_LIST"
        reaches_us = message.target_system in (0, self.system) and (
            message.target_component in (0, self.component)
        )
        if self._is_for_us(message) or (is_list and reaches_us and self.system):
            refusal = self._parameters.on_message(message)
            if refusal:
                self._texts.remark(refusal, now_s)
        return []

    def _on_parameter_value(self, message: Any, sender: Sender, now_s: float) -> list[Any]:
        del now_s
        if sender == self.vehicle:
            self._trim.heard(message)
        return []

    def _on_version(self, message: Any, sender: Sender, now_s: float) -> list[Any]:
        del now_s
        if sender == self.vehicle:
            self._unit.heard(message)
        return []

    # -- out ----------------------------------------------------------------------------------

    def publish(self, estimate: Record) -> list[Any]:
        """Return the messages of this estimate that are due by its own time."""
        if self.system == 0:
            return []
        self._latest, self._published = estimate, True
        publish = self.settings.publish
        if publish is not self._publisher.settings:
            self._publisher = Publisher(publish)
        return self._publisher.messages(estimate)

    def tick(self, now_s: float, state: str) -> list[Any]:
        """Return what is due by time; `state` is boot, active or critical."""
        if self.system == 0:
            return []
        self._state = state
        out: list[Any] = []
        late_s = now_s - self._next_heartbeat_s
        if late_s >= 0.0:
            # On a grid: counted from this tick, every beat would come a tick later.
            self._next_heartbeat_s = now_s + HEARTBEAT_S - (late_s if late_s < HEARTBEAT_S else 0.0)
            out.append(self._heartbeat())
        silence_s = now_s - self._heard_s
        if silence_s > VEHICLE_LOST_S:
            self._lose()
        elif silence_s > HEARTBEAT_LATE_S:
            self.intervals.pause()
        else:
            self._fall_back_on_imu(now_s)
            out += self.intervals.tick(now_s, *self.vehicle)
            out += self.timesync.tick(now_s)
            out += self._trim.tick(now_s, *self.vehicle)
            out += self._unit.tick(now_s, *self.vehicle)
        self._let_estimate_age(now_s)
        return out + self._parameters.tick() + self._texts.tick(now_s)

    def call(self) -> Any:
        """Return the heartbeat for a link on which nobody speaks before we do."""
        return self._heartbeat()

    def _heartbeat(self) -> Any:
        return dialect.MAVLink_heartbeat_message(
            dialect.MAV_TYPE_ONBOARD_CONTROLLER, _INVALID, 0, 0, _STATES[self._state], 3
        )

    def _let_estimate_age(self, now_s: float) -> None:
        """Forget the estimate that REQUEST_MESSAGE would get, when no new one comes."""
        if self._published:
            self._published, self._published_s = False, now_s
        elif now_s - self._published_s > ESTIMATE_STALE_S:
            self._latest = None

    def _lose(self) -> None:
        if not self._lost:
            self._lost = True
            self._report("warning", f"no heartbeat of the vehicle for {VEHICLE_LOST_S:.0f} s")
            self.intervals.forget()

    def _fall_back_on_imu(self, now_s: float) -> None:
        """Where an IMU message is refused or never comes, want the next one as fast."""
        for name, fallback in _IMU_FALLBACK.items():
            rate, other = self.intervals.find(name), self.intervals.find(fallback)
            if rate is None or (other is not None and other.wanted_hz >= rate.wanted_hz):
                continue
            if rate.state in ("unsupported", "denied") or rate.is_silent(now_s):
                self._report(
                    "warning", f"{name} does not come ({rate.state}); asking for {fallback}"
                )
                self.intervals.want(fallback, rate.wanted_hz)

    def announce(self, text: str, is_good: bool, now_s: float) -> None:
        """Queue a STATUSTEXT for the ground station; the same text at most every 30 s."""
        self._texts.announce(text, is_good, now_s)

    def rates(self) -> list[Rate]:
        """Return what was asked, granted and measured per message."""
        return list(self.intervals.rates.values())

    def drain_events(self) -> list[tuple[str, str]]:
        """Return (level, sentence) of what happened since the last call."""
        sources = (
            self._neighbours.events,
            self._events,
            self.intervals.events,
            self._parameters.events,
        )
        events = [event for source in sources for event in source]
        for source in sources:
            source.clear()
        return events

    def _report(self, level: str, text: str) -> None:
        self._events.append((level, text))


def _wanted(settings: Settings) -> dict[str, float]:
    """Return the messages to ask for [Hz]: IMU, its temperature, aiding, the reference."""
    link = settings.link
    return {
        "HIGHRES_IMU": link.imu_rate_hz,
        "SCALED_IMU": link.temperature_rate_hz,
        "ATTITUDE": link.aiding_rate_hz,
        "VFR_HUD": link.aiding_rate_hz,
        "LOCAL_POSITION_NED": link.aiding_rate_hz,
        "GPS_RAW_INT": link.aiding_rate_hz,
        "SYSTEM_TIME": 1.0,
        "SCALED_PRESSURE": 1.0,
    }
