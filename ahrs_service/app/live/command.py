"""Serve attitude on a MAVLink link.

Reads the autopilot's IMU, estimates attitude, sends ATTITUDE back as component 191 and, on
request, records a .tlog and hosts a Rerun stream.

Examples:
  ahrs-service run --link udpin:127.0.0.1:14550
  ahrs-service run --link serial:/dev/ttyAMA0:921600 --record flights --viewer
  ahrs-service run --config configs/ardupilot.toml --set publish.attitude_rate_hz=100
  ahrs-service run --config configs/px4.toml --profile fixed_wing
  ahrs-service run --link udpin:127.0.0.1:14550 --calibration configs/calibrations

"""

import argparse
import asyncio
import contextlib
import dataclasses
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.live import Live

from ahrs_service.app import options
from ahrs_service.app.live.daemon import Daemon
from ahrs_service.app.live.terminal import TerminalLog, live_table, session_table
from ahrs_service.errors import ConfigError
from ahrs_service.estimator import compile_kernels
from ahrs_service.settings import Settings

DEFAULT_VIEWER_PORT: Final = 9876
_REFRESH_HZ: Final = 4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `run`."""
    parser.add_argument(
        "--link",
        metavar="URI",
        help="udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or serial:DEV:BAUD",
    )
    options.add_settings(parser)
    options.add_calibration(parser)
    parser.add_argument("--record", metavar="PATH", help="folder or .tlog file to record to")
    parser.add_argument(
        "--viewer",
        nargs="?",
        type=options.port,
        const=DEFAULT_VIEWER_PORT,
        metavar="PORT",
        help=f"host a Rerun stream on loopback (default port {DEFAULT_VIEWER_PORT})",
    )
    parser.add_argument("--rrd", metavar="FILE", help="also write the Rerun stream to this file")
    parser.add_argument("--seconds", type=options.positive, metavar="S", help="end after S seconds")
    parser.add_argument("--quiet", action="store_true", help="log lines only, no live table")


def settings_from(arguments: argparse.Namespace) -> Settings:
    """Return the effective settings: profile, then file, then --set, then the options."""
    settings = options.settings_of(arguments)
    link, recorder, viewer = settings.link, settings.recorder, settings.viewer
    if arguments.link:
        link = dataclasses.replace(link, uri=arguments.link)
    if arguments.record:
        if arguments.record.endswith(".tlog") and Path(arguments.record).exists():
            raise ConfigError(
                f"--record {arguments.record}: exists already and is never overwritten; "
                "name another file, or a folder"
            )
        recorder = dataclasses.replace(recorder, directory=arguments.record)
    if arguments.viewer is not None:
        viewer = dataclasses.replace(viewer, port=arguments.viewer)
    if arguments.rrd:
        viewer = dataclasses.replace(viewer, rrd=arguments.rrd)
    sensor = options.sensor_of(arguments, settings.sensor)
    return dataclasses.replace(settings, sensor=sensor, link=link, recorder=recorder, viewer=viewer)


def run(arguments: argparse.Namespace) -> int:
    """Serve until SIGINT, SIGTERM or the time is up; return the exit code."""
    settings = settings_from(arguments)
    console = Console()
    # Before the live table, which would overwrite the progress messages.
    compile_kernels(settings)
    daemon = asyncio.run(
        serve(settings, console, table=not arguments.quiet, seconds=arguments.seconds)
    )
    with contextlib.suppress(SystemExit, OSError):
        console.print(session_table(daemon))
        # On a separate line and never wrapped, for scripts that compare it with a replay's.
        digest = daemon.estimator.digest.hexdigest()
        console.print(f"estimates sha256 {digest}", highlight=False, soft_wrap=True)
    return 0


async def serve(settings: Settings, console: Console, table: bool, seconds: float | None) -> Daemon:
    """Run one daemon with its live table; SIGTERM, SIGINT, SIGHUP end it cleanly."""
    daemon = Daemon(settings, TerminalLog(console))
    loop = asyncio.get_running_loop()
    numbers = [signal.SIGINT, signal.SIGTERM]
    # A lost terminal ends the session cleanly, unless nohup asked to go on without one.
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    for number in numbers:
        loop.add_signal_handler(number, daemon.stop)
    limit = asyncio.create_task(_stop_after(daemon, seconds))
    try:
        with showing(daemon, console, table):
            await daemon.run()
    finally:
        limit.cancel()
    return daemon


async def _stop_after(daemon: Daemon, seconds: float | None) -> None:
    """End the session when its time is up, not counting compilation before the start."""
    if seconds is not None:
        await daemon.ready.wait()
        await asyncio.sleep(seconds)
        daemon.stop()


@contextmanager
def showing(daemon: Daemon, console: Console, table: bool) -> Iterator[None]:
    """Update the live table on a terminal; do nothing where the output is no terminal."""
    if not (table and console.is_terminal):
        yield
        return
    with Live(
        console=console,
        get_renderable=lambda: live_table(daemon),
        refresh_per_second=_REFRESH_HZ,
        vertical_overflow="crop",
    ):
        yield
