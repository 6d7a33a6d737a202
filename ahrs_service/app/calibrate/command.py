"""Calibrate a sensor from recordings, or look at a calibration.

ahrs-service calibrate PROCEDURE --help explains each procedure.
"""

import argparse
import importlib
from typing import Final

PROCEDURES: Final[dict[str, tuple[str, str]]] = {
    "six-position": (
        "ahrs_service.app.calibrate.six_position",
        "accelerometer on the six faces, gyros by known turns",
    ),
    "multi-pose": (
        "ahrs_service.app.calibrate.multi_pose",
        "both triads from any twelve poses, without a table",
    ),
    "rate-table": (
        "ahrs_service.app.calibrate.rate_table",
        "gyros by known rates or an encoder",
    ),
    "thermal": (
        "ahrs_service.app.calibrate.thermal",
        "drift over temperature from a soak or a ramp",
    ),
    "allan": (
        "ahrs_service.app.calibrate.allan",
        "random walks and bias instability of a unit at rest",
    ),
    "noise": ("ahrs_service.app.calibrate.noise", "S() of the gate's thresholds, noise densities"),
    "export": ("ahrs_service.app.calibrate.export", "give a calibration to the autopilot"),
    "import": (
        "ahrs_service.app.calibrate.import_params",
        "read one from an autopilot's parameters",
    ),
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
