"""The paper's two benches: a two-axis table at room temperature, a one-axis table in a chamber.

The unit goes on the room's table once, and that table is aligned. In the chamber one axis rotates,
so the unit is mounted three times, with its x, y and z along that axis, and each mounting is off by
up to 1.5 degrees about each axis from what the procedure assumes: the second mounting of
Liu et al., sec. 2.2.1. The chamber heats and cools; the elements follow its air, and elements and
thermometer follow each other with an unknown lag.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.records import Floats, Integers
from ahrs_service.sensor.forward import forward_columns
from ahrs_service.sensor.noise import TriadNoise, first_order, sensor_noise
from ahrs_service.sensor.parameters import Calibration, coefficients

from .thermal_parts import ROOM_DEGC, draw_unit

Booleans = npt.NDArray[np.bool_]

SAMPLE_HZ: Final = 10.0
HOLD_S: Final = 10.0
BOX_S: Final = 300.0
"""Time constant of the elements: the unit is near steady after 300 s (Liu et al., fig. 7)."""
RATE_RAD_S: Final = math.radians(100.0)
LARGEST_LAG_S: Final = 30.0
"""A ceramic package of half a gram (0.4 J/K) on a board (75 K/W) follows it in some 30 s."""
MOUNTING_RAD: Final = math.radians(1.5)

_GYRO_NOISE: Final = TriadNoise(density=math.radians(0.02), wander=math.radians(0.005))
_ACCEL_NOISE: Final = TriadNoise(density=2e-3, wander=1e-3)
_DOWN: Final = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])


@dataclass(frozen=True, slots=True)
class Holds:
    """Means over holds [N] of HOLD_S: what the unit gave, what it was meant to feel, and felt.

    `thermometer_degc` [N, M] is what the thermometer showed at each sample, `temperature_degc` [N]
    the mean of it; `hold` [N] numbers what the table was commanded, alike for like commands;
    `is_still` [N] where the table stood. The `true_` columns are for judging alone.
    """

    time_s: Floats
    thermometer_degc: Floats
    temperature_degc: Floats
    gyro_rad_s: Floats
    accel_m_s2: Floats
    mounting: Integers
    hold: Integers
    is_still: Booleans
    nominal_rate_rad_s: Floats
    nominal_force_m_s2: Floats
    true_rate_rad_s: Floats
    true_force_m_s2: Floats


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit on the bench.

    `truth` its parts; `lag_s` of the elements behind the thermometer [s], negative for a
    thermometer that comes after; noise; steps of the outputs; `repeat` 1-sigma by which the bias of
    a run differs from that of another; thermometer noise 1-sigma and step [degC].
    """

    truth: Calibration
    lag_s: float
    gyro_noise: TriadNoise = _GYRO_NOISE
    accel_noise: TriadNoise = _ACCEL_NOISE
    gyro_step_rad_s: float = math.radians(1.0 / 65.5)
    accel_step_m_s2: float = STANDARD_GRAVITY_M_S2 / 8192.0
    gyro_repeat_rad_s: float = math.radians(0.01)
    accel_repeat_m_s2: float = 0.3e-3 * STANDARD_GRAVITY_M_S2
    thermometer_noise_degc: float = 0.02
    thermometer_step_degc: float = 0.0625


def draw(seed: int) -> tuple[Unit, "Bench"]:
    """Return a unit and the bench's faults: its lag either way, three mountings."""
    rng = np.random.default_rng([seed, 4])
    lag_s = float(rng.uniform(5.0, LARGEST_LAG_S) * rng.choice([-1.0, 1.0]))
    turns = rng.uniform(-MOUNTING_RAD, MOUNTING_RAD, (3, 3))
    return Unit(draw_unit(rng), lag_s), Bench(turns, rng)


