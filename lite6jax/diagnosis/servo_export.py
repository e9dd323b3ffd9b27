"""Diagnosed servos for simulators: an arm with its friction and rotors as MJCF, URDF or description, with position
actuators in MJCF; actuators of Isaac Lab; and a rollout in plain NumPy.
"""

import re
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from lite6jax import storage
from lite6jax.arms import files
from lite6jax.arms.arm import Arm
from lite6jax.arms.mjcf import mjcf_tree, read_mjcf, require_mujoco, write_tree
from lite6jax.arms.trees import format_numbers
from lite6jax.array_types import Array, Mask
from lite6jax.diagnosis.export import with_bodies
from lite6jax.domains.torque.predict import motion_of_joint
from lite6jax.domains.tracking.model import Driven
from lite6jax.domains.tracking.predict import DiagnosedServos, holds_rigidly
from lite6jax.effects.dynamic import BaseTilt, Dynamics, JointTorque, UnnamedInLoop
from lite6jax.effects.servo import UNLIMITED, Servo
from lite6jax.errors import InputError, InputWarning

_PHRASES = {
    "integral": "the integral part of the servo",
    "feedforward": "the velocity feed-forward of the servo",
    "delay": "the delay of the command",
    "clock_rate": "the rate of the clock",
    "time_constant": "the low pass of the command",
    "rate_limit": "the rate limit of the command",
    "dead_band": "the dead band of the servo",
    "torque_limit": "the torque limit of the servo",
    "torque_droop": "the fall of the torque limit with speed",
    "viscous": "viscous friction",
    "coulomb": "Coulomb friction",
    "stribeck": "Stribeck friction",
    "load_friction": "friction in proportion to the load",
    "inertia": "the inertia of the rotor",
    "spring": "the spring",
    "backlash": "backlash",
    "offset": "the offset of the encoder",
    "scale": "the scale of the encoder",
    "eccentricity": "the eccentricity of the encoder",
}
"""What a form may have no place for, by the fields of `Servo`."""
_DRIVES = ("viscous", "coulomb", "inertia", "spring")
_HELD: dict[files.FileForm, tuple[str, ...]] = {
    "numpy": tuple(_PHRASES),
    "mjcf": ("delay", "time_constant", "torque_limit", *_DRIVES),
    "isaac": ("delay", "torque_limit", "rate_limit", "stribeck", "viscous", "coulomb", "inertia"),
    "urdf": ("torque_limit", "rate_limit", *_DRIVES),
    "description": _DRIVES,
}
"""The fields that forms hold, beside stiffness and damping."""
_GAINS: tuple[files.FileForm, ...] = ("numpy", "mjcf", "isaac")
"""The forms that hold stiffness and damping."""
_STEP = 0.0005
"""s, of MuJoCo: a command acts half a step earlier there than it does here."""
_SOFTNESS = "0.002 1"
"""`solreffriction` with which MuJoCo's friction brings joints to rest as ours, for a step of at most 1 ms."""
_STIFFEST = 0.9999
"""The largest impedance of a constraint that MuJoCo takes."""
_WIDTH = "0.95 0.001 0.5 2"
"""The further numbers of its default impedance."""
_POINTS = 401
"""Of a table of a torque, an odd number: rest is one of them."""
_BEYOND = 1.5
"""Times the fitted range, over which a table goes."""
_FINEST = 1e-4
"""rad/s, from rest, that tables of friction resolve."""
_NUMBERS = re.compile(r"^# -- numbers.*?^# -- end of numbers\n", re.DOTALL | re.MULTILINE)
_ENTRY = re.compile(r"^(?P<name>[A-Z_]+) = .*?(?P<comment>  # .*)$")
_TITLE = "Joints that follow position commands, rolled out in plain NumPy."


