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


@pytest.fixture(scope="session")
def simulated_tlog(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated flight of 60 s with its truth: HIGHRES_IMU at 200 Hz, RAW_IMU, SIM_STATE,
    ATTITUDE at 50 Hz, SCALED_IMU at 10 Hz, the rest at 1 to 10 Hz."""
    from ahrs_service.app.simulate import RECORDED_RATES_HZ, write_tlog
    from ahrs_service.simulation.scenario import make_flight

    path = tmp_path_factory.mktemp("simulated") / "flight.tlog"
    write_tlog(path, make_flight("flight", 60.0, seed=1), RECORDED_RATES_HZ)
    return path
