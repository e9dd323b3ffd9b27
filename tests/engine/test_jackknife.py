"""Standard deviations from blocks: those of refits without each block, and those that hold where the fit's do not."""

import numpy as np
import pytest
from scipy.signal import lfilter

from lite6jax.estimation.jackknife import stds_over_blocks
from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.terms import Terms
from lite6jax.recordings.sequence import contiguous_blocks
from tests.engine.linear_problem import Column, LinearProblem, Wave

SAMPLES = 800
BLOCKS = 20
TRUE = 0.7
TERMS = Terms((Column("u"),))


def made(noise, regressor, **data):
    """One row: a level, the regressor times its number, and noise."""
    measured = 0.3 + TRUE * regressor + noise
    data = {"u": regressor, "angle": np.linspace(0, 30, len(noise)), **data}
    return LinearProblem(data, measured[None], (), run=np.zeros(len(noise), int), shares=(1.0,))


def both_stds(problem, terms=TERMS):
    """The estimate, its standard deviation by the fit, and that from blocks."""
    fitted = fit(problem, terms, EngineOptions())
    blocks = contiguous_blocks(problem.samples, BLOCKS)
    by_blocks = stds_over_blocks(problem, fitted, terms, fitted.values, blocks)
    return fitted.values, np.sqrt(np.diagonal(fitted.covariance)), by_blocks


def slow(rng, memory):
    """Unit noise that is autocorrelated over `memory` samples."""
    remains = np.exp(-1 / memory)
    shocks = np.sqrt(1 - remains**2) * rng.standard_normal(SAMPLES + 20 * memory)
    return lfilter([1.0], [1.0, -remains], shocks)[-SAMPLES:]


def test_it_is_the_jackknife_of_refits_where_blocks_know_alike():
    rng = np.random.default_rng(0)
    regressor = np.tile(rng.standard_normal(SAMPLES // BLOCKS), BLOCKS)
    slope = np.repeat(rng.standard_normal(BLOCKS), SAMPLES // BLOCKS)
    problem = made(slope * regressor + rng.standard_normal(SAMPLES), regressor)
    _, std, by_blocks = both_stds(problem)
    blocks = contiguous_blocks(SAMPLES, BLOCKS)
    refits = [fit(problem, TERMS, EngineOptions(), training=~block).values[0] for block in blocks]
    jackknife = np.sqrt((BLOCKS - 1) / BLOCKS * np.sum((np.array(refits) - np.mean(refits)) ** 2))
    assert by_blocks[0] == pytest.approx(jackknife, rel=0.1)  # weights are another in each refit
    assert by_blocks[0] > 3 * std[0]


@pytest.mark.parametrize("memory", [0, 2])
def test_the_larger_standard_deviation_covers_the_truth(memory):
    """The fit takes the noise for white: where it is, nothing is lost, and where it is not, the blocks know."""
    rng = np.random.default_rng(1)
    by_fit = []
    by_larger = []
    ratios = []
    for _ in range(300):
        noise = slow(rng, memory) if memory else rng.standard_normal(SAMPLES)
        regressor = slow(rng, 4)
        values, std, by_blocks = both_stds(made(noise, regressor))
        off = abs(values[0] - TRUE)
        by_fit.append(off < 1.96 * std[0])
        by_larger.append(off < 1.96 * max(std[0], by_blocks[0]))
        ratios.append(by_blocks[0] / std[0])
    assert 0.92 < np.mean(by_larger) < 0.98
    if memory:
        assert np.mean(by_fit) < 0.85
    else:
        assert np.median(ratios) == pytest.approx(0.98, abs=0.03)  # of a χ variable of 19


def test_a_number_that_one_block_determines_keeps_the_standard_deviation_of_the_fit():
    rng = np.random.default_rng(2)
    regressor = np.zeros(SAMPLES)
    regressor[:15] = 1.0
    _, std, by_blocks = both_stds(made(rng.standard_normal(SAMPLES), regressor))
    assert by_blocks[0] == pytest.approx(std[0], rel=1e-3)


def test_an_order_that_was_held_has_one_where_it_is_released():
    rng = np.random.default_rng(3)
    angle = np.linspace(0, 30, SAMPLES)
    problem = made(0.1 * rng.standard_normal(SAMPLES), slow(rng, 5))
    problem.measured[0] += np.sin(2.3 * angle)
    terms = Terms((Column("u"), Wave(2.3)))
    fitted = fit(problem, terms, EngineOptions())
    released = Terms((Column("u"), Wave(None)))
    exact = fit(problem, released, EngineOptions(), np.append(fitted.values, 2.3))
    by_blocks = stds_over_blocks(problem, exact, released, exact.values, contiguous_blocks(SAMPLES, BLOCKS))
    assert by_blocks[-1] == pytest.approx(np.sqrt(exact.covariance[-1, -1]), rel=0.5)
