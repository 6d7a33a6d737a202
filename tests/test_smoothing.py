"""The smoothed attitude of whole flights: better, consistent, complete across realignments."""

import itertools
import math

import numpy as np
import pytest

from ahrs_service.estimator import Estimator, smooth
from ahrs_service.records import (
    READING_DTYPE,
    SAMPLE_DTYPE,
    Airframe,
    Flag,
    ImuSource,
    Kind,
    Phase,
    empty,
)
from ahrs_service.rotation import euler_columns, inverse_columns, multiply_columns
from ahrs_service.sensor.parameters import Calibration
from ahrs_service.settings import FusionSettings, Settings
from ahrs_service.simulation.environment import FIELD_NED_UT
from ahrs_service.simulation.samples import samples_of
from ahrs_service.simulation.scenario import make_flight
from ahrs_service.smoothing import Smoother

IDEAL = Calibration.ideal()
SETTINGS = Settings(
    fusion=FusionSettings(
        declination_deg=math.degrees(math.atan2(FIELD_NED_UT[1], FIELD_NED_UT[0]))
    )
)


@pytest.fixture(scope="module")
def flights():
    """Three flights of a minute at 100 Hz, each with another wind and noise, and their samples."""
    found = []
    for seed in (1, 2, 3):
        flight = make_flight("flight", 60.0, seed=seed, rate_hz=100.0)
        found.append((flight.rows, samples_of(flight, Airframe.FIXED_WING, magnetometer=True)))
    return found


def errors(truth, estimates):
    """Error angles [N, 3] about north, east, down."""
    error = multiply_columns(truth["ned_from_body"], inverse_columns(estimates["ned_from_body"]))
    error *= np.where(error[:, :1] < 0.0, -1.0, 1.0)
    return 2.0 * error[:, 1:]


def rms_deg(angle):
    return math.degrees(math.sqrt(np.mean(angle**2)))


def resting(seconds, rate_hz=100.0, bias=(0.0, 0.0, 0.0)):
    samples = empty(SAMPLE_DTYPE, round(seconds * rate_hz))
    rng = np.random.default_rng(5)
    samples["time_ns"] = samples["received_ns"] = np.arange(len(samples)) * round(1e9 / rate_hz)
    samples["gyro_rad_s"] = rng.normal(0.0, 0.002, (len(samples), 3)) + bias
    samples["accel_m_s2"] = rng.normal(0.0, 0.02, (len(samples), 3))
    samples["accel_m_s2"][:, 2] -= 9.80665
    samples["source"], samples["airframe"] = ImuSource.HIGHRES_IMU, Airframe.OTHER
    return samples


def assert_sound(estimates):
    norms = np.linalg.norm(estimates["ned_from_body"], axis=1)
    np.testing.assert_allclose(norms, 1.0, atol=1e-9)
    for name in ("attitude_sigma_rad", "gyro_bias_rad_s", "gyro_bias_sigma_rad_s"):
        assert np.isfinite(estimates[name]).all(), name


def test_smoothed_is_closer_to_the_truth_and_knows_how_close(flights):
    tilt, nees = [[], []], []
    for truth, samples in flights:
        causal, smoothed = smooth(SETTINGS, IDEAL, samples)
        running = causal["phase"] == Phase.RUNNING
        for n, rows in enumerate((causal, smoothed)):
            tilt[n].append(errors(truth, rows)[running, :2])
        sigma = smoothed["attitude_sigma_rad"][running, :2]
        # The causal sigma changes at updates only, the smoothed one in between as well.
        assert (sigma < 1.03 * causal["attitude_sigma_rad"][running, :2]).all()
        nees.append((tilt[1][-1] / sigma) ** 2)
    before, after = (rms_deg(np.concatenate(one)) for one in tilt)
    assert after < 0.8 * before
    # In-flight samples follow each other, so this is a mean of few independent draws.
    assert 0.05 < np.mean(nees) < 2.0


def test_the_causal_estimates_are_the_same_bytes(flights):
    _, samples = flights[0]
    causal, smoothed = smooth(SETTINGS, IDEAL, samples)
    plain = Estimator(SETTINGS, IDEAL).run(samples)
    assert causal.tobytes() == plain.tobytes()
    for name in ("time_ns", "gate", "flags", "phase", "innovation_rad", "temperature_degc"):
        np.testing.assert_array_equal(smoothed[name], causal[name])
    assert (smoothed["ned_from_body"] != causal["ned_from_body"]).any()


