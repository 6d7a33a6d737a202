"""What the uncertainty that a calibration tells is worth to the filter, on simulated flights.

Run: python tests/benchmarks/calibration_prior.py [--flights 8] [--seconds 400]

Each flight has a sensor of its own, drawn about the consumer's: it warms from 0 to 45 degC with a
time constant of 120 s. Its calibration errs by a smooth curve of RMS `LEFT` over temperature and by
a turn-on bias of RMS `TURN_ON`, both drawn anew for each flight; the filter flies six axes without
magnetometer, airspeed or GPS. Three filters see the same samples:

- raw: no calibration;
- calibrated: the calibration, the settings' own doubts about the gyro bias;
- with prior: the same with the residual and the turn-on sigma that the calibration tells.

Printed is, over all flights after the alignment: the RMS of tilt and of the heading's drift over
60 s [deg], the RMS error of the estimated gyro bias [deg/s], and the mean square of that error over
its own variance per axis (1 is consistent, above is overconfident), once with rest before the
take-off, as every flight has it, and once started in the air.
"""

import argparse
import sys
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table

from ahrs_service.estimator import Estimator
from ahrs_service.records import (
    SAMPLE_DTYPE,
    Airframe,
    Floats,
    ImuSource,
    Rows,
    empty,
)
from ahrs_service.rotation import euler_columns
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import Calibration
from ahrs_service.sensor.provenance import Uncertainty
from ahrs_service.settings import Settings
from ahrs_service.simulation.imu import consumer_grade
from ahrs_service.simulation.scenario import make_flight

RATE_HZ = 100.0
LEFT = np.radians(0.02)
TURN_ON = np.radians(0.05)
BORDERS = np.linspace(-10.0, 70.0, 17)
SETTLED_S = 10.0
DRIFT_S = 60.0


def _left_over(rng: np.random.Generator) -> Curve:
    """A smooth curve of three columns whose RMS over temperature is LEFT."""
    phase, wave = rng.uniform(0.0, 2.0 * np.pi, 3), rng.uniform(0.1, 0.3, 3)
    return Curve.through(
        BORDERS, lambda t: np.sqrt(2.0) * LEFT * np.sin(np.multiply.outer(t, wave) + phase)
    )


def _fly(seed: int, seconds: float) -> tuple[Rows, Rows, Calibration, Floats]:
    """Truth, samples, what the calibration says, and the gyro bias [N, 3] that it leaves."""
    rng = np.random.default_rng(seed)
    imu = consumer_grade().sibling(rng)
    rows = make_flight("flight", seconds, seed, RATE_HZ, imu).rows
    degc = 45.0 * (1.0 - np.exp(-rows["time_s"] / 120.0))
    true = imu.calibration
    gyro, accel = imu.measure(rows, degc, RATE_HZ, rng)
    left, turn_on = _left_over(rng), rng.normal(0.0, TURN_ON, 3)
    gyro += left.at(degc) + turn_on
    samples = empty(SAMPLE_DTYPE, len(rows))
    samples["time_ns"] = samples["received_ns"] = np.rint(rows["time_s"] * 1e9)
    samples["gyro_rad_s"], samples["accel_m_s2"] = gyro, accel
    samples["temperature_degc"] = degc
    samples["source"], samples["airframe"] = ImuSource.HIGHRES_IMU, Airframe.FIXED_WING
    return rows, samples, true, left.at(degc) + turn_on


def _calibrations(true: Calibration) -> dict[str, Calibration]:
    known = Uncertainty(bias_residual=(float(LEFT),) * 3, bias_turn_on=(float(TURN_ON),) * 3)
    return {
        "raw": Calibration.ideal(),
        "calibrated": true,
        "with prior": replace(true, gyro=replace(true.gyro, uncertainty=known)),
    }


def _judge(rows: Rows, samples: Rows, known: Calibration, bias: Floats) -> tuple[Floats, ...]:
    """Squares of tilt, heading drift, bias error, and bias error over its variance."""
    estimates = Estimator(Settings(), known).run(samples)
    settled = rows["time_s"] - rows["time_s"][0] > SETTLED_S
    error = euler_columns(estimates["ned_from_body"]) - euler_columns(rows["ned_from_body"])
    error = np.degrees(np.unwrap(error, axis=0))[settled]
    step = round(DRIFT_S * RATE_HZ)
    left = np.degrees(estimates["gyro_bias_rad_s"] - bias)[settled]
    sigma = np.degrees(estimates["gyro_bias_sigma_rad_s"])[settled]
    drift = error[step:, 2] - error[:-step, 2]
    return error[:, :2] ** 2, drift**2, left**2, (left / sigma) ** 2


def main() -> int:
    """Fly and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--flights", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=400.0)
    args = parser.parse_args()
    found: dict[tuple[str, str], list[tuple[float, ...]]] = {}
    for seed in range(1, args.flights + 1):
        rows, samples, true, bias = _fly(seed, args.seconds)
        first = int(np.argmax(rows["airborne"] > 0.5)) + round(30.0 * RATE_HZ)
        for start, begin in (("at rest", 0), ("in the air", first)):
            part = slice(begin, None)
            for name, known in _calibrations(true).items():
                squares = _judge(rows[part], samples[part], known, bias[part])
                means = tuple(float(np.mean(one)) for one in squares)
                found.setdefault((start, name), []).append(means)
    table = Table(title="Worth of the prior", title_justify="left", show_edge=False)
    heads = ("start", "filter", "tilt [deg]", "drift in 60 s [deg]", "bias [deg/s]", "bias NEES")
    for head in heads:
        table.add_column(head, justify="left" if head in heads[:2] else "right")
    for (start, name), means in found.items():
        tilt, drift, left, nees = np.mean(means, axis=0)
        nees_text = "" if name == "raw" else f"{nees:.2f}"
        bias_text = "" if name == "raw" else f"{np.sqrt(left):.4f}"
        table.add_row(
            start, name, f"{np.sqrt(tilt):.2f}", f"{np.sqrt(drift):.2f}", bias_text, nees_text
        )
    Console(width=100).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
