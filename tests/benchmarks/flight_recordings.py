"""The flight recordings of the benchmarks, and their samples as every filter gets them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ahrs_service import intake
from ahrs_service.errors import RecordingError
from ahrs_service.links.logs.recording import AttitudeReference
from ahrs_service.links.logs.recording_formats import READERS, read_recording
from ahrs_service.records import SAMPLE_DTYPE, Kind, Rows, empty
from ahrs_service.settings import Settings

LOGS = {
    "x8 aerobatics": "x8_fixedwing_aerobatics_50hz_reencoded.tlog",
    "thor75": "umn_thor75_fixedwing_50hz_reencoded.tlog",
    "swiss2": "px4_fixedwing_swiss2_148hz_reencoded.tlog",
    "quad106": "copter_quad106_50hz_reencoded.tlog",
    "demo x8": "demo_x8_fixedwing_300s_reencoded.tlog",
    "plane erle": "plane_erle_2014-12-05_10hz.bin",
    "copter erle": "copter_erle_2014-09-07_50hz.bin",
    "copter pixhawk": "copter_pixhawk_2014_dualimu_50hz.bin",
    "auavx2": "px4_auavx2_quad_250hz.ulg",
    "fmuv6c": "px4_fmuv6c_quad_222hz.ulg",
    "log0036": "copter_pixhawk_log0036_crash_temp.bin",
    "sitl": "../sitl/arduplane_sitl_nominal.tlog",
}
SLOWEST_HZ = 8.0
"""Of an IMU that is slower the turns between samples are lost, whatever the algorithm."""


@dataclass(frozen=True)
class Flight:
    """One recording: samples [N] SAMPLE_DTYPE in the vehicle's axes, the attitude it has itself."""

    name: str
    samples: Rows
    reference: AttitudeReference

    @property
    def duration_s(self) -> float:
        """Time from the first sample to the last, without gaps of more than a minute [s]."""
        steps = np.diff(self.samples["time_ns"]) * 1e-9
        return float(steps[(steps > 0.0) & (steps < 60.0)].sum())


def read_flight(name: str, path: Path) -> Flight:
    """Read a log and let the intake choose its samples; RecordingError where it has no use here."""
    recording = read_recording(path)
    if not recording.references:
        raise RecordingError(f"{path}: has no attitude to compare with")
    limit = int(np.count_nonzero(recording.readings["kind"] == Kind.IMU))
    samples = empty(SAMPLE_DTYPE, limit)
    positions = np.zeros(limit, np.int64)
    count = intake.select(
        intake.parameters(Settings().intake),
        intake.new_state(),
        recording.readings,
        samples,
        positions,
    )
    samples = _in_vehicle_axes(samples[:count])
    if not count or 1e9 / np.median(np.diff(samples["time_ns"])) < SLOWEST_HZ:
        raise RecordingError(f"{path}: its IMU comes at less than {SLOWEST_HZ:.0f} Hz")
    references = sorted(recording.references, key=lambda one: not one.is_truth)
    return Flight(name, samples, references[0])


def _in_vehicle_axes(samples: Rows) -> Rows:
    """Turn rate and force [N, 3] by the trim, so that every filter gets the same."""
    (trimmed,) = np.nonzero(np.isfinite(samples["vehicle_from_board"][:, 0, 0]))
    turn = samples["vehicle_from_board"][trimmed]
    for name in ("gyro_rad_s", "accel_m_s2"):
        samples[name][trimmed] = np.einsum("nij,nj->ni", turn, samples[name][trimmed])
    samples["vehicle_from_board"] = np.nan
    return samples


def recordings(data: Path, names: list[str], everything: bool) -> dict[str, Path]:
    """Paths of the recordings by name: the known ones that are there, then the others."""
    known = {name: data / LOGS[name] for name in names}
    found = {name: path for name, path in known.items() if path.is_file()}
    if everything:
        used = {path.resolve() for path in found.values()}
        others = (path for path in sorted(data.iterdir()) if path.suffix.lower() in READERS)
        found |= {path.stem: path for path in others if path.resolve() not in used}
    if not found:
        raise SystemExit(f"{data} holds none of the known recordings: give --all to take every one")
    return found
