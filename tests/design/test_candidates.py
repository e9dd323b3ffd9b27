"""Candidates: inside limits and filters, the same at every call; each filter against plain NumPy; every refusal."""

import numpy as np
import pytest

from lite6jax.arms.description import load_bundled
from lite6jax.design.candidates import (
    Filter,
    above_floor,
    all_pass,
    candidates,
    clear_of_itself,
    inside_box,
    inside_limits,
    self_collision,
    user_filter,
)
from lite6jax.errors import InputError
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
