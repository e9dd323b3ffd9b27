"""Diagnosed servos in other programs: MuJoCo, a stand-in for Isaac Lab, URDF and plain NumPy roll out what we do."""

import json
import re
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from typed import flat, refused, run

from lite6jax.arms.arm import Arm
from lite6jax.arms.files import read_arm, write_urdf
from lite6jax.diagnosis.document import SCHEMA
from lite6jax.diagnosis.servo_export import convert_servos, numpy_rollout
from lite6jax.domains.tracking.entry import model_entry
from lite6jax.domains.tracking.predict import DiagnosedServos, FittedRange
from lite6jax.effects.dynamic import (
    BaseTilt,
    CoulombFriction,
    CoupledFriction,
    JointSpring,
    LoadFriction,
    PayloadTorque,
    StribeckFriction,
    TorqueRipple,
    ViscousFriction,
)
from lite6jax.effects.servo import (
    RIGID_GRIP,
    ClockDrift,
    CommandDelay,
    CommandFilter,
    DeadBand,
    EncoderBacklash,
    EncoderEccentricity,
    EncoderOffset,
    EncoderScale,
    RateLimit,
    Servo,
    ServoFeedforward,
    ServoIntegral,
    ServoStiffness,
    TorqueLimit,
    TorqueSpeedLimit,
)
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms
from tests.domains.tracking.test_rollout import ARMATURE, CENTERS, KINEMATICS, MASSES, TENSORS, bodies

PERIOD = 0.01
ROWS = 100
WITHIN = 0.02
"""Of the RMS of command less read-out, by which other programs differ from our rollout at most."""
LIMITS = np.array([[-3.0, 3.0]] * 3)


def servos(*effects, compensated=False, interpolated=False, inertia=ARMATURE, masses=True):
    """An arm of three joints with effects, each with its numbers."""
    arm = Arm("three", KINEMATICS, joint_limits=LIMITS)
    servo = Servo.ideal(np.array([300.0, 400.0, 250.0]), np.array([12.0, 14.0, 8.0]))
    servo = servo._replace(
        inertia=np.asarray(inertia, float),
        viscous=np.full(3, 0.5),
        coulomb=np.array([0.4, 0.3, 0.2]),
        grip=bodies().grip,
    )
    rigid = bodies()
    return DiagnosedServos(
        arm=arm,
        servo=servo,
        links=rigid.links if masses else np.zeros((3, 10)),
        payload_center=np.array([0.1, 0.0, 0.05]),
        payload=0.0,
        gravity=np.array([0.0, 0.0, -9.81]),
        compensated=compensated,
        terms=Terms(tuple(effect for effect, _ in effects)),
        values=np.concatenate([np.zeros(0), *(np.atleast_1d(numbers) for _, numbers in effects)]),
        step=0.001,
        interpolated=interpolated,
        ranges=FittedRange(np.array([[-2.0, 2.0]] * 3), np.array([[-9.0, 9.0]] * 3)),
    )


def commands(seed=1):
    """A pause and sines, `(sample, joint)` rad."""
    t = np.maximum(PERIOD * np.arange(ROWS) - 0.1, 0.0)[:, None]
    rates = np.random.default_rng(seed).uniform(0.7, 1.1, 3)
    return 0.3 * np.sin(2 * np.pi * rates * t) + np.array([0.1, -0.4, 0.3])


TIME = PERIOD * np.arange(ROWS)


def apart(model, position, u):
    """The RMS by which positions differ from our rollout, of the RMS of command less read-out."""
    ours = model.predict(TIME, u).position
    return np.sqrt(np.mean((position - ours) ** 2) / np.mean((u - ours) ** 2))


# ------------------------------------------------------------------ NumPy


