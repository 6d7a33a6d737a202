"""The profiles of configs/airframes: the file of each name, in the source tree and as installed.

The folder is the package's, `ahrs_service/configs` (in the source tree a link to configs/), never
another folder of that name, for example in the working directory.
"""

from pathlib import Path
from typing import Final

SUFFIX: Final = ".toml"
_PACKAGE: Final = Path(__file__).resolve().parents[2]
FOLDER: Final = _PACKAGE / "configs" / "airframes"


def names() -> list[str]:
    """Return the names of all profiles."""
    return sorted(path.stem for path in FOLDER.glob(f"*{SUFFIX}"))


def file_of(profile: str) -> Path | None:
    """Return the file of a profile named, or given as a file (by suffix); None if unknown."""
    if profile.endswith(SUFFIX):
        return Path(profile)
    # Both spellings are in use: hand_held and hand-held.
    name = profile.replace("-", "_")
    return FOLDER / f"{name}{SUFFIX}" if name in names() else None
