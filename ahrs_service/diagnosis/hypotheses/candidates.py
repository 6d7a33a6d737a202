"""The responses that the search chooses from: catalogue effects and smooth unknown dependences."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ahrs_service.diagnosis.input.misfit import Residual
from ahrs_service.effects.base import Addition, Columns, Effect, Parameter, Triad
from ahrs_service.effects.catalogue import EFFECTS
from ahrs_service.records import Floats

_REGIME_S: Final = 0.3
"""A choice: width [s] of a Gauss filter, which passes below 0.44 Hz (-3 dB), slow manoeuvres."""
_LEAST_SPREAD: Final = 1e-6
"""A choice: eight steps of float32 (1.2e-7), the type in messages: less spread is rounding."""
_LIMITS: Final = (0.97, 1.0, 1.03)
"""Shares of the largest reading: 3 % is the scale tolerance in MPU-6000's data sheet."""
_NEAR_LIMIT: Final = 0.85
"""A choice: above this share of the largest slow reading, vibration may have been clipped."""
_LEAST_TIES: Final = 5  # A choice: equal largest readings that indicate the end of range


Entry = tuple[Parameter, tuple[int, ...]]


@dataclass(frozen=True, slots=True)
class Term:
    """An effect with values for all of its parameters."""

    effect: Effect
    values: dict[str, Floats]


@dataclass(frozen=True, slots=True)
class Dependence:
    """An unknown dependence: readings of one triad ("gyro", "accel") follow one covariate."""

    triad: Triad
    covariate: str


@dataclass(frozen=True, slots=True)
class Candidate:
    """One form of a hypothesis: its columns in the library, which have free coefficients.

    `triad` that it affects, `imu` being both. `effect` of the catalogue, or None for an unknown
    dependence on `covariate`. `form` the values of the nonlinear parameters, `freedom` the number
    of fitted parameters; `is_whole` where the response has no coefficient and is added as it is.
    """

    name: str
    triad: Triad
    effect: Effect | None
    covariate: str
    form: dict[str, float]
    columns: slice
    freedom: int
    is_whole: bool = False

    @property
    def is_constant(self) -> bool:
        """Whether its effect is a constant attitude error in flight (see effects.base)."""
        return self.effect is not None and self.effect.is_constant

    @property
    def dependence(self) -> Dependence:
        """The unknown dependence that it is a form of, where it has no `effect`."""
        return Dependence(self.triad, self.covariate)


@dataclass(frozen=True, slots=True)
class Smooth:
    """An unknown dependence: a `basis` [N, M]; its first n columns are a form for n in `orders`.

    A form with fewer parameters is significant at a lower gain.
    """

    covariate: str
    basis: Floats
    orders: tuple[int, ...]
    triads: tuple[Triad, ...] = ("gyro", "accel")


@dataclass(slots=True)
class Library:
    """All candidates and their responses `rows` [N, 6, K].

    `refused` effects with the reason; `implausible` terms dropped for their size, with gain.
    """

    candidates: list[Candidate] = field(default_factory=list)
    rows: Floats = field(default_factory=lambda: np.empty((0, 6, 0)))
    refused: dict[str, str] = field(default_factory=dict)
    implausible: dict[str, tuple[Term, float]] = field(default_factory=dict)


def linear_entries(effect: Effect) -> list[Entry]:
    """Return the linear, or nearly linear, parameters of an effect, as parameter and index."""
    return [(p, index) for p in effect.parameters if p.step for index in p.entries()]


def unit_response(
    effect: Effect,
    columns: Columns,
    form: dict[str, float],
    entry: tuple[Parameter, tuple[int, ...]],
) -> Addition:
    """Return the addition of an effect per unit of one of its parameters, near zero."""
    parameter, index = entry
    values = effect.neutral()
    for name, value in form.items():
        values[name] = np.asarray(value)
    numbers = np.zeros(parameter.shape)
    numbers[index] = parameter.step
    values[parameter.name] = numbers
    addition = effect.add(columns, values)
    scale = 1.0 / parameter.step
    return Addition(
        None if addition.gyro is None else addition.gyro * scale,
        None if addition.accel is None else addition.accel * scale,
    )


