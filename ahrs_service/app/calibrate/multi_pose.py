"""Any poses, without a table: both triads by gravity alone, from twelve still poses or more.

Put the unit into twelve or more directions that differ by 10 degrees or more, leaning it against
whatever is solid, and let go for two seconds each; turn it from one to the next in the hand. The
accelerometer is calibrated by the length of gravity, the gyros by how they turn it from pose to
pose.

Examples:
  ahrs-service calibrate multi-pose poses.tlog --out configs/calibrations/A0042.toml
  ahrs-service calibrate multi-pose --link serial:/dev/ttyACM0:115200 --poses 24 --serial A0042

With --link the terminal shows which directions are missing and detects when the unit is still.
All that is received is kept in a .tlog, and what is found is what the same command finds in it.

"""

import argparse
from functools import partial
from typing import Final

from ahrs_service.app.calibrate import capture, outcome, poses, session
from ahrs_service.calibration.guide import guide_multi_pose
from ahrs_service.calibration.multi_pose import (
    LEAST_POSES,
    fit_accelerometer,
    judge_accelerometer,
)
from ahrs_service.calibration.pose_rotations import fit_gyro, judge_gyro
from ahrs_service.calibration.verdict import Finding, Level, judge

_WANTED: Final = 18


def _enough(text: str) -> int:
    count = int(text)
    if count < LEAST_POSES:
        raise argparse.ArgumentTypeError(f"{text}: {LEAST_POSES} poses or more are needed")
    return count


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `calibrate multi-pose`."""
    capture.add_arguments(parser)
    capture.add_gravity(parser)
    parser.add_argument(
        "--poses",
        type=_enough,
        default=_WANTED,
        metavar="N",
        help=f"different poses that a guided session asks for (default: {_WANTED})",
    )
    parser.add_argument("--no-gyro", action="store_true", help="accelerometer only")
    session.add_arguments(parser)
    outcome.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Calibrate from recordings or a guided session; return the exit code."""
    return session.run(arguments, partial(guide_multi_pose, wanted=arguments.poses), calibrate)


def calibrate(captures: list[capture.Capture], arguments: argparse.Namespace) -> int:
    """Fit, judge, show and write."""
    gravity = capture.gravity_of(arguments)
    columns, found = poses.still_poses(captures)
    accel = fit_accelerometer(found, gravity)
    fits, triads = {"accel": accel}, [judge_accelerometer(found, accel, gravity)]
    remarks = list(poses.remarks(captures, found))
    slow = [one for one in captures if not one.rate_hz >= poses.LEAST_ROTATION_HZ]
    if slow and not arguments.no_gyro:
        text = (
            f"the gyros are not calibrated: {slow[0].rate_hz:.0f} Hz are too few to follow a turn "
            f"({poses.LEAST_ROTATION_HZ:.0f} Hz are needed)"
        )
        remarks.append(Finding(Level.WARNING, text))
    elif not arguments.no_gyro:
        fits["gyro"] = fit_gyro(columns, found, accel)
        triads.append(judge_gyro(columns, found, accel, fits["gyro"]))
    verdict = judge("multi-pose", tuple(triads), tuple(remarks))
    return outcome.finish(verdict, fits, captures, arguments, poses.temperature_of(found))
