"""Pooled names against functions without a name: what is outside the catalogue has none, the others keep theirs."""

from dataclasses import replace

import numpy as np
import pytest
from populations.linear_arms import CUBIC, FUNCTIONS, OPTIONS, SPLINE, WIDE, arm, population, wave
from scipy.interpolate import BSpline

from lite6jax.populations.functions import in_common
from lite6jax.populations.reduced import PooledTerm
from lite6jax.populations.schema import check_fleet_document
from lite6jax.report.fleets import population_report, title

SOFT = PooledTerm("soft")


def fleet(seed, outside=None, effects=lambda rng: (), count=30):
    """Arms that have effects, and something of the catalogue's or not at one place.

    Args:
        seed: of all draws.
        outside: of a recording, what adds to the residual `(sample,)`.
        effects: of each arm.
        count: of them.
    """
    rng = np.random.default_rng(seed)
    arms = [arm(rng, effects(rng)) for _ in range(count)]
    for one in arms:
        one.residual[:] -= 0 if outside is None else outside(one)
    return arms


def names(found):
    return [effect.selected.term for effect in found.effects]


def bump(one):
    """At joint 3, no effect of the catalogue; waves of low orders come near."""
    return one.places["joint3"][0] * height(one.drivers["position"])


def height(position):
    return 0.7 * np.exp(-0.5 * ((position - 0.8) / 0.7) ** 2)


def hardening(one):
    """At joint 1, where the effect "soft" is the straight part of it."""
    return 0.12 * one.drivers["load"] ** 3


def test_what_is_outside_the_catalogue_has_no_name_and_its_site(tmp_path):
    arms = fleet(1, bump)
    assert min(one.evidence(PooledTerm("waves:joint3", 1.0), OPTIONS).p_value for one in arms) > 1e-6
    without = population(tmp_path / "names", [replace(one, functions=()) for one in arms])
    assert {one.key for one in names(without)} == {"waves:joint3"}  # the nearest name wins, and is wrong
    found = population(tmp_path / "functions", arms)
    assert names(found) == [PooledTerm(SPLINE.key)]
    document = found.to_dict()
    check_fleet_document(document, "fleet.json")
    (effect,) = document["effects"]
    assert (effect["effect"], effect["site"], effect["driver"]) == ("unnamed", "joint3", "position")
    assert (effect["nearest"]["effect"], effect["nearest"]["order"]) == ("joint_harmonic", 1.0)
    q = np.linspace(-np.pi, np.pi, 200)
    h, first = height(q), np.stack([np.sin(q), np.cos(q)], 1)
    share = 1 - np.linalg.lstsq(first, h)[1][0] / (h @ h)
    assert effect["nearest"]["share"] == pytest.approx(share, abs=0.15)  # its standard deviation is 0.1
    curve = {key: np.array(values) for key, values in effect["curve"].items() if key != "name"}
    off = curve["mean"] - height(curve["driver"])
    assert np.mean(np.abs(off) < 3 * curve["std"] + 0.03) > 0.9
    assert title(effect) == "a function of position without a name, joint3"
    said = " ".join(str(part) for part in population_report(document))
    assert "No effect of the catalogue describes it; the nearest, joint harmonic of order 1, joint3, explains" in said


def test_of_a_spring_that_hardens_the_linear_one_is_the_nearest(tmp_path):
    found = population(tmp_path, fleet(2, hardening))
    (effect,) = found.to_dict()["effects"]
    assert (effect["effect"], effect["site"], effect["nearest"]["effect"]) == ("unnamed", "joint1", "soft")


@pytest.mark.parametrize(
    "effects",
    [
        lambda rng: [(SOFT, [0.25])],
        lambda rng: [wave(2.0, 0.35, 0.7)],
        lambda rng: [(SOFT, [0.25 + 0.1 * rng.normal()]), wave(1.0, 0.6, rng.uniform(-np.pi, np.pi))],
    ],
)
def test_effects_of_the_catalogue_keep_their_names(tmp_path, effects):
    """Each lies in the span of a function, or nearly."""
    found = population(tmp_path, fleet(3, effects=effects))
    assert sorted(names(found)) == sorted(term for term, _ in effects(np.random.default_rng(0)))


def test_a_name_elsewhere_stays_beside_what_has_none(tmp_path):
    found = population(tmp_path, fleet(4, bump, lambda rng: [(SOFT, [0.25])]))
    assert sorted(names(found)) == sorted([SOFT, PooledTerm(SPLINE.key)])


def test_coefficients_mean_the_same_in_recordings_of_other_ranges():
    rng, values = np.random.default_rng(5), np.array([0.3, -0.2, 0.5, 0.4])
    common = in_common(function for _ in range(6) for function in arm(rng).functions)[CUBIC.key]
    score, information = np.zeros(4), np.zeros((4, 4))
    for _ in range(6):
        one = arm(rng, noise=np.zeros(80))
        (low, high) = common.ranges[0]
        u = np.clip(2 * (one.drivers["load"] - low) / (high - low) - 1, -1, 1)
        one.residual[:] -= values @ u ** np.arange(4)[:, None]
        found = one.over([common]).evidence(PooledTerm(CUBIC.key), OPTIONS)
        score, information = score + found.score, information + found.information
    np.testing.assert_allclose(np.linalg.solve(information, score), values, rtol=1e-6)


def test_functions_are_those_of_their_form():
    q = np.linspace(-3, 3, 30)
    knots = np.linspace(-3, 3, 6)[0] + 1.2 * np.arange(-3, 9)
    expected = [BSpline.basis_element(knots[i : i + 5], extrapolate=False)(q) for i in range(8)]
    np.testing.assert_allclose(SPLINE.basis(q[None]), np.nan_to_num(expected), atol=1e-12)
    both = WIDE.basis(np.stack([q / 3, q]))
    np.testing.assert_allclose(both, [np.ones(30), q / 3, q / 3], atol=1e-12)
    turning = replace(SPLINE, pieces=0, orders=(2.0,))
    np.testing.assert_allclose(turning.basis(q[None]), [np.sin(2 * q), np.cos(2 * q)])
    assert len({function.key for function in (*FUNCTIONS, turning)}) == 4
    assert WIDE.candidate.names[:4:3] == ("joint1_coefficient1_m", "joint3_coefficient1_m")
