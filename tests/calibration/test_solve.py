"""One arm's solver: the likeliest model, wherever it begins."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from lite6jax.arms.description import load_bundled
from lite6jax.calibration import fit, solution, solve
from lite6jax.calibration.problem import recording_problem
from lite6jax.calibration.residual import observe, residuals
from lite6jax.estimation.robust import t_scale
from lite6jax.simulation import simulate


@pytest.fixture(scope="module")
def outlying():
    """A recording with an unknown sensor frame and outliers, for the robust loss to work on."""
    recording = simulate("lite6", samples=400, sensor="motion_capture", seed=6)
    position = recording.position.copy()
    position[::23] += 2e-3
    return replace(recording, position=position)


def test_the_scale_and_the_model_are_the_likeliest_of_student_t(outlying):
    """Its own cost is flat at the solution, and its scale solves its equation; outliers hardly move it."""
    problem = recording_problem(outlying, load_bundled("lite6"), "declared")
    found = solve.solve(problem, freedom=4.0)
    assert found.result == solve.Result.CONVERGED
    assert found.scale == pytest.approx(t_scale(found.squares, 6, 4.0), rel=1e-6)
    count = outlying.samples
    observed = observe(
        problem.form,
        *map(jnp.asarray, (problem.joint_position, problem.pose)),
        jnp.ones(count),
        problem.whitener,
        count,
    )

    @jax.jit
    @jax.value_and_grad
    def cost(step):
        one = jax.tree.map(lambda leaf: leaf[0], observed)
        squares = jnp.sum(residuals(problem.form, problem.form.retract(found.model, step), one) ** 2, 0)
        return jnp.sum((4 + 6) / 2 * jnp.log(1 + squares / found.scale**2 / 4))

    free = problem.movable
    _, gradient = cost(jnp.zeros(problem.form.size))
    deviation = 1 / np.sqrt(np.diagonal(found.information))
    assert np.abs(np.asarray(gradient) * deviation)[free].max() < 1e-5

    clean = solve.solve(problem, weight=np.where(np.arange(count) % 23, 1.0, 0.0))

    def squared_error(estimate):
        away = estimate.model.geometry - clean.model.geometry
        return away @ clean.information @ away

    assert squared_error(found) < 0.1 * squared_error(solve.solve(problem))


def test_a_prior_pulls_by_its_precision(outlying):
    problem = recording_problem(outlying, load_bundled("lite6"), "free")
    k = problem.form.names.index("a3")
    moved = problem.start._replace(geometry=problem.start.geometry + 0.01 * (np.arange(28) == k))
    free = np.isin(problem.form.names, ("a2", "a3", "d4"))

    def pulled(precision):
        prior = np.where(np.arange(problem.form.size) == k, precision, 0.0)
        return solve.solve(replace(problem, start=moved, precision=prior), free)

    plain, weak, strong = (pulled(precision) for precision in (0.0, 1e6, 1e18))
    assert strong.model.geometry[k] == pytest.approx(moved.geometry[k], abs=1e-10)
    # a weak one moves the estimate by what linear theory says: H⁻¹ P (center − estimate)
    inside = np.ix_(free, free)
    pull = np.where(np.arange(problem.form.size) == k, 1e6 * (moved.geometry[k] - plain.model.geometry[k]), 0.0)[free]
    expected = np.linalg.solve(weak.information[inside], pull)[np.flatnonzero(free) == k]
    assert weak.model.geometry[k] - plain.model.geometry[k] == pytest.approx(expected[0], rel=0.02)
    held = ~free[:28]
    np.testing.assert_array_equal(weak.model.geometry[held], moved.geometry[held])


def test_what_determines_nothing_is_not_called_a_solution(outlying):
    settings = replace(outlying.settings, tool="unknown")  # the tool says what four numbers of the flange say
    problem = recording_problem(replace(outlying, settings=settings), load_bundled("lite6"), "free")
    assert solve.solve(problem).result in (solve.Result.SINGULAR, solve.Result.STEPS_EXHAUSTED)
    assert solve.solve(problem, max_steps=1).steps == 0
    determined = recording_problem(outlying, load_bundled("lite6"), "declared")
    assert solve.solve(determined, max_steps=1).steps == 1
    spoiled = problem.pose.copy()
    spoiled[:, 0, 3] = 1e300
    assert solve.solve(replace(problem, pose=spoiled)).result == solve.Result.NOT_FINITE


def test_a_fit_begun_on_spread_rows_is_that_of_all_rows(monkeypatch, outlying):
    whole = fit.fit_recording(outlying, load_bundled("lite6"))
    monkeypatch.setattr(fit, "MOST_SPREAD", 200)
    monkeypatch.setattr(solution, "_AT_ONCE", 150)
    spread = fit.fit_recording(outlying, load_bundled("lite6"))
    assert spread.result == whole.result
    deviation = np.sqrt(np.diagonal(whole.covariance))
    n = len(whole.parameters)
    shown = deviation[:n] > 0
    assert np.abs((spread.parameters - whole.parameters)[shown] / deviation[:n][shown]).max() < 3e-3
    np.testing.assert_allclose(np.sqrt(np.diagonal(spread.covariance)), deviation, rtol=3e-3)
    np.testing.assert_allclose(spread.weight, whole.weight, atol=1e-3)
    assert spread.checked.position_rms == pytest.approx(whole.checked.position_rms, rel=0.05)
    assert spread.checked.position_rms != whole.checked.position_rms
    assert np.corrcoef(spread.checked.position, whole.checked.position)[0, 1] > 0.95
    assert spread.quality.verdict == whole.quality.verdict
    np.testing.assert_allclose(spread.quality.explained, whole.quality.explained)
