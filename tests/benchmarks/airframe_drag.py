"""How much of a motion through the air shows in the specific force, on real flights.

Run: python tests/benchmarks/airframe_drag.py [--data DIR]

DIR holds the flight recordings (default: ../shared/data/flights beside the project). The filter
takes v = -T (f - f0) along a body axis (fusion.velocity_constraints); here T and f0 are fitted to
means over half a second, for drag_s in configs/airframes.

Fixed wing: v_y = V sin(aos), v_z = V sin(aoa) by the vanes and the airspeed V of the UMN Ultra
Stick 25e: the motion through the air as it is measured, without any attitude; f_z counts from -g.

Multirotor: nobody measured the motion through the air. The satellite receiver's velocity, turned
into body axes by the autopilot's attitude C, is fitted as f = -k (C^T v - C^T w) + f0 with a wind w
that stays, for x and y at once; T = 1 / k. The receiver's lag is the one that fits best. What it
says of k leans on that attitude, which is an estimate.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
from flight_recordings import LOGS, Flight, read_flight
from gps_velocity import GpsVelocity, gps_velocity
from peers import SHARED_DATA, Floats, require_data
from rich.console import Console
from rich.table import Table

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.links.logs.recording_formats import read_recording
from ahrs_service.rotation import inverse_columns, rotate_columns

VANES = "umn_thor75_fixedwing_50hz.mat"
VANE_AXES = {"y": ("aos", "ay", 0.0), "z": ("aoa", "az", -STANDARD_GRAVITY_M_S2)}
MULTIROTORS = ("quad106", "copter pixhawk")
FLYING_AIRSPEED_M_S = 8.0
MOVING_M_S = 2.0
MEAN_S = 0.5
LAGS_S = np.arange(0.0, 0.61, 0.05)


@dataclass(frozen=True)
class Line:
    """v = -T (f - f0) of one axis, from `count` means.

    T [s], v where f is that of level flight [m/s], their correlation, the standard deviations of v
    and of what the line leaves of it [m/s].
    """

    drag_s: float
    level_m_s: float
    correlation: float
    spread_m_s: float
    rest_m_s: float
    count: int


def by_vanes(path: Path) -> dict[str, Line]:
    """Fit the flight with vanes: one line per axis."""
    data = scipy.io.loadmat(path, simplify_cells=True)["flight_data"]
    size = round(MEAN_S / float(np.median(np.diff(data["time"]))))
    flying = _blocks(data["ias"] > FLYING_AIRSPEED_M_S, size).all(axis=1)
    lines = {}
    for axis, (angle, force, level) in VANE_AXES.items():
        f = _blocks(data[force] - level, size).mean(axis=1)[flying]
        v = _blocks(data["ias"] * np.sin(data[angle]), size).mean(axis=1)[flying]
        slope, at_level = np.polyfit(f, v, 1)
        rest = float(np.std(v - slope * f))
        lines[axis] = Line(-slope, at_level, np.corrcoef(f, v)[0, 1], float(v.std()), rest, len(v))
    return lines


def _blocks(column: Any, size: int) -> Any:
    return column[: len(column) // size * size].reshape(-1, size)


def by_receiver(flight: Flight, gps: GpsVelocity) -> tuple[float, dict[str, Line]]:
    """Fit a multirotor's flight: the receiver's lag [s] and one line per axis."""
    fits = [_fit(*_means(flight, gps, lag_s)) for lag_s in LAGS_S]
    best = int(np.argmin([np.var(rest) for _, _, rest in fits]))
    k, v, rest = fits[best]
    lines = {}
    for i, axis in enumerate("xy"):
        # What wind and trim explain is off before v and f are held against each other.
        f = rest[:, i] - k[i] * v[:, i]
        correlation = float(np.corrcoef(f, v[:, i])[0, 1])
        left = float(rest[:, i].std() / k[i])
        lines[axis] = Line(1.0 / k[i], 0.0, correlation, float(v[:, i].std()), left, len(v))
    return float(LAGS_S[best]), lines


def _means(flight: Flight, gps: GpsVelocity, lag_s: float) -> tuple[Floats, Floats, Floats]:
    """Attitudes [M, 4] body from north-east-down, velocities and forces [M, 3] of fast flight."""
    reference, samples = flight.reference, flight.samples
    time_ns, half_ns = gps.time_ns - round(lag_s * 1e9), round(0.5e9 * MEAN_S)
    times = np.maximum.accumulate(samples["time_ns"])
    first, last = (np.searchsorted(times, time_ns + x) for x in (-half_ns, half_ns))
    place = np.clip(np.searchsorted(reference.time_ns, time_ns), 0, len(reference.time_ns) - 1)
    used = np.abs(reference.time_ns[place] - time_ns) < half_ns
    used &= (last > first) & (np.hypot(gps.ned_m_s[:, 0], gps.ned_m_s[:, 1]) > MOVING_M_S)
    sums = np.cumsum(np.nan_to_num(samples["accel_m_s2"]), axis=0)
    sums = np.concatenate([np.zeros((1, 3)), sums])
    force = (sums[last] - sums[first])[used] / (last - first)[used, None]
    body_from_ned = inverse_columns(reference.ned_from_body[place[used]])
    return body_from_ned, np.nan_to_num(gps.ned_m_s[used]), force


def _fit(
    body_from_ned: Floats, velocity_ned: Floats, force: Floats
) -> tuple[Floats, Floats, Floats]:
    """k along x and y [1/s], velocity in body axes [M, 2], what the fit leaves of the force."""
    v = rotate_columns(body_from_ned, velocity_ned)[:, :2]
    count = len(v)
    design = np.zeros((count, 2, 6))
    for i in range(2):
        design[:, i, i] = -v[:, i]
        design[:, i, 4 + i] = 1.0
        design[:, :, 2 + i] = rotate_columns(body_from_ned, np.eye(3)[i])[:, :2]
    flat, known = design.reshape(-1, 6), force[:, :2].reshape(-1)
    solution, *_ = np.linalg.lstsq(flat, known, rcond=None)
    return solution[:2], v, (known - flat @ solution).reshape(count, 2)


def main() -> int:
    """Fit all and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA / "flights", metavar="DIR")
    data = require_data(parser.parse_args().data, "the flight recordings")
    table = Table(title="v = -T (f - f0), means over half a second")
    for title in ("flight", "axis", "T [s]", "k [1/s]", "v at level [m/s]", "correlation"):
        table.add_column(title, justify="left" if title == "flight" else "right")
    for title in ("v, 1-sigma [m/s]", "rest [m/s]", "means", "lag [s]"):
        table.add_column(title, justify="right")
    found = {("vanes of thor75", ""): by_vanes(data / VANES)}
    for name in MULTIROTORS:
        path = data / LOGS[name]
        gps = gps_velocity(path, read_recording(path).readings)
        if gps is None:
            raise SystemExit(f"{path}: has no velocity of a satellite receiver")
        lag_s, lines = by_receiver(read_flight(name, path), gps)
        found[name, f"{lag_s:.2f}"] = lines
    for (name, lag), lines in found.items():
        for axis, line in lines.items():
            level = f"{line.level_m_s:.2f}" if not lag else ""
            figures = (line.correlation, line.spread_m_s, line.rest_m_s)
            cells = [f"{line.drag_s:.2f}", f"{1.0 / line.drag_s:.2f}", level]
            cells += [f"{one:.2f}" for one in figures]
            table.add_row(name, axis, *cells, str(line.count), lag)
    Console(width=130).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
