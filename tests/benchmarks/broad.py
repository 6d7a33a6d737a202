"""Inclination and total error on the BROAD trials: ours and the peers.

Run: python tests/benchmarks/broad.py [--data DIR] [--no-ahrs] [--only-ours] [--contract]
                                      [--json OUT]

DIR holds the trials as .npz (default: ../shared/data/broad beside the project), with imu_gyr,
imu_acc, imu_mag, opt_quat, movement, sampling_rate. With e = q_estimate * conj(q_optical):

    inclination = 2 acos(sqrt(e_w^2 + e_z^2))     of the run with six axes
    total       = 2 acos(abs(e_w))                of the run with nine

RMS over the samples in movement with a finite reference, one figure per trial, and their plain
mean. The second pair of tables has one constant lag of the output per algorithm fitted out, so
that neither delay nor prediction counts. Ours runs as --profile hand_held --frame flu; the first
trial, with --contract every one, also goes through `ahrs-service estimate` as a process and must
give the same bytes. "ours offline" is that process with --offline, not causal, where it has that.

D. Laidig, M. Caruso, A. Cereatti, T. Seel: BROAD - A Benchmark for Robust Inertial Orientation
Estimation. Data 6 (7), 72, 2021. https://doi.org/10.3390/data6070072
"""

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import contract
import numpy as np
from peers import (
    PEERS,
    SHARED_DATA,
    Floats,
    attitude,
    inclination,
    require_data,
    total,
)
from rich.console import Console
from rich.table import Table

from ahrs_service.app.estimate.arrays import estimate_columns
from ahrs_service.app.estimate.sample_columns import read_columns
from ahrs_service.app.files import config_file
from ahrs_service.settings import Settings

PROFILE = "hand_held"
OURS = {"ours": Settings().fusion.mode, "ours gated": "gated"}
OFFLINE = "ours offline"
LAGS_S = np.arange(-0.016, 0.0161, 0.002)


@dataclass(frozen=True)
class Trial:
    """One trial: columns as given, and which samples are scored."""

    path: Path
    gyr: Floats
    acc: Floats
    mag: Floats
    rate_hz: float
    scored: Any
    reference: Floats

    @property
    def name(self) -> str:
        """The file's name without its suffix."""
        return self.path.stem


def read_trial(path: Path) -> Trial:
    """Read one .npz."""
    with np.load(path) as file:
        columns = {name: file[name] for name in file.files}
    quat = columns["opt_quat"].astype(np.float64)
    scored = np.flatnonzero(columns["movement"] & np.isfinite(quat).all(axis=1))
    reference = quat[scored] / np.linalg.norm(quat[scored], axis=1, keepdims=True)
    vectors = [columns[name].astype(np.float64) for name in ("imu_gyr", "imu_acc", "imu_mag")]
    return Trial(path, *vectors, float(columns["sampling_rate"]), scored, reference)


def answers(name: str, trial: Trial) -> tuple[Floats, Floats]:
    """Attitudes [N, 4] by six and by nine axes."""
    if name == OFFLINE:
        out = contract.run_estimate(trial.path, PROFILE, "flu", "--offline")
        return out["quat"], out["quat9"]
    if name in OURS:
        settings = config_file.load(None, [f"fusion.mode={OURS[name]}"], PROFILE)
        out = estimate_columns(read_columns(trial.path), settings, "flu")
        return out["quat"], out["quat9"]
    t = np.arange(len(trial.gyr)) / trial.rate_hz
    return (
        attitude(name, trial.gyr, trial.acc, t),
        attitude(name, trial.gyr, trial.acc, t, trial.mag),
    )


def _delayed(quat: Floats, trial: Trial, lag_s: float) -> Floats:
    """What the output [N, 4] says `lag_s` after each scored sample."""
    place = np.clip(trial.scored + lag_s * trial.rate_hz, 0.0, len(quat) - 1.0)
    before = np.minimum(place.astype(np.int64), len(quat) - 2)
    share = (place - before)[:, None]
    a, b = quat[before], quat[before + 1]
    b = np.where((a * b).sum(axis=1, keepdims=True) < 0.0, -b, b)
    mixed = (1.0 - share) * a + share * b
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))


def _rmse_deg(error: Floats) -> float:
    return float(np.degrees(np.sqrt(np.mean(error * error))))


def errors_at(quats: list[Floats], trials: list[Trial], measure: Any, lag_s: float) -> list[float]:
    """RMSE [deg] of each trial with a lag taken out."""
    return [
        _rmse_deg(measure(_delayed(quat, trial, lag_s), trial.reference))
        for quat, trial in zip(quats, trials, strict=True)
    ]


