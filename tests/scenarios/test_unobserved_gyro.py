"""A gyro that is stuck or silent in a manoeuvre: the attitude's sigma covers its error."""

import math

import numpy as np
import pytest

from ahrs_service.app.estimate.arrays import estimate_columns
from ahrs_service.app.estimate.sample_columns import Columns
from ahrs_service.app.files import config_file
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.rotation import inverse_columns, rotate_columns
from ahrs_service.simulation.scenario import make_flight

RATE_HZ = 100.0
SETTINGS = config_file.load(profile="fixed_wing")


@pytest.fixture(scope="module")
def flight():
    """A minute of the simulated flight."""
    return make_flight("flight", 60.0, seed=2, rate_hz=RATE_HZ).rows


def estimate(rows, gyro):
    time_ns = np.rint(rows["time_s"] * 1e9).astype(np.int64)
    out = estimate_columns(Columns(time_ns, gyro, rows["accel_m_s2"]), SETTINGS, "frd")
    down = np.broadcast_to([0.0, 0.0, 1.0], (len(rows), 3))
    ours, true = (
        rotate_columns(inverse_columns(q), down) for q in (out["quat"], rows["ned_from_body"])
    )
    error = np.degrees(np.arccos(np.clip((ours * true).sum(axis=1), -1.0, 1.0)))
    return error, out["sigma_deg"]


def steepest(rows):
    """When the aircraft rolls fastest [s]."""
    return float(rows["time_s"][np.argmax(np.abs(rows["rate_rad_s"][:, 0]))])


def test_a_stuck_axis_is_doubted_while_it_is_and_found_again_after(flight):
    begin_s = steepest(flight) - 0.5
    stuck = (flight["time_s"] >= begin_s) & (flight["time_s"] < begin_s + 1.5)
    gyro = flight["gyro_rad_s"].copy()
    gyro[stuck, 0] = gyro[stuck, 0][0]
    error, sigma = estimate(flight, gyro)
    tilt_sigma = np.hypot(sigma[:, 0], sigma[:, 1])
    noticed = stuck & (flight["time_s"] > begin_s + 0.4)
    assert error[noticed].max() > 3.0
    assert (error[noticed] < 3.0 * tilt_sigma[noticed]).all()
    assert error[flight["time_s"] > begin_s + 12.0].max() < 4.0


def test_without_a_number_sigma_grows_with_the_time(flight):
    begin_s = steepest(flight) - 0.5
    silent = (flight["time_s"] >= begin_s) & (flight["time_s"] < begin_s + 2.0)
    gyro = flight["gyro_rad_s"].copy()
    gyro[silent] = np.nan
    error, sigma = estimate(flight, gyro)
    # 1 rad/s unknown for 2 s; up to the limit of a gap, half a second, it is not one yet.
    assert math.degrees(1.9) < sigma[silent][-1, 0] < math.degrees(2.1)
    late = silent & (flight["time_s"] > begin_s + 0.6)
    assert (error[late] < 3.0 * sigma[late, 0]).all()
    assert np.isfinite(error).all()


def test_coarse_readings_at_rest_are_not_stuck():
    """Readings of one count stay the same for long; only during rotation is that a fault."""
    random = np.random.default_rng(1)
    count, t = 6000, np.arange(6000) / RATE_HZ
    step = 1e-3
    gyro = step * np.rint(random.normal(0.0, 0.3, (count, 3)))
    accel = np.tile([0.0, 0.0, -STANDARD_GRAVITY_M_S2], (count, 1))
    accel += random.normal(0.0, 0.02, (count, 3))
    columns = Columns(np.rint(t * 1e9).astype(np.int64), gyro, accel)
    sigma = estimate_columns(columns, SETTINGS, "frd")["sigma_deg"]
    assert sigma[1000:, :2].max() < 1.0
