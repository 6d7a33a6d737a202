"""The recordings that have a temperature, as rows for a thermal fit (see thermal_real.py).

Each recording is read here by what it is: still windows of a bench; quiet seconds of an aircraft
that was handled between them; in flight, the turn that the gyros sum up over ten seconds against
that of the autopilot's attitude, whose tilt hangs on gravity and so does not drift; and the
difference of two IMUs on one board, which move alike, so that what differs is their biases.
"""

import gzip
import io
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation

from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.thermal.pose_groups import joined, still_rows
from ahrs_service.calibration.thermal.rows import ThermalRows
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.errors import CalibrationError
from ahrs_service.links.logs.dataflash_tables import read_tables
from ahrs_service.links.logs.recording_formats import read_recording
from ahrs_service.records import Floats, ImuSource, Kind, Rows

MRAD_S, MILLI_G = 1e-3, 1e-3 * STANDARD_GRAVITY_M_S2
BENCHES = {
    "cuav 11-25": "bench_cuav_2021-11-25_static_warmup_1hz.tlog",
    "cuav 12-08": "bench_cuav_2021-12-08_static_warmup_2hz.tlog",
    "copter 44 min": "bench_copter_2021-11-23_static_44min_1hz.tlog",
    "matek": "bench_matekh743_2021_isbd2khz_warmup.bin",
    "cuav bin": "bench_cuavv5_2021-12-08.bin",
    "swarm": "copter_swarm_2021-12-02_three_sessions_time_jumps.tlog",
    "rov": "rov_bluerov2_2023-05-04_warmup_att20hz.tlog",
}
FLIGHTS = {
    "log0036": "copter_pixhawk_log0036_crash_temp.bin",
    "log0039": "copter_pixhawk_log0039_temp.bin",
    "cuav mission": "copter_cuav_2021-12-02_mission_1hz.tlog",
    "swarm flight": BENCHES["swarm"],
}
ATTITUDES = {
    "log0036": FLIGHTS["log0036"],
    "log0039": FLIGHTS["log0039"],
    "rov": BENCHES["rov"],
}
CHAMBER = "bench_iim42652_accel_cold_chamber.csv.gz"
SOLAR = "solar_dawn3_fixedwing_px4_csv.zip"

_FIRST = {ImuSource.RAW_IMU: 1, ImuSource.DATAFLASH: 1, ImuSource.SCALED_IMU2: 2}
ATTITUDE_S = 10.0
LEAST_ROWS = 10
_CHAMBER_ROW = 100
_QUIET = 3.0
_SLOW_RAD_S = 4e-3
_AROUND = 61
LARGEST_NOISE = {"gyro": 0.03, "accel": 0.3}
"""Two IMUs that differ by more than this have not been sampled at like instants [SI]."""


@dataclass(frozen=True)
class Series:
    """Rows of one triad of one recording; `unit` what its figures are printed in."""

    name: str
    triad: str
    rows: ThermalRows
    unit: str
    scale: float


@dataclass(frozen=True)
class Silent:
    """A recording that gives no rows, and why."""

    name: str
    reason: str


def every_series(data: Path) -> Iterator[Series | Silent]:
    """Read all recordings that are in the folder."""
    for name, file in BENCHES.items():
        if (data / file).is_file():
            for imu, sessions in _imus(data / file):
                yield from _still(f"{name} {imu}", sessions)
    if (data / CHAMBER).is_file():
        yield _chamber(data / CHAMBER)
    if (data / SOLAR).is_file():
        for number in (0, 1):
            yield from _solar(data / SOLAR, number)
    for name, file in ATTITUDES.items():
        if (data / file).is_file():
            yield from _against_attitude(name, data / file)
    for name, file in FLIGHTS.items():
        if (data / file).is_file():
            yield from _difference(name, _imus(data / file))


