"""Effects as text, JSON and a user's file; what a motion cannot show; and every message."""

import json
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typed import refusal

from lite6jax.arms.chains import SixParameterForm
from lite6jax.effects import catalogue as catalogue_module
from lite6jax.effects import user_effects
from lite6jax.effects.catalogue import catalogue, kinds_of, untestable
from lite6jax.effects.composition import Physics
from lite6jax.effects.drivers import QUANTITIES, Driver, driver_of
from lite6jax.effects.kinematic import (
    BaseCompliance,
    BaseDrift,
    FrameOffset,
    GravityDirection,
    JointBacklash,
    JointCompliance,
    JointCoupling,
    JointHarmonic,
    JointLag,
    JointThermalOffset,
    LinkCompliance,
    LinkThermalExpansion,
    PayloadCom,
    SensorDrift,
    TimeOffset,
    ToolCompliance,
    ToolOffset,
)
from lite6jax.effects.motion import motion_of, since_reversal
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.serialization import effect_as_dict, effect_from_dict, parse_effect
from lite6jax.effects.statics import Loads
from lite6jax.effects.user_effects import load_effects
from lite6jax.model import arm_model, predict, predict_poses
from tests.oracles.arms import random_kinematics

RNG = np.random.default_rng(0)
BARE = motion_of(RNG.uniform(-1, 1, (4, 6)))


@pytest.mark.parametrize(
    ("text", "effect", "values"),
    [
        ("joint_compliance:joint=2,compliance_rad_per_Nm=9e-5", JointCompliance(2), [9e-5]),
        (" joint_compliance : joint = 2 , compliance_rad_per_Nm = 9e-5 ", JointCompliance(2), [9e-5]),
        ("joint_harmonic:joint=1,order=2,amplitude_rad=1e-3", JointHarmonic(1, 2.0), [1e-3, 0]),
        ("link_thermal_expansion:link=2,expansion_per_K=2e-5", LinkThermalExpansion(2), [2e-5]),
        ("frame_offset:rz_rad=1e-3,x_m=2e-3", FrameOffset(), [2e-3, 0, 0, 0, 0, 1e-3]),
        ("joint_backlash:joint=2,gap_rad=1e-3,friction_torque_Nm=0.5", JointBacklash(2, 0.5), [1e-3]),
        ("joint_backlash:joint=2,gap_rad=1e-3,friction_torque_Nm=0", JointBacklash(2, 0.0), [1e-3]),
        (
            "base_compliance:cross=true,shift=true,shift_yx_m_per_Nm=1e-5",
            BaseCompliance(cross=True, shift=True),
            [0, 0, 0, 0, 0, 1e-5, 0],
        ),
        ("base_compliance:shift=true,shift_xx_m_per_Nm=1e-5", BaseCompliance(shift=True), [0, 0, 1e-5, 0, 0, 0]),
        ("tool_offset:turned=true,rx_rad=0.1", ToolOffset(turned=True), [0, 0, 0, 0.1, 0, 0]),
        (
            "unnamed:where=joint3,driver=time,lower=0,upper=2.5,kernel=line,coefficient2_rad=2",
            Unnamed("joint3", "time", 0.0, 2.5, "line"),
            [0, 2],
        ),
    ],
)
def test_effects_as_text(text, effect, values):
    found, numbers = parse_effect(text)
    assert found == effect
    np.testing.assert_allclose(numbers, values, rtol=1e-15, atol=1e-19)


NAMES = ", ".join(catalogue_module.POSE_EFFECTS)


