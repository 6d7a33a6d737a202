"""Simulated benches as the procedures see them: IMU columns, and the calibration behind them."""

from dataclasses import replace

import numpy as np
import pytest

from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.poses import POSE_DTYPE
from ahrs_service.records import empty
from ahrs_service.sensor.parameters import TriadCalibration
from ahrs_service.simulation.imu import Imu, consumer_grade
from ahrs_service.simulation.scenario import make_flight


def columns_of(flight):
    rows = flight.rows
    return ImuColumns(
        rows["time_s"],
        rows["gyro_rad_s"].copy(),
        rows["accel_m_s2"].copy(),
        rows["imu_degc"].astype(np.float64),
    )


def white(imu):
    """The sensor with white noise only, the basis of standard errors."""
    return replace(
        imu,
        gyro_noise=replace(imu.gyro_noise, walk=0.0, wander=0.0),
        accel_noise=replace(imu.accel_noise, walk=0.0, wander=0.0),
    )


def warm(imu):
    """The sensor at its room temperature: matrix and bias alone."""
    calibration = imu.calibration
    plain = {
        name: TriadCalibration(matrix=triad.matrix, bias=triad.bias)
        for name, triad in (("gyro", calibration.gyro), ("accel", calibration.accel))
    }
    return replace(imu, calibration=replace(calibration, **plain), propeller=None)


def small_imu():
    return warm(consumer_grade())


@pytest.fixture(scope="session")
def bench():
    """Run a simulated bench; the columns and the flight."""

    def run(name, seconds, seed=1, rate_hz=100.0, imu=None):
        flight = make_flight(name, seconds, seed, rate_hz, imu or white(small_imu()))
        return columns_of(flight), flight

    return run


@pytest.fixture(scope="session")
def perfect():
    return Imu()


def poses_of(force, gyro=None, degc=25.0, hold_s=3.0):
    """Still poses with these means [K, 3], as if cut from a stream of 100 Hz."""
    poses = empty(POSE_DTYPE, len(force))
    poses["accel_m_s2"] = force
    poses["gyro_rad_s"] = 0.0 if gyro is None else gyro
    poses["temperature_degc"] = degc
    poses["start_s"] = 2.0 * hold_s * np.arange(len(force))
    poses["stop_s"] = poses["start_s"] + hold_s
    poses["first"] = 100.0 * poses["start_s"]
    poses["last"] = 100.0 * poses["stop_s"]
    return poses
