"""Torques, their regressor, base parameters and consistent links, against Pinocchio and what physics demands."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from lite6jax.arms import dynamics
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import load_bundled
from lite6jax.errors import InputError
from tests.oracles.arms import perturbed, random_kinematics
from tests.oracles.pinocchio_dynamics import (
    pinocchio_model,
    pinocchio_parameters,
    pinocchio_regressor,
    pinocchio_torques,
    random_bodies,
)

TILTED = np.array([0.3, -0.4, -9.7])
UPRIGHT = np.array([0.0, 0.0, -9.81])


def random_motion(rng, joints, samples):
    """Positions, velocities and accelerations (joint, sample)."""
    return rng.uniform(-np.pi, np.pi, (joints, samples)), *rng.normal(0, 2, (2, joints, samples))


def random_arm(rng, joints):
    mass, center, inertia = random_bodies(rng, joints)
    return Arm("random", random_kinematics(rng, joints), mass=mass, center_of_mass=center, inertia=inertia)


@pytest.mark.parametrize("joints", [1, 6, 7])
def test_torques_and_regressor_are_pinocchios(joints):
    rng = np.random.default_rng(joints)
    for _ in range(3):
        arm, motion = random_arm(rng, joints), random_motion(rng, joints, 20)
        model = pinocchio_model(arm.kinematics, arm.mass, arm.center_of_mass, arm.inertia, TILTED)
        parameters = dynamics.link_parameters(arm)
        np.testing.assert_allclose(parameters, pinocchio_parameters(model), rtol=0, atol=1e-12)
        torques = dynamics.inverse_dynamics(arm.kinematics, parameters, *motion, TILTED)
        np.testing.assert_allclose(torques, pinocchio_torques(model, *motion), rtol=0, atol=1e-10)
        matrix = dynamics.regressor(arm.kinematics, *motion, TILTED)
        np.testing.assert_allclose(matrix, pinocchio_regressor(model, *motion), rtol=0, atol=1e-10)


@pytest.mark.parametrize("samples", [1, dynamics._CHUNK + 1, 3 * dynamics._CHUNK - 7])
def test_chunks_of_samples_leave_no_seam(samples):
    rng = np.random.default_rng(samples)
    arm, motion = random_arm(rng, 2), random_motion(rng, 2, samples)
    model = pinocchio_model(arm.kinematics, arm.mass, arm.center_of_mass, arm.inertia, TILTED)
    matrix = np.asarray(dynamics.regressor(arm.kinematics, *motion, TILTED))
    assert matrix.shape == (2, 20, samples)
    np.testing.assert_allclose(matrix, pinocchio_regressor(model, *motion), rtol=0, atol=1e-10)


def test_a_motor_that_holds_a_load_up_exerts_the_negative_of_gravitys_torque():
    turned = np.array([[0.0, 0.0, 0.0, -np.pi / 2, 0.0, 0.0]])  # z along the base's y: a positive angle lowers the link
    point = np.array([[2.0, 2.0 * 0.5, 0.0, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.0]])  # 2 kg at 0.5 m along x
    zero = np.zeros((1, 1))
    torque = dynamics.inverse_dynamics(turned, point, zero, zero, zero, UPRIGHT)
    np.testing.assert_allclose(torque, [[-2.0 * 9.81 * 0.5]], rtol=0, atol=1e-14)


def test_torques_differentiate_and_vectorise():
    rng = np.random.default_rng(5)
    arm, motion = random_arm(rng, 3), random_motion(rng, 3, 4)
    kinematics, parameters = jnp.asarray(arm.kinematics), jnp.asarray(dynamics.link_parameters(arm))
    step = jnp.asarray(rng.standard_normal(kinematics.shape))

    def torques(kinematics):
        return dynamics.inverse_dynamics(kinematics, parameters, *motion, TILTED)

    def by_regressor(kinematics):
        return jnp.einsum("ips,p->is", dynamics.regressor(kinematics, *motion, TILTED), parameters.ravel())

    arms = jax.vmap(torques)(jnp.stack([kinematics + 1e-5 * step, kinematics - 1e-5 * step]))
    np.testing.assert_allclose(arms[0], by_regressor(kinematics + 1e-5 * step), rtol=1e-12)
    for function in (torques, by_regressor):
        tangent = jax.jvp(function, (kinematics,), (step,))[1]
        np.testing.assert_allclose(tangent, (arms[0] - arms[1]) / 2e-5, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("name", "size"), [("lite6", 36), ("ur10", 36), ("xarm5", 29), ("xarm7", 43)])
def test_base_parameters_of_the_arms(name, size):
    arm = load_bundled(name)
    assert dynamics.base_parameters(arm.kinematics, UPRIGHT).size == size


def test_base_parameters_say_all_that_torques_do():
    rng = np.random.default_rng(2)
    for gravity, size in ((UPRIGHT, 38), (np.zeros(3), 36)):
        arm, motion = random_arm(rng, 6), random_motion(rng, 6, 40)
        base = dynamics.base_parameters(arm.kinematics, gravity)
        model = pinocchio_model(arm.kinematics, arm.mass, arm.center_of_mass, arm.inertia, gravity)
        W = np.moveaxis(pinocchio_regressor(model, *motion), 2, 0).reshape(-1, 60)
        assert base.size == np.linalg.matrix_rank(W, tol=1e-8) == size
        x = pinocchio_parameters(model)
        torques = pinocchio_torques(model, *motion).T.ravel()
        np.testing.assert_allclose(W[:, base.independent] @ base.values(x), torques, rtol=0, atol=1e-9)
        np.testing.assert_allclose(W @ base.basis @ (base.basis.T @ x.ravel()), torques, rtol=0, atol=1e-9)
        np.testing.assert_allclose(base.basis.T @ base.basis, np.eye(size), rtol=0, atol=1e-12)


def test_base_parameters_of_prismatic_joints_at_right_angles_say_all_that_torques_do():
    """Columns there are dependent up to rounding, which is no direction of its own."""
    chain = np.array([[0.0] * 6, [0, 0, 0.1, 0, 0, 0], [0, 0, 0.1, -np.pi / 2, 0, 0]])
    base = dynamics.base_parameters(chain, UPRIGHT, (1, 2))
    rng = np.random.default_rng(3)
    W = np.moveaxis(np.asarray(dynamics.regressor(chain, *rng.normal(size=(3, 3, 40)), UPRIGHT, (1, 2))), 2, 0)
    W = W.reshape(-1, 30)
    assert base.size == np.linalg.matrix_rank(W) == 5
    np.testing.assert_allclose(W[:, base.independent] @ base.grouping, W, rtol=0, atol=1e-9)


def in_words(base):
    """Each combination, such as `Izz1 + 0.16 m2`: coefficients in the parameters' own units."""
    names = [f"{dynamics.PARAMETERS[k % 10]}{k // 10 + 1}" for k in range(base.grouping.shape[1])]
    for row, own in zip(base.grouping, base.independent, strict=True):
        others = [f" + {row[k]:.4g} {names[k]}" for k in np.flatnonzero(row) if k != own]
        yield names[own] + "".join(others)


