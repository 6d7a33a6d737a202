"""The real recordings as diagnosis takes them: BROAD trials, second IMUs, planted effects."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.diagnosis.input.diagnosis_input import Recorded, Series
from ahrs_service.diagnosis.input.effect_removal import with_effects
from ahrs_service.effects.base import Effect, Values
from ahrs_service.links.logs.dataflash_tables import read_tables
from ahrs_service.records import Floats
from ahrs_service.rotation import multiply_columns
from ahrs_service.simulation.reference_track import continuous, smooth

_FRD_FROM_FLU = np.array([1.0, -1.0, -1.0])
_HALF = np.sqrt(0.5)
_NED_FROM_ENU = np.array([0.0, _HALF, _HALF, 0.0])
_FLU_FROM_FRD = np.array([0.0, 1.0, 0.0, 0.0])
_EVERY = 6

GYRO_LSB_RAD_S = np.radians(1.0 / 16.4)
"""MPU-6000 at +-2000 deg/s: 16.4 counts per deg/s."""
ACCEL_LSB_M_S2 = STANDARD_GRAVITY_M_S2 / 2048.0
"""MPU-6000 at +-16 g: 2048 counts per g."""
_COUNTS = 32767


def broad_trial(path: Path) -> Recorded:
    """Return one BROAD trial, the optical system as its reference, in body axes FRD and NED.

    The reference is taken at a sixth of the IMU's rate, 48 Hz, as autopilots tell theirs; its
    velocity is that of a smoothing spline through the positions of the markers.
    """
    with np.load(path) as trial:
        rate_hz = float(trial["sampling_rate"])
        gyro = trial["imu_gyr"].astype(np.float64) * _FRD_FROM_FLU
        accel = trial["imu_acc"].astype(np.float64) * _FRD_FROM_FLU
        attitude = trial["opt_quat"].astype(np.float64)
        position = trial["opt_pos"].astype(np.float64)[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    time_s = np.arange(len(gyro)) / rate_hz
    seen = np.isfinite(attitude).all(axis=1) & np.isfinite(position).all(axis=1)
    seen = np.flatnonzero(seen)[::_EVERY]
    turned = multiply_columns(
        multiply_columns(np.broadcast_to(_NED_FROM_ENU, (len(seen), 4)), attitude[seen]),
        np.broadcast_to(_FLU_FROM_FRD, (len(seen), 4)),
    )
    velocity = smooth(time_s[seen], position[seen], "position").derivative()(time_s[seen])
    return Recorded(
        name=path.stem,
        imu_time_s=time_s,
        gyro_rad_s=gyro,
        accel_m_s2=accel,
        attitude=Series(time_s[seen], continuous(turned)),
        velocity_ned_m_s=Series(time_s[seen], velocity),
        body_rate_rad_s=Series(),
        temperature_degc=Series(),
        vibration_m_s2=Series(),
        current_a=Series(),
        throttle=Series(),
        airspeed_m_s=Series(),
    )


def planted(recorded: Recorded, effect: Effect, values: Values) -> Recorded:
    """Return a recording whose raw IMU had this effect too: added, quantised, clipped.

    The sum is cut to whole counts of an MPU-6000 and to its range, as the autopilot reads it.
    """
    felt = with_effects(recorded, [(effect, values)])
    return replace(
        felt,
        gyro_rad_s=_counted(felt.gyro_rad_s, GYRO_LSB_RAD_S),
        accel_m_s2=_counted(felt.accel_m_s2, ACCEL_LSB_M_S2),
    )


def _counted(values: Floats, unit: float) -> Floats:
    return np.clip(np.round(values / unit), -_COUNTS - 1, _COUNTS) * unit


def both_imus(path: Path) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return time [N] [s], rate and force [N, 3] of the first IMU of a .bin, and of the second."""
    log = read_tables(path)
    first, second = log.table("IMU"), log.table("IMU2")
    clock = "TimeUS" if "TimeUS" in (first.dtype.names or ()) else "TimeMS"
    time_s = first[clock].astype(np.float64) * (1e-6 if clock == "TimeUS" else 1e-3)
    count = min(len(first), len(second))
    columns = [
        np.stack([log.column(rows[:count], name, f"{sensor}{axis}") for axis in "XYZ"], axis=1)
        for rows, name in ((first, "IMU"), (second, "IMU2"))
        for sensor in ("Gyr", "Acc")
    ]
    return time_s[:count], *columns


def part(recorded: Recorded, begin: float, end: float) -> Recorded:
    """Return a share of a recording, 0 to 1 of its IMU's time."""
    first, last = recorded.imu_time_s[[0, -1]]
    start, stop = first + begin * (last - first), first + end * (last - first)

    def cut(series: Series) -> Series:
        inside = (series.time_s >= start) & (series.time_s <= stop)
        return Series(series.time_s[inside], series.values[inside]) if len(series) else series

    inside = (recorded.imu_time_s >= start) & (recorded.imu_time_s <= stop)
    return replace(
        recorded,
        imu_time_s=recorded.imu_time_s[inside],
        gyro_rad_s=recorded.gyro_rad_s[inside],
        accel_m_s2=recorded.accel_m_s2[inside],
        attitude=cut(recorded.attitude),
        velocity_ned_m_s=cut(recorded.velocity_ned_m_s),
        body_rate_rad_s=cut(recorded.body_rate_rad_s),
        temperature_degc=cut(recorded.temperature_degc),
        vibration_m_s2=cut(recorded.vibration_m_s2),
        current_a=cut(recorded.current_a),
        throttle=cut(recorded.throttle),
        airspeed_m_s=cut(recorded.airspeed_m_s),
    )
