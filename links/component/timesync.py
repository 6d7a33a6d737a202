"""The offset between the autopilot's clock and ours, by TIMESYNC (as NTP does it).

We ask with our time in ts1 and tc1 = 0; the reply mirrors ts1 and gives the autopilot's time in
tc1. offset = tc1 - (ts1 + now) / 2, wrong by at most half the round trip; of the last replies the
one with the shortest round trip is believed.
"""

from collections import deque
from typing import Any, Final

from ahrs_service.links.mavlink.codec import dialect

PERIOD_S: Final = 1.0
_KEPT: Final = 10
_LONGEST_ROUND_TRIP_NS: Final = 500_000_000
_REBOOT_NS: Final = 1_000_000_000
"""No crystal drifts by this much within ten replies: the autopilot's clock was restarted."""


class TimeSync:
    """Asks once a second and keeps the best of the last ten replies.

    `offset_ns` autopilot's clock minus ours, None before the first reply; `round_trip_ns` of
    that reply; `jumps` how often the autopilot's clock was restarted, `jump_ns` by how much it
    jumped the last time.
    """

    def __init__(self) -> None:
        self.offset_ns: int | None = None
        self.round_trip_ns: int | None = None
        self.jumps = 0
        self.jump_ns = 0
        self._asked: deque[int] = deque(maxlen=_KEPT)
        self._replies: deque[tuple[int, int]] = deque(maxlen=_KEPT)
        self._next_s = float("-inf")

    def tick(self, now_s: float) -> list[Any]:
        """Return our question when it is time for it."""
        if now_s < self._next_s:
            return []
        self._next_s = now_s + PERIOD_S
        ts1 = int(now_s * 1e9)
        self._asked.append(ts1)
        return [dialect.MAVLink_timesync_message(0, ts1)]

    def on_message(self, message: Any, now_s: float) -> list[Any]:
        """Take a reply to us, or answer the autopilot's own question."""
        if message.tc1 == 0:
            return [dialect.MAVLink_timesync_message(int(now_s * 1e9), message.ts1)]
        if message.ts1 not in self._asked:
            return []
        self._asked.remove(message.ts1)
        now_ns = int(now_s * 1e9)
        round_trip_ns = now_ns - message.ts1
        if 0 <= round_trip_ns <= _LONGEST_ROUND_TRIP_NS:
            self._take(message.tc1 - (message.ts1 + now_ns) // 2, round_trip_ns)
        return []

    def _take(self, offset_ns: int, round_trip_ns: int) -> None:
        if self.offset_ns is not None and abs(offset_ns - self.offset_ns) > _REBOOT_NS:
            self.jumps += 1
            self.jump_ns = offset_ns - self.offset_ns
            self._replies.clear()
        self._replies.append((round_trip_ns, offset_ns))
        self.round_trip_ns, self.offset_ns = min(self._replies)
