"""The front door at work: samples, arrays and logs in, estimates, columns and diagnoses out."""

import numpy as np
import pytest

from ahrs_service import (
    Calibration,
    Estimator,
    Settings,
    as_columns,
    diagnose,
    estimate,
    read_recording,
)
from ahrs_service.app.cli import main
from ahrs_service.app.diagnose.recorded_columns import read_columns
from ahrs_service.app.files import config_file
from ahrs_service.app.prove.blind_files import case_bytes
from ahrs_service.blind.making.case import Request, make
from ahrs_service.diagnosis.input.diagnosis_input import Recorded, Series
from ahrs_service.errors import ConfigError, DiagnosisError, InvalidValueError
from ahrs_service.records import ESTIMATE_DTYPE, READING_DTYPE, SAMPLE_DTYPE, empty
from ahrs_service.rotation import euler_columns
from ahrs_service.sensor.parameters import TriadCalibration
from ahrs_service.simulation.scenario import make_flight
from ahrs_service.smoothing import Smoother
from tests.streams import moving, run

# -- the estimator ----------------------------------------------------------------------------


def test_run_is_the_pipeline_to_the_last_bit():
    samples = moving(1500)
    estimator = Estimator()
    parts = [
        estimator.run(samples[part]) for part in (slice(0, 700), slice(700, 700), slice(700, None))
    ]
    assert np.concatenate(parts).tobytes() == run(samples).tobytes()


def test_what_run_returns_is_the_callers():
    estimator, samples = Estimator(), moving(200)
    first = estimator.run(samples[:100])
    kept = first.copy()
    estimator.run(samples[100:])
    assert first.tobytes() == kept.tobytes()


def test_run_with_a_smoother_gives_the_same_bytes():
    samples, smoother = moving(400), Smoother()
    estimates = Estimator(smoother=smoother).run(samples)
    assert estimates.tobytes() == Estimator().run(samples).tobytes()
    smoother.smooth(estimates)


def flight_arrays(seconds=20.0):
    rows = make_flight("flight", seconds, seed=1, rate_hz=100.0).rows
    return rows["gyro_rad_s"].copy(), rows["accel_m_s2"].copy(), rows["mag_ut"].astype(np.float64)


def test_one_sample_at_a_time_is_all_at_once():
    gyr, acc, mag = flight_arrays()
    whole = estimate(gyr, acc, rate_hz=100.0, mag=mag, settings=Settings(), profile=None)
    settings = config_file.load(None, [f"fusion.airframe={whole.profile}"])
    estimator = Estimator(settings)
    rows = [
        estimator.update(0.01 * n, gyr[n], acc[n], mag[n])["ned_from_body"] for n in range(len(gyr))
    ]
    np.testing.assert_array_equal(np.array(rows), whole.quat9)


def test_update_takes_what_else_is_measured():
    bare, aided = Estimator(), Estimator()
    for n in range(300):
        sample = (0.01 * n, (0.0, 0.0, 0.1), (0.0, 0.5, -9.8))
        last = bare.update(*sample)
        observed = aided.update(
            *sample, airspeed=15.0, velocity_ned=(15.0, 0.0, 0.0), temperature_degc=30.0
        )
    assert observed["temperature_degc"] == 30.0
    assert np.isnan(last["temperature_degc"])
    assert (observed["ned_from_body"] != last["ned_from_body"]).any()


@pytest.mark.parametrize(
    ("words", "match"),
    [
        ({"t": -1.0, "gyr": (0, 0, 0), "acc": (0, 0, -9.8)}, "t = -1.0: give seconds"),
        ({"t": float("nan"), "gyr": (0, 0, 0), "acc": (0, 0, -9.8)}, "t = nan"),
        ({"t": 0.0, "gyr": 0.0, "acc": (0, 0, -9.8)}, r"gyr has shape \(\); give x, y and z"),
        ({"t": 0.0, "gyr": (0, 0, 0), "acc": (0, 0)}, r"acc has shape \(2,\)"),
        ({"t": 0.0, "gyr": (0, 0, 0), "acc": (0, 0, -9.8), "mag": [1.0]}, "mag has shape"),
    ],
)
def test_update_refuses_what_is_no_sample(words, match):
    with pytest.raises(InvalidValueError, match=match):
        Estimator().update(**words)


