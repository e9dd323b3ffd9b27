import os

import jax
import jaxtyping
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames, se3

EXACT = 4e-15
AXES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [1, 1, 0], [0, 1, -1], [-3, 2, 5], [1, -7, -2]], float)
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
ANGLES = [0.0, 1e-300, 1e-12, 1e-8, 0.99e-4, 1.01e-4, 0.1, 1.0, 2.0, 3.0, np.pi - 1e-6, np.pi - 1e-12]

angles = st.floats(-np.pi, np.pi)
vectors = arrays(np.float64, 3, elements=st.floats(-1.8, 1.8))
quaternions = arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 0.1)


def turned(w, R):
    return se3.rotation_log(se3.rotation_exp(w) @ R)


MODES = (jax.jacfwd, jax.jacrev)
EXPONENTIAL, LOGARITHM = ({mode: jax.jit(mode(function)) for mode in MODES} for function in (se3.rotation_exp, turned))
"""Derivatives by the first argument."""


def derivative(function, at, axis_step=1e-2):
    """(..., 3) by central differences of sixth order; their error is below 1e-12 at this step."""
    points = at + axis_step * np.multiply.outer([-3, -2, -1, 1, 2, 3], np.eye(3))
    columns = np.tensordot([-1, 9, -45, 45, -9, 1], function(points), 1) / (60 * axis_step)
    return np.moveaxis(columns, 0, -1)


@given(vectors)
def test_exponential_agrees_with_scipy(vector):
    np.testing.assert_allclose(se3.rotation_exp(vector), Rotation.from_rotvec(vector).as_matrix(), atol=EXACT)


@given(vectors.filter(lambda v: np.linalg.norm(v) < np.pi - 1e-6))
def test_logarithm_inverts_the_exponential(vector):
    np.testing.assert_allclose(se3.rotation_log(se3.rotation_exp(vector)), vector, atol=2e-14)


@given(quaternions)
def test_exponential_inverts_the_logarithm(quaternion):
    R = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    vector = se3.rotation_log(R)
    assert np.linalg.norm(vector) <= np.pi + EXACT
    np.testing.assert_allclose(se3.rotation_exp(vector), R, atol=EXACT)


@pytest.mark.parametrize("angle", ANGLES)
def test_logarithm_is_accurate_at_every_angle(angle):
    vectors = angle * AXES
    error = np.abs(se3.rotation_log(se3.rotation_exp(vectors)) - vectors).max()
    # to the last digits of the angle itself where it is small: log R is not taken from a trace near 3
    assert error <= 4e-15 * angle + 4e-16 * (angle > 1e-3)


def test_half_turns_come_back_with_either_sign():
    R = Rotation.from_rotvec(np.pi * AXES).as_matrix()
    vectors = np.asarray(se3.rotation_log(R))
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), np.pi, atol=EXACT)
    np.testing.assert_allclose(np.abs(np.sum(vectors * AXES, 1)), np.pi, atol=EXACT)
    np.testing.assert_allclose(se3.rotation_exp(vectors), R, atol=EXACT)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 0.99e-4, 1.01e-4, 0.1, 1.0, 3.0])
def test_derivative_of_the_exponential_equals_differences(angle, mode):
    for axis in AXES[[0, 6]]:
        J = EXPONENTIAL[mode](angle * axis)
        np.testing.assert_allclose(J, derivative(se3.rotation_exp, angle * axis), atol=1e-12)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 0.99e-4, 1.01e-4, 0.1, 1.0, 2.0, 3.0])
def test_derivative_of_the_logarithm_equals_differences(angle, mode):
    for axis in AXES[[2, 7]]:
        R = Rotation.from_rotvec(angle * axis).as_matrix()
        found = LOGARITHM[mode](np.zeros(3), R)
        np.testing.assert_allclose(found, derivative(lambda w, R=R: turned(w, R), np.zeros(3)), atol=2e-11)


@pytest.mark.parametrize("mode", MODES)
def test_derivative_of_the_logarithm_is_finite_up_to_half_a_turn(mode):
    for axis in AXES:
        R = Rotation.from_rotvec((np.pi - 1e-9) * axis).as_matrix()
        J = np.asarray(LOGARITHM[mode](np.zeros(3), R))
        # J_l^-1 has the axis as eigenvector of eigenvalue 1, and pi / 2 turned by 90 degrees beside it
        np.testing.assert_allclose(J @ axis, axis, atol=1e-7)
        np.testing.assert_allclose(np.linalg.svd(J)[1], [np.pi / 2, np.pi / 2, 1], atol=1e-7)


