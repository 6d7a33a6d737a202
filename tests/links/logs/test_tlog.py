"""The columnar tlog reader on files made here: layouts, damage, and what pymavlink finds."""

import os
import struct
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from ahrs_service.errors import RecordingError
from ahrs_service.links.logs.tlog import TlogFile, read_tlog, tlog_record
from ahrs_service.links.mavlink.codec import Encoder, dialect
from ahrs_service.links.mavlink.frames import strip_signature
from ahrs_service.links.mavlink.layouts import table_dtype

START_US = 1_700_000_000_000_000
UNKNOWN_ID = 59_999
ENCODER = Encoder(1, 1)


def frame(msgid: int, payload: bytes, version: int = 2, is_signed: bool = False) -> bytes:
    known = dialect.mavlink_map.get(msgid)
    if version == 1:
        head = struct.pack("<BBBBB", len(payload), 9, 1, 1, msgid)
    else:
        low, high = msgid & 0xFFFF, msgid >> 16
        head = struct.pack("<BBBBBBHB", len(payload), int(is_signed), 0, 9, 1, 1, low, high)
    crc = dialect.x25crc(head + payload)
    crc.accumulate(bytes([77 if known is None else known.crc_extra]))
    marker = b"\xfe" if version == 1 else b"\xfd"
    signature = b"\x01" + bytes(range(1, 13)) if is_signed else b""
    return marker + head + payload + struct.pack("<H", crc.crc) + signature


def attitude(i: int) -> bytes:
    return ENCODER.pack(dialect.MAVLink_attitude_message(i, 0.1 * i, 0.2, 0.3, 0.4, 0.5, 0.6))


def records(frames: list[bytes]) -> bytes:
    return b"".join(tlog_record(START_US + 1000 * i, one) for i, one in enumerate(frames))


@pytest.fixture
def read(tmp_path: Path) -> Callable[[bytes], TlogFile]:
    def read_bytes(content: bytes) -> TlogFile:
        path = tmp_path / "made.tlog"
        path.write_bytes(content)
        return read_tlog(path)

    return read_bytes


def raw_frames(tlog: TlogFile) -> list[bytes]:
    return [
        tlog.data[row["offset"] : row["offset"] + row["length"]].tobytes() for row in tlog.frames
    ]


def assert_row_equals(row: Any, message: Any) -> None:
    for name in message.ordered_fieldnames:
        wanted = getattr(message, f"_{name}_raw", getattr(message, name))
        assert np.array_equal(
            row[name],
            np.asarray(wanted, row.dtype[name].base),
            equal_nan=(row.dtype[name].base.kind == "f"),
        ), (message.get_type(), name)


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("length", ["full", "short", "long"])
def test_every_message_of_the_dialect_is_read_as_pymavlink_reads_it(
    read: Callable[[bytes], TlogFile], version: int, length: str
) -> None:
    random = np.random.default_rng(3)
    frames = []
    for msgid, known in sorted(dialect.mavlink_map.items()):
        payload = random.bytes(known.unpacker.size)
        if length == "short":
            payload = payload[: (len(payload) + 1) // 2]
        if length == "long":
            payload = (payload + bytes(20))[:255]
        if version == 2 or msgid < 256:
            frames.append(frame(msgid, payload, version, is_signed=version == 2 and msgid % 2 == 1))
    tlog = read(records(frames))
    assert raw_frames(tlog) == frames
    oracle = dialect.MAVLink(None)
    for index, one in enumerate(frames):
        message = oracle.decode(bytearray(one))
        table = tlog.tables[1, 1, message.get_type()]
        assert len(table) == 1
        assert table["frame_index"][0] == index
        assert table["received_us"][0] == START_US + 1000 * index
        assert_row_equals(table[0], message)


def test_layouts_are_as_long_as_the_payloads() -> None:
    for msgid, known in dialect.mavlink_map.items():
        assert table_dtype(msgid).itemsize == known.unpacker.size + 12


def test_tables_are_kept_apart_by_sender_and_message(read: Callable[[bytes], TlogFile]) -> None:
    message = dialect.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3)
    senders = [(1, 1), (1, 191), (255, 190), (1, 1), (0, 0), (255, 0)]
    encoders = {sender: Encoder(*sender) for sender in senders}
    tlog = read(records([encoders[sender].pack(message) for sender in senders] + [attitude(1)]))
    found = {key: tlog.tables[key]["frame_index"].tolist() for key in tlog.tables}
    assert found == {
        (1, 1, "HEARTBEAT"): [0, 3],
        (1, 191, "HEARTBEAT"): [1],
        (255, 190, "HEARTBEAT"): [2],
        (0, 0, "HEARTBEAT"): [4],
        (255, 0, "HEARTBEAT"): [5],
        (1, 1, "ATTITUDE"): [6],
    }
    assert tlog.message_counts() == {"HEARTBEAT": 6, "ATTITUDE": 1}


