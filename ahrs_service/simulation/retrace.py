"""A flight along the motion of a recording: what its IMU should have given."""

from dataclasses import dataclass

import numpy as np

from ahrs_service.records import Floats
from ahrs_service.simulation import environment
from ahrs_service.simulation.imu import Imu
from ahrs_service.simulation.reference_track import ReferenceTrack
from ahrs_service.simulation.scenario import FLIGHT_DTYPE, Flight


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Effect inputs other than motion, at the instants [N] of a flight; NaN is unknown.

    `temperature_degc` of the IMU, `vibration_m_s2` 1-sigma, `current_a`, `throttle` 0 to 1,
    `airspeed_m_s`.
    """

    temperature_degc: Floats
    vibration_m_s2: Floats
    current_a: Floats
    throttle: Floats
    airspeed_m_s: Floats


def retrace(
    name: str,
    track: ReferenceTrack,
    surroundings: Surroundings,
    time_s: Floats,
    rate_hz: float,
    seed: int,
    imu: Imu,
) -> Flight:
    """Return the flight that `imu` makes along `track`, at times [N] [s] `rate_hz` apart.

    The autopilot's own attitude is the track's. What is unknown of the surroundings is zero in the
    messages, the temperature that of the calibration's room. ValueError where the track is too
    short, or an effect needs what is unknown.
    """
    truth = track.motion(time_s)
    truth["time_s"] -= time_s[0]
    truth["throttle"] = np.nan_to_num(surroundings.throttle)
    speed = truth["airspeed_m_s"]
    airspeed = surroundings.airspeed_m_s
    truth["airspeed_m_s"] = np.where(np.isfinite(airspeed), airspeed, speed)
    truth["airborne"] = 1.0
    rng = np.random.default_rng([seed, 2])
    gyro, accel = imu.measure(
        truth,
        surroundings.temperature_degc,
        rate_hz,
        rng,
        surroundings.current_a,
        surroundings.vibration_m_s2,
    )
    rows = np.zeros(len(truth), FLIGHT_DTYPE)
    for field in truth.dtype.names or ():
        rows[field] = truth[field]
    altitude = environment.HOME_ALTITUDE_M - truth["position_ned_m"][:, 2]
    degc = surroundings.temperature_degc
    rows["gyro_rad_s"], rows["accel_m_s2"] = gyro, accel
    rows["imu_degc"] = np.where(np.isfinite(degc), degc, imu.calibration.room_degc)
    rows["air_degc"] = rows["imu_degc"]
    rows["mag_ut"] = environment.magnetic_field_ut(truth)
    rows["pressure_pa"] = environment.pressure_pa(altitude)
    rows["pitot_pa"] = environment.dynamic_pressure_pa(truth["airspeed_m_s"])
    rows["estimate_ned_from_body"] = truth["ned_from_body"]
    rows["vibration_m_s2"] = np.nan_to_num(surroundings.vibration_m_s2)[:, None]
    rows["current_a"] = np.nan_to_num(surroundings.current_a)
    return Flight(name, seed, rate_hz, (), imu.calibration, rows)
