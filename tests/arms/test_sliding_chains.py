"""Chains with prismatic joints against Pinocchio and MuJoCo: kinematics, parameters, files, dynamics; their units."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from typed import refusal

from lite6jax.arms.arm import LEVER, Arm, as_revolute, by_kind, joint_size, joint_sizes, joint_unit
from lite6jax.arms.chains import (
    BASE,
    HayatiForm,
    SixParameterForm,
    hayati_fk,
    hayati_form_of,
    joint_motion,
    six_parameter_fk,
)
from lite6jax.arms.description import read_description
from lite6jax.arms.dh import hayati_to_six_parameter, read_table, six_parameter_to_hayati
from lite6jax.arms.dynamics import base_parameters, inverse_dynamics, link_parameters, regressor
from lite6jax.arms.files import convert_file, read_arm, read_mjcf, read_urdf, write_arm, write_mjcf, write_urdf
from lite6jax.calibration.residual import Observations, linearise, residuals
from lite6jax.effects.statics import inertia_of, loads
from lite6jax.errors import InputError
from lite6jax.model import ModelForm, arm_model
from tests.oracles.pinocchio_arm import urdf_link_pose
from tests.oracles.pinocchio_dynamics import pinocchio_torques
from tests.oracles.sliding_arms import ARMS

EXACT = 1e-12
QUICK = {"xla_backend_optimization_level": 0}


@pytest.fixture(scope="module", params=ARMS)
def described(request, tmp_path_factory):
    """The file, the arm, Pinocchio's flange, and joint positions in rad and m."""
    path = tmp_path_factory.mktemp("arms") / f"{request.param}.urdf"
    path.write_text(ARMS[request.param])
    arm = read_urdf(path)
    rng = np.random.default_rng(len(request.param))
    return path, arm, urdf_link_pose(path, "tool"), rng.uniform(-2, 2, (12, arm.dof))


few = pytest.mark.parametrize("described", ["rail", "spline"], indirect=True)  # what is slow to compile


def flange(arm, q):
    return np.asarray(six_parameter_fk(arm.kinematics, q, arm.sliding)) @ arm.T_joint_flange


def perturbed(arm, seed=0):
    rng = np.random.default_rng(seed)
    return arm.kinematics + rng.normal(0, [1e-3] * 3 + [2e-3] * 3, (arm.dof, 6))


def test_every_reader_and_writer_agrees_with_pinocchio(described, tmp_path):
    path, arm, pose, q = described
    expected = np.array([pose(row) for row in q])
    np.testing.assert_array_equal(arm.joint_limits, [[-0.8, 0.9]] * arm.dof)
    written = {
        "urdf": write_urdf(arm, tmp_path / "arm.urdf"),
        "mjcf": write_mjcf(arm, tmp_path / "arm.xml"),
        "yaml": write_arm(arm, tmp_path / "arm.yaml"),
        "into": convert_file(replace(arm, kinematics=perturbed(arm)), tmp_path / "into.urdf", into=path).path,
    }
    for form, file in written.items():
        back = read_arm(file)
        assert back.sliding == arm.sliding
        np.testing.assert_array_equal(back.joint_limits, arm.joint_limits)
        if form == "into":
            shown = urdf_link_pose(file, "tool")
            expected_there = np.array([shown(row) for row in q])
            np.testing.assert_allclose(flange(back, q), expected_there, rtol=0, atol=EXACT)
        else:
            np.testing.assert_allclose(flange(back, q), expected, rtol=0, atol=EXACT)
    np.testing.assert_allclose(flange(arm, q), expected, rtol=0, atol=EXACT)


def test_the_effective_model_has_the_parameters_that_poses_show(described):
    """4 a revolute and 2 a prismatic joint, and 4 (Everett, Driels and Mooring, 1987); all of them, and no more."""
    _, arm, _, q = described
    rows = perturbed(arm)
    form = arm.form
    assert form.size == len(form.names) == 4 * arm.dof + 4 - 2 * len(arm.sliding)
    parameters = six_parameter_to_hayati(form, rows, arm.hayati)
    poses = np.asarray(six_parameter_fk(rows, q, arm.sliding))
    np.testing.assert_allclose(hayati_fk(form, parameters, q), poses, rtol=0, atol=EXACT)
    back, after = hayati_to_six_parameter(form, parameters)
    np.testing.assert_allclose(np.asarray(six_parameter_fk(back, q, arm.sliding)) @ after, poses, rtol=0, atol=EXACT)
    np.testing.assert_array_equal(form.pack(*form.unpack(parameters)), parameters)
    assert np.abs(parameters - arm.hayati).max() < 0.05  # no polar angle of two axes that are nearly one


