"""Whole blind cases: nulls, seeds, truths, and their likeness to the shared ones."""

import json

import numpy as np
import pytest
from scipy.signal import welch

from ahrs_service.app.prove.blind_files import case_bytes, seal, write_case
from ahrs_service.blind.making.case import CONTROLS, NULLS, Request, make
from ahrs_service.blind.making.messages import tables
from ahrs_service.blind.making.plan import SHARES, controls, plan
from ahrs_service.blind.making.recording_noise import SHAKE_AXES
from ahrs_service.links.logs.tlog import read_tlog


def residual(case):
    """What the sensors read beyond motion and vibration."""
    motion, shake = case.scene.motion, case.scene.shake
    return (
        case.gyro_rad_s - motion.rate_rad_s - shake[0],
        case.accel_m_s2 - motion.force_m_s2 - shake[1],
    )


@pytest.mark.parametrize("null", NULLS)
@pytest.mark.parametrize("kind", ["bench", "flight"])
def test_nulls_hold_bias_and_noise_alone(kind, null):
    case = make(Request("n", kind, 12, 120, null=null))
    assert all(entry["effect"] == "none" for entry in case.truth["effects"])
    assert not case.hidden[0].any()
    assert not case.hidden[1].any()
    white = case.law.gyro_density * np.sqrt(0.5 * case.scene.rate_hz)
    gyro, accel = residual(case)
    jumps = np.diff(gyro, axis=0).std(axis=0) / np.sqrt(2.0)
    assert jumps == pytest.approx(white, rel=0.05)
    assert np.abs(gyro.mean(axis=0) - case.law.gyro_bias).max() < 5 * case.law.gyro_wander.sigma
    far = np.abs(accel.mean(axis=0) - case.law.accel_bias).max()
    assert far < 5 * case.law.accel_wander.sigma


