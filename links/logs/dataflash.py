"""ArduPilot DataFlash (.bin) recordings."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from ahrs_service.adoption import Vehicle
from ahrs_service.errors import RecordingError
from ahrs_service.links.logs.dataflash_covariates import dataflash_covariates
from ahrs_service.links.logs.dataflash_instances import at_rate, clock_rate_of, table_of
from ahrs_service.links.logs.dataflash_tables import DataFlashFile, read_tables
from ahrs_service.links.logs.parameter_values import ARDUPILOT, param_name
from ahrs_service.links.logs.recorded_parameters import ParameterHistory, RecordedParameters
from ahrs_service.links.logs.recording import (
    OWN,
    AttitudeReference,
    Covariates,
    Log,
    Recording,
    own_readings,
)
from ahrs_service.links.mavlink.gps_velocity import LEAST_FIX, velocity_columns
from ahrs_service.links.mavlink.unit_name import unit_name
from ahrs_service.links.mavlink.vehicle_trim import trim_notes, trim_of_parameter
from ahrs_service.records import READING_DTYPE, ImuSource, Kind, Rows, empty
from ahrs_service.rotation import quaternion_columns

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

_NONE: Final = (np.zeros(0, np.int64), empty(READING_DTYPE, 0))

_UT_PER_MILLIGAUSS: Final = 0.1
_GYRO: Final = ("GyrX", "GyrY", "GyrZ")
_ACCEL: Final = ("AccX", "AccY", "AccZ")
_TEMPERATURES: Final = ("T", "Temp")
_GPS_CLOCKS: Final = ("TimeUS", "T")
"""In the GPS records of old logs TimeMS is the satellites' time and T the autopilot's."""
_BOARD: Final = re.compile(rb"\b([0-9A-F]{8}) ([0-9A-F]{8}) ([0-9A-F]{8})\b")
"""The board's number in three words, from one of the first messages of a log."""
_FIRST_TEXTS: Final = 10
_VEHICLES: Final = ((b"Plane", 1), (b"Copter", 2), (b"Rover", 10), (b"Sub", 12))
"""MAV_TYPE by the firmware's name, from the first messages of a log."""
_VELOCITIES: Final = ("XKF1", "NKF1", "EKF1")
_FASTEST_M_S: Final = 60.0
"""A filter whose velocity ever exceeds this has diverged, so none of it is used [m/s]."""
_AIRSPEEDS: Final = (("ARSP", "Airspeed"), ("NTUN", "Arspd"))
_REFERENCES: Final = ("SIM", "ATT", "AHR2", "XKF1", "NKF1", "EKF1")


class DataFlashLog(Log):
    """A DataFlash log that was read."""

    def __init__(self, path: Path, log: DataFlashFile) -> None:
        self.path, self.file = path, log
        self.clock_rate = clock_rate_of(log)

    def recording(self) -> Recording:
        """Return the first IMU, aiding, the trim, and the autopilot's attitudes.

        The log has one clock, so `received_ns` equals `time_ns`; where the satellites' time gives
        another rate, times are scaled to it (`Recording.clock_rate`). Readings are in the order of
        the file, except the initial trim, which is in effect from the first sample on. The
        velocity is that of the first GPS receiver, or of the autopilot's filter where that never
        had a fix. Temperature is the IMU's own (`T` or `Temp`, 0 is none). SIM, where a simulator
        wrote it, is truth.
        """
        log, rate = self.file, self.clock_rate
        offsets, imu = _imu_readings(self.path, log)
        _attach_magnetometer(log, offsets, imu)
        velocity, doubts = _velocity_readings(log)
        trims = _trim_readings(log, offsets, imu)
        parts = [(offsets, imu), _airspeed_readings(log), velocity, trims]
        order = np.argsort(np.concatenate([at for at, _ in parts]), kind="stable")
        readings = np.concatenate([rows for _, rows in parts])[order]
        heartbeat = own_readings(readings["time_ns"][:1], Kind.HEARTBEAT)
        heartbeat["autopilot"] = ARDUPILOT
        heartbeat["vehicle"] = _vehicle(log)
        readings = np.concatenate([heartbeat, readings])
        for field in ("time_ns", "received_ns"):
            readings[field] = at_rate(readings[field], rate)
        return Recording(
            path=self.path,
            format="DataFlash",
            readings=readings,
            log=self,
            references=_references(log, rate),
            message_counts=log.counts(),
            damaged=log.damaged,
            notes=(*_notes(log, imu), *_clock_note(rate), *trim_notes(readings), *doubts),
            units={OWN: _unit(log)},
            clock_rate=rate,
        )

    def parameters(self, vehicle: Vehicle) -> RecordedParameters:
        """Return the values of the PARM records."""
        del vehicle
        layout = self.file.layouts.get("PARM")
        history = ParameterHistory()
        if layout is not None and {"Name", "Value"} <= set(layout.dtype.names or ()):
            table = self.file.table("PARM")
            names = map(param_name, table["Name"].tolist())
            history.take(zip(names, table["Value"].tolist(), strict=True))
        return history.result(ARDUPILOT)

    def covariates(self, imu: Rows) -> Covariates:
        """Return vibration, current, throttle and airspeed."""
        del imu
        return dataflash_covariates(self.file, self.clock_rate)


