"""A diagnosis in plain sentences: the same words on the screen, the page and the viewer."""

import re
from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from ahrs_service.diagnosis.result import (
    Diagnosis,
    Estimated,
    Finding,
    FreeRun,
    Implausible,
    Unexplained,
    Vector,
    Where,
)
from ahrs_service.effects.catalogue import effect_of, often_taken_for

VERDICTS: Final = {
    "no_mismatch": "No mismatch: the recording agrees with the twin within its noise.",
    "explained": "Explained: with the effects below the twin agrees with the recording.",
    "unexplained": "Unexplained: a real difference is left that no known effect explains.",
}
"""The verdict as a sentence."""

TRUTH_HEAD: Final = ("effect", "parameter", "true", "found")
ORACLE_HEAD: Final = ("", "before", "found", "oracle")
"""Columns of `beside_truth` and `held_out_beside_truth`."""

DOUBTFUL_TRUTH: Final = (
    "the true parameters fit this recording worse than none: is this its truth file?"
)

_UNIT_IN_NAME: Final = re.compile("_(s|m|hz|a|rad|degC|rad_s_per_m_s2)$")
_SPANS_SHOWN: Final = 3
_SMALLEST_POWER: Final = -3


def paragraph(finding: Finding, has_numbers: bool = True) -> str:
    """Return one finding as a paragraph: what, where, how much, how sure, what to do."""
    parts = [_sentence(finding.explanation)]
    if finding.where:
        parts.append(f"It is largest {where_text(finding.where)}.")
    if has_numbers:
        parts.append(f"Fitted: {parameters_text(finding)}.")
    parts.append(f"Added to the reading: {effect_of(finding.effect).equation}.")
    parts.append(_held_out_text(finding))
    others = [one for one in finding.alike if one != finding.effect]
    if others and "cannot tell" not in finding.explanation:
        names = " or ".join(title(one) for one in others)
        parts.append(f"This recording cannot tell it from {names}.")
    mistaken = [one for one in often_taken_for(effect_of(finding.effect)) if one not in others]
    if mistaken:
        parts.append(f"It is often mistaken for {' or '.join(title(one) for one in mistaken)}.")
    if finding.separating_manoeuvre:
        parts.append(f"To separate them: {finding.separating_manoeuvre}.")
    parts.append(_sentence(live_text(finding.effect)))
    return " ".join(parts)


def _held_out_text(finding: Finding) -> str:
    """Return the held-out gain as a sentence, for the axis and band that improve most."""
    held = finding.holdout
    before = np.array([held.rms_before, held.low_frequency_rms_before])
    after = np.array([held.rms_after, held.low_frequency_rms_after])
    band, axis = np.unravel_index(np.argmin(after / np.maximum(before, 1e-30)), before.shape)
    return (
        f"On held-out parts of the recording it gains {held.log_likelihood_gain:.0f} "
        f"nats of log-likelihood ({_chance(finding.p_value)}), and the {triad_of(finding.effect)} "
        f"residual on {'xyz'[axis]}{' below 0.05 Hz' if band else ''} drops from "
        f"{before[band, axis]:.3g} to {after[band, axis]:.3g} {unit_of(finding.effect)} rms."
    )


def live_text(effect: str) -> str:
    """Return a sentence on whether the estimator can compensate an effect live, or why not."""
    why = effect_of(effect).why_not_live
    if why is None:
        return "The estimator can compensate it live, with a calibration file"
    return (
        f"It cannot be compensated live: it {why}"
        if why.startswith("needs")
        else (f"It cannot be compensated live: {why}")
    )


def unexplained_text(item: Unexplained) -> str:
    """Return an unexplained dependence as a sentence."""
    depends = " and ".join(item.depends_on) or "nothing that was recorded"
    place = f" {where_text(item.where)}" if item.where else ""
    return (
        f"{words(item.channel)} deviates{place} and depends on {words(depends)} "
        f"({_chance(item.p_value)}); no known effect explains it."
    )


def implausible_text(item: Implausible) -> str:
    """Return a sentence on an effect that would explain the data only at an implausible size."""
    sizes = ", ".join(
        f"{parameter_text(name)} {estimate_text(Estimated(item.parameters[name], 0.0, '1'))} "
        f"(data sheets: up to {largest:.2g})"
        for name, largest in item.plausible.items()
    )
    return (
        f"Implausible: {title(item.effect)} ({item.effect}) would gain {item.log_evidence:.0f} "
        f"nats, but with {sizes}; look for another cause in recording, reference or vehicle."
    )


def where_text(where: Iterable[Where]) -> str:
    """Return the spans of a finding: "from 60 s to 150 s (vibration above 2 m/s^2)"."""
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
        f"{parameter_text(name)} {estimate_text(estimate)}"
        for name, estimate in finding.parameters.items()
    )


def parameter_rows(finding: Finding) -> list[tuple[str, ...]]:
    """Return the parameters as rows of name with unit, x, y, z; a scalar is under x."""
    rows = []
    for name, estimate in finding.parameters.items():
        value, std = np.asarray(estimate.value), np.asarray(estimate.std)
        unit = "" if estimate.unit == "1" else f" [{estimate.unit}]"
        label = f"{parameter_text(name)}{unit}"
        lines = zip(np.atleast_2d(value), np.atleast_2d(std), strict=True)
        for axis, (values, stds) in zip("xyz", lines, strict=False):
            cells = [_numbers(v, s) for v, s in zip(values, stds, strict=True)]
            cells += [""] * (3 - len(cells))
            rows.append((f"{label} of {axis}" if value.ndim == 2 else label, *cells))
    return rows


