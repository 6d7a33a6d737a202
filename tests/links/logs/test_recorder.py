"""The recorder against the tlog reader, the disk's limits, and a killed process."""

import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from ahrs_service.links.logs.recorder import Recorder
from ahrs_service.links.logs.tlog import TlogFile, read_tlog
from ahrs_service.links.mavlink.codec import Encoder, dialect
from ahrs_service.links.mavlink.frames import strip_signature
from ahrs_service.links.mavlink.signing import Signer

FIRST_US = 1_700_000_000_000_000
MESSAGE = dialect.MAVLink_attitude_message(1000, 0.5, -0.25, 3.0, 0.0, 0.0, 0.0)


def frames(count: int) -> list[bytes]:
    encoder = Encoder(1, 1)
    return [
        encoder.pack(dialect.MAVLink_attitude_message(i + 1, 0.5, -0.25, 3.0, 0.0, 0.0, 0.125))
        for i in range(count)
    ]


def pieces(log: TlogFile) -> list[tuple[int, bytes]]:
    data = log.data.tobytes()
    return [
        (int(row["received_us"]), data[row["offset"] : row["offset"] + row["length"]])
        for row in log.frames
    ]


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "logs")
    sent = [(FIRST_US + 4 * i, frame) for i, frame in enumerate(frames(5000))]
    for stamp, frame in sent:
        recorder.write(stamp, frame)
    recorder.close()
    (path,) = (tmp_path / "logs").iterdir()
    assert path.name == "20231114-221320-00.tlog"
    assert path == recorder.file
    log = read_tlog(path)
    assert pieces(log) == sent
    assert not any(log.damaged.values())
    assert recorder.last_stamp_us == sent[-1][0]
    assert recorder.counts.frames == 5000
    assert recorder.counts.bytes == path.stat().st_size
    assert recorder.counts.dropped == 0


def test_a_real_recording_passes_through_but_for_its_signatures(
    shared: Path, tmp_path: Path
) -> None:
    source = shared / "flights" / "copter_cube_2018-09-25_mission_3imu.tlog"
    if not source.is_file():
        pytest.skip(f"{source.name} is not among the shared recordings")
    wanted = [(us, strip_signature(f)) for us, f in pieces(read_tlog(source))[:20000]]
    recorder = Recorder(tmp_path / "copy.tlog")
    for stamp, frame in wanted:
        recorder.write(stamp, frame)
    recorder.close()
    assert pieces(read_tlog(tmp_path / "copy.tlog")) == wanted


def test_signatures_are_stripped_and_keys_never_recorded(tmp_path: Path) -> None:
    signer, encoder = Signer(bytes(32), 1), Encoder(1, 1)
    plain = encoder.pack(MESSAGE)
    setup = encoder.pack(dialect.MAVLink_setup_signing_message(1, 1, [7] * 32, 0))
    recorder = Recorder(tmp_path / "log.tlog", header=lambda: [signer.sign(plain)])
    recorder.write(FIRST_US, signer.sign(plain))
    recorder.write(FIRST_US, setup)
    recorder.write(FIRST_US, signer.sign(setup))
    old = MESSAGE.pack(dialect.MAVLink(None, 1, 1), force_mavlink1=True)
    recorder.write(FIRST_US, old)
    recorder.close()
    assert pieces(read_tlog(tmp_path / "log.tlog")) == [
        (FIRST_US, plain),
        (FIRST_US, plain),
        (FIRST_US, old),
    ]
    assert bytes([7] * 32) not in (tmp_path / "log.tlog").read_bytes()


def test_every_file_begins_with_the_header_and_none_is_overwritten(tmp_path: Path) -> None:
    header = [Encoder(1, 191).pack(MESSAGE)]
    taken = tmp_path / "20231114-221320-00.tlog"
    taken.write_bytes(b"precious")
    recorder = Recorder(tmp_path, rotate_mb=0.1, header=lambda: header)
    sent = frames(6000)
    for frame in sent:
        recorder.write(FIRST_US, frame)
    recorder.close()
    assert taken.read_bytes() == b"precious"
    files = sorted(set(tmp_path.iterdir()) - {taken})
    assert [path.name for path in files] == [
        f"20231114-221320-{i:02d}.tlog" for i in range(1, len(files) + 1)
    ]
    assert len(files) == recorder.counts.files > 2
    found = [[frame for _, frame in pieces(read_tlog(path))] for path in files]
    assert all(part[0] == header[0] for part in found)
    assert [frame for part in found for frame in part[1:]] == sent
    assert all(path.stat().st_size < 170_000 for path in files)


