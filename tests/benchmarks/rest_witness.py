"""Is the reference right where the vehicle stands? Gravity, between one rest and the next, tells.

Run: python tests/benchmarks/rest_witness.py [--data DIR] [--logs NAME ...] [--json OUT]

A rest is 4 s and more in which gyro and accelerometer are still (1-sigma below 0.02 rad/s and
0.2 m/s^2, rate below 0.1 rad/s, norm of the force within 0.05 m/s^2 of its median over all that is
still: a smooth simulated flight is still, but not at 1 g, and a landing run is shorter). The mean
force there has a roll and a pitch by gravity alone; they are wrong by the accelerometer's offset
and the mounting, which are the same at each rest, so an attitude minus them may differ from 0, but
not from rest to rest. "moved" is by how much it does, the largest minus the smallest over all rests
[deg]: of the reference, what no constant error of a sensor explains. It is no measure of ours,
which takes gravity for its own at rest, and is printed beside it to be compared only.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from flight_recordings import LOGS, Flight, read_flight
from flights import DEFAULT_MODE, ours
from peers import SHARED_DATA, Floats, require_data
from rich.console import Console
from rich.table import Table

from ahrs_service.attitude_interpolation import at_instants
from ahrs_service.rotation import euler_columns

WINDOW_S = 2.0
REST_S = 4.0
RATE_SIGMA_RAD_S = 0.02
FORCE_SIGMA_M_S2 = 0.2
RATE_RAD_S = 0.1
NORM_M_S2 = 0.05


def rests(t_s: Floats, gyro: Floats, force: Floats) -> list[tuple[float, float]]:
    """Spans [s] of rest: windows that are still, joined where they follow each other."""
    still: dict[float, float] = {}
    for start in np.arange(t_s[0], t_s[-1] - WINDOW_S, WINDOW_S):
        here = (t_s >= start) & (t_s < start + WINDOW_S)
        if (
            here.sum() > 5
            and np.linalg.norm(gyro[here].std(axis=0)) < RATE_SIGMA_RAD_S
            and np.linalg.norm(force[here].std(axis=0)) < FORCE_SIGMA_M_S2
            and np.linalg.norm(gyro[here].mean(axis=0)) < RATE_RAD_S
        ):
            still[float(start)] = float(np.linalg.norm(force[here].mean(axis=0)))
    found: list[tuple[float, float]] = []
    usual = float(np.median(list(still.values()))) if still else 0.0
    for start, norm in still.items():
        if abs(norm - usual) > NORM_M_S2:
            continue
        if found and found[-1][1] == start:
            found[-1] = found[-1][0], start + WINDOW_S
        else:
            found.append((start, start + WINDOW_S))
    return [span for span in found if span[1] - span[0] >= REST_S]


def witness(flight: Flight) -> list[dict[str, Any]]:
    """At each rest the roll and pitch [deg] of reference and ours minus those of gravity."""
    samples, reference = flight.samples, flight.reference
    estimates = ours(samples, DEFAULT_MODE, aided=False)
    q, near = at_instants(estimates, reference.time_ns, reference.ned_from_body)
    origin = samples["time_ns"][0]
    t_s, at_s = ((one - origin) * 1e-9 for one in (samples["time_ns"], reference.time_ns))
    force = samples["accel_m_s2"]
    good = np.isfinite(samples["gyro_rad_s"]).all(axis=1) & np.isfinite(force).all(axis=1)
    rows = []
    for start, stop in rests(t_s[good], samples["gyro_rad_s"][good], force[good]):
        here = near & (at_s >= start) & (at_s < stop)
        if not here.any():
            continue
        x, y, z = force[good][(t_s[good] >= start) & (t_s[good] < stop)].mean(axis=0)
        gravity = np.degrees([np.arctan2(-y, -z), np.arctan2(x, np.hypot(y, z))])
        row: dict[str, Any] = {"start_s": float(start), "stop_s": float(stop)}
        for name, attitude in (("reference", reference.ned_from_body), ("ours", q)):
            apart = np.degrees(euler_columns(attitude[here])[:, :2]) - gravity
            row[name] = [float(one) for one in apart.mean(axis=0)]
        rows.append(row)
    return rows


def main() -> int:
    """Judge every flight and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA / "flights", metavar="DIR")
    parser.add_argument("--logs", nargs="+", choices=list(LOGS), default=list(LOGS))
    parser.add_argument("--json", type=Path, metavar="OUT")
    args = parser.parse_args()
    data = require_data(args.data, "the flight recordings")
    results = {name: witness(read_flight(name, data / LOGS[name])) for name in args.logs}
    out = Table(padding=(0, 1), show_edge=False)
    for name in ("flight", "rests", "s", "reference moved: roll", "pitch", "ours: roll", "pitch"):
        out.add_column(name, justify="right" if name != "flight" else "left")
    for name, rows in results.items():
        seconds = sum(row["stop_s"] - row["start_s"] for row in rows)
        cells = ["-"] * 4
        if len(rows) > 1:
            moved = (np.ptp([row[who] for row in rows], axis=0) for who in ("reference", "ours"))
            cells = [f"{one:.1f}" for pair in moved for one in pair]
        out.add_row(name, str(len(rows)), f"{seconds:.0f}", *cells)
    Console(width=110).print(out)
    if args.json is not None:
        args.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
