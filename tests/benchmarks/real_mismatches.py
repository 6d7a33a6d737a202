"""What is really there: mismatches of real recordings, each with its independent witness.

Run: python tests/benchmarks/real_mismatches.py [--data DIR] [--without-diagnosis] [--json OUT]

Plain regressions come first, made without the diagnosis: they say what there is to be found, on
both halves of a recording apart, and who else has seen it: the second IMU of the board, another
trial of the same sensor in the same mount, a parameter in the log. Then what `diagnose` answers on
the same recordings. "agree" is how far two answers lie apart in their common sigma.

What a recording of 1 to 4 Hz can tell: how the bias follows temperature or time, for a second of
mean is as good as a second of samples. What it cannot: timing, filters, scale, lever arm, vibration
(all of them need the motion between two samples); nor, alone, an accelerometer's drift from a
slow tilt of the bench: that takes the second IMU, which would tilt with it.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from peers import SHARED_DATA, require_data
from real_data import both_imus, broad_trial, part
from real_witness import (
    Fit,
    blocks,
    coloured_fit,
    held_out_gain,
    lever_arm,
    slope,
    time_offset,
)
from rich.console import Console
from rich.table import Table

from ahrs_service.app.diagnose.loaded_recording import load
from ahrs_service.diagnosis.input.diagnosis_input import Recorded
from ahrs_service.links.logs.dataflash_tables import read_tables
from ahrs_service.links.logs.recording_formats import read_recording
from ahrs_service.records import ImuSource, Kind, Rows

STATIC = {
    "bench_cuav_2021-11-25_static_warmup_1hz.tlog": "37 to 43 degC, 1 Hz",
    "bench_cuav_2021-12-08_static_warmup_2hz.tlog": "42 to 44 degC, 2 Hz",
    "bench_matekh743_2021_isbd2khz_warmup.bin": "34.3 to 35.8 degC, 25 Hz",
    "bench_copter_2021-11-23_static_44min_1hz.tlog": "40.2 degC held, 44 min, 1 Hz: a null",
}
TWO_IMUS = {
    "copter_pixhawk_2014_dualimu_50hz.bin": "MPU-6000 and LSM303D/L3GD20",
    "copter_pixhawk_log0036_crash_temp.bin": "MPU-6000 and LSM303D/L3GD20",
    "copter_pixhawk_log0039_temp.bin": "MPU-6000 and LSM303D/L3GD20",
}
TIMED = (
    "x8_fixedwing_aerobatics_50hz_reencoded.tlog",
    "umn_thor75_fixedwing_50hz_reencoded.tlog",
    "px4_fixedwing_swiss2_148hz_reencoded.tlog",
    "px4_auavx2_quad_250hz.ulg",
    "px4_fmuv6c_quad_222hz.ulg",
    "copter_quad106_50hz_reencoded.tlog",
    "copter_erle_2014-09-07_50hz.bin",
    "copter_pixhawk_2014_dualimu_50hz.bin",
    "copter_pixhawk_log0036_crash_temp.bin",
    "copter_pixhawk_log0039_temp.bin",
)
CLEAR = 6.0
"""Sigmas from which a slope is listed: six axes of two IMUs in four logs are 48 looks."""

MOUNTS = {
    "A": ("01", "06", "10"),
    "B": ("05", "09", "16", "18", "21", "28", "31"),
    "C": ("03", "12", "24"),
    "33, 35": ("33", "35"),
    "27": ("27",),
}
"""BROAD trials by how the sensor sat on the markers' body, as the lever arms themselves group."""


@dataclass(frozen=True)
class Real:
    """One thing that is really there: the figure, and who else has seen it."""

    recording: str
    effect: str
    figure: str
    witness: str


def pm(value: float, sigma: float, unit: str) -> str:
    """Return "value ± sigma unit"."""
    return f"{value:+.3g} ± {sigma:.1g} {unit}"


def apart(one: Fit, other: Fit) -> float:
    """Return how far two slopes lie apart in their common sigma."""
    return float(abs(one.value[0] - other.value[0]) / np.hypot(one.sigma[0], other.sigma[0]))


def imus_of(path: Path) -> dict[str, Rows]:
    """Return the samples of each IMU that have a temperature, by the name of its source."""
    readings = read_recording(path).readings
    imu = readings[(readings["kind"] == Kind.IMU) & (readings["temperature_degc"] > 1.0)]
    return {ImuSource(int(s)).name: imu[imu["source"] == s] for s in np.unique(imu["source"])}


