"""Which profile `estimate` takes where --profile is left out, and what the choice costs.

Run: python tests/benchmarks/recognition.py [--data DIR]

DIR holds flights/, sitl/ and broad/ (default: ../shared/data). Six axes, plain arrays: RMS of roll
plus that of pitch on flights, of the inclination on BROAD [deg], with the profile of the class that
the recording says, with the one recognised, and with the class unknown (`other`); then by what it
was recognised: speed along the nose [m/s] and its correlation, how far the force wanders [deg], how
much it changes across for along.
"""

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import broad
import contract
import numpy as np
from flight_recordings import LOGS, Flight, read_flight, recordings
from flights import DEFAULT_MODE, ours
from peers import SHARED_DATA, inclination, require_data
from rich.console import Console
from rich.table import Table

from ahrs_service.app.estimate import recognition
from ahrs_service.app.estimate.arrays import estimate_columns
from ahrs_service.app.estimate.sample_columns import Columns, read_columns
from ahrs_service.app.files import config_file
from ahrs_service.comparison import compare


def _row(columns: Columns, frame: str, true: str, error: Callable[[Any], float]) -> list[str]:
    """Cells of one recording; `error` [deg] judges attitudes [N, 4]."""
    signs = recognition.signs_of(columns, frame)
    found = recognition.profile_of(signs)
    settings = (
        config_file.load(profile=true),
        config_file.load(profile=found),
        config_file.load(None, ["fusion.airframe=other"]),
    )
    answers = (estimate_columns(columns, one, frame)["quat"] for one in settings)
    shown = (
        f"{signs.speed_m_s:.1f} {signs.likeness:.2f}",
        f"{math.degrees(signs.spread_rad):.0f}",
        f"{signs.sideways:.2f}",
    )
    return [true, found, *(f"{error(quat):.2f}" for quat in answers), *shown]


def of_flight(flight: Flight) -> list[str]:
    """Cells of one flight."""
    samples, reference = flight.samples, flight.reference
    columns = Columns(samples["time_ns"], samples["gyro_rad_s"], samples["accel_m_s2"])
    rows = ours(samples, DEFAULT_MODE, aided=False)

    def error(quat: Any) -> float:
        rows["ned_from_body"] = quat
        one = compare(rows, reference.time_ns, reference.ned_from_body, False)
        return math.degrees(one.roll.rms + one.pitch.rms)

    return _row(columns, "frd", contract.profile_of(samples) or "none", error)


def of_trial(path: Path) -> list[str]:
    """Cells of one trial of BROAD."""
    trial = broad.read_trial(path)

    def error(quat: Any) -> float:
        angle = inclination(quat[trial.scored], trial.reference)
        return math.degrees(math.sqrt(np.mean(angle * angle)))

    return _row(read_columns(path), "flu", broad.PROFILE, error)


def main() -> int:
    """Print a row for each recording."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA, metavar="DIR")
    data = require_data(parser.parse_args().data, "flights/, sitl/ and broad/")
    out = Table(padding=(0, 1), show_edge=False)
    for column in (
        "recording",
        "is",
        "taken for",
        "its own",
        "as taken",
        "unknown",
        "speed",
        "force",
    ):
        out.add_column(column)
    out.add_column("across")
    for name, path in recordings(data / "flights", list(LOGS), False).items():
        out.add_row(name, *of_flight(read_flight(name, path)))
    for path in sorted((data / "broad").glob("*.npz")):
        out.add_row(path.stem, *of_trial(path))
    Console(width=110).print(out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
