"""The command diagnose: what it says, the files it writes, the loop through twin and service."""

import html
import io
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from ahrs_service.app import calibration_file, truth_file, twin_file
from ahrs_service.app import diagnosis_text as text
from ahrs_service.app.cli import main
from ahrs_service.app.diagnose import compensated, extended, sigmas_of
from ahrs_service.app.diagnosis_page import most_telling, page
from ahrs_service.app.diagnosis_terminal import summary
from ahrs_service.app.loaded_recording import load
from ahrs_service.diagnosis.recorded import Recorded, Series
from ahrs_service.diagnosis.result import (
    Covariate,
    Diagnosis,
    Estimated,
    Finding,
    FreeRun,
    Holdout,
    Implausible,
    NotObservable,
    Oracle,
    ResidualSeries,
    Rival,
    TrueEffect,
    Unexplained,
    Where,
    Whiteness,
    as_json,
)
from ahrs_service.effects.catalogue import effect_of
from ahrs_service.simulation.imu import Imu
from links.errors import RecordingError

CASES = Path(__file__).parents[3] / "shared" / "mismatch" / "cases"


def finding(effect="accel_vibration_rectification", **changes):
    holdout = Holdout(
        412.3, (0.05, 0.05, 0.21), (0.05, 0.05, 0.06), (0.01, 0.01, 0.18), (0.01, 0.01, 0.012)
    )
    values = {
        "effect": effect,
        "alike": (effect, "accel_current_coupling"),
        "axes": ("z",),
        "where": (Where(60.0, 150.0, "vibration above 2 m/s^2"),),
        "parameters": {
            "per_vibration_variance": Estimated([0.0, 0.0, -0.09], [0.004, 0.004, 0.005], "s^2/m")
        },
        "p_value": 1e-14,
        "log_evidence": 812.0,
        "rival": Rival("accel_current_coupling", 640.0),
        "holdout": holdout,
        "explanation": "The z accelerometer reads 0.4 m/s^2 low while the motors vibrate",
        "separating_manoeuvre": "run the motors without propellers",
    }
    return Finding(**{**values, **changes})


@pytest.fixture
def diagnosis():
    time_s = np.arange(0.0, 200.0, 0.1)
    before = np.random.default_rng(4).normal(0.0, 1e-3, (len(time_s), 6))
    edges = np.linspace(0.0, 5.0, 11)
    against = Covariate(
        "accel_z", "vibration", "m/s^2", edges, -edges[:10], np.ones(10), -edges[:10], 1e-20
    )
    return Diagnosis(
        verdict="unexplained",
        findings=(finding(),),
        unexplained=(Unexplained("accel_x", ("airspeed",), (Where(20.0, 90.0, ""),), 1e-5),),
        not_observable=(NotObservable("gyro_thermal_bias", "the temperature spans 0.4 degC"),),
        holdout=None,
        free_run=FreeRun(3.2, 0.4),
        noise={"gyro_white": 1e-4},
        whiteness=Whiteness((0.5,) * 6, (0.4,) * 6),
        covariates=(against,),
        series=ResidualSeries(time_s, before, 0.5 * before),
        notes=("reference: <b>ATTITUDE</b>",),
        implausible=(
            Implausible(
                "accel_scale_factor",
                {"scale_error": [0.6, 0.0, 0.9]},
                {"scale_error": 0.03},
                231.0,
            ),
        ),
    )


def test_a_finding_is_a_paragraph_that_a_pilot_understands():
    words = text.paragraph(finding())
    assert words.startswith("The z accelerometer reads 0.4 m/s^2 low while the motors vibrate. ")
    assert "It shows from 60 s to 150 s (vibration above 2 m/s^2)." in words
    assert "gains 412 nats" in words
    assert "cannot tell it from accelerometer: bias that follows the battery current" in words
    assert "To be sure: run the motors without propellers." in words
    assert "cannot be compensated live: it needs the level of vibration" in words
    can = text.live_text("gyro_scale_factor")
    assert can == "The estimator can compensate it live, by a calibration file"


@pytest.mark.parametrize(
    ("value", "std", "unit", "words"),
    [
        (0.0089219, 0.0000312, "s", "0.008922 ± 0.000031 s"),
        ([0.01, -0.2], [0.001, 0.02], "1", "(0.0100 ± 0.0010, -0.200 ± 0.020)"),
        (25.0, 0.0, "degC", "25 degC"),
        (123.4, 11.0, "ppm", "123 ± 11 ppm"),
        (0.0, 2e-6, "rad/s", "(0.0 ± 2.0)e-6 rad/s"),
    ],
)
def test_figures_carry_two_digits_of_their_sigma(value, std, unit, words):
    assert text.estimate_text(Estimated(value, std, unit)) == words


def test_what_is_too_large_to_be_believed_is_told_with_its_size(diagnosis):
    (item,) = diagnosis.implausible
    words = text.implausible_text(item)
    assert "accel_scale_factor) would gain 231 nats" in words
    assert "scale error (0.6, 0, 0.9) (data sheets: up to 0.03)" in words
    assert words in html.unescape(page("a.tlog", diagnosis))
    assert json.loads(json.dumps(as_json(diagnosis)))["implausible"][0]["log_evidence"] == 231.0


