"""URDF against Pinocchio: odd axes, fixed joints, branches, files with other numbers; and every refusal's message."""

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typed import refusal, refused, run

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import load_bundled
from lite6jax.arms.dynamics import inverse_dynamics, link_parameters
from lite6jax.arms.files import read_arm
from lite6jax.arms.urdf import read_urdf, write_into_urdf, write_urdf
from lite6jax.errors import InputError, InputWarning
from tests.oracles.chains import six_parameter_poses
from tests.oracles.pinocchio_arm import urdf_link_pose
from tests.oracles.pinocchio_dynamics import pinocchio_torques, random_bodies
from tests.oracles.transforms import rotate


def flange_pose(arm, q):
    return six_parameter_poses(arm.kinematics, q) @ arm.T_joint_flange


def joint(name, parent, child, kind="revolute", xyz="0 0 0", rpy="0 0 0", axis="0 0 1", extra=""):
    limit = '<limit lower="-2" upper="3" effort="1" velocity="1"/>' if kind in ("revolute", "prismatic") else ""
    axis = f'<axis xyz="{axis}"/>' if axis else ""
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/><parent link="{parent}"/>'
        f'<child link="{child}"/>{axis}{limit}{extra}</joint>'
    )


def link(name):
    return f'<link name="{name}"/>'


def write(tmp_path, *parts, name="arm.urdf", robot="arm"):
    path = tmp_path / name
    path.write_text(f'<?xml version="1.0"?><robot name="{robot}">{"".join(parts)}</robot>')
    return path


ODD = (
    [link(name) for name in ("world", "base", "a", "a_cover", "b", "c", "d", "tool")]
    + [joint("weld", "world", "base", "fixed", xyz="0.1 -0.2 0.3", rpy="0.3 -0.4 2")]
    + [joint("j1", "base", "a", xyz="0 0 0.2", rpy="0.1 0.2 0.3", axis="0 0 -1")]
    + [joint("cover", "a", "a_cover", "fixed", xyz="0.05 0 0.1", rpy="0 1.5707963267948966 0")]
    + [joint("j2", "a_cover", "b", xyz="0.1 0.02 0", axis="1 0 0")]
    + [joint("j3", "b", "c", "continuous", xyz="0 0.3 0", rpy="0 -1.5707963267948966 0.2", axis="0 -1 0")]
    + [joint("j4", "c", "d", xyz="0.2 0 0.01", axis="1 -2 -3")]
    + [joint("flange", "d", "tool", "fixed", xyz="0 0 0.07", rpy="1 2 3")]
)


