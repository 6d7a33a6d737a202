"""ArduPilot DataFlash (.bin) recordings."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from ahrs_service.links.errors import RecordingError
from ahrs_service.links.logs.dataflash_tables import DataFlashFile, read_tables
from ahrs_service.links.logs.recording import AttitudeReference, Recording, own_readings
from ahrs_service.links.logs.satellite_clock import clock_rate
from ahrs_service.links.mavlink.gps_velocity import LEAST_FIX, velocity_columns
from ahrs_service.links.mavlink.unit_name import unit_name
from ahrs_service.links.mavlink.vehicle_trim import trim_notes, trim_of_parameter
from ahrs_service.records import READING_DTYPE, ImuSource, Kind, Rows, empty
from ahrs_service.rotation import quaternion_columns

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

_NONE: Final = (np.zeros(0, np.int64), empty(READING_DTYPE, 0))

_AUTOPILOT_ARDUPILOT: Final = 3
_UT_PER_MILLIGAUSS: Final = 0.1
_GYRO: Final = ("GyrX", "GyrY", "GyrZ")
_ACCEL: Final = ("AccX", "AccY", "AccZ")
_TEMPERATURES: Final = ("T", "Temp")
_INSTANCES: Final = ("I", "C")
_TIMES: Final = {"TimeUS": 1000, "TimeMS": 1_000_000, "T": 1_000_000}
_CLOCKS: Final = ("TimeUS", "TimeMS")
_GPS_CLOCKS: Final = ("TimeUS", "T")
"""In the GPS records of old logs TimeMS is the satellites' time and T the autopilot's."""
_SATELLITE_CLOCKS: Final = (("TimeUS", "GMS"), ("T", "TimeMS"))
"""Stamps of a fix by the autopilot's clock and by the satellites' time of the week [ms]."""
_BOARD: Final = re.compile(rb"\b([0-9A-F]{8}) ([0-9A-F]{8}) ([0-9A-F]{8})\b")
"""The number of the board in three words, as one of the first messages of a log gives it."""
_FIRST_TEXTS: Final = 10
_VEHICLES: Final = ((b"Plane", 1), (b"Copter", 2), (b"Rover", 10), (b"Sub", 12))
"""MAV_TYPE by the firmware's name, as the first messages of a log give it."""
_VELOCITIES: Final = ("XKF1", "NKF1", "EKF1")
_FASTEST_M_S: Final = 60.0
"""A filter whose velocity runs beyond this has diverged, and not only there [m/s]."""
_AIRSPEEDS: Final = (("ARSP", "Airspeed"), ("NTUN", "Arspd"))
_REFERENCES: Final = ("SIM", "ATT", "AHR2", "XKF1", "NKF1", "EKF1")


def read_dataflash(path: str | Path, progress: Callable[[float], None] | None = None) -> Recording:
    """Read a DataFlash log: the first IMU, aiding, the trim, and the autopilot's attitudes.

    The log has one clock, so `received_ns` equals `time_ns`; where the satellites' time tells
    another rate all times are by that (`Recording.clock_rate`). Readings are in the order of the
    file, but for the trim that it begins with, which holds from the first sample on. The velocity
    is that of the first GPS receiver, of the autopilot's filter only where that never had a fix.
    Temperature is the IMU's own (`T` or `Temp`, 0 is none). SIM, where a simulator wrote
    it, is truth. `progress` is called with the share read, 0 to 1.
    """
    path = Path(path)
    log = read_tables(path, progress)
    offsets, imu = _imu_readings(path, log)
    _attach_magnetometer(log, offsets, imu)
    velocity, doubts = _velocity_readings(log)
    parts = [(offsets, imu), _airspeed_readings(log), velocity, _trim_readings(log, offsets, imu)]
    order = np.argsort(np.concatenate([at for at, _ in parts]), kind="stable")
    readings = np.concatenate([rows for _, rows in parts])[order]
    heartbeat = own_readings(readings["time_ns"][:1], Kind.HEARTBEAT)
    heartbeat["autopilot"] = _AUTOPILOT_ARDUPILOT
    heartbeat["vehicle"] = _vehicle(log)
    rate = clock_rate_of(log)
    readings = np.concatenate([heartbeat, readings])
    for field in ("time_ns", "received_ns"):
        readings[field] = at_rate(readings[field], rate)
    return Recording(
        path=path,
        format="DataFlash",
        readings=readings,
        references=_references(log, rate),
        message_counts=log.counts(),
        damaged=log.damaged,
        notes=(*_notes(log, imu), *_clock_note(rate), *trim_notes(readings), *doubts),
        unit=_unit(log),
        clock_rate=rate,
    )


