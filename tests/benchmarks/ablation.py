"""What each part of the default mode is worth: the same recordings with one part left out.

Run: python tests/benchmarks/ablation.py [--data DIR] [--json OUT]

DIR holds `flights` and `broad` (default: ../shared/data beside the project). Six axes; per flight
the RMS of roll plus that of pitch against the log's own attitude [deg] (for sitl the truth), for
BROAD the mean inclination [deg] with the profile hand_held. A row is the default with the settings
named changed and nothing else tuned to make up for it.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from broad import read_trial
from flight_recordings import LOGS, read_flight
from peers import SHARED_DATA, inclination, require_data
from rich.console import Console
from rich.table import Table

from ahrs_service.app.estimate.arrays import estimate_columns
from ahrs_service.app.estimate.sample_columns import read_columns
from ahrs_service.app.files import config_file
from ahrs_service.comparison import compare
from ahrs_service.estimator import Estimator
from ahrs_service.settings import Settings

FLIGHTS = (
    *("x8 aerobatics", "thor75", "swiss2", "plane erle"),
    *("quad106", "copter pixhawk", "log0036", "sitl"),
)
CLASSES = ("fixed_wing", "multirotor", "hand_held")
HAND_HELD = [
    *("fusion.airframe=hand_held", "fusion.gyro_sample=mean", "fusion.magnetometer=false"),
    "fusion.gyro_scale_error_rts=0.0005",
]


def _in_all(setting: str) -> list[str]:
    return [f"{name}.{setting}" for name in CLASSES]


ROWS: dict[str, list[str]] = {
    "default": [],
    "without accelerometer bias": _in_all("accel_bias_sigma_m_s2=0.0"),
    "scale neither learnt nor doubted": _in_all("accel_scale_error=0.0"),
    "bias walk without shake": _in_all("shaken_bias_walk_s_m_rts=0.0"),
    "without gyro matrix": _in_all("gyro_matrix_sigma=0.0"),
    "matrix's error as noise": [
        *_in_all("gyro_matrix_sigma=0.0"),
        "fusion.gyro_scale_error_rts=0.005",
    ],
    "without drag": _in_all("drag_s=[0.0,0.0,0.0]"),
    "without bound of climb": _in_all("climb_sigma_m_s=1e6"),
    "without bounds of velocity": [
        *_in_all("velocity_sigma_m_s=[1e4,1e4,1e4]"),
        *_in_all("drag_s=[0.0,0.0,0.0]"),
        *_in_all("climb_sigma_m_s=1e6"),
    ],
    "without gravity in open gates": ["gate.norm_m_s2=1e-9"],
    "gravity always (no gates)": [
        "gate.norm_m_s2=1e9",
        "gate.rate_rad_s=1e9",
        "gate.angular_acceleration_rad_s2=1e9",
        "gate.innovation_sigma=1e9",
    ],
    "without rest": ["fusion.gyro_rest_sigma_rad_s=1e-9"],
    "bias walk 5e-5": ["fusion.gyro_bias_walk_rad_s2_rthz=5e-5"],
    "samples as instants": ["fusion.gyro_sample=instant"],
    "samples as means": ["fusion.gyro_sample=mean"],
    "class other": ["fusion.airframe=other"],
    "gated mode": ["fusion.mode=gated"],
}


def flight_error(flight: Any, settings: Settings) -> float:
    """RMS of roll plus RMS of pitch [deg], six axes."""
    samples = flight.samples.copy()
    for field in ("mag_ut", "airspeed_m_s", "velocity_ned_m_s"):
        samples[field] = np.nan
    estimates = Estimator(settings).run(samples)
    reference = flight.reference
    one = compare(estimates, reference.time_ns, reference.ned_from_body, False)
    return float(np.degrees(one.roll.rms + one.pitch.rms))


def broad_error(trials: list[Any], overrides: list[str]) -> float:
    """Mean inclination RMSE [deg] of the trials."""
    settings = config_file.load(None, [*HAND_HELD, *overrides])
    errors = []
    for trial, columns in trials:
        quat = estimate_columns(columns, settings, "flu")["quat"]
        error = inclination(quat[trial.scored], trial.reference)
        errors.append(float(np.degrees(np.sqrt(np.mean(error * error)))))
    return float(np.mean(errors))


def main() -> int:
    """Run every row and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA, metavar="DIR")
    parser.add_argument("--json", type=Path, metavar="OUT")
    args = parser.parse_args()
    data = require_data(args.data, "the recordings")
    flights = {name: read_flight(name, data / "flights" / LOGS[name]) for name in FLIGHTS}
    paths = sorted((data / "broad").glob("*.npz"))
    trials = [(read_trial(path), read_columns(path)) for path in paths]
    out = Table(padding=(0, 1), show_edge=False)
    out.add_column("RMS roll + pitch [deg]")
    for name in [*FLIGHTS, f"BROAD ({len(trials)})"]:
        out.add_column(name, justify="right")
    results: dict[str, list[float]] = {}
    for row, overrides in ROWS.items():
        settings = config_file.load(None, overrides)
        errors = [flight_error(flight, settings) for flight in flights.values()]
        results[row] = [*errors, broad_error(trials, overrides)]
        out.add_row(row, *(f"{error:.2f}" for error in errors), f"{results[row][-1]:.3f}")
    Console(width=140).print(out)
    if args.json is not None:
        args.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
