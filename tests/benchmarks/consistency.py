"""Is the filter as sure as it may be? Its 1-sigma against its true error, on simulated flights.

Run: python tests/benchmarks/consistency.py [--runs N] [--seconds S] [--phases] [--drawn]
                                           [--data DIR] [--no-flights] [--json OUT]

NEES is the squared error in the metric of the filter's own covariance, psi^T P^-1 psi; divided by
its number of axes it is 1 for a consistent filter, above for one too sure of itself, and its root
is the factor by which sigma is short. "tilt" is about the estimated north and east, of six axes
whatever the heading; "heading" about down; "attitude" all three. The flights of a row are
independent draws, its instants, 0.5 s apart, are not: at each instant the mean over the flights of
a consistent filter lies in the interval of a chi-square (Bar-Shalom, Li, Kirubarajan 2001, sec.
5.4). "bounds" is that interval, "in it" whether the mean over all instants lies there too and for
which share of the instants it does, and "+-" twice the standard error of the mean by the scatter of
the flights. rms and sigma in deg.

"drawn" are flights whose errors of sensors and motion are random with the 1-sigmas that the
settings of the class state (class_ensemble.py): the ensemble that the filter is built for, for
which it has to be 1. "unit" are the scenarios of `ahrs-service simulate`, each with its own wind,
turbulence and sibling of the sensor: units of consumer grade in motion that hugs the class's idea
of it (no sideslip, little angle of attack), so better than the filter may assume, and below 1.

NIS is the square of the gate's tilt innovation in its own sigmas over 2, where the gate was open.
The variance that the gate takes for accelerations is a bound for all of them and not that of white
noise, so it is a consistent filter's where it is not above 1. The last table is of the real flights
in DIR (coverage_in_flight.py).
"""

import argparse
import itertools
import json
import math
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from coverage_in_flight import Coverage, coverage, coverage_table
from ensemble import class_ensemble
from error_angle import error_angle
from flight_recordings import LOGS, read_flight, recordings
from peers import SHARED_DATA, require_data
from rich.console import Console
from rich.table import Table

from ahrs_service.estimator import Estimator
from ahrs_service.records import ESTIMATE_DTYPE, Airframe, Floats, Phase, Rows, empty
from ahrs_service.settings import FusionSettings, Settings
from ahrs_service.simulation.environment import FIELD_NED_UT
from ahrs_service.simulation.phases import Phase as FlightPhase
from ahrs_service.simulation.samples import samples_of
from ahrs_service.simulation.scenario import SCENARIOS, make_flight

RATE_HZ = class_ensemble.RATE_HZ
INSTANT_SAMPLES = 50
LONG = {"seed-flight": 3.0}
"""How many times longer than the others a scenario is flown."""
DRAWN = (
    ("fixed_wing", "flight"),
    ("fixed_wing", "circling"),
    ("fixed_wing", "seed-flight"),
    ("multirotor", "moved"),
    ("hand_held", "moved"),
    ("ground_test", "rest"),
    ("ground_test", "rate-table"),
    ("ground_test", "rate-table-oblique"),
)
"""Profiles and what is flown, by six axes."""
UNITS = (("flight", 6), ("flight", 9), ("circling", 6), ("seed-flight", 6), ("rest", 6))
"""Scenarios and axes, as fixed wings."""
MODES = ("velocity", "gated")
PARTS = {"tilt": (0, 1), "heading": (2,), "attitude": (0, 1, 2)}
PARTS_OF = {6: ("tilt",), 9: ("tilt", "heading", "attitude")}


@dataclass(frozen=True)
class Run:
    """One flight at its instants [K]: time, error angle about estimated north, east, down, P."""

    phases: tuple[FlightPhase, ...]
    time_s: Floats
    psi: Floats
    covariance: Floats
    innovation2: Floats


@dataclass(frozen=True)
class Verdict:
    """What many runs say, per axis: NEES, the bounds of its mean at an instant, NIS, rms, sigma.

    `inside` is where the mean NEES was in its bounds, `spread` twice the standard error of the mean
    of all, `covered` the shares within 1, 2, 3 sigma.
    """

    what: str
    sensor: str
    mode: str
    axes: int
    part: str
    nees: float
    spread: float
    bounds: tuple[float, float]
    inside: float
    covered: tuple[float, float, float]
    rms_deg: float
    sigma_deg: float
    nis: float

    @property
    def is_inside(self) -> bool:
        """Whether the mean of all lies within the bounds."""
        return self.bounds[0] < self.nees < self.bounds[1]


