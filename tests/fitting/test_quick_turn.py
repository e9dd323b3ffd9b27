import jax
import numpy as np
import pytest

from lite6jax.fitting.quick_turn import LARGEST, quick_turn


def exact(angle):
    """In the 64 bits of the processor's long double, of which the argument is reduced exactly."""
    wide = np.asarray(angle, np.longdouble)
    return np.cos(wide), np.sin(wide)


@pytest.mark.parametrize("reach", [1e-300, 1e-8, np.pi / 4, 2 * np.pi, 100.0, LARGEST])
def test_cosine_and_sine_are_those_of_long_doubles(reach):
    angle = np.random.default_rng(0).uniform(-reach, reach, 100_000)
    found = jax.jit(quick_turn)(angle)
    for value, right in zip((found.cos, found.sin), exact(angle), strict=True):
        assert float(np.max(np.abs(np.asarray(value) - right))) < 2.3e-16


def test_multiples_of_a_quarter_turn():
    angle = np.concatenate([np.arange(-8, 9) * np.pi / 2, np.nextafter(np.arange(-8, 9) * np.pi / 4, 10)])
    found = jax.jit(quick_turn)(angle)
    for value, right in zip((found.cos, found.sin), exact(angle), strict=True):
        np.testing.assert_allclose(np.asarray(value), right.astype(float), rtol=1e-12, atol=1e-16)
    assert quick_turn(np.zeros(1)).cos == 1
    assert np.isnan(quick_turn(np.array([np.nan, np.inf])).sin).all()


def test_what_no_joint_shows_is_still_a_turn():
    angle = np.array([1e7, -1e15, 1e30, -1e100, np.finfo(float).max])
    found = quick_turn(angle)
    np.testing.assert_allclose(found.cos**2 + found.sin**2, 1, rtol=0, atol=1e-15)


def test_a_turn_has_length_one_and_adds_up():
    one, other = np.random.default_rng(1).uniform(-7, 7, (2, 10_000))
    a, b, both = (quick_turn(angle) for angle in (one, other, one + other))
    np.testing.assert_allclose(a.cos**2 + a.sin**2, 1, rtol=0, atol=1e-15)
    np.testing.assert_allclose(both.cos, a.cos * b.cos - a.sin * b.sin, rtol=0, atol=4e-15)
    np.testing.assert_allclose(both.sin, a.sin * b.cos + a.cos * b.sin, rtol=0, atol=4e-15)
