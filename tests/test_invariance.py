"""What may not matter does not: axes, clocks, rates, number formats, lost and jittered samples."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ahrs_service.app.estimate.arrays import estimate_columns
from ahrs_service.app.estimate.sample_columns import Columns
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.estimator import Estimator
from ahrs_service.fusion.states import GYRO_MATRIX
from ahrs_service.records import ESTIMATE_DTYPE, SAMPLE_DTYPE, Airframe, Phase, empty
from ahrs_service.rotation import (
    inverse_columns,
    multiply_columns,
    quaternion_columns,
    rotate_columns,
)
from ahrs_service.settings import FusionSettings, Settings
from ahrs_service.simulation.samples import samples_of
from ahrs_service.simulation.scenario import make_flight

few = settings(max_examples=12, deadline=None)
angle = st.floats(-math.pi, math.pi)
modes = pytest.mark.parametrize("mode", ["velocity", "gated"])


def run(samples, mode="velocity", airframe="hand_held", yaw=0.0, **fusion):
    """Estimates [N], and the state after the last."""
    chosen = Settings(fusion=FusionSettings(mode=mode, airframe=airframe, **fusion))
    estimator = Estimator(chosen)
    estimator.state["ned_from_body"] = quaternion_columns([[0.0, 0.0, yaw]])
    return estimator.run(samples), estimator.state


def angles_deg(p, q):
    error = multiply_columns(p, inverse_columns(q))
    return np.degrees(2.0 * np.arctan2(np.linalg.norm(error[:, 1:], axis=1), np.abs(error[:, 0])))


def tilts_deg(p, q):
    """Angle between the two verticals; the heading does not matter."""
    error = multiply_columns(p, inverse_columns(q))
    cosine = np.hypot(error[:, 0], error[:, 3])
    return np.degrees(2.0 * np.arctan2(np.hypot(error[:, 1], error[:, 2]), cosine))


@pytest.fixture(scope="module")
def flight():
    """45 s from warm-up to landing at 100 Hz with a consumer sensor: samples, true attitude."""
    flown = make_flight("flight", 45.0, seed=5, rate_hz=100.0)
    return samples_of(flown, Airframe.FIXED_WING, magnetometer=True), flown.rows["ned_from_body"]


def shaken(swing, seed):
    """Rest, then rotation about all axes by 1.5 rad/s and a to and fro of 1 m/s^2 (both RMS)."""
    rng = np.random.default_rng(seed)
    frequency = rng.uniform(0.1, 1.5, (2, 3, 5))
    amplitude = np.array([1.5, 1.0])[:, None, None] / (2 * math.pi * frequency) / math.sqrt(2.5)
    return swing(*np.stack([amplitude, frequency, rng.uniform(0.0, 6.3, (2, 3, 5))], axis=-1))


def tumbled(swing, seed):
    """Full rotations about all axes, where an error of scale or axes adds up."""
    rng = np.random.default_rng(seed)
    angle, push = rng.uniform(0.03, 0.12, (3, 3)), rng.uniform(0.1, 1.5, (3, 3))
    turns = np.stack([np.full((3, 3), 4.0), angle, rng.uniform(0.0, 6.3, (3, 3))], axis=-1)
    size = 1.0 / (2 * math.pi * push) / math.sqrt(1.5)
    return swing(turns, np.stack([size, push, rng.uniform(0.0, 6.3, (3, 3))], axis=-1))


def regular(seconds, rate_hz):
    return np.arange(int(seconds * rate_hz) + 1) / rate_hz


def without_mag(samples):
    samples = samples.copy()
    samples["mag_ut"] = np.nan
    return samples


def turned(samples, mounting):
    """The same motion felt by a sensor mounted otherwise: v' = mounting v."""
    samples, mountings = samples.copy(), np.repeat(mounting, len(samples), axis=0)
    for name in ("gyro_rad_s", "accel_m_s2"):
        samples[name] = rotate_columns(mountings, samples[name])
    return samples


@modes
@few
@given(yaw=angle)
def test_the_heading_at_the_start_rotates_the_result_about_the_vertical(flight, mode, yaw):
    samples = without_mag(flight[0])[:3000]
    north, _ = run(samples, mode, "fixed_wing")
    other, _ = run(samples, mode, "fixed_wing", yaw)
    turn = quaternion_columns([[0.0, 0.0, yaw]])
    expected = multiply_columns(turn, north["ned_from_body"])
    assert angles_deg(other["ned_from_body"], expected).max() < 1e-6
    np.testing.assert_array_equal(other["gate"], north["gate"])
    np.testing.assert_allclose(other["gyro_bias_rad_s"], north["gyro_bias_rad_s"], atol=1e-9)