def sources(residual: Residual, effect: Effect) -> Columns:
    """Return the motion from which an effect is computed.

    Near the largest reading, where saturation may have clipped it, the motion is the reference's;
    elsewhere the reference's noise would be interpreted as clipped motion.
    """
    if not effect.is_limit:
        return residual.columns
    if residual.reference_columns is residual.columns:
        return replace(residual.columns, scatter=residual.scatter)
    read, seen = residual.columns, residual.reference_columns
    near_rate = np.abs(read.rate_rad_s) > _NEAR_LIMIT * residual.largest[:3]
    near_force = np.abs(read.force_m_s2) > _NEAR_LIMIT * residual.largest[3:]
    return replace(
        read,
        rate_rad_s=np.where(near_rate, seen.rate_rad_s, read.rate_rad_s),
        force_m_s2=np.where(near_force, seen.force_m_s2, read.force_m_s2),
        scatter=residual.scatter,
    )


def limits(residual: Residual, effect: Effect) -> tuple[float, float]:
    """Return the smallest and the largest possible saturation limit of an effect's triad.

    Many readings at the same largest value give the limit. Otherwise it is at least the largest
    reading, vibration included, within the scale correction applied after saturation.
    """
    part = slice(0, 3) if effect.triad == "gyro" else slice(3, 6)
    axis = int(np.argmax(residual.ends[part]))
    if residual.ties[part][axis] >= _LEAST_TIES:
        return float(residual.ends[part][axis]), float(residual.ends[part][axis])
    return _LIMITS[0] * float(residual.ends[part].max()), np.inf


def forms_of(residual: Residual, effect: Effect) -> list[dict[str, float]]:
    """Return the forms of an effect to search over; a limit is at the largest readings."""
    if not effect.is_limit:
        return effect.grid(residual.columns)
    part = slice(0, 3) if effect.triad == "gyro" else slice(3, 6)
    low, high = limits(residual, effect)
    if high == low:
        return [{effect.limited_by: low}]
    largest = residual.ends[part].max()
    return [{effect.limited_by: float(largest * share)} for share in _LIMITS]


def missing_covariate(effect: Effect, columns: Columns) -> str | None:
    """Return why an effect cannot be computed or observed here, None where it can."""
    for name in effect.needs:
        if not columns.knows(name):
            return f"the recording has no {name}"
        values = getattr(columns, name)
        if values.ndim == 1 and np.ptp(values) < _LEAST_SPREAD * (1.0 + np.abs(values).max()):
            return f"{name} does not change"
    return None


def responses(residual: Residual, effect: Effect, form: dict[str, float]) -> list[Floats]:
    """Return the rows [N, 6] of an effect's linear parameters, or its whole response."""
    columns = sources(residual, effect)
    entries = linear_entries(effect)
    if entries:
        return [residual.project(unit_response(effect, columns, form, entry)) for entry in entries]
    values = effect.neutral() | {name: np.asarray(value) for name, value in form.items()}
    return [residual.project(effect.add(columns, values))]


def library_of(residual: Residual, names: Sequence[str] | None = None) -> Library:
    """Return the responses of all effects observable in this recording, and of unknown ones.

    `names` of the effects to look for; by default the whole catalogue.
    """
    library, rows, used = Library(), [], 0
    for name in EFFECTS if names is None else names:
        effect = EFFECTS[name]
        why = missing_covariate(effect, residual.columns)
        if why is not None:
            library.refused[name] = why
            continue
        has_coefficients, forms = bool(linear_entries(effect)), forms_of(residual, effect)
        if not forms:
            library.refused[name] = f"the recording does not excite it: {effect.excited_by}"
        for form in forms:
            added = responses(residual, effect, form)
            freedom = len(form) + (len(added) if has_coefficients else 0)
            place = slice(used, used + len(added))
            library.candidates.append(
                Candidate(
                    name, effect.triad, effect, "", form, place, freedom, not has_coefficients
                )
            )
            rows += added
            used += len(added)
    for smooth in unknown_forms(residual.columns):
        for triad in smooth.triads:
            name = f"{triad} {smooth.covariate}"
            for order in smooth.orders:
                place = slice(used, used + 3 * order)
                library.candidates.append(
                    Candidate(name, triad, None, smooth.covariate, {}, place, 3 * order)
                )
            added = [
                residual.project(_on_axis(triad, axis, column))
                for column in smooth.basis.T
                for axis in range(3)
            ]
            rows += added
            used += len(added)
    library.rows = np.stack(rows, axis=2)
    return library


