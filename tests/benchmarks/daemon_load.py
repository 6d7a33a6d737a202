"""Latency, CPU, memory and drops of the live service under load, and how soon it is up.

Run: python tests/benchmarks/daemon_load.py [--seconds 10] [--rates 100 200 400 1000] [--repeats 1]

An autopilot on loopback UDP (this process) sends HEARTBEAT and HIGHRES_IMU to a real
`ahrs-service run` that records and answers every sample with ATTITUDE. Latency is from just before
the frame is sent to just after its ATTITUDE is received, matched by time_boot_ms. A bare echo
process in the service's place, in the same run, is what the machine and the sender cost.
With repeats the table gives medians, and in brackets the least and the most. The viewer's stream is
hosted and nobody looks at it.
"""

import argparse
import contextlib
import gc
import math
import os
import re
import select
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ahrs_service.links.mavlink.codec import Decoder, Encoder, dialect

SPIN_S = 0.0001
FIRST_MS = 10_000
SETTLE_S = 1.5
HEARD_WITHIN_S = 60.0
ATTITUDE = dialect.MAVLINK_MSG_ID_ATTITUDE.to_bytes(3, "little")
HIGHRES_IMU = dialect.MAVLINK_MSG_ID_HIGHRES_IMU.to_bytes(3, "little")
COMMAND_LONG = dialect.MAVLINK_MSG_ID_COMMAND_LONG.to_bytes(3, "little")
MESSAGE_ID = slice(7, 10)

ECHO = """
import asyncio, sys

class Echo(asyncio.DatagramProtocol):
    def connection_made(self, transport):
        self.transport = transport

    def datagram_received(self, data, peer):
        self.transport.sendto(data, peer)

async def main():
    place = ("127.0.0.1", int(sys.argv[1]))
    await asyncio.get_running_loop().create_datagram_endpoint(Echo, local_addr=place)
    await asyncio.Event().wait()

asyncio.run(main())
"""


class Autopilot:
    """Sends HEARTBEAT and HIGHRES_IMU by a steady clock and answers commands."""

    def __init__(self, port: int, rate_hz: float, heartbeat_phase_s: float = 0.0) -> None:
        self._sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sock.setblocking(False)
        self._place = ("127.0.0.1", port)
        self._encoder = Encoder(1, 1)
        self._decoder = Decoder(datagrams=True)
        self._period_s = 1.0 / rate_hz
        self._random = np.random.default_rng(7)
        self._next = 0
        self._next_s = time.perf_counter()
        self._heartbeat_s = self._next_s + heartbeat_phase_s
        self.received: list[tuple[float, bytes]] = []
        self.sent: dict[int, float] = {}

    def fly(self, seconds: float) -> None:
        """Fly for `seconds`; all frames are made before the first is sent."""
        self._send(list(self._frames(seconds)), lambda: False)

    def fly_until_heard(self, running: "Service", each: Callable[[], None] = lambda: None) -> None:
        """Fly until a sample is answered; SystemExit with what the service said if none is."""

        def is_over() -> bool:
            each()
            return self._is_answered() or running.process.poll() is not None

        self._send(self._frames(HEARD_WITHIN_S), is_over)
        if not self._is_answered():
            raise SystemExit(f"no sample was answered\n{running.said()}")

    def _frames(self, seconds: float) -> Iterator[tuple[int, bytes]]:
        first = self._next
        return (self._imu(first + k) for k in range(round(seconds / self._period_s)))

    def _send(self, frames: Iterable[tuple[int, bytes]], until: Callable[[], bool]) -> None:
        """Send one frame per period; what came before is forgotten."""
        self.received, self.sent = [], {}
        # After a pause the clock goes on from here, with nothing to catch up.
        self._next_s = max(self._next_s, time.perf_counter())
        gc.collect()
        gc.disable()
        for time_ms, frame in frames:
            self._receive_until(self._next_s)
            now_s = time.perf_counter()
            if now_s >= self._heartbeat_s:
                self._sock.sendto(self._encoder.pack(_heartbeat()), self._place)
                self._heartbeat_s += 1.0
            self.sent[time_ms] = time.perf_counter()
            self._sock.sendto(frame, self._place)
            self._next += 1
            self._next_s += self._period_s
            if until():
                break
        gc.enable()

    def land(self) -> None:
        """Wait for what is still on its way."""
        self._receive_until(time.perf_counter() + 0.3)

    def close(self) -> None:
        """Leave the link."""
        self._sock.close()

    def _imu(self, number: int) -> tuple[int, bytes]:
        """Return one frame at rest with noise, and its stamp [ms], which no other has."""
        time_us = FIRST_MS * 1000 + round(number * self._period_s * 1e6)
        noise = self._random.normal(0.0, 1.0, 6)
        gyro, accel = 0.002 * noise[:3], [0.0, 0.0, -9.80665] + 0.05 * noise[3:]
        message = dialect.MAVLink_highres_imu_message(
            time_us, *accel, *gyro, 0.2, 0.0, 0.4, 1013.0, 0.0, 0.0, 25.0, 0x3F
        )
        return time_us // 1000, self._encoder.pack(message)

    def _receive_until(self, due_s: float) -> None:
        """Take what comes: asleep while there is time, awake for the last 0.1 ms."""
        while True:
            with contextlib.suppress(BlockingIOError):
                data = self._sock.recv(2048)
                self.received.append((time.perf_counter(), data))
                if data[MESSAGE_ID] == COMMAND_LONG:
                    self._answer(data)
                continue
            left_s = due_s - time.perf_counter()
            if left_s <= 0.0:
                return
            if left_s > SPIN_S:
                select.select([self._sock], [], [], left_s - SPIN_S)

    def _answer(self, data: bytes) -> None:
        for message, _ in self._decoder.feed(data):
            known = message.param1 == dialect.MAVLINK_MSG_ID_HIGHRES_IMU
            result = dialect.MAV_RESULT_ACCEPTED if known else dialect.MAV_RESULT_UNSUPPORTED
            answer = dialect.MAVLink_command_ack_message(
                message.command,
                result,
                target_system=message.get_srcSystem(),
                target_component=message.get_srcComponent(),
            )
            self._sock.sendto(self._encoder.pack(answer), self._place)

    def _is_answered(self) -> bool:
        return bool(self.received) and self.received[-1][1][MESSAGE_ID] in (ATTITUDE, HIGHRES_IMU)

    def latencies_ms(self) -> np.ndarray:
        """Return the latency of every sample of the last flight that was answered [ms]."""
        took = []
        for received_s, data in self.received:
            for message, _ in self._decoder.feed(data):
                time_ms = _stamp_ms(message)
                if time_ms in self.sent:
                    took.append(1e3 * (received_s - self.sent.pop(time_ms)))
        return np.array(took)


