"""Plays a recording's frames over a link in real time, byte for byte as they were recorded."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from ahrs_service.links.logs.tlog import TlogFile
from ahrs_service.links.transport.link import Link, LinkState

BURST: Final = 64
"""Frames sent before yielding to the event loop although more are due."""
RETRY_S: Final = 0.001
RETRIES: Final = 1000


@dataclass(slots=True)
class PlayCounts:
    """Frames that the link accepted, and those it did not accept within a second."""

    sent: int = 0
    lost: int = 0


def due_s(
    received_us: npt.NDArray[np.int64], speed: float, max_gap_s: float
) -> npt.NDArray[np.float64]:
    """Return when each frame [N] is due [s] after the first.

    A gap longer than `max_gap_s` [s of the recording] is shortened to it; a step back in time
    is no gap. The result is divided by `speed`.
    """
    gaps_s = np.diff(received_us, prepend=received_us[:1]) / 1e6
    due: npt.NDArray[np.float64] = np.cumsum(np.clip(gaps_s, 0.0, max_gap_s)) / speed
    return due


async def play(
    log: TlogFile,
    link: Link,
    speed: float = 1.0,
    max_gap_s: float = float("inf"),
    progress: Callable[[int], None] = lambda frames: None,
) -> PlayCounts:
    """Send every frame of the log when it is due; `progress` gets the number due so far.

    A full link is waited for; frames are lost while it is down, as in flight.
    """
    counts = PlayCounts()
    due = due_s(log.frames["received_us"], speed, max_gap_s).tolist()
    starts = log.frames["offset"].tolist()
    stops = (log.frames["offset"] + log.frames["length"]).tolist()
    data = memoryview(log.data)  # type: ignore[arg-type]
    loop = asyncio.get_running_loop()
    begin_s = loop.time()
    for i, at_s in enumerate(due):
        wait_s = at_s - (loop.time() - begin_s)
        if wait_s > 0 or i % BURST == 0:
            progress(i)
            await asyncio.sleep(max(wait_s, 0.0))
        if await _send(link, bytes(data[starts[i] : stops[i]])):
            counts.sent += 1
        else:
            counts.lost += 1
    progress(len(due))
    return counts


async def _send(link: Link, frame: bytes) -> bool:
    for _ in range(RETRIES):
        if link.send(frame):
            return True
        if link.state is not LinkState.UP:
            return False
        await asyncio.sleep(RETRY_S)
    return False
