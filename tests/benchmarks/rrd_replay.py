"""How long one hour of estimates takes to become an .rrd file.

Run: python tests/benchmarks/rrd_replay.py [--out hour.rrd] [--hours 1] [--rate 200]
"""

import argparse
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2 as G
from ahrs_service.links.logs.recording import AttitudeReference
from ahrs_service.records import ESTIMATE_DTYPE, Gate, Phase, Rows, empty
from ahrs_service.rotation import inverse_columns, quaternion_columns, rotate_columns
from ahrs_service.settings import GateSettings


def _turns(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roll, pitch, yaw [N, 3] [rad] and body rate [N, 3] of a flight of climbing turns."""
    bank = 0.6 * np.tanh(4.0 * np.maximum(0.0, np.sin(2.0 * np.pi * t / 40.0) - 0.3))
    bank *= np.where((t // 40.0) % 2 == 0, 1.0, -1.0) * (t > 12.0)
    pitch = np.where(t > 10.0, 0.12 * np.tanh((t - 10.0) / 2.0), 0.0) + 0.02 * np.sin(t / 3.0)
    turn = G * np.tan(bank) / 18.0
    yaw = np.cumsum(turn) * (t[1] - t[0])
    rate = np.stack([np.gradient(bank, t), np.gradient(pitch, t), turn], axis=1)
    return np.stack([bank, pitch, yaw], axis=1), rate


def synthetic_flight(count: int, rate_hz: float, seed: int = 3) -> tuple[Rows, AttitudeReference]:
    """ESTIMATE rows of a made-up flight with the seed's gates, and a second attitude at 25 Hz."""
    random = np.random.default_rng(seed)
    limits = GateSettings()
    t = np.arange(count) / rate_hz
    euler, rate = _turns(t)
    q = quaternion_columns(euler)
    noise = random.normal(0.0, 1.0, (count, 6))
    rows = empty(ESTIMATE_DTYPE, count)
    rows["time_ns"] = 5_000_000_000 + np.round(t * 1e9).astype(np.int64)
    rows["received_ns"] = rows["time_ns"] + 1_700_000_000_000_000_000
    rows["ned_from_body"], rows["rate_rad_s"] = q, rate
    gravity = rotate_columns(inverse_columns(q), np.broadcast_to([0.0, 0.0, -G], (count, 3)))
    takeoff = 3.5 * np.exp(-0.5 * ((t - 9.0) / 1.5) ** 2)
    inward = G * np.tan(euler[:, 0])
    banked = [takeoff, inward * np.cos(euler[:, 0]), -inward * np.sin(euler[:, 0])]
    turning = np.stack(banked, axis=1)
    residual = turning + 0.12 * noise[:, :3]
    rows["residual_m_s2"], rows["accel_m_s2"] = residual, gravity + residual
    settle = np.exp(-t / 25.0)[:, None]
    rows["gyro_bias_rad_s"] = (
        np.array([0.006, -0.004, 0.002]) * (1.0 - settle) + 1e-4 * noise[:, 3:]
    )
    rows["gyro_bias_sigma_rad_s"] = 0.012 * settle * [1.0, 1.0, 1.3] + 0.0008
    rows["attitude_sigma_rad"] = 0.03 * settle * [1.0, 1.0, 3.0] + 0.006
    rows["innovation_rad"] = np.cross(residual, [0.0, 0.0, -1.0]) / G
    force = np.linalg.norm(rows["accel_m_s2"], axis=1)
    rows["gate_norm_m_s2"] = np.abs(force - G)
    rows["gate_rate_rad_s"] = np.linalg.norm(rate, axis=1)
    rows["gate_angular_acceleration_rad_s2"] = np.abs(np.gradient(rate[:, 0], t)) + 0.2
    tilt = np.linalg.norm(rows["innovation_rad"][:, :2], axis=1)
    rows["gate_innovation"] = tilt / 0.06
    rows["temperature_degc"] = 24.0 + 18.0 * (1.0 - np.exp(-t / 300.0))
    rows["phase"] = np.where(t < 1.5, Phase.ALIGNING, Phase.RUNNING)
    rows["gate"] = (
        np.where(rows["gate_norm_m_s2"] > limits.norm_m_s2, Gate.NORM, 0)
        | np.where(rows["gate_rate_rad_s"] > limits.rate_rad_s, Gate.RATE, 0)
        | np.where(rows["gate_innovation"] > limits.innovation_sigma, Gate.INNOVATION, 0)
    )
    theirs = quaternion_columns(euler[::8] + np.radians([4.0, -2.0, 3.0]))
    return rows, AttitudeReference("autopilot", rows["time_ns"][::8].copy(), theirs)


def main() -> None:
    """Write the file and print what it cost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--rate", type=float, default=200.0)
    arguments = parser.parse_args()
    rows, reference = synthetic_flight(
        round(arguments.hours * 3600 * arguments.rate), arguments.rate
    )
    started = time.perf_counter()
    from ahrs_service.viz.batch import write_rrd

    with tempfile.TemporaryDirectory() as folder:
        path = arguments.out or Path(folder) / "hour.rrd"
        imported = time.perf_counter()
        messages = [(int(rows["time_ns"][0]), "INFO", "made-up flight")]
        write_rrd(path, rows, [reference], messages=messages)
        done = time.perf_counter()
        size = path.stat().st_size
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{len(rows)} estimates and {len(reference.time_ns)} reference attitudes\n"
        f"import of rerun {imported - started:6.2f} s\n"
        f"write           {done - imported:6.2f} s\n"
        f"file            {size / 1e6:6.1f} MB\n"
        f"peak memory     {peak_mb:6.0f} MB",
        file=sys.stdout,
    )


if __name__ == "__main__":
    main()
