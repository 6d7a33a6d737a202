"""Compare a recording with its twin: where they differ, what physics is missing, how sure.

The twin is a model of the sensor; without one an ideal sensor is assumed. Each finding is described
in plain words and checked on parts of the recording that it was not fitted to. Findings can be
written into the twin, for simulation (simulate --twin), and, where a calibration has a parameter
for them, into a calibration, which the estimator applies live (run --calibration).

Examples:
  ahrs-service diagnose flight.tlog --html report.html --write-twin twin.toml
  ahrs-service diagnose flight.bin --twin twin.toml --json report.json --rrd report.rrd
  ahrs-service diagnose flight.tlog --against simulated.tlog

"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.markup import escape

from ahrs_service.app import intake_choice
from ahrs_service.app.diagnose import diagnosis_text as text
from ahrs_service.app.diagnose.diagnosis_page import most_significant, page
from ahrs_service.app.diagnose.diagnosis_terminal import summary
from ahrs_service.app.diagnose.recording_diagnosis import diagnose
from ahrs_service.app.files import calibration_file, toml_file, twin_file
from ahrs_service.app.options import new_file
from ahrs_service.app.replay.command import progress_bar
from ahrs_service.calibration.folding import fold
from ahrs_service.diagnosis.result import Diagnosis, ResidualSeries, as_json
from ahrs_service.effects.base import Effect, Values
from ahrs_service.effects.catalogue import effect_of
from ahrs_service.errors import RecordingError
from ahrs_service.links.logs.recording_formats import KNOWN
from ahrs_service.records import Floats
from ahrs_service.settings import IntakeSettings
from ahrs_service.simulation.imu import Imu

EXIT_DONE: Final = 0
_PANELS_SHOWN: Final = 6
"""Panels of residual against covariate in one picture of the viewer: as many as can be read."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ahrs-service diagnose`."""
    parser.add_argument("recording", type=Path, metavar="RECORDING", help=KNOWN)
    parser.add_argument(
        "--twin", type=Path, metavar="TWIN.toml", help="model of the sensor (default: ideal)"
    )
    parser.add_argument(
        "--against",
        type=Path,
        metavar="SIM.tlog",
        help="also diagnose this recording (its first vehicle) and list what the first recording "
        "has that this one lacks",
    )
    parser.add_argument(
        "--truth",
        type=Path,
        metavar="TRUTH.json",
        help="the effects known to be in the recording (as prove writes them), shown next to what "
        "is found",
    )
    intake_choice.add_arguments(parser)
    parser.add_argument("--json", type=new_file, metavar="OUT", help="write the report as JSON")
    parser.add_argument("--html", type=new_file, metavar="OUT", help="write a page with plots")
    parser.add_argument("--rrd", type=new_file, metavar="OUT", help="write a Rerun recording")
    parser.add_argument(
        "--write-twin", type=new_file, metavar="OUT.toml", help="write the twin with the findings"
    )
    parser.add_argument(
        "--write-calibration",
        type=new_file,
        metavar="OUT.toml",
        help="write a calibration that compensates the findings, as far as it can",
    )


def run(args: argparse.Namespace) -> int:
    """Diagnose; return the exit code."""
    console, errors = Console(), Console(stderr=True, soft_wrap=True, highlight=False)
    twin = Imu() if args.twin is None else twin_file.read(args.twin)
    asked = intake_choice.asked_intake(args)
    diagnosis = diagnose_file(args.recording, twin, errors, args.truth, asked)
    console.print(summary(args.recording.name, diagnosis))
    against: tuple[str, Diagnosis] | None = None
    if args.against is not None:
        against = args.against.name, diagnose_file(args.against, twin, errors)
        console.print(summary(*against))
        _print_lacking(console, diagnosis, *against)
    if args.json is not None:
        _write_json(args.json, diagnosis, against)
    if args.html is not None:
        content = page(args.recording.name, diagnosis, against)
        toml_file.write_whole(args.html, content.encode())
    if args.rrd is not None:
        _write_rrd(args.rrd, args.recording.name, diagnosis)
    if args.write_twin is not None:
        source = f"diagnose {args.recording.name}"
        twin_file.write(args.write_twin, extended(twin, diagnosis), source, sigmas_of(diagnosis))
    if args.write_calibration is not None:
        _write_calibration(args.write_calibration, twin, diagnosis, console)
    for name in ("json", "html", "rrd", "write_twin", "write_calibration"):
        if (path := getattr(args, name)) is not None:
            console.print(f"wrote {escape(str(path))}", highlight=False, soft_wrap=True)
    return EXIT_DONE


def diagnose_file(
    path: Path,
    twin: Imu,
    errors: Console,
    truth_path: Path | None = None,
    asked: IntakeSettings | None = None,
) -> Diagnosis:
    """Read and diagnose a recording, with a progress bar; RecordingError says why it cannot."""
    with progress_bar(errors, path.name) as advance:
        return diagnose(path, twin, truth_path, advance, asked)


