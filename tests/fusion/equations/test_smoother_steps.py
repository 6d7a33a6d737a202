"""Each step of the smoother alone: corrections combined, removed, and written out."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ahrs_service.fusion import smoother, smoother_history
from ahrs_service.fusion.smoother_history import CHAINED, NODE_DTYPE, START
from ahrs_service.fusion.states import (
    ACCEL_BIAS,
    AIDED,
    ERROR_STATES,
    GYRO_BIAS,
    GYRO_MATRIX,
    UNAIDED,
    VELOCITY,
    WIND,
)
from ahrs_service.records import ESTIMATE_DTYPE, empty
from tests.error_state import attitude, flying

LOWER = np.tril_indices(ERROR_STATES)


def put_together(second, first):
    out = np.empty(ERROR_STATES)
    smoother._add(np.asarray(second, np.float64), np.asarray(first, np.float64), out)
    return out


def correction(**parts):
    whole = np.zeros(ERROR_STATES)
    for name, value in parts.items():
        at = {"angle": 0, "bias": GYRO_BIAS, "velocity": VELOCITY, "wind": WIND}[name]
        whole[at : at + len(value)] = value
    return whole


@pytest.mark.parametrize(
    ("angle", "velocity", "expected"),
    [
        # Right about down: what went north goes east, what went east goes south.
        ((0.0, 0.0, 0.1), (10.0, 0.0, 0.0), (10.0, 1.0, 0.0)),
        ((0.0, 0.0, 0.1), (0.0, 10.0, 0.0), (-1.0, 10.0, 0.0)),
        # About north: east goes down, down goes west.
        ((0.1, 0.0, 0.0), (0.0, 10.0, 0.0), (0.0, 10.0, 1.0)),
        ((0.1, 0.0, 0.0), (0.0, 0.0, 10.0), (0.0, -1.0, 10.0)),
        # About east: down goes north, north goes up.
        ((0.0, 0.1, 0.0), (0.0, 0.0, 10.0), (1.0, 0.0, 10.0)),
        ((0.0, 0.1, 0.0), (10.0, 0.0, 0.0), (10.0, 0.0, -1.0)),
    ],
)
def test_a_later_rotation_rotates_the_velocity_added_before(angle, velocity, expected):
    found = put_together(correction(angle=angle), correction(velocity=velocity))
    np.testing.assert_allclose(found[VELOCITY : VELOCITY + 3], expected, atol=1e-12)
    np.testing.assert_allclose(found[:3], angle, atol=1e-12)
    # A rotation before the velocity was added does not.
    other = put_together(correction(velocity=velocity), correction(angle=angle))
    np.testing.assert_allclose(other[VELOCITY : VELOCITY + 3], velocity, atol=1e-12)


def test_of_two_rotations_the_second_is_about_earth_axes():
    """A quarter about north, then one about east: where does east go?."""
    first, second = (0.5 * math.pi, 0.0, 0.0), (0.0, 0.5 * math.pi, 0.0)
    found = put_together(correction(angle=second), correction(angle=first))
    turned = Rotation.from_rotvec(found[:3]).apply([0.0, 1.0, 0.0])
    # East goes down by the first, and down goes north by the second.
    np.testing.assert_allclose(turned, [1.0, 0.0, 0.0], atol=1e-12)


def test_all_else_adds():
    rng = np.random.default_rng(1)
    first, second = rng.normal(size=(2, ERROR_STATES))
    second[:3] = 0.0
    np.testing.assert_allclose(put_together(second, first)[3:], (first + second)[3:], atol=1e-15)
    np.testing.assert_allclose(put_together(first, -first * (np.arange(24) < 3))[:3], 0, atol=1e-12)


def a_node(**given):
    node = np.zeros(1, NODE_DTYPE)[0]
    node["states"] = node["states_before"] = AIDED
    for name, value in given.items():
        node[name] = value
    return node


@pytest.mark.parametrize("in_wind", [0, 1])
def test_before_the_wind_was_known_the_velocity_was_that_through_the_air(in_wind):
    """v_air = v - wind where it flew; at rest it was over ground already. Wind and lag vanish."""
    rng = np.random.default_rng(2)
    node = a_node(states_before=UNAIDED, in_wind=in_wind)
    after, root = rng.normal(size=ERROR_STATES), rng.normal(size=(ERROR_STATES, ERROR_STATES))
    after[:3] = 0.0
    ps, before = root @ root.T, np.empty(ERROR_STATES)
    parted = np.eye(ERROR_STATES)
    parted[UNAIDED:] = 0.0
    for i in range(2 * in_wind):
        parted[VELOCITY + i, WIND + i] = -1.0
    expected = parted @ ps @ parted.T
    smoother._undo(node, after, ps, before)
    np.testing.assert_allclose(before, parted @ after, atol=1e-12)
    np.testing.assert_allclose(ps, expected, atol=1e-12)


def test_what_was_applied_comes_before_what_is_left():
    """The sum is `after` on top of `applied`: a rotation in `after` rotates what was applied."""
    node = a_node(applied=correction(velocity=(10.0, 0.0, 0.0)))
    before = np.empty(ERROR_STATES)
    smoother._undo(node, correction(angle=(0.0, 0.0, 0.1)), np.zeros((24, 24)), before)
    np.testing.assert_allclose(before[VELOCITY : VELOCITY + 3], [10.0, 1.0, 0.0], atol=1e-12)


def test_before_a_rotation_to_north_all_was_rotated_back():
    """Rotated right by 90 degrees: what is east now was north, what is south now was east."""
    node = a_node(rotated_rad=0.5 * math.pi)
    after = correction(velocity=(-2.0, 1.0, 3.0), wind=(-4.0, 5.0))
    ps, before = np.diag(np.arange(1.0, 25.0)), np.empty(ERROR_STATES)
    smoother._undo(node, after, ps, before)
    np.testing.assert_allclose(before[VELOCITY : VELOCITY + 3], [1.0, 2.0, 3.0], atol=1e-12)
    np.testing.assert_allclose(before[WIND : WIND + 2], [5.0, 4.0], atol=1e-12)
    # Variances of north and east change places.
    np.testing.assert_allclose(np.diag(ps)[VELOCITY : VELOCITY + 3], [8.0, 7.0, 9.0], atol=1e-12)


def a_row():
    row = empty(ESTIMATE_DTYPE, 1)[0]
    row["ned_from_body"] = attitude([0.3, -0.5, 1.1])
    row["rate_rad_s"], row["gyro_bias_rad_s"] = (1.0, 2.0, -3.0), (0.01, 0.02, 0.03)
    row["accel_m_s2"], row["attitude_sigma_rad"] = (0.5, -0.3, -9.5), 0.1
    return row


def test_a_row_is_moved_by_what_leads_to_the_smoothed_state():
    """Rate less bias and crossed rate: 0.01 * 1 + 0.02 * 2 in x, -0.03 * 3 in z."""
    delta = np.zeros(ERROR_STATES)
    delta[:3] = (0.02, -0.01, 0.03)
    delta[GYRO_BIAS : GYRO_BIAS + 3] = (0.001, -0.002, 0.003)
    delta[ACCEL_BIAS : ACCEL_BIAS + 3] = (0.1, -0.2, 0.3)
    delta[GYRO_MATRIX], delta[GYRO_MATRIX + 1], delta[GYRO_MATRIX + 8] = 0.01, 0.02, 0.03
    variance = np.full(ERROR_STATES, 0.04)
    variance[2], variance[GYRO_BIAS] = 0.09, 1e-6
    row, before = a_row(), a_row()
    smoother._write(row, delta, 0.4, variance, 0.07)
    was = Rotation.from_quat(np.roll(before["ned_from_body"], -1))
    turn = Rotation.from_rotvec([0.0, 0.0, 0.4]) * Rotation.from_rotvec(delta[:3]) * was
    found = Rotation.from_quat(np.roll(row["ned_from_body"], -1))
    np.testing.assert_allclose((found * turn.inv()).as_rotvec(), 0.0, atol=1e-12)
    np.testing.assert_allclose(row["rate_rad_s"], [1.0 - 0.051, 2.0 + 0.002, -3.0 + 0.087])
    np.testing.assert_allclose(row["gyro_bias_rad_s"], [0.011, 0.018, 0.033])
    np.testing.assert_allclose(row["accel_m_s2"], [0.4, -0.1, -9.8])
    # At rest the accelerometer reads -g along down: the remainder is the residual.
    gravity = turn.inv().apply([0.0, 0.0, -9.80665])
    np.testing.assert_allclose(row["residual_m_s2"], row["accel_m_s2"] - gravity, atol=1e-12)
    # Where the field itself points, 0.07 rad^2, stays unknown about down alone.
    np.testing.assert_allclose(row["attitude_sigma_rad"], [0.2, 0.2, 0.4])
    np.testing.assert_allclose(row["gyro_bias_sigma_rad_s"], [0.001, 0.2, 0.2])


def test_between_two_nodes_the_way_goes_evenly_from_the_earlier_on():
    """A quarter of the time after the earlier node a quarter of the change is made."""
    rows = empty(ESTIMATE_DTYPE, 5)
    rows[:] = a_row()
    rows["time_ns"] = np.arange(5) * 10_000_000
    after, before = correction(bias=(0.0, 0.0, 0.01)), correction(bias=(0.0, 0.0, 0.05))
    end, ps = np.full(ERROR_STATES, 0.09), 0.01 * np.eye(ERROR_STATES)
    smoother._fill(rows, 0, 4, after, before, 0.0, end, ps, 0.0)
    np.testing.assert_allclose(rows["gyro_bias_rad_s"][1:4, 2], 0.03 + np.array([0.02, 0.03, 0.04]))
    np.testing.assert_allclose(rows["attitude_sigma_rad"][1:4, 0] ** 2, [0.03, 0.05, 0.07])
    np.testing.assert_array_equal(rows["gyro_bias_rad_s"][[0, 4], 2], 0.03)


def two_nodes(**second):
    """Three equal rows, nodes at the first and the last; no motion and no noise between."""
    nodes, rows = np.zeros(3, NODE_DTYPE), empty(ESTIMATE_DTYPE, 3)
    rows[:] = a_row()
    rows["time_ns"] = np.arange(3) * 10_000_000
    for number, kind, sample in ((1, START, 0), (2, CHAINED, 2)):
        node = nodes[number]
        node["kind"], node["sample"], node["variance"] = kind, sample, 1.0
        node["states"] = node["states_before"] = AIDED
        node["covariance"] = np.eye(ERROR_STATES)[LOWER]
    for name, value in second.items():
        nodes[2][name] = value
    return nodes, rows


def assert_turned(rows, turns):
    """Each row is that of `a_row`, rotated about earth axes."""
    was = Rotation.from_quat(np.roll(a_row()["ned_from_body"], -1))
    for row, turn in zip(rows, turns, strict=True):
        found = Rotation.from_quat(np.roll(row["ned_from_body"], -1))
        np.testing.assert_allclose((found * (turn * was).inv()).as_rotvec(), 0.0, atol=1e-9)


def test_what_came_late_at_a_node_comes_before_what_later_nodes_found():
    """All corrections found at the second node apply at the first.

    There half a radian about down came late: the smoothed attitude has that first, then 0.6 about
    north. Half-way between the nodes the correction is the mean of both.
    """
    nodes, rows = two_nodes(applied=correction(angle=(0.6,)))
    nodes[1]["late"] = correction(angle=(0.0, 0.0, 0.5))
    smoother.smooth(nodes, 3, rows)
    about_north = Rotation.from_rotvec([0.6, 0.0, 0.0])
    at_node = about_north * Rotation.from_rotvec([0.0, 0.0, 0.5])
    between = Rotation.from_rotvec(0.5 * (at_node.as_rotvec() + about_north.as_rotvec()))
    assert_turned(rows, [at_node, between, Rotation.identity()])


def test_the_way_back_by_hand():
    """P 2, with noise 3 at the next node, where the measurement leaves 1: C = 2 / 3.

    The correction of 0.03 there is 0.02 here, and 2 + (1 - 3) * 4 / 9 = 10 / 9 is left.
    """
    nodes, rows = two_nodes(applied=correction(bias=(0.03, 0.0, 0.0)), variance=3.0)
    nodes[1]["covariance"] = 2.0 * np.eye(ERROR_STATES)[LOWER]
    smoother.smooth(nodes, 3, rows)
    np.testing.assert_allclose(rows["gyro_bias_rad_s"][:, 0], 0.01 + np.array([0.02, 0.025, 0.0]))
    # Half way between the nodes half way from 10 / 9 to what is left there, before it is used: 1.
    np.testing.assert_allclose(rows["gyro_bias_sigma_rad_s"][:, 0] ** 2, [10 / 9, 19 / 18, 1.0])


def test_before_a_heading_was_found_all_is_rotated_to_it():
    """By 0.7 rad to the right, up to the sample before the one at which it was found."""
    nodes, rows = two_nodes(rotated_rad=0.7)
    smoother.smooth(nodes, 3, rows)
    right = Rotation.from_rotvec([0.0, 0.0, 0.7])
    assert_turned(rows, [right, right, Rotation.identity()])


def test_what_the_heading_has_beyond_the_filter_is_where_the_field_points():
    node = a_node()
    covariance = np.diag(np.arange(1.0, 25.0) * 1e-3)
    node["covariance"] = covariance[LOWER]
    row = a_row()
    row["attitude_sigma_rad"][2] = 0.1
    # Of this 0.01 the filter's angle about down is 0.003.
    assert smoother._variance_of_the_field(row, node) == pytest.approx(0.007)


def test_noise_adds_and_a_bound_scales():
    """A variance beyond that predicted was noise; one below was held: the row shrinks."""
    predicted = np.array([[4.0, 1.0], [1.0, 9.0]])
    gain = np.array([[2.0, 6.0], [3.0, 5.0]])
    smoother._add_noise(predicted, gain, 2, np.array([1.0, 10.0]))
    np.testing.assert_allclose(predicted, [[1.0, 0.5], [0.5, 10.0]])
    np.testing.assert_allclose(gain, [[1.0, 3.0], [3.0, 5.0]])


def test_a_node_keeps_what_came_at_its_sample_apart_from_what_came_late():
    state, node = flying(5), a_node()
    state["applied"] = np.arange(24.0)
    state["at_rest"], state["rotated_rad"] = 0, 0.3
    state["delta_angle_rad"], state["delta_velocity_m_s"] = (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)
    state["update_rotation_s"] = np.arange(9.0).reshape(3, 3)
    smoother_history.arrive(state, node)
    assert (node["kind"], node["in_wind"], node["states_before"]) == (CHAINED, 1, AIDED)
    np.testing.assert_array_equal(node["rotation_s"], state["update_rotation_s"])
    np.testing.assert_array_equal(node["variance"], np.diag(state["covariance"]))
    assert smoother_history.close(state, node, 17) == 1
    assert (node["kind"], node["sample"], node["rotated_rad"]) == (CHAINED, 17, 0.3)
    state["applied"] += 0.5
    state["covariance"] *= 2.0
    smoother_history.leave(state, node)
    np.testing.assert_array_equal(node["applied"], np.arange(24.0))
    np.testing.assert_array_equal(node["late"], 0.5)
    np.testing.assert_array_equal(node["covariance"], state["covariance"][LOWER])


@pytest.mark.parametrize(("before", "now", "kind"), [(24, 21, START), (21, 24, CHAINED)])
def test_where_the_measured_velocity_was_given_up_a_chain_begins(before, now, kind):
    state, node = flying(5), a_node(kind=CHAINED, states_before=before)
    state["states"] = now
    smoother_history.close(state, node, 1)
    assert node["kind"] == kind


def test_at_rest_no_node_is_in_the_wind():
    state, node = flying(5), a_node()
    state["at_rest"] = 1
    smoother_history.arrive(state, node)
    assert node["in_wind"] == 0
