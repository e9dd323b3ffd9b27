from functools import cache, partial
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lite6jax.arms.chains import HayatiForm
from lite6jax.arms.se3 import turn
from lite6jax.calibration.residual import Observations, Robust, evaluate, linearise, over_blocks, residuals
from lite6jax.model import ArmModel, ModelForm, arm_model
from tests.oracles.arms import LITE6_DH, parameters_of_table, random_kinematics, random_positions
from tests.oracles.chains import hayati_poses
from tests.oracles.transforms import origin_transform, perturb_poses

SAMPLES = 24
CHAIN = HayatiForm(6, (1,))
STUDENT_T = Robust(jnp.array(3.0), jnp.array(0.7))
MODELS = [(False, False), (True, False), (False, True), (True, True)]


class Case(NamedTuple):
    """A model, what it is fitted to, and the poses behind that."""

    form: ModelForm
    model: ArmModel
    observed: Observations
    poses: np.ndarray
    expected: np.ndarray


@cache
def case(frame=True, tool=True, poses=True, isotropic=True, angle=0.05, samples=SAMPLES):
    """Residuals of about `angle` rad and half as many metres, in a general position, every sample's noise another."""
    rng = np.random.default_rng(4)
    dh = LITE6_DH + rng.uniform(-0.1, 0.1, (6, 4))
    dh[1, 1] = 0
    base, beta = rng.uniform(-0.1, 0.1, 4), 0.05
    T_sensor_base, T_flange_tool = (origin_transform(row) for row in random_kinematics(rng, 2))
    model = arm_model(parameters_of_table(CHAIN, base, dh, np.array([beta])), T_sensor_base, T_flange_tool)
    positions = random_positions(rng, samples, 6)
    expected = T_sensor_base @ hayati_poses(base, dh, {1: beta}, positions) @ T_flange_tool
    measured = perturb_poses(rng, expected, angle / 2, angle)
    rows = 6 if poses else 3
    factor = rng.standard_normal((rows, rows, samples)) + 4 * np.eye(rows)[:, :, None]
    observed = Observations(
        turn(jnp.asarray(positions.T)),
        jnp.asarray(measured[:, :3, 3].T),
        jnp.asarray(np.moveaxis(measured[:, :3, :3], 0, -1) if poses else np.zeros((3, 3, 0))),
        jnp.asarray(rng.uniform(0.2, 3.0, samples)),
        jnp.array([4.0, 3.0]) if isotropic else jnp.asarray(factor),
    )
    return Case(ModelForm(CHAIN, frame, tool), model, observed, measured, expected)


def as_full(observed, rows):
    """The same noise, said as a matrix for each sample."""
    diagonal = np.repeat(np.asarray(observed.whitener), 3)[:rows]
    full = np.broadcast_to(np.diag(diagonal)[:, :, None], (rows, rows, len(observed.weight)))
    return observed._replace(whitener=jnp.asarray(full))


def loss_of(r, weight, robust):
    """The documented cost of residuals `(row, sample)` of unit weight."""
    squares = jnp.sum(r**2, 0)
    if robust is None:
        return jnp.sum(weight * squares) / 2
    nu = robust.freedom
    return jnp.sum(weight * (nu + len(r)) / 2 * jnp.log(1 + squares / (nu * robust.scale**2)))


QUICK = {"xla_backend_optimization_level": 0}  # most of the time goes into compiling


@partial(jax.jit, static_argnums=0, compiler_options=QUICK)
def differentiated(form, model, observed):
    """Residuals and their derivatives `(parameter, row, sample)`, by automatic differentiation."""

    def at(step):
        return residuals(form, form.retract(model, step), observed)

    still = jnp.zeros(form.size)
    return at(still), jnp.moveaxis(jax.jacfwd(at)(still), -1, 0)


def reference(form, model, observed, robust):
    """Cost, gradient and the residuals' derivatives, with nothing of the library's but `residuals`."""
    r, J = differentiated(form, model, observed._replace(weight=jnp.ones_like(observed.weight)))
    cost, pull = jax.value_and_grad(loss_of)(r, observed.weight, robust)
    return cost, jnp.tensordot(J, pull, 2), jnp.sqrt(observed.weight) * J


@partial(jax.jit, static_argnums=0, compiler_options=QUICK)
def from_twists(form, model, observed, robust):
    """Cost and gradient, and these with the curvature, by the library."""
    return [f(form, model, observed, robust) for f in (evaluate, linearise)]


def assert_close(found, expected, part=1e-12):
    np.testing.assert_allclose(found, expected, atol=part * np.abs(expected).max())


