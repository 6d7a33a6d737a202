"""The state of the pipeline: the same bytes for any splitting of a stream, compiled or not."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ahrs_service import pipeline
from ahrs_service.fusion import states
from ahrs_service.records import ESTIMATE_DTYPE, empty
from tests.streams import IDEAL, PARAMETERS, moving, run


def test_batch_equals_single_steps():
    samples = moving(1500)
    at_once = run(samples)
    state, one_by_one = pipeline.new_state(), empty(ESTIMATE_DTYPE, len(samples))
    for n in range(len(samples)):
        pipeline.step(PARAMETERS, IDEAL, state, samples[n : n + 1], one_by_one[n : n + 1])
    assert at_once.tobytes() == one_by_one.tobytes()


def test_state_saved_in_flight_goes_on_as_if_never_stopped():
    samples = moving(1500)
    whole = run(samples)
    state = pipeline.new_state()
    first = run(samples[:700], state)
    restored = np.frombuffer(state.tobytes(), pipeline.STATE_DTYPE).copy()
    second = run(samples[700:], restored)
    assert whole.tobytes() == first.tobytes() + second.tobytes()


SCRIPT = """
import hashlib
from tests.streams import moving, run
print(hashlib.sha256(run(moving(400)).tobytes()).hexdigest())
"""


def test_undecorated_code_gives_the_same_bytes():
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    plain = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        cwd=Path(__file__).parents[1],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert plain.stdout.strip() == hashlib.sha256(run(moving(400)).tobytes()).hexdigest()


def test_covariance_stays_symmetric_and_positive():
    state = pipeline.new_state()
    run(moving(20_000), state)
    covariance = state["covariance"][0]
    np.testing.assert_array_equal(covariance, covariance.T)
    used = covariance[: states.UNAIDED, : states.UNAIDED]
    known = used[np.ix_(np.diag(used) > 0.0, np.diag(used) > 0.0)]
    assert len(known) >= 9
    assert np.linalg.eigvalsh(known).min() > 0.0
    assert np.linalg.norm(state["ned_from_body"][0]) == pytest.approx(1.0, abs=1e-12)
