"""Exports that are interrupted, lost, clamped or refused: nothing is left half applied."""

import asyncio

import pytest

from ahrs_service.app.calibrate import parameter_change
from ahrs_service.app.files import calibration_file
from ahrs_service.calibration.autopilots.ardupilot_params import to_ardupilot
from ahrs_service.links.component.parameter_client import ParameterClient
from ahrs_service.links.logs.param_files import ParamValue
from ahrs_service.links.logs.parameter_values import ARDUPILOT, param_name
from ahrs_service.links.mavlink.codec import Encoder, dialect
from tests.app.calibrate.export.conftest import autopilot, command, run, text_of, unit


def test_a_calibration_of_another_board_is_refused(live, folder, capsys):
    calibration_file.save("own.toml", unit(uid="0123456789abcdef", imu=1))
    calibration_file.save("strange.toml", unit(uid="00000000000000aa"))

    async def scenario():
        async with autopilot(live, folder) as far:
            words = ("--link", far.vehicle.uri, "--yes")
            assert await command("export", "strange.toml", *words) == 1
            assert not far.count("PARAM_SET")
            assert await command("export", "own.toml", *words) == 0
            assert far.parameters.values["INS_TCAL2_ENABLE"].value == 1.0
            assert far.parameters.values["INS_TCAL1_ENABLE"].value == 0.0

    run(scenario())
    printed = text_of(capsys)
    assert "is of the board 00000000000000aa, at the link is 0123456789abcdef" in printed


def test_two_autopilots_on_a_link_need_a_choice(live, folder, capsys):
    async def scenario():
        async with autopilot(live, folder) as far:
            message = dialect.MAVLink_heartbeat_message(2, ARDUPILOT, 0, 0, 4, 3)
            second = Encoder(7, 1)
            answer = far.answer

            def both(asked):
                is_asked = asked.get_type() == "PARAM_REQUEST_READ"
                return [second.pack(message), *answer(asked)] if is_asked else answer(asked)

            far.vehicle.answer = both
            words = ("export", "unit.toml", "--link", far.vehicle.uri, "--yes")
            assert await command(*words) == 1
            assert not far.count("PARAM_SET")
            assert await command(*words, "--system", "1") == 0

    run(scenario())
    printed = text_of(capsys)
    assert "autopilots of systems 1, 7 are on this link: say --system N" in printed
    assert "written and read back" in printed


def test_an_interruption_reports_its_progress(live, folder, capsys):
    """As by Ctrl-C, which cancels the running task."""
    said = []

    async def scenario():
        async with autopilot(live, folder) as far, ParameterClient(far.vehicle.uri) as client:
            changes = await parameter_change.plan(client, to_ardupilot(unit()).values)
            far.lose_request = lambda message: far.count("PARAM_SET") > 5
            writing = asyncio.create_task(
                parameter_change.carry_out(client, changes, folder / "old.param", said.append)
            )
            while far.count("PARAM_SET") < 7:
                await asyncio.sleep(0.01)
            writing.cancel()
            with pytest.raises(asyncio.CancelledError):
                await writing

    run(scenario())
    assert said[0] == f"old values are in {folder / 'old.param'}"
    assert said[1].startswith("interrupted. Written so far: INS_")
    assert f"--restore {folder / 'old.param'} --link udpout:127.0.0.1:" in said[1]


def test_lost_requests_and_answers_change_nothing(live, folder, capsys):
    seen = {}

    def lose(message):
        key = (message.get_type(), param_name(message.param_id))
        seen[key] = seen.get(key, 0) + 1
        return seen[key] % 4 == 1

    async def scenario():
        async with autopilot(live, folder) as far:
            far.lose_request = far.lose_answer = lose
            assert await command("export", "unit.toml", "--link", far.vehicle.uri, "--yes") == 0
            wanted = to_ardupilot(unit()).values
            assert {n: far.parameters.values[n].value for n in wanted} == wanted

    run(scenario())


def test_a_link_that_dies_in_the_middle_leaves_nothing_half_in_force(live, folder, capsys):
    async def scenario():
        async with autopilot(live, folder) as far:
            far.parameters.values["INS_TCAL1_ENABLE"] = ParamValue(1.0, 2)
            before = dict(far.parameters.values)
            far.die_after = 12
            words = ("export", "unit.toml", "--link", far.vehicle.uri, "--yes")
            assert await command(*words, "--backup", "old.param") == 1
            printed = text_of(capsys)
            assert "no answer" in printed
            assert "Written so far: INS_" in printed
            assert "INS_TCAL1_ENABLE may be off" in printed
            assert f"calibrate export --restore old.param --link {far.vehicle.uri} --yes" in printed
            assert far.parameters.values["INS_TCAL1_ENABLE"].value == 0.0
            assert far.parameters.values != before

            far.is_dead, far.die_after = False, 10**9
            words = ("export", "--restore", "old.param", "--link", far.vehicle.uri, "--yes")
            assert await command(*words) == 0
            assert far.parameters.values == before

    run(scenario())


def test_a_value_that_is_clamped_stops_the_rest(live, folder, capsys):
    async def scenario():
        limits = {"INS_TCAL1_ACC1_Y": (-100.0, 100.0)}
        async with autopilot(live, folder, limits=limits) as far:
            words = ("export", "unit.toml", "--link", far.vehicle.uri, "--yes")
            assert await command(*words, "--backup", "old.param") == 1
            assert far.parameters.values["INS_TCAL1_ENABLE"].value == 0.0

    run(scenario())
    printed = text_of(capsys)
    assert "INS_TCAL1_ACC1_Y = " in printed
    assert "was not taken: the autopilot has 100.0" in printed
    assert "--restore old.param" in printed


def test_a_parameter_that_is_not_there_refuses_all(live, folder, capsys):
    async def scenario():
        async with autopilot(live, folder) as far:
            del far.parameters.values["INS_TCAL1_GYR2_Z"]
            words = ("export", "unit.toml", "--link", far.vehicle.uri, "--yes")
            assert await command(*words) == 1
            assert not far.count("PARAM_SET")

    run(scenario())
    assert "has no INS_TCAL1_GYR2_Z; nothing was written" in text_of(capsys)
    assert not list(folder.glob("ardupilot-*.param"))