def open_dataflash(
    path: str | Path, progress: Callable[[float], None] | None = None
) -> DataFlashLog:
    """Read a DataFlash log, once; `progress` is called with the share read, 0 to 1."""
    path = Path(path)
    return DataFlashLog(path, read_tables(path, progress))


def read_dataflash(path: str | Path, progress: Callable[[float], None] | None = None) -> Recording:
    """Read a DataFlash log as input of the pipeline."""
    return open_dataflash(path, progress).recording()


def _clock_note(rate: float) -> tuple[str, ...]:
    if rate == 1.0:
        return ()
    return (
        f"the autopilot's clock counts 1 s in {rate:.4f} s of GPS time: all times of "
        "this log are scaled to GPS time",
    )


def _vehicle(log: DataFlashFile) -> int:
    """Return the MAV_TYPE of the firmware that wrote the log, 0 (generic) where it is not known."""
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
    """Return the number of the board, as in "CUAVv5 0025001E 31385115 35333837"; "" if not known.

    The words are written with their last byte first; AUTOPILOT_VERSION.uid2 has the bytes in order.
    """
    for text in _first_texts(log):
        if found := _BOARD.search(text):
            words = (bytes.fromhex(word.decode())[::-1] for word in found.groups())
            return unit_name(0, b"".join(words))
    return ""


def _imu_readings(path: Path, log: DataFlashFile) -> tuple[Integers, Rows]:
    table = table_of(log, "IMU", _GYRO + _ACCEL)
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
    """Attach each measured field to the next IMU row of the file; later values win."""
    fields = ("MagX", "MagY", "MagZ")
    table = table_of(log, "MAG", fields)
    if table is None:
        return
    positions = np.searchsorted(offsets, table.offsets)
    inside = positions < len(imu)
    imu["mag_ut"][positions[inside]] = table.columns(fields)[inside] * _UT_PER_MILLIGAUSS


def _airspeed_readings(log: DataFlashFile) -> tuple[Integers, Rows]:
    for name, field in _AIRSPEEDS:
        table = table_of(log, name, (field,))
        if table is not None:
            rows = own_readings(table.time_ns, Kind.AIRSPEED)
            rows["airspeed_m_s"] = table.column(field)
            return table.offsets, rows
    return _NONE


def _velocity_readings(log: DataFlashFile) -> tuple[tuple[Integers, Rows], tuple[str, ...]]:
    """Return the velocities over ground, and a note where the only source was not used."""
    gps = table_of(log, "GPS", ("Status", "Spd", "GCrs"), _GPS_CLOCKS)
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
        table = table_of(log, name, fields)
        if table is None:
            continue
        rows = own_readings(table.time_ns, Kind.VELOCITY)
        rows["velocity_ned_m_s"] = table.columns(fields)
        fastest = np.fmax.reduce(np.linalg.norm(rows["velocity_ned_m_s"], axis=1), initial=0.0)
        if fastest < _FASTEST_M_S:
            return (table.offsets, rows), ()
        return _NONE, (
            f"velocity of {name} not used: it reaches {fastest:.0f} m/s, so that filter diverged",
        )
    return _NONE, ()


def _trim_readings(log: DataFlashFile, imu_offsets: Integers, imu: Rows) -> tuple[Integers, Rows]:
    """Return the trims; the first value of each comes first, however late it was written."""
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
        table = table_of(log, name, ("Roll", "Pitch", "Yaw"))
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
