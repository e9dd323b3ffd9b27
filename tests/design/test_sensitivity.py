"""Sensitivities are finite differences of the plain chain."""

import numpy as np

from lite6jax.arms.description import load_bundled
from lite6jax.design.identify import sensitivity
from lite6jax.design.information import plan_experiment
from tests.oracles.arms import random_positions
from tests.oracles.chains import six_parameter_poses

LITE6 = load_bundled("lite6")
Q = random_positions(np.random.default_rng(0), 40, 6)
TOLERANCE = {"m": 0.8e-3, "rad": np.deg2rad(0.15)}


def test_by_finite_differences_of_the_plain_chain():
    found = sensitivity("lite6", Q)
    rows = LITE6.kinematics.ravel()
    h = 1e-6
    for i, unit in enumerate(found.units):
        step = h * np.eye(36)[i]
        ahead, behind = (six_parameter_poses((rows + s * step).reshape(6, 6), Q)[:, :3, 3] for s in (1, -1))
        want = np.linalg.norm(ahead - behind, axis=1) / (2 * h) * TOLERANCE[unit]
        np.testing.assert_allclose(found.position[:, i], want, rtol=0, atol=1e-12 + 1e-8 * want.max())
    np.testing.assert_allclose(found.flange_position, six_parameter_poses(LITE6.kinematics, Q)[:, :3, 3], atol=1e-15)


def test_the_expected_error_is_what_drawn_arms_show():
    found = sensitivity("lite6", Q)
    setup = plan_experiment("lite6", chain="six_parameter", frame=False)
    rng = np.random.default_rng(1)
    size = np.array([TOLERANCE[unit] for unit in setup.units])
    arms = [LITE6.kinematics + (size * rng.standard_normal(36)).reshape(6, 6) for _ in range(2000)]
    moved = np.stack([six_parameter_poses(k, Q[:3])[:, :3, 3] for k in arms]) - found.flange_position[:3]
    shown = np.sqrt(np.mean(np.sum(moved**2, -1), 0))
    np.testing.assert_allclose(found.expected_error[:3], shown, rtol=0.05)
