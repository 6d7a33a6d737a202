"""The client against the simulated autopilots' parameters, over real sockets and a real pty."""

import asyncio
from collections import Counter
from contextlib import asynccontextmanager

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ahrs_service.errors import ParamError
from ahrs_service.links.component.parameter_client import ParameterClient
from ahrs_service.links.logs.param_files import INT32, REAL32, ParamValue
from ahrs_service.links.logs.parameter_values import (
    ARDUPILOT,
    PX4,
    decode,
    encode,
    param_name,
    rounded,
)
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.links.simulated.autopilot_parameters import (
    AutopilotParameters,
    ardupilot_ins,
    px4_calibration,
)
from tests.hang import HANG_S

INT8 = int(dialect.MAV_PARAM_TYPE_INT8)


@pytest.fixture(autouse=True)
def short_waits(monkeypatch):
    monkeypatch.setattr("ahrs_service.links.component.parameter_client.ANSWER_S", 0.05)
    monkeypatch.setattr("ahrs_service.links.component.parameter_client.SILENCE_S", 0.3)


@asynccontextmanager
async def conversation(live, folder, kind="udpin", autopilot=ARDUPILOT, limits=None):
    values = px4_calibration() if autopilot == PX4 else ardupilot_ins()
    vehicle = await live.Vehicle(kind, folder).prepare()
    parameters = AutopilotParameters(values, autopilot, limits)
    far = live.FarAutopilot(parameters, autopilot, vehicle)
    client = ParameterClient(vehicle.uri)
    if kind == "udpin":
        await client._link.start()
        await vehicle.meet(client._link.uri)
        client._link.start = lambda: asyncio.sleep(0)
    beat = asyncio.create_task(far.beat())
    try:
        async with client:
            yield client, far
    finally:
        beat.cancel()
        await vehicle.close()


def run(scenario):
    async def limited():
        async with asyncio.timeout(HANG_S):
            await scenario()

    asyncio.run(limited())


@pytest.mark.parametrize("kind", ["udpin", "udpout", "serial", "tcp"])
@pytest.mark.parametrize("autopilot", [ARDUPILOT, PX4])
def test_all_are_read_and_one_is_set(live, tmp_path, kind, autopilot):
    async def scenario():
        async with conversation(live, tmp_path, kind, autopilot) as (client, far):
            before = dict(far.parameters.values)
            assert await client.read(before) == before
            assert (client.autopilot, client.system, client.component) == (autopilot, 1, 1)
            name, value = {
                ARDUPILOT: ("INS_TCAL2_ENABLE", ParamValue(1.0, INT8)),
                PX4: ("TC_A0_ID", ParamValue(-1.0, INT32)),
            }[autopilot]
            assert await client.write(name, value) == value
            assert far.parameters.values == {**before, name: value}

    run(scenario)


def test_a_name_that_the_autopilot_has_not_is_missing_from_what_is_read(live, tmp_path):
    async def scenario():
        async with conversation(live, tmp_path) as (client, _):
            found = await client.read(["INS_NOT_THERE", "INS_ACCOFFS_X"])
            assert found == {"INS_ACCOFFS_X": ParamValue(0.0)}

    run(scenario)


def test_px4_says_that_it_has_no_such_name(live, tmp_path):
    async def scenario():
        async with conversation(live, tmp_path, autopilot=PX4) as (client, far):
            assert await client.read(["TC_NOT_THERE"]) == {}
            assert far.count("PARAM_REQUEST_READ") == 1
            with pytest.raises(ParamError, match=r"TC_NOT_THERE: refused .* DOES_NOT_EXIST"):
                await client.write("TC_NOT_THERE", ParamValue(1.0))

    run(scenario)


def test_lost_requests_and_lost_values_are_asked_for_again(live, tmp_path):
    """For each name up to three replies are lost before one arrives."""
    seen = Counter()

    def lose(message):
        name = param_name(message.param_id)
        seen[name, message.get_type()] += 1
        return seen[name, message.get_type()] % (1 + len(name) % 4) != 0

    async def scenario():
        async with conversation(live, tmp_path) as (client, far):
            far.lose_answer = lose
            names = list(far.parameters.values)
            assert await client.read(names) == far.parameters.values
            for name in names[:9]:
                wanted = ParamValue(0.1)
                assert await client.write(name, wanted) == rounded(wanted)
            assert far.count("PARAM_REQUEST_READ") > len(names)

    run(scenario)


