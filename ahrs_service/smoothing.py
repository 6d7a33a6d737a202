"""Attitude of reference grade after the flight: the filter forward, then back over its history.

Smoothed is as good as the filter's model is. At the end of a recording both are the same, so one
that ends at rest is smoothed better than one cut off in a manoeuvre. In the mode "gated" a long
turn that the gates took for steady flight also misleads what was before it.
"""

from typing import Final

import numpy as np

from ahrs_service import pipeline
from ahrs_service.errors import InvalidValueError
from ahrs_service.fusion import smoother, smoother_history
from ahrs_service.kernel import kernel
from ahrs_service.records import Rows

_MIN_NODES: Final = 1024
"""Room at the start, 123 s of a node each 0.12 s; it doubles when full: memory, not estimates."""


@kernel
def record(
    parameters: Rows,
    coefficients: Rows,
    state: Rows,
    samples: Rows,
    estimates: Rows,
    nodes: Rows,
    used: int,
    first: int,
) -> int:
    """Do what `pipeline.batch` does and keep its updates in `nodes` [at least used + N + 1].

    `first` is the number of the first of `samples` [N]. Return the new `used`, 1 at first.
    """
    for n in range(samples.shape[0]):
        pair = nodes[used - 1 : used + 1]
        pipeline.take(parameters[0], coefficients[0], state[0], samples[n], estimates[n], pair)
        used += smoother_history.close(state[0], pair[1], first + n)
    return used


class Smoother:
    """Runs the filter and remembers what the way back needs: 3.1 kB per update, 110 MB an hour."""

    def __init__(self) -> None:
        self._nodes = np.zeros(_MIN_NODES, smoother_history.NODE_DTYPE)
        self._used = 1
        self._samples = 0

    def batch(
        self, parameters: Rows, coefficients: Rows, state: Rows, samples: Rows, estimates: Rows
    ) -> None:
        """Do what `pipeline.batch` does, to the same bytes."""
        needed = self._used + len(samples) + 1
        if needed > len(self._nodes):
            # Rows that are never written take no memory.
            nodes = np.zeros(max(needed, 2 * len(self._nodes)), smoother_history.NODE_DTYPE)
            nodes[: self._used] = self._nodes[: self._used]
            self._nodes = nodes
        self._used = record(
            parameters,
            coefficients,
            state,
            samples,
            estimates,
            self._nodes,
            self._used,
            self._samples,
        )
        self._samples += len(samples)

    def cut(self) -> None:
        """Keep what comes now from correcting what was before: another state was loaded."""
        self._nodes = np.append(self._nodes[: self._used], np.zeros(1, smoother_history.NODE_DTYPE))
        self._used += 1

    def smooth(self, estimates: Rows) -> None:
        """Smooth in place all `estimates` [N] that came since the beginning.

        Attitude, rate, specific force, residual, bias and the sigmas change; what the gates saw
        and the flags stay. Before the first attitude nothing changes.
        """
        if len(estimates) != self._samples:
            raise InvalidValueError(
                f"{len(estimates)} estimates cannot be smoothed by the nodes of {self._samples}; "
                "give all of them, in order"
            )
        smoother.smooth(self._nodes, self._used, estimates)