def test_a_view_of_samples_and_one_that_cannot_be_written_are_taken():
    samples = moving(400)
    expected = Estimator().run(samples[::2].copy())
    view = samples[::2]
    view.flags.writeable = False
    assert Estimator().run(view).tobytes() == expected.tobytes()


@pytest.mark.parametrize(
    "rows", [np.zeros((5, 6)), empty(READING_DTYPE, 3), moving(4).reshape(2, 2)]
)
def test_run_refuses_what_are_no_samples(rows):
    with pytest.raises(InvalidValueError, match=r"give rows \[N\] of ahrs_service.records.SAMPLE"):
        Estimator().run(rows)


# -- estimate ---------------------------------------------------------------------------------


def test_the_function_and_the_command_give_the_same_bytes(tmp_path):
    gyr, acc, mag = flight_arrays()
    np.savez(tmp_path / "in.npz", imu_gyr=gyr, imu_acc=acc, imu_mag=mag, sampling_rate=100.0)
    words = ["estimate", "--in", str(tmp_path / "in.npz"), "--out", str(tmp_path / "out.npz")]
    assert main(words) == 0
    found = estimate(gyr, acc, rate_hz=100.0, mag=mag)
    with np.load(tmp_path / "out.npz") as file:
        assert set(file.files) == set(found.arrays())
        for name, values in found.arrays().items():
            assert file[name].tobytes() == values.tobytes(), name
    columns = found.columns()
    assert {len(column) for column in columns.values()} == {len(gyr)}
    roll = np.degrees(euler_columns(found.quat)[:, 0])
    np.testing.assert_array_equal(columns["roll_deg"], roll)
    np.testing.assert_allclose(columns["t"][1:], 0.01 * np.arange(1, len(gyr)), atol=1e-9)


def test_lists_times_files_and_objects_are_taken(tmp_path):
    gyr, acc, _ = flight_arrays(5.0)
    by_rate = estimate(gyr, acc, rate_hz=100.0, profile="fixed_wing")
    t = 3.0 + 0.01 * np.arange(len(gyr))
    by_time = estimate(gyr.tolist(), acc.tolist(), t=t, profile="fixed_wing")
    np.testing.assert_allclose(by_time.quat, by_rate.quat, atol=1e-9)
    (tmp_path / "own.toml").write_text("[fusion]\nairframe = 'fixed_wing'\n")
    by_file = estimate(gyr, acc, rate_hz=100.0, settings=tmp_path / "own.toml")
    own = config_file.load(tmp_path / "own.toml")
    by_object = estimate(gyr, acc, rate_hz=100.0, settings=own)
    assert by_object.quat.tobytes() == by_file.quat.tobytes()
    known = Calibration(gyro=TriadCalibration(bias=(0.01, 0.0, 0.0)))
    raw = gyr + np.array([0.01, 0.0, 0.0])
    shifted = estimate(raw, acc, rate_hz=100.0, settings=own, calibration=known)
    np.testing.assert_allclose(shifted.quat, by_object.quat, atol=1e-12)
    smoothed = estimate(gyr, acc, rate_hz=100.0, settings=own, offline=True)
    assert (smoothed.quat != by_object.quat).any()


STILL = np.zeros((50, 3))


