"""The interface of a comparison of IMU and reference, on a bench or in flight."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from ahrs_service.effects.base import Addition, Columns
from ahrs_service.records import Floats

CHANNELS = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
TRIADS = ("gyro", "gyro", "gyro", "accel", "accel", "accel")
"""The triad of each channel."""

Noise = Floats
"""Logarithms of the noise parameters of a residual, in the order of its `noise_names`."""


Grams = Callable[[Noise], tuple[Floats, float]]
"""From noise to the Gram matrix [K, K] of whitened rows, and the noise's log determinant."""


class Residual(Protocol):
    """A misfit of IMU and reference [N, 6] (gyro, accel) with its noise.

    `time_s` [N] of the rows, `rows` [N, 6] the misfit to be whitened; `body` [N, 6] the same as
    rate [rad/s] and specific force [m/s^2] in body axes, for reports. `columns` the motion from the
    best source, `reference_columns` from the reference alone (the same where it is exact).
    `moved` is called with every projection and whitening, for progress: there are thousands.
    `nuisances` [N, 6, K] what errors of the reference that are not noise add to the rows.
    """

    time_s: Floats
    rows: Floats
    body: Floats
    columns: Columns
    reference_columns: Columns
    missing: Floats
    largest: Floats
    ends: Floats
    ties: Floats
    scatter: Floats
    nuisances: Floats
    noise_names: Sequence[str]
    moved: Callable[[], None]

    def __hash__(self) -> int:
        """By identity, for caches of what was computed for a residual."""

    def project(self, addition: Addition) -> Floats:
        """Return what an addition on the grid of `columns` adds to `rows` [N, 6]."""

    def project_body(self, addition: Addition) -> Floats:
        """Return what it adds to `body` [N, 6]."""

    def first_noise(self) -> Noise:
        """Return noise parameters to start a fit from."""

    def noise_bounds(self) -> list[tuple[float, float]]:
        """Return the bounds of the noise parameters."""

    def choose(self, likelihood: Callable[[], float]) -> None:
        """Choose among forms of the noise by the `likelihood` under each."""

    def grams(self, rows: Floats) -> Grams:
        """Return the function from noise to the Gram matrix of `rows` [N, 6, K] whitened."""

    def whiten(self, noise: Noise, rows: Floats) -> tuple[Floats, Floats]:
        """Return `rows` [N, 6, K] whitened, and the log variances [N, 6] of the innovations."""


def bias_rows(residual: Residual) -> Floats:
    """Return what a constant bias of each of the six sensors adds to the rows [N, 6, 6]."""
    count = len(residual.columns.time_s)
    zeros = np.zeros((count, 3))
    columns = []
    for sensor in range(6):
        one = zeros.copy()
        one[:, sensor % 3] = 1.0
        addition = Addition(gyro=one) if sensor < 3 else Addition(accel=one)
        columns.append(residual.project(addition))
    return np.stack(columns, axis=2)


def nuisance_rows(residual: Residual) -> Floats:
    """Return what is always fitted [N, 6, 6 + K]: constant biases and the reference's nuisances."""
    return np.concatenate([bias_rows(residual), residual.nuisances], axis=2)
