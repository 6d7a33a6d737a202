"""Rotations: round trips, composition, and kernels equal to the column helpers."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ahrs_service import rotation
from ahrs_service.rotation import (
    euler_columns,
    inverse_columns,
    multiply_columns,
    quaternion_columns,
    rotate_columns,
)

kernels = settings(deadline=None)
"""The first call of a kernel may compile it."""
angle = st.floats(-math.pi + 1e-6, math.pi - 1e-6)
pitch = st.floats(-1.5, 1.5)
component = st.floats(-50.0, 50.0)
vector = st.tuples(component, component, component)
tiny = st.floats(-1e-3, 1e-3)


@st.composite
def quaternions(draw):
    q = np.array(draw(st.tuples(*[st.floats(-1.0, 1.0)] * 4)))
    norm = np.linalg.norm(q)
    return q / norm if norm > 0.1 else np.array([1.0, 0.0, 0.0, 0.0])


def kernel(function, *arguments, shape=(4,)):
    out = np.empty(shape)
    function(*arguments, out)
    return out


def matrix(q):
    return kernel(rotation.matrix, q, shape=(3, 3))


@kernels
@given(roll=angle, pitch=pitch, yaw=angle)
def test_euler_angles_come_back(roll, pitch, yaw):
    q = kernel(rotation.from_euler, roll, pitch, yaw)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-14)
    back = kernel(rotation.to_euler, q, shape=(3,))
    np.testing.assert_allclose(back, (roll, pitch, yaw), atol=1e-9)


@kernels
@given(q=quaternions())
def test_quaternions_come_back_but_for_their_sign(q):
    roll, pitch_, yaw = kernel(rotation.to_euler, q, shape=(3,))
    assume(abs(pitch_) < math.pi / 2 - 1e-3)
    back = kernel(rotation.from_euler, roll, pitch_, yaw)
    assert abs(back @ q) == pytest.approx(1.0, abs=1e-9)


@kernels
@given(roll=angle, pitch=pitch, yaw=angle)
def test_angles_rotate_in_the_order_yaw_pitch_roll(roll, pitch, yaw):
    about = [
        np.array(rotation.from_rotation_vector(*vector))
        for vector in ((0.0, 0.0, yaw), (0.0, pitch, 0.0), (roll, 0.0, 0.0))
    ]
    composed = multiply_columns(multiply_columns(about[0], about[1]), about[2])
    expected = kernel(rotation.from_euler, roll, pitch, yaw)
    np.testing.assert_allclose(composed, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("euler", "body", "ned"),
    [
        ((0.0, 0.0, math.pi / 2), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ((0.0, math.pi / 2 - 1e-9, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
        ((math.pi / 2, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    ],
    ids=["nose to the east", "nose up", "right wing down"],
)
def test_the_convention_by_hand(euler, body, ned):
    q = kernel(rotation.from_euler, *euler)
    np.testing.assert_allclose(rotate_columns(q[None], np.array([body]))[0], ned, atol=1e-8)


@kernels
@given(p=quaternions(), q=quaternions(), v=vector)
def test_a_product_rotates_as_one_after_the_other(p, q, v):
    v = np.array([v])
    once = rotate_columns(multiply_columns(p, q)[None], v)
    twice = rotate_columns(p[None], rotate_columns(q[None], v))
    np.testing.assert_allclose(once, twice, atol=1e-11)
    np.testing.assert_allclose(matrix(p) @ matrix(q), matrix(multiply_columns(p, q)), atol=1e-13)


@kernels
@given(q=quaternions(), v=vector)
def test_the_inverse_rotates_back_and_lengths_stay(q, v):
    v = np.array([v])
    turned = rotate_columns(q[None], v)
    np.testing.assert_allclose(rotate_columns(inverse_columns(q[None]), turned), v, atol=1e-12)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(v), abs=1e-12)


@kernels
@given(p=quaternions(), q=quaternions(), v=vector)
def test_kernels_equal_the_column_helpers(p, q, v):
    product = kernel(rotation.multiply, p, q)
    np.testing.assert_allclose(product, multiply_columns(p[None], q[None])[0], atol=1e-15)
    np.testing.assert_allclose(
        kernel(rotation.to_euler, q, shape=(3,)), euler_columns(q[None])[0], atol=1e-12
    )
    np.testing.assert_allclose(
        matrix(q) @ np.array(v), rotate_columns(q[None], np.array([v]))[0], atol=1e-12
    )


@kernels
@given(roll=angle, pitch=pitch, yaw=angle)
def test_both_ways_to_make_a_quaternion_agree(roll, pitch, yaw):
    columns = quaternion_columns([[roll, pitch, yaw]])[0]
    np.testing.assert_allclose(kernel(rotation.from_euler, roll, pitch, yaw), columns, atol=1e-15)


@kernels
@given(q=quaternions())
def test_a_matrix_is_a_rotation(q):
    m = matrix(q)
    np.testing.assert_allclose(m @ m.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(m) == pytest.approx(1.0, abs=1e-13)


@kernels
@given(x=tiny, y=tiny, z=tiny)
def test_small_rotation_vectors_are_exact(x, y, z):
    """Below 1e-4 rad a series takes over; both sides of the border agree with the sine."""
    q = np.array(rotation.from_rotation_vector(x, y, z))
    norm = math.sqrt(x * x + y * y + z * z)
    expected = np.array(
        [math.cos(norm / 2), *(0.5 * np.sinc(norm / 2 / math.pi) * np.array([x, y, z]))]
    )
    np.testing.assert_allclose(q, expected, rtol=0.0, atol=1e-16)


def test_multiplying_in_place_is_allowed():
    p = kernel(rotation.from_euler, 0.1, 0.2, 0.3)
    q = kernel(rotation.from_euler, -0.4, 0.5, 1.6)
    expected = kernel(rotation.multiply, p, q)
    for out in (0, 1):
        pair = [p.copy(), q.copy()]
        rotation.multiply(*pair, pair[out])
        assert pair[out].tobytes() == expected.tobytes()


@kernels
@given(q=quaternions(), scale=st.floats(0.1, 10.0))
def test_normalising_gives_length_one_and_a_positive_w(q, scale):
    scaled = q * scale
    rotation.normalise(scaled)
    assert np.linalg.norm(scaled) == pytest.approx(1.0, abs=1e-14)
    assert scaled[0] >= 0.0
    assert abs(scaled @ q) == pytest.approx(1.0, abs=1e-12)


def test_straight_up_gives_no_nan():
    q = quaternion_columns([[0.3, math.pi / 2, 0.2], [0.3, -math.pi / 2, 0.2]])
    assert np.isfinite(euler_columns(q)).all()
    assert abs(euler_columns(q)[:, 1]) == pytest.approx(math.pi / 2, abs=1e-7)


@pytest.mark.parametrize("name", ["multiply", "matrix", "from_euler", "to_euler"])
def test_undecorated_kernels_give_the_same_bytes(name):
    compiled = getattr(rotation, name)
    rng = np.random.default_rng(2)
    for _ in range(200):
        q = rng.normal(size=(2, 4))
        q /= np.linalg.norm(q, axis=1)[:, None]
        angles = rng.normal(size=3) * rng.choice([1e-5, 1.0])
        arguments = {
            "multiply": (q[0], q[1]),
            "from_euler": tuple(angles),
        }.get(name, (q[0],))
        shape = {"matrix": (3, 3), "to_euler": (3,)}.get(name, (4,))
        fast = kernel(compiled, *arguments, shape=shape)
        plain = kernel(compiled.py_func, *arguments, shape=shape)
        assert fast.tobytes() == plain.tobytes()


@kernels
@given(q=quaternions(), stretch=st.floats(-1e-8, 1e-8))
def test_a_length_that_rounding_moved_is_kept(q, stretch):
    expected, kept = q.copy(), (1.0 + stretch) * q
    rotation.normalise(expected)
    rotation.keep_normal(kept)
    np.testing.assert_allclose(kept, expected, atol=3e-16)
