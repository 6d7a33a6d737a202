"""Rows with a velocity measurement, where velocity is reported less often than attitude."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ahrs_service.records import Floats

Places = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Instants:
    """Instants of a measurement, one for each of the `rows` [K] nearest to them.

    `taken` [K] the index of the measurement; it is later than instant `before` [K] of a finer
    grid by `share` [K] of the grid's step. `count` the number of rows.
    """

    rows: Places
    taken: Places
    before: Places
    share: Floats
    count: int

    def measured(self, values: Floats) -> Floats:
        """Return the rows [count, 3] of values [M, 3] on the fine grid, zero where not measured."""
        share = self.share[:, None]
        return self.put((1.0 - share) * values[self.before] + share * values[self.before + 1])

    def put(self, values: Floats) -> Floats:
        """Return values [K, 3] in their rows [count, 3]."""
        rows = np.zeros((self.count, 3))
        rows[self.rows] = values
        return rows


def instants_on(rows_s: Floats, fine_s: Floats, at_s: Floats) -> Instants:
    """Return the places of measurements at `at_s` on rows at `rows_s` and on the grid `fine_s`."""
    edges = 0.5 * (rows_s[1:] + rows_s[:-1])
    rows, taken = np.unique(np.searchsorted(edges, at_s), return_index=True)
    before = np.clip(np.searchsorted(fine_s, at_s[taken], "right") - 1, 0, len(fine_s) - 2)
    share = (at_s[taken] - fine_s[before]) / (fine_s[before + 1] - fine_s[before])
    return Instants(rows, taken, before, share, len(rows_s))