@dataclass(frozen=True, slots=True)
class Bench:
    """Both tables and the chamber; `mounting_rotations` [3, 3] rotation vectors of the faults."""

    mounting_rotations: Floats
    rng: np.random.Generator

    def room(self, unit: Unit) -> Holds:
        """Six still positions and six rates, along each axis both ways, at room temperature."""
        axes = np.concatenate([np.eye(3), -np.eye(3)])
        force = np.concatenate([axes * STANDARD_GRAVITY_M_S2, np.tile(-_DOWN, (6, 1))])
        rate = np.concatenate([np.zeros((6, 3)), axes * RATE_RAD_S])
        # A minute each: the holds of the table follow one another.
        force, rate = (np.repeat(x, 6, axis=0) for x in (force, rate))
        air = np.full(len(rate) * round(HOLD_S * SAMPLE_HZ), ROOM_DEGC)
        still = np.repeat(np.arange(12) < 6, 6)
        hold = np.repeat(np.arange(12), 6)
        holds = self._measure(unit, air, rate, force, hold, still)
        return replace(holds, nominal_rate_rad_s=rate, nominal_force_m_s2=force)

    def chamber(self, unit: Unit, degc_per_min: float = 1.0) -> list[Holds]:
        """Three mountings; in each the chamber heats and cools, the table cycles its holds.

        A cycle is still at 0, 90, 180, 270 degrees and turns both ways, 10 s each: the axis is
        horizontal, so a turn averages gravity out, and its accelerations are not used.
        """
        air = _heat_and_cool(degc_per_min)
        runs = []
        for axis in range(3):
            rate, force, hold, still = _cycle(axis, len(air) // round(HOLD_S * SAMPLE_HZ))
            turn = Rotation.from_rotvec(self.mounting_rotations[axis])
            run = self._measure(unit, air, turn.apply(rate), turn.apply(force), hold, still)
            run = replace(
                run,
                nominal_rate_rad_s=rate,
                nominal_force_m_s2=force,
                mounting=np.full(len(rate), axis),
            )
            runs.append(run)
        return runs

    def validation(self, unit: Unit, degc_per_min: float = 3.0) -> Holds:
        """Return a separate run: faster, in other attitudes and rates, all of them known."""
        air = _heat_and_cool(degc_per_min)
        count = len(air) // round(HOLD_S * SAMPLE_HZ)
        force = Rotation.random(count, rng=self.rng).apply(_DOWN)
        still = self.rng.random(count) < 0.5
        rate = self.rng.uniform(-1.0, 1.0, (count, 3)) * RATE_RAD_S
        rate[still] = 0.0
        holds = self._measure(unit, air, rate, force, np.arange(count), still)
        return replace(holds, nominal_rate_rad_s=rate, nominal_force_m_s2=force)

    def _measure(
        self, unit: Unit, air: Floats, rate: Floats, force: Floats, hold: Integers, still: Booleans
    ) -> Holds:
        """Sample a run at SAMPLE_HZ and return the means of its holds."""
        rng, size = self.rng, round(HOLD_S * SAMPLE_HZ)
        element, thermometer = _temperatures(unit, air, rng)
        gyro, accel = forward_columns(
            coefficients(unit.truth),
            np.repeat(rate, size, axis=0),
            np.repeat(force, size, axis=0),
            element,
        )
        gyro += sensor_noise(rng, len(air), SAMPLE_HZ, unit.gyro_noise)
        accel += sensor_noise(rng, len(air), SAMPLE_HZ, unit.accel_noise)
        gyro += rng.normal(0.0, unit.gyro_repeat_rad_s, 3)
        accel += rng.normal(0.0, unit.accel_repeat_m_s2, 3)
        return Holds(
            time_s=np.arange(0.5, len(rate)) * HOLD_S,
            thermometer_degc=thermometer.reshape(-1, size),
            temperature_degc=_means(thermometer, size),
            gyro_rad_s=_means(_stepped(gyro, unit.gyro_step_rad_s), size),
            accel_m_s2=_means(_stepped(accel, unit.accel_step_m_s2), size),
            mounting=np.zeros(len(rate), np.int64),
            hold=hold,
            is_still=still,
            nominal_rate_rad_s=rate,
            nominal_force_m_s2=force,
            true_rate_rad_s=rate,
            true_force_m_s2=force,
        )


def _heat_and_cool(degc_per_min: float) -> Floats:
    """Air [N] of a chamber at SAMPLE_HZ: soak at -40, heat to 70, soak, cool to -40, soak."""
    ramp_s, soak_s = 110.0 / degc_per_min * 60.0, 5.0 * BOX_S
    corners = np.cumsum([0.0, ramp_s, soak_s, ramp_s, soak_s])
    count = int(corners[-1] // HOLD_S) * round(HOLD_S * SAMPLE_HZ)
    times = np.arange(count) / SAMPLE_HZ
    return np.interp(times, corners, [-40.0, 70.0, 70.0, -40.0, -40.0])


def _temperatures(unit: Unit, air: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Temperatures [N] of the elements and as the thermometer reads them."""
    first = _followed(air, BOX_S)
    second = _followed(first, abs(unit.lag_s))
    element, thermometer = (second, first) if unit.lag_s > 0.0 else (first, second)
    noisy = thermometer + rng.normal(0.0, unit.thermometer_noise_degc, len(air))
    return element, _stepped(noisy, unit.thermometer_step_degc)


def _followed(temperature: Floats, time_constant_s: float) -> Floats:
    """First-order response [N] to a temperature [N], steady at first."""
    keep = math.exp(-1.0 / (time_constant_s * SAMPLE_HZ))
    drive = (1.0 - keep) * temperature[:, None]
    drive[0] = temperature[0]
    return first_order(drive, keep)[:, 0]


def _cycle(axis: int, count: int) -> tuple[Floats, Floats, Integers, Booleans]:
    """Rates, forces, hold numbers and stillness [count] of a table whose axis is a body axis."""
    hold = np.arange(count) % 6
    still = hold < 4
    along, other = np.eye(3)[axis], np.eye(3)[(axis + 1) % 3]
    angle = np.where(still, hold, 0) * 0.5 * math.pi
    turns = Rotation.from_rotvec(angle[:, None] * along)
    force = turns.apply(other * STANDARD_GRAVITY_M_S2)
    force[~still] = 0.0
    sign = np.select([hold == 4, hold == 5], [1.0, -1.0])
    return sign[:, None] * along * RATE_RAD_S, force, hold, still


def _stepped(values: Floats, step: float) -> Floats:
    return np.round(values / step) * step


def _means(values: Floats, size: int) -> Floats:
    blocks = values.reshape(len(values) // size, size, *values.shape[1:])
    mean: Floats = blocks.mean(axis=1)
    return mean
