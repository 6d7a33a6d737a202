"""Simulated flights under whatever goes wrong: ours against the best of three peers.

Run: python tests/benchmarks/robustness.py [--seeds N] [--only WORD] [--all]

Each case is a flight of 120 s, its sensor, its weather, and what was done to the samples. The error
is the angle between the true and the estimated vertical; RMS and largest [deg] from 2 s after the
start on, mean and maximum over the seeds. All get the same plain arrays through the code of
`ahrs-service estimate`; ours with the profile of the class. "sure" is the largest error in
its own 1-sigma; "alarm" where an error above 5 deg is more than 5 sigma for over 1 % of the time.
Printed are the cases in which ours is worse than the best peer, or alarming; with --all every one.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import robustness_flights as make
from peers import attitude, flu_from_frd, frd_attitude, inclination
from rich.console import Console
from rich.progress import track
from rich.table import Table

from ahrs_service.app.estimate.arrays import estimate_columns
from ahrs_service.app.estimate.sample_columns import columns_of
from ahrs_service.app.files import config_file
from ahrs_service.records import Floats, Rows
from ahrs_service.simulation.environment import magnetic_field_ut

SECONDS = 120.0
SCORED_FROM_S = 2.0
IRON_UT = np.array([30.0, 0.0, 0.0])
PEERS = ("vqf", "vqf tauAcc 10", "Fusion gain .5 rej 10")
Fields = dict[str, Any]
Edit = Callable[[Fields, np.random.Generator], None]


@dataclass(frozen=True)
class Case:
    """One flight: its class, rate, sensor, weather and start, and edits of its samples."""

    name: str
    kind: str = "fixed_wing"
    rate_hz: float = 100.0
    grade: str = "consumer"
    wind_m_s: float = 4.0
    turbulence: float = 1.0
    flown: str = "flight"
    start: str = ""
    aided: bool = False
    magnetometer: bool = False
    frame: str = "frd"
    edits: tuple[Edit, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """Errors [deg] of ours and of each peer; how many sigma the largest was; an alarm."""

    ours: tuple[float, float]
    peers: dict[str, tuple[float, float]]
    sigmas: float
    alarm: bool


def truth_of(case: Case, seed: int) -> Rows:
    """The true motion."""
    rate, wind, gusts = case.rate_hz, case.wind_m_s, case.turbulence
    if case.kind == "multirotor":
        truth = make.multirotor(SECONDS, rate, wind, gusts, seed)
    else:
        truth = make.fixed_wing(SECONDS, rate, wind, gusts, seed, case.flown)
    match case.start:
        case "taxi":
            return make.in_the_air(truth, 20.0)
        case "turn":
            return make.in_the_air(truth, 55.0)
        case "over":
            return make.turned_over(truth, rate)
        case "thrown":
            return make.thrown(truth, 45.0, rate)
    return truth


def fields_of(case: Case, truth: Rows, seed: int) -> Fields:
    """What the sensors give, as IN.npz has it; `row` [N] is the truth's row of each."""
    rng = np.random.default_rng([seed, 7])
    warm = np.full(len(truth), 25.0)
    gyro, accel = make.imu_of(case.grade, seed).measure(truth, warm, case.rate_hz, rng)
    fields: Fields = {
        "imu_gyr": gyro,
        "imu_acc": accel,
        "t": truth["time_s"].copy(),
        "row": np.arange(len(truth)),
    }
    if case.magnetometer:
        fields["imu_mag"] = magnetic_field_ut(truth) + rng.normal(0.0, 0.5, (len(truth), 3))
    if case.aided:
        late = np.maximum(np.arange(len(truth)) - round(0.2 * case.rate_hz), 0)
        velocity = truth["velocity_ned_m_s"][late] + rng.normal(0.0, 0.2, (len(truth), 3))
        velocity[np.arange(len(truth)) % max(round(case.rate_hz / 5.0), 1) != 0] = np.nan
        fields["vel_ned"] = velocity
        if case.kind == "fixed_wing":
            fields["airspeed"] = truth["airspeed_m_s"] + rng.normal(0.0, 0.4, len(truth))
    for edit in case.edits:
        edit(fields, rng)
    return fields


