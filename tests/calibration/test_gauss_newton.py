import faulthandler
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2

from lite6jax.arms.chains import HayatiForm
from lite6jax.arms.se3 import turn
from lite6jax.calibration.quality import CONVERGED, NOT_FINITE, SINGULAR, STEPS_EXHAUSTED
from lite6jax.calibration.residual import Observations, residuals
from lite6jax.calibration.solve import solve_chunk
from lite6jax.model import ModelForm, arm_model
from tests.oracles.arms import LITE6_DH, parameters_of_table, random_positions, table_of_parameters
from tests.oracles.chains import hayati_poses
from tests.oracles.transforms import perturb_poses

ARMS, SAMPLES, MAX_STEPS = 4, 60, 50
CHAIN = HayatiForm(6, (1,))
FORM = ModelForm(CHAIN)
NOMINAL = parameters_of_table(CHAIN, np.zeros(4), LITE6_DH, [0.0])
# The seed's tolerance, for each number: 0.8 mm and 0.15 deg.
TOLERANCE = np.where(np.array(CHAIN.units) == "m", 0.8e-3, np.deg2rad(0.15))
POSITION, ORIENTATION = 1e-4, 1e-3
PRECISE = jnp.array([1 / POSITION, 1 / ORIENTATION])
POSITIONS = random_positions(np.random.default_rng(0), SAMPLES, 6)

solve = jax.jit(solve_chunk, static_argnums=0)


def poses_of(parameters):
    base, dh, beta = table_of_parameters(CHAIN, parameters)
    return hayati_poses(base, dh, {1: beta[0]}, POSITIONS)


def random_truths(seed, count=ARMS):
    return NOMINAL + TOLERANCE * np.random.default_rng(seed).uniform(-1, 1, (count, FORM.size))


def observe(measured, positions=POSITIONS, weight=None, blocks=1):
    """A chunk's observations of poses `(arm, sample, 4, 4)` in so many blocks."""
    arms, samples = measured.shape[:2]

    def blocked(leaf):
        """`(arm, sample, …)` as `(arm, block, …, sample)`."""
        return jnp.moveaxis(jnp.asarray(leaf).reshape(arms, blocks, -1, *np.shape(leaf)[2:]), 2, -1)

    return Observations(
        turn(blocked(np.broadcast_to(positions, (arms, *positions.shape)))),
        blocked(measured[:, :, :3, 3]),
        blocked(measured[:, :, :3, :3]),
        blocked(np.ones((arms, samples)) if weight is None else weight),
        jnp.broadcast_to(PRECISE, (arms, blocks, 2)),
    )


def models(start):
    rows = np.broadcast_to(start, (ARMS, FORM.size))
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *map(arm_model, rows))


def fit(measured, start=NOMINAL, max_steps=MAX_STEPS):
    return solve(FORM, models(start), observe(measured), max_steps)


@pytest.fixture(scope="module")
def measured():
    """Four arms of the seed's size, their poses read by a noisy sensor."""
    rng = np.random.default_rng(2)
    return np.array([perturb_poses(rng, poses_of(truth), POSITION, ORIENTATION) for truth in random_truths(1)])


@pytest.fixture(scope="module")
def solved(measured):
    return fit(measured)


def test_exact_poses_give_the_exact_parameters():
    truths = random_truths(3, 2 * ARMS)
    for truth in (truths[:ARMS], truths[ARMS:]):
        found = fit(np.array([poses_of(row) for row in truth]))
        np.testing.assert_array_equal(found.status, CONVERGED)
        np.testing.assert_allclose(found.model.geometry, truth, atol=1e-13)
        assert np.all(found.steps <= 8)
        assert np.all(found.cost < 1e-15)


