"""MJCF against MuJoCo: torques of random chains and of bodies, sites and defaults as MuJoCo compiles them; refusals."""

import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from typed import refusal

from lite6jax.arms.arm import Arm
from lite6jax.arms.description import load_bundled
from lite6jax.arms.dynamics import inverse_dynamics, link_parameters
from lite6jax.arms.files import convert_file, omissions, read_arm, write_arm
from lite6jax.arms.mjcf import read_mjcf, write_mjcf
from lite6jax.errors import InputError
from tests.oracles.arms import random_kinematics
from tests.oracles.chains import six_parameter_poses
from tests.oracles.pinocchio_dynamics import random_bodies

INERTIAL = '<inertial pos="0.01 0.02 0.03" mass="2" fullinertia="0.03 0.04 0.05 0.001 0.002 0.003"/>'
HINGE = '<joint name="j" axis="0 0 1"/>'


def random_arm(rng, joints):
    mass, center, inertia = random_bodies(rng, joints)
    return Arm(
        "random <arm>",
        random_kinematics(rng, joints),
        joint_limits=np.tile([-1.5, 2.5], (joints, 1)),
        T_joint_flange=np.eye(4),
        mass=mass,
        center_of_mass=center,
        inertia=(inertia + np.swapaxes(inertia, 1, 2)) / 2,
        viscous_friction=rng.uniform(0, 2, joints),
        coulomb_friction=rng.uniform(0, 2, joints),
        rotor_inertia=rng.uniform(0, 0.1, joints),
    )


