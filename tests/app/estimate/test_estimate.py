"""`ahrs-service estimate`: attitude of plain arrays, by function, command and process."""

import subprocess
import sys

import numpy as np
import pytest

from ahrs_service.app.estimate import arrays
from ahrs_service.app.files import config_file
from ahrs_service.estimator import Estimator
from ahrs_service.records import SAMPLE_DTYPE, ImuSource, empty
from ahrs_service.rotation import euler_columns, inverse_columns, multiply_columns
from tests.app.estimate.conftest import angle_deg

FLIP = np.array([1.0, -1.0, -1.0])


def only(fields, *names):
    return {name: fields[name] for name in ("imu_gyr", "imu_acc", "sampling_rate", *names)}


def in_flu(fields):
    return {
        name: value * FLIP if name in ("imu_gyr", "imu_acc", "imu_mag") else value
        for name, value in fields.items()
    }


def test_every_sample_gets_an_attitude_a_sigma_and_a_gate(flight, run):
    fields, rows = flight
    out = run(fields, "--profile", "fixed_wing")
    assert {name: array.shape for name, array in out.items()} == {
        "quat": (len(rows), 4),
        "quat9": (len(rows), 4),
        "sigma_deg": (len(rows), 3),
        "gate": (len(rows),),
    }
    for name in ("quat", "quat9"):
        np.testing.assert_allclose(np.linalg.norm(out[name], axis=1), 1.0, atol=1e-12)
    assert np.isfinite(out["sigma_deg"]).all()
    assert (out["sigma_deg"] > 0.0).all()
    assert 0 < np.count_nonzero(out["gate"]) < len(rows)
    truth = euler_columns(rows["ned_from_body"])
    error = np.degrees(np.abs(euler_columns(out["quat"]) - truth)[:, :2])
    assert error[100:].max() < 12.0
    assert angle_deg(out["quat9"], rows["ned_from_body"])[100:].mean() < 12.0


def test_the_answer_is_the_pipelines_to_the_last_bit(flight, run, monkeypatch):
    fields, rows = flight
    samples = empty(SAMPLE_DTYPE, len(rows))
    samples["time_ns"] = samples["received_ns"] = np.arange(len(rows)) * 10_000_000
    samples["gyro_rad_s"], samples["accel_m_s2"] = fields["imu_gyr"], fields["imu_acc"]
    samples["source"] = ImuSource.HIGHRES_IMU
    expected = Estimator(config_file.load(profile="fixed_wing")).run(samples)
    # Several pieces, the last of them short.
    monkeypatch.setattr(arrays, "_CHUNK", 1000)
    out = run(only(fields), "--profile", "fixed_wing")
    assert out["quat"].tobytes() == expected["ned_from_body"].tobytes()
    assert out["gate"].tobytes() == expected["gate"].tobytes()
    assert "quat9" not in out


def test_both_frames_are_one_attitude(flight, run):
    fields, rows = flight
    frd, flu = run(fields), run(in_flu(fields), "--frame", "flu")
    np.testing.assert_allclose(flu["quat"], frd["quat"] * [1, 1, -1, -1], atol=1e-12)
    # East-north-up from forward-left-up, of the truth: forward is east by sin(yaw).
    yaw, pitch = euler_columns(rows["ned_from_body"])[:, [2, 1]].T
    w, x, y, z = frd["quat9"].T
    forward_ned = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
    w, x, y, z = flu["quat9"].T
    forward_enu = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
    np.testing.assert_allclose(forward_enu, forward_ned[[1, 0, 2]] * [[1], [1], [-1]], atol=1e-12)
    settled = slice(100, None)
    east = (np.sin(yaw) * np.cos(pitch))[settled]
    assert np.abs(forward_enu[0][settled] - east).mean() < 0.2
    assert flu["gate"].tobytes() == frd["gate"].tobytes()


def test_six_axes_start_with_heading_zero_whatever_the_field(flight, run):
    fields, _ = flight
    out = run(fields)
    assert abs(euler_columns(out["quat"])[0, 2]) < 1e-12
    assert out["quat"].tobytes() == run(only(fields, "airspeed", "vel_ned"))["quat"].tobytes()
    flu = run(in_flu(only(fields)), "--frame", "flu")
    assert abs(euler_columns(flu["quat"])[0, 2]) < 1e-12


def test_float32_is_taken_as_the_numbers_it_holds(flight, run):
    fields, _ = flight
    narrow = {name: np.asarray(value, np.float32) for name, value in fields.items()}
    widened = {name: value.astype(np.float64) for name, value in narrow.items()}
    left, right = run(narrow), run(widened)
    assert left["quat"].tobytes() == right["quat"].tobytes()
    assert left["quat9"].tobytes() == right["quat9"].tobytes()


