"""`calibrate six-position` and `multi-pose` on recordings: files, JSON, refusals."""

import hashlib
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.files import calibration_file
from ahrs_service.app.simulate.command import write_tlog
from ahrs_service.sensor.compensation import compensate_columns
from ahrs_service.sensor.parameters import coefficients
from ahrs_service.simulation.scenario import make_flight

RATES = {"HEARTBEAT": 1.0, "HIGHRES_IMU": 50.0, "SCALED_IMU": 5.0}


def flight_of(scenario, seconds, **changes):
    return make_flight(scenario, seconds, rate_hz=100.0, **changes)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """One bench recording per scenario, at 50 Hz with the IMU's temperature at 5 Hz."""
    folder = tmp_path_factory.mktemp("bench")
    for scenario, seconds in (("six-position", 110.0), ("multi-pose", 130.0)):
        write_tlog(folder / f"{scenario}.tlog", flight_of(scenario, seconds), RATES)
    return folder


@pytest.fixture
def calibrate(capsys):
    """Run the command line; exit code, JSON or None, and the printed text."""

    def run(*words):
        code = main(["calibrate", *map(str, words)])
        printed = capsys.readouterr()
        lines = [line for line in printed.out.splitlines() if line.startswith(("{", "["))]
        plain = json.loads(lines[-1]) if "--json" in words and lines else None
        return code, plain, printed.out + printed.err

    return run


@pytest.mark.parametrize("scenario", ["six-position", "multi-pose"])
def test_the_file_of_the_unit_makes_its_output_right(scenario, recordings, calibrate, tmp_path):
    path, out = recordings / f"{scenario}.tlog", tmp_path / "A7.toml"
    code, plain, said = calibrate(scenario, path, "--out", out, "--serial", "A7", "--json")
    assert code == 0
    assert plain["words"] == "use"
    assert "verdict: use" in said
    calibration = calibration_file.load(out)
    assert calibration.serial == "A7"
    assert calibration.provenance.procedures == (scenario,)
    (source,) = calibration.provenance.recordings
    assert source.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert calibration.verdict.usable
    assert calibration.verdict.sentences[0] == f"{scenario}: use"
    assert calibration.gyro.uncertainty.standard_errors()["bias.x"] < 5e-4
    # Another bench, other noise: the compensated force at rest is gravity.
    flight = flight_of(scenario, 110.0 if scenario == "six-position" else 130.0, seed=5)
    rows = flight.rows
    rest = np.linalg.norm(rows["rate_rad_s"], axis=1) == 0.0
    gyro, accel = compensate_columns(
        coefficients(calibration),
        rows["gyro_rad_s"][rest],
        rows["accel_m_s2"][rest],
        rows["imu_degc"][rest].astype(float),
    )
    before = np.linalg.norm(rows["accel_m_s2"][rest], axis=1) - 9.80665
    after = np.linalg.norm(accel, axis=1) - 9.80665
    assert np.sqrt(np.mean(after**2)) < 0.6 * np.sqrt(np.mean(before**2))
    assert np.abs(after.mean()) < 0.005
    # Both benches have an additional wandering bias of 2e-4 rad/s; the sensor's is 5e-3.
    assert np.abs(gyro.mean(axis=0)).max() < 8e-4


def test_two_procedures_share_one_file(recordings, calibrate, tmp_path):
    out = tmp_path / "A7.toml"
    assert calibrate("six-position", recordings / "six-position.tlog", "--out", out)[0] == 0
    first = calibration_file.load(out)
    words = ("multi-pose", recordings / "multi-pose.tlog", "--no-gyro", "--out", out)
    assert calibrate(*words)[0] == 0
    both = calibration_file.load(out)
    assert both.gyro == first.gyro
    assert both.accel != first.accel
    assert both.provenance.procedures == ("six-position", "multi-pose")
    assert len(both.provenance.recordings) == 2
    assert any(text.startswith("six-position: gyro") for text in both.verdict.sentences)


def test_a_file_of_another_unit_is_left_alone(recordings, calibrate, tmp_path):
    out = tmp_path / "A7.toml"
    words = ("six-position", recordings / "six-position.tlog", "--out", out, "--serial")
    assert calibrate(*words, "A7")[0] == 0
    before = out.read_bytes()
    code, _, said = calibrate(*words, "B8")
    assert code == 2
    assert "of different units, A7 and B8" in " ".join(said.split())
    assert out.read_bytes() == before


