"""Prior probabilities of terms add up to one at most, and noise exceeds the level of all orders no more often."""

from dataclasses import replace

import numpy as np
import pytest
from engine.linear_problem import Column, Decay, Driver, Wave, linear_problem
from scipy.integrate import quad

from lite6jax.effects.kernels import PAIRS, SCALED, SINGLE
from lite6jax.estimation.evidence import RESOLVED_ORDERS, log_orders, log_orders_of
from lite6jax.estimation.options import DEFAULTS
from lite6jax.search.scan import Scan


def test_the_probabilities_of_whole_and_other_orders_add_up_to_one():
    whole = np.exp(-log_orders(np.arange(1.0, DEFAULTS.highest_order + 1), DEFAULTS)).sum()
    assert whole == pytest.approx(DEFAULTS.prior.whole_order, rel=1e-12)

    def density(log_order: float) -> float:  # of log n, by which it is constant; 1e-6 beside a whole order
        order = np.exp(log_order) + 1e-6
        return RESOLVED_ORDERS * float(np.exp(-log_orders(order, DEFAULTS))) * order

    between = quad(density, 0, np.log(DEFAULTS.highest_order))[0]
    assert between == pytest.approx(1 - DEFAULTS.prior.whole_order, rel=1e-5)


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


def test_orders_count_more_where_angles_spread_farther_and_fewer_are_searched_to_a_lower_one():
    problem = linear_problem(np.random.default_rng(1))
    (family,) = problem.periodic
    twice = replace(family, angle=2 * family.angle)
    assert log_orders_of(twice, 7.5, DEFAULTS) - log_orders_of(family, 7.5, DEFAULTS) == pytest.approx(
        np.log(np.std(twice.angle) * np.sqrt(3) / np.pi / max(np.std(family.angle) * np.sqrt(3) / np.pi, 1))
    )
    some = replace(family, highest=40.0)
    assert log_orders_of(some, 7.5, DEFAULTS) < log_orders_of(family, 7.5, DEFAULTS)


# ---------------------------------------------------------------------------- costs of a scan


@pytest.fixture(scope="module")
def scan():
    """Of seven names, three sites and seven quantities, one of which is an angle."""
    return Scan(linear_problem(np.random.default_rng(1)), DEFAULTS)


def weights_of_processes(scan):
    """Of all processes of one quantity, and of all of two."""
    count, one, two = len(scan.quantities), 0.0, 0.0
    for component in scan.problem.components:
        for which in [(k,) for k in range(count)] + [(a, b) for a in range(count) for b in range(a + 1, count)]:
            kernels_of_it = [name for name in (SINGLE if len(which) == 1 else PAIRS) if scan.suits(name, which)]
            weight = len(kernels_of_it) * np.exp(-scan.cost_of_process(component.site, which))
            one, two = one + weight * (len(which) == 1), two + weight * (len(which) == 2)
    return one, two


def test_the_prior_probabilities_of_all_terms_add_up_to_one_at_most(scan):
    names = sum(np.exp(-scan.cost_of_name(term)) for term in scan.names)
    waves = DEFAULTS.prior.wave  # of one family, and the weights of its orders add up to one
    assert 0.3 < names + waves + sum(weights_of_processes(scan)) <= 1 + 1e-9


def test_each_kind_of_process_has_a_quarter_at_most(scan):
    one, two = weights_of_processes(scan)
    assert 0.05 < one <= 1 / 4 + 1e-9
    assert 0.05 < two <= 1 / 4 + 1e-9


def test_a_quantity_is_likelier_at_its_own_site(scan):
    place = {quantity.driver: k for k, quantity in enumerate(scan.quantities)}
    angle, u1 = place[Driver("angle")], place[Driver("u1")]
    assert scan.cost_of_process("wheel", (angle,)) < scan.cost_of_process("x", (angle,))
    assert scan.cost_of_process("x", (u1,)) < scan.cost_of_process("wheel", (u1,))
    # of a site that has no quantity of its own all are as likely
    assert scan.cost_of_process("y", (angle,)) == scan.cost_of_process("y", (u1,))


def test_two_quantities_cost_more_than_one_and_in_any_order_the_same(scan):
    for a, b in ((0, 1), (2, 6)):
        both = scan.cost_of_process("x", (a, b))
        assert both == pytest.approx(scan.cost_of_process("x", (b, a)))
        assert both > max(scan.cost_of_process("x", (k,)) for k in (a, b))


def test_a_number_that_is_tried_costs_and_what_nearly_every_problem_has_does_not(scan):
    plain = scan.cost_of_name(Column("u3"))
    assert scan.cost_of_name(Decay("u3", 0.3)) > plain
    assert plain > scan.cost_of_name(Column("u3", usual=True)) == pytest.approx(np.log(2))


def test_a_multiple_of_a_wave_costs_its_choice_alone(scan):
    (family,) = scan.problem.periodic
    any_multiple = 0.5 * np.exp(-log_orders_of(family, 2.0, DEFAULTS))
    twice = -np.log(0.5 + any_multiple)
    for order, others in ((20.0, [Wave(10.0)]), (10.0, [Column("u1"), Wave(20.0)])):
        assert scan.cost_of_wave(Wave(order), others) == pytest.approx(twice)
        assert scan.cost_of_wave(Wave(order), ()) > twice + 2
    thrice = float(log_orders_of(family, 3.0, DEFAULTS)) + np.log(2)
    assert scan.cost_of_wave(Wave(30.0), [Wave(10.0)]) == pytest.approx(thrice)
    assert scan.cost_of_wave(Wave(15.0), [Wave(10.0)]) == scan.cost_of_wave(Wave(15.0), ())
    # the multiples of one wave have no more than even odds of twice it and all whole orders together
    weights = [np.exp(-scan.cost_of_wave(Wave(10.0 * multiple), [Wave(10.0)])) for multiple in range(2, 41)]
    assert 0.5 < sum(weights) <= 0.5 + 0.5 * DEFAULTS.prior.whole_order
    assert scan.cost_of_wave(Column("u1"), ()) is None


def test_a_kernel_of_angles_suits_no_other_quantity(scan):
    names = [quantity.driver.phrase for quantity in scan.quantities]
    suiting = {name: [phrase for k, phrase in enumerate(names) if scan.suits(name, (k,))] for name in SINGLE}
    assert suiting["wave"] == suiting["play"] == ["angle"]
    assert all(suiting[name] == names for name in SCALED)
