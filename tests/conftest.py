"""Fixtures that all tests share."""

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[1].parent / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of real recordings beside the project; skips the test where it is missing."""
    data = SHARED / "data"
    if not data.is_dir():
        pytest.skip("no folder ../shared/data with real recordings beside the project")
    return data