def test_poses_of_two_recordings_add_up(calibrate, tmp_path):
    flight = flight_of("six-position", 110.0)
    half = len(flight.rows) // 2
    for name, rows in (("a", flight.rows[:half]), ("b", flight.rows[half:])):
        part = rows.copy()
        part["time_s"] -= part["time_s"][0]
        write_tlog(tmp_path / f"{name}.tlog", replace(flight, rows=part), RATES)
    for name in "ab":
        code, _, said = calibrate("six-position", tmp_path / f"{name}.tlog")
        assert (code, "put the unit on each of its six faces" in said) == (1, True)
    code, plain, _ = calibrate(
        "six-position", tmp_path / "a.tlog", tmp_path / "b.tlog", "--no-turns", "--json"
    )
    assert code == 0
    assert [one["name"] for one in plain["recordings"]] == ["a.tlog", "b.tlog"]


def test_gravity_by_latitude_is_the_geodetic_one(recordings, calibrate):
    """At 45 deg WGS 84 has 9.806199 m/s^2; the scale found follows it."""
    path = recordings / "six-position.tlog"
    standard = calibrate("six-position", path, "--json")[1]["found"]["accel"]["matrix"]
    for latitude, gravity in ((45.0, 9.806199), (0.0, 9.780325), (-90.0, 9.832185)):
        words = ("six-position", path, "--latitude", latitude, "--json")
        there = calibrate(*words)[1]["found"]["accel"]["matrix"]
        ratio = np.array(standard)[0, 0] / there[0][0]
        assert ratio * 9.80665 == pytest.approx(gravity, abs=2e-6)


def change(flight, **columns):
    rows = flight.rows.copy()
    for name, value in columns.items():
        rows[name] = value
    return replace(flight, rows=rows)


def bad(name):
    """A faulty bench recording, and the expected message."""
    six, many = flight_of("six-position", 110.0), flight_of("multi-pose", 130.0)
    gyro, accel = six.rows["gyro_rad_s"], six.rows["accel_m_s2"]
    tremor = math.radians(3.0) * np.sin(2.0 * np.pi * 9.0 * six.rows["time_s"])[:, None]
    return {
        "too few faces": (
            "six-position",
            replace(six, rows=six.rows[:3000]),
            "put the unit on each of its six faces",
        ),
        "too few poses": (
            "multi-pose",
            replace(many, rows=many.rows[:5000]),
            "take 12 or more, each 10 degrees from the others",
        ),
        "six poses": ("multi-pose", six, "in 6 different directions: take 12 or more"),
        "held in the hand": (
            "six-position",
            change(six, gyro_rad_s=gyro + tremor),
            "put it down on something solid",
        ),
        "swapped axes": (
            "six-position",
            change(six, gyro_rad_s=gyro[:, [2, 1, 0]]),
            "an axis is swapped, or the unit was tilted",
        ),
        "swapped axes, no table": (
            "multi-pose",
            change(many, gyro_rad_s=many.rows["gyro_rad_s"][:, [1, 0, 2]]),
            "correct the orientation of the sensor",
        ),
        "mG": (
            "six-position",
            change(six, accel_m_s2=accel * 1000.0 / 9.80665),
            "this is in mG; convert it to m/s^2",
        ),
        "gyro at its end": (
            "multi-pose",
            change(many, gyro_rad_s=np.clip(many.rows["gyro_rad_s"], -0.5, 0.5)),
            "within their range; turn the unit further from pose to pose",
        ),
        "accelerometer at its end": (
            "six-position",
            change(six, accel_m_s2=np.clip(accel, -9.5, 9.5)),
            "set the sensor to a wider range",
        ),
    }[name]


@pytest.mark.parametrize(
    "name",
    [
        "too few faces",
        "too few poses",
        "six poses",
        "held in the hand",
        "swapped axes",
        "swapped axes, no table",
        "mG",
        "gyro at its end",
        "accelerometer at its end",
    ],
)
def test_bad_input_is_refused_in_a_sentence(name, calibrate, tmp_path):
    procedure, flight, says = bad(name)
    write_tlog(tmp_path / "bad.tlog", flight, RATES)
    out = tmp_path / "unit.toml"
    code, plain, said = calibrate(procedure, tmp_path / "bad.tlog", "--out", out, "--json")
    assert code == 1
    assert plain is None
    assert "refused: " in said
    assert says in said
    assert "Traceback" not in said
    assert not out.exists()


