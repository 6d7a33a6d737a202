"""Which autopilot it is, by the number of its board: requested, and read where it is reported."""

from typing import Any, Final

from ahrs_service.links.component.trim_request import ANSWER_S, ATTEMPTS
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.links.mavlink.unit_name import unit_name

_VERSION: Final = int(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)


def unit_request(system: int, component: int) -> Any:
    """Return the request for the number of an autopilot's board."""
    return dialect.MAVLink_command_long_message(
        system, component, dialect.MAV_CMD_REQUEST_MESSAGE, 0, _VERSION, 0, 0, 0, 0, 0, 0
    )


class UnitRequest:
    """Asks for AUTOPILOT_VERSION until it comes: eight times, each time waiting twice as long.

    `unit` is its answer, empty before. Sans I/O.
    """

    def __init__(self) -> None:
        self.unit = ""
        self._is_open = False
        self._attempts = 0
        self._next_s = float("-inf")

    def begin(self) -> None:
        """Ask anew: an autopilot was adopted."""
        self._is_open = True
        self._attempts = 0
        self._next_s = float("-inf")

    def heard(self, message: Any) -> None:
        """Take an AUTOPILOT_VERSION of the autopilot."""
        self.unit = unit_name(message.uid, bytes(message.uid2)) or self.unit
        self._is_open = False

    def tick(self, now_s: float, system: int, component: int) -> list[Any]:
        """Return the request that is due."""
        if not self._is_open or self._attempts == ATTEMPTS or now_s < self._next_s:
            return []
        self._next_s = now_s + ANSWER_S * 2.0**self._attempts
        self._attempts += 1
        return [unit_request(system, component)]
