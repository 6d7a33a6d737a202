"""Scores of the reports of a blind set: judged case by case, then counted.

Truth in the format of truth files, report as ahrs-mismatch/1. A `known` effect of the truth masks
a concealed one: naming it is neither right nor wrong. What an effect `implies` is not wrong either.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any, Final

import numpy as np

from ahrs_service.blind.making.case import CONTROLS

Json = dict[str, Any]

CONFIDENCE: Final = 0.95  # A choice: intervals of 95 %, 1.96 sigma
LIKE_WORDS: Final = {
    "attitude": {"attitude", "roll", "pitch", "yaw", "heading", "tilt", "gravity"},
    "rate": {"rate", "turn_rate", "angular_rate", "angular_acceleration", "rotation"},
    "acceleration": {"acceleration", "force", "specific_force", "load"},
    "airspeed": {"airspeed", "speed", "groundspeed"},
    "voltage": {"voltage", "supply", "supply_voltage", "battery_voltage"},
}
"""Terms of a report that mean the same covariate."""

_CONVENTIONS: Final = {"reference_degC", "width_degC", "order"}
"""Parameters without an interval to score: conventions, or of another form than the one fitted."""


@dataclass(frozen=True, slots=True)
class Rate:
    """`hits` of `total`, with the Wilson score interval."""

    hits: int
    total: int

    @classmethod
    def of(cls, marks: Iterable[bool | None]) -> "Rate":
        """Count the true marks among those that are not None."""
        judged = [mark for mark in marks if mark is not None]
        return cls(sum(judged), len(judged))

    @property
    def share(self) -> float:
        """Hits over total, NaN if the total is 0."""
        return self.hits / self.total if self.total else math.nan

    def interval(self) -> tuple[float, float]:
        """Bounds of the share at 95 % (Wilson 1927, without continuity correction).

        (p + z^2/2n +- z sqrt(p (1-p)/n + z^2/4n^2)) / (1 + z^2/n)
        """
        if not self.total:
            return 0.0, 1.0
        z, n, p = NormalDist().inv_cdf(0.5 + 0.5 * CONFIDENCE), self.total, self.share
        middle = p + z * z / (2 * n)
        reach = z * math.sqrt(p * (1.0 - p) / n + z * z / (4 * n * n))
        whole = 1.0 + z * z / n
        return max(0.0, (middle - reach) / whole), min(1.0, (middle + reach) / whole)


@dataclass(frozen=True, slots=True)
class Mark:
    """The marks of one report; None where a mark does not apply.

    `what` is null, control, single, concealed, pair, alike or outside; `alarm` any finding on one
    of the first two; `first` the first name (or its class) is right, `found` how many of `hidden`
    were named; `extra` a wrong name; `classed` a class was given that contains the effect;
    `covariate` the covariate of the unknown effect was given; `covered` of `intervals` contain the
    truth; `worse` a held-out gain below zero; `gain` the share of the oracle's on new data.
    """

    name: str
    what: str
    kind: str
    level: int
    note: str
    hidden: tuple[str, ...]
    named: tuple[str, ...]
    alarm: bool | None = None
    first: bool | None = None
    found: int = 0
    extra: bool | None = None
    classed: bool | None = None
    covariate: bool | None = None
    covered: int = 0
    intervals: int = 0
    worse: bool | None = None
    gain: float | None = None

    def with_gain(self, gain: float) -> "Mark":
        """Return the mark with its share of the oracle's gain on new data."""
        return replace(self, gain=gain)


def judge(name: str, truth: Json, report: Json) -> Mark:
    """Judge one report against its truth."""
    real = [entry for entry in truth["effects"] if entry["effect"] != "none"]
    hidden = [entry for entry in real if not entry.get("known")]
    ids = tuple(entry["effect"] for entry in hidden)
    findings = report["effects"]
    mark = Mark(
        name,
        _what(truth, real, hidden),
        truth["kind"],
        truth["level"],
        _note(truth),
        ids,
        tuple(finding["effect"] for finding in findings),
    )
    if mark.what in ("null", "control"):
        return replace(mark, alarm=bool(findings) or report["verdict"] != "no_mismatch")
    mark = replace(mark, worse=any(_gain(finding) < 0.0 for finding in findings))
    if mark.what == "outside":
        return replace(
            mark,
            extra=bool(findings),
            covariate=_gives_covariate(truth, report["unexplained"]),
        )
    allowed = {entry["effect"] for entry in real}
    granted = {other for entry in real for other in entry.get("implies", ())}
    granted |= allowed - set(ids)
    counted = [finding for finding in findings if not _only(finding, granted, ids)]
    covered, intervals = _coverage(hidden, findings)
    return replace(
        mark,
        first=bool(counted) and bool(names(counted[0]) & set(ids)),
        found=sum(any(one in names(finding) for finding in findings) for one in ids),
        extra=any(not names(finding) & (allowed | granted) for finding in findings),
        classed=_is_class(findings, ids) if truth.get("inseparable") else None,
        covered=covered,
        intervals=intervals,
    )


def names(finding: Json) -> set[str]:
    """Return the ids that a finding covers: its own and its class."""
    return {finding["effect"], *(finding.get("class") or ())}


