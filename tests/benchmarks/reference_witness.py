"""Is the reference or the estimate nearer to the truth? Witnesses that use no attitude filter.

Run: python tests/benchmarks/reference_witness.py [--data DIR] [--logs NAME ...] [--json OUT]

The autopilot's own attitude is an estimate too; these judge it by what no filter made.

GPS. Over windows of 0.5 s and more the specific force f, turned by an attitude R and freed of
gravity, must add up to the change of the GPS velocity v (Doppler, no attitude in it):

    r = (v(t1 + lag) - v(t0 + lag)) / T - Rz(psi) mean(R (f - b) + g),   |r| / g: a tilt error

horizontal parts only. Only the tilt of an attitude is judged: R has its tilt and turns about the
vertical as the gyro says, psi is fitted (Gaussian weights, sigma 5 s), and so is the accelerometer
bias b, which takes a constant tilt along. One lag per flight, at which all attitudes together fit
best. GPS noise is in every r; but it knows nothing of the difference d = r_ref - r_ours, so that

    fault = mean(r_ref . d) / mean(d . d)

is the share of their squared difference that is the reference's: 0 where the reference is right,
1 where ours is, whatever the noise. An error that both share is seen by neither. Its 1-sigma is
that of a bootstrap over blocks of 10 s. The check is sitl, whose reference is the truth: 0.

Still. A multirotor log without GPS: its velocity changes little in 20 s, so the same with v = 0. A
weaker witness: only slow tilt counts, and the velocity mode is built on the same assumption.

Gyro. The reference's turn over half a second minus that of the gyro, with the bias and matrix that
fit the whole flight: what no gyro saw is a correction by the reference's own filter. Its part about
horizontal axes is printed, rms and 99th percentile [deg/s].

Doubtful is a span of at least 2 s where, over 5 s around, an attitude (ours or the best peer's)
differs from the reference by more than 2 deg and the GPS is on its side: fault beyond 0.5 by more
than 3 sigma. On the truth of sitl this rule must find nothing.
"""

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from flight_recordings import LOGS, Flight, read_flight
from flights import estimates_of
from gps_reference import usable
from gps_velocity import GpsVelocity, gps_velocity
from peers import G0, SHARED_DATA, Floats, require_data
from rich.console import Console
from rich.table import Table
from tilt_witness import (
    Windows,
    best_lag,
    carried,
    gps_windows,
    gyro_corrections,
    residuals,
    still_windows,
    tilted,
    track,
)
from witness_statistics import doubtful, fault, nearer, spans

from ahrs_service.comparison import compare, rate_around, steady_flight
from ahrs_service.links.logs.recording_formats import read_recording
from ahrs_service.records import Airframe, Phase
from ahrs_service.rotation import inverse_columns, rotate_columns

PEER_CHOICE = ("vqf", "vqf tauAcc 10", "BasicVQF tauAcc 10", "Fusion", "Fusion gain .1 rej 5")
OUTLIER = 6.0
FAST_RAD_S = 1.0
STEEP_RAD = np.radians(60.0)
FEWEST_WINDOWS = 30
SEGMENTS = ("all", "steady", "turns", "fast or steep")


@dataclass(frozen=True)
class Attitudes:
    """Attitudes [N, 4] by name at the instants `t_s` [N], and what was measured there."""

    t_s: Floats
    gyro: Floats
    force: Floats
    running: Any
    by_name: dict[str, Floats]
    reference_s: Floats
    reference: Floats

    @property
    def peer(self) -> str:
        """Name of the peer that is nearest to the reference."""
        return list(self.by_name)[-1]


