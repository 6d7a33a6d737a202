"""Effects planted into real recordings, and what `diagnose` makes of them.

Run: python tests/benchmarks/real_planted.py [--data DIR] [--only WORD] [--json OUT]

One effect is put into the raw readings of a piece of a real recording (added, quantised to whole
counts of an MPU-6000, clipped), and the piece is diagnosed as it is and with the effect. The effect
counts as found where its id is named, as one of its class where its class is. "Beyond" is what was
found less what the untouched piece showed of the same effect, in the units of the catalogue; it is
recovered where every number is within 1.96 sigma of what was planted, sigma being that of both
diagnoses together, for both are fits. "Also new" is what else the planted piece is said to have and
the untouched one is not: wrong names.

The sizes are those of small autopilots: 15 ms of stamps, 1 % of scale, some centimetres of arm,
1 mrad/s per m/s^2; they were written down before the first run.
"""

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from peers import SHARED_DATA, require_data
from real_data import broad_trial, part, planted
from rich.console import Console
from rich.table import Table

from ahrs_service.app.diagnose.recorded_columns import read_columns
from ahrs_service.diagnosis.diagnose import diagnose
from ahrs_service.diagnosis.input.diagnosis_input import Recorded
from ahrs_service.diagnosis.result import Diagnosis, Finding
from ahrs_service.effects.catalogue import effect_of

_LATE = ("imu_time_offset", {"offset_s": 0.015})
_DRIFT = ("imu_clock_drift", {"ppm": 400.0})
_SCALE = ("gyro_scale_factor", {"scale_error": [0.012, -0.010, 0.015]})
_FORCE_SCALE = ("accel_scale_factor", {"scale_error": [0.010, -0.010, 0.015]})
_TILTED = ("gyro_misalignment", {"off_diagonal": [[0, 0.01, 0], [0, 0, -0.01], [0.01, 0, 0]]})
_ARM = ("accel_lever_arm", {"arm_m": [0.06, -0.05, 0.04]})
_PUSHED = (
    "gyro_g_sensitivity",
    {"matrix_rad_s_per_m_s2": [[1e-3, 0, 0], [0, 1e-3, 0], [0, 0, 1e-3]]},
)
_SHAKEN = ("accel_vibration_rectification", {"per_vibration_variance": [0.02, 0.0, -0.06]})
_WARMED = ("gyro_thermal_bias", {"linear": [2e-3, -2e-3, 1e-3]})


@dataclass(frozen=True)
class Piece:
    """A share of a recording and what is planted into it."""

    path: str
    read: Callable[[Path], Recorded]
    share: tuple[float, float]
    effects: tuple[tuple[str, dict[str, Any]], ...]


PIECES = (
    Piece(
        "broad/09_undisturbed_fast_rotation_with_breaks_B.npz",
        broad_trial,
        (0.05, 0.4),
        (_LATE, _DRIFT, _SCALE, _TILTED, _ARM, _PUSHED),
    ),
    Piece(
        "broad/06_undisturbed_fast_rotation_A.npz",
        broad_trial,
        (0.05, 0.4),
        (_LATE, _SCALE, _ARM, _PUSHED),
    ),
    Piece(
        "broad/16_undisturbed_fast_translation_B.npz",
        broad_trial,
        (0.05, 0.4),
        (_SCALE, _FORCE_SCALE, _PUSHED),
    ),
    Piece(
        "flights/copter_pixhawk_log0039_temp.bin",
        read_columns,
        (0.0, 1.0),
        (_LATE, _SCALE, _SHAKEN, _WARMED),
    ),
    Piece(
        "flights/umn_thor75_fixedwing_50hz_reencoded.tlog",
        read_columns,
        (0.3, 0.5),
        (_LATE, _SCALE, _ARM),
    ),
    Piece(
        "flights/x8_fixedwing_aerobatics_50hz_reencoded.tlog",
        read_columns,
        (0.3, 0.5),
        (_LATE, _SCALE),
    ),
    Piece(
        "sitl/arduplane_sitl_nominal.tlog",
        read_columns,
        (0.3, 0.5),
        (_LATE, _SCALE, _ARM, _FORCE_SCALE),
    ),
)


@dataclass(frozen=True)
class Answer:
    """What was planted and what was found; `within` where every number is in its interval."""

    recording: str
    effect: str
    named: str
    within: bool | None
    planted: dict[str, Any]
    beyond: dict[str, Any]
    sigma: dict[str, Any]
    also_new: list[str]


