"""The velocity filter on flights where the accelerometer alone would mislead."""

import numpy as np
import pytest

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.estimator import Estimator
from ahrs_service.records import SAMPLE_DTYPE, Airframe, empty
from ahrs_service.rotation import (
    inverse_columns,
    multiply_columns,
    quaternion_columns,
    rotate_columns,
)
from ahrs_service.settings import FusionSettings, Settings
from ahrs_service.simulation.scenario import make_flight


def fly(scenario, seconds, mode, airframe=Airframe.FIXED_WING, with_airspeed=False, start_s=0.0):
    """Run a simulated flight from `start_s` on; return true attitude [N, 4] and estimates [N]."""
    rows = make_flight(scenario, seconds, seed=2, rate_hz=100.0).rows[int(start_s * 100.0) :]
    samples = empty(SAMPLE_DTYPE, len(rows))
    samples["time_ns"] = np.round(rows["time_s"] * 1e9).astype(np.int64)
    samples["gyro_rad_s"], samples["accel_m_s2"] = rows["gyro_rad_s"], rows["accel_m_s2"]
    samples["airframe"] = airframe
    if with_airspeed:
        samples["airspeed_m_s"][::10] = rows["airspeed_m_s"][::10]
    estimates = Estimator(Settings(fusion=FusionSettings(mode=mode))).run(samples)
    return rows["ned_from_body"], estimates


def tilt_errors_deg(truth, estimates):
    """Angle between the true and the estimated vertical [N], from 5 s on."""
    turned = multiply_columns(truth, inverse_columns(estimates["ned_from_body"]))
    down = rotate_columns(turned, np.tile([0.0, 0.0, 1.0], (len(truth), 1)))
    return np.degrees(np.arccos(np.clip(down[:, 2], -1.0, 1.0)))[500:]


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


def test_circling_is_no_climb_out_of_the_turn():
    truth, by_velocity = fly("circling", 180.0, "velocity")
    _, by_gates = fly("circling", 180.0, "gated")
    velocity_rms = rms(tilt_errors_deg(truth, by_velocity))
    assert velocity_rms < 3.0
    assert velocity_rms < 0.5 * rms(tilt_errors_deg(truth, by_gates))


@pytest.mark.parametrize("start_s", [40.0, 60.0, 80.0])
def test_started_in_flight_the_attitude_is_found_and_airspeed_helps(start_s):
    truth, without = fly("flight", 120.0, "velocity", start_s=start_s)
    _, aided = fly("flight", 120.0, "velocity", with_airspeed=True, start_s=start_s)
    errors = tilt_errors_deg(truth, without)
    assert rms(errors[1500:]) < 5.0
    assert rms(tilt_errors_deg(truth, aided)) < rms(errors)


def test_rest_teaches_the_bias():
    _, estimates = fly("rest", 30.0, "velocity")
    sigma = estimates["gyro_bias_sigma_rad_s"]
    assert sigma[-1].max() < 0.15 * sigma[10].max()


@pytest.mark.parametrize("airframe", [Airframe.FIXED_WING, Airframe.MULTIROTOR])
@pytest.mark.parametrize(("angle_deg", "frequency_hz"), [(10.0, 0.2), (30.0, 0.3), (45.0, 0.05)])
def test_tilted_by_hand_drag_is_doubted(airframe, angle_deg, frequency_hz):
    """Gravity along the axes is no wind: the tilt of a vehicle on the bench is right to degrees."""
    t = np.arange(6000) / 100.0
    angle = np.radians(angle_deg) * np.clip((t - 3.0) / 2.0, 0.0, 1.0)
    roll = angle * np.sin(2.0 * np.pi * frequency_hz * t)
    truth = quaternion_columns(np.stack([roll, np.zeros_like(t), np.zeros_like(t)], axis=1))
    samples = empty(SAMPLE_DTYPE, len(t))
    samples["time_ns"] = samples["received_ns"] = np.rint(t * 1e9)
    samples["gyro_rad_s"] = 0.0
    samples["gyro_rad_s"][:, 0] = np.gradient(roll, t)
    gravity = np.tile([0.0, 0.0, -STANDARD_GRAVITY_M_S2], (len(t), 1))
    samples["accel_m_s2"] = rotate_columns(inverse_columns(truth), gravity)
    samples["airframe"] = airframe
    estimates = Estimator().run(samples)
    assert tilt_errors_deg(truth, estimates).max() < 3.0
