"""The misfit in flight: an INS gives attitude and velocity with their own errors.

Compared are angle and velocity integrated from the start, in earth axes, because there the
reference's errors are stationary: first-order Gauss-Markov plus white. Its attitude error e also
tilts the specific force and enters the velocity as e x f. Noise, wander and effects of the IMU
are integrated with the attitude (noise_model.flight_filter).
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from ahrs_service.diagnosis.input.diagnosis_input import Recorded
from ahrs_service.diagnosis.input.misfit import Grams, Noise
from ahrs_service.diagnosis.input.preintegrated_misfit import Preintegrated, preintegrated
from ahrs_service.diagnosis.input.reference import Reference, excursions, jumps
from ahrs_service.diagnosis.input.reference_motion import (
    GRAVITY_NED,
    covariates,
    density,
    ends,
    motion_of_reference,
    moving,
    scatter,
    slow_motion,
)
from ahrs_service.diagnosis.input.sparse_velocity import Instants, instants_on
from ahrs_service.diagnosis.input.windows import integral_means, means
from ahrs_service.diagnosis.noise_model.flight_filter import STATES, flight_gains, whiten_flight
from ahrs_service.effects.base import Addition
from ahrs_service.records import Floats
from ahrs_service.rotation import inverse_columns, rotate_columns

_STEP_S: Final = 0.1  # A choice: Nyquist's frequency of the windows is 5 Hz, near MOTION_HZ
_MOST_ROWS: Final = 8000
"""A choice: bounds time and memory; beyond 13 min the windows become longer."""
_UNKNOWN_ANGLE: Final = 1.0
"""Variance [rad^2]: 1 rad is 1400 times the first guess of the reference's error: unknown."""
_UNKNOWN_SPEED: Final = 100.0
"""Variance [m^2/s^2]: 10 m/s is 330 times the first guess of the reference's error: unknown."""
_SIZES: Final = 50.0
"""A choice: a fitted noise is within this factor of its first guess, two sigma of its prior."""
_WANDERS: Final = 1000.0  # A choice: the same for a wander, whose first guess is the least certain
_LONGEST_ERROR: Final = float(np.log(60.0))
"""An INS corrects its tilt and velocity from its observations within tens of seconds; a longer
error is not a random error of the INS. Over real flights four attitudes have correlation times of
5 to 36 s and two of 84 and 107 s, for which this bound costs 1.5 nats at most; a bound of 20 s
would cost 18 (tests/benchmarks/reference_errors.py)."""
_TIMES: Final = 30.0  # A choice: the same for the lower bound of the reference's correlation times
_GYRO, _ACCEL = slice(0, 3), slice(3, 6)
_USUAL_DENSITIES: Final = (7e-5, 1e-3)
"""ICM-20602 data sheet: 0.004 deg/s and 100 ug per sqrt(Hz)."""
_FILTERS_KEPT: Final = 3
"""Gains cached for the last noises, 9 MB each: the same noise is used many times in a row."""
_QUIETEST: Final = 0.3
"""Least share of the usual density: no MEMS sensor is quieter, but a simulator's may be."""
_MEASURED: Final = float(np.log(1.3))
"""The density is measured in the IMU's spectrum; the reference's error would hide it."""
_SLOW: Final = (float(np.log(15.0)), float(np.log(3000.0)))
"""Wander is slow: what changes within seconds is due to motion and must be explained by it."""

_Path = tuple[Floats, Floats, Floats, Floats]
_Filter = tuple[tuple[*_Path, Floats, Floats, Floats, Floats], Floats]


