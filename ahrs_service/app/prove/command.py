"""Test the diagnosis blind: hide physics in recordings, diagnose them, then read the truth, score.

The recordings are made by a generator that shares no code with the fitting. Their truth is written
and hashed before the first diagnosis; the hash is printed and checked again before it is read.
The baselines choose among the same effects: stepwise regression by F-test or BIC, the lasso; the
oracle knows each effect's shape and the noise. Shares are given with Wilson 95 % intervals.

Examples:
  ahrs-service prove --count 100 --jobs 2
  ahrs-service prove --cases FOLDER      diagnose each NAME.tlog, score with its NAME.truth.json
  ahrs-service prove --cases FOLDER --reports FOLDER     score existing NAME.report.json

"""

import argparse
import json
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from ahrs_service.app.files.truth_file import read_truth
from ahrs_service.app.options import new_file, whole
from ahrs_service.app.prove.blind_files import (
    TRUTH_SUFFIX,
    read_report,
    recordings,
    seal,
    truths_of,
    write_case,
    write_report,
)
from ahrs_service.app.prove.blind_rivals import OURS, Answer, answer
from ahrs_service.app.prove.blind_tables import misses_table, score_table, where_table
from ahrs_service.blind.judging.held_out_score import gain_share
from ahrs_service.blind.judging.scoring import Mark, judge, score
from ahrs_service.blind.making.case import make, request_of
from ahrs_service.blind.making.oracle import oracle_report
from ahrs_service.blind.making.plan import controls, plan
from ahrs_service.errors import ConfigError, RecordingError

