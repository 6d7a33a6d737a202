"""Covariates in a telemetry log: vibration, current, throttle, position.

VIBRATION, BATTERY_STATUS, SYS_STATUS and VFR_HUD carry no time: they get that of the IMU message
before them in the file.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from ahrs_service.links.logs.recording import Covariates, TimedValues, rising
from ahrs_service.links.logs.tlog import TlogFile
from ahrs_service.links.mavlink.gps_velocity import LEAST_FIX
from ahrs_service.records import Floats, Kind, Rows

_UNIX_FROM_NS: Final = 10**18
_NO_VOLTAGE: Final = 65535
"""BATTERY_STATUS.voltages of an absent cell (MAVLink common.xml)."""
_EARTH_M: Final = 6_371_000.0
"""Mean radius of the Earth: positions are differences over a few kilometres only."""


def tlog_covariates(
    tlog: TlogFile, readings: Rows, frame_index: npt.NDArray[np.int32], imu: Rows
) -> Covariates:
    """Return the covariates of the vehicle of `imu` [N], readings of one IMU message.

    `readings` [M] and `frame_index` [M] are those of the whole file.
    """
    clock = _Clock(tlog, readings, frame_index, imu)

    def table_of(name: str) -> Rows | None:
        return tlog.tables.get((*clock.vehicle, name))

    vibration = supply = throttle = airspeed = TimedValues()
    if (table := table_of("VIBRATION")) is not None:
        values = _stack(table, ("vibration_x", "vibration_y", "vibration_z"))
        vibration = rising(clock.before(table), values)
    if (table := table_of("BATTERY_STATUS")) is not None:
        known = table[table["voltages"][:, 0] != _NO_VOLTAGE]
        supply = rising(clock.before(known), known["voltages"][:, 0] * 1e-3)
    if (table := table_of("VFR_HUD")) is not None:
        throttle = rising(clock.before(table), table["throttle"].astype(np.float64) * 1e-2)
        airspeed = rising(clock.before(table), table["airspeed"].astype(np.float64))
    return Covariates(
        power_on_s=clock.power_on_s,
        vibration_m_s2=vibration,
        current_a=_current(clock, table_of("BATTERY_STATUS"), table_of("SYS_STATUS")),
        supply_v=supply,
        throttle=throttle,
        airspeed_m_s=airspeed,
        position_ned_m=_position(clock, table_of("GPS_RAW_INT")),
    )


class _Clock:
    """Times of messages on the clock of the IMU samples, less what makes that Unix time."""

    def __init__(
        self, tlog: TlogFile, readings: Rows, frame_index: npt.NDArray[np.int32], imu: Rows
    ) -> None:
        mine = readings["kind"] == Kind.IMU
        for name in ("source", "system", "component"):
            mine &= readings[name] == imu[name][0]
        self._frame, self._time_ns = frame_index[mine], readings["time_ns"][mine]
        self.vehicle = int(imu["system"][0]), int(imu["component"][0])
        self.power_on_s = 0.0
        table = tlog.tables.get((*self.vehicle, "ATTITUDE_QUATERNION"))
        table = tlog.tables.get((*self.vehicle, "ATTITUDE")) if table is None else table
        if int(imu["time_ns"][0]) > _UNIX_FROM_NS and table is not None:
            boot_s = table["time_boot_ms"] * 1e-3
            self.power_on_s = float(np.median(self.before(table) - boot_s))

    def before(self, table: Rows) -> Floats:
        """Return the time [s] of the IMU message before each frame of a table."""
        at = np.searchsorted(self._frame, table["frame_index"]) - 1
        return self._time_ns[np.maximum(at, 0)] * 1e-9 - self.power_on_s


def _stack(table: Rows, names: tuple[str, ...]) -> Floats:
    return np.stack([table[name] for name in names], axis=1).astype(np.float64)


def _current(clock: _Clock, *tables: Rows | None) -> TimedValues:
    """Return the current of the first message that measures it."""
    for table in tables:
        if table is not None and (table["current_battery"] >= 0).any():
            known = table[table["current_battery"] >= 0]
            return rising(clock.before(known), known["current_battery"] * 1e-2)
    return TimedValues()


def _position(clock: _Clock, table: Rows | None) -> TimedValues:
    """Return the receiver's position from its first 3D fix [m], in a local tangent plane."""
    if table is None or not (table["fix_type"] >= LEAST_FIX).any():
        return TimedValues()
    table = table[table["fix_type"] >= LEAST_FIX]
    latitude, longitude = (np.radians(table[name] * 1e-7) for name in ("lat", "lon"))
    north = _EARTH_M * (latitude - latitude[0])
    east = _EARTH_M * np.cos(latitude[0]) * (longitude - longitude[0])
    down = (table["alt"][0] - table["alt"].astype(np.float64)) * 1e-3
    return rising(clock.before(table), np.stack([north, east, down], axis=1))
