"""One recording through the estimator: the function that replay and fleet share."""

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from ahrs_service.adoption import Vehicle
from ahrs_service.app.files import calibration_file, config_file
from ahrs_service.app.files.calibration_choice import NONE, CalibrationStore
from ahrs_service.app.intake_choice import intake_of
from ahrs_service.app.replay.summary import Summary, summarise
from ahrs_service.errors import ConfigError, RecordingError, StateError
from ahrs_service.estimator import Estimator
from ahrs_service.links.logs.recording import Recording
from ahrs_service.links.logs.recording_formats import read_recording
from ahrs_service.links.logs.session_marks import Mark, MarkKind
from ahrs_service.records import ESTIMATE_DTYPE, Integers, Kind, Rows, empty
from ahrs_service.sensor.parameters import Calibration
from ahrs_service.settings import SensorSettings, Settings
from ahrs_service.smoothing import Smoother

Advance = Callable[[str, float], None]

_CHUNK: Final = 1 << 15


@dataclass(frozen=True, slots=True)
class ReplayResult:
    """A recording and what the estimator made of it.

    `estimates` [N] ESTIMATE_DTYPE, `positions` [N] the reading behind each; `vehicle` the one
    adopted; `settings` those in effect at the end. Where smoothing was requested, `estimates` are
    the smoothed. `is_calibrated` whether a calibration was in use at the end.
    """

    recording: Recording
    estimates: Rows
    positions: Integers
    vehicle: Vehicle
    settings: Settings
    summary: Summary
    is_calibrated: bool

    @property
    def system(self) -> int:
        """System number of the vehicle adopted."""
        return self.vehicle[0]


def replay_log(
    path: str | Path,
    settings: Settings | None = None,
    advance: Advance | None = None,
    sensor: SensorSettings | None = None,
    smooth: bool = False,
) -> ReplayResult:
    """Replay one recording; RecordingError gives the reason where it cannot be replayed.

    Without `settings` those carried by the recording are used, else the defaults; without a
    calibration named by `sensor` (else by `settings`) the recorded one, else none. `advance`
    is called with the current step and the share done, 0 to 1. Equal files, settings and
    calibrations give equal bytes, the same as the live session's where one was recorded.
    ConfigError where the calibration named cannot or must not be used.
    """
    report = advance or _silent
    recording = read_recording(path, lambda share: report("reading", share))
    return replay_recording(recording, settings, report, sensor, smooth)


def replay_recording(
    recording: Recording,
    settings: Settings | None = None,
    advance: Advance | None = None,
    sensor: SensorSettings | None = None,
    smooth: bool = False,
) -> ReplayResult:
    """Replay a recording that was read, as `replay_log` does."""
    report_progress = advance or _silent
    calibration, origin = _calibration(recording, settings, sensor)
    marks = _obeyed(recording, settings, calibration)
    smoother = Smoother() if smooth else None
    replay = _Replay(recording, settings, marks, calibration, smoother)
    replay.calibration = origin
    for share in replay.run():
        report_progress("estimating", share)
    estimates, positions = replay.columns()
    if not len(estimates):
        raise RecordingError(_no_sample(recording, replay.settings))
    smoothed = None
    if smoother is not None:
        report_progress("smoothing", 0.0)
        smoothed = estimates.copy()
        smoother.smooth(smoothed)
    report_progress("comparing", 0.0)
    summary = summarise(
        recording,
        replay.estimator,
        estimates,
        replay.settings.intake,
        replay.origin,
        replay.calibration,
        smoothed,
    )
    system, component = (int(replay.estimator.intake_state[n][0]) for n in ("system", "component"))
    if smoothed is not None:
        estimates = smoothed
    known = replay.estimator.calibration != Calibration.ideal()
    return ReplayResult(
        recording, estimates, positions, (system, component), replay.settings, summary, known
    )


def _silent(stage: str, share: float) -> None:
    del stage, share


def _obeyed(
    recording: Recording, settings: Settings | None, calibration: Calibration | None
) -> list[Mark]:
    """Return the marks to apply: those that no option replaces."""
    obeyed = {MarkKind.SETTINGS} if settings is None else set()
    obeyed |= {MarkKind.CALIBRATION} if calibration is None else set()
    # A state is valid only for the settings and the calibration under which it was made.
    obeyed |= {MarkKind.STATE} if len(obeyed) == 2 else set()
    return [mark for mark in recording.marks if mark.kind in obeyed]


