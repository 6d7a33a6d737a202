"""The diagnosis of a recording: compare, search, judge."""

import math
from typing import Final

import numpy as np

from ahrs_service.diagnosis.hypotheses.candidates import Library, Term, library_of
from ahrs_service.diagnosis.hypotheses.hypothesis import Step
from ahrs_service.diagnosis.hypotheses.model import Model, Number, added_body, free_numbers
from ahrs_service.diagnosis.hypotheses.score_test import surprise, unseen
from ahrs_service.diagnosis.input.bench_misfit import BenchResidual
from ahrs_service.diagnosis.input.diagnosis_input import Recorded
from ahrs_service.diagnosis.input.flight_misfit import FlightResidual, is_flight
from ahrs_service.diagnosis.input.misfit import Residual
from ahrs_service.diagnosis.input.reference import reference_of
from ahrs_service.diagnosis.judgement.beside_truth import Truth, beside_truth
from ahrs_service.diagnosis.judgement.explain import explanation
from ahrs_service.diagnosis.judgement.held_out_gain import free_run, held_out
from ahrs_service.diagnosis.judgement.uncertainty import variances
from ahrs_service.diagnosis.judgement.whiteness import whiteness
from ahrs_service.diagnosis.result import (
    Diagnosis,
    Estimated,
    Finding,
    Implausible,
    NotObservable,
    ResidualSeries,
    Rival,
    Unexplained,
    Where,
)
from ahrs_service.diagnosis.search.forward_search import Progress, Search, search
from ahrs_service.diagnosis.search.locate import against_covariates, where_largest
from ahrs_service.diagnosis.search.search_threshold import over_the_search
from ahrs_service.errors import DiagnosisError
from ahrs_service.records import Floats

_AXIS_SIGMA: Final = 3.0  # A choice: exceeded by chance on one axis in 370 (Gauss, two-sided)
_GENERAL: Final = dict.fromkeys(("roll", "pitch", "heading"), "attitude") | {"altitude": "pressure"}
_FALLBACK: Final = "whole recording"
_COMPARED, _PROJECTED, _SEARCH, _JUDGED = 0.06, 0.24, 0.56, 0.85
"""Shares of the run time at which comparison, projection, search (its length), judgement end."""
_MOST_WRONG_DEG: Final = 0.3
"""Several times an INS's attitude error. Of 29 real recordings, those at 10 Hz and more or at rest
lose at most 0.1 deg, those at 1 to 4 Hz in flight 0.9 deg and more."""
_ADVANCE: Final = 0.003
"""Assumed share of the rest of a stage that one projection or whitening takes."""


class _Bar:
    """The share done: it goes from stage to stage, advances in each and never decreases."""

    def __init__(self, report: Progress) -> None:
        self._report, self._share, self._end = report, 0.0, 0.0

    def enter(self, begin: float, end: float) -> None:
        """Begin a stage from one share to another."""
        self._share, self._end = max(self._share, begin), end
        self._report(self._share)

    def advance(self) -> None:
        """Advance a little towards the end of the stage."""
        self._share += _ADVANCE * (self._end - self._share)
        self._report(self._share)


def _of_search(share: float) -> float:
    return _PROJECTED + _SEARCH * share


def compare(recorded: Recorded) -> Residual:
    """Return the misfit of a recording to its reference; ValueError says what is missing."""
    reference = reference_of(recorded)
    if is_flight(reference):
        _refuse_slow(recorded)
        return FlightResidual(recorded, reference)
    return BenchResidual(recorded, reference)


def _refuse_slow(recorded: Recorded) -> None:
    """Raise ValueError where the IMU's rate is too low to integrate the angle.

    The trapezoid rule errs per step by a twelfth of the second difference times the step.
    """
    step_s = float(np.median(np.diff(recorded.imu_time_s)))
    bends = np.diff(recorded.gyro_rad_s, 2, axis=0)
    wrong_deg = math.degrees(step_s / 12.0 * float(np.sqrt(np.mean(bends**2))))
    if wrong_deg > _MOST_WRONG_DEG:
        raise DiagnosisError(
            f"the IMU is recorded at {1.0 / step_s:.3g} Hz, too slow for the vehicle's rotation "
            f"({wrong_deg:.2g} deg lost between samples); record HIGHRES_IMU at 25 Hz or more"
        )


