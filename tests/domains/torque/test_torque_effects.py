"""Effects on torques against a generator that shares no code with the library, and the laws of all of them."""

import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from domains.torque.moved import CENTER, GRAVITY, hidden, motion_of, setup_of

from benchmarks.torque_trials.physics import torques
from lite6jax.arms.dynamics import link_parameters
from lite6jax.domains.torque.predict import composed
from lite6jax.domains.torque.rows import RigidBodies
from lite6jax.effects.catalogue import TORQUE_EFFECTS, torque_catalogue
from lite6jax.effects.dynamic import (
    CoupledFriction,
    Delaying,
    Scaling,
    StribeckFriction,
    TorqueRipple,
    UnnamedTorque,
    direction,
)
from lite6jax.effects.motion import motion_of as library_motion
from lite6jax.effects.serialization import effect_as_dict, effect_from_dict, parse_effect
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms

CASES = """
joint2 viscous_friction viscous_Nm_s_per_rad=0.8
joint3 coulomb_friction coulomb_Nm=0.5
joint1 stribeck_friction stribeck_Nm=0.4,velocity_rad_per_s=0.1
joint2 load_friction coefficient=0.05
joint4 friction_temperature viscous_Nm_s_per_rad_K=-0.02
joint6 coupled_friction source_joint=5,viscous_Nm_s_per_rad=0.3,coulomb_Nm=0.2
joint5 torque_offset offset_Nm=-0.3
joint1 torque_scale scale=0.12
joint5 rotor_inertia inertia_kg_m2=0.02
joint3 joint_spring stiffness_Nm_per_rad=1.5,rest_rad=0.4
joint2 torque_ripple order=7.3,amplitude_Nm=0.2,phase_rad=1.1
link3 link_mass mass_kg=0.2
link3 link_inertia inertia_kg_m2=0.03
link2 link_com x_m=0.001,y_m=-0.002,z_m=0.001
payload payload_error mass_kg=0.25
base base_tilt tilt_x_rad=0.002,tilt_y_rad=-0.001
"""
"""The site, the name and the numbers of effects that the generator has as well."""


@pytest.fixture(scope="module")
def scene():
    """An arm, its motion, and its dynamics by the library at exactly that motion."""
    setup, arm = setup_of(3)
    motion = motion_of(setup, 4, rate=20.0, seconds=10.0, warming=True, payload=0.3)
    moved = library_motion(
        motion.q,
        joint_velocity=motion.dq,
        direction=direction(motion.dq),
        time=motion.time,
        joint_temperature=motion.temperature,
        payload=motion.payload,
    )._replace(joint_acceleration=jnp.asarray(motion.ddq.T))
    host = moved._replace(**{k: np.asarray(v) for k, v in moved._asdict().items() if isinstance(v, jnp.ndarray)})
    bodies = RigidBodies(host, np.asarray(link_parameters(arm)), CENTER, GRAVITY, np.asarray(arm.kinematics))
    return setup, motion, bodies.dynamics(bodies.links)


def test_the_rigid_arm_agrees(scene):
    setup, motion, dynamics = scene
    np.testing.assert_allclose(dynamics.torque, torques(setup, [], motion).T, rtol=0, atol=1e-9)


@pytest.mark.parametrize("case", CASES.strip().splitlines())
def test_what_an_effect_adds_agrees(scene, case):
    setup, motion, dynamics = scene
    site, name, text = case.split()
    place = f"{site[:-1]}={site[-1]}," if site[-1].isdecimal() else ""
    effect, numbers = parse_effect(f"{name}:{place}{text}", TORQUE_EFFECTS)
    values = {key: float(value) for key, _, value in (each.partition("=") for each in text.split(","))}
    wanted = torques(setup, [hidden(name, site, **values)], motion).T - torques(setup, [], motion).T
    added = composed(Terms((effect,)), numbers, dynamics) - dynamics.torque
    # a shift of a centre and a tilt are taken to first order
    tolerance = 5e-3 if name in ("link_com", "base_tilt") else 1e-9
    assert np.abs(wanted).max() > 1e-3
    np.testing.assert_allclose(added, wanted, rtol=0, atol=tolerance * np.abs(wanted).max())
    assert effect.site == site


