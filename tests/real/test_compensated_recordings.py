"""What the autopilots of the real recordings had compensated before they recorded."""

import pytest

from ahrs_service.calibration.autopilots.ardupilot_params import from_ardupilot, to_ardupilot
from ahrs_service.calibration.autopilots.board_rotation import board_rotation
from ahrs_service.calibration.autopilots.double_compensation import (
    already_compensated,
    forms_in_force,
)
from ahrs_service.calibration.autopilots.px4_params import from_px4, to_px4
from ahrs_service.links.logs.recording_formats import read_recorded_parameters
from ahrs_service.records import ImuSource

KNOWN = {
    # name: (largest offset of IMU 1 [m/s^2], reported by another sender than the vehicle)
    "bench_cuav_2021-12-08_static_warmup_2hz.tlog": (0.252, True),
    "bench_cuavv5_2021-12-08.bin": (0.252, False),
    "bench_matekh743_2021_isbd2khz_warmup.bin": (0.437, False),
    "copter_cube_2018-09-25_mission_3imu.tlog": (0.237, False),
    "copter_pixhawk_log0036_crash_temp.bin": (0.941, False),
    "copter_pixhawk_log0039_temp.bin": (0.196, False),
    "px4_auavx2_quad_250hz.ulg": (0.614, False),
    "px4_fmuv6c_quad_222hz.ulg": (0.622, False),
    "rov_bluerov2_2023-05-04_warmup_att20hz.tlog": (0.155, False),
}


@pytest.mark.parametrize("name", list(KNOWN))
def test_offsets_were_applied_and_temperature_was_not(shared, name):
    offset, is_copy = KNOWN[name]
    recorded = read_recorded_parameters(shared / "flights" / name)
    reported = already_compensated(recorded.values, ImuSource.SCALED_IMU, recorded.autopilot)
    assert f"offsets up to {offset:.3f} m/s^2" in reported[0]
    assert not any("compensated temperature" in text for text in reported)
    assert bool(recorded.notes) is is_copy
    assert all(form.span_degc is None for form in forms_in_force(recorded.values).values())


@pytest.mark.parametrize("name", list(KNOWN))
def test_real_parameters_survive_import_and_export_to_the_last_bit(shared, name):
    """Also with a rotated board: by ROLL_90 (the ROV), by 1.5 deg about x and y (the AUAV)."""
    values = read_recorded_parameters(shared / "flights" / name).values
    turn = board_rotation(values)
    if "CAL_ACC0_ID" in values:
        back = to_px4(from_px4(values, 1, turn), 1, turn).values
        back = {name: value for name, value in back.items() if name.startswith("CAL_")}
        assert len(back) == 9
    else:
        back = to_ardupilot(from_ardupilot(values, 1, turn), 1, turn).values
        assert len(back) == 10
    expected = {name: values.get(name, 0.0) for name in back}
    assert back == expected


def test_two_records_of_one_board_tell_the_same(shared):
    """The bench's tlog, by way of its ground station, and the board's own log of the same day."""
    names = ("bench_cuav_2021-12-08_static_warmup_2hz.tlog", "bench_cuavv5_2021-12-08.bin")
    tlog, own = (read_recorded_parameters(shared / "flights" / name).values for name in names)
    plain = [name for name in own if name.startswith("INS_ACC") and not name.endswith("CALTEMP")]
    assert len(plain) > 18
    assert {name: tlog[name] for name in plain} == {name: own[name] for name in plain}


def test_no_parameters_no_word(shared):
    recorded = read_recorded_parameters(shared / "flights" / "copter_quad106_50hz_reencoded.tlog")
    assert recorded.values == {}
    assert already_compensated({}, ImuSource.SCALED_IMU, recorded.autopilot) == []