def _heartbeat() -> Any:
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_FIXED_WING, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3
    )


def _stamp_ms(message: Any) -> int:
    """Return the stamp of ATTITUDE, or of the echoed sample; -1 for all else."""
    if message.get_type() == "ATTITUDE":
        return int(message.time_boot_ms)
    return int(message.time_usec) // 1000 if message.get_type() == "HIGHRES_IMU" else -1


def _cpu_s(pid: int) -> float:
    """CPU time of all threads of a process [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _rss_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def free_port(kind: int) -> int:
    """Return a loopback port that is free now."""
    with socket.socket(socket.AF_INET, kind) as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


@dataclass
class Load:
    """What one run showed; `lost` is what the daemon says about itself."""

    p50_ms: float
    p99_ms: float
    max_ms: float
    cpu_percent: float
    rss_mb: float
    sent: int
    drops: int
    lost: str = ""


@dataclass
class Service:
    """A process that answers on `port`, its output, and the viewer's port if it has one."""

    process: subprocess.Popen[bytes]
    port: int
    output: Path
    viewer_port: int = 0
    started_s: float = field(default_factory=time.perf_counter)

    def said(self) -> str:
        """Return what it printed so far."""
        return self.output.read_text()


@contextlib.contextmanager
def service(rate_hz: float, viewer: bool, echo: bool = False) -> Iterator[Service]:
    """Start the daemon, or the bare echo, and end it by SIGTERM."""
    port = free_port(socket.SOCK_DGRAM)
    viewer_port = free_port(socket.SOCK_STREAM) if viewer else 0
    with tempfile.TemporaryDirectory() as folder, (Path(folder) / "output").open("wb") as output:
        command = [sys.executable, "-c", ECHO, str(port)] if echo else _run(port, rate_hz, folder)
        if viewer_port:
            command += ["--viewer", str(viewer_port)]
        process = subprocess.Popen(
            command,
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**os.environ, "COLUMNS": "200"},
        )
        try:
            yield Service(process, port, Path(output.name), viewer_port)
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGKILL if echo else signal.SIGTERM)
            process.wait(20.0)


def _run(port: int, rate_hz: float, folder: str) -> list[str]:
    settings = {"publish.attitude_rate_hz": rate_hz, "link.imu_rate_hz": rate_hz}
    return [
        str(Path(sys.executable).with_name("ahrs-service")),
        *("run", "--quiet", "--link", f"udpin:127.0.0.1:{port}", "--record", f"{folder}/logs"),
        *(word for name, value in settings.items() for word in ("--set", f"{name}={value}")),
    ]