@pytest.mark.parametrize("transition", [0.0, 0.02, 0.5])
@pytest.mark.parametrize("change", [1e-9, 1e-3, 0.05, -2.0])
def test_the_direction_of_motion_is_the_mean_over_the_time_of_a_sample(transition, change):
    velocity, parts = np.array([-3.0, -0.3, -0.02, 0.0, 1e-3, 0.4]), 20000
    within = velocity[:, None] + change * ((np.arange(parts) + 0.5) / parts - 0.5)
    wanted = np.tanh(within / (transition or 0.002)).mean(1)
    found = direction(velocity, False, transition, np.full(len(velocity), change))
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-5)


def test_the_scale_multiplies_what_others_add(scene):
    setup, motion, dynamics = scene
    effects = [parse_effect(f"{name}:joint=2,{key}=0.3", TORQUE_EFFECTS) for name, key in
               (("torque_scale", "scale"), ("coulomb_friction", "coulomb_Nm"))]  # fmt: skip
    both = [hidden("torque_scale", "joint2", scale=0.3), hidden("coulomb_friction", "joint2", coulomb_Nm=0.3)]
    found = composed(Terms(tuple(e for e, _ in effects)), np.concatenate([v for _, v in effects]), dynamics)
    np.testing.assert_allclose(found, torques(setup, both, motion).T, rtol=0, atol=1e-9)


@pytest.mark.parametrize("effect", torque_catalogue(3), ids=lambda effect: effect.label)
def test_laws_of_every_effect(scene, effect):
    dynamics = scene[2]
    size = effect.size
    assert not effect.torque(np.zeros(size), dynamics).any()
    rng = np.random.default_rng(1)
    a, b = rng.normal(0, 1, (2, size)) * [number.typical for number in effect.coordinates]
    if effect.linear:
        together = effect.torque(a + 2 * b, dynamics)
        apart = effect.torque(a, dynamics) + 2 * effect.torque(b, dynamics)
        np.testing.assert_allclose(together, apart, rtol=0, atol=1e-9 * max(np.abs(apart).max(), 1e-9))
    parameters = {name: estimate.value for name, estimate in effect.reported(np.abs(a)).items()}
    np.testing.assert_allclose(effect.values_of(parameters), np.abs(a), rtol=1e-9, atol=1e-12)
    document = effect_as_dict(effect, np.abs(a), np.eye(size))
    again, values = effect_from_dict(document, TORQUE_EFFECTS)
    assert again == effect
    np.testing.assert_allclose(values, np.abs(a), rtol=1e-9, atol=1e-12)
    if not isinstance(effect, Scaling | Delaying) and effect.site.startswith("joint"):
        others = [j for j in range(6) if j + 1 not in (effect.joint, getattr(effect, "source_joint", 0))]
        assert not effect.torque(a, dynamics)[others].any()


def test_a_process_acts_at_its_joint_by_the_values_of_its_drivers(scene):
    dynamics = scene[2]
    drivers = "speed of joint 2 and direction of motion of joint 2"
    process = UnnamedTorque(2, drivers, 0.0, 2.0, "smooth*line", (-1.0, 1.0), 0.4)
    velocity = dynamics.velocity(2)
    own = np.stack([np.abs(velocity), np.tanh(velocity / 0.002)])
    np.testing.assert_allclose(process.values_in(dynamics), own, atol=1e-12)
    values = np.random.default_rng(5).normal(size=process.size)
    added = process.torque(values, dynamics)
    np.testing.assert_allclose(added[1], values @ np.asarray(process.functions_at(own)), atol=1e-12)
    assert not added[[0, 2, 3, 4, 5]].any()
    assert {number.spread for number in process.coordinates} == {0.4}
    again, same = effect_from_dict(json.loads(json.dumps(effect_as_dict(process, values))), TORQUE_EFFECTS)
    assert again == process
    np.testing.assert_array_equal(same, values)


