"""The engine on a problem without any robot: planted terms are found, and nothing where nothing was planted."""

from dataclasses import fields, replace

import numpy as np
import pytest
from engine.linear_problem import Column, Decay, Driver, LinearProblem, Number, Process, Wave, linear_problem

from lite6jax.estimation.documented import documented
from lite6jax.estimation.least_squares import fit, weighed
from lite6jax.estimation.noise import autocorrelation_time, noise_model
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import prior_precision
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Terms
from lite6jax.estimation.thresholds import CLOSE, MARGIN
from lite6jax.search.final_estimates import final_estimates
from lite6jax.search.search import search
from lite6jax.search.select import Selector
from lite6jax.search.state import SelectedTerm, State, refitted

OPTIONS = EngineOptions()


def found(problem, options=OPTIONS):
    return final_estimates(problem, search(problem, options).state, options)


def terms(state):
    return [test.term for test in state.tested]


def seeds(count, short):
    """Of which the first few are tried in each run, and the others with the long tests."""
    more = (pytest.param(seed, marks=pytest.mark.long) for seed in range(short, count))
    return pytest.mark.parametrize("seed", [*range(short), *more])


def test_a_number_that_no_sample_depends_on_has_no_share_of_the_inputs():
    problem = linear_problem(np.random.default_rng(0), planted=lambda d: 0.8 * d["u2"])
    problem.data["u4"] = np.zeros(problem.samples)
    terms = Terms((Column("u2"), Column("u4")))
    fitted = fit(problem, terms, OPTIONS)
    assert not np.diagonal(fitted.covariance).all()
    tested = tuple(map(SelectedTerm, terms.terms))
    said = final_estimates(problem, State(fit(problem, Terms(), OPTIONS), fitted, tested), OPTIONS)
    assert [test.input_share for test in said.tested] == [0.0, 0.0]


def test_a_group_of_readings_without_noise_is_scored():
    problem = linear_problem(np.random.default_rng(0), planted=lambda d: 0.8 * d["u2"])
    fitted = fit(problem, Terms(), OPTIONS)
    rows = fitted.residuals.rows.copy()
    rows[problem.groups == 1] = 0.0
    exact = replace(fitted, residuals=weighed(rows, fitted.noise, fitted.training))
    (score,) = score_test(problem, exact, OPTIONS).score([Column("u2")])
    assert np.isfinite(score.gain)


@seeds(4, 2)
def test_planted_terms_are_found_with_their_numbers(seed):
    problem = linear_problem(np.random.default_rng(seed), planted=lambda d: 0.8 * d["u2"] - 0.5 * d["u5"])
    state = found(problem)
    assert set(terms(state)) == {Column("u2"), Column("u5")}
    for term, truth in ((Column("u2"), 0.8), (Column("u5"), -0.5)):
        at = terms(state).index(term)
        std = np.sqrt(state.fit.covariance[at, at])
        assert abs(state.fit.values[at] - truth) < 4 * std
        # what weighted least squares leaves: both rows, the second with half the regressor and three times the noise
        bound = 1 / np.sqrt(np.sum(problem.data[term.name] ** 2) * (1 + 0.25 / 9))
        assert std == pytest.approx(bound, rel=0.15)


@seeds(8, 3)
def test_nothing_is_found_in_noise_of_unequal_scale(seed):
    assert terms(found(linear_problem(np.random.default_rng(100 + seed)))) == []


DECAYS = tuple(Decay(f"u{k}", width) for k in range(1, 7) for width in (0.1, 0.3, 1.0))


@seeds(4, 2)
def test_a_name_whose_number_is_tried_is_found_where_no_other_candidate_resembles_it(seed):
    hidden = Decay("u4", 0.45)
    problem = linear_problem(np.random.default_rng(seed), 800, lambda d: 0.8 * hidden.basis(d)[0])
    state = found(replace(problem, shaped=DECAYS))
    (term,) = terms(state)
    assert term.label == hidden.label
    assert term.width == pytest.approx(hidden.width, rel=0.5)
    assert abs(state.fit.values[0] - 0.8) < 4 * np.sqrt(state.fit.covariance[0, 0])
    # another width of the same name is no alternative to it
    assert all(other.term.label != term.label for test in state.tested for other in test.alternatives)