NO_EFFECTS = """
joint_complaince:joint=2
    effect 'joint_complaince': unknown; the catalogue has joint_offset,
joint_compliance:joint=2,stiffness=1
    joint_compliance: the key 'stiffness' is unknown; the keys are joint, compliance_rad_per_Nm
joint_compliance:compliance_rad_per_Nm=1
    joint_compliance: joint is not given; the keys are joint, compliance_rad_per_Nm
joint_compliance:joint=2
    joint_compliance: no parameter is given; the keys are joint, compliance_rad_per_Nm
joint_compliance:joint
    joint_compliance: 'joint' is not key=value; the keys are joint, compliance_rad_per_Nm
joint_compliance:joint=2,joint=3
    joint_compliance: joint is given twice; keep one
joint_compliance:joint=two
    joint_compliance: joint is 'two'; give a whole number
tool_offset:turned=1,x_m=1
    tool_offset: turned is 1; give true or false
unnamed:where=1
    unnamed: where is 1; give a name
joint_compliance:joint=0,compliance_rad_per_Nm=1
    joint_compliance: joint is 0; joints and links count from 1
joint_compliance:joint=2,compliance_rad_per_Nm=9e
    joint_compliance: compliance_rad_per_Nm is '9e'; give a number
joint_compliance:joint=2,compliance_rad_per_Nm=nan
    joint_compliance:joint2: compliance_rad_per_Nm is nan; give a finite number
joint_harmonic:joint=1,amplitude_rad=1e-3
    joint_harmonic:joint1: no order is given; say how often the error comes in a turn, as order=2
joint_harmonic:joint=1,order=-2,amplitude_rad=1
    joint_harmonic:joint1: order is -2; give a positive number
joint_harmonic:joint=1,order=2,amplitude_rad=-1
    joint_harmonic:joint1: amplitude_rad is -1; make it positive and add pi to phase_rad
joint_harmonic:joint=1,order=2,amplitude=1
    joint_harmonic: the key 'amplitude' is unknown; the keys are joint, order, amplitude_rad, phase_rad
joint_coupling:joint=1,source_joint=1,coupling=1
    joint_coupling:joint1: its source_joint is itself; that is joint_scale
joint_backlash:joint=1,gap_rad=1e-3,friction_torque_Nm=-1
    joint_backlash:joint1: friction_torque_Nm is -1; give zero or a positive number
joint_windup:joint=1,compliance_rad_per_Nm=1e-3,friction_torque_Nm=1e999
    joint_windup:joint1: friction_torque_Nm is inf; give zero or a positive number
joint_warm_up:joint=1,amplitude_rad=1e-3,time_constant_s=0
    joint_warm_up:joint1: time_constant_s is 0; give a positive number
base_compliance:shift=true,compliance_xy_rad_per_Nm=1
    base_compliance: the key 'compliance_xy_rad_per_Nm' is unknown; the keys are cross, shift,
unnamed:joint=1
    unnamed: where is not given; the keys are where, driver, lower, upper, kernel, component, further, spread,
unnamed:where=elbow,driver=time,lower=0,upper=1
    unnamed: no site is called 'elbow'; choose jointN, linkN, base, tool or sensor
unnamed:where=joint1,driver=time,lower=0,upper=1,component=x
    unnamed:joint1: component 'x' is not possible there; give rz
unnamed:where=base,driver=time,lower=0,upper=1,component=w
    unnamed:base: component 'w' is not possible there; give one of x y z rx ry rz
unnamed:where=sensor,driver=time,lower=0,upper=1,component=scale x
    unnamed:sensor: component 'scale x' is not possible there; give one of x y z rx ry rz, or scale
unnamed:where=tool,driver=time,lower=0,upper=1,component=scale
    unnamed:tool: component 'scale' is not possible there; give one of x y z rx ry rz
unnamed:where=base,driver=time,lower=1,upper=1
    unnamed:base: the bounds (1.0, 1.0) are not those of 1 drivers; give lower < upper of each
unnamed:where=joint1,driver=time and payload,lower=0,upper=1,kernel=line*line
    unnamed:joint1: the bounds (0.0, 1.0) are not those of 2 drivers; give lower < upper of each
unnamed:where=tool,driver=time,lower=0,upper=1,kernel=jagged
    unnamed:tool: kernel 'jagged' is not possible with 1 drivers; give one of line, cubic, smooth, medium, fine,
unnamed:where=base,driver=weather,lower=0,upper=1
    driver 'weather': unknown; choose one of position, direction of motion, velocity, speed, travel since reversal,
"""
"""Texts, and below each the line with which it is refused, or its beginning."""


