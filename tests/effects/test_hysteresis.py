"""Effects with memory: a plain loop, laws of hysteresis, and springs that yield as oracles."""

from itertools import pairwise

import jax.numpy as jnp
import numpy as np

from lite6jax.effects.kernels import plays
from lite6jax.effects.motion import motion_of
from lite6jax.effects.nonparametric import Unnamed
from tests.oracles.effects import play

RNG = np.random.default_rng(5)


def runs_of(run):
    """(2, sample): first and last sample of the run of each."""
    return motion_of(np.zeros((len(run), 1)), run=run).run


def test_a_play_is_pushed_along_and_left_behind():
    run = np.repeat([0, 1, 2], [20, 1, 29])
    values, widths = RNG.normal(size=50), np.array([0.0, 0.3, 1.1, 5.0])
    found = np.asarray(plays(jnp.asarray(values), jnp.asarray(widths), runs_of(run)))
    for row, width in zip(found, widths, strict=True):
        np.testing.assert_allclose(row, play(values, width, run), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(found[0], values)
    np.testing.assert_array_equal(found[3], 0)


def test_the_rate_does_not_matter_and_loops_close():
    turning = np.array([0.0, 1.0, -0.6, 0.4, -0.6, 1.0])
    slow = np.concatenate([np.linspace(a, b, 40) for a, b in pairwise(turning)])
    widths, one = jnp.array([0.1, 0.25, 0.5]), np.zeros(len(slow), int)
    fine = np.asarray(plays(jnp.asarray(slow), widths, runs_of(one)))
    coarse = np.asarray(plays(jnp.asarray(turning), widths, runs_of(one[:6])))
    np.testing.assert_allclose(fine[:, 39::40], coarse[:, 1:], rtol=0, atol=1e-14)
    np.testing.assert_allclose(coarse[:, 2], coarse[:, 4], rtol=0, atol=1e-15)  # the inner loop's two ends
    np.testing.assert_allclose(coarse[:, 1], coarse[:, 5], rtol=0, atol=1e-15)  # and the outer one's


def test_springs_beside_a_slider_are_a_line_and_a_play():
    """Of stiffness a, beside one of stiffness b whose slider gives way at a force f (Masing)."""
    a, b, half = 0.7, 1.9, 2.0
    f = 0.2 * half * b / (a + b)  # the play is then a fifth of half the range wide
    load = np.cumsum(RNG.normal(scale=0.3, size=300))
    x, slid, spring = 0.0, 0.0, []
    for force in load:
        x = (force + b * slid) / (a + b)
        if abs(b * (x - slid)) > f:
            side = np.sign(x - slid)
            x = (force - side * f) / a
            slid = x - side * f / b
        spring.append(x)
    functions = Unnamed("joint1", "gravity torque of joint 1", -half, half, "play").functions_at(load[None])
    line, slider = functions[1], functions[1] - 0.2 * functions[6]
    elastic, yielding = half / (a + b) * line, half * (1 / a - 1 / (a + b)) * slider
    np.testing.assert_allclose(elastic + yielding, spring, rtol=0, atol=1e-12)


def test_a_process_with_memory_deflects_by_runs():
    process = Unnamed("joint1", "position of joint 2", -1.0, 1.0, "play")
    assert process.hysteretic
    assert not Unnamed("joint1", "position of joint 2", -1.0, 1.0).hysteretic
    values = RNG.uniform(-1e-3, 1e-3, process.size)
    q, run = RNG.normal(size=(40, 2)), np.repeat([0, 1], 20)
    motion = motion_of(q, run=run)
    expected = (
        values[0]
        + values[1] * q[:, 1]
        + sum(
            value * (q[:, 1] - play(q[:, 1], width, run)) / width
            for value, width in zip(values[2:], (0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7), strict=True)
        )
    )
    functions = np.asarray(process.functions_at(process.values_at(motion, None), motion.run))
    bent, units = process.deflect(jnp.asarray(values), motion, None).joint, process.units(functions, motion).joint
    assert bent is not None
    assert units is not None
    np.testing.assert_allclose(bent[0], expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.tensordot(values, np.asarray(units), 1)[0], expected, rtol=0, atol=1e-14)