@pytest.mark.parametrize("described", ["rail", "spline", "column"], indirect=True)
def test_poses_determine_all_parameters_and_twists_are_their_derivatives(described):
    _, arm, _, q = described
    form, parameters = arm.form, six_parameter_to_hayati(arm.form, perturbed(arm), arm.hayati)
    model, identified = arm_model(parameters), ModelForm(form)

    def entries(step):
        return hayati_fk(form, parameters + step, q)[:, :3].ravel()

    J = np.asarray(jax.jit(jax.jacfwd(entries), compiler_options=QUICK)(jnp.zeros(form.size)))
    s = np.linalg.svd(J, compute_uv=False)
    assert s[-1] > 1e-4 * s[0]
    observed = Observations(
        joint_motion(form, q.T), jnp.zeros((3, len(q))), jnp.zeros((3, 3, 0)), jnp.ones(len(q)), jnp.ones(2)
    )
    *_, curvature = linearise(identified, model, observed, None)
    differentiated = jax.jit(
        jax.jacfwd(lambda step: residuals(identified, identified.retract(model, step), observed)),
        compiler_options=QUICK,
    )(jnp.zeros(form.size))
    J = np.asarray(differentiated).reshape(-1, form.size)
    np.testing.assert_allclose(curvature, J.T @ J, rtol=0, atol=1e-11 * len(q))


def test_the_table_keeps_every_number(described, tmp_path):
    path, arm, _, _ = described
    done = convert_file(path, tmp_path / "arm.json", nominal=arm)
    table = read_table(done.path)
    assert table.form == arm.form
    np.testing.assert_array_equal(table.parameters, arm.hayati)
    assert done.difference < EXACT


@few
def test_forces_and_torques_are_pinocchios(described):
    path, arm, _, _ = described
    model = pin.buildModelFromUrdf(str(path))
    motion = np.random.default_rng(3).normal(0, 1, (3, arm.dof, 20))
    expected = pinocchio_torques(model, *motion)
    gravity = model.gravity.linear
    ours = inverse_dynamics(arm.kinematics, link_parameters(arm), *motion, gravity, arm.sliding)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-10)
    W = regressor(arm.kinematics, *motion, gravity, arm.sliding)
    np.testing.assert_allclose(np.einsum("jps,p->js", W, link_parameters(arm).ravel()), expected, rtol=0, atol=1e-10)
    base = base_parameters(arm.kinematics, gravity, arm.sliding)
    W = np.asarray(W)[:, base.independent]
    by_base = np.einsum("jps,p->js", W, base.values(link_parameters(arm)))
    np.testing.assert_allclose(by_base, expected, rtol=0, atol=1e-8)


@few
def test_loads_of_gravity_and_motion_are_those_of_points(described):
    """Against Pinocchio, of masses without inertia tensors, as loads are."""
    _, arm, _, _ = described
    points = replace(arm, inertia=np.zeros((arm.dof, 3, 3)))
    motion = np.random.default_rng(4).normal(0, 1, (3, arm.dof, 5))
    gravity = np.array([1.0, 2.0, -9.0])
    expected = -inverse_dynamics(arm.kinematics, link_parameters(points), *motion, gravity, arm.sliding)
    form = SixParameterForm(arm.dof, arm.sliding)
    inertia = inertia_of(arm.mass, arm.center_of_mass, gravity=gravity)
    q, dq, ddq = map(jnp.asarray, motion)
    found = loads(form, jnp.asarray(arm.kinematics.ravel()), joint_motion(form, q), jnp.zeros(5), inertia, dq, ddq)
    np.testing.assert_allclose(found.torque, expected, rtol=0, atol=1e-10)


DESCRIPTION = """
name: quill
kinematics:
  joint1: {x: 0, y: 0, z: 0.3, roll: 0, pitch: 0, yaw: 0}
  joint2: {type: prismatic, x: 0.2, y: 0, z: 0, roll: 3.141592653589793, pitch: 0, yaw: 0}
joint_limits: [[-2, 2], [0, 0.3]]
dynamics:
  joint1: {friction: {viscous_Nm_s_per_rad: 1, coulomb_Nm: 2}, rotor_inertia_kg_m2: 3}
  joint2:
    {friction: {viscous_N_s_per_m: 4, coulomb_N: 5}, rotor_mass_kg: 6, spring: {stiffness_N_per_m: 7, rest_m: 0.1}}
"""


def test_a_description_says_which_joints_are_prismatic(tmp_path):
    path = tmp_path / "arm.yaml"
    path.write_text(DESCRIPTION)
    arm = read_description(path)
    assert (arm.sliding, arm.joint_units, arm.dof) == ((1,), ("rad", "m"), 2)
    assert arm.reach == pytest.approx(0.3 + 0.2 + 0.3)
    np.testing.assert_array_equal(
        [arm.viscous_friction, arm.coulomb_friction, arm.rotor_inertia], [[1, 4], [2, 5], [3, 6]]
    )
    np.testing.assert_array_equal([arm.spring_stiffness, arm.spring_rest], [[0, 7], [0, 0.1]])
    again = read_description(write_arm(arm, tmp_path / "again.yaml"))
    for field in ("kinematics", "joint_limits", "sliding", "viscous_friction", "rotor_inertia", "spring_rest"):
        np.testing.assert_array_equal(getattr(again, field), getattr(arm, field))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("type: prismatic", "type: slide", "joint2: type is 'slide'; write revolute or prismatic"),
        ("joint_limits:", "joint_limits_rad:", "joint2 is prismatic; name the list joint_limits, in m for prismatic"),
        ("[0, 0.3]", "[0, 300]", "joint2's limits 0 … 300 are beyond any arm, so they seem to be in millimetres"),
        ("viscous_N_s_per_m", "viscous_Nm_s_per_rad", "dynamics: joint2: friction has the unknown key 'viscous_Nm"),
    ],
)
def test_a_spoilt_description_names_the_remedy(old, new, message, tmp_path):
    path = tmp_path / "arm.yaml"
    path.write_text(DESCRIPTION.replace(old, new))
    assert message in refusal(read_description, path)


