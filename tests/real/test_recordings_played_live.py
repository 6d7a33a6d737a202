"""Real autopilots' streams played in real time into the running service, over every link."""

import asyncio
import contextlib
import dataclasses
import os
import re
import signal
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.links.logs.player import play
from ahrs_service.links.logs.tlog import TlogFile, read_tlog
from ahrs_service.links.mavlink.codec import Encoder, dialect
from ahrs_service.records import Gate, Phase
from tests.hang import HANG_S

ROOT = Path(__file__).resolve().parents[2]
COMMAND = [sys.executable, "-m", "ahrs_service.app.cli", "run"]
KINDS = ["udpin", "tcp", "serial"]
RATE_HZ = 50.0
SECONDS = 10.0


def stretch(path: Path, start_s: float, stop_s: float) -> TlogFile:
    """Return a part of a recording, to be played."""
    log = read_tlog(path)
    since_s = (log.frames["received_us"] - log.frames["received_us"][0]) / 1e6
    return dataclasses.replace(log, frames=log.frames[(since_s >= start_s) & (since_s < stop_s)])


class Service:
    """One service process with one link, and the vehicle at the far end of it."""

    def __init__(self, kind: str, folder: Path, vehicle: Any) -> None:
        self.vehicle = vehicle
        self.recording = folder / f"{kind}.tlog"
        self.said = b""
        self.lost = -1

    async def start(self) -> None:
        await self.vehicle.prepare()
        options = ["--link", self.vehicle.uri, "--record", str(self.recording)]
        self._process = await asyncio.create_subprocess_exec(
            *COMMAND, *options, cwd=ROOT, env={**os.environ}, stdout=asyncio.subprocess.PIPE
        )
        up = b"listening" if self.vehicle.kind == "udpin" else b"connected to"
        where = await self.until_said(rb"  (\S+): " + up)
        await self.vehicle.meet(where[1].decode())

    async def until_said(self, pattern: bytes) -> re.Match[bytes]:
        assert self._process.stdout is not None
        while not (found := re.search(pattern, self.said)):
            data = await self._process.stdout.read(65536)
            assert data, self.said
            self.said += data
        return found

    async def fly(self, log: TlogFile) -> None:
        """Play in real time, wait until all of it was taken, and end the service."""
        counts = await play(log, self.vehicle)
        self.lost = counts.lost
        ask = dialect.MAVLink_command_long_message(
            1, 191, dialect.MAV_CMD_REQUEST_MESSAGE, 0, 0, 0, 0, 0, 0, 0, 0
        )
        taken = asyncio.Event()
        self.vehicle.answer = lambda message: self._note(message, taken)
        self.vehicle.send(Encoder(255, 190).pack(ask))
        await taken.wait()
        self._process.send_signal(signal.SIGTERM)
        out, _ = await self._process.communicate()
        self.said += out
        assert self._process.returncode == 0
        await self.vehicle.close()

    def _note(self, message: Any, taken: asyncio.Event) -> list[bytes]:
        if message.get_type() == "COMMAND_ACK":
            taken.set()
        return []

    def kill(self) -> None:
        with contextlib.suppress(ProcessLookupError, AttributeError):
            self._process.kill()


async def fly_all(services: list[Service], log: TlogFile) -> None:
    """All links at once: times are on the data's clock, so sharing the CPU has no influence."""
    try:
        async with asyncio.timeout(HANG_S):
            await asyncio.gather(*(service.start() for service in services))
            await asyncio.gather(*(service.fly(log) for service in services))
    finally:
        for service in services:
            service.kill()


def check_attitudes(heard: list[Any], estimates: Any) -> None:
    """ATTITUDE came back at the requested rate, on the samples' clock, with our values."""
    running = estimates[estimates["phase"] == Phase.RUNNING]
    ours = [message for message in heard if message.get_type() == "ATTITUDE"]
    flown_s = (running["time_ns"][-1] - running["time_ns"][0]) / 1e9
    assert flown_s > SECONDS - 3.0
    assert len(ours) == pytest.approx(flown_s * RATE_HZ, rel=0.02)
    stamps_ms = np.array([message.time_boot_ms for message in ours])
    steps_ms = np.diff(stamps_ms)
    assert np.median(steps_ms) == pytest.approx(1e3 / RATE_HZ, abs=1.0)
    assert (steps_ms > 0).all()
    assert set(stamps_ms) <= set(running["time_ns"] // 1_000_000 % 2**32)
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in ours} == {(1, 191)}


@pytest.mark.parametrize(
    ("name", "start_s", "limit_deg", "gates"),
    [
        ("sitl/arduplane_sitl_nominal.tlog", 12.0, 2.0, {Gate.OPEN, Gate.NORM}),
        ("flights/px4_auavx2_quad_250hz_reencoded.tlog", 0.0, 1.0, {Gate.OPEN, Gate.RATE}),
    ],
)
def test_played_in_real_time(
    name: str,
    start_s: float,
    limit_deg: float,
    gates: set[int],
    shared: Path,
    live: SimpleNamespace,
    tmp_path: Path,
) -> None:
    if not (shared / name).is_file():
        pytest.skip(f"no recording ../shared/data/{name}")
    log = stretch(shared / name, start_s, start_s + SECONDS)
    services = [Service(kind, tmp_path, live.Vehicle(kind, tmp_path)) for kind in KINDS]
    asyncio.run(fly_all(services, log))
    for service in services:
        result = replay_log(service.recording)
        assert f"\nestimates sha256 {result.summary.digest}\n" in service.said.decode()
        assert service.lost == 0
        assert not any(result.recording.damaged.values())
        played = read_tlog(service.recording)
        inbound = played.frames[played.frames["compid"] != 191]
        assert len(inbound) == len(log.frames) + 1
        check_attitudes(service.vehicle.heard, result.estimates)
        running = result.estimates[result.estimates["phase"] == Phase.RUNNING]
        seen = np.bitwise_or.reduce(running["gate"])
        assert all(not gate or seen & gate for gate in gates)
        assert (running["gate"] == Gate.OPEN).any()
        comparison = result.summary.comparison
        assert comparison is not None
        for angle in (comparison.roll, comparison.pitch):
            assert abs(angle.mean) + angle.sigma < np.radians(limit_deg)
