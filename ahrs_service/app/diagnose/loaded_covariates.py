"""What a recording tells beside IMU and attitude: vibration, current, throttle, speeds, place."""

from typing import Final

import numpy as np
import numpy.typing as npt

from ahrs_service.diagnosis.input.diagnosis_input import Series
from ahrs_service.links.logs.dataflash_tables import DataFlashFile
from ahrs_service.links.logs.tlog import TlogFile
from ahrs_service.links.mavlink.gps_velocity import LEAST_FIX
from ahrs_service.records import Floats, Kind, Rows

_UNIX_FROM_NS: Final = 10**18
_NO_VOLTAGE: Final = 65535
_EARTH_M: Final = 6_371_000.0


def rising(series: Series) -> Series:
    """Return the series in order of time, each instant once."""
    if not len(series):
        return series
    _, first = np.unique(series.time_s, return_index=True)
    return Series(series.time_s[first], series.values[first])


def moved(series: Series, by_s: float) -> Series:
    """Return the series with `by_s` taken off its times."""
    return Series(series.time_s - by_s, series.values)


class TlogClock:
    """Times of messages on the clock of the IMU samples, less what makes that Unix time."""

    def __init__(
        self, tlog: TlogFile, readings: Rows, frame_index: npt.NDArray[np.int32], imu: Rows
    ) -> None:
        mine = readings["kind"] == Kind.IMU
        mine &= (readings["source"] == imu["source"][0]) & (readings["system"] == imu["system"][0])
        self._frame, self._time_ns = frame_index[mine], readings["time_ns"][mine]
        self.vehicle = int(imu["system"][0]), int(imu["component"][0])
        self.shift_s = 0.0
        table = tlog.tables.get((*self.vehicle, "ATTITUDE_QUATERNION"))
        table = tlog.tables.get((*self.vehicle, "ATTITUDE")) if table is None else table
        if int(imu["time_ns"][0]) > _UNIX_FROM_NS and table is not None:
            boot_s = table["time_boot_ms"] * 1e-3
            self.shift_s = float(np.median(self.before(table) - boot_s))

    def before(self, table: Rows) -> Floats:
        """Return the time [s] of the IMU message before each frame of a table."""
        at = np.searchsorted(self._frame, table["frame_index"]) - 1
        return self._time_ns[np.maximum(at, 0)] * 1e-9 - self.shift_s


def _stack(table: Rows, names: tuple[str, ...]) -> Floats:
    return np.stack([table[name] for name in names], axis=1).astype(np.float64)


def tlog_covariates(
    tlog: TlogFile, clock: TlogClock, reference: str
) -> tuple[dict[str, Series], Series]:
    """Return vibration, current, supply, throttle, airspeed; the reference's own body rates."""

    def table_of(name: str) -> Rows | None:
        return tlog.tables.get((*clock.vehicle, name))

    found: dict[str, Series] = {}
    if (table := table_of("VIBRATION")) is not None:
        values = _stack(table, ("vibration_x", "vibration_y", "vibration_z"))
        found["vibration"] = rising(Series(clock.before(table), values))
    for name in ("BATTERY_STATUS", "SYS_STATUS"):
        table = table_of(name)
        if table is not None and "current" not in found and (table["current_battery"] >= 0).any():
            known = table[table["current_battery"] >= 0]
            values = known["current_battery"] * 1e-2
            found["current"] = rising(Series(clock.before(known), values))
    if (table := table_of("BATTERY_STATUS")) is not None:
        known = table[table["voltages"][:, 0] != _NO_VOLTAGE]
        found["supply"] = rising(Series(clock.before(known), known["voltages"][:, 0] * 1e-3))
    if (table := table_of("VFR_HUD")) is not None:
        for name, unit in (("throttle", 1e-2), ("airspeed", 1.0)):
            values = table[name].astype(np.float64) * unit
            found[name] = rising(Series(clock.before(table), values))
    rate = Series()
    table = table_of(reference)
    if table is not None and "rollspeed" in (table.dtype.names or ()):
        values = _stack(table, ("rollspeed", "pitchspeed", "yawspeed"))
        rate = rising(Series(table["time_boot_ms"] * 1e-3, values))
    return found, rate


def true_velocity(tlog: TlogFile, vehicle: tuple[int, int], attitude_s: Floats) -> Series:
    """Return the velocity [m/s] of a simulator's truth, which shares the attitude's messages."""
    table = tlog.tables.get((*vehicle, "SIM_STATE"))
    if table is None or len(table) != len(attitude_s):
        return Series()
    return rising(Series(attitude_s, _stack(table, ("vn", "ve", "vd"))))


def receiver_position(tlog: TlogFile, clock: TlogClock) -> Series:
    """Return the receiver's position from its first 3D fix [m], on a sphere, flat about it."""
    table = tlog.tables.get((*clock.vehicle, "GPS_RAW_INT"))
    if table is None or not (table["fix_type"] >= LEAST_FIX).any():
        return Series()
    table = table[table["fix_type"] >= LEAST_FIX]
    latitude, longitude = (np.radians(table[name] * 1e-7) for name in ("lat", "lon"))
    north = _EARTH_M * (latitude - latitude[0])
    east = _EARTH_M * np.cos(latitude[0]) * (longitude - longitude[0])
    down = (table["alt"][0] - table["alt"].astype(np.float64)) * 1e-3
    return rising(Series(clock.before(table), np.stack([north, east, down], axis=1)))


_DATAFLASH: Final = (
    ("vibration", "VIBE", ("VibeX", "VibeY", "VibeZ"), 1.0),
    ("current", "BAT", ("Curr",), 1.0),
    ("current", "CURR", ("Curr",), 1.0),
    ("supply", "BAT", ("Volt",), 1.0),
    ("throttle", "CTUN", ("ThO",), 1.0),
    ("throttle", "CTUN", ("ThrOut",), 1e-3),
    ("airspeed", "ARSP", ("Airspeed",), 1.0),
)
_OLD_CURRENT_A: Final = 1e-2
"""Logs that count milliseconds hold whole hundredths of an ampere."""
_CLOCKS: Final = {"TimeUS": 1e-6, "TimeMS": 1e-3}


def dataflash_covariates(log: DataFlashFile, clock_rate: float) -> dict[str, Series]:
    """Return vibration, current, throttle and airspeed of the first instance of each.

    The log's seconds last `clock_rate` seconds (links.logs.recording).
    """
    found: dict[str, Series] = {}
    for what, name, fields, unit in _DATAFLASH:
        if what in found or not log.counts().get(name):
            continue
        table = log.table(name)
        names = table.dtype.names or ()
        clock = next((one for one in _CLOCKS if one in names), None)
        if clock is None or set(fields) - set(names):
            continue
        for instance in ("IMU", "I", "C", "Instance"):
            if instance in names:
                table = table[table[instance] == table[instance][0]]
                break
        values = np.stack([log.column(table, name, field) for field in fields], axis=1) * unit
        if name == "CURR" and clock == "TimeMS":
            values *= _OLD_CURRENT_A
        series = values if len(fields) > 1 else values[:, 0]
        found[what] = rising(Series(_seconds(table[clock], clock_rate * _CLOCKS[clock]), series))
    return found


def _seconds(stamps: npt.NDArray[np.generic], unit: float) -> Floats:
    return stamps.astype(np.float64) * unit
