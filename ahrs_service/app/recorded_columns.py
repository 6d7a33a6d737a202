"""From a .tlog to the columns that diagnosis takes."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.diagnosis.recorded import Recorded, Series
from ahrs_service.records import Floats, Rows
from ahrs_service.rotation import quaternion_columns
from links.errors import RecordingError
from links.tlog import Tables, read_tlog

_SCALED: Final = ("SCALED_IMU", "RAW_IMU")
_MILLI: Final = 1e-3
_NO_VOLTAGE: Final = 65535


def _largest(tables: Tables, name: str) -> Rows | None:
    """Return the fullest table of a message, of whichever sender."""
    keys = [key for key in tables if key[2] == name]
    return tables[max(keys, key=tables.count)] if keys else None


def _columns(rows: Rows, names: str) -> Floats:
    return np.stack([rows[name].astype(np.float64) for name in names.split()], axis=1)


def _ordered(time_s: Floats, values: Floats) -> Series:
    """Return the values in order of time, one of each instant."""
    times, first = np.unique(time_s, return_index=True)
    return Series(times, values[first])


def _series(rows: Rows | None, time_s: Floats | None, names: str, scale: float = 1.0) -> Series:
    if rows is None or time_s is None or not len(rows):
        return Series()
    values = _columns(rows, names) * scale
    return _ordered(time_s, values[:, 0] if values.shape[1] == 1 else values)


class _Clock:
    """Boot time [s] of messages that carry none, by those that were received with them."""

    def __init__(self, rows: Rows, time_s: Floats) -> None:
        self._received, first = np.unique(rows["received_us"], return_index=True)
        self._time_s = np.maximum.accumulate(time_s[first])

    def of(self, rows: Rows | None) -> Floats | None:
        """Return the boot time [N] [s] of each row, NaN-free."""
        if rows is None:
            return None
        names = rows.dtype.names or ()
        if "time_boot_ms" in names:
            return np.asarray(rows["time_boot_ms"] * _MILLI)
        received = rows["received_us"]
        since = np.interp(received, self._received, self._time_s)
        beyond = received - np.clip(received, self._received[0], self._received[-1])
        return np.asarray(since + beyond * 1e-6)


def _imu(tables: Tables, path: Path) -> tuple[Rows, Floats, Series, Series]:
    """Return the rows, their boot time [s], gyro and accelerometer of the best IMU message."""
    rows = _largest(tables, "HIGHRES_IMU")
    if rows is not None:
        rows = rows[rows["id"] == rows["id"][0]]
        time_s = rows["time_usec"] * 1e-6
        gyro = _series(rows, time_s, "xgyro ygyro zgyro")
        return rows, time_s, gyro, _series(rows, time_s, "xacc yacc zacc")
    for name in _SCALED:
        rows = _largest(tables, name)
        if rows is not None:
            stamp = "time_boot_ms" if name == "SCALED_IMU" else "time_usec"
            time_s = rows[stamp] * (_MILLI if name == "SCALED_IMU" else 1e-6)
            gyro = _series(rows, time_s, "xgyro ygyro zgyro", _MILLI)
            scale = _MILLI * STANDARD_GRAVITY_M_S2
            return rows, time_s, gyro, _series(rows, time_s, "xacc yacc zacc", scale)
    raise RecordingError(f"{path}: no HIGHRES_IMU, SCALED_IMU or RAW_IMU; record one of them")


def _attitude(tables: Tables, path: Path, clock: _Clock) -> tuple[Series, Series]:
    """Return attitude (wxyz) and body rates of the best attitude message."""
    rows = _largest(tables, "ATTITUDE_QUATERNION")
    rates = "rollspeed pitchspeed yawspeed"
    if rows is not None:
        time_s = clock.of(rows)
        return _series(rows, time_s, "q1 q2 q3 q4"), _series(rows, time_s, rates)
    rows = _largest(tables, "ATTITUDE")
    if rows is None:
        raise RecordingError(f"{path}: no ATTITUDE_QUATERNION or ATTITUDE to compare with")
    time_s = clock.of(rows)
    euler = _series(rows, time_s, "roll pitch yaw")
    attitude = Series(euler.time_s, quaternion_columns(euler.values))
    return attitude, _series(rows, time_s, rates)


def _temperature(tables: Tables, clock: _Clock) -> Series:
    """Return the IMU's own temperature [degC]: HIGHRES_IMU carries the barometer's."""
    for name in _SCALED:
        rows = _largest(tables, name)
        if rows is not None and "temperature" in (rows.dtype.names or ()):
            known = rows[rows["temperature"] != 0]
            if len(known) > 1:
                return _series(known, clock.of(known), "temperature", 0.01)
    return Series()


def _supply(battery: Rows | None, clock: _Clock) -> Series:
    """Return the voltage [V] of the battery: of its first cell field, where autopilots put it."""
    time_s = clock.of(battery)
    if battery is None or time_s is None:
        return Series()
    first = battery["voltages"][:, 0]
    known = first != _NO_VOLTAGE
    return _ordered(time_s[known], first[known] * _MILLI) if known.any() else Series()


def read_columns(path: Path, progress: Callable[[float], None] | None = None) -> Recorded:
    """Read what diagnosis takes from a .tlog; RecordingError says what is missing."""
    tables = read_tlog(path, progress).tables
    rows, time_s, gyro, accel = _imu(tables, path)
    clock = _Clock(rows, time_s)
    attitude, rates = _attitude(tables, path, clock)
    found: Mapping[str, Rows | None] = {
        name: _largest(tables, name)
        for name in ("LOCAL_POSITION_NED", "VIBRATION", "BATTERY_STATUS", "VFR_HUD")
    }
    local, hud, battery = found["LOCAL_POSITION_NED"], found["VFR_HUD"], found["BATTERY_STATUS"]
    shaking, vibration = found["VIBRATION"], "vibration_x vibration_y vibration_z"
    return Recorded(
        name=str(path),
        imu_time_s=gyro.time_s,
        gyro_rad_s=gyro.values,
        accel_m_s2=accel.values,
        attitude=attitude,
        velocity_ned_m_s=_series(local, clock.of(local), "vx vy vz"),
        body_rate_rad_s=rates,
        temperature_degc=_temperature(tables, clock),
        vibration_m_s2=_series(shaking, clock.of(shaking), vibration),
        current_a=_series(battery, clock.of(battery), "current_battery", 0.01),
        throttle=_series(hud, clock.of(hud), "throttle", 0.01),
        airspeed_m_s=_series(hud, clock.of(hud), "airspeed"),
        supply_v=_supply(battery, clock),
    )
