"""`calibrate thermal` on recordings: the unit's file, JSON, refusals in plain words."""

import json
from dataclasses import replace

import numpy as np
import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.files import calibration_file
from ahrs_service.app.simulate.command import write_tlog
from ahrs_service.calibration.thermal.rows import element_degc
from ahrs_service.sensor.compensation import compensate_columns
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.forward import forward_columns
from ahrs_service.sensor.parameters import Calibration, TriadCalibration, coefficients
from ahrs_service.simulation.scenario import make_flight

RATES = {"HEARTBEAT": 1.0, "HIGHRES_IMU": 5.0, "SCALED_IMU": 2.0}
RATE_HZ = 10.0
SECONDS = 600.0
LAG_S = 10.0
NODES = np.linspace(-20.0, 60.0, 41)


def drift(*sizes):
    """A drift that bends, zero at 25 degC."""
    shape = np.tanh((NODES - 15.0) / 15.0) - np.tanh(10.0 / 15.0)
    return Curve.linear(NODES, shape[:, None] * np.array(sizes))


TRUTH = Calibration(
    gyro=TriadCalibration(bias=(0.01, -0.02, 0.005), c=drift(0.03, -0.02, 0.01)),
    accel=TriadCalibration(bias=(0.1, 0.2, -0.1), c=drift(0.3, 0.2, -0.4)),
)


def warm_up(low, high, seed=1, lag_s=LAG_S):
    """A flight at rest whose sensors heat and cool; the elements follow the thermometer."""
    flight = make_flight("rest", SECONDS, seed, RATE_HZ)
    rows, rng = flight.rows.copy(), np.random.default_rng(seed)
    time = rows["time_s"]
    shown = np.interp(time, [0.0, 0.5 * SECONDS, SECONDS], [low, high, low])
    element = element_degc(time, shown, lag_s)
    force = np.tile([1.0, -0.5, -9.7], (len(rows), 1))
    gyro, accel = forward_columns(coefficients(TRUTH), np.zeros_like(force), force, element)
    rows["gyro_rad_s"] = gyro + rng.normal(0.0, 1e-3, gyro.shape)
    rows["accel_m_s2"] = accel + rng.normal(0.0, 0.01, accel.shape)
    rows["imu_degc"] = shown
    return replace(flight, rows=rows)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("thermal")
    for name, low, high in (("wide", -10.0, 50.0), ("narrow", 20.0, 28.0), ("flat", 30.0, 30.2)):
        write_tlog(folder / f"{name}.tlog", warm_up(low, high), RATES)
    return folder


@pytest.fixture
def thermal(capsys):
    """Run the command line; exit code, JSON or None, and the printed text."""

    def run(*words):
        code = main(["calibrate", "thermal", *map(str, words)])
        printed = capsys.readouterr()
        lines = [line for line in printed.out.splitlines() if line.startswith("{")]
        return (
            code,
            json.loads(lines[-1]) if lines else None,
            " ".join((printed.out + printed.err).split()),
        )

    return run


def test_the_units_file_takes_the_drift_off_another_run(recordings, thermal, tmp_path):
    out = tmp_path / "A7.toml"
    code, plain, said = thermal(recordings / "wide.tlog", "--out", out, "--serial", "A7", "--json")
    assert code == 0
    assert plain["usable"]
    assert plain["words"].startswith("use")
    assert "calibrated from -10 to 50 degC" in said
    calibration = calibration_file.load(out)
    assert (calibration.serial, calibration.provenance.procedures) == ("A7", ("thermal",))
    assert calibration.room_degc == 25.0
    assert calibration.gyro.span_degc == pytest.approx((-10.0, 50.0), abs=2.5)
    for triad in (calibration.gyro, calibration.accel):
        assert triad.model == "smooth"
        assert triad.thermal_lag_s == pytest.approx(LAG_S, abs=2.0)
        assert triad.uncertainty.bias_sigma.columns == 3
    other = warm_up(-10.0, 50.0, seed=7).rows
    gyro, accel = compensate_columns(
        coefficients(calibration),
        other["gyro_rad_s"],
        other["accel_m_s2"],
        other["imu_degc"].astype(float),
        other["time_s"],
    )
    whole = len(other) // 100 * 100
    for found, limit in ((gyro, 5e-4), (accel, 5e-3)):
        means = found[:whole].reshape(-1, 100, 3).mean(axis=1)
        assert np.abs(means - means.mean(axis=0)).max() < limit
    assert np.abs(gyro.mean(axis=0)).max() < 1e-4


