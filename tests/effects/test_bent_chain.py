"""Chains whose frames are displaced: the walk itself, its twists, and the Hayati chain's part."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typed import refusal

from lite6jax.arms.chains import Bend, SixParameterForm, sweep, sweep_order
from lite6jax.arms.description import load_bundled
from lite6jax.arms.dh import hayati_to_six_parameter
from lite6jax.arms.se3 import base_frame, cross, displace, turn
from lite6jax.effects.composition import Physics
from lite6jax.effects.deflection import Deflection, dense
from lite6jax.effects.kinematic import (
    BaseDrift,
    FrameOffset,
    GravityDirection,
    JointCompliance,
    JointHarmonic,
    LinkCompliance,
    LinkThermalExpansion,
    MeasurementScale,
    PayloadCom,
    PayloadError,
    TimeOffset,
    ToolOffset,
)
from lite6jax.effects.motion import motion_of
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.statics import Inertia, Loads, inertia_of, loads
from lite6jax.errors import InputError
from lite6jax.model import arm_model, predict, predict_bent, predict_poses
from tests.oracles.arms import random_kinematics, random_positions
from tests.oracles.effects import random_motion
from tests.oracles.gravity import random_inertia
from tests.oracles.transforms import displacement, shift


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-6, 0.9e-4, 1.1e-4, 1e-2, 1.0, 3.1])
def test_displacing_is_a_translation_and_then_a_rotation(size):
    rng = np.random.default_rng(0)
    twists = rng.standard_normal((6, 4))
    twists[3:] *= size / np.linalg.norm(twists[3:], axis=0)
    start = displacement(rng.uniform(-1, 1, 6))
    frame = jax.jit(displace)(base_frame(jnp.asarray(start), 4), jnp.asarray(twists))
    for k in range(4):
        expected = start @ displacement(twists[:, k])
        found = np.stack([np.asarray(part)[:, k] for part in frame], axis=1)
        np.testing.assert_allclose(found, expected[:3], rtol=0, atol=5e-15)


def test_displacing_by_nothing_is_exact_and_can_be_differentiated():
    frame = base_frame(jnp.eye(4), 2)
    for part, same in zip(frame, displace(frame, jnp.zeros((6, 2))), strict=True):
        np.testing.assert_array_equal(part, same)
    slope = jax.jacobian(lambda w: displace(frame, w).x[:, 0])(jnp.zeros((6, 2)))
    np.testing.assert_allclose(slope[:, 3:, 0], [[0, 0, 0], [0, 0, 1], [0, -1, 0]], atol=1e-16)


def test_twists_of_a_bent_chain_are_its_derivatives():
    rng = np.random.default_rng(1)
    form = SixParameterForm(3)
    values = jnp.asarray(random_kinematics(rng, 3).ravel())
    joint = turn(jnp.asarray(random_positions(rng, 4, 3).T))
    bend = Bend(jnp.asarray(rng.uniform(-0.1, 0.1, (3, 4))), jnp.asarray(rng.uniform(-0.1, 0.1, (3, 6, 4))))
    start = base_frame(jnp.eye(4), 4)

    def origin(values):
        return sweep(form, values, joint, start, bend=bend)[0].origin

    end = origin(values)

    def velocity(twist):
        return twist.linear if twist.angular is None else twist.linear + cross(twist.angular, end)

    _, columns = jax.jit(lambda v: sweep(form, v, joint, start, velocity, bend))(values)
    by_sweep = jnp.moveaxis(jax.jit(jax.jacfwd(origin))(values), -1, 0)[sweep_order(form)]
    np.testing.assert_allclose(jnp.concatenate(columns), by_sweep, rtol=0, atol=1e-14)


def test_what_is_absent_is_the_same_as_zero():
    rng = np.random.default_rng(2)
    chain, model = SixParameterForm(2), arm_model(random_kinematics(rng, 2).ravel())
    q = jnp.asarray(random_positions(rng, 3, 2).T)
    part = Deflection(base=jnp.asarray(1e-3 * rng.standard_normal((6, 3))))
    sparse, full = predict_bent(chain, model, q, part), predict_bent(chain, model, q, dense(part, 2, 3))
    for one, other in zip(jax.tree.leaves(sparse), jax.tree.leaves(full), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-15)
    assert all(leaf is not None for leaf in dense(Deflection(), 2, 3))


def hayati_and_six():
    """One Lite 6 as both chains, the second's flange in the tool."""
    arm = load_bundled("lite6")
    rng = np.random.default_rng(4)
    parameters = arm.hayati + 1e-3 * rng.standard_normal(arm.hayati.size)
    kinematics, after = hayati_to_six_parameter(arm.form, parameters)
    return arm.form, arm_model(parameters), SixParameterForm(6), arm_model(kinematics.ravel(), None, after)