def test_odd_axes_and_fixed_joints_agree_with_pinocchio(tmp_path):
    path = write(tmp_path, *ODD)
    arm, pose = read_urdf(path), urdf_link_pose(path, "tool")
    assert arm.dof == 4
    assert arm.source == "URDF arm.urdf, world to tool"
    for q in np.random.default_rng(2).uniform(-3, 3, (50, 4)):
        np.testing.assert_allclose(flange_pose(arm, q), pose(q), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(arm.joint_limits[[0, 1, 3]], [[-2, 3]] * 3)
    np.testing.assert_array_equal(arm.joint_limits[2], [-2 * np.pi, 2 * np.pi])


@pytest.mark.parametrize("axis", ["1 0 0", "-1 0 0", "0 1 0", "0 -1 0", "0 0 1", "0 0 -1", "1e-9 0 -1", "0.6 0 0.8"])
@pytest.mark.parametrize("kind", ["revolute", "continuous"])
def test_every_axis_keeps_the_joint_angle_and_its_sign(axis, kind, tmp_path):
    parts = [link("base"), link("a"), link("tip")]
    parts += [joint("j", "base", "a", kind, xyz="0.1 0.2 0.3", rpy="0 0 0.5", axis=axis)]
    path = write(tmp_path, *parts, joint("f", "a", "tip", "fixed", xyz="0.3 0.2 0.1"))
    arm, pose = read_urdf(path), urdf_link_pose(path, "tip")
    for q in (-2.5, -0.3, 0.0, 1.2):
        np.testing.assert_allclose(flange_pose(arm, [q]), pose([q]), rtol=0, atol=1e-14)


def test_a_joint_without_axis_turns_about_x_as_urdf_says(tmp_path):
    path = write(tmp_path, link("base"), link("a"), joint("j", "base", "a", axis=""))
    np.testing.assert_allclose(flange_pose(read_urdf(path), [0.4])[:3, :3], rotate("x", 0.4)[:3, :3], atol=1e-15)


finite = st.floats(-3, 3)
rows = st.lists(st.lists(finite, min_size=6, max_size=6), min_size=1, max_size=7)


@settings(deadline=None, max_examples=50)
@given(
    rows=rows,
    flange=st.none() | rows,
    seed=st.integers(0, 2**32 - 1),
    known=st.lists(st.booleans(), min_size=4, max_size=4),
)
def test_round_trip_is_exact(tmp_path_factory, rows, flange, seed, known):
    n, rng = len(rows), np.random.default_rng(seed)
    mass, center, inertia = random_bodies(rng, n)
    massive, solid, viscous, coulomb = known
    arm = Arm(
        name='a<&>"b',
        kinematics=np.array(rows),
        joint_limits=np.array([[-1.0 - i / 7, 0.1 + i / 3] for i in range(n)]),
        T_joint_flange=None if flange is None else frames.transform_from_row(flange[0]),
        mass=mass if massive else None,
        center_of_mass=center if massive else None,
        inertia=(inertia + np.swapaxes(inertia, 1, 2)) / 2 if massive and solid else None,
        viscous_friction=rng.uniform(0, 2, n) if viscous else None,
        coulomb_friction=rng.uniform(0, 2, n) if coulomb else None,
    )
    back = read_urdf(write_urdf(arm, tmp_path_factory.mktemp("urdf") / "arm.urdf"))
    assert back.name == arm.name
    np.testing.assert_allclose(back.T_joint_flange, arm.T_joint_flange, rtol=0, atol=2e-15 if flange else 0)
    exact = ("kinematics", "joint_limits", "mass", "center_of_mass", "inertia", "viscous_friction", "coulomb_friction")
    for field in exact:
        np.testing.assert_equal(getattr(back, field), getattr(arm, field))


def branched(tmp_path, tail_rpy="0 0 0"):
    parts = [link(name) for name in ("base_link", "base", "a", "ft_frame", "tool0")]
    parts += [joint("j1", "base_link", "a"), joint("b", "base_link", "base", "fixed")]
    parts += [joint("f", "a", "ft_frame", "fixed", rpy=tail_rpy), joint("t", "a", "tool0", "fixed")]
    return write(tmp_path, *parts)


def test_frames_at_one_place_are_one_tip(tmp_path):
    assert read_urdf(branched(tmp_path)).dof == 1


def test_the_tip_can_be_named_in_the_path(tmp_path):
    path = branched(tmp_path, "3.14159 0 0")
    message = (
        f"{path}: the chain could end at ft_frame (1 joint), tool0 (1 joint); say which as arm.urdf#ft_frame, or "
        "in convert with --tip ft_frame"
    )
    assert refusal(read_urdf, path) == message
    np.testing.assert_array_equal(read_arm(f"{path}#tool0").T_joint_flange, np.eye(4))
    np.testing.assert_allclose(read_arm(f"{path}#ft_frame").T_joint_flange[1, 1], -1)


def test_a_gripper_is_a_branch_until_the_tip_is_named(tmp_path, capsys):
    parts = [link(name) for name in ("base", "a", "hand", "left", "right")]
    parts += [joint("j1", "base", "a"), joint("j2", "a", "hand"), joint("l", "hand", "left", "prismatic")]
    parts += [joint("r", "hand", "right", "prismatic", extra='<mimic joint="l"/>')]
    path = write(tmp_path, *parts)
    assert refusal(read_urdf, path) == (
        f"{path}: the chain could end at hand (2 joints), left (3 joints), right (3 joints); say which as "
        "arm.urdf#hand, or in convert with --tip hand"
    )
    assert run(capsys, "convert", path, tmp_path / "arm.yaml", "--tip", "hand")[0] == 0
    assert read_arm(tmp_path / "arm.yaml").dof == read_arm(f"{path}#hand").dof == 2
    said = refused(capsys, "convert", f"{path}#hand", tmp_path / "p.yaml", "--tip", "hand")
    assert "names base or tip already; leave out --base and --tip, or what follows #" in said
    said = refused(capsys, "convert", "lite6", tmp_path / "p.yaml", "--base", "torso")
    assert said == "lite6: --base and --tip choose a chain of a URDF or MJCF; leave them out"
    assert read_urdf(path, tip="hand").dof == 2
    assert read_urdf(path, tip="left").sliding == (2,)
    assert read_urdf(path, base="a", tip="hand").dof == 1
    coupled = (
        r"joint 'r' is coupled: it mimics 1 times 'l'; .*, name a chain without it with --tip hand, or as arm.urdf#hand"
    )
    with pytest.raises(InputError, match=coupled):
        read_urdf(path, tip="right")
    with pytest.raises(InputError, match="'hand' is not below 'left'; name another base or tip, "):
        read_urdf(path, base="left", tip="hand")
    assert "has no link 'nose'; the links are base, a, hand, left, right" in refusal(read_urdf, path, tip="nose")
    assert "has no link 'nose'; the links are base, a, hand, left, right" in refusal(read_urdf, path, base="nose")
    assert "no joint moves below 'left'; name another, " in refusal(read_urdf, path, base="left")
    with pytest.raises(InputError, match="no joint moves between 'a' and 'a'; name another base or tip, "):
        read_urdf(path, base="a", tip="a")


def tiago():
    """Two wheels, a torso that rises, on it a head of two joints and an arm of seven with a gripper."""
    names = (
        "base_footprint",
        "base_link",
        "wheel_left_link",
        "wheel_right_link",
        "torso_fixed_link",
        "torso_lift_link",
    )
    names += ("head_1_link", "head_2_link", "xtion_link", "arm_tool_link", "gripper_link")
    parts = [link(name) for name in (*names, *(f"arm_{i}_link" for i in range(1, 8)))]
    parts += [joint("base", "base_footprint", "base_link", "fixed")]
    for side in ("left", "right"):
        parts += [joint(f"wheel_{side}_joint", "base_link", f"wheel_{side}_link", "continuous")]
    parts += [joint("torso_fixed", "base_link", "torso_fixed_link", "fixed", xyz="-0.06 0 0.2")]
    parts += [joint("torso_lift_joint", "torso_fixed_link", "torso_lift_link", "prismatic", xyz="0 0 0.6")]
    parts += [
        joint("head_1_joint", "torso_lift_link", "head_1_link"),
        joint("head_2_joint", "head_1_link", "head_2_link"),
    ]
    parts += [joint("xtion", "head_2_link", "xtion_link", "fixed")]
    for i in range(1, 8):
        parent = f"arm_{i - 1}_link" if i > 1 else "torso_lift_link"
        parts += [joint(f"arm_{i}_joint", parent, f"arm_{i}_link", xyz="0.1 0 0", rpy="1.5 0 0")]
    parts += [joint("arm_tool_joint", "arm_7_link", "arm_tool_link", "fixed", rpy="-1.57 0 0")]
    parts += [joint("gripper_joint", "arm_tool_link", "gripper_link", "fixed")]
    for finger in ("left", "right"):
        name = f"gripper_{finger}_finger"
        parts += [link(f"{name}_link"), joint(f"{name}_joint", "gripper_link", f"{name}_link", "prismatic")]
    return parts


def test_a_tree_with_a_torso_names_the_arm_with_and_without_it(tmp_path):
    path = write(tmp_path, *tiago(), name="tiago.urdf")
    assert refusal(read_urdf, path) == (
        f"{path}: the chain could end at gripper_link (8 joints), wheel_left_link (1 joint), wheel_right_link (1 "
        "joint), xtion_link (3 joints), gripper_left_finger_link (9 joints), gripper_right_finger_link (9 joints); "
        "say which as tiago.urdf#gripper_link, or in convert with --tip gripper_link; without torso_lift_joint: "
        "tiago.urdf#torso_lift_link:gripper_link, or --base torso_lift_link --tip gripper_link"
    )
    whole, arm = read_arm(f"{path}#gripper_link"), read_arm(f"{path}#torso_lift_link:gripper_link")
    assert (whole.dof, whole.sliding, arm.dof, arm.sliding) == (8, (0,), 7, ())
    pose = urdf_link_pose(path, "gripper_link")
    q = np.random.default_rng(1).uniform(-0.5, 0.5, 8)
    poses = frames.chain(whole.links, q, whole.sliding) @ whole.T_joint_flange
    at = pin.buildModelFromUrdf(str(path))
    ours = [f"arm_{i}_joint" for i in range(1, 8)]
    order = {"torso_lift_joint": q[0]} | dict(zip(ours, q[1:], strict=True))
    np.testing.assert_allclose(poses, pose([order.get(name, 0.0) for name in list(at.names)[1:]]), rtol=0, atol=1e-12)


TWO = [link("base"), link("a")]


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ([*TWO, joint("j", "base", "a", axis="0 0 0")], "joint 'j': its axis has no direction; write a unit vector"),
        ([*TWO, joint("j", "base", "a", xyz="0 0")], "joint 'j': origin xyz is '0 0'; write three numbers"),
        ([*TWO, joint("j", "base", "a", rpy="0 0 pi")], "joint 'j': origin rpy has 'pi', which is not a number"),
        ([*TWO, joint("j", "base", "a", xyz="0 0 nan")], "joint 'j': origin xyz has 'nan', which is not finite"),
        ([*TWO, joint("j", "base", "a", "floating")], "joint 'j' is floating; an arm here has revolute and"),
        ([*TWO, joint("j", "base", "gone")], "joint 'j' names the link 'gone', which is not there; add it"),
        ([*TWO, joint("j", "base", "a"), joint("k", "base", "a")], "the link 'a' has two parents; a URDF is a tree"),
        ([*TWO, link("b"), joint("j", "base", "a")], "has not one root link (base, b); name one, "),
        ([*TWO, joint("j", "base", "a"), joint("k", "a", "base")], "(none: the joints form a loop)"),
        ([link("base"), link("a"), joint("j", "base", "a", "fixed")], "no joint moves below 'base'"),
        ([*TWO, joint("j", "base", "a").replace('lower="-2"', "")], "joint 'j': lacks <limit lower=\"…\">; add it"),
        ([*TWO, joint("j", "base", "a").replace('upper="3"', 'upper="-4"')], "joint1's limits -2 … -4 rad are empty"),
        ([*TWO, joint("", "base", "a")], "a joint has no name; give it one"),
        ([*TWO, '<joint name="j" type="revolute"><child link="a"/></joint>'], "joint 'j': lacks <parent link=\"…\">"),
        ([*TWO, joint("j", "base", "a", xyz="${d} 0 0")], "is xacro, not yet a URDF; expand it first: xacro arm.urdf"),
    ],
)
def test_refusals_name_the_place_and_the_remedy(parts, message, tmp_path):
    path = write(tmp_path, *parts)
    said = refusal(read_urdf, path)
    assert said.startswith(f"{path}: ")
    assert message in said


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<!DOCTYPE r [<!ENTITY a "b">]><robot name="r">&a;</robot>', "declares a document type or entities"),
        ("<robot", "line 1: not valid XML (unclosed token"),
        ("q1,q2\n1,2\n", "line 1: not valid XML (syntax error"),
        ("", "not valid XML (no element found"),
        ("<sdf/>", "its root is <sdf>, not <robot>; a URDF is needed here"),
        (
            '<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:macro name="m"/></robot>',
            "is xacro, not yet a URDF; expand it first: xacro other.xacro > arm.urdf",
        ),
    ],
)
def test_not_a_urdf(text, message, tmp_path):
    path = tmp_path / "other.xacro"
    path.write_text(text)
    said = refusal(read_arm, path)
    assert said.startswith(f"{path}: ")
    assert message in said


