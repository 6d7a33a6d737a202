"""Tables of a blind test: the score next to the baselines', by effect, and the errors."""

import statistics
from typing import Final

from rich import box
from rich.table import Table

from ahrs_service.blind.judging.scoring import Mark, Rate, score

_SHOWN: Final = 40


def share(rate: Rate) -> str:
    """Return hits and total, and the Wilson interval [%] below them: `12/13` over `67-99`."""
    if not rate.total:
        return "-"
    low, high = rate.interval()
    return f"{rate.hits}/{rate.total}\n{100 * low:.0f}-{100 * high:.0f}"


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, box=box.SIMPLE, title_justify="left", padding=(0, 1, 0, 0))
    table.add_column(columns[0], no_wrap=True)
    for column in columns[1:]:
        table.add_column(column)
    return table


def score_table(marks: dict[str, list[Mark]], count: int) -> Table:
    """Return the score: a row per figure, a column per method, with Wilson 95 % intervals."""
    table = _table(
        f"score of {count} recordings: hits/of, Wilson 95 % interval in %",
        "figure",
        "required",
        *marks,
    )
    scored = {title: score(those) for title, those in marks.items()}
    for rows in zip(*scored.values(), strict=True):
        if not any(row.rate.total for row in rows):
            continue
        table.add_row(rows[0].title, rows[0].asked, *(share(row.rate) for row in rows))
    ours = [m.gain for those in marks.values() for m in those if m.gain is not None]
    if ours:
        reached = Rate.of(gain >= 0.95 for gain in ours)
        table.add_row("held-out gain 95 % of oracle's", "", share(reached))
        table.add_row("held-out gain, median share", "95 %", f"{statistics.median(ours):.3f}")
    return table


def where_table(marks: list[Mark]) -> Table:
    """Return the share of right answers by hidden effect (or kind of null) and recording kind.

    Right is the hidden effect named first, and for a null no alarm.
    """
    kinds = ("bench", "flight", "copter")
    table = _table("by effect: named first, nulls without alarm", "hidden", *kinds)
    rows = sorted({(m.what, _label(m)) for m in marks})
    for what, label in rows:
        these = [m for m in marks if (m.what, _label(m)) == (what, label)]
        cells = [share(Rate.of(_is_right(m) for m in these if m.kind == kind)) for kind in kinds]
        table.add_row(f"{what}: {label}", *cells)
    return table


def misses_table(marks: list[Mark], failures: dict[str, str]) -> Table:
    """Return the recordings diagnosed wrongly: what was hidden and what was named."""
    table = _table("what went wrong", "recording", "level", "hidden", "named")
    wrong = [m for m in marks if not _is_right(m) or m.extra]
    for mark in wrong[:_SHOWN]:
        named = failures.get(mark.name) or ", ".join(mark.named) or "nothing"
        table.add_row(mark.name, f"{mark.kind} {mark.level}", f"{mark.what}: {_label(mark)}", named)
    if len(wrong) > _SHOWN:
        table.add_row(f"and {len(wrong) - _SHOWN} more", "", "", "")
    return table


def _label(mark: Mark) -> str:
    return " + ".join(mark.hidden) if mark.what not in ("null", "control", "outside") else mark.note


def _is_right(mark: Mark) -> bool:
    if mark.what in ("null", "control"):
        return not mark.alarm
    return bool(mark.covariate and not mark.extra) if mark.what == "outside" else bool(mark.first)