def convert_servos(
    model: DiagnosedServos,
    target: str | Path,
    form: files.FileForm | None = None,
    overwrite: bool = False,
    into: str | Path | None = None,
    source: str = "diagnosis",
) -> files.Conversion:
    """Writes a diagnosed arm with its servos, and reads back what is an arm.

    Args:
        model: of a diagnosis of commands.
        target: the file to write.
        form: None derives it from the suffix, `.py` being the rollout in NumPy.
        overwrite: whether the target may be replaced.
        into: a URDF, as of `convert_file`.
        source: that errors name.

    Raises:
        InputError: a form that holds a chain only, an arm without masses for MJCF, or as `convert_file`.
    """
    target = Path(target)
    form = servo_form(target, "urdf" if into is not None else form)
    if form not in ("mjcf", *files.OF_SERVOS):
        arm, left_out = diagnosed_servo_arm(model)
        servo = model.model.servo
        limits: dict[Any, Array] = {"effort": _limit(servo.torque_limit), "velocity": _limit(servo.rate_limit)}
        phrases = (*left_out, *_left_out(model, form))
        return files.convert_file(arm, target, form, None, overwrite, phrases, into, limits)
    if target.suffix.lower() not in files.SUFFIXES[form]:
        raise InputError(f"{target}: a file of the form {form} ends in {' or '.join(files.SUFFIXES[form])}; rename it")
    storage.check_writable(target, overwrite)
    if form == "mjcf":
        return _write_mjcf(model, target, overwrite, source)
    text = numpy_rollout(model) if form == "numpy" else isaac_actuators(model)
    storage.write_atomically(target, text, overwrite)
    return files.Conversion(target, form, model.arm, tuple(_left_out(model, form)), 0.0)


def servo_form(target: Path, form: files.FileForm | None = None) -> files.FileForm:
    """The form of a file that holds servos, by its suffix where it is not given.

    Raises:
        InputError: a suffix of no form, or a form that holds a chain only.
    """
    form = form or files.form_of(target, False)
    if form not in _HELD:
        raise InputError(f"{target}: the form {form} holds a chain only; write {', '.join(_HELD)}")
    return form


def diagnosed_servo_arm(model: DiagnosedServos) -> tuple[Arm, tuple[str, ...]]:
    """The arm of a model with its payload, friction, rotors and springs, and what no bodies have, a phrase each."""
    servo = model.model.servo
    stiff = np.maximum(servo.spring, 0.0)
    fields: dict[str, Array] = {
        "viscous_friction": servo.viscous,
        "coulomb_friction": servo.coulomb,
        "rotor_inertia": servo.inertia,
    }
    if stiff.any():
        spring_rest = np.divide(-servo.spring_torque, stiff, out=np.zeros_like(stiff), where=stiff > 0)
        fields |= {"spring_stiffness": stiff, "spring_rest": spring_rest}
    arm = replace(model.arm, dh=None, **{name: np.asarray(values, float) for name, values in fields.items()})
    return with_bodies(arm, model.model.bodies.links, model.gravity)


# ------------------------------------------------------------------ what a form does not hold


def _left_out(model: DiagnosedServos, form: files.FileForm) -> list[str]:
    """What a form has no place for, a phrase each."""
    servo = model.model.servo
    phrases = [] if form in _GAINS else ["stiffness and damping of the servos"]
    for name, phrase in _PHRASES.items():
        present = _present(servo, name)
        if name in _HELD[form]:
            present &= _beyond(servo, name, form)
        if present.any():
            phrases.append(f"{phrase} at {_joints(present)}")
    limited = _present(servo, "torque_limit")
    if form in ("mjcf", "isaac") and limited.any():
        phrases.append(f"that {_joints(limited)} damp beside the torque limit (it is among the friction)")
    moved = _present(servo, "rate_limit")
    if form in ("urdf", "isaac") and moved.any():
        phrases.append(f"that rate limits at {_joints(moved)} are of the command (they are of the joint)")
    if form == "isaac":
        phrases += [f"the speeds of Stribeck friction at {_joints(part)}"] if (part := servo.stribeck > 0).any() else []
        phrases.append("chain, masses and payload (those of your asset stay)")
    if form not in ("numpy", "mjcf"):
        tilts = any(isinstance(term, BaseTilt) for term in model.terms.terms)
        phrases += ["the tilt of the base"] if tilts and model.links.any() else []
        phrases += ["that the servos carry the weight of the arm"] if model.compensated else []
    exported = [effect for effect, _ in model.model.driven if form == "numpy" and _driver_of(effect)]
    omitted = (effect for effect, _ in model.model.driven if effect not in exported)
    return phrases + [f"{_name_of(effect)} at {effect.site}" for effect in omitted]


