"""MAVLink messages to and from bytes: the only importer of pymavlink."""

import struct
from collections.abc import Callable
from operator import itemgetter
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import all as dialect

from ahrs_service.links.mavlink.frames import (
    FRAME_DTYPE,
    MARKER_V1,
    SCAN_DTYPE,
    SIGNED,
    scan_stream,
)

__all__ = ["CRC_EXTRA", "Decoder", "Encoder", "Signer", "decode_frame", "dialect"]

_HEADER_V1: Final = struct.Struct("<BBBBBB")
_HEADER_V2: Final = struct.Struct("<BBBBBBBHB")
_CHECKSUM: Final = struct.Struct("<H")
_SCAN_ROWS: Final = 1024


class Signer(Protocol):
    """Signs what goes out and judges what comes in."""

    def sign(self, frame: bytes) -> bytes:
        """Return the signed frame of an unsigned MAVLink 2 frame."""
        ...

    def accept(self, frame: bytes) -> bool:
        """Return whether a received frame, signed or not, may be believed."""
        ...


def _crc_extra() -> npt.NDArray[np.int16]:
    table = np.full(max(dialect.mavlink_map) + 1, -1, np.int16)
    for msgid, message in dialect.mavlink_map.items():
        table[msgid] = message.crc_extra
    return table


CRC_EXTRA: Final = _crc_extra()
"""CRC_EXTRA [message id], -1 where the dialect has no such message."""


_SINGLE_CHARS: Final[dict[int, tuple[str, ...]]] = {
    msgid: tuple(
        f"_{name}_raw"
        for name, kind, length in zip(
            message.ordered_fieldnames,
            message.native_format.decode().lstrip("<"),
            message.array_lengths,
            strict=True,
        )
        if kind == "c" and length == 0
    )
    for msgid, message in dialect.mavlink_map.items()
    if "c" in message.unpacker.format
}
"""Fields of one character, by message id."""


class Encoder:
    """Messages to MAVLink 2 frames of one component, with its own sequence number."""

    def __init__(self, system: int, component: int, signer: Signer | None = None) -> None:
        self._link = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        self._signer = signer

    def pack(self, message: Any) -> bytes:
        """Return the frame of `message`, signed if there is a signer."""
        for name in _SINGLE_CHARS.get(message.get_msgId(), ()):
            # pymavlink decodes the character NUL to none at all, which it cannot pack again.
            setattr(message, name, getattr(message, name) or b"\0")
        frame: bytes = message.pack(self._link)
        self._link.seq = (self._link.seq + 1) % 256
        return frame if self._signer is None else self._signer.sign(frame)


Reader = Callable[[tuple[Any, ...]], Any]


def _field_reader(message: Any) -> Reader:
    """Return the function from the unpacked struct to the class's arguments.

    Sorted wire order to declared order, arrays as lists, strings without their padding.
    """
    lengths, slots = message.lengths, []
    for order in message.orders:
        first = sum(lengths[:order])
        slots.append((first, lengths[order]))
    formats = message.unpacker.format
    if "s" not in formats and "c" not in formats and all(n == 1 for n in lengths):
        if len(slots) == 1:
            return list
        pick = itemgetter(*message.orders)
        return pick

    def read(values: tuple[Any, ...]) -> list[Any]:
        fields: list[Any] = []
        for first, length in slots:
            value = values[first]
            if isinstance(value, bytes):
                fields.append(value.rstrip(b"\x00"))
            elif length == 1:
                fields.append(value)
            else:
                fields.append(list(values[first : first + length]))
        return fields

    return read


_READERS: Final[dict[int, tuple[Any, Any, int, Reader]]] = {
    msgid: (message, message.unpacker.unpack, message.unpacker.size, _field_reader(message))
    for msgid, message in dialect.mavlink_map.items()
}


def decode_frame(frame: bytes, is_trusted: bool = False) -> Any:
    """Return pymavlink's message of a frame whose checksum is already known to be right.

    Equal to `MAVLink.decode` of the frame, at a quarter of its cost: the checksum is not computed
    again. `is_trusted` says that a signature was verified.
    """
    if frame[0] == MARKER_V1:
        _, size, sequence, system, component, msgid = _HEADER_V1.unpack_from(frame)
        start, incompatible, compatible = 6, 0, 0
    else:
        _, size, incompatible, compatible, sequence, system, component, low, high = (
            _HEADER_V2.unpack_from(frame)
        )
        start, msgid = 10, low | high << 16
    message_class, unpack, full_size, read = _READERS[msgid]
    payload = frame[start : start + size]
    if size < full_size:
        payload += bytes(full_size - size)
    message = message_class(*read(unpack(payload[:full_size])))
    message._signed = is_trusted and bool(incompatible & SIGNED)
    if message._signed:
        message._link_id = frame[start + size + 2]
    message._msgbuf = bytearray(frame)
    message._payload = message._msgbuf[6 : start + size]
    message._crc = _CHECKSUM.unpack_from(frame, start + size)[0]
    message._header = dialect.MAVLink_header(
        msgid, incompatible, compatible, size, sequence, system, component
    )
    return message


class Decoder:
    """Bytes of one link to messages; what is damaged, forged or unknown is counted, never fatal.

    With `datagrams` each `feed` stands alone, so a cut datagram cannot eat the next; else the
    beginning of a frame at the end of the bytes waits for the rest. Of a `signer` every frame
    asks leave, unsigned ones too.
    """

    def __init__(self, signer: Signer | None = None, datagrams: bool = False) -> None:
        self._signer = signer
        self._datagrams = datagrams
        self._tail = b""
        self._scan = np.zeros(1, SCAN_DTYPE)
        self._rows = np.zeros(_SCAN_ROWS, FRAME_DTYPE)
        self._bad_signature = 0
        # Compiles the scanner here, so no message waits for the compiler.
        self.feed(b"")

    @property
    def counts(self) -> dict[str, int]:
        """Frames with a right checksum so far, and what else was met, by kind."""
        state = self._scan[0]
        return {
            "frames": int(state["count"]),
            "bad_crc": int(state["bad_crc"]),
            "unknown": int(state["unknown"]),
            "garbage_bytes": int(state["garbage_bytes"]),
            "bad_signature": self._bad_signature,
        }

    def restart(self) -> None:
        """Forget a frame that waits for its rest: the connection it came on is gone."""
        self._scan["garbage_bytes"] += len(self._tail)
        self._scan["boundary"] = self._scan["covered"] = 0
        self._tail = b""

    def feed(self, data: bytes) -> list[tuple[Any, bytes]]:
        """Return the messages that end in `data`, each with its frame as received."""
        buffer = self._tail + data if self._tail else bytes(data)
        messages: list[tuple[Any, bytes]] = []
        while True:
            array = np.frombuffer(buffer, np.uint8)
            count, position = scan_stream(
                array, not self._datagrams, CRC_EXTRA, self._scan, self._rows
            )
            for offset, _, _, length, _, _ in self._rows[:count].tolist():
                frame = buffer[offset : offset + length]
                if self._signer is None or self._signer.accept(frame):
                    messages.append((decode_frame(frame, self._signer is not None), frame))
                else:
                    self._bad_signature += 1
            buffer = buffer[position:]
            if count < _SCAN_ROWS:
                break
        self._tail = buffer
        if self._datagrams:
            self._scan["boundary"] = self._scan["covered"] = 0
        return messages
