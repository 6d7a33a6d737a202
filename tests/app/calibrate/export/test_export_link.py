"""`calibrate export` and `import` against autopilots at real links."""

import asyncio
import socket

import pytest
from rich.console import Console

from ahrs_service.app.files import calibration_file
from ahrs_service.app.simulate.command import LinkFlight
from ahrs_service.calibration.autopilots.ardupilot_params import to_ardupilot
from ahrs_service.calibration.autopilots.px4_params import to_px4
from ahrs_service.links.logs.param_files import ParamValue, read_param_file
from ahrs_service.links.logs.parameter_values import ARDUPILOT, PX4, rounded
from ahrs_service.links.mavlink.codec import Decoder, Encoder
from ahrs_service.links.mavlink.signing import Signer, key_from_text
from ahrs_service.links.simulated.autopilot import SimulatedAutopilot
from ahrs_service.sensor.parameters import Calibration, TriadCalibration
from ahrs_service.simulation.scenario import make_flight
from tests.app.calibrate.export.conftest import autopilot, command, run, text_of, unit


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
            printed = text_of(capsys)
            assert "parameters written and read back; restart the autopilot" in printed
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


def test_a_signed_link(live, folder, capsys, monkeypatch):
    """Both ends hold the key; with another key no frame is accepted."""
    (folder / "key.toml").write_text('[link]\nsigning_key = "open sesame"\n')
    signer = Signer(key_from_text("open sesame"), 0)

    async def scenario(*words):
        async with autopilot(live, folder) as far:
            far.encoder = Encoder(1, 1, signer)
            far.vehicle._decoder = Decoder(signer, datagrams=True)
            return await command("export", "unit.toml", "--link", far.vehicle.uri, *words)

    assert asyncio.run(scenario("--config", "key.toml", "--yes")) == 0
    assert "written and read back" in text_of(capsys)
    monkeypatch.setattr("ahrs_service.links.component.parameter_client.VEHICLE_S", 0.3)
    (folder / "key.toml").write_text('[link]\nsigning_key = "another"\n')
    assert asyncio.run(scenario("--config", "key.toml")) == 1
    assert "no heartbeat of an autopilot" in text_of(capsys)


def test_losses_and_what_no_autopilot_carries_are_reported(live, folder, capsys):
    async def scenario():
        async with autopilot(live, folder) as far:
            await command("export", "unit.toml", "--link", far.vehicle.uri)

    run(scenario())
    printed = text_of(capsys)
    assert "what the autopilot's form of calibration loses" in printed
    assert "now in force: IMU 1, accel: offsets up to 0.062 m/s^2" in printed
    assert "--compensated-by" in printed
    loss = to_ardupilot(unit()).losses["accel"]
    assert f"{loss.scale[1]:.4f}" in printed


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