def _name_of(effect: Driven) -> str:
    """The name of what the motion drives, in words."""
    name = effect.name.replace("_", " ")
    if isinstance(effect, UnnamedInLoop) and effect.component:
        return f"{name} shift of the {effect.component}"
    return name


def _present(servo: Servo, name: str) -> Mask:
    """`(joint,)`, which joints have something beyond an ideal servo."""
    if name == "eccentricity":
        return (servo.sine != 0) | (servo.cosine != 0)
    if name == "spring":
        return (servo.spring != 0) | (servo.spring_torque != 0)
    values = np.asarray(servo._asdict()[name], float)
    if name in ("rate_limit", "torque_limit"):
        return values < UNLIMITED
    return values != 0


def _beyond(servo: Servo, name: str, form: files.FileForm) -> Mask:
    """`(joint,)`, which joints have a number that a form does not take although it has a place for the field."""
    none = np.zeros(len(servo.stiffness), bool)
    if form == "numpy":
        return none
    if name == "spring":
        return servo.spring <= 0
    return servo.delay < 0 if name == "delay" else none


def _joints(present: Mask) -> str:
    joint_names = [f"joint{joint + 1}" for joint in np.flatnonzero(present)]
    return " and ".join(filter(None, (", ".join(joint_names[:-1]), joint_names[-1])))


def _limit(values: Array) -> Array:
    """Limits, infinite where they are never reached."""
    return np.where(np.asarray(values) < UNLIMITED, values, np.inf)


# ------------------------------------------------------------------ MJCF


def _write_mjcf(model: DiagnosedServos, target: Path, overwrite: bool, source: str) -> files.Conversion:
    """Writes position actuators on the joints of the arm."""
    require_mujoco(target)
    arm, left_out = diagnosed_servo_arm(model)
    if arm.mass is None:
        raise InputError(
            f"{source}: MuJoCo needs the mass and inertia of every link, which the diagnosed arm lacks; diagnose with "
            "a description that has them, or write a .urdf or .py"
        )
    servo = model.model.servo
    kv, resisting = _dampings(servo)
    root = mjcf_tree(replace(arm, viscous_friction=resisting), target)
    option = {"timestep": repr(_STEP), "integrator": "implicitfast", "gravity": format_numbers(_gravity(model))}
    root.insert(1, ET.Element("option", option))
    if model.compensated:
        for body in root.iter("body"):
            body.set("gravcomp", "1")
    for joint, firmness in zip(root.iter("joint"), _impedances(model), strict=True):
        if float(joint.get("frictionloss", "0")):
            joint.set("solreffriction", _SOFTNESS)
            joint.set("solimpfriction", f"{format_numbers(np.array([firmness]))} {_WIDTH}")
    actuators = ET.SubElement(root, "actuator")
    for i in range(arm.dof):
        entries = {"kp": servo.stiffness[i], "kv": kv[i]}
        name = f"joint{i + 1}"
        entry = ET.SubElement(actuators, "position", name=name, joint=name)
        for key, value in entries.items():
            entry.set(key, repr(float(value)))
        if servo.torque_limit[i] < UNLIMITED:
            torque_limit = float(servo.torque_limit[i])
            entry.set("forcerange", format_numbers(np.array([-torque_limit, torque_limit])))
        if servo.time_constant[i] > 0:
            entry.set("timeconst", repr(float(servo.time_constant[i])))
        if servo.delay[i] > 0:
            entry.set("delay", repr(float(servo.delay[i])))
            entry.set("nsample", str(int(np.ceil(servo.delay[i] / _STEP)) + 1))
    write_tree(root, target, overwrite)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # of gravity that is compensated, which is meant
        again = read_mjcf(target)
    phrases = (*left_out, *_left_out(model, "mjcf"), *files.omissions(arm, "mjcf"))
    return files.Conversion(target, "mjcf", arm, phrases, files.flange_distance(arm, again))


def _gravity(model: DiagnosedServos) -> Array:
    """`(3,)` m/s², with a tilt of the base that was found."""
    if model.compensated:
        return model.gravity
    return model.model.bodies.gravity


def _dampings(servo: Servo) -> tuple[Array, Array]:
    """`(joint,)` Nm·s/rad, of actuators and of joints.

    Simulators limit the whole torque of a drive. Here its damping is outside the limit, and becomes friction there.
    """
    limited = _present(servo, "torque_limit")
    return np.where(limited, 0.0, servo.damping), servo.viscous + np.where(limited, servo.damping, 0.0)


