"""Say what a recording's IMU does that its twin does not: which physics was left out.

ahrs-service diagnose flight.tlog --json report.json
"""

import argparse
import json
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress

from ahrs_service.app.recorded_columns import read_columns
from ahrs_service.diagnosis.diagnose import diagnose
from ahrs_service.diagnosis.result import as_json
from links.errors import RecordingError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ahrs-service diagnose`."""
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="a .tlog")
    parser.add_argument("--json", type=Path, metavar="REPORT", help="write the report here")


def run(args: argparse.Namespace) -> int:
    """Diagnose one recording; return the exit code."""
    out = Console(stderr=True)
    recorded = read_columns(args.recording)
    try:
        with Progress(console=out, transient=True) as bar:
            task = bar.add_task("diagnosis", total=1.0)
            found = diagnose(recorded, (), lambda share: bar.update(task, completed=share))
    except ValueError as error:
        raise RecordingError(str(error)) from None
    if args.json is not None:
        try:
            args.json.write_text(json.dumps(as_json(found), indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise RecordingError(f"{args.json}: {error.strerror}; give another file") from None
    out.print(f"{escape(str(args.recording))}: {found.verdict}", highlight=False, soft_wrap=True)
    for finding in found.findings:
        out.print(f"  {finding.explanation}", highlight=False, soft_wrap=True)
    for left in found.unexplained:
        covariates = ", ".join(left.depends_on)
        out.print(f"  {left.channel}: something unknown that depends on {covariates}")
    return 0
