"""Whose error: roll and pitch against the autopilot's attitude, and against better references.

Run: python tests/benchmarks/second_reference.py [--data DIR] [--logs NAME ...] [--no-ahrs]

flights.py takes the attitude that the autopilot flew by, an estimate as well: an error of its own
is in ours and in the peer's error alike and drives their ratio to 1. Here each log has a second:

- "GPS": the smoother of gps_smoother.py, which no filter here shares anything with but the IMU. Its
  own 1-sigma of tilt is printed, and over how much of the flight it is below 1 deg and near a fix.
  By how much it errs show sitl, whose "autopilot" is the truth, and thor75, whose autopilot has a
  good INS/GPS filter. In brackets least and largest ours / best with gyro or force taken for a
  third, or for three times as noisy: what the smoother's own settings decide.
- The ArduPilot logs of 2014 hold AHR2, the attitude of the EKF beside the DCM that was flown by
  (EKF1 is the same from the first sample on). It takes the GPS velocity too.

The best peer is the best against that reference.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from flight_recordings import LOGS, Flight, read_flight
from flights import OURS, estimates_of
from gps_reference import GpsReference, smoothed, usable
from gps_smoother import Noise
from gps_velocity import GpsVelocity, gps_velocity
from peers import PEERS, SHARED_DATA, require_data
from rich.console import Console
from rich.table import Table

from ahrs_service.comparison import Comparison, compare
from ahrs_service.links.logs.recording import AttitudeReference
from ahrs_service.links.logs.recording_formats import read_recording
from ahrs_service.records import ESTIMATE_DTYPE, Integers, Phase, Rows, empty

NAMES = ("x8 aerobatics", "thor75", "swiss2", "plane erle", "demo x8")
NAMES += ("quad106", "copter pixhawk", "sitl")
INSTANT_S = 0.1
COLUMNS = ("ours", "ours aided", "ours gated", "best peer", "ours / best", "gated / best")


def instants(one: GpsReference, stamps: Integers, q: Any) -> AttitudeReference:
    """Return attitudes `q` [N, 4] at samples where they may be believed, as a reference."""
    stride = max(1, round(INSTANT_S / float(np.median(np.diff(one.t_s)))))
    chosen = np.flatnonzero(one.valid)[::stride]
    return AttitudeReference("GPS", stamps[chosen], q[chosen])


def as_estimates(flight: Flight) -> Rows:
    """The flight's reference in the place of estimates, with the gyro's rate."""
    reference, samples = flight.reference, flight.samples[usable(flight.samples)]
    rows = empty(ESTIMATE_DTYPE, len(reference.time_ns))
    rows["time_ns"] = reference.time_ns
    rows["ned_from_body"] = reference.ned_from_body
    rows["phase"] = Phase.RUNNING
    for i, rate in enumerate(samples["gyro_rad_s"].T):
        rows["rate_rad_s"][:, i] = np.interp(reference.time_ns, samples["time_ns"], rate)
    return rows


def size(one: Comparison) -> float:
    """Roll and pitch RMS together [rad]."""
    return one.roll.rms + one.pitch.rms


def pair(one: Comparison, steady: bool = False) -> str:
    """RMS of roll and pitch [deg]."""
    parts = (one.steady_roll, one.steady_pitch) if steady else (one.roll, one.pitch)
    return " ".join(f"{np.degrees(part.rms):.2f}" for part in parts)


def share(errors: dict[str, Comparison], name: str) -> float:
    """Error as a share of the best peer's."""
    return size(errors[name]) / min(size(errors[p]) for p in errors if p not in OURS)


def against(found: dict[str, Rows], reference: AttitudeReference) -> dict[str, Comparison]:
    """Return all errors against one reference."""
    return {
        name: compare(rows, reference.time_ns, reference.ned_from_body, False)
        for name, rows in found.items()
    }


def cells(errors: dict[str, Comparison]) -> list[str]:
    """Return the cells of COLUMNS."""
    peer = min((name for name in errors if name not in OURS), key=lambda name: size(errors[name]))
    return [
        *(pair(errors[name]) for name in ("ours", "ours aided", "ours gated")),
        f"{pair(errors[peer])} {peer}",
        f"{share(errors, 'ours'):.2f}",
        f"{share(errors, 'ours gated'):.2f}",
    ]


def rows(
    flight: Flight, gps: GpsVelocity, others: list[AttitudeReference], names: list[str]
) -> Iterator[list[str]]:
    """Yield the rows of one flight."""
    found = dict(estimates_of(flight, names))
    own = as_estimates(flight)
    yield [flight.name, flight.reference.name, *cells(against(found, flight.reference))]
    for other in others:
        self_error = compare(own, other.time_ns, other.ned_from_body, False)
        yield ["", other.name, *cells(against(found, other)), pair(self_error)]
    one, _ = smoothed(flight, gps)
    stamps = flight.samples["time_ns"][usable(flight.samples)]
    reference = instants(one, stamps, one.attitudes)
    errors = against(found, reference)
    line = cells(errors)
    shares = []
    for factor in (1.0 / 3.0, 3.0):
        for noise in (Noise(gyro=factor * Noise.gyro), Noise(force=factor * Noise.force)):
            again = one.smoother.attitude(one.smoother.smooth(one.attitudes, noise=noise))
            shares.append(share(against(found, instants(one, stamps, again)), "ours"))
    line[4] += f" ({min(shares):.2f}, {max(shares):.2f})"
    sigma = np.degrees(np.sqrt(np.mean(one.sigma_rad[one.valid] ** 2)))
    self_error = compare(own, reference.time_ns, reference.ned_from_body, False)
    valid = f"{100.0 * one.valid.mean():.0f}"
    yield ["", reference.name, *line, pair(self_error), f"{sigma:.2f}", valid]
    steady = errors["ours"].steady_s
    flown = [pair(errors[name], True) for name in ("ours", "ours aided", "ours gated")]
    yield ["", f"GPS, steady {steady:.0f} s", *flown, "", "", "", pair(self_error, True)]


def main() -> int:
    """Print the rows of each log."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA / "flights", metavar="DIR")
    parser.add_argument("--logs", nargs="+", choices=list(LOGS), default=NAMES)
    parser.add_argument("--no-ahrs", action="store_true", help="leave out what is slow")
    args = parser.parse_args()
    data = require_data(args.data, "the flight recordings")
    slow = ("Mahony", "Madgwick") if args.no_ahrs else ("-",)
    names = [*OURS, *(name for name in PEERS if not name.startswith(slow))]
    out = Table(padding=(0, 1), show_edge=False)
    for column in ("RMS roll, pitch [deg]", "against", *COLUMNS, "autopilot", "sigma", "valid %"):
        out.add_column(column, no_wrap=True)
    for name in args.logs:
        path = data / LOGS[name]
        recording, flight = read_recording(path), read_flight(name, path)
        gps = gps_velocity(path, recording.readings)
        if gps is None:
            print(f"{name}: has no GPS", file=sys.stderr)
            continue
        others = [one for one in recording.references if one.name == "AHR2"]
        for line in rows(flight, gps, others, names):
            out.add_row(*line)
    Console(width=220).print(out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
