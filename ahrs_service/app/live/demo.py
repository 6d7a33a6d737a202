"""Fly a simulated aircraft and watch the service work.

A simulated autopilot flies in a separate process and speaks MAVLink 2 over loopback UDP; the
service estimates attitude from its IMU, sends ATTITUDE back, records a .tlog and an .rrd. At the
end the recording is replayed: attitude error against the simulator's truth, and the proof that
live and replay gave the same bytes.

Examples:
  ahrs-service demo
  ahrs-service demo --seconds 120 --out demo_output --headless

"""

import argparse
import asyncio
import contextlib
import dataclasses
import importlib.util
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from ahrs_service.app import options
from ahrs_service.app.files.calibration_choice import CalibrationStore
from ahrs_service.app.live.command import DEFAULT_VIEWER_PORT, showing
from ahrs_service.app.live.daemon import Daemon
from ahrs_service.app.live.terminal import TerminalLog, session_table
from ahrs_service.app.replay.replay_log import ReplayResult, replay_log
from ahrs_service.app.replay.report import error_table
from ahrs_service.errors import ConfigError
from ahrs_service.estimator import compile_kernels
from ahrs_service.settings import Settings
from ahrs_service.simulation.scenario import SCENARIOS

_HOST: Final = "127.0.0.1"
EXIT_DONE: Final = 0
EXIT_FAILED: Final = 1
EXIT_TERMINATED: Final = 143


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `demo`."""
    parser.add_argument(
        "--seconds", type=options.positive, default=60.0, help="length of the flight (default: 60)"
    )
    parser.add_argument(
        "--scenario", default="flight", help="one of those in simulate --help (default: flight)"
    )
    parser.add_argument("--seed", type=int, default=1, help="random seed of flight (default: 1)")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("demo_output"),
        metavar="DIR",
        help="for .tlog and .rrd (default: demo_output)",
    )
    parser.add_argument(
        "--headless", action="store_true", help="open no viewer window, even with a screen"
    )
    options.add_settings(parser, with_file=False)
    options.add_calibration(parser)


def run(arguments: argparse.Namespace) -> int:
    """Fly, then report; return the exit code."""
    console = Console()
    if arguments.scenario not in SCENARIOS:
        raise ConfigError(f"--scenario {arguments.scenario}: choose one of {', '.join(SCENARIOS)}")
    settings = options.settings_of(arguments)
    sensor = options.sensor_of(arguments, settings.sensor)
    # Errors in it are reported before a folder is made.
    CalibrationStore(sensor)
    files = _files(arguments.out)
    settings = _with_places(dataclasses.replace(settings, sensor=sensor), files)
    # Before the live table, which would overwrite the progress messages.
    compile_kernels(settings)
    try:
        flown = asyncio.run(_fly(settings, arguments, console))
    except asyncio.CancelledError:
        return EXIT_TERMINATED
    if flown is None:
        return EXIT_FAILED
    daemon, autopilot = flown
    console.print(session_table(daemon))
    result = replay_log(files / "flight.tlog")
    if result.summary.comparison is not None:
        console.print(error_table(result.summary, result.summary.comparison))
    return _verdict(console, daemon, autopilot, result, files)


def _files(out: Path) -> Path:
    """Make a new folder for this flight, so that no earlier one is overwritten."""
    name = time.strftime("%Y%m%d-%H%M%S")
    for suffix in ("", *(f"-{n}" for n in range(2, 100))):
        folder = out / f"{name}{suffix}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise ConfigError(f"--out {out}: {error.strerror}; give a writable folder") from None
        return folder
    raise ConfigError(f"--out {out}: too many folders named {name}")


def _free_port(kind: socket.SocketKind, wanted: int = 0) -> int:
    """Return `wanted` if that loopback port is free, else any free one."""
    for port in (wanted, 0):
        with socket.socket(socket.AF_INET, kind) as probe, contextlib.suppress(OSError):
            probe.bind((_HOST, port))
            return int(probe.getsockname()[1])
    raise ConfigError("no free port on the loopback interface")


def _with_places(settings: Settings, files: Path) -> Settings:
    link = dataclasses.replace(settings.link, uri=f"udpin:{_HOST}:{_free_port(socket.SOCK_DGRAM)}")
    recorder = dataclasses.replace(settings.recorder, directory=str(files / "flight.tlog"))
    viewer = dataclasses.replace(
        settings.viewer,
        port=_free_port(socket.SOCK_STREAM, DEFAULT_VIEWER_PORT),
        rrd=str(files / "flight.rrd"),
    )
    return dataclasses.replace(settings, link=link, recorder=recorder, viewer=viewer)


async def _fly(
    settings: Settings, arguments: argparse.Namespace, console: Console
) -> tuple[Daemon, dict[str, Any]] | None:
    """Run service and simulator together until the flight ends."""
    log = TerminalLog(console)
    flying = asyncio.current_task()
    assert flying is not None
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, flying.cancel)
    daemon = Daemon(settings, log)
    serving = asyncio.create_task(daemon.run())
    ready = asyncio.create_task(daemon.ready.wait())
    await asyncio.wait([ready, serving], return_when=asyncio.FIRST_COMPLETED)
    if serving.done():
        ready.cancel()
        await serving
    window = _open_viewer(daemon, arguments.headless, log)
    port = settings.link.uri.rpartition(":")[2]
    try:
        with showing(daemon, console, table=True):
            failed, out, errors = await _simulate(arguments, port, daemon.stop)
    finally:
        daemon.stop()
        await serving
        if window is not None:
            log("info", "the viewer stays open; close its window when done")
    if failed:
        log("error", f"the simulator ended with an error: {errors.strip()}")
        return None
    return daemon, json.loads(out)


async def _simulate(
    arguments: argparse.Namespace, port: str, landed: Callable[[], None]
) -> tuple[int | None, str, str]:
    """Fly the simulator in a separate process; return its exit code and its error output.

    `landed` is called as soon as the flight is over: its process takes a while to end.
    """
    simulator = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "ahrs_service.app.cli", "simulate", "--json"),
        *("--link", f"udpout:{_HOST}:{port}", "--seconds", str(arguments.seconds)),
        *("--scenario", arguments.scenario, "--seed", str(arguments.seed)),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        assert simulator.stdout is not None
        out = await simulator.stdout.readline()
        # Data still in the socket belongs to the flight.
        await asyncio.sleep(0.2)
        landed()
        _, errors = await simulator.communicate()
    finally:
        if simulator.returncode is None:
            simulator.terminate()
            await simulator.wait()
    return simulator.returncode, out.decode(), errors.decode()


def _open_viewer(
    daemon: Daemon, headless: bool, log: TerminalLog
) -> "subprocess.Popen[bytes] | None":
    """Open the viewer's window where there is a screen, else print how to attach one."""
    uri = f"rerun+http://{_HOST}:{daemon.settings.viewer.port}/proxy"
    screen = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if headless or not (screen or sys.platform == "darwin"):
        log("info", f"to look inside while it flies: rerun --connect {uri}")
        return None
    if importlib.util.find_spec("rerun_cli") is None:
        log("warning", f"no viewer installed; elsewhere: rerun --connect {uri}")
        return None
    return subprocess.Popen(
        [sys.executable, "-m", "rerun_cli", "--connect", uri],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _verdict(
    console: Console,
    daemon: Daemon,
    autopilot: dict[str, Any],
    result: ReplayResult,
    files: Path,
) -> int:
    """Report what the autopilot received, whether live equals replay, and where the files are."""
    table = Table(show_header=False)
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    received = autopilot["attitudes_received"]
    table.add_row(
        "autopilot got",
        ", ".join(f"{n} {name}" for name, n in received.items())
        or "[bold red]no attitude[/]; fly longer (--seconds)",
    )
    equal = daemon.estimator.digest.hexdigest() == result.summary.digest
    count = len(result.estimates)
    table.add_row(
        "live and replay",
        f"[green]equal, bit for bit[/] ({count} estimates)" if equal else "[bold red]differ[/]",
    )
    first_s = daemon.session.first_attitude_s
    table.add_row("first attitude", f"{first_s:.1f} s after the service started")
    table.add_row("recording", f"{files / 'flight.tlog'}   (ahrs-service replay FILE)")
    table.add_row("viewer file", f"{files / 'flight.rrd'}   (rerun FILE)")
    console.print(table)
    return EXIT_DONE if equal and received else EXIT_FAILED
