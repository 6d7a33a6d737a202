"""The curves of a calibration over temperature: as a picture, and for the Rerun viewer."""

import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = npt.NDArray[np.float64]

TIMELINE: Final = "temperature_degc"
_AXES: Final = ("x", "y", "z")
_HUES: Final = ("#e5484d", "#30a46c", "#3e7bfa")
_ABOUT: Final = "/about"
_WIDTH: Final = 118
_LINES: Final = 4


@dataclass(frozen=True, slots=True)
class Curves:
    """One panel: `values` [N, 3] over temperature, with `sigma` [N, 3] where that is known.

    `name` as "Gyro bias", `unit` as "deg/s"; `span_degc` the calibrated temperatures, None where
    temperature changes nothing.
    """

    name: str
    unit: str
    values: Floats
    sigma: Floats | None
    span_degc: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class CalibrationView:
    """What is shown of a calibration: `temperature_degc` [N], rising, and panels over it."""

    title: str
    temperature_degc: Floats
    panels: tuple[Curves, ...]
    usable: bool
    verdict: str


def draw_png(path: Path, view: CalibrationView) -> None:
    """Draw the panels as a picture; OSError where it cannot be written."""
    # Loading matplotlib takes longer than most commands run.
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=(11.0, 7.6), layout="constrained")
    grid = figure.subplots(2, 2, sharex=True)
    for axes, curves in zip(np.ravel(grid), view.panels, strict=True):
        _draw_panel(axes, view.temperature_degc, curves)
    for axes in grid[-1]:
        axes.set_xlabel("element temperature [°C]")
    grid[0, 0].legend(ncols=3, frameon=False, fontsize=9)
    figure.suptitle(view.title, fontsize=12)
    lines = textwrap.wrap(view.verdict, _WIDTH)
    if len(lines) > _LINES:
        lines = [*lines[: _LINES - 1], f"{lines[_LINES - 1]} ..."]
    colour = "#1a7f37" if view.usable else "#c62828"
    figure.supxlabel("\n".join(lines), fontsize=9.5, color=colour)
    figure.savefig(path, format="png", dpi=110)


def _draw_panel(axes: "Axes", temperature: Floats, curves: Curves) -> None:
    for i, (name, hue) in enumerate(zip(_AXES, _HUES, strict=True)):
        y = curves.values[:, i]
        axes.plot(temperature, y, color=hue, linewidth=1.6, label=name)
        if curves.sigma is not None:
            low, high = y - curves.sigma[:, i], y + curves.sigma[:, i]
            axes.fill_between(temperature, low, high, color=hue, alpha=0.18, linewidth=0.0)
    text = "does not change with temperature"
    if curves.span_degc is not None:
        low_degc, high_degc = curves.span_degc
        text = f"calibrated {low_degc:.3g} to {high_degc:.3g} °C, held beyond"
        for first, last in ((temperature[0], low_degc), (high_degc, temperature[-1])):
            axes.axvspan(first, last, color="#888888", alpha=0.18, linewidth=0.0)
    band = "" if curves.sigma is None else "; band ± 1 sigma"
    axes.set_title(f"{curves.name} [{curves.unit}]: {text}{band}", fontsize=9)
    axes.set_xlim(temperature[0], temperature[-1])
    axes.grid(True, alpha=0.3)


def write_rrd(path: Path, view: CalibrationView) -> None:
    """Write the panels for the viewer; its timeline is the temperature in whole degrees."""
    import rerun as rr  # noqa: PLC0415

    path.open("wb").close()
    recording = rr.RecordingStream("ahrs-service-calibration", recording_id=path.stem)
    recording.set_sinks(rr.FileSink(path), default_blueprint=_blueprint(view))
    degrees = np.arange(
        np.ceil(view.temperature_degc[0]), np.floor(view.temperature_degc[-1]) + 1.0
    )
    time = rr.TimeColumn(TIMELINE, sequence=degrees.astype(np.int64))
    for curves in view.panels:
        columns, names, colours = [curves.values], list(_AXES), list(_HUES)
        if curves.sigma is not None:
            columns += [curves.values - curves.sigma, curves.values + curves.sigma]
            names += [f"{axis} {sign} sigma" for sign in "-+" for axis in _AXES]
            colours += [f"{hue}60" for hue in _HUES] * 2
        values = np.concatenate(columns, axis=1)
        at = np.stack(
            [np.interp(degrees, view.temperature_degc, column) for column in values.T], axis=1
        )
        entity = _entity(curves)
        look = rr.SeriesLines(names=names, colors=[_rgba(colour) for colour in colours])
        recording.log(entity, look, static=True)
        scalars = rr.Scalars.columns(scalars=at.ravel()).partition([at.shape[1]] * len(at))
        recording.send_columns(entity, [time], scalars)
    text = f"# {view.title}\n\n{view.verdict}"
    recording.log(_ABOUT, rr.TextDocument(text, media_type="text/markdown"), static=True)
    recording.flush()
    recording.disconnect()


def _blueprint(view: CalibrationView) -> Any:
    import rerun.blueprint as rrb  # noqa: PLC0415

    plots = [
        rrb.TimeSeriesView(
            origin=_entity(curves),
            name=f"{curves.name} [{curves.unit}] over °C: x red, y green, z blue, sigma faint",
            plot_legend=rrb.PlotLegend(visible=False),
        )
        for curves in view.panels
    ]
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Grid(*plots, grid_columns=2),
            rrb.TextDocumentView(origin=_ABOUT, name="Verdict"),
            row_shares=[0.8, 0.2],
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def _entity(curves: Curves) -> str:
    return f"/{curves.name.lower().replace(' ', '_')}"


def _rgba(colour: str) -> list[int]:
    digits = colour.removeprefix("#").ljust(8, "f")
    return list(bytes.fromhex(digits))
