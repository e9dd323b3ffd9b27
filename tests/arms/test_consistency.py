"""Consistent links: base parameters kept, bodies that can be, and what happens where none have them."""

import re

import numpy as np
import pytest
from scipy.optimize import minimize

from lite6jax.arms import consistency
from lite6jax.arms.arm import Arm
from lite6jax.arms.bundled import load_bundled
from lite6jax.arms.dynamics import base_parameters, link_parameters
from lite6jax.errors import InputError
from tests.oracles.arms import random_kinematics
from tests.oracles.pinocchio_dynamics import pinocchio_model, pinocchio_torques, random_bodies

UPRIGHT = np.array([0.0, 0.0, -9.81])


def parameters_of(bodies):
    mass, center, inertia = bodies
    arm = Arm("a", np.zeros((len(mass), 6)), mass=mass, center_of_mass=center, inertia=(inertia + inertia.mT) / 2)
    return link_parameters(arm)


def are_bodies(arm):
    """By the principal moments about the centre of mass, which the module does not use."""
    moments = np.linalg.eigvalsh(arm.inertia)
    return (arm.mass > 0).all() and (moments[:, 0] > 0).all() and (moments[:, 2] < moments[:, 0] + moments[:, 1]).all()


@pytest.mark.parametrize("joints", [2, 6, 7])
def test_base_parameters_are_kept_where_bodies_have_them(joints):
    rng = np.random.default_rng(joints)
    for _ in range(3):
        kinematics = random_kinematics(rng, joints)
        base = base_parameters(kinematics, UPRIGHT)
        true, reference = parameters_of(random_bodies(rng, joints)), parameters_of(random_bodies(rng, joints))
        values = base.values(true)
        found = consistency.consistent_links(base, values, reference)
        assert (found.exact, found.chi_square) == (True, 0.0)
        np.testing.assert_allclose(base.values(found.parameters), values, rtol=0, atol=1e-9)
        arm = consistency.with_link_parameters(Arm("a", kinematics), found.parameters)
        assert are_bodies(arm)
        motion = rng.normal(0, 2, (3, joints, 10))
        torques = [
            pinocchio_torques(pinocchio_model(kinematics, *links, UPRIGHT), *motion)
            for links in ((arm.mass, arm.center_of_mass, arm.inertia), bodies_of(true))
        ]
        np.testing.assert_allclose(*torques, rtol=0, atol=1e-8)


def bodies_of(parameters):
    arm = consistency.with_link_parameters(Arm("a", np.zeros((len(parameters), 6))), parameters)
    return arm.mass, arm.center_of_mass, arm.inertia


def test_a_least_squares_solution_that_is_no_body_becomes_one():
    arm = load_bundled("ur10")
    base = base_parameters(arm.kinematics, UPRIGHT)
    values = base.values(link_parameters(arm))
    shortest = np.linalg.lstsq(base.grouping, values, rcond=None)[0].reshape(6, 10)
    assert not consistency.is_consistent(shortest)
    start = np.tile([1.0, 0, 0, 0, 0.0025, 0.0025, 0.0025, 0, 0, 0], (6, 1))  # a kilogram at each joint
    found = consistency.consistent_links(base, base.values(shortest), start)
    assert found.exact
    np.testing.assert_allclose(base.values(found.parameters), values, rtol=0, atol=1e-9)
    assert are_bodies(consistency.with_link_parameters(arm, found.parameters))


def test_the_reference_itself_is_the_nearest_to_itself():
    arm = load_bundled("lite6")
    base = base_parameters(arm.kinematics, UPRIGHT)
    reference = link_parameters(arm)
    found = consistency.consistent_links(base, base.values(reference), reference)
    np.testing.assert_allclose(found.parameters, reference, rtol=1e-9, atol=1e-12)
    again = consistency.with_link_parameters(arm, found.parameters)
    for field in ("mass", "center_of_mass", "inertia"):
        np.testing.assert_allclose(getattr(again, field), getattr(arm, field), rtol=1e-9, atol=1e-12)


