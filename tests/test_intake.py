"""The intake's choices: vehicle, IMU source, temperature, aiding."""

import numpy as np
import pytest

from ahrs_service import intake
from ahrs_service.records import READING_DTYPE, SAMPLE_DTYPE, Flag, ImuSource, Kind, empty
from ahrs_service.settings import IntakeSettings


def heartbeat(system=1, component=1, autopilot=3):
    row = empty(READING_DTYPE)
    row["kind"], row["system"], row["component"] = Kind.HEARTBEAT, system, component
    row["autopilot"] = autopilot
    return row


def imu(source, rate_hz, seconds, system=1, component=1, start_s=0.0, temperature=np.nan):
    rows = empty(READING_DTYPE, int(rate_hz * seconds))
    rows["kind"], rows["system"], rows["component"] = Kind.IMU, system, component
    rows["source"] = source
    rows["time_ns"] = ((start_s + np.arange(len(rows)) / rate_hz) * 1e9).astype(np.int64)
    rows["received_ns"] = rows["time_ns"] + 10**15
    rows["gyro_rad_s"] = 0.0
    rows["accel_m_s2"] = (0.0, 0.0, -9.8)
    rows["temperature_degc"] = temperature
    return rows


def merge(*streams):
    rows = np.concatenate(streams)
    return rows[np.argsort(rows["received_ns"], kind="stable")]


def select(readings, state=None, **settings):
    state = intake.new_state() if state is None else state
    samples = empty(SAMPLE_DTYPE, len(readings))
    positions = np.zeros(len(readings), np.int64)
    parameters = intake.parameters(IntakeSettings(**settings))
    count = intake.select(parameters, state, readings, samples, positions)
    np.testing.assert_array_equal(
        readings["time_ns"][positions[:count]], samples["time_ns"][:count]
    )
    return samples[:count], state


def test_nothing_passes_before_an_autopilot_is_heard():
    stream = imu(ImuSource.HIGHRES_IMU, 100, 1)
    ground_station = heartbeat(system=255, component=190, autopilot=8)
    samples, state = select(np.concatenate([ground_station, stream]))
    assert len(samples) == 0
    assert state["foreign"] == 101
    samples, state = select(np.concatenate([ground_station, heartbeat(), stream]))
    assert len(samples) == 100


def test_first_autopilot_is_kept_and_a_second_vehicle_ignored():
    ours, other = imu(ImuSource.RAW_IMU, 50, 2), imu(ImuSource.RAW_IMU, 50, 2, system=2)
    readings = np.concatenate([heartbeat(), heartbeat(system=2), merge(ours, other)])
    samples, state = select(readings)
    assert len(samples) == 100
    assert state["system"] == 1
    assert state["foreign"] == 101
    samples, state = select(readings, system=2)
    assert state["system"] == 2
    assert len(samples) == 100


def test_highres_takes_over_from_raw_at_like_rates_and_stays():
    raw, highres = imu(ImuSource.RAW_IMU, 100, 4), imu(ImuSource.HIGHRES_IMU, 100, 2, start_s=2.0)
    samples, state = select(np.concatenate([heartbeat(), merge(raw, highres)]))
    assert samples["source"][0] == ImuSource.RAW_IMU
    assert samples["source"][-1] == ImuSource.HIGHRES_IMU
    assert state["source_changes"] == 1
    assert np.count_nonzero(samples["flags"] & Flag.SOURCE_CHANGED) == 1
    # RAW_IMU and HIGHRES_IMU are the same sensor, so no new alignment is needed.
    assert not (samples["flags"] & Flag.IMU_CHANGED).any()


def test_another_sensor_is_reported_from_another_message():
    first, second = imu(ImuSource.SCALED_IMU, 50, 2), imu(ImuSource.SCALED_IMU2, 50, 6)
    samples, _ = select(np.concatenate([heartbeat(), merge(first, second)]))
    assert np.count_nonzero(samples["flags"] & Flag.IMU_CHANGED) == 1


def test_a_faster_source_beats_a_better_name():
    slow, fast = imu(ImuSource.HIGHRES_IMU, 2, 6), imu(ImuSource.RAW_IMU, 50, 6)
    samples, _ = select(np.concatenate([heartbeat(), merge(slow, fast)]))
    assert samples["source"][-1] == ImuSource.RAW_IMU


def test_the_second_source_steps_in_when_the_first_falls_silent():
    highres, scaled = imu(ImuSource.HIGHRES_IMU, 200, 3), imu(ImuSource.SCALED_IMU, 10, 10)
    samples, state = select(np.concatenate([heartbeat(), merge(highres, scaled)]))
    assert samples["source"][-1] == ImuSource.SCALED_IMU
    changed_s = samples["time_ns"][np.flatnonzero(samples["flags"] & Flag.SOURCE_CHANGED)] * 1e-9
    assert changed_s[-1] == pytest.approx(3.3, abs=0.11)
    assert state["source_changes"] == 1


