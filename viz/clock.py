"""The time axis of the viewer: time since the first sample, whole across clock jumps."""

from typing import Final

import numpy as np
import numpy.typing as npt

from ahrs_service.records import Rows

Nanoseconds = npt.NDArray[np.int64]

BACK_NS: Final = 1_000_000_000
AHEAD_NS: Final = 600_000_000_000
"""A step of the sender's clock back by more than `BACK_NS` or ahead by more than `AHEAD_NS` is a
clock that was set (a reboot, a GPS fix), not time that passed."""

_STRAY_NS: Final = 60_000_000_000


class Clock:
    """Converts the sender's `time_ns` to the viewer's t [ns]; remembers where it is.

    t = time_ns - offset_ns. At a jump the offset changes so that t goes on by what the receiver's
    clock counted meanwhile.
    """

    def __init__(self) -> None:
        self.now_ns = 0
        self._offsets_ns: list[int] = []
        self._time_ns = 0
        self._received_ns = 0

    def estimates(self, rows: Rows) -> Nanoseconds:
        """Return t [N] of ESTIMATE rows (at least one) in their order."""
        time_ns: Nanoseconds = rows["time_ns"].astype(np.int64)
        received_ns: Nanoseconds = rows["received_ns"].astype(np.int64)
        if not self._offsets_ns:
            self._offsets_ns = [int(time_ns[0])]
            self._time_ns, self._received_ns = int(time_ns[0]), int(received_ns[0])
        t = np.empty_like(time_ns)
        start = 0
        for jump in np.flatnonzero(_is_jump(np.diff(time_ns, prepend=self._time_ns))):
            self._advance(time_ns, received_ns, t, start, int(jump))
            passed_ns = min(max(int(received_ns[jump]) - self._received_ns, 0), AHEAD_NS)
            self._offsets_ns.append(int(time_ns[jump]) - self.now_ns - passed_ns)
            start = int(jump)
        self._advance(time_ns, received_ns, t, start, len(rows))
        return t

    def live(self, time_ns: Nanoseconds) -> Nanoseconds:
        """Return t [N] of stamps that came just now; a stamp from before a jump becomes now."""
        if not self._offsets_ns:
            return np.zeros_like(time_ns)
        t = time_ns - self._offsets_ns[-1]
        return np.where(np.abs(t - self.now_ns) < _STRAY_NS, t, self.now_ns)

    def whole(self, time_ns: Nanoseconds) -> Nanoseconds:
        """Return t [N] of a whole recording's stamps, jump for jump with its estimates."""
        if not self._offsets_ns:
            return np.zeros_like(time_ns)
        jumps = np.cumsum(_is_jump(np.diff(time_ns, prepend=time_ns[:1])))
        offsets = np.array(self._offsets_ns)[np.minimum(jumps, len(self._offsets_ns) - 1)]
        return np.asarray(time_ns - offsets, np.int64)

    def _advance(
        self, time_ns: Nanoseconds, received_ns: Nanoseconds, t: Nanoseconds, start: int, end: int
    ) -> None:
        if end == start:
            return
        t[start:end] = time_ns[start:end] - self._offsets_ns[-1]
        self._time_ns, self._received_ns = int(time_ns[end - 1]), int(received_ns[end - 1])
        self.now_ns = int(t[end - 1])


def _is_jump(step_ns: Nanoseconds) -> npt.NDArray[np.bool_]:
    jump: npt.NDArray[np.bool_] = (step_ns < -BACK_NS) | (step_ns > AHEAD_NS)
    return jump