@pytest.mark.parametrize(("text", "message"), re.findall(r"^(\S.*)\n    (.+)$", NO_EFFECTS, re.MULTILINE))
def test_text_that_is_no_effect(text, message):
    assert refusal(parse_effect, text).startswith(message)


NO_DOCUMENTS = """
"joint_offset"
    effect 'joint_offset': is not a mapping; give effect, where and parameters
{"where": {}}
    effect None: unknown; the catalogue has ALL
{"effect": ["joint_offset"]}
    effect ['joint_offset']: unknown; the catalogue has ALL
{"effect": "joint_offset", "where": [1]}
    joint_offset: where is [1]; give a mapping of names to values
{"effect": "joint_offset", "where": {"joint": true}}
    joint_offset: joint is True; give a whole number
{"effect": "joint_offset", "where": {"joint": 1}, "site": "joint2", "parameters": {"offset_rad": 1}}
    joint_offset: the site 'joint2' is not that of {'joint': 1}; correct one
{"effect": "joint_offset", "where": {"joint": 1}, "parameters": {"offset": 1}}
    joint_offset:joint1: has no 'offset'; it takes offset_rad
{"effect": "joint_offset", "where": {"joint": 1}, "parameters": {}}
    joint_offset:joint1: no number is given; it takes offset_rad
{"effect": "joint_offset", "where": {"joint": 1}, "parameters": {"offset_rad": {"std": 1}}}
    joint_offset:joint1: offset_rad: Object missing required field `value`
{"effect": "joint_harmonic", "where": {"joint": 1, "order": 2}, "parameters": {"order": 3, "amplitude_rad": 1e-3}}
    joint_harmonic:joint1: order 3 beside the fixed order 2; give one of them
{"effect": "joint_windup", "where": {"joint": 1, "friction_torque_Nm": 2}, "parameters": {"friction_torque_Nm": 3}}
    joint_windup:joint1: friction_torque_Nm 3 beside the fixed friction_torque_Nm 2; give one of them
{"effect": "joint_backlash", "where": {"joint": 1}, "parameters": {"friction_torque_Nm": 3}}
    joint_backlash:joint1: has no 'friction_torque_Nm'; it takes gap_rad
{"effect": "joint_coupling", "where": {"joint": 1, "source_joint": 2}, "parameters": {"coupling": 1, "source_joint": 3}}
    joint_coupling:joint1: source_joint 3 beside the fixed source_joint 2; give one of them
"""


@pytest.mark.parametrize(("document", "message"), re.findall(r"^(\S.*)\n    (.+)$", NO_DOCUMENTS, re.MULTILINE))
def test_documents_that_are_no_effect(document, message):
    assert refusal(effect_from_dict, json.loads(document)) == message.replace("ALL", NAMES)


def test_a_motion_without_drivers_tests_few_effects_and_says_why():
    lacking = {u.effect: u.driver for u in untestable(catalogue(6), BARE, loads_known=False)}
    testable = [effect for effect in catalogue(6) if effect not in lacking]
    assert {effect.name for effect in testable} == {
        *("joint_offset", "joint_scale", "joint_harmonic", "joint_coupling", "frame_offset"),
        *("tool_offset", "measurement_scale", "axis_wobble"),
    }
    assert {effect: (lacking[effect].phrase, lacking[effect].remedy) for effect in SOME} == SOME


MASSES = "the masses of the links; add `inertial` to the arm's description"
SOME = {
    JointCompliance(2): ("gravity torque of joint 2", MASSES),
    LinkCompliance(3): ("gravity moment x of link 3", MASSES),
    LinkThermalExpansion(): ("temperature rise", "a temperature; record temp1_degC … or ambient_degC"),
    JointLag(1): (
        "velocity of joint 1",
        "the velocities of a moving arm; record a trajectory with time_s or dq1_rad_per_s …",
    ),
    JointBacklash(6): (
        "direction of motion of joint 6",
        "the directions of motion; keep the rows in the order of recording",
    ),
    TimeOffset(): ("time", "the times of the samples; record time_s"),
    BaseDrift(): ("time", "the times of the samples; record time_s"),
    SensorDrift(): ("time", "the times of the samples; record time_s"),
    JointThermalOffset(4): (
        "temperature of joint 4",
        "the temperature of each joint; record temp1_degC … or ambient_degC",
    ),
    ToolCompliance(): ("tool moment x", MASSES),
    GravityDirection(): ("base moment x", MASSES),
    PayloadCom(): ("base moment x", MASSES),
}