def diagnose(
    recorded: Recorded, progress: Progress | None = None, truth: Truth | None = None
) -> Diagnosis:
    """Locate and name what makes a recording differ from an ideal IMU.

    The effects of a twin are removed from the readings beforehand (input.effect_removal).
    `progress` is called with the share done, 0 to 1. With a `truth` the result includes the
    figures of an oracle for comparison.
    """
    bar = _Bar(progress or (lambda share: None))
    residual = compare(recorded)
    residual.moved = bar.advance
    bar.enter(_COMPARED, _PROJECTED)
    library = library_of(residual)
    found = search(residual, library, lambda share: bar.enter(_of_search(share), _of_search(1.0)))
    bar.enter(_of_search(1.0), _JUDGED)
    model = found.model
    known = variances(residual, model)
    for number, own in enumerate(free_numbers(model.terms)):
        scattered = found.scatter[own.term] * model.covariance[number, number]
        known[number] = max(known[number], scattered)
    findings = tuple(
        _finding(residual, found, step, place, known) for place, step in enumerate(found.steps)
    )
    left = tuple(
        Unexplained(
            one.triad,
            one.triad,
            _covariates(found.covariates[one]),
            (),
            math.exp(-min(value, 700.0)),
        )
        for one, value in found.unknown.items()
    )
    verdict = "unexplained" if left else "explained" if findings else "no_mismatch"
    triad = findings[0].triad if findings else "gyro"
    whole = held_out(residual, found.bare, model, triad) if model.terms else None
    bar.enter(_JUDGED, 1.0)
    noise = dict(zip(residual.noise_names, np.exp(model.noise).tolist(), strict=True))
    return Diagnosis(
        verdict=verdict,  # type: ignore[arg-type]
        findings=findings,
        unexplained=left,
        not_observable=_not_observable(residual, library, model),
        holdout=whole,
        free_run=free_run(residual, found.bare, model),
        noise=noise,
        whiteness=whiteness(residual, model),
        covariates=against_covariates(residual, found.bare, model),
        series=_series(residual, model),
        implausible=_implausible(library, model),
        oracle=None if truth is None else beside_truth(residual, found.bare, model, truth),
    )


def _covariates(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the covariates, each followed by its more general term."""
    words = [word for name in names for word in (name, _GENERAL.get(name, name))]
    return tuple(dict.fromkeys(words))


def _series(residual: Residual, model: Model) -> ResidualSeries:
    before = residual.body
    return ResidualSeries(residual.time_s, before, before - added_body(residual, model.terms))


def _finding(residual: Residual, found: Search, step: Step, place: int, known: Floats) -> Finding:
    term = found.model.terms[place]
    parameters, axes = _parameters(found.model, place, known)
    scatter, rival = found.scatter[place], found.rivals[place]
    alike = found.alike[place]
    held = held_out(residual, step.model, found.model, term.effect.triad)
    size = _sizes(residual, term)
    where = where_largest(residual, added_body(residual, (term,))) or (
        Where(float(residual.time_s[0]), float(residual.time_s[-1]), _FALLBACK),
    )
    return Finding(
        effect=term.effect.id,
        triad=term.effect.triad,
        alike=alike,
        axes=axes,
        where=where,
        parameters=parameters,
        p_value=over_the_search(
            surprise(step.gain / scatter, step.candidate.freedom), found.hypotheses
        ),
        log_evidence=step.gain,
        rival=None if rival is None else Rival(*rival),
        holdout=held,
        explanation=explanation(term, size, alike),
        separating_manoeuvre=term.effect.separated_by if len(alike) > 1 else None,
    )


def _sizes(residual: Residual, term: Term) -> Floats:
    """Return the rms of what a term adds per channel [6], without its mean."""
    added = added_body(residual, (term,))
    return np.asarray(np.std(added, axis=0))


def _parameters(
    model: Model, place: int, known: Floats
) -> tuple[dict[str, Estimated], tuple[str, ...]]:
    """Return a term's parameters, sigmas from the `known` variances, and its significant axes."""
    term = model.terms[place]
    stds = {p.name: np.zeros(p.shape) for p in term.effect.parameters}
    numbers = free_numbers(model.terms)
    axes: set[int] = set()
    for number, variance in zip(numbers, known, strict=True):
        if number.term == place:
            stds[number.parameter.name][number.index] = math.sqrt(variance)
            axes |= _axis(term, number, math.sqrt(variance))
    parameters = {
        p.name: Estimated(term.values[p.name].tolist(), stds[p.name].tolist(), p.unit)
        for p in term.effect.parameters
    }
    return parameters, tuple("xyz"[axis] for axis in sorted(axes)) or ("x", "y", "z")


def _axis(term: Term, number: Number, std: float) -> set[int]:
    value = abs(float(term.values[number.parameter.name][number.index]))
    stands_out = bool(number.index) and value > _AXIS_SIGMA * std
    return {number.index[0]} if stands_out else set()


def _implausible(library: Library, model: Model) -> tuple[Implausible, ...]:
    named = {term.effect.id for term in model.terms}
    return tuple(
        Implausible(
            name,
            {key: value.tolist() for key, value in term.values.items()},
            {p.name: p.plausible for p in term.effect.parameters if p.step},
            gain,
        )
        for name, (term, gain) in library.implausible.items()
        if name not in named
    )


def _not_observable(
    residual: Residual, library: Library, model: Model
) -> tuple[NotObservable, ...]:
    hidden = unseen(residual, model.noise, library, model.base, model.misfit)
    named = {term.effect.id for term in model.terms}
    reasons = library.refused | {name: why for name, why in hidden.items() if name not in named}
    return tuple(NotObservable(name, why) for name, why in reasons.items())
