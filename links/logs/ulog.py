"""PX4 ULog (.ulg) recordings."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from ahrs_service.adoption import Vehicle
from ahrs_service.errors import RecordingError
from ahrs_service.links.logs.parameter_values import PX4
from ahrs_service.links.logs.recorded_parameters import ParameterHistory, RecordedParameters
from ahrs_service.links.logs.recording import OWN, AttitudeReference, Log, Recording, own_readings
from ahrs_service.links.logs.ulog_tables import Table, UlogTables, read_tables
from ahrs_service.links.mavlink.gps_velocity import LEAST_FIX
from ahrs_service.records import READING_DTYPE, ImuSource, Kind, Rows, empty

Floats = npt.NDArray[np.float64]

_INVALID_RELATIVE_TIME: Final = 0x7FFFFFFF
_UT_PER_GAUSS: Final = 100.0
_GYRO_NAMES: Final = ("gyro_rad", "gyro_rad_s")
_TEMPERATURES: Final = (
    ("sensor_gyro", "temperature", "gyro_device_id"),
    ("sensor_accel", "temperature", "accel_device_id"),
    ("vehicle_imu_status", "temperature_gyro", "gyro_device_id"),
    ("vehicle_imu_status", "temperature_accel", "accel_device_id"),
)
_GPS: Final = ("vehicle_gps_position", "sensor_gps")
_AIRSPEEDS: Final = (
    ("airspeed_validated", "calibrated_airspeed_m_s"),
    ("airspeed", "indicated_airspeed_m_s"),
    ("airspeed", "true_airspeed_m_s"),
)


class UlogLog(Log):
    """A ULog that was read."""

    def __init__(self, path: Path, tables: UlogTables) -> None:
        self.path, self.tables = path, tables

    def recording(self) -> Recording:
        """Return `sensor_combined` as the IMU, aiding, and the autopilot's attitude.

        ULog has one clock, so `received_ns` equals `time_ns`; readings are in order of time. The
        IMU's temperature is that of the sensor PX4 selected: gyro, else accelerometer, of one
        device. Source: docs.px4.io, ULog file format.
        """
        tables = self.tables
        combined = _table(tables, "sensor_combined")
        if combined is None or _vectors(combined, *_GYRO_NAMES) is None:
            raise RecordingError(_no_imu(self.path, tables))
        temperature = _temperature(tables)
        imu = _imu_readings(combined, _magnetometer(tables, combined), temperature)
        parts = [imu, _airspeed_readings(tables), _gps_readings(tables), _velocity_readings(tables)]
        readings = np.concatenate([part for part in parts if len(part)])
        readings = readings[np.argsort(readings["time_ns"], kind="stable")]
        heartbeat = own_readings(readings["time_ns"][:1], Kind.HEARTBEAT)
        heartbeat["autopilot"] = PX4
        heartbeat["vehicle"] = tables.vehicle
        own = "none of its own in the log" if temperature is None else f"from {temperature.origin}"
        return Recording(
            path=self.path,
            format="ULog",
            readings=np.concatenate([heartbeat, readings]),
            log=self,
            references=_references(tables),
            message_counts=tables.counts,
            damaged=tables.damaged,
            notes=(f"IMU temperature: {own}", *tables.notes),
            units={OWN: tables.unit},
        )

    def parameters(self, vehicle: Vehicle) -> RecordedParameters:
        """Return the values at the start of the log, and those that changed later."""
        del vehicle
        history = ParameterHistory()
        for reported in self.tables.parameters:
            history.take((name, float(value)) for name, value in reported)
        return history.result(PX4)


def open_ulog(path: str | Path, progress: Callable[[float], None] | None = None) -> UlogLog:
    """Read a ULog, once; `progress` is called with the share read, 0 to 1."""
    path = Path(path)
    return UlogLog(path, read_tables(path, progress))


def read_ulog(path: str | Path, progress: Callable[[float], None] | None = None) -> Recording:
    """Read a ULog as input of the pipeline."""
    return open_ulog(path, progress).recording()


@dataclass(frozen=True, slots=True)
class _Temperature:
    time_ns: npt.NDArray[np.int64]
    degc: Floats
    origin: str


def _no_imu(path: Path, tables: UlogTables) -> str:
    has = ", ".join(sorted(tables.counts)[:12]) or "no topic at all"
    return (
        f"{path}: the ULog has no sensor_combined topic with gyro_rad; it has {has}; "
        "log with PX4's default profile (SDLOG_PROFILE bit 0)"
    )


def _table(tables: UlogTables, name: str, instance: int = 0) -> Table | None:
    return tables.topics.get((name, instance))


def _columns(table: Table, names: list[str]) -> Floats | None:
    if any(name not in table for name in names):
        return None
    return np.stack([np.asarray(table[name], np.float64) for name in names], axis=-1)


def _vectors(table: Table, *fields: str) -> Floats | None:
    """Columns field[0..2] [N, 3] of the first of `fields` that the table has."""
    found = (_columns(table, [f"{field}[{i}]" for i in range(3)]) for field in fields)
    return next((columns for columns in found if columns is not None), None)


def _time_ns(table: Table) -> npt.NDArray[np.int64]:
    """Times of the samples [ns]: PX4 since 1.11 logs them in a separate field."""
    stamps = table.get("timestamp_sample")
    if stamps is None or not np.all(stamps):
        stamps = table["timestamp"]
    return stamps.astype(np.int64) * 1000


def _imu_readings(
    combined: Table,
    magnetometer: tuple[npt.NDArray[np.int64], Floats] | None,
    temperature: _Temperature | None,
) -> Rows:
    order = np.argsort(combined["timestamp"], kind="stable")
    rows = own_readings(combined["timestamp"][order].astype(np.int64) * 1000, Kind.IMU)
    rows["source"] = ImuSource.ULOG
    gyro, accel = _vectors(combined, *_GYRO_NAMES), _vectors(combined, "accelerometer_m_s2")
    rows["gyro_rad_s"] = np.nan if gyro is None else gyro[order]
    rows["accel_m_s2"] = np.nan if accel is None else accel[order]
    relative = combined.get("accelerometer_timestamp_relative")
    if relative is not None:
        rows["accel_m_s2"][relative[order] == _INVALID_RELATIVE_TIME] = np.nan
    if magnetometer is not None:
        _attach(rows, "mag_ut", *magnetometer)
    if temperature is not None:
        _attach(rows, "temperature_degc", temperature.time_ns, temperature.degc)
    return rows


def _attach(rows: Rows, field: str, time_ns: npt.NDArray[np.int64], values: Floats) -> None:
    """Attach each value to the first IMU row at or after its time; later values win."""
    positions = np.searchsorted(rows["time_ns"], time_ns)
    inside = positions < len(rows)
    rows[field][positions[inside]] = values[inside]


def _selected_device(tables: UlogTables, field: str) -> int | None:
    for name, column in (("sensor_selection", field), ("sensors_status_imu", f"{field}_primary")):
        table = _table(tables, name)
        if table is not None and column in table and table[column][-1]:
            return int(table[column][-1])
    return None


def _temperature(tables: UlogTables) -> _Temperature | None:
    for name, column, device_field in _TEMPERATURES:
        device = _selected_device(tables, device_field)
        for (topic, instance), table in tables.topics.items():
            if topic != name or column not in table:
                continue
            ids = table.get(device_field if name == "vehicle_imu_status" else "device_id")
            same = instance == 0 if device is None or ids is None else int(ids[-1]) == device
            values = np.asarray(table[column], np.float64)
            good = np.isfinite(values) & (values != 0.0)
            if same and good.any():
                time_ns = _time_ns(table)[good]
                return _Temperature(time_ns, values[good], f"{name}[{instance}].{column}")
    return None


def _magnetometer(
    tables: UlogTables, combined: Table
) -> tuple[npt.NDArray[np.int64], Floats] | None:
    own = _vectors(combined, "magnetometer_ga")
    if own is not None and "magnetometer_timestamp_relative" in combined:
        relative = combined["magnetometer_timestamp_relative"].astype(np.int64)
        fresh = relative != _INVALID_RELATIVE_TIME
        fresh[1:] &= np.any(np.diff(own, axis=0) != 0.0, axis=1)
        time_ns = combined["timestamp"].astype(np.int64) * 1000
        return time_ns[fresh], own[fresh] * _UT_PER_GAUSS
    table = _table(tables, "vehicle_magnetometer")
    field = None if table is None else _vectors(table, "magnetometer_ga")
    if table is None or field is None:
        return None
    return _time_ns(table), field * _UT_PER_GAUSS


def _airspeed_readings(tables: UlogTables) -> Rows:
    for name, column in _AIRSPEEDS:
        table = _table(tables, name)
        if table is not None and np.isfinite(table.get(column, np.nan)).any():
            rows = own_readings(_time_ns(table), Kind.AIRSPEED)
            rows["airspeed_m_s"] = table[column]
            return rows[np.isfinite(rows["airspeed_m_s"])]
    return empty(READING_DTYPE, 0)


def _gps_readings(tables: UlogTables) -> Rows:
    """Return the velocities of the first receiver that had a fix."""
    for name in _GPS:
        table = _table(tables, name)
        fields = ["vel_n_m_s", "vel_e_m_s", "vel_d_m_s"]
        velocity = None if table is None else _columns(table, fields)
        if table is None or velocity is None or "fix_type" not in table:
            continue
        valid = np.isfinite(velocity).all(axis=1) & (table["fix_type"] >= LEAST_FIX)
        valid &= table.get("vel_ned_valid", np.ones(len(valid))) != 0
        if valid.any():
            rows = own_readings(_time_ns(table), Kind.GPS)
            rows["velocity_ned_m_s"] = velocity
            return rows[valid]
    return empty(READING_DTYPE, 0)


def _velocity_readings(tables: UlogTables) -> Rows:
    table = _table(tables, "vehicle_local_position")
    velocity = None if table is None else _columns(table, ["vx", "vy", "vz"])
    if table is None or velocity is None:
        return empty(READING_DTYPE, 0)
    rows = own_readings(_time_ns(table), Kind.VELOCITY)
    rows["velocity_ned_m_s"] = velocity
    valid = np.isfinite(velocity).all(axis=1)
    for flag in ("v_xy_valid", "v_z_valid"):
        if flag in table:
            valid &= table[flag] != 0
    return rows[valid]


def _references(tables: UlogTables) -> tuple[AttitudeReference, ...]:
    found = []
    for name, is_truth in (("vehicle_attitude_groundtruth", True), ("vehicle_attitude", False)):
        table = _table(tables, name)
        q = None if table is None else _columns(table, [f"q[{i}]" for i in range(4)])
        if table is None or q is None:
            continue
        norm = np.linalg.norm(q, axis=1)
        good = np.isfinite(norm) & (norm > 0.5)
        time_ns = _time_ns(table)[good]
        order = np.argsort(time_ns, kind="stable")
        unit = (q[good] / norm[good, None])[order]
        found.append(AttitudeReference(name, time_ns[order], unit, is_truth))
    return tuple(found)
