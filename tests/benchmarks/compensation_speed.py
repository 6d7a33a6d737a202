"""Time of the compensation per sample, for each model of the sensor.

Run: python tests/benchmarks/compensation_speed.py [--samples 200000] [--repeats 9]

CPU time of the one thread, median of the repeats, all models in turn in each repeat, so that the
rows of one run can be compared. "alone": the kernel that turns raw samples into compensated ones,
thermometer's lag included. "in the step": what it adds to `pipeline.batch` (velocity mode, six
axes, 200 Hz) over a sensor without calibration. Temperatures sweep -45..75 degC, over all 22
segments of 5 degC and beyond them.
"""

import argparse
import sys
from dataclasses import replace
from typing import Any

import numpy as np
from kernel_speed import flight_samples, medians
from rich.console import Console
from rich.table import Table

from ahrs_service import pipeline
from ahrs_service.kernel import kernel
from ahrs_service.records import ESTIMATE_DTYPE, Rows, empty
from ahrs_service.sensor.compensation import compensate_sample
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import Calibration, TriadCalibration, coefficients
from ahrs_service.settings import Settings

BORDERS = np.linspace(-40.0, 70.0, 23)
LIMIT_NS = 300.0


def calibrations() -> dict[str, Calibration]:
    """A calibration of every model, each with plausible figures."""
    rng = np.random.default_rng(1)
    steps9 = Curve.steps(BORDERS, rng.normal(0.0, 1e-3, (22, 9)))
    steps3 = Curve.steps(BORDERS, rng.normal(0.0, 1e-2, (22, 3)))
    lines9 = Curve.linear(BORDERS, rng.normal(0.0, 1e-3, (23, 9)))
    a, b, c = (Curve.linear(BORDERS, rng.normal(0.0, s, (23, 3))) for s in (1e-5, 1e-3, 1e-2))
    cubic9, cubic3 = (
        Curve.through(BORDERS, lambda t, n=n: 1e-3 * np.sin(t[:, None] / 30.0 + np.arange(n)))
        for n in (9, 3)
    )
    g = ((1e-4, 0.0, 0.0), (0.0, 1e-4, 0.0), (0.0, 0.0, 1e-4))
    full = TriadCalibration(a=cubic3, b=cubic3, c=cubic3, matrix_drift=cubic9)

    def both(triad: TriadCalibration) -> Calibration:
        return Calibration(gyro=triad, accel=triad)

    return {
        "none": Calibration.ideal(),
        "matrix and bias alone": both(TriadCalibration(bias=(0.01, 0.0, 0.0))),
        "conventional, steps": both(TriadCalibration(matrix_drift=steps9, c=steps3)),
        "conventional, lines": both(TriadCalibration(matrix_drift=lines9, c=c)),
        "improved": both(TriadCalibration(a=a, b=b, c=c)),
        "smooth (cubics of bias and matrix)": both(TriadCalibration(matrix_drift=cubic9, c=cubic3)),
        "all of it, g-sensitivity, both lags": Calibration(
            gyro=replace(full, g_sensitivity=g, thermal_lag_s=30.0),
            accel=replace(full, thermal_lag_s=-20.0),
        ),
    }


@kernel
def compensate_all(known: Rows, state: Rows, samples: Rows) -> int:
    """Compensate `samples` [N] one after the other, as the step does."""
    flags = 0
    for n in range(samples.shape[0]):
        flags |= compensate_sample(known[0], state[0], samples[n])
    return flags


def main() -> int:
    """Print the table; return 1 where a model takes longer than it may."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--repeats", type=int, default=9)
    args = parser.parse_args()
    samples = flight_samples(args.samples, 200.0, everything=False)
    samples["temperature_degc"] = np.linspace(-45.0, 75.0, len(samples))
    estimates, parameters = empty(ESTIMATE_DTYPE, len(samples)), pipeline.parameters(Settings())
    models = {name: coefficients(one) for name, one in calibrations().items()}
    alone: dict[str, Any] = {
        name: lambda rows=rows: compensate_all(rows, pipeline.new_state(), samples)
        for name, rows in models.items()
    }
    whole: dict[str, Any] = {
        name: lambda rows=rows: pipeline.batch(
            parameters, rows, pipeline.new_state(), samples, estimates
        )
        for name, rows in models.items()
    }
    alone_s = medians(alone, args.repeats, len(samples))
    whole_s = medians(whole, args.repeats, len(samples))
    table = Table(title="Compensation [ns per sample]", title_justify="left", show_edge=False)
    for name in ("model", "alone", "in the step", "the whole step"):
        table.add_column(name, justify="left" if name == "model" else "right")
    for name in models:
        added = 1e9 * (whole_s[name] - whole_s["none"])
        table.add_row(
            name, f"{1e9 * alone_s[name]:.0f}", f"{added:+.0f}", f"{1e9 * whole_s[name]:.0f}"
        )
    Console(width=100).print(table)
    return int(max(alone_s.values()) * 1e9 > LIMIT_NS)


if __name__ == "__main__":
    sys.exit(main())
