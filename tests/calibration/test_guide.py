"""Instructions to the operator as the samples of a bench arrive."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.guide import (
    guide_multi_pose,
    guide_recording,
    guide_six_position,
)
from ahrs_service.calibration.poses import Stillness, find_poses

NOTHING = ImuColumns(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))


def guidance_steps(columns, guide, step_s=5.0):
    """Guidance every `step_s`, as a session would show it."""
    rate = 1.0 / columns.interval_s
    return [
        guide(columns.part(0, int(k * step_s * rate)))
        for k in range(1 + int(columns.time_s[-1] / step_s))
    ]


def test_before_the_first_sample():
    for guide in (lambda c: guide_six_position(c, True), guide_multi_pose):
        guidance = guide(NOTHING)
        assert not guidance.done
        assert guidance.state == "waiting for samples"
        assert guidance.coverage == 0.0
        assert guidance.refusals == ()


def test_it_leads_through_the_six_faces_and_then_the_turns(bench):
    columns, flight = bench("six-position", 110.0)
    steps = guidance_steps(columns, lambda c: guide_six_position(c, with_turns=False))
    first = next(k for k, step in enumerate(steps) if step.done)
    assert not any(step.refusals for step in steps)
    # Done when the last face has been still, which is the last pose of the plan.
    assert steps[first].instruction == "all is there"
    assert 5.0 * first > sum(phase.seconds for phase in flight.phases[:-1])
    asked = list(dict.fromkeys(step.instruction for step in steps))
    assert asked[0] == "put it nose up (+x up) and let go"
    assert steps[first].coverage == pytest.approx(0.878, abs=0.02)
    with_turns = guide_six_position(columns, with_turns=True)
    assert with_turns.done
    assert dict(with_turns.progress)["turns with z vertical"] == "2"
    residual, unit = dict(with_turns.progress)["residual of the fit"].split()
    # Means of some three seconds of 0.02 m/s^2 at 100 Hz: 1.2 mm/s^2.
    assert (0.6 < float(residual) < 2.4, unit) == (True, "mm/s^2")


def test_turns_that_are_missing_are_asked_for(bench):
    columns, _ = bench("six-position", 110.0)
    still = replace(columns, gyro_rad_s=columns.gyro_rad_s * [1.0, 1.0, 0.0])
    guidance = guide_six_position(still, with_turns=True)
    assert not guidance.done
    assert guidance.instruction.startswith("with z vertical, turn it flat on the table by exactly")


def test_it_asks_for_the_emptiest_direction_until_there_are_enough(bench):
    columns, _ = bench("multi-pose", 130.0)
    steps = guidance_steps(columns, lambda c: guide_multi_pose(c, 14))
    counts = [int(step.progress[0][1].split()[0]) for step in steps]
    assert counts == sorted(counts)
    assert counts[-1] >= 14
    assert steps[-1].done
    assert [step.done for step in steps] == [count >= 14 for count in counts]
    assert all("hold it" in step.instruction for step in steps if not step.done)
    coverage = [step.coverage for step in steps]
    assert coverage == sorted(coverage)
    assert coverage[-1] > 0.9


def held(columns, tilt_deg=0.0, gyro=None, seconds=3.0):
    """The bench's level rest, and after it a pose of some seconds that is tilted or moved."""
    rate = 1.0 / columns.interval_s
    first, more = int(3.0 * rate), int(seconds * rate)
    base = columns.part(0, first)
    tilt = math.radians(tilt_deg)
    turn = np.array(
        [[1, 0, 0], [0, math.cos(tilt), -math.sin(tilt)], [0, math.sin(tilt), math.cos(tilt)]]
    )
    place = np.arange(more) % first
    moving = int(0.8 * rate)
    swing = np.zeros((moving, 3))
    swing[:, 0] = 2.0 * np.sin(np.linspace(0.0, math.pi, moving))
    rest = base.gyro_rad_s[place] + (0.0 if gyro is None else gyro(np.arange(more) / rate))
    gyros = [base.gyro_rad_s, swing, rest, swing]
    up = base.accel_m_s2
    forces = [up, np.tile(up[0], (moving, 1)), up[place] @ turn.T, np.tile(up[0], (moving, 1))]
    time_s = np.arange(first + 2 * moving + more) / rate
    return ImuColumns(
        time_s, np.concatenate(gyros), np.concatenate(forces), np.full(len(time_s), 20.0)
    )


def only_refusal(columns):
    (refusal,) = guide_six_position(columns, with_turns=False).refusals
    return refusal


def test_a_tilted_pose_is_refused_with_its_angle(bench):
    columns, _ = bench("six-position", 110.0)
    refusal = only_refusal(held(columns, tilt_deg=25.0))
    assert refusal.why.startswith("25 deg from the nearest face: lay it flat")
    assert refusal.time_s == pytest.approx(6.5, abs=1.0)


def test_a_trembling_pose_is_refused_with_its_tremor(bench):
    columns, _ = bench("six-position", 110.0)
    tremor = math.radians(3.0)

    def shake(t):
        return tremor * np.sin(2.0 * np.pi * 9.0 * t)[:, None] * [1.0, 0.5, 0.5]

    why = only_refusal(held(columns, gyro=shake)).why
    assert why == "trembles by 2.1 deg/s: put it on something solid and let go"


def test_a_pose_let_go_too_soon_is_refused(bench):
    columns, _ = bench("six-position", 110.0)
    why = only_refusal(held(columns, seconds=1.45)).why
    assert "only: give it 1.5 s" in why


def test_a_pose_that_is_pushed_is_refused(bench):
    columns, _ = bench("multi-pose", 130.0)
    poses = find_poses(columns)
    force = columns.accel_m_s2.copy()
    place = slice(poses["first"][4], poses["last"][4])
    force[place] *= 1.08
    (refusal,) = guide_multi_pose(replace(columns, accel_m_s2=force)).refusals
    assert "is it being pushed or shaken?" in refusal.why


def test_a_recording_at_rest_counts_its_longest_rest_only(bench):
    columns, _ = bench("six-position", 110.0)
    guidance = guide_recording(columns, 60.0, Stillness())
    assert not guidance.done
    assert guidance.instruction.startswith("leave it alone")
    assert guidance.coverage < 0.1
    anyhow = guide_recording(columns, 60.0)
    assert anyhow.done
    assert guide_recording(NOTHING, 60.0, Stillness()).coverage == 0.0
