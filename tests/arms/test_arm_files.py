"""Factory files, descriptions and tables: exact round trips, recognition, and every refusal's whole line."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from typed import refusal

from lite6jax.arms.arm import JOINT_TERMS, Arm
from lite6jax.arms.chains import HayatiForm, six_parameter_fk
from lite6jax.arms.description import bundled_arms, load_bundled, read_description, write_arm
from lite6jax.arms.dh import read_table, write_table
from lite6jax.arms.factory import read_factory, write_factory
from lite6jax.arms.files import read_arm
from lite6jax.errors import InputError, InputWarning
from tests.oracles.arms import random_kinematics

REAL = Path(__file__).resolve().parents[2] / "../shared/real"
SIX = ("x", "y", "z", "roll", "pitch", "yaw")
UR = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")


def vendor(rows):
    return {f"joint{i + 1}": dict(zip(SIX, map(float, row), strict=True)) for i, row in enumerate(rows)}


def calibrated(name):
    rows = load_bundled(name).kinematics
    return rows + np.random.default_rng(0).normal(0, 1e-3, rows.shape)


@pytest.fixture
def save(tmp_path):
    def save(content, name="arm.yaml"):
        path = tmp_path / name
        path.write_text(content if isinstance(content, str) else yaml.safe_dump(content, sort_keys=False))
        return path

    return save


# --- factory files ---


@pytest.mark.parametrize("name", [name for name in bundled_arms() if name != "lite6_ros"])
def test_a_calibration_is_recognised_as_its_model(name, tmp_path):
    rows = calibrated(name)
    calibration = read_factory(write_factory(rows, tmp_path / "arm.yaml"))
    assert calibration.arm is load_bundled(name)
    assert calibration.source == str(tmp_path / "arm.yaml")
    np.testing.assert_array_equal(calibration.kinematics, rows)
    np.testing.assert_array_equal(calibration.T_joint_flange, np.eye(4))


def test_the_ros_default_is_a_lite6(tmp_path):
    path = write_factory(load_bundled("lite6_ros").kinematics, tmp_path / "arm.yaml")
    assert read_factory(path).arm.name == "lite6"
    assert read_factory(path, load_bundled("lite6_ros")).arm.name == "lite6_ros"


number = st.floats(-6.28, 6.28)


@settings(deadline=None, max_examples=60)
@given(st.integers(5, 7).flatmap(lambda n: st.lists(st.lists(number, min_size=6, max_size=6), min_size=n, max_size=n)))
def test_factory_round_trip_is_exact(tmp_path_factory, rows):
    folder = tmp_path_factory.mktemp("factory")
    arm = Arm("same", np.array(rows))
    forms = {"vendor": [f"joint{i + 1}" for i in range(len(rows))]} | ({"ur": list(UR)} if len(rows) == 6 else {})
    for form, joints in forms.items():
        path = write_factory(rows, folder / f"{form}.yaml", form)
        np.testing.assert_array_equal(read_factory(path, arm).kinematics, rows)
        # Any other YAML reader gets the same floats.
        plain = yaml.safe_load(path.read_text())["kinematics"]
        assert list(plain) == joints
        np.testing.assert_array_equal([[row[key] for key in SIX] for row in plain.values()], rows)


def test_universal_robots_form_keeps_the_hash_out_of_the_way(save):
    rows = calibrated("ur5e")
    joints = dict(zip(UR, vendor(rows).values(), strict=True))
    path = save({"kinematics": {**joints, "hash": "calib_1"}})
    np.testing.assert_array_equal(read_factory(path).kinematics, rows)


def test_numbers_that_yaml_takes_for_words_are_numbers(save):
    text = yaml.safe_dump({"kinematics": vendor(load_bundled("lite6").kinematics)}).replace("x: 0.2\n", "x: 2e-1\n")
    assert "2e-1" in text
    assert read_factory(save(text)).kinematics[2, 0] == 0.2


NOT_A_NUMBER = "which is not a number; write a plain number"
NOT_FINITE = "which is not finite; read the file from its source again"
KEYS = "x, y, z, roll, pitch, yaw"


@pytest.mark.parametrize(
    ("joint", "key", "value", "message"),
    [
        ("joint2", "yaw", "abc", f": yaw is 'abc', {NOT_A_NUMBER}"),
        ("joint2", "yaw", True, f": yaw is True, {NOT_A_NUMBER}"),
        ("joint2", "yaw", None, f": yaw is None, {NOT_A_NUMBER}"),
        ("joint2", "yaw", [1.0], f": yaw is [1.0], {NOT_A_NUMBER}"),
        ("joint3", "x", float("nan"), f": x is nan, {NOT_FINITE}"),
        ("joint3", "x", float("inf"), f": x is inf, {NOT_FINITE}"),
        ("joint3", "x", 10**400, f": x is inf, {NOT_FINITE}"),
        ("joint4", None, None, f" is missing from kinematics; add its {KEYS}"),
        ("joint4", "pitch", "absent", " lacks the key 'pitch'; add it"),
        ("joint5", "yow", 1.0, f" has the unknown key 'yow'; did you mean 'yaw'? accepted are {KEYS}"),
        (
            "joint2", "roll", 90.0,
            ": roll is 90, more than a full turn, so it seems to be in degrees; write radians (1.5708)",
        ),
        (
            "joint1", "z", 243.3,
            ": z is 243.3, longer than any arm's link, so it seems to be in millimetres; write metres (0.2433)",
        ),
    ],
)  # fmt: skip
def test_a_spoilt_factory_file_names_joint_and_remedy(joint, key, value, message, save):
    rows = vendor(load_bundled("lite6").kinematics)
    if key is None:
        del rows[joint]
    elif value == "absent":
        del rows[joint][key]
    else:
        rows[joint][key] = value
    path = save({"kinematics": rows})
    assert refusal(read_factory, path) == f"{path}: {joint}{message}"


def test_universal_robots_joints_are_named_both_ways(save):
    rows = dict(zip(UR, vendor(load_bundled("ur5").kinematics).values(), strict=True))
    rows["wrist_2"]["roll"] = 90.0
    assert ": joint5 (wrist_2): roll is 90, more than a full turn" in refusal(read_factory, save({"kinematics": rows}))
    del rows["wrist_2"]
    assert ": joint5 (wrist_2) is missing from kinematics" in refusal(read_factory, save({"kinematics": rows}))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("- 1\n", ": must be a mapping with the keys kinematics"),
        ("kinematics: 3\n", ": kinematics must be a mapping with the joints joint1, joint2, …; write one per joint"),
        ("kinematics: {}\n", ": kinematics must be a mapping with the joints joint1, joint2, …; write one per joint"),
        ("kinematic: {}\n", ": has the unknown key 'kinematic'; did you mean 'kinematics'? accepted are kinematics"),
        ("kinematics: {joint1: 3}\n", ": joint1 must be a mapping with the keys x, y, z, roll, pitch, yaw"),
        ("kinematics: {joint1: {}, elbow: {}}\n", ": kinematics has the unknown joint 'elbow'; accepted are joint1"),
        (
            "kinematics: {shoulder: {}, joint2: {}}\n",
            ": kinematics has the unknown joint 'joint2'; "
            "accepted are shoulder, upper_arm, forearm, wrist_1, wrist_2, wrist_3",
        ),
    ],
)
def test_a_file_of_another_kind_is_refused(content, message, save):
    path = save(content)
    assert refusal(read_factory, path) == f"{path}{message}"


def test_the_number_of_joints_is_checked(save):
    rows = vendor(load_bundled("xarm7").kinematics)
    path = save({"kinematics": rows})
    assert refusal(read_factory, path, load_bundled("lite6")) == (
        f"{path}: has 7 joints, but lite6 has 6; name another with `arm=NAME`"
    )


@pytest.mark.parametrize("joints", [1, 3, 4, 8, 10])
def test_a_chain_of_any_number_of_joints_is_its_own_nominal_arm(joints, tmp_path):
    rows = random_kinematics(np.random.default_rng(joints), joints)
    path = write_factory(rows, tmp_path / "crane.yaml")
    with pytest.warns(InputWarning) as warned:
        calibration = read_factory(path)
    assert str(warned[0].message) == (
        f"{path}: no bundled arm has {joints} joints, so this chain is its own nominal arm; name another with "
        "`arm=NAME` to see how it deviates"
    )
    np.testing.assert_array_equal(calibration.kinematics, rows)
    assert (calibration.arm.name, calibration.arm.dof) == ("crane", joints)
    own = Arm("own", rows + 1e-4)
    assert read_factory(path, own).arm is own


def test_no_model_fits_unless_it_is_given(save):
    rows = load_bundled("ur10e").kinematics.copy()
    rows[2, 0] -= 0.2
    path = save({"kinematics": vendor(rows)})
    assert refusal(read_factory, path) == (
        f"{path}: fits no bundled arm; the nearest is ur10e, 200 mm RMS away at the flange;"
        " name the arm with `arm=NAME` (a bundled one, or a description of your own)"
    )
    assert read_factory(path, load_bundled("ur5e")).arm.name == "ur5e"  # what is said holds, however far


@pytest.mark.parametrize(
    ("name", "joint", "axis"), [("lite6", 2, "x"), ("ur10e", 4, "y"), ("xarm7", 6, "z"), ("xarm5", 0, "z")]
)
def test_a_half_turn_is_refused_by_joint_also_when_the_arm_is_given(name, joint, axis, save):
    arm = load_bundled(name)
    rows = arm.kinematics.copy()
    # R = Rz(yaw) Ry(pitch) Rx(roll) times a half turn: about x, roll + 180 deg; about z, Rz(yaw + 180 deg) Ry(-pitch)
    # Rx(-roll); about y, both.
    turned = {"x": [np.pi, 0, 0], "y": [np.pi, 0, np.pi], "z": [0, 0, np.pi]}[axis]
    signs = {"x": [1, 1, 1], "y": [-1, -1, 1], "z": [-1, -1, 1]}[axis]
    rows[joint, 3:] = rows[joint, 3:] * signs + turned
    rows[joint, 3:] = np.remainder(rows[joint, 3:] + np.pi, 2 * np.pi) - np.pi
    path = save({"kinematics": vendor(rows)})
    for nominal in (None, arm):
        message = refusal(read_factory, path, nominal)
        assert message.startswith(f"{path}: joint{joint + 1} is turned by 180° about {axis}: the flange is ")
        assert message.endswith(f" mm RMS from a {name}'s, and 0.0 mm with that turned back; read the calibration"
                                " from the arm again")  # fmt: skip


def test_write_factory_refuses(tmp_path):
    path = tmp_path / "arm.yaml"
    assert refusal(write_factory, np.zeros((5, 6)), path, "ur") == (
        f"{path}: the ur form holds an array (6, 6), not (5, 6); choose another form"
    )
    assert refusal(write_factory, np.zeros((4, 5)), path) == (
        f"{path}: the vendor form holds an array (joint, 6), not (4, 5); choose another form"
    )
    assert refusal(write_factory, np.zeros((6, 6)), path, "abb") == (
        f"{path}: no form 'abb' of factory files; write 'vendor' or 'ur'"
    )
    rows = np.zeros((6, 6))
    rows[2, 1] = np.nan
    assert refusal(write_factory, rows, path) == (f"{path}: joint3 has a number that is not finite; nothing is written")
    assert not path.exists()
    write_factory(np.zeros((6, 6)), path)
    assert "exists already" in refusal(write_factory, np.ones((6, 6)), path)


def real(folder):
    if not (REAL / folder).is_dir():
        pytest.skip(f"the real files ({folder}) are not beside the repository")
    return sorted((REAL / folder).glob("*.yaml"))


def test_every_real_ur_file_is_recognised_and_the_two_flips_are_refused():
    refused = {}
    for path in real("ur_factory"):
        try:
            calibration = read_factory(path)
        except InputError as error:
            refused[path.name] = str(error).removeprefix(f"{path}: ")
        else:
            assert calibration.arm.name == path.name.split("__")[0]
    flip = (
        "joint3 (forearm) is turned by 180° about z and joint4 (wrist_1) is turned by 180° about z: the flange is {} mm"
        " RMS from a {}'s, and {} mm with that turned back; read the calibration from the arm again"
    )
    assert refused == {
        "ur5__GerardHarkemaAvans+TNO_Project2_PCB.yaml": flip.format("785", "ur5", "2.8"),
        "ur5e__brenhertel+pearl_ur5e.yaml": flip.format("784", "ur5e", "1.1"),
    }


def test_every_real_vendor_file_is_recognised():
    models = {path.name: read_factory(path).arm.name for path in real("vendor")}
    assert models == {
        "lite6_default_kinematics.yaml": "lite6",
        "uf850_default_kinematics.yaml": "uf850",
        "xarm5_default_kinematics.yaml": "xarm5",
        "xarm6_default_kinematics.yaml": "xarm6",
        "xarm7_default_kinematics.yaml": "xarm7",
        "xarm7_one_real_arm.yaml": "xarm7",
    }


# --- descriptions ---


def test_a_description_is_read_whole(save):
    content = {
        "name": "mine",
        "source": "drawing 7",
        "kinematics": vendor([[0, 0, 0.3, 0, 0, 0], [0.2, 0, 0, 0, 0, 0]]),
        "joint_limits_rad": [[-1, 1], [-2, 2.5]],
        "inertial": {
            "link1": {"mass_kg": 2, "com_m": [0, 0, 0.1], "inertia_kg_m2": [0.3, 0.4, 0.5, 0.01, 0.02, 0.03]},
            "link2": {"mass_kg": 1, "com_m": [0.1, 0, 0], "inertia_kg_m2": [0.1, 0.1, 0.1, 0, 0, 0]},
        },
        "dynamics": {
            "joint1": {"friction": {"viscous_Nm_s_per_rad": 0.7}},
            "joint2": {"friction": {"viscous_Nm_s_per_rad": 0.4, "coulomb_Nm": 0.2}, "rotor_inertia_kg_m2": 0.05},
        },
        "flange": {"x": 0.0, "y": 0.0, "z": 0.05, "roll": 0.0, "pitch": 0.0, "yaw": 0.0},
        "dh": {
            "joint1": {"theta_off_rad": 0, "d_m": 0.3, "a_m": 0.2, "alpha_rad": 0},
            "joint2": {"theta_off_rad": 0, "d_m": 0, "a_m": 0, "alpha_rad": 0},
        },
    }
    arm = read_arm(save(content))
    assert (arm.name, arm.source, arm.dof) == ("mine", "drawing 7", 2)
    np.testing.assert_array_equal(arm.joint_limits, [[-1, 1], [-2, 2.5]])
    np.testing.assert_array_equal(arm.mass, [2, 1])
    np.testing.assert_array_equal(arm.center_of_mass, [[0, 0, 0.1], [0.1, 0, 0]])
    np.testing.assert_array_equal(arm.inertia[0], [[0.3, 0.01, 0.02], [0.01, 0.4, 0.03], [0.02, 0.03, 0.5]])
    np.testing.assert_array_equal(arm.inertia[1], 0.1 * np.eye(3))
    np.testing.assert_array_equal(arm.viscous_friction, [0.7, 0.4])
    np.testing.assert_array_equal(arm.coulomb_friction, [0, 0.2])
    np.testing.assert_array_equal(arm.rotor_inertia, [0, 0.05])
    np.testing.assert_array_equal(arm.T_joint_flange[:3, 3], [0, 0, 0.05])
    np.testing.assert_array_equal(arm.dh, [[0, 0.3, 0.2, 0], [0, 0, 0, 0]])


def test_dynamics_that_no_joint_has_are_unknown(save):
    arm = read_arm(save({**ONE, "dynamics": {"joint1": {"friction": {"coulomb_Nm": 0.3}}}}))
    assert (arm.viscous_friction, arm.rotor_inertia, arm.inertia) == (None, None, None)
    np.testing.assert_array_equal(arm.coulomb_friction, [0.3])


def with_tensor(*six):
    return {"inertial": {"link1": {"mass_kg": 1, "com_m": [0, 0, 0], "inertia_kg_m2": list(six)}}}


ONE = {"name": "one", "kinematics": vendor([[0, 0, 0.3, 0, 0, 0]])}


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (
            {"bounds": []},
            ": has the unknown key 'bounds'; accepted are name, kinematics, joint_limits_rad, joint_limits, inertial,"
            " dynamics, dh, convention, flange, source",
        ),
        ({"name": 7}, ": name is 7, which is not text; put it in quotes"),
        ({"source": ["a"]}, ": source is ['a'], which is not text; put it in quotes"),
        ({"name": "a\nb"}, ": arm 'a\\nb': the name must be one printable line; write another"),
        ({"joint_limits_rad": [1, 2]}, ": joint_limits_rad must list one [lower, upper] for each of the 1 joints"),
        ({"joint_limits_rad": [[1]]}, ": joint1's limits must be a list of 2 numbers; write [0.0, 0.0]"),
        (
            {"joint_limits_rad": [[-150, 150]]},
            ": joint1's limits -150 … 150 are many turns, so they seem to be in degrees; write radians",
        ),
        ({"joint_limits_rad": [[1, -1]]}, ": arm 'one': joint1's limits 1 … -1 rad are empty; write lower, upper"),
        ({"inertial": {}}, ": inertial lacks the key 'link1'; add it"),
        ({"inertial": {"link1": {"mass_kg": 1}}}, ": inertial: link1 lacks the key 'com_m'; add it"),
        (
            {"inertial": {"link1": {"mass_kg": 1, "com_m": [0, 0, "x"]}}},
            ": inertial: link1: com_m number 3 is 'x', which is not a number; write a plain number",
        ),
        (with_tensor(1, 2, 3), ": inertial: link1: inertia_kg_m2 must be a list of 6 numbers; write [0.0, 0.0, 0.0,"),
        (
            with_tensor(1, 1, 1, 2, 0, 0),
            ": arm 'one': link1's inertia has the negative principal moment -1 kg·m²; correct it, or leave out all",
        ),
        (
            with_tensor(1, 2, 4, 0, 0, 0),
            ": arm 'one': link1's inertia has the principal moments 1, 2, 4 kg·m², the largest of which exceeds",
        ),
        (
            with_tensor(1451, 887, 1319, 0, 0, 0),
            ": inertial: link1: inertia_kg_m2 has a radius of gyration of 38.1 m, beyond any arm, so it seems to be in"
            " kg mm²; write kg m²",
        ),
        ({"dynamics": {"joint2": {}}}, ": dynamics has the unknown key 'joint2'; did you mean 'joint1'?"),
        (
            {"dynamics": {"joint1": 3}},
            ": dynamics: joint1 must be a mapping with the keys friction, rotor_inertia_kg_m2",
        ),
        (
            {"dynamics": {"joint1": {"friction": {"viscous_Nm_s_per_rad": -0.1}}}},
            ": arm 'one': joint1's viscous friction is negative; correct it",
        ),
        (
            {"dynamics": {"joint1": {"friction": {"coulomb": 0.1}}}},
            ": dynamics: joint1: friction has the unknown key 'coulomb'; did you mean 'coulomb_Nm'?",
        ),
        (
            {"dynamics": {"joint1": {"rotor_inertia_kg_m2": "heavy"}}},
            ": dynamics: joint1: rotor_inertia_kg_m2 is 'heavy', which is not a number; write a plain number",
        ),
        ({"dh": {"joint1": {}}}, ": dh: joint1 lacks the key 'theta_off_rad'; add it"),
        ({"flange": 3}, ": flange must be x y z roll pitch yaw by name, or three rows of four numbers"),
        ({"flange": [[1, 0, 0, 0]] * 3}, ": arm 'one': T_joint_flange does not hold a rotation"),
        ({"kinematics": vendor([[0, 0, 300, 0, 0, 0]])}, ": joint1: z is 300, longer than any arm's link"),
    ],
)
def test_a_spoilt_description_names_the_place(extra, message, save):
    path = save({**ONE, **extra})
    assert refusal(read_arm, path).startswith(f"{path}{message}")


def test_inertia_is_given_for_every_link_or_none(save):
    links = with_tensor(1, 1, 1, 0, 0, 0)["inertial"] | {"link2": {"mass_kg": 1, "com_m": [0, 0, 0]}}
    two = {"name": "two", "kinematics": vendor([[0, 0, 0.3, 0, 0, 0]] * 2), "inertial": links}
    path = save(two)
    message = f"{path}: inertial: link2 lacks inertia_kg_m2, which other links have; give all or none"
    assert refusal(read_arm, path) == message
    message = "arm 'bare': inertia needs the links' masses; give mass and center_of_mass too"
    assert refusal(Arm, "bare", np.zeros((1, 6)), inertia=np.eye(3)[None]) == message
    skewed = np.eye(3)[None] + np.triu(np.ones(3), 1)
    message = "arm 'skewed': link1's inertia is not symmetric; correct it, or leave out all inertia"
    assert (
        refusal(Arm, "skewed", np.zeros((1, 6)), mass=[1], center_of_mass=np.zeros((1, 3)), inertia=skewed) == message
    )


def test_a_rounded_tensor_of_a_flat_body_is_a_bodys(save):
    arm = read_arm(save({**ONE, **with_tensor(1.333e-3, 2.222e-3, 3.556e-3, 0, 0, 0)}))
    np.testing.assert_array_equal(np.diag(arm.inertia[0]), [1.333e-3, 2.222e-3, 3.556e-3])


name_text = st.text(st.characters(codec="utf-8"), min_size=1, max_size=12).filter(str.isprintable)


@settings(deadline=None, max_examples=60)
@given(
    rows=st.lists(st.lists(number, min_size=6, max_size=6), min_size=1, max_size=7),
    name=name_text,
    source=name_text | st.just(""),
    flange=st.lists(number, min_size=3, max_size=3),
    mass=st.none() | st.floats(0, 1e3),
    drives=st.lists(st.none() | st.floats(0, 1e3), min_size=4, max_size=4),
)
def test_description_round_trip_is_exact(tmp_path_factory, rows, name, source, flange, mass, drives):
    angle = flange[0]
    T = np.array(
        [[np.cos(angle), 0, np.sin(angle), flange[1]], [0, 1, 0, 5e-324], [-np.sin(angle), 0, np.cos(angle), 0]]
    )
    arm = Arm(
        name=name,
        source=source,
        kinematics=np.array(rows),
        joint_limits=np.tile([-1 / 3, 1e-5], (len(rows), 1)),
        T_joint_flange=np.vstack([T, [0, 0, 0, 1]]) if flange[2] > 0 else None,
        mass=None if mass is None else np.full(len(rows), mass),
        center_of_mass=None if mass is None else np.array(rows)[:, :3],
        inertia=None if mass is None or mass < 1 else np.tile(np.diag([1 / 3, 1e-5, 1 / 3]), (len(rows), 1, 1)),
        **{k: None if v is None else np.full(len(rows), v) for k, v in zip(JOINT_TERMS, drives, strict=True)},
        spring_rest=None if drives[3] is None else np.array(rows)[:, 0],
    )
    back = read_description(write_arm(arm, tmp_path_factory.mktemp("arm") / "arm.yaml"))
    assert (back.name, back.source) == (name, source)
    for field in (
        "kinematics",
        "joint_limits",
        "T_joint_flange",
        "mass",
        "center_of_mass",
        "inertia",
        "spring_rest",
        *JOINT_TERMS,
    ):
        np.testing.assert_equal(getattr(back, field), getattr(arm, field))


# --- names and paths ---


def test_an_arm_by_name_calibration_or_table(tmp_path):
    assert read_arm("ur5e") is load_bundled("ur5e")
    rows = calibrated("lite6")
    arm = read_arm(write_factory(rows, tmp_path / "my.yaml"))
    assert (arm.name, arm.source) == ("lite6", "factory calibration my.yaml of a lite6")
    np.testing.assert_array_equal(arm.kinematics, rows)
    np.testing.assert_array_equal(arm.joint_limits, load_bundled("lite6").joint_limits)
    nominal = load_bundled("lite6")
    arm = read_arm(write_table(nominal.form, nominal.hayati, tmp_path / "lite6.json"))
    q = np.random.default_rng(3).uniform(-3, 3, (20, 6))
    ours = six_parameter_fk(arm.kinematics, q) @ arm.T_joint_flange
    np.testing.assert_allclose(ours, six_parameter_fk(nominal.kinematics, q), atol=1e-12)


def test_neither_name_nor_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert refusal(read_arm, "lite7").startswith(
        "lite7: neither a bundled arm nor a file; did you mean 'lite6'? accepted are lite6, lite6_ros, "
    )
    assert refusal(read_arm, "lite7.yaml") == "lite7.yaml: no such file; check the name"


# --- the seed's table ---


def seed_table(parameters):
    """The table as the seed's script writes it, for a Lite 6."""
    x, dh = parameters, np.insert(parameters[4:27], 5, 0.0).reshape(6, 4)
    roll, pitch = np.rad2deg(x[2:4])
    base = {"x": x[0] * 1000, "y": x[1] * 1000, "z": 0.0, "roll": roll, "pitch": pitch, "yaw": 0.0}
    rows = [
        {"joint": i + 1, "theta_off": np.rad2deg(t), "d": d * 1000, "a": a * 1000, "alpha": np.rad2deg(alpha)}
        for i, (t, d, a, alpha) in enumerate(dh)
    ]
    return {"units": "mm and deg", "base": base, "dh": rows, "beta_joint2": np.rad2deg(x[27])}