def test_a_wander_that_follows_temperature_does():
    case = make(Request("n", "bench", 12, 300, null=NULLS[3]))
    gyro, _ = residual(case)
    slow = gyro[: len(gyro) // 1000 * 1000].reshape(-1, 1000, 3).mean(axis=1)
    own = case.scene.around.imu_degc[500::1000]
    likeness = [abs(np.corrcoef(slow[:, axis], own)[0, 1]) for axis in range(3)]
    assert max(likeness) > 0.5


def test_one_seed_repeats_its_bytes_and_another_does_not():
    request = Request("a", "copter", 77, 20, effects=("accel_lever_arm",))
    again = case_bytes(make(request))
    assert case_bytes(make(request)) == again
    other = Request("a", "copter", 78, 20, effects=("accel_lever_arm",))
    assert case_bytes(make(other)) != again


def test_a_concealed_effect_is_under_two_percent_of_what_lies_above():
    request = Request(
        "a", "bench", 3, 300, level=3, effects=("gyro_thermal_rate",), known="gyro_thermal_bias"
    )
    case = make(request)
    deep, known = case.truth["effects"]
    assert known["known"]
    raw = residual(case)[0]
    alone = np.sum(np.square(deep["signal_rms"]["gyro"]))
    assert alone < 0.02 * raw.var(axis=0).sum()
    assert deep["oracle_nats"] == pytest.approx(30.0, rel=0.02)


def test_saturation_cuts_the_finished_reading():
    case = make(Request("a", "copter", 3, 60, level=0, effects=("gyro_saturation",)))
    limit = case.truth["effects"][0]["params"]["limit"]
    assert np.abs(case.gyro_rad_s).max() == limit
    assert np.count_nonzero(np.abs(case.gyro_rad_s) == limit) > 3


@pytest.mark.parametrize("control", CONTROLS)
def test_a_control_changes_what_is_reported_and_not_what_is_read(control):
    plain = make(Request("a", "flight", 6, 60))
    changed = make(Request("a", "flight", 6, 60, control=control))
    assert np.array_equal(plain.gyro_rad_s, changed.gyro_rad_s)
    assert np.array_equal(plain.accel_m_s2, changed.accel_m_s2)
    assert not np.array_equal(plain.reported.imu_degc, changed.reported.imu_degc)
    observed = {table.name: table for table in tables(changed)}
    own = np.trunc(changed.reported.imu_degc[::20] * 100.0)
    assert np.array_equal(observed["SCALED_IMU"].fields["temperature"], own)


@pytest.mark.parametrize("count", [1, 7, 60, 160])
def test_a_plan_is_a_third_nulls_and_its_names_tell_nothing(count):
    requests = plan(count, 5)
    assert len(requests) == count
    nulls = [r for r in requests if not r.effects]
    assert len(nulls) >= 0.3 * count
    assert [r.name for r in requests] == [f"case_{n + 1:03d}" for n in range(count)]
    assert len({r.seed for r in requests}) == count
    if count == 160:
        assert {r.level for r in requests} == {0, 1, 2, 3}
        assert sum(any(e.startswith("outside:") for e in r.effects) for r in requests) == round(
            SHARES["outside"] * count
        )
    assert plan(count, 5) == requests
    assert plan(count, 6) != requests


def test_controls_come_in_every_way():
    assert {r.control for r in controls(9, 1)} == set(CONTROLS)
    assert {r.kind for r in controls(9, 1)} == {"bench", "flight", "copter"}


def test_no_effect_is_named_that_cannot_be_made():
    for request in plan(30, 2, seconds=80):
        make(request)


def test_the_seal_covers_names_and_bytes(tmp_path):
    write_case(tmp_path, tmp_path, make(Request("a", "bench", 3, 20)))
    sealed = seal(tmp_path)
    truth = tmp_path / "a.truth.json"
    assert json.loads(truth.read_text())["kind"] == "bench"
    truth.write_text(truth.read_text().replace("bench", "bunch"))
    assert seal(tmp_path) != sealed


def test_the_log_holds_what_was_made(tmp_path):
    case = make(Request("a", "flight", 3, 30))
    write_case(tmp_path, tmp_path, case)
    log = read_tlog(tmp_path / "a.tlog")
    assert not any(log.damaged.values())
    imu = log.tables[(1, 1, "HIGHRES_IMU")]
    assert np.array_equal(imu["zgyro"], case.gyro_rad_s[:, 2].astype(np.float32))
    scaled = log.tables[(1, 1, "SCALED_IMU")]["xacc"]
    assert np.array_equal(scaled, np.trunc(case.accel_m_s2[::20, 0] / 9.80665e-3))
    assert log.message_counts()["LOCAL_POSITION_NED"] == 30 * 50
    stamps = log.frames["received_us"]
    assert (np.diff(stamps) >= 0).all()


def test_vibration_is_reported_as_it_shakes():
    case = make(Request("a", "flight", 3, 120))
    observed = {table.name: table for table in tables(case)}["VIBRATION"]
    shaken = case.scene.shake[1].std(axis=0)
    reported = [np.sqrt(np.mean(observed.fields[f"vibration_{axis}"] ** 2)) for axis in "xyz"]
    assert shaken == pytest.approx(reported, rel=0.03)
    assert reported == pytest.approx(SHAKE_AXES / SHAKE_AXES[0] * reported[0], rel=0.01)


SHARED = "mismatch/cases"


def density(table, axis, band):
    frequency, psd = welch(table[axis][4000:], fs=200.0, nperseg=4096)
    inside = (frequency > band[0]) & (frequency < band[1])
    return float(np.sqrt(psd[inside].mean()))


@pytest.mark.parametrize(("axis", "band"), [("xgyro", (5, 10)), ("xacc", (5, 8))])
def test_the_sensor_is_as_noisy_as_the_shared_one(shared, axis, band):
    path = shared.parent / SHARED / "null_flight.tlog"
    if not path.is_file():
        pytest.skip(f"{path.name} is not in the shared folder: {SHARED}")
    theirs = density(read_tlog(path).tables[(1, 1, "HIGHRES_IMU")], axis, band)
    case = make(Request("a", "flight", 5, 240))
    ours = density({"xgyro": case.gyro_rad_s[:, 0], "xacc": case.accel_m_s2[:, 0]}, axis, band)
    # Units differ by +-25 %, as drawn.
    assert ours == pytest.approx(theirs, rel=0.3)
