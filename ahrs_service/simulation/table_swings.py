"""True motion of a sensor on a rate table that swings (Liu et al., sec. 5).

The table turns about one axis that is fixed in the sensor and in the laboratory, by

    angle(t) = A s(t) sin(w t),  w = peak rate / A

from rest and back to rest: s rises from 0 to 1 and falls again with continuous angular
acceleration. The sensor is off the axis by the arm L, so it also feels dw/dt x L + w x (w x L).
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

RAMP_SWINGS: Final = 2.0
"""Swings until the amplitude is full, and from there to rest."""

_REST_S: Final = 10.0


@dataclass(frozen=True, slots=True)
class Swing:
    """A swing about `axis` (body axes, any length) with the seed's amplitude and largest rate.

    `arm_m` is where the sensor lies from the axis, in body axes: fixtures hold it near.
    """

    axis: Vector
    amplitude_deg: float = 80.0
    peak_rate_deg_s: float = 200.0
    arm_m: Vector = (0.03, 0.0, 0.02)

    @property
    def unit(self) -> Floats:
        """Axis [3] of length 1, in body axes."""
        return np.array(self.axis) / math.hypot(*self.axis)

    def truth(self, phases: tuple[Phase, ...], heading_rad: float, time_s: Floats) -> Rows:
        """Return the true motion [N] TRUTH_DTYPE of the plan at the times [N] [s]."""
        begin_s = phases[0].seconds
        angle, rate, acceleration = self._angle(time_s - begin_s, phases[1].seconds)
        half = 0.5 * angle[:, None]
        turn = np.concatenate([np.cos(half), np.sin(half) * self.unit], axis=1)
        level = quaternion_columns(np.array([[0.0, 0.0, heading_rad]]))
        attitude = multiply_columns(np.broadcast_to(level, turn.shape), turn)
        spin, spin_up = rate[:, None] * self.unit, acceleration[:, None] * self.unit
        arm = np.broadcast_to(self.arm_m, spin.shape)
        velocity = np.cross(spin, arm)
        force = np.cross(spin_up, arm) + np.cross(spin, velocity)
        up = np.array([0.0, 0.0, -STANDARD_GRAVITY_M_S2])
        force += rotate_columns(inverse_columns(attitude), up)
        rows = np.zeros(len(time_s), TRUTH_DTYPE)
        rows["time_s"] = time_s
        rows["ned_from_body"] = attitude
        rows["rate_rad_s"] = spin
        rows["force_m_s2"] = force
        rows["velocity_ned_m_s"] = rotate_columns(attitude, velocity)
        place = rotate_columns(attitude, arm)
        rows["position_ned_m"] = place - place[0]
        return rows

    def _angle(self, time_s: Floats, seconds: float) -> tuple[Floats, Floats, Floats]:
        """Angle [rad] and its first two derivatives [N] at times since the swing began [s]."""
        amplitude = math.radians(self.amplitude_deg)
        turn = math.radians(self.peak_rate_deg_s) / amplitude
        ramp_s = min(RAMP_SWINGS * 2.0 * math.pi / turn, 0.5 * seconds)
        size, slope, bend = smooth_step(np.minimum(time_s, seconds - time_s) / ramp_s)
        slope = slope * np.where(time_s < 0.5 * seconds, 1.0, -1.0) / ramp_s
        bend = bend / ramp_s**2
        sine, cosine = np.sin(turn * time_s), np.cos(turn * time_s)
        angle = size * sine
        rate = slope * sine + size * turn * cosine
        acceleration = bend * sine + 2.0 * slope * turn * cosine - size * turn**2 * sine
        return amplitude * angle, amplitude * rate, amplitude * acceleration


def table_phases(seconds: float) -> tuple[Phase, ...]:
    """Return a plan of `seconds` [s]: at rest, swinging, at rest again."""
    rest_s = min(_REST_S, 0.2 * seconds)
    names = {"at rest": rest_s, "swing": seconds - 1.5 * rest_s, "stopped": 0.5 * rest_s}
    return tuple(
        Phase(name, length, speed_m_s=0.0, throttle=0.0, is_airborne=False)
        for name, length in names.items()
    )