def lite6_parameters():
    nominal = load_bundled("lite6")
    return nominal.form, nominal.hayati + np.random.default_rng(0).normal(0, 1e-3, nominal.hayati.shape)


def test_the_table_is_the_seeds_both_ways(save, tmp_path):
    form, parameters = lite6_parameters()
    seed = seed_table(parameters)
    table = read_table(save(json.dumps(seed, indent=2), "lite6_effective_dh.json"))
    assert table.form == form
    np.testing.assert_allclose(table.parameters, parameters, rtol=3e-16)
    written = json.loads(write_table(form, parameters, tmp_path / "t.json").read_text())
    assert list(written) == [*seed]
    for ours, theirs in zip([written, written["base"], *written["dh"]], [seed, seed["base"], *seed["dh"]], strict=True):
        assert [*ours][: len(theirs)] == [*theirs]
        numbers = [key for key, value in theirs.items() if isinstance(value, float)]
        np.testing.assert_allclose([ours[key] for key in numbers], [theirs[key] for key in numbers], rtol=3e-16)


def test_the_nominal_table_is_printed_as_published(tmp_path):
    arm = load_bundled("lite6")
    text = write_table(arm.form, arm.hayati, tmp_path / "t.json").read_text()
    assert '{"joint": 1, "theta_off": 0.0, "d": 243.3, "a": 0.0, "alpha": -90.0}' in text
    assert '{"joint": 2, "theta_off": -90.0, "d": 0.0, "a": 200.0, "alpha": 180.0}' in text
    assert '{"joint": 4, "theta_off": 0.0, "d": 227.6, "a": 0.0, "alpha": 90.0}' in text


