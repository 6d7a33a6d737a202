"""Calibrate a sensor from recordings, or look at a calibration.

ahrs-service calibrate PROCEDURE --help explains each procedure.
"""

import argparse
import importlib
from typing import Final

PROCEDURES: Final[dict[str, tuple[str, str]]] = {
    "show": ("ahrs_service.app.calibrate.show", "a calibration's figures, verdict and curves"),
}
"""Name of a procedure: the module that runs it, and what it does in a line.

Each module has `add_arguments(parser)` and `run(arguments) -> exit code`.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the procedures of `ahrs-service calibrate`."""
    procedures = parser.add_subparsers(dest="procedure", required=True, metavar="PROCEDURE")
    for name, (module_name, text) in PROCEDURES.items():
        module = importlib.import_module(module_name)
        procedure = procedures.add_parser(
            name,
            help=text,
            description=module.__doc__ or text,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(procedure)


def run(arguments: argparse.Namespace) -> int:
    """Run the chosen procedure; return the exit code."""
    module_name, _ = PROCEDURES[arguments.procedure]
    return int(importlib.import_module(module_name).run(arguments))
