"""Attitude of plain arrays: sensor samples in an .npz in, quaternions in an .npz out.

IN holds imu_gyr [N, 3] rad/s, imu_acc [N, 3] m/s^2 (specific force), and sampling_rate [Hz] or
t [N] s, or both (then t holds). It may hold imu_mag [N, 3] uT, airspeed [N] m/s, vel_ned [N, 3]
m/s (or [N, 2], north and east) and imu_degc [N], the sensor's temperature in degC, NaN where there
is none; a speed may also be held until the next comes, or be 0 where there is none. Other fields
are not looked at. With --calibration the raw output of the sensor is compensated first, in axes
forward, right, down.

OUT holds one row per sample: quat [N, 4] wxyz without the magnetometer, its heading 0 at the
start; quat9 [N, 4] with it, where there is imu_mag; sigma_deg [N, 3] 1-sigma of quat's error
about the earth's axes; gate [N] why the accelerometer was not taken for the vertical, 0 if it was.
Without --profile it is the one that force and rate of the whole recording show (app.recognition).
With --offline all rows but gate are smoothed: what came later corrects what was before.

--frame frd: sensor axes forward, right, down (level at rest: z = -9.81); quat turns them into
north, east, down. --frame flu: forward, left, up (level at rest: z = +9.81); quat turns them into
axes with z up and x along the heading 0, quat9 into east, north (magnetic, or true by
fusion.declination_deg), up.
"""

import argparse
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.markup import escape

from ahrs_service import pipeline
from ahrs_service.app import options
from ahrs_service.app.estimate import recognition
from ahrs_service.app.estimate.sample_columns import Columns, doubts, read_columns
from ahrs_service.app.files import config_file
from ahrs_service.app.files.calibration_choice import CalibrationStore
from ahrs_service.links.errors import RecordingError
from ahrs_service.records import ESTIMATE_DTYPE, Floats, Rows, empty
from ahrs_service.rotation import multiply_columns
from ahrs_service.sensor.parameters import Calibration, coefficients
from ahrs_service.sensor.prior import narrow
from ahrs_service.settings import Settings
from ahrs_service.smoothing import Smoother

EXIT_DONE: Final = 0
_CHUNK: Final = 1 << 15
_FRD_FROM_FLU: Final = np.array([0.0, 1.0, 0.0, 0.0])
_ENU_FROM_NED: Final = np.array([0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0])


def estimate_columns(
    columns: Columns,
    settings: Settings,
    frame: str,
    offline: bool = False,
    calibration: Calibration | None = None,
) -> dict[str, Any]:
    """Run the estimator over `columns` [N], smoothed where `offline`; return the fields of OUT."""
    run = _run_smoothed if offline else _run
    known = calibration or Calibration.ideal()
    count = len(columns.time_ns)
    out: dict[str, Any] = {
        "quat": np.empty((count, 4)),
        "sigma_deg": np.empty((count, 3)),
        "gate": np.empty(count, np.uint32),
    }
    for part, rows in run(columns, settings, known, frame, magnetometer=False):
        out["quat"][part] = _turned(rows["ned_from_body"], frame, earth=_FRD_FROM_FLU)
        out["sigma_deg"][part] = np.degrees(rows["attitude_sigma_rad"])
        out["gate"][part] = rows["gate"]
    if columns.mag_ut is not None and settings.fusion.magnetometer:
        out["quat9"] = np.empty((count, 4))
        for part, rows in run(columns, settings, known, frame, magnetometer=True):
            out["quat9"][part] = _turned(rows["ned_from_body"], frame, earth=_ENU_FROM_NED)
    return out


