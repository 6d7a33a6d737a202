"""The pipeline on streams whose right answer is known."""

import hashlib
import math
import os
import subprocess
import sys

import numpy as np
import pytest

from ahrs_service import pipeline
from ahrs_service.constants import STANDARD_GRAVITY_M_S2 as G
from ahrs_service.fusion import states
from ahrs_service.records import ESTIMATE_DTYPE, SAMPLE_DTYPE, Flag, Gate, Phase, empty
from ahrs_service.rotation import (
    euler_columns,
    inverse_columns,
    multiply_columns,
    quaternion_columns,
    rotate_columns,
)
from ahrs_service.sensor.parameters import Calibration, coefficients
from ahrs_service.settings import Settings

PARAMETERS = pipeline.parameters(Settings())
IDEAL = coefficients(Calibration.ideal())


def still(count, roll=0.0, pitch=0.0, rate_hz=100.0):
    """Samples of a sensor at rest at the given tilt [rad]."""
    samples = empty(SAMPLE_DTYPE, count)
    samples["time_ns"] = np.round(np.arange(count) * 1e9 / rate_hz).astype(np.int64) + 10**9
    samples["gyro_rad_s"] = 0.0
    ned_from_body = quaternion_columns(np.array([[roll, pitch, 0.0]]))
    samples["accel_m_s2"] = rotate_columns(inverse_columns(ned_from_body), [[0.0, 0.0, -G]])
    samples["flags"] = 0
    samples["source"] = 1
    return samples


def run(samples, state=None, parameters=PARAMETERS):
    estimates = empty(ESTIMATE_DTYPE, len(samples))
    state = pipeline.new_state() if state is None else state
    pipeline.batch(parameters, IDEAL, state, samples, estimates)
    return estimates


