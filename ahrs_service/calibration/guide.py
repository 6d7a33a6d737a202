"""Instructions for moving a unit from pose to pose: what to do next, and what went wrong.

Everything is said from the samples so far alone, so a live session and its recording say the same.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.calibration import multi_pose, six_position
from ahrs_service.calibration.columns import ImuColumns, check_stream_unit
from ahrs_service.calibration.known_rotations import find_rotations
from ahrs_service.calibration.multi_pose import LEAST_POSES
from ahrs_service.calibration.poses import (
    Stillness,
    directions,
    find_poses,
    find_runs,
    groups_of,
    lattice,
    sphere_coverage,
    windows_of,
)
from ahrs_service.calibration.six_position import FACES, LARGEST_TILT_RAD, faces_of
from ahrs_service.calibration.triad import TriadFit, ideal
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats, Rows

FACE_WORDS: Final = {
    "+x": "nose up",
    "-x": "nose down",
    "+y": "right side up",
    "-y": "left side up",
    "+z": "upside down",
    "-z": "level, as it flies",
}
"""How to hold a unit with axes forward, right, down so that this end of an axis is up."""

_HELD_RAD_S: Final = math.radians(6.0)
"""Three times a hand's tremor of 2 deg/s (see poses.Stillness): slower is held, not moved."""
_HELD_S: Final = 2.0
"""A choice: who holds a unit so long means it to be a pose (Stillness asks for 1.5 s)."""
_TURNS_PER_AXIS: Final = 2
"""A choice: one to the left and one to the right: what the gyro's bias leaves cancels."""
_PUSHED: Final = 0.05
"""A choice: sensors without calibration are right to 3 % of gravity, so 5 % is a push."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """A pose that does not count: when it ended [s on the clock of the columns], and why."""

    time_s: float
    why: str


@dataclass(frozen=True, slots=True)
class Guidance:
    """What to show: what to do next, what is there, what was refused, and whether all is done.

    `state` is what the unit does now; `progress` names the parts with what they have; `coverage`
    is the share that is there of what `covers` names.
    """

    instruction: str
    state: str
    progress: tuple[tuple[str, str], ...]
    refusals: tuple[Refusal, ...]
    coverage: float
    done: bool
    covers: str = "directions covered"


def guide_six_position(columns: ImuColumns, with_turns: bool, unit_deg: float = 360.0) -> Guidance:
    """Return what to do next for the six faces, and for the turns about the vertical."""
    poses = find_poses(columns)
    faces, tilt = _faces(poses)
    good = tilt < LARGEST_TILT_RAD
    refusals = _refused(columns, poses)
    for pose, angle in zip(poses[~good], tilt[~good], strict=True):
        why = f"{math.degrees(angle):.0f} deg from the nearest face: lay it flat against the table"
        refusals.append(Refusal(float(pose["stop_s"]), why))
    counts = [int(np.sum(good & (faces == k))) for k in range(len(FACES))]
    progress = [
        (f"{face} up, {FACE_WORDS[face]}", "-" if not n else f"{n} pose{'s'[: n > 1]}")
        for face, n in zip(FACES, counts, strict=True)
    ]
    missing = [face for face, n in zip(FACES, counts, strict=True) if not n]
    asked = f"put it {FACE_WORDS[missing[0]]} ({missing[0]} up) and let go" if missing else ""
    if not missing:
        progress.append(_quality(six_position.fit_accelerometer, poses))
    if with_turns and not missing:
        turned, refusal = _turns(columns, poses, unit_deg)
        refusals += refusal
        progress += [(f"turns with {axis} vertical", str(n)) for axis, n in turned.items()]
        lacking = [axis for axis, n in turned.items() if n < _TURNS_PER_AXIS]
        if lacking:
            asked = (
                f"with {lacking[0]} vertical, turn it flat on the table by exactly "
                f"{unit_deg:g} deg, let it rest, and turn it back"
            )
    return Guidance(
        instruction=asked or "all is there",
        state=_state(columns, poses),
        progress=tuple(progress),
        refusals=tuple(sorted(refusals, key=lambda refusal: refusal.time_s)),
        coverage=sphere_coverage(directions(poses["accel_m_s2"])) if len(poses) else 0.0,
        done=not asked,
    )


def guide_multi_pose(columns: ImuColumns, wanted: int = LEAST_POSES) -> Guidance:
    """Return what to do next until there are `wanted` different directions."""
    poses = find_poses(columns)
    refusals = _refused(columns, poses)
    up = directions(poses["accel_m_s2"])
    groups = groups_of(up)
    for k in range(1, len(poses)):
        if (groups[:k] == groups[k]).any():
            why = "like a pose before: it counts, but tilt it by 10 deg or more for a new one"
            refusals.append(Refusal(float(poses["stop_s"][k]), why))
    count = int(groups.max(initial=-1)) + 1
    asked = f"now hold it {_where(_emptiest(up))}: lean it against something and let go"
    return Guidance(
        instruction=asked if count < wanted else "all is there",
        state=_state(columns, poses),
        progress=(
            ("different poses", f"{count} of {wanted}"),
            *([_quality(multi_pose.fit_accelerometer, poses)] if count >= LEAST_POSES else []),
        ),
        refusals=tuple(sorted(refusals, key=lambda refusal: refusal.time_s)),
        coverage=sphere_coverage(up),
        done=count >= wanted,
    )


def guide_recording(
    columns: ImuColumns, seconds: float, stillness: Stillness | None = None
) -> Guidance:
    """Return how much is missing of `seconds` [s]: at rest by `stillness`, or of any motion."""
    had_s = float(columns.time_s[-1] - columns.time_s[0]) if len(columns.time_s) else 0.0
    asked = "go on in steady motion"
    if stillness is not None:
        poses = find_poses(columns, stillness)
        had_s = float((poses["stop_s"] - poses["start_s"]).max(initial=0.0))
        asked = "leave it alone, on something solid"
    done = had_s >= seconds
    return Guidance(
        instruction="all is there" if done else asked,
        state=_state(columns, find_poses(columns)),
        progress=(("recorded", f"{had_s:.0f} of {seconds:.0f} s"),),
        refusals=(),
        coverage=min(1.0, had_s / seconds),
        done=done,
        covers="recorded",
    )


def _faces(poses: Rows) -> tuple[Rows, Floats]:
    if not len(poses):
        return np.zeros(0, np.int64), np.zeros(0)
    return faces_of(poses["accel_m_s2"])


def _quality(fit: Callable[[Rows], TriadFit], poses: Rows) -> tuple[str, str]:
    """Say what residual a fit of the poses so far would leave, or why there is none."""
    try:
        return "residual of the fit", f"{1e3 * fit(poses).sigma:.1f} mm/s^2"
    except CalibrationError as error:
        return "the fit", str(error)


def _turns(
    columns: ImuColumns, poses: Rows, unit_deg: float
) -> tuple[dict[str, int], list[Refusal]]:
    """Return turns so far by the axis that was vertical; what cannot be one is a refusal."""
    count = dict.fromkeys("xyz", 0)
    refusals = []
    for k in range(len(poses) - 1):
        try:
            turns = find_rotations(columns, poses[k : k + 2], ideal(), unit_deg)
        except CalibrationError as error:
            refusals.append(Refusal(float(poses["start_s"][k + 1]), str(error)))
            continue
        refusals += [Refusal(float(poses["start_s"][k + 1]), why) for why in turns.left_out]
        for turn in turns.truth:
            count["xyz"[int(np.argmax(np.abs(turn)))]] += 1
    return count, refusals


def _refused(columns: ImuColumns, poses: Rows) -> list[Refusal]:
    """Return the tries at a pose that were too short, trembled, or were pushed."""
    windows, limits = windows_of(columns), Stillness()
    if not len(windows.is_still):
        return []
    rest = np.median(poses["gyro_rad_s"], axis=0) if len(poses) else np.zeros(3)
    length_s = windows.length * columns.interval_s
    held = np.all(np.abs(windows.gyro - rest) < _HELD_RAD_S, axis=1)
    refusals = []
    for first, last in find_runs(held, windows.accel, 1.0):
        begin_s = float(columns.time_s[first * windows.length])
        end_s = float(columns.time_s[last * windows.length - 1])
        is_pose = (poses["start_s"] < end_s) & (poses["stop_s"] > begin_s)
        if is_pose.any() or last == len(held) or last - first < 2:
            continue
        still = windows.is_still[first:last]
        if still.sum() >= 2:
            why = f"at rest for {still.sum() * length_s:.1f} s only: give it {limits.least_s:g} s"
            refusals.append(Refusal(end_s, why))
        elif (last - first + 0.5) * length_s >= _HELD_S:
            scatter = math.degrees(float(np.median(windows.gyro_scatter[first:last].max(axis=1))))
            why = f"trembles by {scatter:.1f} deg/s: put it on something solid and let go"
            refusals.append(Refusal(end_s, why))
    norm = np.linalg.norm(poses["accel_m_s2"], axis=1)
    for pose, size in zip(poses, norm, strict=True):
        if abs(size / (np.median(norm) or STANDARD_GRAVITY_M_S2) - 1.0) > _PUSHED:
            why = f"a force of {size:.2f} m/s^2 where other poses have {np.median(norm):.2f}"
            refusals.append(Refusal(float(pose["stop_s"]), f"{why}: is it being pushed or shaken?"))
    return refusals


def _state(columns: ImuColumns, poses: Rows) -> str:
    """Say what the unit does now."""
    windows = windows_of(columns)
    if not len(windows.is_still):
        return "waiting for samples"
    try:
        check_stream_unit(columns)
    except CalibrationError as error:
        return str(error)
    moves = np.flatnonzero(~windows.is_still)
    still = len(windows.is_still) - 1 - (int(moves[-1]) if len(moves) else -1)
    if still <= 0:
        scatter = math.degrees(float(windows.gyro_scatter[-1].max()))
        return f"moving (the rate scatters by {scatter:.1f} deg/s)"
    degc = columns.temperature_degc[-1]
    warm = f", {degc:.1f} degC" if math.isfinite(degc) else ""
    return f"still for {still * windows.length * columns.interval_s:.1f} s{warm}"


def _emptiest(up: Floats) -> Floats:
    """Return the direction [3] that is furthest from all of `up`."""
    points = lattice()
    if not len(up):
        return np.array([0.0, 0.0, -1.0])
    furthest: Floats = points[int(np.argmin((points @ up.T).max(axis=1)))]
    return furthest


def _where(up: Floats) -> str:
    """Describe a direction in words: the faces that are up, the most upward first."""
    faces = [(f"{'+' if up[k] > 0 else '-'}{axis}", abs(up[k])) for k, axis in enumerate("xyz")]
    named = sorted((face for face in faces if face[1] > 0.35), key=lambda face: -face[1])
    return " and ".join(FACE_WORDS[face].split(",")[0] for face, _ in named)