def _what(truth: Json, real: list[Json], hidden: list[Json]) -> str:
    if not real:
        return "control" if _note(truth) in CONTROLS else "null"
    if any(entry["effect"] == "unknown" for entry in real):
        return "outside"
    if truth.get("inseparable"):
        return "alike"
    if len(hidden) < len(real):
        return "concealed"
    return "pair" if len(hidden) > 1 else "single"


def _note(truth: Json) -> str:
    params = [entry["params"] for entry in truth["effects"]]
    return next((str(p.get("note") or p.get("depends_on") or "") for p in params), "plain")


def _only(finding: Json, granted: set[str], ids: tuple[str, ...]) -> bool:
    """Whether a finding is of a known or implied effect and of none that is hidden."""
    return bool(names(finding) & granted) and not names(finding) & set(ids)


def _is_class(findings: list[Json], ids: tuple[str, ...]) -> bool:
    return any(set(ids) <= names(finding) and len(names(finding)) > 1 for finding in findings)


def _gain(finding: Json) -> float:
    return float((finding.get("holdout") or {}).get("log_likelihood_gain", 0.0))


def _gives_covariate(truth: Json, unexplained: list[Json]) -> bool:
    """Whether the covariate was named; on a table the force is gravity, so attitude counts too."""
    depends_on = truth["effects"][0]["params"]["depends_on"]
    words = LIKE_WORDS.get(depends_on, {depends_on})
    if depends_on == "acceleration" and truth["kind"] == "bench":
        words = words | LIKE_WORDS["attitude"]
    return bool(words & {str(word) for item in unexplained for word in item["depends_on"]})


def _coverage(hidden: list[Json], findings: list[Json]) -> tuple[int, int]:
    """Count the 95 % intervals of correctly named effects, and those that contain the truth."""
    covered = total = 0
    for entry in hidden:
        for finding in findings:
            if finding["effect"] == entry["effect"]:
                hits = _holds(entry["params"], finding["parameters"])
                covered, total = covered + int(hits.sum()), total + len(hits)
    return covered, total


def _holds(truth: Json, estimates: Json) -> Any:
    """Return, per parameter value [K], whether value +- 1.96 std contains the truth."""
    reach = NormalDist().inv_cdf(0.5 + 0.5 * CONFIDENCE)
    hits = [np.zeros(0, bool)]
    for name, value in _at_reference(truth, estimates).items():
        if name in _CONVENTIONS or name not in estimates or isinstance(value, str):
            continue
        true, found, std = (
            np.ravel(np.asarray(v, np.float64))
            for v in (value, estimates[name]["value"], estimates[name]["std"])
        )
        # The diagonal of an off-diagonal matrix is zero in both, and is no estimate.
        free = ~((true == 0.0) & (found == 0.0))
        hits.append((np.abs(found - true) <= reach * std)[free])
    return np.concatenate(hits)


def _at_reference(truth: Json, estimates: Json) -> Json:
    """Return a thermal polynomial about the report's reference temperature.

    k1 (T - T0) + k2 (T - T0)^2 about T0' has k1' = k1 + 2 k2 (T0' - T0); the rest is bias.
    """
    if "quadratic" not in truth or "reference_degC" not in estimates:
        return truth
    shift = float(estimates["reference_degC"]["value"]) - truth["reference_degC"]
    linear = np.asarray(truth["linear"]) + 2.0 * np.asarray(truth["quadratic"]) * shift
    return truth | {"linear": linear.tolist()}


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the score: what is counted, how often, and the required share."""

    title: str
    rate: Rate
    asked: str


def score(marks: list[Mark]) -> list[Row]:
    """Count the marks as the project's table of figures does."""
    hidden = sum(len(m.hidden) for m in marks if m.what == "pair")
    found = sum(m.found for m in marks if m.what == "pair")
    covered, intervals = sum(m.covered for m in marks), sum(m.intervals for m in marks)
    rows = [
        Row(f"right first, level {level}", _first(m for m in marks if m.level == level), asked)
        for level, asked in ((1, "98 %"), (2, "95 %"), (3, "80 %"), (0, ""))
    ]
    return [
        *rows,
        Row("right first, beneath a known", _first(_of(marks, "concealed")), "80 %"),
        Row("right first, pairs", _first(_of(marks, "pair")), ""),
        Row("both of a pair named", Rate(found, hidden), ""),
        Row("right, inseparable", _first(_of(marks, "alike")), ""),
        Row("class given, inseparable", Rate.of(m.classed for m in marks), ""),
        Row("nulls falsely alarmed", Rate.of(m.alarm for m in _of(marks, "null")), "<= 2 %"),
        Row("negative controls alarmed", Rate.of(m.alarm for m in _of(marks, "control")), "<= 2 %"),
        Row("wrong extra name", Rate.of(m.extra for m in marks if m.what != "outside"), "<= 5 %"),
        Row(
            "outside, named wrongly",
            Rate.of(m.extra for m in marks if m.what == "outside"),
            "<= 5 %",
        ),
        Row("outside, covariate given", Rate.of(m.covariate for m in marks), "80 %"),
        Row("intervals that hold the truth", Rate(covered, intervals), "92-97 %"),
        Row("held out worse than before", Rate.of(m.worse for m in marks), "0 %"),
    ]


def _first(marks: Iterable[Mark]) -> Rate:
    return Rate.of(mark.first for mark in marks)


def _of(marks: list[Mark], what: str) -> list[Mark]:
    return [mark for mark in marks if mark.what == what]
