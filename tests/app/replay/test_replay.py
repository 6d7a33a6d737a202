"""Replay: the same bytes as live, and the summary of a recording."""

import pickle

import numpy as np
import pytest

from ahrs_service.app.files import config_file
from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.links.logs.tlog import read_tlog
from tests.app.replay.conftest import frames_of, live_digest, write


def real_frames(path):
    tlog = read_tlog(path)
    return [
        (
            int(row["received_us"]) & ~3,
            tlog.data[row["offset"] : row["offset"] + row["length"]].tobytes(),
        )
        for row in tlog.frames
    ]


def test_replay_equals_live_bit_for_bit(flight):
    assert replay_log(flight).summary.digest == live_digest(frames_of())


@pytest.mark.parametrize(
    "name", ["bench_apm_2014_handtumble.tlog", "copter_cuav_2021-12-02_mission_1hz.tlog"]
)
def test_replay_equals_live_bit_for_bit_on_real_recordings(name, shared):
    path = shared / "flights" / name
    assert replay_log(path).summary.digest == live_digest(real_frames(path))


def test_the_summary_is_true(flight):
    summary = replay_log(flight).summary
    assert summary.sources == {"HIGHRES_IMU": 1200}
    assert summary.imu_rate_hz == pytest.approx(100.0, rel=1e-6)
    assert summary.duration_s == pytest.approx(11.99)
    assert summary.message_counts == {"HEARTBEAT": 24, "HIGHRES_IMU": 1200, "ATTITUDE": 240}
    assert summary.reference == "ATTITUDE"
    # A fixed wing that rolls in place and never flies.
    assert summary.comparison.roll.max < np.radians(4.0)
    assert summary.comparison.roll.max > 0.0
    assert summary.heading == "free"
    assert np.isnan(summary.temperature_min_degc)
    assert "25.0 to 25.0 degC" in " ".join(summary.warnings)
    assert summary.foreign == 12
    assert sum(summary.gate_time.values()) == pytest.approx(1.0)


def test_highres_temperature_is_taken_when_reported(flight):
    settings = config_file.load(None, ["intake.temperature_source=highres_imu"])
    summary = replay_log(flight, settings).summary
    assert summary.temperature_min_degc == summary.temperature_max_degc == 25.0
    assert summary.temperature_origin == "HIGHRES_IMU"
    assert summary.warnings == ()


def test_gaps_and_clock_jumps_are_counted(tmp_path):
    def rebooted(t_us):
        return t_us if t_us < 9_000_000 else t_us - 8_000_000

    frames = frames_of(16.0, clock_us=rebooted, skip=lambda t_s: 4.0 <= t_s < 6.0)
    summary = replay_log(write(tmp_path / "bad.tlog", frames)).summary
    assert summary.flags["gap"] == 1
    assert summary.flags["clock_jump"] == 1
    # the jump itself is no time that passed
    assert summary.duration_s == pytest.approx(15.98, abs=0.05)
    assert summary.comparison.compared > 150


def test_damage_is_counted_and_survived(flight):
    data = bytearray(flight.read_bytes())
    data[20_000:20_200] = bytes(200)
    flight.write_bytes(data[:-10])
    summary = replay_log(flight).summary
    assert summary.damaged
    assert summary.samples > 1190


def test_low_rate_is_warned_of_with_its_consequence(tmp_path):
    path = write(tmp_path / "slow.tlog", frames_of(30.0, 2.0))
    (warning,) = [one for one in replay_log(path).summary.warnings if "Hz" in one]
    assert "2.0 Hz" in warning
    assert "is meaningless in manoeuvres" in warning


def test_a_result_can_be_pickled(flight):
    result = replay_log(flight)
    again = pickle.loads(pickle.dumps(result))
    assert again.estimates.tobytes() == result.estimates.tobytes()
    assert again.summary.to_plain() == result.summary.to_plain()


def test_the_share_done_rises_to_one(flight):
    observed = []
    replay_log(flight, advance=lambda stage, share: observed.append((stage, share)))
    for stage in ("reading", "estimating"):
        shares = [share for name, share in observed if name == stage]
        assert shares == sorted(shares)
        assert shares[-1] == 1.0
