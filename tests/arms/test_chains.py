import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typed import refusal

from lite6jax.arms import frames
from lite6jax.arms.chains import HayatiForm, SixParameterForm, fk, hayati_fk, hayati_form_of, six_parameter_fk
from lite6jax.arms.description import load_bundled
from lite6jax.errors import InputError
from lite6jax.model import ModelForm, arm_model, predict
from tests.oracles.arms import (
    LITE6_DH,
    parameters_of_table,
    perturbed,
    random_kinematics,
    random_positions,
    table_of_parameters,
)
from tests.oracles.chains import hayati_poses, six_parameter_poses
from tests.oracles.pinocchio_arm import pinocchio_poses
from tests.oracles.transforms import origin_transform, rotate, shift

EXACT = 2e-14
LITE6 = HayatiForm(6, (1,))
seeds = st.integers(0, 2**32 - 1)
arms = pytest.mark.parametrize("dof", range(2, 9))


@arms
@given(seed=seeds)
def test_six_parameter_chain_agrees_with_numpy_and_pinocchio(dof, seed):
    rng = np.random.default_rng(seed)
    kinematics, positions = random_kinematics(rng, dof), random_positions(rng, 3, dof)
    poses = six_parameter_fk(kinematics, positions)
    np.testing.assert_allclose(poses, six_parameter_poses(kinematics, positions), atol=EXACT)
    np.testing.assert_allclose(poses, pinocchio_poses(kinematics, positions), atol=EXACT)


@pytest.mark.parametrize("form", [LITE6, HayatiForm(6, (1, 2)), HayatiForm(7), HayatiForm(3, (0, 1)), HayatiForm(2)])
@given(seed=seeds)
def test_hayati_chain_agrees_with_the_product_of_matrices(form, seed):
    rng = np.random.default_rng(seed)
    base, dh = rng.uniform(-1, 1, 4), rng.uniform(-2, 2, (form.dof, 4))
    dh[list(form.parallel), 1] = 0
    betas = rng.uniform(-1, 1, len(form.parallel))
    positions = random_positions(rng, 3, form.dof)
    poses = hayati_fk(form, parameters_of_table(form, base, dh, betas), positions)
    expected = hayati_poses(base, dh, dict(zip(form.parallel, betas, strict=True)), positions)
    np.testing.assert_allclose(poses, expected, atol=5 * EXACT)


def test_zero_pose_of_the_seed():
    parameters = parameters_of_table(LITE6, np.zeros(4), LITE6_DH, [0.0])
    for T in (
        hayati_fk(LITE6, parameters, np.zeros(6)),
        six_parameter_fk(load_bundled("lite6").kinematics, np.zeros(6)),
    ):
        # (87, 0, 154) mm, to the millimetre in which the seed states it: 243.3 + 200 - 227.6 - 61.5 = 154.2
        np.testing.assert_allclose(T[:3, 3], [0.087, 0, 0.1542], atol=1e-15)
        np.testing.assert_allclose(T[:3, :3], np.diag([1, -1, -1]), atol=1e-15)


@pytest.mark.parametrize("form", [LITE6, SixParameterForm(7)])
def test_leading_axes_jit_and_vmap(form):
    rng = np.random.default_rng(2)
    parameters = rng.uniform(-1, 1, (2, form.size))
    positions = random_positions(rng, 6, form.dof).reshape(2, 3, form.dof)
    poses = np.asarray(fk(form, parameters[0], positions))
    assert poses.shape == (2, 3, 4, 4)
    assert fk(form, parameters[0], positions[:0]).shape == (0, 3, 4, 4)
    one = fk(form, parameters[0], positions[1, 2])
    assert one.shape == (4, 4)
    np.testing.assert_allclose(one, poses[1, 2], atol=EXACT)
    many = jax.jit(jax.vmap(lambda p: fk(form, p, positions)))(parameters)
    np.testing.assert_allclose(many[0], poses, atol=EXACT)
    np.testing.assert_allclose(many[1], fk(form, parameters[1], positions), atol=EXACT)
    over_positions = jax.vmap(jax.vmap(lambda q: fk(form, parameters[0], q)))(positions)
    np.testing.assert_allclose(over_positions, poses, atol=EXACT)


def test_predict_puts_the_sensor_in_front_and_the_tool_behind():
    rng = np.random.default_rng(3)
    kinematics, positions = random_kinematics(rng, 6), random_positions(rng, 4, 6)
    T_sensor_base, T_flange_tool = (origin_transform(row) for row in random_kinematics(rng, 2))
    chain = SixParameterForm(6)
    poses = predict(chain, arm_model(kinematics.ravel(), T_sensor_base, T_flange_tool), positions)
    expected = T_sensor_base @ six_parameter_poses(kinematics, positions) @ T_flange_tool
    np.testing.assert_allclose(poses, expected, atol=EXACT)
    plain = predict(chain, arm_model(kinematics.ravel()), positions)
    np.testing.assert_allclose(plain, six_parameter_poses(kinematics, positions), atol=EXACT)


