"""The columnar tlog reader against mavutil.recv_match over the same file, in one run.

Run: python tests/benchmarks/tlog_reader.py [--data FILE.tlog] [--repeats 5]

Both read every message; the columnar reader decodes all tables. They take turns; the table
gives medians. Memory is what a fresh process holds after reading, by its RSS and by tracemalloc.
"""

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ahrs_service.links.logs.tlog import read_tlog, tlog_record
from ahrs_service.links.mavlink.codec import Encoder, dialect

RECORDING = (
    Path(__file__).resolve().parents[2].parent / "shared/data/sitl/arduplane_sitl_nominal.tlog"
)
START_US = 1_700_000_000_000_000

HELD = """
import gc, sys, tracemalloc
from pathlib import Path
from ahrs_service.links.logs.tlog import read_tlog

def rss():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

def held(path):
    tlog = read_tlog(path)
    return tlog, [tlog.tables[key] for key in tlog.tables]

held(sys.argv[2])
gc.collect()
if sys.argv[1] == "traced":
    tracemalloc.start()
before = rss()
result = held(sys.argv[3])
gc.collect()
after = tracemalloc.get_traced_memory()[0] if sys.argv[1] == "traced" else rss() - before
print(after)
"""


def made(path: Path, seconds: int = 300) -> Path:
    """Write a tlog like a companion link's: HIGHRES_IMU 200 Hz and what goes with it."""
    encoder = Encoder(1, 1)
    with path.open("wb") as file:
        for i in range(200 * seconds):
            ms = 5 * i
            messages = [
                dialect.MAVLink_highres_imu_message(
                    1000 * ms,
                    0.1,
                    0.2,
                    -9.8,
                    0.01 * (i % 7),
                    0,
                    0,
                    0.2,
                    0,
                    0.4,
                    1,
                    0,
                    0,
                    31,
                    0x1FFF,
                )
            ]
            if i % 2 == 0:
                messages.append(dialect.MAVLink_attitude_message(ms, 0.1, 0.2, 0.3, 0, 0, 0))
                messages.append(
                    dialect.MAVLink_raw_imu_message(
                        1000 * ms, 1, 2, -1000, 3, i % 9, 5, 200, 0, 400
                    )
                )
            if i % 20 == 0:
                messages.append(dialect.MAVLink_vfr_hud_message(20.0, 21.0, 90, 50, 100.0, 0.5))
            if i % 200 == 0:
                messages.append(dialect.MAVLink_heartbeat_message(1, 3, 81, 0, 4, 3))
            for message in messages:
                file.write(tlog_record(START_US + 1000 * ms, encoder.pack(message)))
    return path


def by_columns(path: Path) -> int:
    """Read and decode all; return the number of messages."""
    tlog = read_tlog(path)
    return sum(len(tlog.tables[key]) for key in tlog.tables)


def by_recv_match(path: Path) -> int:
    """The same with mavutil, in the same dialect."""
    from pymavlink import mavutil

    log: Any = mavutil.mavlogfile(str(path))
    log.mav = dialect.MAVLink(None)
    log.mav.robust_parsing = True
    log.first_byte = False
    count = 0
    while (message := log.recv_match()) is not None:
        count += message.get_type() != "BAD_DATA"
    log.close()
    return count


def timed(read: Callable[[Path], int], path: Path) -> tuple[float, int]:
    start = time.perf_counter()
    count = read(path)
    return time.perf_counter() - start, count


def held_bytes(how: str, path: Path, small: Path) -> int:
    """Bytes a fresh process holds after reading `path`, warmed up with `small`."""
    command = [sys.executable, "-c", HELD, how, str(small), str(path)]
    root = Path(__file__).resolve().parents[2]
    result = subprocess.run(command, capture_output=True, text=True, check=True, cwd=root)
    return int(result.stdout)


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--data", type=Path, help="tlog to read (default: a recording, or a made one)"
    )
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        small = made(Path(folder) / "small.tlog", seconds=2)
        path = arguments.data
        if path is None:
            path = RECORDING if RECORDING.is_file() else made(Path(folder) / "made.tlog")
        by_columns(small)
        by_recv_match(small)
        columns, theirs = [], []
        for _ in range(arguments.repeats):
            columns.append(timed(by_columns, path))
            theirs.append(timed(by_recv_match, path))
        ours_s = statistics.median(seconds for seconds, _ in columns)
        theirs_s = statistics.median(seconds for seconds, _ in theirs)
        size = path.stat().st_size
        rows = [
            ("file", f"{path.name}, {size / 1e6:.1f} MB"),
            ("messages, columns / recv_match", f"{columns[0][1]} / {theirs[0][1]}"),
            (
                "columns, all tables",
                f"{ours_s * 1e3:.0f} ms, {ours_s / columns[0][1] * 1e6:.2f} us each",
            ),
            ("recv_match", f"{theirs_s * 1e3:.0f} ms, {theirs_s / theirs[0][1] * 1e6:.2f} us each"),
            ("faster by", f"{theirs_s / ours_s:.0f} times"),
            ("held / file size, RSS", f"{held_bytes('rss', path, small) / size:.2f}"),
            ("held / file size, tracemalloc", f"{held_bytes('traced', path, small) / size:.2f}"),
        ]
    for name, value in rows:
        print(f"{name:32} {value}")


if __name__ == "__main__":
    main()