def _keep(fields: Fields, chosen: Any) -> None:
    for name in fields:
        fields[name] = fields[name][chosen]


def gap(start_s: float, length_s: float) -> Edit:
    """No sample for so long."""

    def edit(fields: Fields, rng: np.random.Generator) -> None:
        t = fields["t"]
        _keep(fields, (t < start_s) | (t > start_s + length_s))

    return edit


def gaps(length_s: float, every_s: float) -> Edit:
    """A gap again and again."""

    def edit(fields: Fields, rng: np.random.Generator) -> None:
        _keep(fields, (fields["t"] < 10.0) | (fields["t"] % every_s > length_s))

    return edit


def dropped(share: float) -> Edit:
    """Samples lost at random."""

    def edit(fields: Fields, rng: np.random.Generator) -> None:
        _keep(fields, rng.random(len(fields["t"])) >= share)

    return edit


def doubled(share: float) -> Edit:
    """Samples that come twice."""

    def edit(fields: Fields, rng: np.random.Generator) -> None:
        count = len(fields["t"])
        again = np.flatnonzero(rng.random(count) < share)
        _keep(fields, np.sort(np.concatenate([np.arange(count), again])))

    return edit


def jittered(share: float) -> Edit:
    """Stamps that are wrong by a share of the step."""

    def edit(fields: Fields, rng: np.random.Generator) -> None:
        step = float(np.median(np.diff(fields["t"])))
        fields["t"] = fields["t"] + step * share * rng.uniform(-1.0, 1.0, len(fields["t"]))

    return edit


def reordered(share: float) -> Edit:
    """VehicleAdoption that changed places."""

    def edit(fields: Fields, rng: np.random.Generator) -> None:
        order = np.arange(len(fields["t"]))
        for n in np.flatnonzero(rng.random(len(order) - 1) < share):
            order[[n, n + 1]] = order[[n + 1, n]]
        _keep(fields, order)

    return edit


def _during(fields: Fields, start_s: float, length_s: float) -> Any:
    return (fields["t"] >= start_s) & (fields["t"] < start_s + length_s)


def stuck(name: str, axis: int, start_s: float, length_s: float) -> Edit:
    """An axis that shows what it showed."""

    def edit(fields: Fields, rng: np.random.Generator) -> None:
        chosen = _during(fields, start_s, length_s)
        fields[name][chosen, axis] = fields[name][chosen, axis][0]

    return edit


def clipped(name: str, limit: float, start_s: float, length_s: float) -> Edit:
    """A sensor that clips."""

    def edit(fields: Fields, rng: np.random.Generator) -> None:
        chosen = _during(fields, start_s, length_s)
        fields[name][chosen] = np.clip(fields[name][chosen], -limit, limit)

    return edit


def spikes(name: str, size: float, share: float) -> Edit:
    """Single samples that are far off."""

    def edit(fields: Fields, rng: np.random.Generator) -> None:
        chosen = rng.random(len(fields["t"])) < share
        fields[name][chosen] += rng.uniform(-size, size, (int(chosen.sum()), 3))

    return edit


def missing(name: str, start_s: float, length_s: float) -> Edit:
    """NaN for so long."""

    def edit(fields: Fields, rng: np.random.Generator) -> None:
        fields[name][_during(fields, start_s, length_s)] = np.nan

    return edit


def changed(name: str, change: Callable[[Floats], Floats]) -> Edit:
    """Any change of one field."""

    def edit(fields: Fields, rng: np.random.Generator) -> None:
        fields[name] = change(fields[name])

    return edit


def late(seconds: float, rate_hz: float = 100.0) -> Edit:
    """A velocity that comes later still."""
    return changed("vel_ned", lambda v: np.roll(v, round(seconds * rate_hz), axis=0))


def narrow(fields: Fields, rng: np.random.Generator) -> None:
    """All in float32."""
    for name in fields:
        if name != "row":
            fields[name] = fields[name].astype(np.float32)