def test_the_grouping_is_that_of_the_planar_arm():
    flat = np.zeros((3, 6))
    flat[1, 0], flat[2, 0] = 0.4, 0.3
    sideways = dynamics.base_parameters(flat, [0.0, -9.81, 0.0])
    assert list(in_words(sideways)) == [
        "mx1 + 0.4 m2 + 0.4 m3",
        "my1",
        "Izz1 + 0.16 m2 + 0.16 m3",
        "mx2 + 0.3 m3",
        "my2",
        "Izz2 + 0.09 m3",
        "mx3",
        "my3",
        "Izz3",
    ]
    level = dynamics.base_parameters(flat, UPRIGHT)
    assert next(in_words(level)) == "Izz1 + 0.16 m2 + 0.16 m3"
    assert level.size == 7


def test_a_measured_chain_shows_how_its_first_axis_is_tilted():
    kinematics = perturbed(np.random.default_rng(3), load_bundled("lite6").kinematics)
    base = dynamics.base_parameters(kinematics, UPRIGHT)
    assert base.size == 38
    assert [name.split(" ")[0] for name in in_words(base)][:2] == ["mx1", "my1"]
    assert np.abs(base.grouping).max() < 1.1


@pytest.mark.parametrize(
    ("fields", "lacks"), [({}, "masses"), ({"mass": np.ones(2), "center_of_mass": np.zeros((2, 3))}, "inertia tensors")]
)
def test_torques_need_inertia(fields, lacks):
    arm = Arm("bare", random_kinematics(np.random.default_rng(0), 2), **fields)
    message = f"arm 'bare': has no {lacks}, which torques need; give mass_kg, com_m and inertia_kg_m2 of every link"
    with pytest.raises(InputError, match=re.escape(message)):
        dynamics.link_parameters(arm)


# --- links that bodies can be ---


def parameters_of(bodies):
    mass, center, inertia = bodies
    arm = Arm("a", np.zeros((len(mass), 6)), mass=mass, center_of_mass=center, inertia=(inertia + inertia.mT) / 2)
    return dynamics.link_parameters(arm)


def are_bodies(arm):
    """By the principal moments about the centre of mass, which the module does not use."""
    moments = np.linalg.eigvalsh(arm.inertia)
    return (arm.mass > 0).all() and (moments[:, 0] > 0).all() and (moments[:, 2] < moments[:, 0] + moments[:, 1]).all()


