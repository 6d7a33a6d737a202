"""Columns of messages as the bytes of a log, read back by pymavlink."""

import numpy as np
import pytest
from pymavlink import mavutil

from ahrs_service.errors import RecordingError
from ahrs_service.links.mavlink.frame_columns import MessageColumns, tlog_bytes


def test_pymavlink_reads_every_field(tmp_path):
    count = 300
    stamps = 1_750_000_000_000_000 + 10_000 * np.arange(count)
    rng = np.random.default_rng(1)
    rates = rng.standard_normal(count).astype(np.float32)
    volts = np.full((count, 10), 65535)
    volts[:, 0] = np.arange(count)
    path = tmp_path / "a.tlog"
    path.write_bytes(
        tlog_bytes(
            [
                MessageColumns("HIGHRES_IMU", stamps, {"time_usec": stamps, "zgyro": rates}),
                MessageColumns(
                    "BATTERY_STATUS", stamps + 1, {"voltages": volts, "current_battery": -5}
                ),
            ],
            system=3,
            component=7,
        )
    )
    log = mavutil.mavlogfile(str(path))
    for n in range(count):
        imu, battery = log.recv_msg(), log.recv_msg()
        assert imu.get_type() == "HIGHRES_IMU"
        assert imu.time_usec == stamps[n]
        assert imu.zgyro == rates[n]
        assert imu.xacc == 0.0
        assert (imu.get_srcSystem(), imu.get_srcComponent()) == (3, 7)
        assert imu.get_seq() == 2 * n % 256
        assert battery.voltages[:2] == [n, 65535]
        assert battery.current_battery == -5
        assert imu._timestamp == pytest.approx(stamps[n] * 1e-6, abs=1e-6)
    assert log.recv_msg() is None


def test_an_unknown_field_and_message_are_named():
    stamps = np.zeros(1, np.int64)
    with pytest.raises(RecordingError, match=r"HEARTBEAT: no field speed"):
        tlog_bytes([MessageColumns("HEARTBEAT", stamps, {"speed": 1})], 1, 1)
    with pytest.raises(RecordingError, match=r"SPEED: the dialect has no such message"):
        tlog_bytes([MessageColumns("SPEED", stamps, {})], 1, 1)