@seeds(8, 3)
def test_names_whose_number_is_tried_are_not_found_in_noise(seed):
    assert terms(found(replace(linear_problem(np.random.default_rng(300 + seed)), shaped=DECAYS))) == []


@seeds(6, 3)
def test_nothing_is_found_in_noise_that_is_autocorrelated_in_one_group(seed):
    problem = linear_problem(np.random.default_rng(200 + seed), correlated=(0.0, 0.9), runs=3)
    assert terms(found(problem)) == []


def test_a_term_is_found_in_autocorrelated_noise_and_each_group_has_its_own_model():
    rng = np.random.default_rng(5)
    problem = linear_problem(rng, 800, lambda d: 0.8 * d["u3"], correlated=(0.0, 0.9))
    state = found(problem)
    assert terms(state) == [Column("u3")]
    white, correlated = state.fit.noise.models
    assert white.share == 0.0
    assert correlated.coefficient * correlated.share > 0.7
    assert state.fit.scale == pytest.approx([1.0, 3.0], rel=0.25)


def test_a_name_that_one_group_alone_shows_does_not_stand():
    problem = linear_problem(np.random.default_rng(8), planted=lambda d: 3.0 * d["u3"])
    assert terms(found(problem)) == [Column("u3")]
    contradicted = problem.measured - np.array([[0.0], [1.5]]) * problem.data["u3"]
    other = replace(problem, measured=contradicted)
    # at y, it would be a part of what is true
    object.__setattr__(other, "components", other.components[:2])
    assert Column("u3") not in terms(found(other))


def likelihood(problem, name):
    fitted = fit(problem, Terms((Column(name),)), OPTIONS)
    return fitted.log_likelihood(fitted.scale)


@seeds(4, 2)
def test_of_neighbours_the_likelier_one_is_found_and_the_other_is_its_alternative(seed):
    rng = np.random.default_rng(seed)
    problem = linear_problem(rng, planted=lambda d: 0.8 * d["u2"])
    problem.data["u6"] = problem.data["u2"] + 0.1 * rng.normal(size=400)
    (tested,) = search(problem, OPTIONS).state.tested
    others = [one for one in tested.alternatives if not one.term.nonparametric]
    assert {tested.term, *(one.term for one in others)} <= {Column("u2"), Column("u6")}
    other = "u6" if tested.term == Column("u2") else "u2"
    gap = likelihood(problem, tested.term.name) - likelihood(problem, other)
    assert gap > -0.2
    assert bool(others) == (gap < CLOSE)
    if others:
        assert others[0].gap == pytest.approx(gap, rel=0.1, abs=0.2)


def test_a_ramp_is_found_although_residuals_without_it_look_autocorrelated():
    """In which it would be much less significant; its noisy copy explains less."""
    rng = np.random.default_rng(4)
    problem = linear_problem(rng, planted=lambda d: np.linspace(-30, 30, 400))
    problem.data["u2"] = np.linspace(-1, 1, 400)
    problem.data["u6"] = problem.data["u2"] + 0.1 * rng.normal(size=400)
    (tested,) = search(problem, OPTIONS).state.tested
    assert tested.term == Column("u2")
    assert tested.p_value < 1e-6
    assert Column("u6") not in [one.term for one in tested.alternatives]


def test_a_neighbour_whose_numbers_are_not_possible_does_not_take_a_place():
    rng = np.random.default_rng(4)
    problem = linear_problem(rng, planted=lambda d: -0.8 * d["u2"])
    problem.data["u6"] = problem.data["u2"] + 0.03 * rng.normal(size=400)
    positive = Column("u2", coordinates=(Number(lower=0.0),))
    others = tuple(term for term in problem.candidates if term not in (Column("u2"), Column("u6")))
    (free,) = search(problem, OPTIONS).state.tested
    assert free.term in (Column("u2"), Column("u6"))
    (tested,) = search(replace(problem, candidates=(*others, Column("u6"), positive)), OPTIONS).state.tested
    assert tested.term == Column("u6")
    assert positive not in [one.term for one in tested.alternatives]


