"""Ours through the plug-in contract: arrays in an .npz, `ahrs-service estimate` as a process.

What the process does not see: the flags of the samples (change of IMU or message), temperature,
when a sample was received, and the vehicle's type, which --profile says instead.
"""

import functools
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_service.records import Airframe, Rows

COMMAND = (sys.executable, "-m", "ahrs_service.app.cli", "estimate")
"""What the console script `ahrs-service` starts, in this interpreter's surroundings."""
PROFILE_OF = {Airframe.FIXED_WING: "fixed_wing", Airframe.MULTIROTOR: "multirotor"}


@functools.cache
def offers(option: str) -> bool:
    """Tell whether the command has an option, as --offline."""
    said = subprocess.run([*COMMAND, "--help"], check=True, capture_output=True, text=True)
    return option in said.stdout


def profile_of(samples: Rows) -> str | None:
    """Profile of the vehicle's class as last heard; None for one that has none."""
    return PROFILE_OF.get(Airframe(int(samples["airframe"][-1])))


def write_samples(path: Path, samples: Rows, aided: bool) -> None:
    """Write samples [N] SAMPLE_DTYPE as IN.npz, forward-right-down; speeds only where aided."""
    t = (samples["time_ns"] - samples["time_ns"][0]) * 1e-9
    steps = np.diff(t)
    fields = {
        "imu_gyr": samples["gyro_rad_s"],
        "imu_acc": samples["accel_m_s2"],
        "t": t,
        "sampling_rate": 1.0 / float(np.median(steps[steps > 0.0])),
    }
    if aided:
        fields["airspeed"] = samples["airspeed_m_s"]
        fields["vel_ned"] = samples["velocity_ned_m_s"]
    np.savez(path, **fields)  # type: ignore[arg-type]


def run_estimate(source: Path, profile: str | None, frame: str, *more: str) -> dict[str, Any]:
    """Fields of OUT that the process wrote for IN `source`."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.npz"
        words = ["--in", str(source), "--out", str(out), "--frame", frame, *more]
        if profile is not None:
            words += ["--profile", profile]
        done = subprocess.run([*COMMAND, *words], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise SystemExit(f"{source}: estimate left with {done.returncode}: {done.stderr}")
        with np.load(out) as file:
            return {name: file[name] for name in file.files}
