"""A guided session: the service on a link, a table in the terminal, and all of it in a .tlog.

The link, the requests for messages and the recording are the daemon's own. What the person is asked
to do comes from the samples so far alone (calibration.guide), and the calibration comes from the
.tlog once it is whole, so nothing is lost and the same command gives the same result.
"""

import argparse
import asyncio
import contextlib
import dataclasses
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from ahrs_service.app.calibrate.capture import (
    Capture,
    columns_of,
    read_capture,
    read_captures,
)
from ahrs_service.app.intake_choice import asked_intake
from ahrs_service.app.live.daemon import Daemon
from ahrs_service.app.options import positive
from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.guide import Guidance
from ahrs_service.errors import ConfigError
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.records import READING_DTYPE, Rows, empty
from ahrs_service.settings import IntakeSettings, PublishSettings, RecorderSettings, Settings

Guide = Callable[[ImuColumns], Guidance]
Calibrate = Callable[[list[Capture], argparse.Namespace], int]

EXIT_INTERRUPTED: Final = 130
_LOOK_S: Final = 0.25
_REFRESH_HZ: Final = 4
_SHOWN: Final = 5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of a guided session."""
    parser.add_argument(
        "--link", metavar="URI", help="guided session on this link in place of recordings"
    )
    parser.add_argument(
        "--record", type=Path, metavar="FILE", help="the session's .tlog (default: named by date)"
    )
    parser.add_argument(
        "--rate", type=positive, default=200.0, metavar="HZ", help="IMU rate to ask for"
    )


def run(arguments: argparse.Namespace, guide: Guide, calibrate: Calibrate) -> int:
    """Calibrate from the recordings named, or from those and a guided session."""
    if not arguments.link:
        return calibrate(read_captures(arguments), arguments)
    asked = asked_intake(arguments)
    path = arguments.record or Path(time.strftime(f"{arguments.procedure}-%Y%m%d-%H%M%S.tlog"))
    if path.suffix != ".tlog" or path.exists():
        raise ConfigError(f"--record {path}: give a new file that ends in .tlog")
    before = [read_capture(one, asked) for one in arguments.recordings]
    session = Session(arguments.link, path, arguments.rate, asked or IntakeSettings(), guide)
    done = asyncio.run(session.run())
    if not done:
        _tell_interrupted(path, arguments)
        return EXIT_INTERRUPTED
    return calibrate([*before, read_capture(path, asked)], arguments)


def _tell_interrupted(path: Path, arguments: argparse.Namespace) -> None:
    errors = Console(stderr=True, soft_wrap=True, highlight=False)
    if not path.exists():
        errors.print("interrupted before anything was heard")
        return
    errors.print(
        f"interrupted; all that was heard is in {escape(str(path))}: calibrate from it, or go on "
        f"with more poses, by 'ahrs-service calibrate {arguments.procedure} {escape(str(path))}' "
        "and --link"
    )


class Session:
    """One guided session on one link; `run` ends when the guide is content, or by a signal."""

    def __init__(
        self, uri: str, path: Path, rate_hz: float, intake: IntakeSettings, guide: Guide
    ) -> None:
        defaults = Settings()
        settings = dataclasses.replace(
            defaults,
            intake=intake,
            link=dataclasses.replace(defaults.link, uri=uri, imu_rate_hz=rate_hz),
            recorder=RecorderSettings(str(path), 0.0, 0.0),
            # The unit is being rotated by hand: this attitude must not be flown by.
            publish=PublishSettings(0.0, 0.0, 0.0),
        )
        self.console = Console(stderr=True)
        self._daemon = Daemon(settings, self._log, on_reading=self._take)
        self._intake = intake
        self._guide = guide
        self._readings = empty(READING_DTYPE, 1 << 16)
        self._count = 0
        self._seen = 0
        self._said: list[str] = []
        self._guidance = guide(columns_of(self._readings[:0], intake)[0])

    def _log(self, level: str, text: str) -> None:
        if level != "info" or self._count == 0:
            self.console.print(Text(text, style="dim" if level == "info" else "yellow"))

    def _take(self, rows: Rows) -> None:
        if self._count == len(self._readings):
            self._readings = np.concatenate([self._readings, empty(READING_DTYPE, self._count)])
        self._readings[self._count] = rows[0]
        self._count += 1

    async def run(self) -> bool:
        """Guide until all is there; return whether it is."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, self._daemon.stop)
        serving = asyncio.create_task(self._daemon.run())
        looking = asyncio.create_task(self._look())
        try:
            with self._showing():
                await serving
        finally:
            looking.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await looking
        return self._guidance.done

    async def _look(self) -> None:
        """Look at what came, now and then, until nothing is missing."""
        asked, took_s = False, 0.0
        while not self._guidance.done:
            # A long session takes longer to look through; the link must not wait for it.
            await asyncio.sleep(max(_LOOK_S, 4.0 * took_s))
            if self._daemon.component.system and not asked:
                # The answers are recorded, and show what the autopilot removes from its samples.
                asked = True
                system, component = self._daemon.component.vehicle
                self._daemon.send(dialect.MAVLink_param_request_list_message(system, component))
            if self._count > self._seen:
                self._seen = self._count
                begin_s = time.monotonic()
                columns, _ = columns_of(self._readings[: self._count], self._intake)
                self._guidance = self._guide(columns)
                took_s = time.monotonic() - begin_s
                if not self.console.is_terminal:
                    self._say_what_is_new()
        self._daemon.stop()

    def _say_what_is_new(self) -> None:
        """Say each instruction and refusal once, where there is no terminal to redraw."""
        words = [f"refused: {refusal.why}" for refusal in self._guidance.refusals]
        for text in [*words, f"next: {self._guidance.instruction}"]:
            if text not in self._said[-_SHOWN:]:
                self._said.append(text)
                print(text, file=sys.stderr, flush=True)

    def _showing(self) -> contextlib.AbstractContextManager[object]:
        if not self.console.is_terminal:
            return contextlib.nullcontext()
        return Live(
            console=self.console,
            get_renderable=lambda: guidance_panel(self._guidance),
            refresh_per_second=_REFRESH_HZ,
            vertical_overflow="crop",
        )


def guidance_panel(guidance: Guidance) -> Panel:
    """Return what the terminal shows during the session."""
    state = "green" if guidance.state.startswith("still") else "yellow"
    head = Text.assemble((f"▶ {guidance.instruction}\n", "bold"), (guidance.state, state))
    table = Table.grid(padding=(0, 2))
    for name, what in guidance.progress:
        table.add_row(name, Text(what, style="dim" if what in ("-", "0") else "green"))
    coverage = Table.grid(padding=(0, 2))
    bar = ProgressBar(total=1.0, completed=guidance.coverage, width=30)
    coverage.add_row(guidance.covers, bar, f"{guidance.coverage:.0%}")
    parts: list[Text | Table] = [head, Text(), table, coverage]
    for refusal in guidance.refusals[-_SHOWN:]:
        parts.append(Text(f"refused at {refusal.time_s:.0f} s: {refusal.why}", style="red"))
    return Panel(Group(*parts), title="calibration", title_align="left")
