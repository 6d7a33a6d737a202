"""Thermal calibration on real recordings: what held-out time says, beside the autopilots' cubics.

Run: python tests/benchmarks/thermal_real.py [--data DIR]

DIR holds the flight recordings (default: ../shared/data/flights beside the project). Three ways to
hold out:

  tenths    every second tenth of the time, predicted by the others, and the others by it
  later     the last four tenths, predicted by the first six: mostly beyond the temperatures seen,
            where every model, the autopilots' too, holds its value at the end of its span
  session   each power-on, predicted by the other ones of the unit

"before" is the RMS about the mean of the rows seen; "ArduPilot" a cubic of T - 35 through means of
0.5 degC of rise, as its learning takes them (AP_InertialSensor_tempcal.cpp); "PX4" a cubic through
all rows, as its script fits it; "ours" what the product fits, its order chosen by the rows seen
alone. The verdict is the product's: it refuses less than 10 degC of span, whatever the fit.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from peers import SHARED_DATA, Floats, require_data
from rich.console import Console
from rich.table import Table
from thermal_recordings import Series, Silent, every_series

from ahrs_service.calibration.thermal.fold_choice import TENTHS, HeldOut, fit_chosen, hold_out
from ahrs_service.calibration.thermal.rows import ThermalRows
from ahrs_service.calibration.thermal.smooth import Axes, fit_curves, fit_smooth
from ahrs_service.calibration.thermal.smooth_drift import Structure
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


@dataclass(frozen=True)
class Result:
    """One way to hold out rows of one series: what each model leaves of them, None if it cannot."""

    series: Series
    split: str
    held: dict[str, HeldOut | None]

    @property
    def span_degc(self) -> float:
        """Temperature from the lowest to the highest."""
        return float(np.ptp(self.series.rows.temperature_degc))

    def against(self, other: str) -> tuple[float, float] | None:
        """Log ratio of our RMS to that of another model, or of `before`, and its standard error."""
        ours, theirs = self.held["ours"], self.held["ours" if other == "before" else other]
        if ours is None or theirs is None:
            return None
        return log_ratio(ours.after, theirs.before if other == "before" else theirs.after)

    def cells(self) -> list[str]:
        """The row of the table."""
        series, ours = self.series, self.held["ours"]
        assert ours is not None
        low, high = series.rows.span_degc
        refused = span_finding(series.rows.span_degc).level is Level.REFUSAL
        ratio = self.against("PX4")
        return [
            series.name,
            series.triad,
            series.unit,
            f"{low:.1f}..{high:.1f}",
            self.split,
            per_axis(ours.before, series.scale),
            per_axis(ours.after, series.scale),
            f"{ours.rms()[0] / series.scale:.3f}",
            *("-" if x is None else f"{x.rms()[1] / series.scale:.3f}" for x in self.held.values()),
            "-" if ratio is None else f"{np.exp(ratio[0]):.2f} ±{ratio[1]:.2f}",
            "refused" if refused else "use",
        ]


def log_ratio(ours: Floats, theirs: Floats) -> tuple[float, float]:
    """Log ratio of two RMS of the same rows, and its standard error.

    By the jackknife over tenths of the time (Efron and Tibshirani, An Introduction to the
    Bootstrap, ch. 11): the models err alike, and so do neighbours in time.
    """
    tenth = np.arange(len(ours)) * TENTHS // len(ours)
    squares = [
        np.array([(rest[tenth == n] ** 2).sum() for n in np.unique(tenth)])
        for rest in (ours, theirs)
    ]
    whole, *parts = (
        0.5 * np.log((squares[0].sum() - out[0]) / (squares[1].sum() - out[1]))
        for out in [(0.0, 0.0), *zip(*squares, strict=True)]
    )
    count = len(parts)
    return float(whole), float(np.std(parts) * np.sqrt(count - 1.0))


def per_axis(rest: Floats, scale: float) -> str:
    """RMS of x, y, z in the unit shown."""
    return " ".join(f"{x / scale:.2f}" for x in np.sqrt(np.mean(rest**2, axis=0)))


def summary(results: list[Result], console: Console) -> None:
    """Print how often and by how much ours is better than the cubics, by way to hold out."""
    for split, least_k in (
        ("tenths", NOTHING_K),
        ("tenths", SMALLEST_SPAN_K),
        ("later", NOTHING_K),
        ("session", NOTHING_K),
    ):
        console.print(f"{split}, spans of {least_k:g} degC or more:")
        chosen = [one for one in results if one.split == split and one.span_degc >= least_k]
        for other in ("before", "ArduPilot", "PX4"):
            pairs = [pair for pair in (one.against(other) for one in chosen) if pair is not None]
            if not pairs:
                continue
            ratios, errors = np.array(pairs).T
            mean, error = ratios.mean(), np.sqrt(np.sum(errors**2)) / len(pairs)
            console.print(
                f"  ours / {other:9} geometric mean {np.exp(mean):.3f} ±{error:.3f}; better in "
                f"{(ratios < 0.0).sum()} of {len(pairs)}; told apart (2 sigma): better "
                f"{(ratios < -2.0 * errors).sum()}, worse {(ratios > 2.0 * errors).sum()}"
            )


def main() -> int:
    """Read all recordings, print the table and what it comes to."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA / "flights", metavar="DIR")
    data = require_data(parser.parse_args().data, "the flight recordings")
    console = Console(width=185)
    table = Table(title="RMS of held-out rows")
    for head in ("recording", "triad", "unit", "degC", "held out", "before x y z", "ours x y z"):
        table.add_column(head, no_wrap=True)
    for head in ("before", *MODELS, "ours / PX4", "verdict"):
        table.add_column(head, justify="right")
    results: list[Result] = []
    remarks = []
    for series in every_series(data):
        if isinstance(series, Silent):
            remarks.append(f"{series.name}: {series.reason}")
            continue
        zero = float(np.median(series.rows.temperature_degc))
        for split, part in splits(series.rows):
            held = {name: hold_out(series.rows, zero, fit, part) for name, fit in MODELS.items()}
            results.append(Result(series, split, held))
            table.add_row(*results[-1].cells())
        lag = fit_smooth(series.rows, zero).lag
        if lag.is_reported:
            remarks.append(f"{series.name} {series.triad}: a lag of {lag.lag_s:.0f} s is told")
    console.print(table)
    console.print("recordings that say nothing, and lags that were told:")
    for text in remarks:
        console.print(f"  {text}", soft_wrap=True)
    summary(results, console)
    return 0


if __name__ == "__main__":
    sys.exit(main())
