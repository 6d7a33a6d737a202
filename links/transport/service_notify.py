"""Reports the service's state to systemd (sd_notify): datagrams to the socket in NOTIFY_SOCKET."""

import os
import socket
from collections.abc import Mapping


class ServiceNotifier:
    """Speaks sd_notify; silent where no service manager listens.

    `watchdog_s` is the longest time [s] between two calls of `watchdog` that the manager allows,
    None where it does not watch.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        path = environment.get("NOTIFY_SOCKET", "")
        if path.startswith("@"):
            path = "\0" + path[1:]
        self._path = path if path.startswith(("/", "\0")) else ""
        self._socket: socket.socket | None = None
        self.watchdog_s = _watchdog_s(environment)

    def ready(self, status: str = "") -> None:
        """The service does its work from now on."""
        self._send("READY=1" + (f"\nSTATUS={_line(status)}" if status else ""))

    def watchdog(self) -> None:
        """The main loop is running."""
        self._send("WATCHDOG=1")

    def status(self, text: str) -> None:
        """One line about the state, shown by `systemctl status`."""
        self._send(f"STATUS={_line(text)}")

    def stopping(self) -> None:
        """The service is shutting down."""
        self._send("STOPPING=1")

    def close(self) -> None:
        """Give the socket back."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, text: str) -> None:
        if not self._path:
            return
        try:
            if self._socket is None:
                self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
                self._socket.setblocking(False)
            self._socket.sendto(text.encode(), self._path)
        except OSError:
            # A manager that does not take the word must not end the flight; its watchdog decides.
            self.close()


def _line(text: str) -> str:
    return " ".join(text.split())


def _watchdog_s(environment: Mapping[str, str]) -> float | None:
    """WATCHDOG_USEC, if it is meant for this process."""
    period = environment.get("WATCHDOG_USEC", "")
    process = environment.get("WATCHDOG_PID", "")
    if not period.isdigit() or int(period) == 0 or (process and process != str(os.getpid())):
        return None
    return int(period) / 1e6
