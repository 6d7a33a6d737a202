"""The motion behind a recording's reference: smoothing splines through attitude and velocity.

Model: each component of the quaternion, the velocity and, where no velocity is known, the
position is a twice integrated Wiener process seen in white noise, so that its posterior mean is
the cubic smoothing spline: the curve s that minimises (Wahba, J. R. Stat. Soc. B 40, 1978)

    sum of |y_i - s(t_i)|^2 + p * integral of |s''|^2

The penalty p [s^3] is the one whose curve through every second sample predicts the samples between
best; p = 0, the interpolating spline, is among the candidates, so that an exact reference is
followed exactly. From the splines

    w = 2 vec(conj(q) dq/dt) / |q|^2        f = R^T (dv/dt - g)

w and f are of third order in the reference's interval (f of second where it comes from positions).
What the vehicle does faster than half the reference's rate is not in it.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.interpolate import BSpline, make_smoothing_spline

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.errors import InvalidValueError
from ahrs_service.records import Floats, Rows
from ahrs_service.rotation import inverse_columns, multiply_columns, rotate_columns
from ahrs_service.simulation.trajectory import TRUTH_DTYPE

LEAST_SAMPLES: Final = 12
"""Every second sample must still make a spline, which takes five."""

_PENALTIES: Final = (0.0, *(10.0 ** np.arange(-4.0, 4.5, 0.5)).tolist())
"""Candidates of p in units of the usual interval cubed."""

_GRAVITY_NED: Final = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])


@dataclass(frozen=True, slots=True)
class ReferenceTrack:
    """A recording's data on the motion, on one clock [s]; what it lacks has no rows.

    `attitude_s` [N], `ned_from_body` [N, 4] wxyz; `velocity_s` [M], `velocity_ned_m_s` [M, 3];
    `position_s` [K], `position_ned_m` [K, 3]. Without velocity and position it is at rest.
    """

    attitude_s: Floats
    ned_from_body: Floats
    velocity_s: Floats
    velocity_ned_m_s: Floats
    position_s: Floats
    position_ned_m: Floats

    def span_s(self) -> tuple[float, float]:
        """Return the first and last time that all parts cover."""
        parts = [time_s for time_s in (self.attitude_s, *self._translation()[:1]) if len(time_s)]
        return max(float(part[0]) for part in parts), min(float(part[-1]) for part in parts)

    def motion(self, time_s: Floats) -> Rows:
        """Return the motion [N] TRUTH_DTYPE at the times [N] [s]; ValueError where it cannot be.

        Position is from the start; speed stands for airspeed; throttle is left at 0.
        """
        rows = np.zeros(len(time_s), TRUTH_DTYPE)
        rows["time_s"] = time_s
        q, rate = self._rotation(time_s)
        rows["ned_from_body"], rows["rate_rad_s"] = q, rate
        acceleration = np.zeros((len(time_s), 3))
        when, what, order = self._translation()
        if len(when):
            curve = smooth(when, what, "velocity" if order == 1 else "position")
            velocity = curve if order == 1 else curve.derivative()
            place = velocity.antiderivative()
            rows["velocity_ned_m_s"] = velocity(time_s)
            rows["position_ned_m"] = place(time_s) - place(time_s[:1])
            acceleration = velocity.derivative()(time_s)
        rows["force_m_s2"] = rotate_columns(inverse_columns(q), acceleration - _GRAVITY_NED)
        rows["airspeed_m_s"] = np.linalg.norm(rows["velocity_ned_m_s"], axis=1)
        return rows

    def _translation(self) -> tuple[Floats, Floats, int]:
        """Times and values of the data for the translation, and how often that was derived."""
        if len(self.velocity_s):
            return self.velocity_s, self.velocity_ned_m_s, 1
        return self.position_s, self.position_ned_m, 0

    def _rotation(self, time_s: Floats) -> tuple[Floats, Floats]:
        curve = smooth(self.attitude_s, continuous(self.ned_from_body), "attitude")
        q, slope = curve(time_s), curve.derivative()(time_s)
        norm2 = (q * q).sum(axis=1, keepdims=True)
        rate = 2.0 * multiply_columns(inverse_columns(q), slope)[:, 1:] / norm2
        return q / np.sqrt(norm2), rate


def continuous(q: Floats) -> Floats:
    """Return quaternions [N, 4] each with the sign that is nearer to the one before."""
    flips = np.where((q[1:] * q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    return q * np.concatenate([[1.0], np.cumprod(flips)])[:, None]


def smooth(time_s: Floats, values: Floats, name: str) -> BSpline:
    """Return the smoothing spline through columns `values` [N, M] at rising times [N] [s].

    ValueError with `name` where the samples are too few.
    """
    if len(time_s) < LEAST_SAMPLES:
        raise InvalidValueError(
            f"the reference has {len(time_s)} samples of {name}, {LEAST_SAMPLES} are needed: "
            "give a longer recording or one with more frequent references"
        )
    unit = float(np.median(np.diff(time_s))) ** 3
    between = slice(1, len(time_s) - 1, 2)
    scores = []
    for penalty in _PENALTIES:
        half = make_smoothing_spline(time_s[::2], values[::2], lam=penalty * unit)
        scores.append(float(np.square(half(time_s[between]) - values[between]).sum()))
    best = _PENALTIES[int(np.argmin(scores))]
    curve: BSpline = make_smoothing_spline(time_s, values, lam=best * unit)
    return curve
