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
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.markup import escape

from ahrs_service.app.calibrate import parameter_change
from ahrs_service.app.calibrate.conversion import exports_of, typed
from ahrs_service.app.calibrate.loss_table import loss_table
from ahrs_service.app.files import calibration_file, config_file
from ahrs_service.calibration.autopilots import ardupilot_params, px4_params
from ahrs_service.calibration.autopilots.double_compensation import already_compensated
from ahrs_service.calibration.autopilots.export_plan import Export
from ahrs_service.errors import ConfigError, ParamError
from ahrs_service.links.component.parameter_client import ParameterClient
from ahrs_service.links.logs.param_files import read_param_file, write_param_file
from ahrs_service.links.logs.parameter_values import ARDUPILOT, PX4
from ahrs_service.links.mavlink.signing import Signer, key_from_text
from ahrs_service.records import ImuSource
from ahrs_service.sensor.parameters import Calibration

AUTOPILOTS: Final = {"ardupilot": ARDUPILOT, "px4": PX4}
FORMATS: Final = ("mission-planner", "qgroundcontrol")
EXIT_DONE: Final = 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ahrs-service calibrate export`."""
    parser.add_argument(
        "calibrations",
        nargs="*",
        metavar="[IMU=]FILE",
        help="calibration file; which of the autopilot's IMUs it is for, counted from 1 (default: "
        "as the file says, else 1)",
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
        help="how the board is rotated, as AHRS_ORIENTATION or SENS_BOARD_ROT (default: as the "
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
    parser.add_argument(
        "--works-at",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="degC: where the fit is to be good (default: over all of the calibrated span)",
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
    add_identity_options(parser)


def add_identity_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say whom to speak to, and with which key."""
    parser.add_argument(
        "--system", type=int, default=0, metavar="N", help="the autopilot's system (default: first)"
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
        number, name = "", text
    calibration = calibration_file.load(name)
    if not calibration.verdict.usable:
        raise ParamError(
            f"{name}: not exported, for its verdict is: {'; '.join(calibration.verdict.sentences)}"
        )
    return int(number or (calibration.imu or 0) + 1), calibration


def _to_file(
    args: argparse.Namespace, calibrations: Mapping[int, Calibration], out: Console
) -> None:
    if args.autopilot is None:
        raise ConfigError("--param needs --autopilot ardupilot or px4")
    autopilot = AUTOPILOTS[args.autopilot]
    exports = exports_of(args, calibrations, autopilot, {}, speaker(out))
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


async def _over_link(
    args: argparse.Namespace, calibrations: Mapping[int, Calibration], out: Console
) -> None:
    say = speaker(out)
    async with ParameterClient(args.link, say, signer_of(args.config), args.system) as client:
        say(f"{client.vehicle} heard")
        await _check_unit(client, calibrations)
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


async def _check_unit(client: ParameterClient, calibrations: Mapping[int, Calibration]) -> None:
    """Refuse calibrations of another board; one that does not report its number is accepted."""
    uids = {calibration.uid for calibration in calibrations.values()} - {""}
    unit = await client.unit() if uids else ""
    if unit and uids - {unit}:
        raise ParamError(
            f"the calibration is of the board {', '.join(sorted(uids - {unit}))}, at the link is "
            f"{unit}: give that unit's file, or take uid out of this one if it is right"
        )


async def _converted(
    client: ParameterClient,
    args: argparse.Namespace,
    calibrations: Mapping[int, Calibration],
    out: Console,
) -> dict[str, float]:
    """Return the values to write, by what the autopilot reports of itself; show what they lose."""
    current: dict[str, float] = {}
    for imu in calibrations:
        current |= await calibration_parameters(client, imu)
    exports = exports_of(args, calibrations, client.autopilot, current, speaker(out))
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


def speaker(out: Console) -> Callable[[str], None]:
    """Return what prints a sentence as it is."""
    return lambda text: out.print(escape(text), highlight=False, soft_wrap=True)


def signer_of(config: str | None) -> Signer | None:
    """Return who signs, if the settings have a key."""
    link = config_file.load(config).link
    return Signer(key_from_text(link.signing_key), link.signing_link) if link.signing_key else None
