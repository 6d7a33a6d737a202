import numpy as np
import pytest

from ahrs_service.app.estimate.recognition import Signs, profile_of, signs_of
from ahrs_service.app.estimate.sample_columns import Columns
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.simulation.scenario import make_flight

RATE_HZ = 50.0


def columns(gyro, accel, rate_hz=RATE_HZ):
    time_ns = np.rint(np.arange(len(gyro)) * 1e9 / rate_hz).astype(np.int64)
    return Columns(time_ns, np.asarray(gyro), np.asarray(accel))


def hover(seconds=60.0, seed=1):
    """Thrust along -z that trembles, a little drag, tilting at random: a multirotor."""
    random = np.random.default_rng(seed)
    count = round(seconds * RATE_HZ)
    gyro = random.normal(0.0, 0.5, (count, 3))
    accel = random.normal(0.0, (0.2, 0.2, 0.5), (count, 3)) - [0.0, 0.0, STANDARD_GRAVITY_M_S2]
    return gyro, accel


@pytest.mark.parametrize("name", ["flight", "circling", "seed-flight"])
@pytest.mark.parametrize("rate_hz", [10.0, 50.0, 200.0])
def test_a_fixed_wing_is_known_by_its_turns(name, rate_hz):
    rows = make_flight(name, 90.0, seed=3, rate_hz=rate_hz).rows
    signs = signs_of(columns(rows["gyro_rad_s"], rows["accel_m_s2"], rate_hz), "frd")
    assert profile_of(signs) == "fixed_wing"
    # In a level turn at bank b the line's slope is V / (1 + cos(b)), in a loop V itself.
    speed = rows["airspeed_m_s"].max()
    assert 0.4 * speed < signs.speed_m_s < 1.1 * speed


def test_a_sensor_rotated_by_hand_reads_gravity_in_all_directions():
    t = np.arange(3000) / RATE_HZ
    tilt = 1.2 * np.sin(0.5 * t)
    accel = -STANDARD_GRAVITY_M_S2 * np.stack([np.sin(tilt), 0.0 * t, np.cos(tilt)], axis=1)
    gyro = np.stack([0.0 * t, -np.gradient(tilt, t), 0.0 * t], axis=1)
    assert profile_of(signs_of(columns(gyro, accel), "frd")) == "hand_held"


def test_thrust_stays_along_one_axis():
    gyro, accel = hover()
    signs = signs_of(columns(gyro, accel), "frd")
    assert profile_of(signs) == "multirotor"
    assert profile_of(signs_of(columns(gyro, accel * -1.0), "frd")) == "multirotor"


def test_what_is_pushed_about_upright_is_held():
    """A hand that moves it by some centimetres about once a second, never tilting."""
    t = np.arange(3000) / RATE_HZ
    push = np.stack([np.sin(5.0 * t), np.cos(7.0 * t), np.sin(6.0 * t + 1.0)], axis=1)
    accel = push - [0.0, 0.0, STANDARD_GRAVITY_M_S2]
    signs = signs_of(columns(np.zeros((len(t), 3)), accel), "frd")
    assert signs.sideways == pytest.approx(1.0, abs=0.25)
    assert profile_of(signs) == "hand_held"


def test_noise_alone_is_not_pushed():
    gyro, accel = hover()
    accel = np.random.default_rng(2).normal(0.0, 0.05, accel.shape) + accel.mean(axis=0)
    assert signs_of(columns(0.01 * gyro, accel), "frd").sideways == 0.0


def test_frames_and_missing_rows_change_nothing():
    rows = make_flight("flight", 60.0, seed=1, rate_hz=RATE_HZ).rows
    gyro, accel = rows["gyro_rad_s"].copy(), rows["accel_m_s2"].copy()
    gyro[100:200], accel[500] = np.nan, np.inf
    frd = signs_of(columns(gyro, accel), "frd")
    flipped = [1.0, -1.0, -1.0]
    assert signs_of(columns(gyro * flipped, accel * flipped), "flu") == frd
    assert profile_of(frd) == "fixed_wing"


def test_drift_on_the_ground_is_no_flight():
    """Warming up, bias of gyro and accelerometer move together as force and rate of a turn do."""
    rows = make_flight("rest", 150.0, seed=1, rate_hz=RATE_HZ).rows
    signs = signs_of(columns(rows["gyro_rad_s"], rows["accel_m_s2"]), "frd")
    assert profile_of(signs) == "multirotor"


@pytest.mark.parametrize("count", [1, 2, 500])
def test_too_little_data_is_not_recognised(count):
    gyro, accel = hover()
    assert signs_of(columns(gyro[:count], accel[:count]), "frd") == Signs()
    missing = columns(np.full((count, 3), np.nan), accel[:count])
    assert signs_of(missing, "frd") == Signs()
