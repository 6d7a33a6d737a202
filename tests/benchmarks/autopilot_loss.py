"""What the autopilots' forms of calibration lose against a full model, over many units.

    python tests/benchmarks/autopilot_loss.py [--units 200]

Units as paper.thermal_parts draws them: bias, scale and axes of each part drift with
temperature in forms that are no polynomials. Each is known exactly here, so what is printed is the
loss of the form alone: noise, lag and a fit on fewer temperatures come on top. Largest over
-40..70 degC and all directions of 1 g and 100 deg/s, of the worst axis; median and 90 % of the
units. ArduPilot's form and PX4's are one, so that their figures agree but for rounding.
"""

import argparse
import math
from dataclasses import replace

import numpy as np
from paper.thermal_parts import draw_unit
from rich.console import Console
from rich.table import Table

from ahrs_service.calibration.autopilots.ardupilot_params import to_ardupilot
from ahrs_service.calibration.autopilots.px4_params import to_px4
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import TriadCalibration

BREAKS = np.linspace(-40.0, 70.0, 56)
PARTS = ("largest", "rms", "bias", "scale", "cross")


def within(triad: TriadCalibration) -> TriadCalibration:
    """The same triad with its curves over -40..70 degC, as a chamber run would span."""
    return replace(
        triad,
        c=Curve.through(BREAKS, triad.c.at),
        matrix_drift=Curve.through(BREAKS, triad.matrix_drift.at),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=200)
    units = parser.parse_args().units
    rows: dict[tuple[str, str], list[list[float]]] = {}
    for seed in range(units):
        unit = draw_unit(np.random.default_rng(seed))
        unit = replace(unit, gyro=within(unit.gyro), accel=within(unit.accel))
        for name, export in (("ArduPilot", to_ardupilot(unit)), ("PX4", to_px4(unit))):
            for triad, loss in export.losses.items():
                figures = [float(getattr(loss, part).max()) for part in PARTS]
                rows.setdefault((name, triad), []).append(figures)
    table = Table(title=f"loss of the autopilots' forms, {units} units, median / 90 %")
    for column in ("", *PARTS, ""):
        table.add_column(column, justify="right" if column else "left")
    for (name, triad), figures in rows.items():
        factor, unit_name = (1.0, "m/s2") if triad == "accel" else (math.degrees(1.0), "deg/s")
        middle, high = factor * np.percentile(figures, (50, 90), axis=0)
        cells = [f"{a:.3f} / {b:.3f}" for a, b in zip(middle, high, strict=True)]
        table.add_row(f"{name} {triad}", *cells, unit_name)
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
