"""Files that people bring: a controller's deviations, DH tables of any convention and length, URDFs with jaws."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typed import flat, refusal, refused, run

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import HayatiForm
from lite6jax.arms.description import load_bundled
from lite6jax.arms.dh import read_table, six_parameter_to_hayati, write_table
from lite6jax.arms.files import read_arm, read_factory, read_urdf, write_arm, write_urdf
from lite6jax.errors import InputError, InputWarning
from tests.arms.test_urdf import joint, link, write
from tests.oracles.arms import parameters_of_table, perturbed, table_of_parameters
from tests.oracles.chains import hayati_poses, six_parameter_poses
from tests.oracles.transforms import rotate, shift

Q = frames.sample_joints(6)
STANDARD = HayatiForm(6)
DOCUMENT = Path(__file__).parents[2] / "docs/reference/arms.md"


def flange(calibration, q=Q):
    return six_parameter_poses(calibration.kinematics, q) @ calibration.T_joint_flange


def individual(name, seed=0):
    """A real arm of a model of Universal Robots: its DH table, of axes that are no longer quite parallel."""
    arm = load_bundled(name)
    rows = perturbed(np.random.default_rng(seed), arm.kinematics)
    rows[0, 3:5] = 0.0  # the controller's base is on joint 1's axis
    rows[0, :2] = 0.0
    nominal = parameters_of_table(STANDARD, np.zeros(4), arm.dh)
    _, dh, _ = table_of_parameters(STANDARD, six_parameter_to_hayati(STANDARD, rows, nominal))
    assert np.abs(dh[:, 1]).max() > 5  # metres
    return arm, rows, dh


def deviations(path, delta, status=2):
    lines = ["[mounting]"]
    for k, name in enumerate(("theta", "d", "a", "alpha")):
        lines.append(f"delta_{name} = [ {', '.join(repr(float(value)) for value in delta[:, k])}]")
    lines += ["joint_checksum = [ 0x6e, 0xa3, 0xf6, 0x9e, 0xa1, 0xb2]"]
    lines += [f"calibration_status = {status} # 0 == notInitialized / 1 == notLinearised / 2 == Linearised"]
    path.write_text("\n".join(lines) + "\n")
    return path


# --- calibration.conf of Universal Robots ---


@pytest.mark.parametrize("name", ["ur3e", "ur5", "ur10e", "ur16e"])
def test_deviations_of_a_controller_are_the_arm_exactly(name, tmp_path):
    arm, rows, dh = individual(name)
    path = deviations(tmp_path / "calibration.conf", dh - arm.dh)
    calibration = read_factory(path, arm)
    np.testing.assert_allclose(flange(calibration), six_parameter_poses(rows, Q), atol=1e-11)
    # each frame stands where the nominal arm has it
    assert np.abs(calibration.kinematics - arm.kinematics)[:, :3].max() < 0.02


def test_the_size_of_an_arm_is_recognised_by_its_deviations_and_its_series_assumed(tmp_path):
    for seed, (name, others) in enumerate({"ur5": ("ur5", "ur5e"), "ur3e": ("ur3", "ur3e")}.items()):
        arm, _, dh = individual(name, seed)
        path = deviations(tmp_path / "calibration.conf", dh - arm.dh)
        with pytest.warns(InputWarning) as said:
            calibration = read_factory(path)
        assert calibration.arm.name == others[1]
        (message,) = (str(each.message) for each in said)
        assert re.search(rf"fit {others[0]}e? \(.* mm\) and {others[0]}e? \(.* mm\) RMS alike", message)
        assert message.endswith(f"a {others[1]}, the newer, is assumed, name `arm='{others[0]}'` if it is one")
    arm, _, dh = individual("ur16e", 3)  # of a size that no other model has
    assert read_factory(deviations(tmp_path / "calibration.conf", dh - arm.dh)).arm.name == "ur16e"


def test_deviations_that_tell_no_model_are_asked_for(tmp_path):
    path = deviations(tmp_path / "calibration.conf", np.zeros((6, 4)))
    with pytest.raises(InputError, match=r"does not name its model, and its deviations do not tell it: .*name it with"):
        read_factory(path)
    np.testing.assert_allclose(flange(read_factory(path, load_bundled("ur5e"))), flange_of("ur5e"), atol=1e-12)
    arm, _, dh = individual("ur5e")
    path = deviations(path, dh - arm.dh)
    with pytest.raises(
        InputError, match=r"its deviations are not those of a ur10e: its flange would be \d+ mm RMS off"
    ):
        read_factory(path, load_bundled("ur10e"))
    with pytest.raises(
        InputError, match=r"of a model of Universal Robots, which xarm7 does not have; name one with `arm=NAME`"
    ):
        read_factory(path, load_bundled("xarm7"))


def flange_of(name):
    arm = load_bundled(name)
    return six_parameter_poses(arm.kinematics, Q) @ arm.T_joint_flange


def test_a_urdf_of_the_model_serves_as_its_nominal_arm(tmp_path):
    arm, rows, dh = individual("ur5e")
    robot = write_urdf(replace(arm, dh=None), tmp_path / "ur.urdf")
    path = deviations(tmp_path / "calibration.conf", dh - arm.dh)
    np.testing.assert_allclose(flange(read_factory(path, read_arm(robot))), six_parameter_poses(rows, Q), atol=1e-11)


def test_a_controllers_file_is_fitted_and_converted_by_commands(tmp_path, capsys):
    arm, rows, dh = individual("ur10e")
    path = deviations(tmp_path / "calibration.conf", dh - arm.dh)
    code, out, _ = run(capsys, "fit", path, "--arm", "ur10e")
    assert (code, "Factory calibration of 6 joints, of a ur10e." in out) == (0, True)
    code, _, _ = run(capsys, "convert", path, tmp_path / "ur.yaml", "--to", "ur", "--arm", "ur10e")
    assert code == 0
    np.testing.assert_allclose(flange(read_factory(tmp_path / "ur.yaml")), six_parameter_poses(rows, Q), atol=1e-11)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("delta_theta = [1]\n", "is no calibration.conf (File contains no section headers."),
        ("[mounting]\ncolour = red\n", "has no delta_theta; name the calibration.conf of a controller"),
        ("[mounting]\ndelta_theta = [0, 0, 0, 0, 0, 0]\n", "lacks delta_d; read the file from the controller again"),
        ("[mounting]\ndelta_theta = [0, 0, 0, 0, 0]\n", "delta_theta must be a list of 6 numbers"),
        ("[mounting]\ndelta_theta = [0, 0, x, 0, 0, 0]\n", "delta_theta number 3 is 'x', which is not a number"),
    ],
)
def test_another_conf_is_refused_in_one_line(text, says, tmp_path):
    path = tmp_path / "calibration.conf"
    path.write_text(text)
    with pytest.raises(InputError, match=re.escape(f"{path}: {says}")):
        read_factory(path)


def test_deviations_that_the_controller_does_not_use_are_said_to_be_so(tmp_path):
    arm, _, dh = individual("ur5e")
    path = deviations(tmp_path / "calibration.conf", dh - arm.dh, status=0)
    with pytest.warns(InputWarning, match="calibration_status is 0, not initialised"):
        read_factory(path, arm)


# --- DH tables ---


def table(rows, **more):
    rows = [dict(zip(("theta_off", "d", "a", "alpha"), map(float, row), strict=True)) for row in rows]
    return {"units": "m and rad", "dh": [{"joint": i + 1, **row} for i, row in enumerate(rows)], **more}


def save(path, content):
    path.write_text(json.dumps(content))
    return path


def test_the_documented_table_is_read(tmp_path):
    (text,) = (block for block in re.findall(r"```json\n(.*?)```", DOCUMENT.read_text(), re.DOTALL) if '"dh"' in block)
    path = tmp_path / "doc.json"
    path.write_text(text)
    calibration = read_factory(path)
    assert calibration.arm.name == "lite6"
    assert 1e-4 < np.abs(flange(calibration) - flange_of("lite6"))[:, :3, 3].max() < 0.01


@pytest.mark.parametrize(("units", "length", "angle"), [("mm,deg", 1e3, 180 / np.pi), ("m, rad", 1.0, 1.0)])
def test_units_may_be_written_in_any_way(units, length, angle, tmp_path):
    dh = load_bundled("lite6").dh
    content = table(dh * [angle, length, length, angle], convention="standard")
    content["units"] = units
    np.testing.assert_allclose(flange(read_factory(save(tmp_path / "t.json", content))), flange_of("lite6"), atol=1e-12)


def test_lengths_of_hundreds_of_metres_that_cancel_are_read(tmp_path):
    _, rows, dh = individual("ur10e")
    assert np.abs(dh[:, 1]).max() > 5
    calibration = read_factory(save(tmp_path / "t.json", table(dh)))
    assert calibration.arm.name == "ur10e"
    np.testing.assert_allclose(flange(calibration), six_parameter_poses(rows, Q), atol=1e-11)
    assert np.abs(calibration.kinematics[:, :3]).max() < 1.0
    # as the six numbers of each joint too, where the frames stand as the table has them
    links, after = frames.links_from_dh(dh)
    np.testing.assert_array_equal(after, np.eye(4))
    six = ("x", "y", "z", "roll", "pitch", "yaw")
    rows_of = [dict(zip(six, frames.row_from_transform(T).tolist(), strict=True)) for T in links]
    named = {f"joint{i + 1}": row for i, row in enumerate(rows_of)}
    calibration = read_factory(save(tmp_path / "far.yaml", {"kinematics": named}))
    np.testing.assert_allclose(flange(calibration), six_parameter_poses(rows, Q), atol=1e-11)
    assert np.abs(calibration.kinematics[:, :3]).max() < 1.0


def test_lengths_that_do_not_cancel_are_no_arm(tmp_path):
    dh = load_bundled("ur10e").dh.copy()
    dh[1, 1] = 300.0
    assert "fits no bundled arm" in refusal(read_factory, save(tmp_path / "t.json", table(dh)))
    with pytest.raises(InputError, match="goes farther than 100 m from the base, farther than any arm's; correct its"):
        read_factory(save(tmp_path / "t.json", table(dh)), load_bundled("ur10e"))


def craig(rows, positions):
    """Poses of modified DH, from the textbook's product."""
    T = np.eye(4)
    for (theta, d, a, alpha), q in zip(rows, np.moveaxis(positions, -1, 0), strict=True):
        T = T @ rotate("x", alpha) @ shift(a, 0, 0) @ rotate("z", q + theta) @ shift(0, 0, d)
    return T


