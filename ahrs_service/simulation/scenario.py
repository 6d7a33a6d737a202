"""Named flights with known truth, ready to be sent: the same name and seed, the same flight."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from ahrs_service.errors import InvalidValueError
from ahrs_service.records import Floats, Rows
from ahrs_service.rotation import multiply_columns, quaternion_columns
from ahrs_service.sensor.noise import gauss_markov
from ahrs_service.sensor.parameters import Calibration
from ahrs_service.simulation import environment
from ahrs_service.simulation.imu import Imu, consumer_grade, seed_grade
from ahrs_service.simulation.phases import (
    Phase,
    circling_phases,
    command_curves,
    flight_phases,
    rest_phases,
    seed_flight_phases,
)
from ahrs_service.simulation.pose_sequence import PoseSequence, many_poses, six_positions
from ahrs_service.simulation.table_swings import Swing, table_phases
from ahrs_service.simulation.trajectory import TRUTH_DTYPE, Bumps, fly

FLIGHT_DTYPE: Final[np.dtype[Any]] = np.dtype(
    [
        *((name, TRUTH_DTYPE[name]) for name in TRUTH_DTYPE.names or ()),
        ("gyro_rad_s", "f8", 3),
        ("accel_m_s2", "f8", 3),
        ("imu_degc", "f4"),
        ("air_degc", "f4"),
        ("mag_ut", "f4", 3),
        ("pressure_pa", "f8"),
        ("pitot_pa", "f4"),
        ("estimate_ned_from_body", "f8", 4),
        ("vibration_m_s2", "f4", 3),
        ("current_a", "f4"),
    ]
)
"""The truth of a flight and what its sensors give: what links.simulated.autopilot sends.

`gyro_rad_s` and `accel_m_s2` come from the IMU, `pitot_pa` is the dynamic pressure,
`estimate_ned_from_body` the autopilot's own estimate, `vibration_m_s2` that of two seconds,
`current_a` the battery's.
"""

FASTEST_HZ: Final = 1000.0
_VIBRATION_S: Final = 2.0


@dataclass(frozen=True, slots=True)
class Scenario:
    """What is flown, by which sensor, in which weather; with a `bench`, what is done there.

    The unit warms up by `heating_k` [K] with a quarter of the flight as its time constant, or as
    `warmth` says.
    """

    text: str
    phases: Callable[[float], tuple[Phase, ...]]
    imu: Imu
    turbulence: float = 1.0
    wind_m_s: float = 4.0
    bench: Swing | PoseSequence | None = None
    heating_k: float = 15.0
    warmth: environment.Warmth | None = None


@dataclass(frozen=True, slots=True)
class Flight:
    """A flight in columns: `rows` [N] FLIGHT_DTYPE at `rate_hz`, phases, true calibration."""

    scenario: str
    seed: int
    rate_hz: float
    phases: tuple[Phase, ...]
    calibration: Calibration
    rows: Rows


def _table(text: str, swing: Swing) -> Scenario:
    """Return a scenario on the rate table: the small autopilot's IMU, no engine."""
    imu = replace(consumer_grade(), propeller=None)
    return Scenario(text, table_phases, imu, bench=swing)


def _bench(text: str, poses: PoseSequence) -> Scenario:
    """Return a scenario on a table: the small autopilot's IMU, warm, no engine."""
    imu = replace(consumer_grade(), propeller=None)
    return Scenario(text, poses.phases, imu, bench=poses, heating_k=0.0)


SCENARIOS: Final = {
    "flight": Scenario(
        "warm-up, take-off run, climbing turns, circling, pitch manoeuvres, landing",
        flight_phases,
        consumer_grade(),
    ),
    "calm": Scenario(
        "the same flight with a perfect sensor, no vibration and no wind",
        flight_phases,
        Imu(),
        turbulence=0.0,
        wind_m_s=0.0,
    ),
    "circling": Scenario("a flight that is nearly all one turn", circling_phases, consumer_grade()),
    "rest": Scenario("warm-up on the ground", rest_phases, consumer_grade()),
    "rate-table": _table(
        "a rate table swings the sensor in roll by 80 deg, at up to 200 deg/s",
        Swing((1.0, 0.0, 0.0)),
    ),
    "rate-table-pitch": _table("the same in pitch", Swing((0.0, 1.0, 0.0))),
    "rate-table-heading": _table("the same in heading", Swing((0.0, 0.0, 1.0))),
    "rate-table-oblique": _table("the same about all axes at once", Swing((1.0, 1.0, 1.0))),
    "six-position": _bench(
        "the unit on each of its six faces, with full circles on three; of 100 s or longer",
        six_positions(),
    ),
    "multi-pose": _bench("twenty poses by hand; of 120 s or longer", many_poses()),
    "seed-flight": Scenario(
        "the manoeuvres and the sensor errors of Liu et al., two thirds of it level",
        seed_flight_phases,
        seed_grade(),
    ),
}


