"""Stamps that repeat, come late, jump or leave gaps."""

import math

import numpy as np
import pytest

from ahrs_service import pipeline
from ahrs_service.constants import STANDARD_GRAVITY_M_S2 as G
from ahrs_service.records import Flag, Phase
from ahrs_service.rotation import (
    euler_columns,
    inverse_columns,
    multiply_columns,
    quaternion_columns,
    rotate_columns,
)
from tests.streams import run, still


def received(samples, delay_s=0.01):
    """Give samples the host's times of receipt, as long as their clock is still whole."""
    samples["received_ns"] = samples["time_ns"] + 1_700_000_000_000_000_000 + int(delay_s * 1e9)
    return samples


def turning(count=1200, rate_hz=100.0):
    """A slow roll from the third second on, as seen under a clock that goes on."""
    t = np.arange(count) / rate_hz
    roll_rate = np.where(t > 3.0, 0.3 * np.sin(2.0 * (t - 3.0)), 0.0)
    samples = received(still(count, rate_hz=rate_hz))
    samples["gyro_rad_s"][:, 0] = roll_rate
    roll = np.concatenate([[0.0], np.cumsum((roll_rate[1:] + roll_rate[:-1]) / 2.0)]) / rate_hz
    q = quaternion_columns(np.stack([roll, 0.0 * roll, 0.0 * roll], axis=1))
    samples["accel_m_s2"] = rotate_columns(inverse_columns(q), [[0.0, 0.0, -G]] * count)
    return samples


def tilt_between(mine, theirs):
    """Largest angle between both attitudes [deg]."""
    q = multiply_columns(inverse_columns(mine["ned_from_body"]), theirs["ned_from_body"])
    return math.degrees(2.0 * np.arcsin(np.linalg.norm(q[:, 1:], axis=1)).max())


def test_gap_duplicate_late_and_jump_are_separated():
    samples = still(1200)
    samples["time_ns"][300:] += 2_000_000_000
    received(samples)
    samples["time_ns"][400] = samples["time_ns"][399]
    samples["time_ns"][500] = samples["time_ns"][497] + 1
    samples["time_ns"][800:] -= 5_500_000_000
    state = pipeline.new_state()
    estimates = run(samples, state)
    flags = estimates["flags"]
    found = {300: Flag.GAP, 400: Flag.DUPLICATE, 500: Flag.REORDERED, 800: Flag.CLOCK_JUMP}
    assert {int(n): Flag(int(flags[n])) for n in np.flatnonzero(flags)} == found
    assert (estimates["phase"][300:] == Phase.RUNNING).all()
    counts = {
        name: int(state[name][0]) for name in ("gaps", "duplicates", "reordered", "clock_jumps")
    }
    assert counts == {"gaps": 1, "duplicates": 1, "reordered": 1, "clock_jumps": 1}


