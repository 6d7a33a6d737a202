"""What noise alone makes of the whole search: the calibration of diagnosis.chance.

Run: python tests/benchmarks/mismatch_nulls.py [--data DIR | --make N --seed SEED] [--only TEXT]

For every recording without an effect (the shared nulls, those of DIR with a truth of nothing, or N
made here: all kinds of diagnosis.blind in turn, the hard ones too): the most surprising effect and
unknown dependence under the noise fitted, its p over the whole search, how many independent
hypotheses that was, the p-values of whiteness and normality per channel. Where the bootstrap is
right the p over the search are uniform: printed are their quantiles, and Kolmogorov's test of it.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import kstest

from ahrs_service.app.diagnose.recorded_columns import read_columns
from ahrs_service.app.prove.blind_files import write_case
from ahrs_service.blind.making.case import NULLS, Request, make
from ahrs_service.blind.making.plan import SECONDS
from ahrs_service.diagnosis.diagnose import compare
from ahrs_service.diagnosis.hypotheses.candidates import library_of
from ahrs_service.diagnosis.hypotheses.model import bare
from ahrs_service.diagnosis.hypotheses.score_test import screen
from ahrs_service.diagnosis.judgement.whiteness import whiteness
from ahrs_service.diagnosis.search.forward_search import best_forms
from ahrs_service.diagnosis.search.search_threshold import (
    ALARM,
    hypotheses,
    maxima,
    over_the_search,
)

CASES = Path(__file__).resolve().parents[3] / "shared" / "mismatch" / "cases"
FLOWN = ("reference glitches", "jittered reference", "strong vibration")
QUANTILES = (0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9)


def is_null(path):
    """Whether a recording's truth holds no effect."""
    truth = json.loads(path.with_suffix(".truth.json").read_text())
    return all(effect["effect"] == "none" for effect in truth["effects"])


def nulls(folder, count, seed):
    """Make `count` recordings of noise, one per seed from `seed` on: kinds and nulls in turn."""
    for n in range(count):
        kind, null = tuple(SECONDS)[n % 3], NULLS[n // 3 % len(NULLS)]
        if kind == "bench" and null in FLOWN:
            kind = ("flight", "copter")[n % 2]
        name = f"{seed + n}_{kind}_{null.replace(' ', '_')}"
        write_case(folder, folder, make(Request(name, kind, seed + n, SECONDS[kind], null=null)))


def judge(path, table):
    """Add a recording's row and return its p over the search and whether it raises an alarm."""
    residual = compare(read_columns(path))
    library, model = library_of(residual), bare(residual)
    gains = screen(residual, model.noise, library, model.base, model.misfit)
    forms = best_forms(library, gains)
    named = next((c.name, v) for c, v in forms if c.effect is not None)
    unknown = next((c.name, v) for c, v in forms if c.effect is None)
    count = hypotheses(maxima(residual, library, model))
    tests = whiteness(residual, model)
    chance = over_the_search(named[1], count)
    table.add_row(
        path.stem,
        named[0],
        f"{named[1]:.1f}",
        f"{chance:.2g}",
        f"{count:.0f}",
        unknown[0],
        f"{unknown[1]:.1f}",
        " ".join(f"{p:.2g}" for p in tests.ljung_box),
        " ".join(f"{p:.2g}" for p in tests.normality),
    )
    return chance, named[1] > ALARM


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=CASES)
    parser.add_argument("--make", type=int, default=0, help="make so many recordings instead")
    parser.add_argument("--seed", type=int, default=3000)
    parser.add_argument("--only", default="", help="recordings whose name holds this")
    args = parser.parse_args()
    heads = ("null", "best effect", "nats", "p of the search", "hypotheses", "best unknown", "nats")
    table = Table(*heads, "whiteness", "normality")
    with tempfile.TemporaryDirectory() as made:
        if args.make:
            nulls(Path(made), args.make, args.seed)
        folder = Path(made) if args.make else args.data
        paths = [p for p in sorted(folder.glob("*.tlog")) if args.only in p.stem and is_null(p)]
        if not paths:
            sys.exit(f"{folder}: no recordings without an effect; give --data or --make")
        judged = [judge(path, table) for path in paths]
    Console(width=190).print(table)
    chances = np.array([chance for chance, _ in judged])
    for level, value in zip(QUANTILES, np.quantile(chances, QUANTILES), strict=True):
        print(f"p of the search, quantile {level:.2f}: {value:.3f}")
    print(f"uniform (Kolmogorov): p = {kstest(chances, 'uniform').pvalue:.2g}")
    alarms = sum(is_alarm for _, is_alarm in judged)
    print(f"above ALARM = {ALARM:.1f} nats: {alarms} of {len(judged)} recordings")


if __name__ == "__main__":
    main()
