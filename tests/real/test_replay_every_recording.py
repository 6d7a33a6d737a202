"""Every recording there is: replayed to finite unit quaternions, or refused as expected."""

import gzip
import json
import lzma
import warnings
from pathlib import Path

import numpy as np
import pytest

from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.errors import RecordingError
from ahrs_service.records import Phase
from ahrs_service.settings import FusionSettings, Settings

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
RECORDINGS = [
    path
    for folder in ("flights", "sitl")
    for path in sorted((DATA / folder).glob("*"))
    if path.suffix != ".md"
]
REFUSED = {
    "bench_iim42652_accel_cold_chamber.csv.gz": r"\.gz is not a supported log format",
    "copter_quad106_50hz.zip": r"\.zip is not a supported log format",
    "copter_quadoptflow_48hz.zip": r"\.zip is not a supported log format",
    "px4_fixedwing_swiss2_148hz.zip": r"\.zip is not a supported log format",
    "solar_dawn3_fixedwing_px4_csv.zip": r"\.zip is not a supported log format",
    "umn_thor75_fixedwing_50hz.mat": r"\.mat is not a supported log format",
    "x8_fixedwing_aerobatics_testlog2.mat": r"\.mat is not a supported log format",
}
# 1-sigma of (roll, pitch) [deg] that the estimator must stay below, over the whole recording on
# the ground, in steady flight else, where the IMU is fast enough to judge it: a wrong sign, unit
# or clock in a reader gives several times it.
GROUND_LIMIT_DEG = {
    "bench_cuavv5_2021-12-08.bin": 0.5,
    "bench_matekh743_2021_isbd2khz_warmup.bin": 0.5,
    "px4_auavx2_quad_250hz.ulg": 0.5,
    "px4_auavx2_quad_250hz_reencoded.tlog": 0.5,
}
STEADY_LIMIT_DEG = {
    "copter_erle_2014-09-07_50hz.bin": 4.0,
    "copter_pixhawk_log0036_crash_temp.bin": 1.0,
    "copter_pixhawk_log0039_temp.bin": 1.0,
    "copter_log0036_crash_dualimu_25hz_temp_reencoded.tlog": 1.0,
    "copter_quad106_50hz_reencoded.tlog": 3.0,
    "px4_fmuv6c_quad_222hz.ulg": 2.0,
    "px4_fixedwing_swiss2_148hz_reencoded.tlog": 3.0,
    "x8_fixedwing_aerobatics_50hz_reencoded.tlog": 3.0,
}
JUMPS = {"copter_swarm_2021-12-02_three_sessions_time_jumps.tlog": 2}


@pytest.mark.skipif(not RECORDINGS, reason="no recordings in ../shared/data/flights and sitl")
@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.name)
def test_recording(path, tmp_path):
    if path.suffix == ".xz":
        packed, path = path, tmp_path / path.stem
        path.write_bytes(lzma.decompress(packed.read_bytes()))
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        if path.name in REFUSED:
            with pytest.raises(RecordingError, match=REFUSED[path.name]):
                replay_log(path)
            return
        result = replay_log(path)
    estimates, summary = result.estimates, result.summary
    assert len(estimates) == sum(summary.sources.values()) > 0
    norm = np.linalg.norm(estimates["ned_from_body"], axis=1)
    np.testing.assert_allclose(norm, 1.0, atol=1e-9)
    for name in ("rate_rad_s", "gyro_bias_rad_s", "attitude_sigma_rad"):
        assert np.isfinite(estimates[name]).all(), name
    assert (estimates["phase"] == Phase.RUNNING).any()
    assert summary.comparison is not None
    assert summary.comparison.compared > 20
    json.dumps(summary.to_plain(), allow_nan=False)
    assert bool([one for one in summary.warnings if "below 20 Hz" in one]) == (
        summary.imu_rate_hz < 20.0
    )
    if path.name in GROUND_LIMIT_DEG:
        limit = np.radians(GROUND_LIMIT_DEG[path.name])
        assert summary.comparison.roll.sigma < limit
        assert summary.comparison.pitch.sigma < limit
    if path.name in STEADY_LIMIT_DEG:
        limit = np.radians(STEADY_LIMIT_DEG[path.name])
        assert summary.comparison.steady_roll.sigma < limit
        assert summary.comparison.steady_pitch.sigma < limit
    if path.name in JUMPS:
        assert summary.flags["clock_jump"] == JUMPS[path.name]


def test_one_flight_in_two_formats_gives_one_attitude():
    pairs = [
        ("px4_auavx2_quad_250hz.ulg", "px4_auavx2_quad_250hz_reencoded.tlog"),
        (
            "copter_pixhawk_log0036_crash_temp.bin",
            "copter_log0036_crash_dualimu_25hz_temp_reencoded.tlog",
        ),
    ]
    for original, encoded in pairs:
        paths = [DATA / "flights" / name for name in (original, encoded)]
        if not all(path.is_file() for path in paths):
            pytest.skip(f"{original} and {encoded} are not in ../shared/data/flights")
        # The .tlog was written with neither the trim nor the vertical velocity of the original.
        settings = Settings(fusion=FusionSettings(use_ground_velocity=False))
        one, two = (replay_log(path, settings).summary.comparison for path in paths)
        assert one.roll.sigma == pytest.approx(two.roll.sigma, abs=np.radians(0.1))
        assert one.pitch.sigma == pytest.approx(two.pitch.sigma, abs=np.radians(0.1))


def test_a_packed_log_is_refused_though_its_content_would_do(tmp_path):
    source = DATA / "flights" / "bench_apm_2014_handtumble.tlog"
    if not source.is_file():
        pytest.skip(f"{source.name} is not in ../shared/data/flights")
    packed = tmp_path / "flight.tlog.gz"
    packed.write_bytes(gzip.compress(source.read_bytes()))
    with pytest.raises(RecordingError, match="give the original log"):
        replay_log(packed)
