import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import (
    SEGMENTS,
    Calibration,
    TriadCalibration,
    coefficients,
)
from ahrs_service.sensor.provenance import Provenance, SourceRecording, Uncertainty, Verdict

THREE = Curve.linear((10.0, 20.0), ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)))
MANY = np.linspace(0.0, 50.0, SEGMENTS + 2)


def test_the_inverse_is_that_of_the_matrix():
    matrix = ((1.1, 0.02, -0.01), (0.03, 0.9, 0.0), (0.0, -0.04, 1.0))
    rows = coefficients(Calibration(accel=TriadCalibration(matrix=matrix)))
    np.testing.assert_allclose(rows["accel"]["inverse"][0] @ matrix, np.eye(3), atol=1e-15)
    np.testing.assert_array_equal(rows["gyro"]["inverse"][0], np.eye(3))


def test_curves_of_different_borders_share_the_kernels_table():
    triad = TriadCalibration(
        c=Curve.linear((0.0, 10.0, 50.0), np.arange(9.0).reshape(3, 3)),
        matrix_drift=Curve.steps((0.0, 30.0, 50.0), np.full((2, 9), 0.01)),
    )
    assert triad.breaks_degc().tolist() == [0.0, 10.0, 30.0, 50.0]
    assert triad.span_degc == (0.0, 50.0)
    assert coefficients(Calibration(gyro=triad))["gyro"]["segments"] == 3


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"matrix": ((1.0, 0.0, 0.0),) * 3}, "matrix .*inverted"),
        ({"matrix": ((1.0, 0.0),) * 2}, "matrix .* 3 x 3"),
        ({"bias": (0.0, float("nan"), 0.0)}, "bias .*nan"),
        ({"g_sensitivity": ((0.0, 0.0, 0.0),)}, "g_sensitivity .* 3 x 3"),
        ({"thermal_lag_s": float("nan")}, "thermal_lag_s = nan"),
        ({"thermal_lag_s": 1e6}, "thermal_lag_s"),
        ({"matrix_drift": THREE}, "matrix_drift has 3 columns: give it 9"),
        ({"a": THREE, "c": Curve.steps((0.0, 20.0), ((1.0, 1.0, 1.0),))}, "c spans"),
        ({"c": Curve.linear(MANY, np.zeros((len(MANY), 3)))}, "at most 64"),
        ({"b": THREE}, "b reaches 1.*follow"),
        (
            {"matrix_drift": Curve.steps((10.0, 20.0), -np.eye(3).reshape(1, 9))},
            "with its drift cannot be inverted",
        ),
    ],
)
def test_a_wrong_field_is_named(fields, words):
    with pytest.raises(ValueError, match=words):
        TriadCalibration(**fields)


def test_only_gyros_feel_the_force():
    sensitive = TriadCalibration(g_sensitivity=((1e-3, 0.0, 0.0),) * 3)
    with pytest.raises(ValueError, match=r"accel\.g_sensitivity"):
        Calibration(accel=sensitive)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Verdict(figures={"gain": float("inf")}), "figures.gain = inf"),
        (lambda: SourceRecording("a.tlog", "12ab"), "64 lower-case hex"),
        (lambda: Provenance(date="31.5.2024"), "2024-05-31"),
        (lambda: Uncertainty(bias_residual=(0.1, -0.1, 0.0)), "bias_residual"),
        (lambda: Uncertainty(scale_sigma=Curve.steps((0.0, 1.0), ((1.0,),))), "scale_sigma"),
        (lambda: Uncertainty(parameters=("bias.x",)), "1 x 1"),
        (lambda: Uncertainty(parameters=("bias.x",), covariance=((-1.0,),)), "negative"),
    ],
)
def test_a_wrong_origin_is_named(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_standard_errors_have_the_names_of_their_parameters():
    known = Uncertainty(parameters=("bias.x", "bias.y"), covariance=((4.0, 1.0), (1.0, 9.0)))
    assert known.standard_errors() == {"bias.x": 2.0, "bias.y": 3.0}


def test_pydantic_reads_lists_and_refuses_unknown_keys():
    adapter = TypeAdapter(Calibration)
    gyro = {"bias": [0.1, 0.2, 0.3], "c": {"breaks_degc": [0, 9], "pieces": [[[1], [2, 3], [4]]]}}
    read = adapter.validate_python({"serial": "A1", "gyro": gyro})
    curve = Curve((0.0, 9.0), (((1.0,), (2.0, 3.0), (4.0,)),))
    assert read == Calibration(gyro=TriadCalibration(bias=(0.1, 0.2, 0.3), c=curve), serial="A1")
    with pytest.raises(ValidationError, match="gyr0"):
        adapter.validate_python({"gyr0": {}})
