"""What a replay reports to its user."""

import pytest

from ahrs_service.app.replay.replay_log import replay_log
from tests.app.replay.conftest import frames_of, replay, write


def test_the_table_shows_the_digest_and_the_errors(flight, capsys):
    assert replay(flight) == 0
    shown = capsys.readouterr().out
    assert f"estimates sha256 {replay_log(flight).summary.digest}\n" in shown
    for part in ("HIGHRES_IMU", "100.0 Hz", "roll, whole", "pitch, steady", "open", "free"):
        assert part in shown


@pytest.mark.parametrize("name", ["a.zip", "a.mat", "a.csv.gz", "a.tlog", "a.ulg", "a.bin"])
def test_what_cannot_be_read_is_refused_in_one_sentence(name, flight, tmp_path, capsys):
    bad = tmp_path / name
    bad.write_bytes(b"PK\x03\x04" + bytes(3000))
    assert replay(bad, flight) == 1
    captured = capsys.readouterr()
    (line,) = captured.err.strip().splitlines()
    assert line.startswith("refused:")
    assert name in line
    assert "Traceback" not in captured.err
    assert "estimates sha256" in captured.out


def test_a_log_without_imu_is_refused_with_what_it_has(tmp_path, capsys):
    frames = [one for one in frames_of() if one[1][7] != 105]
    path = write(tmp_path / "blind.tlog", frames)
    assert replay(path) == 1
    message = capsys.readouterr().err
    assert "no IMU" in message
    assert "ATTITUDE 240" in message


def test_a_folder_without_recordings_is_refused(tmp_path, capsys):
    assert replay(tmp_path) == 1
    assert f"{tmp_path}: the folder holds no recording" in capsys.readouterr().err


def test_a_vehicle_that_is_not_there_is_refused_with_the_setting(flight, capsys):
    assert replay(flight, "--set", "intake.system=42") == 1
    assert "intake.system = 42" in capsys.readouterr().err


def test_wrong_settings_are_wrong_usage(flight, capsys):
    assert replay(flight, "--set", "gate.no_such=1") == 2
    assert "gate.no_such" in capsys.readouterr().err


def test_the_recording_is_never_overwritten(flight, capsys):
    before = flight.read_bytes()
    assert replay(flight, "--tlog", flight) == 1
    assert flight.read_bytes() == before
    assert "is the recording itself" in capsys.readouterr().err


def test_an_output_that_cannot_be_written_is_reported(flight, tmp_path, capsys):
    assert replay(flight, "--csv", tmp_path / "none" / "out.csv") == 1
    message = capsys.readouterr().err
    assert message.startswith("failed:")
    assert "out.csv" in message
