"""What the filter keeps at each update for the smoother to go back over.

A node is the state at the end of an update, corrected. The way from node to node is the transition
of the covariance (F of `mekf.propagate`, noise included in the variances it ended with), then the
corrections. A node where the filter began anew is a start: no way leads back from it.
"""

from typing import Final

import numpy as np

from ahrs_service.fusion.states import ERROR_STATES
from ahrs_service.kernel import kernel
from ahrs_service.records import Record

NONE: Final = 0
"""See CHAINED."""
START: Final = 1
"""See CHAINED."""
CHAINED: Final = 2
"""Kinds of a node: nothing, the first of a chain, one that follows the node before it."""

NODE_DTYPE: Final = np.dtype(
    [
        ("sample", "i8"),
        ("kind", "i8"),
        ("states_before", "i8"),
        ("states", "i8"),
        ("in_wind", "i8"),
        ("rotated_rad", "f8"),
        ("rotation_s", "f8", (3, 3)),
        ("rate_rad_s", "f8", 3),
        ("impulse_m_s", "f8", 3),
        ("variance", "f8", ERROR_STATES),
        ("applied", "f8", ERROR_STATES),
        ("late", "f8", ERROR_STATES),
        ("covariance", "f8", ERROR_STATES * (ERROR_STATES + 1) // 2),
    ]
)
"""One node, 3.1 kB: the number of its sample; what led to it (transition, predicted variances,
error states in use, whether they were through the air); the rotation about down and the corrections
applied at its sample, then those that came late, before the next update ended; its covariance after
all of these, the lower triangle row by row."""


@kernel
def leave(state: Record, node: Record) -> None:
    """Complete the last node before the covariance grows: what was corrected since its sample."""
    for i in range(ERROR_STATES):
        node["late"][i] = state["applied"][i] - node["applied"][i]
    _keep_covariance(state, node)


@kernel
def arrive(state: Record, node: Record) -> None:
    """Begin a node with the way to it: after the prediction, before any correction."""
    node["kind"] = CHAINED
    node["states_before"] = state["states"]
    node["in_wind"] = 1 - state["at_rest"]
    for i in range(3):
        node["rate_rad_s"][i] = state["delta_angle_rad"][i]
        node["impulse_m_s"][i] = state["delta_velocity_m_s"][i]
        for j in range(3):
            node["rotation_s"][i, j] = state["update_rotation_s"][i, j]
    for i in range(ERROR_STATES):
        node["variance"][i] = state["covariance"][i, i]


@kernel
def close(state: Record, node: Record, sample: int) -> int:
    """After a step, finish the node if there is one; return how many there are, 1 or 0."""
    aligned = state["aligned_samples"]
    if aligned == 1:
        node["kind"] = START
    if aligned == 0 or node["kind"] == NONE:
        node["kind"] = NONE
        return 0
    if state["states"] < node["states_before"]:
        # The measured velocity was found to contradict all before it.
        node["kind"] = START
    node["sample"] = sample
    node["states"] = state["states"]
    node["rotated_rad"] = state["rotated_rad"]
    for i in range(ERROR_STATES):
        node["applied"][i] = state["applied"][i]
    _keep_covariance(state, node)
    return 1


@kernel
def _keep_covariance(state: Record, node: Record) -> None:
    p, kept, n = state["covariance"], node["covariance"], 0
    for i in range(ERROR_STATES):
        for j in range(i + 1):
            kept[n] = p[i, j]
            n += 1
