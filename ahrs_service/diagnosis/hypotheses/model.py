"""A model of the misfit: named effects with their parameters, unknown dependences, noise."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.diagnosis.hypotheses.candidates import (
    Dependence,
    Term,
    limits,
    linear_entries,
    sources,
    unit_response,
)
from ahrs_service.diagnosis.hypotheses.likelihood import fit, fit_noise
from ahrs_service.diagnosis.input.misfit import Noise, Residual, nuisance_rows
from ahrs_service.effects.base import Addition, Columns, Effect, Parameter
from ahrs_service.effects.undo import ideal_motion
from ahrs_service.records import Floats

SIZES: Final = 2.0
"""Prior sigma of a parameter as a multiple of the largest in data sheets; beyond three sigma it is
implausible.

The largest effect planted into test recordings, some of them too large on purpose, was 4.0 times
the largest in data sheets."""

_ITERATIONS: Final = 6
"""A choice: limit on Gauss-Newton steps; _SETTLED_SIGMA ends a fit that converges."""
_SETTLED_SIGMA: Final = 0.05
"""A choice: a last step of 0.05 sigma is worth 0.05^2 / 2 = 0.001 nats per parameter."""
_RELATIVE_STEP: Final = 1e-3
"""A choice: the error of a central difference is of the order of its square, 1e-6."""
_UNDO_ITERATIONS: Final = 6
"""Raised from 3 for filters: each pass reduces the error to about the effect's share of it."""
_REFIT_ITERATIONS: Final = 8
"""A choice: limit on the steps of the noise, from a start that nearly fits."""


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Terms and unknown columns fitted to a residual; compared by identity.

    `unknown` [U] the smooth dependence of each column of `unknown_rows` [N, 6, U];
    `log_likelihood` at its maximum; `covariance` [P, P] of the terms' free numbers in the order
    of `free_numbers`; `misfit` [N, 6] the rows minus what the terms add, `base` [N, 6, B] bias,
    unknown and the terms' derivatives, `prior` [B+1, B+1] of their coefficients (see `_prior`).
    """

    terms: tuple[Term, ...]
    unknown: tuple[Dependence, ...]
    unknown_rows: Floats
    noise: Noise
    log_likelihood: float
    covariance: Floats
    misfit: Floats
    base: Floats
    prior: Floats


@dataclass(frozen=True, slots=True)
class Number:
    """One free number of a term: parameter and index; `is_form` where it enters nonlinearly."""

    term: int
    parameter: Parameter
    index: tuple[int, ...]
    is_form: bool


def free_numbers(terms: tuple[Term, ...]) -> list[Number]:
    """Return the numbers of all terms that are fitted."""
    numbers = []
    for place, term in enumerate(terms):
        numbers += [Number(place, p, index, False) for p, index in linear_entries(term.effect)]
        numbers += [
            Number(place, p, (), True) for p in term.effect.parameters if p.grid and not p.is_whole
        ]
    return numbers


def motion_under(columns: Columns, terms: tuple[Term, ...]) -> Columns:
    """Return the ideal motion where `columns` holds what an IMU with these terms reads.

    Terms that do not alter the motion are left in the reading.
    """
    acting = [(term.effect, term.values) for term in terms if term.effect.alters_motion]
    return ideal_motion(columns, acting, _UNDO_ITERATIONS)


def _motion(residual: Residual, effect: Effect, terms: tuple[Term, ...]) -> Columns:
    columns = sources(residual, effect)
    is_exact = residual.columns is residual.reference_columns
    return columns if is_exact or effect.is_limit else motion_under(columns, terms)


def added_rows(residual: Residual, terms: tuple[Term, ...]) -> Floats:
    """Return what the terms add to the rows [N, 6]."""
    total = np.zeros(residual.rows.shape)
    for term in terms:
        columns = _motion(residual, term.effect, terms)
        total += residual.project(term.effect.add(columns, term.values))
    return total


def added_body(residual: Residual, terms: tuple[Term, ...]) -> Floats:
    """Return what the terms add to rate and force in body axes [N, 6]."""
    total = np.zeros(residual.body.shape)
    for term in terms:
        columns = _motion(residual, term.effect, terms)
        total += residual.project_body(term.effect.add(columns, term.values))
    return total


def _difference(after: Addition, before: Addition, step: float) -> Addition:
    return Addition(
        None if after.gyro is None or before.gyro is None else (after.gyro - before.gyro) / step,
        None
        if after.accel is None or before.accel is None
        else (after.accel - before.accel) / step,
    )


def derivative(
    residual: Residual, terms: tuple[Term, ...], number: Number, in_body: bool = False
) -> Floats:
    """Return the rows [N, 6], or the body's, per unit of one free number, at current values."""
    project = residual.project_body if in_body else residual.project
    term, parameter = terms[number.term], number.parameter
    columns = _motion(residual, term.effect, terms)
    if not number.is_form and not term.effect.alters_motion:
        form = {p.name: float(term.values[p.name]) for p in term.effect.parameters if p.grid}
        entry = (parameter, number.index)
        return project(unit_response(term.effect, columns, form, entry))
    value = term.values[parameter.name]
    step = parameter.step or _RELATIVE_STEP * max(abs(float(value)), 1.0)
    sides = []
    for sign in (0.5, -0.5):
        moved = np.array(value)
        moved[number.index] += sign * step
        sides.append(term.effect.add(columns, term.values | {parameter.name: moved}))
    return project(_difference(sides[0], sides[1], step))


