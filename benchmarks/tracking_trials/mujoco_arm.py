"""The same arms in MuJoCo, a second physics: actuators with filters and limits, damping, dry friction."""

from collections.abc import Sequence
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import mujoco as _mujoco
import numpy as np

from benchmarks.concealed.chain import Array, quaternion_from_rotation, rotation_from_rpy, rotation_from_vector
from benchmarks.tracking_trials.arms import Bodies
from benchmarks.tracking_trials.effects import NEVER, Hidden, Numbers, altered
from benchmarks.tracking_trials.physics import LEAD, Commands, Setup, start_of

mujoco: Any = _mujoco  # its names are made at run time, where no type checker sees them

STEP = 5e-4  # s
SIMULATED = (
    *("time_offset", "command_delay", "command_filter", "servo_stiffness", "servo_damping", "torque_limit"),
    *("viscous_friction", "coulomb_friction", "rotor_inertia", "joint_spring", "payload_error", "base_tilt"),
    *("encoder_offset", "link_mass", "link_com"),
)
"""What MuJoCo can be given; a delay is of the command that it is given, an offset of what it shows."""
GRIP = "0.999 0.999 0.001 0.5 2"
"""`solimpfriction` of friction that holds nearly rigidly."""
_DIRECT = "0.001 1"  # s and 1, `solreffriction`: twice the step


def follow(setup: Setup, hidden: Sequence[Hidden], commands: Commands, grip: str = GRIP) -> Array:
    """`(run, sample, joint)` rad that encoders show, each run from rest under its first command.

    Args:
        setup: the arm where it stands.
        hidden: among `SIMULATED`.
        commands: what is commanded.
        grip: `solimpfriction` of all joints.

    Raises:
        ValueError: MuJoCo cannot be given an effect.
    """
    for effect in hidden:
        if effect.name not in SIMULATED:
            raise ValueError(f"MuJoCo cannot be given {effect.name}")
    numbers = altered(start_of(setup.arm), tuple(hidden))
    model = mujoco.MjModel.from_xml_string(model_text(setup, numbers, grip))
    return np.stack([_follow(model, numbers, u, commands.period) for u in commands.u])


def _follow(model: Any, numbers: Numbers, u: Array, period: float) -> Array:
    data = mujoco.MjData(model)
    data.qpos[:] = u[0]
    data.act[:] = u[0][numbers["filter"] > 0]
    per_sample = round(period / STEP)
    lead = round(LEAD / STEP)
    shown = np.empty_like(u)
    joints = np.arange(model.nv)
    # of held commands, the mean over a step that they switch in
    late = numbers["delay"] / STEP
    for m in range(lead + (len(u) - 1) * per_sample + 1):
        row, rest = divmod(m - lead, per_sample)
        if rest == 0 and row >= 0:
            shown[row] = data.qpos + numbers["offset"]
        at = m - lead - late
        first = np.floor(at).astype(int)
        share = at - first
        rows = (np.clip((first + k) // per_sample, 0, len(u) - 1) for k in (0, 1))
        before, after = (u[row, joints] for row in rows)
        data.ctrl[:] = before + share * (after - before)
        mujoco.mj_step(model, data)
    return shown


def model_text(setup: Setup, numbers: Numbers, grip: str) -> str:
    """The arm as an MJCF with the actuators of position servos.

    Their damping stands at the joints, where no limit of torque reaches it.
    """
    arm = setup.arm
    tilt = rotation_from_vector(np.array([numbers["tilt_x"][0], numbers["tilt_y"][0], 0.0]))
    shifted = np.stack([numbers["center_x"], numbers["center_y"], numbers["center_z"]])[..., None]
    payload = np.array([setup.payload + numbers["payload"][0]])
    bodies = Bodies.of(arm, payload, setup.payload_center, numbers["link_mass"][:, None], shifted)
    root = Element("mujoco")
    SubElement(root, "compiler", angle="radian", autolimits="false")
    option = SubElement(root, "option", timestep=repr(STEP), gravity=_text(tilt.T @ setup.gravity), integrator="RK4")
    SubElement(option, "flag", contact="disable")
    body = SubElement(root, "worldbody")
    for i, row in enumerate(arm.chain.rows):
        turn = quaternion_from_rotation(rotation_from_rpy(*row[3:])[None])[0]
        body = SubElement(body, "body", pos=_text(row[:3]), quat=_text(turn))
        spring = float(numbers["spring"][i])
        words = {
            "damping": numbers["damping"][i] + numbers["viscous"][i],
            "frictionloss": numbers["coulomb"][i],
            "armature": numbers["rotor"][i],
            "stiffness": spring,
            "springref": -numbers["spring_torque"][i] / spring if spring else 0.0,
        }
        said = {name: repr(float(value)) for name, value in words.items()}
        said |= {"solimpfriction": grip, "solreffriction": _DIRECT}
        SubElement(body, "joint", {"name": f"joint{i + 1}", "type": "hinge", "axis": "0 0 1", **said})
        tensor = bodies.inertia[:, :, i, 0]
        entries = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]]
        mass = repr(float(bodies.mass[i, 0]))
        SubElement(body, "inertial", pos=_text(bodies.center[:, i, 0]), mass=mass, fullinertia=_text(entries))
    actuators = SubElement(root, "actuator")
    for i in range(arm.chain.dof):
        stiffness = repr(float(numbers["stiffness"][i]))
        words = {"joint": f"joint{i + 1}", "gainprm": stiffness, "biastype": "affine", "biasprm": f"0 -{stiffness} 0"}
        if numbers["limit"][i] < NEVER:
            most = float(numbers["limit"][i])
            words |= {"forcelimited": "true", "forcerange": _text([-most, most])}
        if numbers["filter"][i] > 0:
            words |= {"dyntype": "filter", "dynprm": repr(float(numbers["filter"][i]))}
        SubElement(actuators, "general", words)
    return tostring(root, encoding="unicode")


def _text(values: Sequence[float] | Array) -> str:
    return " ".join(repr(float(v)) for v in values)
