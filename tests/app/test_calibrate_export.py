"""`calibrate export` and `import` against autopilots at real links: what happens, what is lost."""

import asyncio
import socket
from contextlib import asynccontextmanager

import numpy as np
import pytest
from rich.console import Console

from ahrs_service.app import calibration_file, cli
from ahrs_service.app.calibrate import parameter_change
from ahrs_service.app.simulate import LinkFlight
from ahrs_service.calibration.autopilots.ardupilot_params import to_ardupilot
from ahrs_service.calibration.autopilots.px4_params import to_px4
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import Calibration, TriadCalibration
from ahrs_service.sensor.provenance import Verdict
from ahrs_service.simulation.scenario import make_flight
from links.autopilot import SimulatedAutopilot
from links.autopilot_parameters import AutopilotParameters, ardupilot_ins, px4_calibration
from links.mavlink_codec import Decoder, Encoder, dialect
from links.param_files import ParamValue, read_param_file
from links.parameter_client import ParameterClient
from links.parameter_values import ARDUPILOT, PX4, param_name, rounded
from links.signing import Signer, key_from_text


def unit(**fields):
    """A unit with drift of both triads, and what no autopilot carries: scale over temperature."""
    breaks = np.linspace(-10.0, 60.0, 15)

    def curve(size):
        return Curve.through(
            breaks,
            lambda t: size * np.column_stack([np.sin(t / 20.0), (t - 25.0) / 30.0, 0.0 * t]),
        )

    drift = np.zeros((2, 9))
    drift[1, 4] = 0.004
    return Calibration(
        gyro=TriadCalibration(bias=(0.004, -0.002, 0.001), c=curve(0.006)),
        accel=TriadCalibration(
            matrix=((1.01, 0.002, 0.0), (0.0, 0.99, 0.0), (0.0, 0.0, 1.002)),
            bias=(0.1, -0.2, 0.3),
            c=curve(0.08),
            matrix_drift=Curve.linear((-10.0, 60.0), drift),
        ),
        serial="A7",
        **fields,
    )


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder to work in, with unit.toml."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("links.parameter_client.ANSWER_S", 0.03)
    monkeypatch.setattr("links.parameter_client.SILENCE_S", 0.3)
    monkeypatch.setattr("links.parameter_client.VEHICLE_S", 5.0)
    calibration_file.save("unit.toml", unit())
    return tmp_path


@asynccontextmanager
async def autopilot(live, folder, kind="udpout", number=ARDUPILOT, limits=None):
    values = px4_calibration() if number == PX4 else ardupilot_ins()
    # Not as new: something that a backup must keep.
    first = "CAL_ACC0_XOFF" if number == PX4 else "INS_ACCOFFS_X"
    values[first] = ParamValue(0.0625)
    vehicle = await live.Vehicle(kind, folder).prepare()
    far = live.FarAutopilot(AutopilotParameters(values, number, limits), number, vehicle)
    beat = asyncio.create_task(far.beat())
    try:
        yield far
    finally:
        beat.cancel()
        await vehicle.close()


async def command(*words):
    async with asyncio.timeout(30.0):
        return await asyncio.to_thread(cli.main, ["calibrate", *map(str, words)])


def run(scenario):
    asyncio.run(scenario)


def text_of(capsys):
    out = capsys.readouterr()
    return " ".join((out.out + out.err).split())


