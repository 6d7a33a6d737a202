"""Columns of ArduPilot DataFlash (.bin) files: framing, formats, damage.

A record is 0xA3 0x95, a type byte and a body; FMT records, type 128, define the length, name,
field types and field names of every type. There is no checksum. Source: ArduPilot
libraries/AP_Logger/LogStructure.h.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ahrs_service.errors import RecordingError
from ahrs_service.kernel import kernel
from ahrs_service.records import Rows

Bytes = npt.NDArray[np.uint8]
Integers = npt.NDArray[np.int64]

_HEAD_1: Final = 0xA3
_HEAD_2: Final = 0x95
_FMT: Final = 128
_FMT_LENGTH: Final = 89
_RECORDS_AT_ONCE: Final = 1 << 16
_FMT_DTYPE: Final = np.dtype(
    [("Type", "u1"), ("Length", "u1"), ("Name", "S4"), ("Format", "S16"), ("Columns", "S64")]
)
_TYPES: Final = {
    "a": "32<i2",
    "b": "i1",
    "B": "u1",
    "g": "<f2",
    "h": "<i2",
    "H": "<u2",
    "i": "<i4",
    "I": "<u4",
    "f": "<f4",
    "d": "<f8",
    "n": "S4",
    "N": "S16",
    "Z": "S64",
    "c": "<i2",
    "C": "<u2",
    "e": "<i4",
    "E": "<u4",
    "L": "<i4",
    "M": "u1",
    "q": "<i8",
    "Q": "<u8",
}
_DIVISORS: Final = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}


@dataclass(frozen=True, slots=True)
class Layout:
    """How the records of one type are laid out; `divisors` for fields stored as integers."""

    type: int
    name: str
    dtype: np.dtype[Any]
    divisors: dict[str, float]


@dataclass(frozen=True, slots=True)
class DataFlashFile:
    """A file's bytes and where its records are.

    `offsets` [N] of the records in order, `types` [N] their type bytes, `damaged` what could
    not be read.
    """

    data: Bytes
    offsets: Integers
    types: Bytes
    layouts: dict[str, Layout]
    damaged: dict[str, int]

    def offsets_of(self, name: str) -> Integers:
        """Offsets [N] of the records called `name`; none if the file has no such format."""
        layout = self.layouts.get(name)
        if layout is None:
            return np.zeros(0, np.int64)
        return self.offsets[self.types == layout.type]

    def table(self, name: str) -> Rows:
        """Records [N] called `name`, fields as stored."""
        return _gather(self.data, self.offsets_of(name), self.layouts[name].dtype)

    def column(self, table: Rows, name: str, field: str) -> npt.NDArray[np.float64]:
        """Field [N] of a table called `name` in the units of its format letter."""
        values = np.asarray(table[field], np.float64)
        return values / self.layouts[name].divisors.get(field, 1.0)

    def counts(self) -> dict[str, int]:
        """Records by name, those present only."""
        by_type = np.bincount(self.types, minlength=256)
        return {
            name: int(by_type[layout.type])
            for name, layout in sorted(self.layouts.items())
            if by_type[layout.type]
        }


def read_tables(path: Path, progress: Callable[[float], None] | None = None) -> DataFlashFile:
    """Find every record of the file; RecordingError if it is not a DataFlash file.

    Damage is skipped byte by byte: a record is accepted when another follows it, or when no whole
    record begins inside it.
    """
    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from error
    lengths = np.zeros(256, np.int64)
    lengths[_FMT] = _FMT_LENGTH
    skipped = np.zeros(1, np.int64)
    offsets, types = [], []
    position = 0
    while position < len(data):
        found = np.empty(_RECORDS_AT_ONCE, np.int64)
        count, position = _scan(data, position, lengths, found, skipped)
        offsets.append(found[:count].copy())
        types.append(data[found[:count] + 2])
        if progress is not None:
            progress(position / len(data))
    all_offsets = np.concatenate([np.zeros(0, np.int64), *offsets])
    all_types = np.concatenate([np.zeros(0, np.uint8), *types])
    formats = _gather(data, all_offsets[all_types == _FMT], _FMT_DTYPE)
    layouts, unusable = _layouts(formats)
    if not layouts:
        raise RecordingError(
            f"{path}: not an ArduPilot DataFlash log: no FMT record (0xA3 0x95 0x80) in "
            f"{len(data)} bytes; text logs (.log) must be converted to .bin first"
        )
    lost = int(np.isin(all_types, list(unusable)).sum())
    damaged = {"bytes skipped": int(skipped[0]), "records of unusable formats": lost}
    damaged = {reason: count for reason, count in damaged.items() if count}
    return DataFlashFile(data, all_offsets, all_types, layouts, damaged)


def _text(value: bytes) -> str:
    return value.split(b"\0")[0].decode("latin-1")


def _layouts(formats: Rows) -> tuple[dict[str, Layout], set[int]]:
    """Layouts by name, and the types whose FMT is unusable; a type's first FMT is used."""
    layouts: dict[str, Layout] = {}
    seen: set[int] = set()
    unusable: set[int] = set()
    for row in formats:
        number = int(row["Type"])
        if number in seen:
            continue
        seen.add(number)
        layout = _layout(row)
        if layout is None or layout.name in layouts:
            unusable.add(number)
        else:
            layouts[layout.name] = layout
    return layouts, unusable


