"""The procedures on real benches: noise of the sensors' class, and missing poses."""

import json

import numpy as np
import pytest

from ahrs_service.app.cli import main
from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.multi_pose import fit_accelerometer
from ahrs_service.calibration.poses import find_poses
from ahrs_service.errors import CalibrationError


def recording(shared, name):
    path = shared / "flights" / name
    if not path.is_file():
        pytest.skip(f"no {name} in ../shared/data/flights")
    return str(path)


@pytest.mark.parametrize(
    "name", ["bench_cuavv5_2021-12-08.bin", "bench_matekh743_2021_isbd2khz_warmup.bin"]
)
def test_the_noise_is_that_of_the_sensors_data_sheets(shared, name, capsys):
    """ICM-20689, ICM-20602 and MPU-6000 class: 0.004 to 0.01 deg/s and 100 to 400 ug per rtHz.

    The autopilot's low-pass of 20 Hz leaves the density at one second as it is.
    """
    assert main(["calibrate", "allan", recording(shared, name), "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    for axis in found["gyro"]:
        assert 0.003 < np.degrees(axis["random_walk"][0]) < 0.01
    for axis in found["accel"]:
        assert 70e-6 < axis["random_walk"][0] / 9.80665 < 400e-6
    assert main(["calibrate", "noise", recording(shared, name), "--json"]) == 0
    (noise,) = json.loads(capsys.readouterr().out)
    assert noise["density"]["gyro"] == pytest.approx(
        [axis["random_walk"][0] for axis in found["gyro"]], rel=0.4
    )
    assert noise["gate_budget"]["rate_sigma_rad_s"] < 1e-3


def test_what_the_autopilot_took_off_before_is_reported(shared, capsys):
    """A bench with its parameters inside: the offsets that ArduPilot had applied are named."""
    path = recording(shared, "bench_cuav_2021-12-08_static_warmup_2hz.tlog")
    from pathlib import Path

    from ahrs_service.app.calibrate.capture import read_capture
    from ahrs_service.settings import IntakeSettings

    observed = " ".join(read_capture(Path(path), IntakeSettings()).compensated)
    assert "INS_ACCOFFS" in observed
    assert main(["calibrate", "multi-pose", path]) == 1
    assert "in 1 different direction: take 12 or more" in capsys.readouterr().err


def test_the_rests_of_broad_are_one_pose(shared):
    """Sixteen trials, in each the sensor rests in the same pose: too little to calibrate."""
    folder = shared / "broad"
    if not folder.is_dir():
        pytest.skip("no folder broad in ../shared/data")
    for path in sorted(folder.glob("*.npz"))[:4]:
        with np.load(path) as file:
            gyro, accel = file["imu_gyr"].astype(float), file["imu_acc"].astype(float)
            time_s = np.arange(len(gyro)) / float(file["sampling_rate"])
        poses = find_poses(ImuColumns(time_s, gyro, accel, np.full(len(gyro), np.nan)))
        # Complete rest for 25 s or more before the movement, according to the data set.
        assert poses["stop_s"][0] > 20.0
        with pytest.raises(CalibrationError, match="in 1 different direction: take 12 or more"):
            fit_accelerometer(poses)
