"""The messages of the simulated autopilot, made from the columns of a flight."""

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.records import Rows
from ahrs_service.rotation import euler_columns

BOOT_US: Final = 3_000_000
"""How long the autopilot has been on when the flight begins [us]."""
UNIX_START_US: Final = 1_767_261_600_000_000
"""Wall time at the begin of every flight, 2026-01-01 10:00 UTC: a flight is the same each time."""

_MG: Final = 1e-3 * STANDARD_GRAVITY_M_S2
_HOME_LATITUDE_DEG: Final = 47.4
_HOME_LONGITUDE_DEG: Final = 8.55
_HOME_ALTITUDE_M: Final = 120.0
_DEG_PER_M: Final = 1.0 / 111_195.0
_GAUSS_PER_UT: Final = 0.01
_BATTERY_MAH: Final = 5000.0
_UPDATED: Final = 0x1FFF
_NO_VOLTAGE: Final = 65535
_UNIT: Final = b"SIM-1"
"""The number of the simulated board: the serial of its sensor, the rest zeros."""


def _int16(value: float) -> int:
    """Cut toward zero and clip, as the conversion from float does on the autopilot."""
    return max(-32768, min(32767, int(value)))


class FlightMessages:
    """Builds one message of a kind for one row of the flight; `names` are those that it can.

    `rows` [N] at `rate_hz`: the fields of ahrs_service.simulation.scenario.FLIGHT_DTYPE. Units
    and quirks are ArduPilot's: RAW_IMU and SCALED_IMU in mG and mrad/s cut to whole numbers with
    the IMU's own temperature, HIGHRES_IMU with the barometer's.
    """

    def __init__(self, rows: Rows, rate_hz: float) -> None:
        self._rows = rows
        self._rate_hz = rate_hz
        self._truth_euler = euler_columns(rows["ned_from_body"])
        self._estimate_euler = euler_columns(rows["estimate_ned_from_body"])
        self._used_mah = np.cumsum(rows["current_a"], dtype=np.float64) / rate_hz / 3.6
        self._builders: dict[str, Callable[[int], Any]] = {
            "HEARTBEAT": self._heartbeat,
            "SYSTEM_TIME": self._system_time,
            "RAW_IMU": self._raw_imu,
            "SIM_STATE": self._sim_state,
            "SCALED_IMU": self._scaled_imu,
            "HIGHRES_IMU": self._highres_imu,
            "ATTITUDE": self._attitude,
            "ATTITUDE_QUATERNION": self._attitude_quaternion,
            "LOCAL_POSITION_NED": self._local_position_ned,
            "GPS_RAW_INT": self._gps_raw_int,
            "VFR_HUD": self._vfr_hud,
            "SCALED_PRESSURE": self._scaled_pressure,
            "VIBRATION": self._vibration,
            "BATTERY_STATUS": self._battery_status,
            "AUTOPILOT_VERSION": self._autopilot_version,
        }

    @property
    def names(self) -> tuple[str, ...]:
        """Messages that can be built, in the order in which one instant sends them.

        SIM_STATE follows RAW_IMU, whose time it shares, for it carries none.
        """
        return tuple(self._builders)

    def build(self, name: str, index: int) -> Any:
        """Return message `name` of row `index`."""
        return self._builders[name](index)

    def time_us(self, index: int) -> int:
        """Time since boot [us] of a row."""
        return BOOT_US + int(index * 1_000_000 / self._rate_hz)

    def _time_ms(self, index: int) -> int:
        return self.time_us(index) // 1000

    def _heartbeat(self, index: int) -> Any:
        is_flying = self._rows["airborne"][index] > 0.5
        mode = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | dialect.MAV_MODE_FLAG_HIL_ENABLED
        if is_flying or self._rows["airspeed_m_s"][index] > 0.5:
            mode |= dialect.MAV_MODE_FLAG_SAFETY_ARMED
        state = dialect.MAV_STATE_ACTIVE if is_flying else dialect.MAV_STATE_STANDBY
        return dialect.MAVLink_heartbeat_message(
            dialect.MAV_TYPE_FIXED_WING, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, 0, state, 3
        )

    def _system_time(self, index: int) -> Any:
        since_boot_us = self.time_us(index)
        return dialect.MAVLink_system_time_message(
            UNIX_START_US + since_boot_us - BOOT_US, since_boot_us // 1000
        )

    def _int16_imu(self, index: int) -> tuple[list[int], int]:
        row = self._rows[index]
        values = [_int16(value / _MG) for value in row["accel_m_s2"].tolist()]
        values += [_int16(value * 1e3) for value in row["gyro_rad_s"].tolist()]
        values += [_int16(value * 10.0) for value in row["mag_ut"].tolist()]
        return values, _int16(float(row["imu_degc"]) * 100.0)

    def _raw_imu(self, index: int) -> Any:
        values, temperature = self._int16_imu(index)
        return dialect.MAVLink_raw_imu_message(self.time_us(index), *values, 0, temperature)

    def _scaled_imu(self, index: int) -> Any:
        values, temperature = self._int16_imu(index)
        return dialect.MAVLink_scaled_imu_message(self._time_ms(index), *values, temperature)

    def _highres_imu(self, index: int) -> Any:
        row = self._rows[index]
        pressure_pa = float(row["pressure_pa"])
        return dialect.MAVLink_highres_imu_message(
            self.time_us(index),
            *row["accel_m_s2"].tolist(),
            *row["gyro_rad_s"].tolist(),
            *(_GAUSS_PER_UT * value for value in row["mag_ut"].tolist()),
            pressure_pa / 100.0,
            float(row["pitot_pa"]) / 100.0,
            44330.0 * (1.0 - (pressure_pa / 101325.0) ** 0.1903),
            float(row["air_degc"]),
            _UPDATED,
            0,
        )

    def _attitude(self, index: int) -> Any:
        return dialect.MAVLink_attitude_message(
            self._time_ms(index),
            *self._estimate_euler[index].tolist(),
            *self._rows["gyro_rad_s"][index].tolist(),
        )

    def _attitude_quaternion(self, index: int) -> Any:
        row = self._rows[index]
        return dialect.MAVLink_attitude_quaternion_message(
            self._time_ms(index),
            *row["estimate_ned_from_body"].tolist(),
            *row["gyro_rad_s"].tolist(),
        )

    def _place(self, index: int) -> tuple[float, float, float]:
        """Latitude and longitude [deg] and altitude [m], on a flat earth round home."""
        north, east, down = self._rows["position_ned_m"][index].tolist()
        shrink = math.cos(math.radians(_HOME_LATITUDE_DEG))
        return (
            _HOME_LATITUDE_DEG + north * _DEG_PER_M,
            _HOME_LONGITUDE_DEG + east * _DEG_PER_M / shrink,
            _HOME_ALTITUDE_M - down,
        )

    def _sim_state(self, index: int) -> Any:
        row = self._rows[index]
        latitude, longitude, altitude = self._place(index)
        return dialect.MAVLink_sim_state_message(
            *row["ned_from_body"].tolist(),
            *self._truth_euler[index].tolist(),
            *row["force_m_s2"].tolist(),
            *row["rate_rad_s"].tolist(),
            latitude,
            longitude,
            altitude,
            0.0,
            0.0,
            *row["velocity_ned_m_s"].tolist(),
            int(latitude * 1e7),
            int(longitude * 1e7),
        )

    def _local_position_ned(self, index: int) -> Any:
        row = self._rows[index]
        return dialect.MAVLink_local_position_ned_message(
            self._time_ms(index),
            *row["position_ned_m"].tolist(),
            *row["velocity_ned_m_s"].tolist(),
        )

    def _gps_raw_int(self, index: int) -> Any:
        north, east, _ = self._rows["velocity_ned_m_s"][index].tolist()
        latitude, longitude, altitude = self._place(index)
        return dialect.MAVLink_gps_raw_int_message(
            self.time_us(index),
            dialect.GPS_FIX_TYPE_3D_FIX,
            int(latitude * 1e7),
            int(longitude * 1e7),
            int(altitude * 1e3),
            90,
            140,
            int(math.hypot(north, east) * 100.0),
            int(math.degrees(math.atan2(east, north)) % 360.0 * 100.0),
            14,
        )

    def _vfr_hud(self, index: int) -> Any:
        row = self._rows[index]
        north, east, down = row["velocity_ned_m_s"].tolist()
        return dialect.MAVLink_vfr_hud_message(
            math.sqrt(2.0 * float(row["pitot_pa"]) / 1.225),
            math.hypot(north, east),
            int(math.degrees(self._estimate_euler[index, 2]) % 360.0),
            int(100.0 * float(row["throttle"])),
            self._place(index)[2],
            -down,
        )

    def _scaled_pressure(self, index: int) -> Any:
        row = self._rows[index]
        temperature = _int16(float(row["air_degc"]) * 100.0)
        return dialect.MAVLink_scaled_pressure_message(
            self._time_ms(index),
            float(row["pressure_pa"]) / 100.0,
            float(row["pitot_pa"]) / 100.0,
            temperature,
            temperature,
        )

    def _vibration(self, index: int) -> Any:
        return dialect.MAVLink_vibration_message(
            self.time_us(index), *self._rows["vibration_m_s2"][index].tolist(), 0, 0, 0
        )

    def _battery_status(self, index: int) -> Any:
        used_mah = float(self._used_mah[index])
        left = max(0.0, 1.0 - used_mah / _BATTERY_MAH)
        current_a = float(self._rows["current_a"][index])
        millivolts = int(1000.0 * (10.8 + 1.8 * left - 0.02 * current_a))
        return dialect.MAVLink_battery_status_message(
            0,
            dialect.MAV_BATTERY_FUNCTION_ALL,
            dialect.MAV_BATTERY_TYPE_LIPO,
            32767,
            [millivolts] + [_NO_VOLTAGE] * 9,
            int(100.0 * current_a),
            int(used_mah),
            -1,
            int(100.0 * left),
        )

    def _autopilot_version(self, index: int) -> Any:
        capabilities = (
            dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2 | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
        )
        nothing = [0] * 8
        return dialect.MAVLink_autopilot_version_message(
            *(capabilities, 0, 0, 0, 0, nothing, nothing, nothing, 0, 0, 0),
            list(_UNIT.ljust(18, b"\0")),
        )