@modes
@few
@given(declination_deg=st.floats(-180.0, 180.0))
def test_the_declination_rotates_the_result_about_the_vertical(flight, mode, declination_deg):
    samples = flight[0][:3000]
    magnetic, _ = run(samples, mode, "fixed_wing")
    true, _ = run(samples, mode, "fixed_wing", declination_deg=declination_deg)
    turn = quaternion_columns([[0.0, 0.0, math.radians(declination_deg)]])
    expected = multiply_columns(turn, magnetic["ned_from_body"])
    assert angles_deg(true["ned_from_body"], expected).max() < 1e-6


@modes
@few
@given(mounting=st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: math.hypot(*q) > 0.3))
def test_how_the_sensor_is_mounted_in_the_hand_does_not_matter(swing, mode, mounting):
    """A hand moves equally along all axes; the constant heading of the result may differ."""
    mounting = np.array([mounting]) / math.hypot(*mounting)
    samples = shaken(swing, 3).samples(regular(15.0, 100.0))
    straight, _ = run(samples, mode)
    other, _ = run(turned(samples, mounting), mode)
    back = multiply_columns(other["ned_from_body"], mounting)
    between = multiply_columns(back, inverse_columns(straight["ned_from_body"]))
    assert tilts_deg(back, straight["ned_from_body"]).max() < 1e-5
    assert angles_deg(between, np.repeat(between[:1], len(between), axis=0)).max() < 1e-4
    np.testing.assert_array_equal(other["gate"], straight["gate"])


@modes
@pytest.mark.parametrize("seed", range(4))
def test_a_flight_is_the_same_however_the_sensor_is_mounted(flight, mode, seed):
    """With a bound on the velocity that is equal on all axes, and with every gate in use."""
    samples = without_mag(flight[0])
    mounting = np.random.default_rng(seed).normal(size=(1, 4))
    mounting /= np.linalg.norm(mounting)
    straight, _ = run(samples, mode)
    other, _ = run(turned(samples, mounting), mode)
    back = multiply_columns(other["ned_from_body"], mounting)
    np.testing.assert_array_equal(other["gate"], straight["gate"])
    assert tilts_deg(back, straight["ned_from_body"]).max() < 1e-5


@modes
@pytest.mark.parametrize("shift_ns", [-(10**9), 10**17])
def test_the_time_of_day_does_not_matter(flight, mode, shift_ns):
    samples = flight[0].copy()
    before, _ = run(samples, mode, "fixed_wing")
    samples["time_ns"] += shift_ns
    samples["received_ns"] += shift_ns
    after, _ = run(samples, mode, "fixed_wing")
    for name in ESTIMATE_DTYPE.names:
        if name not in ("time_ns", "received_ns"):
            assert after[name].tobytes() == before[name].tobytes(), name


@modes
@pytest.mark.parametrize("gyro_sample", ["instant", "mean"])
@pytest.mark.parametrize(
    ("fast_hz", "slow_hz", "limit_deg"), [(1000, 500, 0.01), (500, 100, 0.06), (200, 50, 0.3)]
)
def test_the_rate_of_the_stream_hardly_matters(
    swing, mode, gyro_sample, fast_hz, slow_hz, limit_deg
):
    motion, t = shaken(swing, 7), regular(20.0, fast_hz)
    every, is_mean = fast_hz // slow_hz, gyro_sample == "mean"
    fast, _ = run(motion.samples(t, is_mean), mode, gyro_sample=gyro_sample)
    slow, _ = run(motion.samples(t[::every], is_mean), mode, gyro_sample=gyro_sample)
    between = angles_deg(fast["ned_from_body"][::every], slow["ned_from_body"])
    assert between.max() < limit_deg
    assert tilts_deg(motion.attitude(t[::every]), slow["ned_from_body"]).max() < 3.0


@modes
def test_ten_percent_of_the_samples_lost_at_random_cost_little(flight, mode):
    samples, truth = without_mag(flight[0]), flight[1]
    kept = np.random.default_rng(1).random(len(samples)) > 0.1
    whole, _ = run(samples, mode, "fixed_wing")
    rest, _ = run(samples[kept], mode, "fixed_wing")
    assert not rest["flags"].any()
    settled = slice(300, None)
    assert tilts_deg(rest["ned_from_body"], whole["ned_from_body"][kept])[settled].max() < 2.0
    errors = [
        np.sqrt(np.mean(tilts_deg(truth[rows], found["ned_from_body"])[settled] ** 2))
        for rows, found in ((slice(None), whole), (kept, rest))
    ]
    assert errors[1] < errors[0] + 0.5