def _impedances(model: DiagnosedServos) -> Array:
    """`(joint,)`, d0 of `solimpfriction`, with which friction holds as firmly as the grip of the servos."""
    servo = model.model.servo
    mass = model.model.bodies.mass_matrix(np.zeros((model.dof, 1)))[..., 0]
    firmness = servo.grip * np.diagonal(np.linalg.inv(mass + np.diag(servo.inertia)))
    return np.minimum(firmness / (1 + firmness), _STIFFEST)


# ------------------------------------------------------------------ Isaac Lab


def isaac_actuators(model: DiagnosedServos) -> str:
    """Python that makes Isaac Lab's actuators: delayed ones where commands are late, else those of the solver."""
    servo = model.model.servo
    damping, viscous = _dampings(servo)
    joints = [f'"joint{joint}"' for joint in range(1, model.dof + 1)]
    columns = [
        ("JOINTS", f"[{', '.join(joints)}]", "as the articulation calls them"),
        ("STIFFNESS", _listed(servo.stiffness), "Nm/rad"),
        ("DAMPING", _listed(damping), "Nm·s/rad"),
        ("DELAY", _listed(np.maximum(servo.delay, 0.0)), "s"),
        ("EFFORT_LIMIT", _limits(servo.torque_limit), "Nm"),
        ("VELOCITY_LIMIT", _limits(servo.rate_limit), "rad/s"),
        ("ARMATURE", _listed(servo.inertia), "kg·m²"),
        ("FRICTION", _listed(servo.coulomb + servo.stribeck), "Nm, at rest"),
        ("DYNAMIC_FRICTION", _listed(servo.coulomb), "Nm"),
        ("VISCOUS_FRICTION", _listed(viscous), "Nm·s/rad"),
    ]
    numbers = "\n".join(f"{name} = {values}  # {unit}" for name, values, unit in columns)
    return f'''"""Actuators of a {_plain(model.arm.name)} for Isaac Lab, one a joint, by lite6jax.

    from this_file import actuators
    cfg = cfg.replace(actuators=actuators(physics_dt=0.005))  # cfg is an ArticulationCfg

`effort_limit` and `velocity_limit_sim` are names of Isaac Lab 2; Isaac Lab 3 takes them as well.
"""

from isaaclab.actuators import DelayedPDActuatorCfg, ImplicitActuatorCfg

{numbers}


def actuators(physics_dt):
    """Configurations by joint, for a physics step in s."""
    found = {{}}
    for i, joint in enumerate(JOINTS):
        settings = {{
            "joint_names_expr": [joint],
            "stiffness": STIFFNESS[i],
            "damping": DAMPING[i],
            "effort_limit": EFFORT_LIMIT[i],
            "velocity_limit_sim": VELOCITY_LIMIT[i],
            "armature": ARMATURE[i],
            "friction": FRICTION[i],
            "dynamic_friction": DYNAMIC_FRICTION[i],
            "viscous_friction": VISCOUS_FRICTION[i],
        }}
        steps = round(DELAY[i] / physics_dt)
        if steps:
            found[joint] = DelayedPDActuatorCfg(min_delay=steps, max_delay=steps, **settings)
        else:
            found[joint] = ImplicitActuatorCfg(**settings)
    return found
'''


def _limits(values: Iterable[float]) -> str:
    """A list of limits, None where they are never reached."""
    return f"[{', '.join(_shown(float(limit)) if limit < UNLIMITED else 'None' for limit in values)}]"


def _plain(name: str) -> str:
    """A name within a string of Python."""
    return re.sub(r"[^\w .:+()-]", " ", name)


# ------------------------------------------------------------------ NumPy


