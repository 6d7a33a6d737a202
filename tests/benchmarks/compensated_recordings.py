"""Which recordings their autopilot had already compensated: one row each, by their parameters.

python tests/benchmarks/compensated_recordings.py [--data FOLDER]
"""

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from ahrs_service.calibration.autopilots.double_compensation import forms_in_force
from ahrs_service.links.logs.recording_formats import read_recorded_parameters

SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "data"
NAMES = {3: "ArduPilot", 12: "PX4"}


def row_of(path: Path) -> list[str]:
    """Name, autopilot, parameters told, and what they did to the first IMU."""
    recorded = read_recorded_parameters(path)
    head = [path.name, NAMES.get(recorded.autopilot, "-"), str(len(recorded.values))]
    try:
        forms = forms_in_force(recorded.values)
    except ValueError:
        return [*head, "-", "-", "-", "-"]
    accel, gyro = forms["accel"], forms["gyro"]
    scales = f"{accel.scale.min():.4f}..{accel.scale.max():.4f}"
    thermal = "none" if accel.span_degc is None else "{:.0f}..{:.0f}".format(*accel.span_degc)
    offset, rate = np.abs(accel.powers[0]).max(), np.degrees(np.abs(gyro.powers[0]).max())
    return [*head, thermal, f"{offset:.3f}", scales, f"{rate:.2f}"]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=SHARED)
    folder = parser.parse_args().data
    table = Table(title="what the autopilot had applied to its first IMU")
    for column in (
        "recording", "autopilot", "parameters", "thermal [degC]",
        "accel offset [m/s2]", "accel scale", "gyro offset [deg/s]",
    ):  # fmt: skip
        table.add_column(column, justify="left" if column == "recording" else "right")
    for path in sorted(folder.rglob("*")):
        if path.suffix in (".tlog", ".bin", ".ulg"):
            table.add_row(*row_of(path))
    Console(width=150).print(table)


if __name__ == "__main__":
    main()
