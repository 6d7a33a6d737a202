"""The daemon and the replay with a calibration: which one, and the same bytes in both."""

import asyncio
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.files import calibration_file
from ahrs_service.app.files.calibration_choice import CalibrationStore
from ahrs_service.app.live.daemon import Daemon
from ahrs_service.app.replay.export_rrd import write_recording
from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.errors import ConfigError, RecordingError
from ahrs_service.links.mavlink.codec import Encoder, dialect
from ahrs_service.rotation import euler_columns
from ahrs_service.sensor.parameters import Calibration, TriadCalibration
from ahrs_service.sensor.provenance import Provenance, Uncertainty, Verdict
from ahrs_service.settings import RecorderSettings, SensorSettings, Settings
from ahrs_service.simulation.imu import consumer_grade
from ahrs_service.simulation.scenario import make_flight

SHIPPED = Path(__file__).resolve().parents[3] / "configs" / "calibrations"
UNIT = b"SIM-1"


def version(uid2=UNIT, uid=0):
    """AUTOPILOT_VERSION as the simulated autopilot sends it."""
    nothing = [0] * 8
    numbers = (0, 0, 0, 0, 0, nothing, nothing, nothing, 0, 0, uid)
    message = dialect.MAVLink_autopilot_version_message(*numbers, list(uid2.ljust(18, b"\0")))
    return Encoder(1, 1).pack(message)


