"""Capsules against closed forms: distances of segments, frames, and every refusal."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lite6jax.arms.arm import Arm
from lite6jax.arms.description import load_bundled
from lite6jax.design.candidates import chain_capsules, link_frames, segment_distance, self_collision
from lite6jax.errors import InputError
from tests.oracles.arms import random_kinematics, random_positions
from tests.oracles.chains import six_parameter_poses


def distance_to_segment(point, p, q):
    d = q - p
    along = np.clip((point - p) @ d / (d @ d), 0, 1) if d.any() else 0.0
    return np.linalg.norm(point - p - along * d)


def distance_of_segments(p1, q1, p2, q2):
    """The least of the ends' distances and, where the common perpendicular meets both segments, of its length."""
    found = [distance_to_segment(p, p2, q2) for p in (p1, q1)] + [distance_to_segment(p, p1, q1) for p in (p2, q2)]
    d1, d2 = q1 - p1, q2 - p2
    across = np.cross(d1, d2)
    if np.linalg.norm(across) > 1e-9 * np.linalg.norm(d1) * np.linalg.norm(d2):
        s, t, _ = np.linalg.solve(np.stack([d1, -d2, across], 1), p2 - p1)
        if 0 <= s <= 1 and 0 <= t <= 1:
            found.append(abs((p2 - p1) @ across) / np.linalg.norm(across))
    return min(found)


def test_random_segments():
    rng = np.random.default_rng(0)
    ends = rng.uniform(-1, 1, (4, 3, 2000)) * rng.choice([1.0, 1e-3], (4, 1, 2000))
    found = np.asarray(segment_distance(*ends))
    np.testing.assert_allclose(found, [distance_of_segments(*case) for case in ends.transpose(2, 0, 1)], atol=1e-12)


def test_points_parallels_and_crossings():
    o, x, y, z = np.zeros(3), *np.eye(3)
    cases = [
        ((o, o, o, o), 0.0),
        ((o, o, x, x), 1.0),
        ((o, o, x + y, x - y), 1.0),
        ((x + y, x - y, o, o), 1.0),
        ((o, x, o, x), 0.0),
        ((o, x, y, x + y), 1.0),
        ((o, x, x + y, y), 1.0),
        ((o, x, 3 * x, 2 * x), 1.0),
        ((o, x, 0.5 * x, 3 * x), 0.0),
        ((o, x, 2 * x + y, 3 * x + y), np.sqrt(2)),
        ((-x, x, -y, y), 0.0),
        ((-x, x, z - y, z + y), 1.0),
        ((o, x, 0.5 * x + y, 0.5 * x + 2 * y), 1.0),
    ]
    found = segment_distance(*np.stack([np.stack(case) for case, _ in cases], -1))
    np.testing.assert_allclose(found, [value for _, value in cases], atol=1e-15)


@given(st.floats(-12, 0), st.integers(0, 10**6))
def test_nearly_parallel_segments(exponent, seed):
    rng = np.random.default_rng(seed)
    p1, q1, shift = rng.uniform(-1, 1, (3, 3))
    ends = p1, q1, p1 + shift, q1 + shift + 10**exponent * rng.uniform(-1, 1, 3)
    found = float(segment_distance(*(end[:, None] for end in ends))[0])
    assert found == pytest.approx(distance_of_segments(*ends), rel=1e-9)


def test_frames_of_every_link():
    rng = np.random.default_rng(1)
    arm = Arm("any", random_kinematics(rng, 5), T_joint_flange=six_parameter_poses(random_kinematics(rng, 1), [[0]])[0])
    q = random_positions(rng, 7, 5)
    F = link_frames(arm, q)
    assert F.shape == (6, 3, 4, 7)
    for i in range(5):
        expected = six_parameter_poses(arm.kinematics[: i + 1], q[:, : i + 1])
        np.testing.assert_allclose(np.moveaxis(F[i], -1, 0), expected[:, :3], atol=1e-12)
    np.testing.assert_allclose(np.moveaxis(F[5], -1, 0), (expected @ arm.T_joint_flange)[:, :3], atol=1e-12)


def planar(lengths, limit=np.pi):
    """Joints about z; the links lie along x."""
    rows = np.zeros((len(lengths), 6))
    rows[1:, 0] = lengths[:-1]
    flange = np.eye(4)
    flange[0, 3] = lengths[-1]
    return Arm("planar", rows, joint_limits=[[-limit, limit]] * len(lengths), T_joint_flange=flange)


def test_a_folded_planar_arm():
    collision = self_collision(planar([1.0, 0.5, 1.0]), chain_capsules(planar([1.0, 0.5, 1.0]), radius=0.1))
    assert [(collision.capsules[i].name, collision.capsules[j].name) for i, j in collision.pairs] == [
        ("link3", "link1")
    ]
    right = np.pi / 2
    q = [[0, 0, 0], [0.7, right, right], [0, right, 0.5 * right], [0, right, right + np.arctan(0.5)]]
    expected = [0.5, 0.5, 0.5, 0.5 - np.sqrt(0.2)]
    np.testing.assert_allclose(collision.clearance(q), np.array(expected) - 0.2, atol=1e-12)


def test_many_poses_agree_with_one_at_a_time_in_plain_numpy():
    """Pairs that always overlap are disabled: link 4 has no length, so that links 3 and 5 of the wrist meet."""
    arm = load_bundled("lite6")
    collision = self_collision(arm)
    capsules = collision.capsules
    assert ("link3", "link5") in collision.disabled
    assert not {(capsules[j].name, capsules[i].name) for i, j in collision.pairs} & set(collision.disabled)
    assert all(abs(capsules[i].link - capsules[j].link) > 1 for i, j in collision.pairs)
    q = np.random.default_rng(3).uniform(*arm.joint_limits.T, (4100, 6))
    found = collision.clearance(q)
    assert found.shape == (4100,)
    for n in (0, 1, 2, 4095, 4096, 4099):
        moved = (six_parameter_poses(arm.kinematics[: i + 1], q[n : n + 1, : i + 1])[0] for i in range(6))
        frames = [np.eye(4), *moved]
        ends = [[frames[c.link][:3, :3] @ p + frames[c.link][:3, 3] for p in (c.start, c.end)] for c in capsules]
        apart = [
            distance_of_segments(*ends[i], *ends[j]) - capsules[i].radius - capsules[j].radius
            for i, j in collision.pairs
        ]
        assert found[n] == pytest.approx(min(apart), abs=1e-10)


def test_a_radius_that_is_not_positive_is_refused():
    with pytest.raises(InputError, match=r"capsule radius .* m: give a positive length"):
        chain_capsules(planar([1.0]), np.nan)


def test_clearance_has_a_gradient_in_jax():
    arm = load_bundled("lite6")
    collision, q = self_collision(arm), np.random.default_rng(1).uniform(-1, 1, (5, 6))
    found = jax.jit(jax.grad(lambda q: collision.clearance(q).sum()))(jnp.asarray(q))
    step = 1e-6 * np.eye(30).reshape(30, 5, 6)
    slopes = [(collision.clearance(q + h) - collision.clearance(q - h)).sum() / 2e-6 for h in step]
    np.testing.assert_allclose(found, np.reshape(slopes, (5, 6)), atol=1e-6)
