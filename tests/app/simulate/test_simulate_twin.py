"""simulate with twins and along recordings: the output follows the effects."""

from pathlib import Path

import numpy as np
import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.diagnose.loaded_recording import load
from ahrs_service.app.files import twin_file
from ahrs_service.app.simulate.retrace_recording import flight_along
from ahrs_service.effects.catalogue import EFFECTS, effect_of
from ahrs_service.simulation.effect_inputs import columns_of
from ahrs_service.simulation.environment import battery_current_a
from ahrs_service.simulation.imu import Imu, consumer_grade
from ahrs_service.simulation.scenario import make_flight

TWIN = Path(__file__).parents[3] / "configs" / "twins" / "small_autopilot.toml"


def with_effect(identifier, **values):
    effect = effect_of(identifier)
    return Imu(effects=((effect, effect.checked(values)),))


def test_every_effect_at_zero_leaves_the_simulated_readings_bitwise():
    neutral = tuple((effect, effect.neutral()) for effect in EFFECTS.values())
    plain = make_flight("flight", 10.0, 2, 100.0, Imu()).rows
    twin = make_flight("flight", 10.0, 2, 100.0, Imu(effects=neutral)).rows
    assert twin.tobytes() == plain.tobytes()


def test_the_twins_effects_are_in_the_readings():
    plain = make_flight("flight", 60.0, 2, 100.0, Imu()).rows
    imu = with_effect("accel_vibration_rectification", per_vibration_variance=[0.1, 0.0, -0.2])
    shaken = Imu(propeller=consumer_grade().propeller)
    quiet = make_flight("flight", 60.0, 2, 100.0, imu).rows
    assert quiet.tobytes() == plain.tobytes()
    loud = make_flight("flight", 60.0, 2, 100.0, Imu(propeller=shaken.propeller)).rows
    both = make_flight(
        "flight", 60.0, 2, 100.0, Imu(propeller=shaken.propeller, effects=imu.effects)
    ).rows
    level = shaken.propeller.level_m_s2(plain["throttle"])
    expected = level[:, None] ** 2 * [0.1, 0.0, -0.2]
    np.testing.assert_allclose(both["accel_m_s2"] - loud["accel_m_s2"], expected, atol=1e-12)
    assert np.abs(expected).max() > 0.1
    # The vibration reported by the autopilot equals the simulated one within a few percent.
    reported = loud["vibration_m_s2"].mean(axis=1)[500:-500]
    assert np.median(reported / level[500:-500]) == pytest.approx(1.0, abs=0.05)


def test_current_and_lever_arm_act_as_the_flight_says():
    plain = make_flight("flight", 60.0, 2, 100.0, Imu()).rows
    imu = with_effect("gyro_current_coupling", per_ampere=[1e-4, 0.0, 0.0])
    moved = make_flight("flight", 60.0, 2, 100.0, imu).rows
    added = (moved["gyro_rad_s"] - plain["gyro_rad_s"])[:, 0]
    np.testing.assert_allclose(added, 1e-4 * battery_current_a(plain["throttle"]), atol=1e-15)
    effect, values = with_effect("accel_lever_arm", arm_m=[0.1, 0.0, 0.05]).effects[0]
    still = np.zeros(len(plain))
    columns = columns_of(plain, still, 100.0, still, still)
    arm = make_flight("flight", 60.0, 2, 100.0, Imu(effects=((effect, values),))).rows
    added = arm["accel_m_s2"] - plain["accel_m_s2"]
    np.testing.assert_allclose(added, effect.add(columns, values).accel, atol=1e-12)


@pytest.fixture(scope="module")
def calm_tlog(tmp_path_factory):
    path = tmp_path_factory.mktemp("calm") / "calm.tlog"
    assert main(["simulate", "--scenario", "calm", "--tlog", str(path)]) == 0
    return path


def test_the_prediction_from_a_flights_own_reference_is_its_imu(calm_tlog):
    """The recorded truth, 50 Hz in float32, gives back the readings of the perfect sensor."""
    flight, notes = flight_along(calm_tlog, Imu(), 200.0, 1)
    assert "reference: SIM_STATE" in notes
    measured = load(calm_tlog).columns
    begin_s = float(notes[-1].split()[1])
    time_s = begin_s + flight.rows["time_s"]
    at = np.searchsorted(measured.imu_time_s, time_s - 1e-3)
    np.testing.assert_allclose(measured.imu_time_s[at], time_s, atol=2e-6)
    truth = make_flight("calm", 60.0, 1, 400.0).rows
    airborne = np.interp(time_s - measured.imu_time_s[0], truth["time_s"], truth["airborne"]) > 0.99
    rate = flight.rows["gyro_rad_s"] - measured.gyro_rad_s[at]
    force = flight.rows["accel_m_s2"] - measured.accel_m_s2[at]
    # float32 of 0.7 and of 20 m/s, differentiated over 20 ms: 3e-6 rad/s and 1e-4 m/s^2; the
    # microsecond of the stamps at 10 m/s^3 and the spline itself are below.
    assert np.abs(rate[airborne]).max() < 1e-4
    assert np.abs(force[airborne]).max() < 3e-3


