"""Six positions: the accelerometer by gravity, and the gyros by turns of known angle.

Put the unit on each of its six faces, on something flat and level and against something square,
and let go for two seconds. For the gyros, while it lies on three faces (one for each axis), turn it
flat on the table by a full circle to the same edge, let it rest, and turn it back.

Examples:
  ahrs-service calibrate six-position poses.tlog --out configs/calibrations/A0042.toml
  ahrs-service calibrate six-position --link udpin:127.0.0.1:14550 --out A0042.toml --serial A0042

With --link the terminal shows which pose to take and detects when the unit is still. All
received messages are kept in a .tlog, and what is found is what the same command finds in it.

"""

import argparse
from functools import partial

from ahrs_service.app.calibrate import capture, outcome, poses, session
from ahrs_service.app.options import positive
from ahrs_service.calibration import known_rotations
from ahrs_service.calibration.guide import guide_six_position
from ahrs_service.calibration.six_position import fit_accelerometer, judge_accelerometer
from ahrs_service.calibration.verdict import Finding, Level, judge


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `calibrate six-position`."""
    capture.add_arguments(parser)
    capture.add_gravity(parser)
    parser.add_argument(
        "--turn",
        type=positive,
        default=360.0,
        metavar="DEG",
        help="by how much the unit is turned flat on the table; multiples count (default: 360)",
    )
    parser.add_argument(
        "--no-turns", action="store_true", help="accelerometer only: do not look for turns"
    )
    session.add_arguments(parser)
    outcome.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Calibrate from recordings or a guided session; return the exit code."""
    guide = partial(guide_six_position, with_turns=not arguments.no_turns, unit_deg=arguments.turn)
    return session.run(arguments, guide, calibrate)


def calibrate(captures: list[capture.Capture], arguments: argparse.Namespace) -> int:
    """Fit, judge, show and write."""
    gravity = capture.gravity_of(arguments)
    columns, found = poses.still_poses(captures)
    accel = fit_accelerometer(found, gravity)
    fits, triads = {"accel": accel}, [judge_accelerometer(found, accel, gravity)]
    remarks = list(poses.remarks(captures, found))
    if not arguments.no_turns:
        turns = known_rotations.find_rotations(columns, found, accel, arguments.turn)
        if turns.left_out:
            more = f" (one of {len(turns.left_out)} such turns)" if turns.left_out[1:] else ""
            remarks.append(Finding(Level.WARNING, f"{turns.left_out[0]}{more}"))
        if len(turns.truth):
            for one in captures:
                capture.check_rate(one, poses.LEAST_ROTATION_HZ, "summing up a turn")
            fits["gyro"] = known_rotations.fit_gyro(found, turns)
            triads.append(known_rotations.judge_gyro(found, turns, fits["gyro"]))
        else:
            text = "the gyros are not calibrated: no turn flat on the table is in the recording"
            remarks.append(Finding(Level.NOTE, text))
    verdict = judge("six-position", tuple(triads), tuple(remarks))
    return outcome.finish(verdict, fits, captures, arguments, poses.temperature_of(found))
