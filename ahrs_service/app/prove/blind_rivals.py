"""One recording diagnosed by `diagnose` and by the baselines."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from ahrs_service.app.diagnose.recorded_columns import read_columns
from ahrs_service.blind.judging.baselines import BASELINES
from ahrs_service.blind.judging.naive import regression
from ahrs_service.blind.making.naming import report
from ahrs_service.diagnosis.diagnose import diagnose
from ahrs_service.diagnosis.result import as_json
from ahrs_service.errors import LinkError

OURS: Final = "diagnose"


@dataclass(frozen=True, slots=True)
class Answer:
    """Reports by method, seconds that `diagnose` took, and why it failed if it did."""

    name: str
    reports: dict[str, dict[str, Any]]
    seconds: float
    failure: str = ""


def answer(path: Path, with_rivals: bool) -> Answer:
    """Diagnose one recording with all methods; a failed diagnosis has no findings and a reason."""
    began, failure = time.perf_counter(), ""
    try:
        recorded = read_columns(path)
        ours = as_json(diagnose(recorded))
    except (LinkError, ValueError, ArithmeticError) as error:
        failure, ours = f"{type(error).__name__}: {error}", report([])
        return Answer(path.stem, {OURS: ours}, time.perf_counter() - began, failure)
    reports, seconds = {OURS: ours}, time.perf_counter() - began
    if with_rivals:
        naive = regression(recorded)
        reports |= {title: choose(naive) for title, choose in BASELINES.items()}
    return Answer(path.stem, reports, seconds)
