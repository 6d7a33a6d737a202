"""How flexible the smooth thermal model may be: as flexible as held-out blocks of time bear.

The curves of bias and of scale are chosen in turn, each while the other is held.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.calibration.coloured import inflation
from ahrs_service.calibration.smooth_drift import Problem, Scale, Structure
from ahrs_service.calibration.temperature_basis import LADDER
from ahrs_service.calibration.thermal_rows import ThermalRows
from ahrs_service.records import Floats, Integers

FOLDS: Final = 10
SESSION_BLOCKS: Final = 20
_LEAST_ROWS: Final = 2
_PASSES: Final = 2


@dataclass(frozen=True, slots=True)
class HeldOut:
    """RMS of held-out rows per axis [3]: `before`, levels alone; `after`, with the curves."""

    before: Floats
    after: Floats


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
    rows: ThermalRows, zero_degc: float, folds: int = FOLDS
) -> tuple[Structure, HeldOut]:
    """Return the structure that held-out blocks of time speak for, and what they show."""
    choice = _Choice(rows, zero_degc, folds)
    kinds = scale_kinds(level_outputs(rows))
    now = Structure()
    for _ in range(_PASSES):
        now = choice.best([Structure(bias, now.scale, now.kind) for bias in LADDER])
        scales = [(order, kind) for kind in kinds if kind for order in LADDER[1:]]
        options = [Structure(now.bias, order, kind) for order, kind in scales]
        now = choice.best([Structure(now.bias), *options])
    return now, HeldOut(choice.rms(Structure()), choice.rms(now))
