"""Gravity's loads against Pinocchio and plain NumPy, and what refuses to be loaded."""

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from typed import refusal

from lite6jax.arms.chains import HayatiForm, SixParameterForm
from lite6jax.arms.description import load_bundled
from lite6jax.arms.se3 import turn
from lite6jax.effects.statics import inertia_of, loads
from tests.oracles.arms import random_kinematics, random_positions
from tests.oracles.chains import six_parameter_poses
from tests.oracles.gravity import gravity_moments, mass_points, random_inertia
from tests.oracles.pinocchio_arm import pinocchio_arm

loads_of = jax.jit(loads, static_argnums=0)


def simulated(seed, dof, samples=5):
    rng = np.random.default_rng(seed)
    arm = random_kinematics(rng, dof), random_positions(rng, samples, dof)
    return *arm, rng.uniform(0, 2, samples), random_inertia(rng, dof)


def found(kinematics, positions, payload, inertia, *rates):
    joint = turn(jnp.asarray(positions.T))
    form = SixParameterForm(len(kinematics))
    rates = [jnp.asarray(rate.T) for rate in rates]
    return loads_of(form, jnp.asarray(kinematics.ravel()), joint, jnp.asarray(payload), inertia_of(**inertia), *rates)


def pinocchio_loads(kinematics, positions, payload, inertia):
    """Generalised gravity and the moments through each joint."""
    torques, moments = [], []
    for q, mass in zip(positions, payload, strict=True):
        model = pinocchio_arm(kinematics, mass, inertia)
        data = model.createData()
        torques.append(-pin.computeGeneralizedGravity(model, data, q))
        still = np.zeros(model.nv)
        pin.rnea(model, data, q, still, still)
        moments.append([-data.f[i].angular for i in range(1, model.njoints)])
    return np.array(torques), np.array(moments)


@pytest.mark.parametrize("dof", [1, 2, 6, 7])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_loads_agree_with_pinocchio_and_numpy(dof, seed):
    case = simulated(seed, dof)
    result = found(*case)
    torques, moments = pinocchio_loads(*case)
    np.testing.assert_allclose(result.torque.T, torques, rtol=0, atol=1e-12)
    np.testing.assert_allclose(jnp.moveaxis(result.moment, -1, 0), moments, rtol=0, atol=1e-12)
    plain, plain_base = gravity_moments(*case)
    np.testing.assert_allclose(result.base_moment.T, plain_base, rtol=0, atol=1e-12)
    np.testing.assert_allclose(jnp.moveaxis(result.moment, -1, 0), plain, rtol=0, atol=1e-12)


@pytest.mark.parametrize("dof", [1, 2, 6])
def test_loads_of_a_moving_arm_are_pinocchios_inverse_dynamics(dof):
    kinematics, positions, payload, inertia = simulated(3, dof)
    rng = np.random.default_rng(dof)
    velocity, acceleration = rng.uniform(-2, 2, (2, *positions.shape))
    result = found(kinematics, positions, payload, inertia, velocity, acceleration)
    cases = zip(positions, velocity, acceleration, payload, strict=True)
    for k, (q, dq, ddq, mass) in enumerate(cases):
        model = pinocchio_arm(kinematics, mass, inertia)
        data = model.createData()
        torque = pin.rnea(model, data, q, dq, ddq)
        np.testing.assert_allclose(result.torque[:, k], -torque, rtol=0, atol=1e-11)
        moments = [-data.f[i].angular for i in range(1, dof + 1)]
        np.testing.assert_allclose(result.moment[:, :, k], moments, rtol=0, atol=1e-11)
        pin.forwardKinematics(model, data, q)
        np.testing.assert_allclose(result.base_moment[:, k], -data.oMi[1].act(data.f[1]).angular, rtol=0, atol=1e-11)
    still = np.zeros_like(positions)
    for a, b in zip(
        found(kinematics, positions, payload, inertia, still, still),
        found(kinematics, positions, payload, inertia),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)