def at_rate(time_ns: Integers, rate: float) -> Integers:
    """Times [N] of a clock in each of whose seconds `rate` true ones pass."""
    return time_ns if rate == 1.0 else np.rint(time_ns * rate).astype(np.int64)


def clock_rate_of(log: DataFlashFile) -> float:
    """Seconds of the satellites in one of the autopilot's, by the fixes of the first receiver."""
    for own, satellites in _SATELLITE_CLOCKS:
        table = _table(log, "GPS", ("Status", satellites), (own,))
        if table is not None:
            fixed = table.column("Status") >= LEAST_FIX
            of_week_ms = table.column(satellites)[fixed].astype(np.int64)
            return clock_rate(table.time_ns[fixed], of_week_ms)
    return 1.0


def _clock_note(rate: float) -> tuple[str, ...]:
    if rate == 1.0:
        return ()
    return (
        f"the autopilot's clock passes 1 s in {rate:.4f} s of the satellites' time: all times of "
        "this log are by the satellites'",
    )


def _vehicle(log: DataFlashFile) -> int:
    """Return the MAV_TYPE of the firmware that wrote the log, 0 (generic) where it is not told."""
    for text in _first_texts(log):
        for name, vehicle in _VEHICLES:
            if name in text:
                return vehicle
    return 0


def _first_texts(log: DataFlashFile) -> list[bytes]:
    if "MSG" not in log.counts():
        return []
    texts: list[bytes] = log.table("MSG")["Message"][:_FIRST_TEXTS].tolist()
    return texts


def _unit(log: DataFlashFile) -> str:
    """Return the number of the board, as in "CUAVv5 0025001E 31385115 35333837"; "" if not told.

    The words are written with their last byte first; AUTOPILOT_VERSION.uid2 has the bytes in order.
    """
    for text in _first_texts(log):
        if found := _BOARD.search(text):
            words = (bytes.fromhex(word.decode())[::-1] for word in found.groups())
            return unit_name(0, b"".join(words))
    return ""


class _Table:
    """One instance's records of a name, with their offsets and times."""

    def __init__(self, log: DataFlashFile, name: str, time_field: str) -> None:
        offsets = log.offsets_of(name)
        rows = log.table(name)
        for field in _INSTANCES:
            if field in (rows.dtype.names or ()):
                first = rows[field] == 0
                offsets, rows = offsets[first], rows[first]
                break
        self._log, self._name, self._rows = log, name, rows
        self.offsets = offsets
        self.fields = rows.dtype.names or ()
        self.time_ns: Integers = rows[time_field].astype(np.int64) * _TIMES[time_field]

    def column(self, field: str) -> Floats:
        return self._log.column(self._rows, self._name, field)

    def columns(self, fields: tuple[str, ...]) -> Floats:
        return np.stack([self.column(field) for field in fields], axis=-1)


def _table(
    log: DataFlashFile, name: str, fields: tuple[str, ...], clocks: tuple[str, ...] = _CLOCKS
) -> _Table | None:
    """Return the table of `name` if it has records, a time and all of `fields`."""
    if not len(log.offsets_of(name)):
        return None
    present = log.layouts[name].dtype.names or ()
    time_field = next((field for field in clocks if field in present), None)
    if time_field is None or set(fields) - set(present):
        return None
    table = _Table(log, name, time_field)
    return table if len(table.offsets) else None


def _imu_readings(path: Path, log: DataFlashFile) -> tuple[Integers, Rows]:
    table = _table(log, "IMU", _GYRO + _ACCEL)
    if table is None:
        present = ", ".join(list(log.counts())[:12]) or "no records"
        raise RecordingError(
            f"{path}: the DataFlash log has no IMU records with time, gyro and accelerometer; "
            f"it has {present}; log with the IMU bit of LOG_BITMASK set"
        )
    rows = own_readings(table.time_ns, Kind.IMU)
    rows["source"] = ImuSource.DATAFLASH
    rows["gyro_rad_s"] = table.columns(_GYRO)
    rows["accel_m_s2"] = table.columns(_ACCEL)
    for field in _TEMPERATURES:
        if field in table.fields:
            values = table.column(field)
            rows["temperature_degc"] = np.where(values != 0.0, values, np.nan)
            break
    return table.offsets, rows


