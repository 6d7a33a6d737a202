"""The command compile, and the progress of compilation that every command shows."""

import io
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core import event
from rich.console import Console

from ahrs_service import pipeline
from ahrs_service.app.cli import main
from ahrs_service.app.compile.progress import CompileProgress, reachable
from ahrs_service.fusion import heading, mekf
from ahrs_service.rotation import multiply, to_euler

TREE = Path(__file__).parents[2]

SCANNER = """
import sys
from rich.console import Console
from ahrs_service.app.compile.progress import telling
from ahrs_service.links.mavlink.codec import Decoder

terminal = {"true": True, "false": None}[sys.argv[1]]
with telling(Console(stderr=True, force_terminal=terminal)) as progress:
    Decoder()
print(progress.compiled)
"""


@pytest.fixture
def python(tmp_path):
    """Run Python with a fresh cache of kernels; return the count and what is said."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(TREE)}

    def run(script, *arguments):
        command = [sys.executable, "-c", script, *arguments]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        return int(done.stdout), done.stderr

    return run


def test_in_a_pipe_lines_are_said_while_it_compiles_and_none_when_loaded(python):
    compiled, said = python(SCANNER, "false")
    first, *_ = said.splitlines()
    assert compiled > 1
    assert re.fullmatch(r"compiling kernel 1 of \d+ \(first start only\)", first)
    assert python(SCANNER, "false") == (0, "")


def test_in_a_terminal_a_bar_counts_them(python):
    compiled, said = python(SCANNER, "true")
    assert compiled > 1
    assert re.search(r"compiling kernel.*\d/\d", said)
    assert python(SCANNER, "true") == (0, "")


def test_the_kernels_ahead_are_all_that_may_be_called_and_no_other():
    ahead = reachable(pipeline.batch)
    below = (pipeline.batch, pipeline.take, heading.correct, mekf.transition_rows)
    assert {each.py_func.__code__ for each in below} < ahead
    assert pipeline.step.py_func.__code__ not in ahead
    assert reachable(to_euler) == {to_euler.py_func.__code__}


def test_compile_says_at_the_second_time_that_nothing_is_to_do(capsys):
    assert main(["compile", "--live"]) == 0
    capsys.readouterr()
    assert main(["compile", "--live"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("nothing to do: all kernels are compiled, in ")


def test_what_another_thread_began_to_compile_before_does_no_harm():
    listener = CompileProgress(Console(file=io.StringIO()))
    with event.trigger_event("numba:compile", data={"dispatcher": multiply}):
        event.register("numba:compile", listener)
    event.unregister("numba:compile", listener)
    assert listener.compiled == 0