def test_the_lite6_turns_freely_about_the_vertical_and_feels_a_kilogram_by_its_distance():
    arm = load_bundled("lite6")
    q = np.array([[0.7, 0.9, 1.4, 0.3, -0.2, 0.0]])
    inertia = {"mass": arm.mass, "center_of_mass": arm.center_of_mass}
    empty, laden = (found(arm.kinematics, q, mass, inertia).torque[:, 0] for mass in (np.zeros(1), np.ones(1)))
    assert abs(laden[0]) < 1e-12
    # joint 2's axis is horizontal, across the direction in which joint 1 points
    ahead = np.array([np.cos(0.7), np.sin(0.7), 0.0]) @ six_parameter_poses(arm.kinematics, q[0])[:3, 3]
    assert abs(ahead) > 0.1
    np.testing.assert_allclose(abs(laden[1] - empty[1]), 9.81 * abs(ahead), rtol=1e-12)


def test_moments_are_the_power_of_gravity():
    # a joint that turns by dq lets gravity do the work torque·dq: the loss of potential energy
    kinematics, positions, payload, inertia = simulated(5, 4)

    def height(q):
        points, masses = mass_points(kinematics, q, payload[0], inertia)
        return masses @ points @ inertia["gravity"]

    steps = 1e-5 * np.eye(4)
    work = [(height(positions[0] + step) - height(positions[0] - step)) / 2e-5 for step in steps]
    torque = found(kinematics, positions, payload, inertia).torque[:, 0]
    np.testing.assert_allclose(torque, work, rtol=0, atol=1e-8)


def test_loads_can_be_differentiated_both_ways():
    kinematics, positions, payload, inertia = simulated(6, 3)
    joint = turn(jnp.asarray(positions.T))

    def total(values):
        rows, mass = values
        result = loads(SixParameterForm(3), rows, joint, mass, inertia_of(**inertia))
        return jnp.sum(result.moment**2) + jnp.sum(result.base_moment)

    at = (jnp.asarray(kinematics.ravel()), jnp.asarray(payload))
    direction = jax.tree.map(jnp.cos, at)
    backward = jax.jit(jax.grad(total))(at)
    _, forward = jax.jvp(jax.jit(total), (at,), (direction,))
    product = sum(jnp.vdot(a, b) for a, b in zip(backward, direction, strict=True))
    np.testing.assert_allclose(forward, product, rtol=1e-12)


def test_a_hayati_chain_has_no_link_frames():
    form = HayatiForm(2)
    joint = turn(jnp.zeros((2, 1)))
    inertia = inertia_of(np.ones(2), np.zeros((2, 3)))
    assert refusal(loads, form, jnp.zeros(form.size), joint, jnp.zeros(1), inertia) == (
        "the loads of gravity require the frames of the links; use the six-parameter chain, to which "
        "hayati_to_six_parameter converts a Hayati chain exactly, or give the loads themselves"
    )


def test_masses_must_be_one_per_joint():
    assert refusal(
        loads,
        SixParameterForm(3),
        jnp.zeros(18),
        turn(jnp.zeros((3, 1))),
        jnp.zeros(1),
        inertia_of(np.ones(2), np.zeros((2, 3))),
    ) == ("inertia: 2 masses for an arm of 3 joints; give one per joint, a tool's mass within the last")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"mass": [[1.0]], "center_of_mass": [[0, 0, 0]]}, "inertia: mass has the shape (1, 1); give (joint,)"),
        ({"mass": [1.0], "center_of_mass": [0, 0, 0]}, "inertia: center_of_mass has the shape (3,); give (1, 3)"),
        (
            {"mass": [np.nan], "center_of_mass": [[0, 0, 0]]},
            "inertia: mass has a number that is not finite; correct it",
        ),
        (
            {"mass": [1.0], "center_of_mass": [[0, 0, 0]], "gravity": [9.81]},
            "inertia: gravity has the shape (1,); give (3,)",
        ),
    ],
)
def test_inertia_refuses(given, message):
    assert refusal(inertia_of, **given) == message