@settings(deadline=None, max_examples=100)
@given(st.data())
def test_table_round_trip_is_exact_to_the_last_bit(tmp_path_factory, data):
    n = data.draw(st.integers(1, 7))
    parallel = data.draw(st.sets(st.integers(0, n - 2))) if n > 1 else set()
    form = HayatiForm(n, tuple(sorted(parallel)))
    values = st.floats(min_value=-12, max_value=12)
    parameters = np.array(data.draw(st.lists(values, min_size=form.size, max_size=form.size)))
    path = write_table(form, parameters, tmp_path_factory.mktemp("table") / "t.json")
    table = read_table(path)
    assert table.form == form
    assert table.parameters.tobytes() == parameters.tobytes()
    json.loads(path.read_text())


TABLE_NOT_FINITE = "which is not finite; read the table from its source again"


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (
            ["units"], "cm and deg",
            "units is 'cm and deg'; write 'mm and deg', or m instead of mm, rad instead of deg",
        ),
        (
            ["alpha"], 1.0,
            "has the unknown key 'alpha'; accepted are units, dh, base, beta_joint2, convention, first_axis, fit",
        ),
        (["base", "z"], 1.5, "base: z is not zero, which this form has no place for; add it to d of joint 1"),
        (
            ["base", "yaw"], 1.5,
            "base: yaw is not zero, which this form has no place for; add it to theta_off of joint 1",
        ),
        (["base", "x"], True, f"base: x is true, {NOT_A_NUMBER}"),
        (["base", "x"], "1", f'base: x is "1", {NOT_A_NUMBER}'),
        (["dh", 2, "alpha"], float("nan"), f"dh row 3: alpha is NaN, {TABLE_NOT_FINITE}"),
        (["dh", 2, "alpha"], float("inf"), f"dh row 3: alpha is Infinity, {TABLE_NOT_FINITE}"),
        (["dh", 1, "d"], 3.0, "dh row 2: d is not zero beside beta_joint2; the form has either, set d to 0"),
        (["dh", 1, "joint"], 3, "dh row 2: is for joint 3; list the joints in order, 1, 2, …"),
        (["dh", 1], {"joint": 2}, "dh row 2 lacks the key 'theta_off'; add it"),
        (["dh"], {}, "dh must be a list with one row per joint: joint, theta_off, d, a, alpha"),
        (
            ["beta_joint6"], 0.0,
            "beta_joint6 is for a joint that no other follows: dh has 6 rows; give one row per joint, or remove it",
        ),
    ],
)  # fmt: skip
def test_a_spoilt_table_names_the_place(place, value, message, save):
    table = seed_table(lite6_parameters()[1])
    *above, last = place
    within = table
    for key in above:
        within = within[key]
    within[last] = value
    path = save(json.dumps(table), "t.json")
    assert refusal(read_table, path) == f"{path}: {message}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", ": line 1: not valid JSON (Expecting value); correct the file"),
        ('{"units":\n 1 2}', ": line 2: not valid JSON (Expecting ',' delimiter); correct the file"),
        ('{"dh": 1, "dh": 2}', ": the key 'dh' is given twice; keep one"),
        ("[1]", ": must be a JSON object with the keys units, base, dh and beta_joint2"),
        ("[" * 100_000, ": not valid JSON (nested too deeply or a malformed number); correct the file"),
        (
            '{"units": 1e99999999999999999999}',
            ": not valid JSON (nested too deeply or a malformed number); correct the file",
        ),
    ],
)
def test_not_a_table(text, message, save):
    path = save(text, "t.json")
    assert refusal(read_table, path) == f"{path}{message}"


def test_write_table_refuses_what_the_form_does_not_hold(tmp_path):
    path = tmp_path / "t.json"
    form, parameters = lite6_parameters()
    assert refusal(write_table, form, parameters[1:], path) == (
        f"{path}: a table of this form needs 28 finite numbers, not an array (27,)"
    )
    parameters[3] = np.inf
    assert refusal(write_table, form, parameters, path) == (
        f"{path}: a table of this form needs 28 finite numbers, not an array (28,)"
    )
    assert not path.exists()
