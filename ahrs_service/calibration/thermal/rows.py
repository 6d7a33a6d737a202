"""What a thermal fit takes: means of a sensor's output while its input was constant."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.signal import lfilter, savgol_filter

from ahrs_service.records import Floats, Integers

SLOPE_WINDOW_S: Final = 30.0
"""Time over which a thermometer's rate is measured where the sensor runs ahead of it [s]."""

_SLOWEST_GRID: Final = 100_000  # A choice: bounds the memory; of a day one point each 0.9 s


@dataclass(frozen=True, slots=True)
class ThermalRows:
    """Rows [N] of one triad, each the mean over a second or so without any turn.

    `time_s` [N] rising within a session [s], `temperature_degc` [N] as the thermometer shows it,
    `output` [N, 3] [rad/s or m/s^2]; `level` [N] numbers rows of like input from 0: one still
    pose, one rate of the table; `session` [N] numbers runs of the clock.
    """

    time_s: Floats
    temperature_degc: Floats
    output: Floats
    level: Integers
    session: Integers

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def levels(self) -> int:
        """How many inputs there are."""
        return int(self.level.max()) + 1

    @property
    def span_degc(self) -> tuple[float, float]:
        """Lowest and highest temperature [degC]."""
        return float(self.temperature_degc.min()), float(self.temperature_degc.max())

    def part(self, keep: Integers | slice) -> "ThermalRows":
        """Return the rows that `keep` picks, levels numbered anew."""
        _, level = np.unique(self.level[keep], return_inverse=True)
        return ThermalRows(
            self.time_s[keep],
            self.temperature_degc[keep],
            self.output[keep],
            level.astype(np.int64),
            self.session[keep],
        )

    def at_element(self, lag_s: float) -> "ThermalRows":
        """Return the rows with the temperature of the elements (see `element_degc`)."""
        if lag_s == 0.0:
            return self
        acting = np.empty(len(self))
        for number in np.unique(self.session):
            own = self.session == number
            acting[own] = element_degc(self.time_s[own], self.temperature_degc[own], lag_s)
        return replace(self, temperature_degc=acting)

    def rate_degc_s(self) -> Floats:
        """Return how fast the temperature changes [N] [degC/s], over SLOPE_WINDOW_S."""
        rate = np.empty(len(self))
        for number in np.unique(self.session):
            own = self.session == number
            rate[own] = _rate(self.time_s[own], self.temperature_degc[own])
        return rate


def element_degc(time_s: Floats, thermometer_degc: Floats, lag_s: float) -> Floats:
    """Return the temperature of the sensing element [N] [degC].

    `lag_s` > 0: the element follows the thermometer as lag dT/dt + T = T_thermometer; < 0: the
    thermometer follows the element, so T = T_thermometer + abs(lag) dT_thermometer/dt.
    """
    if lag_s == 0.0 or len(time_s) < 3:
        return thermometer_degc
    if lag_s < 0.0:
        return thermometer_degc - lag_s * _rate(time_s, thermometer_degc)
    grid, values = _even(time_s, thermometer_degc)
    steps = (grid[1] - grid[0]) / lag_s
    keep = np.exp(-steps)
    # Exact for a temperature that is linear between the rows, however long their steps.
    now, before = 1.0 - (1.0 - keep) / steps, (1.0 - keep) / steps - keep
    followed, _ = lfilter([now, before], [1.0, -keep], values, zi=[(1.0 - now) * values[0]])
    return np.interp(time_s, grid, followed)


def _even(time_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return an even grid of times and the values there."""
    step = float(np.median(np.diff(time_s)))
    span = time_s[-1] - time_s[0]
    count = int(min(max(round(span / step) if step > 0.0 else 2, 2), _SLOWEST_GRID)) + 1
    grid = np.linspace(time_s[0], time_s[-1], count)
    return grid, np.interp(grid, time_s, values)


def _rate(time_s: Floats, temperature_degc: Floats) -> Floats:
    """Slope of a line through SLOPE_WINDOW_S around each row [degC/s]."""
    if len(time_s) < 3:
        return np.zeros(len(time_s))
    grid, values = _even(time_s, temperature_degc)
    step = grid[1] - grid[0]
    window = min(2 * int(0.5 * SLOPE_WINDOW_S / step) + 1, 2 * ((len(grid) - 1) // 2) + 1)
    slope = savgol_filter(values, max(window, 3), 1, deriv=1, delta=step, mode="interp")
    return np.interp(time_s, grid, slope)
