"""Texts of the state timeline: the gate with its reasons, and faults of samples."""

from typing import Final

import numpy as np
import numpy.typing as npt

from ahrs_service.records import Flag, Gate, Phase, Rows

Codes = npt.NDArray[np.int64]

_REASONS: Final = {
    Gate.NORM: "norm",
    Gate.RATE: "rate",
    Gate.ANGULAR_ACCELERATION: "angular acceleration",
    Gate.INNOVATION: "innovation",
    Gate.SATURATION: "saturation",
    Gate.STALE: "stale",
}
_CLOSED: Final = 1 << len(_REASONS)
WAITING, ALIGNING, GAP = _CLOSED, _CLOSED + 1, _CLOSED + 2

GREEN: Final = 0x2FA35CFF
AMBER: Final = 0xE3A21AFF
ORANGE: Final = 0xE8662AFF
RED: Final = 0xD8343FFF
BLUE: Final = 0x3F7FD9FF
GREY: Final = 0x70757DFF


def _gate_text(code: int) -> str:
    if code == Gate.OPEN:
        return "open"
    return "closed: " + " + ".join(text for bit, text in _REASONS.items() if code & bit)


def _gate_colour(code: int) -> int:
    """Amber where motion closed the gate, orange where the filter, red where the sensor did."""
    if code & (Gate.SATURATION | Gate.STALE):
        return RED
    if code & Gate.INNOVATION:
        return ORANGE
    return AMBER if code else GREEN


GATE_TEXTS: Final = (*(_gate_text(code) for code in range(_CLOSED)), "waiting", "aligning", "gap")
GATE_COLOURS: Final = (*(_gate_colour(code) for code in range(_CLOSED)), GREY, BLUE, RED)


TRUST_TEXTS: Final = ("not trusted", "partly trusted", "trusted")
TRUST_COLOURS: Final = (RED, AMBER, GREEN)
_PARTLY: Final = 0.1
_MOSTLY: Final = 0.5


def trust_codes(share: npt.NDArray[np.float64]) -> Codes:
    """Return for each share [N] of open gates its index [N] into `TRUST_TEXTS`."""
    return (share >= _PARTLY).astype(np.int64) + (share >= _MOSTLY)


def gate_codes(rows: Rows) -> Codes:
    """Return for each ESTIMATE row its index [N] into `GATE_TEXTS`."""
    codes = rows["gate"].astype(np.int64) & (_CLOSED - 1)
    codes[rows["phase"] == Phase.WAITING] = WAITING
    codes[rows["phase"] == Phase.ALIGNING] = ALIGNING
    return codes


def flag_text(code: int) -> str:
    """Name the flags of a sample, "good" if there is none."""
    names = [flag.name or "" for flag in Flag if flag and code & flag]
    return " + ".join(name.lower().replace("_", " ") for name in names) or "good"


class Changes:
    """Keeps only the rows where a state differs from the row before, across calls."""

    def __init__(self) -> None:
        self._last: int | None = None

    def of(self, codes: Codes) -> npt.NDArray[np.int64]:
        """Return the indices of rows of `codes` [N] at which the state changes."""
        if len(codes) == 0:
            return np.empty(0, np.int64)
        differs = np.ones(len(codes), np.bool_)
        differs[1:] = codes[1:] != codes[:-1]
        differs[0] = codes[0] != self._last
        self._last = int(codes[-1])
        return np.flatnonzero(differs)
