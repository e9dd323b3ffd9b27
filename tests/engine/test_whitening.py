"""Whitened columns that are kept from model to model are those of a filter that is applied to all of them anew."""

from dataclasses import fields
from functools import cached_property

import numpy as np
import pytest
from engine.linear_problem import Column, LinearProblem, Process, Wave, linear_problem

from lite6jax.estimation import whitening
from lite6jax.estimation.least_squares import fit, linear_columns
from lite6jax.estimation.noise import Autocorrelation, NoiseModel
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Terms
from lite6jax.estimation.whitening import Whitened

OPTIONS = EngineOptions()


class WithSameProducts(LinearProblem):
    """A problem that, as those of a robot do, gives the same arrays of a process each time."""

    @cached_property
    def products(self):
        return {}

    def factored(self, term):
        if term not in self.products:
            self.products[term] = super().factored(term)
        return self.products[term]


@pytest.fixture
def problem():
    plain = linear_problem(np.random.default_rng(2), 160, lambda d: 0.8 * d["u2"] + np.tanh(3 * d["u3"]))
    return WithSameProducts(**{field.name: getattr(plain, field.name) for field in fields(plain)})


@pytest.fixture
def noises(problem):
    """Two models of noise of two groups, with a run that begins in the middle."""
    first = Autocorrelation(0.7, 0.8), Autocorrelation(0.5, 1.0)
    second = Autocorrelation(0.9, 0.3), Autocorrelation(0.0, 0.0)
    return [NoiseModel(models, problem.groups, (0, 50)) for models in (first, second)]


def models_of(problem):
    """Models as a search meets them: terms come, go and change places, and numbers move that columns depend on."""
    driver = problem.quantities[2]
    process = Process("x", (driver.driver,), driver.bounds, "medium", 1.0)
    free = Wave(None)
    terms = [(), (Column("u2"),), (Column("u2"), process), (process, free), (process, free), (free, Column("u2"))]
    orders = iter((1.0, 1.5, 1.5))
    for chosen in map(Terms, terms):
        values = np.zeros(chosen.size)
        for term, part in chosen.pairs:
            if term == free:
                values[part] = 0.2, 0.1, next(orders)
        yield chosen, values


def test_columns_are_those_that_are_whitened_anew(problem, noises):
    kept = Whitened()
    for noise in (*noises, noises[0]):
        for terms, values in models_of(problem):
            parts = kept.columns(problem, terms, values, noise)
            expected = noise.whitened(linear_columns(problem, terms, values))
            np.testing.assert_array_equal(np.concatenate(parts), expected)


def test_only_columns_that_changed_are_whitened(problem, noises, monkeypatch):
    whitened = []
    plain = NoiseModel.whitened

    def counted(self, rows):
        whitened.append(len(rows))
        return plain(self, rows)

    monkeypatch.setattr(NoiseModel, "whitened", counted)
    kept = Whitened()
    counts = []
    sizes = []
    for terms, values in models_of(problem):
        sizes.append(terms.size)
        whitened.clear()
        kept.columns(problem, terms, values, noises[0])
        counts.append(sum(whitened))
    # the levels; a name; a process; a wave; its columns at another order; nothing
    assert counts == [problem.rows, 1, sizes[2] - 1, 3, 3, 0]


def test_a_fit_and_a_test_with_kept_columns_are_those_without(problem, noises):
    kept = Whitened()
    for noise in noises:
        for terms, values in models_of(problem):
            some = fit(problem, terms, OPTIONS, values, noise=noise, whitened=kept)
            alone = fit(problem, terms, OPTIONS, values, noise=noise)
            np.testing.assert_array_equal(some.values, alone.values)
            np.testing.assert_array_equal(some.covariance, alone.covariance)
            left = score_test(problem, some, OPTIONS, whitened=kept).left
            np.testing.assert_array_equal(left, score_test(problem, alone, OPTIONS).left)


def test_where_there_is_no_room_columns_are_the_same(problem, noises, monkeypatch):
    monkeypatch.setattr(whitening, "_MOST", 1)
    kept = Whitened()
    for terms, values in models_of(problem):
        parts = kept.columns(problem, terms, values, noises[0])
        np.testing.assert_array_equal(np.concatenate(parts), noises[0].whitened(linear_columns(problem, terms, values)))


def test_columns_that_are_given_are_not_changed_by_later_models(problem, noises):
    kept = Whitened()
    terms, values = next(pair for pair in models_of(problem) if Wave(None) in pair[0].terms)
    before = kept.columns(problem, terms, values, noises[0])
    copies = [part.copy() for part in before]
    kept.columns(problem, terms, values + 0.3, noises[0])
    for part, copy in zip(before, copies, strict=True):
        np.testing.assert_array_equal(part, copy)