def warm_up(folder: Path) -> Iterator[Real]:
    """Yield the biases of static logs that follow the temperature."""
    for name, about in STATIC.items():
        imus = imus_of(folder / "flights" / name)
        listed = 0
        for source, rows in imus.items():
            degc = rows["temperature_degc"].astype(np.float64)
            half = len(rows) // 2
            for field, effect, factor, unit in (
                ("gyro_rad_s", "gyro_thermal_bias", 1e3, "mrad/s/degC"),
                ("accel_m_s2", "accel_thermal_bias", 1e3, "mm/s^2/degC"),
            ):
                for axis in range(3):
                    values = rows[field][:, axis] * factor
                    fit = slope(degc, values)
                    if abs(fit.value[0]) < CLEAR * fit.sigma[0]:
                        continue
                    listed += 1
                    early, late = (
                        slope(degc[:half], values[:half]),
                        slope(degc[half:], values[half:]),
                    )
                    witness = f"halves {apart(early, late):.1f} sigma apart"
                    witness += f", held out {100.0 * held_out_gain(degc, values):.0f} %"
                    for other, others in imus.items():
                        if other != source:
                            there = slope(
                                others["temperature_degc"], others[field][:, axis] * factor
                            )
                            witness += f"; {other} {pm(there.value[0], there.sigma[0], '')}"
                            witness += (
                                "not this: the sensor, not the bench"
                                if apart(fit, there) > 3.0
                                else "likewise: a tilt would do that too"
                            )
                    figure = pm(float(fit.value[0]), float(fit.sigma[0]), unit)
                    yield Real(f"{name} {source}", f"{effect} {'xyz'[axis]}", figure, witness)
        if not listed:
            yield Real(name, "none", f"no slope above {CLEAR:g} sigma", about)


def two_imus(folder: Path) -> Iterator[Real]:
    """Yield what the difference of two IMUs of one board follows."""
    for name in TWO_IMUS:
        path = folder / "flights" / name
        recorded = load(path).columns
        time_s, gyro, accel, gyro_2, accel_2 = both_imus(path)
        count = max(1, round(1.0 / float(np.median(np.diff(time_s)))))
        at = blocks(time_s, count)
        calm = np.linalg.norm(blocks(accel, count), axis=1) < 20.0
        calm &= at < time_s[-1] - 8.0
        force = blocks(accel, count)[calm]
        shaken = (blocks(accel**2, count) - blocks(accel, count) ** 2).sum(axis=1)[calm]
        throttle = recorded.throttle.at(at)[calm]
        regressors = {"throttle": throttle, "vibration variance": shaken}
        if len(recorded.temperature_degc):
            regressors["temperature"] = recorded.temperature_degc.at(at)[calm]
        for what, difference, factor, unit in (
            ("accel", blocks(accel - accel_2, count)[calm], 1.0, "m/s^2"),
            ("gyro", blocks(gyro - gyro_2, count)[calm], 1e3, "mrad/s"),
        ):
            yield from _followed(name, what, difference * factor, unit, regressors, force)


def _followed(
    name: str,
    what: str,
    difference: np.ndarray,
    unit: str,
    regressors: dict[str, np.ndarray],
    force: np.ndarray,
) -> Iterator[Real]:
    """Yield for each axis the regressor with the largest share, all fitted together."""
    names = list(regressors)
    design = np.column_stack([*regressors.values(), force, np.ones(len(force))])
    half = len(force) // 2
    for axis in range(3):
        values = difference[:, axis]
        fit = coloured_fit(design, values)
        sigmas = np.abs(fit.value / fit.sigma)[: len(names)]
        best = int(np.argmax(sigmas))
        if sigmas[best] < CLEAR:
            continue
        early, late = (
            coloured_fit(design[piece], values[piece])
            for piece in (slice(0, half), slice(half, None))
        )
        sign = "same" if early.value[best] * late.value[best] > 0.0 else "OTHER"
        figure = f"{pm(fit.value[best], fit.sigma[best], unit)} per unit of {names[best]}"
        halves = " and ".join(pm(f.value[best], f.sigma[best], "") for f in (early, late))
        yield Real(
            name,
            f"{what} {'xyz'[axis]}: IMU less IMU2 follows {names[best]}",
            figure,
            f"the second IMU itself; halves {halves}({sign} sign)",
        )


def gyro_filter_hz(path: Path) -> float:
    """Return INS_GYRO_FILTER of a .bin log, NaN where it is not told."""
    if path.suffix != ".bin":
        return float("nan")
    rows = read_tables(path).table("PARM")
    found = rows["Value"][rows["Name"] == b"INS_GYRO_FILTER"]
    return float(found[-1]) if len(found) else float("nan")


