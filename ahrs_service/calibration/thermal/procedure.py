"""The thermal procedure: from recordings of a unit that lies still and changes its temperature.

A soak or a ramp, one pose or several. The gyros feel nothing in any of them, so their bias is seen
as it is; of the accelerometers one pose shows the bias's drift alone, poses all around show what
temperature does to scale and axes too. What the room's calibration said of matrix and bias stays,
but for the gyro's bias, which rest determines better.
"""

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from ahrs_service.calibration.columns import (
    AXES,
    ImuColumns,
    check_force_unit,
    check_saturation,
    check_temperature,
)
from ahrs_service.calibration.thermal.coloured import Hysteresis, hysteresis
from ahrs_service.calibration.thermal.fold_choice import TENTHS, HeldOut, hold_out
from ahrs_service.calibration.thermal.pose_groups import joined, still_rows
from ahrs_service.calibration.thermal.rows import ThermalRows
from ahrs_service.calibration.thermal.smooth import SmoothFit, fit_smooth, smooth_calibration
from ahrs_service.calibration.triad import rms, vector
from ahrs_service.calibration.verdict import (
    Finding,
    Level,
    TemperatureResidual,
    TriadVerdict,
    Verdict,
    judge,
    span_finding,
)
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import Calibration, TriadCalibration
from ahrs_service.sensor.provenance import Uncertainty

PROCEDURE: Final = "thermal"
LEAST_SPAN_K: Final = 2.0
"""Below this a recording shows the sensor's noise and no temperature [K]."""
BIN_DEGC: Final = 5.0  # A choice: the width of the paper's segments, as SEGMENT_DEGC
LEAST_ROWS: Final = TENTHS
"""One in each part that is held out: fewer do not predict unseen time."""

_SIGMA_NODES: Final = 8
"""A choice: pieces of the straight lines that carry the sigma over temperature."""
_SIGNIFICANT: Final = 3.0  # A choice: 3 sigma; by chance one value in 370 is so large
_LARGEST_LOOP: Final = 0.1
"""Share of the drift that heating and cooling may differ by without a warning."""
_UNITS: Final = {"gyro": "rad/s", "accel": "m/s^2"}
_LEAST_SESSIONS: Final = 3
"""A choice: a scatter of three power-ons is right to 50 % (1 / sqrt(2 * 2))."""

Triad = Literal["gyro", "accel"]


@dataclass(frozen=True, slots=True)
class TriadResult:
    """What was found of one triad: the fit, the held-out residuals, heating against cooling."""

    fit: SmoothFit
    held_out: HeldOut
    hysteresis: Hysteresis


@dataclass(frozen=True, slots=True)
class ThermalResult:
    """The unit's calibration with its drift, how it was found, and the verdict."""

    calibration: Calibration
    gyro: TriadResult
    accel: TriadResult
    verdict: Verdict


def calibrate_thermal(
    sessions: list[ImuColumns], room: Calibration, remarks: tuple[Finding, ...] = ()
) -> ThermalResult:
    """Fit both triads' drift over temperature to `sessions`, one power-on each.

    `room` is what is known of the unit already. CalibrationError names the fault in the data.
    """
    parts, skipped = _still(sessions)
    check_temperature(
        np.concatenate([part[0].temperature_degc for part in parts]), least_span_k=LEAST_SPAN_K
    )
    rows = {
        name: joined([part[n] for part in parts], same_levels=False)
        for n, name in enumerate(("gyro", "accel"))
    }
    if len(rows["gyro"]) < LEAST_ROWS:
        raise CalibrationError(
            f"only {len(rows['gyro'])} windows are still, {LEAST_ROWS} are the least: put the unit "
            "down and record for some minutes while its temperature changes"
        )
    zero_degc = _zero(room, rows["gyro"].span_degc)
    gyro, accel = (_fit(one, zero_degc) for one in rows.values())
    calibration = replace(
        room,
        gyro=_gyro(gyro, room.gyro),
        accel=_calibrated(accel, room.accel, np.array(room.accel.bias)),
        room_degc=zero_degc,
    )
    triads = (_judge("gyro", gyro), _judge("accel", accel))
    findings = (
        *remarks,
        *skipped,
        span_finding(rows["gyro"].span_degc),
        *_on_room(room, zero_degc),
        *_on_triad("gyro", gyro),
        *_on_triad("accel", accel),
        *_on_poses(accel),
    )
    return ThermalResult(calibration, gyro, accel, judge(PROCEDURE, triads, findings))


