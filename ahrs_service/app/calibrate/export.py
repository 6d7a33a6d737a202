"""Give a calibration to ArduPilot (INS_*) or PX4 (TC_*, CAL_*): as a file, or over a link.

ahrs-service calibrate export unit.toml --autopilot ardupilot --param unit.param
ahrs-service calibrate export unit.toml 2=other.toml --link serial:/dev/ttyACM0:115200
ahrs-service calibrate export unit.toml --link udpin:127.0.0.1:14550 --yes
ahrs-service calibrate export --restore ardupilot-1-20240531T120000Z.param --link URI --yes

What the autopilot's form of calibration loses against ours is printed per axis. Over a link nothing
is written without --yes; with it the old values go to a .param file first, each value is read back,
and --restore puts them back.

A calibration made from what an autopilot sent or logged was made on top of its own calibration:
say with --compensated-by FILE (a .param file or the recording itself) which that was.
"""

import argparse
import asyncio
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ahrs_service.app import calibration_file, config_file
from ahrs_service.app.calibrate import parameter_change
from ahrs_service.app.config_file import ConfigError
from ahrs_service.calibration import ardupilot_params, px4_params
from ahrs_service.calibration.autopilot_form import Loss, Triad
from ahrs_service.calibration.board_rotation import board_rotation, body_from_sensor
from ahrs_service.calibration.double_compensation import already_compensated, forms_in_force
from ahrs_service.calibration.export import Export
from ahrs_service.records import Floats, ImuSource
from ahrs_service.sensor.parameters import Calibration
from links.errors import ParamError
from links.param_files import INT32, REAL32, ParamValue, read_param_file, write_param_file
from links.parameter_client import ParameterClient
from links.parameter_values import ARDUPILOT, PX4
from links.recorded_parameters import read_recorded_parameters
from links.signing import Signer, key_from_text