def timing(folder: Path) -> Iterator[Real]:
    """Yield the offsets between IMU and reference, on both halves of each flight."""
    for name in TIMED:
        path = folder / "flights" / name
        recorded = load(path).columns
        whole, early, late = (
            1e3 * time_offset(part(recorded, *share))
            for share in ((0.0, 1.0), (0.0, 0.5), (0.5, 1.0))
        )
        interval_ms = 1e3 * float(np.median(np.diff(recorded.imu_time_s)))
        witness = f"halves {early:+.1f} and {late:+.1f} ms"
        hz = gyro_filter_hz(path)
        if np.isfinite(hz):
            # Group delay of a second-order Butterworth filter at rest: sqrt(2) / (2 pi fc).
            delay_ms = 1e3 * np.sqrt(2.0) / (2.0 * np.pi * hz)
            witness += f"; INS_GYRO_FILTER {hz:g} Hz delays by {delay_ms:.1f} ms"
        elif abs(abs(whole) - 0.5 * interval_ms) < 0.05 * interval_ms:
            witness += f"; half an IMU interval is {0.5 * interval_ms:.1f} ms"
        yield Real(name, "imu_time_offset", f"{whole:+.1f} ms", witness)


def broad(folder: Path) -> Iterator[Real]:
    """Yield offset and lever arm of the BROAD trials, by the way the sensor was mounted."""
    files = {path.stem[:2]: path for path in sorted((folder / "broad").glob("*.npz"))}
    offsets_ms: list[float] = []
    later_ms: list[float] = []
    for mount, trials in MOUNTS.items():
        arms, spread = [], []
        for trial in trials:
            if trial not in files:
                continue
            recorded = broad_trial(files[trial])
            offset_s = time_offset(recorded)
            offsets_ms.append(1e3 * offset_s)
            halves = []
            for share in ((0.0, 0.5), (0.5, 1.0)):
                piece = part(recorded, *share)
                halves.append(_arm(files[trial], piece, offset_s).value[:3])
            whole = _arm(files[trial], recorded, offset_s).value
            arms.append(whole[:3])
            later_ms.append(1e3 * float(whole[3]))
            spread.append(np.abs(halves[0] - halves[1]).max())
        if not arms:
            continue
        mean = np.mean(arms, axis=0)
        others = (
            f"{len(arms)} trials within {1e3 * np.abs(arms - mean).max():.1f} mm of their mean"
            if len(arms) > 1
            else "no other trial"
        )
        yield Real(
            f"BROAD, mount {mount}",
            "accel_lever_arm",
            "(" + ", ".join(f"{1e3 * x:+.1f}" for x in mean) + ") mm",
            f"{others}; halves within {1e3 * float(np.max(spread)):.1f} mm",
        )
    yield Real(
        f"BROAD, {len(offsets_ms)} trials",
        "imu_time_offset",
        f"{np.mean(offsets_ms):+.2f} ms",
        f"every trial: {min(offsets_ms):+.2f} to {max(offsets_ms):+.2f} ms",
    )
    yield Real(
        f"BROAD, {len(later_ms)} trials",
        "accelerometer against gyro",
        f"{np.mean(later_ms):+.2f} ms",
        f"every trial: {min(later_ms):+.2f} to {max(later_ms):+.2f} ms",
    )


def _arm(path: Path, piece: Recorded, offset_s: float) -> Fit:
    with np.load(path) as trial:
        place = trial["opt_pos"].astype(np.float64)[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
        time_s = np.arange(len(place)) / float(trial["sampling_rate"])
    seen = np.isfinite(place).all(axis=1)
    return lever_arm(piece, time_s[seen], place[seen], offset_s)


def table(title: str, findings: list[Real]) -> Table:
    """Return the list of findings."""
    out = Table(title=title, title_justify="left")
    for name in ("recording", "effect", "figure", "witness"):
        out.add_column(name, overflow="fold")
    for one in findings:
        out.add_row(one.recording, one.effect, one.figure, one.witness)
    return out


def main() -> None:
    """Print the lists."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=SHARED_DATA)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    require_data(arguments.data, "the folders flights and broad")
    console = Console(width=170)
    found: dict[str, list[Real]] = {}
    for title, source in (
        ("Static benches: bias against temperature", warm_up),
        ("Two IMUs of one board", two_imus),
        ("Stamps of the IMU against the reference (positive: late)", timing),
        ("Optical truth", broad),
    ):
        found[title] = list(source(arguments.data))
        console.print(table(title, found[title]))
    if arguments.json is not None:
        rows = {title: [asdict(one) for one in findings] for title, findings in found.items()}
        arguments.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
