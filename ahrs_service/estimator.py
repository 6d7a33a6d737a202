"""Intake and pipeline with their states: readings in, estimates out, one at a time or a million.

The live service and the replay both call `take`; which samples arrive in which call makes no
difference to a single byte of the estimates.
"""

import hashlib
from typing import Final

import numpy as np

from ahrs_service import intake, pipeline, rotation
from ahrs_service.fusion import alignment
from ahrs_service.fusion.ground_velocity import HISTORY
from ahrs_service.fusion.states import AIDED, GATED, UNAIDED
from ahrs_service.records import (
    ESTIMATE_DTYPE,
    READING_DTYPE,
    SAMPLE_DTYPE,
    ImuSource,
    Integers,
    Kind,
    Phase,
    Record,
    Rows,
    empty,
)
from ahrs_service.sensor.parameters import Calibration, coefficients
from ahrs_service.sensor.prior import narrow
from ahrs_service.settings import Settings
from ahrs_service.smoothing import Smoother

_STATE_MARK: Final = hashlib.sha256(
    repr((intake.STATE_DTYPE.descr, pipeline.STATE_DTYPE.descr)).encode()
).digest()[:8]
_STATES: Final = (0, GATED, UNAIDED, AIDED)
"""How many error states are in use: none before the first sample."""


class StateError(ValueError):
    """Saved state bytes that this version cannot take, or that are damaged."""


class Estimator:
    """The whole estimator, from readings to estimates.

    `digest` is the SHA-256 over the bytes of every estimate so far: equal digests of a live
    session and of its replay mean equal estimates, bit for bit. A `smoother` given listens and
    can smooth all estimates in the end; it changes none of them before. `calibration` is that in
    use.
    """

    def __init__(
        self,
        settings: Settings,
        calibration: Calibration | None = None,
        smoother: Smoother | None = None,
    ) -> None:
        self._smoother = smoother
        self._batch = pipeline.batch if smoother is None else smoother.batch
        self.calibration = calibration or Calibration.ideal()
        self._coefficients = coefficients(self.calibration)
        self._intake_state = intake.new_state()
        self._pipeline_state = pipeline.new_state()
        self.digest = hashlib.sha256()
        self._reserve(1)
        self.configure(settings)

    def configure(self, settings: Settings) -> None:
        """Take new settings from the next sample on."""
        self._settings = settings
        self._intake_parameters = intake.parameters(settings.intake)
        self._pipeline_parameters = narrow(pipeline.parameters(settings), self.calibration)

    def calibrate(self, calibration: Calibration) -> None:
        """Take another calibration from the next sample on; what was found of the sensor goes."""
        self.calibration = calibration
        self._coefficients = coefficients(calibration)
        self.configure(self._settings)
        settings = self._pipeline_parameters[0]
        airframe = int(settings["airframe"])
        if airframe < 0:
            vehicle = int(self._intake_state["vehicle"][0])
            airframe = int(self._intake_parameters["airframe_of_type"][0, vehicle])
        alignment.forget_sensors(settings, self._pipeline_state[0], airframe)
        if self._smoother is not None:
            self._smoother.cut()

    def _reserve(self, count: int) -> None:
        self._samples = empty(SAMPLE_DTYPE, count)
        self._estimates = empty(ESTIMATE_DTYPE, count)
        self._positions = np.zeros(count, np.int64)

    def take(self, readings: Rows) -> Rows:
        """Take `readings` [N] in order; return the estimates [M <= N], one per sample.

        The result is a view that the next call overwrites; `positions` tells for each estimate
        which reading it came of.
        """
        if len(readings) > len(self._samples):
            self._reserve(len(readings))
        count = intake.select(
            self._intake_parameters, self._intake_state, readings, self._samples, self._positions
        )
        estimates = self._estimates[:count]
        self._count = count
        if count:
            self._batch(
                self._pipeline_parameters,
                self._coefficients,
                self._pipeline_state,
                self._samples[:count],
                estimates,
            )
            # The buffer of a structured array describes every field anew at each use.
            self.digest.update(estimates.view(np.uint8).data)
        return estimates

    @property
    def positions(self) -> Integers:
        """Index of the reading behind each estimate of the last `take` [M]."""
        return self._positions[: self._count]

    @property
    def state(self) -> Rows:
        """The pipeline's state [1]: counters of gaps and jumps, bias, covariance."""
        return self._pipeline_state

    @property
    def intake_state(self) -> Rows:
        """The intake's state [1]: the adopted vehicle, the source in use, rates per source."""
        return self._intake_state

    def save(self) -> bytes:
        """Return both states as bytes."""
        return _STATE_MARK + self._intake_state.tobytes() + self._pipeline_state.tobytes()

    def restore(self, saved: bytes) -> None:
        """Continue from `save`; StateError if the bytes are of another version, cut or damaged."""
        expected = len(_STATE_MARK) + intake.STATE_DTYPE.itemsize + pipeline.STATE_DTYPE.itemsize
        if len(saved) != expected or not saved.startswith(_STATE_MARK):
            raise StateError(
                f"saved state has {len(saved)} bytes of another layout, this version needs "
                f"{expected}; start from the beginning of the recording instead"
            )
        cut = len(_STATE_MARK) + intake.STATE_DTYPE.itemsize
        intake_state = np.frombuffer(saved[len(_STATE_MARK) : cut], intake.STATE_DTYPE).copy()
        pipeline_state = np.frombuffer(saved[cut:], pipeline.STATE_DTYPE).copy()
        _check(intake_state[0], pipeline_state[0])
        self._intake_state, self._pipeline_state = intake_state, pipeline_state
        if self._smoother is not None:
            self._smoother.cut()


def _check(intake_state: Record, pipeline_state: Record) -> None:
    """Raise StateError for values by which the kernels index and count without a check.

    All else is checked by `alignment.is_sound` at the end of a turn; so that must come.
    """
    source, vehicle = int(intake_state["source"]), int(intake_state["vehicle"])
    phase, states = int(pipeline_state["phase"]), int(pipeline_state["states"])
    place, turn_s = int(pipeline_state["history_next"]), float(pipeline_state["turn_s"])
    known = source in list(ImuSource) and phase in list(Phase) and 0 <= vehicle <= 255
    if not (known and states in _STATES and 0 <= place < HISTORY and turn_s >= 0.0):
        raise StateError(
            f"saved state is damaged (IMU source {source}, vehicle {vehicle}, phase {phase}, "
            f"{states} error states, place {place} in the history, turn of {turn_s} s); "
            "start from the beginning of the recording instead"
        )


def compile_kernels(settings: Settings) -> None:
    """Run every kernel once, so that none compiles while a vehicle waits."""
    estimator = Estimator(settings)
    readings = empty(READING_DTYPE, 4)
    readings["kind"] = Kind.IMU
    readings["source"] = readings["system"] = readings["component"] = 1
    readings[0]["kind"] = Kind.HEARTBEAT
    readings["time_ns"] = np.arange(4) * 10_000_000
    readings["gyro_rad_s"] = 0.0
    readings["accel_m_s2"] = (0.0, 0.0, -9.8)
    estimator.take(readings)
    # What a new calibration, an ATTITUDE sent and one received call besides.
    estimator.calibrate(estimator.calibration)
    attitude = np.array([1.0, 0.0, 0.0, 0.0])
    rotation.to_euler(attitude, np.empty(3))
    rotation.from_euler(0.0, 0.0, 0.0, attitude)
