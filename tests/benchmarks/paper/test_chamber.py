"""The benches against what is known of them: geometry, lags, forms that no basis holds."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.sensor.noise import TriadNoise
from tests.benchmarks.paper.chamber import MOUNTING_RAD, RATE_RAD_S, Bench, Unit, draw
from tests.benchmarks.paper.thermal_parts import (
    ACCELS,
    GYROS,
    ROOM_DEGC,
    draw_triad,
    draw_unit,
    drift_shape,
)

QUIET = TriadNoise()


def quiet_unit(seed=1, lag_s=20.0):
    return Unit(
        draw_unit(np.random.default_rng(seed)),
        lag_s,
        QUIET,
        QUIET,
        gyro_step_rad_s=1e-9,
        accel_step_m_s2=1e-9,
        gyro_repeat_rad_s=0.0,
        accel_repeat_m_s2=0.0,
        thermometer_noise_degc=0.0,
        thermometer_step_degc=1e-9,
    )


def test_drift_is_nil_at_room_temperature_and_one_at_its_largest():
    for seed in range(20):
        shape = drift_shape(np.random.default_rng(seed), np.linspace(-40.0, 70.0, 111))
        assert np.abs(shape).max() == pytest.approx(1.0)
        assert shape[65] == pytest.approx(0.0, abs=1e-12)


def test_drifts_are_no_cubics():
    """The cubic that the autopilots fit leaves more than a twentieth of the usual drift."""
    t = np.linspace(-40.0, 70.0, 111)
    left = []
    for seed in range(40):
        shape = drift_shape(np.random.default_rng(seed), t)
        cubic = np.polynomial.Polynomial.fit(t, shape, 3)
        left.append(np.abs(shape - cubic(t)).max())
    assert np.median(left) > 0.05


@pytest.mark.parametrize("sizes", [ACCELS, GYROS])
def test_parts_are_within_the_data_sheets(sizes):
    t = np.linspace(-40.0, 70.0, 111)
    triad = draw_triad(np.random.default_rng(5), sizes)
    bias = np.abs(triad.c.at(t)).max(axis=0)
    assert (0.49 * sizes.bias_drift < bias).all()
    assert (bias < 1.01 * sizes.bias_drift).all()
    scale = np.abs(triad.matrix_at(t) - np.array(triad.matrix)).max(axis=0)
    assert np.diag(scale).max() < 1.01 * sizes.scale_drift
    assert (scale - np.diag(np.diag(scale))).max() < 1.01 * sizes.axes_drift
    assert triad.c.at(np.array([ROOM_DEGC])) == pytest.approx(0.0, abs=1e-3 * sizes.bias_drift)


def test_a_mounting_turned_by_a_degree_and_a_half_shows_26_mg():
    turns = np.zeros((3, 3))
    turns[0] = [0.0, 0.0, MOUNTING_RAD]
    bench = Bench(turns, np.random.default_rng(1))
    run = bench.chamber(quiet_unit(), degc_per_min=20.0)[0]
    off = (run.true_force_m_s2 - run.nominal_force_m_s2)[run.is_still]
    expected = STANDARD_GRAVITY_M_S2 * math.sin(MOUNTING_RAD)
    assert np.abs(off).max() == pytest.approx(expected, rel=1e-9)
    assert expected / STANDARD_GRAVITY_M_S2 == pytest.approx(26.2e-3, abs=1e-4)


def test_the_rooms_table_is_true_and_shows_matrix_and_bias():
    unit = quiet_unit()
    room = Bench(np.full((3, 3), 0.02), np.random.default_rng(1)).room(unit)
    assert np.array_equal(room.true_rate_rad_s, room.nominal_rate_rad_s)
    truth = unit.truth.gyro
    expected = room.nominal_rate_rad_s @ np.array(truth.matrix).T + np.array(truth.bias)
    assert room.gyro_rad_s == pytest.approx(expected, abs=2e-5)
    assert np.abs(room.nominal_rate_rad_s).max() == pytest.approx(RATE_RAD_S)


@pytest.mark.parametrize("lag_s", [25.0, -25.0])
def test_elements_and_thermometer_follow_each_other(lag_s):
    """In the middle of a ramp of r the two differ by r lag: the bias tells which is late."""
    unit = quiet_unit(lag_s=lag_s)
    bench = Bench(np.zeros((3, 3)), np.random.default_rng(1))
    run = bench.validation(unit, degc_per_min=3.0)
    still = np.flatnonzero(run.is_still)
    truth = unit.truth.gyro
    fine = np.linspace(-40.0, 70.0, 22001)
    rate = 3.0 / 60.0
    middle = still[len(still) // 5]
    bias = truth.c.at(fine) + np.array(truth.bias)
    shown = run.temperature_degc[middle]
    element = shown - rate * lag_s
    near = np.abs(fine - element) < 0.05
    assert np.abs(bias[near] - run.gyro_rad_s[middle]).min(axis=0) == pytest.approx(0.0, abs=2e-4)


def test_seeds_draw_units_and_benches_of_their_own():
    (one, bench), (again, _), (other, _) = draw(1), draw(1), draw(2)
    assert one.truth == again.truth
    assert one.truth != other.truth
    assert np.abs(bench.mounting_rotations).max() <= MOUNTING_RAD
    assert replace(one, lag_s=0.0) == replace(again, lag_s=0.0)
