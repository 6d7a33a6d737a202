"""Reports of a diagnosis: sentences, figures, page, terminal, twin."""

import html
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from ahrs_service.app.diagnose import diagnosis_text as text
from ahrs_service.app.diagnose.command import extended, sigmas_of
from ahrs_service.app.diagnose.diagnosis_page import most_significant, page
from ahrs_service.app.diagnose.diagnosis_terminal import summary
from ahrs_service.app.files import twin_file
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


def finding(effect="accel_vibration_rectification", **changes):
    holdout = Holdout(
        412.3, (0.05, 0.05, 0.21), (0.05, 0.05, 0.06), (0.01, 0.01, 0.18), (0.01, 0.01, 0.012)
    )
    values = {
        "effect": effect,
        "triad": effect.split("_", maxsplit=1)[0],
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
        "accel",
        "accel_z",
        "vibration",
        "m/s^2",
        edges,
        -edges[:10],
        np.ones(10),
        -edges[:10],
        1e-20,
    )
    return Diagnosis(
        verdict="unexplained",
        findings=(finding(),),
        unexplained=(
            Unexplained("accel", "accel_x", ("airspeed",), (Where(20.0, 90.0, ""),), 1e-5),
        ),
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
    assert "It is largest from 60 s to 150 s (vibration above 2 m/s^2)." in words
    assert "gains 412 nats" in words
    assert "cannot tell it from accelerometer: bias that follows the battery current" in words
    assert "Added to the reading: k sigma_vib^2." in words
    assert "It is often mistaken for accelerometer: bias that follows the temperature." in words
    assert "To separate them: run the motors without propellers." in words
    assert "cannot be compensated live: it needs the level of vibration" in words
    can = text.live_text("gyro_scale_factor")
    assert can == "The estimator can compensate it live, with a calibration file"


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


def test_what_is_too_large_to_be_believed_is_reported_with_its_size(diagnosis):
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
    channels = (
        ("gyro", "gyro_x"), ("gyro", "gyro_y"), ("accel", "accel_x"), ("accel", "accel_z")
    )  # fmt: skip
    edges, nothing = np.arange(3.0), np.zeros(2)
    panels = [
        Covariate(triad, channel, covariate, "1", edges, nothing, nothing, nothing, 0.1 / (n + 1))
        for covariate in ("throttle", "time")
        for n, (triad, channel) in enumerate(channels)
    ]
    shown = [(item.covariate, item.channel) for item in most_significant(panels)]
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
    assert "Unexplained: a real difference is left" in shown
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
        ("accel: something that depends on airspeed", "", "not in the catalogue", ""),
    ]  # fmt: skip
    beside = replace(diagnosis, oracle=oracle)
    figures = {name: cells for name, *cells in text.held_out_beside_truth(beside)}
    assert figures["accel z rms [m/s^2]"] == ["0.21", "0.06", "0.06"]
    assert figures["attitude error after 60 s on gyro alone [deg]"] == ["3.200", "0.400", "0.300"]
    wrong = replace(oracle, effects=())
    (row,) = text.beside_truth(replace(diagnosis, oracle=replace(wrong, outside=())))
    assert row[:3] == ("accel_vibration_rectification", "", "not present")


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