def test_a_motion_with_all_drivers_tests_the_whole_catalogue():
    q = RNG.uniform(-1, 1, (4, 6))
    full = motion_of(q, joint_velocity=q, direction=q, time=np.arange(4.0), ambient_temperature=np.full(4, 30.0))
    assert untestable(catalogue(6), full, loads_known=True) == []


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (
            LinkThermalExpansion(),
            "link_thermal_expansion:links: needs the temperature rise: give a temperature; record temp1_degC … or "
            "ambient_degC",
        ),
        (
            JointCompliance(2),
            "joint_compliance:joint2: needs the gravity torque of joint 2: give the masses of the links; add "
            "`inertial` to the arm's description",
        ),
        (FrameOffset(7), "frame_offset:link7: acts at joint 7, but the arm has 6 joints; choose one of them"),
        (JointCoupling(1, 8), "joint_coupling:joint1: acts at joint 8, but the arm has 6 joints; choose one of them"),
    ],
)
def test_a_prediction_without_its_driver_is_refused_by_name(effect, message):
    chain, model = SixParameterForm(6), arm_model(random_kinematics(RNG, 6).ravel())
    values = np.zeros(effect.size)
    assert refusal(predict_poses, chain, Physics((effect,)), model, values, BARE) == message


def test_the_last_link_has_no_next_joint():
    warm = motion_of(np.zeros((2, 3)), ambient_temperature=[30.0, 31.0])
    chain, model = SixParameterForm(3), arm_model(random_kinematics(RNG, 3).ravel())
    message = refusal(predict_poses, chain, Physics((LinkThermalExpansion(3),)), model, np.zeros(1), warm)
    assert message == ("link_thermal_expansion:link3: no joint follows the last link; choose a link from 1 to 2")


def everything():
    q = RNG.uniform(-1, 1, (5, 2))
    motion = motion_of(
        q,
        joint_velocity=2 * q,
        direction=np.sign(q),
        time=np.arange(5.0),
        ambient_temperature=np.linspace(20, 30, 5),
        payload=np.arange(5.0),
        measured_position=RNG.uniform(-1, 1, (5, 3)),
    )
    return motion, Loads(*(jnp.asarray(RNG.uniform(-1, 1, shape)) for shape in ((2, 3, 5), (3, 5), (3, 5))))


