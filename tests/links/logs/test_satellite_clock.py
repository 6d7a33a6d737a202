"""An autopilot's clock against the GPS time in its log."""

import struct

import numpy as np
import pytest

from ahrs_service.links.logs.dataflash import read_dataflash
from ahrs_service.records import Kind
from tests.links.logs.dataflash_records import IMU_FORMAT, fmt, imu

FIX_FORMAT = fmt(0x91, "GPS", "QBIHfff", "TimeUS,Status,GMS,GWk,Spd,GCrs,VZ")


def log_with_fixes(rate, seconds, tmp_path, jitter_ms=0.0, first_ms=604_790_000):
    """A log of `seconds` on its own clock, each of which lasts `rate` GPS seconds."""
    rng = np.random.default_rng(5)
    records = []
    for n in range(50 * seconds):
        own_us = 1_000_000 + 20_000 * n
        records.append(imu(own_us))
        if n % 10 == 0:
            late_ms = abs(rng.normal(0.0, jitter_ms))
            of_week = (first_ms + round(rate * 20.0 * n - late_ms)) % 604_800_000
            values = (own_us, 3, of_week, 1800, 10.0, 0.0, 0.5)
            records.append(b"\xa3\x95\x91" + struct.pack("<QBIHfff", *values))
    path = tmp_path / "fixes.bin"
    path.write_bytes(IMU_FORMAT + FIX_FORMAT + b"".join(records))
    return read_dataflash(path)


def test_a_clock_that_the_satellites_contradict_is_not_believed(tmp_path):
    # over the end of a week, with fixes of a new log 100 ms late at random
    recording = log_with_fixes(1.083, 120, tmp_path, jitter_ms=100.0)
    assert recording.clock_rate == pytest.approx(1.083, abs=5e-4)
    samples = recording.readings[recording.readings["kind"] == Kind.IMU]
    assert np.median(np.diff(samples["time_ns"])) == pytest.approx(1.083 * 20e6, rel=5e-4)
    np.testing.assert_array_equal(samples["time_ns"], samples["received_ns"])
    assert any("1.083" in note and "GPS time" in note for note in recording.notes)


@pytest.mark.parametrize(("rate", "seconds"), [(1.0, 120), (1.0005, 120), (1.083, 20)])
def test_a_quartz_or_a_short_log_keeps_its_own_time(rate, seconds, tmp_path):
    recording = log_with_fixes(rate, seconds, tmp_path, jitter_ms=20.0)
    assert recording.clock_rate == 1.0
    samples = recording.readings[recording.readings["kind"] == Kind.IMU]
    assert set(np.diff(samples["time_ns"])) == {20_000_000}
    assert not any("GPS time" in note for note in recording.notes)


def test_a_constant_time_of_the_week_gives_no_rate(tmp_path):
    assert log_with_fixes(0.0, 120, tmp_path).clock_rate == 1.0


def test_a_real_board_whose_clock_lost_one_second_in_twelve(shared):
    recording = read_dataflash(shared / "flights" / "plane_erle_2014-12-05_10hz.bin")
    assert recording.clock_rate == pytest.approx(1.0833, abs=2e-4)
    other = read_dataflash(shared / "flights" / "copter_pixhawk_2014_dualimu_50hz.bin")
    assert other.clock_rate == 1.0
