"""A wave of any order whose size follows a driver is one term; a wave of one size keeps its name."""

from dataclasses import replace

import numpy as np
import pytest
from engine import linear_problem as linear

from lite6jax.effects.kernels import kernel_of
from lite6jax.estimation.options import EngineOptions
from lite6jax.search.scan import Scan
from lite6jax.search.search import search

OPTIONS = EngineOptions()


@pytest.fixture(autouse=True)
def turning(monkeypatch):
    monkeypatch.setattr(linear, "Driver", linear.Turning)


def made(seed, order, constant, slope):
    """200 samples of a wheel with a wave of the size `constant + slope u2`, over the size of the noise."""

    def wave(data):
        return (constant + slope * data["u2"]) * np.sin(order * data["angle"] + 0.3)

    rng = np.random.default_rng(seed)
    return linear.linear_problem(rng, samples=200, planted=wave, noise=(1.0, 1.0), site="wheel")


@pytest.mark.parametrize("order", [4.2, 37.0])
def test_a_wave_whose_size_follows_a_driver_is_one_term_with_its_order_and_its_driver(order):
    (test,) = search(made(2, order, 0.5, 1.0), OPTIONS).state.tested
    assert (test.term.kernel, test.term.phrases) == ("line*sine", ("u2", "angle"))
    assert test.term.rolloff[0] == pytest.approx(order, abs=0.03)


def test_a_wave_of_one_size_keeps_its_name():
    (test,) = search(made(2, 4.2, 1.0, 0.0), OPTIONS).state.tested
    assert not test.term.nonparametric
    assert test.term.order == pytest.approx(4.2, abs=0.05)


def test_its_choice_costs_what_the_table_says():
    problem = made(4, 1.0, 0.0, 0.0)
    scan = Scan(problem, OPTIONS)
    which = (scan.phrases.index("u2"), scan.phrases.index("angle"))
    its = "wheel", which, kernel_of("line*sine"), (7.85,)
    cost = scan.cost_of_kernel(*its)
    likelier = replace(OPTIONS, prior=replace(OPTIONS.prior, modulated=2 * OPTIONS.prior.modulated))
    assert cost - Scan(problem, likelier).cost_of_kernel(*its) == pytest.approx(np.log(2))
    # the site has one quantity of its own, its angle: u2 has a share of 0.4 of six
    wave = scan.cost_of_wave(linear.Wave(7.85), ())
    price = OPTIONS.prior.cost("modulated") - OPTIONS.prior.cost("wave")
    share = (1 - OPTIONS.prior.own_driver) / scan.drivers
    assert cost - wave == pytest.approx(price - np.log(share))
