"""The paper's 2.6 deg at 200 deg/s: simulate it, hide the cause, let `diagnose` find it.

Run: python tests/benchmarks/hidden_timing.py [--runs N] [--axis NAME] [--late MS] [--json OUT]

Liu et al., sec. 5, swing their system on a rate table by 80 deg, at up to 200 deg/s, and read an
error of 2.6 deg where the rate is largest; they put it down to unsynchronised sampling of table and
system. Here a table swings about an axis (60 s, TABLES of seed_systems.py); its encoder is the
recorded attitude, and the system stamps its samples 13 ms late (or early). The recording is a .tlog
like any other: nothing in it says so. The sensor's calibration is known, as the paper's was, and
given as the twin.

`named` is what it named first, `also` what else.

"before" is the largest error about the axis of the swing of the estimated attitude against the
encoder, "after" the same with the stamps moved by the offset that diagnose names.
"""

import argparse
import dataclasses
import json
import math
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from seed_systems import TABLE_PROFILE, TABLE_S, TABLES, estimate, largest_errors

from ahrs_service.app.diagnose.command import diagnose_file
from ahrs_service.app.files import config_file
from ahrs_service.app.simulate.command import RECORDED_RATES_HZ, write_tlog
from ahrs_service.diagnosis.result import Diagnosis
from ahrs_service.records import Airframe
from ahrs_service.simulation.imu import Imu
from ahrs_service.simulation.scenario import SCENARIOS, Flight, make_flight

LATE_MS = 13
FINE_HZ, IMU_HZ = 1000.0, 200.0
RATES_HZ = {
    "HEARTBEAT": 1.0,
    "HIGHRES_IMU": IMU_HZ,
    "SCALED_IMU": 10.0,
    "ATTITUDE_QUATERNION": 50.0,
    "LOCAL_POSITION_NED": 50.0,
    "VFR_HUD": RECORDED_RATES_HZ["VFR_HUD"],
}
"""What the table's recording holds: no truth but the encoder."""


@dataclass(frozen=True)
class Hidden:
    """One run: what was named, the offset hidden and found [ms], errors about the axis [deg]."""

    axis: str
    late_ms: float
    seed: int
    named: str
    also: str
    found_ms: float
    sigma_ms: float
    before_deg: float
    after_deg: float


def unsynchronised(name: str, seed: int, late_ms: int, seconds: float = TABLE_S) -> Flight:
    """Return a swing whose sensors are `late_ms` behind the table, at 1000 Hz.

    Each row holds the table's encoder of now, the velocity that it gives the sensor's place, and
    what the IMU gave `late_ms` ago.
    """
    # The autopilot filters before it decimates: the noise is that of the slower samples.
    imu, share = SCENARIOS[name].imu, math.sqrt(IMU_HZ / FINE_HZ)
    imu = replace(
        imu,
        gyro_noise=replace(imu.gyro_noise, density=share * imu.gyro_noise.density),
        accel_noise=replace(imu.accel_noise, density=share * imu.accel_noise.density),
    )
    flight = make_flight(name, seconds, seed, FINE_HZ, imu)
    rows = flight.rows.copy()
    rows["estimate_ned_from_body"] = rows["ned_from_body"]
    taken = np.clip(np.arange(len(rows)) - late_ms, 0, len(rows) - 1)
    for field in ("gyro_rad_s", "accel_m_s2", "imu_degc"):
        rows[field] = flight.rows[field][taken]
    return replace(flight, rows=rows)


def diagnosed(flight: Flight, folder: Path) -> Diagnosis:
    """Return what diagnose says of the flight's .tlog with the sensor's calibration known."""
    path = folder / "table.tlog"
    write_tlog(path, flight, RATES_HZ)
    return diagnose_file(path, Imu(calibration=flight.calibration), Console(quiet=True))


def offset_of(diagnosis: Diagnosis) -> tuple[float, float]:
    """Return the time offset named and its sigma [s], 0 where none was."""
    for finding in diagnosis.findings:
        if finding.effect == "imu_time_offset":
            offset = finding.parameters["offset_s"]
            return float(offset.value), float(offset.std)
    return 0.0, math.nan


def hide(axis: str, seed: int, late_ms: int, seconds: float = TABLE_S) -> Hidden:
    """Hide an offset, diagnose, and mend the stamps by what was found."""
    flight = unsynchronised(TABLES[axis], seed, late_ms, seconds)
    with tempfile.TemporaryDirectory() as folder:
        diagnosis = diagnosed(flight, Path(folder))
    found_s, sigma_s = offset_of(diagnosis)
    step = round(FINE_HZ / IMU_HZ)
    slow = replace(flight, rows=flight.rows[::step], rate_hz=IMU_HZ)
    settings = config_file.load(profile=TABLE_PROFILE)
    estimates = estimate(slow, Airframe.OTHER, settings, flight.calibration)
    before, after = (largest_errors(slow, estimates, late_s)[0] for late_s in (0.0, found_s))
    first, *others = [finding.effect for finding in diagnosis.findings] or ["nothing"]
    also = ", ".join(others) or "-"
    found_ms, sigma_ms = 1e3 * found_s, 1e3 * sigma_s
    return Hidden(axis, float(late_ms), seed, first, also, found_ms, sigma_ms, before, after)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--axis", choices=[*TABLES], help="one axis only")
    parser.add_argument("--late", type=int, metavar="MS", help="one offset only")
    parser.add_argument("--seconds", type=float, default=TABLE_S)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    table = Table(title="table and system 13 ms apart, the cause hidden", title_justify="left")
    for field in dataclasses.fields(Hidden):
        table.add_column(field.name.replace("_", " "), justify="right")
    results = []
    for axis in [arguments.axis] if arguments.axis else TABLES:
        for late_ms in (LATE_MS, -LATE_MS) if arguments.late is None else (arguments.late,):
            for seed in range(1, arguments.runs + 1):
                results.append(hide(axis, seed, late_ms, arguments.seconds))
                print(results[-1], flush=True)
                table.add_row(*(_cell(value) for value in asdict(results[-1]).values()))
    Console(width=140).print(table)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps([asdict(one) for one in results], indent=1))


def _cell(value: object) -> str:
    return f"{value:.2f}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