def _moved(terms: tuple[Term, ...], numbers: list[Number], by: Floats) -> tuple[Term, ...]:
    values = [{name: np.array(value) for name, value in term.values.items()} for term in terms]
    for number, change in zip(numbers, by, strict=True):
        array, parameter = values[number.term][number.parameter.name], number.parameter
        old = float(array[number.index])
        new = old + change
        if number.is_form and parameter.bounds[0] > 0.0:
            new = np.clip(new, 0.5 * old, 2.0 * old)
        array[number.index] = np.clip(new, *parameter.bounds)
    return tuple(Term(term.effect, new) for term, new in zip(terms, values, strict=True))


def _possible(residual: Residual, terms: tuple[Term, ...]) -> tuple[Term, ...]:
    """Return the terms with saturation limits clipped to those the readings allow."""
    possible = []
    for term in terms:
        values = dict(term.values)
        if term.effect.is_limit:
            bounds = limits(residual, term.effect)
            name = term.effect.limited_by
            values[name] = np.array(np.clip(float(values[name]), *bounds))
        possible.append(Term(term.effect, values))
    return tuple(possible)


def _base(residual: Residual, terms: tuple[Term, ...], unknown_rows: Floats) -> Floats:
    columns = [derivative(residual, terms, number) for number in free_numbers(terms)]
    own = np.stack(columns, axis=2) if columns else np.empty((*residual.rows.shape, 0))
    return np.concatenate([nuisance_rows(residual), unknown_rows, own], axis=2)


def _prior(terms: tuple[Term, ...], numbers: list[Number], count: int) -> Floats:
    """Return the prior [count+1, count+1] of a base whose last columns are the `numbers`.

    Each linear parameter is Gaussian about zero, its sigma SIZES times the largest in data sheets:
    an unobservable parameter stays small, a well observed one is not affected.
    """
    prior = np.zeros((count + 1, count + 1))
    first = count - len(numbers)
    for place, number in enumerate(numbers, start=first):
        if not number.is_form:
            value = float(terms[number.term].values[number.parameter.name][number.index])
            row = np.array([1.0, -value]) / (SIZES * number.parameter.plausible)
            prior[np.ix_([place, count], [place, count])] += np.outer(row, row)
    return prior


