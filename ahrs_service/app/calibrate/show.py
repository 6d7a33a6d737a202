"""Look at a calibration: its figures, what it is made from, its verdict, its curves.

Bias is the output without input, scale how much more than the input the output changes, both of
the sensor before compensation, with all terms at that temperature.

Examples:
  ahrs-service calibrate show configs/calibrations/sim-1.toml
  ahrs-service calibrate show unit.toml --png unit.png --rrd unit.rrd

"""

import argparse
import math
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ahrs_service.app.files import calibration_file
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.errors import ConfigError
from ahrs_service.records import Floats
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.forward import forward_columns
from ahrs_service.sensor.parameters import NIL, Calibration, TriadCalibration, coefficients
from ahrs_service.viz.calibration_curves import CalibrationView, Curves, draw_png
from ahrs_service.viz.calibration_curves import write_rrd as write_view

EXIT_DONE: Final = 0
_MG: Final = 1e3 / STANDARD_GRAVITY_M_S2
_INPUTS: Final = {"gyro": 1.0, "accel": STANDARD_GRAVITY_M_S2}
"""Input at which the scale is judged: 1 rad/s, 1 g."""
_UNITS: Final = {"gyro": ("deg/s", math.degrees(1.0)), "accel": ("mg", _MG)}
_DEFAULT_SPAN: Final = (-40.0, 70.0)
_MARGIN_DEGC: Final = 5.0
_STEPS_PER_DEGC: Final = 10
_SHOWN_ERRORS: Final = 24
_DIGITS: Final = 12


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ahrs-service calibrate show`."""
    parser.add_argument("file", type=Path, metavar="FILE", help="calibration as TOML")
    parser.add_argument("--png", type=Path, metavar="OUT", help="draw the curves as a picture")
    parser.add_argument("--rrd", type=Path, metavar="OUT", help="write the curves for the viewer")


def run(arguments: argparse.Namespace) -> int:
    """Show one calibration; return the exit code."""
    calibration = calibration_file.load(arguments.file)
    console = Console()
    for table in tables(arguments.file, calibration):
        console.print(table)
    view = view_of(arguments.file, calibration)
    for path, write in ((arguments.png, draw_png), (arguments.rrd, write_view)):
        if path is None:
            continue
        try:
            write(path, view)
        except OSError as error:
            raise ConfigError(
                f"{path}: cannot be written: {error.strerror or error}; give a place that can be"
            ) from None
        console.print(f"wrote {escape(str(path))}", highlight=False, soft_wrap=True)
    return EXIT_DONE


# -- the curves -------------------------------------------------------------------------------


def view_of(path: Path, calibration: Calibration) -> CalibrationView:
    """Return what is drawn of a calibration: bias and scale of both triads over temperature."""
    temperature = _temperatures(calibration)
    panels = []
    for name, triad in (("gyro", calibration.gyro), ("accel", calibration.accel)):
        bias, scale = response(calibration, name, temperature)
        unit, factor = _UNITS[name]
        known = triad.uncertainty
        label = "Gyro" if name == "gyro" else "Accelerometer"
        sigma = _sigma(known.bias_sigma, temperature, factor)
        panels.append(Curves(f"{label} bias", unit, bias * factor, sigma, triad.span_degc))
        sigma = _sigma(known.scale_sigma, temperature, 100.0)
        panels.append(Curves(f"{label} scale", "%", scale * 100.0, sigma, triad.span_degc))
    date = calibration.provenance.date[:10] or "date not known"
    title = f"Calibration of {calibration.serial or path.name}, {date}"
    return CalibrationView(
        title, temperature, tuple(panels), calibration.verdict.usable, verdict_text(calibration)
    )


def _temperatures(calibration: Calibration) -> Floats:
    """Temperatures [N] over all spans and somewhat beyond, in tenths of a degree."""
    spans = [t.span_degc for t in (calibration.gyro, calibration.accel) if t.span_degc is not None]
    low = min((span[0] for span in spans), default=_DEFAULT_SPAN[0]) - _MARGIN_DEGC
    high = max((span[1] for span in spans), default=_DEFAULT_SPAN[1]) + _MARGIN_DEGC
    return np.linspace(low, high, round((high - low) * _STEPS_PER_DEGC) + 1)


def response(
    calibration: Calibration, name: str, temperature_degc: Floats
) -> tuple[Floats, Floats]:
    """Return bias [N, 3] [rad/s or m/s^2] and scale error [N, 3] [1] of one triad's raw output.

    The output without input, and half the difference of those to plus and minus the input along
    each axis, over the input, less 1.
    """
    rows, size = coefficients(calibration), _INPUTS[name]
    count = len(temperature_degc)
    nothing = np.zeros((count, 3))

    def output(value: Floats) -> Floats:
        rate, force = (value, nothing) if name == "gyro" else (nothing, value)
        both = forward_columns(rows, rate, force, temperature_degc)
        return both[0] if name == "gyro" else both[1]

    scale = np.empty((count, 3))
    for axis in range(3):
        value = nothing.copy()
        value[:, axis] = size
        change = output(value)[:, axis] - output(-value)[:, axis]
        scale[:, axis] = change / (2.0 * size) - 1.0
    # What differs in the last digits only would fill its plot with noise.
    return output(nothing), np.round(scale, _DIGITS)


def _sigma(curve: Curve, temperature_degc: Floats, factor: float) -> Floats | None:
    return curve.at(temperature_degc) * factor if curve.pieces else None


# -- the tables -------------------------------------------------------------------------------


def verdict_text(calibration: Calibration, between: str = "; ") -> str:
    """Say the verdict and its sentences, with `between` them."""
    verdict = calibration.verdict
    head = "usable" if verdict.usable else "DO NOT USE"
    text = between.join((head, *verdict.sentences))
    return text.replace(f"DO NOT USE{between}do not use", "DO NOT USE")


def tables(path: Path, calibration: Calibration) -> list[Table]:
    """Return what there is to read: origin and verdict, then the figures of both triads."""
    about = Table(title=escape(str(path)), title_justify="left", show_header=False)
    about.add_column(style="bold")
    about.add_column(overflow="fold")
    origin = calibration.provenance
    colour = "green" if calibration.verdict.usable else "bold red"
    said = escape(verdict_text(calibration, "\n"))
    rows = {
        "verdict": f"[{colour}]{said}[/]",
        "serial": escape(calibration.serial or "not known"),
        "board": escape(calibration.uid or "not known"),
        "IMU": "any" if calibration.imu is None else str(calibration.imu),
        "date": escape(origin.date or "not known"),
        "procedures": escape(", ".join(origin.procedures) or "not known"),
        "recordings": "\n".join(
            escape(f"{one.name} ({one.use or 'all'}) sha256 {one.sha256[:12]}...")
            for one in origin.recordings
        ),
        "source": escape(calibration.source),
        "figures": "\n".join(
            escape(f"{name}: {value:.6g}") for name, value in calibration.verdict.figures.items()
        ),
    }
    for name, text in rows.items():
        if text:
            about.add_row(name, text)
    triads = (("gyro", calibration.gyro), ("accel", calibration.accel))
    return [about, *(_triad_table(calibration, name, triad) for name, triad in triads)]


def _triad_table(calibration: Calibration, name: str, triad: TriadCalibration) -> Table:
    unit, factor = _UNITS[name]
    table = Table(title=_triad_title(name, triad), title_justify="left")
    for head in ("axis", escape(f"bias [{unit}]"), "scale [%]", "matrix, row [1]"):
        table.add_column(head, justify="left" if head == "axis" else "right")
    table.add_column(escape(f"bias over temperature [{unit}]"), justify="right")
    table.add_column("scale over temperature [%]", justify="right")
    table.add_column(escape(f"bias left [{unit}]"), justify="right")
    bias, scale = response(calibration, name, _temperatures(calibration))
    left = triad.uncertainty.bias_residual
    for i, axis in enumerate("xyz"):
        table.add_row(
            axis,
            f"{triad.bias[i] * factor:+.4f}",
            f"{(triad.matrix[i][i] - 1.0) * 100.0:+.3f}",
            " ".join(f"{value:+.5f}" for value in triad.matrix[i]),
            f"{bias[:, i].min() * factor:+.4f} to {bias[:, i].max() * factor:+.4f}",
            f"{scale[:, i].min() * 100.0:+.3f} to {scale[:, i].max() * 100.0:+.3f}",
            "not known" if left is None else f"{left[i] * factor:.4f}",
        )
    errors = list(triad.uncertainty.standard_errors().items())
    shown = ", ".join(f"{key} {value:.2g}" for key, value in errors[:_SHOWN_ERRORS])
    if errors:
        more = f", and {len(errors) - _SHOWN_ERRORS} more" if len(errors) > _SHOWN_ERRORS else ""
        table.caption = escape(f"standard errors: {shown}{more}")
    return table


def _triad_title(name: str, triad: TriadCalibration) -> str:
    parts = [name, triad.model or "no thermal model"]
    if triad.span_degc is not None:
        parts.append(f"{triad.span_degc[0]:.3g} to {triad.span_degc[1]:.3g} degC")
        parts.append(f"{len(triad.breaks_degc()) - 1} segments")
    if triad.thermal_lag_s:
        which = "the sensor" if triad.thermal_lag_s > 0.0 else "the thermometer"
        parts.append(f"{which} lags by {abs(triad.thermal_lag_s):.0f} s")
    if triad.g_sensitivity != NIL:
        largest = np.abs(triad.g_sensitivity).max() * math.degrees(STANDARD_GRAVITY_M_S2)
        parts.append(f"g-sensitivity up to {largest:.3f} deg/s per g")
    return escape(", ".join(parts))