def _imus(path: Path) -> list[tuple[str, list[ImuColumns]]]:
    """The IMUs of a log, each as its sessions: the clock of a log may jump back."""
    if path.suffix == ".bin":
        return _dataflash_imus(path)
    readings = read_recording(path).readings
    readings = readings[readings["kind"] == Kind.IMU]
    found = []
    for source in (ImuSource.RAW_IMU, ImuSource.SCALED_IMU2):
        rows = readings[readings["source"] == source]
        if not len(rows):
            continue
        # Both count from the autopilot's start: one origin keeps like instants alike.
        time = (rows["time_ns"] - readings["time_ns"][0]) * 1e-9
        cuts = np.flatnonzero(np.diff(time) < 0.0) + 1
        columns = [
            ImuColumns(t, r["gyro_rad_s"], r["accel_m_s2"], r["temperature_degc"])
            for t, r in zip(np.split(time, cuts), np.split(rows, cuts), strict=True)
        ]
        found.append((f"IMU{_FIRST[source]}", columns))
    return found


def _dataflash_imus(path: Path) -> list[tuple[str, list[ImuColumns]]]:
    log = read_tables(path)
    found = []
    for number in (0, 1):
        name = "IMU" if number == 0 or "IMU2" not in log.counts() else "IMU2"
        table = log.table(name)
        if "I" in (table.dtype.names or ()):
            table = table[table["I"] == number]
        columns = {
            field: log.column(table, name, field)
            for field in (table.dtype.names or ())
            if field not in ("I",)
        }
        temperature = columns["T"] if "T" in columns else columns["Temp"]
        gyro, accel = (
            np.stack([columns[f"{kind}{axis}"] for axis in "XYZ"], axis=1)
            for kind in ("Gyr", "Acc")
        )
        time = (columns["TimeUS"] - columns["TimeUS"][0]) * 1e-6
        found.append((f"IMU{number + 1}", [ImuColumns(time, gyro, accel, temperature)]))
    return found


def _still(name: str, sessions: list[ImuColumns]) -> Iterator[Series | Silent]:
    parts, reason = [], "has no sample"
    for number, columns in enumerate(sessions):
        try:
            parts.append(still_rows(columns, number))
        except CalibrationError as error:
            reason = str(error)
    count = sum(len(gyro) for gyro, _ in parts)
    if count < LEAST_ROWS:
        yield Silent(name, reason if not parts else f"only {count} still windows")
        return
    for triad, unit, scale, k in (("gyro", "mrad/s", MRAD_S, 0), ("accel", "mg", MILLI_G, 1)):
        # The autopilot zeroes its gyros when it starts, so a session has its own level.
        rows = joined([part[k] for part in parts], same_levels=False)
        yield Series(name, triad, rows, unit, scale)


def _chamber(path: Path) -> Series:
    """Mean rows of the chamber file: it has no times, so a sample counts as a second."""
    with gzip.open(path, "rt") as file:
        values = np.loadtxt(file, delimiter=",")
    count = len(values) // _CHAMBER_ROW
    means = values[: count * _CHAMBER_ROW].reshape(count, _CHAMBER_ROW, -1).mean(axis=1)
    zero = np.zeros(count, np.int64)
    time = np.arange(count) * float(_CHAMBER_ROW)
    rows = ThermalRows(time, means[:, 4], means[:, 1:4] * MILLI_G, zero, zero)
    return Series("iim42652", "accel", rows, "mg", MILLI_G)


def _solar(path: Path, number: int) -> Iterator[Series]:
    """Quiet seconds of the aircraft on the ground: means over a second and their variances."""
    with zipfile.ZipFile(path) as bundle:
        text = io.TextIOWrapper(bundle.open(f"flight3_vehicle_imu_status_{number}.csv"))
        table = np.genfromtxt(text, delimiter=",", names=True, deletechars="")
    gyro, accel, spread, shake = (
        np.stack([table[f"{name}[{axis}]"] for axis in range(3)], axis=1)
        for name in ("mean_gyro", "mean_accel", "var_gyro", "var_accel")
    )
    quiet = np.ones(len(table), np.bool_)
    for variance in (spread.sum(axis=1), shake.sum(axis=1)):
        quiet &= variance < _QUIET * np.quantile(variance, 0.1)
    time, temperature = table["timestamp"] * 1e-6, table["temperature_accel"]
    columns = ImuColumns(time, gyro, accel, temperature)
    keep = np.flatnonzero(quiet & np.isfinite(temperature))
    # Someone turns a 4 m aircraft slowly: its seconds are quiet, but off those around them.
    around = median_filter(gyro[keep], size=(_AROUND, 1), mode="nearest")
    keep = keep[(np.abs(gyro[keep] - around) < _SLOW_RAD_S).all(axis=1)]
    level = np.zeros(len(keep), np.int64)
    rows = ThermalRows(time[keep], temperature[keep], columns.gyro_rad_s[keep], level, level)
    yield Series(f"solar IMU{number + 1}", "gyro", rows, "mrad/s", MRAD_S)


