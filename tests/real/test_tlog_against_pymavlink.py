"""Every real tlog: frames, fields and readings against pymavlink, message by message."""

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ahrs_service.links.logs.readings import from_message, from_tables
from ahrs_service.links.logs.tlog import TlogFile, read_tlog
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.links.mavlink.frames import STAMP_BYTES
from ahrs_service.records import READING_DTYPE, empty

SHARED = Path(__file__).resolve().parents[2].parent / "shared"
FLIGHTS = sorted((SHARED / "data" / "flights").glob("*.tlog"))
SIMULATED = sorted((SHARED / "data" / "sitl").glob("*.tlog"))
# Two of the cases are enough: all come from one writer.
CASES = sorted((SHARED / "mismatch" / "cases").glob("*.tlog"))[:2]
RECORDINGS = FLIGHTS + SIMULATED + CASES
SLICE_BYTES = 300_000

pytestmark = pytest.mark.skipif(
    not RECORDINGS, reason="no recordings in ../shared/data next to the project"
)


def decoded(tlog: TlogFile) -> Iterator[Any]:
    """The frames as decoded by pymavlink, including its checksum test."""
    oracle = dialect.MAVLink(None)
    content = tlog.data.tobytes()
    for offset, length in tlog.frames[["offset", "length"]].tolist():
        yield oracle.decode(bytearray(content[offset : offset + length]))


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_fields_are_those_of_pymavlink(path: Path) -> None:
    tlog = read_tlog(path)
    wanted: dict[tuple[int, int, str], list[tuple[Any, ...]]] = defaultdict(list)
    for index, message in enumerate(decoded(tlog)):
        key = (message.get_srcSystem(), message.get_srcComponent(), message.get_type())
        fields = [
            getattr(message, f"_{name}_raw", None) or getattr(message, name)
            for name in message.ordered_fieldnames
        ]
        wanted[key].append((*map(as_column, fields), index))
    assert set(tlog.tables) == set(wanted)
    for key, rows in wanted.items():
        table = tlog.tables[key]
        expected = np.zeros(len(rows), table.dtype)
        names = [name for name in table.dtype.names or () if name != "received_us"]
        for name, column in zip(names, zip(*rows, strict=True), strict=True):
            expected[name] = column
        expected["received_us"] = tlog.frames["received_us"][expected["frame_index"]]
        # Bytes of equal numbers are equal, NaN and the padding of strings included.
        assert table.tobytes() == expected.tobytes(), key


def as_column(value: Any) -> Any:
    return value.encode("ascii") if isinstance(value, str) else value


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_nothing_between_the_frames_is_left_unread(path: Path) -> None:
    tlog = read_tlog(path)
    taken = int(tlog.frames["length"].sum()) + STAMP_BYTES * len(tlog.frames)
    passed_over = tlog.damaged["garbage_bytes"] + tlog.damaged["truncated_tail_bytes"]
    assert taken + passed_over == len(tlog.data)
    assert tlog.damaged["bad_stamp"] == 0


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_mavlogfile_finds_the_same_frames_at_the_same_times(path: Path, tmp_path: Path) -> None:
    from pymavlink import mavutil

    content = path.read_bytes()
    start = len(content) // 2 if len(content) > SLICE_BYTES else 0
    start = first_record(path, start)
    part = tmp_path / "part.tlog"
    part.write_bytes(content[start : start + SLICE_BYTES])
    log = mavutil.mavlogfile(str(part))
    log.mav = dialect.MAVLink(None)
    log.mav.robust_parsing = True
    # Else the first byte makes it change to another dialect.
    log.first_byte = False
    theirs = []
    while (message := log.recv_msg()) is not None:
        if message.get_type() != "BAD_DATA":
            theirs.append((bytes(message.get_msgbuf()), round(message._timestamp * 1e6)))
    log.close()
    tlog = read_tlog(part)
    ours = [
        (tlog.data[offset : offset + length].tobytes(), received_us)
        for offset, received_us, _, length, _, _ in tlog.frames.tolist()
    ]
    assert ours == theirs


def first_record(path: Path, start: int) -> int:
    offsets = read_tlog(path).frames["offset"] - STAMP_BYTES
    return int(offsets[np.searchsorted(offsets, start)])


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_readings_by_message_and_by_column_are_the_same_bytes(path: Path) -> None:
    tlog = read_tlog(path)
    readings, frame_index = from_tables(tlog)
    rows = empty(READING_DTYPE)
    found: list[bytes] = []
    frames: list[int] = []
    received_ns = ((tlog.frames["received_us"] & ~3) * 1000).tolist()
    for index, message in enumerate(decoded(tlog)):
        if from_message(message, received_ns[index], rows):
            found.append(rows.tobytes())
            frames.append(index)
    assert frames == frame_index.tolist()
    assert b"".join(found) == readings.tobytes()
