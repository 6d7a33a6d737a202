"""Pictures of a diagnosis, drawn by matplotlib without a screen; as SVG text or PNG bytes.

Each function takes plain columns and returns a figure. x is red, y green, z blue as in the viewer;
grey is before, colour after.
"""

import io
import math
from collections.abc import Sequence
from typing import Any, Final, Protocol

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

Floats = npt.NDArray[np.float64]
Span = tuple[float, float]

CHANNELS: Final = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
"""The columns of a residual [N, 6]: [rad/s] and [m/s^2]."""
TRIADS: Final = ("gyro", "gyro", "gyro", "accel", "accel", "accel")
"""The triad of each of them."""

_AXES: Final = ("#E5484D", "#30A46C", "#3E7BFA")
_BEFORE: Final = "#9AA0A6"
_BAND: Final = "#DADDE1"
_SPAN: Final = "#F6C453"
_INK: Final = "#22262B"
_BINS: Final = 300
_COLUMNS: Final = 3
_STYLE: Final[Any] = {
    "font.size": 8.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": _INK,
    "axes.titlesize": 8.5,
    "svg.fonttype": "none",
    "svg.hashsalt": "ahrs-service",
    "legend.frameon": False,
}


class Covariate(Protocol):
    """Residual of one channel against one covariate, in bins."""

    @property
    def triad(self) -> str: ...  # noqa: D102
    @property
    def channel(self) -> str: ...  # noqa: D102
    @property
    def covariate(self) -> str: ...  # noqa: D102
    @property
    def unit(self) -> str: ...  # noqa: D102
    @property
    def edges(self) -> Floats: ...  # noqa: D102
    @property
    def mean(self) -> Floats: ...  # noqa: D102
    @property
    def null_std(self) -> Floats: ...  # noqa: D102
    @property
    def fitted(self) -> Floats: ...  # noqa: D102
    @property
    def p_value(self) -> float: ...  # noqa: D102


def as_svg(figure: Figure) -> str:
    """Return the figure as an `<svg>` element, the same for the same figure."""
    out = io.StringIO()
    with mpl.rc_context(_STYLE):
        figure.savefig(out, format="svg", metadata={"Date": None})
    text = out.getvalue()
    return text[text.index("<svg") :]


def as_png(figure: Figure) -> bytes:
    """Return the figure as the bytes of a PNG file."""
    out = io.BytesIO()
    with mpl.rc_context(_STYLE):
        figure.savefig(out, format="png", dpi=110.0)
    return out.getvalue()


def unit_of(triad: str) -> tuple[str, float]:
    """Return the unit in which a triad's channels are drawn, and the factor to it from SI."""
    return ("mrad/s", 1e3) if triad == "gyro" else ("m/s²", 1.0)


def residual_over_time(
    time_s: Floats, before: Floats, after: Floats, spans: Sequence[Span] = ()
) -> Figure:
    """Draw the residuals [N, 6] over time [N] [s], averaged in bins; `spans` [s] are shaded.

    The remaining constant bias is subtracted: a turn-on bias is not a finding.
    """
    bias = np.nanmean(after, axis=0) if len(after) else np.zeros(len(CHANNELS))
    before, after = before - bias, after - bias
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(10.0, 4.4), layout="constrained")
        grid = figure.subplots(2, _COLUMNS, sharex=True, squeeze=False).ravel()
        for index, (channel, axes) in enumerate(zip(CHANNELS, grid, strict=True)):
            unit, factor = unit_of(TRIADS[index])
            t, old = _binned(time_s, before[:, index] * factor)
            _, new = _binned(time_s, after[:, index] * factor)
            for start, stop in spans:
                axes.axvspan(start, stop, color=_SPAN, alpha=0.15, linewidth=0.0)
            axes.axhline(0.0, color=_INK, linewidth=0.5)
            axes.plot(t, old, color=_BEFORE, linewidth=1.0, label="before")
            axes.plot(t, new, color=_AXES[index % _COLUMNS], linewidth=1.0, label="after")
            axes.set_title(f"{words(channel)} [{unit}]", loc="left")
            _robust_limits(axes, np.concatenate([old, new]))
        for axes in grid[_COLUMNS:]:
            axes.set_xlabel("time [s]")
        grid[0].legend(loc="upper right", ncols=2)
    return figure


def against_covariates(covariates: Sequence[Covariate]) -> Figure:
    """Draw each residual against its covariate: bin means, the 2-sigma band of noise, the fit."""
    columns = min(_COLUMNS, max(1, len(covariates)))
    rows = max(1, math.ceil(len(covariates) / columns))
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(3.4 * columns, 2.3 * rows), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in grid[len(covariates) :]:
            axes.set_axis_off()
        for item, axes in zip(covariates, grid, strict=False):
            _against(axes, item)
        if covariates:
            grid[0].legend(loc="best", fontsize=7.0)
    return figure