def attitudes(flight: Flight) -> Attitudes:
    """Run ours and the peers; keep the peer that is nearest to the reference."""
    samples = flight.samples
    good = usable(samples)
    origin = samples["time_ns"][0]
    t_s = (samples["time_ns"][good] - origin) * 1e-9
    order = np.argsort(flight.reference.time_ns, kind="stable")
    reference_s = (flight.reference.time_ns[order] - origin) * 1e-9
    rising = np.concatenate([[True], np.diff(reference_s) > 0.0])
    reference_s, reference = reference_s[rising], flight.reference.ned_from_body[order][rising]
    found, errors = {}, {}
    for name, rows in estimates_of(flight, ["ours", "ours aided", *PEER_CHOICE]):
        found[name] = rows["ned_from_body"][good]
        running = rows["phase"][good] == Phase.RUNNING
        one = compare(rows, flight.reference.time_ns, flight.reference.ned_from_body, False)
        errors[name] = one.roll.rms + one.pitch.rms
    peer = min(PEER_CHOICE, key=lambda name: errors[name])
    gyro, force = samples["gyro_rad_s"][good], samples["accel_m_s2"][good]
    by_name = {"reference": carried(t_s, gyro, reference_s, reference)}
    by_name |= {name: found[name] for name in ("ours", "ours aided", peer)}
    return Attitudes(t_s, gyro, force, running, by_name, reference_s, reference)


def segments(all_of: Attitudes, middle_s: Floats) -> dict[str, Any]:
    """Which windows [K] belong to which kind of flight, by the reference and the gyro."""
    down = rotate_columns(
        inverse_columns(all_of.by_name["reference"]),
        np.broadcast_to([0.0, 0.0, 1.0], all_of.force.shape),
    )
    tilt = np.interp(middle_s, all_of.t_s, np.arccos(np.clip(down[:, 2], -1.0, 1.0)))
    rate = np.interp(middle_s, all_of.t_s, np.linalg.norm(all_of.gyro, axis=1))
    stamps, instants = ((t * 1e9).astype(np.int64) for t in (all_of.t_s, all_of.reference_s))
    calm, _ = steady_flight(instants, all_of.reference, *rate_around(stamps, all_of.gyro, instants))
    steady = np.interp(middle_s, all_of.reference_s, calm.astype(np.float64)) > 0.5
    wild = (rate > FAST_RAD_S) | (tilt > STEEP_RAD)
    every = np.ones(len(middle_s), bool)
    return dict(zip(SEGMENTS, (every, steady, ~steady & ~wild, wild), strict=True))


def gyro_witness(all_of: Attitudes) -> dict[str, float]:
    """What the reference turned about horizontal axes and the gyro did not [deg/s]."""
    _, rate = gyro_corrections(all_of.t_s, all_of.gyro, all_of.reference_s, all_of.reference)
    return {"rms": float(np.sqrt(np.mean(rate**2))), "p99": float(np.percentile(rate, 99.0))}


def witness(flight: Flight, gps: GpsVelocity | None) -> dict[str, Any]:
    """All that the witnesses say of one flight."""
    all_of = attitudes(flight)
    result: dict[str, Any] = {"peer": all_of.peer, "gyro": gyro_witness(all_of)}
    if gps is not None:
        windows = gps_windows(gps, int(flight.samples["time_ns"][0]))
    elif Airframe(int(flight.samples["airframe"][-1])) == Airframe.MULTIROTOR:
        windows = still_windows(all_of.t_s)
    else:
        return result | {"witness": "none"}
    ready = np.interp(windows.start_s, all_of.t_s, all_of.running.astype(np.float64)) > 0.99
    first, last = all_of.reference_s[0], all_of.reference_s[-1]
    windows = windows.chosen(
        ready & (windows.start_s > first + 1.0) & (windows.stop_s < last - 1.0)
    )
    tracks = {
        name: track(all_of.t_s, all_of.force, tilted(all_of.t_s, all_of.gyro, q))
        for name, q in all_of.by_name.items()
    }
    lag_s = 0.0 if gps is None else best_lag(list(tracks.values()), windows)
    r = {name: residuals(one, windows, lag_s) for name, one in tracks.items()}
    # A glitch of the GPS is where no attitude explains it.
    smallest = np.min([np.abs(one) for one in r.values()], axis=0)
    kept = smallest < OUTLIER * np.median(np.abs(r["reference"]))
    windows, r = windows.chosen(kept), {name: one[kept] for name, one in r.items()}
    marked = doubtful(r["reference"], r["ours"], windows)
    marked |= doubtful(r["reference"], r[all_of.peer], windows)
    return result | {
        "witness": "still" if gps is None else "GPS",
        "lag_s": lag_s,
        "windows": len(windows.start_s),
        "segments": _by_segment(all_of, windows, r),
        "doubtful_share": float(marked.mean()),
        "doubtful_spans_s": spans(marked, windows.middle_s) if gps is not None else [],
    }


