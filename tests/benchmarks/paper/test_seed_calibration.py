"""The paper's comparison (Liu et al., sec. 2.2.2): 30 mg conventional against 5 mg improved.

The bench is that of tests/benchmarks/thermal_calibration.py, which prints the figures of ten units;
here one of them. The limits are the issue's: conventional between 20 and 40 mg (a mounting turned
by 1.5 degrees makes 26), improved at most 5, smooth at most 2. A gyro at 100 deg/s sees the same
1.5 degrees as 2.6 deg/s.
"""

import math

import numpy as np
import pytest

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from tests.benchmarks.paper.comparison import calibrate_bench, residuals

MILLI_G = 1e-3 * STANDARD_GRAVITY_M_S2


@pytest.fixture(scope="module")
def bench():
    return calibrate_bench(1)


def largest(bench, method):
    rate, force = residuals(bench.calibrations[method], bench.validation)
    return np.degrees(np.abs(rate).max(axis=0)), np.abs(force).max(axis=0) / MILLI_G


def test_conventional_leaves_its_second_mounting(bench):
    gyro, accel = largest(bench, "conventional, jumping")
    assert 20.0 < accel.max() < 40.0
    assert 100.0 * math.sin(math.radians(1.0)) < gyro.max() < 6.0


def test_improved_leaves_5_mg_and_the_axes_alike(bench):
    gyro, accel = largest(bench, "improved")
    assert accel.max() < 5.0
    assert accel.max() < 3.0 * accel.min()
    assert gyro.max() < 0.4


def test_smooth_leaves_2_mg(bench):
    gyro, accel = largest(bench, "smooth")
    assert accel.max() < 2.0
    assert gyro.max() < 0.15
    improved_gyro, improved_accel = largest(bench, "improved")
    assert accel.max() < improved_accel.max()
    assert gyro.max() < improved_gyro.max()


def test_the_autopilots_cubic_does_not_hold_110_degrees(bench):
    _, cubic = largest(bench, "cubic of the bias")
    _, smooth = largest(bench, "smooth")
    assert smooth.max() < 0.3 * cubic.max()


def test_what_the_room_alone_knows_is_far_worse(bench):
    gyro, accel = largest(bench, "none")
    assert accel.max() > 30.0
    assert gyro.max() > 2.0


def test_the_lag_is_found(bench):
    for fit in (bench.gyro_fit, bench.accel_fit):
        assert fit.lag.is_reported
        assert fit.lag.lag_s == pytest.approx(bench.true_lag_s, abs=1.5)