@modes
def test_jitter_of_a_tenth_of_the_step_in_the_stamps_costs_little(flight, mode):
    samples = without_mag(flight[0])
    whole, _ = run(samples, mode, "fixed_wing")
    noise_s = np.random.default_rng(2).uniform(-1e-3, 1e-3, len(samples))
    samples["time_ns"] += np.rint(noise_s * 1e9).astype(np.int64)
    shaky, _ = run(samples, mode, "fixed_wing")
    assert not shaky["flags"].any()
    assert tilts_deg(shaky["ned_from_body"], whole["ned_from_body"])[300:].max() < 1.0


@modes
@pytest.mark.parametrize("frame", ["frd", "flu"])
def test_single_precision_costs_nothing(flight, mode, frame):
    samples = flight[0]
    chosen = Settings(fusion=FusionSettings(mode=mode, airframe="fixed_wing"))
    exact, rounded, widened = (
        estimate_columns(
            Columns(
                samples["time_ns"],
                *(samples[name].astype(first).astype(then) for name in fields),
            ),
            chosen,
            frame,
        )
        for fields in [("gyro_rad_s", "accel_m_s2", "mag_ut")]
        for first, then in [("f8", "f8"), ("f4", "f4"), ("f4", "f8")]
    )
    for name in ("quat", "quat9", "sigma_deg", "gate"):
        assert rounded[name].tobytes() == widened[name].tobytes(), name
    for name in ("quat", "quat9"):
        assert angles_deg(rounded[name], exact[name]).max() < 1e-3


def in_motion(swing, seed, seconds):
    """A motion already under way at the first sample: samples, true attitude."""
    motion, t = shaken(swing, seed), regular(seconds, 100.0)
    t = t[t > 3.3]
    return motion.samples(t), motion.attitude(t)