def _against(axes: Axes, item: Covariate) -> None:
    unit, factor = unit_of(item.triad)
    is_angle = item.unit.startswith("rad")
    turn, along = (180.0 / math.pi if is_angle else 1.0), item.unit.replace("rad", "deg")
    middle = 0.5 * turn * (item.edges[1:] + item.edges[:-1])
    band = 2.0 * factor * item.null_std
    axes.fill_between(middle, -band, band, color=_BAND, linewidth=0.0, label="noise, 2 sigma")
    axes.axhline(0.0, color=_INK, linewidth=0.5)
    colour = _AXES["xyz".index(item.channel[-1])]
    axes.plot(middle, factor * item.mean, "o", color=colour, markersize=3.0, label="residual")
    axes.plot(middle, factor * item.fitted, color=_INK, linewidth=1.0, label="findings")
    axes.set_title(f"{words(item.channel)} [{unit}], {p_text(item.p_value)}", loc="left")
    axes.set_xlabel(f"{words(item.covariate)} [{along}]")


def holdout_bars(
    names: Sequence[str], before: Sequence[Floats], after: Sequence[Floats], unit: str
) -> Figure:
    """Draw rms per axis of each thing named, before (grey) and after, on data not fitted to."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(3.2 * len(names), 2.2), layout="constrained")
        grid = figure.subplots(1, len(names), squeeze=False).ravel()
        place = np.arange(3)
        for name, old, new, axes in zip(names, before, after, grid, strict=True):
            axes.bar(place - 0.2, old, 0.38, color=_BEFORE, label="before")
            axes.bar(place + 0.2, new, 0.38, color=_AXES, label="after")
            axes.set_xticks(place, ["x", "y", "z"])
            axes.set_title(f"{name} [{unit}]", loc="left")
    return figure


def evidence_bars(names: Sequence[str], evidence: Sequence[float]) -> Figure:
    """Draw log evidence [nats] by name, the first on top."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(6.5, 0.5 + 0.28 * max(1, len(names))), layout="constrained")
        axes = figure.subplots()
        place = np.arange(len(names))[::-1]
        axes.barh(place, evidence, 0.7, color=_AXES[2])
        axes.set_yticks(place, names)
        axes.set_xlabel("log evidence [nats]")
        for at, value in zip(place, evidence, strict=True):
            axes.text(value, at, f" {value:.0f}", va="center", fontsize=7.0)
    return figure


def timeline(rows: Sequence[tuple[str, Sequence[Span]]], whole: Span) -> Figure:
    """Draw where each thing named shows, over the whole recording [s]."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(10.0, 0.6 + 0.28 * max(1, len(rows))), layout="constrained")
        axes = figure.subplots()
        for index, (_, spans) in enumerate(rows):
            bars = [(start, stop - start) for start, stop in spans]
            axes.broken_barh(bars, (len(rows) - 1 - index - 0.35, 0.7), color=_SPAN)
        axes.set_yticks(np.arange(len(rows))[::-1], [name for name, _ in rows])
        axes.set_ylim(-0.6, max(len(rows), 1) - 0.4)
        axes.set_xlim(*whole)
        axes.set_xlabel("time [s]")
    return figure


def words(name: str) -> str:
    """Return a field's name as words: accel_z is "accel z"."""
    return name.replace("_", " ")


def p_text(p_value: float) -> str:
    """Return "p = 0.03", or "p < 1e-12" where it is smaller than can be meant."""
    return f"p = {p_value:.2g}" if p_value > 1e-12 else "p < 1e-12"


def _binned(time_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return middles and means of at most 300 bins of like length, the empty ones left out."""
    if len(time_s) <= _BINS:
        return time_s, values
    edges = np.linspace(time_s[0], time_s[-1], _BINS + 1)
    which = np.clip(np.searchsorted(edges, time_s, side="right") - 1, 0, _BINS - 1)
    good = np.isfinite(values)
    count = np.bincount(which[good], minlength=_BINS)
    total = np.bincount(which[good], weights=values[good], minlength=_BINS)
    kept = count > 0
    return 0.5 * (edges[1:] + edges[:-1])[kept], total[kept] / count[kept]


def _robust_limits(axes: Axes, values: Floats) -> None:
    """Leave a few glitches out of the picture rather than squeeze all else flat."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return
    low, high = np.quantile(finite, [0.005, 0.995])
    margin = 0.25 * max(high - low, 1e-12)
    axes.set_ylim(float(low - margin), float(high + margin))