def _calibration(
    recording: Recording, settings: Settings | None, sensor: SensorSettings | None
) -> tuple[Calibration | None, str]:
    """Return the requested calibration and its description; None where none is requested."""
    sensor = sensor or (settings or Settings()).sensor
    if sensor.calibration == NONE:
        return Calibration.ideal(), "none, as requested"
    store = CalibrationStore(sensor)
    intake = intake_of(recording, None if settings is None else settings.intake, "give --config")
    unit = recording.unit_of((intake.system, intake.component))
    choice = store.choose(unit)
    if choice is None:
        if store.is_folder:
            raise RecordingError(f"{recording.path}: {store.refusal(unit)}")
        return None, "none"
    warning = store.mismatch(unit)
    return choice.calibration, f"{choice.text()}; {warning}" if warning else choice.text()


class _Replay:
    """The run over the readings, in pieces that end at the recording's marks."""

    def __init__(
        self,
        recording: Recording,
        settings: Settings | None,
        marks: list[Mark],
        calibration: Calibration | None,
        smoother: Smoother | None,
    ) -> None:
        self.settings = settings or Settings()
        self.origin = "the defaults" if settings is None else "as given"
        self.calibration = "none"
        self.estimator = Estimator(self.settings, calibration, smoother)
        self._recording = recording
        self._marks = marks
        limit = int(np.count_nonzero(recording.readings["kind"] == Kind.IMU))
        self._estimates = empty(ESTIMATE_DTYPE, limit)
        self._positions = np.zeros(limit, np.int64)
        self._count = 0

    def run(self) -> Iterator[float]:
        """Process all readings; yield the share done."""
        readings = self._recording.readings
        start = 0
        stops = [(mark.reading, mark) for mark in self._marks]
        for stop, mark in [*stops, (len(readings), None)]:
            for first in range(start, stop, _CHUNK):
                last = min(first + _CHUNK, stop)
                estimates = self.estimator.take(readings[first:last])
                end = self._count + len(estimates)
                self._estimates[self._count : end] = estimates
                self._positions[self._count : end] = self.estimator.positions + first
                self._count = end
                yield last / len(readings)
            start = stop
            if mark is not None:
                self._obey(mark)

    def columns(self) -> tuple[Rows, Integers]:
        """Return all estimates and the reading behind each."""
        return self._estimates[: self._count], self._positions[: self._count]

    def _obey(self, mark: Mark) -> None:
        """Do what the live service did here: change settings, or continue from a saved state."""
        if mark.kind == MarkKind.STATE:
            try:
                self.estimator.restore(mark.data)
            except StateError as error:
                raise RecordingError(f"{self._recording.path}: {error}; or give --config") from None
            return
        if mark.kind == MarkKind.CALIBRATION:
            self._calibrate(mark.data)
            return
        try:
            self.settings = config_file.from_json(mark.data, str(self._recording.path))
        except ConfigError as error:
            raise RecordingError(
                f"the settings recorded cannot be used here ({error}); give --config"
            ) from None
        self.estimator.configure(self.settings)
        self.origin = "those of the recording"

    def _calibrate(self, data: bytes) -> None:
        """Use the calibration that the live service used from here on."""
        origin = str(self._recording.path)
        try:
            calibration = calibration_file.from_json(zlib.decompress(data), origin)
        except (ConfigError, zlib.error) as error:
            raise RecordingError(
                f"the calibration recorded cannot be used here ({error}); "
                "give --calibration FILE, or none"
            ) from None
        self.estimator.calibrate(calibration)
        self.calibration = f"that of the recording, serial {calibration.serial or 'not known'}"


def _no_sample(recording: Recording, settings: Settings) -> str:
    """Explain why no reading became a sample."""
    return (
        f"{recording.path}: none of its {len(recording.readings)} readings belongs to an IMU of "
        f"the vehicle looked for (intake.system = {settings.intake.system}, "
        f"intake.imu_source = {settings.intake.imu_source}) after its HEARTBEAT; "
        "change these with --set"
    )
