"""Finding MAVLink frames in bytes: one compiled scanner for streams, datagrams and tlogs."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba import njit

Bytes = npt.NDArray[np.uint8]
Rows = npt.NDArray[Any]
Record = Any

FRAME_DTYPE: Final = np.dtype(
    [
        ("offset", "i8"),
        ("received_us", "i8"),
        ("msgid", "u4"),
        ("length", "u2"),
        ("sysid", "u1"),
        ("compid", "u1"),
    ]
)
"""One frame found: where its marker is, its length with checksum and signature [bytes], its time
stamp of receipt [us] (0 where the bytes carry none)."""

SCAN_DTYPE: Final = np.dtype(
    [
        ("boundary", "i8"),
        ("covered", "i8"),
        ("last_end", "i8"),
        ("last_us", "i8"),
        ("count", "i8"),
        ("bad_crc", "i8"),
        ("unknown", "i8"),
        ("garbage_bytes", "i8"),
        ("bad_stamp", "i8"),
    ]
)
"""What the scanner remembers between calls [1]: `boundary` where the next frame is expected and
`covered` where the last frame of unknown id ends, both from the start of the data; the last frame's
end and stamp in a tlog; and the counts."""

STAMP_BYTES: Final = 8
SIGNATURE_BYTES: Final = 13
MARKER_V1: Final = 0xFE
MARKER_V2: Final = 0xFD
SIGNED: Final = 0x01

_NOTHING = 0
_GOOD = 1
_BAD_CRC = 2
_UNKNOWN = 3
_INCOMPLETE = 4
_STAMP_SLACK_US = 3 * 86400 * 1_000_000
_STAMP_LIMIT_US = (2**63 - 1) // 1000


def _crc_tables() -> npt.NDArray[np.int64]:
    """Return [k, byte]: the change of the checksum by `byte` with k zero bytes behind it."""
    tables = np.zeros((4, 256), np.int64)
    for byte in range(256):
        value = byte
        for _ in range(8):
            value = (value >> 1) ^ 0x8408 if value & 1 else value >> 1
        tables[0, byte] = value
    for k in range(1, 4):
        tables[k] = (tables[k - 1] >> 8) ^ tables[0, tables[k - 1] & 0xFF]
    return tables


_CRC4 = _crc_tables()


@njit(cache=True)
def checksum(data: Bytes, start: int, stop: int, extra: int) -> int:
    """Return CRC-16/MCRF4XX of data[start:stop] and the byte `extra` (MAVLink's CRC_EXTRA).

    Four bytes a step, which their own tables make independent of one another.
    """
    crc = np.int64(0xFFFF)
    i = start
    while i + 4 <= stop:
        crc = (
            _CRC4[3, (crc ^ data[i]) & 0xFF]
            ^ _CRC4[2, (crc >> 8) ^ data[i + 1]]
            ^ _CRC4[1, data[i + 2]]
            ^ _CRC4[0, data[i + 3]]
        )
        i += 4
    while i < stop:
        crc = (crc >> 8) ^ _CRC4[0, (crc ^ data[i]) & 0xFF]
        i += 1
    return int((crc >> 8) ^ _CRC4[0, (crc ^ extra) & 0xFF])


@njit(cache=True)
def _inspect(data: Bytes, at: int, crc_extra: npt.NDArray[np.int16]) -> tuple[int, int, int]:
    """Return what is at `at` (one of the verdicts above), the frame's length, the message id."""
    left = len(data) - at
    marker = int(data[at])
    if marker == MARKER_V1:
        header = 6
    elif marker == MARKER_V2:
        header = 10
    else:
        return _NOTHING, 0, 0
    if marker == MARKER_V2 and left > 2 and int(data[at + 2]) & ~SIGNED != 0:
        return _NOTHING, 0, 0
    if left < header:
        return _INCOMPLETE, 0, 0
    end = header + int(data[at + 1])
    length = end + 2
    if marker == MARKER_V1:
        msgid = int(data[at + 5])
    else:
        msgid = int(data[at + 7]) | int(data[at + 8]) << 8 | int(data[at + 9]) << 16
        if int(data[at + 2]) & SIGNED:
            length += SIGNATURE_BYTES
    if length > left:
        return _INCOMPLETE, length, msgid
    extra = int(crc_extra[msgid]) if msgid < len(crc_extra) else -1
    if extra < 0:
        return _UNKNOWN, length, msgid
    found = int(data[at + end]) | int(data[at + end + 1]) << 8
    if checksum(data, at + 1, at + end, extra) != found:
        return _BAD_CRC, length, msgid
    return _GOOD, length, msgid


@njit(cache=True)
def _stamp(data: Bytes, at: int) -> int:
    """Return the big-endian stamp at `at` [us], -1 where it is beyond any time in int64 ns."""
    value = 0
    if int(data[at]) >= 0x80:
        return -1
    for i in range(at, at + STAMP_BYTES):
        value = value << 8 | int(data[i])
    return value if value <= _STAMP_LIMIT_US else -1


@njit(cache=True)
def _is_near(a: int, b: int) -> bool:
    return a >= 0 and b >= 0 and -_STAMP_SLACK_US <= a - b <= _STAMP_SLACK_US


@njit(cache=True)
def _lands_well(data: Bytes, start: int, end: int, state: Record) -> bool:
    """Return whether a stamped frame of unknown id sits between plausible neighbours.

    Its checksum cannot be known, so its own stamp must follow a frame and what comes after it
    must look like the next stamp and marker, or be the end.
    """
    if start - STAMP_BYTES < state["last_end"]:
        return False
    stamp = _stamp(data, start - STAMP_BYTES)
    if state["count"] > 0 and not _is_near(stamp, state["last_us"]):
        return False
    if end + STAMP_BYTES >= len(data):
        return True
    marker = int(data[end + STAMP_BYTES])
    return (marker in (MARKER_V1, MARKER_V2)) and _is_near(_stamp(data, end), stamp)


@njit(cache=True)
def _holds_frame(data: Bytes, start: int, end: int, crc_extra: npt.NDArray[np.int16]) -> bool:
    """Return whether a frame with a right checksum begins between `start` and `end`."""
    at = start
    while at < end and _inspect(data, at, crc_extra)[0] != _GOOD:
        at += 1
    return at < end


@njit(cache=True)
def _received_us(data: Bytes, start: int, is_regular: bool, state: Record) -> int:
    """Return the stamp before a frame; the last good one where this is cut or cannot be true."""
    stamp = -1
    if start - STAMP_BYTES >= state["last_end"]:
        stamp = _stamp(data, start - STAMP_BYTES)
    doubtful = not is_regular and state["count"] > 0 and not _is_near(stamp, state["last_us"])
    if stamp < 0 or doubtful:
        state["bad_stamp"] += 1
        return state["last_us"]
    return stamp


@njit(cache=True)
def _accept(
    data: Bytes, start: int, length: int, msgid: int, received_us: int, state: Record, row: Record
) -> None:
    is_v1 = int(data[start]) == MARKER_V1
    row["offset"] = start
    row["received_us"] = received_us
    row["msgid"] = msgid
    row["length"] = length
    row["sysid"] = data[start + (3 if is_v1 else 5)]
    row["compid"] = data[start + (4 if is_v1 else 6)]
    state["last_us"] = received_us
    state["last_end"] = start + length
    state["boundary"] = start + length
    state["count"] += 1


@njit(cache=True)
def scan_stream(
    data: Bytes, holds_tail: bool, crc_extra: npt.NDArray[np.int16], states: Rows, frames: Rows
) -> tuple[int, int]:
    """Find frames in `data`; return (frames found, bytes done with): the next data begins there.

    Any byte may begin a frame: only a right checksum lets the scan step over more than one
    byte, so a forged length swallows nothing. `holds_tail` stops at what may be the beginning of a
    frame whose end is yet to come. `crc_extra` [id] is -1 where the id is unknown; `states` [1].
    """
    state = states[0]
    position = 0
    found = 0
    while position < len(data) and found < len(frames):
        verdict, length, msgid = _inspect(data, position, crc_extra)
        if verdict == _GOOD:
            _accept(data, position, length, msgid, 0, state, frames[found])
            found += 1
            position += length
            continue
        if verdict == _INCOMPLETE and holds_tail:
            break
        if position == state["boundary"] and verdict in (_BAD_CRC, _UNKNOWN):
            # Where the next frame is expected, for the counts alone: these bytes are searched too.
            state["boundary"] = position + length
            if verdict == _BAD_CRC:
                state["bad_crc"] += 1
            else:
                state["unknown"] += 1
                state["covered"] = position + length
        if position >= state["covered"]:
            state["garbage_bytes"] += 1
        position += 1
        state["boundary"] = max(state["boundary"], position)
    state["boundary"] = max(state["boundary"] - position, 0)
    state["covered"] = max(state["covered"] - position, 0)
    return found, position


@njit(cache=True)
def _take_stamped(
    data: Bytes,
    start: int,
    is_regular: bool,
    crc_extra: npt.NDArray[np.int16],
    state: Record,
    row: Record,
) -> bool:
    """Take the frame at `start` of a tlog into `row` if there is one."""
    if start >= len(data):
        return False
    verdict, length, msgid = _inspect(data, start, crc_extra)
    end = start + length
    # What nothing vouches for may not swallow what its checksum does.
    if (
        verdict == _UNKNOWN
        and _lands_well(data, start, end, state)
        and not _holds_frame(data, start + 1, end, crc_extra)
    ):
        state["unknown"] += 1
    elif verdict != _GOOD:
        if verdict == _BAD_CRC and is_regular:
            state["bad_crc"] += 1
            state["boundary"] = end
        return False
    if not is_regular:
        state["garbage_bytes"] -= min(STAMP_BYTES, start - state["last_end"])
    _accept(
        data,
        start,
        length,
        msgid,
        _received_us(data, start, is_regular, state),
        state,
        row,
    )
    return True


@njit(cache=True)
def scan_tlog(
    data: Bytes, position: int, crc_extra: npt.NDArray[np.int16], states: Rows, frames: Rows
) -> tuple[int, int]:
    """Find stamped frames in data[position:]; return (frames found, where to go on).

    Tries the regular place, 8 bytes after the last frame, then every byte. A frame of unknown id is
    taken when it sits between plausible neighbours and no frame with a right checksum is in it.
    """
    state = states[0]
    found = 0
    while position < len(data) and found < len(frames):
        row = frames[found]
        regular = position + STAMP_BYTES
        if (
            position == state["boundary"]
            and _take_stamped(data, regular, True, crc_extra, state, row)
        ) or _take_stamped(data, position, False, crc_extra, state, row):
            found += 1
            position = state["last_end"]
        else:
            state["garbage_bytes"] += 1
            position += 1
            state["boundary"] = max(state["boundary"], position)
    return found, position


@njit(cache=True)
def flip_in_checksum(flip: int, bytes_after: int) -> int:
    """Return by what the checksum changes when a byte is xored with `flip`.

    `bytes_after` are those the checksum takes after it, CRC_EXTRA included.
    """
    change = _CRC4[0, flip & 0xFF]
    for _ in range(bytes_after):
        change = (change >> 8) ^ _CRC4[0, change & 0xFF]
    return int(change)


def strip_signature(frame: bytes) -> bytes:
    """Return a MAVLink frame without its signature block; unsigned ones as they are.

    The checksum is linear in the bits of the frame, so that of the cleared flag follows without
    knowing the message.
    """
    if frame[0] != MARKER_V2 or not frame[2] & SIGNED:
        return frame
    end = 10 + frame[1]
    crc = int.from_bytes(frame[end : end + 2], "little")
    crc ^= flip_in_checksum(SIGNED, end - 2)
    head = bytes((frame[0], frame[1], frame[2] & ~SIGNED))
    return head + frame[3:end] + crc.to_bytes(2, "little")
