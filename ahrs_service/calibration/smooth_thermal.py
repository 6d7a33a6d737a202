"""The smooth thermal fit: curves as flexible as held-out data bear, and the thermometer's lag.

Order: the curves' structure is chosen by cross-validation over contiguous blocks of time, each
curve in turn while the other is held; then the lag by the likelihood of the residual, all else
fitted anew at each lag (profile likelihood); then the structure once more at that lag.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from ahrs_service.calibration.coloured import inflation
from ahrs_service.calibration.smooth_drift import Curves, Problem, Scale, Structure
from ahrs_service.calibration.temperature_basis import LADDER
from ahrs_service.calibration.thermal_rows import ThermalRows
from ahrs_service.records import Floats, Integers
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import TriadCalibration

FOLDS: Final = 10
SESSION_BLOCKS: Final = 20
_LEAST_ROWS: Final = 5
LARGEST_LAG_S: Final = 180.0
_HALF_CHI2: Final = 0.5 * 3.841
"""Drop of the log likelihood at the ends of a 95 % interval (chi-squared of one parameter)."""


@dataclass(frozen=True, slots=True)
class HeldOut:
    """RMS of held-out rows per axis [3]: `before`, levels alone; `after`, with the curves."""

    before: Floats
    after: Floats


@dataclass(frozen=True, slots=True)
class Lag:
    """Lag of the elements behind the thermometer [s] and its 95 % interval.

    `is_told` is false where the interval is no narrower than what was searched, or holds 0: then
    the lag is taken as 0.
    """

    lag_s: float
    low_s: float
    high_s: float
    is_told: bool

    @property
    def sigma_s(self) -> float:
        """Standard error, from the interval."""
        return (self.high_s - self.low_s) / 3.92


@dataclass(frozen=True, slots=True)
class SmoothFit:
    """What was found: curves, lag, held-out figures, residual [N, 3] of all rows.

    `inflation` [3] of the variance by the residual's colour.
    """

    rows: ThermalRows
    curves: Curves
    lag: Lag
    held_out: HeldOut
    residual: Floats
    inflation: Floats


def time_folds(rows: ThermalRows, folds: int = FOLDS) -> Integers:
    """Return the number [N] of the fold that each row belongs to.

    Each session is cut into SESSION_BLOCKS contiguous blocks of time, dealt out to the folds in
    turn: neighbours in time are held out together, and no fold takes a whole end of the span.
    """
    fold, first = np.empty(len(rows), np.int64), 0
    for number in np.unique(rows.session):
        own = np.flatnonzero(rows.session == number)
        blocks = int(np.clip(len(own) // _LEAST_ROWS, 1, SESSION_BLOCKS))
        fold[own] = (first + np.arange(len(own)) * blocks // len(own)) % folds
        first += blocks
    return fold


def level_outputs(rows: ThermalRows) -> Floats:
    """Return the mean output of each level [P, 3]: u_p to a per cent."""
    marks = np.bincount(rows.level, minlength=rows.levels)
    sums = [np.bincount(rows.level, rows.output[:, i], rows.levels) for i in range(3)]
    return np.stack(sums, axis=1) / marks[:, None]


def scale_kinds(level_output: Floats) -> tuple[Scale, ...]:
    """Return what of the scale these levels [P, 3] can tell.

    An axis tells its scale when its inputs differ by half of the largest input; the matrix needs
    levels that differ in all three directions by as much.
    """
    largest = np.abs(level_output).max()
    spread = np.ptp(level_output, axis=0)
    if len(level_output) < 2 or not (spread > 0.5 * largest).all():
        return (Scale.NONE,)
    singular = np.linalg.svd(level_output - level_output.mean(axis=0), compute_uv=False)
    if len(level_output) < 4 or singular[-1] < 0.5 * largest:
        return (Scale.NONE, Scale.AXES)
    return (Scale.NONE, Scale.AXES, Scale.MATRIX)


class _Choice:
    """Held-out residuals of structures for some rows, each computed once."""

    def __init__(self, rows: ThermalRows, zero_degc: float, folds: int) -> None:
        self._rows, self._zero = rows, zero_degc
        self._u, self._block = level_outputs(rows), time_folds(rows, folds)
        self._folds = int(self._block.max()) + 1
        self._rests: dict[Structure, Floats] = {}

    def rest(self, structure: Structure) -> Floats:
        """Return the held-out residual [N, 3]."""
        if structure not in self._rests:
            problem = Problem(self._rows, structure, self._zero, self._u, self._block)
            rest = np.empty((len(self._rows), 3))
            for block in range(self._folds):
                own = self._block == block
                rest[own] = problem.residual(problem.fit(leave_out=block), block)
            self._rests[structure] = rest
        return self._rests[structure]

    def rms(self, structure: Structure) -> Floats:
        """Return the RMS held-out residual per axis [3]."""
        rms: Floats = np.sqrt(np.mean(self.rest(structure) ** 2, axis=0))
        return rms

    def best(self, candidates: list[Structure]) -> Structure:
        """Return the smallest structure that held-out rows do not tell from the best.

        The scores are mean squares relative to the best one's, averaged over the axes. Of n
        independent Gauss values a mean square is known to sqrt(2 / n) of itself; colour leaves
        n / inflation of n rows.
        """
        squares = [self.rms(one) ** 2 for one in candidates]
        winner = int(np.argmin([np.log(np.maximum(x, 1e-300)).sum() for x in squares]))
        least = np.maximum(squares[winner], 1e-300)
        rest = self.rest(candidates[winner])
        count = sum(len(rest) / inflation(rest[:, i]) for i in range(3))
        bound = 1.0 + math.sqrt(2.0 / count)
        near = [
            one
            for one, x in zip(candidates, squares, strict=True)
            if float(np.mean(x / least)) <= bound
        ]
        return min(near, key=lambda one: one.size)


def choose_structure(
    rows: ThermalRows, zero_degc: float, folds: int = FOLDS, passes: int = 2
) -> tuple[Structure, HeldOut]:
    """Return the structure that held-out blocks of time speak for, and what they show."""
    choice = _Choice(rows, zero_degc, folds)
    kinds = scale_kinds(level_outputs(rows))
    now = Structure()
    for _ in range(passes):
        now = choice.best([Structure(bias, now.scale, now.kind) for bias in LADDER])
        scales = [(order, kind) for kind in kinds if kind for order in LADDER[1:]]
        options = [Structure(now.bias, order, kind) for order, kind in scales]
        now = choice.best([Structure(now.bias), *options])
    return now, HeldOut(choice.rms(Structure()), choice.rms(now))


def estimate_lag(rows: ThermalRows, structure: Structure, zero_degc: float) -> Lag:
    """Estimate the elements' lag by the profile likelihood over -LARGEST..LARGEST_LAG_S.

    Of independent Gauss residuals the log likelihood is -n/2 log(RSS) per axis; colour leaves
    n / inflation of the n rows. A run at one constant rate cannot tell a lag from a shift of the
    temperature, and the interval then is as wide as the search.
    """
    if structure.size == 0:
        return Lag(0.0, -LARGEST_LAG_S, LARGEST_LAG_S, is_told=False)
    u, one_block = level_outputs(rows), np.zeros(len(rows), np.int64)

    def residual(lag_s: float) -> Floats:
        problem = Problem(rows.at_element(lag_s), structure, zero_degc, u, one_block)
        return problem.residual(problem.fit())

    rest = residual(0.0)

    def weights(rest: Floats) -> Floats:
        return np.array([len(rows) / inflation(rest[:, i]) for i in range(3)])

    def cost(lag_s: float) -> float:
        squares = np.einsum("ni,ni->i", *(residual(lag_s),) * 2)
        return float(0.5 * effective @ np.log(np.maximum(squares, 1e-300)))

    effective = weights(rest)
    grid = np.linspace(-1.0, 1.0, 25) ** 3 * LARGEST_LAG_S
    best = 0.0
    for _ in range(2):
        costs = [cost(x) for x in grid]
        n = int(np.clip(np.argmin(costs), 1, len(grid) - 2))
        found = minimize_scalar(cost, bounds=(grid[n - 1], grid[n + 1]), method="bounded")
        best, least = float(found.x), float(found.fun)
        effective = effective * 0.0 + weights(residual(best))
        least = cost(best)

    def above(lag_s: float) -> float:
        return cost(lag_s) - least - _HALF_CHI2

    ends = [
        brentq(above, best, end, xtol=0.01) if above(end) > 0.0 else end
        for end in (-LARGEST_LAG_S, LARGEST_LAG_S)
    ]
    inside = ends[0] > -LARGEST_LAG_S and ends[1] < LARGEST_LAG_S
    is_told = inside and not ends[0] <= 0.0 <= ends[1]
    return Lag(best if is_told else 0.0, ends[0], ends[1], is_told)


def fit_smooth(
    rows: ThermalRows, zero_degc: float, folds: int = FOLDS, with_lag: bool = True
) -> SmoothFit:
    """Fit curves and lag to `rows`; all drift is zero at `zero_degc`, which must be inside."""
    structure, _ = choose_structure(rows, zero_degc, folds)
    lag = Lag(0.0, -LARGEST_LAG_S, LARGEST_LAG_S, is_told=False)
    if with_lag:
        lag = estimate_lag(rows, structure, zero_degc)
    acting = rows.at_element(lag.lag_s)
    structure, validated = choose_structure(acting, zero_degc, folds)
    problem = Problem(
        acting, structure, zero_degc, level_outputs(acting), np.zeros(len(rows), np.int64)
    )
    curves = problem.fit()
    # The levels' means of first sight carry some drift; the fitted ones do not.
    problem = Problem(acting, structure, zero_degc, curves.levels, np.zeros(len(rows), np.int64))
    curves = problem.fit()
    residual = problem.residual(curves)
    colour = np.array([inflation(residual[:, i]) for i in range(3)])
    return SmoothFit(acting, curves, lag, validated, residual, colour)


def smooth_calibration(fit: SmoothFit, matrix: Floats, bias: Floats) -> TriadCalibration:
    """Return the triad's calibration for `matrix` K and `bias` B of the zero temperature.

    Of N = u + c(T) + b(T) u with u = K A + B follow dK = b K and the drift c + b B.
    """
    curves = fit.curves
    pieces = curves.bias_basis.polynomials(curves.bias)
    drift, matrix_drift = Curve.from_ppoly(pieces.x, pieces.c), Curve()
    if curves.structure.kind is not Scale.NONE:
        scale = curves.scale.reshape(-1, 3, 3)
        turned = curves.scale_basis.polynomials((scale @ matrix).reshape(-1, 9))
        matrix_drift = Curve.from_ppoly(turned.x, turned.c)
        lever = curves.scale_basis.polynomials(scale @ bias)
        drift = _sum(drift, Curve.from_ppoly(lever.x, lever.c))
    first, second, third = (tuple(row) for row in matrix.tolist())
    return TriadCalibration(
        matrix=(first, second, third),
        bias=tuple(bias.tolist()),
        c=drift,
        matrix_drift=matrix_drift,
        thermal_lag_s=fit.lag.lag_s,
        model="smooth",
    )


def _sum(one: Curve, other: Curve) -> Curve:
    breaks = np.unique(np.concatenate([one.breaks_degc, other.breaks_degc]))
    tables = one.on(breaks).table() + other.on(breaks).table()
    return Curve.from_ppoly(breaks, np.moveaxis(tables, -1, 0)[::-1])