def flipped(fields: Fields, rng: np.random.Generator) -> None:
    """Axes forward, left, up."""
    for name in ("imu_gyr", "imu_acc"):
        fields[name] = flu_from_frd(fields[name])


def _both(name: str, **more: Any) -> list[Case]:
    return [Case(name, kind=kind, **more) for kind in ("fixed_wing", "multirotor")]


def cases() -> list[Case]:
    """All cases."""
    found: list[Case] = []
    for grade in ("consumer", "poor"):
        for rate in (10.0, 25.0, 50.0, 100.0, 250.0, 400.0, 1000.0):
            found += _both(f"{grade} {rate:.0f} Hz", rate_hz=rate, grade=grade)
    for wind, gusts in ((0.0, 0.0), (12.0, 1.0), (12.0, 3.0)):
        found += _both(f"wind {wind:.0f} gusts {gusts:.0f}", wind_m_s=wind, turbulence=gusts)
    found.append(Case("circling", flown="circling"))
    found.append(Case("circling, poor", flown="circling", grade="poor"))
    for start in ("taxi", "turn", "over", "thrown"):
        for grade in ("consumer", "poor"):
            kinds = _both(f"start {start}, {grade}", start=start, grade=grade)
            found += kinds if start in ("turn", "over") else kinds[:1]
    for length in (0.2, 0.6, 1.0, 3.0, 6.0, 10.0):
        found += _both(f"gap {length:g} s in a manoeuvre", edits=(gap(55.0, length),))
    found += _both("gap 0.4 s every 5 s", edits=(gaps(0.4, 5.0),))
    found += _both("gap 1 s every 10 s", edits=(gaps(1.0, 10.0),))
    for share in (0.05, 0.2, 0.5):
        found += _both(f"{100 * share:.0f} % dropped", edits=(dropped(share),))
    found += _both("half doubled", edits=(doubled(0.5),))
    found += _both("stamps 30 % off", edits=(jittered(0.3),))
    found += _both("neighbours swapped", edits=(reordered(0.05),))
    found += _both("stuck gyro x 1 s", edits=(stuck("imu_gyr", 0, 50.0, 1.0),))
    found += _both("stuck gyro z 5 s", edits=(stuck("imu_gyr", 2, 50.0, 5.0),))
    found += _both("stuck force x 5 s", edits=(stuck("imu_acc", 0, 50.0, 5.0),))
    found += _both("gyro clips at 0.3 rad/s 2 s", edits=(clipped("imu_gyr", 0.3, 50.0, 2.0),))
    found += _both("force clips at 9 m/s2 2 s", edits=(clipped("imu_acc", 9.0, 50.0, 2.0),))
    found += _both("force spikes 1 %", edits=(spikes("imu_acc", 100.0, 0.01),))
    found += _both("gyro spikes 0.2 %", edits=(spikes("imu_gyr", 30.0, 0.002),))
    found += _both("force NaN 10 s", edits=(missing("imu_acc", 50.0, 10.0),))
    found += _both("gyro NaN 2 s", edits=(missing("imu_gyr", 50.0, 2.0),))
    found += _both("float32", edits=(narrow,))
    found += _both("flu", edits=(flipped,), frame="flu")
    found += _both(
        "iron 30 uT", magnetometer=True, edits=(changed("imu_mag", lambda m: m + IRON_UT),)
    )
    aiding: dict[str, tuple[Edit, ...]] = {
        "as it is": (),
        "gone from 50 to 80 s": (missing("vel_ned", 50.0, 30.0),),
        "axes swapped": (changed("vel_ned", lambda v: v[:, [1, 0, 2]]),),
        "turned about": (changed("vel_ned", lambda v: -v),),
        "down for up": (changed("vel_ned", lambda v: v * [1.0, 1.0, -1.0]),),
        "1 s late": (late(0.8),),
        "0": (changed("vel_ned", np.zeros_like),),
        "10 m/s for ever": (changed("vel_ned", lambda v: np.full_like(v, 10.0)),),
        "NaN": (changed("vel_ned", lambda v: np.full_like(v, np.nan)),),
        "outliers": (spikes("vel_ned", 100.0, 0.05),),
        "knots": (changed("vel_ned", lambda v: 1.94 * v),),
    }
    for name, edits in aiding.items():
        found += _both(f"velocity {name}", aided=True, edits=edits)
    found.append(Case("airspeed 0 from 50 s", aided=True, edits=(stuck_speed(0.0),)))
    found.append(Case("airspeed 35 from 50 s", aided=True, edits=(stuck_speed(35.0),)))
    return found


