"""The equivalences of effects: pairs that no recording can tell apart, exactly or to first order."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from lite6jax.arms.chains import SixParameterForm
from lite6jax.arms.description import load_bundled
from lite6jax.arms.se3 import turn
from lite6jax.effects.composition import Physics
from lite6jax.effects.kinematic import (
    AxisWobble,
    FrameOffset,
    GravityDirection,
    JointBacklash,
    JointCompliance,
    JointHarmonic,
    JointLag,
    JointOffset,
    JointScale,
    JointThermalOffset,
    JointWindup,
    LinkCompliance,
    LinkThermalExpansion,
    MeasurementScale,
    PayloadCom,
    PayloadError,
    TimeOffset,
    ToolCompliance,
    ToolOffset,
)
from lite6jax.effects.motion import motion_of
from lite6jax.effects.statics import inertia_of, loads
from lite6jax.model import arm_model, predict, predict_poses
from tests.oracles.arms import random_kinematics
from tests.oracles.effects import random_motion
from tests.oracles.gravity import GRAVITY, random_inertia
from tests.oracles.transforms import displacement

DOF = 3
FORM = SixParameterForm(DOF)
RNG = np.random.default_rng(3)
KINEMATICS = random_kinematics(RNG, DOF)
ARRAYS = random_motion(RNG, DOF)
MOTION, INERTIA = motion_of(**ARRAYS), inertia_of(**random_inertia(RNG, DOF))
MODEL = arm_model(
    KINEMATICS.ravel(), displacement([0.1, 0.2, -0.1, 0.5, -0.3, 0.2]), displacement([0.02, 0.03, 0.1, 0.4, 0.1, 0.7])
)
BARE = arm_model(KINEMATICS.ravel())


def poses(effects, values, model=MODEL, motion=MOTION):
    return predict_poses(FORM, Physics(effects), model, jnp.asarray(values, float), motion, INERTIA)


def slope(effects, direction):
    direction = jnp.asarray(direction, float)
    return jax.jvp(lambda v: poses(effects, v), (jnp.zeros_like(direction),), (direction,))[1]


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_a_joint_offset_is_its_frames_rotation_about_z(joint):
    turned = poses((FrameOffset(joint),), [0, 0, 0, 0, 0, 3e-3])
    np.testing.assert_allclose(poses((JointOffset(joint),), [3e-3]), turned, rtol=0, atol=1e-14)


def test_a_tool_offset_is_the_last_frames_offset():
    twist = [1e-3, -2e-3, 4e-3, 5e-3, -1e-3, 2e-3]
    np.testing.assert_allclose(
        poses((ToolOffset(turned=True),), twist), poses((FrameOffset(DOF),), twist), rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(
        poses((ToolOffset(),), twist[:3]), poses((FrameOffset(DOF),), [*twist[:3], 0, 0, 0]), rtol=0, atol=1e-14
    )


def test_equal_lags_of_all_joints_are_a_time_offset_to_first_order():
    lags = tuple(JointLag(joint) for joint in (1, 2, 3))
    np.testing.assert_allclose(slope(lags, [1.0, 1, 1]), -slope((TimeOffset(),), [1.0]), rtol=0, atol=1e-12)


def test_expansion_at_constant_temperature_is_the_sensors_scale():
    steady = motion_of(ARRAYS["joint_position"], ambient_temperature=np.full(MOTION.samples, 37.0))
    grown = poses((LinkThermalExpansion(),), [2.3e-5], BARE, steady)
    scaled = poses((MeasurementScale(),), [2.3e-5 * 12], BARE, steady)
    np.testing.assert_allclose(grown, scaled, rtol=0, atol=1e-14)


def test_expansions_of_the_links_and_of_what_stands_before_joint_1_are_that_of_all():
    single = tuple(LinkThermalExpansion(link) for link in (1, 2))
    all_but_first = slope(single, [1.0, 1.0])
    warmth = np.asarray(MOTION.temperature_rise)[:, None]
    first = slope((FrameOffset(),), [*KINEMATICS[0, :3], 0, 0, 0])  # along the base's axes, as joint 1's origin is
    whole = slope((LinkThermalExpansion(),), [1.0])
    np.testing.assert_allclose(all_but_first[:, :3, 3] + first[:, :3, 3] * warmth, whole[:, :3, 3], rtol=0, atol=1e-12)


def test_the_sensors_scale_lies_inside_free_lengths():
    scale = 3e-4
    longer = KINEMATICS * np.repeat([1 + scale, 1.0], 3)
    tool, frame = np.array(MODEL.T_flange_tool), np.array(MODEL.T_sensor_base)
    tool[:3, 3] *= 1 + scale
    frame[:3, 3] *= 1 + scale
    rigid = predict(FORM, arm_model(longer.ravel(), frame, tool), ARRAYS["joint_position"])
    np.testing.assert_allclose(poses((MeasurementScale(),), [scale]), rigid, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        (JointOffset(DOF), [1e-2]),
        (JointScale(DOF), [1e-2]),
        (JointHarmonic(DOF, 3.5), [1e-2, 2e-2]),
        (JointCompliance(DOF), [1e-2]),
        (FrameOffset(DOF), [0, 0, 0, 1e-2, 2e-2, 3e-2]),
    ],
    ids=lambda case: getattr(case, "label", ""),
)
def test_the_last_joint_does_not_move_the_flange(effect, values):
    rigid = predict(FORM, BARE, ARRAYS["joint_position"])
    found = poses((effect,), values, BARE)
    np.testing.assert_allclose(found[:, :3, 3], rigid[:, :3, 3], rtol=0, atol=1e-14)
    assert np.abs(found - rigid).max() > 1e-3


def test_a_payload_error_shows_in_a_compliance_alone_and_is_another_payload_there():
    rigid = predict(FORM, MODEL, ARRAYS["joint_position"])
    np.testing.assert_array_equal(poses((PayloadError(),), [0.7]), poses((PayloadError(),), [0.0]))
    np.testing.assert_allclose(poses((PayloadError(),), [0.7]), rigid, rtol=0, atol=1e-14)
    declared = motion_of(**(ARRAYS | {"payload": ARRAYS["payload"] + 0.7}))
    np.testing.assert_allclose(
        poses((PayloadError(), JointCompliance(2)), [0.7, 1e-4]),
        poses((JointCompliance(2),), [1e-4], motion=declared),
        rtol=0,
        atol=1e-14,
    )


def test_another_centre_or_gravity_shows_in_a_compliance_alone_and_is_that_of_other_masses():
    given, soft = random_inertia(np.random.default_rng(4), DOF), (JointCompliance(2),)
    for effect, values, changed in [
        (PayloadCom(), [0.02, -0.01, 0.03], {"payload_center": given["payload_center"] + [0.02, -0.01, 0.03]}),
        (GravityDirection(), [0.01, 0.02], {"gravity": displacement([0, 0, 0, 0.01, 0.02, 0])[:3, :3] @ GRAVITY}),
    ]:
        rigid = predict(FORM, MODEL, ARRAYS["joint_position"])
        np.testing.assert_allclose(poses((effect,), values), rigid, rtol=0, atol=1e-14)
        other = inertia_of(**(given | changed))
        found = predict_poses(
            FORM, Physics((effect, *soft)), MODEL, jnp.array([*values, 1e-4]), MOTION, inertia_of(**given)
        )
        wanted = predict_poses(FORM, Physics(soft), MODEL, jnp.array([1e-4]), MOTION, other)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-14)


def test_friction_above_every_torque_is_plain_backlash_and_a_play_of_no_width_is_a_compliance():
    torque = loads(FORM, MODEL.geometry, turn(MOTION.joint_position), MOTION.payload, INERTIA).torque[1]
    above = 1.01 * float(jnp.abs(torque).max())
    plain, loaded = poses((JointBacklash(2),), [1e-3]), poses((JointBacklash(2, above),), [1e-3])
    np.testing.assert_allclose(plain, loaded, rtol=0, atol=1e-14)
    wound, soft = poses((JointWindup(2, 0.0),), [1e-4]), poses((JointCompliance(2),), [1e-4])
    np.testing.assert_allclose(wound, soft, rtol=0, atol=1e-14)


def test_a_tools_compliance_is_that_of_a_last_link_without_mass():
    light = random_inertia(np.random.default_rng(5), DOF)
    light["mass"][-1] = 0.0
    values = jnp.array([1e-4, 2e-4])
    tool, link = (
        predict_poses(FORM, Physics((effect,)), MODEL, values, MOTION, inertia_of(**light))
        for effect in (ToolCompliance(), LinkCompliance(DOF))
    )
    np.testing.assert_allclose(tool, link, rtol=0, atol=1e-14)
    assert np.abs(tool - predict(FORM, MODEL, ARRAYS["joint_position"])).max() > 1e-6


def test_a_wobble_of_order_1_that_turns_with_the_joint_is_its_links_offset():
    turning = slope((AxisWobble(2),), [1.0, 0, 0, 0, 0, 1.0, 0, 0])
    offset = slope((FrameOffset(2),), [0, 0, 0, 1.0, 0, 0])
    np.testing.assert_allclose(turning, offset, rtol=0, atol=1e-12)


def test_a_thermal_offset_of_joints_in_one_temperature_is_that_of_the_surroundings():
    ambient = ARRAYS["joint_temperature"][:, 0]
    around = motion_of(ARRAYS["joint_position"], ambient_temperature=ambient)
    each = motion_of(ARRAYS["joint_position"], joint_temperature=np.tile(ambient[:, None], DOF))
    values = jnp.array([1e-5])
    one, other = (poses((JointThermalOffset(3),), values, motion=motion) for motion in (around, each))
    np.testing.assert_array_equal(one, other)
    bare = around._replace(joint_temperature_rise=None)  # as of one instant, of which only the arm's is given
    np.testing.assert_array_equal(one, poses((JointThermalOffset(3),), values, motion=bare))


def test_a_harmonic_of_low_order_over_a_short_range_is_an_offset_and_a_scale():
    q = np.linspace(0.4, 0.5, 40)
    columns = np.stack([np.ones_like(q), q], axis=1)
    wave = np.sin(q + 0.3)
    left = wave - columns @ np.linalg.lstsq(columns, wave, rcond=None)[0]
    short = motion_of(np.stack([q, np.zeros_like(q), np.zeros_like(q)], axis=1))
    fitted = np.linalg.lstsq(columns, wave, rcond=None)[0]
    physics = (JointOffset(1), JointScale(1), JointHarmonic(1, 1.0))
    size = 1e-3
    alone = poses(physics, [0, 0, size * np.cos(0.3), size * np.sin(0.3)], motion=short)
    instead = poses(physics, [*(size * fitted), 0, 0], motion=short)
    assert np.abs(alone - instead).max() < 2 * size * np.abs(left).max() + 1e-9
    assert np.abs(left).max() < 1e-3 * np.abs(wave).max()


def test_compliance_of_the_lite6s_joint_2_is_its_first_harmonic_while_the_wrist_holds():
    arm = load_bundled("lite6")
    rng = np.random.default_rng(1)
    q = np.tile([0.0, 0.0, 1.2, 0.4, 0.3, 0.0], (50, 1))
    q[:, :2] = rng.uniform(-2, 2, (50, 2))
    inertia = inertia_of(arm.mass, arm.center_of_mass)
    joint = turn(jnp.asarray(q.T))
    torque = np.asarray(
        loads(SixParameterForm(6), jnp.asarray(arm.kinematics.ravel()), joint, jnp.zeros(50), inertia).torque[1]
    )
    waves = np.stack([np.sin(q[:, 1]), np.cos(q[:, 1])], axis=1)
    left = torque - waves @ np.linalg.lstsq(waves, torque, rcond=None)[0]
    assert np.abs(torque).max() > 3
    assert np.abs(left).max() < 1e-12


def test_two_link_offsets_along_a_joints_axis_are_one():
    # the gauge of the six-parameter chain: a frame may slide along its own z, which the next origin undoes
    slid = poses((FrameOffset(1),), [0, 0, 2e-3, 0, 0, 0])
    rows = KINEMATICS.copy()
    rows[1, 2] += 2e-3
    rigid = predict(FORM, arm_model(rows.ravel(), *MODEL[1:]), ARRAYS["joint_position"])
    np.testing.assert_allclose(slid, rigid, rtol=0, atol=1e-14)