def as_modified(dh):
    """A standard table whose last a and alpha are zero, in Craig's convention: a and alpha go to the next row."""
    rows = dh.copy()
    rows[1:, 2:], rows[0, 2:] = dh[:-1, 2:], 0.0
    return rows


@pytest.mark.parametrize("word", ["modified", "mdh", "Craig"])
def test_modified_tables_are_the_same_chain(word, tmp_path):
    arm = load_bundled("lite6")
    rows = as_modified(arm.dh)
    rows[:, :3] += np.random.default_rng(0).normal(0, 1e-3, (6, 3))
    rows[2:, 3] += 1e-3
    path = save(tmp_path / ("t.yaml" if word == "mdh" else "t.json"), table(rows, convention=word))
    calibration = read_factory(path)
    assert calibration.arm.name == read_arm(path).name == "lite6"
    np.testing.assert_allclose(flange(calibration), craig(rows, Q) @ arm.T_joint_flange, atol=1e-12)


def test_a_table_that_does_not_say_its_convention_is_not_guessed(tmp_path):
    path = save(tmp_path / "t.json", table(as_modified(load_bundled("lite6").dh)))
    for arm in (None, load_bundled("lite6")):
        with pytest.raises(
            InputError, match=r"as standard DH, and 0.0 mm from a lite6 as modified DH \(Craig's\); write"
        ):
            read_factory(path, arm)
    path = save(tmp_path / "t.json", table(load_bundled("lite6").dh[:3]))
    with pytest.warns(InputWarning) as said:
        read_factory(path)
    assert any("does not say its convention; standard DH is assumed" in str(each.message) for each in said)
    with pytest.raises(InputError, match="convention is 'denavit'; write standard or modified"):
        read_table(save(tmp_path / "t.json", table(load_bundled("lite6").dh, convention="denavit")))
    with pytest.raises(InputError, match="beta_joint2 is of standard DH, and convention says modified; keep one"):
        read_table(save(tmp_path / "t.json", table(load_bundled("lite6").dh, convention="modified", beta_joint2=0.0)))


