"""Message rates: asks for each by SET_MESSAGE_INTERVAL, checks the answer, measures what comes.

COMMAND_ACK names the command and not the message, so one request is under way at a time. A denied
rate steps down a ladder (ArduPilot grants at most 0.8 of its loop rate, in whole milliseconds),
a rate that is lost (a ground station or a reboot reset it) is asked for again, and an autopilot
that does not support this command is asked once by the older REQUEST_DATA_STREAM.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from ahrs_service.links.mavlink.codec import dialect

LADDER_HZ: Final = (
    1000.0,
    400.0,
    333.0,
    250.0,
    200.0,
    100.0,
    50.0,
    40.0,
    25.0,
    10.0,
    5.0,
    2.0,
    1.0,
)
ANSWER_S: Final = 0.7
ATTEMPTS: Final = 3
WINDOW_S: Final = 2.0
WINDOW_MESSAGES: Final = 5.0
"""Rates are measured over 2 s, slow ones over 5 messages: one late message must not matter."""
SETTLING_S: Final = 5.0
"""A rate is judged this long after it was granted, not before."""
ASK_AGAIN_S: Final = 10.0
LONGEST_ASK_AGAIN_S: Final = 120.0
LOST_SHARE: Final = 0.5
WHEN_NEW: Final = frozenset({"GPS_RAW_INT"})
"""Sent only when there is something new, however often it was asked for,"""
LOST_SHARE_WHEN_NEW: Final = 0.02
"""so only silence indicates a loss."""
LATE_ANSWER_S: Final = 0.3
"""How much later than the first the answers to repeated requests may come."""
SLOW_STREAM_HZ: Final = 5
_EVENTS: Final = 64

_SET_INTERVAL: Final = int(dialect.MAV_CMD_SET_MESSAGE_INTERVAL)
_ACCEPTED: Final = int(dialect.MAV_RESULT_ACCEPTED)
_IN_PROGRESS: Final = int(dialect.MAV_RESULT_IN_PROGRESS)
_NOT_NOW: Final = int(dialect.MAV_RESULT_TEMPORARILY_REJECTED)
_REFUSED: Final = (int(dialect.MAV_RESULT_DENIED), int(dialect.MAV_RESULT_FAILED))


@dataclass(slots=True)
class Rate:
    """One message: rates asked, granted and measured [Hz], and their status in words."""

    name: str
    message_id: int
    wanted_hz: float
    asked_hz: float
    granted_hz: float | None = None
    measured_hz: float = 0.0
    state: str = "not asked yet"
    settled_s: float = float("inf")
    retry_s: float = float("-inf")
    patience_s: float = ASK_AGAIN_S
    patient_until_s: float = float("-inf")
    attempts: int = 0
    window_s: float = float("-inf")
    is_low: bool = False
    count: int = 0
    heard: int = 0
    first_s: float = float("-inf")
    last_s: float = float("-inf")

    @property
    def mean_hz(self) -> float:
        """Mean rate from the first to the last message heard [Hz], silence between included."""
        if self.last_s <= self.first_s:
            return 0.0
        return (self.heard - 1) / (self.last_s - self.first_s)

    def is_silent(self, now_s: float) -> bool:
        """Return whether nothing comes although it was granted."""
        return (
            self.granted_hz is not None
            and now_s > self.settled_s
            and now_s - self.last_s > max(SETTLING_S, WINDOW_MESSAGES / self.granted_hz)
        )


class Intervals:
    """Keeps the wanted rates; `events` tell what a user should know, until taken."""

    def __init__(self, wanted_hz: Mapping[str, float]) -> None:
        self.rates: dict[int, Rate] = {}
        self.events: deque[tuple[str, str]] = deque(maxlen=_EVENTS)
        self._asking: Rate | None = None
        self._deadline_s = 0.0
        self._quiet_until_s = float("-inf")
        self._window_s = float("-inf")
        self._understood = False
        self._old_way = False
        for name, hertz in wanted_hz.items():
            self.want(name, hertz)

    def want(self, name: str, hertz: float) -> None:
        """Want a message at `hertz`, or at more than was wanted before; 0 leaves it alone."""
        message_id = int(getattr(dialect, f"MAVLINK_MSG_ID_{name}"))
        known = self.rates.get(message_id)
        if hertz > (0.0 if known is None else known.wanted_hz):
            self.rates[message_id] = Rate(name, message_id, hertz, hertz)

    def find(self, name: str) -> Rate | None:
        """Return the rate of one message, None if it is not wanted."""
        return self.rates.get(int(getattr(dialect, f"MAVLINK_MSG_ID_{name}")))

    def forget(self) -> None:
        """Ask for everything anew: the autopilot restarted or the link came back."""
        self._asking = None
        self._window_s = float("-inf")
        self._understood = self._old_way = False
        self.pause()
        for rate in self.rates.values():
            rate.asked_hz, rate.granted_hz, rate.measured_hz = rate.wanted_hz, None, 0.0
            rate.retry_s, rate.patience_s, rate.attempts = float("-inf"), ASK_AGAIN_S, 0
            rate.patient_until_s = float("-inf")
            rate.state = "not asked yet"

    def pause(self) -> None:
        """Measure anew: while the link stalls, no rate can be judged."""
        for rate in self.rates.values():
            rate.window_s, rate.is_low = float("-inf"), False

    def heard(self, message_id: int, now_s: float) -> None:
        """Count one message of the autopilot."""
        rate = self.rates.get(message_id)
        if rate is not None:
            if not rate.heard:
                rate.first_s = now_s
            rate.last_s = now_s
            rate.heard += 1
            rate.count += 1

    def tick(self, now_s: float, system: int, component: int) -> list[Any]:
        """Measure, and return the request that is due, if any."""
        self._measure(now_s)
        if self._asking is not None:
            if now_s < self._deadline_s:
                return []
            self._give_up_waiting(self._asking, now_s)
        if now_s < self._quiet_until_s:
            return []
        if self._asking is None:
            if self._is_deaf():
                return self._ask_the_old_way(system, component)
            self._asking = self._next_to_ask(now_s)
        if self._asking is None:
            return []
        self._asking.attempts += 1
        self._deadline_s = now_s + ANSWER_S
        repeated, message_id = self._asking.attempts - 1, self._asking.message_id
        numbers = (message_id, 1e6 / self._asking.asked_hz, 0, 0, 0, 0, 0)
        return [
            dialect.MAVLink_command_long_message(
                system, component, _SET_INTERVAL, repeated, *numbers
            )
        ]

    def on_ack(self, command: int, result: int, now_s: float) -> None:
        """Take the autopilot's answer to the request under way."""
        rate = self._asking
        if command != _SET_INTERVAL or rate is None:
            return
        if result == _IN_PROGRESS:
            self._deadline_s = now_s + ANSWER_S
            return
        self._finish(rate, now_s)
        # Old autopilots answer UNSUPPORTED to what they do not know: that is no understanding.
        self._understood |= result in (_ACCEPTED, _NOT_NOW, *_REFUSED)
        if result == _ACCEPTED:
            self._grant(rate, now_s)
        elif result in _REFUSED:
            self._step_down(rate, now_s)
        elif result == _NOT_NOW:
            self._postpone(rate, "rejected for now", now_s)
        else:
            rate.state = "unsupported"
            rate.retry_s = float("inf")

    def _finish(self, rate: Rate, now_s: float) -> None:
        """End the request under way; answers to its repetitions are not those of the next one."""
        if rate.attempts > 1:
            self._quiet_until_s = now_s + (rate.attempts - 1) * ANSWER_S + LATE_ANSWER_S
        rate.attempts = 0
        self._asking = None

    def _grant(self, rate: Rate, now_s: float) -> None:
        changed = rate.granted_hz != rate.asked_hz
        rate.granted_hz = rate.asked_hz
        rate.settled_s = now_s + SETTLING_S
        rate.window_s, rate.count = now_s, 0
        rate.retry_s = float("inf")
        rate.state = "granted"
        if changed and rate.asked_hz < rate.wanted_hz:
            self.events.append(
                (
                    "warning",
                    f"{rate.name}: {rate.wanted_hz:.0f} Hz denied, {rate.asked_hz:.0f} Hz granted; "
                    "a higher loop rate of the autopilot allows more",
                )
            )

    def _step_down(self, rate: Rate, now_s: float) -> None:
        rate.granted_hz = None
        lower = [hertz for hertz in LADDER_HZ if hertz < rate.asked_hz]
        if lower:
            rate.asked_hz = lower[0]
            rate.retry_s = float("-inf")
            rate.state = f"denied, asking for {rate.asked_hz:.0f} Hz"
            return
        rate.state, rate.retry_s = "denied", now_s + LONGEST_ASK_AGAIN_S
        rate.asked_hz = rate.wanted_hz

    def _give_up_waiting(self, rate: Rate, now_s: float) -> None:
        if rate.attempts < ATTEMPTS:
            return
        self._asking = None
        rate.attempts = 0
        self._postpone(rate, "no answer", now_s)

    def _postpone(self, rate: Rate, state: str, now_s: float) -> None:
        rate.granted_hz, rate.state = None, state
        rate.retry_s = now_s + rate.patience_s
        rate.patience_s = min(2.0 * rate.patience_s, LONGEST_ASK_AGAIN_S)

    def _next_to_ask(self, now_s: float) -> Rate | None:
        """Return the request that has waited longest, so none is starved."""
        first = min(self.rates.values(), key=lambda rate: rate.retry_s, default=None)
        return first if first is not None and first.retry_s <= now_s else None

    def _is_deaf(self) -> bool:
        """Return whether no request was understood and the old way is still open."""
        if self._understood or self._old_way:
            return False
        return all(rate.state in ("no answer", "unsupported") for rate in self.rates.values())

    def _ask_the_old_way(self, system: int, component: int) -> list[Any]:
        """Ask by streams."""
        self._old_way = True
        self.events.append(
            ("warning", "SET_MESSAGE_INTERVAL is not understood; asking by REQUEST_DATA_STREAM")
        )
        hertz = int(min(50.0, max(rate.wanted_hz for rate in self.rates.values())))
        streams = {
            dialect.MAV_DATA_STREAM_RAW_SENSORS: hertz,
            dialect.MAV_DATA_STREAM_EXTRA1: hertz,
            dialect.MAV_DATA_STREAM_EXTRA2: hertz,
            dialect.MAV_DATA_STREAM_POSITION: hertz,
            # The GPS among much else that nobody needs often.
            dialect.MAV_DATA_STREAM_EXTENDED_STATUS: min(hertz, SLOW_STREAM_HZ),
        }
        return [
            dialect.MAVLink_request_data_stream_message(system, component, stream, rate_hz, 1)
            for stream, rate_hz in streams.items()
        ]

    def _measure(self, now_s: float) -> None:
        if now_s - self._window_s < WINDOW_S:
            return
        self._window_s = now_s
        for rate in self.rates.values():
            elapsed_s = now_s - rate.window_s
            if elapsed_s * (rate.granted_hz or rate.wanted_hz) < WINDOW_MESSAGES:
                continue
            rate.window_s, count, rate.count = now_s, rate.count, 0
            if elapsed_s < float("inf"):
                rate.measured_hz = count / elapsed_s
                self._judge(rate, now_s)

    def _judge(self, rate: Rate, now_s: float) -> None:
        """Ask again for a granted rate that is gone, twice in a row: a short stall is none."""
        if rate.granted_hz is None or now_s < rate.settled_s:
            return
        share = LOST_SHARE_WHEN_NEW if rate.name in WHEN_NEW else LOST_SHARE
        if rate.measured_hz >= share * rate.granted_hz:
            rate.state = "granted"
            rate.patience_s, rate.is_low = ASK_AGAIN_S, False
            return
        was_low, rate.is_low = rate.is_low, True
        if not was_low:
            return
        rate.state = f"granted, yet {rate.measured_hz:.1f} Hz come"
        if now_s >= rate.patient_until_s:
            rate.retry_s = now_s
            rate.patient_until_s = now_s + rate.patience_s
            rate.patience_s = min(2.0 * rate.patience_s, LONGEST_ASK_AGAIN_S)
            self.events.append(
                (
                    "warning",
                    f"{rate.name}: {rate.granted_hz:.0f} Hz granted, "
                    f"{rate.measured_hz:.1f} Hz measured; asking again",
                )
            )
