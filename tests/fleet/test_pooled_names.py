"""Names and processes of a fleet in one contest: what is outside the catalogue has no name, the others keep theirs."""

import numpy as np
import pytest
from fleet.linear_arms import LOAD, POSITION, arm, population, tried, wave

from lite6jax.fleet.terms import FleetProcess, PooledTerm
from lite6jax.report.listings import population_report

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
    """The terms, of processes their site and drivers."""
    terms = [effect.selected.term for effect in found.effects]
    return [(term.site, term.drivers) if isinstance(term, FleetProcess) else term for term in terms]


def bump(one):
    """At joint 3, no effect of the catalogue; waves of low orders come near."""
    return one.places[1, 0] * height(one.values[1])


def height(position):
    return 0.7 * np.exp(-0.5 * ((position - 0.8) / 0.7) ** 2)


def hardening(one):
    """At joint 1, where the effect "soft" is the straight part of it."""
    return 0.12 * one.values[0] ** 3


def test_what_is_outside_the_catalogue_has_no_name_and_its_site(tmp_path):
    found = population(tmp_path, fleet(1, bump))
    assert names(found) == [("joint3", (POSITION.phrase,))]
    document = found.to_dict()
    (effect,) = document["effects"]
    assert (effect["effect"], effect["site"], effect["driver"]) == ("unnamed", "joint3", POSITION.phrase)
    assert (effect["nearest"]["effect"], effect["nearest"]["order"]) == ("joint_harmonic", 1.0)
    q = np.linspace(-np.pi, np.pi, 200)
    h, first = height(q), np.stack([np.sin(q), np.cos(q)], 1)
    share = 1 - np.linalg.lstsq(first, h)[1][0] / (h @ h)
    assert effect["nearest"]["share"] == pytest.approx(share, abs=0.15)  # its standard deviation is 0.1
    curve = {key: np.array(values) for key, values in effect["curve"].items() if key != "name"}
    off = curve["mean"] - height(curve["driver"])
    assert np.mean(np.abs(off) < 3 * curve["std"] + 0.03) > 0.9
    said = " ".join(str(part) for part in population_report(document))
    assert "1. Unnamed effect at joint3 as a function of its position: p = " in said
    assert "No effect of the catalogue describes it; the nearest, joint harmonic of order 1 at joint3, explains" in said


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
    """Each lies in the span of a process, or nearly."""
    found = population(tmp_path, fleet(3, effects=effects))
    assert sorted(names(found)) == sorted(term for term, _ in effects(np.random.default_rng(0)))


def test_a_name_elsewhere_stays_beside_what_has_none(tmp_path):
    found = population(tmp_path, fleet(4, bump, lambda rng: [(SOFT, [0.25])]))
    assert set(names(found)) == {SOFT, ("joint3", (POSITION.phrase,))}


def test_coefficients_mean_the_same_in_recordings_of_other_ranges():
    rng, values = np.random.default_rng(5), np.array([0.3, -0.2, 0.5, 0.4, 0.1, -0.3, 0.2])
    all_tried = tried([arm(rng) for _ in range(6)])
    load = next(one for one in all_tried.singles if (one.site, one.drivers) == ("joint1", (LOAD.phrase,)))
    (cubic,) = (one for one in all_tried.with_every_kernel(load) if one.kernel == "cubic")
    score, information = np.zeros(7), np.zeros((7, 7))
    for _ in range(6):
        found = arm(rng, [(cubic, values)], noise=np.zeros(80)).evidence(cubic)
        score, information = score + found.score, information + found.information
    estimate = np.linalg.lstsq(information, score, rcond=1e-9)[0]
    functions = cubic.functions(np.linspace(*cubic.bounds, 50)[None])
    np.testing.assert_allclose(estimate @ functions, values @ functions, atol=0.02)