def test_a_late_earlier_reply_is_not_mistaken_for_the_reply(live, tmp_path):
    """The old value, reported once more after the PARAM_SET, must not look like a refusal."""

    async def scenario():
        async with conversation(live, tmp_path) as (client, far):
            name = "INS_ACCOFFS_X"
            old = far.answer

            def late(message):
                stale = far.parameters._value(name)
                frames = old(message)
                is_set = message.get_type() == "PARAM_SET"
                return [far.encoder.pack(stale), *frames] if is_set else frames

            far.vehicle.answer = late
            assert await client.write(name, ParamValue(0.25)) == ParamValue(0.25)

    run(scenario)


def test_a_value_that_is_clamped_comes_back_as_it_is(live, tmp_path):
    async def scenario():
        limits = {"INS_TCAL1_TMAX": (-70.0, 80.0)}
        async with conversation(live, tmp_path, limits=limits) as (client, _):
            assert await client.write("INS_TCAL1_TMAX", ParamValue(95.0)) == ParamValue(80.0)

    run(scenario)


def test_a_refusal_by_message_is_reported_by_its_name(live, tmp_path):
    async def scenario():
        async with conversation(live, tmp_path) as (client, far):
            error = dialect.MAVLink_param_error_message(
                1, 192, b"INS_ACCOFFS_X", -1, dialect.MAV_PARAM_ERROR_READ_ONLY
            )
            far.vehicle.answer = lambda message: (
                [far.encoder.pack(error)] if message.get_type() == "PARAM_SET" else []
            )
            with pytest.raises(ParamError, match=r"INS_ACCOFFS_X: refused .*READ_ONLY"):
                await client.write("INS_ACCOFFS_X", ParamValue(1.0))

    run(scenario)


def test_nobody_there_and_a_vehicle_that_falls_silent_are_reported(live, tmp_path, monkeypatch):
    async def scenario():
        async with conversation(live, tmp_path) as (client, far):
            far.is_dead = True
            with pytest.raises(ParamError, match="fell silent before it sent INS_ACCOFFS_X"):
                await client.read(["INS_ACCOFFS_X"])
            with pytest.raises(ParamError, match=r"INS_ACCOFFS_X = 1\.0: no answer"):
                await client.write("INS_ACCOFFS_X", ParamValue(1.0))
        monkeypatch.setattr("ahrs_service.links.component.parameter_client.VEHICLE_S", 0.1)
        with pytest.raises(ParamError, match=r"no heartbeat of an autopilot in 0 s"):
            async with ParameterClient("udpin:127.0.0.1:0"):
                pass

    run(scenario)


def test_another_kind_of_autopilot_is_refused(live, tmp_path):
    async def scenario():
        with pytest.raises(ParamError, match="neither ArduPilot nor PX4"):
            async with conversation(live, tmp_path, "udpout", dialect.MAV_AUTOPILOT_GENERIC):
                pass

    run(scenario)


@given(st.integers(-(2**22), 2**31 - 2**24), st.sampled_from([ARDUPILOT, PX4]))
def test_integers_travel_as_each_autopilot_sends_them(value, autopilot):
    """Beyond 24 bits ArduPilot's cast rounds; PX4's bytes carry every integer."""
    field = encode("X", ParamValue(float(value), INT32), autopilot)
    back = decode(field, INT32, autopilot).value
    assert back == (value if autopilot == PX4 else float(np.float32(value)))


def test_the_bytes_on_px4_s_wire_are_those_of_the_integer():
    """CAL_ACC0_ID of a real PX4 log, 4259850 = 0x0041000A, reads as a tiny float."""
    field = encode("CAL_ACC0_ID", ParamValue(4259850.0, INT32), PX4)
    assert np.float32(field).tobytes() == bytes([0x0A, 0x00, 0x41, 0x00])
    assert encode("CAL_ACC0_ID", ParamValue(4259850.0, INT32), ARDUPILOT) == 4259850.0


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (ParamValue(300.0, INT8), "-128..127"),
        (ParamValue(0.5, INT8), "whole number"),
        (ParamValue(1.0, 10), "MAV_PARAM_TYPE 10"),
    ],
)
def test_a_value_beyond_its_type_is_refused(value, words):
    with pytest.raises(ParamError, match=words):
        encode("X", value, ARDUPILOT)


def test_a_float_is_rounded_to_32_bits():
    assert rounded(ParamValue(0.1)).value == float(np.float32(0.1))
    assert decode(encode("X", ParamValue(0.1), PX4), REAL32, PX4) == rounded(ParamValue(0.1))
