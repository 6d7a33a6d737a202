"""What every procedure ends with: tables, the verdict in words, the unit's file, JSON."""

import argparse
import dataclasses
import datetime
import json
import math
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from ahrs_service.app import options
from ahrs_service.app.calibrate.capture import Capture
from ahrs_service.app.files import calibration_file
from ahrs_service.calibration.triad import NAMES, TriadFit, vector
from ahrs_service.calibration.verdict import Level, TriadVerdict, Verdict
from ahrs_service.errors import ConfigError
from ahrs_service.records import IMU_OF_SOURCE, ImuSource
from ahrs_service.sensor import provenance
from ahrs_service.sensor.parameters import Calibration, TriadCalibration
from ahrs_service.sensor.provenance import Provenance, SourceRecording, Uncertainty

EXIT_DONE: Final = 0
EXIT_REFUSED: Final = 1

_COLOURS: Final = {Level.NOTE: "dim", Level.WARNING: "yellow", Level.REFUSAL: "bold red"}
_ROOM_K: Final = 2.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add where the calibration goes."""
    parser.add_argument(
        "--out",
        type=options.new_file,
        metavar="FILE",
        help="the unit's calibration (.toml); what this procedure finds replaces that part of an "
        "existing file",
    )
    parser.add_argument("--serial", default="", metavar="TEXT", help="serial number of the unit")
    parser.add_argument("--json", action="store_true", help="end with one line of JSON on stdout")


def finish(
    verdict: Verdict,
    fits: dict[str, TriadFit],
    captures: list[Capture],
    arguments: argparse.Namespace,
    degc: float = math.nan,
) -> int:
    """Show and write a calibration; return the exit code. A refused one is not written.

    `fits` by triad ("gyro", "accel"), `degc` the temperature that they hold at.
    """
    console = Console(stderr=bool(arguments.json))
    console.print(report(verdict, fits, captures))
    written = None
    if arguments.out is not None and not verdict.is_refused:
        calibration = updated(arguments, verdict, fits, captures, degc)
        calibration_file.save(arguments.out, calibration)
        written = str(arguments.out)
        console.print(f"wrote {escape(written)}", highlight=False, soft_wrap=True)
    elif arguments.out is not None:
        console.print(
            f"{escape(str(arguments.out))} was not written", style="bold red", soft_wrap=True
        )
    if arguments.json:
        print(json.dumps(_plain(verdict, fits, captures, written)))
    return EXIT_REFUSED if verdict.is_refused else EXIT_DONE


def updated(
    arguments: argparse.Namespace,
    verdict: Verdict,
    fits: dict[str, TriadFit],
    captures: list[Capture],
    degc: float,
) -> Calibration:
    """Return the calibration of `--out`, or an ideal one, with the triads of `fits` in it."""
    path: Path = arguments.out
    before = unit_of(arguments, captures)
    triads = {
        name: _triad(path, before, getattr(before, name), fit, degc) for name, fit in fits.items()
    }
    origin = before.provenance
    recordings = {recording.sha256: recording for recording in origin.recordings}
    for capture in captures:
        recordings[capture.sha256] = SourceRecording(
            capture.path.name, capture.sha256, verdict.procedure
        )
    return dataclasses.replace(
        before,
        gyro=triads.get("gyro", before.gyro),
        accel=triads.get("accel", before.accel),
        verdict=as_stored(verdict, before.verdict),
        provenance=Provenance(
            date=datetime.date.today().isoformat(),
            procedures=tuple(dict.fromkeys((*origin.procedures, verdict.procedure))),
            recordings=tuple(recordings.values()),
        ),
    )


def unit_of(arguments: argparse.Namespace, captures: list[Capture]) -> Calibration:
    """Return the calibration in the file `--out`, else an ideal calibration, of the captures' unit.

    Serial, board and IMU: as given, else of the file, else of the recordings. ConfigError where
    they are of different units, for the figures of one harm another.
    """
    path: Path | None = arguments.out
    exists = path is not None and path.exists()
    before = calibration_file.load(path) if path is not None and exists else Calibration.ideal()
    serials = {before.serial, arguments.serial} - {""}
    uids = {before.uid, *(one.unit for one in captures)} - {""}
    imus = {IMU_OF_SOURCE.get(ImuSource[one.source], 0) for one in captures}
    imus |= set() if before.imu is None else {before.imu}
    for what, found in (("units", serials), ("boards", uids), ("IMUs", imus)):
        if len(found) > 1:
            names = " and ".join(sorted(str(one) for one in found))
            raise ConfigError(
                f"{path or 'the recordings'}: of different {what}, {names}; calibrate one at a "
                "time, each with an --out of its own"
            )
    return dataclasses.replace(
        before,
        serial=max(serials, default=""),
        uid=max(uids, default=""),
        imu=max(imus, default=None),
    )


def _triad(
    path: Path, before: Calibration, triad: TriadCalibration, fit: TriadFit, degc: float
) -> TriadCalibration:
    """Return the triad with the matrix and bias found; its curves stay where they are zero."""
    if triad.span_degc is not None and not abs(degc - before.room_degc) <= _ROOM_K:
        raise ConfigError(
            f"{path}: holds a thermal calibration about {before.room_degc:g} degC, and this was "
            f"recorded at {degc:.0f} degC; record at room temperature, or give another --out"
        )
    x, y, z = fit.matrix
    used = np.flatnonzero(np.diag(fit.covariance) > 0.0)
    names = [NAMES[k].replace("matrix ", "matrix.").replace("bias ", "bias.") for k in used]
    covariance = fit.covariance[np.ix_(used, used)]
    known = bool(np.isfinite(covariance).all())
    return dataclasses.replace(
        triad,
        matrix=(vector(x), vector(y), vector(z)),
        bias=vector(fit.bias),
        uncertainty=dataclasses.replace(
            triad.uncertainty,
            parameters=tuple(names) if known else (),
            covariance=tuple(tuple(row) for row in covariance.tolist()) if known else (),
        )
        if triad.span_degc is None
        else Uncertainty(),
    )


def as_stored(verdict: Verdict, before: provenance.Verdict) -> provenance.Verdict:
    """Return the verdict as the unit's file holds it, after what the file says of other triads."""
    mine = tuple(f"{triad.triad}_" for triad in verdict.triads)
    sentences = [f"{verdict.procedure}: {verdict.words}"]
    sentences += [
        f"{verdict.procedure}: {finding.text}"
        for finding in verdict.findings
        if finding.level is Level.NOTE
    ]
    figures = {name: value for name, value in before.figures.items() if not name.startswith(mine)}
    for triad in verdict.triads:
        figures |= _figures(triad)
    kept = [text for text in before.sentences if not text.startswith(f"{verdict.procedure}: ")]
    return provenance.Verdict(
        usable=before.usable and not verdict.is_refused,
        sentences=(*kept, *sentences),
        figures=figures,
    )


