"""The weights of candidates: they add up to one, and noise exceeds the level of all orders no more often than that."""

import numpy as np
import pytest
from scipy.integrate import quad

from lite6jax.effects.kinematic.joints import JointHarmonic, JointOffset
from lite6jax.estimation.multiplicity import description_length, log_orders, relative_multiplicity
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


def test_orders_below_the_lowest_count_as_that():
    assert log_orders(0.5, DEFAULTS, whole=False) == log_orders(1.0, DEFAULTS, whole=False)


@pytest.mark.parametrize(("turns", "level"), [(1.0, 0.05), (1.0, 0.01), (0.6, 0.05)])
def test_noise_exceeds_the_level_of_all_orders_no_more_often_than_that(turns, level):
    """In plain NumPy: the least p-value of all orders from 1 to 400, of 200 angles, in noise alone."""
    random = np.random.default_rng(7)
    orders = np.arange(1.0, DEFAULTS.highest_order, 0.1)
    factor = np.exp(log_orders(orders, DEFAULTS, whole=False))
    angles = 2 * np.pi * turns * random.random(200)
    waves = np.exp(1j * np.multiply.outer(orders, angles))
    noise = random.standard_normal((200, 4000))
    gains = np.abs(waves @ noise) ** 2 / 200  # sine and cosine are orthogonal on average
    share = np.mean((np.exp(-gains) * factor[:, None]).min(0) < level)
    assert share < level + 2 * np.sqrt(level / 4000)
    assert share > 0.4 * level * turns  # and it is not a multiple of what is needed


def test_only_terms_with_an_order_have_a_weight_of_their_own():
    assert relative_multiplicity(JointOffset(2), DEFAULTS) == 1.0
    assert relative_multiplicity(JointHarmonic(2), DEFAULTS) == 1.0  # its order is fitted
    assert relative_multiplicity(JointHarmonic(2, 2.0), DEFAULTS) == 1.0  # orders 1 and 2 have names of their own
    low, high = (relative_multiplicity(JointHarmonic(2, order), DEFAULTS) for order in (3.0, 320.5))
    assert low < 1 < high


def test_description_lengths_count_numbers_and_the_choice_of_orders():
    n = 500.0
    a_number = 0.5 * np.log(n)
    assert description_length([JointOffset(2)], n, DEFAULTS) == pytest.approx(a_number)
    assert description_length([JointHarmonic(2, 2.0)], n, DEFAULTS) == pytest.approx(2 * a_number)
    low = description_length([JointHarmonic(2, 3.0)], n, DEFAULTS)
    assert low == pytest.approx(3 * a_number + float(log_orders(3.0, DEFAULTS)))
    both = description_length([JointHarmonic(2, 3.0), JointHarmonic(2, 160.7)], n, DEFAULTS)
    assert both == pytest.approx(low + 3 * a_number + float(log_orders(160.7, DEFAULTS)))
