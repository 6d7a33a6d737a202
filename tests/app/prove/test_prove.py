"""`ahrs-service prove`: sealing, scoring an existing set, files, refusals."""

import json

import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.prove import command as prove
from ahrs_service.app.prove.blind_files import write_case
from ahrs_service.app.prove.blind_rivals import Answer
from ahrs_service.app.prove.blind_tables import share
from ahrs_service.blind.judging.held_out_score import gain_share, modelled
from ahrs_service.blind.judging.scoring import Rate
from ahrs_service.blind.making.case import Request, make


@pytest.fixture
def cases(tmp_path):
    """A folder with a null and a thermal bias of a data sheet's size, 30 s each."""
    folder = tmp_path / "cases"
    folder.mkdir()
    for request in (
        Request("null", "bench", 4, 30),
        Request("bias", "bench", 5, 30, level=0, effects=("gyro_thermal_bias",)),
    ):
        write_case(folder, folder, make(request))
    return folder


def test_a_set_is_sealed_diagnosed_and_scored(tmp_path, capsys):
    keep, out = tmp_path / "kept", tmp_path / "score.json"
    arguments = ["--count", "3", "--seconds", "30", "--seed", "9", "--keep", str(keep)]
    assert main(["prove", *arguments, "--json", str(out)]) == 0
    printed = capsys.readouterr().out
    document = json.loads(out.read_text())
    assert f"sha256 {document['seal_sha256']}" in printed
    assert printed.index("sealed") < printed.index("score of 3 recordings")
    assert {"diagnose", "F-test", "BIC", "lasso", "oracle"} == set(document["score"])
    assert len(document["marks"]["diagnose"]) == 3
    assert len(list(keep.glob("*.tlog"))) == len(list(keep.glob("*.report.json"))) == 3
    again = tmp_path / "again.json"
    kept = ["--cases", str(keep), "--reports", str(keep), "--json", str(again)]
    assert main(["prove", *kept]) == 0
    rescored = json.loads(again.read_text())
    assert rescored["seal_sha256"] == document["seal_sha256"]
    assert rescored["marks"]["diagnose"] == document["marks"]["diagnose"]
    assert main(["prove", *arguments]) == 2
    assert "already holds a set" in capsys.readouterr().err


def test_recordings_that_are_there_are_scored_in_processes(cases, tmp_path):
    out = tmp_path / "score.json"
    assert main(["prove", "--cases", str(cases), "--jobs", "2", "--json", str(out)]) == 0
    document = json.loads(out.read_text())
    assert [mark["name"] for mark in document["marks"]["diagnose"]] == ["bias", "null"]
    alarms = {row["title"]: row for row in document["score"]["F-test"]}["nulls falsely alarmed"]
    assert alarms["of"] == 1


def test_a_truth_changed_under_way_is_noticed(cases, monkeypatch, capsys):
    def meddling(path, with_rivals):
        truth = cases / "null.truth.json"
        truth.write_text(truth.read_text() + " ")
        return Answer(path.stem, {"diagnose": {}}, 0.0)

    monkeypatch.setattr(prove, "answer", meddling)
    assert main(["prove", "--cases", str(cases)]) == 1
    assert "a truth file changed" in " ".join(capsys.readouterr().err.split())


def test_what_cannot_be_scored_is_refused(cases, tmp_path, capsys):
    assert main(["prove", "--reports", str(cases)]) == 2
    assert main(["prove", "--cases", str(cases), "--reports", str(cases)]) == 1
    assert "no NAME.report.json" in capsys.readouterr().err
    (cases / "bias.report.json").write_text("[]")
    assert main(["prove", "--cases", str(cases), "--reports", str(cases)]) == 1
    assert "no table of fields" in capsys.readouterr().err
    assert main(["prove", "--cases", str(tmp_path)]) == 1
    assert "no NAME.tlog" in capsys.readouterr().err
    (tmp_path / "a.tlog").write_bytes(b"")
    (tmp_path / "a.truth.json").write_text("{}")
    assert main(["prove", "--cases", str(tmp_path), "--no-rivals"]) == 1
    assert "a.truth.json" in capsys.readouterr().err


def test_a_recording_that_cannot_be_read_is_reported_and_the_others_are_scored(
    cases, tmp_path, capsys
):
    (cases / "bias.tlog").write_bytes(b"no frames at all")
    out = tmp_path / "score.json"
    assert main(["prove", "--cases", str(cases), "--no-rivals", "--json", str(out)]) == 1
    document = json.loads(out.read_text())
    assert set(document["failures"]) == {"bias"}
    assert "no MAVLink frames" in document["failures"]["bias"]
    assert [mark["name"] for mark in document["marks"]["diagnose"]] == ["bias", "null"]
    assert "bias" in capsys.readouterr().out


def test_shares_are_shown_with_their_interval():
    assert share(Rate(0, 0)) == "-"
    assert share(Rate(81, 263)) == "81/263\n26-37"


def test_the_true_parameters_have_all_of_the_oracle_s_gain():
    case = make(Request("a", "copter", 5, 60, effects=("accel_lever_arm", "gyro_scale_factor")))
    findings = [
        {
            "effect": entry["effect"],
            "parameters": {name: {"value": value} for name, value in entry["params"].items()},
        }
        for entry in case.truth["effects"]
    ]
    assert gain_share(case, {"effects": findings}) > 0.99
    assert gain_share(case, {"effects": findings[:1]}) == pytest.approx(0.5, abs=0.02)
    assert not any(added.any() for added in modelled(case, {"effects": []}))


def test_recordings_too_short_to_hide_in_are_refused(capsys):
    assert main(["prove", "--count", "4", "--seconds", "1"]) == 2
    assert "--seconds 1: too short" in capsys.readouterr().err
