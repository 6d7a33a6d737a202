"""Allan deviation of a unit at rest: angle and velocity random walk, bias instability, rate walk.

Leave the unit still, at a steady temperature, for as long as can be: an averaging time needs nine
times its length, so an hour shows what happens within six minutes. The longest still part of the
recording is used. Coefficients are fitted with their 1-sigma; what does not stand out of it is
given as its upper bound (<). Autopilots filter what they send, which lowers short averaging times.

Examples:
  ahrs-service calibrate allan bench.tlog --figure allan.png
  ahrs-service calibrate allan bench.bin --json
  ahrs-service calibrate allan --link serial:/dev/ttyACM0:115200 --seconds 3600

"""

import argparse
import json
import math
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from ahrs_service.app.calibrate import capture, session
from ahrs_service.app.options import positive
from ahrs_service.calibration.allan import (
    AllanDeviation,
    NoiseCoefficients,
    fit_coefficients,
    overlapping_deviation,
)
from ahrs_service.calibration.columns import AXES, ImuColumns, check_stream_unit
from ahrs_service.calibration.guide import guide_recording
from ahrs_service.calibration.poses import Stillness, find_poses, resolution
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats

EXIT_DONE: Final = 0
_DRIFT_K: Final = 1.0
_SECONDS: Final = 600.0
_COEFFICIENTS: Final = ("random_walk", "bias_instability", "rate_random_walk", "quantisation")
_UNITS: Final = {
    "gyro": ("rad/s", "rad/√s", "rad/s", "rad/s/√s", "rad"),
    "accel": ("m/s²", "m/s/√s", "m/s²", "m/s²/√s", "m/s"),
}
_NOISE: Final = Stillness(scatter=math.inf, gyro_cap_rad_s=0.05, accel_cap_m_s2=1.0, shift_m_s2=1.0)
"""A bench that vibrates or drifts is what it is: only handling ends the still part."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `calibrate allan`."""
    capture.add_arguments(parser)
    session.add_arguments(parser)
    parser.add_argument(
        "--seconds",
        type=positive,
        default=_SECONDS,
        metavar="S",
        help=f"how long a session on a link records at rest (default: {_SECONDS:g})",
    )
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw the curves (.png)")
    parser.add_argument("--json", action="store_true", help="end with one line of JSON on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Show the deviations of recordings or of a session; return the exit code."""
    guide = partial(guide_recording, seconds=arguments.seconds, stillness=_NOISE)
    return session.run(arguments, guide, show)


def show(captures: list[capture.Capture], arguments: argparse.Namespace) -> int:
    """Show the deviations of each recording."""
    console = Console(stderr=bool(arguments.json))
    plain = []
    for one in captures:
        still = longest_still(one.columns)
        curves = deviations(still)
        found = coefficients(still)
        console.print(Text(_title(one, still), style="dim"))
        for text in warnings(still):
            console.print(Text(f"warning: {text}", style="yellow"), soft_wrap=True)
        for triad, axes in found.items():
            console.print(_table(triad, axes))
        if arguments.figure is not None:
            _draw(arguments.figure, one.path.name, curves)
            console.print(f"wrote {escape(str(arguments.figure))}", soft_wrap=True)
        plain.append(_plain(one, still, curves, found))
    if arguments.json:
        print(json.dumps(plain))
    return EXIT_DONE


def longest_still(columns: ImuColumns) -> ImuColumns:
    """Return the longest still part; CalibrationError where there is none of 100 samples."""
    check_stream_unit(columns)
    poses = find_poses(columns, _NOISE)
    if not len(poses):
        raise CalibrationError(
            "the unit is nowhere still: leave it alone on something solid for ten minutes or more"
        )
    pose = poses[np.argmax(poses["last"] - poses["first"])]
    return columns.part(int(pose["first"]), int(pose["last"]))


def deviations(still: ImuColumns) -> dict[str, tuple[AllanDeviation, ...]]:
    """Return the curves of gyro and accel, x, y, z, on an even grid of time."""
    return {
        triad: tuple(overlapping_deviation(column, still.interval_s) for column in even.T)
        for triad, even in _even(still).items()
    }


def coefficients(still: ImuColumns) -> dict[str, tuple[NoiseCoefficients, ...]]:
    """Return the fitted coefficients of gyro and accel, x, y, z."""
    return {
        triad: tuple(fit_coefficients(column, still.interval_s) for column in even.T)
        for triad, even in _even(still).items()
    }


def _even(still: ImuColumns) -> dict[str, Floats]:
    """Return the outputs at even steps: the sample before holds where one is missing."""
    count = round((still.time_s[-1] - still.time_s[0]) / still.interval_s) + 1
    grid = still.time_s[0] + (np.arange(count) + 0.5) * still.interval_s
    place = np.clip(np.searchsorted(still.time_s, grid) - 1, 0, len(still.time_s) - 1)
    return {"gyro": still.gyro_rad_s[place], "accel": still.accel_m_s2[place]}


def warnings(still: ImuColumns) -> list[str]:
    """Say what makes the curves other than the sensor's own."""
    texts = []
    known = still.temperature_degc[np.isfinite(still.temperature_degc)]
    if len(known) and np.ptp(known) > _DRIFT_K:
        texts.append(
            f"the IMU's temperature moved by {np.ptp(known):.1f} degC: long averaging times show "
            "its drift, not the sensor's instability; let the unit warm up before"
        )
    for triad, values in (("gyro", still.gyro_rad_s), ("accel", still.accel_m_s2)):
        coarse = resolution(values) > 2.0 * values.std(axis=0)
        if coarse.any():
            names = ", ".join(np.array(AXES)[coarse])
            texts.append(
                f"{triad} {names}: the link's rounding is coarser than the noise, which is not "
                "seen; use HIGHRES_IMU or an onboard log"
            )
    return texts


def _title(one: capture.Capture, still: ImuColumns) -> str:
    seconds = still.time_s[-1] - still.time_s[0]
    return (
        f"{one.path.name}: {one.source}, {one.rate_hz:.1f} Hz, still for {seconds:.0f} s; "
        f"averaging times to {seconds / 9.0:.0f} s"
    )


def _table(triad: str, axes: tuple[NoiseCoefficients, ...]) -> Table:
    _, *units = _UNITS[triad]
    walk = "angle random walk" if triad == "gyro" else "velocity random walk"
    table = Table(title=f"{triad}: noise coefficients, 1-sigma", title_justify="left")
    for head in ("", "unit", *AXES):
        table.add_column(head, justify="right" if head in AXES else "left", no_wrap=True)
    names = (walk, "bias instability", "rate random walk", "quantisation")
    for name, unit, label in zip(_COEFFICIENTS, units, names, strict=True):
        cells = []
        for axis in axes:
            value, sigma = getattr(axis, name), getattr(axis, f"{name}_sigma")
            seen = axis.is_seen(name)
            cells.append(f"{value:.1e} ±{sigma / value:.0%}" if seen else f"< {2 * sigma:.1e}")
        table.add_row(label, unit, *cells)
    return table


def _draw(path: Path, title: str, curves: dict[str, tuple[AllanDeviation, ...]]) -> None:
    from ahrs_service.viz.allan_figure import draw_allan  # noqa: PLC0415 - matplotlib is slow to load

    axes = {
        f"{triad} [{_UNITS[triad][0]}]": [
            (axis, c.tau_s, c.deviation, c.low, c.high)
            for axis, c in zip(AXES, triads, strict=True)
        ]
        for triad, triads in curves.items()
    }
    try:
        draw_allan(path, title, axes)
    except (OSError, ValueError) as error:
        raise CalibrationError(f"--figure {path}: cannot be written: {error}") from None


def _plain(
    one: capture.Capture,
    still: ImuColumns,
    curves: dict[str, tuple[AllanDeviation, ...]],
    found: dict[str, tuple[NoiseCoefficients, ...]],
) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "recording": one.path.name,
        "sha256": one.sha256,
        "seconds": float(still.time_s[-1] - still.time_s[0]),
        "rate_hz": one.rate_hz,
        "warnings": warnings(still),
    }
    for triad, axes in curves.items():
        plain[triad] = [
            {
                "tau_s": c.tau_s.tolist(),
                "deviation": c.deviation.tolist(),
                "low": c.low.tolist(),
                "high": c.high.tolist(),
                **{
                    name: [getattr(n, name), getattr(n, f"{name}_sigma")]
                    for name in _COEFFICIENTS
                    if math.isfinite(getattr(n, name))
                },
            }
            for c, n in zip(axes, found[triad], strict=True)
        ]
    return plain
