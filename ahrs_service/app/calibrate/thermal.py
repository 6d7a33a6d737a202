"""Drift over temperature: from recordings in which the unit lies still and warms or cools.

Cool the unit (a freezer, in a bag against frost), switch it on, put it down and record until it is
as warm as it gets; or let a chamber heat and cool it. Any number of power-ons, in one recording or
several, in one pose or, for scale and axes too, in poses all around: come back to each, as exactly
as a fixture does, before the temperature has moved by some 5 degC. 10 degC of span are the least
that is accepted, and the drift is known for what was recorded only.

Both heating and cooling show the lag between thermometer and sensing elements and the hysteresis.
How flexible the curves are is decided by time held out from the fit; a calibration that makes such
time worse is refused.

Examples:
  ahrs-service calibrate thermal warmup.tlog --out configs/calibrations/A0042.toml
  ahrs-service calibrate thermal cold1.bin cold2.bin --json
  ahrs-service calibrate thermal --link udpin:127.0.0.1:14550 --span 30 --out A0042.toml

With --link the terminal shows the temperature reached so far, and ends by itself. All that is
received is kept in a .tlog, and what is found is what the same command finds in it.

"""

import argparse
import dataclasses
import datetime
import json
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ahrs_service.app import intake_choice
from ahrs_service.app.calibrate import capture, outcome, poses, session
from ahrs_service.app.files import calibration_file
from ahrs_service.app.options import positive
from ahrs_service.calibration.thermal.procedure import PROCEDURE, ThermalResult, calibrate_thermal
from ahrs_service.calibration.thermal.soak_guide import guide_thermal
from ahrs_service.calibration.verdict import TriadVerdict
from ahrs_service.links.logs.recording_formats import read_recording
from ahrs_service.records import Kind
from ahrs_service.sensor.parameters import Calibration
from ahrs_service.sensor.provenance import Provenance, SourceRecording
from ahrs_service.settings import IntakeSettings

LEAST_HZ: Final = 0.5
"""Slower samples have no window of eight between a bump and the next."""
LINK_HZ: Final = 20.0
"""What is asked for on a link: the means of a second are what is fitted."""
WANTED_K: Final = 20.0
_BACK_NS: Final = 1_000_000_000
_SHOWN: Final = {"gyro": (1e3, "mrad/s"), "accel": (1e3 / 9.80665, "mg")}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `calibrate thermal`."""
    capture.add_arguments(parser)
    session.add_arguments(parser)
    parser.set_defaults(rate=LINK_HZ)
    parser.add_argument(
        "--span",
        type=positive,
        default=WANTED_K,
        metavar="DEGC",
        help=f"span of temperature that ends a session on a link (default: {WANTED_K:g})",
    )
    outcome.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Calibrate from recordings or a session on a link; return the exit code."""
    if arguments.link or not arguments.recordings:
        guide = partial(guide_thermal, wanted_degc=arguments.span)
        return session.run(arguments, guide, calibrate)
    asked = intake_choice.asked_intake(arguments)
    captures = [one for path in arguments.recordings for one in power_ons(path, asked)]
    return calibrate(captures, arguments)


def calibrate(captures: list[capture.Capture], arguments: argparse.Namespace) -> int:
    """Fit, judge, show and write; return the exit code."""
    console = Console(stderr=bool(arguments.json))
    for one in captures:
        capture.check_rate(one, LEAST_HZ, "telling rest from motion")
    room = outcome.unit_of(arguments, captures)
    result = calibrate_thermal(
        [one.columns for one in captures], room, poses.on_autopilot(captures)
    )
    console.print(outcome.report(result.verdict, {}, captures))
    for triad in result.verdict.triads:
        console.print(_by_temperature(triad))
    written = None
    if arguments.out is not None and not result.verdict.is_refused:
        calibration_file.save(arguments.out, _with_origin(result, room, captures))
        written = str(arguments.out)
        console.print(f"wrote {escape(written)}", highlight=False, soft_wrap=True)
    elif arguments.out is not None:
        console.print(f"{escape(str(arguments.out))} was not written", style="bold red")
    if arguments.json:
        print(json.dumps(_plain(result, captures, written)))
    return outcome.EXIT_REFUSED if result.verdict.is_refused else outcome.EXIT_DONE


def power_ons(path: Path, asked: IntakeSettings | None = None) -> list[capture.Capture]:
    """Return the captures of a recording, one for each power-on: there its clock jumps back."""
    recording = read_recording(path)
    readings = recording.readings
    back = np.diff(readings["received_ns"]) < -_BACK_NS
    if not back.any():
        return [capture.capture_of(recording, readings, asked)]
    parts = np.split(readings, np.flatnonzero(back) + 1)
    held = [part for part in parts if np.count_nonzero(part["kind"] == Kind.IMU) > 1]
    return [capture.capture_of(recording, part, asked) for part in held]


def _with_origin(
    result: ThermalResult,
    room: Calibration,
    captures: list[capture.Capture],
) -> Calibration:
    """Return the calibration with verdict and where it comes from."""
    origin = room.provenance
    recordings = {recording.sha256: recording for recording in origin.recordings}
    for one in captures:
        recordings[one.sha256] = SourceRecording(one.path.name, one.sha256, PROCEDURE)
    return dataclasses.replace(
        result.calibration,
        verdict=outcome.as_stored(result.verdict, room.verdict),
        provenance=Provenance(
            date=datetime.date.today().isoformat(),
            procedures=tuple(dict.fromkeys((*origin.procedures, PROCEDURE))),
            recordings=tuple(recordings.values()),
        ),
    )


def _by_temperature(triad: TriadVerdict) -> Table:
    scale, unit = _SHOWN[triad.triad]
    table = Table(
        title=escape(f"{triad.triad}: RMS residual by temperature [{unit}]"), title_justify="left"
    )
    for head in ("degC", "means", "x", "y", "z"):
        table.add_column(head, justify="right")
    for one in triad.by_temperature:
        cells = [f"{scale * value:.2f}" for value in one.rms]
        table.add_row(f"{one.low_degc:.0f} to {one.high_degc:.0f}", str(one.count), *cells)
    return table


def _plain(
    result: ThermalResult, captures: list[capture.Capture], written: str | None
) -> dict[str, Any]:
    """Return all that was found as JSON holds it."""
    found = {}
    for name, triad in (("gyro", result.gyro), ("accel", result.accel)):
        lag = triad.fit.lag
        found[name] = {
            "curves": [structure.text for structure in triad.fit.structures],
            "thermal_lag_s": lag.lag_s,
            "thermal_lag_interval_s": [lag.low_s, lag.high_s],
            "lag_is_told": lag.is_reported,
        }
    return {
        "procedure": PROCEDURE,
        "words": result.verdict.words,
        "usable": not result.verdict.is_refused,
        "verdict": result.verdict.to_dict(),
        "found": found,
        "recordings": [{"name": one.path.name, "sha256": one.sha256} for one in captures],
        "wrote": written,
    }