class FlightResidual:
    """Angle and velocity integrated from the IMU minus the reference's; see misfit.Residual."""

    noise_names: Sequence[str] = (
        "reference_attitude_rad",
        "reference_attitude_s",
        "reference_attitude_white_rad",
        "gyro_density_rad_s_hz",
        "gyro_wander_rad_s",
        "gyro_wander_s",
        "reference_velocity_m_s",
        "reference_velocity_s",
        "reference_velocity_white_m_s",
        "accel_density_m_s2_hz",
        "accel_wander_m_s2",
        "accel_wander_s",
        "angle_white_per_vibration_s2_m",
        "velocity_white_per_vibration_s",
        "reference_jitter_s",
    )

    def __init__(self, recorded: Recorded, reference: Reference) -> None:
        grid_s = reference.time_s
        length_s = grid_s[-1] - grid_s[0]
        window_s = max(_STEP_S, length_s / _MOST_ROWS)
        self._window = max(1, round(window_s * (len(grid_s) - 1) / length_s))
        path = preintegrated(recorded, reference)
        self._parts, self._q = path.parts, path.ned_from_body
        axes = [
            rotate_columns(self._q, np.broadcast_to(axis, (len(self._q), 3))) for axis in np.eye(3)
        ]
        self._axes = np.ascontiguousarray(np.stack(axes, axis=2))
        self._fine_s = np.diff(path.time_s)
        increments = path.misfit
        judged = increments[:, :3] if len(path.velocity) else increments
        jumped = jumps(judged) | path.is_broken
        away = jumped | excursions(grid_s, increments, jumped, reference.ned_from_body[1:])
        increments[jumped] = 0.0
        self.rows = self._windows(_sum(increments))
        self.time_s = self._windows(grid_s)
        self._steps_s = np.diff(self.time_s, prepend=2.0 * self.time_s[0] - self.time_s[1])
        self.missing = (self._windows(np.append(False, away).astype(float)) > 0.0).astype(float)
        self._begins = (self._windows(np.append(False, jumped).astype(float)) > 0.0).astype(float)
        # Integrals over a span with a wrong attitude are invalid: restart after it.
        self._begins[1:] = np.maximum(self._begins[1:], self.missing[:-1])
        self._instants: Instants | None = None
        self._unseen = np.zeros(self.rows.shape, np.bool_)
        if len(path.velocity):
            self._measure(path)
        self._rotation, self._tilt, self._path = self._paths(path.speeds)
        self._is_error_in_body = True
        self.moved: Callable[[], None] = lambda: None
        self._filters: dict[tuple[bytes, bool], _Filter] = {}
        imu_s, readings = recorded.imu_time_s, np.hstack([recorded.gyro_rad_s, recorded.accel_m_s2])
        slow = slow_motion(imu_s, readings, path.time_s)
        self.largest = np.abs(slow).max(axis=0)
        self.ends, self.ties = ends(readings)
        self.scatter = scatter(imu_s, readings, slow_motion(imu_s, readings, imu_s), path.time_s)
        self._densities = [density(imu_s, readings[:, part]) for part in (_GYRO, _ACCEL)]
        motion = slow - self._mean_bias(reference, increments, away)
        changes = self._in_earth(motion)
        self._changes = np.abs(self._windows(changes[:: self._parts]))
        self.nuisances = self._lateness(path.time_s, changes[:, _ACCEL])
        read = covariates(recorded, path.time_s, motion[:, _GYRO], motion[:, _ACCEL], self._q)
        shaking = np.where(np.isfinite(read.vibration_m_s2), read.vibration_m_s2, 0.0)
        self._vibration = self._windows(shaking[:: self._parts])[:, None]
        self.reference_columns = motion_of_reference(reference, read)
        self.columns = moving(read, self.reference_columns)
        self.body = self._in_body(reference, increments)

    def _measure(self, path: Preintegrated) -> None:
        """Put the misfit of a sparse velocity into the rows nearest to its instants.

        Interpolated, it would be smooth and autocorrelated.
        """
        instants = instants_on(self.time_s, path.time_s, path.velocity.time_s)
        increments = np.diff(path.velocity.values[instants.taken], axis=0)
        jumped = jumps(increments)
        increments[jumped] = 0.0
        self.rows[:, _ACCEL] = instants.put(_sum(increments))
        self._begins[instants.rows[1:][jumped]] = 1.0
        self._unseen[:, _ACCEL] = True
        self._unseen[instants.rows, _ACCEL] = False
        self._instants = instants

    def _windows(self, values: Floats) -> Floats:
        """Return the means of successive windows of the references."""
        return means(values, self._window)

    def _paths(self, speeds: Floats) -> tuple[Floats, Floats, Floats]:
        """Return mean rotation and integrated -[f x] of the step to each row; rotation there."""
        path = self._windows(self._axes[:: self._parts])
        rotation_of_step = path.copy()
        rotation_of_step[1:] = 0.5 * (path[1:] + path[:-1])
        speed = self._windows(_sum(speeds))
        x, y, z = np.diff(speed, axis=0, prepend=speed[:1]).T
        zero = np.zeros(len(x))
        cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
        return rotation_of_step, -cross, path

    def _mean_bias(
        self, reference: Reference, increments: Floats, away: npt.NDArray[np.bool_]
    ) -> Floats:
        """Return the mean misfit [6] in body axes [rad/s, m/s^2]."""
        good = ~away
        q = inverse_columns(reference.ned_from_body[:-1][good])
        angle = rotate_columns(q, increments[good, :3]).sum(axis=0)
        speed = rotate_columns(q, increments[good, 3:]).sum(axis=0)
        length_s = np.diff(reference.time_s)[good].sum()
        return np.asarray(np.concatenate([angle, speed]) / length_s)

    def _in_earth(self, motion: Floats) -> Floats:
        """Return the rates of change of angle and velocity [M, 6] in earth axes."""
        turning = rotate_columns(self._q, motion[:, _GYRO])
        acceleration = rotate_columns(self._q, motion[:, _ACCEL]) + GRAVITY_NED
        return np.hstack([turning, acceleration])

    def _lateness(self, fine_s: Floats, acceleration: Floats) -> Floats:
        """Return what a late velocity adds to the rows [N, 6, 2], by its first two derivatives.

        A GNSS receiver reports its velocity 0.1 to 0.2 s late (ArduPilot issues 2850, 5405), so
        the time of a sparse velocity is not trusted.
        """
        if self._instants is None:
            return np.empty((*self.rows.shape, 0))
        added = np.zeros((*self.rows.shape, 2))
        bends = np.gradient(acceleration, fine_s, axis=0)
        added[:, _ACCEL, 0] = self._instants.measured(acceleration)
        added[:, _ACCEL, 1] = self._instants.measured(bends)
        return added

    def _in_body(self, reference: Reference, increments: Floats) -> Floats:
        """Return the misfit as rate and force [N, 6] in body axes, per row."""
        q = inverse_columns(reference.ned_from_body[:-1])
        parts = [rotate_columns(q, increments[:, part : part + 3]) for part in (0, 3)]
        body = np.hstack(parts) / np.diff(reference.time_s)[:, None]
        return self._windows(np.vstack([body, body[-1:]]))

    def project(self, addition: Addition) -> Floats:
        """Return what an addition [M, 3] on the grid adds to angle and velocity [N, 6]."""
        self.moved()
        rows = np.zeros(self.rows.shape)
        if addition.gyro is not None:
            rows[:, _GYRO] = self._integrated(addition.gyro)
        if addition.accel is None:
            return rows
        if self._instants is None:
            rows[:, _ACCEL] = self._integrated(addition.accel)
        else:
            every = integral_means(self._axes, addition.accel, self._fine_s, 1)
            rows[:, _ACCEL] = self._instants.measured(every)
        return rows

    def _integrated(self, added: Floats) -> Floats:
        return integral_means(self._axes, added, self._fine_s, self._window, self._parts)

    def project_body(self, addition: Addition) -> Floats:
        """Return what an addition [M, 3] on the grid adds to rate and force [N, 6]."""
        rows = np.zeros(self.rows.shape)
        if addition.gyro is not None:
            rows[:, :3] = self._windows(addition.gyro[:: self._parts])
        if addition.accel is not None:
            rows[:, 3:] = self._windows(addition.accel[:: self._parts])
        return rows

    def first_noise(self) -> Noise:
        """Return the noise of a good INS and of a consumer IMU."""
        attitude, velocity = [7e-4, 6.0, 5e-5], [0.03, 4.0, 0.003]
        g, a = (
            max(seen, _QUIETEST * usual) if np.isfinite(seen) else usual
            for seen, usual in zip(self._densities, _USUAL_DENSITIES, strict=True)
        )
        gyro, accel = [g, 1e-4, 100.0], [a, 2e-3, 100.0]
        return np.log([*attitude, *gyro, *velocity, *accel, 5e-6, 3e-4, 1e-4])

    def noise_bounds(self) -> list[tuple[float, float]]:
        """Return bounds: factors of _SIZES, _WANDERS and _TIMES about the first guesses."""
        bounds = []
        for name, value in zip(self.noise_names, self.first_noise(), strict=True):
            is_time = name.endswith(("attitude_s", "velocity_s"))
            size = _WANDERS if name in ("gyro_wander_rad_s", "accel_wander_m_s2") else _SIZES
            span = np.log(_TIMES if is_time else size)
            if "density" in name and np.isfinite(self._densities).all():
                bounds.append((value - _MEASURED, value + _MEASURED))
                continue
            if name.endswith("wander_s"):
                bounds.append(_SLOW)
                continue
            bounds.append((value - span, _LONGEST_ERROR if is_time else value + span))
        return bounds

    def _earth_axes(self) -> Floats:
        return np.broadcast_to(np.eye(3), self._path.shape).copy()

    def choose(self, likelihood: Callable[[], float]) -> None:
        """Choose whether the reference's attitude error is stationary in body or in earth axes.

        The one with the higher `likelihood`: the error of the vehicle's own INS is stationary in
        body axes, that of a reference from satellites or cameras in earth axes.
        """
        values = {}
        for is_in_body in (True, False):
            self._is_error_in_body = is_in_body
            values[is_in_body] = likelihood()
        self._is_error_in_body = values[True] >= values[False]

    def grams(self, rows: Floats) -> Grams:
        """Return the function from noise to the Gram matrix of `rows` [N, 6, K] whitened."""
        rows = np.ascontiguousarray(rows)

        def gram(noise: Noise) -> tuple[Floats, float]:
            white, log_variance = self.whiten(noise, rows)
            flat = white.reshape(-1, rows.shape[2])
            return np.asarray(flat.T @ flat), float(log_variance.sum())

        return gram

    def whiten(self, noise: Noise, rows: Floats) -> tuple[Floats, Floats]:
        """Return `rows` [N, 6, K] whitened, and the log variances [N, 6] of the innovations."""
        self.moved()
        key = noise.tobytes(), self._is_error_in_body
        if key not in self._filters:
            while len(self._filters) >= _FILTERS_KEPT:
                del self._filters[next(iter(self._filters))]
            self._filters[key] = self._filter(noise)
        filtering, log_variance = self._filters[key]
        out = np.empty(rows.shape)
        whiten_flight(np.ascontiguousarray(rows), *filtering, out)
        return out, log_variance

    def _filter(self, noise: Noise) -> _Filter:
        """Return path, steps and gains for `whiten_flight`, and the log variances."""
        e, e_s, e_white, g, b, b_s, v, v_s, v_white, a, c, c_s, e_vib, v_vib, jitter = np.exp(noise)
        step_s = self._steps_s[:, None]
        keep = np.exp(-step_s / np.array([e_s, b_s, v_s, c_s]))
        held = np.array([e, b, v, c]) ** 2 * (1.0 - keep * keep)
        drive = np.hstack(
            [held[:, :1], g * g * step_s, held[:, 1:3], a * a * step_s, held[:, 3:]],
        )
        start = np.array([e * e, _UNKNOWN_ANGLE, b * b, v * v, _UNKNOWN_SPEED, c * c])
        # Window means of a random walk: their increments are correlated by +1/4,
        # equivalent to a white noise of negative variance (Working 1960).
        mean_of_walk = (1.0 - 1.0 / self._window**2) / 6.0
        white = (jitter * self._changes) ** 2
        white[:, :3] += e_white**2 + (e_vib * self._vibration) ** 2
        white[:, 3:] += v_white**2 + (v_vib * self._vibration) ** 2
        usual = np.median(drive, axis=0)
        white[:, :3] -= mean_of_walk * (usual[0] + usual[1])
        if self._instants is None:
            white[:, 3:] -= mean_of_walk * (usual[3] + usual[4])
        count = len(self.rows)
        path = (
            self._rotation,
            self._tilt @ self._rotation if self._is_error_in_body else self._tilt,
            self._path if self._is_error_in_body else self._earth_axes(),
            self._begins,
        )
        gains, roots = np.empty((count, STATES, 6)), np.empty((count, 6, 6))
        variances = np.empty((count, 6))
        steps = self._steps_s, keep
        unseen = np.maximum(self._unseen[:, ::3], self.missing[:, None])
        flight_gains(*path, *steps, unseen, drive, start, white, gains, roots, variances)
        # Noise far out of range gives NaN; a likelihood of NaN compares as higher than no other.
        with np.errstate(invalid="ignore"):
            return (*path, *steps, gains, roots), np.log(variances)


def _sum(increments: Floats) -> Floats:
    return np.vstack([np.zeros((1, increments.shape[1])), np.cumsum(increments, axis=0)])


def is_flight(reference: Reference) -> bool:
    """Whether the reference moves or has no independent rates."""
    return reference.rate_rad_s is None or not reference.is_at_rest
