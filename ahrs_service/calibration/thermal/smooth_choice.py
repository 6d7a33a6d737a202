"""How flexible the smooth thermal model may be: as flexible as held-out blocks of time bear.

Each axis has its own parts and so its own curves; those of bias and of scale are chosen in turn,
each while the other is held.
"""

from typing import Final

import numpy as np

from ahrs_service.calibration.thermal.basis import LADDER
from ahrs_service.calibration.thermal.rows import ThermalRows
from ahrs_service.calibration.thermal.smooth_drift import AxisProblem, Scale, Structure
from ahrs_service.records import Floats, Integers

FOLDS: Final = 11  # A choice: a prime near ten, so that SESSION_BLOCKS is no multiple of it
SESSION_BLOCKS: Final = 20
"""No multiple of FOLDS: like times of two sessions, and so like temperatures, are not held out
together."""
ROWS_EACH: Final = 5  # A choice: rows asked for each coefficient
SEGMENT_DEGC: Final = 5.0
"""Width of the paper's segments, in which a part's curve is taken as straight."""
_LEAST_ROWS: Final = 2  # A choice: least rows of a block, so that neighbours are held out together
_INPUT_TO_DRIFT: Final = 10.0
"""A choice: by how much more than the drift the inputs of a scale must differ."""


def time_folds(rows: ThermalRows, folds: int = FOLDS) -> Integers:
    """Return the number [N] of the fold that each row belongs to.

    Each session is cut into SESSION_BLOCKS contiguous blocks of time, dealt out to the folds in
    turn: neighbours in time are held out together.
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


def scale_kinds(rows: ThermalRows, level_output: Floats, axis: int) -> tuple[Scale, ...]:
    """Return what these levels [P, 3] can determine of an axis's scale.

    Its own input's where that differs by half of the largest input, and by far more than the bias
    drifts: scale drifts by per cents. That of all inputs where the levels differ in all three
    directions by as much.
    """
    largest = np.abs(level_output).max()
    drift = (rows.output - level_output[rows.level]).std(axis=0).max()
    if np.ptp(level_output[:, axis]) <= max(0.5 * largest, _INPUT_TO_DRIFT * drift):
        return (Scale.NONE,)
    singular = np.linalg.svd(level_output - level_output.mean(axis=0), compute_uv=False)
    if len(level_output) < 4 or singular[-1] < 0.5 * largest:
        return (Scale.NONE, Scale.OWN)
    return (Scale.NONE, Scale.OWN, Scale.ALL)


class Choice:
    """Held-out residuals of structures for one axis of some rows, each computed once."""

    def __init__(self, rows: ThermalRows, axis: int, zero_degc: float, folds: int = FOLDS) -> None:
        self._rows, self._axis, self._zero = rows, axis, zero_degc
        self._u, self._fold = level_outputs(rows), time_folds(rows, folds)
        self._rests: dict[Structure, Floats] = {}

    def rest(self, structure: Structure) -> Floats:
        """Return the held-out residual [N]."""
        if structure not in self._rests:
            problem = AxisProblem(
                self._rows, self._axis, structure, self._zero, self._u, self._fold
            )
            self._rests[structure] = problem.held_out()
        return self._rests[structure]

    def rms(self, structure: Structure) -> float:
        """Return the RMS held-out residual."""
        return float(np.sqrt(np.mean(self.rest(structure) ** 2)))

    def best(self, candidates: list[Structure]) -> Structure:
        """Return the structure of the least held-out residual among those the rows can bear.

        Those are the structures with ROWS_EACH rows or more for each coefficient, whose curves bend
        no faster than the paper's table: a coefficient for each SEGMENT_DEGC of the span, and the
        slope. The least held-out residual predicts best (Li, Annals of Statistics 15, 1987).
        """
        low, high = self._rows.span_degc
        most = 1 + round((high - low) / SEGMENT_DEGC)
        bearable = [
            one
            for one in candidates
            if one.size * ROWS_EACH <= len(self._rows)
            and max(sum(one.bias), sum(one.scale)) - 1 <= most
        ]
        return min(bearable, key=lambda one: (self.rms(one), one.size))

    def structure(self, start: Structure, passes: int) -> Structure:
        """Return the structure that the held-out blocks of time support, starting from `start`."""
        kinds = scale_kinds(self._rows, self._u, self._axis)
        now = start
        for _ in range(passes if len(kinds) > 1 else 1):
            now = self.best([Structure(bias, now.scale, now.kind) for bias in LADDER])
            scales = [(order, kind) for kind in kinds if kind for order in LADDER[1:]]
            options = [Structure(now.bias, order, kind) for order, kind in scales]
            now = self.best([Structure(now.bias), *options])
        return now
