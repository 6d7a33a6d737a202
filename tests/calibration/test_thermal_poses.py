"""Still rows of a recording: what ends a pose and what does not."""

import numpy as np
import pytest

from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.thermal.pose_groups import joined, still_rows
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.errors import CalibrationError

RATE_HZ = 20.0


def lying(seconds, force=(0.0, 0.0, -9.81), drift=0.0, seed=1):
    """A unit that lies still; its accelerometer drifts by `drift` [m/s^2] from first to last."""
    rng = np.random.default_rng(seed)
    count = round(seconds * RATE_HZ)
    ramp = np.linspace(0.0, 1.0, count)[:, None]
    accel = np.array(force) + drift * ramp + rng.normal(0.0, 0.01, (count, 3))
    return rng.normal(0.0, 1e-3, (count, 3)), accel


def shaken(seconds=3.0, seed=9):
    rng = np.random.default_rng(seed)
    count = round(seconds * RATE_HZ)
    return rng.normal(0.0, 0.5, (count, 3)), rng.normal(0.0, 2.0, (count, 3)) - [0.0, 0.0, 9.81]


def columns(*parts, degc=None):
    gyro, accel = (np.concatenate(part) for part in zip(*parts, strict=True))
    time = np.arange(len(gyro)) / RATE_HZ
    temperature = np.linspace(10.0, 40.0, len(gyro)) if degc is None else np.full(len(gyro), degc)
    return ImuColumns(time, gyro, accel, temperature)


def test_a_row_is_the_mean_of_a_second():
    gyro, accel = still_rows(columns(lying(60.0)))
    assert len(gyro) == len(accel) == 60
    assert gyro.time_s[:2] == pytest.approx([0.475, 1.475])
    assert accel.output.std(axis=0) == pytest.approx(0.01 / np.sqrt(20.0), rel=0.3)
    assert gyro.levels == accel.levels == 1


def test_drift_of_65_mg_does_not_end_a_pose():
    """By far more than a pose found for six positions may shift (5 mg)."""
    _, accel = still_rows(columns(lying(600.0, drift=65e-3 * STANDARD_GRAVITY_M_S2)))
    assert accel.levels == 1


def test_motion_gives_no_rows_and_a_pose_that_is_as_before_goes_on():
    _, accel = still_rows(columns(lying(60.0), shaken(), lying(60.0, seed=2)))
    assert accel.levels == 1
    assert 117 <= len(accel) <= 120


def test_a_bump_that_tilts_the_unit_by_a_tenth_of_a_degree_begins_another():
    tilted = (9.81 * np.sin(np.radians(0.15)), 0.0, -9.81)
    _, accel = still_rows(columns(lying(60.0), shaken(), lying(60.0, tilted)))
    assert accel.levels == 2


def test_a_fixture_that_comes_back_brings_the_pose_back():
    up, side = (0.0, 0.0, -9.81), (9.81, 0.0, 0.0)
    parts = []
    for n in range(6):
        parts += [lying(20.0, side if n % 2 else up, seed=n), shaken(seed=n)]
    _, accel = still_rows(columns(*parts))
    assert accel.levels == 2


def test_a_slow_steady_turn_is_no_rest():
    gyro, accel = lying(30.0)
    gyro[:, 2] += np.radians(5.0)
    rows, _ = still_rows(columns(lying(60.0), (gyro, accel), lying(60.0, seed=3)))
    assert 118 <= len(rows) <= 120


def test_samples_without_temperature_give_no_rows():
    one = columns(lying(60.0))
    one.temperature_degc[: 20 * 30] = np.nan
    rows, _ = still_rows(one)
    assert len(rows) == 30


def test_a_flight_is_refused():
    with pytest.raises(CalibrationError, match="put the unit down"):
        still_rows(columns(shaken(60.0)))


def test_sessions_keep_their_levels_apart_unless_they_are_one_input():
    parts = [still_rows(columns(lying(20.0, seed=n)), n)[0] for n in range(3)]
    assert joined(parts, same_levels=False).levels == 3
    assert joined(parts, same_levels=True).levels == 1
    assert np.array_equal(np.unique(joined(parts, same_levels=True).session), [0, 1, 2])
