"""What the live viewer costs the thread that estimates, with and without it.

Run: python tests/benchmarks/viewer_cost.py [--rate 400] [--seconds 20]
"""

import argparse
import socket
import tempfile
import time
from pathlib import Path

import numpy as np

from ahrs_service.records import ESTIMATE_DTYPE, Phase, Rows, empty
from ahrs_service.viz.live import LiveViewer


def _rows(count: int, rate_hz: float) -> Rows:
    rows = empty(ESTIMATE_DTYPE, count)
    for name in ESTIMATE_DTYPE.names or ():
        if ESTIMATE_DTYPE[name].base.kind == "f":
            rows[name] = np.random.default_rng(1).normal(0.0, 1.0, rows[name].shape)
    rows["time_ns"] = np.round(np.arange(count) * 1e9 / rate_hz)
    rows["ned_from_body"] /= np.linalg.norm(rows["ned_from_body"], axis=1, keepdims=True)
    rows["phase"] = Phase.RUNNING
    rows["gate"] = np.arange(count) // 40 % 4
    return rows


def _paced(rows: Rows, rate_hz: float, viewer: LiveViewer | None) -> tuple[float, np.ndarray]:
    """Share of one core [%] that the process took, and how late each step came [ms]."""
    late = np.empty(len(rows))
    cpu, started = time.process_time(), time.perf_counter()
    for i in range(len(rows)):
        due = started + i / rate_hz
        while (wait := due - time.perf_counter()) > 0.0:
            time.sleep(wait)
        late[i] = (time.perf_counter() - due) * 1e3
        if viewer is not None:
            viewer.estimate(rows[i : i + 1])
            if i % 16 == 0:
                viewer.reference(int(rows["time_ns"][i]), rows["ned_from_body"][i])
            if i % 400 == 0:
                viewer.rates({"IMU": rate_hz, "ATTITUDE": 50.0})
    spent = time.process_time() - cpu
    return 100.0 * spent / (time.perf_counter() - started), late


def _call_us(rows: Rows) -> float:
    """Time of one `estimate` call [us], slicing of the row not counted."""
    viewer, ones = LiveViewer(), [rows[i : i + 1] for i in range(2000)]
    started = time.perf_counter()
    for _ in range(50):
        for row in ones:
            viewer.estimate(row)
    return (time.perf_counter() - started) / (50 * len(ones)) * 1e6


def main() -> None:
    """Print the costs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rate", type=float, default=400.0)
    parser.add_argument("--seconds", type=float, default=20.0)
    arguments = parser.parse_args()
    rows = _rows(round(arguments.rate * arguments.seconds), arguments.rate)
    print(f"estimate() {_call_us(rows):.2f} us per call")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    for label in ("without", "with"):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "live.rrd"
            viewer = None
            if label == "with":
                viewer = LiveViewer(port, path)
                viewer.start()
                viewer.ready.wait(30.0)
            percent, late = _paced(rows, arguments.rate, viewer)
            p50, p99, worst = (*np.percentile(late, [50, 99]), late.max())
            print(f"{label:8s} {percent:5.1f} % of a core, steps late p50 {p50:.2f} ms,", end=" ")
            print(f"p99 {p99:.2f} ms, max {worst:.1f} ms", end="")
            if viewer is not None:
                viewer.close()
                size = path.stat().st_size / arguments.seconds * 3600.0 / 1e6
                print(f", dropped {viewer.dropped}, file {size:.0f} MB/h {viewer.error}", end="")
            print()


if __name__ == "__main__":
    main()
