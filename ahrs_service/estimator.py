"""Intake and pipeline with their states: readings in, estimates out, one at a time or a million.

The live service and the replay both call `take`; which samples arrive in which call makes no
difference to a single byte of the estimates.
"""

import hashlib
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from ahrs_service import intake, pipeline, rotation
from ahrs_service.errors import InvalidValueError, StateError
from ahrs_service.fusion import alignment
from ahrs_service.fusion.ground_velocity import HISTORY
from ahrs_service.fusion.states import AIDED, GATED, UNAIDED
from ahrs_service.records import (
    ESTIMATE_DTYPE,
    READING_DTYPE,
    SAMPLE_DTYPE,
    Floats,
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
_LONGEST_S: Final = 9e9
"""Times in ns are int64: 292 years, and then some margin [s]."""


class Estimator:
    """The whole estimator, from readings or samples to estimates.

    `take` is fed with readings of a link or a log, `run` with samples of one sensor as records,
    `update` with one sample as plain numbers. `digest` is the SHA-256 over the bytes of every
    estimate so far: equal digests of a live session and of its replay mean equal estimates, bit
    for bit. A `smoother` given listens and can smooth all estimates in the end; it changes none of
    them before. `calibration` is that in use.

    A live loop, here of a sensor that lies still; without `settings` the defaults hold:

    >>> from ahrs_service import Estimator
    >>> estimator = Estimator()
    >>> for n in range(200):
    ...     estimate = estimator.update(0.01 * n, gyr=(0.0, 0.0, 0.0), acc=(0.0, 0.0, -9.81))
    >>> estimate["ned_from_body"].round(3)
    array([1., 0., 0., 0.])

    A link or a log, in pieces of any size:

    >>> from ahrs_service import read_recording
    >>> readings = read_recording("flight.tlog").readings
    >>> estimator, count = Estimator(), 0
    >>> for first in range(0, len(readings), 100):
    ...     count += len(estimator.take(readings[first : first + 100]))
    >>> count > 100
    True
    """

    def __init__(
        self,
        settings: Settings | None = None,
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
        self.configure(settings or Settings())

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

        The result is a view that the next call overwrites; `positions` gives for each estimate
        which reading it came of.
        """
        readings = _as_kernels_take_it(readings, READING_DTYPE)
        if len(readings) > len(self._samples):
            self._reserve(len(readings))
        count = intake.select(
            self._intake_parameters, self._intake_state, readings, self._samples, self._positions
        )
        estimates = self._estimates[:count]
        self._count = count
        if count:
            self._fill(self._samples[:count], estimates)
        return estimates

    def run(self, samples: Rows) -> Rows:
        """Take `samples` [N] SAMPLE_DTYPE of one sensor in order; return their estimates [N].

        The result is the caller's. Which samples come in which call changes no byte.

        >>> from ahrs_service import Estimator
        >>> from ahrs_service.records import SAMPLE_DTYPE, empty
        >>> samples = empty(SAMPLE_DTYPE, 300)
        >>> samples["time_ns"] = samples["received_ns"] = range(0, 300 * 10**7, 10**7)
        >>> samples["gyro_rad_s"] = 0.0
        >>> samples["accel_m_s2"] = (0.0, 0.0, -9.81)
        >>> Estimator().run(samples)["attitude_sigma_rad"].shape
        (300, 3)
        """
        samples = _as_kernels_take_it(samples, SAMPLE_DTYPE)
        estimates = empty(ESTIMATE_DTYPE, len(samples))
        if len(samples):
            self._fill(samples, estimates)
        return estimates

    def update(
        self,
        t: float,
        gyr: Sequence[float] | Floats,
        acc: Sequence[float] | Floats,
        mag: Sequence[float] | Floats | None = None,
        *,
        airspeed: float = math.nan,
        velocity_ned: Sequence[float] | Floats | None = None,
        temperature_degc: float = math.nan,
    ) -> Record:
        """Take one sample of a sensor; return its estimate, a row of ESTIMATE_DTYPE.

        `t` [s] on a clock that runs on; `gyr` [3] rad/s, `acc` [3] m/s^2 (specific force), `mag`
        [3] uT, all forward, right, down; `airspeed` m/s, `velocity_ned` [3] m/s and the sensor's
        `temperature_degc`, where there are new ones.
        """
        if not 0.0 <= t <= _LONGEST_S:
            raise InvalidValueError(f"t = {t}: give seconds from 0 to {_LONGEST_S:g}")
        sample = empty(SAMPLE_DTYPE)
        sample["time_ns"] = sample["received_ns"] = round(t * 1e9)
        sample["source"] = ImuSource.HIGHRES_IMU
        sample["airspeed_m_s"], sample["temperature_degc"] = airspeed, temperature_degc
        for name, field, vector in (
            ("gyr", "gyro_rad_s", gyr),
            ("acc", "accel_m_s2", acc),
            ("mag", "mag_ut", mag),
            ("velocity_ned", "velocity_ned_m_s", velocity_ned),
        ):
            if vector is not None:
                sample[field] = _vector(name, vector)
        return self.run(sample)[0]

    def _fill(self, samples: Rows, estimates: Rows) -> None:
        """Estimate `samples` [N > 0] into `estimates` [N]."""
        self._batch(
            self._pipeline_parameters, self._coefficients, self._pipeline_state, samples, estimates
        )
        # The buffer of a structured array describes every field anew at each use.
        self.digest.update(estimates.view(np.uint8).data)

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


def _as_kernels_take_it(rows: Rows, dtype: np.dtype[Any]) -> Rows:
    """Return `rows` [N] of `dtype`, copied where their layout would compile all kernels anew."""
    if rows.dtype != dtype or rows.ndim != 1:
        known = "READING_DTYPE" if dtype == READING_DTYPE else "SAMPLE_DTYPE"
        raise InvalidValueError(
            f"an array {list(rows.shape)} of {rows.dtype} is given; give rows [N] of "
            f"ahrs_service.records.{known}"
        )
    return rows if rows.flags.c_contiguous and rows.flags.writeable else rows.copy()


def _vector(name: str, value: Sequence[float] | Floats) -> Floats:
    vector = np.asarray(value, np.float64)
    if vector.shape != (3,):
        raise InvalidValueError(f"{name} has shape {vector.shape}; give x, y and z")
    return vector


def _check(intake_state: Record, pipeline_state: Record) -> None:
    """Raise StateError for values by which the kernels index and count without a check.

    All else is checked by `alignment.is_sound` at the end of an update; so that must come.
    """
    source, vehicle = int(intake_state["source"]), int(intake_state["vehicle"])
    phase, states = int(pipeline_state["phase"]), int(pipeline_state["states"])
    place, update_s = int(pipeline_state["history_next"]), float(pipeline_state["update_s"])
    known = source in list(ImuSource) and phase in list(Phase) and 0 <= vehicle <= 255
    if not (known and states in _STATES and 0 <= place < HISTORY and update_s >= 0.0):
        raise StateError(
            f"saved state is damaged (IMU source {source}, vehicle {vehicle}, phase {phase}, "
            f"{states} error states, place {place} in the history, update of {update_s} s); "
            "start from the beginning of the recording instead"
        )


def smooth(settings: Settings, calibration: Calibration, samples: Rows) -> tuple[Rows, Rows]:
    """Return the estimates of `samples` [N], causal and smoothed, each [N] ESTIMATE_DTYPE."""
    both = Smoother()
    causal = Estimator(settings, calibration, both).run(samples)
    smoothed = causal.copy()
    both.smooth(smoothed)
    return causal, smoothed


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