def test_a_recording_is_flown_with_the_twins_sensor_and_its_own_temperature(calm_tlog, tmp_path):
    path = tmp_path / "twin.tlog"
    arguments = ["simulate", "--from", str(calm_tlog), "--twin", str(TWIN), "--rate", "250"]
    assert main([*arguments, "--tlog", str(path)]) == 0
    twin, source = load(path).columns, load(calm_tlog).columns
    time_s = np.arange(10.0, 50.0)
    np.testing.assert_allclose(
        twin.temperature_degc.at(time_s),
        source.temperature_degc.at(time_s + source.attitude.time_s[0] - twin.attitude.time_s[0]),
        atol=0.05,
    )
    again = tmp_path / "again.tlog"
    assert main([*arguments, "--tlog", str(again)]) == 0
    assert again.read_bytes() == path.read_bytes()


def test_a_twin_is_written_and_read_as_it_was(tmp_path):
    twin = twin_file.read(TWIN)
    assert [effect.id for effect, _ in twin.effects] == [
        "accel_vibration_rectification",
        "gyro_thermal_bias",
    ]
    known = Imu(
        consumer_grade().calibration,
        twin.gyro_noise,
        twin.accel_noise,
        twin.propeller,
        twin.effects,
    )
    path = tmp_path / "again.toml"
    sigmas = {"gyro_thermal_bias": {"linear": [1e-5, 1e-5, 1e-5]}}
    twin_file.write(path, known, 'a "test"', sigmas)
    again = twin_file.read(path)
    assert again.calibration == known.calibration
    assert again.gyro_noise == known.gyro_noise
    assert again.propeller == known.propeller
    for (effect, values), (other, expected) in zip(again.effects, twin.effects, strict=True):
        assert effect == other
        assert {k: v.tolist() for k, v in values.items()} == {
            k: v.tolist() for k, v in expected.items()
        }
    assert [file.name for file in tmp_path.iterdir()] == ["again.toml"]


@pytest.mark.parametrize("identifier", EFFECTS)
def test_every_effect_can_be_written_and_read(identifier, tmp_path):
    effect = effect_of(identifier)
    path = tmp_path / "one.toml"
    twin_file.write(path, Imu(effects=((effect, effect.neutral()),)), "test")
    ((again, values),) = twin_file.read(path).effects
    assert again == effect
    for name, value in effect.neutral().items():
        np.testing.assert_array_equal(values[name], value)


def entry(text):
    return f'[[effects]]\nid = "accel_vibration_rectification"\n{text}'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[[effects]]\nid = "gyro_gremlins"', "gyro_gremlins is no known effect"),
        ("[[effects]]\nk = 1.0", "effects.0.id: is missing"),
        (entry("k = [1.0, 0.0, 0.0]"), "no parameter k; there are per_vibration_variance"),
        (entry("per_vibration_variance = 1.0"), "per_vibration_variance: 1.0 has"),
        (
            entry('per_vibration_variance=[1.0,0.0,0.0]\nunits={per_vibration_variance="g"}'),
            "units.per_vibration_variance = 'g'",
        ),
        (entry("per_vibration_variance=['a',0.0,0.0]"), "could not convert string"),
        (
            '[[effects]]\nid="gyro_low_pass"\ncutoff_hz=-3.0',
            "gyro_low_pass.cutoff_hz = -3.0: give 0.5 to 400 Hz",
        ),
        ("[gyro_noise]\ndensity = -1.0", "gyro_noise.density = -1.0"),
        ("[gyro_nose]\ndensity = 1.0", "gyro_nose: no such field"),
    ],
)
def test_a_twin_that_cannot_be_is_reported(text, words, tmp_path, capsys):
    path, out = tmp_path / "twin.toml", tmp_path / "x.tlog"
    path.write_text(text)
    assert main(["simulate", "--twin", str(path), "--tlog", str(out)]) == 2
    message = capsys.readouterr().err
    assert str(path) in message
    assert words in message
    assert not out.exists()


def test_an_effect_without_what_it_needs_is_reported(calm_tlog, tmp_path, capsys):
    path, out = tmp_path / "twin.toml", tmp_path / "x.tlog"
    path.write_text('[[effects]]\nid="gyro_thermal_rate"\nper_degC_per_s=[nan, 0.0, 0.0]')
    assert main(["simulate", "--twin", str(path), "--tlog", str(out)]) == 2
    assert "per_degC_per_s" in capsys.readouterr().err


def test_a_recording_without_reference_is_refused(tmp_path, capsys):
    path = tmp_path / "none.tlog"
    arguments = ["simulate", "--from", str(path), "--tlog", str(tmp_path / "x.tlog")]
    assert main(arguments) == 1
    assert f"{path}: no such file" in capsys.readouterr().err


def test_a_twin_that_cannot_be_written_is_reported(tmp_path):
    place = tmp_path / "missing" / "twin.toml"
    with pytest.raises(Exception, match=r"cannot be written: .*; give a writable path"):
        twin_file.write(place, Imu(), "test")
