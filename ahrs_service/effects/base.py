"""What a physical effect is: an equation, its parameters, and what it adds to the ideal reading.

Adding physics is adding a file beside this one and naming it in `catalogue`. The simulator adds
an effect, diagnosis fits it and compensation takes it away again, all by the same `add`.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar, Final, Literal

import numpy as np

from ahrs_service.records import Floats

Triad = Literal["gyro", "accel", "imu"]
Values = Mapping[str, Floats]
"""Parameters of one effect by name, each an array of its parameter's shape (a number is [])."""

REFERENCE_DEGC: Final = 25.0
"""Where thermal effects are zero unless a twin says otherwise (MPU-6000 data sheet: at 25 degC)."""

PER_AXIS: Final = (3,)
MATRIX: Final = (3, 3)


@dataclass(frozen=True, slots=True)
class Columns:
    """What acts on an IMU at N instants; a covariate that is not known is NaN throughout.

    `time_s` [N] on the clock of the recording, `since_power_on_s` [N]; ideal `rate_rad_s` and
    `force_m_s2` [N, 3] at the reference point in body axes, `angular_acceleration_rad_s2` [N, 3];
    `temperature_degc` [N] the IMU's own as it reports it, `temperature_slope_degc_s` [N] its slope;
    `vibration_m_s2` [N] 1-sigma of the vibration, mean of the three axes; `current_a` [N] of the
    battery; `throttle` [N] 0 to 1; `airspeed_m_s` [N]; `ned_from_body` [N, 4]. `scatter` [N, 6]
    1-sigma of what the readings (gyro, accel) hold beside this motion, where it is left out of it.
    `supply_v` [N] of the battery, `altitude_m` [N] above where the recording begins.
    """

    time_s: Floats
    since_power_on_s: Floats
    rate_rad_s: Floats
    force_m_s2: Floats
    angular_acceleration_rad_s2: Floats
    temperature_degc: Floats
    temperature_slope_degc_s: Floats
    vibration_m_s2: Floats
    current_a: Floats
    throttle: Floats
    airspeed_m_s: Floats
    ned_from_body: Floats
    scatter: Floats | None = None
    supply_v: Floats | None = None
    altitude_m: Floats | None = None

    def knows(self, name: str) -> bool:
        """Whether the covariate `name` is there at every instant."""
        return bool(np.isfinite(getattr(self, name)).all())


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of an effect.

    `shape` () or (3,) or (3, 3); `plausible` the largest size that data sheets or measurements
    give it, with `source`; `neutral` the value at which the effect is zero (NaN: not there at all);
    `step` a size at which the response is linear. Parameters that enter by their `grid` change
    the form of the response and are searched over, in whole numbers with `is_whole`; those without
    step or grid are conventions that keep their `default`. `is_off_diagonal` leaves the diagonal of
    a matrix at zero. `form_share` is by how much of its size (1 sigma) it depends on the form that
    nature gives the effect.
    """

    name: str
    unit: str
    shape: tuple[int, ...]
    plausible: float
    source: str
    neutral: float = 0.0
    step: float = 0.0
    grid: tuple[float, ...] = ()
    default: float = 0.0
    bounds: tuple[float, float] = (-np.inf, np.inf)
    is_off_diagonal: bool = False
    is_whole: bool = False
    form_share: float = 0.0

    def entries(self) -> list[tuple[int, ...]]:
        """Return the indices of the numbers that are free."""
        return [
            index
            for index in np.ndindex(self.shape)
            if not (self.is_off_diagonal and index[0] == index[1])
        ]

    def array(self, values: object) -> Floats:
        """Return `values` as an array of this parameter's shape; ValueError names what is wrong."""
        array = np.asarray(values, np.float64)
        if array.shape != self.shape:
            raise ValueError(
                f"{self.name}: {values} has shape {array.shape}; give {self.shape or 'a number'}"
            )
        return array


@dataclass(frozen=True, slots=True)
class Addition:
    """What an effect adds to the ideal reading: `gyro` [N, 3] [rad/s], `accel` [N, 3] [m/s^2].

    None where the effect leaves the triad alone.
    """

    gyro: Floats | None = None
    accel: Floats | None = None