def test_the_fitted_numbers_stand_in_a_table_by_axis():
    matrix = Estimated(np.full((3, 3), 2e-3).tolist(), np.full((3, 3), 1e-4).tolist(), "rad s/m")
    offset = Estimated(0.0089, 0.0001, "s")
    one = finding(parameters={"matrix_rad_s_per_m_s2": matrix, "offset_s": offset})
    cell = "0.00200 ± 0.00010"
    assert text.parameter_rows(one) == [
        *((f"matrix [rad s/m] of {axis}", cell, cell, cell) for axis in "xyz"),
        ("offset [s]", "0.00890 ± 0.00010", "", ""),
    ]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("offset_s", "offset"),
        ("arm_m", "arm"),
        ("reference_degC", "reference"),
        ("matrix_rad_s_per_m_s2", "matrix"),
        ("per_degC_per_s", "per degC per s"),
        ("per_ampere", "per ampere"),
    ],
)
def test_a_parameter_is_named_without_the_unit_that_its_value_carries(name, words):
    assert text.parameter_text(name) == words


def test_every_covariate_has_the_most_telling_channel_of_each_sensor():
    channels = ("gyro_x", "gyro_y", "accel_x", "accel_z")
    edges, nothing = np.arange(3.0), np.zeros(2)
    panels = [
        Covariate(channel, covariate, "1", edges, nothing, nothing, nothing, 0.1 / (n + 1))
        for covariate in ("throttle", "time")
        for n, channel in enumerate(channels)
    ]
    shown = [(item.covariate, item.channel) for item in most_telling(panels)]
    assert shown == [
        ("throttle", "accel_z"), ("time", "accel_z"), ("throttle", "gyro_y"), ("time", "gyro_y")
    ]  # fmt: skip


def test_the_page_is_one_file_with_all_that_was_found(diagnosis):
    content = page(
        "flight <1>.tlog", diagnosis, ("sim.tlog", Diagnosis("no_mismatch", (), (), (), None, None))
    )
    assert "flight &lt;1&gt;.tlog" in content
    assert "<b>ATTITUDE" not in content
    # Evidence, residuals, timeline, covariates, held out.
    assert content.count("<svg") == 5
    for words in ("0.4 m/s^2 low", "What sim.tlog lacks", "airspeed", "spans 0.4 degC", "3.20 deg"):
        assert words in html.unescape(content)
    remote = re.findall(r'(?:src|href)="(?!#)([^"]+)"', content)
    assert remote == []
    report = json.loads(html.unescape(re.search(r"<pre>(.*)</pre>", content, re.S).group(1)))
    assert report["schema"] == "ahrs-mismatch/1"


def test_the_terminal_says_the_same(diagnosis):
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(summary("flight.tlog", diagnosis))
    shown = " ".join(console.export_text().split())
    assert "Unexplained: something real is left" in shown
    assert "The z accelerometer reads 0.4 m/s^2 low while the motors vibrate." in shown
    assert "accel x deviates from 20 s to 90 s and depends on airspeed" in shown
    assert "0.21 → 0.06" in shown
    assert "3.20 deg before, 0.40 deg after" in shown


def test_what_the_truth_holds_stands_beside_the_found(diagnosis):
    held = finding().holdout
    true = (
        TrueEffect("accel_current_coupling", {"per_ampere": [0.0, 0.0, 0.1], "reference_a": 0.0}),
        TrueEffect("gyro_scale_factor", {"scale_error": [0.01, 0.0, 0.0]}),
    )
    sides = {"gyro": held, "accel": held}
    oracle = Oracle(true, ("accel: something that depends on airspeed",), sides, sides, 0.3)
    rows = text.beside_truth(replace(diagnosis, oracle=oracle))
    assert rows == [
        ("accel_current_coupling", "per ampere", "(0, 0, 0.1) m/s^2/A",
         "in the class of accel_vibration_rectification"),
        ("accel_current_coupling", "reference", "0 A",
         "in the class of accel_vibration_rectification"),
        ("gyro_scale_factor", "scale error", "(0.01, 0, 0)", "not found"),
        ("accel: something that depends on airspeed", "", "has no equation here", ""),
    ]  # fmt: skip
    beside = replace(diagnosis, oracle=oracle)
    figures = {name: cells for name, *cells in text.held_out_beside_truth(beside)}
    assert figures["accel z rms [m/s^2]"] == ["0.21", "0.06", "0.06"]
    assert figures["attitude after 60 s of the gyro alone [deg]"] == ["3.200", "0.400", "0.300"]
    wrong = replace(oracle, effects=())
    (row,) = text.beside_truth(replace(diagnosis, oracle=replace(wrong, outside=())))
    assert row[:3] == ("accel_vibration_rectification", "", "not there")


