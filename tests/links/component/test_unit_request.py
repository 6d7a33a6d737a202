"""The board's number is requested where a calibration may depend on it, until it is reported."""

import itertools

import pytest

from ahrs_service.adoption import first_vehicle
from ahrs_service.links.component.unit_request import ATTEMPTS, UnitRequest
from ahrs_service.links.logs.recording_formats import read_recording
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.links.mavlink.unit_name import unit_name
from ahrs_service.settings import IntakeSettings, SensorSettings, Settings

NUMBER = dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
SIMULATED = b"SIM-1".hex()


def asked(flight):
    return [at_s for at_s, m in flight.named("COMMAND_LONG") if m.param1 == NUMBER]


def test_it_is_asked_once_where_it_is_answered(converse):
    flight = converse(settings=Settings(sensor=SensorSettings(calibration="folder")))
    flight.run(10.0)
    assert len(asked(flight)) == 1
    assert flight.component.unit == SIMULATED


def test_nobody_asks_who_needs_no_calibration(converse):
    flight = converse()
    flight.run(10.0)
    assert not asked(flight)
    assert flight.component.unit == ""


def test_who_does_not_answer_is_asked_ever_less(converse):
    flight = converse(settings=Settings(sensor=SensorSettings(calibration="folder")))
    flight.withhold = {"AUTOPILOT_VERSION"}
    flight.run(68.0)
    times = asked(flight)
    assert len(times) == 7 < ATTEMPTS
    gaps = [b - a for a, b in itertools.pairwise(times)]
    assert gaps == pytest.approx([2.0**k for k in range(len(gaps))], abs=0.11)
    assert flight.component.unit == ""


def test_nobody_is_asked_for_ever():
    request = UnitRequest()
    request.begin()
    times = [at_s for at_s in range(1000) if request.tick(float(at_s), 1, 1)]
    assert len(times) == ATTEMPTS
    request.begin()
    assert request.tick(1000.0, 1, 1)


@pytest.mark.parametrize(
    ("uid", "uid2", "name"),
    [
        (0, b"\x1e\0\x25\0\x15QV1\0\0", "1e00250015515631"),
        (0xAB, bytes(18), "00000000000000ab"),
        (0xAB, b"\x01", "01"),
        (0, bytes(18), ""),
    ],
)
def test_its_name_is_that_of_uid2_else_uid(uid, uid2, name):
    assert unit_name(uid, uid2) == name


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("bench_cuav_2021-12-08_static_warmup_2hz.tlog", "1e0025001551383137383335"),
        ("bench_cuavv5_2021-12-08.bin", "1e0025001551383137383335"),
        ("copter_erle_2014-09-07_50hz.bin", ""),
        ("px4_fmuv6c_quad_222hz.ulg", "0006000000003535323734325116003d0021"),
        ("px4_auavx2_quad_250hz.ulg", ""),
    ],
)
def test_recordings_tell_it(name, unit, shared):
    """ArduPilot's uid2 ends in zeros, PX4's sys_uuid has all 18 bytes; old logs have neither.

    The first two are of one day and one board: its DataFlash log writes the number by words.
    """
    path = shared / "flights" / name
    if not path.exists():
        pytest.skip(f"{path.name} is missing in ../shared/data/flights")
    recording = read_recording(path)
    vehicle = first_vehicle(recording.readings, IntakeSettings())
    assert recording.unit_of(vehicle) == unit