def stuck_speed(speed_m_s: float) -> Edit:
    """A pitot tube that shows one number from 50 s on."""
    return lambda fields, rng: fields["airspeed"].__setitem__(fields["t"] > 50.0, speed_m_s)


def run_case(case: Case, seed: int) -> Outcome:
    """Fly one case with one seed."""
    truth = truth_of(case, seed)
    fields = fields_of(case, truth, seed)
    row = fields.pop("row")
    reference = frd_attitude(truth["ned_from_body"][row])
    scored = np.arange(len(row)) >= np.searchsorted(
        np.maximum.accumulate(fields["t"]), SCORED_FROM_S
    )
    out = estimate_columns(columns_of(fields), config_file.load(profile=case.kind), case.frame)
    quat = out["quat9" if case.magnetometer else "quat"]
    quat = quat if case.frame == "flu" else frd_attitude(quat)
    error = np.degrees(inclination(quat, reference))[scored]
    if not np.isfinite(error).all():
        raise SystemExit(f"{case.name}, {case.kind}, seed {seed}: an attitude is not finite")
    sigma = np.hypot(*out["sigma_deg"][scored, :2].T)
    wrong = (error > 5.0) & (error > 5.0 * sigma)
    turn = (lambda v: v) if case.frame == "flu" else flu_from_frd
    peers = {}
    for name in PEERS:
        other = attitude(
            name,
            turn(fields["imu_gyr"].astype(float)),
            turn(fields["imu_acc"].astype(float)),
            fields["t"].astype(float),
        )
        peers[name] = _figures(np.degrees(inclination(other, reference))[scored])
    return Outcome(_figures(error), peers, float((error / sigma).max()), bool(wrong.mean() > 0.01))


def _figures(error: Floats) -> tuple[float, float]:
    return float(np.sqrt(np.mean(error * error))), float(error.max())


def main() -> int:
    """Run all and print the table; 0 whatever it says."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3, metavar="N")
    parser.add_argument("--only", default="", metavar="WORD", help="cases whose name has this")
    parser.add_argument("--all", action="store_true", help="print good cases too")
    args = parser.parse_args()
    table = Table(padding=(0, 1), show_edge=False)
    for column in ("case", "class", "ours rms, max", "best peer rms, max", "", "share", "sure", ""):
        table.add_column(column)
    chosen = [case for case in cases() if args.only in case.name]
    good = 0
    for case in track(chosen, console=Console(stderr=True)):
        outcomes = [run_case(case, seed) for seed in range(1, args.seeds + 1)]
        rms, most = _mean([one.ours for one in outcomes])
        pooled = {name: _mean([one.peers[name] for one in outcomes]) for name in PEERS}
        best = min(pooled, key=lambda name: pooled[name][0])
        alarm = any(one.alarm for one in outcomes)
        if rms <= pooled[best][0] and not alarm:
            good += 1
            if not args.all:
                continue
        table.add_row(
            case.name,
            case.kind,
            f"{rms:.2f} {most:.1f}",
            f"{pooled[best][0]:.2f} {pooled[best][1]:.1f}",
            best,
            f"{rms / pooled[best][0]:.2f}",
            f"{max(one.sigmas for one in outcomes):.1f}",
            "alarm" if alarm else "",
        )
    out = Console(width=130)
    out.print(table)
    out.print(f"{good} of {len(chosen)} cases better than every peer and without alarm")
    return 0


def _mean(figures: list[tuple[float, float]]) -> tuple[float, float]:
    return float(np.mean([one[0] for one in figures])), max(one[1] for one in figures)


if __name__ == "__main__":
    sys.exit(main())