# The parameters


def test_lite6_parameters_stand_in_the_seeds_order():
    names = "base_x base_y base_roll base_pitch theta_off1 d1 a1 alpha1 theta_off2 a2 alpha2 theta_off3 d3 a3 alpha3 "
    names += "theta_off4 d4 a4 alpha4 theta_off5 d5 a5 alpha5 theta_off6 d6 a6 alpha6 beta2"
    assert LITE6.names == tuple(names.split())
    assert (LITE6.size, len(LITE6.units)) == (28, 28)
    expected = ["m", "m", "rad", "rad"] + ["rad", "m", "m", "rad"] * 6 + ["rad"]
    del expected[9]
    assert LITE6.units == tuple(expected)
    # the seed's own packing: x = [base, table without d2, beta2]
    parameters = parameters_of_table(LITE6, [1, 2, 3, 4], LITE6_DH, [5])
    np.testing.assert_array_equal(parameters, [1, 2, 3, 4, *np.delete(LITE6_DH.ravel(), 5), 5])


def test_model_steps_are_named():
    form = ModelForm(LITE6, frame=True, tool=True)
    assert form.size == len(form.names) == len(form.units) == 40
    assert form.names[28:34] == ("frame_x", "frame_y", "frame_z", "frame_rx", "frame_ry", "frame_rz")
    assert form.names[34:] == ("tool_x", "tool_y", "tool_z", "tool_rx", "tool_ry", "tool_rz")
    assert form.units[28:] == ("m", "m", "m", "rad", "rad", "rad") * 2


@pytest.mark.parametrize(
    ("name", "parallel"),
    [
        ("lite6", (1,)),
        ("xarm5", (1, 2)),
        ("xarm6", (1,)),
        ("xarm7", ()),
        ("uf850", (1,)),
        ("ur10", (1, 2)),
        ("ur3e", (1, 2)),
    ],
)
def test_parallel_pairs_are_found(name, parallel):
    kinematics = load_bundled(name).kinematics
    assert hayati_form_of(kinematics) == HayatiForm(len(kinematics), parallel)
    # a calibration tilts them, which changes nothing; antiparallel axes count too
    tilted = kinematics + np.deg2rad(1.0) * np.random.default_rng(0).uniform(-1, 1, kinematics.shape)
    assert hayati_form_of(tilted).parallel == parallel


@given(seed=seeds)
def test_joint_axes_are_the_lines_about_which_the_joints_turn(seed):
    rng = np.random.default_rng(seed)
    kinematics = random_kinematics(rng, 4)
    axes = frames.frames_at_zero(kinematics)
    points, directions = axes[:, :3, 3], axes[:, :3, 2]
    zero = six_parameter_poses(kinematics, np.zeros((1, 4)))[0]
    for i in range(4):
        q = np.zeros((1, 4))
        q[0, i] = rng.uniform(-3, 3)
        motion = six_parameter_poses(kinematics, q)[0] @ np.linalg.inv(zero)
        np.testing.assert_allclose(motion[:3, :3] @ points[i] + motion[:3, 3], points[i], atol=EXACT)
        about = pin.AngleAxis(q[0, i], directions[i]).toRotationMatrix()
        np.testing.assert_allclose(motion[:3, :3], about, atol=EXACT)


