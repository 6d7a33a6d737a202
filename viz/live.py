"""The live stream: hosted on loopback for any viewer that comes, and written to a file.

The estimator's path only appends bytes to a bounded queue; a thread of this module does the rest,
so that no viewer, slow disk or full queue ever holds up an estimate. `rerun` is imported in that
thread, which keeps its seconds of imports off the start of the service.
"""

import os
import socket
import threading
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from ahrs_service.errors import ViewerError
from ahrs_service.records import ESTIMATE_DTYPE, Rows
from ahrs_service.settings import GateSettings

if TYPE_CHECKING:
    import rerun as rr

    from ahrs_service.viz.rerun_columns import Columns

HOST: Final = "127.0.0.1"
_DRAIN_S: Final = 10.0
_SHOWN_DTYPE: Final = np.dtype([("estimate", ESTIMATE_DTYPE), ("raw", "f8", 6)])
_NOT_SHOWN: Final = np.full(6, np.nan).tobytes()


class LiveViewer:
    """Streams estimates to whoever attaches to `rerun+http://127.0.0.1:PORT/proxy`.

    `port` 0 hosts nothing, an empty `rrd` writes no file. `memory_mb` bounds what a viewer that
    comes late is reported, `queue` the rows that wait for the thread, `period_s` is how often it
    sends. `dropped` counts rows and values that found the queue full; `error` is the last thing
    that went wrong in the thread, or empty; `gate` are the limits as they are now. `shows_sensor`
    makes room for raw values next to compensated ones.
    """

    def __init__(
        self,
        port: int = 9876,
        rrd: str | Path = "",
        memory_mb: float = 200.0,
        period_s: float = 0.1,
        gate: GateSettings | None = None,
        shows_sensor: bool = False,
        queue: int = 8192,
    ) -> None:
        self.port = port
        self.rrd = str(rrd)
        self.gate = gate or GateSettings()
        self.dropped = 0
        self.error = ""
        self.ready = threading.Event()
        self._shows_sensor = shows_sensor
        self._memory_mb = memory_mb
        self._period_s = period_s
        self._rows: deque[bytes] = deque(maxlen=queue)
        self._references: deque[tuple[int, tuple[float, ...]]] = deque(maxlen=queue)
        self._temperatures: deque[tuple[str, int, float]] = deque(maxlen=queue)
        self._values: deque[tuple[str, dict[str, float]]] = deque(maxlen=queue)
        self._lines: deque[tuple[str, str]] = deque(maxlen=queue)
        self._shown_drops = -1
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)

    @property
    def uri(self) -> str:
        """What a viewer connects to: `rerun --connect URI`."""
        return f"rerun+http://{HOST}:{self.port}/proxy" if self.port else ""

    def start(self) -> None:
        """Check port and file, then start the thread; `ready` is set once it streams."""
        if self.port:
            _check_port(self.port)
        if self.rrd:
            try:
                Path(self.rrd).open("wb").close()
            except OSError as error:
                raise ViewerError(
                    f"viewer: cannot write {self.rrd}: {error.strerror}; name another file"
                ) from error
        self._thread.start()

    def estimate(self, rows: Rows, readings: Rows | None = None) -> None:
        """Take a copy of ESTIMATE rows, mostly one; never blocks.

        `readings` [N] are those behind the estimates, to plot next to them.
        """
        for n in range(len(rows)):
            raw = _NOT_SHOWN
            if readings is not None:
                raw = readings["gyro_rad_s"][n].tobytes() + readings["accel_m_s2"][n].tobytes()
            self._append(self._rows, rows[n].tobytes() + raw)

    def reference(self, time_ns: int, ned_from_body: npt.ArrayLike) -> None:
        """Take the autopilot's own attitude, w, x, y, z, on the clock of the samples."""
        w, x, y, z = np.asarray(ned_from_body, np.float64)
        self._append(self._references, (int(time_ns), (float(w), float(x), float(y), float(z))))

    def temperature(self, site: str, time_ns: int, degc: float) -> None:
        """Take the temperature [degC] of one site."""
        self._append(self._temperatures, (site, int(time_ns), float(degc)))

    def rates(self, hertz: Mapping[str, float]) -> None:
        """Take rates [Hz] by name of message, as of now."""
        self._append(self._values, ("rate", dict(hertz)))

    def drops(self, counts: Mapping[str, float]) -> None:
        """Take how many of each thing were lost so far, as of now."""
        self._append(self._values, ("drops", dict(counts)))

    def log(self, level: str, text: str) -> None:
        """Take a line of the log; levels are those of rerun: INFO, WARN, ERROR."""
        self._append(self._lines, (level, text))

    def close(self) -> None:
        """Send what waits, end the stream, and leave the file whole."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(_DRAIN_S)

    def _append(self, queue: deque[Any], item: Any) -> None:
        if len(queue) == queue.maxlen:
            self.dropped += 1
        queue.append(item)

    def _run(self) -> None:
        try:
            recording, columns = self._open()
        except Exception as error:
            self.error = f"viewer: {error}"
            return
        self.ready.set()
        stopping = False
        while not stopping:
            stopping = self._stop.wait(self._period_s)
            self._guarded(self._send, columns)
        self._guarded(recording.flush, timeout_sec=_DRAIN_S / 2.0)
        self._guarded(recording.disconnect)

    def _guarded(self, act: Callable[..., None], *values: Any, **named: Any) -> None:
        """Report any failure by `error`; the service itself goes on."""
        try:
            act(*values, **named)
        except Exception as error:
            self.error = f"viewer: {error}"

    def _open(self) -> "tuple[rr.RecordingStream, Columns]":
        # Else rerun warns on the terminal that a file for streaming has no footer.
        os.environ.setdefault("RUST_LOG", "warn,re_log_encoding=error")
        import rerun as rr  # noqa: PLC0415

        from ahrs_service.viz import entities  # noqa: PLC0415
        from ahrs_service.viz.blueprint import blueprint  # noqa: PLC0415
        from ahrs_service.viz.rerun_columns import Columns  # noqa: PLC0415
        from ahrs_service.viz.scene import send_scene  # noqa: PLC0415

        sinks: list[Any] = []
        if self.port:
            limit = f"{self._memory_mb:.0f}MB"
            sinks.append(rr.GrpcServerSink(HOST, self.port, server_memory_limit=limit))
        if self.rrd:
            sinks.append(rr.FileSink(self.rrd, write_footer=False))
        recording = rr.RecordingStream(entities.APPLICATION)
        recording.set_sinks(*sinks, default_blueprint=blueprint(True, self._shows_sensor))
        send_scene(recording)
        return recording, Columns(recording, self.gate)

    def _send(self, columns: "Columns") -> None:
        columns.gate = self.gate
        shown = np.frombuffer(b"".join(_taken(self._rows)), _SHOWN_DTYPE)
        # Each column in one piece, as the viewer's own arrays must be.
        columns.estimates(np.ascontiguousarray(shown["estimate"]), shown["raw"].copy())
        clock = columns.clock
        if references := _taken(self._references):
            t = clock.live(np.array([time_ns for time_ns, _ in references], np.int64))
            columns.reference("autopilot", t, np.array([attitude for _, attitude in references]))
        sites: dict[str, list[tuple[int, float]]] = {}
        for site, time_ns, degc in _taken(self._temperatures):
            sites.setdefault(site, []).append((time_ns, degc))
        for site, readings in sites.items():
            t = clock.live(np.array([time_ns for time_ns, _ in readings], np.int64))
            columns.temperature(site, t, np.array([degc for _, degc in readings]))
        now = np.array([clock.now_ns])
        for kind, values in _taken(self._values):
            send = columns.rate if kind == "rate" else columns.drops
            for name, value in values.items():
                send(name, now, np.array([value]))
        if self.dropped != self._shown_drops:
            self._shown_drops = self.dropped
            columns.drops("viewer", now, np.array([float(self.dropped)]))
        lines = _taken(self._lines)
        columns.messages(
            np.full(len(lines), clock.now_ns),
            [level for level, _ in lines],
            [text for _, text in lines],
        )


def _taken(queue: deque[Any]) -> list[Any]:
    return [queue.popleft() for _ in range(len(queue))]


def _check_port(port: int) -> None:
    """Rerun itself only logs an error when its port is taken."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise ViewerError(
                f"viewer: port {port} on {HOST} cannot be used: {error.strerror}; "
                "end what listens there or set another viewer port (0 is off)"
            ) from error