AUTOPILOTS: Final = {"ardupilot": ARDUPILOT, "px4": PX4}
FORMATS: Final = ("mission-planner", "qgroundcontrol")
EXIT_DONE: Final = 0
_UNITS: Final = {"m/s^2": (1.0, "m/s²"), "rad/s": (math.degrees(1.0), "°/s")}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ahrs-service calibrate export`."""
    parser.add_argument(
        "calibrations",
        nargs="*",
        metavar="[IMU=]FILE",
        help="calibration file; which of the autopilot's IMUs it is for, counted from 1 (default)",
    )
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--param", type=Path, metavar="OUT", help="write a .param file")
    where.add_argument("--link", metavar="URI", help="write to the autopilot at this link")
    parser.add_argument("--autopilot", choices=AUTOPILOTS, help="with --param: for which")
    parser.add_argument(
        "--format", choices=FORMATS, help="of the .param file (default: as the autopilot's own)"
    )
    parser.add_argument(
        "--orientation",
        type=int,
        metavar="N",
        help="how the board is turned, as AHRS_ORIENTATION or SENS_BOARD_ROT (default: as the "
        "autopilot or --compensated-by has it, else 0)",
    )
    parser.add_argument(
        "--compensated-by",
        type=Path,
        metavar="FILE",
        help=".param file or recording: the autopilot's calibration that was in force where the "
        "calibration comes from",
    )
    parser.add_argument(
        "--offsets-at",
        type=float,
        metavar="DEGC",
        help="temperature of the offsets: CALTEMP or TREF (default: the calibration's room)",
    )
    add_link_options(parser)
    parser.add_argument(
        "--restore", type=Path, metavar="BACKUP", help="write the values of this file instead"
    )


def add_link_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say how to write over a link."""
    parser.add_argument("--yes", action="store_true", help="write; without it only show")
    parser.add_argument(
        "--backup", type=Path, metavar="FILE", help="old values go here (default: by vehicle, time)"
    )
    parser.add_argument("--config", metavar="FILE", help="settings with link.signing_key, as TOML")


def run(args: argparse.Namespace) -> int:
    """Export or restore; return the exit code."""
    out = Console()
    if bool(args.calibrations) == (args.restore is not None):
        raise ConfigError("give calibration files, or --restore BACKUP")
    if args.restore is not None and args.link is None:
        raise ConfigError("--restore needs --link URI: the autopilot to put the values back on")
    calibrations = dict(map(_calibration, args.calibrations))
    if len(calibrations) != len(args.calibrations):
        raise ConfigError("two calibrations for one IMU: give each its number, as 2=other.toml")
    if args.link is not None:
        asyncio.run(_over_link(args, calibrations, out))
    else:
        _to_file(args, calibrations, out)
    return EXIT_DONE


def _calibration(text: str) -> tuple[int, Calibration]:
    """Return IMU number and calibration of `[IMU=]FILE`; refused ones do not leave the house."""
    number, separator, name = text.partition("=")
    if not (separator and number.isdigit()):
        number, name = "1", text
    calibration = calibration_file.load(name)
    if not calibration.verdict.usable:
        raise ParamError(
            f"{name}: not exported, for its verdict is: {'; '.join(calibration.verdict.sentences)}"
        )
    return int(number), calibration


def parameters_of(path: Path) -> dict[str, float]:
    """Return the parameters in a .param file or a recording."""
    if path.suffix.lower() in (".tlog", ".bin", ".ulg"):
        recorded = read_recorded_parameters(path)
        if not recorded.values:
            raise ParamError(f"{path}: carries no parameters; give the autopilot's .param file")
        return recorded.values
    return parameter_change.values_of(read_param_file(path))


def rotation_of(orientation: int | None, parameters: Mapping[str, float]) -> Floats:
    """Return body_from_sensor [3, 3] by option, else by the autopilot's parameters."""
    try:
        if orientation is not None:
            return body_from_sensor(orientation)
        return board_rotation(parameters)
    except ValueError as error:
        raise ConfigError(f"--orientation: {error}") from None


def _exports(
    args: argparse.Namespace,
    calibrations: Mapping[int, Calibration],
    autopilot: int,
    current: Mapping[str, float],
) -> dict[int, Export]:
    """Return the parameters of each IMU; `current` those of the autopilot, as far as known."""
    under = {} if args.compensated_by is None else parameters_of(args.compensated_by)
    known = {**under, **current}
    turn = rotation_of(args.orientation, known)
    exports = {}
    for imu, calibration in calibrations.items():
        try:
            below = forms_in_force(under, imu) if under else None
            if autopilot == PX4:
                ids = px4_params.known_ids(known, imu)
                export = px4_params.to_px4(calibration, imu, turn, below, ids, args.offsets_at)
                px4_params.check_slots({**current, **export.values}, imu)
            else:
                export = ardupilot_params.to_ardupilot(
                    calibration, imu, turn, below, args.offsets_at
                )
        except ValueError as error:
            raise ParamError(f"IMU {imu}: {error}") from None
        exports[imu] = export
    return exports


def _to_file(
    args: argparse.Namespace, calibrations: Mapping[int, Calibration], out: Console
) -> None:
    if args.autopilot is None:
        raise ConfigError("--param needs --autopilot ardupilot or px4")
    autopilot = AUTOPILOTS[args.autopilot]
    exports = _exports(args, calibrations, autopilot, {})
    values = {name: typed(v) for e in exports.values() for name, v in e.values.items()}
    comments = [
        f"IMU {imu}: {calibrations[imu].serial or 'unit without serial number'}" for imu in exports
    ]
    write_param_file(
        args.param,
        values,
        args.format or parameter_change.dialect_of(autopilot),
        ("calibration of ahrs-service", *comments),
    )
    _show(exports, out)
    out.print(f"{len(values)} parameters written to {escape(str(args.param))}", highlight=False)


def typed(value: float | int) -> ParamValue:
    """Return a parameter as a file holds it."""
    return ParamValue(float(value), INT32 if isinstance(value, int) else REAL32)


async def _over_link(
    args: argparse.Namespace, calibrations: Mapping[int, Calibration], out: Console
) -> None:
    def say(text: str) -> None:
        out.print(escape(text), highlight=False, soft_wrap=True)

    async with ParameterClient(args.link, say, signer_of(args.config)) as client:
        say(f"{client.vehicle} heard")
        if args.restore is not None:
            wanted: dict[str, float] = parameter_change.values_of(read_param_file(args.restore))
        else:
            wanted = await _converted(client, args, calibrations, out)
        changes = await parameter_change.plan(client, wanted)
        try:
            if args.yes and any(change.is_needed for change in changes):
                backup = args.backup or parameter_change.default_backup(client)
                await parameter_change.carry_out(client, changes, backup, say)
        finally:
            out.print(parameter_change.change_table(changes, client.vehicle))
        _conclude(args, changes, say)


async def _converted(
    client: ParameterClient,
    args: argparse.Namespace,
    calibrations: Mapping[int, Calibration],
    out: Console,
) -> dict[str, float]:
    """Return the values to write, by what the autopilot tells of itself; show what they lose."""
    current: dict[str, float] = {}
    for imu in calibrations:
        current |= await calibration_parameters(client, imu)
    exports = _exports(args, calibrations, client.autopilot, current)
    _show(exports, out)
    if args.compensated_by is None:
        _warn(current, calibrations, client.autopilot, out)
    values = {name: value for e in exports.values() for name, value in e.values.items()}
    # A switch to be off, or an id to be none, need not be there.
    off = {name for name, value in values.items() if isinstance(value, int) and value == 0}
    return {name: value for name, value in values.items() if name in current or name not in off}


async def calibration_parameters(client: ParameterClient, imu: int) -> dict[str, float]:
    """Read all that calibrates an IMU, as far as the autopilot has it."""
    module = px4_params if client.autopilot == PX4 else ardupilot_params
    try:
        names = module.all_names(imu)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    return parameter_change.values_of(await client.read(names))


def _conclude(
    args: argparse.Namespace,
    changes: list[parameter_change.Change],
    say: Callable[[str], None],
) -> None:
    count = sum(change.is_needed for change in changes)
    if not count:
        say("the autopilot has these values already")
    elif args.yes:
        say(f"{count} parameters written and read back; restart the autopilot")
    else:
        say(f"nothing was written; {count} parameters would change: add --yes to write them")


def _warn(
    current: Mapping[str, float],
    calibrations: Mapping[int, Calibration],
    autopilot: int,
    out: Console,
) -> None:
    sources = {1: ImuSource.SCALED_IMU, 2: ImuSource.SCALED_IMU2, 3: ImuSource.SCALED_IMU3}
    for imu in calibrations:
        source = sources.get(imu, ImuSource.SCALED_IMU)
        for sentence in already_compensated(current, source, autopilot):
            text = f"[yellow]now in force:[/] {escape(sentence)}"
            out.print(text, highlight=False, soft_wrap=True)


def _show(exports: Mapping[int, Export], out: Console) -> None:
    for imu, export in exports.items():
        out.print(loss_table(imu, export.losses))
        for remark in export.remarks:
            out.print(f"[yellow]note:[/] {escape(remark)}", highlight=False, soft_wrap=True)


def loss_table(imu: int, losses: Mapping[Triad, Loss]) -> Table:
    """Return what the autopilot's form loses: per body axis, all of it and by its cause."""
    table = Table(
        title=f"IMU {imu}: what the autopilot's form of calibration loses",
        caption="largest over the span and all directions of 1 g and 100 °/s; bias: not a cubic",
        title_justify="left",
        caption_justify="left",
    )
    for column in ("", "largest", "rms", "bias", "scale", "cross-axis", "by force", ""):
        table.add_column(column, justify="right" if column else "left")
    for triad, loss in losses.items():
        factor, unit = _UNITS[loss.unit]
        parts = (loss.largest, loss.rms, loss.bias, loss.scale, loss.cross, loss.force)
        for axis in range(3):
            figures = [f"{factor * part[axis]:.4f}" for part in parts]
            table.add_row(f"{triad} {'xyz'[axis]}", *figures, unit)
    return table


def signer_of(config: str | None) -> Signer | None:
    """Return who signs, if the settings have a key."""
    link = config_file.load(config).link
    return Signer(key_from_text(link.signing_key), link.signing_link) if link.signing_key else None