@dataclass(frozen=True)
class Effect(ABC):
    """A physical effect on one triad or on both; `name` without the triad's prefix.

    `needs` the covariates of Columns without which it cannot be computed. `has_inverse` where the
    ideal reading can be found again from the reading of the same instant. `is_limit` where it cuts
    off what lies beyond its one parameter. `is_constant` where in flight it is a constant attitude
    error in body axes, as the reference's own is that lasts.
    """

    triad: Triad

    name: ClassVar[str]
    title: ClassVar[str]
    equation: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()
    excited_by: ClassVar[str]
    taken_for: ClassVar[tuple[str, ...]] = ()
    separated_by: ClassVar[str]
    has_inverse: ClassVar[bool] = True
    is_limit: ClassVar[bool] = False
    is_constant: ClassVar[bool] = False

    @property
    def id(self) -> str:
        """Name in the catalogue: `gyro_thermal_bias`."""
        return f"{self.triad}_{self.name}"

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """What the equation's letters are."""

    @abstractmethod
    def add(self, columns: Columns, values: Values) -> Addition:
        """Return what the effect adds to the ideal reading in `columns`."""

    def grid(self, columns: Columns) -> list[dict[str, float]]:
        """Return the forms of the response to search over: one without such parameters."""
        forms = [p for p in self.parameters if p.grid]
        points = product(*(p.grid for p in forms))
        return [{p.name: v for p, v in zip(forms, point, strict=True)} for point in points]

    def neutral(self) -> dict[str, Floats]:
        """Return parameters at which the effect is zero."""
        return {
            p.name: np.full(p.shape, p.neutral if p.step or p.grid else p.default)
            for p in self.parameters
        }

    def checked(self, values: Mapping[str, object]) -> dict[str, Floats]:
        """Return complete parameters from what a twin gives; ValueError names the unknown one."""
        known = {p.name: p for p in self.parameters}
        for name in values:
            if name not in known:
                raise ValueError(f"{self.id}: no parameter {name}; there are {', '.join(known)}")
        complete = self.neutral()
        for name, value in values.items():
            complete[name] = known[name].array(value)
        return complete

    def on_triad(self, added: Floats) -> Addition:
        """Return the addition to this effect's own triad."""
        return Addition(gyro=added) if self.triad == "gyro" else Addition(accel=added)

    def ideal(self, columns: Columns) -> Floats:
        """Return the ideal reading [N, 3] of this effect's own triad."""
        return columns.rate_rad_s if self.triad == "gyro" else columns.force_m_s2


def apply(columns: Columns, effects: list[tuple[Effect, Values]]) -> tuple[Floats, Floats]:
    """Return the readings (gyro [N, 3], accel [N, 3]) of an IMU with these effects.

    Every effect acts on the ideal reading, and the additions are summed. Where they are zero the
    ideal reading is returned bit for bit.
    """
    gyro, accel = columns.rate_rad_s.copy(), columns.force_m_s2.copy()
    for effect, values in effects:
        addition = effect.add(columns, values)
        _add(gyro, addition.gyro)
        _add(accel, addition.accel)
    return gyro, accel


def _add(reading: Floats, addition: Floats | None) -> None:
    if addition is not None:
        # Adding 0.0 would turn a reading of -0.0 into 0.0.
        np.add(reading, addition, out=reading, where=addition != 0.0)


def remove(
    columns: Columns, effects: list[tuple[Effect, Values]], iterations: int = 12
) -> tuple[Floats, Floats]:
    """Return the ideal readings where `columns` holds the measured ones: the inverse of `apply`.

    Fixed-point iteration u <- measured - added(u), which gains a factor of the effect's slope per
    iteration (2 % or less by the data sheets). Only effects with an inverse may be given.
    """
    for effect, _ in effects:
        if not effect.has_inverse:
            raise ValueError(f"{effect.id}: has no inverse at one instant; leave it out")
    measured_gyro, measured_accel = columns.rate_rad_s, columns.force_m_s2
    for _ in range(iterations):
        gyro, accel = apply(columns, effects)
        columns = replace(
            columns,
            rate_rad_s=measured_gyro - (gyro - columns.rate_rad_s),
            force_m_s2=measured_accel - (accel - columns.force_m_s2),
        )
    return columns.rate_rad_s, columns.force_m_s2