@pytest.mark.parametrize("hidden", [3.0, 30.0])
def test_a_name_stands_beside_a_wandering_error_that_is_taken_for_noise(hidden):
    """No term describes it, and it is in one group of four; the others say what noise is."""
    rng = np.random.default_rng(9)
    walk = np.cumsum(rng.normal(size=400))
    problem = linear_problem(
        rng, 400, lambda d: 5 * d["u2"] + hidden * walk / np.std(walk), (1.0,) * 4, (0.0,) * 4, 1, (1.0, 0.0, 0.0, 0.0)
    )
    for declared in (True, False):
        state = search(replace(problem, declared=declared), OPTIONS).state
        assert terms(state) == [Column("u2")]
        assert state.fit.values[0] == pytest.approx(5.0, abs=4 * np.sqrt(state.fit.covariance[0, 0]))


class _Narrow(LinearProblem):
    """In whose data u4 is between -1 and 1, whatever a term says that it can be."""

    def limits(self, term):
        return [(-1.0, 1.0)] if term.name == "u4" else super().limits(term)


@pytest.mark.parametrize("by_data", [False, True])
def test_what_the_data_leave_open_stays_possible(by_data):
    """By ridge regression in closed form; and what they determine is not touched."""
    problem = linear_problem(np.random.default_rng(6), planted=lambda d: 0.8 * d["u2"])
    problem.data["u4"] = 1e-3 * np.random.default_rng(7).normal(size=400)
    if by_data:
        problem = _Narrow(**{field.name: getattr(problem, field.name) for field in fields(problem)})
    bounded = Column("u4", coordinates=(Number(lower=-1e6, upper=1e6) if by_data else Number(lower=-1.0, upper=1.0),))
    wide = Column("u2", coordinates=(Number(lower=-1e3, upper=1e3),))
    alone, both = (fit(problem, Terms(model), OPTIONS) for model in ((wide,), (wide, bounded)))
    assert abs(both.values[1]) < 1
    assert np.sqrt(both.covariance[1, 1]) == pytest.approx(1 / np.sqrt(3), rel=0.1)  # of an even distribution
    assert both.values[0] == pytest.approx(alone.values[0], abs=0.01 * np.sqrt(alone.covariance[0, 0]))


@pytest.mark.parametrize(
    ("lower", "upper"), [(-1.0, 1.0), (0.0, 3.0), (-0.1, 2.0), (0.5, 2.0), (-np.inf, np.inf), (0.0, np.inf)]
)
def test_a_prior_has_the_mean_square_of_an_even_distribution_within_limits_around_zero(lower, upper):
    problem = linear_problem(np.random.default_rng(6))
    term = Column("u2", coordinates=(Number(lower=lower, upper=upper),))
    (precision,) = prior_precision(problem, [term])
    known = np.isfinite([lower, upper]).all() and lower <= 0 <= upper
    assert precision == pytest.approx(1 / np.mean(np.linspace(lower, upper, 100_001) ** 2) if known else 0.0, rel=1e-3)


def test_of_two_numbers_whose_sum_alone_is_seen_each_is_as_uncertain_as_its_bounds():
    """The sum is known, and the difference by the prior N(0, 2 / 3) alone."""
    problem = linear_problem(np.random.default_rng(6), planted=lambda d: 0.8 * d["u2"])
    problem.data["u4"] = problem.data["u2"]
    model = tuple(Column(name, coordinates=(Number(lower=-1.0, upper=1.0),)) for name in ("u2", "u4"))
    said = fit(problem, Terms(model), OPTIONS)
    np.testing.assert_allclose(np.sqrt(np.diagonal(said.covariance)), np.sqrt(2 / 3) / 2, rtol=0.1)
    of_sum = np.sqrt(said.covariance.sum())
    assert of_sum < 0.1
    assert said.values.sum() == pytest.approx(0.8, abs=4 * of_sum)


class _Bent(LinearProblem):
    """With a term u2 whose derivative at zero is another one than at its estimate, as that of a delay is."""

    def columns(self, terms, values=None, beside=None):
        found = super().columns(terms, values, beside)
        if values is None and tuple(terms) == (Column("u2"),):
            found = found + 0.5 * super().columns([Column("u4")])
        return found


