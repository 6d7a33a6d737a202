"""Compile the kernels now instead of at the first start of each command.

For installers, system images and the service's unit (ExecStartPre). Kernels compiled already
are only loaded; --live limits it to what `run` and `demo` need. The machine code is kept next to
the package where that is writable, else in $CACHE_DIRECTORY, $XDG_CACHE_HOME or ~/.cache.

Examples:
  ahrs-service compile
  ahrs-service compile --live

"""

import argparse
from typing import Final

import numba
from rich.console import Console
from rich.markup import escape

from ahrs_service.app.compile.progress import telling
from ahrs_service.app.compile.workload import STEPS, kernels_of_the_link

EXIT_DONE: Final = 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `compile`."""
    parser.add_argument("--live", action="store_true", help="only what run and demo need")


def run(arguments: argparse.Namespace) -> int:
    """Compile what is missing and report it; return the exit code."""
    console = Console(soft_wrap=True, highlight=False)
    steps = {"live service": kernels_of_the_link} if arguments.live else STEPS
    total, spent_s = 0, 0.0
    for name, work in steps.items():
        with telling(Console(stderr=True, quiet=True)) as progress:
            work()
        total += progress.compiled
        spent_s += progress.spent_s
        if progress.compiled:
            console.print(f"{name}: {progress.compiled} kernels in {progress.spent_s:.0f} s")
    where = escape(str(numba.config.CACHE_DIR))  # type: ignore[attr-defined]
    if total:
        console.print(f"{total} kernels compiled in {spent_s:.0f} s, kept in {where}")
    else:
        console.print(f"nothing to do: all kernels are compiled, in {where}")
    return EXIT_DONE
