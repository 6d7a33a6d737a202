"""Serial link: `serial:DEV:BAUD`; a device that is unplugged is opened again when it is back."""

import errno
import os
import termios
from typing import Final

import serial

from ahrs_service.errors import LinkOpenError, UriError
from ahrs_service.links.transport.link import OnBytes, OnState, ReopeningLink
from ahrs_service.links.transport.stream import FdStream

QUEUE_BYTES: Final = 4096
NO_PORT: Final = (errno.ENOTTY, errno.EINVAL, errno.EISDIR, errno.ENOTDIR)
BUSY: Final = "another program holds the device"


class SerialLink(ReopeningLink):
    """A serial port, 8N1 without flow control, held alone.

    DEV may hold colons, as names under /dev/serial/by-path do: BAUD is what follows the last one.
    """

    def __init__(self, uri: str, rest: str, on_bytes: OnBytes, on_state: OnState) -> None:
        super().__init__(uri, on_bytes, on_state)
        device, _, baud = rest.rpartition(":")
        if not device or not (baud.isascii() and baud.isdigit() and int(baud) > 0):
            raise UriError(f"{uri!r}: expected serial:DEV:BAUD, e.g. serial:/dev/ttyAMA0:921600")
        self._device, self._baud = device, int(baud)
        self._port: serial.Serial | None = None
        self._stream: FdStream | None = None

    async def start(self) -> None:
        """Begin to open the device; it may be plugged in later, but must be a port we may use."""
        try:
            self._port = self._serial()
        except OSError as error:
            if error.errno in (errno.EACCES, errno.EPERM):
                raise LinkOpenError(
                    f"{self.uri}: permission denied; add this user to the group that owns "
                    f"{self._device} (often 'dialout') and log in again"
                ) from error
            if error.errno in NO_PORT:
                raise LinkOpenError(
                    f"{self.uri}: {self._device} is no serial port, or not at {self._baud} baud"
                ) from error
        await super().start()

    def _serial(self) -> serial.Serial:
        """Open the port; every failure is an OSError with its number."""
        try:
            return serial.Serial(self._device, self._baud, timeout=0, exclusive=True)
        except serial.SerialException as error:
            number = error.errno or errno.ENOTTY
        except (ValueError, OverflowError, termios.error):
            number = errno.EINVAL
        except OSError as error:
            number = error.errno or errno.EIO
        raise OSError(number, BUSY if number == errno.EAGAIN else os.strerror(number))

    async def _open(self) -> str:
        if self._port is None:
            self._port = self._serial()
        self._stream = FdStream(
            self._port.fileno(),
            lambda data: self._deliver(data, self._device),
            self._lose,
            QUEUE_BYTES,
        )
        return f"{self._device} at {self._baud} baud"

    def _release(self) -> None:
        if self._stream is not None:
            self._stream.detach()
            self._stream = None
        if self._port is not None:
            self._port.close()
            self._port = None

    def _write(self, frame: bytes) -> bool:
        return self._stream is not None and self._stream.write(frame)

    async def close(self) -> None:
        """Send what is queued, then let go of the device."""
        if self._stream is not None:
            await self._stream.drain()
        await super().close()
