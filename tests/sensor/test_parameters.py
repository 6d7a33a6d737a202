import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from ahrs_service.sensor.parameters import (
    NODES,
    Calibration,
    TriadCalibration,
    coefficients,
)

ZEROS = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def test_the_inverse_is_that_of_the_matrix():
    matrix = ((1.1, 0.02, -0.01), (0.03, 0.9, 0.0), (0.0, -0.04, 1.0))
    rows = coefficients(Calibration(accel=TriadCalibration(matrix=matrix)))
    np.testing.assert_allclose(rows["accel"]["inverse"][0] @ matrix, np.eye(3), atol=1e-15)
    np.testing.assert_array_equal(rows["gyro"]["inverse"][0], np.eye(3))


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"matrix": ((1.0, 0.0, 0.0),) * 3}, "matrix"),
        ({"matrix": ((1.0, 0.0),) * 2}, "matrix .* 3 x 3"),
        ({"bias": (0.0, float("nan"), 0.0)}, "bias .*nan"),
        ({"temperature_degc": (0.0,)}, "1 nodes"),
        ({"temperature_degc": tuple(range(NODES + 1))}, "33 nodes"),
        ({"temperature_degc": (20.0, 10.0), "a": ZEROS, "b": ZEROS, "c": ZEROS}, "sort"),
        ({"temperature_degc": (10.0, 10.0), "a": ZEROS, "b": ZEROS, "c": ZEROS}, "once"),
        ({"temperature_degc": (10.0, 20.0), "a": ZEROS, "b": ZEROS}, "c = .* 2 x 3"),
        ({"c": ZEROS}, "c = "),
        (
            {
                "temperature_degc": (1.0, 2.0),
                "a": ZEROS,
                "b": ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
                "c": ZEROS,
            },
            "b = .*follow",
        ),
    ],
)
def test_a_wrong_field_is_named(fields, words):
    with pytest.raises(ValueError, match=words):
        TriadCalibration(**fields)


def test_pydantic_reads_lists_and_refuses_unknown_keys():
    adapter = TypeAdapter(Calibration)
    read = adapter.validate_python({"serial": "A1", "gyro": {"bias": [0.1, 0.2, 0.3]}})
    assert read == Calibration(gyro=TriadCalibration(bias=(0.1, 0.2, 0.3)), serial="A1")
    with pytest.raises(ValidationError, match="gyr0"):
        adapter.validate_python({"gyr0": {}})