def recorded_for(seconds, rate_hz=100.0):
    time_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    nothing = np.zeros((len(time_s), 3))
    series = Series(time_s, nothing)
    return Recorded(
        "a.tlog", time_s, nothing, nothing, series, series, series, *(Series() for _ in range(5))
    )


def test_a_truth_is_read_as_its_effects_and_what_has_no_equation(tmp_path):
    path = tmp_path / "a.truth.json"
    effects = [
        {"effect": "imu_time_offset", "params": {"offset_s": 0.01, "meaning": "late"}},
        {"effect": "unknown", "params": {"depends_on": "airspeed", "sensor": "accel"}},
        {"effect": "none", "params": {"note": "glitches"}},
    ]
    content = {"kind": "flight", "level": 1, "seconds": 20, "imu_rate_hz": 100, "effects": effects}
    path.write_text(json.dumps(content))
    truth = truth_file.read(path, recorded_for(20.0))
    assert [(effect.id, float(values["offset_s"])) for effect, values in truth.effects] == [
        ("imu_time_offset", 0.01)
    ]
    assert truth.outside == ("accel: something that depends on airspeed",)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"seconds": 600}, "seconds 600, but a.tlog has 19.99; give the truth of this recording"),
        ({"imu_rate_hz": 200}, "imu_rate_hz 200, but a.tlog has 100"),
        ({"effects": [{"effect": "gyro_magic", "params": {}}]}, "gyro_magic is not in the catal"),
        ({"effects": [{"effect": "gyro_scale_factor"}]}, "no 'params'"),
        ({"effects": [{"effect": "gyro_scale_factor", "params": {}}]}, "has no scale_error"),
        (
            {"effects": [{"effect": "gyro_scale_factor", "params": {"scale_error": 1}}]},
            "scale_error: 1 has shape ()",
        ),
        ({"effects": 3}, "effects"),
    ],
)
def test_a_truth_of_another_recording_or_none_is_refused(tmp_path, changes, words):
    path = tmp_path / "a.truth.json"
    content = {"kind": "flight", "level": 1, "seconds": 20, "imu_rate_hz": 100, "effects": []}
    path.write_text(json.dumps(content | changes))
    with pytest.raises(RecordingError) as refused:
        truth_file.read(path, recorded_for(20.0))
    assert words in str(refused.value)
    assert str(path) in str(refused.value)


def test_what_the_simulated_lacks_is_what_no_effect_of_its_classes_explains(diagnosis):
    has_alike = Diagnosis(
        "explained", (finding("accel_current_coupling", alike=()),), (), (), None, None
    )
    findings, unexplained = text.lacking(diagnosis, has_alike)
    assert findings == []
    assert [item.channel for item in unexplained] == ["accel_x"]


def test_the_twin_is_extended_and_what_it_had_is_added_to(diagnosis, tmp_path):
    effect = effect_of("accel_vibration_rectification")
    had = effect.checked({"per_vibration_variance": [0.01, 0.0, 0.0]})
    twin = extended(Imu(effects=((effect, had),)), diagnosis)
    path = tmp_path / "twin.toml"
    twin_file.write(path, twin, "test", sigmas_of(diagnosis))
    ((again, values),) = twin_file.read(path).effects
    assert again == effect
    np.testing.assert_allclose(values["per_vibration_variance"], [0.01, 0.0, -0.09])
    assert "[effects.sigma]" in path.read_text()


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
    told = {one["effect"]: one["parameters"] for one in oracle["effects"]}
    assert told == {one["effect"]: one["params"] for one in truth}
    found, true = (oracle[side]["gyro"]["log_likelihood_gain"] for side in ("found", "oracle"))
    assert 0.95 * true < found < 1.05 * true
    for triad in ("gyro", "accel"):
        after, best = (oracle[side][triad]["rms_after"] for side in ("found", "oracle"))
        np.testing.assert_allclose(after, best, rtol=0.15)
    run = report["holdout"]["free_run_attitude_error_60s_deg"]
    assert run["oracle"] == pytest.approx(run["after"], rel=0.1)
    assert "Beside the truth" in (folder / "report.html").read_text()


def test_every_file_is_whole(written):
    _, folder = written
    assert (folder / "report.html").read_text().rstrip().endswith("</html>")
    assert (folder / "report.rrd").stat().st_size > 10_000
    assert len(list(folder.iterdir())) == 5
    twin = twin_file.read(folder / "twin.toml")
    assert {effect.id for effect, _ in twin.effects} == {"gyro_scale_factor", "accel_thermal_bias"}


def test_the_calibration_written_takes_the_mismatch_away(written):
    """By the service's own compensation: what the reference says and the IMU reads then agree."""
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
    [("missing.tlog", "no such file"), ("notes.txt", "is no log format")],
)
def test_a_recording_that_cannot_be_read_is_told(name, words, tmp_path, capsys):
    path = tmp_path / name
    if name == "notes.txt":
        path.write_text("nothing")
    assert main(["diagnose", str(path)]) == 1
    message = capsys.readouterr().err
    assert str(path) in message
    assert words in message
