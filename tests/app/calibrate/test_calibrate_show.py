"""`calibrate show`: figures equal to the model's, and a picture and an .rrd with them."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ahrs_service.app.calibrate.show import response, verdict_text, view_of
from ahrs_service.app.cli import main
from ahrs_service.app.files import calibration_file
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import Calibration, TriadCalibration
from ahrs_service.sensor.provenance import Uncertainty, Verdict
from ahrs_service.viz.calibration_curves import TIMELINE

SHIPPED = Path(__file__).resolve().parents[3] / "configs" / "calibrations" / "sim-1.toml"
BREAKS = np.linspace(-40.0, 70.0, 23)


def example():
    """Conventional model: steps of matrix and bias, with bands."""
    bias = np.outer(BREAKS[:-1], (1e-4, -2e-4, 0.0))
    scale = np.zeros((22, 9))
    scale[:, 0], scale[:, 1] = 1e-4 * BREAKS[:-1], 0.01
    known = Uncertainty(bias_sigma=Curve.steps(BREAKS, np.full((22, 3), 2e-3)))
    gyro = TriadCalibration(
        bias=(0.01, 0.0, 0.0),
        c=Curve.steps(BREAKS, bias),
        matrix_drift=Curve.steps(BREAKS, scale),
        uncertainty=known,
    )
    return Calibration(gyro=gyro, serial="A1")


def test_bias_and_scale_are_those_of_the_model():
    """The mean of the segment that holds: bias B + c, scale the diagonal of K + dK, less 1."""
    temperature = np.array([-60.0, -37.0, 12.0, 70.0, 90.0])
    bias, scale = response(example(), "gyro", temperature)
    segment = [0, 0, 10, 21, 21]
    expected = np.outer(BREAKS[segment], (1e-4, -2e-4, 0.0)) + np.array((0.01, 0.0, 0.0))
    np.testing.assert_allclose(bias, expected, atol=1e-15)
    np.testing.assert_allclose(scale[:, 0], 1e-4 * BREAKS[segment], atol=1e-14)
    np.testing.assert_allclose(scale[:, 1:], 0.0, atol=1e-14)


def test_the_scale_of_an_improved_model_follows_its_b():
    """N = (A + B + c) / (1 - b) where a is zero: the scale is b / (1 - b)."""
    triad = TriadCalibration(b=Curve.linear((0.0, 50.0), ((0.0,) * 3, (0.01, -0.01, 0.0))))
    _, scale = response(Calibration(accel=triad), "accel", np.array([25.0]))
    np.testing.assert_allclose(scale[0], (0.005 / 0.995, -0.005 / 1.005, 0.0), atol=1e-14)


def test_the_view_reaches_beyond_the_span_and_has_bands_where_they_are_known():
    view = view_of(Path("x.toml"), example())
    assert (view.temperature_degc[0], view.temperature_degc[-1]) == (-45.0, 75.0)
    gyro_bias, gyro_scale, accel_bias, _ = view.panels
    assert gyro_bias.span_degc == (-40.0, 70.0)
    assert accel_bias.span_degc is None
    np.testing.assert_allclose(gyro_bias.sigma, np.degrees(2e-3))
    assert gyro_scale.sigma is None
    assert "A1" in view.title


def test_the_command_prints_draws_and_writes(tmp_path, capsys):
    png, rrd = tmp_path / "unit.png", tmp_path / "unit.rrd"
    assert main(["calibrate", "show", str(SHIPPED), "--png", str(png), "--rrd", str(rrd)]) == 0
    shown = capsys.readouterr().out
    for words in ("SIM-1", "usable", "-10 to 70 degC", "improved", "[deg/s]", f"wrote {png}"):
        assert words in shown
    with Image.open(png) as picture:
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    assert picture.size[0] > 1000
    for colour in ((0xE5, 0x48, 0x4D), (0x30, 0xA4, 0x6C), (0x3E, 0x7B, 0xFA)):
        assert (np.abs(pixels - np.array(colour)).max(axis=1) < 12).sum() > 500, "a curve is drawn"
    tables = read_rrd(rrd)
    view = view_of(SHIPPED, calibration_file.load(SHIPPED))
    t, values = tables["/gyro_bias"]
    assert t.tolist() == list(range(-15, 76))
    expected = np.stack(
        [np.interp(t, view.temperature_degc, column) for column in view.panels[0].values.T], axis=1
    )
    np.testing.assert_allclose(values, expected, atol=1e-12)
    assert set(tables) == {
        "/gyro_bias",
        "/gyro_scale",
        "/accelerometer_bias",
        "/accelerometer_scale",
    }


def read_rrd(path):
    """Temperature and values of each panel."""
    from rerun.chunk import RrdReader

    found = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if chunk.is_static or TIMELINE not in batch.schema.names:
            continue
        values = np.array(batch["Scalars:scalars"].to_pylist())
        found[str(chunk.entity_path)] = np.asarray(batch[TIMELINE]).astype(int), values
    return found


def test_a_verdict_against_it_is_said_and_the_file_still_shown(tmp_path, capsys):
    path = tmp_path / "bad.toml"
    bad = Verdict(False, ("do not use: span 8 degC",), {"span_degc": 8.0})
    calibration_file.save(path, replace(example(), verdict=bad))
    assert main(["calibrate", "show", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "DO NOT USE: span 8 degC" in shown
    assert "span_degc: 8" in shown
    assert verdict_text(Calibration(verdict=Verdict(True, ("fine",)))) == "usable; fine"


@pytest.mark.parametrize("option", ["--png", "--rrd"])
def test_a_place_that_cannot_be_written_is_reported(option, tmp_path, capsys):
    place = tmp_path / "nowhere" / "out"
    assert main(["calibrate", "show", str(SHIPPED), option, str(place)]) == 2
    error = capsys.readouterr().err
    assert f"{place}: cannot be written" in error
    assert "Traceback" not in error


def test_what_is_no_calibration_is_refused_in_one_line(tmp_path, capsys):
    path = tmp_path / "unit.toml"
    path.write_text("[gate]\nnorm_m_s2 = 0.3\n")
    assert main(["calibrate", "show", str(path)]) == 2
    error = capsys.readouterr().err
    assert "gate: no such field" in error
    assert len(error.splitlines()) == 1


def test_looking_at_the_figures_loads_no_picture_library():
    code = (
        "import sys, json; from ahrs_service.app.cli import main; "
        f"main(['calibrate', 'show', {str(SHIPPED)!r}]); "
        "print(json.dumps([n for n in ('matplotlib', 'rerun') if n in sys.modules]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout.splitlines()[-1]) == []
