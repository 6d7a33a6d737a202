"""The part of a misfit explained so far, passed from stage to stage of the search."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from ahrs_service.diagnosis.hypotheses.candidates import Dependence, Library
from ahrs_service.diagnosis.hypotheses.hypothesis import Step
from ahrs_service.diagnosis.hypotheses.model import Model
from ahrs_service.diagnosis.input.misfit import Residual


@dataclass(frozen=True, slots=True)
class Explained:
    """The explanations found so far, as one stage of the search passes them to the next.

    `model` all of them fitted, `taken` one step per term of the model in its order, `unknown` the
    surprise of every unknown dependence in it.
    """

    residual: Residual
    library: Library
    model: Model
    taken: tuple[Step, ...] = ()
    unknown: Mapping[Dependence, float] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """The number of explanations."""
        return len(self.taken) + len(self.unknown)

    def with_effect(self, step: Step) -> "Explained":
        """Return it with one more named effect."""
        return replace(self, model=step.model, taken=(*self.taken, step))

    def with_unknown(self, step: Step) -> "Explained":
        """Return it with one more unknown dependence."""
        unknown = {**self.unknown, step.candidate.dependence: step.surprise}
        return replace(self, model=step.model, unknown=unknown)

    def without_effect(self, place: int, shorter: Model) -> "Explained":
        """Return it without one of its effects, `shorter` being the model of the rest."""
        return replace(self, model=shorter, taken=self.taken[:place] + self.taken[place + 1 :])

    def without_unknown(self, shorter: Model, *names: Dependence) -> "Explained":
        """Return it without unknown dependences, `shorter` being the model of the rest."""
        left = {one: value for one, value in self.unknown.items() if one not in names}
        return replace(self, model=shorter, unknown=left)
