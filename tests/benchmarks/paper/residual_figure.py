"""What thermal calibrations leave over temperature: panels for the axes, all of it and near 0."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure

from ahrs_service.records import Floats

_COLOURS: Final = ("tab:red", "tab:orange", "tab:blue")
_AXES: Final = "xyz"


def draw_residuals(
    path: Path,
    title: str,
    unit: str,
    temperature_degc: Floats,
    residuals: Mapping[str, Floats],
    near: float,
) -> None:
    """Draw residuals [N, 3] by method over temperature [N]; OSError where it cannot be written.

    Up to three methods. The upper panels show all, the lower ones what lies within `near`.
    """
    figure = Figure(figsize=(11.0, 5.5), layout="constrained")
    figure.suptitle(title)
    panels = figure.subplots(2, 3, sharex=True, sharey="row")
    for column, axis in enumerate(_AXES):
        for row in (0, 1):
            panel = panels[row][column]
            for (name, residual), colour in zip(residuals.items(), _COLOURS, strict=False):
                dots = {"marker": ".", "markersize": 2.0, "linestyle": "none"}
                panel.plot(temperature_degc, residual[:, column], color=colour, label=name, **dots)
            panel.grid(visible=True, alpha=0.3)
        panels[0][column].set_title(axis)
        panels[1][column].set_ylim(-near, near)
        panels[1][column].set_xlabel("temperature [degC]")
    panels[0][0].set_ylabel(f"residual [{unit}]")
    panels[1][0].set_ylabel(f"the same, near [{unit}]")
    panels[0][0].legend(loc="upper left", markerscale=4.0, fontsize="small")
    figure.savefig(path, dpi=90)
