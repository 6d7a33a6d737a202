"""The findings compared with an oracle that knows the truth of a recording.

The oracle has the true effects with their true parameters, and the noise fitted with them; the
findings are scored under the same noise on the same held-out blocks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ahrs_service.diagnosis.hypotheses.candidates import Term, missing_covariate
from ahrs_service.diagnosis.hypotheses.likelihood import fit_noise
from ahrs_service.diagnosis.hypotheses.model import Model, added_rows
from ahrs_service.diagnosis.input.misfit import Residual
from ahrs_service.diagnosis.judgement.held_out_gain import free_run, held_out
from ahrs_service.diagnosis.result import Oracle, TrueEffect
from ahrs_service.effects.base import Effect, Values
from ahrs_service.errors import DiagnosisError

TRIADS = ("gyro", "accel")


@dataclass(frozen=True, slots=True)
class Truth:
    """The effects known to be in a recording: with parameters, or (`outside`) in words."""

    effects: Sequence[tuple[Effect, Values]]
    outside: tuple[str, ...] = ()


def beside_truth(residual: Residual, bare: Model, found: Model, truth: Truth) -> Oracle:
    """Return the oracle's figures; ValueError names a true effect that cannot be computed here."""
    for effect, _ in truth.effects:
        why = missing_covariate(effect, residual.columns)
        if why is not None:
            raise DiagnosisError(
                f"the truth contains {effect.id}, but {why}; give this recording's truth"
            )
    terms = tuple(Term(effect, dict(values)) for effect, values in truth.effects)
    model = _with_true_numbers(residual, bare, terms)
    run = free_run(residual, bare, model)
    # Gains are comparable only under one noise: the one fitted with the true effects removed.
    same = replace(found, noise=model.noise)
    return Oracle(
        tuple(TrueEffect(effect.id, _plain(values)) for effect, values in truth.effects),
        truth.outside,
        {triad: held_out(residual, bare, same, triad) for triad in TRIADS},
        {triad: held_out(residual, bare, model, triad, has_fixed=True) for triad in TRIADS},
        None if run is None else run.after,
    )


def _with_true_numbers(residual: Residual, bare: Model, terms: tuple[Term, ...]) -> Model:
    misfit = residual.rows - added_rows(residual, terms)
    noise = fit_noise(residual, bare.base, misfit, bare.prior, bare.noise)
    return replace(bare, terms=terms, noise=noise, misfit=misfit)


def _plain(values: Values) -> dict[str, object]:
    return {name: np.asarray(value).tolist() for name, value in values.items()}