@pytest.mark.parametrize("airframe", ["hand_held", "multirotor"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_bias_is_found_in_motion_within_its_sigma(swing, airframe, seed):
    samples, truth = in_motion(swing, seed, 120.0)
    bias = np.array([0.012, -0.010, 0.008])
    samples["gyro_rad_s"] += bias
    estimates, _ = run(samples, "velocity", airframe)
    last = estimates[-1]
    error, sigma = last["gyro_bias_rad_s"] - bias, last["gyro_bias_sigma_rad_s"]
    assert (np.abs(error) < 3.0 * sigma).all()
    # At first the sigma is 0.02 on all axes; what is seen about the vertical is up to the motion.
    assert (np.sort(sigma)[:2] < 0.008).all()
    assert np.sort(np.abs(error))[1] < 0.003
    assert tilts_deg(truth, estimates["ned_from_body"])[6000:].max() < 4.0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_gyros_matrix_is_found_in_motion_within_its_sigma(swing, seed):
    """Of gyro = (I + E) rate the filter finds M with I - M = (I + E)^-1."""
    samples = tumbled(swing, seed).samples(regular(300.0, 100), mean=True)
    error = np.random.default_rng(seed).normal(0.0, 0.004, (3, 3))
    samples["gyro_rad_s"] = samples["gyro_rad_s"] @ (np.eye(3) + error).T
    truth = np.eye(3) - np.linalg.inv(np.eye(3) + error)
    _, state = run(without_mag(samples), gyro_sample="mean")
    found = state["gyro_matrix"][0]
    variances = np.diag(state["covariance"][0])[GYRO_MATRIX : GYRO_MATRIX + 9]
    sigma = np.sqrt(variances).reshape(3, 3)
    assert (np.abs(found - truth) < 3.0 * sigma).all()
    # States observable in this motion were found; those that need a heading stay uncertain.
    observed = sigma < 0.5 * 0.004
    assert observed.sum() >= 3
    assert np.linalg.norm((found - truth)[observed]) < 0.5 * np.linalg.norm(truth[observed])


@modes
def test_a_bias_is_found_in_flight_within_its_sigma(mode):
    flown = make_flight("calm", 150.0, seed=2, rate_hz=100.0)
    aloft = np.flatnonzero(flown.rows["airborne"] > 0.99)[200:-200]
    samples, bias = samples_of(flown, Airframe.FIXED_WING)[aloft], np.array([0.012, -0.010, 0.008])
    samples["gyro_rad_s"] += bias
    last = run(samples, mode, "fixed_wing")[0][-1]
    error, sigma = last["gyro_bias_rad_s"] - bias, last["gyro_bias_sigma_rad_s"]
    assert (np.abs(error) < 3.0 * sigma).all()
    assert (sigma < 0.004).all()


STILL = [[0.0, 1.0, 0.0]]


@modes
@pytest.mark.parametrize(
    "angles",
    [
        [STILL, [[3.0, 0.1, 0.0]], STILL],
        [STILL, [[math.pi / 2, 0.1, 0.0]], STILL],
        [[[2.0, 0.13, 1.0]], [[1.5, 0.1, 0.0]], STILL],
        [STILL, [[1.5, 0.07, 0.0]], [[2.0, 0.11, 0.0]]],
    ],
    ids=["loops", "to the vertical and back", "roll and pitch", "yaw near the vertical"],
)
def test_the_vertical_nose_is_an_attitude_as_any_other(swing, mode, angles):
    motion, t = swing(angles), regular(40.0, 100.0)
    estimates, _ = run(motion.samples(t), mode)
    assert angles_deg(motion.attitude(t), estimates["ned_from_body"]).max() < 0.05
    assert np.abs(np.linalg.norm(estimates["ned_from_body"], axis=1) - 1.0).max() < 1e-12


@modes
@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg"), [(180, 0), (172, 17), (0, 90), (0, -90), (29, 89.99), (-90, 0)]
)
def test_any_attitude_is_a_place_to_start(mode, roll_deg, pitch_deg):
    attitude = quaternion_columns([[math.radians(roll_deg), math.radians(pitch_deg), 0.4]])
    samples = without_mag(noisy(regular(20.0, 100.0), attitude, np.zeros(3)))
    samples["gyro_rad_s"] += (0.01, -0.01, 0.02)
    estimates, _ = run(samples, mode, "fixed_wing")
    assert estimates["phase"][200] == Phase.RUNNING
    errors = tilts_deg(attitude, estimates["ned_from_body"])
    assert errors.max() < 2.0
    assert errors[-1] < 1.0
    np.testing.assert_allclose(estimates["gyro_bias_rad_s"][-1], [0.01, -0.01, 0.02], atol=4e-3)


def noisy(t, attitude, acceleration_ned):
    """Samples of a noisy sensor that moves by `attitude` [N, 4] and `acceleration_ned` [N, 3]."""
    attitude = np.broadcast_to(attitude, (len(t), 4))
    step = multiply_columns(inverse_columns(attitude[:-1]), attitude[1:])
    turn = 2.0 * step[:, 1:] * np.sign(step[:, :1]) / np.diff(t)[:, None]
    rng = np.random.default_rng(1)
    samples = empty(SAMPLE_DTYPE, len(t))
    samples["time_ns"] = samples["received_ns"] = np.rint(t * 1e9)
    samples["gyro_rad_s"] = rng.normal(0.0, 0.005, (len(t), 3))
    samples["gyro_rad_s"][1:-1] += 0.5 * (turn[1:] + turn[:-1])
    gravity = [0.0, 0.0, STANDARD_GRAVITY_M_S2]
    force = np.broadcast_to(acceleration_ned - np.array(gravity), (len(t), 3))
    samples["accel_m_s2"] = rotate_columns(inverse_columns(attitude), force)
    samples["accel_m_s2"] += rng.normal(0.0, 0.1, (len(t), 3))
    return samples


@modes
def test_a_launch_by_hand_does_not_tilt_the_horizon(mode):
    """Five seconds in a hand that sways, a throw of 3 g, then 10 m/s with the nose at 11 deg."""
    t = regular(30.0, 100.0)
    sway = np.sin(2.0 * math.pi * t[:, None] * [0.7, 0.5, 0.3] + [0.0, 1.0, 2.0])
    euler = np.clip(5.0 - t, 0.0, 1.0)[:, None] * sway * [0.05, 0.08, 0.03]
    euler[:, 1] += 0.2 * np.clip(t - 4.0, 0.0, 1.0)
    attitude = quaternion_columns(euler)
    thrown = (t > 5.0) & (t < 5.7)
    push = np.where(thrown, 28.6 * np.sin(math.pi * (t - 5.0) / 0.7) ** 2, 0.0)
    acceleration = push[:, None] * rotate_columns(attitude, np.tile([1.0, 0.0, 0.0], (len(t), 1)))
    estimates, _ = run(noisy(t, attitude, acceleration), mode, "fixed_wing")
    errors = tilts_deg(attitude, estimates["ned_from_body"])
    assert estimates["gate"][(t > 5.2) & (t < 5.7)].all()
    assert errors[200:].max() < 2.0
    assert errors[-1] < 1.0