def test_eight_degrees_are_refused_in_plain_words_and_nothing_is_written(
    recordings, thermal, tmp_path
):
    out = tmp_path / "A7.toml"
    code, plain, said = thermal(recordings / "narrow.tlog", "--out", out, "--json")
    assert code == 1
    assert plain["words"].startswith("do not use: span 8 degC, from 20 to 28")
    assert "was not written" in said
    assert not out.exists()


def test_a_constant_temperature_is_refused(recordings, thermal):
    code, _, said = thermal(recordings / "flat.tlog")
    assert code == 1
    assert "the temperature is constant" in said


def test_what_the_room_reported_stays(recordings, thermal, tmp_path):
    out = tmp_path / "A7.toml"
    matrix = ((1.01, 0.0, 0.002), (0.0, 0.99, 0.0), (0.0, 0.001, 1.0))
    room = Calibration(
        gyro=TriadCalibration(matrix=matrix),
        accel=TriadCalibration(matrix=matrix, bias=(0.1, 0.2, -0.1)),
        serial="A7",
    )
    calibration_file.save(out, room)
    assert thermal(recordings / "wide.tlog", "--out", out)[0] == 0
    found = calibration_file.load(out)
    assert found.gyro.matrix == matrix
    assert (found.accel.matrix, found.accel.bias) == (matrix, room.accel.bias)
    assert found.gyro.bias == pytest.approx(TRUTH.gyro.bias, abs=2e-4)
    code, _, said = thermal(recordings / "wide.tlog", "--out", out, "--serial", "B8")
    assert code == 2
    assert "of different units, A7 and B8" in said


def test_sessions_show_how_the_bias_repeats(recordings, thermal, tmp_path):
    out = tmp_path / "A7.toml"
    paths = []
    for n, offset in enumerate((0.0, 2e-3, 4e-3)):
        flight = warm_up(-10.0, 50.0, seed=n)
        flight.rows["gyro_rad_s"] += offset
        paths.append(tmp_path / f"{n}.tlog")
        write_tlog(paths[-1], flight, RATES)
    assert thermal(*paths, "--out", out)[0] == 0
    turn_on = calibration_file.load(out).gyro.uncertainty.bias_turn_on
    assert turn_on == pytest.approx([2e-3] * 3, rel=0.1)


def test_a_real_warm_up_of_five_degrees_is_refused(thermal, shared):
    path = shared / "flights" / "bench_cuav_2021-11-25_static_warmup_1hz.tlog"
    code, plain, _ = thermal(path, "--json")
    assert code == 1
    assert plain["words"].startswith("do not use: span 5 degC, from 37 to 42")
    gyro = plain["verdict"]["triads"][0]
    assert gyro["held_out_after"] < gyro["held_out_before"]


def test_a_real_log_of_three_power_ons_gives_a_calibration(thermal, shared, tmp_path):
    """Its clock jumps back twice; one power-on is a flight, the others warm up by 10 degC."""
    path = shared / "flights" / "copter_swarm_2021-12-02_three_sessions_time_jumps.tlog"
    out = tmp_path / "swarm.toml"
    code, plain, said = thermal(path, "--imu", "RAW_IMU", "--out", out, "--json")
    assert code == 0
    assert "a power-on is left out" in said
    assert [one["name"] for one in plain["recordings"]] == [path.name] * 3
    for triad in plain["verdict"]["triads"]:
        assert triad["held_out_after"] < 0.5 * triad["held_out_before"]
    calibration = calibration_file.load(out)
    assert calibration.gyro.span_degc == pytest.approx((32.6, 43.0), abs=0.1)
    assert len(calibration.provenance.recordings) == 1


def test_a_calibration_is_of_one_board(thermal, shared):
    logs = (
        "bench_cuav_2021-12-08_static_warmup_2hz.tlog",
        "rov_bluerov2_2023-05-04_warmup_att20hz.tlog",
    )
    code, _, said = thermal(*(shared / "flights" / log for log in logs))
    assert code == 2
    assert "of different boards" in said
