"""The command diagnose: the files it writes, the loop through twin and service."""

import json
from pathlib import Path

import numpy as np
import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.diagnose.loaded_recording import load
from ahrs_service.app.diagnose.recording_diagnosis import compensated
from ahrs_service.app.files import calibration_file, twin_file

CASES = Path(__file__).parents[4] / "shared" / "mismatch" / "cases"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A case of two effects, diagnosed by the command, with every file it writes."""
    case = CASES / "two_effects_bench.tlog"
    if not case.is_file():
        pytest.skip(f"{case.name} is not in ../shared/mismatch/cases")
    folder = tmp_path_factory.mktemp("diagnose")
    names = {
        "--json": "report.json",
        "--html": "report.html",
        "--rrd": "report.rrd",
        "--write-twin": "twin.toml",
        "--write-calibration": "calibration.toml",
    }
    words = [word for option, name in names.items() for word in (option, str(folder / name))]
    words += ["--truth", str(case.with_suffix(".truth.json"))]
    assert main(["diagnose", str(case), *words]) == 0
    return case, folder


def test_two_effects_are_named_and_their_values_found(written):
    case, folder = written
    truth = json.loads(case.with_suffix(".truth.json").read_text())["effects"]
    found = {
        one["effect"]: one for one in json.loads((folder / "report.json").read_text())["effects"]
    }
    assert set(found) == {one["effect"] for one in truth}
    (scale,) = [one["params"]["scale_error"] for one in truth if "scale_error" in one["params"]]
    estimate = found["gyro_scale_factor"]["parameters"]["scale_error"]
    error = np.abs(np.array(estimate["value"]) - scale)
    assert (error < 5.0 * np.array(estimate["std"]) + 1e-5).all()


def test_the_oracle_stands_beside_what_was_found(written):
    case, folder = written
    report = json.loads((folder / "report.json").read_text())
    truth = json.loads(case.with_suffix(".truth.json").read_text())["effects"]
    oracle = report["oracle"]
    observed = {one["effect"]: one["parameters"] for one in oracle["effects"]}
    assert observed == {one["effect"]: one["params"] for one in truth}
    found, true = (oracle[side]["gyro"]["log_likelihood_gain"] for side in ("found", "oracle"))
    assert 0.95 * true < found < 1.05 * true
    for triad in ("gyro", "accel"):
        after, best = (oracle[side][triad]["rms_after"] for side in ("found", "oracle"))
        np.testing.assert_allclose(after, best, rtol=0.15)
    run = report["holdout"]["free_run_attitude_error_60s_deg"]
    assert run["oracle"] == pytest.approx(run["after"], rel=0.1)
    assert "Compared with the truth" in (folder / "report.html").read_text()


def test_every_file_is_whole(written):
    _, folder = written
    assert (folder / "report.html").read_text().rstrip().endswith("</html>")
    assert (folder / "report.rrd").stat().st_size > 10_000
    assert len(list(folder.iterdir())) == 5
    twin = twin_file.read(folder / "twin.toml")
    assert {effect.id for effect, _ in twin.effects} == {"gyro_scale_factor", "accel_thermal_bias"}


def test_the_calibration_written_takes_the_mismatch_away(written):
    """After the service's own compensation the IMU agrees with the reference."""
    case, folder = written
    columns = load(case).columns
    calibration = calibration_file.load(folder / "calibration.toml")
    mended = compensated(columns, calibration)
    rates = columns.body_rate_rad_s
    truth = np.stack([np.interp(columns.imu_time_s, rates.time_s, c) for c in rates.values.T], 1)
    turning = np.abs(truth).max(axis=1) > 0.3
    k_before, k_after = (
        [
            float(np.polyfit(truth[turning, axis], gyro[turning, axis], 1)[0] - 1.0)
            for axis in range(3)
        ]
        for gyro in (columns.gyro_rad_s, mended.gyro_rad_s)
    )
    assert np.abs(k_before).max() > 5e-3
    assert np.abs(k_after).max() < 2e-4


def test_what_the_real_recording_has_and_the_simulated_lacks_is_said(tmp_path, capsys):
    """Two flights of one sensor with noise, one of them with a scale error of 1 % too."""
    sensor = "[gyro_noise]\ndensity = 1e-4\n[accel_noise]\ndensity = 1e-3\n"
    scale = '[[effects]]\nid = "gyro_scale_factor"\nscale_error = [0.012, -0.010, 0.015]\n'
    for name, twin in (("sim", sensor), ("real", sensor + scale)):
        (tmp_path / f"{name}.toml").write_text(twin)
        flight = ["simulate", "--twin", str(tmp_path / f"{name}.toml"), "--seconds", "50"]
        assert main([*flight, "--tlog", str(tmp_path / f"{name}.tlog")]) == 0
    report = tmp_path / "report.json"
    files = ["--against", str(tmp_path / "sim.tlog"), "--json", str(report)]
    assert main(["diagnose", str(tmp_path / "real.tlog"), *files]) == 0
    against = json.loads(report.read_text())["against"]
    assert against["lacks"] == ["gyro_scale_factor"]
    said = capsys.readouterr().out.split("What sim.tlog lacks:")[1]
    assert "gyro: scale factor error (gyro_scale_factor)" in said


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("missing.tlog", "no such file"),
        ("notes.txt", "is not a supported log format"),
        (".", "is a folder; give a recording"),
    ],
)
def test_a_recording_that_cannot_be_read_is_reported(name, words, tmp_path, capsys):
    path = tmp_path / name
    if name == "notes.txt":
        path.write_text("nothing")
    assert main(["diagnose", str(path)]) == 1
    message = capsys.readouterr().err
    assert str(path) in message
    assert words in message