def test_joint_base_tool_and_sensor_effects_work_on_a_hayati_chain():
    rng = np.random.default_rng(5)
    motion = motion_of(**random_motion(rng, 6))
    hayati, model, six, same = hayati_and_six()
    assert np.allclose(same.T_flange_tool, np.eye(4), atol=5e-3)
    physics = Physics((JointHarmonic(2, 1.5), BaseDrift(), MeasurementScale(), TimeOffset()))
    values = np.array([1e-3, 2e-3, 1e-4, 2e-4, -1e-4, 1e-3, 0.01])
    np.testing.assert_allclose(
        predict_poses(hayati, physics, model, values, motion),
        predict_poses(six, physics, same, values, motion),
        rtol=0,
        atol=1e-13,
    )
    # a tool's offset is along the flange's axes, which is where the Hayati chain ends
    tool = Physics((ToolOffset(),))
    shifted = arm_model(model.geometry, None, shift(1e-3, 2e-3, 3e-3))
    np.testing.assert_allclose(
        predict_poses(hayati, tool, model, np.array([1e-3, 2e-3, 3e-3]), motion),
        predict(hayati, shifted, motion.joint_position.T),
        rtol=0,
        atol=1e-14,
    )


@pytest.mark.parametrize("effect", [FrameOffset(2), LinkThermalExpansion(), LinkThermalExpansion(3)])
def test_link_effects_of_a_hayati_chain_are_refused(effect):
    motion = motion_of(**random_motion(np.random.default_rng(6), 6))
    hayati, model, _, _ = hayati_and_six()
    assert refusal(predict_poses, hayati, Physics((effect,)), model, np.zeros(effect.size), motion) == (
        "the frames of a Hayati chain are not those of its links, so it cannot bend; use the six-parameter "
        "chain, to which hayati_to_six_parameter converts it exactly"
    )


def test_loads_of_a_hayati_chain_are_given():
    rng = np.random.default_rng(7)
    arrays = random_motion(rng, 6)
    motion, inertia = motion_of(**arrays), inertia_of(**random_inertia(rng, 6))
    hayati, model, six, same = hayati_and_six()
    physics, values = Physics((JointCompliance(2),)), np.array([1e-4])
    with pytest.raises(
        InputError, match=r"^the loads of gravity require the frames of the links; use the six-parameter"
    ):
        predict_poses(hayati, physics, model, values, motion, inertia)
    pulled = loads(six, same.geometry, turn(motion.joint_position), motion.payload, inertia)
    np.testing.assert_allclose(
        predict_poses(hayati, physics, model, values, motion, pulled),
        predict_poses(six, physics, same, values, motion, inertia),
        rtol=0,
        atol=1e-13,
    )
    # no effect depends on them: masses do no harm
    assert isinstance(inertia, Inertia)
    predict_poses(hayati, Physics(), model, np.zeros(0), motion, inertia)


def test_derivatives_by_geometry_and_frames_are_finite_differences():
    rng = np.random.default_rng(8)
    chain = SixParameterForm(2)
    motion, inertia = motion_of(**random_motion(rng, 2, (3,))), inertia_of(**random_inertia(rng, 2))
    model = arm_model(random_kinematics(rng, 2).ravel(), displacement([0.1, 0, 0, 0.1, 0.2, 0.3]), shift(0, 0, 0.1))
    physics = Physics((JointCompliance(2), LinkCompliance(1), LinkThermalExpansion(), MeasurementScale()))
    values = jnp.asarray([1e-3, 2e-3, 1e-3, 1e-4, 1e-3])
    step = jax.tree.map(lambda leaf: jnp.asarray(1e-6 * rng.standard_normal(leaf.shape)), model)

    def predicted(model):
        return predict_poses(chain, physics, model, values, motion, inertia)

    _, slope = jax.jvp(predicted, (model,), (step,))
    ahead, behind = (jax.tree.map(lambda a, b, s=s: a + s * b, model, step) for s in (1, -1))
    np.testing.assert_allclose(slope, (predicted(ahead) - predicted(behind)) / 2, rtol=0, atol=1e-12)
    cotangent = jnp.asarray(rng.standard_normal(slope.shape))
    _, pull = jax.vjp(predicted, model)
    backward = sum(
        jnp.vdot(a, b) for a, b in zip(jax.tree.leaves(pull(cotangent)[0]), jax.tree.leaves(step), strict=True)
    )
    np.testing.assert_allclose(backward, jnp.vdot(cotangent, slope), rtol=1e-9)


