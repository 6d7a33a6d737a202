"""Six positions: the accelerometer by gravity, and the gyros by turns of known angle.

Put the unit on each of its six faces, on something flat and level and against something square,
and let go for two seconds. For the gyros, while it lies on three faces (one for each axis), turn it
flat on the table by a full circle to the same edge, let it rest, and turn it back.

Examples:
  ahrs-service calibrate six-position poses.tlog --out configs/calibrations/A0042.toml
  ahrs-service calibrate six-position --link udpin:127.0.0.1:14550 --out A0042.toml --serial A0042

With --link the terminal tells which pose to take and sees by itself when the unit is still. All
that is heard is kept in a .tlog, and what is found is what the same command finds in it.

"""

import argparse
from functools import partial

from ahrs_service.app.calibrate import capture, outcome, poses, session
from ahrs_service.app.options import positive
from ahrs_service.calibration import known_turns
from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.guide import guide_six_position
from ahrs_service.calibration.six_position import fit_accelerometer, judge_accelerometer
from ahrs_service.calibration.triad import TriadFit
from ahrs_service.calibration.verdict import Finding, Level, TriadVerdict, judge
from ahrs_service.records import Rows


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
        gyro, verdict = _gyro(columns, found, accel, captures, arguments.turn)
        if gyro is None:
            text = "the gyros are not calibrated: no turn flat on the table is in the recording"
            remarks.append(Finding(Level.NOTE, text))
        else:
            fits["gyro"] = gyro
            triads += verdict
    verdict_of_all = judge("six-position", tuple(triads), tuple(remarks))
    return outcome.finish(verdict_of_all, fits, captures, arguments, poses.temperature_of(found))


def _gyro(
    columns: ImuColumns,
    found: Rows,
    accel: TriadFit,
    captures: list[capture.Capture],
    turn_deg: float,
) -> tuple[TriadFit | None, list[TriadVerdict]]:
    """Return the gyros' fit and verdict, or None where nobody turned the unit."""
    turns, measured = known_turns.find_turns(columns, found, accel, turn_deg)
    if not len(turns):
        return None, []
    for one in captures:
        capture.check_rate(one, poses.LEAST_TURN_HZ, "summing up a turn")
    gyro = known_turns.fit_gyro(found, turns, measured)
    return gyro, [known_turns.judge_gyro(found, turns, measured, gyro)]
