"""A new log format is one file and one line of the registry: here this file is it."""

import json

import numpy as np
import pytest

from ahrs_service.app.calibrate.capture import read_capture
from ahrs_service.app.diagnose.loaded_recording import load
from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.links.logs import recording_formats
from ahrs_service.links.logs.recorded_parameters import RecordedParameters
from ahrs_service.links.logs.recording import (
    OWN,
    AttitudeReference,
    Covariates,
    Log,
    Recording,
    TimedValues,
    own_readings,
)
from ahrs_service.records import ImuSource, Kind
from ahrs_service.rotation import quaternion_columns

RATE_RAD_S = 0.05


class ToyLog(Log):
    """Lines of JSON: time [s], gyro [rad/s], accel [m/s^2], roll [rad]."""

    def __init__(self, path):
        self.path = path
        self.rows = np.array([json.loads(line) for line in path.read_text().splitlines()])

    def recording(self):
        time_ns = np.rint(self.rows[:, 0] * 1e9).astype(np.int64)
        imu = own_readings(time_ns, Kind.IMU)
        imu["source"] = ImuSource.DATAFLASH
        imu["gyro_rad_s"], imu["accel_m_s2"] = self.rows[:, 1:4], self.rows[:, 4:7]
        beat = own_readings(time_ns[:1], Kind.HEARTBEAT)
        beat["autopilot"] = 3
        roll = self.rows[:, 7]
        q = quaternion_columns(np.stack([roll, 0 * roll, 0 * roll], axis=1))
        return Recording(
            self.path,
            "toy",
            np.concatenate([beat, imu]),
            self,
            (AttitudeReference("ROLL", time_ns, q),),
            message_counts={"lines": len(time_ns)},
            units={OWN: "toy-1"},
        )

    def parameters(self, vehicle):
        return RecordedParameters({"INS_ACCOFFS_X": 0.2}, 3)

    def covariates(self, imu):
        return Covariates(current_a=TimedValues(self.rows[:, 0], 0 * self.rows[:, 0] + 7.0))


def open_toy(path, progress):
    return ToyLog(path)


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """A slow roll at 50 Hz."""
    monkeypatch.setitem(recording_formats.READERS, ".toy", ("toy", f"{__name__}:open_toy"))
    time_s = np.arange(1500) / 50.0
    roll = RATE_RAD_S * time_s
    zero = np.zeros_like(time_s)
    accel = [zero, -9.80665 * np.sin(roll), -9.80665 * np.cos(roll)]
    rows = np.stack([time_s, zero + RATE_RAD_S, zero, zero, *accel, roll], axis=1)
    path = tmp_path / "roll.toy"
    path.write_text("\n".join(json.dumps(row) for row in rows.tolist()))
    return path


def test_every_command_reads_it(toy):
    result = replay_log(toy)
    assert result.summary.format == "toy"
    assert len(result.estimates) == 1500
    assert result.summary.comparison is not None
    loaded = load(toy)
    assert np.all(loaded.columns.current_a.values == 7.0)
    np.testing.assert_array_equal(loaded.columns.gyro_rad_s[:, 0], RATE_RAD_S)
    capture = read_capture(toy)
    assert (capture.unit, capture.source) == ("toy-1", "DATAFLASH")
    assert capture.compensated
    assert recording_formats.read_recorded_parameters(toy).values == {"INS_ACCOFFS_X": 0.2}


def test_a_format_need_not_have_parameters_or_covariates(toy, monkeypatch):
    monkeypatch.delattr(ToyLog, "parameters")
    monkeypatch.delattr(ToyLog, "covariates")
    assert recording_formats.open_log(toy).parameters(OWN).values == {}
    assert not len(load(toy).columns.current_a)
    assert read_capture(toy).compensated == ()
