import pytest
from pyulog import ULog

from ahrs_service.errors import RecordingError
from ahrs_service.links.logs.parameter_values import ARDUPILOT, PX4
from ahrs_service.links.logs.recording_formats import read_recorded_parameters
from ahrs_service.links.logs.tlog import tlog_record
from ahrs_service.links.mavlink.codec import Encoder, decode_frame, dialect
from ahrs_service.links.simulated.autopilot_parameters import (
    AutopilotParameters,
    ardupilot_ins,
    px4_calibration,
)
from ahrs_service.settings import IntakeSettings


def write_tlog(path, frames):
    stamps = range(1_700_000_000_000_000, 1_800_000_000_000_000, 4000)
    path.write_bytes(b"".join(map(tlog_record, stamps, frames)))
    return path


def reported(autopilot, values, system=1, component=1):
    """PARAM_VALUEs of all parameters of an autopilot, as its reply to PARAM_REQUEST_LIST."""
    parameters = AutopilotParameters(values, autopilot)
    request = dialect.MAVLink_param_request_list_message(system, component)
    message = decode_frame(Encoder(255, 190).pack(request))
    encoder = Encoder(system, component)
    return [encoder.pack(answer) for answer in parameters.on_message(message)]


def beat(autopilot, system=1, component=1):
    message = dialect.MAVLink_heartbeat_message(2, autopilot, 0, 0, 4, 3)
    return Encoder(system, component).pack(message)


@pytest.mark.parametrize("autopilot", [ARDUPILOT, PX4])
def test_a_tlog_gives_what_the_autopilot_reported(tmp_path, autopilot):
    values = px4_calibration() if autopilot == PX4 else ardupilot_ins()
    path = write_tlog(tmp_path / "a.tlog", [beat(autopilot), *reported(autopilot, values)])
    recorded = read_recorded_parameters(path)
    assert recorded.autopilot == autopilot
    assert recorded.notes == recorded.changed == ()
    listed = {n: v.value for n, v in values.items() if "TCAL" not in n or "ENABLE" in n}
    assert recorded.values == listed


def test_a_value_reported_anew_is_the_last_and_is_named(tmp_path):
    first = ardupilot_ins()
    second = first | {"INS_ACCOFFS_X": first["INS_ACCSCAL_X"]}
    frames = [beat(ARDUPILOT), *reported(ARDUPILOT, first), *reported(ARDUPILOT, second)]
    recorded = read_recorded_parameters(write_tlog(tmp_path / "a.tlog", frames))
    assert recorded.values["INS_ACCOFFS_X"] == 1.0
    assert recorded.changed == ("INS_ACCOFFS_X",)


def test_a_ground_station_s_copy_is_used_and_said(tmp_path):
    """As Mission Planner's logs have it: all by 255/190, one by the vehicle itself."""
    old = ardupilot_ins() | {"INS_ACCOFFS_X": ardupilot_ins()["INS_ACCSCAL_X"]}
    own = [f for f in reported(ARDUPILOT, ardupilot_ins(), 10) if b"INS_ACCOFFS_X" in f]
    frames = [beat(dialect.MAV_AUTOPILOT_INVALID, 255, 190), beat(ARDUPILOT, 10)]
    frames += [*own, *reported(ARDUPILOT, old, 255, 190)]
    recorded = read_recorded_parameters(write_tlog(tmp_path / "a.tlog", frames))
    assert recorded.values["INS_ACCOFFS_X"] == 0.0
    assert recorded.values["INS_ACCOFFS_Y"] == 0.0
    assert recorded.notes == ("parameters as reported by 255/190, not the vehicle itself",)


def test_none_and_no_log(tmp_path):
    assert read_recorded_parameters(write_tlog(tmp_path / "a.tlog", [beat(PX4)])).values == {}
    with pytest.raises(RecordingError, match="no such file"):
        read_recorded_parameters(tmp_path / "no.bin")
    with pytest.raises(RecordingError, match="not a supported log format"):
        read_recorded_parameters(tmp_path / "no.txt")
    (tmp_path / "bad.ulg").write_bytes(b"nonsense")
    with pytest.raises(RecordingError, match="not a ULog"):
        read_recorded_parameters(tmp_path / "bad.ulg")


def test_a_real_ulog_against_pyulog(shared):
    path = shared / "flights" / "px4_fmuv6c_quad_222hz.ulg"
    recorded = read_recorded_parameters(path)
    assert recorded.values == ULog(str(path)).initial_parameters
    assert recorded.values["CAL_ACC0_ID"] == 4259850


def test_of_two_vehicles_each_keeps_its_own(tmp_path):
    """The first autopilot heard is used, even if another reports more; another can be selected."""
    second = ardupilot_ins() | {"INS_ACCOFFS_X": ardupilot_ins()["INS_ACCSCAL_X"]}
    few = [frame for frame in reported(ARDUPILOT, ardupilot_ins(), 7) if b"INS_ACCOFFS_X" in frame]
    frames = [beat(ARDUPILOT, 7), beat(ARDUPILOT, 2), *reported(ARDUPILOT, second, 2), *few]
    path = write_tlog(tmp_path / "a.tlog", frames)
    assert read_recorded_parameters(path).values == {"INS_ACCOFFS_X": 0.0}
    other = read_recorded_parameters(path, IntakeSettings(system=2))
    assert other.values["INS_ACCOFFS_X"] == 1.0
    assert len(other.values) > 10
    assert other.notes == ()