def _layout(row: Any) -> Layout | None:
    letters, columns = _text(bytes(row["Format"])), _text(bytes(row["Columns"]))
    names = columns.split(",") if columns else []
    if len(letters) != len(names) or len(set(names)) != len(names) or set(letters) - set(_TYPES):
        return None
    dtype = np.dtype([(name, _TYPES[letter]) for name, letter in zip(names, letters, strict=True)])
    if dtype.itemsize + 3 != int(row["Length"]):
        return None
    divisors = {n: _DIVISORS[c] for n, c in zip(names, letters, strict=True) if c in _DIVISORS}
    return Layout(int(row["Type"]), _text(bytes(row["Name"])), dtype, divisors)


def _gather(data: Bytes, offsets: Integers, dtype: np.dtype[Any]) -> Rows:
    out = np.empty((len(offsets), dtype.itemsize), np.uint8)
    inside = offsets + 3 + dtype.itemsize <= len(data)
    _copy(data, offsets[inside], out)
    return out[: int(inside.sum())].reshape(-1).view(dtype)


@kernel
def _copy(data: Bytes, offsets: Integers, out: Bytes) -> None:
    for n in range(offsets.shape[0]):
        for i in range(out.shape[1]):
            out[n, i] = data[offsets[n] + 3 + i]


@kernel
def _length_at(data: Bytes, i: int, lengths: Integers) -> int:
    """Length of the whole record that begins at `i`, 0 if none does."""
    size = data.shape[0]
    if i + 3 > size or data[i] != _HEAD_1 or data[i + 1] != _HEAD_2:
        return 0
    length = lengths[data[i + 2]]
    return length if i + length <= size else 0


@kernel
def _is_followed(data: Bytes, end: int) -> bool:
    """Return whether a record ends at the end of the file or at another header."""
    size = data.shape[0]
    if end == size:
        return True
    if data[end] != _HEAD_1:
        return False
    return end + 1 == size or data[end + 1] == _HEAD_2


@kernel
def _damaged_until(data: Bytes, i: int, length: int, lengths: Integers) -> int:
    """Return where a whole record begins inside the one at `i` with none after it; else 0."""
    for j in range(i + 3, i + length):
        inner = _length_at(data, j, lengths)
        if inner > 0 and _is_followed(data, j + inner):
            return j
    return 0


@kernel
def _scan(
    data: Bytes, start: int, lengths: Integers, offsets: Integers, skipped: Integers
) -> tuple[int, int]:
    """Fill `offsets` from `start` on; return (records found, where to continue).

    FMT records on the way set `lengths` [256], only the first one of each type.
    """
    i, count, size = start, 0, data.shape[0]
    while i < size and count < offsets.shape[0]:
        length = _length_at(data, i, lengths)
        if length == 0:
            skipped[0] += 1
            i += 1
            continue
        if not _is_followed(data, i + length):
            good = _damaged_until(data, i, length, lengths)
            if good > 0:
                skipped[0] += good - i
                i = good
                continue
        if data[i + 2] == _FMT and lengths[data[i + 3]] == 0 and data[i + 4] >= 3:
            lengths[data[i + 3]] = data[i + 4]
        offsets[count] = i
        count += 1
        i += length
    return count, i
