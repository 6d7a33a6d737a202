"""What a diagnosis says, in plain sentences: the same words on the screen, the page, the viewer."""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from ahrs_service.calibration.folding import why_not_live
from ahrs_service.diagnosis.result import Diagnosis, Estimated, Finding, FreeRun, Unexplained, Where
from ahrs_service.effects.catalogue import effect_of

VERDICTS: Final = {
    "no_mismatch": "No mismatch: the recording agrees with the twin within its noise.",
    "explained": "Explained: what is named below brings recording and twin together.",
    "unexplained": "Unexplained: something real is left that no effect of the catalogue explains.",
}
"""The verdict as a sentence."""

_SPANS_SHOWN: Final = 3
_SMALLEST_POWER: Final = -3


def paragraph(finding: Finding) -> str:
    """Return one finding as a paragraph: what, where, how much, how sure, what to do."""
    parts = [_sentence(finding.explanation)]
    if finding.where:
        parts.append(f"It shows {where_text(finding.where)}.")
    parts.append(f"Fitted: {parameters_text(finding)}.")
    gain = finding.holdout.log_likelihood_gain
    parts.append(
        f"On parts of the recording it was not fitted to it gains {gain:.0f} nats of likelihood "
        f"({_chance(finding.p_value)})."
    )
    others = [one for one in finding.alike if one != finding.effect]
    if others and "cannot tell" not in finding.explanation:
        names = " or ".join(title(one) for one in others)
        parts.append(f"This recording cannot tell it from {names}.")
    if finding.separating_manoeuvre:
        parts.append(f"To be sure: {finding.separating_manoeuvre}.")
    parts.append(_sentence(live_text(finding.effect)))
    return " ".join(parts)


def live_text(effect: str) -> str:
    """Say whether the estimator can compensate an effect live, and why not."""
    why = why_not_live(effect_of(effect))
    if why is None:
        return "The estimator can compensate it live, by a calibration file"
    return (
        f"It cannot be compensated live: it {why}"
        if why.startswith("needs")
        else (f"It cannot be compensated live: {why}")
    )


def unexplained_text(item: Unexplained) -> str:
    """Return something that no effect explains, as a sentence."""
    depends = " and ".join(item.depends_on) or "nothing that was recorded"
    place = f" {where_text(item.where)}" if item.where else ""
    return (
        f"{words(item.channel)} deviates{place} and depends on {words(depends)} "
        f"({_chance(item.p_value)}); no effect of the catalogue explains it."
    )


def where_text(where: Iterable[Where]) -> str:
    """Return where something shows: "from 60 s to 150 s (vibration above 2 m/s^2)"."""
    spans = list(where)
    shown = [
        f"from {one.t0_s:.0f} s to {one.t1_s:.0f} s" + (f" ({one.regime})" if one.regime else "")
        for one in spans[:_SPANS_SHOWN]
    ]
    more = len(spans) - len(shown)
    return ", ".join(shown) + (f" and {more} more times" if more else "")


def parameters_text(finding: Finding) -> str:
    """Return the parameters with their 1-sigma and unit."""
    return ", ".join(
        f"{words(name)} {estimate_text(estimate)}" for name, estimate in finding.parameters.items()
    )


def estimate_text(estimate: Estimated) -> str:
    """Return "(0.010 ± 0.002, ...) unit", or a number without brackets."""
    value, std = np.asarray(estimate.value, np.float64), np.asarray(estimate.std, np.float64)
    unit = "" if estimate.unit == "1" else f" {estimate.unit}"
    return f"{_numbers(value, np.broadcast_to(std, value.shape))}{unit}"


def _numbers(value: Any, std: Any) -> str:
    if value.ndim:
        return "(" + ", ".join(_numbers(v, s) for v, s in zip(value, std, strict=True)) + ")"
    if not np.isfinite(std) or std <= 0.0:
        return f"{float(value):.4g}"
    # Two digits of the sigma say all; small numbers are written with their power of ten.
    size = int(np.floor(np.log10(max(abs(value), std))))
    power = size if size < _SMALLEST_POWER else 0
    digits = max(0, 1 + power - int(np.floor(np.log10(std))))
    text = f"{value / 10.0**power:.{digits}f} ± {std / 10.0**power:.{digits}f}"
    return f"({text})e{power}" if power else text


def title(effect: str) -> str:
    """Return an effect's title with its sensor: "z accelerometer" is said by the finding."""
    sensor = {"gyro": "gyro: ", "accel": "accelerometer: ", "imu": ""}
    found = effect_of(effect)
    return sensor[found.triad] + found.title


def triad_of(effect: str) -> str:
    """Return the triad whose residual a finding's held-out figures are of."""
    return "accel" if effect_of(effect).triad == "accel" else "gyro"


def unit_of(effect: str) -> str:
    """Return the unit of a finding's held-out figures."""
    return "m/s^2" if triad_of(effect) == "accel" else "rad/s"


def free_run_text(run: FreeRun) -> str:
    """Say how far the attitude runs off when the gyro is alone."""
    return (
        f"Attitude error after 60 s of the gyro alone: {run.before:.2f} deg before, "
        f"{run.after:.2f} deg after."
    )


def words(name: str) -> str:
    """Return a field's name as words."""
    return name.replace("_", " ")


def _sentence(text: str) -> str:
    text = text.strip()
    return text if text.endswith((".", "!", "?")) else f"{text}."


def _chance(p_value: float) -> str:
    if p_value < 1e-12:
        return "by chance in less than one of 10^12 recordings"
    return f"by chance in {p_value:.1g} of recordings without it"


def lacking(real: Diagnosis, simulated: Diagnosis) -> tuple[list[Finding], list[Unexplained]]:
    """Return what the real recording has that the simulated one lacks.

    A finding counts as had by the simulated one where any effect of its class was found there.
    """
    had = {one for finding in simulated.findings for one in finding.alike or (finding.effect,)}
    findings = [
        finding
        for finding in real.findings
        if not had.intersection(finding.alike or (finding.effect,))
    ]
    channels = {item.channel for item in simulated.unexplained}
    return findings, [item for item in real.unexplained if item.channel not in channels]
