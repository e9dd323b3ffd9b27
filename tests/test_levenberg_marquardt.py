"""The damped Gauss–Newton method of many small problems ends where the solver of record does."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest

from lite6jax.arms.se3 import rotation_exp
from lite6jax.levenberg_marquardt import Linearised, minimise

RECORD = optimistix.LevenbergMarquardt(rtol=1e-14, atol=1e-14, norm=optimistix.max_norm)


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_poses_of_points_are_those_of_the_solver_of_record(noise):
    rng = np.random.default_rng(2)
    points = rng.standard_normal((10, 3))
    start = jnp.zeros((6, 20))

    def place(twist):
        return points @ rotation_exp(twist[3:]).T + twist[:3]

    def residual(twist, measured):
        return (place(twist) - measured).ravel()

    def linearise(twists):
        r = jax.vmap(residual)(twists.T, measured)
        J = jax.vmap(jax.jacfwd(residual))(twists.T, measured)
        curvature = jnp.einsum("prk,prl->klp", J, J)
        return Linearised(jnp.sum(r**2, 1), jnp.einsum("prk,pr->kp", J, r), curvature, jnp.ones_like(twists))

    measured = jax.vmap(place)(0.5 * rng.standard_normal((20, 6))) + noise * rng.standard_normal((20, 10, 3))
    minimum = jax.jit(minimise, static_argnums=(0, 1))(linearise, jnp.add, start, 100)
    assert minimum.ended.all()
    record = jax.jit(lambda points: optimistix.least_squares(residual, RECORD, start[:, 0], points).value)
    np.testing.assert_allclose(minimum.numbers.T, [record(points) for points in measured], rtol=0, atol=1e-12)