def test_a_named_source_is_the_only_one():
    both = merge(imu(ImuSource.HIGHRES_IMU, 200, 2), imu(ImuSource.SCALED_IMU2, 10, 2))
    samples, _ = select(np.concatenate([heartbeat(), both]), imu_source="scaled_imu2")
    assert set(samples["source"]) == {ImuSource.SCALED_IMU2}
    with pytest.raises(ValueError, match=r"intake\.imu_source = 'gyro'.*HIGHRES_IMU"):
        intake.parameters(IntakeSettings(imu_source="gyro"))


def test_temperature_comes_from_the_imu_and_not_from_highres():
    highres = imu(ImuSource.HIGHRES_IMU, 100, 2, temperature=55.0)
    scaled = imu(ImuSource.SCALED_IMU, 5, 2, temperature=31.5)
    second = imu(ImuSource.SCALED_IMU2, 5, 2, temperature=40.0)
    readings = np.concatenate([heartbeat(), merge(highres, scaled, second)])
    samples, _ = select(readings)
    assert samples["temperature_degc"][-1] == 31.5
    samples, _ = select(np.concatenate([heartbeat(), highres]))
    assert np.isnan(samples["temperature_degc"]).all()
    samples, _ = select(np.concatenate([heartbeat(), highres]), temperature_source="highres_imu")
    assert samples["temperature_degc"][-1] == 55.0


def test_a_frozen_or_silent_temperature_is_flagged():
    highres = imu(ImuSource.HIGHRES_IMU, 50, 120)
    scaled = imu(ImuSource.SCALED_IMU, 5, 120)
    seconds = np.arange(len(scaled)) / 5
    scaled["temperature_degc"] = np.minimum(30.0 + 0.01 * np.floor(seconds), 30.4)
    samples, _ = select(np.concatenate([heartbeat(), merge(highres, scaled)]))
    stale_s = samples["time_ns"][(samples["flags"] & Flag.TEMPERATURE_STALE) > 0] * 1e-9
    assert stale_s.min() == pytest.approx(70.0, abs=0.3)

    samples, _ = select(np.concatenate([heartbeat(), merge(highres, scaled[:100])]))
    stale_s = samples["time_ns"][(samples["flags"] & Flag.TEMPERATURE_STALE) > 0] * 1e-9
    assert stale_s.min() == pytest.approx(19.8 + 10.0, abs=0.1)


def test_a_temperature_that_never_moved_is_not_called_frozen():
    highres = imu(ImuSource.HIGHRES_IMU, 50, 120)
    scaled = imu(ImuSource.SCALED_IMU, 5, 120, temperature=45.0)
    samples, _ = select(np.concatenate([heartbeat(), merge(highres, scaled)]))
    assert not samples["flags"].any()


def test_aiding_rides_on_the_next_sample_only():
    stream = imu(ImuSource.HIGHRES_IMU, 100, 1)
    aiding = empty(READING_DTYPE, 2)
    aiding["system"] = aiding["component"] = 1
    aiding["kind"] = (Kind.AIRSPEED, Kind.VELOCITY)
    aiding["airspeed_m_s"][0] = 17.5
    aiding["velocity_ned_m_s"][1] = (1.0, 2.0, 3.0)
    readings = np.concatenate([heartbeat(), stream[:50], aiding, stream[50:]])
    samples, _ = select(readings)
    assert np.flatnonzero(~np.isnan(samples["airspeed_m_s"])).tolist() == [50]
    np.testing.assert_array_equal(samples["velocity_ned_m_s"][50], (1.0, 2.0, 3.0))


def velocities(kind, north_m_s, rate_hz, seconds, start_s=0.0):
    rows = imu(ImuSource.NONE, rate_hz, seconds, start_s=start_s + 0.001)
    rows["kind"] = kind
    rows["velocity_ned_m_s"] = (north_m_s, 0.0, np.nan)
    return rows


def norths(samples):
    """Velocity north of the samples that have one, with their times [s]."""
    has = np.isfinite(samples["velocity_ned_m_s"][:, 0])
    return samples["time_ns"][has] * 1e-9, samples["velocity_ned_m_s"][has, 0]


def test_the_velocity_of_a_receiver_silences_that_of_the_filter_for_three_seconds():
    stream = imu(ImuSource.HIGHRES_IMU, 100, 12)
    gps = velocities(Kind.GPS, 1.0, 5, 4, start_s=2.0)
    local = velocities(Kind.VELOCITY, 2.0, 10, 12)
    both = velocities(Kind.GLOBAL_VELOCITY, 3.0, 10, 12)
    samples, _ = select(np.concatenate([heartbeat(), merge(stream, gps, local, both)]))
    seconds, north = norths(samples)
    assert set(north[seconds < 2.0]) == {2.0}
    assert set(north[(seconds > 2.05) & (seconds < 8.7)]) == {1.0}
    assert np.count_nonzero(north == 1.0) == 20
    assert set(north[seconds > 8.9]) == {2.0}
    samples, _ = select(np.concatenate([heartbeat(), merge(stream, both)]))
    assert set(norths(samples)[1]) == {3.0}


