"""What a physical effect is: an equation, its parameters, and what it adds to the ideal reading.

Adding physics is adding a file in this folder: `catalogue` finds it. The simulator adds an effect,
diagnosis fits it and `undo` takes it away again, all by the same `add`; what the effect becomes in
a calibration, or why it cannot, it defines itself.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import ClassVar, Final, Literal

import numpy as np

from ahrs_service.errors import InvalidValueError
from ahrs_service.records import Floats

Triad = Literal["gyro", "accel", "imu"]
"""The triad that an effect applies to; `imu` is both."""

Values = Mapping[str, Floats]
"""Parameters of one effect by name, each an array of its parameter's shape (a number is [])."""

OfTemperature = Callable[[Floats], Floats]
"""From temperatures [M] [degC] to values [M, 3]."""

REFERENCE_DEGC: Final = 25.0
"""Where thermal effects are zero unless a twin sets another (MPU-6000 data sheet: at 25 degC)."""

PER_AXIS: Final = (3,)
MATRIX: Final = (3, 3)


@dataclass(frozen=True, slots=True)
class Columns:
    """Inputs of an IMU's effects at N instants; a covariate that is not known is NaN throughout.

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
            raise InvalidValueError(
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


@dataclass(frozen=True, slots=True)
class Contribution:
    """What an effect is in the calibration of a triad; None where it has no such part.

        reading = (I + D + D_T(T)) u + beta(T) + Gamma f + k f^2

    `linear` D [3, 3] [1]; `scale` the diagonal of D_T [1]; `bias` beta [rad/s or m/s^2];
    `g_sensitivity` Gamma [3, 3] [rad s/m]; `quadratic` k [3] [s^2/m]. `lag_s` by how much the
    element temperature lags the reported one, first order. An effect on both triads
    contributes the same to each.
    """

    linear: Floats | None = None
    scale: OfTemperature | None = None
    bias: OfTemperature | None = None
    g_sensitivity: Floats | None = None
    quadratic: Floats | None = None
    lag_s: float | None = None

    @property
    def follows_temperature(self) -> bool:
        """Whether it is another at another temperature."""
        return self.scale is not None or self.bias is not None


def polynomial(origin_degc: Floats, *powers: Floats) -> OfTemperature:
    """Return T [M] -> sum of powers[k] (T - origin)^(k + 1) [M, 3]."""

    def at(temperature_degc: Floats) -> Floats:
        warm = (temperature_degc - origin_degc)[:, None]
        return sum((p * warm ** (k + 1) for k, p in enumerate(powers)), np.zeros((len(warm), 3)))

    return at


@dataclass(frozen=True)
class Effect(ABC):
    """A physical effect on one triad or on both; `name` without the triad's prefix.

    `triads` on which it is looked for. `equation` what it adds to the ideal reading u; `needs` the
    covariates of Columns without which that cannot be computed; `excited_by` what a recording must
    hold to show it; `taken_for` the ids, or names of the same triad, that it is commonly mistaken
    for, and `separated_by` the manoeuvre that parts it from them. `not_live` why a calibration
    cannot compensate it, where it cannot.

    `limited_by` names the parameter beyond which the reading is cut off. `alters_motion` where it
    is so large, and of such a kind, that the reading is no substitute for the ideal motion, and
    `is_timing` where that is because the stamps are late, by `delay_s`.
    `is_constant` where in flight it is a constant attitude error in body axes, as the reference's
    own is that lasts.
    """

    triad: Triad

    name: ClassVar[str]
    triads: ClassVar[tuple[Triad, ...]]
    title: ClassVar[str]
    equation: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()
    excited_by: ClassVar[str]
    taken_for: ClassVar[tuple[str, ...]] = ()
    separated_by: ClassVar[str]
    not_live: ClassVar[str] = "the calibration has no term of its form"
    limited_by: ClassVar[str] = ""
    alters_motion: ClassVar[bool] = False
    is_timing: ClassVar[bool] = False
    is_constant: ClassVar[bool] = False

    @property
    def id(self) -> str:
        """Name in the catalogue: `gyro_thermal_bias`."""
        return f"{self.triad}_{self.name}"

    @property
    def is_limit(self) -> bool:
        """Whether it cuts off what lies beyond a limit."""
        return bool(self.limited_by)

    @property
    def why_not_live(self) -> str | None:
        """Why a calibration cannot compensate it live; None where it can."""
        return self.not_live if self.in_calibration(self.neutral()) is None else None

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """What the equation's letters are."""

    @abstractmethod
    def add(self, columns: Columns, values: Values) -> Addition:
        """Return what the effect adds to the ideal reading in `columns`."""

    def in_calibration(self, values: Values) -> Contribution | None:
        """Return what the effect becomes in a calibration; None where that has no such term."""
        return None

    def delay_s(self, time_s: Floats, values: Values) -> Floats:
        """Return how late the stamps `time_s` [N] are [N] [s]: of an effect on timing."""
        return np.zeros(len(time_s))

    def acts_on(self, triad: str) -> bool:
        """Whether it applies to a triad."""
        return self.triad in (triad, "imu")

    def unknown_need(self, columns: Columns) -> str | None:
        """Return the first covariate that it needs and that is not known, None if all are."""
        return next((name for name in self.needs if not columns.knows(name)), None)

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
                raise InvalidValueError(
                    f"{self.id}: no parameter {name}; there are {', '.join(known)}"
                )
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

    Every effect applies to the ideal reading, and the additions are summed. Where they are zero the
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
