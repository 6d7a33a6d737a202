import numpy as np
import pytest

from ahrs_service.records import Airframe
from ahrs_service.rotation import euler_columns, inverse_columns, multiply_columns
from ahrs_service.sensor.compensation import compensate_columns
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.forward import forward_columns
from ahrs_service.sensor.parameters import coefficients
from ahrs_service.simulation.environment import HOME_ALTITUDE_M, Propeller, Warmth, pressure_pa
from ahrs_service.simulation.imu import Imu, consumer_grade, seed_grade
from ahrs_service.simulation.phases import flight_phases, seed_flight_phases
from ahrs_service.simulation.samples import samples_of
from ahrs_service.simulation.scenario import SCENARIOS, make_flight

PHASES = [
    "warm-up",
    "take-off run",
    "climb",
    "climbing turn",
    "level",
    "circling",
    "pitch manoeuvres",
    "descending turn",
    "landing",
    "stopped",
]


@pytest.fixture(scope="module")
def flight():
    return make_flight("flight", 60.0, seed=3, rate_hz=200.0)


@pytest.mark.parametrize("seconds", [40.0, 60.0, 61.7, 500.0, 3600.0])
def test_a_plan_holds_every_phase_and_its_time(seconds):
    phases = flight_phases(seconds)
    assert sum(phase.seconds for phase in phases) == pytest.approx(seconds)
    assert list(dict.fromkeys(phase.name for phase in phases)) == PHASES
    assert min(phase.seconds for phase in phases) >= 1.0
    assert all(abs(phase.climb_deg) < 20.0 for phase in phases)


def test_the_seeds_flight_holds_its_manoeuvres_and_is_mostly_level():
    phases = seed_flight_phases(1200.0)
    names = {phase.name for phase in phases}
    assert names > {"take-off run", "landing", "coordinated turn", "circling", "pitch manoeuvres"}
    level_s = sum(phase.seconds for phase in phases if phase.name == "level")
    assert 0.5 < level_s / 1200.0 < 0.7
    assert sum(phase.seconds for phase in phases) == pytest.approx(1200.0)


def test_the_seeds_accelerometers_err_by_at_most_5_mg():
    """In any direction of gravity and at any temperature of its flight, noise apart."""
    row = coefficients(seed_grade().calibration)
    dice = np.random.default_rng(0)
    up = dice.normal(size=(2000, 3))
    force = 9.80665 * up / np.linalg.norm(up, axis=1, keepdims=True)
    _, given = forward_columns(row, np.zeros_like(force), force, dice.uniform(18.0, 33.0, 2000))
    worst_mg = 1e3 * np.abs(given - force).max() / 9.80665
    assert 3.0 < worst_mg < 5.0


def figures(triad, field):
    """A field of a calibration as numbers, a curve at its borders."""
    value = getattr(triad, field)
    return value.at(triad.breaks_degc()) if isinstance(value, Curve) else np.array(value)


def test_siblings_of_a_sensor_have_its_errors_as_their_sigma():
    nominal = consumer_grade()
    dice = np.random.default_rng(1)
    siblings = [nominal.sibling(dice).calibration for _ in range(400)]
    for name in ("gyro", "accel"):
        own = getattr(nominal.calibration, name)
        drawn = [getattr(one, name) for one in siblings]
        for field, base in (("matrix", np.eye(3)), ("bias", 0.0), ("b", 0.0), ("c", 0.0)):
            errors = np.array([figures(one, field) for one in drawn]) - base
            size = np.abs(figures(own, field) - base)
            np.testing.assert_allclose(errors.std(axis=0), size, rtol=0.15)
            np.testing.assert_allclose(errors.mean(axis=0), 0.0, atol=0.25 * size.max())
    assert Imu().sibling(dice) == Imu()


def test_another_sensor_flies_the_same_flight(flight):
    dice = np.random.default_rng(5)
    other = make_flight("flight", 60.0, 3, 200.0, consumer_grade().sibling(dice))
    np.testing.assert_array_equal(other.rows["ned_from_body"], flight.rows["ned_from_body"])
    assert (other.rows["accel_m_s2"] != flight.rows["accel_m_s2"]).all()
    assert other.calibration != flight.calibration


@pytest.mark.parametrize("magnetometer", [False, True])
def test_samples_are_the_flight_as_the_estimator_gets_it(flight, magnetometer):
    samples = samples_of(flight, Airframe.FIXED_WING, magnetometer)
    np.testing.assert_array_equal(np.diff(samples["time_ns"]), 5_000_000)
    np.testing.assert_array_equal(samples["gyro_rad_s"], flight.rows["gyro_rad_s"])
    np.testing.assert_array_equal(samples["accel_m_s2"], flight.rows["accel_m_s2"])
    assert np.isfinite(samples["mag_ut"]).all() == magnetometer
    assert np.isnan(samples["airspeed_m_s"]).all()
    assert set(samples["airframe"]) == {Airframe.FIXED_WING}


