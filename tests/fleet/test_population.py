"""Fleets of arms that are no robots: what all share and an odd arm are found, and of noise nothing."""

from pathlib import Path

import numpy as np
import pytest
from fleet.linear_arms import OPTIONS, arm, population, stored, tried, wave

from lite6jax.fleet.pooling import Reduced
from lite6jax.fleet.terms import PooledTerm
from lite6jax.workers import Workers

ROOT = Path(__file__).resolve().parents[2]
SOFT, OTHER = PooledTerm("soft"), PooledTerm("other3")
HALF = 0.3
"""Of an effect, whose standard error in one recording is 0.11: a single search finds about twice as much."""


def fleet(seed, effects, count=30):
    rng = np.random.default_rng(seed)
    return [arm(rng, effects(i, rng)) for i in range(count)]


def significance(one, term):
    """Standard deviations of a number in one recording."""
    found = one.evidence(term)
    return float(np.abs(found.score[0]) / np.sqrt(found.information[0, 0]))


def test_what_all_arms_share_below_the_threshold_of_one_is_found(tmp_path):
    arms = fleet(1, lambda i, rng: [(SOFT, [HALF])])
    assert np.mean([significance(one, SOFT) > 4.6 for one in arms]) < 0.1  # which a search of one needs
    found = population(tmp_path, arms)
    (effect,) = found.effects
    assert (effect.selected.term, effect.selected.way) == (SOFT, "mean")
    assert effect.selected.p_value < 1e-20
    mean, half = effect.hierarchy.mean[0], effect.hierarchy.half_width[0]
    assert abs(mean - HALF) < half < 0.06
    assert effect.outliers == {}
    # each arm is known better than by its recording alone, whose standard error is 0.11
    estimates = np.array([values[0] for values, _ in effect.estimates()])
    assert np.sqrt(np.mean((estimates - HALF) ** 2)) < 0.06


def test_a_gear_whose_phase_is_another_in_each_arm_is_found(tmp_path):
    arms = fleet(2, lambda i, rng: [wave(57.0, 0.6, rng.uniform(-np.pi, np.pi))])
    found = population(tmp_path, arms)
    (effect,) = found.effects
    assert (effect.selected.term, effect.selected.way) == (PooledTerm("waves:joint3", 57.0), "any")
    said = found.to_dict()["effects"][0]
    assert (said["effect"], said["site"], said["order"]) == ("joint_harmonic", "joint3", 57.0)
    assert said["amplitude_rms_rad"] == pytest.approx(0.6, abs=0.1)


@pytest.mark.parametrize(("degrees", "order"), [(10, 7.0), (2, 3.0), (30, 2.0)])
def test_of_orders_that_are_one_wave_in_all_arms_it_is_the_lowest(tmp_path, degrees, order):
    rng = np.random.default_rng(8)
    waves = [wave(order, 0.9, rng.uniform(-np.pi, np.pi)) for _ in range(8)]
    (effect,) = population(tmp_path, [arm(rng, [one], step=np.radians(degrees)) for one in waves]).effects
    assert effect.selected.term == PooledTerm("waves:joint3", order)


def test_an_odd_arm_is_named_and_the_type_is_that_of_the_others(tmp_path):
    def effects(i, rng):
        return [(SOFT, [1.0 + 0.1 * rng.normal() + 2.0 * (i == 4)])]

    found = population(tmp_path, fleet(3, effects, 12))
    (effect,) = found.effects
    assert list(effect.outliers) == [4]
    assert abs(effect.hierarchy.mean[0] - 1.0) < effect.hierarchy.half_width[0] < 0.2
    assert effect.estimates()[4][0][0] == pytest.approx(3.0, abs=0.4)
    said = found.to_dict()
    assert [member["file"] for member in said["recordings"] if member["outlier_in"]] == ["arm4.csv"]


def test_an_effect_of_one_arm_alone_is_its_own(tmp_path):
    def effects(i, rng):
        return [(OTHER, [1.2])] if i == 7 else []

    found = population(tmp_path, fleet(4, effects, 20))
    (effect,) = found.effects
    assert (effect.selected.term, list(effect.outliers)) == (OTHER, [7])
    assert abs(effect.hierarchy.mean[0]) < effect.hierarchy.half_width[0]


def test_of_few_arms_none_is_odd(tmp_path):
    found = population(tmp_path, fleet(5, lambda i, rng: [(SOFT, [1.0 + 3.0 * (i == 1)])], 4))
    assert [effect.outliers for effect in found.effects] == [{}]


def test_the_keys_of_its_document_are_described(tmp_path):
    whole = population(tmp_path, fleet(6, lambda i, rng: [(SOFT, [0.8])], 6)).to_dict()
    described = (ROOT / "docs" / "reference" / "results.md").read_text().split("## The file of a fleet")[1]
    keys = {
        *whole,
        *whole["recordings"][0],
        *whole["effects"][0],
        *next(iter(whole["effects"][0]["parameters"].values())),
    }
    assert [key for key in sorted(keys) if f"`{key}`" not in described] == []


def test_a_name_that_cannot_be_is_not_given(tmp_path):
    """A compliance is not negative."""
    found = population(tmp_path, fleet(7, lambda i, rng: [(SOFT, [-HALF])], 20))
    assert all(effect.selected.term != SOFT for effect in found.effects)


def test_numbers_do_not_depend_on_the_processes(tmp_path):
    arms = fleet(8, lambda i, rng: [(SOFT, [0.6])], 3)
    paths = stored(tmp_path, arms)
    asked = [(SOFT, (OTHER,)), (PooledTerm("waves:joint3", 9.5), ()), (PooledTerm("unknown"), ())]

    def numbers(processes):
        with Workers(processes=processes) as workers:
            reduced = Reduced(paths, OPTIONS, workers)
            return [
                (scan.named["bent"], scan.groups) for scan in reduced.scans([OTHER], tried(arms))
            ], reduced.evidence(asked)

    here, there = map(numbers, (0, 2))
    assert here[1][0][2] is None
    assert str(here) == str(there)


@pytest.mark.long
def test_noise_alone_is_no_effect_and_no_odd_arm(tmp_path):
    """Each of 40 fleets has an effect with a probability of 0.003."""
    alarms = [
        seed for seed in range(40) if population(tmp_path / str(seed), fleet(1000 + seed, lambda i, rng: [], 8)).effects
    ]
    assert len(alarms) <= 1