def test_friction_depends_on_the_motion_of_its_own_joint_alone():
    own = UnnamedTorque(2, "velocity of joint 2", -1.0, 1.0)
    assert own.is_friction_of(own.joint)
    assert replace(own, driver="velocity of joint 2 and direction of motion of joint 2", kernel="smooth*line",
                   further=(-1.0, 1.0)).is_friction_of(own.joint)  # fmt: skip
    assert not replace(own, joint=3).is_friction_of(3)
    assert not replace(own, driver="position of joint 2").is_friction_of(own.joint)


def test_laws_of_friction_say_so_of_their_joints():
    lines = [line.split() for line in CASES.splitlines() if line.startswith("joint")]
    texts = [f"{name}:joint={site.removeprefix('joint')},{numbers}" for site, name, numbers in lines]
    effects = [parse_effect(text, TORQUE_EFFECTS)[0] for text in texts]
    said = {(effect.name, joint) for effect in effects for joint in range(1, 7) if effect.is_friction_of(joint)}
    assert said == {
        *(("viscous_friction", 2), ("coulomb_friction", 3), ("stribeck_friction", 1), ("load_friction", 2)),
        *(("friction_temperature", 4), ("coupled_friction", 6), ("coupled_friction", 5)),
    }


def test_a_process_of_load_and_position_is_of_the_torque_that_the_joint_bears(scene):
    dynamics = scene[2]
    process = UnnamedTorque(2, "position of joint 2 and gravity torque of joint 2", -1.0, 1.0, "wave*line", (-4.0, 4.0))
    # what links exert on a motor is the opposite of what it exerts
    np.testing.assert_allclose(process.values_in(dynamics)[1], -dynamics.torque[1])
    without = process.functions_of(dynamics._replace(torque=0 * dynamics.torque)).reshape(7, 2, -1)
    with_load = process.functions_of(dynamics).reshape(7, 2, -1)
    np.testing.assert_allclose(with_load[:, 1], -with_load[:, 0] * dynamics.torque[1] / 4.0, atol=1e-12)
    assert not without[:, 1].any()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: StribeckFriction(1, -0.1), "velocity_rad_per_s is -0.1; give a positive number"),
        (lambda: CoupledFriction(2, 2), "name the outer joint as joint"),
        (lambda: TorqueRipple(1, 0.0), "order is 0; give a positive number"),
        (lambda: UnnamedTorque(1, "time", 1.0, 1.0), "are not those of 1 drivers; give lower < upper of each"),
    ],
)
def test_impossible_effects(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_a_payload_is_a_mass_at_another_centre(scene):
    dynamics = scene[2]
    away = np.array([0.03, -0.02, 0.04])
    body, numbers = parse_effect("payload:mass_kg=0.62,x_m=0.03,y_m=-0.02,z_m=0.04", TORQUE_EFFECTS)
    mass, value = parse_effect("payload_error:mass_kg=0.62", TORQUE_EFFECTS)
    there = mass.torque(value, dynamics._replace(payload_center=CENTER + away))
    np.testing.assert_allclose(body.torque(numbers, dynamics), there, rtol=0, atol=1e-4 * np.abs(there).max())
    assert body.site == "payload"
    reported = body.reported(numbers, np.diag([1e-4, 1e-6, 1e-6, 1e-6]))
    assert {name: one.value for name, one in reported.items()} == pytest.approx(
        {"mass_kg": 0.62, "x_m": 0.03, "y_m": -0.02, "z_m": 0.04}
    )
    assert reported["x_m"].std == pytest.approx(np.hypot(1e-3, 0.03 * 1e-2) / 0.62)
