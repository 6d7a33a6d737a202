import pytest

from ahrs_service.calibration.autopilots.double_compensation import (
    PX4,
    already_compensated,
    forms_in_force,
    imu_of,
)
from ahrs_service.links.simulated.autopilot_parameters import ardupilot_ins, px4_calibration
from ahrs_service.records import ImuSource


def ardupilot(**changes):
    values = {name: value.value for name, value in ardupilot_ins(3).items()}
    assert not changes.keys() - values.keys()
    return values | changes


def px4(**changes):
    values = {name: value.value for name, value in px4_calibration().items()}
    assert not changes.keys() - values.keys()
    return values | changes


def test_a_new_autopilot_had_compensated_nothing():
    for source in ImuSource:
        assert already_compensated(ardupilot(), source, 3) == []
    for source in (ImuSource.SCALED_IMU, ImuSource.ULOG, ImuSource.RAW_IMU):
        assert already_compensated(px4(), source, PX4) == []
    assert already_compensated({}, ImuSource.SCALED_IMU) == []


def test_thermal_calibration_of_ardupilot_by_imu():
    values = ardupilot(INS_TCAL2_ENABLE=1.0, INS_TCAL2_TMIN=12.0, INS_TCAL2_TMAX=61.0)
    reported = already_compensated(values, ImuSource.SCALED_IMU2, 3)
    assert [text.split(":")[0] for text in reported] == ["IMU 2, accel", "IMU 2, gyro"]
    for text in reported:
        assert "INS_TCAL2_ENABLE = 1" in text
        assert "12..61 degC" in text
        assert "--compensated-by" in text
    assert already_compensated(values, ImuSource.SCALED_IMU, 3) == []
    learning = ardupilot(INS_TCAL1_ENABLE=2.0)
    assert already_compensated(learning, ImuSource.DATAFLASH, 3) == []


def test_offsets_and_scales_of_ardupilot():
    values = ardupilot(INS_ACCOFFS_Y=-0.25, INS_ACCSCAL_Z=1.02, INS_GYROFFS_X=0.0349)
    accel, gyro = already_compensated(values, ImuSource.RAW_IMU, 3)
    assert "offsets up to 0.250 m/s^2 and scales of 1.0000..1.0200" in accel
    assert "(INS_ACCOFFS and SCAL)" in accel
    assert "offsets up to 2.00 deg/s" in gyro
    assert "INS_GYR_CAL = 0" in gyro


def test_px4_by_the_id_of_the_sensor_and_by_the_message():
    values = px4(TC_A_ENABLE=1.0, TC_A1_ID=px4()["CAL_ACC0_ID"], TC_A1_TMAX=55.0, TC_A1_X0_2=0.5)
    reported = already_compensated(values, ImuSource.SCALED_IMU, PX4)
    assert "TC_A_ENABLE = 1, so the autopilot had compensated temperature over 0..55" in reported[0]
    assert "offsets up to 0.500 m/s^2" in reported[1]
    assert len(reported) == 2
    highres = already_compensated(px4(), ImuSource.HIGHRES_IMU, PX4)
    assert len(highres) == 1
    assert "estimator's own bias" in highres[0]
    assert "SCALED_IMU" in highres[0]
    assert already_compensated({}, ImuSource.HIGHRES_IMU, PX4) == highres
    assert already_compensated({}, ImuSource.HIGHRES_IMU, 3) == []


def test_what_cannot_be_known_is_reported():
    values = ardupilot(INS_TCAL1_ENABLE=1.0)
    del values["INS_TCAL1_ACC2_Y"]
    (reported,) = already_compensated(values, ImuSource.SCALED_IMU, 3)
    assert reported == (
        "IMU 1: what the autopilot did to it is not known: INS_TCAL1_ACC2_Y is missing: give all "
        "calibration parameters of the autopilot"
    )
    with pytest.raises(ValueError, match="none of the 1 parameters"):
        forms_in_force({"SYSID_THISMAV": 1.0})


def test_the_imu_of_a_source():
    assert [imu_of(source) for source in ImuSource] == [1, 1, 1, 1, 1, 1, 2, 3, 2, 3]
