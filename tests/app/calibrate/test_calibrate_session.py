"""A guided session: the real process on a real socket, and the simulated unit on the bench."""

import asyncio
import json
import math
import os
import pty
import re
import select
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.simulate import command as simulate
from ahrs_service.links.logs.tlog import read_tlog
from ahrs_service.simulation.pose_sequence import PoseSequence, Turn
from ahrs_service.simulation.scenario import SCENARIOS, make_flight
from tests.hang import HANG_S

ROOT = Path(__file__).resolve().parents[3]
COMMAND = [sys.executable, "-m", "ahrs_service.app.cli", "calibrate"]
X, Y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


@pytest.fixture
def clumsy(monkeypatch):
    """Six faces by an operator who first leaves the unit tilted by 30 deg, and once holds it."""
    poses = PoseSequence(
        (
            Turn(X, 30.0),
            Turn(X, 60.0),
            *(Turn(X, 90.0), Turn(X, 90.0), Turn(X, 90.0)),
            Turn(Y, 90.0),
            Turn(Y, -180.0),
        )
    )
    scenario = replace(SCENARIOS["six-position"], bench=poses, phases=poses.phases)
    monkeypatch.setitem(SCENARIOS, "clumsy", scenario)
    flight = make_flight("clumsy", 32.0, rate_hz=100.0)
    ends = np.cumsum([phase.seconds for phase in flight.phases])
    t = flight.rows["time_s"]
    hand = (t > ends[11] + 0.3) & (t < ends[12] - 0.3)
    tremor = math.radians(4.0) * np.sin(2.0 * np.pi * 9.0 * t)
    flight.rows["gyro_rad_s"][:, 1] += np.where(hand, tremor, 0.0)
    return flight, hand


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


async def fly(flight, port, process, speed):
    """Send the flight to the session until it is over or the session ends."""
    rates = {"HEARTBEAT": 1.0, "SCALED_IMU": 1.0}
    autopilot = simulate.SimulatedAutopilot(flight.rows, flight.rate_hz, rates)
    out = simulate.Console(quiet=True)
    link = simulate.LinkFlight(autopilot, f"udpout:127.0.0.1:{port}", speed, out)
    flying = asyncio.create_task(link.fly())
    async with asyncio.timeout(HANG_S):
        while process.poll() is None and not flying.done():
            await asyncio.sleep(0.05)
    flying.cancel()
    await asyncio.gather(flying, return_exceptions=True)
    return autopilot


def until(read, pattern, said=b""):
    """Read the output of a process until `pattern` is in it."""
    deadline_s = time.monotonic() + HANG_S
    while not (found := re.search(pattern, said)):
        assert time.monotonic() < deadline_s, said.decode(errors="replace")[-2000:]
        ready, _, _ = select.select([read], [], [], HANG_S)
        data = os.read(read, 65536) if ready else b""
        assert data, said.decode(errors="replace")
        said += data
    return said, found


def test_a_session_refuses_bad_poses_goes_on_and_ends_as_its_recording_does(
    clumsy, tmp_path, capsys
):
    flight, hand = clumsy
    # The trembling pose is nose up; show it once more, still, so that the session can end.
    again = flight.rows.copy()
    again["time_s"] += flight.rows["time_s"][-1] + 0.01
    clean = make_flight("clumsy", 32.0, rate_hz=100.0).rows
    for name in ("gyro_rad_s", "accel_m_s2"):
        again[name] = clean[name]
    long = replace(flight, rows=np.concatenate([flight.rows, again]))
    port, tlog, out = free_port(), tmp_path / "bench.tlog", tmp_path / "A1.toml"
    words = ["six-position", "--no-turns", "--record", str(tlog), "--rate", "50", "--json"]
    process = subprocess.Popen(
        [*COMMAND, *words, "--link", f"udpin:127.0.0.1:{port}", "--out", str(out)],
        cwd=ROOT,
        env={**os.environ, "XDG_STATE_HOME": str(tmp_path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        said, _ = until(process.stderr.fileno(), rb"listening")
        autopilot = asyncio.run(fly(long, port, process, 16.0))
        stdout, stderr = process.communicate(timeout=HANG_S)
    finally:
        process.kill()
    said = (said + stderr).decode()
    assert process.returncode == 0, said
    assert "refused: 30 deg from the nearest face: lay it flat against the table" in said
    assert "refused: trembles by" in said
    assert "next: put it nose up (+x up) and let go" in said
    assert "next: all is there" in said
    assert "verdict: use" in said
    assert autopilot.counts.received["ATTITUDE"] == 0
    live = json.loads(stdout)
    assert out.exists()
    # The recording is whole, and the offline command finds the same in it.
    assert not any(read_tlog(tlog).damaged.values())
    assert main(["calibrate", "six-position", "--no-turns", str(tlog), "--json"]) == 0
    offline = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert live.pop("wrote") == str(out)
    assert offline.pop("wrote") is None
    assert live == offline
    error = np.array(live["found"]["accel"]["matrix"]) - make_truth()
    assert np.abs(error).max() < 2e-3
    assert hand.any()


def make_truth():
    return np.array(SCENARIOS["six-position"].imu.calibration.accel.matrix)


def test_an_interrupted_session_loses_nothing(clumsy, tmp_path, capsys):
    flight, _ = clumsy
    port, tlog = free_port(), tmp_path / "half.tlog"
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [*COMMAND, "six-position", "--link", f"udpin:127.0.0.1:{port}", "--record", str(tlog)],
        cwd=ROOT,
        env={**os.environ, "XDG_STATE_HOME": str(tmp_path), "TERM": "xterm", "COLUMNS": "120"},
        stdout=slave,
        stderr=slave,
    )
    os.close(slave)

    async def session():
        await asyncio.to_thread(until, master, rb"listening")
        flying = asyncio.create_task(fly(flight, port, process, 16.0))
        # The screen shows level as taken; then somebody presses Ctrl-C.
        screen, _ = await asyncio.to_thread(until, master, rb"-z up, level[^\n]*1 pose")
        process.send_signal(signal.SIGINT)
        await asyncio.to_thread(process.wait, HANG_S)
        await flying
        return screen

    try:
        screen = asyncio.run(session())
        rest, _ = until(master, rb"interrupted; all that was heard is in")
    finally:
        process.kill()
        os.close(master)
    assert process.returncode == 130
    assert "put it nose up (+x up) and let go" in screen.decode(errors="replace")
    assert "directions covered" in screen.decode(errors="replace")
    assert str(tlog) in rest.decode(errors="replace").replace("\r\n", "")
    assert not any(read_tlog(tlog).damaged.values())
    assert main(["calibrate", "six-position", str(tlog)]) == 1
    printed = capsys.readouterr().err
    assert "put the unit on each of its six faces" in printed
    assert "-z up" not in printed.split("none of them with")[1].split("up:")[0]