@pytest.mark.parametrize("altering", [TimeOffset(), PayloadError(), PayloadCom(), GravityDirection()])
def test_given_loads_cannot_follow_another_clock_or_payload(altering):
    motion = motion_of(**random_motion(np.random.default_rng(9), 6))
    _, _, six, model = hayati_and_six()
    given = Loads(jnp.ones((6, 3, motion.samples)), jnp.ones((3, motion.samples)))
    assert refusal(
        predict_poses, six, Physics((altering, JointCompliance(1))), model, np.zeros(altering.size + 1), motion, given
    ) == (
        f"{altering.label}: changes the loads, and they are given; give the masses instead, with the "
        "six-parameter chain"
    )


def test_what_the_sensor_shows_of_a_motion_to_be_predicted_is_the_rigid_arms_position():
    rng = np.random.default_rng(10)
    arrays = random_motion(rng, 3)
    chain = SixParameterForm(3)
    model = arm_model(random_kinematics(rng, 3).ravel(), displacement([0.1, 0.2, 0, 0.3, 0.2, 0.1]), shift(0, 0, 0.1))
    rigid = predict(chain, model, arrays["joint_position"])
    lens = Unnamed("sensor", "measured position y", -2.0, 2.0, "cubic", "x")
    values = 1e-4 * rng.standard_normal(lens.size)
    found = predict_poses(chain, Physics((lens,)), model, values, motion_of(**arrays))
    shift_x = values @ np.asarray(lens.functions_at(np.asarray(rigid[:, 1, 3])[None]))
    assert np.abs(shift_x).max() > 1e-5
    np.testing.assert_allclose(found[:, 0, 3], rigid[:, 0, 3] + shift_x, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found[:, 1:, 3], rigid[:, 1:, 3], rtol=0, atol=1e-14)
    shown = motion_of(**arrays, measured_position=np.full((len(rigid), 3), np.nan))
    np.testing.assert_array_equal(predict_poses(chain, Physics((lens,)), model, values, shown), found)


def test_readings_that_grow_with_the_distance_are_those_of_a_lens():
    """A radial distortion of second order: p ← (1 + c |p|) p."""
    rng = np.random.default_rng(11)
    arrays, chain = random_motion(rng, 3), SixParameterForm(3)
    model = arm_model(random_kinematics(rng, 3).ravel(), displacement([0.1, 0.2, 0, 0.3, 0.2, 0.1]), shift(0, 0, 0.1))
    p = predict(chain, model, arrays["joint_position"])[:, :3, 3]
    lens = Unnamed("sensor", "measured position's distance", 0.0, 3.0, "line", "scale")
    assert [number.name for number in lens.coordinates] == ["coefficient1", "coefficient2"]
    values = 2e-3 * np.array([1.0, 1.0]) * 1.5  # of 1 and u, with u = |p| / 1.5 - 1
    found = predict_poses(chain, Physics((lens,)), model, values, motion_of(**arrays))
    r = np.linalg.norm(p, axis=1, keepdims=True)
    np.testing.assert_allclose(found[:, :3, 3], p * (1 + 2e-3 * r), rtol=0, atol=1e-13)


def test_a_motion_of_another_arm_is_refused():
    motion = motion_of(np.zeros((2, 3)))
    _, _, six, model = hayati_and_six()
    assert (
        refusal(predict_poses, six, Physics(), model, np.zeros(0), motion)
        == "motion: has 3 joints, and the chain 6; give that arm's motion"
    )