def parameter_text(name: str) -> str:
    """Return a parameter's name as words, without the unit that follows its value."""
    return words(name if name.startswith("per_") else _UNIT_IN_NAME.sub("", name))


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
    # Two digits of the sigma are enough; small numbers are written with their power of ten.
    size = int(np.floor(np.log10(max(abs(value), std))))
    power = size if size < _SMALLEST_POWER else 0
    digits = max(0, 1 + power - int(np.floor(np.log10(std))))
    text = f"{value / 10.0**power:.{digits}f} ± {std / 10.0**power:.{digits}f}"
    return f"({text})e{power}" if power else text


def title(effect: str) -> str:
    """Return an effect's title after its sensor, as in "gyro: scale factor error"."""
    sensor = {"gyro": "gyro: ", "accel": "accelerometer: ", "imu": ""}
    found = effect_of(effect)
    return sensor[found.triad] + found.title


def triad_of(effect: str) -> str:
    """Return the triad that a finding's held-out figures are given for."""
    return "accel" if effect_of(effect).triad == "accel" else "gyro"


def unit_of(effect: str) -> str:
    """Return the unit of a finding's held-out figures."""
    return "m/s^2" if triad_of(effect) == "accel" else "rad/s"


def free_run_text(run: FreeRun) -> str:
    """Return a sentence on the attitude drift of the gyro integrated alone."""
    return (
        f"Attitude error after 60 s on the gyro alone: {run.before:.2f} deg before, "
        f"{run.after:.2f} deg after."
    )


def beside_truth(diagnosis: Diagnosis) -> list[tuple[str, str, str, str]]:
    """Return rows of effect, parameter, true and found value, for every true or found effect."""
    oracle = diagnosis.oracle
    if oracle is None:
        return []
    found = {finding.effect: finding for finding in diagnosis.findings}
    rows = []
    for true in oracle.effects:
        mine = found.pop(true.effect, None)
        inside = [one.effect for one in found.values() if true.effect in one.alike]
        for name, value in true.parameters.items():
            unit = {p.name: p.unit for p in effect_of(true.effect).parameters}[name]
            known = estimate_text(Estimated(value, np.zeros(np.shape(value)), unit))
            if mine is not None:
                got = estimate_text(mine.parameters[name])
            else:
                got = f"in the class of {inside[0]}" if inside else "not found"
            rows.append((true.effect, parameter_text(name), known, got))
    rows += [(what, "", "not in the catalogue", "") for what in oracle.outside]
    for finding in found.values():
        if not any(true.effect in finding.alike for true in oracle.effects):
            rows.append((finding.effect, "", "not present", parameters_text(finding)))
    return rows


def held_out_beside_truth(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    """Return rows of figure, before, with the findings, with the truth: all on held-out parts."""
    oracle = diagnosis.oracle
    if oracle is None:
        return []
    gains = [triads["gyro"].log_likelihood_gain for triads in (oracle.found, oracle.oracle)]
    rows = [("log-likelihood gain [nats]", "0", *(f"{gain:.1f}" for gain in gains))]
    for triad, unit in (("gyro", "rad/s"), ("accel", "m/s^2")):
        mine, true = oracle.found[triad], oracle.oracle[triad]
        whole = mine.rms_before, mine.rms_after, true.rms_after
        rows += _per_axis(f"{triad} {{}} rms [{unit}]", whole)
        slow = (
            mine.low_frequency_rms_before,
            mine.low_frequency_rms_after,
            true.low_frequency_rms_after,
        )
        rows += _per_axis(f"{triad} {{}} rms below 0.05 Hz [{unit}]", slow)
    run = diagnosis.free_run
    if run is not None and oracle.free_run_deg is not None:
        figures = run.before, run.after, oracle.free_run_deg
        rows.append(
            ("attitude error after 60 s on gyro alone [deg]", *(f"{one:.3f}" for one in figures))
        )
    return rows


def _per_axis(name: str, sides: Iterable[Vector]) -> list[tuple[str, ...]]:
    return [
        (name.format(axis), *(f"{value:.3g}" for value in values))
        for axis, values in zip("xyz", zip(*sides, strict=True), strict=True)
    ]


def words(name: str) -> str:
    """Return a field's name as words."""
    return name.replace("_", " ")


def _sentence(text: str) -> str:
    text = text.strip()
    return text if text.endswith((".", "!", "?")) else f"{text}."


def _chance(p_value: float) -> str:
    if p_value < 1e-12:
        return "chance of a false alarm below 1e-12"
    return f"chance of a false alarm {p_value:.1g}"


def lacking(real: Diagnosis, simulated: Diagnosis) -> tuple[list[Finding], list[Unexplained]]:
    """Return what the real recording has that the simulated one lacks.

    A finding is not lacking where any effect of its class was found in the simulated one.
    """
    had = {one for finding in simulated.findings for one in finding.alike or (finding.effect,)}
    findings = [
        finding
        for finding in real.findings
        if not had.intersection(finding.alike or (finding.effect,))
    ]
    channels = {item.channel for item in simulated.unexplained}
    return findings, [item for item in real.unexplained if item.channel not in channels]