def test_in_pieces_it_smooths_to_the_same_bytes(flights):
    _, samples = flights[0]
    _, whole = smooth(SETTINGS, IDEAL, samples)
    smoother = Smoother()
    estimator = Estimator(SETTINGS, IDEAL, smoother)
    edges = itertools.pairwise([0, 1, 2, 500, 503, 4000, len(samples)])
    estimates = np.concatenate([estimator.run(samples[a:b]) for a, b in edges])
    smoother.smooth(estimates)
    assert estimates.tobytes() == whole.tobytes()


def test_no_step_at_an_update(flights):
    """Where the filter corrects, its attitude jumps; the smoothed one follows the gyro."""
    _, samples = flights[0]
    jumps = []
    for estimates in smooth(SETTINGS, IDEAL, samples):
        rows = estimates[estimates["phase"] == Phase.RUNNING][500:]
        step = multiply_columns(
            inverse_columns(rows["ned_from_body"][:-1]), rows["ned_from_body"][1:]
        )
        mean = 0.5 * (rows["rate_rad_s"][:-1] + rows["rate_rad_s"][1:]) * 0.01
        extra = np.linalg.norm(2.0 * step[:, 1:] * np.sign(step[:, :1]) - mean, axis=1)
        jumps.append(np.sort(extra)[-20:].mean())
    assert jumps[1] < 0.3 * jumps[0]


def test_residual_and_rate_are_those_of_the_smoothed_state(flights):
    _, samples = flights[0]
    _, rows = smooth(SETTINGS, IDEAL, samples)
    euler = euler_columns(rows["ned_from_body"])
    down = np.stack(
        [
            -np.sin(euler[:, 1]),
            np.sin(euler[:, 0]) * np.cos(euler[:, 1]),
            np.cos(euler[:, 0]) * np.cos(euler[:, 1]),
        ],
        axis=1,
    )
    np.testing.assert_allclose(
        rows["residual_m_s2"], rows["accel_m_s2"] + 9.80665 * down, atol=1e-9
    )
    crossed = samples["gyro_rad_s"] - rows["gyro_bias_rad_s"] - rows["rate_rad_s"]
    rate = np.linalg.norm(samples["gyro_rad_s"], axis=1)
    assert (np.linalg.norm(crossed, axis=1) < 0.03 * rate + 1e-3)[200:].all()


def test_nothing_passes_from_after_a_new_alignment_to_before(flights):
    _, samples = flights[0]
    cut = 3000
    parted = samples.copy()
    parted["time_ns"][cut:] += 8_000_000_000
    parted["received_ns"] = parted["time_ns"]
    causal, smoothed = smooth(SETTINGS, IDEAL, parted)
    assert causal["flags"][cut] & Flag.REALIGNED
    _, first = smooth(SETTINGS, IDEAL, samples[:cut])
    assert smoothed[:cut].tobytes() == first.tobytes()
    assert_sound(smoothed)
    assert (smoothed["ned_from_body"][cut:] != causal["ned_from_body"][cut:]).any()


def test_over_a_short_gap_it_reaches_back(flights):
    truth, samples = flights[0]
    kept = np.ones(len(samples), bool)
    kept[2500:2650] = False
    causal, smoothed = smooth(SETTINGS, IDEAL, samples[kept])
    assert np.count_nonzero(causal["flags"] & Flag.GAP) == 1
    running = causal["phase"] == Phase.RUNNING
    before, after = (rms_deg(errors(truth[kept], e)[running, :2]) for e in (causal, smoothed))
    assert after < before
    near = slice(2500, 2600)
    before, after = (rms_deg(errors(truth[kept], e)[near, :2]) for e in (causal, smoothed))
    assert after < before


def test_the_bias_that_the_alignment_found_holds_from_the_first_sample():
    causal, smoothed = smooth(Settings(), IDEAL, resting(10.0, bias=(0.05, -0.03, 0.02)))
    assert (abs(causal["gyro_bias_rad_s"][10]) < 0.01).all()
    np.testing.assert_allclose(smoothed["gyro_bias_rad_s"][10], (0.05, -0.03, 0.02), atol=0.005)


def test_a_bias_that_steps_at_rest_is_not_reported_to_the_time_before():
    samples = resting(120.0)
    step, n = 0.03, 6000
    samples["gyro_rad_s"][n:, 0] += step
    _, smoothed = smooth(Settings(), IDEAL, samples)
    bias = smoothed["gyro_bias_rad_s"][:, 0]
    assert abs(bias[200 : n - 100]).max() < 0.2 * step
    assert abs(bias[-3000:] - step).max() < 0.2 * step


