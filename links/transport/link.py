"""What every link is: bytes in with a stamp and a peer, frames out, a state, and counts."""

import asyncio
import contextlib
import functools
import random
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar, Final

Peer = Hashable
"""Who sent the bytes: the address of a socket, or the path of a serial device."""

OnBytes = Callable[[bytes, int, Peer], None]
"""Called with the bytes, the receipt stamp [us] and the peer, from the event loop."""


class LinkState(Enum):
    """Where a link stands; CLOSED is final."""

    CONNECTING = "connecting"
    UP = "up"
    DOWN = "down"
    CLOSED = "closed"


OnState = Callable[[LinkState, str], None]
"""Called with a new state and the reason as a sentence."""


@dataclass(slots=True)
class LinkCounts:
    """What passed and what did not.

    `reads` datagrams, or reads of a stream; `sends` frames accepted; `send_failures` frames that
    `send` refused; `connects` times the link came up; `peers_refused` unknown peers rejected.
    """

    bytes_in: int = 0
    bytes_out: int = 0
    reads: int = 0
    sends: int = 0
    send_failures: int = 0
    connects: int = 0
    peers_refused: int = 0


@functools.cache
def _wall_minus_monotonic_ns() -> int:
    return time.time_ns() - time.monotonic_ns()


def receipt_clock() -> int:
    """Return the receipt stamp of this moment [us since 1970], two low bits clear.

    Wall time when the process first asked, plus monotonic time since: it never steps, also when
    the host's clock is set. A .tlog keeps a link number in the two low bits.
    """
    return (_wall_minus_monotonic_ns() + time.monotonic_ns()) // 1000 & ~3


class Link(ABC):
    """A way to exchange bytes with one vehicle; `transport.registry.open_link` makes one."""

    is_datagram: ClassVar[bool] = False
    """True where every `on_bytes` holds whole frames and nothing carries over to the next."""
    calls_first: ClassVar[bool] = False
    """True where the other side learns of us only by what we send."""

    def __init__(self, uri: str, on_bytes: OnBytes, on_state: OnState) -> None:
        self.uri = uri
        self.counts = LinkCounts()
        self.state = LinkState.CONNECTING
        self._on_bytes = on_bytes
        self._on_state = on_state

    @abstractmethod
    async def start(self) -> None:
        """Open the link, or begin to try; raise LinkOpenError where trying again cannot help."""

    @abstractmethod
    def _write(self, frame: bytes) -> bool:
        """Hand the whole frame to the system or refuse it; never block, never raise."""

    @abstractmethod
    async def close(self) -> None:
        """End the link and give back everything it holds; safe to call twice."""

    def send(self, frame: bytes) -> bool:
        """Send one frame now; False (and counted) where that is not possible."""
        if self.state is not LinkState.CLOSED and self._write(frame):
            self.counts.sends += 1
            self.counts.bytes_out += len(frame)
            return True
        self.counts.send_failures += 1
        return False

    def confirm(self, peer: Peer) -> None:  # noqa: B027 - only a link with many peers must know
        """Report to the link that a valid frame of our vehicle came from this peer.

        Call it for every such frame: a `udpin` link sends only to peers confirmed lately.
        """

    def _deliver(self, data: bytes, peer: Peer) -> None:
        counts = self.counts
        counts.bytes_in += len(data)
        counts.reads += 1
        self._on_bytes(data, receipt_clock(), peer)

    def _set_state(self, state: LinkState, why: str) -> None:
        if self.state is LinkState.CLOSED:
            return
        if state is LinkState.UP and self.state is not LinkState.UP:
            self.counts.connects += 1
        self.state = state
        self._on_state(state, why)


FIRST_DELAY_S: Final = 0.1
LAST_DELAY_S: Final = 5.0


class ReopeningLink(Link):
    """A link that opens, is lost, and opens again, with exponential back-off and jitter."""

    def __init__(self, uri: str, on_bytes: OnBytes, on_state: OnState) -> None:
        super().__init__(uri, on_bytes, on_state)
        self._lost: asyncio.Future[str] | None = None
        self._task: asyncio.Task[None] | None = None

    @abstractmethod
    async def _open(self) -> str:
        """Open once and say to what; raise OSError where that does not work now."""

    @abstractmethod
    def _release(self) -> None:
        """Give back what `_open` made, also half of it."""

    def _lose(self, why: str) -> None:
        if self._lost is not None and not self._lost.done():
            self._lost.set_result(why)

    async def start(self) -> None:
        """Begin to keep the link open."""
        self._task = asyncio.create_task(self._keep_open())

    async def _keep_open(self) -> None:
        delay_s = FIRST_DELAY_S
        said = ""
        while True:
            self._lost = asyncio.get_running_loop().create_future()
            try:
                where = await self._open()
            except OSError as error:
                self._release()
                why = f"{self.uri}: {error.strerror or error}; trying again"
                if why != said:
                    said = why
                    self._set_state(self.state, why)
            else:
                said = ""
                reads = self.counts.reads
                self._set_state(LinkState.UP, f"{self.uri}: connected to {where}")
                why = await self._lost
                if self.counts.reads > reads:
                    delay_s = FIRST_DELAY_S
                self._release()
                self._set_state(LinkState.DOWN, f"{self.uri}: {why}; trying again")
            await asyncio.sleep(delay_s * random.uniform(0.75, 1.25))
            delay_s = min(2 * delay_s, LAST_DELAY_S)

    async def close(self) -> None:
        """Stop trying and release the link."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
            self._task = None
        self._release()
        self._set_state(LinkState.CLOSED, f"{self.uri}: closed")
