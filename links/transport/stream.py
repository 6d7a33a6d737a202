"""A non-blocking byte stream on a file descriptor: what TCP and serial links share."""

import asyncio
import os
from collections.abc import Callable
from typing import Final

READ_BYTES: Final = 65536
CLOSE_S: Final = 1.0


class FdStream:
    """Reads and writes one descriptor from the event loop; the caller owns the descriptor.

    A frame goes to the system at once. What the system does not take waits, at most
    `limit_bytes`; a frame that does not fit any more is refused whole, so that what is sent stays
    fresh and no frame is cut.
    """

    def __init__(
        self,
        fd: int,
        on_data: Callable[[bytes], None],
        on_lost: Callable[[str], None],
        limit_bytes: int,
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._fd = fd
        self._on_data = on_data
        self._on_lost = on_lost
        self._limit_bytes = limit_bytes
        self._waiting = bytearray()
        self._drained: asyncio.Future[None] | None = None
        self._open = True
        self._loop.add_reader(fd, self._readable)

    def write(self, frame: bytes) -> bool:
        """Send the frame or queue it; False where the stream is gone or the queue is full."""
        if not self._open or len(self._waiting) + len(frame) > self._limit_bytes:
            return False
        sent = 0
        if not self._waiting:
            try:
                sent = os.write(self._fd, frame)
            except (BlockingIOError, InterruptedError):
                sent = 0
            except OSError as error:
                self._fail(error.strerror or str(error))
                return False
        if sent < len(frame):
            if not self._waiting:
                self._loop.add_writer(self._fd, self._writable)
            self._waiting += frame[sent:]
        return True

    def _readable(self) -> None:
        try:
            data = os.read(self._fd, READ_BYTES)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._fail(error.strerror or str(error))
            return
        if data:
            self._on_data(data)
        else:
            self._fail("the other side is gone")

    def _writable(self) -> None:
        try:
            sent = os.write(self._fd, self._waiting)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._fail(error.strerror or str(error))
            return
        del self._waiting[:sent]
        if not self._waiting:
            self._loop.remove_writer(self._fd)
            self._settle()

    def _settle(self) -> None:
        if self._drained is not None and not self._drained.done():
            self._drained.set_result(None)

    def _fail(self, why: str) -> None:
        self.detach()
        self._on_lost(why)

    async def drain(self) -> None:
        """Wait until what was queued is sent, or the stream is lost, but not long."""
        if self._open and self._waiting:
            self._drained = self._loop.create_future()
            await asyncio.wait([self._drained], timeout=CLOSE_S)

    def detach(self) -> None:
        """Leave the event loop; must come before the descriptor is closed."""
        if self._open:
            self._open = False
            self._loop.remove_reader(self._fd)
            self._loop.remove_writer(self._fd)
            self._settle()
