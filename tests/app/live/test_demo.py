"""The real `ahrs-service demo`: its output, its files, and how it can be stopped."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.links.logs.tlog import read_tlog
from tests.hang import HANG_S

ROOT = Path(__file__).resolve().parents[3]


def start(out: Path, seconds: float) -> "subprocess.Popen[str]":
    options = ["--headless", "--seconds", str(seconds), "--out", str(out)]
    options += ["--calibration", str(ROOT / "configs" / "calibrations")]
    return subprocess.Popen(
        [sys.executable, "-m", "ahrs_service.app.cli", "demo", *options],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "COLUMNS": "200"},
        start_new_session=True,
    )


def group_is_gone(process: "subprocess.Popen[str]") -> bool:
    """Return whether no process of the demo's session is left, the simulator included."""
    try:
        os.killpg(process.pid, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.fixture
def ended() -> Iterator[list["subprocess.Popen[str]"]]:
    processes: list[subprocess.Popen[str]] = []
    yield processes
    for process in processes:
        if not group_is_gone(process):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_it_flies_reports_and_leaves_whole_files(tmp_path, ended):
    process = start(tmp_path / "out", 6.0)
    ended.append(process)
    shown, errors = process.communicate(timeout=HANG_S)
    assert (process.returncode, errors) == (0, "")
    (folder,) = (tmp_path / "out").iterdir()
    assert sorted(path.name for path in folder.iterdir()) == ["flight.rrd", "flight.tlog"]
    log = read_tlog(folder / "flight.tlog")
    assert not any(log.damaged.values())
    result = replay_log(folder / "flight.tlog")
    equal = re.search(r"live and replay.*equal, bit for bit \((\d+) estimates\)", shown)
    assert int(equal[1]) == len(result.estimates) > 800
    assert int(re.search(r"autopilot got.* (\d+) ATTITUDE", shown)[1]) > 150
    assert re.search(r"HIGHRES_IMU: requested 200, received [12]\d\d\.\d Hz \(granted\)", shown)
    assert re.search(r"latency +│ p50 \d+\.\d\d ms", shown)
    assert "error against SIM_STATE (truth" in shown
    assert "sim-1.toml: serial SIM-1" in shown
    assert result.summary.calibration == "that of the recording, serial SIM-1"
    truth = next(one for one in result.recording.references if one.is_truth)
    assert len(truth.time_ns) > 200

    from rerun.chunk import RrdReader

    shown_in_rrd = {str(chunk.entity_path) for chunk in RrdReader(folder / "flight.rrd").stream()}
    assert {"/sensor/rate/raw", "/sensor/rate/used"} < shown_in_rrd


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_it_with_whole_files_and_nothing_left_behind(number, code, tmp_path, ended):
    process = start(tmp_path, 60.0)
    ended.append(process)
    for line in process.stdout:
        if "health: aligning" in line:
            break
    process.send_signal(number)
    _, errors = process.communicate(timeout=HANG_S)
    assert (process.returncode, errors) == (code, "")
    assert group_is_gone(process)
    (folder,) = tmp_path.iterdir()
    assert not any(read_tlog(folder / "flight.tlog").damaged.values())
    assert (folder / "flight.rrd").stat().st_size > 0


def test_what_cannot_be_flown_is_reported_before_anything_is_made(tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["demo", "--out", str(out), "--scenario", "moon"]) == 2
    assert "--scenario moon: choose one of flight" in capsys.readouterr().err
    assert main(["demo", "--out", str(out), "--set", "link.uri=4"]) == 2
    assert "link.uri = 4" in capsys.readouterr().err
    assert main(["demo", "--out", str(out), "--calibration", str(tmp_path / "no.toml")]) == 2
    assert "no.toml: No such file" in capsys.readouterr().err
    assert not out.exists()


def test_two_flights_in_one_second_have_folders_of_their_own(tmp_path, monkeypatch):
    from ahrs_service.app.live import demo

    monkeypatch.setattr(demo.time, "strftime", lambda form: "20260101-000000")
    made = [demo._files(tmp_path).name for _ in range(3)]
    assert made == ["20260101-000000", "20260101-000000-2", "20260101-000000-3"]
