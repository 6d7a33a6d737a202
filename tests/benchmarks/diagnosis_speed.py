"""Time and memory of `diagnose` on long recordings at 200 Hz, each in a process of its own.

Run: python tests/benchmarks/diagnosis_speed.py [--seconds 600 3600] [--only TEXT] [--keep DIR]

The blind generator makes the recordings (a rate table at 100 Hz, the flights at 200 Hz): nothing
hidden, one effect, two effects. Wall time is what a user waits, but other programs disturb it, so
CPU time of all threads stands beside it. `bar` is the longest time without a move of the progress
bar, `peak` the largest resident memory of the process, interpreter and libraries with it.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ahrs_service.app.diagnose.recorded_columns import read_columns
from ahrs_service.app.prove.blind_files import write_case
from ahrs_service.blind.making.case import Request, make
from ahrs_service.diagnosis.diagnose import diagnose

HIDDEN = {
    "bench": ((), ("gyro_thermal_bias",), ("accel_thermal_bias", "gyro_scale_factor")),
    "flight": ((), ("accel_current_coupling",), ("gyro_scale_factor", "gyro_current_coupling")),
    "copter": ((), ("imu_time_offset",), ("gyro_g_sensitivity", "accel_scale_factor")),
}
SEED = 20260705


def requests(lengths_s, only):
    """What to make: every kind with nothing, one and two effects, of every length."""
    for seconds in lengths_s:
        for kind, choices in HIDDEN.items():
            for effects in choices:
                name = f"{kind}_{seconds}s_{len(effects)}"
                if only in name:
                    yield Request(name, kind, SEED + len(effects), seconds, 1, effects)


def diagnosed(path):
    """Diagnose one recording in this process; return times and answer."""
    moves = [time.perf_counter()]

    def move(share):
        moves.append(time.perf_counter())

    start = time.perf_counter()
    columns = read_columns(path, move)
    read = time.perf_counter()
    found = diagnose(columns, move)
    moves.append(time.perf_counter())
    return {
        "reading_s": read - start,
        "bar_s": max(b - a for a, b in pairwise(moves)),
        "found": [f"{f.effect} {f.log_evidence:.1f}" for f in found.findings],
        "unexplained": [u.channel for u in found.unexplained],
    }


def measured(path):
    """Diagnose one recording in a fresh process; return its answer, times and peak memory."""
    start = time.perf_counter()
    command = [sys.executable, __file__, "--one", str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        answer = process.stdout.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{path}: diagnosis failed")
    return json.loads(answer) | {
        "wall_s": time.perf_counter() - start,
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "peak_mb": usage.ru_maxrss / 1024.0,
    }


def run(folder, lengths_s, only):
    """Make and diagnose all recordings; print a row each as it is done."""
    out = Console(width=150)
    table = Table("recording", "MB", "reading s", "wall s", "CPU s", "bar s", "peak MB", "found")
    for request in requests(lengths_s, only):
        path = folder / f"{request.name}.tlog"
        if not path.exists():
            write_case(folder, folder, make(request))
        row = measured(path)
        out.print(f"{request.name}: {row}", highlight=False)
        table.add_row(
            request.name,
            f"{path.stat().st_size / 1e6:.0f}",
            *(f"{row[key]:.1f}" for key in ("reading_s", "wall_s", "cpu_s", "bar_s")),
            f"{row['peak_mb']:.0f}",
            ", ".join([*row["found"], *(f"unexplained {u}" for u in row["unexplained"])])
            or "nothing",
        )
    out.print(table)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, nargs="+", default=[600, 3600])
    parser.add_argument("--only", default="", help="recordings whose name holds this")
    parser.add_argument("--keep", type=Path, help="folder to keep the recordings in")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one is not None:
        print(json.dumps(diagnosed(args.one)))
        return
    with tempfile.TemporaryDirectory() as scratch:
        folder = args.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        run(folder, args.seconds, args.only)


if __name__ == "__main__":
    main()
