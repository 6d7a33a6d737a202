"""Make a calibration file of ArduPilot's INS_* or PX4's TC_* and CAL_* parameters.

ahrs-service calibrate import autopilot.param --out unit.toml
ahrs-service calibrate import flight.bin --imu 2 --out unit2.toml
ahrs-service calibrate import --link udpin:127.0.0.1:14550 --out unit.toml

The parameters come from a .param file, from a recording that carries them, or from the autopilot.
The calibration has exactly their effect on the raw sensor. What an autopilot sends and logs it
has compensated by them already.
"""

import argparse
import asyncio
import datetime
import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.markup import escape

from ahrs_service.app.calibrate.conversion import parameters_of, rotation_of
from ahrs_service.app.calibrate.export import (
    EXIT_DONE,
    add_identity_options,
    calibration_parameters,
    signer_of,
    speaker,
)
from ahrs_service.app.files import calibration_file
from ahrs_service.calibration.autopilots import ardupilot_params, px4_params
from ahrs_service.errors import ParamError
from ahrs_service.links.component.parameter_client import ParameterClient
from ahrs_service.sensor.parameters import Calibration
from ahrs_service.sensor.provenance import Provenance, SourceRecording

_TOLD_APART: Final = 3
"""How many IMUs have messages of their own."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ahrs-service calibrate import`."""
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument(
        "source", nargs="?", type=Path, metavar="FILE", help=".param, .tlog, .bin or .ulg"
    )
    where.add_argument("--link", metavar="URI", help="read them from the autopilot at this link")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="calibration file")
    parser.add_argument("--imu", type=int, default=1, metavar="N", help="counted from 1")
    parser.add_argument("--serial", default="", help="serial number of the unit")
    parser.add_argument(
        "--orientation",
        type=int,
        metavar="N",
        help="the board's rotation (default: as recorded)",
    )
    add_identity_options(parser)


def run(args: argparse.Namespace) -> int:
    """Import the parameters; return the exit code."""
    out = Console()
    provenance = Provenance(
        date=datetime.datetime.now(datetime.UTC).date().isoformat(), procedures=("import",)
    )
    unit = ""
    if args.link is not None:
        parameters, origin, unit = asyncio.run(_over_link(args, out))
    else:
        parameters = parameters_of(args.source, speaker(out), args.system)
        origin = args.source.name
        digest = hashlib.sha256(args.source.read_bytes()).hexdigest()
        recording = SourceRecording(args.source.name, digest, "parameters")
        provenance = replace(provenance, recordings=(recording,))
    calibration = replace(
        _calibration(args, parameters, origin),
        serial=args.serial,
        uid=unit,
        imu=args.imu - 1 if args.imu <= _TOLD_APART else None,
        source=f"parameters of IMU {args.imu} in {origin}",
        provenance=provenance,
    )
    calibration_file.save(args.out, calibration)
    _tell(calibration, args.out, out)
    return EXIT_DONE


def _calibration(
    args: argparse.Namespace, parameters: dict[str, float], origin: str
) -> Calibration:
    turn = rotation_of(args.orientation, parameters, args.imu)
    try:
        if any(name.startswith("INS") for name in parameters):
            return ardupilot_params.from_ardupilot(parameters, args.imu, turn)
        return px4_params.from_px4(parameters, args.imu, turn)
    except ValueError as error:
        raise ParamError(f"{origin}: {error}") from None


async def _over_link(args: argparse.Namespace, out: Console) -> tuple[dict[str, float], str, str]:
    """Return the parameters, where they come from, and the number of its board."""
    async with ParameterClient(
        args.link, speaker(out), signer_of(args.config), args.system
    ) as client:
        parameters = await calibration_parameters(client, args.imu)
        return parameters, client.vehicle, await client.unit()


def _tell(calibration: Calibration, path: Path, out: Console) -> None:
    spans = {name: getattr(calibration, name).span_degc for name in ("gyro", "accel")}
    for name, span in spans.items():
        text = "no thermal part" if span is None else f"cubic over {span[0]:g}..{span[1]:g} °C"
        out.print(f"{name}: {text}", highlight=False)
    out.print(
        f"written to {escape(str(path))}. It is of the raw sensor: do not give it to the service "
        "beside the same autopilot, whose IMU messages are compensated by it already",
        highlight=False,
        soft_wrap=True,
    )