def test_forms_refuse_what_they_have_no_place_for():
    form = HayatiForm(3, (0,), (1,))
    with pytest.raises(InputError, match="sliding joints \\(2, 1\\): give each once, in order, from 0 to 2"):
        HayatiForm(3, (), (2, 1))
    with pytest.raises(InputError, match="d1 is 2, and this form has no such parameter"):
        form.pack(np.zeros(len(BASE)), [[0, 2, 0, 0, 0, 0]] + [[0] * 6] * 2)
    with pytest.raises(InputError, match="sliding is \\(1, 0\\); give prismatic joints in order, from 0 to 1"):
        Arm("a", np.zeros((2, 6)), sliding=(1, 0))
    with pytest.raises(InputError, match="a DH table is of revolute joints, and it has others; leave dh out"):
        Arm("a", np.zeros((2, 6)), sliding=(1,), dh=np.zeros((2, 4)))
    rows = np.zeros((2, 6))
    rows[1] = [0.2, 0, 0, 1.0, 0, 0]
    with pytest.raises(InputError, match="joints 1 and 2: their axes are not parallel as this form expects"):
        six_parameter_to_hayati(HayatiForm(2, (0,), (1,)), rows)
    assert hayati_form_of(rows, (1,)).parallel == ()


def test_mjcf_slides_start_at_their_reference(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><worldbody><body name="a" pos="0.1 0 0"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        '<joint name="s" type="slide" axis="0 1 0" ref="0.2" range="-1 2" armature="3"/></body></worldbody></mujoco>'
    )
    arm = read_mjcf(path)
    assert arm.sliding == (0,)
    np.testing.assert_array_equal(arm.joint_limits, [[-1, 2]])
    np.testing.assert_allclose(flange(arm, np.array([[0.5]]))[0, :3, 3], [0.1, 0.3, 0], atol=1e-15)
    assert arm.rotor_inertia == [3]


# ------------------------------------------------------------------ units


@pytest.mark.parametrize(
    ("revolute", "prismatic", "power"),
    [
        ("Nm", "N", -1),
        ("rad", "m", 1),
        ("rad/s²", "m/s²", 1),
        ("Nm·s/rad", "N·s/m", -2),
        ("Nm·s/rad/K", "N·s/m/K", -2),
        ("Nm/rad", "N/m", -2),
        ("kg·m²", "kg", -2),
        ("1", "1", 0),
    ],
)
def test_a_prismatic_joint_has_the_unit_and_size_at_the_lever(revolute, prismatic, power):
    assert joint_unit(revolute, True) == prismatic
    assert joint_unit(revolute, False) == revolute
    # a pinion of this radius: a shift is LEVER times an angle, and a force is a torque over LEVER
    assert joint_size(3.0, revolute, True) == pytest.approx(3.0 * LEVER**power)
    assert joint_size(3.0, revolute, False) == 3.0


@pytest.mark.parametrize(
    ("revolute", "prismatic"),
    [
        ("viscous_Nm_s_per_rad", "viscous_N_s_per_m"),
        ("viscous_Nm_s_per_rad_K", "viscous_N_s_per_m_K"),
        ("inertia_kg_m2", "mass_kg"),
        ("rotor_inertia_kg_m2", "rotor_mass_kg"),
        ("rest_rad", "rest_m"),
        ("coefficient", "coefficient"),
        ("heldout_torque_rms_Nm", "heldout_torque_rms_N"),
        ("radius_m", "radius_m"),
    ],
)
def test_names_have_the_unit_of_their_joint(revolute, prismatic):
    assert joint_unit(revolute, True) == prismatic


def test_sizes_by_joint():
    slides = np.array([False, True])
    np.testing.assert_allclose(joint_sizes(0.02, "rad", slides), [0.02, 0.002])
    values = np.array([[0.02, 0.04], [0.002, 0.004]])
    np.testing.assert_allclose(as_revolute(values, "rad", slides), [[0.02, 0.04], [0.02, 0.04]])
    np.testing.assert_allclose(as_revolute(values[1], "rad", True), [0.02, 0.04])
    assert by_kind("moves_Nm", values, slides, np.max) == {"moves_Nm": 0.04, "moves_N": 0.004}
    assert by_kind("moves_Nm", values, ~slides & False, np.max) == {"moves_Nm": 0.04}
