"""What a thermal fit is worth: every second tenth of the time, predicted by the other tenths."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.calibration.thermal.rows import ThermalRows
from ahrs_service.calibration.thermal.smooth import Axes, fit_smooth
from ahrs_service.calibration.thermal.smooth_choice import level_outputs
from ahrs_service.records import Floats, Integers

Fit = Callable[[ThermalRows, float], tuple[Axes, float] | None]
"""Curves and lag [s] for some rows and a zero temperature, None where they cannot be fitted."""

TENTHS: Final = 10  # A choice: parts of a session that are fitted and held out in turn


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Residual of held-out rows [N, 3]: `before` about their levels, `after` with the curves."""

    before: Floats
    after: Floats

    def rms(self) -> tuple[float, float]:
        """Return the RMS over all axes before and after."""
        before, after = (float(np.sqrt(np.mean(rest**2))) for rest in (self.before, self.after))
        return before, after


def fit_chosen(rows: ThermalRows, zero_degc: float) -> tuple[Axes, float]:
    """Fit the smooth model, its structures and its lag chosen by these rows alone."""
    fit = fit_smooth(rows, zero_degc)
    return fit.axes, fit.lag.lag_s


def halves(rows: ThermalRows) -> Integers:
    """Return 0 or 1 for each row [N]: the tenths of each session in turn, or its rows if fewer."""
    half = np.empty(len(rows), np.int64)
    for number in np.unique(rows.session):
        own = np.flatnonzero(rows.session == number)
        half[own] = np.arange(len(own)) * min(TENTHS, len(own)) // len(own) % 2
    return half


def hold_out(
    rows: ThermalRows, zero_degc: float, fit: Fit = fit_chosen, part: Integers | None = None
) -> HeldOut | None:
    """Predict each half of the rows from the other; `part` [N] numbers other parts than halves.

    Everything that the fit chooses it chooses anew without the rows held out. Beyond the
    temperatures seen the nearest one counts, as in use. A level that was not seen says nothing
    about its own height: its mean is taken off. None where the model cannot be fitted.
    """
    part = halves(rows) if part is None else part
    before, after = np.full((2, len(rows), 3), np.nan)
    for number in np.unique(part[part >= 0]):
        test, train = np.flatnonzero(part == number), np.flatnonzero(part != number)
        seen = rows.part(train)
        found = fit(seen, float(np.clip(zero_degc, *seen.span_degc)))
        if found is None:
            return None
        curves, lag_s = found
        before[test] = _about_levels(rows, test, train, None)
        after[test] = _about_levels(rows.at_element(lag_s), test, train, curves)
    tested = np.isfinite(after[:, 0])
    return HeldOut(before[tested], after[tested])


def _about_levels(
    rows: ThermalRows, test: Integers, train: Integers, curves: Axes | None
) -> Floats:
    """Return what curves leave of the rows `test` [M, 3], about the levels of the rows `train`."""
    rest = rows.output.copy()
    if curves is not None:
        u = level_outputs(rows)[rows.level]
        seen = rows.temperature_degc[train]
        inside = np.clip(rows.temperature_degc, seen.min(), seen.max())
        rest -= np.stack([axis.drift(inside, u) for axis in curves], axis=1)
    level = rows.level[test]
    out = np.empty((len(test), 3))
    for number in np.unique(level):
        known = train[rows.level[train] == number]
        mean = rest[known if len(known) else test[level == number]].mean(axis=0)
        out[level == number] = rest[test[level == number]] - mean
    return out
