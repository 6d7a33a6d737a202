"""The paper's two models on exact data: what each can and cannot hold."""

import numpy as np
import pytest

from ahrs_service.calibration.thermal.rows import ThermalRows
from ahrs_service.errors import CalibrationError
from ahrs_service.sensor.compensation import compensate_columns
from ahrs_service.sensor.parameters import Calibration, coefficients
from tests.benchmarks.paper.segmented import fit_conventional, fit_improved

ROOM = 25.0
MATRIX = np.array([[1.01, 0.002, 0.0], [0.0, 0.99, 0.001], [0.003, 0.0, 1.02]])
BIAS = np.array([0.2, -0.1, 0.05])
NODES = np.linspace(-40.0, 70.0, 23)


def run(drift, angles=((0, 1), (1, 2), (2, 0))):
    """Six positions held in turn while it heats and cools; `drift` (T, output u) -> [N, 3]."""
    time = np.arange(0.0, 13200.0, 5.0)
    t = np.interp(time, [0.0, 6600.0, 13200.0], [-40.0, 70.0, -40.0])
    pose = np.arange(len(time)) % 6
    force = np.concatenate([np.eye(3), -np.eye(3)])[pose] * 9.8
    u = force @ MATRIX.T + BIAS
    rows = ThermalRows(time, t, u + drift(t, u), pose, np.zeros(len(time), int))
    return rows, force


def linear_in_pieces(t, u):
    """Drift that is linear between the borders of the 5 degC segments, and zero at 25 degC."""
    table = 0.3 * np.sin(NODES[:, None] / 15.0 + [0.0, 1.0, 2.0])
    table -= table[13]
    return np.stack([np.interp(t, NODES, column) for column in table.T], axis=1)


def quadratic_in_output(t, u):
    return linear_in_pieces(t, u) * (1.0 + 0.02 * u + 1e-3 * u**2)


def left(triad, rows, force):
    _, found = compensate_columns(
        coefficients(Calibration(accel=triad)), rows.output, rows.output, rows.temperature_degc
    )
    return np.abs(found - force).max()


def test_conventional_holds_what_is_linear_in_pieces():
    rows, force = run(linear_in_pieces)
    assert left(fit_conventional(rows, force, ROOM), rows, force) < 1e-9


def test_improved_holds_a_quadratic_of_the_output_in_pieces():
    rows, force = run(quadratic_in_output)
    triad = fit_improved(rows, MATRIX, BIAS, ROOM)
    # The output of room temperature is a mean over half a segment each way, in which it moves.
    assert left(triad, rows, force) < 0.01
    assert triad.c.at(np.array([ROOM])) == pytest.approx(0.0, abs=1e-12)


def test_conventional_takes_a_turned_mounting_for_axes_and_improved_does_not():
    """Liu et al., sec. 2.2.1: g sin 1.5 deg = 26 mg against nothing."""
    rows, force = run(linear_in_pieces)
    angle = np.radians(1.5)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0]])
    turn = np.vstack([turn, [0.0, 0.0, 1.0]])
    told = force @ turn.T
    off = left(fit_conventional(rows, told, ROOM), rows, force)
    assert off == pytest.approx(9.8 * np.sin(angle), rel=0.02)
    assert left(fit_improved(rows, MATRIX, BIAS, ROOM), rows, force) < 0.01


@pytest.mark.parametrize("fit", [fit_conventional, None])
def test_steps_leave_half_a_segment_of_slope(fit):
    rows, force = run(lambda t, u: 0.01 * (t[:, None] - ROOM) * np.ones(3))
    if fit is None:
        triad = fit_improved(rows, MATRIX, BIAS, ROOM, continuous=False)
    else:
        triad = fit_conventional(rows, force, ROOM, continuous=False)
    assert left(triad, rows, force) == pytest.approx(0.01 * 2.5, rel=0.15)


def test_segments_are_those_of_the_paper():
    rows, force = run(linear_in_pieces)
    triad = fit_conventional(rows, force, ROOM)
    assert triad.breaks_degc() == pytest.approx(NODES, abs=1e-9)
    assert triad.model == "conventional"


def test_three_positions_are_refused():
    rows, force = run(linear_in_pieces)
    some = np.flatnonzero(rows.level < 3)
    with pytest.raises(CalibrationError, match="six positions"):
        fit_conventional(rows.part(some), force[some], ROOM)


def test_a_run_that_does_not_pass_room_temperature_is_refused():
    rows, _ = run(linear_in_pieces)
    cold = np.flatnonzero(rows.temperature_degc < 10.0)
    with pytest.raises(CalibrationError, match="room temperature"):
        fit_improved(rows.part(cold), MATRIX, BIAS, ROOM)


def test_one_position_does_not_tell_a_quadratic():
    rows, _ = run(linear_in_pieces)
    one = np.flatnonzero(rows.level == 0)
    with pytest.raises(CalibrationError, match="both ways"):
        fit_improved(rows.part(one), MATRIX, BIAS, ROOM)
