"""The thermal procedure on columns: its results, and its remarks on what it cannot find."""

import numpy as np
import pytest

from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.thermal.procedure import calibrate_thermal
from ahrs_service.calibration.verdict import Level
from ahrs_service.errors import CalibrationError
from ahrs_service.sensor.parameters import Calibration, TriadCalibration

RATE_HZ = 10.0
SECONDS = 600.0


def bench(low=-10.0, high=50.0, hysteresis=0.0, loop=True, scale=0.0, poses=1, drift=0.3, seed=1):
    """A unit that heats and cools: bias of a bent curve, scale, loop, held in poses in turn."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    corners = [low, high, low] if loop else [low, 0.5 * (low + high), high]
    t = np.interp(time, [0.0, 0.5 * SECONDS, SECONDS], corners)
    bend = np.tanh((t - 15.0) / 15.0)[:, None]
    sign = np.where(time < 0.5 * SECONDS, 0.5, -0.5)[:, None]
    faces = 9.80665 * np.concatenate([-np.eye(3), np.eye(3)])[[2, 5, 0, 3, 1, 4]]
    force = faces[(time // 5.0).astype(int) % poses]
    accel = force * (1.0 + scale * (t - 25.0)[:, None]) + drift * bend
    gyro = (0.01 + 0.02 * bend + hysteresis * sign) * np.ones(3)
    # A hand turns the unit from one pose to the next in a second.
    moving = (time % 5.0 < 1.0) & (poses > 1)
    shake = np.where(moving[:, None], rng.normal(0.0, 0.5, gyro.shape), 0.0)
    return ImuColumns(
        time,
        gyro + rng.normal(0.0, 1e-3, gyro.shape) + shake,
        accel + rng.normal(0.0, 5e-3, accel.shape) + shake,
        t,
    )


def texts(result, level):
    return " | ".join(one.text for one in result.verdict.findings if one.level is level)


def test_a_wide_loop_is_used():
    result = calibrate_thermal([bench()], Calibration.ideal())
    assert not result.verdict.is_refused
    gyro, accel = result.verdict.triads
    assert gyro.held_out_after < 0.1 * gyro.held_out_before
    assert accel.held_out_after < 0.1 * accel.held_out_before
    assert gyro.span_degc == pytest.approx((-10.0, 50.0), abs=0.2)
    assert sum(one.count for one in gyro.by_temperature) == gyro.count
    assert max(gyro.standard_errors.values()) < 2e-4
    assert "heating and cooling agree" in texts(result, Level.NOTE)
    assert "one pose does not tell" in texts(result, Level.NOTE)
    at = np.array([-10.0, 10.0, 25.0, 50.0])
    bend = np.tanh((at - 15.0) / 15.0)
    found = result.calibration.gyro.c.at(at)[:, 0]
    assert found == pytest.approx(0.02 * (bend - bend[2]), abs=3e-4)
    assert result.calibration.gyro.bias == pytest.approx([0.01 + 0.02 * bend[2]] * 3, abs=2e-4)


def test_hysteresis_is_measured_and_warned_of():
    result = calibrate_thermal([bench(hysteresis=8e-3)], Calibration.ideal())
    loop = result.verdict.triads[0].hysteresis
    # The fit may take some of the loop for a lag.
    assert max(loop) == pytest.approx(8e-3, rel=0.5)
    assert "heating and cooling differ" in texts(result, Level.WARNING)


def test_heating_alone_says_that_it_knows_no_hysteresis():
    result = calibrate_thermal([bench(loop=False)], Calibration.ideal())
    assert result.verdict.triads[0].hysteresis is None
    assert "hysteresis is not known" in texts(result, Level.NOTE)


def test_poses_all_around_tell_the_drift_of_scale():
    result = calibrate_thermal([bench(scale=1e-4, poses=6, drift=0.05)], Calibration.ideal())
    assert not result.verdict.is_refused
    at = np.array([-5.0, 45.0])
    scale = result.calibration.accel.matrix_at(at)[:, [0, 1, 2], [0, 1, 2]]
    assert scale == pytest.approx(1.0 + 1e-4 * (at[:, None] - 25.0) * np.ones(3), abs=2e-4)


def test_noise_without_drift_is_no_calibration():
    still = bench()
    rng = np.random.default_rng(2)
    flat = ImuColumns(
        still.time_s,
        rng.normal(0.0, 1e-3, still.gyro_rad_s.shape),
        rng.normal(0.0, 5e-3, still.accel_m_s2.shape) - [0.0, 0.0, 9.80665],
        still.temperature_degc,
    )
    result = calibrate_thermal([flat], Calibration.ideal())
    for triad in (result.calibration.gyro, result.calibration.accel):
        spread = np.ptp(triad.c.at(np.linspace(-10.0, 50.0, 13)), axis=0)
        assert (spread < 3e-3).all()
    if not result.verdict.is_refused:
        assert all(abs(one.gain) < 0.05 for one in result.verdict.triads)


def test_a_span_that_misses_the_rooms_temperature_is_warned_of():
    room = Calibration(accel=TriadCalibration(bias=(0.1, 0.0, 0.0)), serial="A7")
    result = calibrate_thermal([bench(low=30.0, high=55.0)], room)
    assert "the drift is counted from 30 degC, for 25 degC" in texts(result, Level.WARNING)
    assert result.calibration.room_degc == pytest.approx(30.0, abs=0.2)


def test_a_small_span_is_refused_in_plain_words():
    result = calibrate_thermal([bench(low=20.0, high=28.0)], Calibration.ideal())
    assert result.verdict.words.startswith("do not use: span 8 degC")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"temperature_degc": np.nan}, "temperature is missing"),
        ({"temperature_degc": 30.0}, "temperature is constant"),
    ],
)
def test_temperatures_that_say_nothing_are_refused(change, words):
    columns = bench()
    columns.temperature_degc[:] = change["temperature_degc"]
    with pytest.raises(CalibrationError, match=words):
        calibrate_thermal([columns], Calibration.ideal())


def test_a_handful_of_still_windows_is_refused():
    """As in a flight in which only the start is still."""
    short = bench().part(0, round(8.0 * RATE_HZ))
    short.temperature_degc[:] = np.linspace(20.0, 30.0, len(short.time_s))
    with pytest.raises(CalibrationError, match="windows are still, 10 are the least"):
        calibrate_thermal([short], Calibration.ideal())


def test_milli_g_for_metres_is_refused():
    columns = bench()
    columns.accel_m_s2[:] *= 1000.0 / 9.80665
    with pytest.raises(CalibrationError, match="this is in mG"):
        calibrate_thermal([columns], Calibration.ideal())
