"""Asks ArduPilot for its trim; the answer is recorded as it comes, and so replays. Sans I/O."""

from typing import Any, Final

from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.links.mavlink.vehicle_trim import TRIM_NAMES

ANSWER_S: Final = 1.0
ATTEMPTS: Final = 8
_ARDUPILOT: Final = int(dialect.MAV_AUTOPILOT_ARDUPILOTMEGA)


class TrimRequest:
    """Asks for each parameter until it arrives: eight times, each time waiting twice as long."""

    def __init__(self) -> None:
        self._missing: set[str] = set()
        self._attempts = 0
        self._next_s = float("-inf")

    def begin(self, autopilot: int) -> None:
        """Ask anew: an autopilot was adopted or restarted. Others than ArduPilot have no trim."""
        self._missing = set(TRIM_NAMES) if autopilot == _ARDUPILOT else set()
        self._attempts = 0
        self._next_s = float("-inf")

    def heard(self, message: Any) -> None:
        """Take a PARAM_VALUE of the autopilot."""
        self._missing.discard(str(message.param_id))

    def tick(self, now_s: float, system: int, component: int) -> list[Any]:
        """Return the requests that are due."""
        if not self._missing or self._attempts == ATTEMPTS or now_s < self._next_s:
            return []
        self._next_s = now_s + ANSWER_S * 2.0**self._attempts
        self._attempts += 1
        return [
            dialect.MAVLink_param_request_read_message(system, component, name.encode(), -1)
            for name in TRIM_NAMES
            if name in self._missing
        ]
