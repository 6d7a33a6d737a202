"""PX4 ULog (.ulg) recordings, read with pyulog."""

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from pyulog import ULog

from ahrs_service.links.errors import RecordingError
from ahrs_service.links.logs.recording import AttitudeReference, Recording, own_readings
from ahrs_service.links.mavlink.gps_velocity import LEAST_FIX
from ahrs_service.links.mavlink.unit_name import unit_name
from ahrs_service.records import READING_DTYPE, ImuSource, Kind, Rows, empty

Floats = npt.NDArray[np.float64]
Table = dict[str, npt.NDArray[Any]]

_AUTOPILOT_PX4: Final = 12
_INVALID_RELATIVE_TIME: Final = 0x7FFFFFFF
_UT_PER_GAUSS: Final = 100.0
_BLOCK: Final = 1 << 18
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


def read_ulog(path: str | Path, progress: Callable[[float], None] | None = None) -> Recording:
    """Read a ULog: `sensor_combined` as the IMU, aiding, and the autopilot's attitude.

    ULog has one clock, so `received_ns` equals `time_ns`; readings are in order of time. The IMU's
    temperature is that of the sensor PX4 selected: gyro, else accelerometer, of one
    device. `progress` is called with the share read, 0 to 1. Source: docs.px4.io, ULog file
    format.
    """
    path = Path(path)
    tables = _load(path, progress)
    combined = _table(tables, "sensor_combined")
    if combined is None or _vectors(combined, *_GYRO_NAMES) is None:
        raise RecordingError(_no_imu(path, tables))
    temperature = _temperature(tables)
    imu = _imu_readings(combined, _magnetometer(tables, combined), temperature)
    parts = [imu, _airspeed_readings(tables), _gps_readings(tables), _velocity_readings(tables)]
    readings = np.concatenate([part for part in parts if len(part)])
    readings = readings[np.argsort(readings["time_ns"], kind="stable")]
    heartbeat = own_readings(readings["time_ns"][:1], Kind.HEARTBEAT)
    heartbeat["autopilot"] = _AUTOPILOT_PX4
    heartbeat["vehicle"] = tables.vehicle
    origin = "none of its own in the log" if temperature is None else f"from {temperature.origin}"
    return Recording(
        path=path,
        format="ULog",
        readings=np.concatenate([heartbeat, readings]),
        references=_references(tables),
        message_counts=tables.counts,
        damaged=tables.damaged,
        notes=(f"IMU temperature: {origin}", *tables.notes),
        unit=tables.unit,
    )


@dataclass(frozen=True, slots=True)
class _Tables:
    """The topics of a log by (name, instance), and what was found wrong with the file."""

    topics: dict[tuple[str, int], Table]
    counts: dict[str, int]
    damaged: dict[str, int]
    notes: tuple[str, ...]
    vehicle: int
    unit: str


@dataclass(frozen=True, slots=True)
class _Temperature:
    time_ns: npt.NDArray[np.int64]
    degc: Floats
    origin: str


class _CountingFile(io.FileIO):
    """A file that tells how far it has been read; pyulog offers no progress itself."""

    def __init__(self, path: Path, progress: Callable[[float], None] | None) -> None:
        super().__init__(path)
        self._size = max(path.stat().st_size, 1)
        self._progress = progress

    def readinto(self, buffer: Any) -> int | None:
        count = super().readinto(buffer)
        if self._progress is not None:
            self._progress(min(self.tell() / self._size, 1.0))
        return count


def _load(path: Path, progress: Callable[[float], None] | None) -> _Tables:
    try:
        with (
            _CountingFile(path, progress) as raw,
            # pyulog prints its findings; they are reported through Recording.damaged instead.
            contextlib.redirect_stdout(io.StringIO()),
        ):
            log = ULog(io.BufferedReader(raw, _BLOCK))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:
        # pyulog lets many kinds of error out of a damaged header or definition section.
        raise RecordingError(
            f"{path}: not a ULog that can be read ({error}); check that the file is whole"
        ) from error
    damaged = {}
    if log.dropouts:
        damaged["drop-outs"] = len(log.dropouts)
    if log.file_corruption:
        damaged["corrupt sections"] = 1
    lost_ms = sum(dropout.duration for dropout in log.dropouts)
    notes = (f"the logger dropped {lost_ms} ms in all",) if log.dropouts else ()
    # A damaged definition can leave a topic without its time.
    topics = {
        (item.name, item.multi_id): item.data for item in log.data_list if "timestamp" in item.data
    }
    counts: dict[str, int] = {}
    for (name, _), data in topics.items():
        counts[name] = counts.get(name, 0) + len(data["timestamp"])
    vehicle, unit = _vehicle(log.initial_parameters), _unit(log.msg_info_dict)
    return _Tables(topics, counts, damaged, notes, vehicle, unit)


def _unit(about: dict[str, Any]) -> str:
    """Return the number of the board, which PX4 sends as AUTOPILOT_VERSION.uid2; "" if damaged."""
    with contextlib.suppress(ValueError):
        return unit_name(0, bytes.fromhex(str(about.get("sys_uuid", ""))))
    return ""


def _vehicle(parameters: dict[str, Any]) -> int:
    """Return the parameter MAV_TYPE, 0 (generic) where a log has none that is possible."""
    value = parameters.get("MAV_TYPE", 0)
    return int(value) if 0 <= value <= 255 else 0


def _no_imu(path: Path, tables: _Tables) -> str:
    has = ", ".join(sorted(tables.counts)[:12]) or "no topic at all"
    return (
        f"{path}: the ULog has no sensor_combined topic with gyro_rad; it has {has}; "
        "log with PX4's default profile (SDLOG_PROFILE bit 0)"
    )


def _table(tables: _Tables, name: str, instance: int = 0) -> Table | None:
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
    """When the values were true [ns]: PX4 since 1.11 logs the sample's time apart."""
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
    """Put each value on the first IMU row at or after its time; later values win."""
    positions = np.searchsorted(rows["time_ns"], time_ns)
    inside = positions < len(rows)
    rows[field][positions[inside]] = values[inside]


def _selected_device(tables: _Tables, field: str) -> int | None:
    for name, column in (("sensor_selection", field), ("sensors_status_imu", f"{field}_primary")):
        table = _table(tables, name)
        if table is not None and column in table and table[column][-1]:
            return int(table[column][-1])
    return None


def _temperature(tables: _Tables) -> _Temperature | None:
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


def _magnetometer(tables: _Tables, combined: Table) -> tuple[npt.NDArray[np.int64], Floats] | None:
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


def _airspeed_readings(tables: _Tables) -> Rows:
    for name, column in _AIRSPEEDS:
        table = _table(tables, name)
        if table is not None and np.isfinite(table.get(column, np.nan)).any():
            rows = own_readings(_time_ns(table), Kind.AIRSPEED)
            rows["airspeed_m_s"] = table[column]
            return rows[np.isfinite(rows["airspeed_m_s"])]
    return empty(READING_DTYPE, 0)


def _gps_readings(tables: _Tables) -> Rows:
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


def _velocity_readings(tables: _Tables) -> Rows:
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


def _references(tables: _Tables) -> tuple[AttitudeReference, ...]:
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