@given(angles, st.floats(-1.57, 1.57), angles)
def test_roll_pitch_yaw_round_trip(roll, pitch, yaw):
    rpy = np.array([roll, pitch, yaw])
    R = se3.rotation_from_rpy(rpy)
    np.testing.assert_allclose(R, Rotation.from_euler("xyz", rpy).as_matrix(), atol=EXACT)
    back = np.asarray(frames.rpy_from_rotation(R))
    np.testing.assert_allclose(se3.rotation_from_rpy(back), R, atol=EXACT)
    turns = (back - rpy) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-11)  # 1e-15 / cos(1.57) at the worst


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("off", [0.0, 1e-16, 1e-9, 1e-8, 1e-4])
@given(roll=angles, yaw=angles)
def test_upright_pitch_reproduces_the_rotation(sign, off, roll, yaw):
    R = Rotation.from_euler("xyz", [roll, sign * (np.pi / 2 - off), yaw]).as_matrix()
    np.testing.assert_allclose(se3.rotation_from_rpy(frames.rpy_from_rotation(R)), R, atol=EXACT)


@given(quaternions)
def test_quaternions_agree_with_scipy_and_come_back(quaternion):
    R = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    back = np.asarray(se3.quaternion_from_rotation(R))
    assert back[0] >= 0
    unit = quaternion / np.linalg.norm(quaternion)
    np.testing.assert_allclose(back, unit if unit @ back > 0 else -unit, atol=EXACT)


@given(vectors, vectors)
def test_skew_is_the_cross_product(a, b):
    np.testing.assert_allclose(se3.skew(a) @ b, np.cross(a, b), atol=1e-15)


@pytest.mark.parametrize("shape", [(), (2, 3), (0,)])
def test_leading_axes_are_batches(shape):
    rng = np.random.default_rng(0)
    vectors = rng.uniform(-1, 1, (*shape, 3))
    R = np.asarray(se3.rotation_exp(vectors))
    assert R.shape == (*shape, 3, 3)
    quaternion, rpy = se3.quaternion_from_rotation(R), frames.rpy_from_rotation(R)
    T = np.asarray(se3.transform(R, vectors))
    assert (se3.rotation_log(R).shape, quaternion.shape, rpy.shape) == ((*shape, 3), (*shape, 4), (*shape, 3))
    assert (se3.skew(vectors).shape, T.shape) == ((*shape, 3, 3), (*shape, 4, 4))
    for at in np.ndindex(shape):
        # one XLA program may fuse differently from another
        np.testing.assert_allclose(se3.rotation_exp(vectors[at]), R[at], atol=EXACT)
        np.testing.assert_allclose(se3.rotation_log(R[at]), vectors[at], atol=EXACT)
        np.testing.assert_allclose(se3.quaternion_from_rotation(R[at]), quaternion[at], atol=EXACT)
        np.testing.assert_allclose(se3.rotation_from_rpy(rpy[at]), R[at], atol=EXACT)
        np.testing.assert_array_equal(T[at], np.block([[R[at], vectors[at][:, None]], [0, 0, 0, 1]]))


@pytest.mark.skipif("CHECK_TYPES" not in os.environ, reason="types are checked in the second stage")
def test_types_are_checked_at_run_time():
    with pytest.raises(jaxtyping.TypeCheckError):
        se3.skew("a string")


@pytest.mark.parametrize("sliding", [(), (0, 3)])
def test_a_chain_is_the_product_of_its_transforms_whatever_the_block(monkeypatch, sliding):
    rng = np.random.default_rng(3)
    links = np.stack([frames.transform_from_row(row) for row in rng.uniform(-1, 1, (6, 6))])
    q = rng.uniform(-2, 2, (3, 11, 6))
    expected = np.eye(4)
    for i in range(6):
        motion = np.zeros((3, 11, 6))
        motion[..., 2 if i in sliding else 5] = q[..., i]
        expected = expected @ links[i] @ frames.transform_from_row(motion)
    for block in (4, 4096):
        monkeypatch.setattr(frames, "BLOCK", block)
        found = frames.chain(links, q, sliding)
        assert found.shape == (3, 11, 4, 4)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