def _still(
    sessions: list[ImuColumns],
) -> tuple[list[tuple[ThermalRows, ThermalRows]], list[Finding]]:
    """Return the still rows of the sessions that have any, and what is said of the others."""
    parts, skipped = [], []
    for number, columns in enumerate(sessions):
        check_saturation(columns)
        check_temperature(columns.temperature_degc)
        check_force_unit(columns.accel_m_s2)
        try:
            parts.append(still_rows(columns, number))
        except CalibrationError as error:
            skipped.append(error)
    if not parts:
        raise skipped[0]
    return parts, [Finding(Level.NOTE, f"a power-on is left out: {error}") for error in skipped]


def _zero(room: Calibration, span_degc: tuple[float, float]) -> float:
    """Return where the drift is zero: the room's temperature, or the nearest that was seen."""
    return float(np.clip(room.room_degc, *span_degc))


def _fit(rows: ThermalRows, zero_degc: float) -> TriadResult:
    fit = fit_smooth(rows, zero_degc)
    validated = hold_out(rows, zero_degc)
    assert validated is not None, "the smooth model can always be fitted: it may be a constant"
    loop = hysteresis(fit.rows.temperature_degc, fit.rows.rate_degc_s(), fit.residual)
    return TriadResult(fit, validated, loop)


def _gyro(result: TriadResult, room: TriadCalibration) -> TriadCalibration:
    """Return the gyros' calibration: at rest the level is the bias, at each power-on another."""
    levels = np.stack([axis.levels for axis in result.fit.axes], axis=1)
    found = _calibrated(result, room, levels.mean(axis=0))
    if len(levels) < _LEAST_SESSIONS:
        return found
    turn_on = vector(levels.std(axis=0, ddof=1))
    return replace(found, uncertainty=replace(found.uncertainty, bias_turn_on=turn_on))


def _calibrated(result: TriadResult, room: TriadCalibration, bias: Floats) -> TriadCalibration:
    fit = result.fit
    found = smooth_calibration(fit.axes, np.array(room.matrix), bias, fit.lag.lag_s)
    nodes = np.linspace(*fit.rows.span_degc, _SIGMA_NODES + 1)
    after = np.sqrt(np.mean(result.held_out.after**2, axis=0))
    lag = (("thermal_lag_s",), ((fit.lag.sigma_s**2,),)) if fit.lag.is_reported else ((), ())
    return replace(
        found,
        g_sensitivity=room.g_sensitivity,
        uncertainty=Uncertainty(
            bias_residual=vector(after),
            bias_sigma=Curve.linear(nodes, fit.bias_sigma(nodes)),
            parameters=lag[0],
            covariance=lag[1],
        ),
    )


def _judge(name: Triad, result: TriadResult) -> TriadVerdict:
    """Return the figures of one triad."""
    fit, rows = result.fit, result.fit.rows
    level = np.stack([axis.levels for axis in fit.axes], axis=1)[rows.level]
    low, high = rows.span_degc
    ends = fit.bias_sigma(np.array([low, high]))
    errors = {
        f"drift {axis} at {degc:.0f} degC": float(ends[k, n])
        for n, axis in enumerate(AXES)
        for k, degc in enumerate((low, high))
    }
    if fit.lag.is_reported:
        errors["thermal_lag_s"] = fit.lag.sigma_s
    before, after = result.held_out.rms()
    largest = result.hysteresis.largest
    return TriadVerdict(
        triad=name,
        unit=_UNITS[name],
        count=len(rows),
        rms_before=rms(rows.output - level),
        rms_after=rms(fit.residual),
        by_temperature=_by_temperature(rows, fit.residual),
        span_degc=rows.span_degc,
        standard_errors=errors,
        held_out_before=before,
        held_out_after=after,
        hysteresis=None if largest is None else vector(largest),
    )