def moving(count, seed=3):
    """A rough ride: every branch of the estimator is visited."""
    rng = np.random.default_rng(seed)
    samples = still(count)
    samples["gyro_rad_s"] = rng.normal(0.0, 0.3, (count, 3)).cumsum(axis=0) * 0.05
    samples["accel_m_s2"] += rng.normal(0.0, 1.0, (count, 3))
    samples["time_ns"] += rng.integers(0, 3_000_000, count)
    samples["time_ns"][count // 2 :] += 700_000_000
    samples["gyro_rad_s"][count // 3] = np.nan
    samples["accel_m_s2"][count // 4] = np.nan
    samples["time_ns"][count // 5] = samples["time_ns"][count // 5 - 1]
    samples["mag_ut"][::10] = (22.0, 3.0, 42.0)
    return samples


@pytest.mark.parametrize("roll", [-2.8, -0.7, 0.0, 0.4, 3.1])
@pytest.mark.parametrize("pitch", [-1.3, 0.0, 0.6])
def test_rest_at_any_tilt_is_found(roll, pitch):
    estimate = run(still(300, roll, pitch))[-1:]
    found = euler_columns(estimate["ned_from_body"])[0]
    np.testing.assert_allclose(found[:2], [roll, pitch], atol=1e-6)
    assert estimate["phase"] == Phase.RUNNING
    assert estimate["gate"] == Gate.OPEN


def test_gyro_bias_is_taken_at_rest():
    samples = still(3000)
    bias = np.array([0.02, -0.01, 0.03])
    samples["gyro_rad_s"] = bias
    estimate = run(samples)[-1]
    np.testing.assert_allclose(estimate["gyro_bias_rad_s"], bias, atol=5e-4)
    np.testing.assert_allclose(estimate["rate_rad_s"], 0.0, atol=5e-4)


def test_bias_that_appears_in_flight_is_learnt_about_the_horizontal_axes():
    samples = still(30_000)
    samples["gyro_rad_s"][3000:] = (0.01, -0.02, 0.0)
    estimate = run(samples)[-1]
    np.testing.assert_allclose(estimate["gyro_bias_rad_s"][:2], [0.01, -0.02], atol=2e-3)


def test_a_turn_is_integrated():
    samples = still(500)
    samples["gyro_rad_s"][200:300] = (0.0, 0.0, math.pi / 2)
    yaw = euler_columns(run(samples)["ned_from_body"])[:, 2]
    assert math.degrees(yaw[-1]) == pytest.approx(90.0, abs=0.01)


def test_batch_equals_single_steps():
    samples = moving(1500)
    at_once = run(samples)
    state, one_by_one = pipeline.new_state(), empty(ESTIMATE_DTYPE, len(samples))
    for n in range(len(samples)):
        pipeline.step(PARAMETERS, IDEAL, state, samples[n : n + 1], one_by_one[n : n + 1])
    assert at_once.tobytes() == one_by_one.tobytes()


def test_state_saved_in_flight_goes_on_as_if_never_stopped():
    samples = moving(1500)
    whole = run(samples)
    state = pipeline.new_state()
    first = run(samples[:700], state)
    restored = np.frombuffer(state.tobytes(), pipeline.STATE_DTYPE).copy()
    second = run(samples[700:], restored)
    assert whole.tobytes() == first.tobytes() + second.tobytes()


SCRIPT = """
import importlib.util, hashlib, sys
spec = importlib.util.spec_from_file_location("stream", sys.argv[1])
stream = importlib.util.module_from_spec(spec)
spec.loader.exec_module(stream)
print(hashlib.sha256(stream.run(stream.moving(400)).tobytes()).hexdigest())
"""


def test_undecorated_code_gives_the_same_bytes():
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    plain = subprocess.run(
        [sys.executable, "-c", SCRIPT, __file__],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert plain.stdout.strip() == hashlib.sha256(run(moving(400)).tobytes()).hexdigest()


def test_covariance_stays_symmetric_and_positive():
    state = pipeline.new_state()
    run(moving(20_000), state)
    covariance = state["covariance"][0]
    np.testing.assert_array_equal(covariance, covariance.T)
    used = covariance[: states.UNAIDED, : states.UNAIDED]
    known = used[np.ix_(np.diag(used) > 0.0, np.diag(used) > 0.0)]
    assert len(known) >= 9
    assert np.linalg.eigvalsh(known).min() > 0.0
    assert np.linalg.norm(state["ned_from_body"][0]) == pytest.approx(1.0, abs=1e-12)


def test_each_motion_closes_the_gate_for_its_own_reason():
    pushed = still(400)
    pushed["accel_m_s2"][300:, 2] -= 3.0
    assert run(pushed)["gate"][-1] & Gate.NORM

    turning = still(400)
    turning["gyro_rad_s"][300:, 2] = 1.0
    assert run(turning)["gate"][-1] == Gate.RATE

    started = still(410)
    started["gyro_rad_s"][390:, 2] = 1.0
    assert np.any(run(started)["gate"][390:] & Gate.ANGULAR_ACCELERATION)

    clipped = still(400)
    clipped["accel_m_s2"][399, 0] = 170.0
    assert run(clipped)["gate"][-1] & Gate.SATURATION

    missing = still(400)
    missing["accel_m_s2"][399] = np.nan
    last = run(missing)[-1]
    assert last["gate"] & Gate.STALE
    assert last["flags"] & Flag.ACCEL_MISSING


def test_a_tilt_the_filter_cannot_believe_is_rejected_by_innovation():
    samples = still(4000)
    samples["accel_m_s2"][3000:] = still(1, roll=0.5)["accel_m_s2"]
    assert run(samples)["gate"][3100] & Gate.INNOVATION


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


def test_gap_duplicate_late_and_jump_are_told_apart():
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
    """Also where a link delivers in bursts, so that receipts stand still and then step."""
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


def test_a_log_whose_receipts_are_its_stamps_does_not_tell_how_long_a_jump_back_was():
    samples = still(1200)
    samples["time_ns"][800:] -= 5_500_000_000
    samples["received_ns"] = samples["time_ns"]
    estimates = run(samples)
    assert estimates["flags"][800] == Flag.GAP | Flag.CLOCK_JUMP | Flag.REALIGNED
    assert estimates["phase"][800] == Phase.ALIGNING


@pytest.mark.parametrize("rate_hz", [10.0, 50.0, 200.0])
def test_a_clock_set_back_by_little_is_found_and_loses_no_turn(rate_hz):
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
    """The first samples after the gap look late; the receipts tell that it was long."""
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


def test_one_gyro_spike_is_held_back_and_a_real_fast_turn_is_not():
    spiked = still(400)
    spiked["gyro_rad_s"][300, 0] = 25.0
    estimates = run(spiked)
    assert estimates["flags"][300] & Flag.SPIKE
    roll = euler_columns(estimates["ned_from_body"])[:, 0]
    assert abs(roll[-1]) < 1e-6

    fast = still(400)
    fast["gyro_rad_s"][300:, 2] = 15.0
    flags = run(fast)["flags"]
    assert np.count_nonzero(flags & Flag.SPIKE) == 1


def test_not_a_number_moves_nothing():
    samples = still(400)
    samples["gyro_rad_s"][300] = np.nan
    estimates = run(samples)
    assert estimates["flags"][300] & Flag.NOT_FINITE
    assert np.isfinite(estimates["ned_from_body"]).all()
    np.testing.assert_allclose(euler_columns(estimates["ned_from_body"])[-1], 0.0, atol=1e-9)


def test_slow_stream_is_flagged_low_rate():
    assert run(still(50, rate_hz=2.0))["flags"][-1] == Flag.LOW_RATE
    assert run(still(50, rate_hz=50.0))["flags"][-1] == 0


def test_heading_follows_the_magnetic_field_and_ignores_a_disturbed_one():
    field_ned = np.array([22.0, 0.0, 42.0])
    yaw = 1.2
    samples = still(3000)
    body = rotate_columns(inverse_columns(quaternion_columns([[0.0, 0.0, yaw]])), field_ned[None])
    samples["mag_ut"] = body
    samples["mag_ut"][2000:] = (0.0, 60.0, 60.0)
    found = euler_columns(run(samples)["ned_from_body"])[:, 2]
    assert found[1999] == pytest.approx(yaw, abs=1e-3)
    assert found[-1] == pytest.approx(yaw, abs=1e-2)


@pytest.mark.parametrize("value", [1e3, 3e38, -np.inf, np.nan])
def test_impossible_values_move_nothing(value):
    samples = still(600)
    samples["gyro_rad_s"][300:310] = value
    samples["accel_m_s2"][400:410] = 10.0 * value
    estimates = run(samples)
    assert (estimates["flags"][300:310] & Flag.NOT_FINITE).all()
    assert (estimates["flags"][400:410] & Flag.ACCEL_MISSING).all()
    np.testing.assert_allclose(euler_columns(estimates["ned_from_body"])[350:], 0.0, atol=1e-6)


@pytest.mark.parametrize("field", ["ned_from_body", "covariance", "gyro_bias_rad_s"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_wrecked_state_aligns_anew(field, value):
    state = pipeline.new_state()
    run(still(400), state)
    state[field] = value
    estimate = run(still(1000, roll=0.3)[400:], state)[-1]
    assert estimate["phase"] == Phase.RUNNING
    assert euler_columns(estimate["ned_from_body"])[0] == pytest.approx(0.3, abs=0.02)


def test_a_vehicle_that_stands_is_at_rest_within_three_seconds():
    """One second aligns, two averages forget the doubt of the start, the last confirms."""
    samples = still(300)
    state = pipeline.new_state()
    estimates = empty(ESTIMATE_DTYPE, len(samples))
    pipeline.batch(
        pipeline.parameters(Settings()),
        coefficients(Calibration.ideal()),
        state,
        samples,
        estimates,
    )
    assert state["at_rest"][0] == 1
    assert np.degrees(estimates["attitude_sigma_rad"][-1, :2]).max() < 1.0
