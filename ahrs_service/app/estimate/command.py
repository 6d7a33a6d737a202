"""Attitude of plain arrays: sensor samples in an .npz in, quaternions in an .npz out.

IN holds imu_gyr [N, 3] rad/s, imu_acc [N, 3] m/s^2 (specific force), and sampling_rate [Hz] or
t [N] s, or both (then t is used). It may hold imu_mag [N, 3] uT, airspeed [N] m/s, vel_ned [N, 3]
m/s (or [N, 2], north and east) and imu_degc [N], the sensor's temperature in degC, NaN where there
is none; a speed may also be held until the next value, or be 0 where there is none. Other fields
are ignored. With --calibration the raw output of the sensor is compensated first, in axes
forward, right, down.

OUT holds one row per sample: quat [N, 4] wxyz without the magnetometer, heading 0 at the
start; quat9 [N, 4] with it, where there is imu_mag; sigma_deg [N, 3] 1-sigma of quat's error
about the earth's axes; gate [N] why the accelerometer was not used as the vertical, 0 if it was.
Without --profile it is recognised from the motion in the whole recording (estimate.recognition).
With --offline all rows but gate are smoothed: later samples also correct earlier attitudes.

--frame frd: sensor axes forward, right, down (level at rest: z = -9.81); quat rotates them to
north, east, down. --frame flu: forward, left, up (level at rest: z = +9.81); quat rotates them to
axes with z up and x along heading 0, quat9 to east, north (magnetic, or true by
fusion.declination_deg), up.
"""

import argparse
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.markup import escape

from ahrs_service.app import options
from ahrs_service.app.estimate.arrays import attitude_of
from ahrs_service.app.estimate.sample_columns import read_columns
from ahrs_service.app.files import config_file
from ahrs_service.app.files.calibration_choice import CalibrationStore
from ahrs_service.errors import ConfigError, RecordingError
from ahrs_service.settings import Settings

EXIT_DONE: Final = 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ahrs-service estimate`."""
    parser.add_argument("--in", dest="source", type=Path, required=True, metavar="IN.npz")
    parser.add_argument("--out", type=Path, required=True, metavar="OUT.npz")
    parser.add_argument("--frame", choices=["frd", "flu"], default="frd", help="default: frd")
    parser.add_argument(
        "--offline", action="store_true", help="smooth: non-causal, for reference-grade attitude"
    )
    options.add_settings(parser)
    options.add_calibration(parser)


def run(args: argparse.Namespace) -> int:
    """Estimate the attitude of one file; return the exit code."""
    settings = options.settings_of(args)
    if args.out.exists() and args.source.exists() and args.out.samefile(args.source):
        raise RecordingError(f"{args.out}: is the input file; give another file as --out")
    shelf = CalibrationStore(options.sensor_of(args, settings.sensor))
    choice, console = shelf.choose(""), Console(stderr=True)
    if choice is None and shelf.is_folder:
        raise ConfigError(shelf.refusal(""))
    columns = read_columns(args.source)

    def settings_with(profile: str | None) -> Settings:
        return config_file.load(args.config, args.overrides, profile)

    known = None if choice is None else choice.calibration
    attitude = attitude_of(columns, settings_with, args.profile, args.frame, args.offline, known)
    out = attitude.arrays()
    _write(args.out, out)
    if args.profile is None and settings.fusion.airframe == "auto":
        said = f"recognised as {attitude.profile} from its motion; set it with --profile"
        console.print(said, highlight=False)
    for doubt in attitude.doubts:
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
            f"{path}: cannot be written: {error.strerror or error}; give a writable path"
        ) from None