def test_drivers_are_read_and_said():
    motion, loads = everything()
    for driver, values, unit in [
        (Driver("position", 2), motion.joint_position[1], "rad"),
        (Driver("slide position", 2), motion.joint_position[1], "m"),
        (Driver("gravity force", 2), loads.moment[1, 2], "N"),
        (Driver("direction of motion", 1), motion.direction[0], "1"),
        (Driver("velocity", 2), motion.joint_velocity[1], "rad/s"),
        (Driver("speed", 2), np.sqrt(motion.joint_velocity[1] ** 2), "rad/s"),
        (Driver("travel since reversal", 2), since_reversal(motion)[1], "rad"),
        (Driver("gravity torque", 2), loads.moment[1, 2], "Nm"),
        (Driver("gravity moment x", 1), loads.moment[0, 0], "Nm"),
        (Driver("gravity moment y", 1), loads.moment[0, 1], "Nm"),
        (Driver("base moment x"), loads.base_moment[0], "Nm"),
        (Driver("base moment y"), loads.base_moment[1], "Nm"),
        (Driver("temperature rise"), motion.temperature_rise, "K"),
        (Driver("time"), motion.time, "s"),
        (Driver("payload"), motion.payload, "kg"),
        (Driver("temperature", 2), motion.joint_temperature_rise[1], "K"),
        (Driver("tool moment x"), loads.payload_moment[0], "Nm"),
        (Driver("tool moment y"), loads.payload_moment[1], "Nm"),
        (Driver("measured position x"), motion.measured_position[0], "m"),
        (Driver("measured position z"), motion.measured_position[2], "m"),
    ]:
        np.testing.assert_array_equal(driver.values(motion, loads), values)
        assert (driver.unit, driver.known(motion, loads)) == (unit, True)
        assert driver_of(driver.phrase) == driver
    assert Driver("gravity torque", 2).phrase == "gravity torque of joint 2"
    assert Driver("gravity moment x", 2).phrase == "gravity moment x of link 2"
    assert Driver("temperature", 2).phrase == "temperature of joint 2"
    assert not Driver("tool moment x").known(motion, loads._replace(payload_moment=None))
    distance = Driver("measured position's distance").values(motion, loads)
    np.testing.assert_allclose(distance, np.linalg.norm(motion.measured_position, axis=0), rtol=1e-15)
    assert not Driver("measured position's distance").known(motion._replace(measured_position=None), loads)
    x, y, z = motion.measured_position
    azimuth, elevation = (Driver(f"measured position's {k}").values(motion, loads) for k in ("azimuth", "elevation"))
    np.testing.assert_allclose(distance * np.cos(elevation) * np.cos(azimuth), x, atol=1e-15)
    np.testing.assert_allclose(distance * np.cos(elevation) * np.sin(azimuth), y, atol=1e-15)
    np.testing.assert_allclose(distance * np.sin(elevation), z, atol=1e-15)
    assert not Driver("measured position's elevation").known(motion._replace(measured_position=None), loads)
    commanded = motion._replace(command_velocity=2 * motion.joint_position)
    np.testing.assert_array_equal(Driver("command velocity", 2).values(commanded, None), 2 * motion.joint_position[1])
    assert not Driver("command velocity", 2).known(motion, loads)
    assert len(QUANTITIES) == 31


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Driver("torque", 1), f"driver 'torque': unknown; choose one of {', '.join(QUANTITIES)}"),
        (lambda: Driver("position"), "driver 'position': its joint is missing; write 'position of joint 1'"),
        (lambda: Driver("time", 1), "driver 'time': is a quantity of the whole arm; give no joint"),
        (
            lambda: driver_of("position of joint two"),
            "driver 'position of joint two': does not end in a number; write it like 'gravity torque of joint 2'",
        ),
        (
            lambda: Driver("velocity", 1).values(BARE, None),
            "velocity of joint 1: is required but missing; give the velocities of a moving arm; record a "
            "trajectory with time_s or dq1_rad_per_s …",
        ),
        (
            lambda: Driver("position", 7).values(BARE, None),
            "position of joint 7: the arm has 6 joints; choose one of them",
        ),
        (
            lambda: Unnamed("tool", "time and payload", 0.0, 1.0, "smooth", further=(0.0, 1.0)),
            "unnamed:tool: kernel 'smooth' is not possible with 2 drivers; give two that are joined by *, such as "
            "smooth*line",
        ),
        (
            lambda: Unnamed("tool", "time and payload", 0.0, 1.0, "play*line", further=(0.0, 1.0)),
            "unnamed:tool: kernel 'play*line' is not possible with 2 drivers; give two that are joined by *, such as "
            "smooth*line",
        ),
        (
            lambda: Unnamed("joint1", "position of joint 1", 0.0, 1.0, rolloff=(2.0, 1.0)),
            "unnamed:joint1: rolloff (2.0, 1.0) is not possible; give corner and slope of a spectrum",
        ),
        (
            lambda: Unnamed("joint1", "time", 0.0, 1.0, "step", rolloff=(2.0,)),
            "unnamed:joint1: a step is not possible at (2.0,); give one value within its range",
        ),
        (
            lambda: Unnamed("joint1", "position of joint 1", 0.0, 1.0, "spectrum", rolloff=(0.0, 1.0)),
            "unnamed:joint1: rolloff (0.0, 1.0) is not possible; give corner and slope of a spectrum",
        ),
    ],
)
def test_drivers_and_processes_that_are_not(make, message):
    assert refusal(make) == message


