"""The result of a diagnosis as frozen records; `as_json` gives a report of ahrs-mismatch/1."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final, Literal

from ahrs_service.records import Floats

SCHEMA: Final = "ahrs-mismatch/1"

Verdict = Literal["no_mismatch", "explained", "unexplained"]
Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Where:
    """A span of the recording [s on its clock] and what distinguishes it."""

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

    `log_likelihood_gain` [nats]; rms of the residual of the finding's triad per axis
    [rad/s or m/s^2]: over all frequencies, and below 0.05 Hz.
    """

    log_likelihood_gain: float
    rms_before: Vector
    rms_after: Vector
    low_frequency_rms_before: Vector
    low_frequency_rms_after: Vector


@dataclass(frozen=True, slots=True)
class Finding:
    """One missing effect: its id, and the triad it belongs to ("imu" is both).

    `alike` the ids that cannot be separated in this recording.
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
    """A significant misfit that no effect explains: `channel` as in accel_z, or accel."""

    triad: str
    channel: str
    depends_on: tuple[str, ...]
    where: tuple[Where, ...]
    p_value: float


@dataclass(frozen=True, slots=True)
class Implausible:
    """An effect that would explain part of the misfit, but only at a size that no IMU has.

    `parameters` as fitted, `plausible` the largest in data sheets, both by name; `log_evidence`
    the gain it would have [nats].
    """

    effect: str
    parameters: Mapping[str, Any]
    plausible: Mapping[str, float]
    log_evidence: float


@dataclass(frozen=True, slots=True)
class NotObservable:
    """An effect that is not observable in this recording, and why."""

    effect: str
    why: str


@dataclass(frozen=True, slots=True)
class FreeRun:
    """Attitude error after 60 s on the gyro alone [deg], rms over starts, before and after."""

    before: float
    after: float


@dataclass(frozen=True, slots=True)
class TrueEffect:
    """An effect known to be in a recording, with its parameters by name."""

    effect: str
    parameters: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Oracle:
    """The same figures for the true parameters, none of them fitted.

    `outside` the hidden effects that are not in the catalogue, in words; `found` and `oracle` the
    held-out figures, before and after, of the findings and of the truth by triad ("gyro", "accel").
    `free_run_deg` the attitude error after 60 s on the gyro alone with the true effects removed.
    """

    effects: tuple[TrueEffect, ...]
    outside: tuple[str, ...]
    found: Mapping[str, Holdout]
    oracle: Mapping[str, Holdout]
    free_run_deg: float | None


@dataclass(frozen=True, slots=True)
class Covariate:
    """Residual of one channel against one covariate, for a plot.

    `edges` [B+1] of the bins, `mean` [B] of the residual in each, `null_std` [B] its 1-sigma under
    noise alone, `fitted` [B] what the findings explain. `p_value` of the whole dependence.
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
    """Residuals over time for plots: `time_s` [N], before and after [N, 6] (gyro, accel)."""

    time_s: Floats
    before: Floats
    after: Floats


@dataclass(frozen=True, slots=True)
class Whiteness:
    """Tests of the whitened innovations [N, 6]: p-values per channel.

    `ljung_box` over 20 lags, `normality` by Jarque-Bera without glitches beyond 5 sigma.
    """

    ljung_box: tuple[float, ...]
    normality: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The complete diagnosis; `noise` holds the fitted noise parameters by name.

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
    """Return the report in the format ahrs-mismatch/1; the data of plots are left out."""
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