def best_lag(quats: list[Floats], trials: list[Trial], measure: Any) -> float:
    """The one lag [s] with the smallest mean error: the best of a grid, refined by a parabola."""
    means = [float(np.mean(errors_at(quats, trials, measure, lag))) for lag in LAGS_S]
    best = min(max(int(np.argmin(means)), 1), len(means) - 2)
    low, middle, high = means[best - 1 : best + 2]
    curvature = low - 2.0 * middle + high
    offset = 0.5 * (low - high) / curvature if curvature > 0.0 else 0.0
    return float(LAGS_S[best] + float(np.clip(offset, -1.0, 1.0)) * (LAGS_S[1] - LAGS_S[0]))


def measure_algorithm(name: str, trials: list[Trial]) -> dict[str, Any]:
    """Errors [deg] of one algorithm, as is and without its lag."""
    both = [answers(name, trial) for trial in trials]
    result: dict[str, Any] = {}
    for label, quats, measure in (
        ("inclination", [six for six, _ in both], inclination),
        ("total", [nine for _, nine in both], total),
    ):
        lag_s = best_lag(quats, trials, measure)
        result[label] = errors_at(quats, trials, measure, 0.0)
        result[f"{label}_without_lag"] = errors_at(quats, trials, measure, lag_s)
        result[f"{label}_lag_s"] = lag_s
    return result


def table(title: str, key: str, results: dict[str, Any], trials: list[Trial]) -> Table:
    """Errors by trial and algorithm, the mean, and the lag."""
    out = Table(title=title, title_justify="left", padding=(0, 1), show_edge=False)
    out.add_column("RMSE [deg]")
    for name in results:
        out.add_column(name, justify="right")
    for n, trial in enumerate(trials):
        out.add_row(trial.name, *(f"{result[key][n]:.2f}" for result in results.values()))
    out.add_section()
    out.add_row("mean", *(f"{np.mean(result[key]):.3f}" for result in results.values()))
    if key.endswith("_without_lag"):
        lags = [result[key.replace("_without_lag", "_lag_s")] for result in results.values()]
        out.add_row("lag [ms]", *(f"{1e3 * lag:.1f}" for lag in lags))
    return out


def check_command(trial: Trial) -> None:
    """Run the command on one trial; leave with an error where it answers otherwise."""
    said = contract.run_estimate(trial.path, PROFILE, "flu")
    for ours, theirs in zip(answers("ours", trial), (said["quat"], said["quat9"]), strict=True):
        if not np.array_equal(ours, theirs):
            raise SystemExit(f"{trial.name}: the command's answer differs from the function's")


def main() -> int:
    """Run all and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA / "broad", metavar="DIR")
    parser.add_argument("--no-ahrs", action="store_true", help="leave out what is slow (minutes)")
    parser.add_argument("--only-ours", action="store_true")
    parser.add_argument("--contract", action="store_true", help="all trials by the command too")
    parser.add_argument("--json", type=Path, metavar="OUT")
    args = parser.parse_args()
    data = require_data(args.data, "the BROAD trials as .npz")
    paths = sorted(data.glob("*.npz"))
    if not paths:
        raise SystemExit(f"{data} holds no .npz: give --data DIR with the BROAD trials")
    trials = [read_trial(path) for path in paths]
    names = [*OURS, OFFLINE] if contract.offers("--offline") else [*OURS]
    if not args.only_ours:
        left_out = ("Mahony", "Madgwick") if args.no_ahrs else ()
        names += [name for name in PEERS if not left_out or not name.startswith(left_out)]
    log = Console(stderr=True)
    checked = trials if args.contract else trials[:1]
    for trial in checked:
        check_command(trial)
    log.print(f"the command gives the same bytes on {len(checked)} trials", highlight=False)
    results = {}
    for name in names:
        log.print(name, highlight=False)
        results[name] = measure_algorithm(name, trials)
    # The tables are as wide as they are, on a screen or in a file.
    out = Console(width=60 + 30 * len(names))
    for title, key in (
        ("Inclination, six axes, as is", "inclination"),
        ("Inclination, six axes, one lag per algorithm fitted out", "inclination_without_lag"),
        ("Total, nine axes, as is", "total"),
        ("Total, nine axes, one lag per algorithm fitted out", "total_without_lag"),
    ):
        out.print(table(title, key, results, trials))
        out.print()
    if args.json is not None:
        plain = {"trials": [trial.name for trial in trials], "algorithms": results}
        args.json.write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
