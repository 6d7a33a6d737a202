"""Options that several commands share, and the values that they take."""

import argparse
import dataclasses
import math
from pathlib import Path

from ahrs_service.app.files import config_file, profiles
from ahrs_service.settings import SensorSettings, Settings


def add_settings(parser: argparse.ArgumentParser, with_file: bool = True) -> None:
    """Add `--profile`, `--set` (as `overrides`) and, with `with_file`, `--config`."""
    parser.add_argument(
        "--profile",
        metavar="NAME",
        help=f"class of vehicle: {', '.join(profiles.names())}, or a {profiles.SUFFIX} file "
        "like those in configs/airframes (default: by the vehicle type on the link, else unknown); "
        "--config and --set override it",
    )
    if with_file:
        parser.add_argument("--config", metavar="FILE", help="settings as TOML, see configs/")
    parser.add_argument(
        "--set",
        dest="overrides",
        metavar="SECTION.KEY=VALUE",
        action="append",
        default=[],
        help="change one setting, as gate.norm_m_s2=0.4; may be given several times",
    )


def add_calibration(parser: argparse.ArgumentParser) -> None:
    """Add `--calibration` and `--force-calibration`."""
    parser.add_argument(
        "--calibration",
        metavar="FILE|DIR",
        help="calibration of the sensor, or a folder from which that of this unit is used (by the "
        'number of the autopilot\'s board, or sensor.unit); "none" to use none',
    )
    parser.add_argument(
        "--force-calibration",
        action="store_true",
        help="use a calibration although its verdict says not to",
    )


def sensor_of(arguments: argparse.Namespace, settings: SensorSettings) -> SensorSettings:
    """Return `settings` with the options of `add_calibration` applied."""
    if arguments.calibration is not None:
        settings = dataclasses.replace(settings, calibration=arguments.calibration)
    if arguments.force_calibration:
        settings = dataclasses.replace(settings, force_calibration=True)
    return settings


def has_settings(arguments: argparse.Namespace) -> bool:
    """Return whether any setting was given."""
    files = (arguments.profile, getattr(arguments, "config", None))
    return bool(arguments.overrides) or any(file is not None for file in files)


def settings_of(arguments: argparse.Namespace) -> Settings:
    """Return the settings of a profile, overridden by a file, overridden by `--set`."""
    path = getattr(arguments, "config", None)
    return config_file.load(path, arguments.overrides, arguments.profile)


def positive(text: str) -> float:
    """Return the number that `text` is, for argparse; it must be finite and above 0."""
    value = _number(text)
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not a number above 0")
    return value


def positive_or_inf(text: str) -> float:
    """Return the number above 0 that `text` is, for argparse; `inf` is allowed."""
    return math.inf if _number(text) == math.inf else positive(text)


def not_negative(text: str) -> float:
    """Return the number that `text` is, for argparse; it must be finite and not below 0."""
    value = _number(text)
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not a number of 0 or more")
    return value


def whole(text: str) -> int:
    """Return the whole number above 0 that `text` is, for argparse."""
    if not (text.isdecimal() and int(text)):
        raise argparse.ArgumentTypeError(f"{text} is not a whole number above 0")
    return int(text)


def port(text: str) -> int:
    """Return the number of a TCP port that `text` is, for argparse."""
    if not (text.isdecimal() and 0 < int(text) < 1 << 16):
        raise argparse.ArgumentTypeError(f"{text} is not a port, 1 to 65535")
    return int(text)


def new_file(text: str) -> Path:
    """Return the path of a file to be written, for argparse: checked before the work starts."""
    path = Path(text)
    if path.is_dir():
        raise argparse.ArgumentTypeError(f"{text} is a folder; give a file")
    if not path.parent.is_dir():
        raise argparse.ArgumentTypeError(f"{text}: there is no folder {path.parent}")
    return path


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