def test_an_expanded_xacro_may_keep_its_namespace(tmp_path):
    path = write(tmp_path, *TWO, joint("j", "base", "a"))
    path.write_text(path.read_text().replace("<robot ", '<robot xmlns:xacro="http://ros.org/wiki/xacro" '))
    assert read_urdf(path).dof == 1


def test_deep_nesting_and_large_files_are_refused_or_harmless(tmp_path):
    path = tmp_path / "deep.urdf"
    path.write_text("<robot>" + "<a>" * 200_000 + "</a>" * 200_000 + "</robot>")
    assert "has not one root link" in refusal(read_urdf, path)
    path.write_text("<robot>" + " " * (1 << 23) + "</robot>")
    assert "larger than 8388608 bytes" in refusal(read_urdf, path)


# --- inertia and friction ---


def heavy(name, mass, com="0 0 0", rpy="0 0 0", six=(0.03, 0.001, -0.002, 0.04, 0.003, 0.05)):
    tensor = " ".join(
        f'{key}="{value}"' for key, value in zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), six, strict=True)
    )
    inertial = f'<inertial><origin xyz="{com}" rpy="{rpy}"/><mass value="{mass}"/><inertia {tensor}/></inertial>'
    return f'<link name="{name}">{inertial}</link>'


def test_torques_of_rotated_inertia_and_fixed_bodies_are_pinocchios(tmp_path):
    parts = [heavy("base", 9), heavy("a", 2, "0.1 0 0.02", "0.3 -0.2 1"), heavy("cover", 1, "0 0.05 0.1", "0 1 0.4")]
    parts += [heavy("b", 3, "0 0.2 0", "1 1 1"), link("bare"), heavy("hand", 0.5, "0.01 0.02 0.03", "0.5 0 0")]
    parts += [heavy("bolt", 0.2, "0 0.1 0"), link("tool")]
    parts += [joint("j1", "base", "a", axis="0 -1 0", rpy="0.2 0 0", extra='<dynamics damping="0.7" friction="0.2"/>')]
    parts += [joint("weld", "a", "cover", "fixed", xyz="0 0.5 0", rpy="1.2 0.3 0")]
    parts += [joint("j2", "a", "b", xyz="0.3 0 0", axis="1 2 -3"), joint("f1", "b", "bare", "fixed", xyz="0 0 0.1")]
    parts += [joint("f2", "bare", "hand", "fixed", rpy="0 0 1"), joint("f3", "hand", "bolt", "fixed", xyz="0.1 0 0")]
    path = write(tmp_path, *parts, joint("f4", "hand", "tool", "fixed", xyz="0.1 0 0"))
    arm = read_urdf(path, tip="tool")
    np.testing.assert_array_equal(arm.mass, [3, 3.7])
    np.testing.assert_array_equal(arm.viscous_friction, [0.7, 0])
    np.testing.assert_array_equal(arm.coulomb_friction, [0.2, 0])
    model = pin.buildModelFromUrdf(str(path))
    rng = np.random.default_rng(7)
    motion = rng.normal(0, 2, (3, 2, 20))
    torques = inverse_dynamics(arm.kinematics, link_parameters(arm), *motion, model.gravity.linear)
    np.testing.assert_allclose(torques, pinocchio_torques(model, *motion), rtol=0, atol=1e-10)


