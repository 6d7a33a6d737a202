"""A small real workload that compiles every kernel a command needs.

A kernel is compiled for the types that it is called with; only the callers themselves know
these. Each step therefore runs them, on a few seconds of a simulated flight.
"""

import contextlib
import importlib
import io
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from ahrs_service.calibration.rotating import rotation_and_leverage
from ahrs_service.effects.thermal_hysteresis import branch
from ahrs_service.estimator import compile_kernels
from ahrs_service.links.logs import dataflash_tables
from ahrs_service.links.mavlink.codec import Decoder
from ahrs_service.sensor.compensation import compensate_columns
from ahrs_service.sensor.forward import forward_columns
from ahrs_service.sensor.parameters import Calibration, coefficients
from ahrs_service.settings import Settings

_FLIGHT_S: Final = "40"
_FMT_OF_FMT: Final = b"\xa3\x95\x80" + bytes([128, 89]) + b"FMT\0" + b"BBnNZ".ljust(16, b"\0")
_FMT_NAMES: Final = b"Type,Length,Name,Format,Columns".ljust(64, b"\0")


def kernels_of_the_link() -> None:
    """Compile what the live service needs: the scanner of frames, intake and estimator."""
    Decoder()
    compile_kernels(Settings())


def kernels_of_recordings() -> None:
    """Compile what reads, replays and smooths recordings."""
    with tempfile.TemporaryDirectory() as folder:
        flight, log = Path(folder) / "flight.tlog", Path(folder) / "log.bin"
        _command("simulate", "--tlog", str(flight), "--seconds", _FLIGHT_S)
        _command("replay", str(flight), "--smooth")
        log.write_bytes(3 * (_FMT_OF_FMT + _FMT_NAMES))
        dataflash_tables.read_tables(log)


def kernels_of_diagnosis() -> None:
    """Compile the filters of the diagnosis."""
    with tempfile.TemporaryDirectory() as folder:
        flight = Path(folder) / "flight.tlog"
        _command("simulate", "--tlog", str(flight), "--seconds", _FLIGHT_S)
        _command("diagnose", str(flight))


def kernels_of_calibration() -> None:
    """Compile the sensor's model both ways and the rotations of a calibration."""
    ideal, time_s, still = coefficients(Calibration.ideal()), np.arange(3.0), np.zeros((3, 3))
    compensate_columns(ideal, *forward_columns(ideal, still, still, time_s, time_s), time_s, time_s)
    branch(time_s, 1.0)
    rotation_and_leverage(time_s, still, np.eye(3), np.zeros(3), np.empty((3, 3)), np.empty((3, 9)))


def _command(*words: str) -> None:
    """Run a command of the program and suppress its output."""
    module = importlib.import_module("ahrs_service.app.cli")
    with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.redirect_stderr(said):
        code = module.main(list(words))
    if code:
        raise RuntimeError(f"{' '.join(words)}: {said.getvalue()}")


STEPS: Final[Mapping[str, Callable[[], None]]] = {
    "live service": kernels_of_the_link,
    "recordings": kernels_of_recordings,
    "diagnosis": kernels_of_diagnosis,
    "calibration": kernels_of_calibration,
}
"""What is compiled, by what needs it."""
