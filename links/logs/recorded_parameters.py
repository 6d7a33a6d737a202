"""The autopilot's parameters in a recording: PARAM_VALUE, PARM, or a ULog's own."""

from collections.abc import Iterable
from dataclasses import dataclass, field

Reported = Iterable[tuple[str, float]]


@dataclass(frozen=True, slots=True)
class RecordedParameters:
    """Values by name, the last of each, and which of them had another value before.

    `autopilot` is MAV_AUTOPILOT, 0 where the recording has none; `notes` are for the user.
    """

    values: dict[str, float]
    autopilot: int = 0
    changed: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(slots=True)
class ParameterHistory:
    """Collects values in order, and the names of those that changed."""

    values: dict[str, float] = field(default_factory=dict)
    changed: dict[str, None] = field(default_factory=dict)

    def take(self, reported: Reported) -> None:
        """Add values in the order in which they were reported."""
        for name, value in reported:
            # An autopilot reports some values more than once, unchanged.
            if self.values.get(name, value) != value:
                self.changed[name] = None
            self.values[name] = value

    def result(self, autopilot: int, notes: tuple[str, ...] = ()) -> RecordedParameters:
        """Return the collected parameters."""
        return RecordedParameters(self.values, autopilot, tuple(self.changed), notes)
