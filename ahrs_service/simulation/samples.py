"""A flight as the estimator would get it over a link that loses nothing, without the link."""

import numpy as np

from ahrs_service.records import SAMPLE_DTYPE, Airframe, ImuSource, Rows, empty
from ahrs_service.simulation.scenario import Flight


def samples_of(flight: Flight, airframe: Airframe, magnetometer: bool = False) -> Rows:
    """Return the flight's samples [N] SAMPLE_DTYPE, six axes or nine, with IMU temperature."""
    rows = flight.rows
    samples = empty(SAMPLE_DTYPE, len(rows))
    samples["time_ns"] = np.round(rows["time_s"] * 1e9).astype(np.int64)
    samples["received_ns"] = samples["time_ns"]
    samples["gyro_rad_s"], samples["accel_m_s2"] = rows["gyro_rad_s"], rows["accel_m_s2"]
    samples["temperature_degc"] = rows["imu_degc"]
    samples["source"], samples["airframe"] = ImuSource.HIGHRES_IMU, airframe
    if magnetometer:
        samples["mag_ut"] = rows["mag_ut"]
    return samples
