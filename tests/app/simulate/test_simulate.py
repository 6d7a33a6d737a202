import asyncio
import json
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.files.toml_file import read_as
from ahrs_service.app.simulate import command as simulate
from ahrs_service.links.logs.tlog import read_tlog
from ahrs_service.links.logs.tlog_recording import recording_from_tlog
from ahrs_service.links.mavlink.codec import Decoder, Encoder, dialect
from ahrs_service.rotation import euler_columns
from ahrs_service.simulation.imu import consumer_grade
from ahrs_service.simulation.scenario import fly_scenario, make_flight
from ahrs_service.simulation.script import Script
from tests.hang import HANG_S

EXAMPLE_SCRIPT = Path(__file__).parents[3] / "configs" / "flights" / "warm_up_and_turns.toml"


def test_the_written_flight_is_whole_and_the_same_each_time(simulated_tlog, tmp_path):
    flight = make_flight("flight", 60.0, seed=1)
    again = tmp_path / "again.tlog"
    frames = simulate.write_tlog(again, flight, simulate.RECORDED_RATES_HZ)
    assert again.read_bytes() == simulated_tlog.read_bytes()
    log = read_tlog(again)
    assert len(log.frames) == frames
    assert not any(log.damaged.values())
    counts = {name: len(table) for (_, _, name), table in log.tables.items()}
    assert counts == {
        name: round(60 * rate) + 1 for name, rate in simulate.RECORDED_RATES_HZ.items()
    }


def test_the_written_truth_is_the_flights_on_the_clock_of_the_imu(simulated_tlog):
    recording = recording_from_tlog(simulated_tlog)
    (truth,) = [reference for reference in recording.references if reference.is_truth]
    flight = make_flight("flight", 60.0, seed=1)
    rows = flight.rows[np.arange(len(truth.time_ns)) * 8]
    np.testing.assert_allclose(truth.ned_from_body, rows["ned_from_body"], atol=1e-6)
    since_ns = truth.time_ns - truth.time_ns[0]
    np.testing.assert_allclose(since_ns / 1e9, rows["time_s"], atol=1e-6)


class Companion(asyncio.DatagramProtocol):
    """A component that requests HIGHRES_IMU at the first heartbeat and sends ATTITUDE back."""

    def __init__(self):
        self.names = []
        self._decoder = Decoder(datagrams=True)
        self._encoder = Encoder(1, 191)

    def connection_made(self, transport):
        self._transport = transport

    def datagram_received(self, data, addr):
        for message, _ in self._decoder.feed(data):
            name = message.get_type()
            self.names.append(name)
            if name == "HEARTBEAT" and self.names.count(name) == 1:
                self._send(
                    dialect.MAVLink_command_long_message(
                        1, 1, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 105, 10_000, 0, 0, 0, 0, 0
                    ),
                    addr,
                )
            if name == "HIGHRES_IMU":
                self._send(dialect.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0), addr)

    def _send(self, message, addr):
        self._transport.sendto(self._encoder.pack(message), addr)


def test_it_flies_over_udp_and_counts_what_comes_back():
    async def fly():
        transport, companion = await asyncio.get_running_loop().create_datagram_endpoint(
            Companion, local_addr=("127.0.0.1", 0)
        )
        port = transport.get_extra_info("sockname")[1]
        flight = make_flight("rest", 10.0, rate_hz=200.0)
        autopilot = simulate.SimulatedAutopilot(flight.rows, flight.rate_hz)
        out = simulate.Console(quiet=True)
        link = simulate.LinkFlight(autopilot, f"udpout:127.0.0.1:{port}", 10.0, out)
        await link.fly()
        async with asyncio.timeout(HANG_S):
            while companion.names.count("HEARTBEAT") < 11:
                await asyncio.sleep(0.01)
        transport.close()
        return companion, autopilot, link

    companion, autopilot, link = asyncio.run(fly())
    assert link.flown_s == 10.0
    assert autopilot.counts.commands == {"SET_MESSAGE_INTERVAL ACCEPTED": 1}
    assert companion.names.count("HIGHRES_IMU") > 500
    assert companion.names.count("HEARTBEAT") == 11
    assert link.link.counts.send_failures == 0
    sent = autopilot.counts.sent["HIGHRES_IMU"]
    assert 0.9 * sent <= autopilot.counts.received["ATTITUDE"] <= sent