def test_inertia_of_zeros_is_unknown(tmp_path):
    parts = [link("base"), heavy("a", 1, six=[0] * 6), joint("j", "base", "a")]
    arm = read_urdf(write(tmp_path, *parts))
    assert arm.inertia is None
    np.testing.assert_array_equal(arm.mass, [1])


def test_an_impossible_tensor_is_left_out_with_a_warning(tmp_path):
    parts = [link("base"), heavy("a", 1, six=[1, 0, 0, 1, 0, 5]), joint("j", "base", "a")]
    path = write(tmp_path, *parts)
    with pytest.warns(InputWarning) as warned:
        arm = read_urdf(path)
    assert arm.inertia is None
    assert str(warned[0].message) == (
        f"{path}: link 'a': its inertia has the principal moments 1, 1, 5 kg·m², the largest of which exceeds the sum"
        " of the others, as no body's does; the inertia of this file is left out, correct it to diagnose torques"
    )


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (heavy("a", 1, six=["x", 0, 0, 1, 0, 1]), "link 'a': inertial: ixx has 'x', which is not a number; correct it"),
        ('<link name="a"><inertial/></link>', "link 'a': inertial: lacks <mass value=\"…\">; add it"),
    ],
)
def test_a_spoilt_inertial_names_the_link(part, message, tmp_path):
    path = write(tmp_path, link("base"), part, joint("j", "base", "a"))
    assert refusal(read_urdf, path) == f"{path}: {message}"