def follow(
    samples: Rows,
    settings: Settings,
    truth: Floats,
    axes: int = 6,
    phases: tuple[FlightPhase, ...] = (),
) -> Run:
    """Estimate, and keep error and covariance at every instant after the alignment."""
    estimator, estimates = Estimator(settings), empty(ESTIMATE_DTYPE, len(samples))
    ends, covariance = range(INSTANT_SAMPLES, len(samples) + 1, INSTANT_SAMPLES), []
    for end in ends:
        part = slice(end - INSTANT_SAMPLES, end)
        estimates[part] = estimator.run(samples[part])
        covariance.append(estimator.state["covariance"][0, :3, :3].copy())
    last = np.array(ends) - 1
    running = estimates["phase"][last] == Phase.RUNNING
    last = last[running]
    psi = error_angle(truth[last], estimates["ned_from_body"][last], axes)
    open_gate = (estimates["gate"] == 0) & (estimates["phase"] == Phase.RUNNING)
    innovation2 = estimates["gate_innovation"][open_gate] ** 2
    return Run(phases, last / RATE_HZ, psi, np.array(covariance)[running], innovation2)


def fly_unit(scenario: str, mode: Any, axes: int, seconds: float, seed: int) -> Run:
    """Fly a scenario once, with a sibling of its sensor."""
    sensor = SCENARIOS[scenario].imu.sibling(np.random.default_rng([seed, 99]))
    flight = make_flight(scenario, seconds, seed, RATE_HZ, sensor)
    samples = samples_of(flight, Airframe.FIXED_WING, magnetometer=axes == 9)
    declination = math.degrees(math.atan2(FIELD_NED_UT[1], FIELD_NED_UT[0]))
    settings = Settings(fusion=FusionSettings(mode=mode, declination_deg=declination))
    return follow(samples, settings, flight.rows["ned_from_body"], axes, flight.phases)


def fly_drawn(profile: str, scenario: str, mode: str, seconds: float, seed: int) -> Run:
    """Fly a flight drawn from the settings of a profile once."""
    drawn = class_ensemble.draw(profile, scenario, seconds, seed, mode)
    return follow(drawn.samples, drawn.settings, drawn.ned_from_body)


def nees(run: Run, part: str) -> Floats:
    """NEES per axis [K] of one of PARTS."""
    chosen = PARTS[part]
    psi, p = run.psi[:, chosen], run.covariance[:, chosen][:, :, chosen]
    return np.einsum("ki,ki->k", psi, np.linalg.solve(p, psi[:, :, None])[:, :, 0]) / len(chosen)


def variances(run: Run, part: str) -> Floats:
    """Variances [K, M] of one of PARTS."""
    return run.covariance[:, PARTS[part], PARTS[part]]


def chi_square_mean_interval(freedom: int) -> tuple[float, float]:
    """95 % interval of a chi-square over its `freedom` (Wilson, Hilferty 1931)."""
    spread = 2.0 / (9.0 * freedom)
    low, high = ((1.0 - spread + z * math.sqrt(spread)) ** 3 for z in (-1.96, 1.96))
    return low, high


def judge(runs: list[Run], what: str, sensor: str, mode: str, axes: int, part: str) -> Verdict:
    """Put many runs together."""
    instants = min(len(run.time_s) for run in runs)
    each = np.array([nees(run, part)[-instants:] for run in runs])
    low, high = chi_square_mean_interval(len(PARTS[part]) * len(runs))
    mean = each.mean(axis=0)
    psi = np.concatenate([run.psi[:, PARTS[part]] for run in runs])
    sigma2 = np.concatenate([variances(run, part) for run in runs])
    ratio = np.abs(psi) / np.sqrt(sigma2)
    innovation2 = np.concatenate([run.innovation2 for run in runs])
    return Verdict(
        what=what,
        sensor=sensor,
        mode=mode,
        axes=axes,
        part=part,
        nees=float(each.mean()),
        spread=2.0 * float(each.mean(axis=1).std(ddof=1)) / math.sqrt(len(runs)),
        bounds=(low, high),
        inside=float(np.mean((mean > low) & (mean < high))),
        covered=tuple(float(np.mean(ratio < limit)) for limit in (1.0, 2.0, 3.0)),
        rms_deg=math.degrees(math.sqrt(np.mean(psi**2))),
        sigma_deg=math.degrees(math.sqrt(np.mean(sigma2))),
        nis=float(innovation2.mean() / 2.0) if len(innovation2) else math.nan,
    )