# every kind of data with the full model, every smaller model with one kind of data, and two without a robust loss
KINDS = [
    *[(True, True, *kind, STUDENT_T) for kind in product([False, True], repeat=2)],
    *[(*model, True, False, STUDENT_T) for model in MODELS[1:3]],
    (True, True, True, False, None),
    (False, False, True, True, None),
]


@pytest.mark.parametrize("isotropic", [False, True])
@pytest.mark.parametrize("poses", [False, True])
def test_residuals_are_what_they_say(poses, isotropic):
    c = case(poses=poses, isotropic=isotropic)
    found = residuals(c.form, c.model, c.observed)
    shift = c.expected[:, :3, 3] - c.poses[:, :3, 3]
    measured, predicted = (Rotation.from_matrix(T[:, :3, :3]) for T in (c.poses, c.expected))
    raw = np.hstack([shift, (measured.inv() * predicted).as_rotvec()])[:, : 6 if poses else 3]
    whitener = np.asarray(as_full(c.observed, raw.shape[1]).whitener if isotropic else c.observed.whitener)
    weighted = np.sqrt(c.observed.weight)[:, None] * np.einsum("ijs,sj->si", whitener, raw)
    np.testing.assert_allclose(found, weighted.T, atol=1e-12)


@pytest.mark.parametrize(("frame", "tool", "poses", "isotropic", "robust"), KINDS)
def test_derivatives_equal_automatic_differentiation(frame, tool, poses, isotropic, robust):
    c = case(frame, tool, poses, isotropic)
    (cost, gradient), (same_cost, same_gradient, curvature) = from_twists(c.form, c.model, c.observed, robust)
    full = ModelForm(CHAIN, True, True)  # its step holds the smaller models' steps
    kept = np.isin(full.names, c.form.names)
    plain_cost, plain_gradient, plain_J = (np.asarray(part) for part in reference(full, c.model, c.observed, robust))
    assert gradient.shape == (c.form.size,) == (int(kept.sum()),)
    for found in (cost, same_cost):
        np.testing.assert_allclose(found, plain_cost, rtol=1e-13)
    for found in (gradient, same_gradient):
        assert_close(found, plain_gradient[kept])
    assert curvature.shape == (c.form.size, c.form.size)
    if poses:
        return  # its orientation rows are without the logarithm's derivative
    r = np.asarray(residuals(c.form, c.model, c.observed))
    factor = np.ones(SAMPLES)
    if robust is not None:
        nu, scale2 = float(robust.freedom), float(robust.scale) ** 2
        factor = (nu + len(r)) / (nu * scale2 + np.sum(r**2, 0) / c.observed.weight)
    J = (np.sqrt(factor) * plain_J[kept]).reshape(c.form.size, -1)
    assert_close(curvature, J @ J.T)


@pytest.mark.parametrize("isotropic", [False, True])
@pytest.mark.parametrize("angle", [1e-9, 1e-2, 0.6, 1.5])
def test_gradient_is_exact_however_far_the_orientation(angle, isotropic):
    c = case(isotropic=isotropic, angle=angle)
    if angle == 1.5:  # the farthest come near half a turn, which poor starts do
        raw = residuals(c.form, c.model, c.observed._replace(whitener=jnp.ones(2), weight=jnp.ones(SAMPLES)))
        assert np.max(np.linalg.norm(raw[3:], axis=0)) > 2.5
    (_, gradient), _ = from_twists(c.form, c.model, c.observed, STUDENT_T)
    # the rotations themselves are rounded, so that an angle of 1e-9 rad is known to 2e-7 of itself only
    rounding = max(1e-12, np.finfo(float).eps / angle)
    assert_close(gradient, reference(c.form, c.model, c.observed, STUDENT_T)[1], rounding)


@pytest.mark.parametrize("isotropic", [False, True])
def test_blocks_add_up(isotropic):
    c = case(isotropic=isotropic)

    def cut(leaf):
        return jnp.moveaxis(leaf.reshape(*leaf.shape[:-1], 3, -1), -2, 0)

    blocks = jax.tree.map(cut, c.observed._replace(whitener=jnp.zeros(0)))
    whitener = jnp.broadcast_to(c.observed.whitener, (3, 2)) if isotropic else cut(c.observed.whitener)
    blocks = blocks._replace(whitener=whitener)
    block = partial(linearise, c.form, c.model, robust=STUDENT_T)
    whole = from_twists(c.form, c.model, c.observed, STUDENT_T)[1]
    for found, total in zip(jax.jit(partial(over_blocks, block), compiler_options=QUICK)(blocks), whole, strict=True):
        assert_close(found, total)
    # a single block takes a path of its own
    only = over_blocks(lambda one: one, jax.tree.map(lambda leaf: leaf[None], c.observed))
    for found, leaf in zip(jax.tree.leaves(only), jax.tree.leaves(c.observed), strict=True):
        np.testing.assert_array_equal(found, leaf)
