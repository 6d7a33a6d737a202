"""Roll and pitch errors on real flights: ours and the peers, all causal, on the same samples.

Run: python tests/benchmarks/flights.py [--data DIR] [--logs NAME ...] [--all] [--no-ahrs]
                                        [--contract] [--json OUT]

DIR holds the recordings (default: ../shared/data/flights beside the project): the known ones, with
--all every other one too that can be read and has an attitude to compare with. Every log goes
through the project's reader and intake; what the intake chose is what every algorithm gets. "ours"
sees gyro and accelerometer only, as the peers do; "ours aided" also the airspeed and the velocity
over ground that the log has. All get the IMU in the vehicle's axes, by AHRS_TRIM. Ours runs with
the profile of the vehicle's class (configs/airframes), as its HEARTBEAT says it. The error
is against the autopilot's own attitude (ahrs_service.comparison has the rules), which is another
estimate, not the truth (second_reference.py and own_error.py judge all by the GPS); for sitl it is
the simulator's truth.

The first flight, with --contract every one, also goes through `ahrs-service estimate` as a process:
its bytes must be those of the function that the command calls, and its errors stand in a table of
their own. They may differ from "ours", since plain arrays carry no flags (contract.py).
"""

import argparse
import dataclasses
import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import contract
import numpy as np
import worst_minute
from flight_recordings import LOGS, Flight, read_flight, recordings
from peers import PEERS, SHARED_DATA, attitude, flu_from_frd, frd_attitude, require_data
from rich.console import Console
from rich.table import Table

from ahrs_service.app.estimate.arrays import estimate_columns
from ahrs_service.app.estimate.sample_columns import read_columns
from ahrs_service.app.files import config_file
from ahrs_service.comparison import Comparison, compare
from ahrs_service.errors import RecordingError
from ahrs_service.estimator import Estimator
from ahrs_service.records import (
    Airframe,
    Flag,
    Phase,
    Rows,
)
from ahrs_service.settings import Settings

OURS = ("ours", "ours gated", "ours aided")
CONTRACT = "six axes", "aided", "offline"
UNUSED = int(Flag.DUPLICATE | Flag.REORDERED | Flag.NOT_FINITE)
DEFAULT_MODE = Settings().fusion.mode


def ours(samples: Rows, mode: str, aided: bool) -> Rows:
    """Estimates [N] of our filter without the magnetometer; not aided: by gyro and force alone."""
    given = samples.copy()
    given["mag_ut"] = np.nan
    if not aided:
        given["airspeed_m_s"] = given["velocity_ned_m_s"] = np.nan
    settings = config_file.load(None, [f"fusion.mode={mode}"], contract.profile_of(samples))
    return Estimator(settings).run(given)


def estimates_of(flight: Flight, names: list[str]) -> Iterator[tuple[str, Rows]]:
    """Estimates [N] ESTIMATE_DTYPE of each algorithm; all are judged where ours is running."""
    base = ours(flight.samples, DEFAULT_MODE, aided=False)
    used = base["flags"] & UNUSED == 0
    t = np.where(used, _rising_time_s(flight.samples["time_ns"], used), np.nan)
    gyr = flu_from_frd(flight.samples["gyro_rad_s"])
    acc = flu_from_frd(flight.samples["accel_m_s2"])
    for name in names:
        if name == "ours":
            rows = base
        elif name in OURS:
            mode = "gated" if name == "ours gated" else DEFAULT_MODE
            rows = ours(flight.samples, mode, aided=name == "ours aided")
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
        "roll_mean": float(np.degrees(one.roll.mean)),
        "pitch_mean": float(np.degrees(one.pitch.mean)),
        "steady_s": one.steady_s,
        "compared": one.compared,
        "steep": one.steep,
    }
    return {name: value if np.isfinite(value) else None for name, value in figures.items()}


def measure(flight: Flight, names: list[str]) -> dict[str, Any]:
    """Errors [deg] of each algorithm on one flight, the best peer, and ours' worst minute."""
    reference = flight.reference
    errors, best, kept = {}, np.inf, {}
    for name, rows in estimates_of(flight, names):
        one = compare(rows, reference.time_ns, reference.ned_from_body, False)
        errors[name] = _figures(one)
        size = one.roll.rms + one.pitch.rms
        if name == "ours":
            kept["ours"] = rows
        elif name not in OURS and size < best:
            best, kept["peer"], peer = size, rows, name
    result: dict[str, Any] = {"errors": errors}
    if len(kept) > 1 and errors["ours"]["compared"]:
        result["best_peer"] = peer
        result["worst_minute"] = worst_minute.worst_minute(
            flight.samples, kept["ours"], kept["peer"], reference
        )
    return result


