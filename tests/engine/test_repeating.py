"""What repeats at any order and is no sine is one term; a single wave, or a few, keep their names."""

from dataclasses import replace

import numpy as np
import pytest
from engine import linear_problem as linear

from lite6jax.effects.kernels import kernel_of
from lite6jax.estimation.options import EngineOptions
from lite6jax.search.scan import Scan
from lite6jax.search.search import search

OPTIONS = EngineOptions()
PERIOD = 0.8


@pytest.fixture(autouse=True)
def turning(monkeypatch):
    monkeypatch.setattr(linear, "Driver", linear.Turning)


def made(seed, planted):
    """200 samples of a wheel, as the size of the noise."""
    rng = np.random.default_rng(seed)
    return linear.linear_problem(
        rng, samples=200, planted=lambda data: planted(data["angle"]), noise=(1.0, 1.0), site="wheel"
    )


def sawtooth(angle):
    return 4 * ((angle / PERIOD + 0.3) % 1 - 0.5)


def ratchet(angle):
    """Slowly up, and back within a seventh of the period."""
    phase = (angle / PERIOD + 0.3) % 1
    return np.where(phase < 0.85, 4 * phase / 0.85 - 2, 2 - 4 * (phase - 0.85) / 0.15)


@pytest.mark.parametrize("planted", [sawtooth, ratchet])
def test_what_repeats_is_one_term_with_its_period(planted):
    (test,) = search(made(1, planted), OPTIONS).state.tested
    assert (test.term.kernel, test.term.site) == ("repeat", "wheel")
    assert 2 * np.pi / test.term.rolloff[0] == pytest.approx(PERIOD, rel=3e-3)


@pytest.mark.parametrize("order", [3.0, 4.2])
def test_a_wave_without_multiples_keeps_its_name(order):
    (test,) = search(made(2, lambda angle: 2 * np.sin(order * angle + 0.4)), OPTIONS).state.tested
    assert not test.term.nonparametric
    assert test.term.order == pytest.approx(order, abs=0.05)


def test_nothing_repeats_in_noise():
    assert search(made(3, np.zeros_like), OPTIONS).state.tested == ()


def test_its_choice_costs_what_the_table_says():
    problem = made(4, np.zeros_like)
    scan = Scan(problem, OPTIONS)
    which = (scan.phrases.index("angle"),)
    its = "wheel", which, kernel_of("repeat"), (7.85, 2.0)
    likelier = replace(OPTIONS, prior=replace(OPTIONS.prior, repeating=2 * OPTIONS.prior.repeating))
    cost = scan.cost_of_kernel(*its)
    assert cost - Scan(problem, likelier).cost_of_kernel(*its) == pytest.approx(np.log(2))
    wave = scan.cost_of_wave(linear.Wave(7.85), ())
    slopes = np.log(2)
    assert cost - wave == pytest.approx(slopes + OPTIONS.prior.cost("repeating") - OPTIONS.prior.cost("wave"))
    assert scan.cost_of_kernel(*its[:3], (7.0, 2.0)) < cost
