"""Velocity and height that a recording's GPS receiver measured, before any filter of the autopilot.

GPS_RAW_INT of a .tlog, GPS of a DataFlash log, vehicle_gps_position of a ULog. A receiver's
velocity comes from Doppler shifts and knows nothing of the vehicle's attitude.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pyulog import ULog

from ahrs_service.links.logs.dataflash_instances import at_rate, clock_rate_of
from ahrs_service.links.logs.dataflash_tables import read_tables
from ahrs_service.links.logs.tlog import read_tlog
from ahrs_service.records import Kind, Rows

UNKNOWN = 0xFFFF
LEAST_FIX = 3
"""A three-dimensional fix."""
LEAST_COUNT = 50
SPEED_LIMIT_M_S = 100.0
COURSE_SPEED_M_S = 5.0
"""Faster than this the positions tell the course."""


@dataclass(frozen=True)
class GpsVelocity:
    """`time_ns` [N] on the clock of the IMU, rising; `ned_m_s` [N, 3], down NaN if not measured.

    `height_m` [N] above the sea, NaN where it is not known.
    """

    time_ns: npt.NDArray[np.int64]
    ned_m_s: npt.NDArray[np.float64]
    height_m: npt.NDArray[np.float64]


def gps_velocity(path: Path, readings: Rows) -> GpsVelocity | None:
    """Read it; None where there is none or the vehicle had no fix."""
    read = {".tlog": _of_tlog, ".bin": _of_dataflash, ".ulg": _of_ulog}[path.suffix.lower()]
    found = read(path, readings[readings["kind"] == Kind.IMU])
    if found is None:
        return None
    time_ns, ned, height_m = found
    good = np.isfinite(ned[:, :2]).all(axis=1) & (np.abs(ned[:, :2]) < SPEED_LIMIT_M_S).all(axis=1)
    newest = np.maximum.accumulate(time_ns)
    good[1:] &= time_ns[1:] > newest[:-1]
    # A logger writes the last fix again until there is a new one.
    good[1:] &= (ned[1:, :2] != ned[:-1, :2]).any(axis=1)
    if good.sum() < LEAST_COUNT:
        return None
    return GpsVelocity(time_ns[good], ned[good], height_m[good])


def _ned(speed: Any, course_deg: Any, down: Any) -> npt.NDArray[np.float64]:
    course = np.radians(course_deg)
    down = np.broadcast_to(down, speed.shape)
    return np.stack([speed * np.cos(course), speed * np.sin(course), down], axis=1)


def _of_tlog(path: Path, imu: Rows) -> tuple[Any, Any, Any] | None:
    tlog = read_tlog(path)
    vehicle = (int(imu["system"][0]), int(imu["component"][0]))
    table = tlog.tables.get((*vehicle, "GPS_RAW_INT"))
    if table is None:
        return None
    table = table[
        (table["fix_type"] >= LEAST_FIX) & (table["vel"] != UNKNOWN) & (table["cog"] != UNKNOWN)
    ]
    if not len(table):
        return None
    time_ns = table["time_usec"].astype(np.int64) * 1000
    if time_ns[0] < imu["time_ns"][0] - 10**9 or time_ns[-1] > imu["time_ns"][-1] + 10**9:
        lead_ns = np.median(imu["time_ns"] - imu["received_ns"])
        time_ns = table["received_us"].astype(np.int64) * 1000 + int(lead_ns)
    ned = _ned(1e-2 * table["vel"], _course_deg(time_ns, table), np.nan)
    return time_ns, ned, 1e-3 * table["alt"]


def _course_deg(time_ns: Any, table: Rows) -> Any:
    """Course [deg]; in radians where the positions say that its writer put those there."""
    raw = 1e-2 * table["cog"]
    later = np.minimum(np.searchsorted(time_ns, time_ns + 10**9), len(table) - 1)
    north = (table["lat"][later] - table["lat"]).astype(np.float64)
    east = (table["lon"][later] - table["lon"]) * np.cos(np.radians(1e-7 * table["lat"]))
    fast = (table["vel"] > 100 * COURSE_SPEED_M_S) & (np.hypot(north, east) > 0.0)
    track = np.arctan2(east, north)

    def agreement(course_deg: Any) -> float:
        return float(np.cos(np.radians(course_deg) - track)[fast].sum())

    return max((raw, np.degrees(raw)), key=agreement)


def _of_dataflash(path: Path, imu: Rows) -> tuple[Any, Any, Any] | None:
    log = read_tables(path)
    table = log.table("GPS") if "GPS" in log.counts() else ()
    if not len(table):
        return None
    table = table[table["Status"] >= LEAST_FIX]
    # Before TimeUS there was the receiver's own time, and T of the autopilot [ms].
    old = "TimeUS" not in (table.dtype.names or ())
    time_ns = table["T" if old else "TimeUS"].astype(np.int64) * (1_000_000 if old else 1000)
    names = ("Spd", "GCrs", "VZ", "Alt")
    speed, course, down, height_m = (log.column(table, "GPS", name) for name in names)
    return at_rate(time_ns, clock_rate_of(log)), _ned(speed, course, down), height_m


def _of_ulog(path: Path, imu: Rows) -> tuple[Any, Any, Any] | None:
    names = ("vehicle_gps_position", "sensor_gps")
    for table in ULog(str(path), list(names)).data_list:
        data = table.data
        fixed = data["fix_type"] >= LEAST_FIX
        ned = np.stack([data[f"vel_{axis}_m_s"] for axis in "ned"], axis=1).astype(np.float64)
        if fixed.any():
            time_ns = data["timestamp"][fixed].astype(np.int64) * 1000
            return time_ns, ned[fixed], np.full(len(time_ns), np.nan)
    return None
