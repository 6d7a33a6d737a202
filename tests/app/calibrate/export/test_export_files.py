"""Exports to parameter files, imports from files and recordings."""

import pytest

from ahrs_service.app import cli
from ahrs_service.app.files import calibration_file
from ahrs_service.calibration.autopilots.ardupilot_params import to_ardupilot
from ahrs_service.links.logs.param_files import ParamValue, read_param_file
from ahrs_service.sensor.provenance import Verdict
from tests.app.calibrate.export.conftest import text_of, unit


def test_a_file_and_back_is_the_same_calibration_of_the_autopilot(folder, capsys):
    words = ["calibrate", "export", "unit.toml", "--autopilot", "ardupilot", "--param", "a.param"]
    assert cli.main(words) == 0
    assert cli.main(words) == 1
    assert "already exists" in text_of(capsys)
    assert cli.main(["calibrate", "import", "a.param", "--out", "b.toml", "--serial", "B"]) == 0
    assert "do not give it to the service" in text_of(capsys)
    read = calibration_file.load("b.toml")
    assert (read.serial, read.provenance.procedures) == ("B", ("import",))
    assert read.accel.span_degc == (-10.0, 60.0)
    assert cli.main(
        ["calibrate", "export", "b.toml", "--autopilot", "ardupilot", "--param", "c.param"]
    ) == 0  # fmt: skip
    assert read_param_file("c.param") == read_param_file("a.param")


def test_px4_s_file_needs_the_ids_of_the_sensors(folder, capsys):
    words = ["calibrate", "export", "unit.toml", "--autopilot", "px4", "--param"]
    assert cli.main([*words, "a.param"]) == 0
    assert "set it to CAL_ACC0_ID" in text_of(capsys)
    (folder / "px4.params").write_text(
        "1\t1\tCAL_ACC0_ID\t4259850\t6\n1\t1\tCAL_GYRO0_ID\t4325386\t6\n"
        + "".join(
            f"1\t1\tCAL_{triad}0_{axis}{what}\t{value}\t9\n"
            for triad, what, value in (("ACC", "OFF", 0), ("ACC", "SCALE", 1), ("GYRO", "OFF", 0))
            for axis in "XYZ"
        )
    )
    assert cli.main([*words, "b.param", "--compensated-by", "px4.params"]) == 0
    values = read_param_file("b.param")
    assert values["TC_A0_ID"] == ParamValue(4259850.0, 6)
    assert values["TC_G0_ID"] == ParamValue(4325386.0, 6)


def test_what_came_on_top_of_the_autopilot_s_own_replaces_both(folder, capsys):
    (folder / "old.param").write_text(
        "".join(
            f"INS_{name}_{axis},{value}\n"
            for name, value in (("ACCOFFS", 0.3), ("ACCSCAL", 1.02), ("GYROFFS", 0.01))
            for axis in "XYZ"
        )
    )
    words = ["calibrate", "export", "unit.toml", "--autopilot", "ardupilot", "--param", "a.param"]
    assert cli.main([*words, "--compensated-by", "old.param"]) == 0
    values = read_param_file("a.param")
    alone = to_ardupilot(unit()).values
    for i, axis in enumerate("XYZ"):
        scale = alone[f"INS_ACCSCAL_{axis}"]
        assert values[f"INS_ACCSCAL_{axis}"].value == pytest.approx(scale * 1.02, rel=1e-6)
        offset = alone[f"INS_ACCOFFS_{axis}"] / 1.02 + 0.3
        assert values[f"INS_ACCOFFS_{axis}"].value == pytest.approx(offset, abs=1e-5), i


@pytest.mark.parametrize(
    ("words", "code", "printed"),
    [
        (["unit.toml", "--param", "a.param"], 2, "--param needs --autopilot"),
        (["--param", "a.param", "--autopilot", "px4"], 2, "give calibration files, or --restore"),
        (["--restore", "a.param", "--param", "b.param"], 2, "--restore needs --link"),
        (["unit.toml", "unit.toml", "--link", "udpin:127.0.0.1:0"], 2, "two calibrations for one"),
        (["no.toml", "--link", "udpin:127.0.0.1:0"], 2, "no.toml: No such file"),
        (["9=unit.toml", "--autopilot", "px4", "--param", "a.param"], 1, "IMU 9: give 1 for PX4"),
        (
            ["unit.toml", "--autopilot", "ardupilot", "--param", "a", "--orientation", "100"],
            2,
            "orientation 100 is none of the fixed rotations",
        ),
        (
            ["bad.toml", "--autopilot", "ardupilot", "--param", "a.param"],
            1,
            "bad.toml: not exported, for its verdict is: do not use: span 8 degC",
        ),
        (["unit.toml", "--link", "nonsense"], 1, "no such kind of link"),
    ],
)
def test_wrong_usage_and_refusals(folder, capsys, words, code, printed):
    refused = Verdict(usable=False, sentences=("do not use: span 8 degC",))
    calibration_file.save("bad.toml", unit(verdict=refused))
    assert cli.main(["calibrate", "export", *words]) == code
    assert printed in text_of(capsys)


def test_a_real_recording_s_parameters_and_who_reported_them(folder, shared, capsys):
    flights = shared / "flights"
    log = flights / "bench_cuav_2021-12-08_static_warmup_2hz.tlog"
    assert cli.main(["calibrate", "import", str(log), "--imu", "2", "--out", "a.toml"]) == 0
    assert "as reported by 255/190, not the vehicle itself" in text_of(capsys)
    read = calibration_file.load("a.toml")
    assert read.imu == 1
    assert read.accel.bias[0] == pytest.approx(0.39934, abs=1e-5)
    log = flights / "copter_cube_2018-09-25_mission_3imu.tlog"
    assert cli.main(["calibrate", "import", str(log), "--out", "b.toml"]) == 0
    assert "INS_GYROFFS_X, INS_GYROFFS_Y" in text_of(capsys)


def test_a_recording_without_parameters_is_reported(folder, simulated_tlog, capsys):
    assert cli.main(["calibrate", "import", str(simulated_tlog), "--out", "a.toml"]) == 1
    assert "carries no parameters" in text_of(capsys)
