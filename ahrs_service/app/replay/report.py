"""A replay's summary as tables for the terminal."""

import math
from collections.abc import Callable, Iterable
from typing import Final

from rich import box
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from ahrs_service.app.replay.summary import Summary
from ahrs_service.comparison import Comparison, ErrorStatistics, HeadingError

RULES: Final = (
    "Errors are our attitude minus the log's, at its instants, where our filter runs; Euler "
    "angles beyond 75 deg of pitch left out. Steady flight, from the reference alone: body rate "
    "below 0.15 rad/s, roll and pitch within 25 deg, for at least 2 s."
)
_MESSAGES_SHOWN: Final = 12
_WIDE: Final = 160


def log_table(summary: Summary) -> RenderableType:
    """Return the full table of one log."""
    table = Table(title=escape(summary.log), title_justify="left", show_header=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for name, text in _rows(summary):
        table.add_row(name, escape(text))
    parts: list[RenderableType] = [table]
    if summary.comparison is not None:
        parts.append(error_table(summary, summary.comparison))
    if summary.smoothed_comparison is not None:
        parts.append(error_table(summary, summary.smoothed_comparison, "smoothed: "))
    parts += [Text(f"warning: {warning}", style="yellow") for warning in summary.warnings]
    return Group(*parts)


def summary_table(summaries: Iterable[Summary], width: int) -> Table:
    """Return one row per log with roll and pitch errors [deg]; more columns where `width` allows.

    Whole flight: 1-sigma and max; steady flight: 1-sigma; smoothed, if requested: 1-sigma.
    """
    summaries = list(summaries)
    table = Table(
        title="all logs: 1-sigma of roll and pitch errors in deg",
        title_justify="left",
        box=box.SIMPLE,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    smoothed = any(summary.smoothed for summary in summaries)
    columns = _COLUMNS + _SMOOTHED if smoothed else _COLUMNS
    if width < _WIDE:
        left_out = _NOT_WITH_SMOOTHED if smoothed else ()
        columns = tuple(one for one in columns if one[1] and one[0] not in left_out)
    table.add_column("log", overflow="fold", min_width=16)
    for name, _, _ in columns:
        table.add_column(name.replace(" ", "\n"), justify="right", no_wrap=True)
    for summary in summaries:
        cells = (cell(summary) for _, _, cell in columns)
        table.add_row(escape(summary.log), *(escape(text) for text in cells))
    return table


def _error_cell(axis: str, figure: str, comparison: str = "comparison") -> Callable[[Summary], str]:
    def cell(summary: Summary) -> str:
        found = getattr(summary, comparison)
        return "-" if found is None else _degrees(getattr(getattr(found, axis), figure))

    return cell


def _rows(summary: Summary) -> Iterable[tuple[str, str]]:
    duration_s = summary.duration_s
    yield "format", summary.format
    yield "duration", f"{duration_s:.1f} s, attitude for {summary.running_s:.1f} s"
    yield "messages", _messages(summary)
    if summary.damaged:
        yield "damaged", _listed(summary.damaged)
    yield "IMU", _imu(summary)
    yield "gaps, clock", _clock(summary)
    others = {
        name: count
        for name, count in summary.flags.items()
        if name not in ("gap", "clock_jump", "duplicate", "reordered", "source_changed")
    }
    if others:
        yield "findings", _listed(others)
    if summary.foreign:
        yield "not adopted", f"{summary.foreign} readings of other vehicles or before a HEARTBEAT"
    yield "temperature", _temperature(summary)
    shares = {name: 100.0 * share for name, share in summary.gate_reasons.items()}
    yield "gate", ", ".join(f"{name} {share:.1f} %" for name, share in shares.items())
    yield "heading", _heading(summary)
    for note in summary.notes:
        yield "note", note
    yield "settings", summary.settings_origin
    yield "calibration", summary.calibration


def _messages(summary: Summary) -> str:
    """List the most frequent messages and their rates."""
    duration_s = max(summary.duration_s, 1e-9)
    ordered = sorted(summary.message_counts.items(), key=lambda item: -item[1])
    shown = [f"{name} {n} ({n / duration_s:.1f} Hz)" for name, n in ordered[:_MESSAGES_SHOWN]]
    more = len(ordered) - len(shown)
    if more > 0:
        shown.append(f"{more} more names")
    return f"{sum(summary.message_counts.values())}: " + ", ".join(shown)


def _imu(summary: Summary) -> str:
    used = ", ".join(f"{name} {count}" for name, count in summary.sources.items()) or "none"
    times = {0: "", 1: ", source changed once"}
    changes = times.get(summary.source_changes, f", source changed {summary.source_changes} times")
    return f"{used} samples at {_number(summary.imu_rate_hz, 1)} Hz{changes}"


def _clock(summary: Summary) -> str:
    names = ("gap", "clock_jump", "duplicate", "reordered", "realigned")
    return ", ".join(f"{summary.flags.get(name, 0)} {name.replace('_', ' ')}" for name in names)


def _span(summary: Summary) -> str:
    if math.isnan(summary.temperature_min_degc):
        return "-"
    return f"{summary.temperature_min_degc:.1f}..{summary.temperature_max_degc:.1f}"


def _temperature(summary: Summary) -> str:
    if math.isnan(summary.temperature_min_degc):
        return "no temperature of the IMU itself"
    return f"{_span(summary)} degC from {summary.temperature_origin}"


def _heading(summary: Summary) -> str:
    if summary.heading == "free":
        return "free: no usable heading source"
    found = summary.comparison.heading if summary.comparison is not None else None
    if not isinstance(found, HeadingError):
        return summary.heading
    return (
        f"{summary.heading}; against {summary.reference}: 1-sigma {_degrees(found.sigma_rad)}, "
        f"max {_degrees(found.max_rad)} deg about a mean of {_degrees(found.offset_rad)} deg, "
        f"drift {_degrees(60.0 * found.drift_rad_s)} deg/min"
    )


def error_table(summary: Summary, found: Comparison, whose: str = "") -> Table:
    """Return the errors against the log's own attitude, whole and steady flight."""
    kind = "truth" if summary.reference_is_truth else "the log's own estimate"
    lag = ""
    if not math.isnan(found.lag_s):
        order = "later" if found.lag_s >= 0.0 else "earlier"
        lag = f", {abs(1e3 * found.lag_s):.0f} ms {order} than ours"
    caption = (
        f"{found.compared} instants; {found.out_of_reach} without our attitude close "
        f"by, {found.steep} beyond 75 deg of pitch. {RULES}"
    )
    table = Table(
        title=f"{whose}error against {escape(summary.reference)} ({kind}{lag}) in deg",
        title_justify="left",
        caption=None if whose else caption,
        caption_justify="left",
    )
    for name in ("", "instants", "mean", "1-sigma", "rms", "max"):
        table.add_column(name, justify="left" if not name else "right")
    steady = f"steady ({found.steady_s:.0f} s)"
    for name, one in (
        ("roll, whole", found.roll),
        ("pitch, whole", found.pitch),
        ("tilt, whole", found.tilt),
        (f"roll, {steady}", found.steady_roll),
        (f"pitch, {steady}", found.steady_pitch),
    ):
        table.add_row(name, str(one.count), *_cells(one))
    return table


def _cells(one: ErrorStatistics) -> list[str]:
    return [_degrees(value) for value in (one.mean, one.sigma, one.rms, one.max)]


def _degrees(angle: float) -> str:
    return _number(math.degrees(angle), 2)


def _number(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items())


_COLUMNS: Final[tuple[tuple[str, bool, Callable[[Summary], str]], ...]] = (
    ("min", True, lambda one: _number(one.duration_s / 60.0, 1)),
    ("IMU", False, lambda one: " ".join(one.sources)),
    ("Hz", True, lambda one: _number(one.imu_rate_hz, 0)),
    ("gaps", True, lambda one: str(one.flags.get("gap", 0))),
    ("jumps", True, lambda one: str(one.flags.get("clock_jump", 0))),
    ("degC", False, _span),
    ("open %", True, lambda one: _number(100.0 * one.gate_reasons.get("open", math.nan), 0)),
    ("reference", False, lambda one: one.reference or "none"),
    ("roll", True, _error_cell("roll", "sigma")),
    ("pitch", True, _error_cell("pitch", "sigma")),
    ("roll max", False, _error_cell("roll", "max")),
    ("pitch max", False, _error_cell("pitch", "max")),
    ("steady roll", True, _error_cell("steady_roll", "sigma")),
    ("steady pitch", True, _error_cell("steady_pitch", "sigma")),
)
"""Heading, whether also shown on a narrow terminal, and the cell's text."""
_SMOOTHED: Final[tuple[tuple[str, bool, Callable[[Summary], str]], ...]] = (
    ("smooth roll", True, _error_cell("roll", "sigma", "smoothed_comparison")),
    ("smooth pitch", True, _error_cell("pitch", "sigma", "smoothed_comparison")),
)
"""The same, where the attitude was smoothed,"""
_NOT_WITH_SMOOTHED: Final = ("gaps", "jumps")
"""and what makes place for them on a narrow terminal."""