def by_phase(runs: list[Run], part: str) -> Iterator[tuple[str, float, float, float]]:
    """Yield for each phase of the plan its name, NEES per axis, rms error and sigma [deg]."""
    phases = runs[0].phases
    names = np.array([phase.name for phase in phases])
    ends = np.cumsum([phase.seconds for phase in phases])[:-1]
    which = np.concatenate([names[np.searchsorted(ends, run.time_s)] for run in runs])
    values = np.concatenate([nees(run, part) for run in runs])
    psi2 = np.concatenate([np.mean(run.psi[:, PARTS[part]] ** 2, axis=1) for run in runs])
    sigma2 = np.concatenate([variances(run, part).mean(axis=1) for run in runs])
    for name in dict.fromkeys(names.tolist()):
        here = which == name
        if here.any():
            rms, sigma = np.degrees(np.sqrt([psi2[here].mean(), sigma2[here].mean()]))
            yield name, float(values[here].mean()), float(rms), float(sigma)


def table_of(verdicts: list[Verdict], runs: int) -> Table:
    """Return the table of all cases."""
    table = Table(title=f"{runs} flights each; the first row is what a consistent filter has")
    for heading in ("flown", "sensor", "mode", "axes", "part"):
        table.add_column(heading, no_wrap=True)
    for heading in (
        *("NEES", "+-", "bounds", "in it", "at", "<1s", "<2s", "<3s", "rms", "sigma", "NIS"),
    ):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_row(*("", "", "", "", "", "1", "", "", "yes", "95", "68", "95", "99.7"), "", "", "<1")
    for one in verdicts:
        shares = (100.0 * share for share in (one.inside, *one.covered))
        low, high = one.bounds
        table.add_row(
            *(one.what, one.sensor, one.mode, str(one.axes), one.part),
            *(f"{one.nees:.2f}", f"{one.spread:.2f}", f"{low:.2f}..{high:.2f}"),
            "yes" if one.is_inside else "no",
            *(f"{share:.{digits}f}" for share, digits in zip(shares, (0, 0, 0, 1), strict=True)),
            *(f"{value:.2f}" for value in (one.rms_deg, one.sigma_deg, one.nis)),
        )
    return table


def phase_table(runs: list[Run], title: str, part: str) -> Table:
    """Return the table of one case by phase of flight."""
    table = Table(title=title)
    table.add_column("phase", no_wrap=True)
    for heading in ("NEES", "sigma short", "rms [deg]", "sigma [deg]"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, value, rms, sigma in by_phase(runs, part):
        table.add_row(name, *(f"{v:.2f}" for v in (value, math.sqrt(value), rms, sigma)))
    return table


def real_flights(data: Path) -> dict[str, tuple[Coverage, Coverage, Coverage]]:
    """Return how sigma covers the error on each recording: flown, aided in flight, on ground."""
    found = {}
    for name, path in recordings(
        require_data(data, "the flight recordings"), list(LOGS), False
    ).items():
        flight = read_flight(name, path)
        flown, grounded = coverage(flight, aided=False)
        found[name] = flown, coverage(flight, aided=True)[0], grounded
    return found


def main() -> int:
    """Fly, judge, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=_Plain)
    parser.add_argument("--runs", type=int, default=30, help="flights of each case")
    parser.add_argument("--seconds", type=float, default=90.0, help="length of a flight")
    parser.add_argument("--phases", action="store_true", help="units also by phase of flight")
    parser.add_argument("--drawn", action="store_true", help="drawn flights only")
    parser.add_argument("--data", type=Path, default=SHARED_DATA / "flights", metavar="DIR")
    parser.add_argument("--no-flights", action="store_true", help="simulated flights only")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the figures here too")
    args = parser.parse_args()
    verdicts, tables, seeds = [], [], range(1, args.runs + 1)
    for (profile, scenario), mode in itertools.product(DRAWN, MODES):
        seconds = args.seconds * LONG.get(scenario, 1.0)
        runs = [fly_drawn(profile, scenario, mode, seconds, seed) for seed in seeds]
        verdicts.append(judge(runs, f"{profile} {scenario}", "drawn", mode, 6, "tilt"))
    for (scenario, axes), mode in itertools.product(() if args.drawn else UNITS, MODES):
        seconds = args.seconds * LONG.get(scenario, 1.0)
        runs = [fly_unit(scenario, mode, axes, seconds, seed) for seed in seeds]
        for part in PARTS_OF[axes]:
            verdicts.append(judge(runs, f"fixed_wing {scenario}", "unit", mode, axes, part))
            if args.phases:
                title = f"{scenario}, unit, {mode}, {axes} axes, {part}"
                tables.append(phase_table(runs, title, part))
    if not args.no_flights:
        tables.append(coverage_table(real_flights(args.data)))
    Console(width=160).print(table_of(verdicts, args.runs), *tables)
    if args.json is not None:
        args.json.write_text(json.dumps([asdict(one) for one in verdicts], indent=1) + "\n")
    return 0


_Plain = argparse.RawDescriptionHelpFormatter


if __name__ == "__main__":
    sys.exit(main())