def mujoco_torques(model, q, dq, ddq):
    """(joint, sample) of the rigid bodies alone, without armature and passive forces."""
    data, torques = mujoco.MjData(model), []
    model.dof_armature[:] = 0
    for row in zip(q.T, dq.T, ddq.T, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = row
        mujoco.mj_inverse(model, data)
        torques.append(data.qfrc_inverse + data.qfrc_passive + data.qfrc_constraint)
    return np.array(torques).T


def write(tmp_path, *bodies, head="", name="arm.xml"):
    path = tmp_path / name
    path.write_text(f"<mujoco>{head}<worldbody>{''.join(bodies)}</worldbody></mujoco>")
    return path


@pytest.mark.parametrize("joints", [1, 4, 7])
def test_torques_of_a_written_chain_are_mujocos(joints, tmp_path):
    rng = np.random.default_rng(joints)
    arm = random_arm(rng, joints)
    model = mujoco.MjModel.from_xml_path(str(write_mjcf(arm, tmp_path / "arm.xml")))
    for field, theirs in (
        ("viscous_friction", model.dof_damping),
        ("coulomb_friction", model.dof_frictionloss),
        ("rotor_inertia", model.dof_armature),
    ):
        np.testing.assert_array_equal(getattr(arm, field), theirs)
    np.testing.assert_array_equal(model.jnt_range, arm.joint_limits)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    motion = rng.normal(0, 1, (3, joints, 20))
    torques = inverse_dynamics(arm.kinematics, link_parameters(arm), *motion, model.opt.gravity)
    np.testing.assert_allclose(torques, mujoco_torques(model, *motion), rtol=0, atol=1e-10)


ODD = """
<mujoco model="odd"><compiler angle="degree"/>
<default><joint damping="0.3" axis="0 1 0"/>
 <default class="wrist"><joint armature="0.02" range="-90 90"/></default></default>
<worldbody><body name="stand" pos="0.1 0.2 0.3" euler="10 20 30"><geom size="0.1" mass="5"/>
 <body name="a" pos="0 0 0.2" quat="0.5 0.1 -0.7 0.2">
  <joint name="j1" pos="0.02 0.01 0" ref="25" frictionloss="0.4"/>
  <joint name="j2" pos="0 0.03 0.01" axis="1 2 -3" stiffness="3" springref="20"/>
  <geom type="box" size="0.02 0.03 0.1" pos="0.01 0 0.1" mass="1.5"/>
  <body name="cover" pos="0.05 0 0.1" euler="0 90 20"><inertial pos="0.01 0 0" mass="0.4" diaginertia="3e-3 2e-3 2e-3"/>
   <body name="b" pos="0.1 0.02 0.05" euler="3 0 80"><joint name="j3" class="wrist"/>
    <geom type="capsule" size="0.03 0.1" density="700"/>
    <body name="hand" pos="0 0 0.2"><geom size="0.03" mass="0.2"/>
     <site name="grasp" pos="0 0 0.07" euler="0 0 45"/></body>
   </body></body></body></body></worldbody></mujoco>
"""


def test_an_arm_is_what_mujoco_compiles(tmp_path):
    path = tmp_path / "odd.xml"
    path.write_text(ODD)
    model = mujoco.MjModel.from_xml_string(ODD)
    data = mujoco.MjData(model)
    arm = read_arm(f"{path}#grasp")
    assert (arm.name, arm.dof, arm.source) == ("odd", 3, "MJCF odd.xml, world to grasp")
    rng = np.random.default_rng(3)
    q, dq, ddq = rng.normal(0, 1, (3, 3, 20))
    for row in q.T:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        flange = six_parameter_poses(arm.kinematics, row) @ arm.T_joint_flange
        np.testing.assert_allclose(flange[:3, 3], data.site("grasp").xpos, rtol=0, atol=1e-12)
        np.testing.assert_allclose(flange[:3, :3].ravel(), data.site("grasp").xmat, rtol=0, atol=1e-12)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    torques = inverse_dynamics(arm.kinematics, link_parameters(arm), q, dq, ddq, model.opt.gravity)
    np.testing.assert_allclose(torques, mujoco_torques(model, q, dq, ddq), rtol=0, atol=1e-10)
    np.testing.assert_array_equal(arm.viscous_friction, [0.3] * 3)
    np.testing.assert_array_equal(arm.coulomb_friction, [0.4, 0, 0])
    np.testing.assert_array_equal(arm.rotor_inertia, [0, 0, 0.02])
    np.testing.assert_allclose([arm.spring_stiffness, arm.spring_rest], [[0, 3, 0], [0, np.deg2rad(20), 0]])
    turns = [-2 * np.pi, 2 * np.pi]
    np.testing.assert_allclose(arm.joint_limits, [turns, turns, [-np.pi / 2, np.pi / 2]], rtol=1e-15)
    assert read_mjcf(path, base="stand", tip="hand").source == "MJCF odd.xml, stand to hand"


def test_convert_writes_mjcf_and_says_what_it_leaves_out(tmp_path):
    done = convert_file("lite6", tmp_path / "arm.xml")
    assert (done.form, done.left_out) == ("mjcf", ("the published DH table",))
    assert done.difference < 1e-14
    rotors = write_arm(random_arm(np.random.default_rng(0), 2), tmp_path / "arm.yaml")
    assert convert_file(rotors, tmp_path / "arm.urdf").left_out == ("rotor inertia",)
    assert convert_file(rotors, tmp_path / "again.xml").left_out == ()
    drives = ["viscous friction", "Coulomb friction", "rotor inertia"]
    assert omissions(read_arm(rotors), "vendor") == ["joint limits, masses and inertia", *drives]
    with pytest.raises(InputError, match="the form table holds a chain only; write description, urdf, mjcf"):
        convert_file(load_bundled("lite6"), tmp_path / "arm.json")


def test_missing_meshes_do_not_matter_where_inertia_is_given(tmp_path):
    head = '<asset><mesh name="shell" file="gone.stl"/></asset>'
    shell = '<geom type="mesh" mesh="shell"/>'
    path = write(tmp_path, f'<body name="a">{HINGE}{INERTIAL}{shell}</body>', head=head)
    np.testing.assert_array_equal(read_arm(path).mass, [2])
    path = write(tmp_path, f'<body name="a">{HINGE}{shell}</body>', head=head, name="hollow.xml")
    assert refusal(read_arm, path) == f"{path}: MuJoCo refuses it (Error opening file 'gone.stl'); correct the file"


ARM = f'<body name="a">{HINGE}{INERTIAL}'


@pytest.mark.parametrize(
    ("body", "tip", "message"),
    [
        ("<body>", None, "MuJoCo refuses it (XML parse error"),
        (
            f'<body name="a"><freejoint name="f"/>{INERTIAL}</body>',
            None,
            "joint 'f' is neither hinge nor slide, which an arm here is made of; name a chain without it with --base",
        ),
        (f"{ARM}</body>".replace('mass="2"', 'mass="nan"'), None, "has a number that is not finite; correct it"),
        (f"{ARM}</body>".replace("0.05 ", "0.5 "), None, "MuJoCo refuses it (inertia must satisfy A + B >= C"),
        (f"{ARM}</body>", "hand", "has no body 'hand'; the bodies are world, a"),
        (f'{ARM}</body><body name="b"/>', "b", "no joint moves between 'world' and 'b'; name another"),
        ('<body name="a"/>', None, "no joint moves below 'world'; name another"),
        (
            f'{ARM}<site name="s"/><body name="x"/><body name="y" pos="1 0 0"/></body>',
            None,
            "the chain could end at x (1 joint), y (1 joint), s; say which as arm.xml#x, or in convert with --tip x",
        ),
    ],
)
def test_refusals_name_the_place_and_the_remedy(body, tip, message, tmp_path):
    path = write(tmp_path, body)
    assert refusal(read_mjcf, path, tip=tip).startswith(f"{path}: {message}")


def test_a_tip_must_be_below_its_base(tmp_path):
    path = write(tmp_path, f'{ARM}</body><body name="b"/>')
    assert "'a' is not below 'b'; name another base or tip, " in refusal(read_mjcf, path, base="b", tip="a")


def test_a_written_spring_pulls_as_that_of_the_arm(tmp_path):
    rng = np.random.default_rng(5)
    stiffness, rest = rng.uniform(1, 9, 4), rng.uniform(-1, 1, 4)
    arm = replace(random_arm(rng, 4), spring_stiffness=stiffness, spring_rest=rest)
    path = write_mjcf(arm, tmp_path / "arm.xml")
    again = read_mjcf(path)
    np.testing.assert_allclose(again.spring_stiffness, stiffness, rtol=1e-12)
    np.testing.assert_allclose(again.spring_rest, rest, rtol=1e-12)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:] = rng.uniform(-1, 1, 4)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_spring, -stiffness * (data.qpos - rest), rtol=1e-9)