EXIT_DONE: Final = 0
EXIT_FAILED: Final = 1
ORACLE: Final = "oracle"

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Proof:
    """All that the tables show: the seal, marks by method, seconds and failures by recording."""

    seal: str
    marks: dict[str, list[Mark]]
    seconds: dict[str, float]
    failures: dict[str, str]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ahrs-service prove`."""
    parser.add_argument(
        "--count", type=whole, default=60, metavar="N", help="recordings to make (default 60)"
    )
    parser.add_argument(
        "--seconds", type=whole, metavar="S", help="length of each (default 200 to 400 by kind)"
    )
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="random seed of the set (default 1)"
    )
    parser.add_argument(
        "--controls",
        type=int,
        default=0,
        metavar="N",
        help="add N negative controls: nulls whose covariates are from another flight, reversed "
        "in time, or with the temperature inverted",
    )
    parser.add_argument("--cases", type=Path, metavar="DIR", help="use the recordings in DIR")
    parser.add_argument(
        "--reports", type=Path, metavar="DIR", help="with --cases: score NAME.report.json of DIR"
    )
    parser.add_argument(
        "--keep", type=Path, metavar="DIR", help="keep recordings, truths and reports in DIR"
    )
    parser.add_argument("--jobs", type=whole, default=1, metavar="N", help="processes (default 1)")
    parser.add_argument("--no-rivals", action="store_true", help="do not run the baselines")
    parser.add_argument("--json", type=new_file, metavar="OUT", help="write marks and score")


def run(args: argparse.Namespace) -> int:
    """Make or read a set, diagnose, score; return 0 if every recording got a report, else 1."""
    if args.reports and not args.cases:
        raise ConfigError("--reports: give the recordings' folder with --cases as well")
    console = Console()
    with _folder(args) as folder:
        if not args.cases:
            _make(args, folder, console)
        paths, truths = recordings(args.cases or folder), truths_of(args.cases or folder)
        sealed = seal(truths)
        console.print(f"truths sealed: sha256 {sealed}", soft_wrap=True)
        answers = _given(paths, args.reports) if args.reports else _ask(paths, args, console)
        if seal(truths) != sealed:
            raise RecordingError(f"{truths}: a truth file changed while the set was diagnosed")
        proof = _judge(answers, truths, sealed)
    console.print(score_table(proof.marks, len(answers)))
    console.print(where_table(proof.marks[OURS]))
    console.print(misses_table(proof.marks[OURS], proof.failures))
    if args.json:
        _write_json(args.json, proof)
    return EXIT_FAILED if proof.failures else EXIT_DONE


@contextmanager
def _folder(args: argparse.Namespace) -> Iterator[Path]:
    if args.keep:
        try:
            args.keep.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"--keep {args.keep}: {error.strerror}") from error
    keeper = nullcontext(str(args.keep)) if args.keep else tempfile.TemporaryDirectory()
    with keeper as folder:
        yield Path(folder)


def _make(args: argparse.Namespace, folder: Path, console: Console) -> None:
    requests = [*plan(args.count, args.seed, args.seconds), *controls(args.controls, args.seed)]
    truths = folder / "truths"
    if truths.exists():
        raise ConfigError(f"--keep {folder}: already holds a set; give an empty folder")
    truths.mkdir()
    for request in _track(requests, len(requests), "hiding", console):
        try:
            case = make(request)
        except ValueError as error:
            raise ConfigError(f"--seconds {args.seconds}: too short: {error}") from None
        write_case(folder, truths, case)


def _ask(paths: list[Path], args: argparse.Namespace, console: Console) -> list[Answer]:
    """Diagnose every recording, in `--jobs` processes; with `--keep` each report is written."""
    rivals, answers = not args.no_rivals, []
    with _answers(paths, rivals, args.jobs) as coming:
        for one in _track(coming, len(paths), "diagnosing", console):
            answers.append(one)
            if args.keep:
                write_report(args.keep, one.name, one.reports[OURS])
    return sorted(answers, key=lambda one: one.name)


def _given(paths: list[Path], folder: Path) -> list[Answer]:
    """Return the existing reports; recordings without one are left out."""
    reports = {path.stem: read_report(folder, path.stem) for path in paths}
    answers = [Answer(name, {OURS: report}, 0.0) for name, report in reports.items() if report]
    if not answers:
        raise RecordingError(f"{folder}: no NAME.report.json of these recordings")
    return answers


@contextmanager
def _answers(paths: list[Path], rivals: bool, jobs: int) -> Iterator[Iterator[Answer]]:
    if jobs == 1:
        yield (answer(path, rivals) for path in paths)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        tasks = [pool.submit(answer, path, rivals) for path in paths]
        yield (task.result() for task in as_completed(tasks))


def _track(items: Iterable[T], total: int, what: str, console: Console) -> Iterator[T]:
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task(what, total=total)
        for item in items:
            yield item
            bar.advance(task)


def _judge(answers: list[Answer], truths: Path, sealed: str) -> Proof:
    marks: dict[str, list[Mark]] = {}
    for number, one in enumerate(answers):
        truth = read_truth(truths / f"{one.name}{TRUTH_SUFFIX}")
        reports = dict(one.reports)
        oracle = oracle_report(truth, np.random.default_rng((number, 3)))
        if oracle is not None:
            reports[ORACLE] = oracle
        for title, report in reports.items():
            mark = judge(one.name, truth, report)
            request = request_of(truth)
            if title == OURS and request is not None and mark.first is not None:
                mark = mark.with_gain(gain_share(make(request), report))
            marks.setdefault(title, []).append(mark)
    failures = {one.name: one.failure for one in answers if one.failure}
    return Proof(sealed, marks, {one.name: one.seconds for one in answers}, failures)


def _write_json(path: Path, proof: Proof) -> None:
    rows = {
        title: [
            {
                "title": row.title,
                "hits": row.rate.hits,
                "of": row.rate.total,
                "wilson_95": row.rate.interval(),
                "asked": row.asked,
            }
            for row in score(marks)
        ]
        for title, marks in proof.marks.items()
    }
    document = {
        "seal_sha256": proof.seal,
        "score": rows,
        "marks": {title: [asdict(m) for m in marks] for title, marks in proof.marks.items()},
        "seconds": proof.seconds,
        "failures": proof.failures,
    }
    try:
        path.write_text(json.dumps(document, indent=1), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"--json {path}: {error.strerror}; give a writable file") from error
