"""Effects on torques against a generator that shares no code with the library, and the laws of all of them."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from domains.torque.moved import CENTER, GRAVITY, hidden, motion_of, setup_of

from benchmarks.torque_trials.physics import torques
from lite6jax.arms.dynamics import link_parameters
from lite6jax.domains.torque.composition import composed
from lite6jax.domains.torque.rows import RigidBodies
from lite6jax.effects.dynamic.catalogue import BUILT_IN, torque_catalogue, torque_ladder
from lite6jax.effects.dynamic.friction import CoupledFriction, StribeckFriction
from lite6jax.effects.dynamic.motors import TorqueRipple
from lite6jax.effects.dynamic.torque_effect import Delaying, Scaling, direction
from lite6jax.effects.dynamic.unnamed import UnnamedTorque
from lite6jax.effects.motion import motion_of as library_motion
from lite6jax.effects.serialization import effect_as_dict, effect_from_dict, parse_effect
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms

CASES = [
    ("viscous_friction:joint=2,viscous_Nm_s_per_rad=0.8", {"viscous_Nm_s_per_rad": 0.8}, "joint2"),
    ("coulomb_friction:joint=3,coulomb_Nm=0.5", {"coulomb_Nm": 0.5}, "joint3"),
    (
        "stribeck_friction:joint=1,stribeck_Nm=0.4,velocity_rad_per_s=0.1",
        {"stribeck_Nm": 0.4, "velocity_rad_per_s": 0.1},
        "joint1",
    ),
    ("load_friction:joint=2,coefficient=0.05", {"coefficient": 0.05}, "joint2"),
    ("friction_temperature:joint=4,viscous_Nm_s_per_rad_K=-0.02", {"viscous_Nm_s_per_rad_K": -0.02}, "joint4"),
    (
        "coupled_friction:joint=6,source_joint=5,viscous_Nm_s_per_rad=0.3,coulomb_Nm=0.2",
        {"viscous_Nm_s_per_rad": 0.3, "coulomb_Nm": 0.2, "source_joint": 5.0},
        "joint6",
    ),
    ("torque_offset:joint=5,offset_Nm=-0.3", {"offset_Nm": -0.3}, "joint5"),
    ("torque_scale:joint=1,scale=0.12", {"scale": 0.12}, "joint1"),
    ("rotor_inertia:joint=5,inertia_kg_m2=0.02", {"inertia_kg_m2": 0.02}, "joint5"),
    (
        "joint_spring:joint=3,stiffness_Nm_per_rad=1.5,rest_rad=0.4",
        {"stiffness_Nm_per_rad": 1.5, "rest_rad": 0.4},
        "joint3",
    ),
    (
        "torque_ripple:joint=2,order=7.3,amplitude_Nm=0.2,phase_rad=1.1",
        {"order": 7.3, "amplitude_Nm": 0.2, "phase_rad": 1.1},
        "joint2",
    ),
    ("link_mass:link=3,mass_kg=0.2", {"mass_kg": 0.2}, "link3"),
    ("link_com:link=2,x_m=0.001,y_m=-0.002,z_m=0.001", {"x_m": 0.001, "y_m": -0.002, "z_m": 0.001}, "link2"),
    ("payload_error:mass_kg=0.25", {"mass_kg": 0.25}, "payload"),
    ("base_tilt:tilt_x_rad=0.002,tilt_y_rad=-0.001", {"tilt_x_rad": 0.002, "tilt_y_rad": -0.001}, "base"),
]


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


@pytest.mark.parametrize(("text", "values", "site"), CASES, ids=lambda case: case if isinstance(case, str) else "")
def test_what_an_effect_adds_agrees(scene, text, values, site):
    setup, motion, dynamics = scene
    effect, numbers = parse_effect(text, BUILT_IN)
    name = text.split(":")[0]
    wanted = torques(setup, [hidden(name, site, **values)], motion).T - torques(setup, [], motion).T
    added = composed(Terms((effect,)), numbers, dynamics) - dynamics.torque
    # a shift of a centre and a tilt are taken to first order
    tolerance = 5e-3 if name in ("link_com", "base_tilt") else 1e-9
    assert np.abs(wanted).max() > 1e-3
    np.testing.assert_allclose(added, wanted, rtol=0, atol=tolerance * np.abs(wanted).max())
    assert effect.site == site


def test_the_scale_multiplies_what_others_add(scene):
    setup, motion, dynamics = scene
    effects = [parse_effect(f"{name}:joint=2,{key}=0.3", BUILT_IN) for name, key in
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
    again, values = effect_from_dict(document, BUILT_IN)
    assert again == effect
    np.testing.assert_allclose(values, np.abs(a), rtol=1e-9, atol=1e-12)
    if not isinstance(effect, Scaling | Delaying) and effect.site.startswith("joint"):
        others = [j for j in range(6) if j + 1 not in (effect.joint, getattr(effect, "source_joint", 0))]
        assert not effect.torque(a, dynamics)[others].any()


def test_no_two_of_the_ladder_are_the_same_function(scene):
    dynamics = scene[2]
    columns = np.array([e.torque(u, dynamics).ravel() for e in torque_ladder(6) for u in np.eye(e.size)])
    scaled = columns / np.linalg.norm(columns, axis=1)[:, None]
    assert np.linalg.eigvalsh(scaled @ scaled.T)[0] > 1e-6


def test_a_curve_of_splines_follows_a_function_and_stays_constant_beyond():
    curve = UnnamedTorque(2, "position of joint 2", -1.0, 1.0, 12)
    q = np.linspace(-1, 1, 300)
    values = np.linalg.lstsq(curve.functions_of(q[None]).T, np.sin(2 * q), rcond=None)[0]
    assert np.abs(curve.curve(values, q) - np.sin(2 * q)).max() < 2e-4
    assert curve.curve(values, np.array([5.0]))[0] == pytest.approx(curve.curve(values, np.array([1.0]))[0])
    assert [c.name for c in curve.coordinates][:2] == ["level_Nm", "step1_Nm"]
    assert curve.drivers[0].phrase == "position of joint 2"
    signed = UnnamedTorque(2, "position of joint 2", -1.0, 1.0, signed=True)
    assert [driver.quantity for driver in signed.drivers] == ["position", "direction of motion"]


def test_a_curve_continues_as_a_constant_where_no_sample_determines_it():
    curve = UnnamedTorque(2, "position of joint 2", -1.0, 1.0, 8, spread=20.0)
    q = np.linspace(-1, 0, 200)
    A = curve.functions_of(q[None]).T / 0.1
    prior = np.diag([number.spread**-2 for number in curve.coordinates])
    values = np.linalg.solve(A.T @ A + prior, A.T @ np.full(200, 7.0) / 0.1)
    np.testing.assert_allclose(curve.curve(values, np.array([-1.0, 0.3, 1.0])), 7.0, atol=1e-3)


def test_a_curve_over_the_speed_is_an_odd_function_of_the_velocity(scene):
    dynamics = scene[2]
    curve = UnnamedTorque(2, "speed of joint 2", 0.0, 2.0, 3, signed=True)
    values = np.random.default_rng(5).normal(size=curve.size)
    back = dynamics._replace(motion=dynamics.motion._replace(joint_velocity=-dynamics.motion.joint_velocity))
    there = values @ curve.basis(dynamics)
    np.testing.assert_allclose(there, -(values @ curve.basis(back)), atol=1e-12)
    assert np.abs(there).max() > 0.1


def test_a_curve_that_is_multiplied_by_the_load_is_zero_without_one(scene):
    dynamics = scene[2]
    curve = UnnamedTorque(2, "position of joint 2", -1.0, 1.0, 3)
    loaded = replace(curve, full_load=4.0)
    assert [driver.phrase for driver in loaded.drivers] == ["position of joint 2", "gravity torque of joint 2"]
    # what links exert on a motor is the opposite of what it exerts
    np.testing.assert_allclose(loaded.basis(dynamics), -curve.basis(dynamics) * dynamics.torque[1] / 4.0, atol=1e-12)
    assert not loaded.basis(dynamics._replace(torque=0 * dynamics.torque)).any()


def test_products_with_a_direction_of_motion_hold_it_once():
    drivers = "position of joint 2 and direction of motion of joint 2"
    curve = UnnamedTorque(2, drivers, -1.0, 1.0, degree=3, further=(-1.0, 1.0))
    q, sign = np.random.default_rng(6).uniform(-1, 1, 40), np.tile([-1.0, 1.0], 20)
    functions = curve.functions_of(np.stack([q, sign]))
    expected = [np.ones(40), q, sign, q**2, q * sign, q**3, q**2 * sign]
    assert len(functions) == curve.size == np.linalg.matrix_rank(functions)
    np.testing.assert_allclose(sorted(functions.tolist()), sorted(np.array(expected).tolist()), atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: StribeckFriction(1, -0.1), "velocity_rad_per_s is -0.1; give a positive number"),
        (lambda: CoupledFriction(2, 2), "name the outer joint as joint"),
        (lambda: TorqueRipple(1, 0.0), "order is 0; give a positive number"),
        (lambda: UnnamedTorque(1, "time", 1.0, 1.0), "are no curve; give lower < upper"),
        (lambda: UnnamedTorque(1, "time and time", 0.0, 1.0), "give lower and upper of each driver but the first"),
        (lambda: UnnamedTorque(1, "time", 0.0, 1.0, orders=(1.0,), degree=2), "a degree beside orders"),
        (lambda: UnnamedTorque(1, "time", 0.0, 1.0, signed=True, full_load=2.0), "full_load 2 is not possible"),
        (lambda: UnnamedTorque(1, "time", 0.0, 1.0, full_load=-2.0), "full_load -2 is not possible"),
    ],
)
def test_impossible_effects(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_a_payload_is_a_mass_at_another_centre(scene):
    dynamics = scene[2]
    away = np.array([0.03, -0.02, 0.04])
    body, numbers = parse_effect("payload:mass_kg=0.62,x_m=0.03,y_m=-0.02,z_m=0.04", BUILT_IN)
    mass, value = parse_effect("payload_error:mass_kg=0.62", BUILT_IN)
    there = mass.torque(value, dynamics._replace(payload_center=CENTER + away))
    np.testing.assert_allclose(body.torque(numbers, dynamics), there, rtol=0, atol=1e-4 * np.abs(there).max())
    assert body.site == "payload"
    reported = body.reported(numbers, np.diag([1e-4, 1e-6, 1e-6, 1e-6]))
    assert {name: one.value for name, one in reported.items()} == pytest.approx(
        {"mass_kg": 0.62, "x_m": 0.03, "y_m": -0.02, "z_m": 0.04}
    )
    assert reported["x_m"].std == pytest.approx(np.hypot(1e-3, 0.03 * 1e-2) / 0.62)