def _wait_for_viewer(running: Service) -> None:
    """Wait until its port listens: its imports are part of the start, not of the load."""
    listening = f":{running.viewer_port:04X} 00000000:0000 0A"
    deadline_s = time.perf_counter() + HEARD_WITHIN_S
    while listening not in Path("/proc/net/tcp").read_text():
        if time.perf_counter() > deadline_s:
            raise SystemExit(f"the viewer did not start\n{running.said()}")
        time.sleep(0.1)


def load(rate_hz: float, seconds: float, viewer: bool = False, echo: bool = False) -> Load:
    """Run one service under one load."""
    with service(rate_hz, viewer, echo) as running:
        autopilot = Autopilot(running.port, rate_hz)
        if viewer:
            _wait_for_viewer(running)
        autopilot.fly_until_heard(running)
        autopilot.fly(SETTLE_S)
        pid = running.process.pid
        started_s = time.perf_counter()
        busy_s = _cpu_s(pid)
        autopilot.fly(seconds)
        busy_s = _cpu_s(pid) - busy_s
        elapsed_s = time.perf_counter() - started_s
        autopilot.land()
        rss_mb = _rss_mb(pid)
        autopilot.close()
        running.process.send_signal(signal.SIGKILL if echo else signal.SIGTERM)
        running.process.wait(20.0)
        lost = re.search(r"│ lost +│ (.*?) *│", running.said())
    sent = len(autopilot.sent)
    took = autopilot.latencies_ms()
    p50, p99 = np.percentile(took, [50, 99])
    return Load(
        float(p50),
        float(p99),
        float(took.max()),
        100.0 * busy_s / elapsed_s,
        rss_mb,
        sent,
        sent - len(took),
        lost.group(1) if lost else "",
    )


def start_up(phase_s: float) -> tuple[float, float]:
    """Return the time from the start of the process to listening and to the first ATTITUDE [s]."""
    listening_s = math.nan
    with service(200.0, viewer=False) as running:
        autopilot = Autopilot(running.port, 200.0, phase_s)

        def note_listening() -> None:
            nonlocal listening_s
            if math.isnan(listening_s) and "listening" in running.said():
                listening_s = time.perf_counter() - running.started_s

        autopilot.fly_until_heard(running, note_listening)
        first_s = autopilot.received[-1][0] - running.started_s
        autopilot.close()
    return listening_s, first_s


def _spread(values: list[float], digits: int) -> str:
    middle = f"{statistics.median(values):.{digits}f}"
    if len(values) == 1:
        return middle
    return f"{middle} [{min(values):.{digits}f}..{max(values):.{digits}f}]"


def _table() -> Table:
    table = Table(title="frame in to ATTITUDE out", title_justify="left")
    names = ["service", "IMU Hz", "p50 ms", "p99 ms", "max ms", "CPU %", "RSS MB"]
    for name in [*names, "sent", "not answered", "daemon lost"]:
        table.add_column(name, justify="left" if name == "service" else "right")
    return table


def _add_row(table: Table, name: str, rate_hz: float, loads: list[Load]) -> None:
    def of(field_name: str, digits: int) -> str:
        return _spread([getattr(one, field_name) for one in loads], digits)

    table.add_row(
        *(name, f"{rate_hz:g}", of("p50_ms", 3), of("p99_ms", 2), of("max_ms", 1)),
        *(of("cpu_percent", 1), of("rss_mb", 0), str(sum(one.sent for one in loads))),
        str(sum(one.drops for one in loads)),
        "; ".join(sorted({one.lost for one in loads if one.lost})),
    )


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rates", type=float, nargs="+", default=[100.0, 200.0, 400.0, 1000.0])
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--starts", type=int, default=3)
    arguments = parser.parse_args()
    console = Console()
    kinds: dict[str, dict[str, bool]] = {
        "echo": {"echo": True},
        "daemon": {},
        "daemon and viewer": {"viewer": True},
    }
    # The kernels are compiled and cached by the first start, which does not count.
    start_up(0.0)
    starts = [start_up(n / arguments.starts) for n in range(arguments.starts)]
    results: dict[tuple[float, str], list[Load]] = {}
    for _ in range(arguments.repeats):
        for rate_hz in arguments.rates:
            for name, options in kinds.items():
                one = load(rate_hz, arguments.seconds, **options)
                results.setdefault((rate_hz, name), []).append(one)
    table = _table()
    for (rate_hz, name), loads in results.items():
        _add_row(table, name, rate_hz, loads)
    console.print(table)
    console.print(f"load average of the machine {os.getloadavg()[0]:.1f}")
    if starts:
        listening, first = zip(*starts, strict=True)
        console.print(
            f"start-up: listening after {_spread(list(listening), 2)} s, "
            f"first ATTITUDE after {_spread(list(first), 2)} s (heartbeat 1 Hz, alignment 1 s)"
        )


if __name__ == "__main__":
    main()
