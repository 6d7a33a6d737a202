"""Of which unit a calibration is: given, read from recordings, and never mixed."""

import argparse
from dataclasses import replace

import numpy as np
import pytest

from ahrs_service.app.calibrate.capture import Capture, read_capture
from ahrs_service.app.calibrate.outcome import unit_of
from ahrs_service.app.files import calibration_file
from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.errors import ConfigError
from ahrs_service.sensor.parameters import Calibration
from ahrs_service.settings import IntakeSettings

NOTHING = ImuColumns(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))


def captured(path, unit="", source="HIGHRES_IMU"):
    return Capture(NOTHING, path / "a.tlog", "0" * 64, source, 100.0, unit=unit)


def given(out=None, serial=""):
    return argparse.Namespace(out=out, serial=serial)


def test_board_and_imu_are_the_recordings(tmp_path):
    captures = [captured(tmp_path), captured(tmp_path, "ab12")]
    found = unit_of(given(serial="A1"), captures)
    assert (found.serial, found.uid, found.imu) == ("A1", "ab12", 0)
    assert unit_of(given(), [captured(tmp_path, source="SCALED_IMU3")]).imu == 2


def test_what_the_file_says_is_kept(tmp_path):
    path = tmp_path / "unit.toml"
    before = Calibration(serial="A1", uid="ab12", imu=1, source="bench")
    calibration_file.save(path, before)
    assert unit_of(given(path), [captured(tmp_path, source="SCALED_IMU2")]) == before


@pytest.mark.parametrize(
    ("serial", "unit", "source", "words"),
    [
        ("B2", "ab12", "HIGHRES_IMU", "different units, A1 and B2"),
        ("A1", "cd34", "HIGHRES_IMU", "different boards, ab12 and cd34"),
        ("", "", "SCALED_IMU2", "different IMUs, 0 and 1"),
    ],
)
def test_units_are_never_mixed(serial, unit, source, words, tmp_path):
    path = tmp_path / "unit.toml"
    calibration_file.save(path, Calibration(serial="A1", uid="ab12", imu=0))
    with pytest.raises(ConfigError, match=words):
        unit_of(given(path, serial), [captured(tmp_path, unit, source)])


def test_a_real_recording_identifies_its_board(shared):
    path = shared / "flights" / "bench_cuav_2021-12-08_static_warmup_2hz.tlog"
    if not path.exists():
        pytest.skip(f"{path.name} is missing in ../shared/data/flights")
    one = read_capture(path, IntakeSettings())
    found = unit_of(given(), [replace(one, columns=NOTHING)])
    assert found.uid == "1e0025001551383137383335"
    assert found.imu == 0