def test_spoilt_friction_names_the_joint(tmp_path):
    path = write(tmp_path, *TWO, joint("j", "base", "a", extra='<dynamics damping="much"/>'))
    message = "joint 'j': dynamics: damping has 'much', which is not a number; correct it"
    assert refusal(read_urdf, path) == f"{path}: {message}"
    path = write(tmp_path, *TWO, joint("j", "base", "a", extra='<dynamics friction="-1"/>'))
    assert "joint1's Coulomb friction is negative; correct it" in refusal(read_urdf, path)


def test_a_written_arm_is_whole_for_gazebo_and_moveit(tmp_path):
    """Gazebo drops a link without mass with all that it carries, and holds a joint whose effort or velocity is 0."""
    spring = {"spring_stiffness": np.array([0, 2.5, 0, 0, 0, 0]), "spring_rest": np.array([0, 0.1, 0, 0, 0, 0])}
    robot = ET.parse(write_urdf(replace(load_bundled("lite6"), **spring), tmp_path / "arm.urdf")).getroot()
    links = {link.get("name"): link for link in robot.findall("link")}
    fixed = {
        (j.find("parent").get("link"), j.find("child").get("link")) for j in robot.iterfind("joint[@type='fixed']")
    }
    assert fixed == {("world", "base_link"), ("link6", "flange")}
    for name in links.keys() - {"world", "flange"}:  # a link fixed to another one is lumped with it
        assert float(links[name].find("inertial/mass").get("value")) > 0
    for joint in robot.iterfind("joint[@type='revolute']"):
        assert min(float(joint.find("limit").get(key)) for key in ("effort", "velocity")) > 100
    assert robot.find("gazebo[@reference='joint2']/springStiffness").text == "2.5"
    assert robot.find("gazebo[@reference='joint2']/springReference").text == "0.1"
    assert all({*entry.attrib} <= {"damping", "friction"} for entry in robot.iter("dynamics"))  # what URDF knows
    chain = replace(load_bundled("lite6"), mass=None, center_of_mass=None, inertia=None)
    assert "world" not in write_urdf(chain, tmp_path / "chain.urdf").read_text()


