"""Attitude by a GPS and an IMU after the flight, from first principles: a reference to judge by.

A smoother (Rauch, Tung, Striebel) in Gauss-Newton steps over the fixes of a GPS, which shares with
the service's filter nothing but the IMU: it knows no class of airframe, no rest, no gravity gate
and no heading, and it takes the velocity over ground that the service without aid never sees.

Nodes k are the instants of the fixes, the GPS's lag taken off. Between them the samples, linear in
time, are integrated with the corrections w = (1 + G) gyro - b and f = (1 + diag(s)) force - c:

    R <- R exp(w dt),    v <- v + (R f + g) dt,    h <- h - v_down dt

An error state holds phi (R_true = exp(phi) R, earth axes), v, h, b, c (random walks), G, s, and the
lag's error (constants), `STATES` of them. A fix shows v and, where the receiver does not measure
v_down, the height h. Weights are those of a Student distribution of four degrees of freedom
(a GPS on its back loses satellites); the noise of its velocity is estimated with them (EM). Each
step solves the linear problem around the last trajectory, the misfit of that trajectory to the
samples included, so nothing is approximated once it has settled, and where it began is forgotten.

A constant error of the accelerometer along with a tilt is hardly seen: what the accelerometers show
in the mean is 0 within START's 1-sigma of c. `sigma_rad` has that in it.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from scipy.spatial.transform import Rotation
from tilt_witness import carried, interpolated

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.records import Floats
from ahrs_service.rotation import rotate_columns

PHI, VEL, HEIGHT, GYRO, FORCE = 0, 3, 6, 7, 10
MATRIX, SCALE, LAG, STATES = 13, 22, 25, 26
LONGEST_GAP_S = 0.5
STUDENT = 4.0
STEPS = 10
LEAST_VELOCITY_M_S = 0.05
HEIGHT_M = 1.0


@dataclass(frozen=True)
class Noise:
    """Standard deviations; the sensors' as broad as any small vehicle's are.

    White noise of gyro [rad/sqrt(s)] and force [m/s/sqrt(s)], walks of their biases [rad/s and
    m/s^2 per sqrt(s)] and of the height [m/sqrt(s)], the fix's velocity [m/s] to begin with.
    """

    gyro: float = 3e-3
    force: float = 0.1
    gyro_walk: float = 1e-4
    force_walk: float = 1e-3
    height_walk: float = 0.1
    fix_velocity: float = 0.3


_NOISE = Noise()

START = np.concatenate(
    [[0.5] * 2, [3.0], [5.0] * 3, [20.0], [0.05] * 3, [0.1] * 3, [0.005] * 9, [0.02] * 3, [0.2]]
)
"""1-sigma [STATES] at the begin; after a gap of the samples, those of the first seven again."""
ONE_DIE = 0.92
"""Correlation of G's elements ij and ji: it leaves 1 mrad for a turn of the gyros against the
accelerometers of the same die. More would be a turn of the mounting, which no GPS can tell."""


def first_covariance() -> Floats:
    """Covariance [STATES, STATES] at the begin."""
    first = np.diag(START**2)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        a, b = MATRIX + 3 * i + j, MATRIX + 3 * j + i
        first[a, b] = first[b, a] = ONE_DIE * START[a] * START[b]
    return first


@njit(cache=True)
def _exp(x: float, y: float, z: float) -> Floats:
    angle = math.sqrt(x * x + y * y + z * z)
    a = math.sin(angle) / angle if angle > 1e-9 else 1.0
    b = (1.0 - math.cos(angle)) / (angle * angle) if angle > 1e-5 else 0.5
    out = np.empty((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    out[1, 0], out[1, 1], out[1, 2] = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
    out[2, 0], out[2, 1], out[2, 2] = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)
    return out


@njit(cache=True)
def _log(r: Floats) -> Floats:
    x, y, z = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    sine = 0.5 * math.sqrt(x * x + y * y + z * z)
    angle = math.atan2(sine, 0.5 * (r[0, 0] + r[1, 1] + r[2, 2] - 1.0))
    scale = 0.5 * angle / sine if sine > 1e-9 else 0.5
    return np.array([scale * x, scale * y, scale * z])


@njit(cache=True)
def _between(
    dt: Floats, gyro: Floats, force: Floats, r0: Floats, x: Floats, f: Floats
) -> tuple[Floats, Floats, float]:
    """Integrate steps `dt` [n] from attitude r0 and state x; write F; return R and v, h at the end.

    `gyro`, `force` [n, 3] are means over the steps; the rows of F are of earth axes at the end.
    """
    r, v, h = r0.copy(), x[VEL : VEL + 3].copy(), x[HEIGHT]
    turn = np.zeros((3, 12))
    f[:] = np.eye(STATES)
    total = 0.0
    for n in range(len(dt)):
        w, a = np.empty(3), np.empty(3)
        for i in range(3):
            w[i] = gyro[n, i] - x[GYRO + i]
            for j in range(3):
                w[i] += x[MATRIX + 3 * i + j] * gyro[n, j]
            a[i] = (1.0 + x[SCALE + i]) * force[n, i] - x[FORCE + i]
        w *= 0.5 * dt[n]
        half = _exp(w[0], w[1], w[2])
        middle = r @ half
        r = middle @ half
        pushed = middle @ a
        h -= (v[2] + 0.5 * (pushed[2] + STANDARD_GRAVITY_M_S2) * dt[n]) * dt[n]
        v += pushed * dt[n]
        v[2] += STANDARD_GRAVITY_M_S2 * dt[n]
        total += dt[n]
        change = np.zeros((3, 12))
        for i in range(3):
            for j in range(3):
                change[i, j] = -middle[i, j] * dt[n]
                for k in range(3):
                    change[i, 3 + 3 * j + k] = middle[i, j] * gyro[n, k] * dt[n]
        turn += 0.5 * change
        cross = np.zeros((3, 3))
        cross[0, 1], cross[0, 2], cross[1, 2] = pushed[2], -pushed[1], pushed[0]
        cross[1, 0], cross[2, 0], cross[2, 1] = -pushed[2], pushed[1], -pushed[0]
        # phi x f: of what the attitude was wrong by at first, and of what the gyro added since.
        cross *= dt[n]
        f[VEL : VEL + 3, PHI : PHI + 3] += cross
        added = cross @ turn
        f[VEL : VEL + 3, GYRO : GYRO + 3] += added[:, :3]
        f[VEL : VEL + 3, MATRIX : MATRIX + 9] += added[:, 3:]
        turn += 0.5 * change
        for i in range(3):
            for j in range(3):
                f[VEL + i, FORCE + j] -= middle[i, j] * dt[n]
                f[VEL + i, SCALE + j] += middle[i, j] * force[n, j] * dt[n]
    f[PHI : PHI + 3, GYRO : GYRO + 3] = turn[:, :3]
    f[PHI : PHI + 3, MATRIX : MATRIX + 9] = turn[:, 3:]
    for k in range(STATES):
        f[HEIGHT, k] -= 0.5 * total * f[VEL + 2, k]
    f[HEIGHT, VEL + 2] -= 0.5 * total
    return r, v, h


@njit(cache=True)
def _update(
    d: Floats, p: Floats, fix: Floats, state: Floats, sigma: Floats, accel: Floats
) -> tuple[Floats, Floats]:
    """Take one fix [4] whose `sigma` [4] is infinite where it shows nothing, one by one."""
    for m in range(4):
        if sigma[m] < np.inf:
            late = accel[m] if m < 3 else 0.0
            i = VEL + m
            cross = p[i] - late * p[LAG]
            variance = cross[i] - late * cross[LAG] + sigma[m] ** 2
            expected = state[i] + d[i] - late * (state[LAG] + d[LAG])
            d = d + cross * ((fix[m] - expected) / variance)
            p = p - np.outer(cross, cross) / variance
    return d, 0.5 * (p + p.T)


@njit(cache=True)
def _forward(
    dt: Floats,
    gyro: Floats,
    force: Floats,
    begin: Any,
    new: Any,
    rs: Floats,
    xs: Floats,
    span: Floats,
    fix: Floats,
    sigma: Floats,
    accel: Floats,
    white: Floats,
    mean: Floats,
    first: Floats,
    out: tuple[Floats, Floats, Floats, Floats, Floats],
) -> None:
    """Kalman filter of the error state around the trajectory `rs`, `xs` [K].

    Writes F [K, S, S], means and covariances before each fix, and after it.
    """
    fs, before, p_before, after, p_after = out
    d, p = mean.copy(), first.copy()
    for k in range(len(xs)):
        drive = white**2 * span[k]
        if k > 0:
            defect = xs[k - 1] - xs[k]
            if new[k]:
                # What lay between is not known: only what changes slowly is carried over.
                fs[k] = np.diag((np.arange(STATES) >= GYRO) * 1.0)
                drive[:GYRO] = np.diag(first)[:GYRO]
                defect[:GYRO] = 0.0
            else:
                rows = slice(begin[k - 1], begin[k])
                r, v, h = _between(dt[rows], gyro[rows], force[rows], rs[k - 1], xs[k - 1], fs[k])
                defect[:VEL] = _log(r @ rs[k].T)
                defect[VEL:HEIGHT] = v - xs[k, VEL:HEIGHT]
                defect[HEIGHT] = h - xs[k, HEIGHT]
            d = fs[k] @ d + defect
            p = fs[k] @ p @ fs[k].T + np.diag(drive)
        before[k], p_before[k] = d, p
        d, p = _update(d, p, fix[k], xs[k], sigma[k], accel[k])
        after[k], p_after[k] = d, p


@njit(cache=True)
def _backward(fs: Floats, before: Floats, p_before: Floats, after: Floats, p_after: Floats) -> None:
    """Rauch, Tung, Striebel: write smoothed means and covariances over the filtered ones."""
    for k in range(len(after) - 2, -1, -1):
        gain = np.linalg.solve(p_before[k + 1], fs[k + 1] @ p_after[k]).T
        after[k] += gain @ (after[k + 1] - before[k + 1])
        p_after[k] += gain @ (p_after[k + 1] - p_before[k + 1]) @ gain.T


@dataclass(frozen=True)
class Smoothed:
    """The trajectory at the nodes `t_s` [K]: R [K, 3, 3], states, covariances, weights of velocity.

    `fix_sigma_m_s` is the noise of the GPS's velocity as estimated.
    """

    t_s: Floats
    matrix: Floats
    state: Floats
    covariance: Floats
    weight: Floats
    fix_sigma_m_s: float

    @property
    def sigma_rad(self) -> Floats:
        """1-sigma [K] of the tilt."""
        return np.sqrt(self.covariance[:, 0, 0] + self.covariance[:, 1, 1])


class GpsSmoother:
    """The samples of a flight and the fixes of its GPS, ready to be smoothed."""

    def __init__(
        self, t_s: Floats, gyro: Floats, force: Floats, fix_s: Floats, fix: Floats, lag_s: float
    ) -> None:
        """Samples [N] at `t_s`; fixes [K, 4] (v north, east, down, height; NaN: none) at `fix_s`.

        What is left of the lag after `lag_s` is estimated.
        """
        node_s = fix_s - lag_s
        self.inside = (node_s > t_s[0]) & (node_s < t_s[-1])
        self.node_s, self.fix = node_s[self.inside], fix[self.inside]
        self._samples = t_s, gyro, force
        grid = np.union1d(t_s, self.node_s)
        middle, dt = 0.5 * (grid[1:] + grid[:-1]), np.diff(grid)
        begin = np.searchsorted(grid, self.node_s)
        # Steps lie between neighbouring samples, or a node and a sample: linear in time.
        means = [
            np.stack([np.interp(middle, t_s, column[:, i]) for i in range(3)], axis=1)
            for column in (gyro, force)
        ]
        longest = np.maximum.reduceat(dt, begin[:-1])
        self.new = np.concatenate([[False], longest > LONGEST_GAP_S])
        self._steps = dt, *means, begin, self.new

    def smooth(
        self, start: Floats, used: Any = None, noise: Noise = _NOISE, steps: int = STEPS
    ) -> Smoothed:
        """Smooth from a first guess of the attitude [N, 4] at the samples on.

        Only the fixes `used` [K] are heard, all where it is None.
        """
        count = len(self.node_s)
        known = np.isfinite(self.fix) & (True if used is None else used[:, None])
        fix = np.where(known, self.fix, 0.0)
        rs = _matrices(interpolated(self._samples[0], start, self.node_s))
        xs = np.zeros((count, STATES))
        for m in range(4):
            good = known[:, m]
            if good.any():
                xs[:, VEL + m] = np.interp(self.node_s, self.node_s[good], fix[good, m])
        first, white = first_covariance(), _white(noise)
        span = np.diff(self.node_s, prepend=self.node_s[0])
        weight, velocity = np.ones(count), noise.fix_velocity
        for _ in range(steps):
            sigma = np.where(known, velocity / np.sqrt(weight)[:, None], np.inf)
            sigma[:, 3] = np.where(known[:, 3], HEIGHT_M, np.inf)
            accel = np.gradient(xs[:, VEL:HEIGHT], self.node_s, axis=0)
            mean = -xs[0]
            mean[VEL:GYRO] = 0.0
            out = _arrays(count)
            _forward(*self._steps, rs, xs, span, fix, sigma, accel, white, mean, first, out)
            _backward(*out)
            change, covariance = out[3], out[4]
            rs = np.stack([_exp(*phi) @ r for phi, r in zip(change[:, :3], rs, strict=True)])
            xs[:, VEL:] += change[:, VEL:]
            power = _power(known, fix, xs, accel, covariance)
            number = known[:, :3].sum(axis=1)
            weight = (STUDENT + number) / (STUDENT + power / velocity**2)
            velocity = max(LEAST_VELOCITY_M_S, float(np.sqrt(weight @ power / number.sum())))
        return Smoothed(self.node_s, rs, xs, covariance, weight, velocity)

    def attitude(self, one: Smoothed) -> Floats:
        """Attitudes [N, 4] at the samples: the gyro, corrected, tells what lies between nodes."""
        t_s, gyro, _ = self._samples
        state = at_samples(t_s, one)
        matrix = state[:, MATRIX:SCALE].reshape(-1, 3, 3)
        rate = gyro + np.einsum("nij,nj->ni", matrix, gyro) - state[:, GYRO:FORCE]
        return carried(t_s, rate, one.t_s, _quaternions(one.matrix))

    def force(self, one: Smoothed) -> Floats:
        """Specific force [N, 3] at the samples, corrected."""
        t_s, _, force = self._samples
        state = at_samples(t_s, one)
        return (1.0 + state[:, SCALE:LAG]) * force - state[:, FORCE:MATRIX]


def at_samples(t_s: Floats, one: Smoothed) -> Floats:
    """States [N, STATES] at `t_s` [N]."""
    return np.stack([np.interp(t_s, one.t_s, column) for column in one.state.T], axis=1)


def _power(known: Any, fix: Floats, xs: Floats, accel: Floats, covariance: Floats) -> Floats:
    """Squared misfit of velocity [K] that is to be expected, the state's own error included."""
    h = np.zeros((len(xs), 3, STATES))
    h[:, range(3), range(VEL, HEIGHT)] = 1.0
    h[:, :, LAG] = -accel
    left = fix[:, :3] - xs[:, VEL:HEIGHT] + accel * xs[:, LAG, None]
    power = left**2 + np.einsum("kmi,kij,kmj->km", h, covariance, h)
    return np.asarray(np.where(known[:, :3], power, 0.0).sum(axis=1))


def _white(noise: Noise) -> Floats:
    white = np.zeros(STATES)
    white[:VEL], white[VEL:HEIGHT], white[HEIGHT] = noise.gyro, noise.force, noise.height_walk
    white[GYRO:FORCE], white[FORCE:MATRIX] = noise.gyro_walk, noise.force_walk
    return white


def _arrays(count: int) -> tuple[Floats, ...]:
    vector, square = (count, STATES), (count, STATES, STATES)
    return tuple(np.zeros(shape) for shape in (square, vector, square, vector, square))


def _matrices(q: Floats) -> Floats:
    axes = (np.broadcast_to(axis, (len(q), 3)) for axis in np.eye(3))
    return np.stack([rotate_columns(q, axis) for axis in axes], axis=2)


def _quaternions(matrix: Floats) -> Floats:
    return np.asarray(Rotation.from_matrix(matrix).as_quat()[:, [3, 0, 1, 2]])
