"""Allan deviations as a picture: one panel per triad, one line with its confidence per axis."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure

from ahrs_service.records import Floats

Curve = tuple[str, Floats, Floats, Floats, Floats]
"""Axis name, averaging times [s], deviation, and the ends of its confidence."""

_COLOURS: Final = ("tab:red", "tab:green", "tab:blue")


def draw_allan(path: Path, title: str, panels: Mapping[str, Sequence[Curve]]) -> None:
    """Draw `panels` [title with unit, curves] to a picture file; OSError where it cannot be."""
    figure = Figure(figsize=(5.0 * len(panels), 4.0), layout="constrained")
    figure.suptitle(title)
    for k, (name, curves) in enumerate(panels.items(), start=1):
        axes = figure.add_subplot(1, len(panels), k)
        for (axis, tau_s, deviation, low, high), colour in zip(curves, _COLOURS, strict=False):
            axes.loglog(tau_s, deviation, color=colour, label=axis)
            axes.fill_between(tau_s, low, high, color=colour, alpha=0.2, linewidth=0.0)
        axes.set_title(f"Allan deviation, {name}")
        axes.set_xlabel("averaging time [s]")
        axes.grid(visible=True, which="both", alpha=0.3)
        axes.legend()
    figure.savefig(path, dpi=110)