def test_a_velocity_that_is_none_silences_nothing():
    stream = imu(ImuSource.HIGHRES_IMU, 100, 3)
    nothing, local = velocities(Kind.GPS, np.nan, 5, 3), velocities(Kind.VELOCITY, 2.0, 10, 3)
    samples, _ = select(np.concatenate([heartbeat(), merge(stream, nothing, local)]))
    assert len(norths(samples)[1]) == 30


def test_a_clock_that_was_set_back_does_not_silence_for_longer():
    early, late = imu(ImuSource.HIGHRES_IMU, 100, 2), imu(ImuSource.HIGHRES_IMU, 100, 2, start_s=9)
    gps = velocities(Kind.GPS, 1.0, 5, 2, start_s=9.0)
    local = velocities(Kind.VELOCITY, 2.0, 10, 2)
    readings = np.concatenate([heartbeat(), merge(late, gps), merge(early, local)])
    samples, _ = select(readings)
    assert np.count_nonzero(norths(samples)[1] == 2.0) == 20


def trim(x_rad, y_rad):
    row = empty(READING_DTYPE)
    row["kind"], row["system"], row["component"] = Kind.TRIM, 1, 1
    row["trim_rad"] = (x_rad, y_rad)
    return row


def test_samples_tell_how_the_board_stands_from_the_trim_on():
    """Rate and force stay as measured; the magnetic field is rotated here."""
    stream = imu(ImuSource.HIGHRES_IMU, 100, 1)
    stream["gyro_rad_s"], stream["mag_ut"] = (0.1, 0.2, 0.3), (20.0, 0.0, 40.0)
    x, y = 0.03, -0.05
    parts = [heartbeat(), stream[:30], trim(x, np.nan), stream[30:60], trim(np.nan, y), stream[60:]]
    samples, _ = select(np.concatenate(parts))
    about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    for name in ("gyro_rad_s", "accel_m_s2"):
        assert samples[name].tobytes() == stream[name].tobytes()
    assert np.isnan(samples["vehicle_from_board"][:30]).all()
    assert samples["mag_ut"][:30].tobytes() == stream["mag_ut"][:30].tobytes()
    for part, dcm in ((slice(30, 60), about_x), (slice(60, 100), about_y @ about_x)):
        turns = np.broadcast_to(dcm, (part.stop - part.start, 3, 3))
        np.testing.assert_allclose(samples["vehicle_from_board"][part], turns, atol=1e-14)
        turned = stream["mag_ut"][part] @ dcm.T
        np.testing.assert_allclose(samples["mag_ut"][part], turned, atol=1e-14)
    assert not samples["flags"].any()


@pytest.mark.parametrize(("sender", "is_ours"), [((1, 1), True), ((2, 1), False), ((1, 9), False)])
def test_a_trim_before_the_first_heartbeat_holds_if_it_is_the_vehicles(sender, is_ours):
    stream, early = imu(ImuSource.HIGHRES_IMU, 100, 1), trim(0.1, 0.1)
    early["system"], early["component"] = sender
    samples, _ = select(np.concatenate([early, heartbeat(), stream]))
    assert np.isfinite(samples["vehicle_from_board"]).all() == is_ours
    # A later one of the vehicle's starts from none.
    samples, _ = select(np.concatenate([early, heartbeat(), trim(np.nan, 0.0), stream]))
    assert np.isfinite(samples["vehicle_from_board"]).all() == is_ours


def test_a_trim_that_is_no_number_or_of_another_vehicle_changes_nothing():
    stream, other = imu(ImuSource.HIGHRES_IMU, 100, 1), trim(0.1, 0.1)
    other["system"] = 2
    samples, _ = select(np.concatenate([heartbeat(), trim(np.nan, np.nan), other, stream]))
    assert np.isnan(samples["vehicle_from_board"]).all()


def test_one_reading_at_a_time_chooses_the_same():
    both = merge(
        imu(ImuSource.RAW_IMU, 100, 3),
        imu(ImuSource.HIGHRES_IMU, 90, 3, start_s=1.0),
        velocities(Kind.GPS, 1.0, 5, 1, start_s=0.5),
        velocities(Kind.VELOCITY, 2.0, 10, 3),
    )
    readings = np.concatenate([heartbeat(), both[:100], trim(0.1, -0.05), both[100:]])
    at_once, _ = select(readings)
    state, rows = intake.new_state(), []
    for n in range(len(readings)):
        samples, state = select(readings[n : n + 1], state)
        rows.append(samples.copy())
    assert np.concatenate(rows).tobytes() == at_once.tobytes()
