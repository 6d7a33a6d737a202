"""The paper's comparison on the simulated bench: conventional, improved and smooth calibration.

All get the same chamber run; improved and smooth also the room table's six positions. What each
leaves is judged by a separate run (chamber).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.calibration.thermal.drift_records import matrix_rows
from ahrs_service.calibration.thermal.rows import ThermalRows
from ahrs_service.calibration.thermal.smooth import (
    SmoothFit,
    fit_curves,
    fit_smooth,
    smooth_calibration,
)
from ahrs_service.calibration.thermal.smooth_drift import Structure
from ahrs_service.calibration.triad import fit_triad, vector
from ahrs_service.records import Floats, Integers
from ahrs_service.sensor.compensation import compensate_columns
from ahrs_service.sensor.parameters import Calibration, TriadCalibration, coefficients
from ahrs_service.sensor.thermometer import acting_columns

from .chamber import SAMPLE_HZ, Holds, draw
from .segmented import fit_conventional, fit_improved
from .thermal_parts import ROOM_DEGC

METHODS: Final = (
    "none",
    "cubic of the bias",
    "conventional, jumping",
    "conventional",
    "improved, jumping",
    "improved",
    "smooth",
)
"""What is compared: `none` has the room's matrix and bias alone, `cubic of the bias` is what the
autopilots fit; the paper's two models jump at the borders of their segments, or meet there."""


@dataclass(frozen=True, slots=True)
class Bench:
    """One unit on the bench: its calibrations by method, the smooth fits, the validation run."""

    calibrations: dict[str, Calibration]
    gyro_fit: SmoothFit
    accel_fit: SmoothFit
    validation: Holds
    true_lag_s: float


def gyro_rows(runs: list[Holds]) -> tuple[ThermalRows, Floats]:
    """Return all holds as rows and the nominal rates [N, 3]: level 0 is standing still."""
    levels = [np.where(run.is_still, 0, 1 + 2 * n + run.hold - 4) for n, run in enumerate(runs)]
    return _rows(runs, "gyro_rad_s", "nominal_rate_rad_s", levels, still_only=False)


def accel_rows(runs: list[Holds]) -> tuple[ThermalRows, Floats]:
    """Return the still holds as rows and the nominal forces [N, 3]."""
    levels = [4 * n + run.hold for n, run in enumerate(runs)]
    return _rows(runs, "accel_m_s2", "nominal_force_m_s2", levels, still_only=True)


def _rows(
    runs: list[Holds], output: str, nominal: str, levels: list[Integers], still_only: bool
) -> tuple[ThermalRows, Floats]:
    keep = [run.is_still if still_only else np.ones(len(run.time_s), np.bool_) for run in runs]
    pairs = list(zip(runs, keep, strict=True))
    rows = ThermalRows(
        time_s=np.concatenate([run.time_s[k] for run, k in pairs]),
        temperature_degc=np.concatenate([run.temperature_degc[k] for run, k in pairs]),
        output=np.concatenate([getattr(run, output)[k] for run, k in pairs]),
        level=np.concatenate([level[k] for level, k in zip(levels, keep, strict=True)]),
        session=np.concatenate([np.full(k.sum(), n) for n, k in enumerate(keep)]),
    )
    return rows, np.concatenate([getattr(run, nominal)[k] for run, k in pairs])


def calibrate_bench(seed: int) -> Bench:
    """Draw a unit and its bench, calibrate it by every method, and run the validation."""
    unit, bench = draw(seed)
    room, runs, validation = bench.room(unit), bench.chamber(unit), bench.validation(unit)
    gyro, gyro_fit = _by_method(*gyro_rows(runs), room.gyro_rad_s, room.nominal_rate_rad_s)
    still = room.is_still
    accel, accel_fit = _by_method(
        *accel_rows(runs), room.accel_m_s2[still], room.nominal_force_m_s2[still]
    )
    calibrations = {name: Calibration(gyro=gyro[name], accel=accel[name]) for name in METHODS}
    return Bench(calibrations, gyro_fit, accel_fit, validation, unit.lag_s)


def _by_method(
    rows: ThermalRows, nominal: Floats, room_output: Floats, room_input: Floats
) -> tuple[dict[str, TriadCalibration], SmoothFit]:
    room = fit_triad(np.hstack([room_input, np.ones((len(room_input), 1))]), room_output)
    matrix, bias = room.matrix, room.bias
    fit = fit_smooth(rows, ROOM_DEGC)
    triads = {"none": TriadCalibration(matrix=matrix_rows(matrix), bias=vector(bias))}
    for name, continuous in ((", jumping", False), ("", True)):
        triads["conventional" + name] = fit_conventional(rows, nominal, ROOM_DEGC, continuous)
        triads["improved" + name] = fit_improved(rows, matrix, bias, ROOM_DEGC, continuous)
    triads["cubic of the bias"] = _cubic(rows, matrix, bias)
    triads["smooth"] = smooth_calibration(fit.axes, matrix, bias, fit.lag.lag_s)
    return triads, fit


def _cubic(rows: ThermalRows, matrix: Floats, bias: Floats) -> TriadCalibration:
    """Return what the autopilots fit: a cubic of the bias alone, in one position."""
    one = rows.part(np.flatnonzero(rows.level == 0))
    cubic = Structure(bias=(3, 1))
    axes, _ = fit_curves(one, (cubic, cubic, cubic), ROOM_DEGC)
    return smooth_calibration(axes, matrix, bias, model="cubic")


def residuals(calibration: Calibration, run: Holds) -> tuple[Floats, Floats]:
    """Return what a calibration leaves of rate [N, 3] [rad/s] and force [N, 3] [m/s^2].

    The temperature is followed as in service: sample by sample, from what came before.
    """
    rows, shown = coefficients(calibration), run.thermometer_degc
    acting = acting_columns(rows, shown.ravel(), np.arange(shown.size) / SAMPLE_HZ)
    gyro_degc, accel_degc = acting.reshape(*shown.shape, 2).mean(axis=1).T
    outputs = run.gyro_rad_s, run.accel_m_s2
    rate, _ = compensate_columns(rows, *outputs, gyro_degc)
    _, force = compensate_columns(rows, *outputs, accel_degc)
    return rate - run.true_rate_rad_s, force - run.true_force_m_s2