def test_a_term_that_is_there_is_not_added_again():
    plain = linear_problem(np.random.default_rng(9), planted=lambda d: 0.8 * d["u2"] + 0.4 * d["u4"])
    bent = _Bent(**{field.name: getattr(plain, field.name) for field in fields(plain)})
    found = terms(search(replace(bent, candidates=(Column("u2"),)), OPTIONS).state)
    assert found.count(Column("u2")) == 1


def test_an_order_is_found_released_and_stated_with_its_numbers():
    problem = linear_problem(np.random.default_rng(6), planted=lambda d: 0.9 * np.sin(7.3 * d["angle"] + 0.4))
    state = found(problem)
    (wave,) = terms(state)
    assert isinstance(wave, Wave)
    assert wave.order == pytest.approx(7.3, abs=0.02)
    assert np.hypot(*state.fit.values) == pytest.approx(0.9, abs=0.25)
    (std,) = (test.chosen_std for test in state.tested)
    # what an efficient estimate reaches: (A·std(angle))² times half the samples, of both rows, over the noise
    spread = np.std(problem.data["angle"])
    bound = 1 / (0.9 * spread * np.sqrt(0.5 * problem.samples * (1 + 0.25 / 9)))
    assert std == pytest.approx(bound, rel=0.3)
    assert abs(wave.order - 7.3) < 4 * std


def test_orders_that_are_close_are_found_together():
    """Over a third of a turn, 38 and 45 pull each other: one by one they are found elsewhere."""
    whole = linear_problem(np.random.default_rng(3), 260)
    angle = np.random.default_rng(4).uniform(-1.0, 1.0, 260)
    signal = 3.0 * np.cos(38 * angle - 0.8) + 3.0 * np.cos(45 * angle - 0.5)
    measured = whole.measured + signal * np.array([[1.0], [0.5]])
    state = found(replace(whole, data=whole.data | {"angle": angle}, measured=measured))
    assert sorted(wave.order for wave in terms(state)) == [38.0, 45.0]


def test_a_whole_order_stays_whole():
    problem = linear_problem(np.random.default_rng(7), planted=lambda d: 0.9 * np.cos(12 * d["angle"]))
    assert terms(found(problem)) == [Wave(12.0)]


def test_a_bump_that_no_name_explains_becomes_a_process():
    problem = linear_problem(
        np.random.default_rng(8), 800, lambda d: 3.0 * np.exp(-0.5 * ((d["angle"] - 2) / 0.4) ** 2), site="wheel"
    )
    state = found(problem)
    (bump,) = terms(state)
    assert process(bump) == ("wheel", ("angle",))
    angle = np.linspace(-8, 8, 50)
    done = state.fit.values @ bump.basis({"angle": angle, "every_run": None})
    missed = done - np.median(done) - 3.0 * np.exp(-0.5 * ((angle - 2) / 0.4) ** 2)
    assert np.sqrt(np.mean(missed**2)) < 0.3


def test_many_samples_show_more_than_the_few_that_are_searched_first():
    few = replace(OPTIONS, first_samples=300)
    problem = linear_problem(np.random.default_rng(9), 1200, lambda d: 0.6 * d["u4"] + 0.17 * d["u1"])
    assert terms(search(problem.thinned(4), OPTIONS).state) == [Column("u4")]
    state = found(problem, few)
    assert set(terms(state)) == {Column("u4"), Column("u1")}
    assert state.fit.training.sum() == 1200


def test_very_many_samples_are_searched_in_part_and_fitted_whole():
    few = replace(OPTIONS, first_samples=150, most_samples=300)
    problem = linear_problem(np.random.default_rng(9), 1200, lambda d: 0.6 * d["u4"])
    state = found(problem, few)
    assert terms(state) == [Column("u4")]
    assert state.fit.training.sum() == 1200
    whole = fit(problem, state.fit.terms, few)
    np.testing.assert_allclose(state.fit.values, whole.values, rtol=0, atol=1e-4)
    np.testing.assert_allclose(state.fit.covariance, whole.covariance, rtol=1e-3)


