"""The live service: one event loop from the bytes of a link to the attitude sent back.

A frame that arrives is recorded, estimated and published inside one callback; everything else
(heartbeat, intervals, health, viewer figures) is done by a slow tick of the same loop, so that a
stuck loop is visible on the link as a missing heartbeat.
"""

import asyncio
import contextlib
import gc
import math
import os
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from ahrs_service.app.files import calibration_file, config_file
from ahrs_service.app.files.calibration_choice import CalibrationStore
from ahrs_service.app.live.observer import Observer
from ahrs_service.app.statistics import Session
from ahrs_service.estimator import Estimator, compile_kernels
from ahrs_service.health import Health, HealthMonitor
from ahrs_service.links.component.component import Component
from ahrs_service.links.logs import readings
from ahrs_service.links.logs.recorder import Recorder
from ahrs_service.links.logs.session_marks import MarkKind, is_mark, mark_messages
from ahrs_service.links.mavlink.codec import Decoder, Encoder
from ahrs_service.links.mavlink.signing import Signer, key_from_text
from ahrs_service.links.transport.link import LinkState, Peer
from ahrs_service.links.transport.registry import open_link
from ahrs_service.links.transport.service_notify import ServiceNotifier
from ahrs_service.records import READING_DTYPE, Phase, Record, Rows, empty
from ahrs_service.settings import Settings

TICK_S: Final = 0.05
_TICKS_PER_SECOND: Final = 20

_MAV_STATE: Final = {
    Health.NO_VEHICLE: "boot",
    Health.NO_IMU: "critical",
    Health.ALIGNING: "boot",
    Health.GOOD: "active",
    Health.DEGRADED: "active",
}

Log = Callable[[str, str], None]
"""Called with a level (`info`, `warning`, `error`) and a sentence."""