def test_springs_are_read_and_written_as_gazebo_has_them(tmp_path):
    spring = "<gazebo reference='j'><springStiffness>2.5</springStiffness></gazebo>"
    path = write(tmp_path, *TWO, joint("j", "base", "a"), spring)
    arm = read_urdf(path)
    assert (arm.spring_stiffness.tolist(), arm.spring_rest.tolist()) == ([2.5], [0])
    write_into_urdf(replace(arm, spring_rest=np.array([0.2])), path, tmp_path / "new.urdf")
    again = read_urdf(tmp_path / "new.urdf")
    assert (again.spring_stiffness.tolist(), again.spring_rest.tolist()) == ([2.5], [0.2])
    path = write(tmp_path, *TWO, joint("j", "base", "a"), spring.replace("2.5", "much"))
    assert "joint 'j': dynamics: springStiffness has 'much', which is not a number" in refusal(read_urdf, path)


# --- an existing file with other numbers ---


def moved(rng, row):
    """A row a millimetre and a milliradian away."""
    return frames.row_from_transform(
        frames.transform_from_row(row) @ frames.transform_from_row(1e-3 * rng.normal(size=6))
    )


@pytest.fixture
def robot(tmp_path):
    """Odd axes, a fixed joint in the chain, bodies fixed and moving beside it, and a tip after a fixed joint."""
    parts = [link("base"), heavy("a", 2, "0.1 0 0.02", "0.3 -0.2 1"), heavy("cover", 1, "0 0.05 0.1", "0 1 0.4")]
    parts += [heavy("b", 3, "0 0.2 0", "1 1 1"), heavy("hand", 0.5, "0.01 0.02 0.03", "0.5 0 0"), link("tool")]
    parts += [joint("j1", "base", "a", axis="0 -1 0", rpy="0.2 0 0", extra='<dynamics damping="0.7"/>')]
    parts += [joint("weld", "a", "cover", "fixed", xyz="0 0.5 0", rpy="1.2 0.3 0")]
    parts += [joint("j2", "cover", "b", xyz="0.3 0 0", axis="1 2 -3"), joint("f2", "b", "hand", "fixed", rpy="0 0 1")]
    parts += [heavy("finger", 0.2, "0 0.01 0.04", "0 0.2 0"), heavy("pad", 0.1, "0 0 0.02", "1 0 0")]
    parts += [joint("finger", "hand", "finger", "prismatic", xyz="0 0.02 0.06", rpy="0.1 0 0", axis="0 1 0")]
    parts += [joint("pad", "finger", "pad", xyz="0 0 0.05")]
    return write(tmp_path, *parts, joint("f4", "hand", "tool", "fixed", xyz="0.1 0 0"))