def answers_of(piece: Piece, recorded: Recorded, told: Callable[[Answer], None]) -> None:
    """Diagnose a piece as it is and with each effect."""
    name = Path(piece.path).stem[:28]
    try:
        own = diagnose(recorded)
    except ValueError as error:
        told(Answer(name, "as it is", f"refused: {error}", None, {}, {}, {}, []))
        return
    for one in own.findings:
        value, sigma = _numbers(one, "value"), _numbers(one, "std")
        told(Answer(name, f"as it is: {one.effect}", "", None, {}, value, sigma, []))
    for identifier, values in piece.effects:
        effect = effect_of(identifier)
        felt = planted(recorded, effect, effect.checked(values))
        told(judged(name, identifier, values, own, diagnose(felt)))


def judged(
    name: str, identifier: str, values: dict[str, Any], own: Diagnosis, felt: Diagnosis
) -> Answer:
    """Compare what was found with what was planted."""
    had = {one.effect: one for one in own.findings}
    found = next((one for one in felt.findings if one.effect == identifier), None)
    of_class = next((one for one in felt.findings if identifier in one.alike), None)
    taken = found or of_class
    also = [one.effect for one in felt.findings if one is not taken and one.effect not in had]
    also += [item.channel for item in felt.unexplained if item not in own.unexplained]
    if found is None:
        named = "no" if of_class is None else f"as {of_class.effect}"
        return Answer(name, identifier, named, None, values, {}, {}, also)
    value, sigma = _numbers(found, "value"), _numbers(found, "std")
    before = had.get(identifier)
    if before is not None:
        value = {k: v - _numbers(before, "value")[k] for k, v in value.items()}
        sigma = {k: np.hypot(s, _numbers(before, "std")[k]) for k, s in sigma.items()}
    within = all(
        (np.abs(value[k] - np.asarray(v)) <= 1.96 * sigma[k] + 1e-12).all()
        for k, v in values.items()
    )
    return Answer(name, identifier, "yes", within, values, value, sigma, also)


def _numbers(finding: Finding, kind: str) -> dict[str, Any]:
    return {k: np.asarray(getattr(v, kind), float) for k, v in finding.parameters.items()}


def row(one: Answer) -> tuple[str, ...]:
    """Return the cells of an answer."""
    within = "" if one.within is None else "yes" if one.within else "NO"
    shown = (_shown(one.planted), _shown(one.beyond), _shown(one.sigma))
    return one.recording, one.effect, one.named, within, *shown, ", ".join(one.also_new)


def _shown(values: dict[str, Any]) -> str:
    with np.printoptions(precision=3, suppress=False):
        return "; ".join(
            str(np.asarray(v, float)).replace("\n", "") for k, v in values.items() if "ref" not in k
        )


def main() -> None:
    """Print the answers as they come, then the table and its sums."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=SHARED_DATA)
    parser.add_argument("--only", default="", metavar="WORD")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    folder = require_data(arguments.data, "the folders broad, flights and sitl")
    answers: list[Answer] = []
    console = Console(width=190)

    def told(one: Answer) -> None:
        answers.append(one)
        console.print(" | ".join(row(one)), highlight=False, markup=False)

    for piece in PIECES:
        if arguments.only in piece.path:
            recorded = part(piece.read(folder / piece.path), *piece.share)
            answers_of(piece, recorded, told)
    table = Table(title="effects planted into real recordings", title_justify="left")
    columns = ("recording", "effect", "named", "within", "planted", "beyond", "sigma", "also new")
    for column in columns:
        table.add_column(column, overflow="fold")
    for one in answers:
        table.add_row(*row(one))
    console.print(table)
    cases = [one for one in answers if one.planted]
    named = [one for one in cases if one.named == "yes"]
    misnamed = [one for one in cases if any("_" in new for new in one.also_new)]
    unknown = [one for one in cases if any("_" not in new for new in one.also_new)]
    console.print(
        f"{len(cases)} planted: {len(named)} named, {sum(bool(one.within) for one in named)} of "
        f"these within their intervals; {len(misnamed)} with a new name of the catalogue, "
        f"{len(unknown)} with a new unexplained dependence"
    )
    if arguments.json is not None:
        content = [asdict(one) for one in answers]
        arguments.json.write_text(json.dumps(content, indent=1, default=np.ndarray.tolist))


if __name__ == "__main__":
    main()
