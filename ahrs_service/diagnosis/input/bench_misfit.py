"""The misfit on a rate table: an encoder gives rate and attitude, the reference point is at rest.

Rate and specific force of the reference are exact compared with the IMU's noise, so each channel is
compared by itself in body axes: white noise, a constant bias and a first-order Gauss-Markov wander
(IEEE Std 952, annex C). White noise has a size per axis, wander a size and time per triad.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from ahrs_service.diagnosis.input.diagnosis_input import Recorded
from ahrs_service.diagnosis.input.misfit import Grams, Noise
from ahrs_service.diagnosis.input.reference import (
    Reference,
    body_vectors,
    excursions,
    jumps,
    rotations,
)
from ahrs_service.diagnosis.input.reference_motion import (
    GRAVITY_NED,
    covariates,
    ends,
    scatter,
    slow_motion,
)
from ahrs_service.diagnosis.input.windows import means
from ahrs_service.diagnosis.noise_model.kalman import whiten_channel
from ahrs_service.effects.base import Addition
from ahrs_service.errors import DiagnosisError
from ahrs_service.records import Floats

_STEP_S: Final = 0.08  # A choice: Nyquist's frequency of the windows is 6.3 Hz, about MOTION_HZ
_MOST_ROWS: Final = 12000
"""A choice: bounds time and memory; beyond 16 min the windows become longer."""
_MOST_KNOWN: Final = 100
"""A choice: whitened channels cached before all are dropped: bounds the memory."""


class BenchResidual:
    """Window means of the IMU minus encoder and gravity; see input.misfit.Residual."""

    noise_names: Sequence[str] = (
        *(f"gyro_white_{axis}_rad_s" for axis in "xyz"),
        "gyro_wander_rad_s",
        "gyro_wander_s",
        *(f"accel_white_{axis}_m_s2" for axis in "xyz"),
        "accel_wander_m_s2",
        "accel_wander_s",
    )

    def __init__(self, recorded: Recorded, reference: Reference) -> None:
        if reference.rate_rad_s is None:
            raise DiagnosisError(f"{recorded.name}: no encoder rates to compare with")
        inside = (recorded.imu_time_s >= reference.time_s[0]) & (
            recorded.imu_time_s <= reference.time_s[-1]
        )
        time_s = recorded.imu_time_s[inside]
        rate = CubicSpline(reference.time_s, reference.rate_rad_s)(time_s)
        attitude = CubicSpline(reference.time_s, reference.ned_from_body)(time_s)
        attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
        force = body_vectors(attitude, np.broadcast_to(-GRAVITY_NED, rate.shape))
        self.columns = covariates(recorded, time_s, rate, force, attitude)
        self.reference_columns = self.columns
        step_s = (time_s[-1] - time_s[0]) / (len(time_s) - 1)
        window_s = max(_STEP_S, (time_s[-1] - time_s[0]) / _MOST_ROWS)
        self._window = max(1, round(window_s / step_s))
        self._step_s = self._window * step_s
        self.time_s = self._windows(time_s)
        readings = np.hstack([recorded.gyro_rad_s[inside], recorded.accel_m_s2[inside]])
        slow = slow_motion(time_s, readings, time_s)
        self.largest = np.abs(slow).max(axis=0)
        self.ends, self.ties = ends(readings)
        self.scatter = scatter(time_s, readings, slow, time_s)
        self.rows = self._windows(readings - np.hstack([rate, force]))
        self.body = self.rows
        self.nuisances = np.empty((*self.rows.shape, 0))
        self.missing = self._without_reference(reference, time_s)
        self.moved: Callable[[], None] = lambda: None

    def _windows(self, values: Floats) -> Floats:
        """Return the means of successive windows of the grid."""
        return means(values, self._window)

    def _without_reference(self, reference: Reference, time_s: Floats) -> Floats:
        """Return which windows [N] contain a jump or an excursion of the encoder."""
        assert reference.rate_rad_s is not None
        steps = np.diff(reference.time_s)[:, None]
        means = 0.5 * (reference.rate_rad_s[1:] + reference.rate_rad_s[:-1])
        apart = rotations(reference) - means * steps
        jumped = jumps(apart)
        bad = jumped | excursions(reference.time_s, apart, jumped)
        # The splines ring for some intervals around a jump.
        bad = np.convolve(bad, np.ones(9), mode="same") > 0.0
        at_imu = np.interp(time_s, reference.time_s[1:], bad.astype(np.float64))
        return (self._windows(at_imu) > 0.0).astype(np.float64)

    def project(self, addition: Addition) -> Floats:
        """Return what an addition [M, 3] on the grid adds to the windows [N, 6]."""
        self.moved()
        rows = np.zeros(self.rows.shape)
        if addition.gyro is not None:
            rows[:, :3] = self._windows(addition.gyro)
        if addition.accel is not None:
            rows[:, 3:] = self._windows(addition.accel)
        return rows

    def project_body(self, addition: Addition) -> Floats:
        """Return the same as `project`: the windows are in body axes."""
        return self.project(addition)

    def first_noise(self) -> Noise:
        """Return white noise from successive differences, a wander of 0.3 of it over 60 s."""
        here = self.rows[self.missing == 0.0]
        white = np.maximum(1.4826 * np.median(np.abs(np.diff(here, axis=0)), axis=0), 1e-12)
        white /= np.sqrt(2.0)
        values = [
            *white[:3],
            0.3 * white[:3].mean(),
            60.0,
            *white[3:],
            0.3 * white[3:].mean(),
            60.0,
        ]
        return np.log(values)

    def noise_bounds(self) -> list[tuple[float, float]]:
        """Return bounds about the guess: white noise 1/5 to 5, wander 1/300 to 1000; 15-1000 s."""
        first = self.first_noise()
        white = [(w - np.log(5.0), w + np.log(5.0)) for w in first]
        times = (np.log(15.0), np.log(1000.0))
        wanders = [(first[n] - np.log(300.0), first[n] + np.log(1e3)) for n in (3, 8)]
        return [*white[:3], wanders[0], times, *white[5:8], wanders[1], times]

    def choose(self, likelihood: Callable[[], float]) -> None:
        """Nothing to choose."""

    def _white_channel(self, values: Floats, channel: int, rows: Floats) -> tuple[Floats, Floats]:
        """Return one channel's rows [N, K] whitened by noise `values`, and log variances [N]."""
        first = 5 * (channel // 3)
        white, wander, time_s = values[[first + channel % 3, first + 3, first + 4]]
        out, log_variance = np.empty(rows.shape), np.empty(len(rows))
        keep = float(np.exp(-self._step_s / time_s))
        whiten_channel(rows, self.missing, white**2, wander**2, keep, out, log_variance)
        return out, log_variance

    def grams(self, rows: Floats) -> Grams:
        """Return the function from noise to the Gram matrix of `rows` [N, 6, K] whitened.

        Each channel is whitened separately, without columns that are zero there, and only when
        one of its parameters has changed.
        """
        used = [np.flatnonzero(np.any(rows[:, channel] != 0.0, axis=0)) for channel in range(6)]
        parts = [np.ascontiguousarray(rows[:, c, used[c]]) for c in range(6)]
        known: dict[tuple[int, float, float, float], tuple[Floats, float]] = {}

        def gram(noise: Noise) -> tuple[Floats, float]:
            self.moved()
            values, total, log_det = np.exp(noise), np.zeros(2 * rows.shape[2:]), 0.0
            if len(known) > _MOST_KNOWN:
                known.clear()
            for channel in range(6):
                first = 5 * (channel // 3)
                key = (channel, noise[first + channel % 3], noise[first + 3], noise[first + 4])
                if key not in known:
                    white, log_variance = self._white_channel(values, channel, parts[channel])
                    known[key] = (white.T @ white, float(log_variance.sum()))
                part, part_log_det = known[key]
                total[np.ix_(used[channel], used[channel])] += part
                log_det += part_log_det
            return total, log_det

        return gram

    def whiten(self, noise: Noise, rows: Floats) -> tuple[Floats, Floats]:
        """Return `rows` [N, 6, K] whitened, and the log variances [N, 6] of the innovations."""
        self.moved()
        values = np.exp(noise)
        out, log_variance = np.empty(rows.shape), np.empty(rows.shape[:2])
        for channel in range(6):
            part = np.ascontiguousarray(rows[:, channel])
            out[:, channel], log_variance[:, channel] = self._white_channel(values, channel, part)
        return out, log_variance
