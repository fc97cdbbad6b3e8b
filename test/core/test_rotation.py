"""Rotations: laws that hold for every rotation, and the kernels against their numpy forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nav_pose_estimator.core.numerics import rotation
from nav_pose_estimator.core.numerics.vectors import q_exp, q_polish, q_rotate, q_rotate_back

number = st.floats(-10.0, 10.0, allow_subnormal=False)
vector = st.builds(lambda *v: np.array(v), number, number, number)
direction = vector.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))
turn = st.builds(
    lambda u, angle: u * angle, direction, st.one_of(st.floats(0.0, 3.14), st.floats(0.0, 1e-6), st.just(0.2))
)
quaternion = turn.map(rotation.quat_from_rotvec)
angle = st.floats(-3.1, 3.1)


@given(turn)
def test_exp_and_log_are_inverse(v):
    assert np.allclose(rotation.rotvec_from_quat_many(rotation.quat_from_rotvec(v)), v, rtol=1e-12, atol=1e-15)


@given(turn)
def test_exp_is_that_of_scipy(v):
    assert np.allclose(rotation.quat_to_matrix(np.array(q_exp(v))), Rotation.from_rotvec(v).as_matrix(), atol=1e-14)


@given(quaternion, vector)
def test_rotating_keeps_lengths_and_comes_back(q, v):
    turned = q_rotate(q, v)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(v), abs=1e-13)
    assert np.allclose(q_rotate_back(q, turned), v, atol=1e-13)
    assert np.allclose(turned, rotation.quat_to_matrix(q) @ v, atol=1e-13)


@given(quaternion, quaternion, vector)
def test_product_is_one_rotation_after_the_other(a, b, v):
    both = rotation.quat_rotate(rotation.quat_multiply(a, b), v)
    assert np.allclose(both, rotation.quat_rotate(a, rotation.quat_rotate(b, v)), atol=1e-13)
    assert np.allclose(rotation.quat_multiply(a, rotation.quat_conjugate(a)), (1.0, 0.0, 0.0, 0.0), atol=1e-14)


@given(angle, st.floats(-1.57, 1.57), angle)
def test_euler_angles_come_back(roll, pitch, yaw):
    q = rotation.quat_from_euler(roll, pitch, yaw)
    assert np.allclose(rotation.euler_from_quat(q), (roll, pitch, yaw), atol=1e-9)
    expected = Rotation.from_euler("ZYX", (yaw, pitch, roll)).as_matrix()
    assert np.allclose(rotation.quat_to_matrix(q), expected, atol=1e-13)


@given(angle, angle, st.sampled_from([-math.pi / 2, math.pi / 2]))
def test_euler_angles_straight_up_still_give_the_rotation(roll, yaw, pitch):
    q = rotation.quat_from_euler(roll, pitch, yaw)
    angles = rotation.euler_from_quat(q)
    again = rotation.quat_from_euler(*angles)
    assert abs(again @ q) == pytest.approx(1.0, abs=1e-12)
    assert np.allclose(rotation.euler_from_quat_many(q), angles)


def test_axes_are_those_of_rep_103():
    # A body that heads North, and one that climbs: yaw counts from East, pitch is positive nose down.
    north = rotation.quat_from_euler(0.0, 0.0, math.pi / 2)
    assert np.allclose(rotation.quat_rotate(north, np.array([1.0, 0.0, 0.0])), (0.0, 1.0, 0.0))
    climb = rotation.quat_from_euler(0.0, -0.1, 0.0)
    assert rotation.quat_rotate(climb, np.array([1.0, 0.0, 0.0]))[2] > 0.0


@given(vector, vector)
def test_skew_is_the_cross_product(a, b):
    assert np.allclose(rotation.skew(a) @ b, np.cross(a, b), atol=1e-12)


@given(st.floats(-1e4, 1e4))
def test_wrapped_angle(a):
    wrapped = rotation.wrap_angle(a)
    assert -math.pi <= wrapped < math.pi + 1e-11
    assert math.remainder(a - wrapped, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-11)
    assert rotation.wrap_angle_many(a) == wrapped


@pytest.mark.parametrize("a", [math.nan, math.inf, -math.inf])
def test_an_angle_that_is_not_finite_wraps_to_nan(a):
    """With and without a compiler: Python's floor of such a number is an error."""
    assert math.isnan(rotation.wrap_angle(a))


@pytest.mark.parametrize("bad", [(0.0, 0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 1.0), (math.inf, 0.0, 0.0, 0.0)])
def test_a_quaternion_without_length_becomes_the_identity(bad):
    assert np.array_equal(rotation.quat_normalize(np.array(bad)), (1.0, 0.0, 0.0, 0.0))
    assert np.array_equal(rotation.quat_normalize_many(np.array([bad])), [(1.0, 0.0, 0.0, 0.0)])


@given(quaternion, st.floats(-1e-4, 1e-4))
def test_polish_brings_back_unit_length(q, error):
    assert np.linalg.norm(q_polish(q * (1.0 + error))) == pytest.approx(1.0, abs=1.6 * error * error + 4e-16)


@given(st.lists(st.tuples(turn, turn, vector), min_size=1, max_size=5))
def test_numpy_forms_equal_the_kernels(cases):
    turns, others, vectors = (np.array(column) for column in zip(*cases, strict=True))
    q, p = (rotation.quat_from_rotvec_many(v) for v in (turns, others))
    each = {
        "quat_from_rotvec": ((turns,), q),
        "quat_multiply": ((q, p), rotation.quat_multiply_many(q, p)),
        "quat_conjugate": ((q,), rotation.quat_conjugate_many(q)),
        "quat_normalize": ((3.0 * q,), rotation.quat_normalize_many(3.0 * q)),
        "quat_rotate": ((q, vectors), rotation.quat_rotate_many(q, vectors)),
        "euler_from_quat": ((q,), rotation.euler_from_quat_many(q)),
        "quat_from_euler": (tuple(turns.T), rotation.quat_from_euler_many(*turns.T)),
    }
    for name, (arguments, together) in each.items():
        alone = [getattr(rotation, name)(*row) for row in zip(*arguments, strict=True)]
        assert np.allclose(together, alone, atol=1e-12), name
