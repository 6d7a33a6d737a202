"""Changes an autopilot's parameters so that nothing is lost: backup, write, read back.

The old values are on the disk before the first is changed; the switches that turn a compensation
on stay off while its figures change, so that a link that dies in the middle leaves none of it half
in force; what is read back is compared, and after the last all are read once more.
"""

import asyncio
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rich.table import Table

from ahrs_service.errors import LinkError, ParamError
from ahrs_service.links.component.parameter_client import ParameterClient
from ahrs_service.links.logs.param_files import Dialect, ParamValue, ParamValues, write_param_file
from ahrs_service.links.logs.parameter_values import PX4, rounded

SWITCHES: Final = ("TC_A_ENABLE", "TC_G_ENABLE")
"""PX4's; ArduPilot's are those below TCAL."""


@dataclass(slots=True)
class Change:
    """One parameter: as it was, as it is to be, and as it was read back, if it was."""

    name: str
    old: ParamValue
    new: ParamValue
    read_back: ParamValue | None = None
    is_touched: bool = False

    @property
    def is_needed(self) -> bool:
        """Whether it is not already as it is to be."""
        return self.old != self.new


def is_switch(name: str) -> bool:
    """Return whether a parameter turns a thermal compensation on."""
    return name in SWITCHES or (name.startswith("INS") and name.endswith("_ENABLE"))


def dialect_of(autopilot: int) -> Dialect:
    """Return the dialect of files that the ground stations of an autopilot write."""
    return "qgroundcontrol" if autopilot == PX4 else "mission-planner"


def default_backup(client: ParameterClient) -> Path:
    """Return a file name for the old values: vehicle and time."""
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    return Path(f"{client.vehicle.split()[0].lower()}-{client.system}-{stamp}.param")


async def plan(client: ParameterClient, wanted: Mapping[str, float]) -> list[Change]:
    """Read the values that are to change.

    ParamError names those that the autopilot has not, or autopilots between which none was chosen.
    """
    old = await client.read(wanted)
    if client.others and not client.is_chosen:
        heard = ", ".join(map(str, sorted({client.system, *client.others})))
        raise ParamError(f"autopilots of systems {heard} are on this link: say --system N")
    missing = [name for name in wanted if name not in old]
    if missing:
        raise ParamError(
            f"{client.vehicle} has no {_listed(missing)}; nothing was written. Is there such an "
            "IMU, and does this firmware have thermal calibration?"
        )
    return [
        Change(name, old[name], rounded(ParamValue(float(value), old[name].type)))
        for name, value in wanted.items()
    ]


async def carry_out(
    client: ParameterClient, changes: list[Change], backup: Path, say: Callable[[str], None]
) -> None:
    """Write what is needed, the old values first to `backup`; ParamError reports how far it got."""
    old = {change.name: change.old for change in changes}
    write_param_file(
        backup,
        old,
        dialect_of(client.autopilot),
        (f"values of {client.vehicle} before a calibration was written",),
        client.system,
        client.component,
    )
    say(f"old values are in {backup}")
    try:
        await _write_all(client, changes)
        await _read_all_back(client, changes)
    except LinkError as error:
        raise ParamError(f"{error}. {_how_far(client, changes, backup)}") from None
    except asyncio.CancelledError:
        say(f"interrupted. {_how_far(client, changes, backup)}")
        raise


async def _write_all(client: ParameterClient, changes: list[Change]) -> None:
    needed = [change for change in changes if change.is_needed]
    figures = [change for change in needed if not is_switch(change.name)]
    if figures:
        for change in changes:
            if is_switch(change.name) and change.old.value != 0.0:
                await _write(client, change, ParamValue(0.0, change.old.type))
    for change in figures:
        await _write(client, change, change.new)
    for change in changes:
        if is_switch(change.name) and (change.is_needed or change.is_touched):
            await _write(client, change, change.new)


async def _write(client: ParameterClient, change: Change, value: ParamValue) -> None:
    change.is_touched = True
    read_back = await client.write(change.name, value)
    if read_back != value:
        change.read_back = read_back
        raise ParamError(
            f"{change.name} = {value.text} was not taken: the autopilot has {read_back.text}"
        )


async def _read_all_back(client: ParameterClient, changes: list[Change]) -> None:
    read_back = await client.read(change.name for change in changes)
    for change in changes:
        change.read_back = read_back.get(change.name)
    wrong = [change.name for change in changes if change.read_back != change.new]
    if wrong:
        raise ParamError(f"{_listed(wrong)} read back otherwise than written")


def _how_far(client: ParameterClient, changes: list[Change], backup: Path) -> str:
    touched = [change.name for change in changes if change.is_touched]
    if not touched:
        return "Nothing was written"
    off = [name for name in touched if is_switch(name)]
    state = f"; {_listed(off)} may be off" if off else ""
    return (
        f"Written so far: {_listed(touched)}{state}. Put the old values back with: ahrs-service "
        f"calibrate export --restore {backup} --link {client.uri} --yes"
    )


def _listed(names: Iterable[str], most: int = 6) -> str:
    names = list(names)
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def change_table(changes: list[Change], title: str) -> Table:
    """Return old, new and read back of each parameter; what stays as it is counted below."""
    needed = [change for change in changes if change.is_needed or change.is_touched]
    same = len(changes) - len(needed)
    caption = f"{same} more are already as they should be" if same else None
    table = Table(title=title, caption=caption, title_justify="left", caption_justify="left")
    for column in ("parameter", "old", "new", "read back"):
        table.add_column(column, justify="left" if column == "parameter" else "right")
    for change in needed:
        read_back = "-" if change.read_back is None else change.read_back.text
        style = "bold red" if change.read_back not in (None, change.new) else None
        table.add_row(change.name, change.old.text, change.new.text, read_back, style=style)
    return table


def values_of(values: ParamValues) -> dict[str, float]:
    """Return the bare numbers."""
    return {name: value.value for name, value in values.items()}
