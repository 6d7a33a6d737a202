"""What the procedures with poses share: checks before the fit, remarks on what was recorded."""

from typing import Final

import numpy as np

from ahrs_service.app.calibrate.capture import Capture, check_rate, joined
from ahrs_service.calibration.columns import AXES, ImuColumns, check_stream_unit, flat_tops
from ahrs_service.calibration.poses import check_clipped_poses, find_poses, span_of
from ahrs_service.calibration.verdict import Finding, Level
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Rows

LEAST_HZ: Final = 1.0
"""Slower samples have no window of eight in any pose that a person would hold."""
LEAST_ROTATION_HZ: Final = 20.0
"""Slower gyros cannot follow a turn by hand, which lasts about a second."""

_WARM_K: Final = 3.0


def still_poses(captures: list[Capture]) -> tuple[ImuColumns, Rows]:
    """Return all columns and their still poses, checked; CalibrationError names the fault."""
    for capture in captures:
        check_rate(capture, LEAST_HZ, "telling rest from motion")
    columns = joined(captures)
    check_stream_unit(columns)
    poses = find_poses(columns)
    if not len(poses):
        raise CalibrationError(
            "the unit is nowhere still for 1.5 s: put it down on something solid, without motors "
            "and hands, and record again"
        )
    check_clipped_poses(columns, poses)
    return columns, poses


def remarks(captures: list[Capture], poses: Rows) -> tuple[Finding, ...]:
    """Say what the autopilot had done to the samples, and what their temperatures mean."""
    return (*on_autopilot(captures), *_on_range(captures), _on_temperature(poses))


def _on_range(captures: list[Capture]) -> tuple[Finding, ...]:
    """Say which gyros ran into the end of their range."""
    clipped = [flat_tops(capture.columns.gyro_rad_s).any(axis=0) for capture in captures]
    names = ", ".join(np.array(AXES)[np.any(clipped, axis=0)])
    if not names:
        return ()
    text = (
        f"gyro {names} was saturated at times, and turns with it do not count: turn more slowly, "
        "or set the gyro to a wider range"
    )
    return (Finding(Level.WARNING, text),)


def on_autopilot(captures: list[Capture]) -> tuple[Finding, ...]:
    """Say what the autopilot had done to the samples before it recorded them."""
    known = dict.fromkeys(text for capture in captures for text in capture.compensated)
    return tuple(Finding(Level.WARNING, text) for text in known)


def _on_temperature(poses: Rows) -> Finding:
    span = span_of(poses)
    if span is None:
        text = "the temperature of the IMU is not known, so neither is where this holds"
        return Finding(Level.WARNING, text)
    low, high = span
    if high - low > _WARM_K:
        text = (
            f"the IMU went from {low:.0f} to {high:.0f} degC during the poses, and its errors with "
            "it: let it warm up before, or calibrate over temperature (calibrate thermal)"
        )
        return Finding(Level.WARNING, text)
    text = f"holds at {low:.0f} to {high:.0f} degC; nothing is known of other temperatures"
    return Finding(Level.NOTE, text)


def temperature_of(poses: Rows) -> float:
    """Return the mean temperature of the poses [degC], NaN where not known."""
    known = poses["temperature_degc"][np.isfinite(poses["temperature_degc"])]
    return float(known.mean()) if len(known) else float("nan")