@pytest.mark.parametrize(
    "effect",
    [
        Unnamed("joint2", "position of joint 2 and direction of motion of joint 2", -1.0, 1.0, "smooth*line",
                further=(-1.0, 1.0), spread=2e-4),
        Unnamed("link1", "gravity torque of joint 2 and position of joint 1", -1.0, 1.0, "cubic*wave", "ry",
                (-1.0, 2.0)),
        Unnamed("joint1", "position of joint 1", -1.0, 1.0, "spectrum", spread=1e-4, rolloff=(8.0, 2.0)),
        Unnamed("joint1", "position of joint 1", -1.0, 1.0, "repeat", spread=1e-4, rolloff=(7.854, 2.0)),
        Unnamed("joint1", "position of joint 1 and gravity torque of joint 2", -1.0, 1.0, "sine*line",
                further=(-1.0, 1.0), spread=1e-4, rolloff=(7.854,)),
        Unnamed("joint2", "gravity torque of joint 2", -1.0, 1.0, "play"),
        Unnamed("sensor", "measured position's distance", 0.0, 2.0, "cubic", "scale"),
    ],
    ids=lambda effect: effect.kernel,
)  # fmt: skip
def test_a_process_deflects_by_its_functions_and_survives_its_file(effect):
    motion, loads = everything()
    values, at = RNG.uniform(-1, 1, effect.size), np.asarray(effect.values_at(motion, loads))
    functions = np.asarray(effect.functions_at(at, motion.run))
    assert functions.shape == (effect.size, 5) == (len(effect.coordinates), 5)
    parts = [part for part in effect.deflect(jnp.asarray(values), motion, loads) if part is not None]
    (moved,) = (np.asarray(part).reshape(-1, 5) for part in parts)
    np.testing.assert_allclose(moved[moved.any(1)], [values @ functions], rtol=0, atol=1e-12)
    (unit,) = (np.asarray(part) for part in effect.units(functions, motion) if part is not None)
    np.testing.assert_allclose(np.tensordot(values, unit, 1).reshape(-1, 5), moved, rtol=0, atol=1e-12)
    again, numbers = effect_from_dict(json.loads(json.dumps(effect_as_dict(effect, values))), kinds_of(()))
    assert again == effect
    np.testing.assert_array_equal(numbers, values)


def example():
    """The file that the documentation of user effects shows."""
    return user_effects.__doc__.split("```python\n")[1].split("```")[0]


def test_the_documented_file_of_a_user_works_like_the_catalogue(tmp_path):
    path = tmp_path / "my_effects.py"
    path.write_text(example())
    effects = load_effects(path)
    assert [effect.label for effect in effects] == [f"cable_drag:joint{i}" for i in range(1, 7)]
    kinds = kinds_of(effects)
    effect, values = parse_effect("cable_drag:joint=2,drag_rad=2e-3", kinds)
    assert effect == effects[1]
    document = json.loads(json.dumps(effect_as_dict(effect, values)))
    again, numbers = effect_from_dict(document, kinds)
    assert again == effect
    np.testing.assert_array_equal(numbers, values)
    # it deflects, and can be differentiated, like a built-in one
    chain, model = SixParameterForm(6), arm_model(random_kinematics(RNG, 6).ravel())
    physics = Physics((effect,))
    q = np.asarray(BARE.joint_position.T).copy()
    q[:, 1] += 2e-3 * np.tanh(q[:, 1])
    found = predict_poses(chain, physics, model, values, BARE)
    np.testing.assert_allclose(found, predict(chain, model, q), rtol=0, atol=1e-14)
    slope = jax.jvp(lambda v: predict_poses(chain, physics, model, v, BARE), (jnp.zeros(1),), (jnp.ones(1),))[1]
    assert np.abs(slope).max() > 0.01
    assert untestable(effects, BARE, loads_known=False) == []
    assert refusal(parse_effect, "cable_drag:joint=2,drag=1", kinds) == (
        "cable_drag: the key 'drag' is unknown; the keys are joint, drag_rad"
    )