def test_without_the_package_the_line_names_the_extra(tmp_path, monkeypatch):
    path = write(tmp_path, f"{ARM}</body>")
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert refusal(read_arm, path) == f"{path}: MJCF files take the package mujoco; pip install 'lite6jax[mjcf]'"
    made = path.with_name("made.xml")
    assert "pip install 'lite6jax[mjcf]'" in refusal(convert_file, "lite6", made)
    assert not made.exists()


@pytest.mark.parametrize("prolog", ['<?xml version="1.0"?>', "<!-- <mujoco> -->", ""])
def test_xml_is_urdf_or_mjcf_by_its_root(prolog, tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(prolog + f"<mujoco><worldbody>{ARM}</body></worldbody></mujoco>")
    assert read_arm(path).source.startswith("MJCF")
    path.write_text(prolog + '<robot name="r"><link name="a"/></robot>')
    assert "no joint moves below 'a'" in refusal(read_arm, path)


def test_mujoco_takes_no_link_without_inertia(tmp_path):
    path = tmp_path / "arm.xml"
    bare = Arm("bare", np.zeros((1, 6)))
    assert refusal(write_mjcf, bare, path) == (
        f"{path}: MuJoCo needs the mass and inertia of every link, which bare lacks; give inertia_kg_m2 in its"
        " description, or write a .urdf"
    )
    point = Arm("point", np.zeros((1, 6)), mass=[1], center_of_mass=np.zeros((1, 3)), inertia=np.zeros((1, 3, 3)))
    with pytest.raises(InputError, match="MuJoCo takes link1 of point for massless or impossible; its mass and princ"):
        write_mjcf(point, path)
    assert not path.exists()
