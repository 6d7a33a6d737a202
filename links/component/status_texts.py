"""STATUSTEXT to the ground station: sparse, in chunks of 50 bytes, the latest always sent."""

from collections import deque
from typing import Any, Final

from ahrs_service.links.mavlink.codec import dialect

PACE_S: Final = 1.0
REPEAT_S: Final = 30.0
REMARK_S: Final = 5.0
_CHUNK_BYTES: Final = 50
_LONGEST_BYTES: Final = 5 * _CHUNK_BYTES
_REMEMBERED: Final = 16


class StatusTexts:
    """Queue of texts: one a second, the same one at most every 30 s.

    A text that comes back too early is held until its 30 s are over, unless another one follows:
    what the ground station read last is what holds.
    """

    def __init__(self) -> None:
        self._queue: deque[tuple[int, str]] = deque(maxlen=8)
        self._said_s: dict[str, float] = {}
        self._last = ""
        self._held: tuple[str, bool] | None = None
        self._next_s = float("-inf")
        self._next_remark_s = float("-inf")
        self._id = 0

    def announce(self, text: str, is_good: bool, now_s: float) -> None:
        """Queue a text, as a warning unless it `is_good`."""
        self._held = None
        if now_s - self._said_s.get(text, float("-inf")) >= REPEAT_S:
            self._enqueue(text, is_good, now_s)
        elif text != self._last:
            self._held = text, is_good

    def remark(self, text: str, now_s: float) -> None:
        """Queue what holds for a moment only: one in 5 s, and none while a text waits."""
        if self._queue or now_s < self._next_remark_s:
            return
        self._next_remark_s = now_s + REMARK_S
        self._queue.append((int(dialect.MAV_SEVERITY_WARNING), f"AHRS: {text}"))

    def tick(self, now_s: float) -> list[Any]:
        """Return the messages of the text that is due, if any."""
        if self._held is not None:
            self.announce(*self._held, now_s)
        if not self._queue or now_s < self._next_s:
            return []
        self._next_s = now_s + PACE_S
        return self._messages(*self._queue.popleft())

    def _enqueue(self, text: str, is_good: bool, now_s: float) -> None:
        self._said_s.pop(text, None)
        self._said_s[text] = now_s
        if len(self._said_s) > _REMEMBERED:
            del self._said_s[next(iter(self._said_s))]
        self._last = text
        severity = dialect.MAV_SEVERITY_INFO if is_good else dialect.MAV_SEVERITY_WARNING
        self._queue.append((int(severity), f"AHRS: {text}"))

    def _messages(self, severity: int, text: str) -> list[Any]:
        data = text.encode("ascii", "replace")[:_LONGEST_BYTES]
        parts = [data[i : i + _CHUNK_BYTES] for i in range(0, len(data), _CHUNK_BYTES)]
        text_id = 0
        if len(parts) > 1:
            self._id = text_id = self._id % 65535 + 1
        return [
            dialect.MAVLink_statustext_message(severity, part, text_id, index)
            for index, part in enumerate(parts)
        ]
