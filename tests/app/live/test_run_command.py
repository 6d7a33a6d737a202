"""The real `ahrs-service run`: how it starts, ends, is killed, and its errors if it cannot run."""

import contextlib
import os
import re
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ahrs_service.app.cli import COMMANDS, main
from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.links.logs.tlog import read_tlog
from ahrs_service.links.mavlink.codec import Decoder, Encoder, dialect
from tests.hang import HANG_S

ROOT = Path(__file__).resolve().parents[3]
COMMAND = [sys.executable, "-m", "ahrs_service.app.cli"]


class Running:
    """A service process on a UDP port that the system chose, and a socket that talks to it."""

    def __init__(self, folder: Path, *options: str, link: str = "udpin:127.0.0.1:0") -> None:
        environment = {**os.environ, "XDG_STATE_HOME": str(folder), "COLUMNS": "80"}
        environment.pop("NOTIFY_SOCKET", None)
        self.notify = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.notify.bind(str(folder / "notify"))
        self.notify.settimeout(HANG_S)
        environment["NOTIFY_SOCKET"] = str(folder / "notify")
        self.process = subprocess.Popen(
            [*COMMAND, "run", "--link", link, *options],
            cwd=ROOT,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self.said = b""
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(HANG_S)
        self.decoder = Decoder(datagrams=True)
        self.encoder = Encoder(255, 190)
        self.heard: list[str] = []

    def until_said(self, pattern: bytes) -> re.Match[bytes]:
        assert self.process.stdout is not None
        while not (found := re.search(pattern, self.said)):
            ready, _, _ = select.select([self.process.stdout], [], [], HANG_S)
            data = os.read(self.process.stdout.fileno(), 65536) if ready else b""
            assert data, (self.said, self.process.poll())
            self.said += data
        return found

    def connect(self) -> None:
        port = int(self.until_said(rb"udpin:127\.0\.0\.1:(\d+): listening")[1])
        self.socket.connect(("127.0.0.1", port))

    def fly(self, frames: list[bytes]) -> None:
        """Send frames in bursts; each ends when the service has acknowledged a final command."""
        ask = dialect.MAVLink_command_long_message(
            1, 191, dialect.MAV_CMD_REQUEST_MESSAGE, 0, 0, 0, 0, 0, 0, 0, 0
        )
        for start in range(0, len(frames), 200):
            for frame in frames[start : start + 200]:
                self.socket.send(frame)
            self.socket.send(self.encoder.pack(ask))
            self.until_heard("COMMAND_ACK")

    def until_heard(self, name: str) -> None:
        known = len(self.heard)
        while name not in self.heard[known:]:
            data = self.socket.recv(2000)
            self.heard += [message.get_type() for message, _ in self.decoder.feed(data)]

    def end(self, number: signal.Signals) -> tuple[str, str]:
        self.process.send_signal(number)
        out, errors = self.process.communicate(timeout=HANG_S)
        return (self.said + out).decode(), errors.decode()

    def notified(self) -> list[bytes]:
        self.notify.setblocking(False)
        heard = []
        with contextlib.suppress(BlockingIOError):
            while True:
                heard.append(self.notify.recv(1000))
        return heard

    def close(self) -> None:
        self.process.kill()
        self.process.communicate()
        self.socket.close()
        self.notify.close()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[object]:
    with contextlib.ExitStack() as stack:

        def start_one(*options: str, link: str = "udpin:127.0.0.1:0") -> Running:
            running = Running(tmp_path, *options, link=link)
            stack.callback(running.close)
            return running

        yield start_one


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_sigterm_leaves_every_file_whole(start, flight_frames, tmp_path):
    tlog, rrd = tmp_path / "flight.tlog", tmp_path / "flight.rrd"
    running = start("--record", str(tlog), "--rrd", str(rrd))
    running.connect()
    running.fly(flight_frames)
    assert running.heard.count("ATTITUDE") > 900
    assert running.notify.recv(1000).startswith(b"READY=1\nSTATUS=listening on udpin:")
    while running.notify.recv(1000) != b"WATCHDOG=1":
        pass
    out, errors = running.end(signal.SIGTERM)
    assert (running.process.returncode, errors) == (0, "")
    words = running.notified()
    assert words[-1] == b"STOPPING=1"
    assert any(re.match(rb"STATUS=\w.*, \d+ samples", word) for word in words)

    log = read_tlog(tlog)
    assert not any(log.damaged.values())
    assert log.frames["offset"][-1] + log.frames["length"][-1] == len(log.data)
    result = replay_log(tlog)
    assert f"\nestimates sha256 {result.summary.digest}\n" in out
    assert "closed" in out

    from rerun.chunk import RrdReader

    shown = set()
    for chunk in RrdReader(str(rrd)).stream():
        shown.add(str(chunk.entity_path))
    assert any("gate" in path for path in shown)


def test_a_recording_survives_a_kill(start, flight_frames, tmp_path):
    tlog = tmp_path / "flight.tlog"
    running = start("--record", str(tlog))
    running.connect()
    running.fly(flight_frames)
    # Twice, one whole second apart: what was received is then written to the system.
    for _ in range(2):
        running.notified()
        running.notify.settimeout(HANG_S)
        while running.notify.recv(1000) != b"WATCHDOG=1":
            pass
    running.end(signal.SIGKILL)
    assert running.process.returncode == -signal.SIGKILL
    log = read_tlog(tlog)
    assert not any(log.damaged.values())
    assert len(replay_log(tlog).estimates) > 1500
    assert np.all(np.diff(log.frames["received_us"]) >= 0)


def test_a_reader_of_the_log_that_goes_away_ends_no_flight(start, flight_frames, tmp_path):
    running = start("--record", str(tmp_path / "flight.tlog"))
    running.connect()
    assert running.process.stdout is not None
    running.process.stdout.close()
    running.fly(flight_frames[:1000])
    running.process.send_signal(signal.SIGHUP)
    assert running.process.wait(HANG_S) == 0
    assert len(replay_log(tmp_path / "flight.tlog").estimates) > 400


def test_it_ends_by_itself_when_reported(start):
    running = start("--seconds", "0.05", "--quiet")
    running.until_said(b"closed")
    assert running.process.wait(HANG_S) == 0


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to be in, with files that commands cannot use."""
    monkeypatch.chdir(tmp_path)
    Path("folder").mkdir()
    Path("empty.tlog").touch()
    Path("text.tlog").write_text("this is no log\n" * 100)
    Path("broken.toml").write_text("[link\nuri = 1")
    Path("binary.toml").write_bytes(b"\xff\xfe\x00")
    Path("typo.toml").write_text("[gate]\nnorm = 0.5\n")
    Path("wrong.toml").write_text("[gate]\nnorm_m_s2 = -1\n[link]\nuri = 5\n")
    Path("there.tlog").write_bytes(b"an earlier flight")
    Path("loop.toml").symlink_to("loop.toml")
    return tmp_path


LINK = ["--link", "udpin:127.0.0.1:0", "--seconds", "0.01"]

WRONG = [
    # The link.
    (["run", "--link", "udp:127.0.0.1:14550"], 1, "no such kind of link 'udp'; known: udpin:"),
    (["run", "--link", "udpin:127.0.0.1"], 1, "expected HOST:PORT"),
    (["run", "--link", "udpin:127.0.0.1:99999"], 1, "port 99999 is not between 0 and 65535"),
    (["run", "--link", "tcp:http://host:80"], 1, "is not a host|in brackets"),
    (["run", "--link", "serial:/dev/ttyAMA0"], 1, "expected serial:DEV:BAUD"),
    (["run", "--link", "serial:folder:57600"], 1, "folder is no serial port"),
    (["run", "--link", "udpin:192.0.2.1:14550"], 1, "cannot listen"),
    # Settings.
    (["run", *LINK, "--config", "missing.toml"], 2, "missing.toml: No such file"),
    (["run", *LINK, "--config", "folder"], 2, "folder: Is a directory"),
    (["run", *LINK, "--config", "loop.toml"], 2, "loop.toml: Too many levels"),
    (["run", *LINK, "--config", "broken.toml"], 2, "broken.toml: not valid TOML"),
    (["run", *LINK, "--config", "binary.toml"], 2, "binary.toml: not valid TOML"),
    (["run", *LINK, "--config", "typo.toml"], 2, r"gate.norm: no such field; .*norm_m_s2"),
    (["run", *LINK, "--config", "wrong.toml"], 2, r"wrong.toml: gate.norm_m_s2 = -1: .*great"),
    (["run", *LINK, "--set", "gate.nrom_m_s2=1"], 2, "gate.nrom_m_s2: no such field"),
    (["run", *LINK, "--set", "gates.norm_m_s2=1"], 2, "gates: no such field; known are intake"),
    (["run", *LINK, "--set", "gate.norm_m_s2"], 2, "write section.key=value"),
    (["run", *LINK, "--set", "norm_m_s2=1"], 2, "write section.key=value"),
    (["run", *LINK, "--set", "gate.norm_m_s2=wide"], 2, "gate.norm_m_s2 = 'wide'"),
    (["run", *LINK, "--set", "gate.norm_m_s2=nan"], 2, "gate.norm_m_s2 = nan"),
    (["run", *LINK, "--set", "intake.imu_source=best"], 2, "choose auto or one of HIGHRES_IMU"),
    (["run", *LINK, "--record", "there.tlog"], 2, "there.tlog: exists already"),
    (["run", *LINK, "--rrd", "folder"], 2, "cannot write folder: Is a directory"),
    (["run", *LINK, "--rrd", "missing/x.rrd"], 2, "cannot write missing/x.rrd"),
    # Other commands.
    (["replay", "missing.tlog"], 1, "missing.tlog: no such file"),
    (["replay", "folder"], 1, "folder"),
    (["replay", "empty.tlog"], 1, "empty.tlog: the file is empty"),
    (["replay", "text.tlog"], 1, "text.tlog: holds no MAVLink frames"),
    (["replay", "typo.toml"], 1, "typo.toml"),
    (["replay", "text.tlog", "--config", "folder"], 2, "folder: Is a directory"),
    (["replay", "text.tlog", "--set", "gate.norm=1"], 2, "gate.norm: no such field"),
    (["play", "missing.tlog", *LINK[:2]], 1, "missing.tlog: no such file"),
    (["play", "folder", *LINK[:2]], 1, "folder: cannot be read"),
    (["play", "text.tlog", *LINK[:2]], 1, "text.tlog: holds no MAVLink frames"),
    (["simulate", "--tlog", "folder", "--seconds", "1"], 1, "folder: Is a directory"),
    (["simulate", "--link", "carrier:pigeon", "--seconds", "1"], 1, "no such kind of link"),
    (["simulate", "--tlog", "x.tlog", "--scenario", "moon"], 2, "'moon': choose one of"),
    (["demo", "--out", "there.tlog"], 2, "--out there.tlog: Not a directory"),
    (["demo", "--set", "gate.norm=1"], 2, "gate.norm: no such field"),
]


@pytest.mark.parametrize(("arguments", "code", "says"), WRONG, ids=lambda value: str(value)[:60])
def test_errors_are_clear(arguments, code, says, files, capsys):
    assert main(arguments) == code
    errors = capsys.readouterr().err
    assert re.search(says, errors), errors
    assert re.match(r"(error|refused|failed): ", errors), errors
    assert "Traceback" not in errors
    assert Path("there.tlog").read_bytes() == b"an earlier flight"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "required: COMMAND"),
        (["fly"], "invalid choice: 'fly' .*'demo', 'run'"),
        (["run", "--seconds", "0"], "0 is not a number above 0"),
        (["run", "--seconds", "nan"], "nan is not a number above 0"),
        (["run", "--viewer", "high"], "high is not a port"),
        (["run", "--speed", "1"], "unrecognized arguments: --speed 1"),
        (["replay"], "required: LOG"),
        (["play", "x.tlog"], "required: --link"),
        (["simulate"], "--link --tlog is required"),
        (["demo", "--seconds", "-1"], "-1 is not a number above 0"),
    ],
)
def test_wrong_usage_is_reported(arguments, says, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert re.search(says, capsys.readouterr().err)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_names_every_option(command, capsys):
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    assert f"usage: ahrs-service {command}" in capsys.readouterr().out


def test_the_command_itself_fails_in_one_line(files):
    """The same through the real command: only one line on stderr, and the exit code."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder, socket.socket() as viewer:
        holder.bind(("127.0.0.1", 0))
        viewer.bind(("127.0.0.1", 0))
        viewer.listen()
        taken = f"udpin:127.0.0.1:{holder.getsockname()[1]}"
        viewer_port = str(viewer.getsockname()[1])
        cases = [
            (
                ["run", "--link", taken],
                1,
                b"cannot listen (Address already in use); choose another",
            ),
            (["run", *LINK, "--viewer", viewer_port], 2, b"port " + viewer_port.encode()),
            (["run", "--link", "udpin"], 1, b"no such kind of link"),
            (["run", "--config", "broken.toml"], 2, b"broken.toml: not valid TOML"),
        ]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        started = [
            subprocess.Popen(
                [*COMMAND, *arguments],
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
            )
            for arguments, _, _ in cases
        ]
        for process, (_, code, says) in zip(started, cases, strict=True):
            _, errors = process.communicate(timeout=HANG_S)
            assert process.returncode == code, errors
            assert says in errors
            assert errors.startswith(b"error: ")
            assert errors.count(b"\n") == 1, errors