@pytest.mark.parametrize("kind", ["udpout", "serial"])
@pytest.mark.parametrize("number", [ARDUPILOT, PX4])
def test_written_read_back_and_put_back_again(live, folder, capsys, kind, number):
    async def scenario():
        async with autopilot(live, folder, kind, number) as far:
            before = dict(far.parameters.values)
            uri = far.vehicle.uri
            assert await command("export", "unit.toml", "--link", uri) == 0
            assert "nothing was written" in text_of(capsys)
            assert far.parameters.values == before
            assert not far.count("PARAM_SET")

            words = ("export", "unit.toml", "--link", uri, "--yes", "--backup", "old.param")
            assert await command(*words) == 0
            told = text_of(capsys)
            assert "parameters written and read back; restart the autopilot" in told
            ids = {"accel": 4259850, "gyro": 4259850}
            wanted = to_px4(unit(), 1, device_ids=ids) if number == PX4 else to_ardupilot(unit())
            changed = {n: v for n, v in far.parameters.values.items() if v != before[n]}
            assert {n: far.parameters.values[n].value for n in wanted.values} == wanted.values
            assert changed.keys() <= wanted.values.keys()
            kept = {name: rounded(v) for name, v in read_param_file("old.param").items()}
            assert {n: v.value for n, v in kept.items()} == {n: before[n].value for n in kept}
            assert kept.keys() == wanted.values.keys()

            assert await command("export", "unit.toml", "--link", uri, "--yes") == 0
            assert "has these values already" in text_of(capsys)
            words = ("export", "--restore", "old.param", "--link", uri, "--yes")
            assert await command(*words, "--backup", "second.param") == 0
            assert far.parameters.values == before

    run(scenario())


def test_an_import_over_a_link_is_what_the_autopilot_does(live, folder, capsys):
    async def scenario():
        async with autopilot(live, folder, number=PX4) as far:
            words = ("--link", far.vehicle.uri)
            assert await command("export", "unit.toml", *words, "--yes") == 0
            assert await command("import", *words, "--out", "px4.toml", "--serial", "A7") == 0
            assert await command("export", "px4.toml", *words, "--offsets-at", "25") == 0

    run(scenario())
    assert "the autopilot has these values already" in text_of(capsys)
    read = calibration_file.load("px4.toml")
    assert read.gyro.span_degc == (-10.0, 60.0)
    assert (read.uid, read.imu) == ("0123456789abcdef", 0)


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
    told = text_of(capsys)
    assert "is of the board 00000000000000aa, at the link is 0123456789abcdef" in told


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
    told = text_of(capsys)
    assert "autopilots of systems 1, 7 are on this link: say --system N" in told
    assert "written and read back" in told


def test_a_signed_link(live, folder, capsys, monkeypatch):
    """Both ends hold the key; with another nobody is heard."""
    (folder / "key.toml").write_text('[link]\nsigning_key = "open sesame"\n')
    signer = Signer(key_from_text("open sesame"), 0)

    async def scenario(*words):
        async with autopilot(live, folder) as far:
            far.encoder = Encoder(1, 1, signer)
            far.vehicle._decoder = Decoder(signer, datagrams=True)
            return await command("export", "unit.toml", "--link", far.vehicle.uri, *words)

    assert asyncio.run(scenario("--config", "key.toml", "--yes")) == 0
    assert "written and read back" in text_of(capsys)
    monkeypatch.setattr("links.parameter_client.VEHICLE_S", 0.3)
    (folder / "key.toml").write_text('[link]\nsigning_key = "another"\n')
    assert asyncio.run(scenario("--config", "key.toml")) == 1
    assert "no heartbeat of an autopilot" in text_of(capsys)


def test_an_interruption_tells_how_far_it_came(live, folder, capsys):
    """As by Ctrl-C, which cancels what runs."""
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


def test_losses_and_what_no_autopilot_carries_are_told(live, folder, capsys):
    async def scenario():
        async with autopilot(live, folder) as far:
            await command("export", "unit.toml", "--link", far.vehicle.uri)

    run(scenario())
    told = text_of(capsys)
    assert "what the autopilot's form of calibration loses" in told
    assert "now in force: IMU 1, accel: offsets up to 0.062 m/s^2" in told
    assert "--compensated-by" in told
    loss = to_ardupilot(unit()).losses["accel"]
    assert f"{loss.scale[1]:.4f}" in told


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
            told = text_of(capsys)
            assert "no answer" in told
            assert "Written so far: INS_" in told
            assert "INS_TCAL1_ENABLE may be off" in told
            assert f"calibrate export --restore old.param --link {far.vehicle.uri} --yes" in told
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
    told = text_of(capsys)
    assert "INS_TCAL1_ACC1_Y = " in told
    assert "was not taken: the autopilot has 100.0" in told
    assert "--restore old.param" in told


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