def make_flight(
    name: str = "flight",
    seconds: float = 60.0,
    seed: int = 1,
    rate_hz: float = 400.0,
    imu: Imu | None = None,
) -> Flight:
    """Return the flight of a scenario, the same for the same arguments.

    From 40 s on it holds every phase; a shorter one is cut off in the air. An `imu` stands in
    for the scenario's own. ValueError for a name, length or rate that cannot be.
    """
    if name not in SCENARIOS:
        raise InvalidValueError(f"scenario = {name!r}: choose one of {', '.join(SCENARIOS)}")
    return fly_scenario(name, SCENARIOS[name], seconds, seed, rate_hz, imu)


def fly_scenario(
    name: str,
    scenario: Scenario,
    seconds: float,
    seed: int,
    rate_hz: float,
    imu: Imu | None = None,
) -> Flight:
    """Return the flight of a scenario that may be the caller's own, see `make_flight`."""
    if not (0.0 < seconds < math.inf):
        raise InvalidValueError(f"seconds = {seconds:g}: give the length of the flight, such as 60")
    if not 1.0 <= rate_hz <= FASTEST_HZ:
        raise InvalidValueError(f"rate = {rate_hz:g} Hz: choose 1 to {FASTEST_HZ:g} Hz")
    imu = scenario.imu if imu is None else imu
    phases = scenario.phases(seconds)
    # One generator per part: a change in one does not shift the dice of the others.
    dice = [np.random.default_rng([seed, part]) for part in range(4)]
    time_s = np.arange(math.floor(seconds * rate_hz) + 1) / rate_hz
    bearing, heading = dice[1].uniform(-np.pi, np.pi, 2)
    if scenario.bench is not None:
        truth = scenario.bench.truth(phases, float(heading), time_s)
    else:
        curves = command_curves(phases, scenario.turbulence, dice[0])
        wind = scenario.wind_m_s * np.array([math.cos(bearing), math.sin(bearing), 0.0])
        truth = fly(curves, Bumps.draw(dice[1]), wind, float(heading), time_s)
    warmth = scenario.warmth or environment.Warmth(
        heating_k=scenario.heating_k, time_constant_s=0.25 * seconds
    )
    rows = _sense(truth, imu, warmth, rate_hz, dice[2])
    rows["estimate_ned_from_body"] = _estimate(truth, rate_hz, dice[3])
    return Flight(name, seed, rate_hz, phases, imu.calibration, rows)


def _sense(
    truth: Rows, imu: Imu, warmth: environment.Warmth, rate_hz: float, rng: np.random.Generator
) -> Rows:
    """Return the flight's rows with all sensors filled in."""
    count = len(truth)
    rows = np.zeros(count, FLIGHT_DTYPE)
    for name in TRUTH_DTYPE.names or ():
        rows[name] = truth[name]
    temperature = warmth.of_imu(truth, rate_hz)
    current_a = environment.battery_current_a(truth["throttle"])
    gyro, accel = imu.measure(truth, temperature, rate_hz, rng, current_a)
    altitude = environment.HOME_ALTITUDE_M - truth["position_ned_m"][:, 2]
    rows["gyro_rad_s"], rows["accel_m_s2"] = gyro, accel
    rows["imu_degc"], rows["current_a"] = temperature, current_a
    rows["air_degc"] = warmth.ambient(truth) + 6.0
    rows["mag_ut"] = environment.magnetic_field_ut(truth) + rng.normal(0.0, 0.3, (count, 3))
    rows["pressure_pa"] = environment.pressure_pa(altitude) + rng.normal(0.0, 3.0, count)
    rows["pitot_pa"] = environment.dynamic_pressure_pa(
        truth["airspeed_m_s"] + rng.normal(0.0, 0.2, count)
    )
    rows["vibration_m_s2"] = _deviation(accel - truth["force_m_s2"], rate_hz)
    return rows


def _deviation(values: Floats, rate_hz: float) -> Floats:
    """Running standard deviation [N, 3] over the last two seconds."""
    width = min(max(1, round(_VIBRATION_S * rate_hz)), len(values))
    sums = np.cumsum(np.concatenate([np.zeros((1, 3)), values]), axis=0)
    squares = np.cumsum(np.concatenate([np.zeros((1, 3)), values**2]), axis=0)
    begin = np.maximum(np.arange(1, len(values) + 1) - width, 0)
    count = (np.arange(1, len(values) + 1) - begin)[:, None]
    mean = (sums[1:] - sums[begin]) / count
    return np.sqrt(np.maximum((squares[1:] - squares[begin]) / count - mean**2, 0.0))


def _estimate(truth: Rows, rate_hz: float, rng: np.random.Generator) -> Floats:
    """Attitude [N, 4] as an autopilot estimates it: truth with a slow error of some 0.3 deg."""
    error = np.empty((len(truth), 3))
    error[:, :2] = gauss_markov(rng, (len(truth), 2), math.radians(0.3), 15.0, rate_hz)
    error[:, 2:] = gauss_markov(rng, (len(truth), 1), math.radians(1.0), 40.0, rate_hz)
    return multiply_columns(quaternion_columns(error), truth["ned_from_body"])