def test_very_many_samples_are_fitted_in_the_noise_of_those_that_decide():
    few = replace(OPTIONS, first_samples=150, most_samples=300)
    problem = linear_problem(np.random.default_rng(9), 1200, lambda d: 0.6 * d["u4"], correlated=(0.97, 0.97))
    state = found(problem, few)
    assert Column("u4") in terms(state)
    assert not state.fit.noise.white
    number = terms(state).index(Column("u4"))
    alone = fit(problem, Terms((Column("u4"),)), few)  # as if the noise were white
    std = np.sqrt(state.fit.covariance[number, number])
    assert abs(state.fit.values[number] - 0.6) < 4 * std
    assert std < 0.5 * np.sqrt(alone.covariance[0, 0])  # differences of neighbours tell a fast regressor


def test_the_most_specific_of_indistinguishable_names_is_reported():
    problem = linear_problem(np.random.default_rng(10), planted=lambda d: 0.8 * d["u1"])
    twin = problem.data | {"twin": problem.data["u1"] + 1e-3 * problem.data["u6"]}
    candidates = (*(c for c in problem.candidates if c != Column("u1")), Column("twin", 3), Column("u1", 1))
    problem = replace(problem, data=twin, candidates=candidates)
    (test,) = search(problem, OPTIONS).state.tested
    assert test.term == Column("u1", 1)
    assert test.alternatives[0].term == Column("twin", 3)
    assert abs(test.alternatives[0].gap) < CLOSE


def test_a_candidate_in_the_span_of_the_nuisance_is_confounded():
    problem = linear_problem(np.random.default_rng(11))
    problem = replace(problem, data=problem.data | {"u1": np.ones(problem.samples)})
    assert search(problem, OPTIONS).confounded == (Column("u1"),)


def test_p_values_of_a_candidate_are_uniform_in_white_noise():
    p_values = []
    for seed in range(200):
        problem = linear_problem(np.random.default_rng(1000 + seed), 150)
        test = score_test(problem, fit(problem, Terms(), OPTIONS), OPTIONS)
        p_values.append(test.score([Column("u1")])[0].p_value)
    # the larger of two p-values is conservative, never optimistic
    assert np.mean(np.array(p_values) < 0.05) <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 200)
    assert np.mean(np.array(p_values) < 0.5) > 0.3


def test_fitted_groups_have_scales_of_their_own_and_noise_models_their_times():
    rng = np.random.default_rng(12)
    problem = linear_problem(rng, 2000, correlated=(0.0, 0.8))
    found_fit = fit(problem, Terms(), OPTIONS)
    assert found_fit.scale == pytest.approx([1.0, 3.0], rel=0.12)
    assert found_fit.freedom == pytest.approx(4000 - 2)
    rows = found_fit.residuals.rows / found_fit.scale[:, None]
    assert autocorrelation_time(rows[:1]) < 1.3
    assert autocorrelation_time(rows[1:]) == pytest.approx(1.8 / 0.2, rel=0.4)
    model = noise_model(rows, problem.levels, np.zeros(2), problem.groups, problem.run, OPTIONS)
    innovations = model.whitened(rows)
    assert autocorrelation_time(innovations[1:]) < 1.3
    assert model.models[1].time == pytest.approx(9.0, rel=0.4)


def test_held_out_samples_do_not_touch_a_fit():
    rng = np.random.default_rng(13)
    problem = linear_problem(rng, planted=lambda d: 0.8 * d["u2"])
    training = np.arange(problem.samples) % 5 > 0
    spoilt = problem.measured.copy()
    spoilt[:, ~training] += 1e3
    clean, other = (search(p, OPTIONS, training) for p in (problem, replace(problem, measured=spoilt)))
    assert np.array_equal(clean.state.fit.values, other.state.fit.values)
    assert terms(clean.state) == terms(other.state) == [Column("u2")]


def test_a_state_refuses_tests_of_other_terms_than_were_fitted():
    empty = fit(linear_problem(np.random.default_rng(14)), Terms(), OPTIONS)
    with pytest.raises(ValueError, match="not those of the fitted terms"):
        State(empty, empty, (SelectedTerm(Column("u1")),))


