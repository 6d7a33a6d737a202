"""Each attitude's own error of tilt, by a GPS and by no other attitude.

Run: python tests/benchmarks/own_error.py [--data DIR] [--logs NAME ...] [--no-ahrs] [--seeds N]

Over a window between two fixes, T = 1 s or the GPS's step, an attitude's horizontal residual is

    r = (v(t1) - v(t0)) / T - mean(R f + g),    E = mean |r / mean(R f)_z|^2 = e^2 + n^2

with e its error of tilt [rad] and n the GPS's noise, the same for every attitude A. What takes n^2
away is a smoother S (gps_smoother.py) that has not heard the fixes it is judged by: blocks of 2 s
are left out, every third in one of three runs, and in them

    e_A^2 = E_A - E_S        (A with the heading and the calibrated force of S)

n is not in the difference, whatever it is, since neither A nor S knows it. What the smoother errs
by itself within such a gap lowers e_A^2, and a constant tilt that it takes for the accelerometer's
bias raises it, both by some 0.3^2 deg^2; of an attitude that is as good as the smoother little more
can be said, and the root of what is negative is printed as 0. What every filter with this IMU has
in common is seen by none. Windows where S misses by more than six medians (a glitch of the GPS) or
where the force has lost its vertical part (below g / 2) are left out; errors that change within T
are averaged. "Ours aided" knows the GPS: its n is not free.

In brackets the 95 % interval, a bootstrap over blocks of 10 s, for the share of ours with the same
draws. Simulated flights show that it holds: there the truth is known, the GPS has white and slow
noise and a lag, and a third of the error of Mahony's filter, which is what a DCM is, plays the
autopilot's: its share of ours is far from the true one, that of the GPS is not. "smoother" is by
how much S errs there when it has heard every fix.
"""

import argparse
import itertools
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from flight_recordings import LOGS, Flight, read_flight
from flights import estimates_of
from gps_reference import GpsReference, smoothed, usable
from gps_velocity import GpsVelocity, gps_velocity
from peers import G0, PEERS, SHARED_DATA, Floats, inclination, require_data
from rich.console import Console
from rich.table import Table
from second_reference import NAMES
from tilt_witness import track

from ahrs_service.links.logs.recording import AttitudeReference
from ahrs_service.links.logs.recording_formats import read_recording
from ahrs_service.records import Airframe, Phase
from ahrs_service.rotation import inverse_columns, multiply_columns, rotate_columns
from ahrs_service.simulation.samples import samples_of
from ahrs_service.simulation.scenario import make_flight

FOLDS = 3
BLOCK_S = 2.0
WINDOW_S = 1.0
OUTLIER = 6.0
LEAST_VERTICAL = 0.5 * G0
BOOTSTRAP_S = 10.0
DRAWS = 1000
SIMULATED = (("flight", 300.0), ("circling", 300.0), ("seed-flight", 600.0))
SIMULATED_HZ = 50.0
FIX_S, LATE_NS = 0.2, 200_000_000
NOISE_M_S, SLOW_S = 0.1, 5.0
DOUBTFUL = "Mahony .1/.0005"
DOUBT = 1.0 / 3.0
"""That much of this peer's error is the autopilot's in simulated flights."""
COLUMNS = (
    "tilt [deg]",
    "windows",
    "autopilot",
    "ours",
    "ours aided",
    "best peer",
    "",
    "share by the autopilot",
    "by the GPS",
    "true: autopilot",
    "ours",
    "peer",
    "share",
    "smoother",
)


@dataclass(frozen=True)
class Judge:
    """The smoother that has not heard the fixes around: attitudes, force at samples [N]; windows.

    `first`, `last` [W] are the nodes of each window and `accel` [W] what the GPS says, north plus i
    east [m/s^2].
    """

    reference: GpsReference
    attitudes: Floats
    force: Floats
    first: Any
    last: Any
    accel: Any


