"""`calibrate allan` and `noise` on benches with known noise, and on flights."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.simulate.command import write_tlog
from ahrs_service.calibration.noise import gate_noise, steady_motion
from ahrs_service.errors import CalibrationError
from ahrs_service.records import ESTIMATE_DTYPE, Phase, empty
from ahrs_service.rotation import quaternion_columns
from ahrs_service.sensor.noise import TriadNoise
from ahrs_service.simulation.imu import Imu
from ahrs_service.simulation.scenario import make_flight

GYRO, ACCEL = 2e-4, 3e-3
RATES = {"HEARTBEAT": 1.0, "HIGHRES_IMU": 100.0, "SCALED_IMU": 2.0}


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Three minutes at rest of a sensor with known noise densities as its only error."""
    imu = Imu(gyro_noise=TriadNoise(density=GYRO), accel_noise=TriadNoise(density=ACCEL))
    flight = make_flight("rest", 180.0, rate_hz=200.0, imu=imu)
    rows = flight.rows.copy()
    # Every second loop iteration is sent; the density is that of the sent samples.
    rng = np.random.default_rng(3)
    rows["gyro_rad_s"] = rng.normal(0.0, GYRO * 10.0, rows["gyro_rad_s"].shape)
    rows["accel_m_s2"] = [0.0, 0.0, -9.80665]
    rows["accel_m_s2"] += rng.normal(0.0, ACCEL * 10.0, rows["accel_m_s2"].shape)
    path = tmp_path_factory.mktemp("noise") / "bench.tlog"
    write_tlog(path, replace(flight, rows=rows), RATES)
    return path


def run(capsys, *words):
    code = main(["calibrate", *map(str, words)])
    printed = capsys.readouterr()
    plain = json.loads(printed.out.splitlines()[-1]) if code == 0 and "--json" in words else None
    return code, plain, printed.out + printed.err


def test_allan_finds_the_noise_of_the_bench_and_draws_it(bench, capsys, tmp_path):
    picture = tmp_path / "allan.png"
    code, plain, said = run(capsys, "allan", bench, "--figure", picture, "--json")
    assert code == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "angle random walk" in said
    for triad, density in (("gyro", GYRO), ("accel", ACCEL)):
        for axis in plain[0][triad]:
            value, sigma = axis["random_walk"]
            assert abs(value - density) < 4.0 * sigma
            assert sigma < 0.02 * density
            walk, walk_sigma = axis["rate_random_walk"]
            assert walk <= 2.0 * walk_sigma or walk < 0.01 * density
    assert plain[0]["seconds"] > 170.0


def test_noise_gives_the_densities_and_a_budget(bench, capsys):
    code, plain, said = run(capsys, "noise", bench, "--json")
    assert code == 0
    assert plain[0]["density"]["gyro"] == pytest.approx([GYRO] * 3, rel=0.15)
    assert plain[0]["density"]["accel"] == pytest.approx([ACCEL] * 3, rel=0.15)
    assert "[gate_budget]" in said
    assert plain[0]["steady_s"] > 150.0
    budget = plain[0]["gate_budget"]
    assert 0.0 < budget["rate_sigma_rad_s"] < 10.0 * GYRO


def test_the_budget_is_one_that_settings_take(bench, capsys, tmp_path):
    from ahrs_service.app.files.config_file import load

    _, _, said = run(capsys, "noise", bench)
    section = said[said.index("[gate_budget]") :].splitlines()[:4]
    file = tmp_path / "settings.toml"
    file.write_text("\n".join(section) + "\n")
    assert load(file).gate_budget.norm_sigma_m_s2 > 0.0


def test_a_shaken_flight_has_a_larger_budget_than_the_bench(bench, simulated_tlog, capsys):
    quiet = run(capsys, "noise", bench, "--json")[1][0]["gate_budget"]
    words = ("noise", simulated_tlog, "--from", 15, "--to", 45, "--json")
    loud = run(capsys, *words)[1][0]["gate_budget"]
    assert all(loud[name] > quiet[name] for name in quiet)


def estimates(seconds=40.0, rate_hz=50.0, roll=0.0, seed=1):
    rows = empty(ESTIMATE_DTYPE, round(seconds * rate_hz))
    t = np.arange(len(rows)) / rate_hz
    rows["time_ns"] = np.rint(t * 1e9)
    rows["phase"] = Phase.RUNNING
    angles = np.zeros((len(rows), 3))
    angles[:, 0] = roll * np.sin(t)
    angles[:, 2] = 0.2 * t
    rows["ned_from_body"] = quaternion_columns(angles)
    rng = np.random.default_rng(seed)
    sigmas = {"gate_norm_m_s2": 0.05, "gate_rate_rad_s": 0.01}
    for name, sigma in (sigmas | {"gate_angular_acceleration_rad_s2": 0.3}).items():
        rows[name] = np.abs(rng.normal(0.0, sigma, len(rows)))
    return rows


def test_the_budget_is_the_standard_deviation_of_what_the_gate_compares():
    found = gate_noise(estimates())
    folded = math.sqrt(1.0 - 2.0 / math.pi)
    assert found.norm_sigma_m_s2 == pytest.approx(0.05 * folded, rel=0.05)
    assert found.rate_sigma_rad_s == pytest.approx(0.01 * folded, rel=0.05)
    assert found.angular_acceleration_sigma_rad_s2 == pytest.approx(0.3 * folded, rel=0.05)
    assert found.steady_s == pytest.approx(40.0, abs=0.1)


def test_a_steady_turn_is_steady_and_a_rolling_one_is_not():
    assert steady_motion(estimates()).all()
    assert not steady_motion(estimates(roll=0.3)).any()


def test_a_knock_is_left_out():
    rows = estimates()
    rows["gate_rate_rad_s"][1010:1020] = 2.0
    steady = steady_motion(rows)
    assert not steady[1010:1020].any()
    assert steady.mean() == pytest.approx(35.0 / 40.0, abs=0.01)


def test_too_little_steady_motion_is_reported():
    with pytest.raises(CalibrationError, match=r"say which part is steady with --from and --to"):
        gate_noise(estimates(roll=0.5))
    with pytest.raises(CalibrationError, match="holds no estimates"):
        gate_noise(empty(ESTIMATE_DTYPE, 0))


def test_a_unit_in_flight_has_no_allan_deviation(capsys, tmp_path):
    path = tmp_path / "flight.tlog"
    flight = make_flight("flight", 60.0, rate_hz=100.0)
    rows = flight.rows[2000:4000].copy()
    rows["time_s"] -= rows["time_s"][0]
    write_tlog(path, replace(flight, rows=rows), {"HEARTBEAT": 1.0, "HIGHRES_IMU": 50.0})
    code, _, said = run(capsys, "allan", path)
    assert code == 1
    assert "nowhere still: leave it alone on something solid" in said


def test_a_picture_that_cannot_be_written_is_reported(bench, capsys, tmp_path):
    code, _, said = run(capsys, "allan", bench, "--figure", tmp_path / "absent" / "a.png")
    assert code == 1
    assert "cannot be written" in said