def test_every_option_is_documented_once():
    options = documented(EngineOptions())
    assert len({option.name for option in options}) == len(options) >= 7
    assert all(option.meaning and option.why for option in options)


# ---------------------------------------------------------------------------- processes


def process(term):
    """Site and drivers of a process; the label of a name."""
    return (term.site, term.phrases) if isinstance(term, Process) else term.label


SHAPES = {
    "step": (lambda d: 2.0 * (d["u2"] > 0.3), ("u2",)),
    "saturation": (lambda d: 2.0 * np.tanh(4.0 * d["u3"]), ("u3",)),
    "parabola": (lambda d: 0.6 * d["u2"] ** 2, ("u2",)),
    "cubic": (lambda d: 0.8 * d["u4"] ** 3, ("u4",)),
    "product": (lambda d: 0.8 * d["u1"] * d["u5"], ("u1", "u5")),
    "valve": (lambda d: 1.5 * np.abs(d["u2"]) * (d["u3"] > 0), ("u2", "u3")),
    "turn": (lambda d: 1.2 * d["u6"] * np.sin(d["angle"]), ("u6", "angle")),
}


@seeds(3, 1)
@pytest.mark.parametrize(
    ("shape", "site"), [*((shape, "x") for shape in SHAPES), ("saturation", "y"), ("product", "y")]
)
def test_a_process_is_found_at_its_site_by_its_driver(shape, site, seed):
    planted, phrases = SHAPES[shape]
    problem = linear_problem(np.random.default_rng(seed), 400, planted, noise=(1.0, 1.0), site=site)
    state = found(problem)
    # the wheel moves as x does, and the angle is its own
    where = "wheel" if site == "x" and "angle" in phrases else site
    assert list(map(process, terms(state))) == [(where, phrases)]
    done = state.fit.values @ terms(state)[0].basis(problem.data)
    missed = done - planted(problem.data)
    assert np.std(missed) < 0.5 * np.std(planted(problem.data))
    (tested,) = state.tested
    assert tested.net > MARGIN
    assert tested.p_value < OPTIONS.level


def test_two_processes_are_found_beside_a_name():
    problem = linear_problem(
        np.random.default_rng(3),
        800,
        lambda d: 0.8 * d["u1"] + 2.0 * np.tanh(4.0 * d["u3"]),
        noise=(1.0, 1.0),
    )
    more = np.multiply.outer([0.5, 1.0], 1.5 * np.abs(problem.data["u5"]))
    state = search(replace(problem, measured=problem.measured + more), OPTIONS).state
    assert set(map(process, terms(state))) == {"u1:x", ("x", ("u3",)), ("y", ("u5",))}


@seeds(4, 1)
def test_a_name_stands_beside_a_process_of_another_quantity(seed):
    """A process of both quantities explains as much, with a product that is not there."""
    problem = linear_problem(np.random.default_rng(seed), planted=lambda d: 0.8 * d["u2"] + 0.4 * d["u4"])
    state = search(replace(problem, candidates=(Column("u2"),)), OPTIONS).state
    assert list(map(process, terms(state))) == ["u2:x", ("x", ("u4",))]


@seeds(4, 1)
def test_a_truth_that_no_name_has_is_not_called_by_the_nearest_name(seed):
    """A square of u2, of which the line is the nearest name where u2 is not centred."""
    problem = linear_problem(np.random.default_rng(seed), planted=lambda d: 0.6 * (d["u2"] + 1.0) ** 2)
    assert list(map(process, terms(search(problem, OPTIONS).state))) == [("x", ("u2",))]


@seeds(4, 1)
def test_a_regressor_that_has_no_name_is_the_driver_of_a_process(seed):
    """Of two sites that move alike, it is at that whose own it is."""
    problem = linear_problem(np.random.default_rng(seed), planted=lambda d: 0.8 * d["u2"])
    (term,) = terms(search(replace(problem, candidates=()), OPTIONS).state)
    assert process(term) == ("x", ("u2",))


