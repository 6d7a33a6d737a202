"""What the daemon counts while it runs: latency, gate shares, publishing."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from ahrs_service.records import Gate, Phase, Record, Rows

_LATENCIES: Final = 65536
_LONGEST_STEP_NS: Final = 1_000_000_000


class Latency:
    """The last 65536 latencies [s], for percentiles."""

    def __init__(self) -> None:
        self._values = np.zeros(_LATENCIES)
        self.count = 0

    def add(self, value_s: float) -> None:
        """Note one latency."""
        self._values[self.count % _LATENCIES] = value_s
        self.count += 1

    def percentiles_ms(self) -> tuple[float, float, float]:
        """Return p50, p99 and the maximum [ms]; NaN before the first."""
        if not self.count:
            return (np.nan, np.nan, np.nan)
        values = 1e3 * self._values[: min(self.count, _LATENCIES)]
        p50, p99 = np.percentile(values, [50, 99])
        return float(p50), float(p99), float(values.max())


def gate_text(phase: int, gate: int) -> str:
    """Return the gate's state and reasons: `open`, `closed: norm + rate`, `aligning`."""
    if phase != Phase.RUNNING:
        return Phase(phase).name.lower()
    if not gate:
        return "open"
    names = [str(reason.name).lower().replace("_", " ") for reason in Gate if gate & reason]
    return "closed: " + " + ".join(names)


@dataclass(slots=True)
class GateShares:
    """Time per gate state, from the estimates' stamps; gaps over 1 s are not counted."""

    time_ns: dict[tuple[int, int], int] = field(default_factory=dict)
    _last_ns: int = 0

    def add(self, estimate: Record) -> None:
        """Note one estimate."""
        time_ns = int(estimate["time_ns"])
        step = time_ns - self._last_ns
        self._last_ns = time_ns
        if 0 < step < _LONGEST_STEP_NS:
            key = (int(estimate["phase"]), int(estimate["gate"]))
            self.time_ns[key] = self.time_ns.get(key, 0) + step

    def shares(self) -> dict[str, float]:
        """Return the share of time per state, the longest first; they sum to 1."""
        return _as_shares(self.time_ns)


def gate_shares(estimates: Rows) -> dict[str, float]:
    """Return the same shares of a whole recording's estimates [N]."""
    steps = np.diff(estimates["time_ns"], prepend=estimates["time_ns"][:1])
    counted = (steps > 0) & (steps < _LONGEST_STEP_NS)
    keys = estimates["phase"].astype(np.int64) << 32 | estimates["gate"]
    time_ns = {}
    for key in np.unique(keys):
        time_ns[int(key) >> 32, int(key) & 0xFFFFFFFF] = int(steps[counted & (keys == key)].sum())
    return _as_shares(time_ns)


def _as_shares(time_ns: dict[tuple[int, int], int]) -> dict[str, float]:
    total = sum(time_ns.values()) or 1
    named: dict[str, int] = {}
    for key, value in time_ns.items():
        # During alignment every state of the gate has the same name.
        text = gate_text(*key)
        named[text] = named.get(text, 0) + value
    ordered = sorted(named.items(), key=lambda item: -item[1])
    return {text: value / total for text, value in ordered if value}


@dataclass(slots=True)
class Session:
    """Counters of a live session.

    `published` messages with our attitude, `not_sent` frames the link refused;
    `first_attitude_s` from the start of the service [s].
    """

    latency: Latency = field(default_factory=Latency)
    gates: GateShares = field(default_factory=GateShares)
    estimates: int = 0
    published: int = 0
    not_sent: int = 0
    first_attitude_s: float = float("nan")