def pinocchio_without_fingers(path):
    """The arm of a file with `finger` and `pad` held at zero."""
    model = pin.buildModelFromUrdf(str(path))
    return pin.buildReducedModel(model, [model.getJointId("finger"), model.getJointId("pad")], pin.neutral(model))


def test_what_an_arm_carries_on_joints_beside_its_chain_weighs_on_it(robot):
    arm, model = read_urdf(robot, tip="tool"), pinocchio_without_fingers(robot)
    motion = np.random.default_rng(1).normal(0, 2, (3, 2, 20))
    torques = inverse_dynamics(arm.kinematics, link_parameters(arm), *motion, model.gravity.linear)
    np.testing.assert_allclose(torques, pinocchio_torques(model, *motion), rtol=0, atol=1e-10)


def test_the_file_is_the_arm(robot, tmp_path):
    rng = np.random.default_rng(0)
    old = read_urdf(robot, tip="tool")
    tail = frames.transform_from_row(moved(rng, frames.row_from_transform(old.T_joint_flange)))
    arm = replace(
        old,
        kinematics=np.array([moved(rng, row) for row in old.kinematics]),
        T_joint_flange=tail,
        mass=old.mass * 1.1,
        center_of_mass=old.center_of_mass + 0.01,
        inertia=old.inertia * 1.2,
        viscous_friction=np.array([0.9, 0.4]),
        rotor_inertia=np.array([0.1, 0.1]),
    )
    path = tmp_path / "new.urdf"
    assert write_into_urdf(arm, robot, path, tip="tool") == ["rotor inertia"]
    q = rng.uniform(-2, 2, (10, 2))
    at = np.pad(q, [(0, 0), (0, 2)])
    shown = np.array([urdf_link_pose(path, "tool")(row) for row in at])
    np.testing.assert_allclose(shown, six_parameter_poses(arm.kinematics, q) @ tail, rtol=0, atol=1e-12)
    motion = rng.normal(0, 2, (3, 2, 20))
    model = pinocchio_without_fingers(path)
    wanted = inverse_dynamics(arm.kinematics, link_parameters(arm), *motion, model.gravity.linear)
    assert ET.parse(path).find("link[@name='finger']/inertial/mass").get("value") == "0.2"
    np.testing.assert_allclose(pinocchio_torques(model, *motion), wanted, rtol=0, atol=1e-10)
    assert '<dynamics damping="0.9"' in path.read_text()
    np.testing.assert_array_equal(read_urdf(path, tip="tool").viscous_friction, [0.9, 0.4])


def test_what_does_not_change_stays_as_it_is_written(robot, tmp_path):
    arm = replace(read_urdf(robot, tip="tool"), viscous_friction=None, mass=None, center_of_mass=None, inertia=None)
    path = tmp_path / "new.urdf"
    assert write_into_urdf(arm, robot, path, tip="tool") == []
    assert (
        path.read_text().split("\n", 1)[1].replace(" ", "")
        == robot.read_text().split("?>", 1)[1].replace(" ", "") + "\n"
    )


def test_a_chain_without_a_fixed_joint_at_its_end_keeps_it(tmp_path):
    robot = write(tmp_path, link("base"), link("a"), joint("j1", "base", "a"))
    arm = read_urdf(robot)
    arm = replace(arm, T_joint_flange=frames.transform_from_row([0, 0, 0.1, 0, 0, 0]))
    left_out = write_into_urdf(arm, robot, tmp_path / "new.urdf")
    assert left_out == ["what follows the last joint (no fixed joint leads to a)"]


def test_another_number_of_joints_is_refused(robot, tmp_path):
    arm = read_urdf(robot, tip="a")
    with pytest.raises(InputError, match=r"has 2 joints from base to tool, but arm has 1"):
        write_into_urdf(arm, robot, tmp_path / "new.urdf", tip="tool")
