"""What `diagnose` answers on real recordings, whole and in halves.

Run: python tests/benchmarks/real_diagnoses.py [--data DIR] [--only WORD] [--json OUT]

As they are: each recording whole, and its halves apart; a finding that only one half shows is no
finding. tests/benchmarks/real_mismatches.py says, without the diagnosis, what is to be found;
tests/benchmarks/real_planted.py plants effects.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from peers import SHARED_DATA, require_data
from real_data import broad_trial, part
from rich.console import Console
from rich.table import Table

from ahrs_service.app.diagnose.loaded_recording import load
from ahrs_service.app.diagnose.recorded_columns import with_velocity
from ahrs_service.diagnosis.diagnose import diagnose
from ahrs_service.diagnosis.input.diagnosis_input import Recorded
from ahrs_service.diagnosis.result import Diagnosis

FLIGHTS = (
    "px4_auavx2_quad_250hz.ulg",
    "px4_fmuv6c_quad_222hz.ulg",
    "copter_pixhawk_log0036_crash_temp.bin",
    "copter_pixhawk_log0039_temp.bin",
    "px4_fixedwing_swiss2_148hz_reencoded.tlog",
    "copter_quad106_50hz_reencoded.tlog",
    "umn_thor75_fixedwing_50hz_reencoded.tlog",
    "x8_fixedwing_aerobatics_50hz_reencoded.tlog",
    "bench_cuav_2021-12-08_static_warmup_2hz.tlog",
)
TRIALS = ("06", "09", "16", "27")
SHARES = {"whole": (0.0, 1.0), "first half": (0.0, 0.5), "second half": (0.5, 1.0)}


@dataclass(frozen=True)
class Answer:
    """What diagnose said of one piece of a recording."""

    recording: str
    piece: str
    verdict: str
    named: list[str]
    values: dict[str, Any]
    unexplained: list[str]


def answer(name: str, piece: str, recorded: Recorded) -> Answer:
    """Diagnose; a refusal is an answer too."""
    try:
        found = diagnose(recorded)
    except ValueError as error:
        return Answer(name, piece, f"refused: {error}", [], {}, [])
    return Answer(
        name,
        piece,
        found.verdict,
        ["|".join(one.alike or (one.effect,)) for one in found.findings],
        values_of(found),
        [f"{item.channel} on {'+'.join(item.depends_on)}" for item in found.unexplained],
    )


def values_of(found: Diagnosis) -> dict[str, Any]:
    """Return value and sigma of every parameter found."""
    return {
        f"{one.effect}.{name}": [
            np.asarray(estimate.value).tolist(),
            np.asarray(estimate.std).tolist(),
        ]
        for one in found.findings
        for name, estimate in one.parameters.items()
    }


def recordings(folder: Path, word: str) -> Iterator[tuple[str, Recorded]]:
    """Yield the recordings whose name holds `word`."""
    for name in FLIGHTS:
        if word in name:
            yield name, _loaded(folder / "flights" / name)
    for path in sorted((folder / "broad").glob("*.npz")):
        if path.stem[:2] in TRIALS and word in f"broad {path.stem}":
            yield f"broad {path.stem}", broad_trial(path)


def _loaded(path: Path) -> Recorded:
    """Return the columns; without any velocity diagnose refuses, and says so."""
    loaded = load(path)
    try:
        return with_velocity(loaded)
    except ValueError:
        return loaded.columns


def row(one: Answer) -> tuple[str, ...]:
    """Return the cells of an answer."""
    values = "; ".join(
        f"{name.split('.')[1]} {np.array2string(np.asarray(value), precision=4)}"
        for name, (value, _) in one.values.items()
    )
    named = ", ".join(one.named) or "-"
    return one.recording, one.piece, one.verdict, named, values, ", ".join(one.unexplained)


def main() -> None:
    """Print the answers as they come."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=SHARED_DATA)
    parser.add_argument("--only", default="", metavar="WORD")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    folder = require_data(arguments.data, "the folders flights and broad")
    answers: list[Answer] = []
    console = Console(width=190)

    def told(one: Answer) -> None:
        answers.append(one)
        console.print(" | ".join(row(one)), highlight=False, markup=False)
        if arguments.json is not None:
            arguments.json.write_text(json.dumps([asdict(a) for a in answers], indent=1))

    for name, recorded in recordings(folder, arguments.only):
        for piece, share in SHARES.items():
            told(answer(name, piece, part(recorded, *share)))
    table = Table(title="what diagnose answers", title_justify="left")
    for column in ("recording", "piece", "verdict", "named", "values", "unexplained"):
        table.add_column(column, overflow="fold")
    for one in answers:
        table.add_row(*row(one))
    console.print(table)


if __name__ == "__main__":
    main()