def test_regressors_that_are_not_told_apart_are_alternatives():
    problem = linear_problem(np.random.default_rng(9), planted=lambda d: 2.0 * np.tanh(3 * d["u2"]))
    data = problem.data | {"u3": problem.data["u2"] + 0.02 * problem.data["u3"]}
    (tested,) = search(replace(problem, data=data), OPTIONS).state.tested
    likely = {process(one.term): one.gap for one in tested.alternatives} | {process(tested.term): 0.0}
    assert {("x", ("u2",)), ("x", ("u3",))} <= set(likely)
    assert all(0 <= gap < CLOSE for gap in likely.values())
    assert not any({"u4", "u5", "u6"} & set(phrases) for _, phrases in likely if len(phrases) == 1)


# ---------------------------------------------------------------------------- names


@seeds(6, 1)
def test_a_name_stands_where_it_is_true(seed):
    problem = linear_problem(np.random.default_rng(seed), planted=lambda data: 0.8 * data["u2"])
    assert terms(search(problem, OPTIONS).state) == [Column("u2")]


@seeds(4, 1)
def test_names_take_the_place_of_a_process_where_their_sum_is_true(seed):
    """Two decays of one regressor: a process of it explains both at once."""
    pair = Decay("u2", 0.3), Column("u2")
    problem = linear_problem(
        np.random.default_rng(seed), 800, lambda d: 3.0 * pair[0].basis(d)[0] + 1.5 * d["u2"], noise=(1.0, 1.0)
    )
    state = search(replace(problem, shaped=DECAYS), OPTIONS).state
    assert sorted(term.label for term in terms(state)) == ["decay of u2:x", "u2:x"]


def test_a_number_that_is_not_possible_is_no_name():
    """A negative slope of a term that can only be positive is given to a process."""
    positive = Column("u3", coordinates=(Number(lower=0.0),))
    for sign, expected in ((1.0, "u3:x"), (-1.0, ("x", ("u3",)))):
        problem = linear_problem(np.random.default_rng(5), planted=lambda data, s=sign: s * data["u3"])
        candidates = tuple(positive if term.label == "u3:x" else term for term in problem.candidates)
        state = search(replace(problem, candidates=candidates), OPTIONS).state
        assert list(map(process, terms(state))) == [expected]
        assert (positive in terms(state)) == (sign > 0)


@seeds(8, 3)
def test_every_finding_is_significant_beside_the_others_in_the_end(seed):
    problem = linear_problem(
        np.random.default_rng(seed), planted=lambda data: 0.3 * data["u1"] + 0.25 * np.sin(data["angle"])
    )
    for tested in search(problem, OPTIONS).state.tested:
        assert tested.p_value < OPTIONS.level


@pytest.mark.parametrize("seed", range(2))
def test_a_name_that_is_a_part_of_one_function_is_not_all_that_may_be(seed):
    """A step of a sign and a curve of its regressor: one function of both, of which the step alone has a name."""
    rng = np.random.default_rng(700 + seed)
    problem = linear_problem(rng, 600)
    u1 = problem.data["u1"]
    sign = np.sign(u1)
    curve = sign * (1.0 + 2.0 * np.exp(-((u1 / 0.4) ** 2)))
    data = problem.data | {"sign": sign}
    measured = problem.measured + np.outer(problem.shares, curve)
    candidates = (*problem.candidates, Column("sign"))
    problem = replace(problem, data=data, measured=measured, candidates=candidates)
    baseline = fit(problem, Terms(), OPTIONS)
    process = Process("x", (Driver("u1"),), (float(u1.min()), float(u1.max())), "medium", 1.0)
    begun = [SelectedTerm(Column("sign"), cost=4.0), SelectedTerm(process, cost=6.0)]
    selector = Selector(problem, OPTIONS)
    state = selector.selected(refitted(problem, State(baseline, baseline), begun, OPTIONS), exchanging=True)
    possible = [
        [test.term, *(other.term for other in others)]
        for test, others in zip(state.tested, selector.alternatives(state), strict=True)
    ]
    named = [terms for terms in possible if terms[0] == Column("sign")]
    assert any(term.nonparametric for term in state.fit.terms.terms)
    assert all(any(term.nonparametric and {"sign", "u1"} == set(term.phrases) for term in terms) for terms in named)