def test_a_whole_file_is_not_damaged_and_its_frames_tile_it(
    read: Callable[[bytes], TlogFile],
) -> None:
    frames = [attitude(i) for i in range(70_000)]
    tlog = read(records(frames))
    assert not any(tlog.damaged.values())
    assert tlog.tables[1, 1, "ATTITUDE"]["time_boot_ms"].tolist() == list(range(70_000))
    copied = b"".join(
        tlog_record(int(row["received_us"]), one)
        for row, one in zip(tlog.frames, raw_frames(tlog), strict=True)
    )
    assert copied == tlog.data.tobytes()


def test_progress_ends_at_one(tmp_path: Path) -> None:
    path = tmp_path / "a.tlog"
    path.write_bytes(records([attitude(i) for i in range(70_000)]))
    shares: list[float] = []
    read_tlog(path, shares.append)
    assert shares == sorted(shares)
    assert len(shares) > 2
    assert shares[-1] == 1.0


@pytest.mark.parametrize(
    ("damage", "lost", "reason"),
    [
        (lambda b, at: b[: at + 20] + bytes([b[at + 20] ^ 1]) + b[at + 21 :], 1, "bad_crc"),
        (lambda b, at: b[: at + 9] + b"\xff" + b[at + 10 :], 1, "bad_crc"),
        (lambda b, at: b[:at] + bytes(500) + b[at:], 0, "garbage_bytes"),
        (lambda b, at: b[:at] + b"\xfd\xfe" * 300 + b[at:], 0, "garbage_bytes"),
        (lambda b, at: b[: at + 30] + b[at + 40 :], 1, "garbage_bytes"),
        (lambda b, at: b[: at + 3] + b[at + 5 :], 0, "bad_stamp"),
        (lambda b, at: b[:at] + b"\xff" + b[at + 1 :], 0, "bad_stamp"),
    ],
    ids=["payload", "length", "zeros", "markers", "cut out", "stamp cut", "stamp wrong"],
)
def test_damage_costs_only_what_it_hit(
    read: Callable[[bytes], TlogFile],
    damage: Callable[[bytes, int], bytes],
    lost: int,
    reason: str,
) -> None:
    frames = [attitude(i) for i in range(40)]
    content = records(frames)
    tlog = read(damage(content, 20 * len(content) // 40))
    assert raw_frames(tlog) == frames[:20] + frames[20 + lost :]
    assert tlog.damaged[reason] > 0
    stamps = (tlog.frames["received_us"] - START_US) // 1000
    assert stamps[-10:].tolist() == list(range(30, 40))
    assert np.all(np.diff(tlog.frames["received_us"]) >= 0)


@pytest.mark.parametrize("left", range(1, 40))
def test_a_cut_tail_is_counted(read: Callable[[bytes], TlogFile], left: int) -> None:
    tlog = read(records([attitude(0), attitude(1)])[: len(records([attitude(0)])) + left])
    assert len(tlog.frames) == 1
    assert tlog.damaged["truncated_tail_bytes"] == left
    assert tlog.damaged["garbage_bytes"] == 0


def test_unknown_ids_are_kept_as_frames_and_have_no_table(
    read: Callable[[bytes], TlogFile],
) -> None:
    frames = [attitude(0), frame(UNKNOWN_ID, b"\x05" * 30), attitude(1)]
    frames += [frame(UNKNOWN_ID, b"\x05" * 9, is_signed=True), attitude(2)]
    tlog = read(records(frames))
    assert raw_frames(tlog) == frames
    assert list(tlog.tables) == [(1, 1, "ATTITUDE")]
    assert tlog.damaged == {
        "bad_crc": 0,
        "unknown": 2,
        "garbage_bytes": 0,
        "bad_stamp": 0,
        "truncated_tail_bytes": 0,
    }


def test_a_forged_unknown_id_swallows_nothing(read: Callable[[bytes], TlogFile]) -> None:
    head = b"\xfd\xff\x00\x00\x00\x01\x01" + UNKNOWN_ID.to_bytes(3, "little")
    frames = [attitude(i) for i in range(20)]
    content = records(frames[:5]) + tlog_record(START_US + 5000, head) + records(frames)[-800:]
    tlog = read(content)
    assert raw_frames(tlog)[:5] == frames[:5]
    assert raw_frames(tlog)[-15:] == frames[-15:]


def test_refusals_name_the_file_and_what_to_do(tmp_path: Path) -> None:
    empty, text = tmp_path / "empty.tlog", tmp_path / "text.tlog"
    raw, noise = tmp_path / "raw.tlog", tmp_path / "noise.tlog"
    empty.write_bytes(b"")
    text.write_text("no telemetry at all\n" * 100)
    raw.write_bytes(b"".join(attitude(i) for i in range(10)))
    noise.write_bytes(np.random.default_rng(0).bytes(2_000_000))
    for path, reason in [
        (tmp_path / "none.tlog", "no such file; check"),
        (tmp_path, "cannot be read .*; give"),
        (empty, "is empty; record again"),
        (text, "no MAVLink frames.*; give a .tlog"),
        (noise, "no MAVLink frames.*; give a .tlog"),
        (raw, "no time stamps.*; give a .tlog"),
    ]:
        with pytest.raises(RecordingError, match=f"{path.name}.*{reason}"):
            read_tlog(path)


@pytest.mark.parametrize("msgid", [0, 30, 105, 12900, UNKNOWN_ID])
def test_a_stripped_signature_leaves_the_frame_that_was_never_signed(msgid: int) -> None:
    payload = bytes(range(1, 10))
    plain = frame(msgid, payload)
    assert strip_signature(frame(msgid, payload, is_signed=True)) == plain
    assert strip_signature(plain) == plain
    assert strip_signature(frame(0, payload, version=1)) == frame(0, payload, version=1)


def pymavlink_frames(path: Path) -> list[bytes]:
    from pymavlink import mavutil

    log = mavutil.mavlogfile(str(path))
    log.mav = dialect.MAVLink(None)
    log.mav.robust_parsing = True
    # Else the first byte makes it change to another dialect.
    log.first_byte = False
    found = []
    while (message := log.recv_msg()) is not None:
        if message.get_type() != "BAD_DATA" and not message.get_type().startswith("UNKNOWN"):
            found.append(bytes(message.get_msgbuf()))
    log.close()
    return found


FRAMES = st.one_of(
    st.integers(0, 99).map(attitude),
    st.builds(
        frame,
        st.sampled_from([0, 24, 30, 105, 253, 147]),
        st.binary(min_size=1, max_size=60),
        st.sampled_from([1, 2]),
    ),
    st.builds(
        frame, st.sampled_from([0, 30, 12900]), st.binary(min_size=1), st.just(2), st.just(True)
    ),
    st.builds(frame, st.just(UNKNOWN_ID), st.binary(min_size=1, max_size=30)),
)


def damaged(draw: st.DrawFn, content: bytes) -> bytes:
    edited = bytearray(content)
    for _ in range(draw(st.integers(0, 6))):
        at = draw(st.integers(0, max(len(edited) - 1, 0)))
        action = draw(st.sampled_from(["flip", "delete", "insert", "repeat", "markers", "cut"]))
        size = draw(st.integers(1, 120))
        if action == "flip" and edited:
            edited[at] ^= 1 << draw(st.integers(0, 7))
        elif action == "delete":
            del edited[at : at + size]
        elif action == "insert":
            edited[at:at] = draw(st.binary(min_size=1, max_size=40))
        elif action == "repeat":
            edited[at:at] = edited[at // 2 : at // 2 + size]
        elif action == "markers":
            edited[at:at] = bytes(draw(st.lists(st.sampled_from([0xFD, 0xFE, 0]), max_size=12)))
        elif action == "cut" and size > 100:
            del edited[at:]
    return bytes(edited)


@st.composite
def damaged_tlogs(draw: st.DrawFn) -> bytes:
    return damaged(draw, records(draw(st.lists(FRAMES, min_size=1, max_size=25))))


SWALLOWING = bytes.fromhex(
    "060a24181e40181e4000fd00fdfdfdfd00fd00fdfdfdfdfdfdfdfdfc01011e00000000000000000000cdcc4c"
    "3e9a99993ecdcccc3e0000003f9a99193f64c400060a24181e43e8fd01010009010100000000f1ac01010203"
    "0405060708090a0b060a24181e4000fd00fdfdfdfdfdfdfdfdfc01011e00000000000000000000cdcc4c3e9a"
    "99993ecdcccc3e0000003f9a99193f64c400060a24181e43e8fd01010009010100000000f1ac010102030405"
    "060708090a0b0c00060a24181e47d0fd1c0000fd01011e00000000000000000000cdcc4c3e9a99993ecdcccc"
    "3e0000003f9a99193f5dc900060a24181e4bb8fd1c0000fe01011e00000000000000000000cdcc4c3e9a9999"
    "3ecdcccc3e0000003f9a99193f16de"
)
"""A forged frame of an unknown id between plausible stamps, with whole frames inside."""

TORN = bytes.fromhex(
    "060a060a24181e4000fd1c0000910101fd1c00009101011e1e00000000000000000000cdcc4c3e9a99993ecd"
    "cccc3e0000003f9a99193f336d0a24181e43e8fd1c00009201011e00000000000000000000cdcc4c3e9a9999"
    "3ecdcccc3e0000003f9a99193f787a"
)
"""The second head of a repeated one passes for a stamp, and pymavlink joins what is around it."""

UNSTAMPED = bytes.fromhex(
    "01060a24181e4000fe01090101000047ccfe01090101000047cc060a24181e43e8fd1c00008c01011e000000"
    "00000000000000cdcc4c3e9a99993ecdcccc3e0000003f9a99193fb6ee"
)
"""Two frames in a row after an invalid stamp: it looks like a raw capture."""


@given(content=damaged_tlogs())
@example(content=SWALLOWING)
@example(content=TORN)
@example(content=UNSTAMPED)
@settings(
    max_examples=300,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
def test_what_pymavlink_finds_in_a_damaged_file_is_found(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "damaged.tlog"
    path.write_bytes(content)
    theirs = Counter(pymavlink_frames(path)) if content else Counter()
    try:
        ours = Counter(raw_frames(read_tlog(path)))
    except RecordingError as error:
        if "no time stamps" in str(error):
            return
        ours = Counter()
    assert not [one for one in theirs - ours if one in content]


SCAN_ALL = """
import hashlib, sys
import numpy as np
from ahrs_service.links.mavlink.frames import FRAME_DTYPE, SCAN_DTYPE, scan_stream, scan_tlog
from ahrs_service.links.mavlink.codec import CRC_EXTRA

seen = hashlib.sha256()
for line in sys.stdin.read().split():
    data = np.frombuffer(bytes.fromhex(line), np.uint8)
    for scan, argument in ((scan_tlog, 0), (scan_stream, True), (scan_stream, False)):
        state, rows = np.zeros(1, SCAN_DTYPE), np.zeros(64, FRAME_DTYPE)
        result = scan(data, argument, CRC_EXTRA, state, rows)
        seen.update(repr(tuple(map(int, result))).encode() + state.tobytes() + rows.tobytes())
print(seen.hexdigest())
"""


def test_the_uncompiled_scanner_finds_the_same_and_reads_nothing_beyond_the_end() -> None:
    signed, old = frame(30, bytes(range(1, 29)), is_signed=True), frame(30, b"\x01" * 28, version=1)
    unknown = frame(UNKNOWN_ID, b"\x01" * 20)
    whole = [records([one, attitude(1)]) for one in (signed, old, unknown)]
    cut = [content[start:stop] for content in whole for start in (0, 8) for stop in range(9, 70)]
    hit = [content[:at] + b"\xfd" + content[at + 1 :] for content in whole for at in range(60)]
    lines = "\n".join(content.hex() for content in [*whole, *cut, *hit])
    seen = [
        subprocess.run(
            [sys.executable, "-c", SCAN_ALL],
            input=lines,
            capture_output=True,
            text=True,
            check=True,
            cwd=Path(__file__).parents[3],
            env={**os.environ, "NUMBA_DISABLE_JIT": switch},
        ).stdout
        for switch in ("0", "1")
    ]
    assert seen[0] == seen[1]