@pytest.mark.parametrize("convention", [None, "standard", "modified"])
def test_a_description_may_be_its_table_alone(convention, tmp_path):
    dh = np.random.default_rng(1).uniform(-1, 1, (4, 4))
    keys = ("theta_off_rad", "d_m", "a_m", "alpha_rad")
    content = {
        "name": "mine",
        "dh": {f"joint{i + 1}": dict(zip(keys, row.tolist(), strict=True)) for i, row in enumerate(dh)},
    }
    if convention:
        content["convention"] = convention
    content["flange"] = {"x": 0.0, "y": 0.0, "z": 0.1, "roll": 0.0, "pitch": 0.0, "yaw": 0.0}
    q = frames.sample_joints(4)
    arm = read_arm(save(tmp_path / "arm.yaml", content))
    poses = craig(dh, q) if convention == "modified" else hayati_poses(np.zeros(4), dh, {}, q)
    np.testing.assert_allclose(
        six_parameter_poses(arm.kinematics, q) @ arm.T_joint_flange, poses @ shift(0, 0, 0.1), atol=1e-13
    )
    again = read_arm(write_arm(arm, tmp_path / "again.yaml"))
    np.testing.assert_array_equal(again.kinematics, arm.kinematics)


# --- a first axis that lies ---


def torso():
    """An arm on a torso: the shoulder turns about the base's y."""
    rows = np.zeros((4, 6))
    rows[0] = [0, 0.1, 0.3, -np.pi / 2, 0, 0]
    rows[1:, 3] = np.pi / 2, -np.pi / 2, np.pi / 2
    rows[1:, :3] = [0, 0.02, 0.05], [0.03, -0.2, 0], [0, 0.03, 0.15]
    return Arm("torso", rows)


