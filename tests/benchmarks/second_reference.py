"""Roll and pitch errors against every attitude that a log holds, and how far those are apart.

Run: python tests/benchmarks/second_reference.py [--data DIR] [--logs NAME ...]

flights.py takes the attitude that the autopilot flew by. The ArduPilot logs of 2014 hold another:
ATT is the DCM's, which was flown by, AHR2 that of the EKF beside it from when it was ready (EKF1 is
the same, from the first sample on). That EKF takes the GPS velocity, as ours aided does. What two
references differ by bounds what an error against one of them can tell; one that is tens of degrees
from the other has failed.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from flight_recordings import LOGS, read_flight
from flights import DEFAULT_MODE, ours
from peers import SHARED_DATA, require_data
from rich.console import Console
from rich.table import Table

from ahrs_service.comparison import compare
from ahrs_service.records import ESTIMATE_DTYPE, Phase, Rows, empty
from links.recording import AttitudeReference
from links.recording_formats import read_recording


def errors(rows: Rows, reference: AttitudeReference) -> str:
    """RMS of roll and pitch [deg]; in brackets in steady flight."""
    one = compare(rows, reference.time_ns, reference.ned_from_body, False)
    angles = (one.roll.rms, one.pitch.rms, one.steady_roll.rms, one.steady_pitch.rms)
    roll, pitch, steady_roll, steady_pitch = np.degrees(angles)
    return f"{roll:.2f} {pitch:.2f} ({steady_roll:.2f} {steady_pitch:.2f})"


def as_estimates(reference: AttitudeReference) -> Rows:
    """A reference in the place of estimates."""
    rows = empty(ESTIMATE_DTYPE, len(reference.time_ns))
    rows["time_ns"] = reference.time_ns
    rows["ned_from_body"] = reference.ned_from_body
    rows["rate_rad_s"] = 0.0
    rows["phase"] = Phase.RUNNING
    return rows


def main() -> int:
    """Print a row for each attitude of each log."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = ["plane erle", "copter pixhawk"]
    parser.add_argument("--data", type=Path, default=SHARED_DATA / "flights", metavar="DIR")
    parser.add_argument("--logs", nargs="+", choices=list(LOGS), default=names)
    args = parser.parse_args()
    data = require_data(args.data, "the flight recordings")
    out = Table(padding=(0, 1), show_edge=False)
    for column in ("RMS roll, pitch (steady) [deg]", "against", "ours", "ours aided", "the first"):
        out.add_column(column)
    for name in args.logs:
        flight = read_flight(name, data / LOGS[name])
        alone, aided = (ours(flight.samples, DEFAULT_MODE, aided=a) for a in (False, True))
        first = as_estimates(flight.reference)
        for one in read_recording(data / LOGS[name]).references:
            apart = errors(first, one).split(" (")[0]
            out.add_row(name, one.name, errors(alone, one), errors(aided, one), apart)
    Console(width=130).print(out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