def _against_attitude(name: str, path: Path) -> Iterator[Series | Silent]:
    """Gyro bias in windows of ATTITUDE_S: what the gyros turned more than the attitude did."""
    recording = read_recording(path)
    reference = recording.references[0]
    imu = recording.readings[recording.readings["kind"] == Kind.IMU]
    source = min(set(imu["source"].tolist()) & set(_FIRST), key=lambda one: _FIRST[ImuSource(one)])
    imu = imu[imu["source"] == source]
    imu = imu[np.isfinite(imu["temperature_degc"])]
    start = max(imu["time_ns"][0], reference.time_ns[0])
    stop = min(imu["time_ns"][-1], reference.time_ns[-1])
    edges = np.arange(start, stop, round(ATTITUDE_S * 1e9))
    attitude = reference.ned_from_body[np.searchsorted(reference.time_ns, edges)]
    at = reference.time_ns[np.searchsorted(reference.time_ns, edges)]
    biases, temperatures = [], []
    for n in range(len(edges) - 1):
        own = (imu["time_ns"] >= at[n]) & (imu["time_ns"] < at[n + 1])
        turned = _turn(imu[own], at[n], at[n + 1])
        told = Rotation.from_quat(attitude[n : n + 2], scalar_first=True)
        difference = (told[0].inv() * told[1]).inv() * turned
        biases.append(difference.as_rotvec() / ((at[n + 1] - at[n]) * 1e-9))
        temperatures.append(imu["temperature_degc"][own].mean())
    zero = np.zeros(len(biases), np.int64)
    rows = ThermalRows(edges[:-1] * 1e-9, np.array(temperatures), np.array(biases), zero, zero)
    yield Series(f"{name} by attitude", "gyro", rows, "mrad/s", MRAD_S)


def _turn(imu: Rows, start_ns: int, stop_ns: int) -> Rotation:
    """Return the turn from `start_ns` to `stop_ns` by rates held from one sample to the next."""
    times = np.concatenate([[start_ns], imu["time_ns"][1:], [stop_ns]])
    turn = Rotation.identity()
    for rate, step_ns in zip(imu["gyro_rad_s"], np.diff(times), strict=True):
        turn = turn * Rotation.from_rotvec(rate * step_ns * 1e-9)
    return turn


def _difference(name: str, imus: list[tuple[str, list[ImuColumns]]]) -> Iterator[Series | Silent]:
    """The first IMU's output minus the second's, over windows of a second, all of the flight."""
    (_, (first, *_)), (_, (second, *_)) = imus
    size = max(1, round(1.0 / first.interval_s))
    time, temperature = (_means(x, size) for x in (first.time_s, first.temperature_degc))
    keep = np.isfinite(temperature)
    zero = np.zeros(int(keep.sum()), np.int64)
    for triad, field, unit, scale in (
        ("gyro", "gyro_rad_s", "mrad/s", MRAD_S),
        ("accel", "accel_m_s2", "mg", MILLI_G),
    ):
        other = [
            np.interp(first.time_s, second.time_s, column) for column in getattr(second, field).T
        ]
        difference = _means(getattr(first, field) - np.stack(other, axis=1), size)
        noise = float(np.median(np.abs(difference - np.median(difference, axis=0))))
        if noise > LARGEST_NOISE[triad]:
            reason = f"its IMUs are not sampled together: their {triad}s differ by {noise:.2g} SI"
            yield Silent(f"{name} IMU1-IMU2", reason)
            return
        rows = ThermalRows(time[keep], temperature[keep], difference[keep], zero, zero)
        yield Series(f"{name} IMU1-IMU2", triad, rows, unit, scale)


def _means(values: Floats, size: int) -> Floats:
    count = len(values) // size
    mean: Floats = values[: count * size].reshape(count, size, *values.shape[1:]).mean(axis=1)
    return mean