def _by_temperature(rows: ThermalRows, residual: Floats) -> tuple[TemperatureResidual, ...]:
    """Return the RMS residual in bins of BIN_DEGC, whole multiples of it."""
    place = np.floor(rows.temperature_degc / BIN_DEGC)
    return tuple(
        TemperatureResidual(
            low_degc=float(n * BIN_DEGC),
            high_degc=float((n + 1) * BIN_DEGC),
            count=int((place == n).sum()),
            rms=rms(residual[place == n]),
        )
        for n in np.unique(place)
    )


def _on_room(room: Calibration, zero_degc: float) -> list[Finding]:
    """Say where matrix and bias of the room meet the drift."""
    gap = abs(room.room_degc - zero_degc)
    ideal = Calibration.ideal()
    if gap < 1.0 or (room.gyro, room.accel) == (ideal.gyro, ideal.accel):
        return []
    text = (
        f"the drift is counted from {zero_degc:.0f} degC, for {room.room_degc:.0f} degC, where "
        "matrix and bias were found, was not passed: what lies between is not known"
    )
    return [Finding(Level.WARNING, text)]


def _on_triad(name: str, result: TriadResult) -> list[Finding]:
    """Say what was seen of drift, lag and hysteresis."""
    fit, lag = result.fit, result.fit.lag
    shapes = "; ".join(f"{a} {s.text}" for a, s in zip(AXES, fit.structures, strict=True))
    findings = [Finding(Level.NOTE, f"{name}: {shapes}")]
    if not any(one.size for one in fit.structures):
        text = f"{name}: no drift stands out of the noise, so none is taken off"
        findings.append(Finding(Level.WARNING, text))
    if lag.is_reported:
        late = "elements follow thermometer" if lag.lag_s > 0.0 else "thermometer follows elements"
        text = f"{name}: {late} by {abs(lag.lag_s):.0f} s ({lag.low_s:.0f} to {lag.high_s:.0f})"
        findings.append(Finding(Level.NOTE, text))
    else:
        text = f"{name}: a lag of the thermometer does not show, none is assumed"
        findings.append(Finding(Level.NOTE, text))
    return findings + _on_hysteresis(name, result)


def _on_hysteresis(name: str, result: TriadResult) -> list[Finding]:
    loop = result.hysteresis
    if loop.largest is None:
        text = f"{name}: heating and cooling were not both seen, so hysteresis is not known"
        return [Finding(Level.NOTE, text)]
    ratio = np.abs(loop.difference) / np.maximum(loop.sigma, 1e-300)
    significant = np.where(ratio > _SIGNIFICANT, np.abs(loop.difference), 0.0)
    axis = int(np.argmax(significant.max(axis=0)))
    worst = float(significant[:, axis].max())
    if worst == 0.0:
        return [Finding(Level.NOTE, f"{name}: heating and cooling agree")]
    drift = result.fit.axes[axis].drift(loop.temperature_degc, np.zeros((len(loop.sigma), 3)))
    level = Level.WARNING if worst > _LARGEST_LOOP * np.ptp(drift) else Level.NOTE
    text = (
        f"{name}: heating and cooling differ by up to {worst:.3g} {_UNITS[name]} "
        f"({AXES[axis]}), which no curve of temperature takes off"
    )
    return [Finding(level, text)]


def _on_poses(accel: TriadResult) -> list[Finding]:
    """Report what the poses could not determine of the accelerometers."""
    count = accel.fit.rows.levels
    if any(one.kind for one in accel.fit.structures):
        return []
    poses = "one pose does" if count == 1 else f"{count} poses do"
    text = (
        f"accel: {poses} not tell what temperature does to scale and axes; repeat the run in "
        "poses all around to have it"
    )
    return [Finding(Level.NOTE, text)]