def test_a_calibration_without_gain_is_not_written(calibrate, tmp_path):
    """A perfect sensor has nothing to gain: held-out poses get worse, and that is refused."""
    from ahrs_service.sensor.noise import TriadNoise
    from ahrs_service.simulation.imu import Imu

    imu = Imu(gyro_noise=TriadNoise(density=1e-4), accel_noise=TriadNoise(density=2e-3))
    write_tlog(tmp_path / "a.tlog", flight_of("six-position", 110.0, imu=imu), RATES)
    out = tmp_path / "unit.toml"
    code, plain, said = calibrate("six-position", tmp_path / "a.tlog", "--out", out, "--json")
    assert code == 1
    assert plain["words"].startswith("do not use: ")
    assert "held out got worse" in plain["words"]
    assert plain["wrote"] is None
    assert "was not written" in said
    assert not out.exists()


def test_what_the_autopilot_did_and_the_warm_up_are_reported(calibrate, tmp_path):
    flight = flight_of("six-position", 110.0)
    warming = change(flight, imu_degc=np.linspace(20.0, 32.0, len(flight.rows)))
    write_tlog(tmp_path / "a.tlog", warming, RATES)
    code, plain, _ = calibrate("six-position", tmp_path / "a.tlog", "--json")
    assert code == 0
    assert plain["words"].startswith("use with care: ")
    assert "from 20 to 32 degC during the poses" in plain["words"]
    assert plain["verdict"]["triads"][0]["span_degc"] == pytest.approx([20, 32], abs=1.5)


def test_turns_at_the_end_of_the_range_do_not_count(calibrate, tmp_path):
    """Two of six circles are too fast: the others and the poses are used."""
    flight = flight_of("six-position", 110.0)
    gyro = flight.rows["gyro_rad_s"].copy()
    gyro[:, 2] = np.clip(gyro[:, 2], -1.0, 1.5)
    write_tlog(tmp_path / "a.tlog", change(flight, gyro_rad_s=gyro), RATES)
    code, plain, _ = calibrate("six-position", tmp_path / "a.tlog", "--no-turns", "--json")
    assert code == 0
    assert "gyro z was saturated at times" in plain["words"]
    code, _, said = calibrate("six-position", tmp_path / "a.tlog")
    assert code == 1
    assert "4 turns about the vertical" in said
    assert "with each of the unit's three axes vertical in turn" in said


def test_turns_by_another_angle_do_not_count(recordings, calibrate):
    words = ("six-position", recordings / "six-position.tlog", "--turn", 250, "--json")
    code, plain, _ = calibrate(*words)
    assert code == 0
    assert "say by how much you turn with --turn" in plain["words"]
    assert set(plain["found"]) == {"accel"}


def test_without_a_temperature_it_is_said(calibrate, tmp_path):
    rates = {"HEARTBEAT": 1.0, "HIGHRES_IMU": 50.0}
    write_tlog(tmp_path / "a.tlog", flight_of("six-position", 110.0), rates)
    code, plain, _ = calibrate("six-position", tmp_path / "a.tlog", "--json")
    assert code == 0
    assert "temperature of the IMU is not known" in plain["words"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["six-position"], "give one recording or more, or --link URI"),
        (["six-position", "absent.tlog"], "absent.tlog: no such file"),
        (["six-position", "x.tlog", "--gravity", "1"], "--gravity 1: give the local gravity"),
        (["six-position", "x.tlog", "--imu", "NONE"], "--imu 'NONE'"),
        (["multi-pose", "x.tlog", "--poses", "3"], "12 poses or more"),
        (["multi-pose", "--link", "udpin:127.0.0.1:0", "--record", "x.txt"], "ends in .tlog"),
    ],
)
def test_wrong_words_are_reported(words, says, recordings, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.tlog").write_bytes((recordings / "six-position.tlog").read_bytes())
    try:
        code = main(["calibrate", *words])
    except SystemExit as ended:
        code = ended.code
    printed = capsys.readouterr()
    assert code in (1, 2)
    assert says in " ".join(printed.err.split())