def test_a_signal_ends_it_with_its_report():
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.bind(("127.0.0.1", 0))
    listener.settimeout(HANG_S)
    uri = f"udpout:127.0.0.1:{listener.getsockname()[1]}"
    program = subprocess.Popen(
        [sys.executable, "-m", "ahrs_service.app.cli", "simulate", "--link", uri, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        listener.recv(300)
        program.send_signal(signal.SIGTERM)
        output, errors = program.communicate(timeout=HANG_S)
    finally:
        program.kill()
        listener.close()
    assert program.returncode == 0, errors
    report = json.loads(output)
    assert report["scenario"] == "flight"
    assert report["seconds"] < 60.0
    assert report["sent"]["HEARTBEAT"] >= 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--scenario", "moon"], "'moon': choose one of flight"),
        (["--rate", "3000"], "3000 Hz: choose 1 to 1000"),
        (["--rate", "50"], "loop of 50 Hz cannot"),
    ],
)
def test_what_cannot_be_flown_is_reported(options, words, tmp_path, capsys):
    assert main(["simulate", "--tlog", str(tmp_path / "x.tlog"), *options]) == 2
    assert words in capsys.readouterr().err


def test_a_script_is_flown_phase_by_phase(tmp_path):
    script = read_as(EXAMPLE_SCRIPT, Script)
    flight = fly_scenario("script", script.scenario(consumer_grade()), script.seconds, 1, 50.0)
    assert flight.rows["time_s"][-1] == script.seconds == 199.0
    ends = np.cumsum([phase.seconds for phase in script.phases])
    for phase, end_s in zip(script.phases, ends, strict=True):
        middle = flight.rows[round((end_s - 0.5 * phase.seconds) * 50.0)]
        assert middle["throttle"] == pytest.approx(phase.throttle, abs=1e-3)
        roll = np.degrees(euler_columns(middle["ned_from_body"][None])[0, 0])
        assert roll == pytest.approx(phase.roll_deg, abs=6.0)
    assert abs(flight.rows["position_ned_m"][-1, 2]) < 10.0
    path = tmp_path / "script.tlog"
    assert main(["simulate", "--script", str(EXAMPLE_SCRIPT), "--tlog", str(path)]) == 0
    recording = recording_from_tlog(path)
    assert recording.message_counts["HIGHRES_IMU"] == 199 * 200 + 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("phases = []", "phases = []: Tuple should have at least 1 item"),
        ("wind = 3.0\n[[phases]]\nname='a'\nseconds=3.0", "wind: no such field"),
        ("[[phases]]\nname = 'a'\nseconds = 5.0\nroll_deg = 90.0", "phases.0.roll_deg = 90.0"),
        ("[[phases]]\nname = 'a'", "phases.0.seconds: is missing"),
        ("[[phases]", "not valid TOML"),
    ],
)
def test_a_script_that_cannot_be_flown_is_reported(text, words, tmp_path, capsys):
    script = tmp_path / "mine.toml"
    script.write_text(text)
    out = tmp_path / "x.tlog"
    assert main(["simulate", "--script", str(script), "--tlog", str(out)]) == 2
    message = capsys.readouterr().err
    assert str(script) in message
    assert words in message
    assert not out.exists()


def test_a_file_that_cannot_be_written_is_named(tmp_path, capsys):
    path = tmp_path / "missing" / "x.tlog"
    assert main(["simulate", "--tlog", str(path), "--seconds", "1"]) == 1
    assert f"{path}: No such file" in capsys.readouterr().err


def test_a_place_to_fly_to_is_needed(capsys):
    with pytest.raises(SystemExit):
        main(["simulate"])
    assert "--link --tlog is required" in capsys.readouterr().err