EVERY = [
    (ClockDrift(), 2e-3),
    (CommandDelay(1), 0.013),
    (CommandDelay(2), -0.004),
    (CommandFilter(1), 0.02),
    (RateLimit(2), 1 / 0.9),
    (ServoStiffness(3), -0.3),
    (ServoIntegral(1), 150.0),
    (ServoFeedforward(2), 4.0),
    (DeadBand(3), 0.003),
    (TorqueLimit(2), 1 / 9.0),
    (TorqueSpeedLimit(3), [1 / 6.0, 0.1]),
    (StribeckFriction(1), [0.5, 0.2]),
    (LoadFriction(2), 0.05),
    (JointSpring(1), [3.0, -0.5]),
    (EncoderBacklash(3), 0.002),
    (EncoderOffset(1), 0.004),
    (EncoderScale(2), 0.003),
    (EncoderEccentricity(3), [0.002, -0.001]),
    (PayloadTorque(), 0.3),
    (BaseTilt(), [0.02, -0.03]),
    (TorqueRipple(1, 5.0), [0.4, 0.2]),
    (ViscousFriction(2, 0.6), 0.5),
]
"""Of each effect that the page holds, one."""


@pytest.mark.parametrize(("effects", "interpolated"), [(EVERY, False), (EVERY[:3], True)])
def test_the_page_of_numpy_rolls_out_what_we_do(effects, interpolated):
    model = servos(*effects, interpolated=interpolated)
    page = {}
    exec(numpy_rollout(model), page)
    u = commands()
    assert apart(model, page["rollout"](TIME, u), u) < 0.1 * WITHIN


def test_the_page_begins_where_friction_holds_joints():
    model = servos()
    held = model.servo._replace(grip=np.array([RIGID_GRIP, model.servo.grip[1], RIGID_GRIP]))
    model = replace(model, servo=held, friction_share=np.array([1.0, 1.0, -0.5]))
    page = {}
    exec(numpy_rollout(model), page)
    u = commands()
    ours = model.predict(TIME, u).position
    assert np.abs(ours[0] - u[0])[[0, 2]].min() > 5e-4
    assert apart(model, page["rollout"](TIME, u), u) < 0.1 * WITHIN


def test_the_page_needs_numpy_alone_and_holds_arms_without_masses():
    model = servos((CommandDelay(1), 0.02), masses=False)
    text = numpy_rollout(model)
    assert re.findall(r"^ *(?:import|from) .*", text.split('"""')[2], re.MULTILINE) == ["import numpy as np"]
    page = {}
    exec(text, page)
    u = commands()
    assert apart(model, page["rollout"](TIME, u), u) < 0.1 * WITHIN


# ------------------------------------------------------------------ MuJoCo


def stepped(mujoco, path, u, drive=None):
    """Positions `(sample, joint)` rad in MuJoCo after two seconds at the first command.

    `drive` sets what acts before each step, from the number of steps since; else actuators follow the commands.
    """
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:] = u[0]
    parts = round(PERIOD / model.opt.timestep)
    rows = []
    for row in range(-200, ROWS):
        rows.append(data.qpos.copy())
        for part in range(parts):
            if drive is None:
                data.ctrl[:] = u[max(row, 0)]
            else:
                drive(model, data, row * parts + part)
            mujoco.mj_step(model, data)
    return np.array(rows[200:])


@pytest.mark.parametrize(
    ("effects", "compensated"),
    [
        ([(ServoStiffness(1), -0.4), (CoulombFriction(2), 1.0), (CommandDelay(3), 0.02)], False),
        ([(CommandFilter(1), 0.03), (TorqueLimit(2), 1 / 8.0), (JointSpring(3), [4.0, 0.3])], False),
        ([(PayloadTorque(), 0.5), (BaseTilt(), [0.05, -0.05])], False),
        ([(CoulombFriction(1), 0.5)], True),
    ],
)
def test_mujoco_follows_the_commands_as_we_do(tmp_path, effects, compensated):
    mujoco = pytest.importorskip("mujoco")
    model = servos(*effects, compensated=compensated)
    done = convert_servos(model, tmp_path / "arm.xml")
    assert done.difference < 1e-9
    u = commands()
    assert apart(model, stepped(mujoco, done.path, u), u) < WITHIN


