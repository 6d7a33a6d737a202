"""Rotor drag as a measure of velocity, on simulated flights of a point mass with a rotor's drag."""

import numpy as np
import pytest

from ahrs_service.attitude_interpolation import rotation_vectors
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.estimator import Estimator
from ahrs_service.records import SAMPLE_DTYPE, Airframe, empty
from ahrs_service.rotation import (
    inverse_columns,
    multiply_columns,
    quaternion_columns,
    rotate_columns,
)

RATE_HZ = 100.0
DRAG_PER_S = 0.25
GYRO_NOISE_RAD_S = 0.02
SHAKE_M_S2 = 0.5
BIAS_RAD_S = (0.004, -0.006, 0.003)


def fly_tilted(roll, pitch, heading):
    """Fly level with the attitude by the angles [N] [rad], in still air.

    dv/dt = thrust + drag - g, drag -k v along body x and y (Leishman et al. 2014), and a thrust
    along -z that holds the height. Returns the true attitude [N, 4], speed [N] and samples [N].
    """
    count, dt = len(roll), 1.0 / RATE_HZ
    truth = quaternion_columns(np.stack([roll, pitch, heading], axis=1))
    x, y, z = (rotate_columns(truth, np.tile(axis, (count, 1))) for axis in np.eye(3))
    force, velocity, speed = np.zeros((count, 3)), np.zeros(3), np.zeros(count)
    for n in range(count):
        force[n, 0] = -DRAG_PER_S * (x[n] @ velocity)
        force[n, 1] = -DRAG_PER_S * (y[n] @ velocity)
        across = force[n, 0] * x[n, 2] + force[n, 1] * y[n, 2]
        force[n, 2] = -(STANDARD_GRAVITY_M_S2 + across) / z[n, 2]
        speed[n] = np.linalg.norm(velocity)
        velocity += dt * (force[n, 0] * x[n] + force[n, 1] * y[n] + force[n, 2] * z[n])
        velocity[2] = 0.0
    rng = np.random.default_rng(3)
    samples = empty(SAMPLE_DTYPE, count)
    samples["time_ns"] = samples["received_ns"] = np.rint(np.arange(1, count + 1) * dt * 1e9)
    rates = rotation_vectors(truth) / dt
    samples["gyro_rad_s"] = np.concatenate([rates[:1], rates]) + BIAS_RAD_S
    samples["gyro_rad_s"] += rng.normal(0.0, GYRO_NOISE_RAD_S, (count, 3))
    samples["accel_m_s2"] = force + rng.normal(0.0, SHAKE_M_S2, (count, 3))
    samples["airframe"] = Airframe.MULTIROTOR
    return truth, speed, samples


def tilt_errors_deg(truth, samples):
    """Angle between the true and the estimated vertical [N]."""
    estimates = Estimator().run(samples)
    turned = multiply_columns(truth, inverse_columns(estimates["ned_from_body"]))
    down = rotate_columns(turned, np.tile([0.0, 0.0, 1.0], (len(truth), 1)))
    return np.degrees(np.arccos(np.clip(down[:, 2], -1.0, 1.0)))


def circle(tilt_deg, period_s):
    """Circle with nose down and a bank of `tilt_deg` each; mean speed [m/s], rms error [deg]."""
    t = np.arange(int(150.0 * RATE_HZ)) / RATE_HZ
    begun = np.clip((t - 10.0) / 3.0, 0.0, 1.0)
    tilt = np.radians(tilt_deg) * begun
    heading = 2.0 * np.pi / period_s * np.cumsum(begun) / RATE_HZ
    truth, speed, samples = fly_tilted(tilt, -tilt, heading)
    errors = tilt_errors_deg(truth, samples)
    flown = t > 40.0
    return speed[flown].mean(), float(np.sqrt(np.mean(errors[flown] ** 2)))


@pytest.mark.parametrize(
    ("tilt_deg", "period_s", "speed_m_s", "limit_deg"),
    [
        (6.0, 40.0, 4.9, 1.0),
        (6.0, 100.0, 5.6, 1.0),
        (12.0, 40.0, 10.0, 1.5),
        (12.0, 100.0, 11.5, 1.3),
        (15.0, 30.0, 11.5, 1.3),
    ],
)
def test_a_circle_is_no_steady_flight(tilt_deg, period_s, speed_m_s, limit_deg):
    """The drag is as large as a hand's tilt would be, and right.

    Where the gates are open, a circle of 40 s, gravity alone would take half of the bank away.
    """
    speed, error_deg = circle(tilt_deg, period_s)
    assert speed == pytest.approx(speed_m_s, abs=0.15)
    assert error_deg < limit_deg