def test_agrees_with_scipy(measured, solved):
    np.testing.assert_array_equal(solved.status, CONVERGED)
    observed = observe(measured)

    @jax.jit
    def rows(parameters, arm):
        one = jax.tree.map(lambda leaf: leaf[arm, 0], observed)
        return residuals(FORM, arm_model(parameters), one).ravel()

    jacobian = jax.jit(jax.jacfwd(rows))
    for arm in range(ARMS):
        one = partial(lambda f, arm, x: np.asarray(f(x, arm)))
        scipy = least_squares(
            partial(one, rows, arm),
            NOMINAL,
            partial(one, jacobian, arm),
            x_scale="jac",
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        np.testing.assert_allclose(solved.model.geometry[arm], scipy.x, atol=1e-10)
        np.testing.assert_allclose(solved.cost[arm], scipy.cost, rtol=1e-12)
        information = scipy.jac.T @ scipy.jac
        np.testing.assert_allclose(solved.curvature[arm], information, atol=1e-3 * np.abs(information).max())


def test_data_that_is_not_finite_is_said_and_disturbs_nobody(measured, solved):
    spoiled = measured.copy()
    spoiled[1, 7, 0, 3] = np.nan
    found = fit(spoiled)
    np.testing.assert_array_equal(found.status, [CONVERGED, NOT_FINITE, CONVERGED, CONVERGED])
    np.testing.assert_array_equal(found.model.geometry[1], NOMINAL)
    others = np.array([0, 2, 3])
    np.testing.assert_allclose(found.model.geometry[others], solved.model.geometry[others], atol=1e-14)


def test_too_few_steps_are_said(measured):
    found = fit(measured, max_steps=1)
    np.testing.assert_array_equal(found.status, STEPS_EXHAUSTED)
    np.testing.assert_array_equal(found.steps, 1)


@pytest.mark.parametrize("seed", range(5))
def test_a_poor_start_converges(measured, solved, seed):
    angles = np.array([name.startswith(("theta", "alpha")) for name in CHAIN.names])
    starts = NOMINAL + 0.3 * angles * np.random.default_rng(seed).choice([-1, 0, 1], (ARMS, FORM.size))
    found = fit(measured, start=starts)
    np.testing.assert_array_equal(found.status, CONVERGED)
    np.testing.assert_allclose(found.model.geometry, solved.model.geometry, atol=1e-12)
    np.testing.assert_allclose(found.cost, solved.cost, rtol=1e-12)


def test_two_threads_at_once_do_not_wait_for_ever(measured, solved):
    faulthandler.dump_traceback_later(120, exit=True)
    try:
        with ThreadPoolExecutor(2) as threads:
            for found in threads.map(lambda _: jax.block_until_ready(fit(measured)), range(20)):
                np.testing.assert_array_equal(found.model.geometry, solved.model.geometry)
    finally:
        faulthandler.cancel_dump_traceback_later()


def test_estimates_scatter_as_the_curvature_says():
    truth, refits = random_truths(7, 1)[0], 200
    exact = np.broadcast_to(poses_of(truth), (ARMS, SAMPLES, 4, 4))
    rng = np.random.default_rng(8)
    found = []
    for _ in range(refits // ARMS):
        drawn = perturb_poses(rng, exact.reshape(-1, 4, 4), POSITION, ORIENTATION).reshape(exact.shape)
        found.append(fit(drawn, start=truth))
    np.testing.assert_array_equal([chunk.status for chunk in found], CONVERGED)
    errors = np.concatenate([chunk.model.geometry for chunk in found]) - truth
    curvature = np.concatenate([chunk.curvature for chunk in found])

    def between(value, freedom, chance=0.001):
        return chi2.ppf(chance, freedom) < value < chi2.ppf(1 - chance, freedom)

    # whitened by each fit's own curvature: every direction of the 28 counts alike
    z = np.einsum("aji,aj->ai", np.linalg.cholesky(curvature), errors)
    assert between(np.sum(z**2), z.size)
    assert between(refits * np.sum(np.mean(z, 0) ** 2), FORM.size)  # no bias
    # and each parameter by its own standard deviation, which is the one that is reported
    deviations = np.sqrt(np.diagonal(np.linalg.inv(curvature), axis1=1, axis2=2))
    for scaled in (errors / deviations).T:
        assert between(np.sum(scaled**2), refits, 1e-3 / FORM.size)
    # the least cost is chi-square with what the parameters leave of the rows
    assert between(2 * sum(float(np.sum(chunk.cost)) for chunk in found), refits * (6 * SAMPLES - FORM.size))


def test_a_singular_curvature_is_not_called_a_solution(measured):
    form = ModelForm(CHAIN, tool=True)  # the tool says again what theta_off6, d6, a6 and alpha6 say
    observed, rng = observe(measured), np.random.default_rng(3)
    for _ in range(5):  # what rounding makes of the inverse is another thing each time
        starts = NOMINAL + TOLERANCE * rng.uniform(-1, 1, (ARMS, FORM.size))
        found = solve(form, models(starts), observed, MAX_STEPS)
        for arm in range(ARMS):
            model, one = (jax.tree.map(lambda leaf, arm=arm: leaf[arm], tree) for tree in (found.model, observed))
            cost = 0.5 * np.sum(residuals(form, model, jax.tree.map(lambda leaf: leaf[0], one)) ** 2)
            if found.status[arm] == CONVERGED:
                np.testing.assert_allclose(cost, found.cost[arm], rtol=1e-6)
            else:
                assert found.status[arm] in (STEPS_EXHAUSTED, SINGULAR)