def _run(
    columns: Columns, settings: Settings, known: Calibration, frame: str, magnetometer: bool
) -> Iterator[tuple[slice, Rows]]:
    """Run once over all samples; yield estimates piece by piece, in rows used again."""
    parameters, row = narrow(pipeline.parameters(settings), known), coefficients(known)
    state = pipeline.new_state()
    estimates = empty(ESTIMATE_DTYPE, _CHUNK)
    count = len(columns.time_ns)
    for start in range(0, count, _CHUNK):
        stop = min(start + _CHUNK, count)
        samples = columns.samples(start, stop, frame, magnetometer)
        rows = estimates[: stop - start]
        pipeline.batch(parameters, row, state, samples, rows)
        yield slice(start, stop), rows


def _run_smoothed(
    columns: Columns, settings: Settings, known: Calibration, frame: str, magnetometer: bool
) -> Iterator[tuple[slice, Rows]]:
    """Run once over all samples and back; yield all estimates in one piece."""
    count, smoother = len(columns.time_ns), Smoother()
    estimates = empty(ESTIMATE_DTYPE, count)
    parameters, row = narrow(pipeline.parameters(settings), known), coefficients(known)
    state = pipeline.new_state()
    for start in range(0, count, _CHUNK):
        stop = min(start + _CHUNK, count)
        samples = columns.samples(start, stop, frame, magnetometer)
        smoother.batch(parameters, row, state, samples, estimates[start:stop])
    smoother.smooth(estimates)
    yield slice(0, count), estimates


def _turned(ned_from_body: Floats, frame: str, earth: Floats) -> Floats:
    """Attitudes [N, 4] in the frame asked for, by the turn `earth` [4] from north-east-down."""
    if frame == "frd":
        return ned_from_body
    turned = multiply_columns(multiply_columns(earth, ned_from_body), _FRD_FROM_FLU)
    flipped: Floats = np.where(turned[:, :1] < 0.0, -turned, turned)
    return flipped


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ahrs-service estimate`."""
    parser.add_argument("--in", dest="source", type=Path, required=True, metavar="IN.npz")
    parser.add_argument("--out", type=Path, required=True, metavar="OUT.npz")
    parser.add_argument("--frame", choices=["frd", "flu"], default="frd", help="default: frd")
    parser.add_argument(
        "--offline", action="store_true", help="smooth: not causal, for reference-grade attitude"
    )
    options.add_settings(parser)
    options.add_calibration(parser)


def run(args: argparse.Namespace) -> int:
    """Estimate the attitude of one file; return the exit code."""
    settings = options.settings_of(args)
    if args.out.exists() and args.source.exists() and args.out.samefile(args.source):
        raise RecordingError(f"{args.out}: is the input itself; give --out another file")
    shelf = CalibrationStore(options.sensor_of(args, settings.sensor))
    choice, console = shelf.choose(""), Console(stderr=True)
    if choice is None and shelf.is_folder:
        raise config_file.ConfigError(shelf.refusal(""))
    columns = read_columns(args.source)
    if args.profile is None and settings.fusion.airframe == "auto":
        args.profile = recognition.profile_of(recognition.signs_of(columns, args.frame))
        settings = options.settings_of(args)
        console.print(f"taken for {args.profile} by its motion; --profile says it", highlight=False)
    known = None if choice is None else choice.calibration
    out = estimate_columns(columns, settings, args.frame, args.offline, known)
    _write(args.out, out)
    for doubt in doubts(columns, args.frame):
        console.print(escape(f"{args.source}: {doubt}"), highlight=False, soft_wrap=True)
    if choice is not None:
        console.print(escape(choice.text()), highlight=False, soft_wrap=True)
    console.print(
        f"{escape(str(args.out))}: {', '.join(out)} of {len(columns.time_ns)} samples",
        highlight=False,
        soft_wrap=True,
    )
    return EXIT_DONE


def _write(path: Path, out: dict[str, Any]) -> None:
    try:
        # An open file, since by its name alone numpy would add a suffix.
        with path.open("wb") as file:
            np.savez(file, **out)
    except OSError as error:
        raise RecordingError(
            f"{path}: cannot be written: {error.strerror or error}; give a place that can be"
        ) from None