def test_the_arm_of_an_mjcf_has_what_was_found(tmp_path):
    pytest.importorskip("mujoco")
    done = convert_servos(servos((CoulombFriction(2), 1.0), (TorqueLimit(1), 0.1)), tmp_path / "arm.xml")
    arm = read_arm(done.path)
    assert arm.coulomb_friction == pytest.approx([0.4, 1.3, 0.2])
    assert arm.viscous_friction == pytest.approx([12.5, 0.5, 0.5])  # with the servo's at joint 1
    assert arm.rotor_inertia == pytest.approx(ARMATURE)
    actuators = {entry.get("joint"): entry for entry in ET.parse(done.path).getroot().iter("position")}
    assert [float(actuators[f"joint{joint}"].get("kp")) for joint in (1, 2, 3)] == [300.0, 400.0, 250.0]
    assert [float(actuators[f"joint{joint}"].get("kv")) for joint in (1, 2, 3)] == [0.0, 14.0, 8.0]
    assert actuators["joint1"].get("forcerange") == "-10.0 10.0"
    assert actuators["joint2"].get("forcerange") is None
    assert done.left_out == ("that joint1 damp beside the torque limit (it is among the friction)",)


def explicit(stiffness, damping, u, limit=np.inf, late=0.0):
    """What acts on joints before a step in MuJoCo: a drive in plain Python."""

    def act(model, data, step):
        h = model.opt.timestep
        rows = np.floor((step * h - late) / PERIOD + 1e-6).astype(int)
        target = u[np.clip(rows, 0, ROWS - 1), [0, 1, 2]]
        data.qfrc_applied[:] = np.clip(stiffness * (target - data.qpos) - damping * data.qvel, -limit, limit)

    return act


# ------------------------------------------------------------------ Isaac Lab

_FIELDS = {
    *("joint_names_expr", "stiffness", "damping", "armature", "friction", "dynamic_friction", "viscous_friction"),
    *("effort_limit", "velocity_limit", "effort_limit_sim", "velocity_limit_sim"),
}
"""Of ActuatorBaseCfg of Isaac Lab 2.3."""


def configuration(*more):
    """A class that takes what a configuration of Isaac Lab takes."""

    class Configuration(SimpleNamespace):
        def __init__(self, **settings):
            assert set(settings) <= _FIELDS | set(more)
            super().__init__(**settings)

    return Configuration


@pytest.fixture
def isaac(monkeypatch):
    """Runs a file of actuators beside a stand-in of Isaac Lab, which is not installed here."""
    module = ModuleType("isaaclab.actuators")
    module.ImplicitActuatorCfg = configuration()
    module.DelayedPDActuatorCfg = configuration("min_delay", "max_delay")
    monkeypatch.setitem(sys.modules, "isaaclab", ModuleType("isaaclab"))
    monkeypatch.setitem(sys.modules, "isaaclab.actuators", module)

    def read(path, physics_dt):
        names = {}
        exec(path.read_text(), names)
        return names["actuators"](physics_dt), module

    return read


def test_actuators_of_isaac_lab_follow_as_we_do(tmp_path, isaac):
    mujoco = pytest.importorskip("mujoco")
    model = servos((CommandDelay(2), 0.02), (TorqueLimit(1), 1 / 8.0), (CoulombFriction(3), 0.5))
    done = convert_servos(model, tmp_path / "actuators.py", "isaac")
    step = 0.0002
    groups, module = isaac(done.path, step)
    assert list(groups) == ["joint1", "joint2", "joint3"]
    assert isinstance(groups["joint1"], module.ImplicitActuatorCfg)
    assert isinstance(groups["joint2"], module.DelayedPDActuatorCfg)
    assert groups["joint2"].min_delay == groups["joint2"].max_delay == 100
    assert groups["joint2"].effort_limit is None
    # the same numbers in another program, in which such actuators are written by hand
    each = [groups[f"joint{joint}"] for joint in (1, 2, 3)]
    numbers = {
        name: np.array([getattr(one, name) for one in each])
        for name in ("stiffness", "damping", "armature", "friction", "viscous_friction")
    }
    plain = convert_servos(servos(), tmp_path / "arm.xml").path
    tree = ET.parse(plain)
    tree.getroot().remove(tree.getroot().find("actuator"))
    tree.getroot().find("option").set("timestep", str(step))
    fields = {"armature": "armature", "frictionloss": "friction", "damping": "viscous_friction"}
    for i, joint in enumerate(tree.getroot().iter("joint")):
        for attribute, field in fields.items():
            joint.set(attribute, str(numbers[field][i]))
    tree.write(plain)
    limit = np.array([one.effort_limit or np.inf for one in each])
    late = step * np.array([getattr(one, "min_delay", 0) for one in each])
    u = commands()
    drive = explicit(numbers["stiffness"], numbers["damping"], u, limit, late)
    assert apart(model, stepped(mujoco, plain, u, drive), u) < WITHIN


