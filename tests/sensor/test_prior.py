from dataclasses import replace

import numpy as np
import pytest

from ahrs_service import pipeline
from ahrs_service.estimator import Estimator
from ahrs_service.records import SAMPLE_DTYPE, ImuSource, empty
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import Calibration, TriadCalibration
from ahrs_service.sensor.prior import CORRELATION_DEGC, narrow
from ahrs_service.sensor.provenance import Uncertainty
from ahrs_service.settings import Settings

NAMES = ("compensated_bias_per_rtdegc_rad_s", "gyro_bias_sigma_rad_s")


def with_known(**fields):
    return Calibration(gyro=TriadCalibration(uncertainty=Uncertainty(**fields)))


def prior(**fields):
    row = narrow(pipeline.parameters(Settings()), with_known(**fields))
    return tuple(float(row[name][0]) for name in NAMES)


def test_the_worst_axis_counts_and_its_growth_is_that_of_its_structure_function():
    """Of a bias of RMS r and correlation exp(-d / L) the difference over d has the variance
    2 r^2 (1 - exp(-d / L)): for small d the square of the prior times d."""
    per_rtdegc, sigma = prior(bias_residual=(1e-4, 2e-4, 0.0), bias_turn_on=(0.0, 0.0, 1e-3))
    d = 1e-3
    structure = 2.0 * (2e-4) ** 2 * -np.expm1(-d / CORRELATION_DEGC)
    assert per_rtdegc**2 * d == pytest.approx(structure, rel=1e-3)
    assert sigma == pytest.approx(np.hypot(2e-4, 1e-3))


@pytest.mark.parametrize(
    ("fields", "keeps"),
    [
        ({}, (True, True)),
        ({"bias_turn_on": (1e-3,) * 3}, (True, True)),
        ({"bias_residual": (1e-4,) * 3}, (False, True)),
        ({"bias_residual": (1.0,) * 3, "bias_turn_on": (1.0,) * 3}, (True, True)),
        ({"bias_residual": (0.0,) * 3, "bias_turn_on": (0.0,) * 3}, (True, True)),
    ],
)
def test_what_is_not_reported_or_is_worse_or_impossible_changes_nothing(fields, keeps):
    row = pipeline.parameters(Settings())
    default = tuple(float(row[name][0]) for name in NAMES)
    assert tuple(a == b for a, b in zip(prior(**fields), default, strict=True)) == keeps


def test_beyond_the_calibrated_span_the_usual_doubt_holds():
    """The same change of temperature inside and outside it, at rest, aligned before."""
    curve = Curve.steps((0.0, 60.0), ((0.0, 0.0, 0.0),))
    known = with_known(bias_residual=(1e-6,) * 3)
    known = replace(known, gyro=replace(known.gyro, c=curve))
    settings = Settings()
    settings = replace(
        settings, fusion=replace(settings.fusion, mode="gated", gyro_bias_walk_rad_s2_rthz=1e-9)
    )
    sigmas = []
    for first, last in ((30.0, 40.0), (61.0, 71.0)):
        samples = empty(SAMPLE_DTYPE, 600)
        samples["time_ns"] = samples["received_ns"] = np.arange(600) * 10_000_000
        samples["gyro_rad_s"], samples["accel_m_s2"] = 0.0, (0.0, 0.0, -9.80665)
        samples["temperature_degc"] = np.linspace(first, last, 600)
        samples["source"] = ImuSource.HIGHRES_IMU
        estimates = Estimator(settings, known).run(samples)
        sigmas.append(estimates["gyro_bias_sigma_rad_s"][-1].max())
    inside, outside = sigmas
    # The alignment takes the first of the six seconds, and with it a sixth of the ten degrees.
    grown = settings.fusion.gyro_bias_per_rtdegc_rad_s**2 * 10.0 * 5.0 / 6.0
    assert outside**2 - inside**2 == pytest.approx(grown, rel=0.05)
