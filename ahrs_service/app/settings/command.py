"""List every setting: type, unit, value and meaning.

Without options the values are the defaults; with --profile, --config or --set those that `run`
would use. --toml prints them as a complete settings file, which `run --config` reads back.

Examples:
  ahrs-service settings
  ahrs-service settings --toml > config.toml
  ahrs-service settings --profile multirotor --set gate.norm_m_s2=0.4 --toml

"""

import argparse
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Final

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from ahrs_service.app import options
from ahrs_service.app.settings.listing import AIRFRAMES, Setting, heading, listed
from ahrs_service.settings import Settings

_WIDTH: Final = 98


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `settings`."""
    options.add_settings(parser)
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--markdown", action="store_true", help="print Markdown tables")
    form.add_argument("--toml", action="store_true", help="print a complete settings file")


def run(arguments: argparse.Namespace) -> int:
    """Print the settings; return the exit code."""
    settings = options.settings_of(arguments)
    console = Console()
    if arguments.toml:
        console.out(toml(settings), highlight=False)
    elif arguments.markdown:
        console.out(markdown(settings), highlight=False)
    else:
        _show(settings, console)
    return 0


def toml(settings: Settings) -> str:
    """Return a complete settings file with each setting's meaning above it."""
    lines = [
        "# Settings of ahrs-service, complete. A file needs only what differs from the defaults."
    ]
    for section, rows in _sections(settings):
        lines += ["", *_comment(heading(section)), f"[{section}]"]
        for row in rows:
            unit = f" [{row.unit}]" if row.unit else ""
            lines += _comment(f"{row.meaning}{unit}: {row.kind}.")
            # TOML has no null: what is not set is left out.
            lines.append(f"# {row.name} =" if row.value == "none" else f"{row.name} = {row.value}")
    return "\n".join(lines)


def markdown(settings: Settings) -> str:
    """Return one table per section; the classes of vehicle share one."""
    parts = []
    for table in _tables(settings):
        title = ", ".join(f"`[{name}]`" for name in table.sections)
        lines = [f"### {title}", "", heading(table.sections[0]), ""]
        lines += [_line(table.columns), _line(["---"] * len(table.columns))]
        lines += [_line([f"`{name}`", *cells]) for name, *cells in table.rows]
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, _WIDTH, initial_indent="# ", subsequent_indent="#   ")


def _sections(settings: Settings) -> Iterator[tuple[str, list[Setting]]]:
    for section, rows in groupby(listed(settings), lambda row: row.section):
        yield section, list(rows)


@dataclass(frozen=True, slots=True)
class _Table:
    """The settings of one section, or of several that share their fields."""

    sections: tuple[str, ...]
    columns: list[str]
    rows: list[list[str]]


def _tables(settings: Settings) -> Iterator[_Table]:
    values = dict(_sections(settings))
    for section, rows in values.items():
        if section in AIRFRAMES[1:]:
            continue
        shared = AIRFRAMES if section in AIRFRAMES else (section,)
        value_columns = list(shared) if len(shared) > 1 else ["value"]
        yield _Table(
            shared,
            ["setting", "type", "unit", *value_columns, "meaning"],
            [
                [row.name, row.kind, row.unit, *(values[n][i].value for n in shared), row.meaning]
                for i, row in enumerate(rows)
            ],
        )


def _show(settings: Settings, console: Console) -> None:
    for one in _tables(settings):
        names = ", ".join(f"[{name}]" for name in one.sections)
        title = Text(f"{names}  {heading(one.sections[0])}")
        table = Table(title=title, title_justify="left", header_style="bold", expand=True)
        for column in one.columns:
            table.add_column(column, overflow="fold", no_wrap=column == "setting")
        for row in one.rows:
            table.add_row(*map(escape, row))
        console.print(table)
