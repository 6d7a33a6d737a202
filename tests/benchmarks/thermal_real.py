"""Thermal calibration on real recordings: what held-out time says, beside the autopilots' cubics.

Run: python tests/benchmarks/thermal_real.py [--data DIR]

DIR holds the flight recordings (default: ../shared/data/flights beside the project). Three ways to
hold out:

  tenths    every second tenth of the time, foretold by the others, and the others by it
  later     the last four tenths, foretold by the first six: mostly beyond the temperatures seen,
            where every model, the autopilots' too, holds its value at the end of its span
  session   each power-on, foretold by the other ones of the unit

"before" is the RMS about the mean of the rows seen; "ArduPilot" a cubic of T - 35 through means of
0.5 degC of rise, as its learning takes them (AP_InertialSensor_tempcal.cpp); "PX4" a cubic through
all rows, as its script fits it; "ours" what the product fits, its order chosen by the rows seen
alone. The verdict is the product's: it refuses less than 10 degC of span, whatever the fit.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from peers import SHARED_DATA, Floats, require_data
from rich.console import Console
from rich.table import Table
from thermal_recordings import Series, Silent, every_series

from ahrs_service.calibration.held_out import fit_chosen, hold_out
from ahrs_service.calibration.smooth_drift import Structure
from ahrs_service.calibration.smooth_thermal import Axes, fit_curves, fit_smooth
from ahrs_service.calibration.thermal_rows import ThermalRows
from ahrs_service.calibration.verdict import SMALLEST_SPAN_K, Level, span_finding

CUBIC = (Structure(bias=(3, 1)),) * 3
RISE_DEGC = 0.5
NOTHING_K = 1.0
LATER = 0.6


def px4_cubic(rows: ThermalRows, zero_degc: float) -> tuple[Axes, float] | None:
    """A cubic through all rows; None where they are too few."""
    if len(rows) < 4 + rows.levels:
        return None
    return fit_curves(rows, CUBIC, zero_degc)[0], 0.0


def ardupilot_cubic(rows: ThermalRows, zero_degc: float) -> tuple[Axes, float] | None:
    """A cubic through means over each rise of half a degree; None where there are too few."""
    means = rising_means(rows)
    if len(means) < 4 + means.levels:
        return None
    return fit_curves(means, CUBIC, float(np.clip(zero_degc, *means.span_degc)))[0], 0.0


def rising_means(rows: ThermalRows) -> ThermalRows:
    """Mean rows as ArduPilot's learning takes them: one whenever it has got RISE_DEGC warmer."""
    picked: list[tuple[float, float, Floats, int, int]] = []
    for session in np.unique(rows.session):
        for level in np.unique(rows.level[rows.session == session]):
            own = np.flatnonzero((rows.session == session) & (rows.level == level))
            last, first = float(rows.temperature_degc[own[0]]), 0
            for n, row in enumerate(own):
                now = float(rows.temperature_degc[row])
                if now - last >= RISE_DEGC:
                    mean = rows.output[own[first : n + 1]].mean(axis=0)
                    picked.append(
                        (float(rows.time_s[row]), 0.5 * (now + last), mean, level, session)
                    )
                    last, first = now, n + 1
    if not picked:
        return rows.part(slice(0, 1))
    time, temperature, output, level, session = zip(*picked, strict=True)
    return ThermalRows(
        np.array(time), np.array(temperature), np.array(output), np.array(level), np.array(session)
    ).part(slice(None))


MODELS = {"ArduPilot": ardupilot_cubic, "PX4": px4_cubic, "ours": fit_chosen}


def splits(rows: ThermalRows) -> Iterator[tuple[str, Floats | None]]:
    """The ways to hold out that these rows allow."""
    yield "tenths", None
    yield "later", np.where(np.arange(len(rows)) >= LATER * len(rows), 0, -1)
    if len(np.unique(rows.session)) > 1:
        yield "session", rows.session


def describe(series: Series, split: str, part: Floats | None) -> tuple[list[str], dict[str, float]]:
    """The row of the table for one way to hold out, and each model's figure relative to none."""
    rows, scale = series.rows, series.scale
    zero = float(np.median(rows.temperature_degc))
    found = {name: hold_out(rows, zero, fit, part) for name, fit in MODELS.items()}
    ours = found["ours"]
    assert ours is not None
    low, high = rows.span_degc
    level = span_finding(rows.span_degc).level
    cells = [series.name, series.triad, series.unit, f"{low:.1f}..{high:.1f}", split]
    cells.append(per_axis(ours.before, scale))
    cells.append(per_axis(ours.after, scale))
    cells.append(f"{ours.rms()[0] / scale:.3f}")
    for held in found.values():
        cells.append("-" if held is None else f"{held.rms()[1] / scale:.3f}")
    cells.append("refused" if level is Level.REFUSAL else "use")
    figures = {name: held.rms()[1] / held.rms()[0] for name, held in found.items() if held}
    return cells, figures


def per_axis(rest: Floats, scale: float) -> str:
    """RMS of x, y, z in the unit shown."""
    return " ".join(f"{x / scale:.2f}" for x in np.sqrt(np.mean(rest**2, axis=0)))


def summary(rows: list[tuple[str, float, dict[str, float]]], console: Console) -> None:
    """Print how often and by how much ours is better than the cubics, by way to hold out."""
    for split, least_k in (
        ("tenths", NOTHING_K),
        ("tenths", SMALLEST_SPAN_K),
        ("later", NOTHING_K),
        ("session", NOTHING_K),
    ):
        console.print(f"{split}, spans of {least_k:g} degC or more:")
        for other in ("before", "ArduPilot", "PX4"):
            pairs = [
                (figures["ours"], figures.get(other, 1.0))
                for name, span, figures in rows
                if name == split and (other in figures or other == "before") and span >= least_k
            ]
            if not pairs:
                continue
            ratio = np.exp(np.mean(np.log([ours / cubic for ours, cubic in pairs])))
            better = sum(ours < cubic for ours, cubic in pairs)
            within = sum(ours < 1.01 * cubic for ours, cubic in pairs)
            console.print(
                f"  ours / {other:9} geometric mean {ratio:.3f}; better in {better}, "
                f"better or within 1 % in {within} of {len(pairs)}"
            )


def main() -> int:
    """Read all recordings, print the table and what it comes to."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA / "flights", metavar="DIR")
    data = require_data(parser.parse_args().data, "the flight recordings")
    console = Console(width=170)
    table = Table(title="RMS of held-out rows")
    for head in ("recording", "triad", "unit", "degC", "held out", "before x y z", "ours x y z"):
        table.add_column(head, no_wrap=True)
    for head in ("before", *MODELS, "verdict"):
        table.add_column(head, justify="right")
    silent, figures = [], []
    for series in every_series(data):
        if isinstance(series, Silent):
            silent.append(series)
            continue
        span = float(np.ptp(series.rows.temperature_degc))
        for split, part in splits(series.rows):
            cells, relative = describe(series, split, part)
            table.add_row(*cells)
            figures.append((split, span, relative))
        lag = fit_smooth(series.rows, float(np.median(series.rows.temperature_degc))).lag
        if lag.is_told:
            silent.append(Silent(f"{series.name} {series.triad}", f"lag {lag.lag_s:.0f} s told"))
    console.print(table)
    console.print("recordings that say nothing, and lags that were told:")
    for one in silent:
        console.print(f"  {one.name}: {one.reason}", soft_wrap=True)
    summary(figures, console)
    return 0


if __name__ == "__main__":
    sys.exit(main())
