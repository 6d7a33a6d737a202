"""A last look: ours and the peers on two flights that no setting was ever chosen by.

Run: python tests/benchmarks/held_out.py [--data DIR] [--no-ahrs]

DIR holds copter_quadoptflow_48hz.zip (849 s of low hover and some flight, text columns) and
solar_dawn3_fixedwing_px4_csv.zip (974 s of a 4 m solar aircraft; gyro 50 Hz, accelerometer 20 Hz
brought to the gyro's instants). The product reads neither format: this script does.
"""

import argparse
import io
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from flight_recordings import Flight
from flights import OURS, measure, table
from peers import PEERS, SHARED_DATA, require_data
from rich.console import Console

from ahrs_service.links.logs.recording import AttitudeReference
from ahrs_service.records import SAMPLE_DTYPE, Airframe, Floats, ImuSource, Rows, empty
from ahrs_service.rotation import quaternion_columns

COPTER = "copter_quadoptflow_48hz.zip"
SOLAR = "solar_dawn3_fixedwing_px4_csv.zip"


def _samples(time_s: Floats, gyro: Floats, accel: Floats, airframe: Airframe) -> Rows:
    samples = empty(SAMPLE_DTYPE, len(time_s))
    samples["time_ns"] = samples["received_ns"] = np.rint(time_s * 1e9).astype(np.int64)
    samples["gyro_rad_s"], samples["accel_m_s2"] = gyro, accel
    samples["source"], samples["airframe"] = ImuSource.HIGHRES_IMU, airframe
    return samples


def _heard(samples: Rows, field: str, time_s: Floats, values: Floats) -> None:
    """Put each value on the first sample after it."""
    place = np.searchsorted(samples["time_ns"], np.rint(time_s * 1e9).astype(np.int64))
    known = place < len(samples)
    samples[field][place[known]] = values[known]


def read_copter(path: Path) -> Flight:
    """Columns of the text files: times [ms], rad/s, m/s^2, deg, m/s."""
    with zipfile.ZipFile(path) as archive:
        imu, att, gps = (np.loadtxt(io.BytesIO(archive.read(name))) for name in FILES)
    samples = _samples(imu[:, 1] * 1e-3, imu[:, 2:5], imu[:, 5:8], Airframe.MULTIROTOR)
    course = np.radians(gps[:, 11])
    velocity = np.stack([gps[:, 10] * np.cos(course), gps[:, 10] * np.sin(course)], axis=1)
    rows = np.column_stack([velocity, np.full(len(gps), np.nan)])
    fixed = gps[:, 1] >= 3.0
    _heard(samples, "velocity_ned_m_s", gps[fixed, 2] * 1e-3, rows[fixed])
    time_ns = np.rint(att[:, 1] * 1e6).astype(np.int64)
    euler = np.radians(att[:, 2:5])
    return Flight(COPTER, samples, AttitudeReference("ATT", time_ns, quaternion_columns(euler)))


FILES = ("IMU.txt", "ATT.txt", "GPS.txt")


def read_solar(path: Path) -> Flight:
    """PX4's topics as .csv: timestamps [us], SI."""
    with zipfile.ZipFile(path) as archive:

        def topic(name: str) -> Any:
            text = io.BytesIO(archive.read(f"flight3_{name}_0.csv"))
            return np.genfromtxt(text, delimiter=",", names=True, deletechars="")

        rate, force = topic("vehicle_angular_velocity"), topic("vehicle_acceleration")
        att, air, gps = topic("vehicle_attitude"), topic("airspeed_validated"), topic("sensor_gps")
    time_s = rate["timestamp"] * 1e-6
    columns = [f"xyz[{i}]" for i in range(3)]
    gyro = np.stack([rate[name] for name in columns], axis=1)
    at_s = force["timestamp"] * 1e-6
    accel = np.stack([np.interp(time_s, at_s, force[name]) for name in columns], axis=1)
    samples = _samples(time_s, gyro, accel, Airframe.FIXED_WING)
    _heard(samples, "airspeed_m_s", air["timestamp"] * 1e-6, air["true_airspeed_m_s"])
    velocity = np.stack([gps[f"vel_{axis}_m_s"] for axis in "ned"], axis=1)
    _heard(samples, "velocity_ned_m_s", gps["timestamp"] * 1e-6, velocity)
    q = np.stack([att[f"q[{i}]"] for i in range(4)], axis=1)
    time_ns = np.rint(att["timestamp"] * 1e3).astype(np.int64)
    return Flight(SOLAR, samples, AttitudeReference("vehicle_attitude", time_ns, q))


def main() -> int:
    """Read both, run all, print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA / "flights", metavar="DIR")
    parser.add_argument("--no-ahrs", action="store_true", help="leave out what is slow")
    args = parser.parse_args()
    data = require_data(args.data, "the flight recordings")
    slow = ("Mahony", "Madgwick") if args.no_ahrs else ("-",)
    names = [*OURS, *(name for name in PEERS if not name.startswith(slow))]
    results = {
        title: measure(read(data / file), names)
        for title, read, file in (
            ("copter, low hover", read_copter, COPTER),
            ("solar aircraft", read_solar, SOLAR),
        )
    }
    out = Console(width=60 + 14 * (len(names) + 3))
    out.print(table("Whole flight", results, names, ""))
    out.print(table("Steady flight", results, names, "steady_"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
