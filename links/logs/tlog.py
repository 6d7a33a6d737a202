"""Telemetry logs (.tlog): frames, each behind 8 bytes of big-endian microseconds, as columns."""

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from ahrs_service.errors import RecordingError
from ahrs_service.links.mavlink.codec import CRC_EXTRA
from ahrs_service.links.mavlink.frames import (
    FRAME_DTYPE,
    MARKER_V1,
    MARKER_V2,
    SCAN_DTYPE,
    SIGNATURE_BYTES,
    SIGNED,
    STAMP_BYTES,
    Bytes,
    Record,
    Rows,
    scan_tlog,
)
from ahrs_service.links.mavlink.layouts import decode_table, is_known, message_name

Key = tuple[int, int, str]

_STAMP: Final = struct.Struct(">Q")
_BLOCK_FRAMES: Final = 1 << 14
_LEAST_SHARE: Final = 1e-3


class Tables(Mapping[Key, Rows]):
    """Tables of a tlog by (system, component, message name), decoded when first asked for."""

    def __init__(self, data: Bytes, frames: Rows) -> None:
        self._data = data
        self._frames = frames
        msgid = frames["msgid"]
        # One radix pass per key of at most 16 bits: far faster than one sort of a wide key.
        self._order = np.lexsort(
            (frames["compid"], frames["sysid"], msgid.astype(np.uint16), msgid >> 16)
        ).astype(np.int32)
        sender = frames["sysid"].astype(np.int64) << 8 | frames["compid"]
        head = (msgid.astype(np.int64) << 16 | sender)[self._order]
        starts = np.flatnonzero(np.concatenate([[True], head[1:] != head[:-1]]))
        stops = np.append(starts[1:], len(frames))
        self._places: dict[Key, tuple[int, int, int]] = {}
        for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
            name = int(head[start])
            number = name >> 16
            key = (name >> 8 & 0xFF, name & 0xFF, message_name(number))
            if is_known(number):
                self._places[key] = (number, start, stop)
        self._decoded: dict[Key, Rows] = {}

    def __getitem__(self, key: Key) -> Rows:
        if key not in self._decoded:
            msgid, start, stop = self._places[key]
            indices = self._order[start:stop]
            self._decoded[key] = decode_table(self._data, self._frames, indices, msgid)
        return self._decoded[key]

    def __iter__(self) -> Iterator[Key]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def count(self, key: Key) -> int:
        """Return the rows of a table without decoding it."""
        _, start, stop = self._places[key]
        return stop - start


@dataclass(frozen=True, slots=True)
class TlogFile:
    """A tlog in memory.

    `data` the file's bytes; `frames` FRAME_DTYPE in file order, frames of unknown ids too;
    `tables` by (system, component, message name); `damaged` what was found besides good
    frames, by kind.
    """

    path: Path
    data: Bytes
    frames: Rows
    tables: Tables
    damaged: dict[str, int]

    def message_counts(self) -> dict[str, int]:
        """Return messages by name, the most frequent first."""
        counts: dict[str, int] = {}
        for key in self.tables:
            counts[key[2]] = counts.get(key[2], 0) + self.tables.count(key)
        return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def read_tlog(path: str | Path, progress: Callable[[float], None] | None = None) -> TlogFile:
    """Read a tlog of MAVLink 1 and 2 frames, signed or not; damage is counted and skipped.

    `progress` is called with the share scanned, 0 to 1. RecordingError where there is no
    tlog to read. Source: mavlink.io, "Packet serialization".
    """
    path = Path(path)
    data = np.frombuffer(_read(path), np.uint8)
    states = np.zeros(1, SCAN_DTYPE)
    blocks: list[Rows] = []
    position = 0
    while position < len(data):
        block = np.empty(_BLOCK_FRAMES, FRAME_DTYPE)
        count, position = scan_tlog(data, position, CRC_EXTRA, states, block)
        blocks.append(block[:count].copy())
        if progress is not None:
            progress(position / len(data))
    frames = np.concatenate(blocks)
    _check(path, data, frames, states[0])
    return TlogFile(path, data, frames, Tables(data, frames), _damage(data, states[0]))


def _read(path: Path) -> bytes:
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such file; check the path") from None
    except OSError as error:
        raise RecordingError(
            f"{path}: cannot be read ({error.strerror}); give a readable .tlog file"
        ) from None
    if not content:
        raise RecordingError(f"{path}: the file is empty; record again or give another file")
    return content


def _check(path: Path, data: Bytes, frames: Rows, state: Record) -> None:
    """Refuse files that are no tlog: in any large file some checksum is right by chance."""
    if int(frames["length"].sum()) < _LEAST_SHARE * len(data):
        raise RecordingError(
            f"{path}: holds no MAVLink frames, so it is no .tlog; give a .tlog, or a .ulg or .bin "
            "file with its correct suffix"
        )
    ends = frames["offset"] + frames["length"]
    if state["bad_stamp"] == len(frames) and np.any(frames["offset"][1:] == ends[:-1]):
        raise RecordingError(
            f"{path}: holds {len(frames)} MAVLink frames but no time stamps between them; "
            "give a .tlog as written by a ground station, not a raw capture of the link"
        )


def _damage(data: Bytes, state: Record) -> dict[str, int]:
    """Return the counts; a frame start after the last whole frame counts as a cut frame."""
    rest = data[int(state["last_end"]) :]
    head = rest[STAMP_BYTES : STAMP_BYTES + 3].tolist()
    is_cut = len(head) < 3
    if not is_cut and head[0] in (MARKER_V1, MARKER_V2):
        around = 8 if head[0] == MARKER_V1 else 12 + SIGNATURE_BYTES * (head[2] & SIGNED)
        is_cut = STAMP_BYTES + around + head[1] > len(rest)
    cut = len(rest) if is_cut else 0
    return {
        "bad_crc": int(state["bad_crc"]),
        "unknown": int(state["unknown"]),
        "garbage_bytes": int(state["garbage_bytes"]) - cut,
        "bad_stamp": int(state["bad_stamp"]),
        "truncated_tail_bytes": cut,
    }


def tlog_record(received_us: int, frame: bytes) -> bytes:
    """Return the bytes of one tlog entry: stamp [us] since 1970 and frame."""
    return _STAMP.pack(received_us) + frame
