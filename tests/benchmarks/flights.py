"""Roll and pitch errors on real flights: ours and the peers, all causal, on the same samples.

Run: python tests/benchmarks/flights.py [--data DIR] [--logs NAME ...] [--no-ahrs] [--json OUT]

DIR holds the recordings (default: ../shared/data/flights beside the project). Every log goes
through the project's reader and intake; what the intake chose is what every algorithm gets. "ours"
sees gyro and accelerometer only, as the peers do; "ours aided" also what speed the link has. The
error is against the autopilot's own attitude (ahrs_service.comparison has the rules), which is
another estimate, not the truth; for sitl it is the simulator's truth.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from peers import PEERS, SHARED_DATA, attitude, flu_from_frd, frd_attitude, require_data
from rich.console import Console
from rich.table import Table

from ahrs_service import intake, pipeline
from ahrs_service.comparison import Comparison, compare
from ahrs_service.records import (
    ESTIMATE_DTYPE,
    SAMPLE_DTYPE,
    Airframe,
    Flag,
    Kind,
    Phase,
    Rows,
    empty,
)
from ahrs_service.sensor.parameters import Calibration, coefficients
from ahrs_service.settings import Settings
from links.recording import AttitudeReference
from links.recording_formats import read_recording

LOGS = {
    "x8 aerobatics": "x8_fixedwing_aerobatics_50hz_reencoded.tlog",
    "thor75": "umn_thor75_fixedwing_50hz_reencoded.tlog",
    "swiss2": "px4_fixedwing_swiss2_148hz_reencoded.tlog",
    "quad106": "copter_quad106_50hz_reencoded.tlog",
    "demo x8": "demo_x8_fixedwing_300s_reencoded.tlog",
    "plane erle": "plane_erle_2014-12-05_10hz.bin",
    "copter erle": "copter_erle_2014-09-07_50hz.bin",
    "copter pixhawk": "copter_pixhawk_2014_dualimu_50hz.bin",
    "auavx2": "px4_auavx2_quad_250hz.ulg",
    "fmuv6c": "px4_fmuv6c_quad_222hz.ulg",
    "log0036": "copter_pixhawk_log0036_crash_temp.bin",
    "sitl": "../sitl/arduplane_sitl_nominal.tlog",
}
OURS = ("ours", "ours gated", "ours aided")
UNUSED = int(Flag.DUPLICATE | Flag.REORDERED | Flag.NOT_FINITE)


@dataclass(frozen=True)
class Flight:
    """One recording: samples [N] SAMPLE_DTYPE and the attitude it has itself."""

    name: str
    samples: Rows
    reference: AttitudeReference

    @property
    def duration_s(self) -> float:
        """Time from the first sample to the last, without gaps of more than a minute [s]."""
        steps = np.diff(self.samples["time_ns"]) * 1e-9
        return float(steps[(steps > 0.0) & (steps < 60.0)].sum())


def read_flight(name: str, path: Path) -> Flight:
    """Read a log and let the intake choose its samples."""
    recording = read_recording(path)
    limit = int(np.count_nonzero(recording.readings["kind"] == Kind.IMU))
    samples = empty(SAMPLE_DTYPE, limit)
    positions = np.zeros(limit, np.int64)
    count = intake.select(
        intake.parameters(Settings().intake),
        intake.new_state(),
        recording.readings,
        samples,
        positions,
    )
    references = sorted(recording.references, key=lambda one: not one.is_truth)
    return Flight(name, samples[:count], references[0])


def ours(samples: Rows, mode: str, aided: bool) -> Rows:
    """Estimates [N] of our filter without the magnetometer; not aided: by gyro and force alone."""
    given = samples.copy()
    given["mag_ut"] = np.nan
    if not aided:
        given["airspeed_m_s"] = given["velocity_ned_m_s"] = np.nan
    settings = Settings()
    settings = replace(settings, fusion=replace(settings.fusion, mode=mode))
    estimates = empty(ESTIMATE_DTYPE, len(given))
    pipeline.batch(
        pipeline.parameters(settings),
        coefficients(Calibration.ideal()),
        pipeline.new_state(),
        given,
        estimates,
    )
    return estimates


def estimates_of(flight: Flight, names: list[str]) -> Iterator[tuple[str, Rows]]:
    """Estimates [N] ESTIMATE_DTYPE of each algorithm; all are judged where ours is running."""
    base = ours(flight.samples, "velocity", aided=False)
    used = base["flags"] & UNUSED == 0
    t = np.where(used, _rising_time_s(flight.samples["time_ns"], used), np.nan)
    gyr = flu_from_frd(flight.samples["gyro_rad_s"])
    acc = flu_from_frd(flight.samples["accel_m_s2"])
    for name in names:
        if name == "ours":
            rows = base
        elif name in OURS:
            rows = ours(
                flight.samples, "gated" if name == "ours gated" else "velocity", name == OURS[2]
            )
        else:
            rows = base.copy()
            rows["ned_from_body"] = frd_attitude(attitude(name, gyr, acc, t))
        rows["phase"] = base["phase"]
        yield name, rows


def _rising_time_s(time_ns: Any, used: Any) -> Any:
    """Times [N] [s] in which a clock that was set back goes on instead."""
    t = np.zeros(len(time_ns))
    stamps = time_ns[used]
    steps = np.diff(stamps) * 1e-9
    usual = float(np.median(steps[steps > 0.0]))
    t[used] = np.concatenate([[0.0], np.cumsum(np.where(steps > 0.0, steps, usual))])
    return t


def _figures(one: Comparison) -> dict[str, float | None]:
    figures = {
        "roll": float(np.degrees(one.roll.rms)),
        "pitch": float(np.degrees(one.pitch.rms)),
        "tilt": float(np.degrees(one.tilt.rms)),
        "steady_roll": float(np.degrees(one.steady_roll.rms)),
        "steady_pitch": float(np.degrees(one.steady_pitch.rms)),
        "steady_s": one.steady_s,
        "compared": one.compared,
        "steep": one.steep,
    }
    return {name: value if np.isfinite(value) else None for name, value in figures.items()}


def measure(flight: Flight, names: list[str]) -> dict[str, dict[str, float | None]]:
    """Errors [deg] of each algorithm on one flight."""
    reference = flight.reference
    return {
        name: _figures(compare(rows, reference.time_ns, reference.ned_from_body, False))
        for name, rows in estimates_of(flight, names)
    }


def table(title: str, results: dict[str, Any], names: list[str], prefix: str) -> Table:
    """Roll and pitch of every algorithm by flight, with ours as a share of the best peer's."""
    out = Table(title=title, title_justify="left", padding=(0, 1), show_edge=False)
    out.add_column("RMS roll, pitch [deg]")
    for name in [*names, "best peer", "ours / best", "gated / best"]:
        out.add_column(name, justify="right")
    for flight, result in results.items():
        errors = result["errors"]
        pairs = {
            name: (errors[name][f"{prefix}roll"], errors[name][f"{prefix}pitch"]) for name in names
        }
        if None in pairs["ours"]:
            out.add_row(flight, *["-"] * len(out.columns[1:]))
            continue
        best = min((name for name in names if name not in OURS), key=lambda name: sum(pairs[name]))
        shares = [f"{sum(pairs[name]) / sum(pairs[best]):.2f}" for name in OURS[:2]]
        figures = [f"{roll:.2f} {pitch:.2f}" for roll, pitch in pairs.values()]
        out.add_row(flight, *figures, best, *shares)
    return out


