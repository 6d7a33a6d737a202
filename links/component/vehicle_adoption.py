"""Who speaks on the link: the autopilot that is adopted, others of its system, strangers."""

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any, Final

from ahrs_service.adoption import AUTOPILOT_INVALID, may_adopt
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.settings import Settings

Sender = tuple[int, int]
"""System and component number."""

_STRANGERS: Final = 16
_EVENTS: Final = 64


@dataclass(slots=True)
class Traffic:
    """Messages by who sent them: the adopted autopilot, others of its system, strangers.

    `by_stranger` keeps the first 16 senders; a flood of made-up ones only raises the sums.
    """

    vehicle: int = 0
    same_system: int = 0
    foreign: int = 0
    by_stranger: Counter[Sender] = field(default_factory=Counter)


class VehicleAdoption:
    """Adopts the first autopilot that the settings allow (adoption.may_adopt), and stays with it.

    `vehicle` is its address, (-1, -1) before; `system` our own system number, 0 before; `events`
    tell what a user should know, until taken.
    """

    def __init__(self, settings: Settings) -> None:
        self.system = 0
        self.component = settings.link.component
        self.vehicle: Sender = (-1, -1)
        self.traffic = Traffic()
        self.events: deque[tuple[str, str]] = deque(maxlen=_EVENTS)
        self._own_system = settings.link.system
        self._wanted_system = settings.intake.system
        self._wanted_component = settings.intake.component
        self._told: set[str] = set()

    def count(self, sender: Sender) -> None:
        """Count one message of somebody else than the vehicle."""
        traffic = self.traffic
        if sender[0] == self.vehicle[0]:
            traffic.same_system += 1
        else:
            traffic.foreign += 1
        if sender in traffic.by_stranger or len(traffic.by_stranger) < _STRANGERS:
            traffic.by_stranger[sender] += 1

    def heartbeat(self, message: Any, sender: Sender) -> bool:
        """Take a HEARTBEAT; return whether it is the vehicle's."""
        if self.system and sender == (self.system, self.component):
            self._tell_once(
                "warning",
                f"another component {self.component} speaks on system {self.system} "
                "(or our own frames come back); set link.component to a free number",
            )
        if message.autopilot == AUTOPILOT_INVALID:
            return False
        if self.system == 0:
            self._adopt(message.autopilot, sender)
        elif sender != self.vehicle:
            self._tell_once(
                "info", f"autopilot {sender[0]}/{sender[1]} is also on this link; ignored"
            )
        return sender == self.vehicle

    def _adopt(self, autopilot: int, sender: Sender) -> None:
        system, component = sender
        wanted = self._wanted_system, self._wanted_component
        if not may_adopt(system, component, autopilot, *wanted):
            if system == 0:
                self._tell_once("warning", "an autopilot calls itself system 0; ignored")
                return
            self._tell_once(
                "info", f"autopilot {system}/{component} is not the one of intake.system; ignored"
            )
            return
        self.vehicle = sender
        self.system = self._own_system or system
        name = dialect.enums["MAV_AUTOPILOT"].get(autopilot)
        kind = "autopilot" if name is None else name.name.removeprefix("MAV_AUTOPILOT_")
        self.events.append(("info", f"adopted vehicle {system}/{component} ({kind})"))

    def _tell_once(self, level: str, text: str) -> None:
        if text not in self._told and len(self._told) < _STRANGERS:
            self._told.add(text)
            self.events.append((level, text))