@pytest.mark.parametrize("jump_s", [-7.5, -1.1, 61.0, 1e6])
@pytest.mark.parametrize("burst", [1, 20], ids=["singly", "in bursts"])
def test_a_clock_jump_with_samples_that_keep_coming_keeps_the_attitude(jump_s, burst):
    """Also where a link delivers in bursts: receipt times stay constant, then step."""
    samples = turning()
    samples["received_ns"] = samples["received_ns"][np.arange(1200) // burst * burst]
    whole = run(samples)
    samples["time_ns"][800:] += int(jump_s * 1e9)
    state = pipeline.new_state()
    jumped = run(samples, state)
    assert jumped["flags"][800] == Flag.CLOCK_JUMP
    assert not np.delete(jumped["flags"], 800).any()
    assert (state["clock_jumps"], state["gaps"]) == (1, 0)
    assert jumped["phase"].tobytes() == whole["phase"].tobytes()
    assert tilt_between(jumped, whole) < 1e-3
    np.testing.assert_allclose(jumped["attitude_sigma_rad"], whole["attitude_sigma_rad"], rtol=1e-3)


@pytest.mark.parametrize("jump_s", [-100.0, -30.0, 1e6])
@pytest.mark.parametrize("away_s", [0.6, 2.0, 4.9])
def test_a_clock_jump_with_samples_missed_is_a_gap_as_long_as_the_receipts_say(jump_s, away_s):
    samples = still(1200)
    samples["time_ns"] += 200_000_000_000
    samples["time_ns"][800:] += int(away_s * 1e9)
    gap = run(received(samples))
    samples["time_ns"][800:] += int(jump_s * 1e9)
    state = pipeline.new_state()
    jumped = run(samples, state)
    assert gap["flags"][800] == Flag.GAP
    assert jumped["flags"][800] == Flag.GAP | Flag.CLOCK_JUMP
    assert not np.delete(jumped["flags"], 800).any()
    assert (state["clock_jumps"], state["gaps"]) == (1, 1)
    assert (jumped["phase"][800:] == Phase.RUNNING).all()
    # To the last bit as the same gap under a clock that went on.
    for field in ("ned_from_body", "attitude_sigma_rad", "gyro_bias_rad_s", "gate"):
        assert jumped[field].tobytes() == gap[field].tobytes(), field
    assert jumped["attitude_sigma_rad"][800, 0] > jumped["attitude_sigma_rad"][799, 0]


@pytest.mark.parametrize(
    ("receipt_s", "jump_s"), [(5.1, -100.0), (5.1, 1e6), (59.0, 1e6), (-3.0, -100.0), (-3.0, 1e6)]
)
def test_a_clock_jump_is_aligned_anew_after_a_long_gap_or_one_of_unknown_length(receipt_s, jump_s):
    samples = received(still(1200, roll=0.3))
    samples["time_ns"] += 200_000_000_000
    samples["time_ns"][800:] += int(jump_s * 1e9)
    samples["received_ns"][800:] += int(receipt_s * 1e9)
    # Nothing that was known of the attitude is of use.
    samples["accel_m_s2"][800:] = still(1, roll=-0.5)["accel_m_s2"]
    estimates = run(samples)
    assert estimates["flags"][800] == Flag.GAP | Flag.CLOCK_JUMP | Flag.REALIGNED
    assert not np.delete(estimates["flags"], 800).any()
    assert estimates["phase"][799] == Phase.RUNNING
    assert estimates["phase"][800] == Phase.ALIGNING
    assert estimates["phase"][1000] == Phase.RUNNING
    roll = euler_columns(estimates["ned_from_body"])[:, 0]
    np.testing.assert_allclose(roll[800:], -0.5, atol=1e-6)


def test_a_log_with_receipts_equal_to_stamps_hides_the_length_of_a_jump_back():
    samples = still(1200)
    samples["time_ns"][800:] -= 5_500_000_000
    samples["received_ns"] = samples["time_ns"]
    estimates = run(samples)
    assert estimates["flags"][800] == Flag.GAP | Flag.CLOCK_JUMP | Flag.REALIGNED
    assert estimates["phase"][800] == Phase.ALIGNING


@pytest.mark.parametrize("rate_hz", [10.0, 50.0, 200.0])
def test_a_clock_set_back_by_little_is_found_and_loses_no_rotation(rate_hz):
    samples = turning(1200, rate_hz)
    whole = run(samples)
    samples["time_ns"][700:] -= 900_000_000
    jumped = run(samples)
    assert np.flatnonzero(jumped["flags"] & Flag.REORDERED).tolist() == list(range(700, 705))
    assert np.flatnonzero(jumped["flags"] & Flag.CLOCK_JUMP).tolist() == [705]
    assert not (jumped["flags"] & (Flag.GAP | Flag.REALIGNED)).any()
    assert (jumped["phase"][700:] == Phase.RUNNING).all()
    assert tilt_between(jumped[705:], whole[705:]) < 1.0


def test_a_gap_is_not_hidden_by_a_clock_set_back_by_little():
    """The first samples after the gap look late; the receipt times reveal its length."""
    samples = received(still(1200))
    samples["received_ns"][600:] += 8_000_000_000
    samples["time_ns"][600:] -= 500_000_000
    flags = run(samples)["flags"]
    assert np.flatnonzero(flags & Flag.REORDERED).tolist() == list(range(600, 605))
    assert flags[605] == Flag.GAP | Flag.CLOCK_JUMP | Flag.REALIGNED


def test_samples_of_one_hz_that_keep_coming_over_a_clock_jump_are_no_gap():
    samples = received(still(60, rate_hz=1.0))
    samples["time_ns"][40:] += 3_600_000_000_000
    flags = run(samples)["flags"]
    assert Flag(int(flags[40])) & ~Flag.LOW_RATE == Flag.CLOCK_JUMP
    assert not (flags & Flag.GAP).any()


def test_a_gap_widens_the_uncertainty_and_keeps_the_heading():
    samples = still(1500)
    samples["gyro_rad_s"][200:300] = (0.0, 0.0, 1.0)
    samples["time_ns"][1000:] += 2_000_000_000
    estimates = run(samples)
    tilt_sigma = estimates["attitude_sigma_rad"][:, 0]
    assert tilt_sigma[1000] > 2 * tilt_sigma[999]
    assert tilt_sigma[-1] < 2 * tilt_sigma[999]
    yaw = euler_columns(estimates["ned_from_body"])[:, 2]
    assert yaw[-1] == pytest.approx(1.0, abs=1e-3)


def test_slow_stream_is_flagged_low_rate():
    assert run(still(50, rate_hz=2.0))["flags"][-1] == Flag.LOW_RATE
    assert run(still(50, rate_hz=50.0))["flags"][-1] == 0