ABSENT = f"this form has no such parameter; its are {LITE6.names}"
REFUSED = [
    (lambda: HayatiForm(6, (5,)), "parallel joints (5,): give each once, in order, from 0 to 4"),
    (lambda: HayatiForm(6, first_axis=3), "first_axis joints (3,): give each once, in order, from 0 to 2"),
    (
        lambda: HayatiForm(6, sliding=(0,), first_axis=1),
        "first_axis joints (1,): give each once, in order, from 2 to 2",
    ),
    (lambda: HayatiForm(6, (2, 1)), "parallel joints (2, 1): give each once, in order, from 0 to 4"),
    (lambda: LITE6.pack(np.zeros(4), np.zeros((6, 6))), "base (4,), links (6, 6): this form takes (6,) and (6, 6)"),
    (lambda: parameters_of_table(LITE6, np.zeros(4), LITE6_DH + 0.5, [0]), f"d2 is 0.5, and {ABSENT}"),
    (lambda: table_of_parameters(LITE6, np.zeros(27)), "parameters of shape (27,): this form takes (28,)"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED)
def test_refusals(call, message):
    assert refusal(call) == message


# What flange poses determine


def sensitivity(form, model, positions):
    """(pose entries, step): the derivatives of every entry of every pose by `ModelForm`'s step."""

    def entries(step):
        return predict(form.chain, form.retract(model, step), positions)[:, :3].ravel()

    quick = {"xla_backend_optimization_level": 0}  # most of the time goes into compiling
    return np.asarray(jax.jit(jax.jacfwd(entries), compiler_options=quick)(jnp.zeros(form.size)))


def rank(J):
    """The rank, which must stand out: the last singular value that counts is far above the first that does not."""
    s = np.linalg.svd(J / np.maximum(np.linalg.norm(J, axis=0), 1e-12), compute_uv=False)
    count = int(np.sum(s > 1e-9 * s[0]))
    assert s[count - 1] > 1e-5 * s[0]
    assert np.all(s[count:] < 1e-13 * len(J) ** 0.5 * s[0])
    return count


def generic_model(chain, seed):
    rng = np.random.default_rng(seed)
    frame, tool = (origin_transform(row) for row in random_kinematics(rng, 2))
    return arm_model(rng.uniform(-1, 1, chain.size), frame, tool), random_positions(rng, 60, chain.dof)


@pytest.mark.parametrize("axis", range(3))
@given(seed=seeds)
def test_the_base_leads_to_joint_1_along_any_of_its_axes(axis, seed):
    rng = np.random.default_rng(seed)
    form = HayatiForm(3, (1,), (), axis)
    parameters, positions = rng.uniform(-1, 1, form.size), random_positions(rng, 3, 3)
    given = dict(zip(form.names, parameters, strict=True))
    x, y, z, yaw, pitch, roll = (given.get(f"base_{name}", 0.0) for name in ("x", "y", "z", "yaw", "pitch", "roll"))
    # the quarter turns that take z to the axis, and x and y to the two that follow it
    turned = (
        rotate("y", np.pi / 2) @ rotate("z", np.pi / 2),
        rotate("x", -np.pi / 2) @ rotate("z", -np.pi / 2),
        np.eye(4),
    )
    base = shift(x, y, z) @ rotate("z", yaw) @ rotate("y", pitch) @ rotate("x", roll) @ turned[axis]
    _, dh, betas = table_of_parameters(form, parameters)
    expected = base @ hayati_poses(np.zeros(4), dh, {1: betas[0]}, positions)
    np.testing.assert_allclose(hayati_fk(form, parameters, positions), expected, atol=EXACT)


@pytest.mark.parametrize("dof", [3, 6, 7])
def test_ranks_at_generic_geometry(dof):
    n = 4 * dof
    six, hayati = SixParameterForm(dof), HayatiForm(dof, (1,))
    model, positions = generic_model(six, dof)
    assert rank(sensitivity(ModelForm(six), model, positions)) == n + 2
    # with a frame in front nothing is gained, as joint 1's origin is general; with a tool behind, the flange is
    assert rank(sensitivity(ModelForm(six, frame=True), model, positions)) == n + 2
    assert rank(sensitivity(ModelForm(six, tool=True), model, positions)) == n + 6
    model, positions = generic_model(hayati, dof)
    for frame in (False, True):
        assert rank(sensitivity(ModelForm(hayati, frame=frame), model, positions)) == n + 4
        assert rank(sensitivity(ModelForm(hayati, frame=frame, tool=True), model, positions)) == n + 6


def test_ranks_at_the_nominal_lite6_are_26_28_and_30():
    positions = random_positions(np.random.default_rng(5), 60, 6)
    rng, kinematics = np.random.default_rng(8), load_bundled("lite6").kinematics
    calibrated = arm_model(perturbed(rng, kinematics).ravel())
    assert rank(sensitivity(ModelForm(SixParameterForm(6)), calibrated, positions)) == 26
    # exactly at nominal joint 2's pitch is -90 deg, where roll and yaw are one: the numbers lose a rank that the
    # geometry keeps
    nominal = arm_model(kinematics.ravel())
    assert rank(sensitivity(ModelForm(SixParameterForm(6)), nominal, positions)) == 25
    hayati = arm_model(parameters_of_table(LITE6, np.zeros(4), LITE6_DH, [0]))
    assert rank(sensitivity(ModelForm(LITE6), hayati, positions)) == 28
    assert rank(sensitivity(ModelForm(LITE6, tool=True), hayati, positions)) == 30
    assert rank(sensitivity(ModelForm(LITE6, frame=True, tool=True), hayati, positions)) == 30
    # standard DH loses one where axes are parallel: d2 and d3 do the same
    standard = HayatiForm(6)
    by_table = arm_model(parameters_of_table(standard, np.zeros(4), LITE6_DH))
    assert rank(sensitivity(ModelForm(standard), by_table, positions)) == 27


def test_chains_refuse_numbers_of_another_shape():
    form = HayatiForm(6, (1,))
    with pytest.raises(InputError, match=r"parameters \(24,\) and joint_position \(6,\): this chain takes \(28,\) and"):
        hayati_fk(form, np.zeros(24), np.zeros(6))
    with pytest.raises(InputError, match=r"joint_position \(5, 7\)"):
        hayati_fk(form, np.zeros(28), np.zeros((5, 7)))
    with pytest.raises(InputError, match=r"kinematics of shape \(6, 5\): give \(joint, 6\)"):
        six_parameter_fk(np.zeros((6, 5)), np.zeros(6))