def _on_axis(triad: str, axis: int, values: Floats) -> Addition:
    added = np.zeros((len(values), 3))
    added[:, axis] = values
    return Addition(gyro=added) if triad == "gyro" else Addition(accel=added)


def regimes(columns: Columns) -> dict[str, Floats]:
    """Return the recorded covariates [N] that a misfit is compared with."""
    step_s = (columns.time_s[-1] - columns.time_s[0]) / (len(columns.time_s) - 1)
    # The norm of a noisy reading correlates with its noise: use the slow reading.
    rate, force_m_s2 = (
        gaussian_filter1d(values, _REGIME_S / step_s, axis=0, mode="nearest")
        for values in (columns.rate_rad_s, columns.force_m_s2)
    )
    speed, force = np.linalg.norm(rate, axis=1), np.linalg.norm(force_m_s2, axis=1)
    down = 2.0 * columns.ned_from_body**2
    w, x, y, z = columns.ned_from_body.T
    known = {
        "temperature": columns.temperature_degc,
        "temperature slope": columns.temperature_slope_degc_s,
        "rate": speed,
        "acceleration": force,
        "throttle": columns.throttle,
        "current": columns.current_a,
        "vibration": columns.vibration_m_s2,
        "airspeed": columns.airspeed_m_s,
        "roll": np.arctan2(2.0 * (w * x + y * z), 1.0 - down[:, 1] - down[:, 2]),
        "pitch": np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)),
        "heading": np.arctan2(2.0 * (w * z + x * y), 1.0 - down[:, 2] - down[:, 3]),
    }
    known |= {
        name: values
        for name, values in (("voltage", columns.supply_v), ("altitude", columns.altitude_m))
        if values is not None
    }
    spread = {name: np.ptp(values) for name, values in known.items()}
    return {
        name: values
        for name, values in known.items()
        if np.isfinite(values).all() and spread[name] > _LEAST_SPREAD * (1 + np.abs(values).max())
    }


def unknown_forms(columns: Columns) -> list[Smooth]:
    """Return smooth forms of each covariate: polynomials, cubic splines, two harmonics of heading.

    Also the products of components of rate and specific force, which are no function of their norm
    or of attitude angles; linear dependences on them are effects of the catalogue.
    """
    forms = []
    for name, values in regimes(columns).items():
        low, high = np.quantile(values, [0.002, 0.998])
        if not high > low:
            continue
        if name == "heading":
            angles = np.array([1.0, 2.0]) * values[:, None]
            basis = np.stack([np.sin(angles), np.cos(angles)], axis=2).reshape(-1, 4)
            forms.append(Smooth(name, basis, (4,)))
        else:
            share = np.clip((values - low) / (high - low), 0.0, 1.0)
            forms.append(Smooth(name, spline_basis(share), (1, 2, 4)))
    force, rate = products(columns.force_m_s2), products(columns.rate_rad_s)
    rotation = np.hstack([rate, columns.angular_acceleration_rad_s2])
    return [
        *forms,
        Smooth("acceleration", force, (6,)),
        Smooth("rate", rate, (6,), ("gyro",)),
        Smooth("rate", rotation, (9,), ("accel",)),
    ]


def products(vector: Floats) -> Floats:
    """Return the products of two components [N, 6] of a vector [N, 3], each scaled to 1."""
    first, second = np.triu_indices(3)
    terms = vector[:, first] * vector[:, second]
    return np.asarray(terms / np.maximum(np.abs(terms).max(axis=0), 1e-300))


def spline_basis(share: Floats) -> Floats:
    """Return a basis [N, 4] over 0..1 of the cubic splines with a knot in the middle, less 1.

    The first column is a straight line, the first two a parabola; orthogonal on these samples.
    """
    powers = np.vander(share, 4, increasing=True)
    bent = np.maximum(share - 0.5, 0.0) ** 3
    basis, triangle = np.linalg.qr(np.hstack([powers, bent[:, None]]))
    # A covariate with few distinct values has fewer forms; the rest would be rounding.
    lives = np.abs(np.diag(triangle)) > _LEAST_SPREAD * np.sqrt(len(share))
    return np.asarray((basis * lives)[:, 1:] * np.sqrt(len(share)))
