"""The smooth fit against plain least squares, exact data, and the scatter that it predicts."""

import numpy as np
import pytest

from ahrs_service.calibration.thermal.fold_choice import hold_out
from ahrs_service.calibration.thermal.rows import ThermalRows
from ahrs_service.calibration.thermal.smooth import fit_smooth, smooth_calibration
from ahrs_service.calibration.thermal.smooth_choice import Choice, level_outputs, time_folds
from ahrs_service.calibration.thermal.smooth_drift import AxisProblem, Scale, Structure
from ahrs_service.sensor.compensation import compensate_columns
from ahrs_service.sensor.noise import first_order
from ahrs_service.sensor.parameters import Calibration, coefficients

ZERO = 20.0
MATRIX = np.array([[1.02, 0.003, -0.002], [0.001, 0.98, 0.004], [-0.003, 0.002, 1.01]])
BIAS = np.array([0.3, -0.2, 0.1])


def drift_of(t):
    """Bias [N, 3] and scale [N, 3, 3] of an exact quadratic and linear drift, zero at ZERO."""
    s = (t - ZERO) / 40.0
    bias = s[:, None] * [0.2, -0.1, 0.3] + (s**2)[:, None] * [0.05, 0.1, -0.05]
    table = np.array([[4e-3, 1e-3, 0.0], [0.0, -6e-3, 1e-3], [-1e-3, 0.0, 5e-3]])
    return bias, s[:, None, None] * table


def six_pose_rows(noise=0.0, seed=1):
    """Heating and cooling in six poses along the axes, 9.8 m/s^2 each way, held in turn."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 7200.0, 20.0)
    t = np.interp(time, [0.0, 3600.0, 7200.0], [-20.0, 60.0, -20.0])
    pose = np.arange(len(time)) % 6
    force = np.concatenate([np.eye(3), -np.eye(3)])[pose] * 9.8
    u = force @ MATRIX.T + BIAS
    bias, scale = drift_of(t)
    output = u + bias + np.einsum("nij,nj->ni", scale, u) + rng.normal(0.0, noise, u.shape)
    return ThermalRows(time, t, output, pose, np.zeros(len(time), int)), force


def test_the_elimination_of_levels_is_plain_least_squares():
    rows, _ = six_pose_rows(noise=0.01)
    structure = Structure(bias=(3, 2), scale=(1, 1), kind=Scale.ALL)
    u = level_outputs(rows)
    problem = AxisProblem(rows, 1, structure, ZERO, u)
    design = np.hstack([problem._columns, np.eye(6)[rows.level]])
    solution, *_ = np.linalg.lstsq(design, rows.output[:, 1], rcond=None)
    curves = problem.fit()
    assert curves.levels == pytest.approx(solution[-6:], abs=1e-9)
    rest = rows.output[:, 1] - design @ solution
    assert problem.residual(curves) == pytest.approx(rest, abs=1e-9)
    variance = rest @ rest / (len(rest) - design.shape[1])
    covariance = np.linalg.inv(design.T @ design) * variance
    size = structure.size
    assert curves.covariance == pytest.approx(covariance[:size, :size], rel=1e-6)


def test_exact_drift_is_found_and_compensated_to_the_last_digits():
    rows, force = six_pose_rows()
    fit = fit_smooth(rows, ZERO, with_lag=False)
    assert all(one.kind is Scale.ALL for one in fit.structures)
    triad = smooth_calibration(fit.axes, MATRIX, BIAS)
    _, found = compensate_columns(
        coefficients(Calibration(accel=triad)), rows.output, rows.output, rows.temperature_degc
    )
    assert found == pytest.approx(force, abs=2e-5)


def test_how_the_unit_lies_does_not_enter():
    """The same unit rotated by two degrees in its fixture: the same drift."""
    rows, _ = six_pose_rows(noise=1e-3)
    fit = fit_smooth(rows, ZERO, with_lag=False)
    t = np.linspace(-20.0, 60.0, 9)
    bias, scale = drift_of(t)
    u = np.tile([[3.0, -4.0, 8.0]], (9, 1))
    expected = bias + np.einsum("nij,nj->ni", scale, u)
    found = np.stack([axis.drift(t, u) for axis in fit.axes], axis=1)
    assert found == pytest.approx(expected, abs=2e-3)


def still_rows(seed, keep=0.0, drift=0.4):
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 6000.0, 10.0)
    t = np.interp(time, [0.0, 3000.0, 6000.0], [0.0, 40.0, 0.0])
    noise = first_order(rng.normal(0.0, 0.02, (len(time), 3)), keep)
    zero = np.zeros(len(time), int)
    curve = drift * np.tanh((t - 15.0) / 12.0)
    return ThermalRows(time, t, curve[:, None] + noise, zero, zero)


@pytest.mark.parametrize("keep", [0.0, 0.8])
def test_the_errors_reported_are_the_scatter_of_the_fits(keep):
    """Of 60 runs with noise white or coloured; without the colour the errors are 3 times small."""
    at = np.array([0.0, 40.0])
    structures = (Structure(bias=(3, 3)),) * 3
    from ahrs_service.calibration.thermal.coloured import inflation
    from ahrs_service.calibration.thermal.smooth import fit_curves

    found, observed = [], []
    for seed in range(60):
        rows = still_rows(seed, keep)
        curves, residual = fit_curves(rows, structures, ZERO)
        found.append([axis.drift(at, np.zeros((2, 3))) for axis in curves])
        observed.append(
            [
                axis.bias_sigma(at) * np.sqrt(inflation(residual[:, n]))
                for n, axis in enumerate(curves)
            ]
        )
    ratio = np.std(found, axis=0).mean() / np.mean(observed)
    assert 0.85 < ratio < 1.25


def test_noise_alone_gets_no_flexible_curve():
    sizes = []
    for seed in range(9):
        rows = still_rows(seed, drift=0.0)
        sizes.append(Choice(rows, 0, ZERO).structure(Structure(), 1).size)
    assert np.median(sizes) <= 1


def test_held_out_time_supports_real_curves_and_rejects_noise():
    before, after = hold_out(still_rows(1), ZERO).rms()
    assert after < 0.1 * before
    rows = still_rows(2, drift=0.0)
    before, after = hold_out(rows, ZERO).rms()
    assert after == pytest.approx(before, rel=0.03)


def test_folds_are_contiguous_blocks_of_each_session():
    rows, _ = six_pose_rows()
    session = np.repeat([0, 1], len(rows) // 2)
    two = ThermalRows(rows.time_s, rows.temperature_degc, rows.output, rows.level, session)
    fold = time_folds(two)
    changes = np.flatnonzero(np.diff(fold)) + 1
    assert len(changes) == 39
    assert np.diff(changes).min() >= len(rows) // 40
    assert np.bincount(fold).max() <= 1.4 * np.bincount(fold).mean()


def test_scale_is_not_sought_where_the_inputs_do_not_tell_it():
    rows = still_rows(3)
    two = ThermalRows(
        rows.time_s,
        rows.temperature_degc,
        rows.output,
        (np.arange(len(rows)) >= 300).astype(int),
        rows.session,
    )
    assert Choice(two, 0, ZERO).structure(Structure(), 2).kind is Scale.NONE
