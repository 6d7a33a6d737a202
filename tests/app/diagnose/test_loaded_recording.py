"""Columns for diagnosis and simulation from every format: one clock, SI units, what is missing."""

from pathlib import Path

import numpy as np
import pytest

from ahrs_service.app.diagnose.loaded_recording import load, vibration_of
from ahrs_service.app.diagnose.recorded_columns import with_velocity
from ahrs_service.errors import RecordingError
from ahrs_service.simulation.scenario import make_flight

FLIGHTS = Path(__file__).parents[4] / "shared" / "data" / "flights"


def real(name):
    path = FLIGHTS / name
    if not path.is_file():
        pytest.skip(f"{name} is not in ../shared/data/flights")
    return load(path)


def test_a_simulated_flight_comes_back_on_one_clock(simulated_tlog):
    loaded = load(simulated_tlog)
    columns, rows = loaded.columns, make_flight("flight", 60.0, seed=1).rows
    assert "reference: SIM_STATE" in loaded.notes
    since = columns.imu_time_s - columns.imu_time_s[0]
    np.testing.assert_allclose(since, rows["time_s"][::2], atol=2e-6)
    np.testing.assert_allclose(columns.gyro_rad_s, rows["gyro_rad_s"][::2], atol=1e-5)
    # Power-on was three seconds before.
    assert columns.imu_time_s[0] == pytest.approx(3.0)
    at = columns.imu_time_s[2000:-2000]
    index = np.round((at - 3.0) * 400.0).astype(int)
    for series, field, error in (
        (columns.temperature_degc, "imu_degc", 0.05),
        (columns.current_a, "current_a", 2.0),
        (columns.throttle, "throttle", 0.05),
        (columns.airspeed_m_s, "airspeed_m_s", 1.0),
    ):
        apart = series.at(at) - rows[field][index]
        assert np.abs(apart).mean() < error, field
    truth = rows["velocity_ned_m_s"][index]
    found = np.stack(
        [
            np.interp(at, columns.velocity_ned_m_s.time_s, c)
            for c in columns.velocity_ned_m_s.values.T
        ],
        axis=1,
    )
    np.testing.assert_allclose(found, truth, atol=0.05)


@pytest.mark.parametrize(
    ("name", "rate_hz", "has"),
    [
        ("copter_pixhawk_log0039_temp.bin", 25.0, ("temperature_degc", "current_a", "throttle")),
        ("copter_pixhawk_2014_dualimu_50hz.bin", 50.0, ("current_a", "throttle")),
        ("px4_fmuv6c_quad_222hz.ulg", 222.0, ("temperature_degc",)),
        ("px4_auavx2_quad_250hz.ulg", 250.0, ()),
        ("x8_fixedwing_aerobatics_50hz_reencoded.tlog", 50.0, ("airspeed_m_s",)),
        ("bench_cuav_2021-12-08_static_warmup_2hz.tlog", 2.0, ("temperature_degc",)),
    ],
)
def test_real_recordings_of_every_format_give_rising_columns(name, rate_hz, has):
    columns = real(name).columns
    steps = np.diff(columns.imu_time_s)
    assert (steps > 0.0).all()
    assert 1.0 / np.median(steps) == pytest.approx(rate_hz, rel=0.05)
    assert 0.0 <= columns.imu_time_s[0] < 2000.0
    for field in ("attitude", "velocity_ned_m_s", "temperature_degc", "vibration_m_s2"):
        series = getattr(columns, field)
        assert (np.diff(series.time_s) > 0.0).all(), field
    for field in has:
        assert len(getattr(columns, field)), field
    assert np.median(np.linalg.norm(columns.accel_m_s2, axis=1)) == pytest.approx(9.8, abs=1.0)
    current = columns.current_a.values
    assert not len(current) or 0.0 <= np.median(current) < 100.0


def test_where_no_velocity_is_reported_the_receivers_positions_serve():
    loaded = real("x8_fixedwing_aerobatics_50hz_reencoded.tlog")
    assert not len(loaded.columns.velocity_ned_m_s)
    velocity = with_velocity(loaded).velocity_ned_m_s
    speed = np.linalg.norm(velocity.values, axis=1)
    airspeed = loaded.columns.airspeed_m_s.at(velocity.time_s)
    flying = airspeed > 12.0
    assert np.median(speed[flying] / airspeed[flying]) == pytest.approx(1.0, abs=0.2)


def test_without_any_velocity_what_to_record_is_said():
    loaded = real("px4_auavx2_quad_250hz.ulg")
    with pytest.raises(ValueError, match="record LOCAL_POSITION_NED"):
        with_velocity(loaded)


def test_vibration_is_the_deviation_of_what_is_fast():
    time_s = np.arange(0.0, 60.0, 0.005)
    shake = np.sqrt(2.0) * np.sin(2.0 * np.pi * 40.0 * time_s)
    slow = 5.0 * np.sin(2.0 * np.pi * 0.1 * time_s)
    series = vibration_of(time_s, np.stack([shake, slow, shake + slow], axis=1))
    middle = series.values[2000:-2000]
    np.testing.assert_allclose(middle[:, 0], 1.0, atol=0.02)
    np.testing.assert_allclose(middle[:, 2], 1.0, atol=0.06)
    assert middle[:, 1].max() < 0.2
    assert len(vibration_of(time_s[::20], np.zeros((len(time_s[::20]), 3)))) == 0


def test_a_recording_without_attitude_is_refused(tmp_path):
    path = tmp_path / "none.ulg"
    with pytest.raises(RecordingError, match="no such file"):
        load(path)