@pytest.mark.parametrize("seconds", [40.0, 60.0, 700.0])
def test_it_comes_down_and_stops(seconds):
    last = make_flight("flight", seconds, seed=2, rate_hz=20.0).rows[-1]
    assert abs(last["position_ned_m"][2]) < 0.005 * seconds + 1.0
    assert np.abs(last["velocity_ned_m_s"]).max() < 0.05


def test_the_same_seed_is_the_same_flight_and_another_is_not(flight):
    again = make_flight("flight", 60.0, seed=3, rate_hz=200.0)
    assert again.rows.tobytes() == flight.rows.tobytes()
    other = make_flight("flight", 60.0, seed=4, rate_hz=200.0)
    assert (other.rows["gyro_rad_s"] != flight.rows["gyro_rad_s"]).all()


def test_a_short_flight_is_cut_not_squeezed():
    short, whole = (make_flight("calm", seconds, rate_hz=50.0).rows for seconds in (20.0, 40.0))
    np.testing.assert_array_equal(short["ned_from_body"], whole["ned_from_body"][: len(short)])


def test_compensation_with_the_true_calibration_leaves_noise_alone(flight):
    """In the mean over the flight, where noise and vibration average out."""
    rows = coefficients(flight.calibration)
    gyro, accel = compensate_columns(
        rows, flight.rows["gyro_rad_s"], flight.rows["accel_m_s2"], flight.rows["imu_degc"]
    )
    truth = flight.rows["rate_rad_s"], flight.rows["force_m_s2"]
    raw = flight.rows["gyro_rad_s"], flight.rows["accel_m_s2"]
    for name, compensated, true, given, limit in zip(
        ("gyro", "accel"), (gyro, accel), truth, raw, (5e-4, 1.2e-2), strict=True
    ):
        left = np.abs((compensated - true).mean(axis=0))
        before = np.abs((given - true).mean(axis=0))
        assert left.max() < limit, name
        assert before.max() > 5.0 * left.max(), name


def test_a_calm_flight_measures_the_truth():
    rows = make_flight("calm", 40.0, rate_hz=50.0).rows
    np.testing.assert_array_equal(rows["gyro_rad_s"], rows["rate_rad_s"])
    np.testing.assert_array_equal(rows["accel_m_s2"], rows["force_m_s2"])


def test_the_imu_warms_up_by_the_first_order_law():
    rows = make_flight("rest", 60.0, rate_hz=50.0).rows
    warmth = Warmth(time_constant_s=15.0)
    law = warmth.ambient_degc + warmth.heating_k * (1.0 - np.exp(-rows["time_s"] / 15.0))
    np.testing.assert_allclose(rows["imu_degc"], law, atol=1e-4)


def test_the_autopilots_estimate_is_near_but_not_the_truth(flight):
    error = multiply_columns(
        inverse_columns(flight.rows["ned_from_body"]), flight.rows["estimate_ned_from_body"]
    )
    angle = np.degrees(2.0 * np.linalg.norm(error[:, 1:], axis=1))
    assert 0.1 < np.sqrt(np.mean(angle**2)) < 3.0
    assert np.degrees(np.abs(np.diff(euler_columns(error), axis=0))).max() < 0.5


def test_pressure_is_that_of_the_standard_atmosphere(flight):
    """ISO 2533: 1013.25 hPa at 0 m, 898.76 hPa at 1000 m, 794.95 hPa at 2000 m."""
    np.testing.assert_allclose(
        pressure_pa(np.array([0.0, 1000.0, 2000.0])), [101325.0, 89876.0, 79495.0], rtol=1e-4
    )
    altitude = HOME_ALTITUDE_M - flight.rows["position_ned_m"][:, 2]
    assert np.abs(flight.rows["pressure_pa"] - pressure_pa(altitude)).max() < 20.0


def test_vibration_above_half_the_rate_appears_as_its_alias():
    """A shaft at 90 Hz sampled at 100 Hz aliases to 10 Hz, its harmonic to 20 Hz."""
    propeller = Propeller(idle_hz=90.0, full_hz=90.0, harmonics=(1.0, 0.5))
    _, force = propeller.shake(np.full(1000, 1.0), 100.0, np.random.default_rng(0))
    size = np.abs(np.fft.rfft(force[:, 0]))
    assert set(np.argsort(size)[-2:]) == {100, 200}
    assert np.std(force) == pytest.approx(propeller.accel_m_s2, rel=0.01)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nowhere",), "nowhere.*flight"),
        (("flight", -1.0), "seconds = -1"),
        (("flight", float("nan")), "seconds = nan"),
        (("flight", 60.0, 1, 5000.0), "5000 Hz"),
    ],
)
def test_what_cannot_be_flown_is_named(arguments, words):
    with pytest.raises(ValueError, match=words):
        make_flight(*arguments)


@pytest.mark.parametrize("name", list(SCENARIOS))
def test_every_scenario_is_finite(name):
    rows = make_flight(name, 40.0, rate_hz=50.0).rows
    for field in rows.dtype.names:
        assert np.isfinite(rows[field]).all(), field