def log_cholesky(theta):
    """Pseudo-inertia of a link by the numbers of C. Rucker and P. Wensing (2022), positive whatever they are."""
    a, *d, s12, s23, s13, t1, t2, t3 = theta
    U = np.array([[np.exp(d[0]), s12, s13, t1], [0, np.exp(d[1]), s23, t2], [0, 0, np.exp(d[2]), t3], [0, 0, 0, 1]])
    U = np.exp(a) * U
    P = U @ U.T
    tensor = np.trace(P[:3, :3]) * np.eye(3) - P[:3, :3]
    return np.array([P[3, 3], *P[:3, 3], *np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]])


def test_impossible_base_parameters_are_changed_as_little_as_positivity_allows():
    kinematics = np.array([[0, 0, 0.2, 0, 0, 0], [0, 0, 0.1, np.pi / 2, 0, 0]])
    base = base_parameters(kinematics, UPRIGHT)
    rng = np.random.default_rng(4)
    reference = parameters_of(random_bodies(rng, 2))
    values = base.values(reference)
    values[base.independent.tolist().index(16)] = -0.02  # Izz of link 2
    spread = rng.normal(size=(base.size, base.size))
    covariance = 1e-6 * (spread @ spread.T + np.eye(base.size))
    found = consistency.consistent_links(base, values, reference, covariance)
    assert not found.exact
    assert consistency.is_consistent(found.parameters)
    precision = np.linalg.inv(covariance)
    np.testing.assert_allclose(found.change, base.values(found.parameters) - values, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found.change @ precision @ found.change, found.chi_square, rtol=1e-9)

    def chi_square(theta):
        change = base.values([log_cholesky(theta[:10]), log_cholesky(theta[10:])]) - values
        return change @ precision @ change

    start = np.tile([0.5, -2, -2, -2, 0, 0, 0, 0, 0, 0.0], 2)
    best = minimize(chi_square, start, method="BFGS", options={"maxiter": 400}).fun
    assert 0.98 * best <= found.chi_square <= 1.01 * best


def test_the_chi_square_of_a_negative_moment_of_inertia_is_its_square():
    base = base_parameters(np.zeros((1, 6)), UPRIGHT)
    assert base.independent.tolist() == [6]
    reference = parameters_of(random_bodies(np.random.default_rng(1), 1))
    found = consistency.consistent_links(base, [-0.02], reference, [[0.004**2]])
    assert not found.exact
    np.testing.assert_allclose(found.chi_square, 25, rtol=1e-3)
    assert consistency.is_consistent(found.parameters)


def test_links_that_are_no_bodies_become_such_nearby():
    points = Arm("points", np.zeros((1, 6)), mass=[2], center_of_mass=[[0.1, 0, 0]], inertia=np.zeros((1, 3, 3)))
    for links in (np.zeros((2, 10)), link_parameters(points), link_parameters(load_bundled("xarm7"))):
        assert consistency.is_consistent(consistency.bodies_near(links))
    found = consistency.with_link_parameters(points, consistency.bodies_near(link_parameters(points)))
    np.testing.assert_allclose(found.mass, 2, rtol=1e-4)
    np.testing.assert_allclose(found.center_of_mass, [[0.1, 0, 0]], atol=1e-4)
    arm = load_bundled("lite6")
    # eigenvectors are exact to some units in the last place, as many as the processor makes of it
    np.testing.assert_allclose(consistency.bodies_near(link_parameters(arm)), link_parameters(arm), rtol=0, atol=1e-14)


def test_what_does_not_fit_is_refused():
    arm = load_bundled("lite6")
    base = base_parameters(arm.kinematics, UPRIGHT)
    links = link_parameters(arm)
    values = base.values(links)
    for call, message in (
        (lambda: consistency.consistent_links(base, values[1:], links), "do not fit a chain of 6 links with 36 base"),
        (lambda: consistency.consistent_links(base, values, -links), "the reference links are no bodies; give such as"),
        (
            lambda: consistency.consistent_links(base, values, links, np.eye(3)),
            "the covariance has the shape (3, 3); it must be (36, 36)",
        ),
        (
            lambda: consistency.with_link_parameters(arm, -links),
            "arm 'lite6': these links are no bodies; take such as consistent_links gives",
        ),
    ):
        with pytest.raises(InputError, match=re.escape(message)):
            call()