def test_an_arm_whose_first_axis_lies_has_a_table(tmp_path):
    arm = torso()
    assert arm.form.first_axis == 1
    rng, q = np.random.default_rng(0), frames.sample_joints(4)
    path = write_table(arm.form, arm.hayati + rng.normal(0, 1e-3, arm.form.size), tmp_path / "t.json")
    assert json.loads(path.read_text())["first_axis"] == "y"
    read = read_table(path)
    assert read.form == arm.form
    with pytest.warns(InputWarning, match="no bundled arm has 4 joints"):
        own = read_factory(path)
    np.testing.assert_allclose(flange(read_factory(path, arm), q), flange(own, q), atol=1e-13)
    content = json.loads(path.read_text())
    for key, instead in (("y", "d"), ("pitch", "theta_off")):
        changed = content | {"base": content["base"] | {key: 1.0}}
        with pytest.raises(InputError, match=f"base: {key} is not zero, .*; add it to {instead} of joint 1"):
            read_table(save(tmp_path / "changed.json", changed))


# --- into a URDF of one's own ---


def test_a_table_goes_into_the_urdf_of_its_arm(tmp_path, capsys):
    nominal = torso()
    robot = write_urdf(nominal, tmp_path / "robot.urdf")
    parameters = read_arm(robot).hayati + np.random.default_rng(2).normal(0, 2e-4, nominal.form.size)
    path = write_table(nominal.form, parameters, tmp_path / "m.json")
    for i, arm in enumerate(((), ("--arm", robot))):  # named, or known by --into
        code, _, said = run(capsys, "convert", path, tmp_path / f"new{i}.urdf", "--into", robot, *arm)
        assert (code, said) == (0, "")
        q = frames.sample_joints(4)
        found = read_arm(tmp_path / f"new{i}.urdf")
        expected = flange(read_factory(path, nominal), q)
        np.testing.assert_allclose(
            six_parameter_poses(found.kinematics, q) @ found.T_joint_flange, expected, atol=1e-12
        )
    assert "named with --arm" not in refused(
        capsys, "convert", path, tmp_path / "x.urdf", "--into", robot, "--arm", "xarm7"
    )


# --- jaws ---


def jawed(tmp_path, joint_name="gripper", child="moving_jaw", frame="gripper_frame_link"):
    parts = [link(name) for name in ("base", "a", "hand", child, *([frame] if frame else []))]
    parts += [joint("j1", "base", "a"), joint("wrist_roll", "a", "hand", axis="1 0 0", xyz="0 0 0.2")]
    parts += [joint("f", "hand", frame, "fixed", xyz="0 0 0.1")] if frame else []
    return write(tmp_path, *parts, joint(joint_name, "hand", child, axis="0 1 0", xyz="0 0.02 0.05"))


def test_a_chain_that_ends_in_a_jaw_says_so_and_which_tip_is_meant(tmp_path, capsys, recwarn):
    path = jawed(tmp_path)
    code, out, said = run(capsys, "arms", path)
    assert code == 0
    assert "base to moving_jaw" in flat(out)
    assert (
        "the chain ends in moving_jaw after 3 joints, and joint 'gripper' seems to move a jaw: the tip of the arm is"
        " likely gripper_frame_link, after 2 joints; name arm.urdf#gripper_frame_link for it, or arm.urdf#moving_jaw to"
        " keep the jaw"
    ) in flat(said)
    for tip, joints in (("gripper_frame_link", 2), ("moving_jaw", 3)):  # what was named is not remarked on
        code, out, said = run(capsys, "arms", f"{path}#{tip}", "--json")
        assert (code, said, json.loads(out)["joints"]) == (0, "", joints)
        assert [each["name"] for each in json.loads(out)["joint_list"]][:2] == ["j1", "wrist_roll"]


