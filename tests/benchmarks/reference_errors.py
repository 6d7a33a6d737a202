"""How long the errors of real references last, and what the bound on that costs on nulls.

Run: python tests/benchmarks/reference_errors.py [--data DIR] [--cases DIR]

The misfit of each recording is fitted without any effect but the time offset, with the correlation
time of the reference's own errors free up to 20, 60 (diagnosis.flight) and 600 s. Shown: size and
time of the attitude's and the velocity's error under the longest bound, and the gain in restricted
likelihood over the shorter ones; below, on simulated recordings with a truth beside them, the
largest surprise of the screening under each bound: nulls (how near to an alarm) and others.
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from peers import SHARED_DATA, require_data
from real_data import broad_trial, part
from real_diagnoses import FLIGHTS
from rich.console import Console
from rich.table import Table

from ahrs_service.app.diagnose.recorded_columns import read_columns
from ahrs_service.diagnosis.diagnose import compare
from ahrs_service.diagnosis.hypotheses.candidates import library_of
from ahrs_service.diagnosis.hypotheses.likelihood import fit
from ahrs_service.diagnosis.hypotheses.model import Model, bare
from ahrs_service.diagnosis.hypotheses.score_test import screen
from ahrs_service.diagnosis.input import flight_misfit
from ahrs_service.diagnosis.input.diagnosis_input import Recorded
from ahrs_service.diagnosis.input.flight_misfit import FlightResidual
from ahrs_service.diagnosis.search.forward_search import extend
from ahrs_service.errors import RecordingError

BOUNDS_S = (20.0, 60.0, 600.0)
LATE = "imu_time_offset"
MIDDLE = (0.3, 0.7)


def recordings(folder: Path) -> Iterator[tuple[str, Recorded]]:
    """Yield the middle of the real recordings that hold a reference in flight."""
    for name in FLIGHTS:
        try:
            yield name, part(read_columns(folder / "flights" / name), *MIDDLE)
        except RecordingError as error:
            print(f"{name}: {error}")
    for path in sorted((folder / "broad").glob("*.npz"))[::3]:
        yield f"broad {path.stem}", part(broad_trial(path), *MIDDLE)


def fitted(recorded: Recorded, bound_s: float) -> tuple[FlightResidual, Model] | None:
    """Return the misfit with the time offset alone fitted under a bound; None on a bench."""
    flight_misfit._LONGEST_ERROR = float(np.log(bound_s))
    residual = compare(recorded)
    if not isinstance(residual, FlightResidual):
        return None
    model, library = bare(residual), library_of(residual, (LATE,))
    candidate = next(one for one in library.candidates if one.name == LATE)
    return residual, extend(residual, library, model, candidate, has_noise=True).model


def restricted(residual: FlightResidual, model: Model) -> float:
    """Return the restricted likelihood."""
    return fit(residual, model.noise, model.base, model.misfit, model.prior).restricted


def real_row(name: str, recorded: Recorded) -> list[str] | None:
    """Return sizes and times of the reference's errors, and the gains over shorter bounds."""
    values = []
    for bound_s in BOUNDS_S:
        found = fitted(recorded, bound_s)
        if found is None:
            return None
        values.append(restricted(*found))
    noise = dict(zip(found[0].noise_names, np.exp(found[1].noise), strict=True))
    return [
        name[:40],
        f"{1e3 * noise['reference_attitude_rad']:.2f}",
        f"{noise['reference_attitude_s']:.1f}",
        f"{noise['reference_velocity_m_s']:.3f}",
        f"{noise['reference_velocity_s']:.1f}",
        *(f"{values[-1] - value:.1f}" for value in values[:-1]),
    ]


def case_row(path: Path) -> list[str] | None:
    """Return the largest surprise of the screening under each bound."""
    truth = json.loads(path.read_text())
    names = [one["effect"] for one in truth["effects"] if one["effect"] != "none"]
    recording = path.with_suffix("").with_suffix(".tlog")
    if not recording.exists():
        recording = path.parents[1] / recording.name
    recorded, cells = read_columns(recording), []
    for bound_s in BOUNDS_S:
        flight_misfit._LONGEST_ERROR = float(np.log(bound_s))
        residual = compare(recorded)
        if not isinstance(residual, FlightResidual):
            return None
        model, library = bare(residual), library_of(residual)
        gains = screen(residual, model.noise, library, model.base, model.misfit)
        named = [n for n, one in enumerate(library.candidates) if one.effect is not None]
        best = max(named, key=lambda n: gains.surprise[n])
        cells.append(f"{gains.surprise[best]:.1f} {library.candidates[best].name}")
    return [recording.stem, ", ".join(names) or "nothing", *cells]


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=SHARED_DATA)
    parser.add_argument("--cases", type=Path, help="folder of *.truth.json; default the shared")
    arguments = parser.parse_args()
    folder = require_data(arguments.data, "the folders flights and broad")
    console = Console(width=150)
    gains = [f"gain over {bound_s:.0f} s" for bound_s in BOUNDS_S[:-1]]
    columns = ("recording", "attitude mrad", "s", "velocity m/s", "s", *gains)
    table = Table(*columns, title="errors of real references", title_justify="left")
    for name, recorded in recordings(folder):
        row = real_row(name, recorded)
        if row is not None:
            print(" | ".join(row), flush=True)
            table.add_row(*row)
    console.print(table)
    cases = arguments.cases or folder.parent / "mismatch" / "cases"
    columns = ("case", "truth", *(f"{bound_s:.0f} s" for bound_s in BOUNDS_S))
    table = Table(*columns, title="largest surprise of a name", title_justify="left")
    for path in sorted(cases.glob("*.truth.json")):
        row = case_row(path)
        if row is not None:
            print(" | ".join(row), flush=True)
            table.add_row(*row)
    console.print(table)


if __name__ == "__main__":
    main()