def judge(reference: GpsReference) -> Judge:
    """Smooth with every third block of fixes left out, three times."""
    smoother, t_s = reference.smoother, reference.t_s
    node_s, fix = smoother.node_s, smoother.fix
    block = (node_s // BLOCK_S).astype(int)
    attitudes, force = reference.attitudes.copy(), np.empty((len(t_s), 3))
    for fold in range(FOLDS):
        one = smoother.smooth(reference.attitudes, used=block % FOLDS != fold)
        here = (t_s // BLOCK_S).astype(int) % FOLDS == fold
        attitudes[here] = smoother.attitude(one)[here]
        force[here] = smoother.force(one)[here]
    first = np.arange(len(node_s))
    last = np.searchsorted(node_s, node_s + WINDOW_S - 0.05)
    kept = last < len(node_s)
    first, last = first[kept], last[kept]
    kept = (block[first] == block[last]) & (node_s[last] - node_s[first] < 1.5 * WINDOW_S)
    first, last = first[kept], last[kept]
    v = fix[:, 0] + 1j * fix[:, 1]
    accel = (v[last] - v[first]) / (node_s[last] - node_s[first])
    return Judge(reference, attitudes, force, first, last, accel)


def headed(q: Floats, other: Floats) -> Floats:
    """Attitudes `q` [N, 4] turned about the vertical to the heading of others."""
    turn = multiply_columns(other, inverse_columns(q)) * np.array([1.0, 0.0, 0.0, 1.0])
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    return multiply_columns(turn, q)


def doubtful(q: Floats, truth: Floats) -> Floats:
    """Attitudes [N, 4] with DOUBT of the error of `q` [N, 4]."""
    turned = headed(q, truth)
    turned *= np.where((turned * truth).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    mixed = truth + DOUBT * (turned - truth)
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))


def residual(one: Judge, q: Floats) -> tuple[Any, Floats]:
    """Residual [W] [m/s^2] of attitudes [N, 4] turned to the judge's heading, and mean(R f)_z."""
    turned = headed(q, one.attitudes)
    t_s, node_s = one.reference.t_s, one.reference.smoother.node_s
    span = node_s[one.last] - node_s[one.first]
    sums = np.interp(node_s, t_s, track(t_s, one.force, turned).force)
    down = rotate_columns(turned, one.force)[:, 2]
    fall = np.concatenate([[0.0], np.cumsum(0.5 * (down[1:] + down[:-1]) * np.diff(t_s))])
    falls = np.interp(node_s, t_s, fall)
    mean = (sums[one.last] - sums[one.first]) / span
    return one.accel - mean, (falls[one.last] - falls[one.first]) / span


@dataclass(frozen=True)
class Own:
    """Own errors by name [deg] with their 95 % intervals, and ours as a share of the best peer's.

    `share` is by the GPS; `by_autopilot` what it is where the autopilot is taken for the truth.
    `truth` holds the true errors over the same time where they are known.
    """

    windows: int
    error: dict[str, tuple[float, float, float]]
    peer: str
    share: tuple[float, float, float]
    by_autopilot: float
    truth: dict[str, float]


def own_errors(one: Judge, attitudes: dict[str, Floats], running: Any, truth: Floats | None) -> Own:
    """Judge attitudes [N, 4] by name, where `running` [N]; the true one, if known, beside them."""
    smooth, down = residual(one, one.attitudes)
    size = np.abs(smooth)
    kept = _usable_windows(one, size, down, running)
    squares = {
        name: (np.abs(residual(one, q)[0][kept]) ** 2 - size[kept] ** 2) / down[kept] ** 2
        for name, q in attitudes.items()
    }
    mean = {name: _root(square.mean()) for name, square in squares.items()}
    draws = _bootstrap(one.reference.smoother.node_s[one.first[kept]], squares)
    peer = min((name for name in attitudes if name in PEERS), key=lambda name: mean[name])
    within = _within(one, kept)
    apart = {name: _apart(q, attitudes["autopilot"], within) for name, q in attitudes.items()}
    true = {}
    if truth is not None:
        known = attitudes | {"smoother": one.reference.attitudes}
        true = {name: _apart(q, truth, within) for name, q in known.items()}
    return Own(
        windows=int(kept.sum()),
        error={name: (mean[name], *_interval(draws[name])) for name in attitudes},
        peer=peer,
        share=(mean["ours"] / mean[peer], *_interval(draws["ours"] / draws[peer])),
        by_autopilot=apart["ours"] / min(apart[name] for name in apart if name in PEERS),
        truth=true,
    )


def _usable_windows(one: Judge, size: Floats, down: Floats, running: Any) -> Any:
    """Mark [W] the windows that count, by how much the smoother misses there [W]."""
    t_s, node_s = one.reference.t_s, one.reference.smoother.node_s
    usual = np.interp(node_s, t_s, (running & one.reference.valid).astype(np.float64)) > 0.99
    kept = usual[one.first] & usual[one.last] & (np.abs(down) > LEAST_VERTICAL)
    return kept & (size < OUTLIER * np.median(size[kept]))


def _within(one: Judge, kept: Any) -> Any:
    """Mark [N] the samples that lie in a window."""
    t_s, node_s = one.reference.t_s, one.reference.smoother.node_s
    inside = np.zeros(len(t_s))
    for nodes, step in ((one.first, 1.0), (one.last, -1.0)):
        np.add.at(inside, np.searchsorted(t_s, node_s[nodes[kept]]), step)
    return np.cumsum(inside) > 0.0


def _bootstrap(at_s: Floats, squares: dict[str, Floats]) -> dict[str, Floats]:
    """Roots of the means [DRAWS] over drawn blocks of windows, the same draws for all."""
    block = np.unique(at_s // BOOTSTRAP_S, return_inverse=True)[1]
    number = np.bincount(block)
    drawn = np.random.default_rng(1).integers(0, len(number), (DRAWS, len(number)))
    count = number[drawn].sum(axis=1)
    return {
        name: _root(np.bincount(block, square)[drawn].sum(axis=1) / count)
        for name, square in squares.items()
    }


def _interval(draws: Floats) -> tuple[float, float]:
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(low), float(high)


def _root(square: Any) -> Any:
    return np.degrees(np.sqrt(np.maximum(square, 0.0)))


def _apart(q: Floats, other: Floats, within: Any) -> float:
    return float(np.degrees(np.sqrt(np.mean(inclination(q[within], other[within]) ** 2))))


def flown(flight: Flight, gps: GpsVelocity, names: list[str]) -> Own:
    """Judge all attitudes of a recording; of a simulated flight DOUBTFUL is the autopilot's."""
    good = usable(flight.samples)
    reference, autopilot = smoothed(flight, gps)
    truth = autopilot if flight.reference.is_truth else None
    attitudes, running = {"autopilot": autopilot}, np.zeros(len(autopilot), bool)
    for name, rows in estimates_of(flight, names):
        attitudes[name] = rows["ned_from_body"][good]
        running = rows["phase"][good] == Phase.RUNNING
    if truth is not None:
        attitudes["autopilot"] = doubtful(attitudes[DOUBTFUL], truth)
    aids = ("velocity_ned_m_s", "airspeed_m_s")
    if not any(np.isfinite(flight.samples[aid]).any() for aid in aids):
        del attitudes["ours aided"]
    stamps, at_ns = flight.samples["time_ns"][good], flight.reference.time_ns
    running &= (stamps > at_ns.min()) & (stamps < at_ns.max())
    return own_errors(judge(reference), attitudes, running, truth)


def simulated(scenario: str, seconds: float, seed: int) -> tuple[Flight, GpsVelocity]:
    """A simulated flight, and what a GPS of 5 Hz sees of it 0.2 s late.

    Its noise is 0.1 m/s white and 0.1 m/s with a correlation time of 5 s.
    """
    made = make_flight(scenario, seconds, seed, SIMULATED_HZ)
    samples, truth = samples_of(made, Airframe.FIXED_WING), made.rows
    every = slice(0, None, round(SIMULATED_HZ * FIX_S))
    dice, count = np.random.default_rng([seed, 7]), len(truth[every])
    slow, keep = np.zeros((count, 3)), np.exp(-FIX_S / SLOW_S)
    for k in range(1, count):
        slow[k] = keep * slow[k - 1] + np.sqrt(1.0 - keep**2) * dice.normal(0.0, NOISE_M_S, 3)
    noise = slow + dice.normal(0.0, NOISE_M_S, (count, 3))
    fixes = GpsVelocity(
        samples["time_ns"][every] + LATE_NS,
        truth["velocity_ned_m_s"][every] + noise,
        np.full(count, np.nan),
    )
    reference = AttitudeReference("truth", samples["time_ns"], truth["ned_from_body"], True)
    return Flight(f"{scenario} {seed}", samples, reference), fixes


def cells(one: Own) -> list[str]:
    """Return the cells of COLUMNS."""
    names = ("autopilot", "ours", "ours aided", one.peer)
    said = [
        "{:.2f} ({:.2f}, {:.2f})".format(*one.error[n]) if n in one.error else "-" for n in names
    ]
    shares = [f"{one.by_autopilot:.2f}", "{:.2f} ({:.2f}, {:.2f})".format(*one.share)]
    if one.truth:
        best = min(value for name, value in one.truth.items() if name in PEERS)
        known = [f"{one.truth[name]:.2f}" for name in ("autopilot", "ours", one.peer)]
        shares += [*known, f"{one.truth['ours'] / best:.2f}", f"{one.truth['smoother']:.2f}"]
    return [str(one.windows), *said, one.peer, *shares]


def judged(args: argparse.Namespace, names: list[str]) -> Iterator[list[str]]:
    """Yield a row for each flight."""
    for (scenario, seconds), seed in itertools.product(SIMULATED, range(1, args.seeds + 1)):
        flight, gps = simulated(scenario, seconds, seed)
        yield [flight.name, *cells(flown(flight, gps, names))]
    data = require_data(args.data, "the flight recordings")
    for name in args.logs:
        path = data / LOGS[name]
        gps_or_none = gps_velocity(path, read_recording(path).readings)
        if gps_or_none is not None:
            yield [name, *cells(flown(read_flight(name, path), gps_or_none, names))]


def main() -> int:
    """Print a row for each flight."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA / "flights", metavar="DIR")
    parser.add_argument("--logs", nargs="*", choices=list(LOGS), default=NAMES)
    parser.add_argument("--seeds", type=int, default=3, help="simulated flights of each scenario")
    parser.add_argument("--no-ahrs", action="store_true", help="leave out what is slow")
    args = parser.parse_args()
    slow = ("Madgwick",) if args.no_ahrs else ("-",)
    names = ["ours", "ours aided", *(name for name in PEERS if not name.startswith(slow))]
    out = Table(padding=(0, 1), show_edge=False)
    for column in COLUMNS:
        out.add_column(column, no_wrap=True)
    for row in judged(args, names):
        print(" | ".join(row), file=sys.stderr, flush=True)
        out.add_row(*row)
    Console(width=240).print(out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
