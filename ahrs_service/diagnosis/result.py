"""What a diagnosis says, as frozen records; `as_json` gives a report of ahrs-mismatch/1."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final, Literal

from ahrs_service.records import Floats

SCHEMA: Final = "ahrs-mismatch/1"

Verdict = Literal["no_mismatch", "explained", "unexplained"]
Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Where:
    """A span of the recording [s on its clock] and what is special there."""

    t0_s: float
    t1_s: float
    regime: str


@dataclass(frozen=True, slots=True)
class Estimated:
    """A parameter: number or list of its shape, 1-sigma of the same shape, unit."""

    value: Any
    std: Any
    unit: str


@dataclass(frozen=True, slots=True)
class Rival:
    """The next best effect for the same misfit and its log evidence."""

    effect: str
    log_evidence: float


@dataclass(frozen=True, slots=True)
class Holdout:
    """What a finding gains on blocks of the recording that it was not fitted to.

    `log_likelihood_gain` [nats]; rms of the residual of the triad that the finding acts on, per
    axis [rad/s or m/s^2]: of all of it, and of what is slower than 0.05 Hz.
    """

    log_likelihood_gain: float
    rms_before: Vector
    rms_after: Vector
    low_frequency_rms_before: Vector
    low_frequency_rms_after: Vector


@dataclass(frozen=True, slots=True)
class Finding:
    """One effect that was left out: its id, and the triad it acts on ("imu" is both).

    `alike` the ids that this recording cannot tell apart.
    """

    effect: str
    triad: str
    alike: tuple[str, ...]
    axes: tuple[str, ...]
    where: tuple[Where, ...]
    parameters: Mapping[str, Estimated]
    p_value: float
    log_evidence: float
    rival: Rival | None
    holdout: Holdout
    explanation: str
    separating_manoeuvre: str | None


@dataclass(frozen=True, slots=True)
class Unexplained:
    """Something real that no effect of the catalogue explains: `channel` as accel_z, or accel."""

    triad: str
    channel: str
    depends_on: tuple[str, ...]
    where: tuple[Where, ...]
    p_value: float


@dataclass(frozen=True, slots=True)
class Implausible:
    """An effect that would explain something, but only at a size that no IMU has.

    `parameters` as fitted, `plausible` the largest of data sheets, both by name; `log_evidence`
    what it would gain [nats].
    """

    effect: str
    parameters: Mapping[str, Any]
    plausible: Mapping[str, float]
    log_evidence: float


@dataclass(frozen=True, slots=True)
class NotObservable:
    """An effect that this recording cannot show, and why."""

    effect: str
    why: str


@dataclass(frozen=True, slots=True)
class FreeRun:
    """Attitude error after 60 s of the gyro alone [deg], rms over starts, before and after."""

    before: float
    after: float


@dataclass(frozen=True, slots=True)
class TrueEffect:
    """An effect that a recording is known to hold, with its parameters by name."""

    effect: str
    parameters: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Oracle:
    """What the truth would have gained: the same figures with its numbers, none of them fitted.

    `outside` what is hidden and has no equation here, in words; `found` and `oracle` the held-out
    figures of what was found and of the truth, by triad ("gyro", "accel"): both before and after.
    `free_run_deg` the truth's attitude error after 60 s of the gyro alone.
    """

    effects: tuple[TrueEffect, ...]
    outside: tuple[str, ...]
    found: Mapping[str, Holdout]
    oracle: Mapping[str, Holdout]
    free_run_deg: float | None


@dataclass(frozen=True, slots=True)
class Covariate:
    """Residual of one channel against one covariate, for a picture.

    `edges` [B+1] of the bins, `mean` [B] of the residual in each, `null_std` [B] what the noise
    alone gives it, `fitted` [B] what the findings explain. `p_value` of the whole dependence.
    """

    triad: str
    channel: str
    covariate: str
    unit: str
    edges: Floats
    mean: Floats
    null_std: Floats
    fitted: Floats
    p_value: float


@dataclass(frozen=True, slots=True)
class ResidualSeries:
    """Residuals over time for pictures: `time_s` [N], before and after [N, 6] (gyro, accel)."""

    time_s: Floats
    before: Floats
    after: Floats


@dataclass(frozen=True, slots=True)
class Whiteness:
    """Tests of the whitened innovations [N, 6]: p-values per channel, and of all together.

    `ljung_box` over 20 lags, `normality` (Jarque-Bera after 5-sigma glitches are set aside).
    """

    ljung_box: tuple[float, ...]
    normality: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The whole answer. `noise` the fitted hyperparameters by name.

    `as_json` gives it as plain tables and lists.

    >>> from ahrs_service import diagnose
    >>> diagnosis = diagnose("bench.tlog")
    >>> diagnosis.verdict
    'explained'
    >>> (finding,) = diagnosis.findings
    >>> finding.effect, finding.parameters["scale_error"].unit
    ('gyro_scale_factor', '1')
    """

    verdict: Verdict
    findings: tuple[Finding, ...]
    unexplained: tuple[Unexplained, ...]
    not_observable: tuple[NotObservable, ...]
    holdout: Holdout | None
    free_run: FreeRun | None
    noise: Mapping[str, float] = field(default_factory=dict)
    whiteness: Whiteness | None = None
    covariates: tuple[Covariate, ...] = ()
    series: ResidualSeries | None = None
    notes: tuple[str, ...] = ()
    oracle: Oracle | None = None
    implausible: tuple[Implausible, ...] = ()


def as_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the report as ahrs-mismatch/1 lays it down; pictures' numbers stay out."""
    held_out: dict[str, Any] = {}
    if diagnosis.holdout is not None:
        held_out |= asdict(diagnosis.holdout)
    if diagnosis.free_run is not None:
        held_out["free_run_attitude_error_60s_deg"] = asdict(diagnosis.free_run)
    report: dict[str, Any] = {
        "schema": SCHEMA,
        "verdict": diagnosis.verdict,
        "effects": [_finding(finding) for finding in diagnosis.findings],
        "unexplained": [_unexplained(item) for item in diagnosis.unexplained],
        "not_observable": [asdict(item) for item in diagnosis.not_observable],
        "implausible": [asdict(item) for item in diagnosis.implausible],
        "holdout": held_out,
        "noise": dict(diagnosis.noise),
        "notes": list(diagnosis.notes),
    }
    if diagnosis.oracle is not None:
        report["oracle"] = asdict(diagnosis.oracle)
        if diagnosis.free_run is not None:
            free_run = held_out["free_run_attitude_error_60s_deg"]
            free_run["oracle"] = diagnosis.oracle.free_run_deg
    return report


def _unexplained(item: Unexplained) -> dict[str, Any]:
    return {name: value for name, value in asdict(item).items() if name != "triad"}


def _finding(finding: Finding) -> dict[str, Any]:
    row = {
        "effect": finding.effect,
        "class": list(finding.alike),
        "axes": list(finding.axes),
        "where": [asdict(where) for where in finding.where],
        "parameters": {name: asdict(value) for name, value in finding.parameters.items()},
        "p_value": finding.p_value,
        "log_evidence": finding.log_evidence,
        "rival": None if finding.rival is None else asdict(finding.rival),
        "holdout": asdict(finding.holdout),
        "explanation": finding.explanation,
        "separating_manoeuvre": finding.separating_manoeuvre,
    }
    return row