def test_the_oldest_own_files_make_room(tmp_path: Path) -> None:
    foreign = [tmp_path / "flight.tlog", tmp_path / "20000101-000000-00.tlog.bak"]
    for path in foreign:
        path.write_bytes(bytes(10**6))
    oldest = tmp_path / "20000101-000000-00.tlog"
    oldest.write_bytes(bytes(500_000))
    notes: list[str] = []
    recorder = Recorder(tmp_path, rotate_mb=0.1, limit_mb=0.6, on_note=notes.append)
    for i, frame in enumerate(frames(20000)):
        recorder.write(FIRST_US + 1000 * i, frame)
    recorder.close()
    assert not oldest.exists()
    assert all(path.exists() for path in foreign)
    own = set(tmp_path.iterdir()) - set(foreign)
    assert sum(path.stat().st_size for path in own) < 700_000
    assert recorder.counts.deleted == recorder.counts.files + 1 - len(own) > 1
    assert f"deleted {oldest}" in next(note for note in notes if "deleted" in note)
    last = read_tlog(max(own))
    assert last.tables[1, 1, "ATTITUDE"]["time_boot_ms"][-1] == 20000


def test_one_file_ends_at_the_limit(tmp_path: Path) -> None:
    notes: list[str] = []
    recorder = Recorder(tmp_path / "a.tlog", rotate_mb=0.1, limit_mb=0.2, on_note=notes.append)
    for frame in frames(10000):
        recorder.write(FIRST_US, frame)
    recorder.close()
    assert [path.name for path in tmp_path.iterdir()] == ["a.tlog"]
    assert len(read_tlog(tmp_path / "a.tlog").frames) == recorder.counts.frames
    assert recorder.counts.frames + recorder.counts.dropped == 10000
    assert recorder.counts.dropped > 0
    assert [note for note in notes if "the limit" in note] == notes[1:]
    assert len(notes) == 2


def test_a_full_disk_leaves_whole_frames_and_is_said_once(tmp_path: Path) -> None:
    notes: list[str] = []
    recorder = Recorder(tmp_path, on_note=notes.append)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_001, limits[1]))
    try:
        for frame in frames(10000):
            recorder.write(FIRST_US, frame)
        recorder.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    (path,) = tmp_path.iterdir()
    log = read_tlog(path)
    assert not any(log.damaged.values())
    assert len(log.frames) == recorder.counts.frames > 0
    assert recorder.counts.frames + recorder.counts.dropped == 10000
    assert len(notes) == 2
    assert "recording ended" in notes[1]


def test_a_disk_with_little_left_is_not_filled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ahrs_service.links.logs.recorder.KEEP_FREE_MB", 1e12)
    notes: list[str] = []
    recorder = Recorder(tmp_path, on_note=notes.append)
    recorder.write(FIRST_US, frames(1)[0])
    recorder.flush()
    recorder.write(FIRST_US, frames(1)[0])
    recorder.close()
    assert recorder.counts.dropped == 2
    assert "MB free" in notes[-1]


@pytest.mark.parametrize("name", ["folder", "log.tlog"])
def test_a_place_that_cannot_be_written_is_said_once(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "log.tlog").write_bytes(b"precious")
    where = tmp_path / "file" / name if name == "folder" else tmp_path / name
    notes: list[str] = []
    recorder = Recorder(where, on_note=notes.append)
    for frame in frames(10):
        recorder.write(FIRST_US, frame)
        recorder.flush()
    recorder.close()
    assert recorder.counts.dropped == 10
    assert len(notes) == 1
    assert str(where) in notes[0]
    assert (tmp_path / "log.tlog").read_bytes() == b"precious"


WRITER = """
import sys
from ahrs_service.links.logs.recorder import Recorder
recorder = Recorder(sys.argv[1])
frame = bytes.fromhex(sys.argv[2])
for i in range(10**9):
    recorder.write(1_700_000_000_000_000 + 4 * i, frame)
    if i == 20000:
        recorder.flush()
        print("going", flush=True)
"""


def test_a_killed_process_leaves_whole_frames(tmp_path: Path) -> None:
    frame = frames(1)[0]
    writer = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path / "log.tlog"), frame.hex()],
        stdout=subprocess.PIPE,
        cwd=Path(__file__).resolve().parents[3],
        env={**os.environ, "PYTHONPATH": "."},
    )
    assert writer.stdout is not None
    assert writer.stdout.readline() == b"going\n"
    os.kill(writer.pid, signal.SIGKILL)
    writer.wait()
    writer.stdout.close()
    log = read_tlog(tmp_path / "log.tlog")
    assert len(log.frames) > 20000
    assert not {k: v for k, v in log.damaged.items() if k != "truncated_tail_bytes" and v}
    assert all(piece == (FIRST_US + 4 * i, frame) for i, piece in enumerate(pieces(log)[:30000]))
