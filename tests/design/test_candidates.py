"""Candidates: inside limits and filters, the same at every call; each filter against plain NumPy; every refusal."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lite6jax.arms.arm import Arm
from lite6jax.arms.description import load_bundled
from lite6jax.design.candidates import (
    Filter,
    above_floor,
    all_pass,
    candidates,
    chain_capsules,
    clear_of_itself,
    inside_box,
    inside_limits,
    link_frames,
    segment_distance,
    self_collision,
    user_filter,
)
from lite6jax.errors import InputError
from tests.oracles.arms import random_kinematics, random_positions
from tests.oracles.chains import six_parameter_poses

ARM = load_bundled("lite6")
LOW, HIGH = (0.0, -0.4, 0.1), (0.6, 0.4, 0.7)
TOOL = (0.02, -0.01, 0.1)


def test_candidates_fill_the_limits_but_for_a_margin_and_are_repeatable():
    found, again, other = (candidates(ARM, 3000, seed).joint_position for seed in (1, 1, 2))
    np.testing.assert_array_equal(found, again)
    assert not np.array_equal(found, other)
    lower, upper = ARM.joint_limits.T
    assert np.all((found >= lower) & (found <= upper))
    np.testing.assert_allclose(np.mean((found - lower) / (upper - lower), axis=0), 0.5, atol=0.03)
    found = candidates(ARM, 2000, limit_margin=0.3)
    limits = inside_limits(ARM, 0.3)
    np.testing.assert_allclose(limits - ARM.joint_limits, [[0.3, -0.3]] * 6)
    assert np.all((found.joint_position >= limits[:, 0]) & (found.joint_position <= limits[:, 1]))
    assert found.tried >= 2000
    assert found.refused == {}


def test_filters_agree_with_plain_numpy_and_are_counted():
    collision = self_collision(ARM)
    filters = [above_floor(ARM, 0.05, TOOL), inside_box(ARM, LOW, HIGH, TOOL), clear_of_itself(collision, 0.01)]
    q = np.random.default_rng(3).uniform(*ARM.joint_limits.T, (500, 6))
    flange = six_parameter_poses(ARM.kinematics, q) @ ARM.T_joint_flange
    tool = flange[:, :3, :3] @ TOOL + flange[:, :3, 3]
    heights = [six_parameter_poses(ARM.kinematics[:i], q[:, :i])[:, 2, 3] for i in range(2, 7)]
    floor = np.min([*heights, flange[:, 2, 3], tool[:, 2]], axis=0) > 0.05
    box = np.all((tool >= LOW) & (tool <= HIGH), axis=1)
    clear = collision.clearance(q) > 0.01
    for condition, expected in zip(filters, (floor, box, clear), strict=True):
        assert 0 < expected.sum() < 500
        np.testing.assert_array_equal(condition.accepts(q), expected)
    np.testing.assert_array_equal(all_pass(filters, q), floor & box & clear)

    found = candidates(ARM, 1000, 5, filters)
    assert len(found.joint_position) == 1000
    assert all_pass(filters, found.joint_position).all()
    assert list(found.refused) == ["floor", "box", "self-collision"]
    assert found.tried - sum(found.refused.values()) >= 1000
    np.testing.assert_array_equal(found.joint_position, candidates(ARM, 1000, 5, filters).joint_position)


def test_a_users_own_filter(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text("import numpy as np\nlow = 0.5\ndef bent(q):\n    q += 0\n    return np.abs(q[:, 1]) > low\n")
    condition = user_filter(f"{path}:bent")
    assert condition.name == f"{path}:bent"
    found = candidates(ARM, 500, filters=[condition]).joint_position
    assert np.all(np.abs(found[:, 1]) > 0.5)


NOTHING = Filter("nothing", lambda q: np.zeros(len(q), bool))
HALF = Filter("half", lambda q: q[:, 0] > 0)
RARE = Filter("rare", lambda q: q[:, 1] > ARM.joint_limits[1, 1] - 1e-4)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: candidates(ARM, 0), "0 candidates: give 1 or more"),
        (lambda: candidates(ARM, 10, filters=[HALF, NOTHING]), "0 of 114688 joint positions pass; "),
        (lambda: candidates(ARM, 10, filters=[RARE, HALF]), "rare refused 100 % of them; widen it"),
        (lambda: candidates(ARM, 10, limit_margin=-1.0), "limit margin -1 rad: give zero or more"),
        (lambda: user_filter("mine.py"), "filter 'mine.py': write FILE.py:function"),
    ],
)
def test_refusals(call, words):
    with pytest.raises(InputError) as caught:
        call()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("raise RuntimeError('two\\nlines')\n", "cannot be loaded (RuntimeError: two lines); correct it"),
        ("def other(q): pass\n", "has no function 'bent'; write one, or name another"),
        ("def bent(q): return q[9, 9, 9]\n", "bent: fails (IndexError: "),
        ("def bent(q): return 1.0 * q[:, 0]\n", "bent: returns float64 of shape (5,) for 5 samples; return (5,) bool"),
    ],
)
def test_refused_filters(tmp_path, text, words):
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        user_filter(f"{path}:bent").accepts(np.zeros((5, 6)))
    assert words in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


# ------------------------------------------------------------------ clearance


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
