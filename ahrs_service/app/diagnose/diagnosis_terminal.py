"""A diagnosis on the terminal: verdict, one paragraph per finding, held-out figures."""

from collections.abc import Iterator, Sequence

from rich import box
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from ahrs_service.app.diagnose import diagnosis_text as text
from ahrs_service.diagnosis.result import Diagnosis

_STYLES = {"no_mismatch": "green", "explained": "yellow", "unexplained": "red"}


def summary(name: str, diagnosis: Diagnosis) -> RenderableType:
    """Return the whole diagnosis as tables and paragraphs."""
    return Group(*_parts(name, diagnosis))


def _parts(name: str, diagnosis: Diagnosis) -> Iterator[RenderableType]:
    yield Text(name, style="bold")
    yield Text(text.VERDICTS[diagnosis.verdict], style=_STYLES[diagnosis.verdict])
    if diagnosis.findings:
        yield findings_table(diagnosis)
    for number, finding in enumerate(diagnosis.findings, start=1):
        yield Padding(Text(f"{number}. {text.paragraph(finding)}"), (0, 0, 1, 0))
    for item in diagnosis.unexplained:
        yield Text(f"? {text.unexplained_text(item)}", style="red")
    for implausible in diagnosis.implausible:
        yield Text(f"! {text.implausible_text(implausible)}", style="yellow")
    if diagnosis.findings:
        yield holdout_table(diagnosis)
    if diagnosis.free_run is not None:
        yield Text(text.free_run_text(diagnosis.free_run))
    if diagnosis.oracle is not None:
        yield _table("compared with the truth", text.TRUTH_HEAD, text.beside_truth(diagnosis))
        rows = text.held_out_beside_truth(diagnosis)
        yield _table("on held-out parts, compared with the truth", text.ORACLE_HEAD, rows)
    if diagnosis.not_observable:
        yield not_observable_table(diagnosis)
    for note in diagnosis.notes:
        yield Text(f"note: {note}", style="dim")


def findings_table(diagnosis: Diagnosis) -> Table:
    """Return one row per finding with its figures."""
    table = Table(title="missing effects", title_justify="left", box=box.SIMPLE)
    table.add_column("effect", no_wrap=True)
    table.add_column("axes")
    for name in ("log evidence", "next best", "held-out gain"):
        table.add_column(name, justify="right")
    for finding in diagnosis.findings:
        rival = finding.rival
        table.add_row(
            escape(finding.effect),
            " ".join(finding.axes),
            f"{finding.log_evidence:.1f}",
            escape(f"{rival.effect}\n{rival.log_evidence:.1f}") if rival else "-",
            f"{finding.holdout.log_likelihood_gain:.1f}",
        )
    return table


def holdout_table(diagnosis: Diagnosis) -> Table:
    """Return the residual on held-out parts before and after each finding."""
    table = Table(title="on held-out parts of the recording", title_justify="left", box=box.SIMPLE)
    table.add_column("")
    for name in ("x", "y", "z"):
        table.add_column(f"{name} before → after", justify="right")
    for finding in diagnosis.findings:
        held = finding.holdout
        for what, before, after in (
            ("", held.rms_before, held.rms_after),
            (
                ", below 0.05 Hz",
                held.low_frequency_rms_before,
                held.low_frequency_rms_after,
            ),
        ):
            name = f"{text.triad_of(finding.effect)} rms{what} [{text.unit_of(finding.effect)}]"
            cells = (f"{old:.3g} → {new:.3g}" for old, new in zip(before, after, strict=True))
            table.add_row(name, *cells)
    return table


def _table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(*head, title=title, title_justify="left", box=box.SIMPLE)
    for row in rows:
        table.add_row(*(escape(cell) for cell in row))
    return table


def not_observable_table(diagnosis: Diagnosis) -> Table:
    """Return the effects that are not observable in this recording, and why."""
    table = Table(
        title="not observable in this recording", title_justify="left", box=box.SIMPLE, style="dim"
    )
    table.add_column("effect")
    table.add_column("why", overflow="fold")
    for item in diagnosis.not_observable:
        table.add_row(escape(item.effect), escape(item.why))
    return table