def _figures(triad: TriadVerdict) -> dict[str, float]:
    """Return the figures of one triad by name, finite ones only."""
    unit = triad.unit.replace("/", "_").replace("^", "")
    figures: dict[str, float | None] = {"count": float(triad.count)}
    for axis, before, after in zip("xyz", triad.rms_before, triad.rms_after, strict=True):
        figures[f"before_{axis}_{unit}"], figures[f"after_{axis}_{unit}"] = before, after
    figures |= {
        f"held_out_before_{unit}": triad.held_out_before,
        f"held_out_after_{unit}": triad.held_out_after,
        "coverage": triad.coverage,
        "condition": triad.condition,
    }
    if triad.span_degc is not None:
        figures["low_degc"], figures["high_degc"] = triad.span_degc
    return {
        f"{triad.triad}_{name}": value
        for name, value in figures.items()
        if value is not None and math.isfinite(value)
    }


def report(verdict: Verdict, fits: dict[str, TriadFit], captures: list[Capture]) -> RenderableType:
    """Return what was used, what was found with 1-sigma, the residuals, and the verdict."""
    parts: list[RenderableType] = []
    for capture in captures:
        c = capture.columns
        text = f"{capture.path.name}: {capture.source}, {len(c.time_s)} samples"
        parts.append(Text(f"{text}, {c.time_s[-1]:.0f} s, {capture.rate_hz:.1f} Hz", style="dim"))
        parts += [Text(f"note: {note}", style="dim") for note in capture.notes]
    parts += [_parameters(name, fit) for name, fit in fits.items()]
    parts.append(_residuals(verdict))
    for finding in verdict.findings:
        parts.append(Text(f"{finding.level.value}: {finding.text}", style=_COLOURS[finding.level]))
    colour = "bold red" if verdict.is_refused else "bold green"
    parts.append(Text(f"verdict: {verdict.words}", style=colour))
    return Group(*parts)


def _parameters(name: str, fit: TriadFit) -> Table:
    """Return K and B with the 1-sigma of the last digits behind them: 1.00135(16)."""
    title = f"{name}: output = matrix · input + bias (1-sigma of the last digits)"
    table = Table(title=title, title_justify="left")
    unit = "rad/s" if name == "gyro" else "m/s^2"
    for head in ("", "x", "y", "z", escape(f"bias [{unit}]")):
        table.add_column(head, justify="right", no_wrap=True)
    errors = np.sqrt(np.diag(fit.covariance))
    for row in range(3):
        values = [*fit.matrix[row], fit.bias[row]]
        sigmas = [*errors[3 * row : 3 * row + 3], errors[9 + row]]
        table.add_row("xyz"[row], *map(_with_sigma, values, sigmas))
    return table


def _with_sigma(value: float, sigma: float) -> str:
    return f"{value:+.5f}({sigma * 1e5:.0f})"


def _residuals(verdict: Verdict) -> Table:
    table = Table(title=f"{verdict.procedure}: RMS residual", title_justify="left")
    for title in ("", "x", "y", "z", "held out", "unit"):
        table.add_column(title, justify="left" if title in ("", "unit") else "right")
    for triad in verdict.triads:
        for when, axes, held_out in (
            ("before", triad.rms_before, triad.held_out_before),
            ("after", triad.rms_after, triad.held_out_after),
        ):
            cells = [*axes, math.nan if held_out is None else held_out]
            table.add_row(f"{triad.triad} {when}", *(f"{value:.5f}" for value in cells), triad.unit)
    return table


def _plain(
    verdict: Verdict, fits: dict[str, TriadFit], captures: list[Capture], written: str | None
) -> dict[str, Any]:
    """Return all that was found as JSON holds it; what is not finite is left out."""
    found = {
        name: {
            "matrix": fit.matrix.tolist(),
            "bias": fit.bias.tolist(),
            "standard_errors": {
                key: error for key, error in fit.standard_errors().items() if math.isfinite(error)
            },
        }
        for name, fit in fits.items()
    }
    return {
        "procedure": verdict.procedure,
        "words": verdict.words,
        "usable": not verdict.is_refused,
        "verdict": verdict.to_dict(),
        "found": found,
        "recordings": [{"name": c.path.name, "sha256": c.sha256} for c in captures],
        "wrote": written,
    }