@pytest.mark.parametrize("joints", [2, 6, 7])
def test_base_parameters_are_kept_where_bodies_have_them(joints):
    rng = np.random.default_rng(joints)
    for _ in range(3):
        kinematics = random_kinematics(rng, joints)
        base = dynamics.base_parameters(kinematics, UPRIGHT)
        true, reference = parameters_of(random_bodies(rng, joints)), parameters_of(random_bodies(rng, joints))
        values = base.values(true)
        links, exact = dynamics.consistent_links(base, values, reference)
        assert exact
        np.testing.assert_allclose(base.values(links), values, rtol=0, atol=1e-9)
        arm = dynamics.set_link_parameters(Arm("a", kinematics), links)
        assert are_bodies(arm)
        motion = rng.normal(0, 2, (3, joints, 10))
        torques = [
            pinocchio_torques(pinocchio_model(kinematics, *links, UPRIGHT), *motion)
            for links in ((arm.mass, arm.center_of_mass, arm.inertia), bodies_of(true))
        ]
        np.testing.assert_allclose(*torques, rtol=0, atol=1e-8)


def bodies_of(parameters):
    arm = dynamics.set_link_parameters(Arm("a", np.zeros((len(parameters), 6))), parameters)
    return arm.mass, arm.center_of_mass, arm.inertia


def test_a_least_squares_solution_that_is_no_body_becomes_one():
    arm = load_bundled("ur10")
    base = dynamics.base_parameters(arm.kinematics, UPRIGHT)
    values = base.values(dynamics.link_parameters(arm))
    shortest = np.linalg.lstsq(base.grouping, values, rcond=None)[0].reshape(6, 10)
    assert not dynamics.is_consistent(shortest)
    start = np.tile([1.0, 0, 0, 0, 0.0025, 0.0025, 0.0025, 0, 0, 0], (6, 1))  # a kilogram at each joint
    links, exact = dynamics.consistent_links(base, base.values(shortest), start)
    assert exact
    np.testing.assert_allclose(base.values(links), values, rtol=0, atol=1e-9)
    assert are_bodies(dynamics.set_link_parameters(arm, links))


def test_the_reference_itself_is_the_nearest_to_itself():
    arm = load_bundled("lite6")
    base = dynamics.base_parameters(arm.kinematics, UPRIGHT)
    reference = dynamics.link_parameters(arm)
    links, _ = dynamics.consistent_links(base, base.values(reference), reference)
    np.testing.assert_allclose(links, reference, rtol=1e-9, atol=1e-12)
    again = dynamics.set_link_parameters(arm, links)
    for field in ("mass", "center_of_mass", "inertia"):
        np.testing.assert_allclose(getattr(again, field), getattr(arm, field), rtol=1e-9, atol=1e-12)


def test_impossible_base_parameters_are_changed_as_little_as_positivity_allows():
    base = dynamics.base_parameters(np.zeros((1, 6)), UPRIGHT)
    assert base.independent.tolist() == [6]  # the moment of inertia about the axis
    reference = parameters_of(random_bodies(np.random.default_rng(1), 1))
    links, exact = dynamics.consistent_links(base, [-0.02], reference)
    assert not exact
    assert dynamics.is_consistent(links)
    assert 0 < base.values(links)[0] < 1e-3 * base.values(reference)[0]


def test_links_that_are_no_bodies_become_such_nearby():
    points = Arm("points", np.zeros((1, 6)), mass=[2], center_of_mass=[[0.1, 0, 0]], inertia=np.zeros((1, 3, 3)))
    for links in (np.zeros((2, 10)), dynamics.link_parameters(points), dynamics.link_parameters(load_bundled("xarm7"))):
        assert dynamics.is_consistent(dynamics.bodies_near(links))
    found = dynamics.set_link_parameters(points, dynamics.bodies_near(dynamics.link_parameters(points)))
    np.testing.assert_allclose(found.mass, 2, rtol=1e-4)
    np.testing.assert_allclose(found.center_of_mass, [[0.1, 0, 0]], atol=1e-4)
    arm = load_bundled("lite6")
    # eigenvectors are exact to some units in the last place, as many as the processor makes of it
    np.testing.assert_allclose(
        dynamics.bodies_near(dynamics.link_parameters(arm)), dynamics.link_parameters(arm), rtol=0, atol=1e-14
    )


def test_what_does_not_fit_is_refused():
    arm = load_bundled("lite6")
    base = dynamics.base_parameters(arm.kinematics, UPRIGHT)
    links = dynamics.link_parameters(arm)
    values = base.values(links)
    for call, message in (
        (lambda: dynamics.consistent_links(base, values, -links), "the reference links are no bodies; give such as"),
        (
            lambda: dynamics.set_link_parameters(arm, -links),
            "arm 'lite6': these links are no bodies; take such as consistent_links gives",
        ),
    ):
        with pytest.raises(InputError, match=re.escape(message)):
            call()
