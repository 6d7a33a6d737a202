"""Conventional, improved and smooth thermal calibration on the paper's benches, simulated.

Run: python tests/benchmarks/thermal_calibration.py [--seeds 10] [--figure FILE.png]

Each seed is another unit and another bench (paper.chamber): parts whose drift has
forms that no calibration fits, sized by data sheets; three mountings in the chamber, each turned by
up to 1.5 degrees about each axis; a lag of up to 30 s between thermometer and elements, either way;
noise, steps of the outputs, and a bias that differs from run to run by 0.3 mg and 0.01 deg/s. All
methods get the same chamber run, heating and cooling at 1 degC a minute. Judged by a run of its
own: 3 degC a minute, attitudes and rates of its own, over -40..70 degC; the residual counted is the
largest of all, as in the paper. A mounting turned by 1.5 degrees makes g sin 1.5 = 26 mg by itself.

"cubic of the bias" is what ArduPilot and PX4 fit, in one position, scale taken as constant. The
paper (Liu et al., sec. 2.2.2): 30 mg with the conventional model, 5 mg with the improved one.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from paper.comparison import METHODS, Bench, calibrate_bench, residuals
from paper.residual_figure import draw_residuals
from peers import Floats
from rich.console import Console
from rich.progress import track
from rich.table import Table

from ahrs_service.constants import STANDARD_GRAVITY_M_S2

MILLI_G = 1e-3 * STANDARD_GRAVITY_M_S2
TARGETS_MG = {
    "conventional, jumping": (20.0, 40.0),
    "improved": (0.0, 5.0),
    "smooth": (0.0, 2.0),
}
DRAWN = ("conventional, jumping", "improved", "smooth")
PAPER_MG = {"conventional, jumping": "30", "improved, jumping": "5"}


def largest(bench: Bench) -> dict[str, tuple[Floats, Floats]]:
    """Largest residuals [3] by method: accelerometers [mg], gyros [deg/s]."""
    found = {}
    for method in METHODS:
        rate, force = residuals(bench.calibrations[method], bench.validation)
        found[method] = (
            np.abs(force).max(axis=0) / MILLI_G,
            np.degrees(np.abs(rate).max(axis=0)),
        )
    return found


def print_tables(figures: list[dict[str, tuple[Floats, Floats]]], console: Console) -> None:
    """Print for each triad the median over the seeds per axis, and the worst of all."""
    for n, (triad, digits) in enumerate((("accelerometer, mg", 2), ("gyro, deg/s", 3))):
        table = Table(title=f"{triad}: largest residual over -40..70 degC, {len(figures)} units")
        for head in ("method", "x", "y", "z", "largest axis", "worst unit", "paper"):
            table.add_column(head, justify="left" if head == "method" else "right")
        for method in METHODS:
            axes = np.array([one[method][n] for one in figures])
            cells = [*np.median(axes, axis=0), np.median(axes.max(axis=1)), axes.max()]
            paper = PAPER_MG.get(method, "") if n == 0 else ""
            table.add_row(method, *(f"{cell:.{digits}f}" for cell in cells), paper)
        console.print(table)


def print_targets(figures: list[dict[str, tuple[Floats, Floats]]], console: Console) -> None:
    """Print how many units lie where they are to lie."""
    for method, (low, high) in TARGETS_MG.items():
        inside = sum(low <= one[method][0].max() <= high for one in figures)
        console.print(f"{method}: {low:g} to {high:g} mg in {inside} of {len(figures)} units")


def print_lags(benches: list[Bench], console: Console) -> None:
    """Print how far the lags found lie from the true ones."""
    for name in ("gyro", "accel"):
        fits = [getattr(bench, f"{name}_fit").lag for bench in benches]
        off = [lag.lag_s - bench.true_lag_s for lag, bench in zip(fits, benches, strict=True)]
        inside = sum(
            lag.low_s <= bench.true_lag_s <= lag.high_s
            for lag, bench in zip(fits, benches, strict=True)
        )
        console.print(
            f"{name}: lag found to {np.sqrt(np.mean(np.square(off))):.2f} s (RMS), the true one in "
            f"the 95 % interval for {inside} of {len(fits)} units"
        )


def draw(path: Path, bench: Bench, seed: int) -> None:
    """Draw the accelerometer's residuals of one unit."""
    forces = {m: residuals(bench.calibrations[m], bench.validation)[1] / MILLI_G for m in DRAWN}
    title = f"accelerometer after thermal calibration, unit {seed}: an independent run"
    draw_residuals(path, title, "mg", bench.validation.temperature_degc, forces, near=6.0)


def main() -> int:
    """Calibrate all units and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10, metavar="N", help="units (default: 10)")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw the first unit")
    arguments = parser.parse_args()
    console = Console(width=110)
    benches = [calibrate_bench(seed) for seed in track(range(arguments.seeds), console=console)]
    figures = [largest(bench) for bench in benches]
    print_tables(figures, console)
    print_targets(figures, console)
    print_lags(benches, console)
    if arguments.figure is not None:
        draw(arguments.figure, benches[0], 0)
        console.print(f"wrote {arguments.figure}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
