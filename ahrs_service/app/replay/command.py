"""Run recordings through the service: tables, and .rrd, .tlog, .parquet, .csv, .json files.

Reads MAVLink .tlog, PX4 ULog .ulg and ArduPilot DataFlash .bin. Every log gets a table of its
contents and of our attitude against the log's; several logs get one more table over all. The line
"estimates sha256" is over the bytes of all estimates: equal to the live session's, it proves that
the replay is the same to the last bit.

With one log, each OUT is a file. With several, or where OUT is a folder, OUT is a folder, made if
needed, and each log's file there is named after the log: OUT/flight.ulg.parquet.

With --smooth later samples also correct earlier attitudes, for reference-grade attitude offline.
The tables show both, the files hold the smoothed attitude, the digest is that of the causal
estimates and can still be compared.

A recording made by this service carries its settings; they are used unless --profile,
--config or --set is given. It also carries its calibration, used unless --calibration is given.
"""

import argparse
import contextlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import chain, count
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from ahrs_service.app import options
from ahrs_service.app.replay.export_columns import write_csv, write_parquet
from ahrs_service.app.replay.export_rrd import write_recording
from ahrs_service.app.replay.export_tlog import write_tlog
from ahrs_service.app.replay.replay_log import ReplayResult, replay_log
from ahrs_service.app.replay.report import log_table, summary_table
from ahrs_service.app.replay.summary import Summary
from ahrs_service.errors import RecordingError
from ahrs_service.estimator import compile_kernels
from ahrs_service.links.logs.recording_formats import KNOWN, READERS
from ahrs_service.settings import Settings

EXIT_DONE: Final = 0
EXIT_REFUSED: Final = 1
_OUTPUTS: Final = ("rrd", "tlog", "parquet", "csv")

Advance = Callable[[str, float], None]


@contextlib.contextmanager
def progress_bar(console: Console, log: str) -> Iterator[Advance]:
    """Show a bar while the block runs; give the function that moves it."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
    )
    quiet = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=quiet) as bar:
        task = bar.add_task(escape(log), total=1.0)

        def advance(stage: str, share: float) -> None:
            bar.update(task, description=f"{escape(log)}: {stage}", completed=share)

        yield advance


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ahrs-service replay`."""
    parser.add_argument("logs", nargs="+", type=Path, metavar="LOG", help=f"{KNOWN}, or a folder")
    parser.add_argument("--rrd", type=Path, metavar="OUT", help="write for the Rerun viewer")
    parser.add_argument(
        "--tlog",
        type=Path,
        metavar="OUT",
        help="write the recording with our ATTITUDE as component 191, at the rate "
        "publish.attitude_rate_hz; ground tools that merge components of one vehicle show both",
    )
    parser.add_argument("--parquet", type=Path, metavar="OUT", help="write all estimates")
    parser.add_argument("--csv", type=Path, metavar="OUT", help="write all estimates as text")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write all tables' figures")
    parser.add_argument(
        "--smooth", action="store_true", help="smooth the attitude, forward and backward in time"
    )
    options.add_settings(parser)
    options.add_calibration(parser)


def run(args: argparse.Namespace) -> int:
    """Replay every log; return 0 if all were, 1 if some were refused or failed."""
    settings = options.settings_of(args) if options.has_settings(args) else None
    sensor = options.sensor_of(args, (settings or Settings()).sensor)
    logs = _logs(args.logs)
    console = Console()
    errors = Console(stderr=True, soft_wrap=True, highlight=False)
    if errors.is_terminal:
        # Its progress bar and that of a log would overwrite each other.
        compile_kernels(settings or Settings())
    outputs = _Outputs({kind: getattr(args, kind) for kind in _OUTPUTS}, len(logs) > 1)
    summaries: list[Summary] = []
    for path in logs:
        try:
            with progress_bar(errors, path.name) as advance:
                result = replay_log(path, settings, advance, sensor, args.smooth)
                written = outputs.write(result, advance)
        except RecordingError as error:
            errors.print(f"[bold red]refused:[/] {escape(str(error))}")
            continue
        except OSError as error:
            where = error.filename or path
            errors.print(
                f"[bold red]failed:[/] {escape(str(where))}: {error.strerror or error}; "
                "give a writable path"
            )
            continue
        summaries.append(result.summary)
        console.print(log_table(result.summary))
        # On a separate line and never wrapped, for scripts that compare it.
        console.print(f"estimates sha256 {result.summary.digest}", highlight=False, soft_wrap=True)
        for file in written:
            console.print(f"wrote {escape(str(file))}", highlight=False, soft_wrap=True)
    if len(logs) > 1 and summaries:
        console.print(summary_table(summaries, console.width))
    if args.json is not None:
        _write_json(args.json, summaries)
    return EXIT_DONE if len(summaries) == len(logs) else EXIT_REFUSED


def _logs(paths: list[Path]) -> list[Path]:
    """Replace each folder by the logs inside it."""
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = [one for one in sorted(path.iterdir()) if one.suffix.lower() in READERS]
            if not inside:
                raise RecordingError(f"{path}: the folder holds no recording: no {KNOWN}")
            found += inside
        else:
            found.append(path)
    return found


@dataclass(frozen=True, slots=True)
class _Outputs:
    """Where each kind of file goes; None where it was not asked for."""

    places: dict[str, Path | None]
    many: bool
    used: set[Path] = field(default_factory=set)

    def write(self, result: ReplayResult, advance: Advance) -> list[Path]:
        """Write the files asked for of one log; return their paths."""
        written = []
        for kind, place in self.places.items():
            if place is None:
                continue
            advance(f"writing .{kind}", 0.0)
            path = self._path(place, kind, result.summary.log)
            if path.exists() and path.samefile(result.recording.path):
                raise RecordingError(f"{path}: is the recording itself; give --{kind} another file")
            _WRITERS[kind](path, result)
            self.used.add(path)
            written.append(path)
        return written

    def _path(self, place: Path, kind: str, log: str) -> Path:
        if not self.many and not place.is_dir():
            return place
        place.mkdir(parents=True, exist_ok=True)
        # Logs of one name from several folders must not overwrite each other.
        names = (f"{log}{number}.{kind}" for number in chain([""], (f"-{n}" for n in count(2))))
        return next(place / name for name in names if place / name not in self.used)


def _write_tlog(path: Path, result: ReplayResult) -> None:
    write_tlog(
        path,
        result.recording,
        result.estimates,
        result.positions,
        result.system,
        result.settings,
    )


def _write_parquet(path: Path, result: ReplayResult) -> None:
    summary = result.summary
    write_parquet(path, result.estimates, result.settings, summary)


def _write_csv(path: Path, result: ReplayResult) -> None:
    write_csv(path, result.estimates)


_WRITERS: Final[dict[str, Callable[[Path, ReplayResult], None]]] = {
    "rrd": write_recording,
    "tlog": _write_tlog,
    "parquet": _write_parquet,
    "csv": _write_csv,
}


def _write_json(path: Path, summaries: list[Summary]) -> None:
    plain = [summary.to_plain() for summary in summaries]
    try:
        path.write_text(json.dumps(plain, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error
