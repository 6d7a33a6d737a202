"""S() of the gates: how much their three measures vary while a vehicle flies steadily.

Run: python tests/benchmarks/steady_motion.py [--data DIR]

DIR holds the folders flights and broad (default: ../shared/data beside the project). S() are the
standard deviations of abs(norm(f) - g0), norm(w) and norm(dw/dt) as the gates see them (Liu et al.,
sec. 4), for [gate_budget] in configs/airframes. Steady is what lies between the first and the last
instant of speed, in roll within 10 deg of level and in pitch within 10 deg of the usual, by the
recording's own attitude and for at least 3 s. Of BROAD it is a slow rotation by hand.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from broad import PROFILE
from flight_recordings import LOGS, Flight, read_flight
from flights import DEFAULT_MODE, ours
from peers import SHARED_DATA, require_data
from rich.console import Console
from rich.table import Table

from ahrs_service.app.estimate.sample_columns import read_columns
from ahrs_service.app.files import config_file
from ahrs_service.estimator import Estimator
from ahrs_service.records import Phase, Rows
from ahrs_service.rotation import euler_columns

FLOWN = ("x8 aerobatics", "thor75", "plane erle", "sitl")
HOVERED = ("quad106", "copter pixhawk", "copter erle", "fmuv6c")
TURNED = (
    "01_undisturbed_slow_rotation_A",
    "03_undisturbed_slow_rotation_C",
    "05_undisturbed_slow_rotation_with_breaks_B",
)
MEASURES = ("gate_norm_m_s2", "gate_rate_rad_s", "gate_angular_acceleration_rad_s2")
LEVEL_DEG = 10.0
AT_LEAST_NS = 3_000_000_000
SETTLED_NS = 1_000_000_000
AIRSPEED_M_S = 8.0
SPEED_M_S = 2.0


def steady(flight: Flight) -> tuple[Any, Rows]:
    """Which samples [N] are of steady flight, and the estimates [N]."""
    samples, reference = flight.samples, flight.reference
    times = np.maximum.accumulate(samples["time_ns"])
    velocity = samples["velocity_ned_m_s"]
    moving = samples["airspeed_m_s"] > AIRSPEED_M_S
    if not moving.any():
        moving = np.hypot(velocity[:, 0], velocity[:, 1]) > SPEED_M_S
    moved = times[moving] if moving.any() else times
    roll, pitch, _ = np.degrees(euler_columns(reference.ned_from_body)).T
    level = np.abs(roll) < LEVEL_DEG
    level &= np.abs(pitch - np.median(pitch)) < LEVEL_DEG
    edges = np.flatnonzero(np.diff(np.concatenate([[False], level, [False]]).astype(np.int8)))
    chosen = np.zeros(len(samples), bool)
    for start, stop in edges.reshape(-1, 2):
        begin, end = reference.time_ns[start], reference.time_ns[stop - 1]
        if end - begin > AT_LEAST_NS:
            chosen |= (times > max(begin + SETTLED_NS, moved[0])) & (times < min(end, moved[-1]))
    estimates = ours(samples, DEFAULT_MODE, aided=False)
    return chosen & (estimates["phase"] == Phase.RUNNING), estimates


def turned(path: Path) -> tuple[Any, Rows]:
    """Which samples [N] of a BROAD trial are in movement, and the estimates [N]."""
    columns = read_columns(path)
    samples = columns.samples(0, len(columns.time_ns), "flu", magnetometer=False)
    estimates = Estimator(config_file.load(profile=PROFILE)).run(samples)
    with np.load(path) as file:
        return file["movement"] & (estimates["phase"] == Phase.RUNNING), estimates


def row(name: str, chosen: Any, estimates: Rows) -> list[str]:
    """Cells of the printed table."""
    step_s = float(np.median(np.diff(estimates["time_ns"]))) * 1e-9
    sigmas = (f"{estimates[name][chosen].std():.2f}" for name in MEASURES)
    return [name, f"{chosen.sum() * step_s:.0f}", *sigmas]


def main() -> int:
    """Measure all and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA, metavar="DIR")
    data = require_data(parser.parse_args().data, "the folders flights and broad")
    table = Table(title="S(): standard deviation in steady motion")
    for title in ("recording", "s", "norm(f) [m/s^2]", "norm(w) [rad/s]", "norm(dw/dt) [rad/s^2]"):
        table.add_column(title, justify="left" if title == "recording" else "right")
    for group in (FLOWN, HOVERED):
        for name in group:
            flight = read_flight(name, data / "flights" / LOGS[name])
            table.add_row(*row(name, *steady(flight)))
        table.add_section()
    for name in TURNED:
        table.add_row(*row(name, *turned(data / "broad" / f"{name}.npz")))
    Console(width=110).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
