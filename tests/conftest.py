"""Fixtures that all tests share."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.links.logs.tlog import TlogFile, read_tlog
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.records import SAMPLE_DTYPE, Rows, empty
from ahrs_service.rotation import inverse_columns, quaternion_columns, rotate_columns
from tests.live import FarAutopilot, Served, Vehicle, fly, session

SHARED = Path(__file__).resolve().parents[1].parent / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of real recordings next to the project; skips the test where it is missing."""
    data = SHARED / "data"
    if not data.is_dir():
        pytest.skip("no folder ../shared/data with real recordings next to the project")
    return data


@pytest.fixture(scope="session")
def simulated_tlog(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated flight of 60 s with its truth: HIGHRES_IMU at 200 Hz, RAW_IMU, SIM_STATE,
    ATTITUDE at 50 Hz, SCALED_IMU at 10 Hz, the rest at 1 to 10 Hz."""
    from ahrs_service.app.simulate.command import RECORDED_RATES_HZ, write_tlog
    from ahrs_service.simulation.scenario import make_flight

    path = tmp_path_factory.mktemp("simulated") / "flight.tlog"
    write_tlog(path, make_flight("flight", 60.0, seed=1), RECORDED_RATES_HZ)
    return path


@pytest.fixture
def live(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> SimpleNamespace:
    """Tools to serve live in a test: Served, Vehicle, session(settings, kind, folder), fly."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    return SimpleNamespace(
        Served=Served,
        Vehicle=Vehicle,
        FarAutopilot=FarAutopilot,
        session=session,
        fly=fly,
        frames_of=_frames_of,
    )


def _frames_of(log: TlogFile, keep: Any) -> list[bytes]:
    """Return the frames of a recording that `keep` selects."""
    chosen = log.frames[keep]
    spans = zip(chosen["offset"].tolist(), chosen["length"].tolist(), strict=True)
    return [log.data[start : start + length].tobytes() for start, length in spans]


@pytest.fixture(scope="session")
def flight_frames(simulated_tlog: Path) -> list[bytes]:
    """Frames of the first 20 s of the simulated flight: IMU at 100 Hz, the gate opens and closes
    for several reasons."""
    log = read_tlog(simulated_tlog)
    stamps, numbers = log.frames["received_us"], log.frames["msgid"]
    unwanted = [dialect.MAVLINK_MSG_ID_RAW_IMU, dialect.MAVLINK_MSG_ID_SIM_STATE]
    keep = (stamps < stamps[0] + 20_000_000) & ~np.isin(numbers, unwanted)
    keep[np.flatnonzero(keep & (numbers == dialect.MAVLINK_MSG_ID_HIGHRES_IMU))[1::2]] = False
    return _frames_of(log, keep)


class Swing:
    """Motion known in closed form: rest, then sines of Euler angles and velocity that swell.

    `angles` [3, K, 3] and `velocities` [3, K, 3]: for each axis K sines of amplitude [rad or m/s],
    frequency [Hz] and phase [rad]. Rate and specific force follow exactly; the mean over an
    interval is taken by Gauss-Legendre quadrature, to rounding.
    """

    REST_S = 2.0
    SWELL_S = 1.0
    STILL = (((0.0, 1.0, 0.0),),) * 3

    def __init__(self, angles: Any, velocities: Any = STILL) -> None:
        self._angles = np.asarray(angles, np.float64)
        self._velocities = np.asarray(velocities, np.float64)

    def _sines(self, terms: Any, t: Any) -> tuple[Any, Any]:
        """Values and slopes [N, 3], at rest before REST_S, at full size SWELL_S later."""
        x = np.clip((t - self.REST_S) / self.SWELL_S, 0.0, 1.0)[:, None]
        size = x**3 * (10.0 - 15.0 * x + 6.0 * x * x)
        growth = 30.0 * x * x * (1.0 - x) ** 2 / self.SWELL_S
        amplitude, turn, phase = terms[..., 0], 2.0 * np.pi * terms[..., 1], terms[..., 2]
        angle = turn * t[:, None, None] + phase
        value = (amplitude * np.sin(angle)).sum(axis=2)
        slope = (amplitude * turn * np.cos(angle)).sum(axis=2)
        return size * value, size * slope + growth * value

    def attitude(self, t: Any) -> Any:
        """ned_from_body [N, 4]."""
        return quaternion_columns(self._sines(self._angles, t)[0])

    def velocity(self, t: Any) -> Any:
        """Velocity north, east, down [N, 3] [m/s]."""
        return self._sines(self._velocities, t)[0]

    def sense(self, t: Any) -> Any:
        """Body rate [rad/s] and specific force [m/s^2] of the instants, side by side [N, 6]."""
        (roll, pitch, _), (roll_rate, pitch_rate, turn) = (
            columns.T for columns in self._sines(self._angles, t)
        )
        rate = [
            roll_rate - turn * np.sin(pitch),
            pitch_rate * np.cos(roll) + turn * np.cos(pitch) * np.sin(roll),
            -pitch_rate * np.sin(roll) + turn * np.cos(pitch) * np.cos(roll),
        ]
        force = self._sines(self._velocities, t)[1] - [0.0, 0.0, STANDARD_GRAVITY_M_S2]
        body = rotate_columns(inverse_columns(self.attitude(t)), force)
        return np.concatenate([np.stack(rate, axis=1), body], axis=1)

    def sense_mean(self, t: Any) -> Any:
        """The means of both since the instant before [N, 6]; the first row is that of rest."""
        half = 0.5 * np.diff(t, prepend=t[0] - 1e-3)
        nodes = zip(*np.polynomial.legendre.leggauss(10), strict=True)
        return sum(0.5 * weight * self.sense(t - half + node * half) for node, weight in nodes)

    def samples(self, t: Any, mean: bool = False) -> Rows:
        """Samples at the times [N] [s] of a perfect sensor that gives instants or means."""
        rows = empty(SAMPLE_DTYPE, len(t))
        sensed = (self.sense_mean if mean else self.sense)(t)
        rows["time_ns"] = rows["received_ns"] = np.rint(t * 1e9)
        rows["gyro_rad_s"], rows["accel_m_s2"] = sensed[:, :3], sensed[:, 3:]
        return rows


@pytest.fixture(scope="session")
def swing() -> type[Swing]:
    """The class of motions that are known in closed form."""
    return Swing
