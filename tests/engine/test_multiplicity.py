"""The weights of candidates: they add up to one, and noise exceeds the level of all orders no more often than that."""

from dataclasses import replace

import numpy as np
import pytest
from engine.linear_problem import Column, Curve, Wave, linear_problem
from scipy.integrate import quad

from lite6jax.estimation.multiplicity import (
    description_length,
    log_orders,
    log_orders_of,
    multiplicity,
    searched_size,
)
from lite6jax.estimation.options import DEFAULTS


def test_the_probabilities_of_whole_and_other_orders_add_up_to_one():
    whole = np.exp(-log_orders(np.arange(1.0, DEFAULTS.highest_order + 1), DEFAULTS)).sum()
    assert whole == pytest.approx(DEFAULTS.whole_share, rel=1e-12)

    def density(log_order: float) -> float:  # of log n, by which it is constant; 1e-6 beside a whole order
        order = np.exp(log_order) + 1e-6
        return DEFAULTS.resolved_orders * float(np.exp(-log_orders(order, DEFAULTS))) * order

    between = quad(density, 0, np.log(DEFAULTS.highest_order))[0]
    assert between == pytest.approx(1 - DEFAULTS.whole_share, rel=1e-5)


def test_low_and_whole_orders_are_the_likelier_ones():
    assert np.all(np.diff(log_orders(np.arange(1.0, 400)[:, None] + np.array([0.0, 0.5]), DEFAULTS), axis=0) > 0)
    # two in three orders are whole: a factor of about seven over those between them
    preferred = float(log_orders(63.5, DEFAULTS) - log_orders(63.0, DEFAULTS))
    assert 1.5 < preferred < 2.5
    assert log_orders(63.0, DEFAULTS, whole=False) < log_orders(63.5, DEFAULTS, whole=False)
    assert log_orders(63.0, DEFAULTS, whole=False) > log_orders(63.0, DEFAULTS)


def test_orders_below_the_lowest_count_as_that_but_are_not_whole():
    assert log_orders(0.5, DEFAULTS) == pytest.approx(float(log_orders(1.0 + 1e-9, DEFAULTS)))
    assert log_orders(0.97, DEFAULTS) > log_orders(1.0, DEFAULTS) + 1.5


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize(("turns", "level"), [(1.0, 0.05), (1.0, 0.01), (0.6, 0.05), (2.0, 0.05)])
def test_noise_exceeds_the_level_of_all_orders_no_more_often_than_that(turns, level, whole):
    """In plain NumPy: the least p-value of all orders from 1 to 400, of 200 angles, in noise alone."""
    random = np.random.default_rng(7)
    orders = np.round(np.arange(1.0, DEFAULTS.highest_order, 0.1), 1)
    factor = np.exp(log_orders(orders, DEFAULTS, whole, turns=max(turns, 1.0)))
    angles = 2 * np.pi * turns * random.random(200)
    waves = np.exp(1j * np.multiply.outer(orders, angles))
    noise = random.standard_normal((200, 4000))
    gains = np.abs(waves @ noise) ** 2 / 200  # sine and cosine are orthogonal on average
    share = np.mean((np.exp(-gains) * factor[:, None]).min(0) < level)
    assert share < level + 2 * np.sqrt(level / 4000)
    assert share > 0.4 * level * min(turns, 1)  # and it is not a multiple of what is needed


def test_only_waves_of_a_fixed_order_have_a_weight_of_their_own():
    problem = linear_problem(np.random.default_rng(1))
    searched = searched_size(problem, DEFAULTS)
    assert multiplicity(problem, Column("u3"), DEFAULTS) == searched
    assert multiplicity(problem, Wave(None), DEFAULTS) == searched  # its order is fitted
    low, high = (multiplicity(problem, Wave(order), DEFAULTS) for order in (3.0, 320.5))
    assert low < searched < high


def test_orders_count_more_where_angles_spread_farther_and_fewer_are_searched_to_a_lower_one():
    problem = linear_problem(np.random.default_rng(1))
    (family,) = problem.periodic
    twice = replace(family, angle=2 * family.angle)
    assert log_orders_of(twice, 7.5, DEFAULTS) - log_orders_of(family, 7.5, DEFAULTS) == pytest.approx(
        np.log(np.std(twice.angle) * np.sqrt(3) / np.pi / max(np.std(family.angle) * np.sqrt(3) / np.pi, 1))
    )
    some = replace(family, highest=40.0)
    assert log_orders_of(some, 7.5, DEFAULTS) < log_orders_of(family, 7.5, DEFAULTS)


def test_the_order_of_a_wave_is_what_its_family_says():
    """Orders of a slide are waves per metre: in their family they are waves per stroke."""
    problem = linear_problem(np.random.default_rng(1))
    (family,) = problem.periodic
    stroke = replace(family, order=lambda term: None if term.order is None else 0.3 * term.order, whole=False)
    other = type(
        "Slide", (), {"periodic": (stroke,), "candidates": (), "shaped": (), "functions_tried": 0, "curves": ()}
    )()
    found = multiplicity(other, Wave(200.0), DEFAULTS) / searched_size(other, DEFAULTS)
    assert np.log(found * DEFAULTS.searched_orders) == pytest.approx(float(log_orders_of(stroke, 60.0, DEFAULTS)))


def test_description_lengths_count_numbers_and_the_choice_of_orders():
    problem = linear_problem(np.random.default_rng(1))
    (family,) = problem.periodic
    n = 500.0
    a_number = 0.5 * np.log(n)
    assert description_length(problem, [Column("u3")], n, DEFAULTS) == pytest.approx(a_number)
    low = description_length(problem, [Wave(3.0)], n, DEFAULTS)
    assert low == pytest.approx(3 * a_number + float(log_orders_of(family, 3.0, DEFAULTS)))
    both = description_length(problem, [Wave(3.0), Wave(160.7)], n, DEFAULTS)
    assert both == pytest.approx(low + 3 * a_number + float(log_orders_of(family, 160.7, DEFAULTS)))


def test_a_rare_function_costs_more_by_as_much_as_it_is_less_likely():
    problem, n = linear_problem(np.random.default_rng(3)), 100
    usual, rare = Curve("u2"), Curve("u2", rare=True)
    more = description_length(problem, [rare], n, DEFAULTS) - description_length(problem, [usual], n, DEFAULTS)
    assert more == pytest.approx(DEFAULTS.rare)
    factor = multiplicity(problem, rare, DEFAULTS) / multiplicity(problem, usual, DEFAULTS)
    assert np.log(factor) == pytest.approx(DEFAULTS.rare)
