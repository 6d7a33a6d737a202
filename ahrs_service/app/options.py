"""Options that several commands share, and the values that they take."""

import argparse
import math


def add_settings(parser: argparse.ArgumentParser, with_file: bool = True) -> None:
    """Add `--set` (as `overrides`) and, with `with_file`, `--config`."""
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


def positive(text: str) -> float:
    """Return the number that `text` is, for argparse; it must be finite and above 0."""
    value = float(text)
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not a number above 0")
    return value