def test_irregular_times_are_honoured(run):
    random = np.random.default_rng(3)
    t = 100.0 + np.cumsum(random.uniform(0.002, 0.03, 1500))
    count = len(t)
    fields = {
        "imu_gyr": np.tile([0.0, 0.0, 1.0], (count, 1)),
        "imu_acc": np.tile([0.0, 0.0, -9.80665], (count, 1)),
        "t": t,
    }
    yaw = np.unwrap(euler_columns(run(fields)["quat"])[:, 2])
    np.testing.assert_allclose(yaw, t - t[0], atol=0.02)
    # The times hold where a rate is given too.
    again = np.unwrap(euler_columns(run(fields | {"sampling_rate": 10.0})["quat"])[:, 2])
    np.testing.assert_array_equal(again, yaw)


@pytest.mark.parametrize("field", ["imu_gyr", "imu_acc", "imu_mag", "airspeed", "vel_ned", "t"])
def test_rows_without_numbers_survive(flight, run, field):
    fields, rows = flight
    fields = {name: np.array(value) for name, value in fields.items()}
    fields["t"] = np.arange(len(rows)) / 100.0
    for part in (slice(0, 7), slice(2000, 2020), slice(4000, 4001), slice(-3, None)):
        fields[field][part] = np.nan
    fields[field][3000:3003] = np.inf
    out = run(fields, "--profile", "fixed_wing")
    assert np.isfinite(out["quat"]).all()
    assert np.isfinite(out["quat9"]).all()
    truth = euler_columns(rows["ned_from_body"])
    error = np.degrees(np.abs(euler_columns(out["quat"]) - truth)[:, :2])
    assert error[200:].max() < 12.0


def test_each_profile_gives_an_answer_of_its_own(flight, run):
    fields, _ = flight
    profiles = ("fixed_wing", "multirotor", "hand_held", "ground_test")
    answers = {run(only(fields), "--profile", one)["quat"].tobytes() for one in profiles}
    answers.add(run(only(fields), "--set", "fusion.airframe=other")["quat"].tobytes())
    assert len(answers) == len(profiles) + 1


def test_without_a_profile_the_motion_says_it(flight, run, capsys):
    """The flight is recognised as fixed-wing; from half a minute at rest nothing is recognised."""
    fields, _ = flight
    own = run(only(fields), "--profile", "fixed_wing")["quat"]
    assert run(only(fields))["quat"].tobytes() == own.tobytes()
    assert "recognised as fixed_wing" in capsys.readouterr().err
    rest = {name: fields[name][:600] for name in ("imu_gyr", "imu_acc")} | {"sampling_rate": 20.0}
    run(rest)
    assert "recognised as multirotor" in capsys.readouterr().err
    run(in_flu(only(fields)), "--frame", "flu", "--set", "fusion.airframe=fixed_wing")
    assert "recognised as" not in capsys.readouterr().err


def test_airspeed_is_used(flight, run):
    fields, _ = flight
    with_it = run(only(fields, "airspeed"), "--profile", "fixed_wing")["quat"]
    assert with_it.tobytes() != run(only(fields), "--profile", "fixed_wing")["quat"].tobytes()


def test_a_magnetometer_switched_off_gives_no_second_attitude(flight, run):
    assert "quat9" not in run(flight[0], "--set", "fusion.magnetometer=false")


def test_broad_through_a_process_of_its_own(shared, tmp_path):
    source = shared / "broad" / "01_undisturbed_slow_rotation_A.npz"
    if not source.is_file():
        pytest.skip(f"no {source.name} in ../shared/data/broad")
    out = tmp_path / "out.npz"
    command = [sys.executable, "-m", "ahrs_service.app.cli", "estimate", "--frame", "flu"]
    words = ["--in", str(source), "--out", str(out), "--profile", "hand_held"]
    done = subprocess.run([*command, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with np.load(source) as given_, np.load(out) as found:
        reference = given_["opt_quat"].astype(np.float64)
        scored = given_["movement"] & np.isfinite(reference).all(axis=1)
        reference = reference[scored]
        reference /= np.linalg.norm(reference, axis=1, keepdims=True)
        six = multiply_columns(found["quat"][scored], inverse_columns(reference))
        total = angle_deg(found["quat9"][scored], reference)
    tilt = np.degrees(2.0 * np.arccos(np.minimum(np.hypot(six[:, 0], six[:, 3]), 1.0)))
    assert np.sqrt(np.mean(tilt**2)) < 4.0
    assert np.sqrt(np.mean(total**2)) < 9.0