def _degrees(r: Any) -> float:
    return float(np.degrees(np.sqrt(np.mean(np.abs(r) ** 2)) / G0))


def _by_segment(all_of: Attitudes, windows: Windows, r: dict[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for segment, mask in segments(all_of, windows.middle_s).items():
        if mask.sum() < FEWEST_WINDOWS:
            continue
        part = {name: one[mask] for name, one in r.items()}
        out[segment] = {
            name: {
                "residual_deg": _degrees(one),
                "apart_deg": _degrees(part["reference"] - one),
                "fault": fault(part["reference"], one, windows.middle_s[mask])
                if name != "reference"
                else None,
            }
            for name, one in part.items()
        }
    return out


def whole_table(results: dict[str, Any]) -> Table:
    """Whole flights: residuals of all, how far apart, and whose fault that is."""
    out = Table(title="Whole flight, tilt", title_justify="left", padding=(0, 1), show_edge=False)
    names = (
        "flight",
        "witness",
        "GPS lag s",
        "windows",
        "residual deg: ref",
        "ours",
        "aided",
        "peer",
    )
    for name in (*names, "ours-ref deg", "fault of ref", "nearer", "fault, aided", "fault, peer"):
        out.add_column(name, justify="left" if name in ("flight", "witness") else "right")
    for flight, result in results.items():
        if result["witness"] == "none":
            out.add_row(flight, "none", *["-"] * (len(out.columns) - 2))
            continue
        one = result["segments"]["all"]
        columns = ("ours", "ours aided", result["peer"])
        shares = [one[name]["fault"] for name in columns]
        said = [f"{share:.2f} ± {sigma:.2f}" for share, sigma in shares]
        out.add_row(
            flight,
            result["witness"],
            f"{result['lag_s']:.2f}",
            str(result["windows"]),
            *(f"{one[name]['residual_deg']:.2f}" for name in ("reference", *columns)),
            f"{one['ours']['apart_deg']:.2f}",
            said[0],
            nearer(*shares[0]),
            said[1],
            f"{said[2]} {result['peer']}",
        )
    return out


def segment_table(results: dict[str, Any]) -> Table:
    """The reference's share by kind of flight, and what its own corrections are."""
    title = "Fault of the reference against ours (ours-ref deg) by kind of flight; its corrections"
    out = Table(title=title, title_justify="left", padding=(0, 1), show_edge=False)
    for name in ("flight", *SEGMENTS[1:], "unseen by the gyro deg/s: rms", "p99", "doubtful %"):
        out.add_column(name, justify="left" if name == "flight" else "right")
    for flight, result in results.items():
        cells = []
        for segment in SEGMENTS[1:]:
            one = result.get("segments", {}).get(segment)
            if one is None:
                cells.append("-")
                continue
            share, sigma = one["ours"]["fault"]
            cells.append(f"{share:.2f} ± {sigma:.2f} ({one['ours']['apart_deg']:.1f})")
        gyro = result["gyro"]
        doubt = f"{100.0 * result['doubtful_share']:.0f}" if result["witness"] == "GPS" else "-"
        out.add_row(flight, *cells, f"{gyro['rms']:.2f}", f"{gyro['p99']:.1f}", doubt)
    return out


def main() -> int:
    """Ask the witnesses about every flight and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA / "flights", metavar="DIR")
    parser.add_argument("--logs", nargs="+", choices=list(LOGS), default=list(LOGS))
    parser.add_argument("--json", type=Path, metavar="OUT")
    args = parser.parse_args()
    data = require_data(args.data, "the flight recordings")
    log, results = Console(stderr=True), {}
    for name in args.logs:
        path = data / LOGS[name]
        if not path.is_file():
            log.print(f"{path} is not there: left out", highlight=False, soft_wrap=True)
            continue
        log.print(name, highlight=False)
        results[name] = witness(
            read_flight(name, path), gps_velocity(path, read_recording(path).readings)
        )
    out = Console(width=210)
    out.print(whole_table(results))
    out.print()
    out.print(segment_table(results))
    out.print()
    for name, result in results.items():
        for start, stop in result.get("doubtful_spans_s", ()):
            out.print(f"{name}: reference doubtful {start:.0f} to {stop:.0f} s", highlight=False)
    if args.json is not None:
        args.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