def main() -> int:
    """Run all and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA / "flights", metavar="DIR")
    parser.add_argument("--logs", nargs="+", choices=list(LOGS), default=list(LOGS))
    parser.add_argument("--no-ahrs", action="store_true", help="leave out what is slow")
    parser.add_argument("--json", type=Path, metavar="OUT")
    args = parser.parse_args()
    data = require_data(args.data, "the flight recordings")
    slow = ("Mahony", "Madgwick") if args.no_ahrs else ()
    names = [*OURS, *(name for name in PEERS if not name.startswith(slow or ("-",)))]
    results: dict[str, Any] = {}
    log = Console(stderr=True)
    for name in args.logs:
        path = data / LOGS[name]
        if not path.is_file():
            log.print(f"{path} is not there: left out", highlight=False, soft_wrap=True)
            continue
        flight = read_flight(name, path)
        running = ours(flight.samples, "velocity", aided=False)["phase"] == Phase.RUNNING
        airframe = Airframe(int(flight.samples["airframe"][-1])).name.lower()
        log.print(f"{name}: {len(flight.samples)} samples, {airframe}", highlight=False)
        results[name] = {
            "duration_s": flight.duration_s,
            "airframe": airframe,
            "samples": len(flight.samples),
            "running": float(running.mean()),
            "reference": flight.reference.name,
            "errors": measure(flight, names),
        }
    # The tables are as wide as they are, on a screen or in a file.
    out = Console(width=60 + 14 * (len(names) + 3))
    out.print(table("Whole flight", results, names, ""))
    out.print()
    out.print(table("Steady flight", results, names, "steady_"))
    out.print()
    for name, result in results.items():
        steady_s = result["errors"]["ours"]["steady_s"]
        out.print(
            f"{name}: {result['duration_s']:.0f} s, steady {steady_s:.0f} s, {result['airframe']}, "
            f"reference {result['reference']}",
            highlight=False,
        )
    if args.json is not None:
        args.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
