"""The truth of a recording, NAME.truth.json of ../shared/mismatch, as an oracle uses it."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from ahrs_service.app.files import toml_file
from ahrs_service.diagnosis.input.diagnosis_input import Recorded
from ahrs_service.diagnosis.judgement.beside_truth import Truth
from ahrs_service.effects.base import Effect, Values
from ahrs_service.effects.catalogue import EFFECTS
from ahrs_service.errors import RecordingError

_LENGTH_SHARE: Final = 0.05
_RATE_SHARE: Final = 0.2
_NOTHING: Final = "none"
_OUTSIDE: Final = "unknown"


def read_truth(path: Path) -> dict[str, Any]:
    """Read a truth file; RecordingError says what is wrong with it."""
    return toml_file.read_json_table(path, ("kind", "level", "effects"), "a truth")


def read(path: Path, recorded: Recorded) -> Truth:
    """Read a truth; RecordingError says what is wrong, or how it contradicts the recording."""
    content = read_truth(path)
    _check_fit(path, content, recorded)
    effects: list[tuple[Effect, Values]] = []
    outside = []
    entries = content["effects"]
    if not isinstance(entries, list):
        raise RecordingError(f"{path}: effects: {entries} is no list; see shared mismatch cases")
    for entry in entries:
        try:
            name, given = entry["effect"], entry["params"]
            if name == _OUTSIDE:
                outside.append(_in_words(given))
            elif name != _NOTHING:
                effects.append(_effect(name, given))
        except (KeyError, TypeError, ValueError) as error:
            why = f"no {error}" if isinstance(error, KeyError) else error
            raise RecordingError(
                f"{path}: effects: {why}; an entry is an effect of the catalogue and its params"
            ) from None
    return Truth(tuple(effects), tuple(outside))


def _effect(name: str, given: dict[str, Any]) -> tuple[Effect, Values]:
    if name not in EFFECTS:
        raise ValueError(f"{name} is not in the catalogue")
    # Texts next to the numbers explain them.
    numbers = {key: value for key, value in given.items() if not isinstance(value, str)}
    effect = EFFECTS[name]
    missing = [p.name for p in effect.parameters if p.step and p.name not in numbers]
    if missing:
        raise ValueError(f"{name} has no {', '.join(missing)}")
    return effect, effect.checked(numbers)


def _in_words(given: dict[str, Any]) -> str:
    sensor, covariate = given.get("sensor", "a sensor"), given.get("depends_on", "nothing known")
    return f"{sensor}: something that depends on {covariate}"


def _check_fit(path: Path, content: dict[str, Any], recorded: Recorded) -> None:
    """Refuse a truth whose length or rate is that of another recording."""
    time_s = recorded.imu_time_s
    here = {
        "seconds": (float(time_s[-1] - time_s[0]), _LENGTH_SHARE),
        "imu_rate_hz": (1.0 / float(np.median(np.diff(time_s))), _RATE_SHARE),
    }
    for name, (value, share) in here.items():
        stated = content.get(name)
        if isinstance(stated, int | float) and abs(value - stated) > share * stated:
            raise RecordingError(
                f"{path}: {name} {stated}, but {recorded.name} has {value:.4g}; "
                "give the truth of this recording"
            )