def test_several_imus_and_a_turned_board(live, folder, capsys):
    other = Calibration(accel=TriadCalibration(bias=(0.0, 0.0, 0.5)))
    calibration_file.save("other.toml", other)

    async def scenario():
        async with autopilot(live, folder) as far:
            # ROLL_90: the sensor's y points along body z, its z along body -y.
            far.parameters.values["AHRS_ORIENTATION"] = ParamValue(16.0, 2)
            words = ("export", "unit.toml", "2=other.toml", "--link", far.vehicle.uri, "--yes")
            assert await command(*words) == 0
            values = far.parameters.values
            assert values["INS_ACC2OFFS_Y"].value == 0.5
            assert values["INS_ACC2OFFS_Z"].value == values["INS_TCAL2_ENABLE"].value == 0.0
            assert values["INS_ACCOFFS_Z"].value == pytest.approx(0.2, abs=0.02)
            assert values["INS_TCAL1_ENABLE"].value == 1.0

    run(scenario())


def test_px4_s_other_slot_of_the_same_sensor_is_found(live, folder, capsys):
    async def scenario():
        async with autopilot(live, folder, number=PX4) as far:
            values = far.parameters.values
            values["TC_A0_ID"] = values["CAL_ACC1_ID"]
            values["TC_A_ENABLE"] = ParamValue(1.0, 6)
            words = ("export", "2=unit.toml", "--link", far.vehicle.uri, "--yes")
            assert await command(*words) == 1
            assert not far.count("PARAM_SET")

    run(scenario())
    assert "TC_A0_ID is of the same sensor" in text_of(capsys)


def test_a_file_and_back_is_the_same_calibration_of_the_autopilot(folder, capsys):
    words = ["calibrate", "export", "unit.toml", "--autopilot", "ardupilot", "--param", "a.param"]
    assert cli.main(words) == 0
    assert cli.main(words) == 1
    assert "is there already" in text_of(capsys)
    assert cli.main(["calibrate", "import", "a.param", "--out", "b.toml", "--serial", "B"]) == 0
    assert "do not give it to the service" in text_of(capsys)
    read = calibration_file.load("b.toml")
    assert (read.serial, read.provenance.procedures) == ("B", ("import",))
    assert read.accel.span_degc == (-10.0, 60.0)
    assert cli.main(
        ["calibrate", "export", "b.toml", "--autopilot", "ardupilot", "--param", "c.param"]
    ) == 0  # fmt: skip
    assert read_param_file("c.param") == read_param_file("a.param")


def test_px4_s_file_needs_the_ids_of_the_sensors(folder, capsys):
    words = ["calibrate", "export", "unit.toml", "--autopilot", "px4", "--param"]
    assert cli.main([*words, "a.param"]) == 0
    assert "set it to CAL_ACC0_ID" in text_of(capsys)
    (folder / "px4.params").write_text(
        "1\t1\tCAL_ACC0_ID\t4259850\t6\n1\t1\tCAL_GYRO0_ID\t4325386\t6\n"
        + "".join(
            f"1\t1\tCAL_{triad}0_{axis}{what}\t{value}\t9\n"
            for triad, what, value in (("ACC", "OFF", 0), ("ACC", "SCALE", 1), ("GYRO", "OFF", 0))
            for axis in "XYZ"
        )
    )
    assert cli.main([*words, "b.param", "--compensated-by", "px4.params"]) == 0
    values = read_param_file("b.param")
    assert values["TC_A0_ID"] == ParamValue(4259850.0, 6)
    assert values["TC_G0_ID"] == ParamValue(4325386.0, 6)