class Daemon:
    """The service on one link; `run` serves until `stop`.

    The constructor raises ConfigError for a calibration that cannot or must not be used.
    `on_reading` is given every reading [1] and `on_estimate` every estimate [1], views that the
    next one overwrites. `session`, `health`, `latest`, `component`, `calibration`, `decoder` and
    `link` can be read meanwhile;
    `forged_marks` counts frames that were kept out of the recording (links.logs.session_marks).
    """

    def __init__(
        self,
        settings: Settings,
        log: Log,
        on_estimate: Callable[[Rows], None] | None = None,
        on_reading: Callable[[Rows], None] | None = None,
    ) -> None:
        self.settings = settings
        self.session = Session()
        self.health = HealthMonitor()
        self._shelf = CalibrationStore(settings.sensor)
        self.calibration = self._shelf.choose("")
        known = None if self.calibration is None else self.calibration.calibration
        self.estimator = Estimator(settings, known)
        self.latest: Record | None = None
        self.recorder: Recorder | None = None
        self.observer: Observer | None = None
        self.component = Component(settings)
        self.forged_marks = 0
        self.link = open_link(settings.link.uri, self._on_bytes, self._on_link_state)
        self._signer = _make_signer(settings)
        self.decoder = Decoder(self._signer, datagrams=self.link.is_datagram)
        self._encoder: Encoder | None = None
        self._log = log
        self._on_estimate = on_estimate
        self._on_reading = on_reading
        self.ready = asyncio.Event()
        self._stop = asyncio.Event()
        self._started_s = time.monotonic()
        self._rows = empty(READING_DTYPE, 1)
        self._notifier = ServiceNotifier()
        self._ticks = 0
        self._unit = ""

    # -- life ---------------------------------------------------------------------------------

    async def run(self) -> None:
        """Serve until `stop` is called; every file is whole when this returns or raises."""
        compile_kernels(self.settings)
        self._open_outputs()
        self._tell_calibration()
        try:
            await self.link.start()
            self._notifier.ready(f"listening on {self.settings.link.uri}")
            # Start-up objects are never garbage; scanning them again would cost latency.
            gc.collect()
            gc.freeze()
            self.ready.set()
            await self._tick_until_stopped()
        finally:
            self._notifier.stopping()
            await self.link.close()
            self._close_outputs()
            gc.unfreeze()

    def stop(self) -> None:
        """End the session; may be called by a signal handler of the loop."""
        self._stop.set()

    def _open_outputs(self) -> None:
        recorder, viewer = self.settings.recorder, self.settings.viewer
        if self._signer is not None:
            self._signer.save()
            if self._signer.counts.state_failures:
                self._say("warning", f"{_signing_file()}: signing stamps cannot be saved there")
        if viewer.port or viewer.rrd:
            self.observer = Observer(self.settings)
            self._log("info", f"viewer: {self.observer.where}")
        if recorder.directory:
            self.recorder = Recorder(
                recorder.directory,
                recorder.rotate_mb,
                recorder.limit_mb,
                header=self._recording_header,
                on_note=self._on_recorder_note,
            )

    def _on_recorder_note(self, text: str) -> None:
        ended = self.recorder is not None and self.recorder.has_ended
        self._say("warning" if ended else "info", text)

    def _close_outputs(self) -> None:
        if self.recorder is not None:
            self.recorder.close()
        if self.observer is not None:
            self.observer.close()
        if self._signer is not None:
            self._signer.save()
        self._notifier.close()

    # -- the path of a frame ------------------------------------------------------------------

    def _on_bytes(self, data: bytes, received_us: int, peer: Peer) -> None:
        started_s = time.perf_counter()
        for message, frame in self.decoder.feed(data):
            self._take(message, frame, received_us, peer, started_s)

    def _take(
        self, message: Any, frame: bytes, received_us: int, peer: Peer, started_s: float
    ) -> None:
        """Record, estimate and publish, then let the component answer."""
        if is_mark(message):
            self.forged_marks += 1
        elif self.recorder is not None:
            self.recorder.write(received_us, frame)
        if readings.from_message(message, received_us * 1000, self._rows):
            if self._on_reading is not None:
                self._on_reading(self._rows)
            estimates = self.estimator.take(self._rows)
            if len(estimates):
                self._use(estimates, started_s)
        now_s = time.monotonic()
        for reply in self.component.on_message(message, now_s):
            self.send(reply)
        if self.component.is_vehicle(message):
            self.link.confirm(peer)
            if self.observer is not None:
                self.observer.message(message)
        self._take_new_settings()
        if self.component.unit != self._unit:
            self._unit = self.component.unit
            self._take_unit()

    def _use(self, estimates: Rows, started_s: float) -> None:
        """Publish one estimate and notify the observers."""
        estimate = estimates[0]
        # Comparing numpy's number with an enum costs more than the filter's step.
        if int(estimate["phase"]) == Phase.RUNNING:
            sent = 0
            for message in self.component.publish(estimate):
                sent += self.send(message)
            if sent:
                self.session.latency.add(time.perf_counter() - started_s)
                self.session.published += sent
                if math.isnan(self.session.first_attitude_s):
                    self.session.first_attitude_s = time.monotonic() - self._started_s
        self.session.estimates += 1
        self.session.gates.add(estimate)
        self.health.sample(estimate, time.monotonic())
        self.latest = estimate
        if self.observer is not None:
            self.observer.estimate(estimates, self._rows if self.calibration else None)
        if self._on_estimate is not None:
            self._on_estimate(estimates)

    def send(self, message: Any) -> bool:
        """Pack and send one message; the system is known from the adoption on."""
        if self._encoder is None:
            self._encoder = Encoder(
                self.component.system, self.settings.link.component, self._signer
            )
        sent = self.link.send(self._encoder.pack(message))
        self.session.not_sent += not sent
        return sent

    def _on_link_state(self, state: LinkState, why: str) -> None:
        self._say("warning" if state is LinkState.DOWN else "info", why)
        if state is LinkState.UP:
            # Half a frame of the lost connection must not meet the first bytes of the new one.
            self.decoder.restart()

    # -- settings that change in flight -------------------------------------------------------

    def _take_new_settings(self) -> None:
        """Apply a PARAM_SET that the component accepted, and record it."""
        settings = self.component.settings
        if settings is self.settings:
            return
        self.settings = settings
        self.estimator.configure(settings)
        if self.observer is not None:
            self.observer.configure(settings)
        if self.recorder is not None:
            for frame in self._mark(MarkKind.SETTINGS, config_file.to_json(settings)):
                self.recorder.write(self.recorder.last_stamp_us, frame)

    # -- the calibration ----------------------------------------------------------------------

    def _tell_calibration(self) -> None:
        for note in self._shelf.notes:
            self._say("warning", note)
        if self.calibration is not None:
            self._say("info", self.calibration.text())
        elif self._shelf.is_folder:
            self._say("info", "calibration: waiting for the autopilot to report its unit")

    def _take_unit(self) -> None:
        """Apply the calibration of the unit that the autopilot reported."""
        if self.calibration is None and not self._shelf.is_folder:
            return
        warning, choice = self._shelf.mismatch(self._unit), self._shelf.choose(self._unit)
        if choice is None:
            warning = self._shelf.refusal(self._unit)
        elif choice != self.calibration:
            self.calibration = choice
            self.estimator.calibrate(choice.calibration)
            if self.recorder is not None:
                for frame in self._calibration_marks():
                    self.recorder.write(self.recorder.last_stamp_us, frame)
            self._say("info", choice.text())
        if warning:
            self._say("warning", warning)
        used = "none for this unit" if choice is None else choice.calibration.serial
        self.component.announce(f"calibration: {used}", not warning, time.monotonic())

    def _calibration_marks(self) -> list[bytes]:
        if self.calibration is None:
            return []
        data = calibration_file.to_json(self.calibration.calibration)
        return self._mark(MarkKind.CALIBRATION, zlib.compress(data))

    def _mark(self, kind: MarkKind, data: bytes) -> list[bytes]:
        encoder = Encoder(self.component.system or 1, self.settings.link.component)
        return [encoder.pack(message) for message in mark_messages(kind, data)]

    def _recording_header(self) -> list[bytes]:
        """Frames that begin every file: settings, calibration and, in mid-session, the state."""
        frames = self._mark(MarkKind.SETTINGS, config_file.to_json(self.settings))
        frames += self._calibration_marks()
        if self.session.estimates or self.component.system:
            frames += self._mark(MarkKind.STATE, self.estimator.save())
        return frames

    # -- the tick -----------------------------------------------------------------------------

    async def _tick_until_stopped(self) -> None:
        while not self._stop.is_set():
            self._tick(time.monotonic())
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._stop.wait(), TICK_S)

    def _tick(self, now_s: float) -> None:
        """Do the work that is due by time, not triggered by a message."""
        for message in self.component.tick(now_s, _MAV_STATE[self.health.state]):
            self.send(message)
        for level, text in self.component.drain_events():
            self._say(level, text)
        change = self.health.update(self.component.system != 0, now_s)
        if change:
            good = self.health.state in (Health.GOOD, Health.ALIGNING)
            self._say("info" if good else "warning", f"health: {change}")
            self.component.announce(change, good, now_s)
        self._ticks += 1
        if self._ticks % _TICKS_PER_SECOND == 0:
            self._each_second()

    def _each_second(self) -> None:
        if not self.component.system and self.link.calls_first:
            self._call()
        self._notifier.watchdog()
        self._notifier.status(f"{self.health.state.value}, {self.session.estimates} samples")
        if self.recorder is not None:
            self.recorder.flush()
        if self.observer is not None:
            rates = {rate.name: rate.measured_hz for rate in self.component.rates()}
            self.observer.figures(rates, self.drops())

    def _call(self) -> None:
        """Announce ourselves to a listener, as a component of the system that we expect there."""
        system = self.settings.link.system or self.settings.intake.system or 1
        encoder = Encoder(system, self.settings.link.component, self._signer)
        self.link.send(encoder.pack(self.component.call()))

    def drops(self) -> dict[str, int]:
        """Return the counts of everything lost so far, by kind."""
        counts = self.decoder.counts
        lost = {name: count for name, count in counts.items() if name != "frames"}
        lost["forged_marks"] = self.forged_marks
        lost["not_sent"] = self.session.not_sent
        if self.recorder is not None:
            lost["not_recorded"] = self.recorder.counts.dropped
        if self.observer is not None:
            lost["not_shown"] = self.observer.dropped
        return lost

    def _say(self, level: str, text: str) -> None:
        self._log(level, text)
        if self.observer is not None:
            self.observer.log(level, text)


def _make_signer(settings: Settings) -> Signer | None:
    link = settings.link
    if not link.signing_key:
        return None
    return Signer(key_from_text(link.signing_key), link.signing_link, _signing_file())


def _signing_file() -> Path:
    """Return the file of the signing stamps; saved stamps are never reused after a restart."""
    home = os.environ.get("STATE_DIRECTORY") or os.environ.get("XDG_STATE_HOME")
    folder = Path(home) if home else Path.home() / ".local" / "state"
    path = folder / "ahrs-service" / "signing.json"
    # Where this fails, so does writing the file, which is reported when the service starts.
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
    return path