def lagging():
    """The simulator's sensor with thermometers that lag, g-sensitivity and no lack of models."""
    known = consumer_grade().calibration
    gyro = replace(
        known.gyro, thermal_lag_s=30.0, g_sensitivity=((1e-4, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3)
    )
    return replace(known, gyro=gyro, accel=replace(known.accel, thermal_lag_s=-20.0))


def folder_of(tmp_path, **calibrations):
    folder = tmp_path / "calibrations"
    folder.mkdir()
    for name, calibration in calibrations.items():
        calibration_file.save(folder / f"{name}.toml", calibration)
    return folder


def serve(live, tmp_path, sensor, frames, **recorder):
    """Serve `frames` over UDP, recorded; return the daemon, its estimates and its output."""

    async def scenario():
        recording = RecorderSettings(directory=str(tmp_path / "flights"), **recorder)
        settings = Settings(sensor=sensor, recorder=recording)
        async with live.session(settings, "udpin", tmp_path) as (served, vehicle):
            await live.fly(served, vehicle, frames)
        return served

    return asyncio.run(scenario())


def replayed(tmp_path):
    return [replay_log(path) for path in sorted((tmp_path / "flights").iterdir())]


@pytest.mark.parametrize("rotate_mb", [0.0, 0.05])
def test_live_equals_replay_with_a_calibration(rotate_mb, live, flight_frames, tmp_path):
    path = tmp_path / "unit.toml"
    calibration_file.save(path, lagging())
    sensor = SensorSettings(calibration=str(path))
    served = serve(live, tmp_path, sensor, flight_frames, rotate_mb=rotate_mb)
    path.unlink()
    parts = replayed(tmp_path)
    assert (len(parts) > 2) == (rotate_mb > 0.0)
    assert b"".join(part.estimates.tobytes() for part in parts) == b"".join(served.estimates)
    assert all("that of the recording, serial SIM-1" in part.summary.calibration for part in parts)


@pytest.mark.parametrize("rotate_mb", [0.0, 0.05])
def test_the_unit_that_the_autopilot_reports_in_flight_selects_from_a_folder(
    rotate_mb, live, flight_frames, tmp_path
):
    other = Calibration(gyro=TriadCalibration(bias=(1.0, 1.0, 1.0)), serial="B", uid="4242")
    folder = folder_of(tmp_path, ours=replace(lagging(), uid=UNIT.hex(), serial="A"), other=other)
    frames = [*flight_frames[:2000], version(), *flight_frames[2000:]]
    sensor = SensorSettings(calibration=str(folder))
    served = serve(live, tmp_path, sensor, frames, rotate_mb=rotate_mb)
    shutil.rmtree(folder)
    assert served.daemon.calibration.calibration.serial == "A"
    parts = replayed(tmp_path)
    assert b"".join(part.estimates.tobytes() for part in parts) == b"".join(served.estimates)
    assert "serial A" in parts[-1].summary.calibration
    assert parts[-1].recording.unit_of((1, 1)) == (UNIT.hex() if rotate_mb == 0.0 else "")


def test_from_the_moment_on_the_attitude_goes_on_and_what_was_learnt_of_the_sensor_goes(
    live, flight_frames, tmp_path
):
    folder = folder_of(tmp_path, ours=replace(consumer_grade().calibration, uid=UNIT.hex()))
    frames = [*flight_frames[:2000], version(), *flight_frames[2000:]]
    served = serve(live, tmp_path, SensorSettings(calibration=str(folder)), frames)
    rows = served.rows
    (change,) = np.flatnonzero(
        (rows["gyro_bias_rad_s"][1:] == 0.0).all(axis=1)
        & (rows["gyro_bias_rad_s"][:-1] != 0.0).any(axis=1)
    )
    before, after = rows["ned_from_body"][change], rows["ned_from_body"][change + 1]
    assert abs(before @ after) > np.cos(np.radians(0.5))


def test_settings_and_calibration_that_both_change_in_flight(live, flight_frames, tmp_path):
    """The prior from the calibration is used under both settings."""
    known = lagging()
    doubt = Uncertainty(bias_residual=(1e-4,) * 3, bias_turn_on=(1e-3,) * 3)
    known = replace(known, uid=UNIT.hex(), gyro=replace(known.gyro, uncertainty=doubt))
    folder = folder_of(tmp_path, ours=known)
    message = dialect.MAVLink_param_set_message(1, 191, b"AHRS_GATE_NORM", 0.1, 9)
    change = Encoder(255, 190).pack(message)
    part = len(flight_frames) // 4
    frames = [*flight_frames[:part], change, *flight_frames[part : 2 * part], version()]
    frames += [*flight_frames[2 * part : 3 * part], change, *flight_frames[3 * part :]]
    served = serve(live, tmp_path, SensorSettings(calibration=str(folder)), frames)
    assert served.daemon.settings.gate.norm_m_s2 == pytest.approx(0.1)
    (result,) = replayed(tmp_path)
    assert result.summary.digest == served.digest


def test_a_change_of_calibration_is_smoothed_over_on_either_side(live, flight_frames, tmp_path):
    folder = folder_of(tmp_path, ours=replace(consumer_grade().calibration, uid=UNIT.hex()))
    frames = [*flight_frames[:2000], version(), *flight_frames[2000:]]
    served = serve(live, tmp_path, SensorSettings(calibration=str(folder)), frames)
    (path,) = (tmp_path / "flights").iterdir()
    causal, smoothed = replay_log(path), replay_log(path, smooth=True)
    assert causal.summary.digest == smoothed.summary.digest == served.digest
    angle = np.abs(
        np.sum(causal.estimates["ned_from_body"] * smoothed.estimates["ned_from_body"], 1)
    )
    assert angle.min() > np.cos(np.radians(5.0))
    assert np.isfinite(smoothed.estimates["attitude_sigma_rad"]).all()
    sigmas = [one.estimates["attitude_sigma_rad"][:, :2].mean() for one in (smoothed, causal)]
    assert sigmas[0] < sigmas[1]


def test_the_replay_command_takes_file_folder_or_none(
    simulated_tlog, tmp_path, capsys, monkeypatch
):
    # In a narrow terminal the table wraps a long path.
    monkeypatch.setenv("COLUMNS", "250")
    said = []
    for options in (["--calibration", str(SHIPPED / "sim-1.toml")], ["--calibration", "none"]):
        assert main(["replay", str(simulated_tlog), *options]) == 0
        said.append(capsys.readouterr().out)
    assert "serial SIM-1" in said[0]
    assert "none, as requested" in said[1]
    unit = ["--set", "sensor.unit=sim-1"]
    assert main(["replay", str(simulated_tlog), "--calibration", str(SHIPPED), *unit]) == 0
    digests = [text.split("estimates sha256 ")[1].split()[0] for text in said]
    assert digests[0] in capsys.readouterr().out
    assert digests[0] != digests[1]
    assert main(["replay", str(simulated_tlog), "--calibration", str(SHIPPED)]) == 1
    assert "name the unit by sensor.unit" in capsys.readouterr().err
    assert main(["replay", str(simulated_tlog), "--calibration", str(tmp_path / "no.toml")]) == 2
    assert "no.toml: No such file" in capsys.readouterr().err


def test_a_calibrated_replay_shows_raw_beside_compensated(simulated_tlog, tmp_path):
    out = tmp_path / "flight.rrd"
    sensor = SensorSettings(calibration=str(SHIPPED / "sim-1.toml"))
    result = replay_log(simulated_tlog, sensor=sensor)
    assert result.is_calibrated
    write_recording(out, result)
    calibrated = out.stat().st_size
    plain = replay_log(simulated_tlog)
    assert not plain.is_calibrated
    write_recording(out, plain)
    # Rate and force, each raw, used and their difference: 18 numbers per sample.
    assert calibrated - out.stat().st_size > 0.5 * 18 * 8 * len(plain.estimates)


def test_estimate_compensates_arrays(tmp_path, capsys):
    """The raw output of the simulator's sensor, its temperature, and the shipped calibration."""
    rows = make_flight("flight", 30.0, seed=2, rate_hz=100.0).rows
    fields = {
        "imu_gyr": rows["gyro_rad_s"],
        "imu_acc": rows["accel_m_s2"],
        "imu_degc": rows["imu_degc"],
        "sampling_rate": 100.0,
    }
    source, out = tmp_path / "in.npz", tmp_path / "out.npz"
    np.savez(source, **fields)
    words = ["estimate", "--in", str(source), "--out", str(out), "--profile", "fixed_wing"]
    quats = {}
    for name, more in (("raw", []), ("known", ["--calibration", str(SHIPPED / "sim-1.toml")])):
        for frame in ("--frame", "frd"), ("--offline",):
            assert main([*words, *more, *frame]) == 0
            quats[name, frame[0]] = np.load(out)["quat"]
    assert "serial SIM-1" in capsys.readouterr().err.replace("\n", " ")
    truth = euler_columns(rows["ned_from_body"])[:, :2]
    for way in ("--frame", "--offline"):
        errors = {
            name: np.sqrt(np.mean((euler_columns(quats[name, way])[200:, :2] - truth[200:]) ** 2))
            for name in ("raw", "known")
        }
        assert errors["known"] < errors["raw"], (way, errors)
    assert main([*words, "--calibration", str(SHIPPED)]) == 2
    assert "name the unit by sensor.unit" in capsys.readouterr().err


def test_a_replay_takes_another_calibration_or_none(live, flight_frames, tmp_path):
    sensor = SensorSettings(calibration=str(SHIPPED / "sim-1.toml"))
    served = serve(live, tmp_path, sensor, flight_frames)
    (path,) = (tmp_path / "flights").iterdir()
    plain = replay_log(path, sensor=SensorSettings(calibration="none"))
    assert plain.summary.digest != served.digest
    assert plain.summary.calibration == "none, as requested"
    again = replay_log(path, served.daemon.settings)
    assert again.summary.digest == served.digest
    assert "sim-1.toml" in again.summary.calibration
    kept = replay_log(path, Settings())
    assert kept.summary.digest == served.digest, "other settings leave the recorded calibration"
    with pytest.raises(
        RecordingError, match=r"no calibration for a unit whose number is not known"
    ):
        replay_log(path, sensor=SensorSettings(calibration=str(SHIPPED)))


def test_the_daemon_says_which_it_uses(live, flight_frames, tmp_path):
    """The shipped example is of the simulator's unit."""
    frames = [flight_frames[0], version(), *flight_frames[1:500]]
    served = serve(live, tmp_path, SensorSettings(calibration=str(SHIPPED)), frames)
    said = [text for _, text in served.said]
    assert "calibration: waiting for the autopilot to report its unit" in said
    assert any("sim-1.toml: serial SIM-1, of 2026-01-01, gyro -10 to 70 degC" in t for t in said)


def test_a_unit_without_a_calibration_flies_on_without(live, flight_frames, tmp_path):
    frames = [flight_frames[0], version(b"\x07\x08"), *flight_frames[1:500]]
    served = serve(live, tmp_path, SensorSettings(calibration=str(SHIPPED)), frames)
    assert served.daemon.calibration is None
    assert any("no calibration for unit 0708 (it has those of SIM-1)" in t for _, t in served.said)
    assert len(served.rows)


@pytest.mark.parametrize("calibration", ["", "none"])
def test_who_wants_no_calibration_hears_of_none(live, flight_frames, tmp_path, calibration):
    frames = [flight_frames[0], version(), *flight_frames[1:500]]
    served = serve(live, tmp_path, SensorSettings(calibration=calibration), frames)
    assert served.daemon.component.unit == UNIT.hex()
    warnings = [text for level, text in served.said if level == "warning"]
    assert not [text for text in warnings if "no calibration for unit" in text]


def test_a_file_of_another_unit_is_used_as_reported_and_warned_of(live, flight_frames, tmp_path):
    frames = [flight_frames[0], version(b"", 0xAB), *flight_frames[1:500]]
    sensor = SensorSettings(calibration=str(SHIPPED / "sim-1.toml"))
    served = serve(live, tmp_path, sensor, frames)
    assert served.daemon.calibration is not None
    warnings = [text for level, text in served.said if level == "warning"]
    assert any("the autopilot is unit 00000000000000ab" in text for text in warnings)


BAD = Verdict(False, ("do not use: span 8 degC",))


def test_a_verdict_against_it_is_a_refusal_unless_forced(tmp_path, capsys):
    path = tmp_path / "bad.toml"
    calibration_file.save(path, Calibration(verdict=BAD))
    with pytest.raises(ConfigError, match=r"span 8 degC; calibrate again, or use .*--force"):
        Daemon(Settings(sensor=SensorSettings(calibration=str(path))), print)
    assert main(["run", "--calibration", str(path), "--seconds", "0.1"]) == 2
    assert "do not use: span 8 degC" in capsys.readouterr().err.replace("\n", " ")
    forced = CalibrationStore(SensorSettings(calibration=str(path), force_calibration=True))
    assert "DO NOT USE, forced" in forced.choose("").text()


def test_a_folder_passes_over_what_cannot_be_used_and_says_why(tmp_path):
    good = Calibration(serial="G", provenance=Provenance("2024-01-01"))
    newer = replace(good, provenance=Provenance("2024-02-01"))
    folder = folder_of(tmp_path, a=good, b=newer, bad=Calibration(serial="G", verdict=BAD))
    (folder / "broken.toml").write_text("[gyro")
    store = CalibrationStore(SensorSettings(calibration=str(folder), unit="g"))
    assert store.choose("").path.name == "b.toml"
    assert [any(w in note for note in store.notes) for w in ("span 8", "not valid TOML")] == [1, 1]


def test_a_folder_of_nothing_and_a_missing_file_are_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"holds no \.toml file"):
        CalibrationStore(SensorSettings(calibration=str(tmp_path)))
    with pytest.raises(ConfigError, match="No such file"):
        CalibrationStore(SensorSettings(calibration=str(tmp_path / "none.toml")))


def test_the_shipped_example_is_the_simulators_truth():
    shipped = calibration_file.load(SHIPPED / "sim-1.toml")
    truth = consumer_grade().calibration
    for name in ("gyro", "accel"):
        ours, theirs = getattr(shipped, name), getattr(truth, name)
        for field in ("matrix", "bias", "a", "b", "c", "matrix_drift", "g_sensitivity"):
            assert getattr(ours, field) == getattr(theirs, field), (name, field)
    assert (shipped.serial, shipped.uid) == (truth.serial, UNIT.hex())
