"""Rate table: the gyros by known rates, one recording for each way that the unit is mounted.

Each --run names the axis of the unit that the table's axis goes through, by the right hand (x, x-
for the other way, y, ... or three numbers as 1,1,0), and the recording. The rates are either steps
that the table kept for three seconds or more each, with rests between (--rates), or those of an
encoder: a .csv with the columns time_s and rate_deg_s or angle_deg, where 0 s is the start of the
recording but for a lag of up to half a second, which is found.

Examples:
  ahrs-service calibrate rate-table --rates=-200,-100,100,200 --run x roll.tlog \\
      --run y pitch.tlog --run z yaw.tlog --out A0042.toml
  ahrs-service calibrate rate-table --run x roll.tlog roll.csv --run y pitch.tlog pitch.csv \\
      --run z yaw.tlog yaw.csv

"""

import argparse
import csv
from pathlib import Path
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from ahrs_service.app import intake_choice
from ahrs_service.app.calibrate import capture, outcome, poses
from ahrs_service.calibration.columns import check_saturation
from ahrs_service.calibration.rate_table import (
    Mounting,
    fit_encoder,
    fit_plateaus,
    judge_encoder,
    judge_plateaus,
    plateaus,
)
from ahrs_service.calibration.verdict import Finding, Level, Vector, judge
from ahrs_service.errors import ConfigError
from ahrs_service.records import Floats

_AXES: Final = {
    f"{name}{sign}": (value * (name == "x"), value * (name == "y"), value * (name == "z"))
    for name in "xyz"
    for sign, value in (("", 1.0), ("+", 1.0), ("-", -1.0))
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `calibrate rate-table`."""
    parser.add_argument(
        "--run",
        dest="runs",
        nargs="+",
        action="append",
        required=True,
        metavar="AXIS RECORDING [ENCODER.csv]",
        help="one mounting; give three or more",
    )
    parser.add_argument(
        "--rates", metavar="DEG_S,...", help="rates that the table was set to, as -100,100,200"
    )
    intake_choice.add_arguments(parser)
    outcome.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Calibrate from the recordings of all mountings; return the exit code."""
    asked = intake_choice.asked_intake(arguments)
    axes, captures, encoders = [], [], []
    for parts in arguments.runs:
        if len(parts) != (2 if arguments.rates else 3):
            raise ConfigError(
                f"--run {' '.join(parts)}: give AXIS RECORDING with --rates, or "
                "AXIS RECORDING ENCODER.csv without"
            )
        axes.append(_axis(parts[0]))
        captures.append(capture.read_capture(Path(parts[1]), asked))
        capture.check_rate(captures[-1], poses.LEAST_ROTATION_HZ, "following the table")
        check_saturation(captures[-1].columns)
        encoders += parts[2:]
    if arguments.rates:
        return _from_rates(axes, captures, arguments)
    mountings = tuple(
        Mounting(axis, one.columns, *read_encoder(Path(path)))
        for axis, one, path in zip(axes, captures, encoders, strict=True)
    )
    fit, lags_s = fit_encoder(mountings)
    listed = ", ".join(f"{1e3 * lag_s:+.1f} ms" for lag_s in lags_s)
    remark = Finding(Level.NOTE, f"the recordings are late against the encoder by {listed}")
    remarks = (*poses.on_autopilot(captures), remark)
    verdict = judge("rate-table", (judge_encoder(mountings, fit, lags_s),), remarks)
    return outcome.finish(verdict, {"gyro": fit}, captures, arguments, _degc(captures))


def _from_rates(
    axes: list[Vector], captures: list[capture.Capture], arguments: argparse.Namespace
) -> int:
    rates = _rates(arguments.rates)
    found = [plateaus(one.columns, axis, rates) for axis, one in zip(axes, captures, strict=True)]
    truth = np.concatenate([true for true, _ in found])
    measured = np.concatenate([seen for _, seen in found])
    fit = fit_plateaus(truth, measured)
    verdict = judge(
        "rate-table", (judge_plateaus(truth, measured, fit),), poses.on_autopilot(captures)
    )
    return outcome.finish(verdict, {"gyro": fit}, captures, arguments, _degc(captures))


def _degc(captures: list[capture.Capture]) -> float:
    degc = np.concatenate([one.columns.temperature_degc for one in captures])
    return float(np.nanmean(degc)) if np.isfinite(degc).any() else float("nan")


def _axis(text: str) -> Vector:
    """Return the axis that `text` names; ConfigError where it is none."""
    if text.lower() in _AXES:
        return _AXES[text.lower()]
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        x = y = z = 0.0
    if not 0.0 < x * x + y * y + z * z < np.inf:
        raise ConfigError(f"--run {text}: give the axis as x, y-, z or as three numbers 1,1,0")
    return x, y, z


def _rates(text: str) -> Floats:
    try:
        rates = np.radians([float(part) for part in text.split(",")])
    except ValueError:
        rates = np.zeros(0)
    if not len(rates) or not np.isfinite(rates).all():
        raise ConfigError(f"--rates {text}: give rates in deg/s as --rates=-200,-100,100,200")
    return rates


def read_encoder(path: Path) -> tuple[Floats, Floats]:
    """Return times [M] [s] and rates [M] [rad/s]; ConfigError names the file and what is wrong."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        names = rows[0].keys() if rows else ()
        column = next((name for name in ("rate_deg_s", "angle_deg") if name in names), None)
        if column is None or "time_s" not in names:
            raise ConfigError(
                f"{path}: has the columns {', '.join(names) or 'none'}; give time_s and rate_deg_s "
                "or angle_deg"
            )
        time_s = np.array([float(row["time_s"]) for row in rows])
        values = np.radians([float(row[column]) for row in rows])
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give a readable .csv") from None
    except (ValueError, TypeError) as error:
        raise ConfigError(f"{path}: {error}; give a number in every row") from None
    if len(time_s) < 4 or (np.diff(time_s) <= 0.0).any() or not np.isfinite(values).all():
        raise ConfigError(f"{path}: give four rows or more, finite, with rising time_s")
    if column == "angle_deg":
        values = CubicSpline(time_s, values)(time_s, 1)
    return time_s, values
