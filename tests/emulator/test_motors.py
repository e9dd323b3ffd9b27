"""What the motors of an emulated arm exert: rigid-body dynamics by Pinocchio, hidden effects by hand, and noise."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.stats import kstest

from lite6jax.effects.catalogue import TORQUE_EFFECTS
from lite6jax.effects.composition import Physics
from lite6jax.effects.serialization import parse_effect
from lite6jax.emulator import EmulatedArm, draw_sines
from lite6jax.emulator.body import Load, Sample
from lite6jax.emulator.core import Core
from lite6jax.errors import InputError
from tests.oracles.pinocchio_arm import pinocchio_chain

TOOL = np.eye(4)
CENTER = np.array([0.01, -0.02, 0.03])


@pytest.fixture(scope="module")
def arm(lite6):
    """With tensors of bodies that could be: a few points each."""
    points = np.random.default_rng(0).normal(scale=0.05, size=(6, 5, 3))
    square = np.einsum("ika,ika->i", points, points)[:, None, None] * np.eye(3)
    return replace(lite6.arm, inertia=square - np.einsum("ika,ikb->iab", points, points))


def moved(seed=1, samples=40):
    rng = np.random.default_rng(seed)
    q, dq, ddq = rng.uniform(-2, 2, (3, samples, 6))
    return Sample(np.arange(samples) * 0.004, q, dq, np.sign(dq)), 5 * ddq


def by_pinocchio(body, sample, ddq, payload, center):
    model = pinocchio_chain(body.kinematics)
    for i in range(6):
        link = pin.Inertia(body.arm.mass[i], body.arm.center_of_mass[i], body.arm.inertia[i])
        model.appendBodyToJoint(i + 1, link, pin.SE3.Identity())
    model.appendBodyToJoint(6, pin.Inertia(payload, center, np.zeros((3, 3))), pin.SE3.Identity())
    model.gravity.linear = np.array([0, 0, -9.81])
    data = model.createData()
    return np.stack([pin.rnea(model, data, *row) for row in zip(sample.position, sample.velocity, ddq, strict=True)])


def with_effects(body, *texts, **changed):
    return replace(body, torque_effects=tuple(parse_effect(text, TORQUE_EFFECTS) for text in texts), **changed)


def test_the_rigid_arm_with_its_payload_is_pinocchios(arm, lite6):
    body = EmulatedArm(arm, lite6.kinematics)
    sample, ddq = moved()
    for payload in (0.0, 0.7):
        carried = Load(TOOL, payload, CENTER)
        found = body.torque(sample, ddq, carried)
        np.testing.assert_allclose(found, by_pinocchio(body, sample, ddq, payload, CENTER), atol=1e-12)


def test_friction_adds_up_and_a_scale_multiplies_all_of_it(arm, lite6):
    rigid = EmulatedArm(arm, lite6.kinematics)
    sample, ddq = moved()
    texts = (
        "torque_scale:joint=2,scale=0.1",  # named first, and applied last
        "viscous_friction:joint=2,viscous_Nm_s_per_rad=3",
        "rotor_inertia:joint=2,inertia_kg_m2=0.2",
        "friction_temperature:joint=4,viscous_Nm_s_per_rad_K=-0.1",
    )
    body = with_effects(rigid, *texts)
    carried = Load(TOOL, 0.3, CENTER)
    expected = rigid.torque(sample, ddq, carried)
    expected[:, 1] = 1.1 * (expected[:, 1] + 3 * sample.velocity[:, 1] + 0.2 * ddq[:, 1])
    expected[:, 3] -= 0.1 * (body.temperature(sample.time)[:, 3] - 25) * sample.velocity[:, 3]
    np.testing.assert_allclose(body.torque(sample, ddq, carried), expected, atol=1e-12)


def test_masses_and_a_tilted_base_are_those_of_another_arm(arm, lite6):
    rigid = EmulatedArm(arm, lite6.kinematics)
    sample, ddq = moved()
    carried = Load(TOOL, 0.3, CENTER)
    heavier = EmulatedArm(replace(arm, mass=arm.mass + 0.2 * (np.arange(6) == 2)), lite6.kinematics)
    body = with_effects(rigid, "link_mass:link=3,mass_kg=0.2")
    np.testing.assert_allclose(body.torque(sample, ddq, carried), heavier.torque(sample, ddq, carried), atol=1e-12)
    still = sample._replace(velocity=0 * sample.velocity)
    tilted = with_effects(rigid, "base_tilt:tilt_x_rad=1e-4,tilt_y_rad=0")
    model_change = tilted.torque(still, 0 * ddq, carried) - rigid.torque(still, 0 * ddq, carried)
    # to first order, a base that is turned by t about x carries gravity turned by −t
    turned = lite6.kinematics.copy()
    T = pin.rpy.rpyToMatrix(1e-4, 0, 0)
    R = T @ pin.rpy.rpyToMatrix(*turned[0, 3:])
    turned[0] = [*(T @ turned[0, :3]), *pin.rpy.matrixToRpy(R)]
    other = EmulatedArm(arm, turned)
    change = by_pinocchio(other, still, 0 * ddq, 0.3, CENTER)
    change -= by_pinocchio(EmulatedArm(arm, lite6.kinematics), still, 0 * ddq, 0.3, CENTER)
    assert np.abs(change).max() > 1e-4
    np.testing.assert_allclose(model_change, change, atol=3e-6)  # the chain is rounded to fp32


def test_a_payload_and_a_clock_are_seen_by_poses_and_motors(arm, lite6):
    """One cause, two sensors: an effect on poses of that name acts on torques too."""

    def hidden(text):
        effect, values = parse_effect(text)
        return EmulatedArm(arm, lite6.kinematics, Physics((effect,)), values)

    rigid = EmulatedArm(arm, lite6.kinematics)
    sample, ddq = moved()
    found = hidden("payload_error:mass_kg=0.4").torque(sample, ddq, Load(TOOL, 0.3, CENTER))
    np.testing.assert_allclose(found, rigid.torque(sample, ddq, Load(TOOL, 0.7, CENTER)), atol=1e-12)
    path = draw_sines(arm, seed=5)
    late, plain = (Core(body, path=path) for body in (hidden("time_offset:offset_s=-0.02"), rigid))
    time = np.linspace(1.0, 2.0, 50)
    np.testing.assert_allclose(late.torque(time), plain.torque(time - 0.02), atol=1e-12)
    assert np.abs(late.torque(time) - plain.torque(time)).max() > 1e-2


def test_noise_is_normal_white_and_that_of_its_instant(arm, lite6):
    sigma = np.array([0.06, 0.08, 0.05, 0.02, 0.02, 0.015])
    core = Core(EmulatedArm(arm, lite6.kinematics, torque_noise=sigma))
    plain = Core(EmulatedArm(arm, lite6.kinematics))
    time = 0.004 * np.arange(1, 5001)
    noise = (core.torque(time) - plain.torque(time)) / sigma
    assert kstest(noise.ravel(), "norm").pvalue > 0.01
    of_joints = np.corrcoef(noise.T) - np.eye(6)
    assert np.abs(of_joints).max() < 0.06
    assert np.abs([np.corrcoef(n[1:], n[:-1])[0, 1] for n in noise.T]).max() < 0.06
    np.testing.assert_array_equal(core.torque(time[7:9]), core.torque(time)[7:9])


@pytest.mark.parametrize(
    ("texts", "noise", "message"),
    [
        (("viscous_friction:joint=7,viscous_Nm_s_per_rad=1",), [], "acts at joint 7, but the arm has 6 joints; choose"),
        ((), [0.1, 0.1], "the noise of torques; give one Nm per joint, 6, 0 or more"),
        ((), [-0.1] * 6, "the noise of torques; give one Nm per joint, 6, 0 or more"),
        (("time_offset:offset_s=1.5",), [], "torques are at most 1 s late or early; give a smaller time_offset or"),
        (("torque_lag:joint=2,lag_s=1.5",), [], "torques are at most 1 s late or early; give a smaller time_offset or"),
    ],
)
def test_what_an_emulator_refuses(arm, lite6, texts, noise, message):
    with pytest.raises(InputError, match=message):
        with_effects(EmulatedArm(arm, lite6.kinematics), *texts, torque_noise=np.array(noise))