# ------------------------------------------------------------------ URDF


def test_a_urdf_with_its_friction_follows_as_we_do(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    model = servos((CoulombFriction(2), 0.5), (PayloadTorque(), 0.3), inertia=np.zeros(3))
    done = convert_servos(model, tmp_path / "arm.urdf")
    # as MuJoCo reads it; its step and how firmly friction holds are no part of a URDF
    spec = mujoco.MjSpec.from_file(str(done.path))
    spec.option.timestep = 0.0002
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for joint in spec.joints:
        joint.solref_friction = [0.002, 1.0]
    (tmp_path / "arm.xml").write_text(spec.compile() and spec.to_xml())
    u = commands()
    drive = explicit(model.model.servo.stiffness, model.model.servo.damping, u)
    assert apart(model, stepped(mujoco, tmp_path / "arm.xml", u, drive), u) < WITHIN


def test_limits_go_into_a_urdf_and_what_is_not_known_stays(tmp_path):
    model = servos((TorqueLimit(2), 1 / 8.0), (RateLimit(3), 0.5))
    done = convert_servos(model, tmp_path / "arm.urdf")
    limits = {joint.get("name"): joint.find("limit") for joint in ET.parse(done.path).getroot().iter("joint")}
    assert [float(limits[f"joint{joint}"].get("effort")) for joint in (1, 2, 3)] == [1000.0, 8.0, 1000.0]
    assert [float(limits[f"joint{joint}"].get("velocity")) for joint in (1, 2, 3)] == [1000.0, 1000.0, 2.0]
    robot = write_urdf(Arm("three", KINEMATICS, joint_limits=LIMITS), tmp_path / "robot.urdf")
    robot.write_text(robot.read_text().replace("1000.0", "55.0"))
    into = convert_servos(model, tmp_path / "mine.urdf", into=robot)
    limits = {joint.get("name"): joint.find("limit") for joint in ET.parse(into.path).getroot().iter("joint")}
    assert [float(limits[f"joint{joint}"].get("effort")) for joint in (1, 2, 3)] == [55.0, 8.0, 55.0]
    assert [float(limits[f"joint{joint}"].get("velocity")) for joint in (1, 2, 3)] == [55.0, 55.0, 2.0]
    assert read_arm(into.path).coulomb_friction == pytest.approx([0.4, 0.3, 0.2])


# ------------------------------------------------------------------ what is left out, and refused

_NO_GAINS = "stiffness and damping of the servos"
_MOTION = "that rate limits at joint2 are of the command (they are of the joint)"


@pytest.mark.parametrize(
    ("name", "form", "left_out"),
    [
        ("rollout.py", None, ["coupled friction at joint2"]),
        (
            "arm.xml",
            None,
            [
                "the rate of the clock at joint1, joint2 and joint3",
                "the delay of the command at joint2",
                "the rate limit of the command at joint2",
                "the dead band of the servo at joint3",
                "backlash at joint3",
                "coupled friction at joint2",
            ],
        ),
        (
            "actuators.py",
            "isaac",
            [
                "the rate of the clock at joint1, joint2 and joint3",
                "the delay of the command at joint2",
                "the dead band of the servo at joint3",
                "backlash at joint3",
                _MOTION,
                "chain, masses and payload (those of your asset stay)",
                "the tilt of the base",
                "coupled friction at joint2",
            ],
        ),
        (
            "arm.urdf",
            None,
            [
                _NO_GAINS,
                "the delay of the command at joint1 and joint2",
                "the rate of the clock at joint1, joint2 and joint3",
                "the dead band of the servo at joint3",
                "backlash at joint3",
                _MOTION,
                "the tilt of the base",
                "coupled friction at joint2",
                "rotor inertia",
            ],
        ),
        (
            "arm.yaml",
            None,
            [
                _NO_GAINS,
                "the delay of the command at joint1 and joint2",
                "the rate of the clock at joint1, joint2 and joint3",
                "the rate limit of the command at joint2",
                "the dead band of the servo at joint3",
                "backlash at joint3",
                "the tilt of the base",
                "coupled friction at joint2",
            ],
        ),
    ],
)
def test_what_a_form_does_not_hold_is_listed(tmp_path, name, form, left_out):
    if name.endswith(".xml"):
        pytest.importorskip("mujoco")
    effects = [
        (CommandDelay(1), 0.013),
        (CommandDelay(2), -0.004),
        (ClockDrift(), 2e-3),
        (RateLimit(2), 0.5),
        (DeadBand(3), 0.003),
        (EncoderBacklash(3), 0.002),
        (BaseTilt(), [0.02, -0.03]),
        (CoupledFriction(2, source_joint=1), 0.1),
    ]
    done = convert_servos(servos(*effects), tmp_path / name, form)
    assert sorted(done.left_out) == sorted(left_out)


def test_a_model_with_little_leaves_nothing_out(tmp_path):
    assert convert_servos(servos(), tmp_path / "rollout.py").left_out == ()
    compensated = convert_servos(servos(compensated=True), tmp_path / "arm.urdf").left_out
    assert "that the servos carry the weight of the arm" in compensated


@pytest.mark.parametrize(
    ("name", "form", "says"),
    [
        ("arm.json", None, "the form table holds a chain only; write numpy, mjcf, isaac, urdf, description"),
        ("arm.py", "mjcf", "a file of the form mjcf ends in .xml or .mjcf; rename it"),
        ("arm.xml", "isaac", "a file of the form isaac ends in .py; rename it"),
    ],
)
def test_forms_that_hold_no_servos_are_refused(tmp_path, name, form, says):
    with pytest.raises(InputError) as error:
        convert_servos(servos(), tmp_path / name, form)
    assert str(error.value) == f"{tmp_path / name}: {says}"
    assert not (tmp_path / name).exists()


def test_an_arm_without_masses_is_refused_where_they_are_needed(tmp_path):
    pytest.importorskip("mujoco")
    with pytest.raises(InputError, match=r"d.json: MuJoCo needs the mass .*diagnose with a description that has them"):
        convert_servos(servos(masses=False), tmp_path / "arm.xml", source="d.json")
    assert convert_servos(servos(masses=False), tmp_path / "arm.urdf").arm.mass is None


def test_the_command_converts_a_diagnosis_of_commands(tmp_path, capsys):
    model = servos((CommandDelay(1), 0.013), (DeadBand(3), 0.003))
    covariances = [np.eye(1), np.eye(1)]
    document = {"schema": SCHEMA, "domain": "tracking", "model": model_entry(model, covariances)}
    diagnosis = tmp_path / "d.json"
    diagnosis.write_text(json.dumps(document))
    code, out, _ = run(capsys, "convert", diagnosis, tmp_path / "arm.urdf")
    assert code == 0
    assert "Left out: stiffness and damping of the servos; the delay of the command at joint1" in flat(out)
    code, out, _ = run(capsys, "convert", diagnosis, tmp_path / "rollout.py")
    assert "Form numpy, arm three." in flat(out)
    assert "Left out" not in out
    code, out, _ = run(capsys, "convert", diagnosis, tmp_path / "actuators.py", "--to", "isaac", "--json")
    assert json.loads(out)["left_out"] == [
        "the dead band of the servo at joint3",
        "chain, masses and payload (those of your asset stay)",
    ]
    said = refused(capsys, "convert", diagnosis, tmp_path / "a.urdf", "--arm", "lite6")
    assert said == f"--arm: {diagnosis} is of commands and has an arm; leave it out"
    said = refused(capsys, "convert", "lite6", tmp_path / "lite6.py")
    assert said == f"{tmp_path / 'lite6.py'}: the form numpy is of servos; give a diagnosis of commands"


def test_bodies_that_no_links_have_are_said(tmp_path):
    model = servos((PayloadTorque(), -2.0))
    done = convert_servos(model, tmp_path / "arm.urdf")
    assert "inertial numbers that no bodies have" in done.left_out
    assert np.all(read_arm(done.path).mass > 0)
    unchanged = convert_servos(replace(model, terms=Terms(), values=np.zeros(0)), tmp_path / "same.urdf")
    assert read_arm(unchanged.path).mass == pytest.approx(MASSES)
    assert read_arm(unchanged.path).center_of_mass == pytest.approx(CENTERS)
    assert np.diagonal(read_arm(unchanged.path).inertia, axis1=1, axis2=2) == pytest.approx(TENSORS)
