"""sd_notify against a real datagram socket, as the service manager opens it."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from ahrs_service.links.transport.service_notify import ServiceNotifier
from tests.hang import HANG_S


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    if request.param == "path":
        name = address = str(tmp_path / "notify")
    else:
        name, address = f"@ahrs-test-{os.getpid()}", f"\0ahrs-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        try:
            sock.bind(address)
        except OSError:
            pytest.skip("this system has no abstract unix sockets")
        sock.settimeout(HANG_S)
        yield sock, name


def test_every_word_arrives(manager: tuple[socket.socket, str]) -> None:
    sock, name = manager
    notifier = ServiceNotifier({"NOTIFY_SOCKET": name})
    notifier.ready("waiting for\nan autopilot")
    notifier.watchdog()
    notifier.status("running")
    notifier.stopping()
    heard = [sock.recv(1000) for _ in range(4)]
    notifier.close()
    assert heard == [
        b"READY=1\nSTATUS=waiting for an autopilot",
        b"WATCHDOG=1",
        b"STATUS=running",
        b"STOPPING=1",
    ]


def test_a_manager_that_restarts_is_found_again(tmp_path: Path) -> None:
    name = str(tmp_path / "notify")
    notifier = ServiceNotifier({"NOTIFY_SOCKET": name})
    notifier.watchdog()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind(name)
        sock.settimeout(HANG_S)
        notifier.watchdog()
        assert sock.recv(100) == b"WATCHDOG=1"
    notifier.watchdog()
    notifier.close()


def test_a_manager_that_does_not_read_blocks_nothing(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind(str(tmp_path / "notify"))
        notifier = ServiceNotifier({"NOTIFY_SOCKET": str(tmp_path / "notify")})
        for _ in range(2000):
            notifier.watchdog()
        notifier.close()
        assert sock.recv(100) == b"WATCHDOG=1"


@pytest.mark.parametrize(
    ("environment", "watchdog_s"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "10000000"}, 10.0),
        ({"WATCHDOG_USEC": "500000", "WATCHDOG_PID": str(os.getpid())}, 0.5),
        ({"WATCHDOG_USEC": "500000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
    ],
)
def test_the_watchdog_period_is_what_the_manager_allows(
    environment: dict[str, str], watchdog_s: float | None
) -> None:
    assert ServiceNotifier(environment).watchdog_s == watchdog_s


def test_without_a_manager_nothing_happens() -> None:
    for value in ("", "relative/path"):
        notifier = ServiceNotifier({"NOTIFY_SOCKET": value})
        notifier.ready()
        notifier.close()
