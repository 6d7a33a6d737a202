"""What noise alone makes of the whole search: the threshold of diagnosis.search, ALARM.

Run: python tests/benchmarks/mismatch_nulls.py [--data DIR] [--only TEXT] [--draws N]

For every recording without an effect (the shared nulls, or those of DIR with a truth of nothing):
the most surprising effect and unknown dependence under the noise fitted, the p-values of whiteness
and normality per channel, and a parametric bootstrap of the maximum. The bootstrap draws the
targets b of all regressors from N(0, G), G their Gram matrix under the noise with biases taken
out, which is what the fitted noise alone gives them, with all their correlations, and takes the
most surprising effect of each draw. Wander that is badly known makes the real tail longer than
this one: the measured nulls say by how much.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from ahrs_service.app.recorded_columns import read_columns
from ahrs_service.diagnosis.diagnose import compare
from ahrs_service.diagnosis.library import library_of
from ahrs_service.diagnosis.model import bare
from ahrs_service.diagnosis.screen import gain_of, grams, surprise
from ahrs_service.diagnosis.search import ALARM, best_forms, screen
from ahrs_service.diagnosis.whiteness import whiteness

CASES = Path(__file__).resolve().parents[3] / "shared" / "mismatch" / "cases"


def is_null(path):
    """Whether a recording's truth holds no effect."""
    truth = json.loads(path.with_suffix(".truth.json").read_text())
    return all(effect["effect"] == "none" for effect in truth["effects"])


def maxima(residual, library, model, draws, rng):
    """Return the most surprising effect's surprise of each draw of the noise [draws]."""
    gram, _, share = grams(residual, model.noise, library, model.base, model.misfit)
    values, vectors = np.linalg.eigh(gram)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    named = [c for c in library.candidates if c.effect is not None]
    found = []
    for _ in range(draws):
        target = root @ rng.normal(size=len(root))
        found.append(max(surprise(gain_of(c, gram, target, share), c.freedom) for c in named))
    return np.array(found)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=CASES)
    parser.add_argument("--only", default="", help="recordings whose name holds this")
    parser.add_argument("--draws", type=int, default=100)
    args = parser.parse_args()
    paths = [p for p in sorted(args.data.glob("*.tlog")) if args.only in p.stem and is_null(p)]
    if not paths:
        sys.exit(f"{args.data}: no recordings without an effect; give --data")
    table = Table("null", "best effect", "nats", "best unknown", "nats", "whiteness", "normality")
    rng, drawn, measured = np.random.default_rng(1), [], []
    for path in paths:
        residual = compare(read_columns(path))
        library, model = library_of(residual), bare(residual)
        gains = screen(residual, model.noise, library, model.base, model.misfit)
        forms = best_forms(library, gains)
        named = next((c.name, v) for c, v in forms if c.effect is not None)
        unknown = next((c.name, v) for c, v in forms if c.effect is None)
        tests = whiteness(residual, model)
        measured.append(named[1])
        drawn.append(maxima(residual, library, model, args.draws, rng))
        table.add_row(
            path.stem,
            named[0],
            f"{named[1]:.1f}",
            unknown[0],
            f"{unknown[1]:.1f}",
            " ".join(f"{p:.2g}" for p in tests.ljung_box),
            " ".join(f"{p:.2g}" for p in tests.normality),
        )
    Console(width=170).print(table)
    drawn = np.concatenate(drawn)
    q95, q98, q99 = np.quantile(drawn, [0.95, 0.98, 0.99])
    print(f"bootstrap of the maximum: 95 % {q95:.1f}, 98 % {q98:.1f}, 99 % {q99:.1f} nats")
    alarms = sum(value > ALARM for value in measured)
    print(f"above ALARM = {ALARM} nats: {alarms} of {len(measured)} recordings, ", end="")
    print(f"{np.mean(drawn > ALARM):.2%} of the draws")


if __name__ == "__main__":
    main()
