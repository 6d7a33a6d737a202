"""The command `ahrs-service`: picks a program, runs it, turns errors into one clear line."""

import argparse
import importlib
import sys
from typing import Final

from rich.console import Console
from rich.markup import escape

from ahrs_service import __version__
from ahrs_service.errors import AhrsError

COMMANDS: Final = {
    "demo": ("ahrs_service.app.live.demo", "fly a simulated aircraft and watch the service work"),
    "run": ("ahrs_service.app.live.command", "serve attitude on a MAVLink link"),
    "replay": (
        "ahrs_service.app.replay.command",
        "run recordings (.tlog, .ulg, .bin) through the service",
    ),
    "estimate": (
        "ahrs_service.app.estimate.command",
        "attitude of plain arrays (.npz in, .npz out)",
    ),
    "calibrate": ("ahrs_service.app.calibrate.command", "calibrate a sensor, show a calibration"),
    "diagnose": (
        "ahrs_service.app.diagnose.command",
        "name physical effects in an IMU that its twin lacks",
    ),
    "compile": (
        "ahrs_service.app.compile.command",
        "compile the kernels now, for installers and images",
    ),
    "play": ("ahrs_service.app.live.play", "play a recording over a link in real time"),
    "prove": (
        "ahrs_service.app.prove.command",
        "hide effects in recordings and score their detection",
    ),
    "simulate": ("ahrs_service.app.simulate.command", "fly the simulated autopilot over a link"),
    "settings": (
        "ahrs_service.app.settings.command",
        "list every setting: type, unit, default, meaning",
    ),
}

EXIT_INTERRUPTED: Final = 130


def _usage() -> argparse.ArgumentParser:
    lines = [f"  {name:<10} {text}" for name, (_, text) in COMMANDS.items()]
    parser = argparse.ArgumentParser(
        prog="ahrs-service",
        description="Attitude and heading reference for small UAVs, over MAVLink.",
        epilog="commands:\n"
        + "\n".join(lines)
        + "\n\nbegin with:  ahrs-service demo\nmore on one:  ahrs-service COMMAND --help"
        + "\n\nexit codes: 0 done, 1 failed, 2 wrong usage or settings, 130 interrupted",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    parser.add_argument("command", choices=list(COMMANDS), metavar="COMMAND")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    words = sys.argv[1:] if arguments is None else arguments
    command = _usage().parse_args(words[:1]).command
    module_name, text = COMMANDS[command]
    module = importlib.import_module(module_name)
    parser = argparse.ArgumentParser(
        prog=f"ahrs-service {command}",
        description=module.__doc__ or text,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(parser)
    errors = Console(stderr=True, soft_wrap=True, highlight=False)
    parsed = parser.parse_args(words[1:])
    progress = importlib.import_module("ahrs_service.app.compile.progress")
    try:
        with progress.telling(errors):
            return int(module.run(parsed))
    except AhrsError as error:
        errors.print(f"[bold red]{error.headline}:[/] {escape(str(error))}")
        return error.exit_code
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
