"""Found against truth: `diagnose` on every case with a truth beside it.

Run: python tests/benchmarks/mismatch_cases.py [--data DIR] [--only TEXT] [--json OUT]

DIR holds NAME.tlog and NAME.truth.json as ../shared/mismatch/README.md lays them down. A right
name is the true effect first, or a class that holds it; `implies` of a truth counts as named too.
z are the errors of the parameters in their sigmas: two thirds within 1, 95 % within 2.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from ahrs_service.app.diagnose.recorded_columns import read_columns
from ahrs_service.diagnosis.diagnose import diagnose

CASES = Path(__file__).resolve().parents[3] / "shared" / "mismatch" / "cases"
NO_EFFECT = ("none", "unknown")


def truths_of(path):
    """Return the level, and the effects that are there, outside the catalogue as `unknown`."""
    truth = json.loads(path.with_suffix("").with_suffix(".truth.json").read_text())
    return truth["level"], [e for e in truth["effects"] if e["effect"] != "none"]


def errors_in_sigmas(finding, params):
    """Errors of the parameters that truth and finding share, in sigmas."""
    errors = []
    for name, found in finding.parameters.items():
        value, std = np.asarray(found.value, float), np.asarray(found.std, float)
        if name in params and np.shape(params[name]) == value.shape:
            there = std > 0.0
            errors += list(((value - np.asarray(params[name]))[there] / std[there]).ravel())
    return errors


def is_alike(truth, seen):
    """Whether a covariate's names in truth and report mean the same."""
    return truth in seen or seen in truth


def judge(found, effects):
    """Return what is right: named, extra names, errors in sigmas; the unknown's covariate."""
    names = {e["effect"] for e in effects} - set(NO_EFFECT)
    implied = {i for e in effects for i in e.get("implies", [])}
    classes = [set(finding.alike) for finding in found.findings]
    named = {name for name in names if any(name in alike for alike in classes)}
    extra = [alike for alike in classes if not alike & (names | implied)]
    errors = []
    for finding in found.findings:
        for effect in effects:
            if effect["effect"] == finding.effect:
                errors += errors_in_sigmas(finding, effect["params"])
    outside = [e["params"].get("depends_on") for e in effects if e["effect"] == "unknown"]
    seen = [covariate for item in found.unexplained for covariate in item.depends_on]
    return {
        "missed": sorted(names - named),
        "extra": len(extra),
        "errors": errors,
        "outside": [str(o) for o in outside],
        "covariate": bool(outside)
        and all(any(str(o) in s or s in str(o) for s in seen) for o in outside),
    }


def row_of(path):
    """Diagnose one case; return its row."""
    level, effects = truths_of(path)
    start = time.perf_counter()
    found = diagnose(read_columns(path))
    row = {
        "case": path.stem,
        "level": level,
        "kind": path.stem.rsplit("_", 1)[-1],
        "truth": [e["effect"] for e in effects],
        "verdict": found.verdict,
        "found": [list(finding.alike) for finding in found.findings],
        "unexplained": [f"{u.channel}: {', '.join(u.depends_on)}" for u in found.unexplained],
        "seconds": time.perf_counter() - start,
        **judge(found, effects),
    }
    if found.whiteness is not None:
        row["ljung_box"] = list(found.whiteness.ljung_box)
        row["normality"] = list(found.whiteness.normality)
    if found.holdout is not None:
        row["gain"] = found.holdout.log_likelihood_gain
    return row


def wilson(hits, count):
    """Wilson's 95 % interval of a share."""
    if not count:
        return "none"
    z, p = 1.96, hits / count
    middle = (p + z * z / (2 * count)) / (1 + z * z / count)
    half = z * np.sqrt(p * (1 - p) / count + z * z / (4 * count * count)) / (1 + z * z / count)
    low, high = 100 * (middle - half), 100 * (middle + half)
    return f"{100 * p:.0f} % ({hits} of {count}; {low:.0f} to {high:.0f})"


def summary(rows):
    """Return the figures that the issue asks for."""
    nulls = [row for row in rows if not row["truth"]]
    outside = [row for row in rows if "unknown" in row["truth"]]
    named = [row for row in rows if row["truth"] and "unknown" not in row["truth"]]
    figures = {}
    for level in sorted({row["level"] for row in named}):
        there = [row for row in named if row["level"] == level]
        figures[f"level {level}: all effects named"] = wilson(
            sum(not row["missed"] for row in there), len(there)
        )
    figures["nulls falsely alarmed"] = wilson(
        sum(row["verdict"] != "no_mismatch" for row in nulls), len(nulls)
    )
    figures["a wrong extra name"] = wilson(sum(row["extra"] > 0 for row in named), len(named))
    figures["outside: named wrongly"] = wilson(
        sum(row["extra"] > 0 for row in outside), len(outside)
    )
    figures["outside: covariate given"] = wilson(
        sum(row["covariate"] for row in outside), len(outside)
    )
    errors = np.abs([e for row in rows for e in row["errors"]])
    figures["truth within 1.96 sigma"] = wilson(int(np.sum(errors < 1.96)), len(errors))
    return figures


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=CASES)
    parser.add_argument("--only", default="", help="cases whose name holds this")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    paths = sorted(p for p in args.data.glob("*.tlog") if args.only in p.stem)
    if not paths:
        sys.exit(f"{args.data}: no cases (*.tlog with *.truth.json); give --data")
    out = Console(width=150)
    table = Table("case", "truth", "found", "unexplained", "extra", "|z| max", "s")
    rows = []
    for path in paths:
        row = row_of(path)
        rows.append(row)
        table.add_row(
            row["case"],
            ", ".join(row["truth"]) or "nothing",
            "; ".join("|".join(alike) for alike in row["found"]) or row["verdict"],
            "; ".join(row["unexplained"]),
            str(row["extra"]),
            f"{np.max(np.abs(row['errors'])):.1f}" if row["errors"] else "",
            f"{row['seconds']:.0f}",
        )
        if args.json:
            args.json.write_text(json.dumps(rows, indent=1))
    out.print(table)
    for name, figure in summary(rows).items():
        out.print(f"{name}: {figure}", highlight=False)


if __name__ == "__main__":
    main()
