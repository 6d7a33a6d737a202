"""The minimal report: names only, for baselines that give no more."""

from typing import Any


def report(names: list[str]) -> dict[str, Any]:
    """Return a report that names the effects, the best first."""
    return {
        "verdict": "explained" if names else "no_mismatch",
        "effects": [{"effect": name, "class": [name], "parameters": {}} for name in names],
        "unexplained": [],
    }