def numpy_rollout(model: DiagnosedServos) -> str:
    """`domains/tracking/plain_rollout.py` with the numbers of a model."""
    page = (resources.files("lite6jax") / "domains" / "tracking" / "plain_rollout.py").read_text(encoding="utf-8")
    bodies = model.model.bodies
    numbers: dict[str, Any] = {name.upper(): values for name, values in model.model.servo._asdict().items()}
    numbers |= {"KINEMATICS": bodies.kinematics, "LINKS": bodies.links, "GRAVITY": bodies.gravity}
    holds = np.zeros(model.dof)
    share = np.zeros(model.dof)
    if model.friction_share is not None:
        holds = holds_rigidly(model.model.servo).astype(float)
        share = holds * model.friction_share
    numbers |= {"HOLDS": holds, "FRICTION_SHARE": share}
    numbers |= {"STEP": model.step, "INTERPOLATED": model.interpolated, "TABLES": _tables(model)}
    block = _NUMBERS.search(page)
    assert block is not None
    lines = [_with_number(line, numbers) for line in block[0].splitlines()]
    title = f"Joints of a {_plain(model.arm.name)} that follow position commands, in plain NumPy; by lite6jax."
    return page.replace(block[0], "\n".join(lines) + "\n").replace(_TITLE, title)


def _with_number(line: str, numbers: dict[str, Any]) -> str:
    """A line with its number replaced."""
    entry = _ENTRY.match(line)
    if entry is None:
        return line
    value = numbers[entry["name"]]
    if isinstance(value, np.ndarray) and value.ndim == 2:
        rows = "".join(f"    {_listed(row)},\n" for row in value)
        return f"{entry['name']} = np.array([{entry['comment']}\n{rows}])"
    if isinstance(value, list):
        tables = (f"({joint}, {of!r}, {_listed(grid)}, {_listed(torque)})" for joint, of, grid, torque in value)
        return f"{entry['name']} = [{', '.join(tables)}]{entry['comment']}"
    shown = f"np.array({_listed(value)})" if isinstance(value, np.ndarray) else _shown(value)
    return f"{entry['name']} = {shown}{entry['comment']}"


def _listed(values: Iterable[float]) -> str:
    return f"[{', '.join(_shown(float(value)) for value in values)}]"


def _shown(value: bool | float) -> str:
    """A number with as many digits as say anything."""
    if isinstance(value, bool):
        return repr(value)
    return repr(float(f"{value:.12g}")).replace("1000000000.0", "1e9")


def _driver_of(effect: Driven) -> str:
    """Over what a torque is tabulated, position or velocity of its own joint; empty of what is not tabulated."""
    if not isinstance(effect, JointTorque | UnnamedInLoop):
        return ""
    if isinstance(effect, UnnamedInLoop) and effect.component:
        return ""
    if set(effect.drivers) == {effect.own_driver("position")}:
        return "position"
    if effect.drivers and effect.follows_own_motion:
        return "velocity"
    return ""


def _tables(model: DiagnosedServos) -> list[tuple[int, str, Array, Array]]:
    """The torques that are tabulated: joint from 0, over what, its values, and Nm."""
    tables = []
    for effect, values in model.model.driven:
        driver = _driver_of(effect)
        if not driver:
            continue
        assert isinstance(effect, JointTorque | UnnamedInLoop)
        joint = effect.joint - 1
        grid = _grid(model, joint, driver)
        torque = effect.at_joint(values, _motion_along(model, joint, driver, grid))
        tables.append((joint, driver, grid, np.asarray(torque, float)))
    return tables


def _grid(model: DiagnosedServos, joint: int, driver: str) -> Array:
    """Positions over a turn each way, or velocities to beyond the fastest, dense at rest."""
    if driver == "position":
        return np.linspace(-2 * np.pi, 2 * np.pi, 4 * _POINTS)
    fastest = max(_BEYOND * float(np.abs(model.ranges.velocity[joint]).max()), 1.0)
    speeds = np.geomspace(_FINEST, fastest, _POINTS // 2)
    return np.concatenate([-speeds[::-1], [0.0], speeds])


def _motion_along(model: DiagnosedServos, joint: int, driver: str, grid: Array) -> Dynamics:
    """The arm where one joint alone has the values of a grid."""
    still = np.zeros((model.dof, len(grid)))
    moving = still.copy()
    moving[joint] = grid
    if driver == "position":
        motion = motion_of_joint(joint, still[joint], model.arm.slides)._replace(joint_position=moving)
    else:
        motion = motion_of_joint(joint, grid, model.arm.slides)
    return Dynamics(motion, still, model.links, model.payload_center, _nothing, _nothing, model.gravity)


def _nothing(numbers: Array) -> Array:
    raise NotImplementedError("a torque over a joint's own motion needs neither inertia nor gravity")