def test_what_came_on_top_of_the_autopilot_s_own_replaces_both(folder, capsys):
    (folder / "old.param").write_text(
        "".join(
            f"INS_{name}_{axis},{value}\n"
            for name, value in (("ACCOFFS", 0.3), ("ACCSCAL", 1.02), ("GYROFFS", 0.01))
            for axis in "XYZ"
        )
    )
    words = ["calibrate", "export", "unit.toml", "--autopilot", "ardupilot", "--param", "a.param"]
    assert cli.main([*words, "--compensated-by", "old.param"]) == 0
    values = read_param_file("a.param")
    alone = to_ardupilot(unit()).values
    for i, axis in enumerate("XYZ"):
        scale = alone[f"INS_ACCSCAL_{axis}"]
        assert values[f"INS_ACCSCAL_{axis}"].value == pytest.approx(scale * 1.02, rel=1e-6)
        offset = alone[f"INS_ACCOFFS_{axis}"] / 1.02 + 0.3
        assert values[f"INS_ACCOFFS_{axis}"].value == pytest.approx(offset, abs=1e-5), i


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (["unit.toml", "--param", "a.param"], 2, "--param needs --autopilot"),
        (["--param", "a.param", "--autopilot", "px4"], 2, "give calibration files, or --restore"),
        (["--restore", "a.param", "--param", "b.param"], 2, "--restore needs --link"),
        (["unit.toml", "unit.toml", "--link", "udpin:127.0.0.1:0"], 2, "two calibrations for one"),
        (["no.toml", "--link", "udpin:127.0.0.1:0"], 2, "no.toml: No such file"),
        (["9=unit.toml", "--autopilot", "px4", "--param", "a.param"], 1, "IMU 9: give 1 for PX4"),
        (
            ["unit.toml", "--autopilot", "ardupilot", "--param", "a", "--orientation", "100"],
            2,
            "orientation 100 is none of the fixed rotations",
        ),
        (
            ["bad.toml", "--autopilot", "ardupilot", "--param", "a.param"],
            1,
            "bad.toml: not exported, for its verdict is: do not use: span 8 degC",
        ),
        (["unit.toml", "--link", "nonsense"], 1, "no such kind of link"),
    ],
)
def test_wrong_usage_and_refusals(folder, capsys, words, code, told):
    refused = Verdict(usable=False, sentences=("do not use: span 8 degC",))
    calibration_file.save("bad.toml", unit(verdict=refused))
    assert cli.main(["calibrate", "export", *words]) == code
    assert told in text_of(capsys)


def test_a_real_recording_s_parameters_and_who_told_them(folder, shared, capsys):
    flights = shared / "flights"
    log = flights / "bench_cuav_2021-12-08_static_warmup_2hz.tlog"
    assert cli.main(["calibrate", "import", str(log), "--imu", "2", "--out", "a.toml"]) == 0
    assert "as 255/190 tells them, not the vehicle itself" in text_of(capsys)
    read = calibration_file.load("a.toml")
    assert read.imu == 1
    assert read.accel.bias[0] == pytest.approx(0.39934, abs=1e-5)
    log = flights / "copter_cube_2018-09-25_mission_3imu.tlog"
    assert cli.main(["calibrate", "import", str(log), "--out", "b.toml"]) == 0
    assert "INS_GYROFFS_X, INS_GYROFFS_Y" in text_of(capsys)


def test_a_recording_without_parameters_is_told(folder, simulated_tlog, capsys):
    assert cli.main(["calibrate", "import", str(simulated_tlog), "--out", "a.toml"]) == 1
    assert "carries no parameters" in text_of(capsys)


def test_against_the_simulated_autopilot_in_flight(folder, capsys):
    """As `simulate` flies it, its other messages all around."""
    flight = make_flight("flight", 30.0, seed=2, rate_hz=100.0)
    vehicle = SimulatedAutopilot(flight.rows, flight.rate_hz)
    vehicle.parameters.values["INS_GYROFFS_Z"] = ParamValue(0.125)

    async def scenario():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            place = f"127.0.0.1:{free.getsockname()[1]}"
        flown = LinkFlight(vehicle, f"udpout:{place}", 1.0, Console(quiet=True))
        flying = asyncio.create_task(flown.fly())
        code = await command("export", "unit.toml", "--link", f"udpin:{place}", "--yes")
        flying.cancel()
        return code

    assert asyncio.run(scenario()) == 0
    assert "written and read back" in text_of(capsys)
    wanted = to_ardupilot(unit()).values
    assert {n: vehicle.parameters.values[n].value for n in wanted} == wanted
    (backup,) = folder.glob("ardupilot-1-*.param")
    assert read_param_file(backup)["INS_GYROFFS_Z"] == ParamValue(0.125)