def found_effects(diagnosis: Diagnosis) -> list[tuple[Effect, Values]]:
    """Return the findings as effects with their parameters."""
    return [
        (
            effect_of(finding.effect),
            effect_of(finding.effect).checked(
                {name: estimate.value for name, estimate in finding.parameters.items()}
            ),
        )
        for finding in diagnosis.findings
    ]


def extended(twin: Imu, diagnosis: Diagnosis) -> Imu:
    """Return the twin with the findings added; an effect already in it becomes the sum."""
    return twin_file.with_effects(twin, found_effects(diagnosis))


def sigmas_of(diagnosis: Diagnosis) -> dict[str, dict[str, Any]]:
    """Return the 1-sigma of every fitted parameter by effect id and name."""
    return {
        finding.effect: {
            name: np.asarray(estimate.std, np.float64).tolist()
            for name, estimate in finding.parameters.items()
        }
        for finding in diagnosis.findings
    }


def _print_lacking(console: Console, real: Diagnosis, name: str, simulated: Diagnosis) -> None:
    findings, unexplained = text.lacking(real, simulated)
    console.print(f"What {escape(name)} lacks:", style="bold")
    for finding in findings:
        console.print(f"  {escape(text.title(finding.effect))} ({finding.effect})", highlight=False)
    for item in unexplained:
        console.print(f"  {escape(text.unexplained_text(item))}", highlight=False)
    if not findings and not unexplained:
        console.print("  nothing: everything found in the real recording is in this one too")


def _write_json(path: Path, diagnosis: Diagnosis, against: tuple[str, Diagnosis] | None) -> None:
    report = as_json(diagnosis)
    if against is not None:
        findings, unexplained = text.lacking(diagnosis, against[1])
        report["against"] = {
            "recording": against[0],
            "report": as_json(against[1]),
            "lacks": [finding.effect for finding in findings],
            "lacks_unexplained": [item.channel for item in unexplained],
        }
    toml_file.write_whole(path, (json.dumps(report, indent=1) + "\n").encode())


def _write_rrd(path: Path, name: str, diagnosis: Diagnosis) -> None:
    # Loading rerun and matplotlib takes longer than reading most logs.
    from ahrs_service.viz import report_plots as plots  # noqa: PLC0415
    from ahrs_service.viz.report_rrd import write_report  # noqa: PLC0415

    shown_covariates = most_significant(diagnosis.covariates)
    pictures = {}
    for first in range(0, len(shown_covariates), _PANELS_SHOWN):
        shown = shown_covariates[first : first + _PANELS_SHOWN]
        about = " and ".join(dict.fromkeys(item.covariate for item in shown[:2]))
        title = f"Residual against {about}, ..."
        pictures[title] = plots.as_png(plots.against_covariates(shown))
    where = {
        finding.effect: [(one.t0_s, one.t1_s, one.regime) for one in finding.where]
        for finding in diagnosis.findings
    }
    where |= {
        f"unexplained {item.channel}": [(one.t0_s, one.t1_s, one.regime) for one in item.where]
        for item in diagnosis.unexplained
    }
    lines = [f"# {name}", text.VERDICTS[diagnosis.verdict]]
    for finding in diagnosis.findings:
        lines += [f"## {text.title(finding.effect)}", text.paragraph(finding, has_numbers=False)]
        lines.append(_markdown(("fitted", "x", "y", "z"), text.parameter_rows(finding)))
    lines += [text.unexplained_text(item) for item in diagnosis.unexplained]
    lines += [text.implausible_text(item) for item in diagnosis.implausible]
    series = diagnosis.series
    empty = np.zeros((0, 6))
    time_s, before, after = (np.zeros(0), empty, empty) if series is None else _without_bias(series)
    try:
        write_report(path, time_s, before, after, where, "\n\n".join(lines), pictures)
    except OSError as error:
        raise RecordingError(
            f"{path}: {error.strerror}; give a file in a folder that can be written"
        ) from None


def _markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def _without_bias(series: ResidualSeries) -> tuple[Floats, Floats, Floats]:
    """Return time, before and after, less the remaining constant bias, which is no finding."""
    bias = series.after.mean(axis=0)
    return series.time_s, series.before - bias, series.after - bias


def _write_calibration(path: Path, twin: Imu, diagnosis: Diagnosis, console: Console) -> None:
    # The effects of the twin are in the readings as well: both are compensated.
    folded = fold(twin.calibration, extended(twin, diagnosis).effects)
    calibration_file.save(path, folded.calibration)
    for identifier, why in folded.left:
        console.print(f"not in the calibration: {identifier}: {why}", highlight=False)
