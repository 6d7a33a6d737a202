"""The gate's S(): how far its three quantities scatter in steady motion, and the noise behind them.

The recording is replayed, and the standard deviations are those of the very values that the gate
compared, over the parts of steady motion: five seconds or more in which roll, pitch and the rate of
turn hold to 6 degrees. Give a recording of steady flight, for noise and vibration of the motor are
what the thresholds must leave room for; or of a bench, for the sensor alone.

The result is the section [gate_budget] of a settings file.

Examples:
  ahrs-service calibrate noise flight.bin
  ahrs-service calibrate noise flight.tlog --from 120 --to 300 --json
  ahrs-service calibrate noise --link udpin:127.0.0.1:14550 --seconds 60

"""

import argparse
import dataclasses
import json
import math
from functools import partial
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from ahrs_service.app import intake_choice, options
from ahrs_service.app.calibrate import capture, session
from ahrs_service.app.calibrate.allan import longest_still
from ahrs_service.app.replay.replay_log import replay_recording
from ahrs_service.calibration.allan import overlapping_deviation, random_walk_at
from ahrs_service.calibration.columns import AXES, ImuColumns
from ahrs_service.calibration.guide import guide_recording
from ahrs_service.calibration.noise import GateNoise, gate_noise
from ahrs_service.errors import CalibrationError, ConfigError
from ahrs_service.links.logs.recording_formats import read_recording
from ahrs_service.records import Rows
from ahrs_service.settings import IntakeSettings, Settings

EXIT_DONE: Final = 0
_SECONDS: Final = 120.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `calibrate noise`."""
    capture.add_arguments(parser)
    session.add_arguments(parser)
    parser.add_argument(
        "--seconds",
        type=options.positive,
        default=_SECONDS,
        metavar="S",
        help=f"how long a session on a link records (default: {_SECONDS:g})",
    )
    parser.add_argument(
        "--from", dest="begin", type=float, metavar="S", help="steady from here on [s since start]"
    )
    parser.add_argument("--to", dest="end", type=float, metavar="S", help="steady up to here")
    options.add_settings(parser)
    parser.add_argument("--json", action="store_true", help="end with one line of JSON on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Show S() of recordings or of a session; return the exit code."""
    return session.run(arguments, partial(guide_recording, seconds=arguments.seconds), show)


def show(captures: list[capture.Capture], arguments: argparse.Namespace) -> int:
    """Show S() of each recording."""
    if len(captures) > 1 and (arguments.begin or arguments.end):
        raise ConfigError("--from and --to are of one recording: give one")
    settings = options.settings_of(arguments) if options.has_settings(arguments) else None
    asked = intake_choice.asked_intake(arguments)
    console = Console(stderr=bool(arguments.json))
    plain = []
    for one in captures:
        estimates = _replayed(one, settings, asked)
        found = gate_noise(estimates, _chosen(estimates, arguments))
        densities = noise_densities(one.columns)
        console.print(Text(f"{one.path.name}: {found.steady_s:.0f} s of steady motion"))
        console.print(_budget(found), highlight=False, markup=False)
        if densities is not None:
            console.print(_table(densities))
        plain.append(_plain(one, found, densities))
    if arguments.json:
        print(json.dumps(plain))
    return EXIT_DONE


def _replayed(
    one: capture.Capture, settings: Settings | None, asked: IntakeSettings | None
) -> Rows:
    """Return the estimates of a recording, of the vehicle and IMU asked for."""
    recording = one.recording or read_recording(one.path)
    if asked is not None:
        advice = "give --set or --config"
        below = settings or intake_choice.recorded_settings(recording, advice) or Settings()
        settings = dataclasses.replace(below, intake=asked)
    return replay_recording(recording, settings).estimates


def _chosen(estimates: Rows, arguments: argparse.Namespace) -> Any:
    """Return which estimates the arguments name, None where they leave it open."""
    if arguments.begin is None and arguments.end is None:
        return None
    time_s = (estimates["time_ns"] - estimates["time_ns"][0]) * 1e-9
    end = math.inf if arguments.end is None else arguments.end
    return (time_s >= (arguments.begin or 0.0)) & (time_s < end)


def noise_densities(columns: ImuColumns) -> dict[str, list[float]] | None:
    """Return the noise density per axis [unit/sqrt(Hz)] at rest, None where it never rests.

    Of gyro and accel, read at one second of the Allan deviation (IEEE Std 952).
    """
    try:
        still = longest_still(columns)
        return {
            triad: [
                random_walk_at(overlapping_deviation(values[:, axis], still.interval_s))
                for axis in range(3)
            ]
            for triad, values in (("gyro", still.gyro_rad_s), ("accel", still.accel_m_s2))
        }
    except CalibrationError:
        return None


def _budget(found: GateNoise) -> str:
    return (
        "[gate_budget]\n"
        f"norm_sigma_m_s2 = {found.norm_sigma_m_s2:.4g}\n"
        f"rate_sigma_rad_s = {found.rate_sigma_rad_s:.4g}\n"
        f"angular_acceleration_sigma_rad_s2 = {found.angular_acceleration_sigma_rad_s2:.4g}"
    )


def _table(densities: dict[str, list[float]]) -> Table:
    table = Table(title="noise density at rest, read at 1 s", title_justify="left")
    for head in ("", *AXES, "unit"):
        table.add_column(head, justify="right" if head in AXES else "left")
    for triad, unit in (("gyro", "rad/s/√Hz"), ("accel", "m/s²/√Hz")):
        table.add_row(triad, *(f"{value:.2e}" for value in densities[triad]), unit)
    return table


def _plain(
    one: capture.Capture, found: GateNoise, densities: dict[str, list[float]] | None
) -> dict[str, Any]:
    sigmas = {
        name: getattr(found, name)
        for name in (
            "norm_sigma_m_s2",
            "rate_sigma_rad_s",
            "angular_acceleration_sigma_rad_s2",
        )
    }
    values = {} if densities is None else {"density": densities}
    plain = {"recording": one.path.name, "steady_s": found.steady_s, "gate_budget": sigmas}
    return {**plain, **values} if np.isfinite(list(sigmas.values())).all() else plain