@pytest.mark.parametrize(
    ("words", "match"),
    [
        ({"gyr": STILL, "acc": STILL}, "neither rate_hz nor t is given; give rate_hz in Hz"),
        ({"gyr": STILL, "acc": STILL[1:], "rate_hz": 1.0}, r"acc has shape \(49, 3\).* as gyr has"),
        ({"gyr": STILL, "acc": STILL, "rate_hz": -1.0}, "rate_hz = -1.0; give one number above 0"),
        (
            {"gyr": STILL, "acc": STILL, "t": np.zeros(50)},
            "t never rises; give seconds, or rate_hz",
        ),
        ({"gyr": STILL, "acc": STILL, "rate_hz": 9.0, "mag": STILL[0]}, r"mag has shape \(3,\)"),
        ({"gyr": [[0.0], [1.0, 2.0]], "acc": STILL, "rate_hz": 9.0}, "gyr is no array"),
        ({"gyr": STILL[:0], "acc": STILL[:0], "rate_hz": 9.0}, "gyr holds no sample"),
        ({"gyr": STILL, "acc": STILL, "rate_hz": 9.0, "frame": "enu"}, 'give "frd" or "flu"'),
        (
            {
                "gyr": STILL,
                "acc": STILL,
                "rate_hz": 9.0,
                "settings": Settings(),
                "profile": "hand_held",
            },
            "profile = 'hand_held' and settings",
        ),
    ],
)
def test_estimate_says_which_argument_cannot_be_used(words, match):
    with pytest.raises(InvalidValueError, match=match):
        estimate(**words)


def test_an_unknown_profile_names_those_there_are():
    with pytest.raises(ConfigError, match="bird: no such profile; known are fixed_wing"):
        estimate(STILL, STILL, rate_hz=9.0, profile="bird")


# -- columns ----------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [READING_DTYPE, SAMPLE_DTYPE, ESTIMATE_DTYPE])
def test_columns_hold_every_number_once(dtype):
    rows = empty(dtype, 7)
    for n, name in enumerate(dtype.names):
        rows[name] = n
    columns = as_columns(rows)
    assert {len(column) for column in columns.values()} == {7}
    numbers = sum(
        int(np.prod(dtype[name].shape, dtype=int)) for name in dtype.names if name != "reserved"
    )
    extra = 3 if dtype == ESTIMATE_DTYPE else 0
    assert len(columns) == numbers + extra
    assert all(column.flags.c_contiguous for column in columns.values())


def test_axes_are_named_by_what_they_are():
    rows = empty(SAMPLE_DTYPE, 1)
    rows["vehicle_from_board"][0] = np.arange(9.0).reshape(3, 3)
    rows["velocity_ned_m_s"][0] = (1.0, 2.0, 3.0)
    columns = as_columns(rows)
    assert columns["vehicle_from_board_xz"][0] == 2.0
    assert columns["vehicle_from_board_zx"][0] == 6.0
    assert columns["velocity_ned_m_s_east"][0] == 2.0
    assert "reserved" not in columns


def test_a_log_becomes_a_table_of_estimates(simulated_tlog):
    recording = read_recording(simulated_tlog)
    estimates = Estimator().take(recording.readings)
    columns = as_columns(estimates)
    assert {len(column) for column in columns.values()} == {len(estimates)}
    np.testing.assert_array_equal(columns["ned_from_body_w"], estimates["ned_from_body"][:, 0])
    np.testing.assert_array_equal(
        columns["yaw_rad"], euler_columns(estimates["ned_from_body"])[:, 2]
    )


# -- diagnose ---------------------------------------------------------------------------------


def test_columns_are_diagnosed_as_their_recording_is(tmp_path):
    path = tmp_path / "bench.tlog"
    request = Request("bench", "bench", 5, 40, level=3, effects=("gyro_scale_factor",))
    path.write_bytes(case_bytes(make(request)))
    observed = []
    of_file = diagnose(path, advance=lambda stage, share: observed.append((stage, share)))
    of_columns = diagnose(read_columns(path))
    assert of_columns.findings == of_file.findings
    assert {stage for stage, _ in observed} == {"reading", "searching"}
    assert [share for _, share in observed] == sorted(share for _, share in observed)


def test_columns_without_a_reference_are_refused():
    time_s = 0.01 * np.arange(500)
    still = np.zeros((500, 3))
    with pytest.raises(DiagnosisError, match="only 0 attitudes within the IMU's samples, too few"):
        diagnose(Recorded("own", time_s, still, still, Series(), Series()))
