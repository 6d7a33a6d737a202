"""Results of a replay as plain numbers: for the tables, for JSON, for the fleet."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from ahrs_service.app.statistics import gate_shares
from ahrs_service.comparison import Comparison, compare
from ahrs_service.estimator import Estimator
from ahrs_service.fusion import heading
from ahrs_service.links.logs.recording import Recording
from ahrs_service.records import Flag, Gate, ImuSource, Kind, Phase, Rows
from ahrs_service.settings import IntakeSettings

LOW_RATE_HZ: Final = 20.0
_HEADINGS: Final = {heading.FIELD: "magnetometer", heading.VELOCITY: "velocity over ground"}
_SESSION_STEP_NS: Final = 60_000_000_000
_HIGHRES: Final = (ImuSource.HIGHRES_IMU, ImuSource.HIGHRES_IMU_1, ImuSource.HIGHRES_IMU_2)
_SECOND: Final = (ImuSource.SCALED_IMU2, ImuSource.HIGHRES_IMU_1)
_THIRD: Final = (ImuSource.SCALED_IMU3, ImuSource.HIGHRES_IMU_2)


@dataclass(frozen=True, slots=True)
class Summary:
    """One replay in numbers: SI units, NaN where there is nothing.

    `gate_time` shares of time by the gate's state, `gate_reasons` shares of the running time in
    which each reason held; `flags` samples per finding; `sources` samples per IMU source;
    `smoothed` whether the attitude was, and its comparison.
    """

    log: str
    format: str
    duration_s: float
    readings: int
    samples: int
    message_counts: dict[str, int]
    damaged: dict[str, int]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    sources: dict[str, int]
    source_changes: int
    foreign: int
    imu_rate_hz: float
    flags: dict[str, int]
    temperature_min_degc: float
    temperature_max_degc: float
    temperature_origin: str
    gate_time: dict[str, float]
    gate_reasons: dict[str, float]
    running_s: float
    reference: str
    reference_is_truth: bool
    other_references: tuple[str, ...]
    comparison: Comparison | None
    smoothed: bool
    smoothed_comparison: Comparison | None
    heading: str
    settings_origin: str
    calibration: str
    digest: str

    def to_plain(self) -> dict[str, Any]:
        """Return nested dictionaries for JSON, None for NaN."""
        plain: dict[str, Any] = _plain(dataclasses.asdict(self))
        return plain


def summarise(
    recording: Recording,
    estimator: Estimator,
    estimates: Rows,
    settings: IntakeSettings,
    settings_origin: str,
    calibration: str,
    smoothed: Rows | None = None,
) -> Summary:
    """Compute the summary of one replay from its causal and its smoothed estimates."""
    steps = _steps_s(estimates)
    running = estimates["phase"] == Phase.RUNNING
    source = int(estimator.state["heading_source"][0])
    measured = source != heading.NONE
    system, component = (int(estimator.intake_state[n][0]) for n in ("system", "component"))
    references = sorted(
        recording.references_of((system, component)), key=lambda one: not one.is_truth
    )
    reference = references[0] if references else None
    comparison, smoothed_comparison = (
        compare(rows, reference.time_ns, reference.ned_from_body, measured)
        if reference is not None and rows is not None and len(rows)
        else None
        for rows in (estimates, smoothed)
    )
    rate_hz = _rate_hz(estimates)
    degc = estimates["temperature_degc"]
    degc = degc[np.isfinite(degc)]
    return Summary(
        log=recording.path.name,
        format=recording.format,
        duration_s=float(steps.sum()),
        readings=len(recording.readings),
        samples=len(estimates),
        message_counts=dict(recording.message_counts),
        damaged=dict(recording.damaged),
        notes=recording.notes,
        warnings=_warnings(recording, estimates, rate_hz, settings),
        sources=_sources(estimates),
        source_changes=int(estimator.intake_state["source_changes"][0]),
        foreign=int(estimator.intake_state["foreign"][0]),
        imu_rate_hz=rate_hz,
        flags=_counts(estimates["flags"], Flag),
        temperature_min_degc=float(degc.min()) if len(degc) else math.nan,
        temperature_max_degc=float(degc.max()) if len(degc) else math.nan,
        temperature_origin=_temperature_origin(recording, estimates, settings),
        gate_time=gate_shares(estimates),
        gate_reasons=_gate_reasons(estimates, running),
        running_s=float(steps[running].sum()),
        reference="" if reference is None else reference.name,
        reference_is_truth=reference is not None and reference.is_truth,
        other_references=tuple(one.name for one in references[1:]),
        comparison=comparison,
        smoothed=smoothed is not None,
        smoothed_comparison=smoothed_comparison,
        heading=_HEADINGS.get(source, "free"),
        settings_origin=settings_origin,
        calibration=calibration,
        digest=estimator.digest.hexdigest(),
    )


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _steps_s(estimates: Rows) -> Any:
    """Time from each sample to the next [s], without the gap between two sessions of a log."""
    steps = np.diff(estimates["time_ns"], append=estimates["time_ns"][-1:])
    return np.where((steps > 0) & (steps < _SESSION_STEP_NS), steps, 0) * 1e-9


def _rate_hz(estimates: Rows) -> float:
    steps = np.diff(estimates["time_ns"])
    steps = steps[(steps > 0) & (steps < _SESSION_STEP_NS)]
    # The mean over the usual steps: the median of steps of 2.5 and 5 ms would be wrong.
    usual = steps[steps < 5 * np.median(steps)] if len(steps) else steps
    return float(1e9 / usual.mean()) if len(usual) else math.nan


def _sources(estimates: Rows) -> dict[str, int]:
    numbers, counts = np.unique(estimates["source"], return_counts=True)
    pairs = sorted(zip(counts.tolist(), numbers.tolist(), strict=True), reverse=True)
    return {ImuSource(number).name: count for count, number in pairs}


def _counts(column: Any, names: type[Flag]) -> dict[str, int]:
    found = {name.name or "": int(np.count_nonzero(column & name)) for name in names if name}
    return {name.lower(): count for name, count in found.items() if count}


def _gate_reasons(estimates: Rows, running: Any) -> dict[str, float]:
    gate = estimates["gate"][running]
    total = max(len(gate), 1)
    shares = {"open": float(np.count_nonzero(gate == 0) / total)}
    for reason in Gate:
        if reason and (count := np.count_nonzero(gate & reason)):
            shares[(reason.name or "").lower().replace("_", " ")] = float(count / total)
    return shares


def _imu_of(source: int) -> int:
    return 1 if source in _SECOND else 2 if source in _THIRD else 0


def _temperature_origin(recording: Recording, estimates: Rows, settings: IntakeSettings) -> str:
    """Name the sources whose temperature belongs to the IMU in use and is trusted."""
    if not np.isfinite(estimates["temperature_degc"]).any():
        return "none"
    readings = recording.readings
    warm = readings[(readings["kind"] == Kind.IMU) & np.isfinite(readings["temperature_degc"])]
    used = {_imu_of(source) for source in np.unique(estimates["source"]).tolist()}
    trusted = settings.temperature_source == "highres_imu"
    names = [
        ImuSource(source).name
        for source in np.unique(warm["source"]).tolist()
        if _imu_of(source) in used and (trusted or source not in _HIGHRES)
    ]
    return ", ".join(names)


def _warnings(
    recording: Recording, estimates: Rows, rate_hz: float, settings: IntakeSettings
) -> tuple[str, ...]:
    found = []
    if rate_hz < LOW_RATE_HZ:
        found.append(_low_rate_warning(rate_hz))
    readings = recording.readings
    highres = readings[np.isin(readings["source"], _HIGHRES) & (readings["kind"] == Kind.IMU)]
    degc = highres["temperature_degc"]
    degc = degc[np.isfinite(degc) & (degc != 0.0)]
    cold = not np.isfinite(estimates["temperature_degc"]).any()
    if settings.temperature_source == "imu" and len(degc) and cold:
        found.append(
            f"HIGHRES_IMU carries {degc.min():.1f} to {degc.max():.1f} degC, which autopilots fill "
            "from the barometer or the air, so it is not used; if the writer of this log put the "
            "IMU's own there, add --set intake.temperature_source=highres_imu"
        )
    if not (estimates["phase"] == Phase.RUNNING).any():
        found.append("the log ends before the alignment did: there is no attitude to judge")
    return tuple(found)


def _low_rate_warning(rate_hz: float) -> str:
    consequence = (
        "rotation between samples is lost, so the attitude follows the accelerometer alone and "
        "is meaningless in manoeuvres"
        if rate_hz < 5.0
        else "fast rotation between samples is lost, so roll and pitch lag and err in manoeuvres"
    )
    return f"IMU at {rate_hz:.1f} Hz, below {LOW_RATE_HZ:.0f} Hz: {consequence}"
