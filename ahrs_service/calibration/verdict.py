"""What a calibration is worth, in figures and in words: no fit leaves its procedure without one.

A fit always makes the data that it saw better, so what counts is data that it did not see: poses,
time or temperatures held out. A calibration that makes those worse is refused.
"""

import math
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any, ClassVar, Final, Literal

Vector = tuple[float, float, float]

SMALLEST_SPAN_K: Final = 10.0
"""Least span of a thermal calibration [K]: ArduPilot's learning asks for as much before it fits."""
LARGEST_CONDITION: Final = 1000.0
"""A parameter is then known from a thousandth of what its column of the Jacobian suggests."""
DOUBTFUL_CONDITION: Final = 50.0
"""A choice: a parameter's sigma may be 50 times what its column alone suggests."""
SMALLEST_COVERAGE: Final = 0.25
"""Share of the sphere under which directions are extrapolated over more than a right angle."""

_STRICT = {"extra": "forbid"}


class Level(StrEnum):
    """How much a finding weighs; one refusal is enough."""

    NOTE = "note"
    WARNING = "warning"
    REFUSAL = "refusal"


@dataclass(frozen=True, slots=True)
class Finding:
    """One sentence about a calibration, in words that need no textbook."""

    __pydantic_config__: ClassVar = _STRICT
    level: Level
    text: str


@dataclass(frozen=True, slots=True)
class TemperatureResidual:
    """Residual that is left between two temperatures [degC], RMS per axis of `count` values."""

    __pydantic_config__: ClassVar = _STRICT
    low_degc: float
    high_degc: float
    count: int
    rms: Vector


@dataclass(frozen=True, slots=True)
class TriadVerdict:
    """The figures of one triad, in its `unit`; what a procedure cannot know is None or empty.

    `count` what was fitted (poses, turns, means of a bin); RMS residual per axis with the factory
    values and with the fit, and that per temperature; `span_degc` lowest and highest temperature
    fitted; `coverage` share of the sphere of directions [0..1]; `condition` of the Jacobian with
    columns of length 1; `standard_errors` by parameter's name, 1-sigma; RMS of data held out
    from the fit, before and after; `hysteresis` largest difference between heating and cooling.
    """

    __pydantic_config__: ClassVar = _STRICT
    triad: Literal["gyro", "accel"]
    unit: str
    count: int
    rms_before: Vector
    rms_after: Vector
    by_temperature: tuple[TemperatureResidual, ...] = ()
    span_degc: tuple[float, float] | None = None
    coverage: float | None = None
    condition: float | None = None
    standard_errors: dict[str, float] = field(default_factory=dict)
    held_out_before: float | None = None
    held_out_after: float | None = None
    hysteresis: Vector | None = None

    @property
    def gain(self) -> float | None:
        """Share of the held-out residual that the calibration takes away; below 0 it adds."""
        if self.held_out_before is None or self.held_out_after is None:
            return None
        if self.held_out_before == 0.0:
            return 0.0 if self.held_out_after == 0.0 else -math.inf
        return 1.0 - self.held_out_after / self.held_out_before


@dataclass(frozen=True, slots=True)
class Verdict:
    """Figures and findings of one calibration; `judge` makes it."""

    __pydantic_config__: ClassVar = _STRICT
    procedure: str
    triads: tuple[TriadVerdict, ...]
    findings: tuple[Finding, ...] = ()

    @property
    def is_refused(self) -> bool:
        """Whether the calibration must not be used."""
        return any(finding.level is Level.REFUSAL for finding in self.findings)

    @property
    def words(self) -> str:
        """The verdict in a line: `use`, `use with care: ...` or `do not use: ...`."""
        for level, opening in ((Level.REFUSAL, "do not use"), (Level.WARNING, "use with care")):
            texts = [finding.text for finding in self.findings if finding.level is level]
            if texts:
                return f"{opening}: {'; '.join(texts)}"
        return "use"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for TOML and JSON, without what is None, empty or not finite."""
        plain: dict[str, Any] = _without_gaps(asdict(self))
        return plain


def judge(
    procedure: str, triads: tuple[TriadVerdict, ...], remarks: tuple[Finding, ...] = ()
) -> Verdict:
    """Return the verdict on what `procedure` found; `remarks` are its own, and come first."""
    findings = list(remarks)
    for triad in triads:
        findings += _on_held_out(triad)
        findings += _on_geometry(triad)
        findings += _on_standard_errors(triad)
    return Verdict(procedure, triads, tuple(findings))


def span_finding(span_degc: tuple[float, float]) -> Finding:
    """Return the findings on a thermal calibration's temperature span [degC]."""
    low, high = span_degc
    span = high - low
    if not span >= SMALLEST_SPAN_K:
        return Finding(
            Level.REFUSAL,
            f"span {span:.0f} degC, from {low:.0f} to {high:.0f}: heat or cool the unit over "
            f"{SMALLEST_SPAN_K:.0f} degC or more",
        )
    return Finding(Level.NOTE, f"calibrated from {low:.0f} to {high:.0f} degC")


def _on_held_out(triad: TriadVerdict) -> list[Finding]:
    """Refuse what makes held-out data worse."""
    gain = triad.gain
    if gain is None:
        text = f"{triad.triad}: nothing could be held out, so no gain is shown"
        return [Finding(Level.WARNING, text)]
    before, after = triad.held_out_before, triad.held_out_after
    figures = f"{before:.4g} before, {after:.4g} {triad.unit} after"
    if gain < 0.0:
        text = f"{triad.triad}: data held out got worse, {figures}; keep the calibration you have"
        return [Finding(Level.REFUSAL, text)]
    return [Finding(Level.NOTE, f"{triad.triad}: held-out residual {figures}")]


def _on_geometry(triad: TriadVerdict) -> list[Finding]:
    """Judge whether the directions taken determine the parameters."""
    findings = []
    condition = triad.condition
    if condition is not None and not condition < DOUBTFUL_CONDITION:
        level = Level.WARNING if condition < LARGEST_CONDITION else Level.REFUSAL
        text = f"{triad.triad}: parameters are hardly separable (condition {condition:.0f})"
        findings.append(Finding(level, f"{text}; take poses or turns in more directions"))
    coverage = triad.coverage
    if coverage is not None and coverage < SMALLEST_COVERAGE:
        text = f"{triad.triad}: poses cover {coverage:.0%} of all directions; take others too"
        findings.append(Finding(Level.WARNING, text))
    return findings


def _on_standard_errors(triad: TriadVerdict) -> list[Finding]:
    """Refuse what has no covariance: a parameter was not observed at all."""
    lost = [name for name, error in triad.standard_errors.items() if not math.isfinite(error)]
    if not lost:
        return []
    text = f"{triad.triad}: the data say nothing about {', '.join(lost)}"
    return [Finding(Level.REFUSAL, text)]


def _without_gaps(value: Any) -> Any:
    """Return `value` without what is None, empty or not finite; enums as their text."""
    if isinstance(value, dict):
        pairs = ((key, _without_gaps(item)) for key, item in value.items())
        return {key: item for key, item in pairs if item not in (None, {}, [])}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, (list, tuple)):
        return [_without_gaps(item) for item in value]
    return value.value if isinstance(value, StrEnum) else value