def settle(
    residual: Residual,
    terms: tuple[Term, ...],
    noise: Noise,
    unknown: tuple[Dependence, ...] = (),
    unknown_rows: Floats | None = None,
) -> Model:
    """Fit the terms' parameters under one noise: Gauss-Newton, shortened where it overshoots."""
    if unknown_rows is None:
        unknown_rows = np.empty((*residual.rows.shape, 0))
    numbers = free_numbers(terms)
    best: Model | None = None
    change, shares = np.zeros(len(numbers)), 1.0
    start = terms
    for _ in range(_ITERATIONS):
        misfit = residual.rows - added_rows(residual, terms)
        base = _base(residual, terms, unknown_rows)
        prior = _prior(terms, numbers, base.shape[2])
        here = fit(residual, noise, base, misfit, prior)
        first = base.shape[2] - len(numbers)
        # The step is linearised: the likelihood that counts is at the current parameters.
        kept = np.append(np.arange(first), base.shape[2])
        held = fit(residual, noise, base[:, :, :first], misfit, prior[np.ix_(kept, kept)])
        covariance = here.covariance[first:, first:]
        if best is None or held.log_likelihood > best.log_likelihood:
            start, change = terms, here.coefficients[first:]
            gained = np.inf if best is None else held.log_likelihood - best.log_likelihood
            best = Model(
                terms,
                unknown,
                unknown_rows,
                noise,
                held.log_likelihood,
                covariance,
                misfit,
                base,
                prior,
            )
            shares = 1.0
            if not numbers or gained < 1e-3:
                break
            sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
            if np.all(np.abs(change) <= _SETTLED_SIGMA * np.maximum(sigma, 1e-300)):
                break
        else:
            shares *= 0.4
        terms = _possible(residual, _moved(start, numbers, shares * change))
    assert best is not None
    return best


def refit(residual: Residual, model: Model, iterations: int = 2) -> Model:
    """Fit parameters and noise alternately."""
    for _ in range(iterations):
        start = _better_start(residual, model)
        noise = fit_noise(residual, model.base, model.misfit, model.prior, start, _REFIT_ITERATIONS)
        before = model.log_likelihood
        model = settle(residual, model.terms, noise, model.unknown, model.unknown_rows)
        if model.log_likelihood - before < 0.3:
            break
    return model


def _better_start(residual: Residual, model: Model) -> Noise:
    """Return the model's noise, or the first guess where that has the higher likelihood.

    A large effect not yet in the model can inflate its noise too far to converge back.
    """
    first = residual.first_noise()
    afresh = fit(residual, first, model.base, model.misfit, model.prior)
    return first if afresh.log_likelihood > model.log_likelihood else model.noise


def bare(residual: Residual) -> Model:
    """Return the model without any effect, with its noise fitted."""
    noise = residual.first_noise()
    base = nuisance_rows(residual)
    prior = np.zeros((base.shape[2] + 1, base.shape[2] + 1))
    for _ in range(2):
        choose(residual, noise, base, residual.rows, prior)
        noise = fit_noise(residual, base, residual.rows, prior, noise)
    return settle(residual, (), noise)


def is_plausible(model: Model) -> bool:
    """Whether all parameters of all terms may be of a size that an IMU can have."""
    for number, variance in zip(free_numbers(model.terms), np.diag(model.covariance), strict=True):
        value = model.terms[number.term].values[number.parameter.name][number.index]
        least = abs(float(value)) - 2.0 * np.sqrt(max(float(variance), 0.0))
        if not number.is_form and least > 3.0 * SIZES * number.parameter.plausible:
            return False
    return True


def choose(residual: Residual, noise: Noise, base: Floats, rows: Floats, prior: Floats) -> None:
    """Choose among the forms of the noise that a residual has."""
    residual.choose(lambda: fit(residual, noise, base, rows, prior).log_likelihood)


def gain_between(residual: Residual, shorter: Model, longer: Model) -> float:
    """Return the gain in log-likelihood [nats] of a model over one that it contains.

    Each noise maximises the restricted likelihood, not the likelihood itself: each model is
    evaluated under both noises, and the better value counts.
    """
    short, long = (
        fit(residual, noise, model.base, model.misfit, model.prior).log_likelihood
        for model, noise in ((shorter, longer.noise), (longer, shorter.noise))
    )
    return max(longer.log_likelihood, long) - max(shorter.log_likelihood, short)
