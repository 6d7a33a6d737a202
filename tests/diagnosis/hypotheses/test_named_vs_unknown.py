"""Named or unknown: evidence by brute force, smooth forms by a peer library, sealed recordings."""

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.optimize import minimize_scalar

from ahrs_service.app.diagnose.recorded_columns import read_columns
from ahrs_service.app.prove.blind_files import case_bytes
from ahrs_service.blind.making.case import Request, make
from ahrs_service.diagnosis.diagnose import compare, diagnose
from ahrs_service.diagnosis.hypotheses.candidates import library_of, products, spline_basis
from ahrs_service.diagnosis.hypotheses.hypothesis import extend
from ahrs_service.diagnosis.hypotheses.model import bare
from ahrs_service.diagnosis.hypotheses.named_vs_unknown import evidence, is_clearer, is_clearer_than


@pytest.mark.parametrize(("freedom", "gain"), [(1, 3.0), (3, 12.0), (12, 150.0)])
def test_evidence_is_the_marginal_likelihood_at_the_best_size_of_the_numbers(freedom, gain):
    rng = np.random.default_rng(3)
    x, _ = np.linalg.qr(rng.normal(size=(60, freedom)))
    inside, outside = x @ rng.normal(size=freedom), rng.normal(size=60)
    outside -= x @ (x.T @ outside)
    y = inside * np.sqrt(2.0 * gain) / np.linalg.norm(inside) + outside

    def log_marginal(log_g):
        covariance = np.eye(60) + np.exp(log_g) * x @ x.T
        _, log_det = np.linalg.slogdet(covariance)
        return -0.5 * (y @ np.linalg.solve(covariance, y) + log_det)

    best = -minimize_scalar(lambda g: -log_marginal(g), bounds=(-5.0, 12.0), method="bounded").fun
    assert evidence(gain, freedom) == pytest.approx(best + 0.5 * y @ y, abs=1e-4)


def test_evidence_of_a_gain_that_chance_would_give_is_nil():
    assert evidence(6.0, 12) == 0.0
    assert evidence(5.0, 12) == 0.0


def test_the_same_gain_with_more_numbers_is_never_clearer():
    assert not is_clearer(150.0, 12, 150.0, 3)
    assert not is_clearer(150.0, 3, 150.0, 6)
    assert is_clearer(300.0, 27, 100.0, 9)


def test_smooth_forms_span_the_cubic_splines_with_a_knot_in_the_middle():
    share = np.random.default_rng(1).beta(2.0, 3.0, 400)
    basis = np.hstack([np.ones((400, 1)), spline_basis(share)])
    knots = np.concatenate([np.zeros(3), [0.0, 0.5, 1.0], np.ones(3)])
    peer = BSpline.design_matrix(share, knots, 3).toarray()
    np.testing.assert_allclose(basis @ np.linalg.lstsq(basis, peer, rcond=None)[0], peer, atol=1e-9)
    line, parabola = np.polyfit(share, basis[:, 1], 1), np.polyfit(share, basis[:, 2], 2)
    np.testing.assert_allclose(np.polyval(line, share), basis[:, 1], atol=1e-9)
    np.testing.assert_allclose(np.polyval(parabola, share), basis[:, 2], atol=1e-9)


def test_a_covariate_of_two_values_has_one_form():
    basis = spline_basis(np.repeat([0.0, 1.0], 50))
    assert np.count_nonzero(np.abs(basis).max(axis=0) > 1e-6) == 1


def test_the_products_hold_every_product_of_two_components():
    vector = np.random.default_rng(2).normal(size=(50, 3))
    basis = products(vector)
    for i, j in np.ndindex(3, 3):
        product = vector[:, i] * vector[:, j]
        left = product - basis @ np.linalg.lstsq(basis, product, rcond=None)[0]
        assert np.abs(left).max() < 1e-9


def diagnosed(folder, **request):
    path = folder / "hidden.tlog"
    path.write_bytes(case_bytes(make(Request("hidden", "bench", 3501, 240, **request))))
    return diagnose(read_columns(path))


def test_what_bends_with_the_square_of_the_force_is_not_named_after_the_force_itself(tmp_path):
    found = diagnosed(tmp_path, effects=("outside:acceleration",), level=1)
    assert found.findings == ()
    assert found.verdict == "unexplained"
    assert "acceleration" in found.unexplained[0].depends_on
    assert found.unexplained[0].channel == "gyro"


def test_the_height_climbed_is_the_vertical_speed_integrated(tmp_path):
    path = tmp_path / "hidden.tlog"
    case = make(Request("hidden", "copter", 3502, 60))
    path.write_bytes(case_bytes(case))
    columns = compare(read_columns(path)).columns
    flown_s = columns.time_s - columns.time_s[0]
    down = np.interp(flown_s, case.scene.time_s, case.scene.motion.position_ned_m[:, 2])
    assert np.ptp(down) > 5.0
    # The reference's speed errs by 0.03 m/s over 3 s, which adds up to some 0.5 m in a minute.
    assert np.std(columns.altitude_m + down) < 0.5


def test_what_goes_with_the_force_itself_keeps_its_name(tmp_path):
    found = diagnosed(tmp_path, effects=("gyro_g_sensitivity",), level=1)
    assert [finding.effect for finding in found.findings] == ["gyro_g_sensitivity"]
    assert found.unexplained == ()


def test_an_unknown_dependence_that_says_the_same_is_not_clearer(tmp_path):
    """A current coupling of fixed noise against a straight line of the current, noise fitted."""
    path = tmp_path / "hidden.tlog"
    request = Request("hidden", "copter", 3503, 60, effects=("gyro_current_coupling",), level=1)
    path.write_bytes(case_bytes(make(request)))
    residual = compare(read_columns(path))
    library, empty = library_of(residual, ("gyro_current_coupling",)), bare(residual)
    named, line = (
        library.candidates[0],
        next(c for c in library.candidates if c.name == "gyro current"),
    )
    coupling = extend(residual, library, empty, named, has_noise=False)
    unknown = extend(residual, library, empty, line, has_noise=True)
    assert named.freedom == line.freedom == 3
    assert not is_clearer_than(residual, unknown, coupling.model, 3)
    assert is_clearer_than(residual, unknown, empty, 0)
