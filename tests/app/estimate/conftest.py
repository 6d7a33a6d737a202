"""A flight as plain arrays, and the command run on them."""

import numpy as np
import pytest

from ahrs_service.app.cli import main
from ahrs_service.rotation import inverse_columns, multiply_columns
from ahrs_service.simulation.scenario import make_flight


@pytest.fixture(scope="module")
def flight():
    """A minute of the simulated flight as the fields of IN, forward-right-down, and its truth."""
    rows = make_flight("flight", 60.0, seed=1, rate_hz=100.0).rows
    fields = {
        "imu_gyr": rows["gyro_rad_s"],
        "imu_acc": rows["accel_m_s2"],
        "imu_mag": rows["mag_ut"].astype(np.float64),
        "airspeed": rows["airspeed_m_s"].astype(np.float64),
        "vel_ned": rows["velocity_ned_m_s"].astype(np.float64),
        "sampling_rate": 100.0,
    }
    return fields, rows


@pytest.fixture
def run(tmp_path, capsys):
    """Run the command on fields; return the fields of OUT."""

    def _run(fields, *options):
        source, out = tmp_path / "in.npz", tmp_path / "out.npz"
        np.savez(source, **fields)
        assert main(["estimate", "--in", str(source), "--out", str(out), *options]) == 0
        with np.load(out) as file:
            return {name: file[name] for name in file.files}

    return _run


def angle_deg(p, q):
    error = multiply_columns(p, inverse_columns(q))
    return np.degrees(2.0 * np.arctan2(np.linalg.norm(error[:, 1:], axis=1), np.abs(error[:, 0])))