@pytest.mark.parametrize(
    ("names", "tip"),
    [
        ({"joint_name": "6", "child": "jaw", "frame": ""}, "hand"),
        ({"joint_name": "6", "child": "end", "frame": "tool0"}, "tool0"),
        ({"joint_name": "left_finger_joint", "child": "x", "frame": "camera"}, "hand"),
    ],
)
def test_jaws_are_known_by_names_or_by_a_frame_beside_them(names, tip, tmp_path):
    path = jawed(tmp_path, **names)
    with pytest.warns(InputWarning, match=f"the tip of the arm is likely {tip}, after 2 joints"):
        read_urdf(path)


@pytest.mark.parametrize(
    "names",
    [
        {"joint_name": "wrist_yaw", "child": "gripper_link", "frame": ""},
        {"joint_name": "gripper_roll", "child": "gripper_base", "frame": ""},
        {"joint_name": "j3", "child": "flange", "frame": "camera"},
    ],
)
def test_a_wrist_that_carries_a_gripper_is_no_jaw(names, tmp_path):
    assert read_urdf(jawed(tmp_path, **names)).dof == 3


def test_a_coupled_joint_in_the_chain_is_refused_with_what_it_follows(tmp_path):
    mimic = '<mimic joint="j1" multiplier="-1" offset="0.5"/>'
    path = write(
        tmp_path,
        *(link(name) for name in ("base", "a", "b", "c")),
        *(joint("j1", "base", "a"), joint("level", "a", "b", extra=mimic, xyz="0.2 0 0"), joint("j3", "b", "c")),
    )
    assert refusal(read_urdf, path) == (
        f"{path}: joint 'level' is coupled: it mimics -1 times 'j1' +0.5; an arm here has revolute and prismatic joints"
        " that move on their own, name a chain without it with --tip a, or as arm.urdf#a where a file is named"
    )
    assert read_urdf(path, tip="a").dof == 1


# ------------------------------------------------------------------ franka_description

FRANKA = (
    (0, 0, 0.333, 0, 0, 0),
    (0, 0, 0, -np.pi / 2, 0, 0),
    (0, -0.316, 0, np.pi / 2, 0, 0),
    (0.0825, 0, 0, np.pi / 2, 0, 0),
    (-0.0825, 0.384, 0, -np.pi / 2, 0, 0),
    (0, 0, 0, np.pi / 2, 0, 0),
    (0.088, 0, 0, np.pi / 2, 0, 0),
    (0, 0, 0.107, 0, 0, 0),
)


def write_franka(path, rows=FRANKA):
    keys = ("x", "y", "z", "roll", "pitch", "yaw")
    entries = (
        f"joint{k}:\n  kinematic:\n" + "".join(f"    {key}: {value}\n" for key, value in zip(keys, row, strict=True))
        for k, row in enumerate(rows, 1)
    )
    path.write_text("".join(entries))
    return path


def test_the_kinematics_of_franka_description_are_an_arm_of_seven_joints(tmp_path, capsys):
    path = write_franka(tmp_path / "kinematics.yaml")
    code, said, _ = run(capsys, "arms", path)
    assert code == 0
    assert "7 joints" in flat(said)
    arm = read_arm(path)
    q = np.random.default_rng(0).uniform(-1, 1, (5, 7))
    expected = six_parameter_poses(np.array(FRANKA[:7]), q) @ np.block(
        [[np.eye(3), np.array([[0], [0], [0.107]])], [np.zeros((1, 3)), np.ones((1, 1))]]
    )
    np.testing.assert_allclose(frames.chain(arm.links, q) @ arm.T_joint_flange, expected, atol=1e-12)
    code, _, _ = run(capsys, "convert", path, tmp_path / "franka.urdf")
    assert code == 0


def test_a_joint_of_franka_description_that_lacks_a_number_is_refused(tmp_path):
    path = write_franka(tmp_path / "kinematics.yaml")
    path.write_text(path.read_text().replace("    yaw: 0\n", "", 1))
    assert "joint1" in refusal(read_arm, path)