HEAD = example().split("EFFECTS")[0]
LIGHTER = """
from dataclasses import dataclass
from typing import ClassVar, final

from lite6jax import Coordinate
from lite6jax.effects.effect import Loading


@final
@dataclass(frozen=True)
class Balance(Loading):
    name: ClassVar[str] = "balance"
    at: ClassVar[str] = "base"
    quantities: ClassVar[tuple] = ("base moment x",)
    numbers: ClassVar[tuple] = (Coordinate("share", "1", 1e-2),)

    def alter_inertia(self, values, inertia):
        return inertia._replace(gravity=(1 - values[0]) * inertia.gravity)


EFFECTS = [Balance()]
"""


def test_a_user_changes_what_weighs_on_the_arm(tmp_path):
    path = tmp_path / "balance.py"
    path.write_text(LIGHTER)
    (effect,) = load_effects(path)
    assert effect.label == "balance:base"
    path.write_text(LIGHTER.replace("(1 - values[0])", "(2 - values[0])"))
    assert refusal(load_effects, path) == (
        f"{path}: EFFECTS[0]: balance:base changes gravity at zero; choose coordinates that change nothing at zero"
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = (1,\n", "line 1: SyntaxError: '(' was never closed"),
        ("import math\n\nmath.sqrt(-1)\n", "line 3: ValueError: "),
        (HEAD, "has no list EFFECTS; end it with EFFECTS = [MyEffect(joint=1), …]"),
        (HEAD + "EFFECTS = []", "has no list EFFECTS; end it with EFFECTS = [MyEffect(joint=1), …]"),
    ],
)
def test_files_of_a_user_that_fail(tmp_path, text, message):
    path = tmp_path / "mine.py"
    path.write_text(text)
    assert refusal(load_effects, path).startswith(f"{path}: {message}")


SPOILT = """
[CableDrag(1)] -> [CableDrag(1), CableDrag]
    EFFECTS[1]: is the class CableDrag; give an instance, such as CableDrag(joint=1)
[CableDrag(1)] -> [3]
    EFFECTS[0]: 3 is not an effect; derive its class from JointEffect or Bending
@final -> # not
    EFFECTS[0]: CableDrag is not final; write @final above the class
@dataclass(frozen=True) -> # nor
    EFFECTS[0]: CableDrag is not frozen; write @dataclass(frozen=True) above the class
cable_drag -> joint_lag
    EFFECTS[0]: CableDrag has the name of a built-in effect, joint_lag; choose another
name: ClassVar[str] = "cable_drag" -> # none
    EFFECTS[0]: CableDrag has no name; write name: ClassVar[str] = "…" in the class
values[0] * -> values[0] +
    EFFECTS[0]: cable_drag:joint1 changes joint at zero; choose coordinates that change nothing at zero
values[0] * -> values[0] ** 2 * 1e3 *
    EFFECTS[0]: cable_drag:joint1 is not proportional to its coordinates; write linear=False in the Coordinate that it
motion.joint_position[self.joint - 1] -> motion.joint_position
    EFFECTS[0]: cable_drag:joint1 gives joint of shape (2, 2, 3); give (2, 3)
jnp.tanh -> jnp.tanhh
    EFFECTS[0]: CableDrag(joint=1, of_slide=False) fails on a trial motion (AttributeError:
(Coordinate("drag_rad", "rad", 1e-4),) -> ()
    EFFECTS[0]: cable_drag:joint1 has the coordinates []; give at least one, with distinct names
"""
"""Of the documented file what is replaced and by what, and below each the beginning of its line."""


@pytest.mark.parametrize(("old", "new", "message"), re.findall(r"^(\S.*) -> (.*)\n    (.+)$", SPOILT, re.MULTILINE))
def test_effects_of_a_user_that_fail(tmp_path, old, new, message):
    text = f"{HEAD}EFFECTS = [CableDrag(1)]"
    assert old in text
    test_files_of_a_user_that_fail(tmp_path, text.replace(old, new), message)


def test_a_user_may_postpone_annotations(tmp_path):
    path = tmp_path / "postponed.py"
    path.write_text("from __future__ import annotations\n" + example())
    effects = load_effects(path)
    assert parse_effect("cable_drag:joint=3,drag_rad=1", kinds_of(effects))[0] == effects[2]
