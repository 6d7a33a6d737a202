"""True motion of a unit that is put from pose to pose by hand or on a fixture: turn, hold, turn.

Each turn is about one axis that is fixed in the unit; its angle rises with continuous angular
acceleration, so nothing jumps. Between turns the unit lies still, and gravity is all it feels.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.records import Floats, Rows
from ahrs_service.rotation import (
    inverse_columns,
    multiply_columns,
    quaternion_columns,
    rotate_columns,
)
from ahrs_service.sensor.parameters import Vector
from ahrs_service.simulation.phases import Phase
from ahrs_service.simulation.spline import smooth_step
from ahrs_service.simulation.trajectory import TRUTH_DTYPE

_DEG_S: Final = 60.0
"""Mean rate of the turns [deg/s]."""


@dataclass(frozen=True, slots=True)
class Turn:
    """A turn of the unit about its own `axis` (body axes, any length) by `angle_deg`."""

    axis: Vector
    angle_deg: float

    @property
    def seconds(self) -> float:
        """How long it takes [s]."""
        return abs(self.angle_deg) / _DEG_S


@dataclass(frozen=True, slots=True)
class PoseSequence:
    """Poses reached by turns, one after the other, from level."""

    turns: tuple[Turn, ...]

    def phases(self, seconds: float) -> tuple[Phase, ...]:
        """Return the plan: all turns, and before, between and after them equal times at rest."""
        hold_s = (seconds - sum(turn.seconds for turn in self.turns)) / (len(self.turns) + 1)
        rest = _phase("at rest", max(hold_s, 0.0))
        return (rest, *(p for turn in self.turns for p in (_phase("turn", turn.seconds), rest)))

    def truth(self, phases: tuple[Phase, ...], heading_rad: float, time_s: Floats) -> Rows:
        """Return the true motion [N] TRUTH_DTYPE of the plan at the times [N] [s]."""
        ends = np.cumsum([phase.seconds for phase in phases])
        attitude = np.empty((len(time_s), 4))
        rate = np.zeros((len(time_s), 3))
        before = quaternion_columns(np.array([[0.0, 0.0, heading_rad]]))
        attitude[:] = before
        for turn, begin_s in zip(self.turns, ends[::2], strict=False):
            now = time_s >= begin_s
            share, slope = smooth_step((time_s[now] - begin_s) / turn.seconds)[:2]
            angle = math.radians(turn.angle_deg)
            unit = np.array(turn.axis) / math.hypot(*turn.axis)
            rate[now] = (slope * angle / turn.seconds)[:, None] * unit
            attitude[now] = multiply_columns(before, _about(unit, share * angle))
            before = multiply_columns(before, _about(unit, np.array([angle])))
        rows = np.zeros(len(time_s), TRUTH_DTYPE)
        rows["time_s"] = time_s
        rows["ned_from_body"] = attitude
        rows["rate_rad_s"] = rate
        up = np.array([0.0, 0.0, -STANDARD_GRAVITY_M_S2])
        rows["force_m_s2"] = rotate_columns(inverse_columns(attitude), up)
        return rows


def _phase(name: str, seconds: float) -> Phase:
    return Phase(name, seconds, speed_m_s=0.0, throttle=0.0, is_airborne=False)


def _about(unit: Floats, angle_rad: Floats) -> Floats:
    half = 0.5 * angle_rad[:, None]
    quaternion: Floats = np.concatenate([np.cos(half), np.sin(half) * unit], axis=1)
    return quaternion


_X: Final = (1.0, 0.0, 0.0)
_Y: Final = (0.0, 1.0, 0.0)
_Z: Final = (0.0, 0.0, 1.0)


def six_positions() -> PoseSequence:
    """Return the unit on each of its faces, and on three of them full circles there and back.

    The circles are about the vertical, which is then z, y and x of the unit in turn.
    """
    return PoseSequence(
        (
            *(Turn(_Z, 360.0), Turn(_Z, -360.0)),
            Turn(_X, 90.0),
            *(Turn(_Y, 360.0), Turn(_Y, -360.0)),
            *(Turn(_X, 90.0), Turn(_X, 90.0), Turn(_X, 90.0)),
            Turn(_Y, 90.0),
            *(Turn(_X, 360.0), Turn(_X, -360.0)),
            Turn(_Y, -180.0),
        )
    )


def many_poses(count: int = 20, seed: int = 7) -> PoseSequence:
    """Return `count` poses reached by turns of 60 to 150 deg about axes of all directions."""
    rng = np.random.default_rng(seed)
    axes, angles = rng.normal(size=(count - 1, 3)), rng.uniform(60.0, 150.0, count - 1)
    return PoseSequence(
        tuple(Turn((x, y, z), a) for (x, y, z), a in zip(axes.tolist(), angles, strict=True))
    )