def through_contract(flight: Flight) -> dict[str, Any]:
    """Errors [deg] of the command's answers; leave where its bytes are not the function's."""
    samples, reference = flight.samples, flight.reference
    profile = contract.profile_of(samples)
    settings = config_file.load(profile=profile)
    rows, errors = ours(samples, DEFAULT_MODE, aided=False), {}
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "in.npz"
        for name in CONTRACT:
            if name == "offline" and not contract.offers("--offline"):
                continue
            contract.write_samples(source, samples, aided=name == "aided")
            more = ("--offline",) if name == "offline" else ()
            quat = contract.run_estimate(source, profile, "frd", *more)["quat"]
            if not more:
                same = estimate_columns(read_columns(source), settings, "frd")["quat"]
                if not np.array_equal(quat, same):
                    raise SystemExit(f"{flight.name}: the command's answer is not the function's")
            rows["ned_from_body"] = quat
            errors[name] = _figures(
                compare(rows, reference.time_ns, reference.ned_from_body, False)
            )
    return errors


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


def contract_table(results: dict[str, Any]) -> Table:
    """Errors of the command beside those of the samples with their flags."""
    title = "Through `ahrs-service estimate`, RMS roll, pitch [deg]"
    out = Table(title=title, title_justify="left", padding=(0, 1), show_edge=False)
    out.add_column("flight")
    columns = [("samples with flags", "errors", "ours"), ("aided", "errors", "ours aided")]
    columns += [(f"command, {name}", "contract", name) for name in CONTRACT]
    columns = [one for one in columns if any(one[2] in r.get(one[1], ()) for r in results.values())]
    for title, _, _ in columns:
        out.add_column(title, justify="right")
    for flight, result in results.items():
        if "contract" in result:
            cells = (result[part][name] for _, part, name in columns)
            out.add_row(flight, *(_pair(one["roll"], one["pitch"]) for one in cells))
    return out


def _pair(roll: float | None, pitch: float | None) -> str:
    return "-" if roll is None or pitch is None else f"{roll:.2f} {pitch:.2f}"


def run(args: argparse.Namespace, names: list[str], log: Console) -> dict[str, Any]:
    """All results by flight."""
    results: dict[str, Any] = {}
    data = require_data(args.data, "the flight recordings")
    for name, path in recordings(data, args.logs, args.all).items():
        try:
            flight = read_flight(name, path)
        except RecordingError as error:
            log.print(f"left out: {error}", highlight=False, soft_wrap=True)
            continue
        samples = flight.samples
        airframe = Airframe(int(samples["airframe"][-1])).name.lower()
        log.print(f"{name}: {len(samples)} samples, {airframe}", highlight=False)
        running = ours(samples, DEFAULT_MODE, aided=False)["phase"] == Phase.RUNNING
        results[name] = {
            "duration_s": flight.duration_s,
            "airframe": airframe,
            "samples": len(samples),
            "running": float(running.mean()),
            "reference": flight.reference.name,
            "aided_by": {
                "airspeed": int(np.isfinite(samples["airspeed_m_s"]).sum()),
                "velocity": int(np.isfinite(samples["velocity_ned_m_s"]).any(axis=1).sum()),
            },
            **measure(flight, names),
        }
        if args.contract or len(results) == 1:
            results[name]["contract"] = through_contract(flight)
    return results


def report(results: dict[str, Any], names: list[str]) -> None:
    """Print the tables."""
    # The tables are as wide as they are, on a screen or in a file.
    out = Console(width=60 + 24 * (len(names) + 3))
    minutes = {
        flight: (result["best_peer"], result["worst_minute"])
        for flight, result in results.items()
        if "worst_minute" in result
    }
    for one in (
        table("Whole flight", results, names, ""),
        table("Steady flight", results, names, "steady_"),
        contract_table(results),
        worst_minute.table(minutes),
    ):
        out.print(one)
        out.print()
    for name, result in results.items():
        own, aid = result["errors"]["ours"], result["aided_by"]
        mean = _pair(own["roll_mean"], own["pitch_mean"])
        out.print(
            f"{name}: {result['duration_s']:.0f} s, steady {own['steady_s']:.0f} s, "
            f"{result['airframe']}, reference {result['reference']}; mean error {mean}; "
            f"samples with airspeed {aid['airspeed']}, velocity {aid['velocity']}",
            highlight=False,
        )


def main() -> int:
    """Run all and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA / "flights", metavar="DIR")
    parser.add_argument("--logs", nargs="+", choices=list(LOGS), default=list(LOGS))
    parser.add_argument("--all", action="store_true", help="every recording in DIR")
    parser.add_argument("--no-ahrs", action="store_true", help="leave out what is slow")
    parser.add_argument("--contract", action="store_true", help="all flights by the command too")
    parser.add_argument("--json", type=Path, metavar="OUT")
    args = parser.parse_args()
    slow = ("Mahony", "Madgwick") if args.no_ahrs else ()
    names = [*OURS, *(name for name in PEERS if not name.startswith(slow or ("-",)))]
    results = run(args, names, Console(stderr=True))
    report(results, names)
    if args.json is not None:
        plain = json.dumps(results, indent=1, default=dataclasses.asdict)
        args.json.write_text(plain + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