def _attach_magnetometer(log: DataFlashFile, offsets: Integers, imu: Rows) -> None:
    """Put each field measured on the next IMU row of the file; later values win."""
    fields = ("MagX", "MagY", "MagZ")
    table = _table(log, "MAG", fields)
    if table is None:
        return
    positions = np.searchsorted(offsets, table.offsets)
    inside = positions < len(imu)
    imu["mag_ut"][positions[inside]] = table.columns(fields)[inside] * _UT_PER_MILLIGAUSS


def _airspeed_readings(log: DataFlashFile) -> tuple[Integers, Rows]:
    for name, field in _AIRSPEEDS:
        table = _table(log, name, (field,))
        if table is not None:
            rows = own_readings(table.time_ns, Kind.AIRSPEED)
            rows["airspeed_m_s"] = table.column(field)
            return table.offsets, rows
    return _NONE


def _velocity_readings(log: DataFlashFile) -> tuple[tuple[Integers, Rows], tuple[str, ...]]:
    """Return the velocities over ground, and a note where the only one there is was left out."""
    gps = _table(log, "GPS", ("Status", "Spd", "GCrs"), _GPS_CLOCKS)
    fixed = np.zeros(0, np.bool_) if gps is None else gps.column("Status") >= LEAST_FIX
    if gps is not None and fixed.any():
        rows = own_readings(gps.time_ns, Kind.GPS)
        down = gps.column("VZ") if "VZ" in gps.fields else np.zeros(len(rows))
        # A receiver that does not measure the vertical leaves 0 there.
        down = down if down[fixed].any() else np.full(len(rows), np.nan)
        velocity = velocity_columns(gps.column("Spd"), gps.column("GCrs"), down)
        rows["velocity_ned_m_s"] = velocity
        return (gps.offsets[fixed], rows[fixed]), ()
    fields = ("VN", "VE", "VD")
    for name in _VELOCITIES:
        table = _table(log, name, fields)
        if table is None:
            continue
        rows = own_readings(table.time_ns, Kind.VELOCITY)
        rows["velocity_ned_m_s"] = table.columns(fields)
        fastest = np.fmax.reduce(np.linalg.norm(rows["velocity_ned_m_s"], axis=1), initial=0.0)
        if fastest < _FASTEST_M_S:
            return (table.offsets, rows), ()
        return _NONE, (
            f"velocity of {name} not used: it runs to {fastest:.0f} m/s, so that filter diverged",
        )
    return _NONE, ()


def _trim_readings(log: DataFlashFile, imu_offsets: Integers, imu: Rows) -> tuple[Integers, Rows]:
    """Return the trims; the first value of each goes before all, however late it was written."""
    fields = ("Name", "Value")
    layout = log.layouts.get("PARM")
    if layout is None or set(fields) - set(layout.dtype.names or ()):
        return _NONE
    table, offsets = log.table("PARM"), log.offsets_of("PARM")
    found = [
        (offset, trim)
        for offset, name, value in zip(
            offsets.tolist(), table["Name"].tolist(), table["Value"].tolist(), strict=False
        )
        if (trim := trim_of_parameter(name, value)) is not None
    ]
    if not found:
        return _NONE
    trims = np.array([trim for _, trim in found])
    at = np.array([offset for offset, _ in found])
    for axis in np.isfinite(trims).T:
        at[np.flatnonzero(axis)[:1]] = -1
    before = np.maximum(np.searchsorted(imu_offsets, at) - 1, 0)
    rows = own_readings(imu["time_ns"][before], Kind.TRIM)
    rows["trim_rad"] = trims
    return at, rows


def _references(log: DataFlashFile, rate: float) -> tuple[AttitudeReference, ...]:
    found = []
    for name in _REFERENCES:
        table = _table(log, name, ("Roll", "Pitch", "Yaw"))
        if table is None:
            continue
        time_ns = at_rate(table.time_ns, rate)
        q = quaternion_columns(np.radians(table.columns(("Roll", "Pitch", "Yaw"))))
        good = np.flatnonzero(np.isfinite(q).all(axis=1))
        good = good[np.argsort(time_ns[good], kind="stable")]
        found.append(AttitudeReference(name, time_ns[good], q[good], is_truth=name == "SIM"))
    return tuple(found)


def _notes(log: DataFlashFile, imu: Rows) -> tuple[str, ...]:
    notes = []
    if np.isfinite(imu["temperature_degc"]).any():
        notes.append("IMU temperature: the first IMU's own")
    else:
        notes.append("IMU temperature: none in the log")
    counts = log.counts()
    others = [name for name in ("IMU2", "IMU3", "ISBD") if counts.get(name)]
    if others:
        notes.append(f"also in the log and not used: {', '.join(others)}")
    return tuple(notes)