def test_a_heading_found_in_flight_holds_for_the_time_before(flights):
    """Six axes and a velocity: the heading is found at take-off, the wind becomes a state."""
    truth, samples = flights[0]
    samples = samples.copy()
    samples["mag_ut"] = np.nan
    samples["velocity_ned_m_s"][::20] = truth["velocity_ned_m_s"][::20]
    causal, smoothed = smooth(SETTINGS, IDEAL, samples)
    found = int(np.argmax(causal["attitude_sigma_rad"][:, 2] < 1.0))
    assert found > 500
    heading = [errors(truth, rows)[200 : found - 10, 2] for rows in (causal, smoothed)]
    sigma = smoothed["attitude_sigma_rad"][200 : found - 10, 2]
    assert abs(heading[0]).max() > 0.5
    assert (abs(heading[1]) < 4.0 * sigma).all()
    assert abs(heading[1]).max() < math.radians(15.0)
    assert rms_deg(errors(truth, smoothed)[found:]) < rms_deg(errors(truth, causal)[found:])


def test_gated_mode_is_smoothed_too(flights):
    truth, samples = flights[1]
    settings = Settings(fusion=FusionSettings(mode="gated", magnetometer=False))
    causal, smoothed = smooth(settings, IDEAL, samples)
    running = causal["phase"] == Phase.RUNNING
    tilt = [
        euler_columns(e["ned_from_body"])[running, :2]
        - euler_columns(truth["ned_from_body"])[running, :2]
        for e in (causal, smoothed)
    ]
    assert rms_deg(tilt[1]) < rms_deg(tilt[0])


@pytest.mark.parametrize("count", [0, 1, 2, 7])
def test_few_samples_are_smoothed_to_something_sound(count):
    causal, smoothed = smooth(Settings(), IDEAL, resting(1.0)[:count])
    assert len(smoothed) == count
    assert_sound(smoothed)
    assert (smoothed["attitude_sigma_rad"] <= causal["attitude_sigma_rad"] + 1e-12).all()


@pytest.mark.parametrize("name", ["gyro_rad_s", "accel_m_s2"])
def test_nothing_but_nan_leaves_the_estimates_as_they_are(name):
    samples = resting(2.0)
    samples[name] = np.nan
    causal, smoothed = smooth(Settings(), IDEAL, samples)
    assert causal.tobytes() == smoothed.tobytes()


@pytest.mark.parametrize("seed", range(6))
def test_damaged_streams_are_smoothed_to_something_sound(flights, seed):
    rng = np.random.default_rng(seed)
    samples = flights[seed % 3][1][:3000].copy()
    for name in ("gyro_rad_s", "accel_m_s2", "mag_ut"):
        hit = rng.uniform(size=len(samples)) < 0.02
        samples[name][hit] = rng.choice([np.nan, np.inf, 1e30, 200.0, 0.0], (hit.sum(), 1))
    clock = samples["time_ns"]
    for n in rng.integers(100, 2900, 6):
        clock[n:] += rng.choice([-40_000_000_000, -50_000_000, 700_000_000, 9_000_000_000])
    samples["flags"][rng.integers(0, 3000, 2)] = Flag.IMU_CHANGED
    samples = np.repeat(samples, rng.integers(1, 3, len(samples)))
    causal, smoothed = smooth(SETTINGS, IDEAL, samples)
    assert_sound(causal)
    assert_sound(smoothed)


def readings_of(samples):
    readings = empty(READING_DTYPE, len(samples) + 1)
    readings["system"] = readings["component"] = 1
    readings["kind"], readings["source"] = Kind.IMU, ImuSource.HIGHRES_IMU
    readings[0]["kind"] = Kind.HEARTBEAT
    for name in ("time_ns", "received_ns", "gyro_rad_s", "accel_m_s2"):
        readings[name][1:] = samples[name]
    return readings


def test_an_estimator_with_a_smoother_has_the_same_digest_and_keeps_restored_states_apart():
    readings = readings_of(resting(6.0, bias=(0.01, 0.0, 0.0)))
    plain, smoother = Estimator(Settings()), Smoother()
    watched = Estimator(Settings(), smoother=smoother)
    first = watched.take(readings[:300]).copy()
    plain.take(readings[:300])
    middle, early = plain.save(), Smoother()
    again = Estimator(Settings(), smoother=early)
    early_rows = again.take(readings[:300]).copy()
    early.smooth(early_rows)
    watched.restore(middle)
    rows = np.concatenate([first, watched.take(readings[300:])])
    plain.take(readings[300:])
    assert watched.digest.hexdigest() == plain.digest.hexdigest()
    smoother.smooth(rows)
    assert rows[: len(first)].tobytes() == early_rows.tobytes()


def test_it_takes_all_estimates_or_none():
    smoother, samples = Smoother(), resting(1.0)
    estimates = Estimator(smoother=smoother).run(samples)
    with pytest.raises(ValueError, match="99 estimates cannot be smoothed by the nodes of 100"):
        smoother.smooth(estimates[:-1])
