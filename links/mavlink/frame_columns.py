"""Columns of messages to the bytes of a telemetry log, thousands of frames at a time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba import njit

from ahrs_service.errors import RecordingError
from ahrs_service.links.mavlink.codec import CRC_EXTRA, dialect
from ahrs_service.links.mavlink.frames import MARKER_V2, STAMP_BYTES, Bytes, checksum
from ahrs_service.links.mavlink.layouts import table_dtype

_HEADER_BYTES: Final = 10
_CHECKSUM_BYTES: Final = 2


@dataclass(frozen=True, slots=True)
class MessageColumns:
    """Messages of one name: stamps of receipt [us] [N], fields as numbers, [N] or [N, k].

    Fields left out are 0.
    """

    name: str
    received_us: npt.NDArray[np.int64]
    fields: Mapping[str, Any]


def tlog_bytes(tables: Sequence[MessageColumns], system: int, component: int) -> bytes:
    """Return the log of all messages in order of their stamps, equal ones in order of `tables`.

    Raises:
        RecordingError: a message or a field that the dialect does not have.

    """
    packed = [_frames(table, system, component) for table in tables]
    stamps = np.concatenate([table.received_us for table in tables])
    order = np.argsort(stamps, kind="stable")
    lengths = np.repeat([frames.shape[1] for frames in packed], [len(f) for f in packed])
    starts = np.empty(len(order), np.int64)
    starts[order] = np.cumsum(lengths[order]) - lengths[order]
    sequence = np.empty(len(order), np.uint8)
    sequence[order] = np.arange(len(order)) % 256
    out = np.empty(int(lengths.sum()), np.uint8)
    first = 0
    for table, frames in zip(tables, packed, strict=True):
        here = slice(first, first + len(frames))
        extra = int(CRC_EXTRA[_number(table.name)])
        _place(frames, sequence[here], starts[here], extra, out)
        first += len(frames)
    return out.tobytes()


def _number(name: str) -> int:
    for number, message in dialect.mavlink_map.items():
        if message.msgname == name:
            return int(number)
    raise RecordingError(f"{name}: the dialect has no such message")


def _frames(table: MessageColumns, system: int, component: int) -> Bytes:
    """Return frames [N, bytes] behind their stamps, without sequence number and checksum."""
    number, count = _number(table.name), len(table.received_us)
    layout = table_dtype(number)
    size = dialect.mavlink_map[number].unpacker.size
    rows = np.zeros(count, layout)
    for field, values in table.fields.items():
        if field not in (layout.names or ()):
            raise RecordingError(f"{table.name}: no field {field}")
        rows[field] = values
    out = np.zeros((count, STAMP_BYTES + _HEADER_BYTES + size + _CHECKSUM_BYTES), np.uint8)
    stamps = table.received_us.astype(">u8")
    out[:, :STAMP_BYTES] = stamps.view(np.uint8).reshape(count, STAMP_BYTES)
    head = (MARKER_V2, size, 0, 0, 0, system, component)
    out[:, STAMP_BYTES : STAMP_BYTES + 7] = head
    out[:, STAMP_BYTES + 7 : STAMP_BYTES + 10] = tuple(number.to_bytes(3, "little"))
    payload = rows.view(np.uint8).reshape(count, -1)[:, :size]
    out[:, STAMP_BYTES + _HEADER_BYTES : -_CHECKSUM_BYTES] = payload
    return out


@njit(cache=True)
def _place(
    frames: Bytes,
    sequence: npt.NDArray[np.uint8],
    starts: npt.NDArray[np.int64],
    extra: int,
    out: Bytes,
) -> None:
    """Number each frame, close it with its checksum and copy it to its place in `out`."""
    length = frames.shape[1]
    for i in range(len(frames)):
        frame = frames[i]
        frame[STAMP_BYTES + 4] = sequence[i]
        crc = checksum(frame, STAMP_BYTES + 1, length - 2, extra)
        frame[length - 2] = crc & 0xFF
        frame[length - 1] = crc >> 8
        start = starts[i]
        for j in range(length):
            out[start + j] = frame[j]
