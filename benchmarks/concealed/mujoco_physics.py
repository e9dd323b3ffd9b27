"""The same arms in MuJoCo, a second physics: springs, friction, clearance and a soft base that bend because forces act.

Nothing here says δq: a joint is a motor (what the encoder reads) and behind it a hinge of its own, held by a spring, by
two springs of which one yields, or by nothing within a clearance. The arm is driven by servos that err. Poses at rest
without memory are solved for; the rest is simulated.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import mujoco as _mujoco
import numpy as np
from mujoco import rollout

from benchmarks.concealed.chain import Array, quaternion_from_rotation, rotation_from_rpy
from benchmarks.concealed.plain_physics import HARDENING, YIELD, Effects, Hidden, Motion, Setup, hardening

mujoco: Any = _mujoco  # its names are made at run time, where no type checker sees them

SPRINGS = ("joint_compliance", "hardening_spring", "yielding_spring")
GEARS = (*SPRINGS, "joint_backlash")
OFFERED = (*GEARS, "base_compliance", "time_offset", "payload_error")  # the effects that can be built
REMEMBERING = ("joint_backlash", "yielding_spring")

STEP = 1e-3  # s
_MOVE, _REST = 1.0, 0.4  # s: from pose to pose, and until the arm is read
_FLANK = 1e8  # Nm/rad of a gear's flank: at 1e6, what gravity pressed into it was found as the compliance that it was
_SERVO = 4e4  # Nm/rad


@dataclass(frozen=True, eq=False)
class Simulated:
    """What a simulation leaves."""

    motion: Motion  # as the encoders have it
    rotation: Array  # `(sample, 3, 3)` of what the sensor looks at, in the sensor's frame, without noise
    position: Array  # `(sample, 3)` m


class Arm:
    """An arm as MuJoCo has it, its hidden physics built in.

    Args:
        setup: the arm and where it is seen from.
        hidden: among `OFFERED`; every payload error and clock's offset is heeded by `at_rest` and `moving`.
        payload: kg at the flange, as declared.
    """

    def __init__(self, setup: Setup, hidden: Effects, payload: float):
        unknown = [effect.name for effect in hidden if effect.name not in OFFERED]
        if unknown:
            raise ValueError(f"MuJoCo cannot be given {unknown}")
        self.setup, self.hidden = setup, hidden
        self.model = mujoco.MjModel.from_xml_string(_model(setup, hidden, payload))
        self.data = mujoco.MjData(self.model)
        dof = setup.chain.dof
        self.motors = np.array([self.model.joint(f"motor{i + 1}").qposadr[0] for i in range(dof)])
        self.soft = {self.model.joint(name).qposadr[0]: effect for effect in hidden for name in _soft_joints(effect)}

    @property
    def remembers(self) -> bool:
        """Whether where it rests depends on where it came from."""
        return any(effect.name in REMEMBERING for effect in self.hidden)

    def at_rest(self, motion: Motion) -> Simulated:
        """The arm at rest at each of the poses, reached one after the other from the one before."""
        states = self._settled(motion.q) if self.remembers else self._balanced(motion.q)
        return self._seen(states, replace(motion, q=states[:, self.motors]))

    def moving(self, motion: Motion) -> Simulated:
        """The arm driven along the motion's curve; the sensor's clock is late by the hidden offset."""
        assert motion.curve is not None
        offset = sum(effect.values[0] for effect in self.hidden if effect.name == "time_offset")
        before, after = 1.0, 0.5
        times = np.arange(motion.time[0] - before, motion.time[-1] + after, STEP)
        wanted, _ = motion.curve(times)
        positions, velocities = self._driven(wanted)

        def at(instants: Array) -> tuple[Array, Array]:
            return _hermite(times, positions, velocities, instants)

        def curve(instants: Array) -> tuple[Array, Array]:
            q, dq = at(instants)
            return q[:, self.motors], dq[:, self.motors]

        q, dq = curve(motion.time)
        measured = replace(motion, q=q, dq=dq, direction=np.sign(dq), curve=curve)
        return self._seen(at(motion.time + offset)[0], measured)

    def _balanced(self, q: Array) -> Array:
        """Joint coordinates at which every spring holds what gravity pulls: a fixed point, as springs are stiff."""
        model, data = self.model, self.data
        states, force = np.zeros((len(q), model.nq)), np.zeros(model.nv)
        states[:, self.motors] = q
        data.qvel[:] = 0
        for state in states:
            for _ in range(6):
                data.qpos[:] = state
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                mujoco.mj_rne(model, data, 0, force)
                for place, effect in self.soft.items():
                    state[place] = _given(effect, -float(force[place]), place == min(self.soft))
        return states

    def _settled(self, q: Array) -> Array:
        """Joint coordinates read after each move has come to rest."""
        steps, rest = round(_MOVE / STEP), round(_REST / STEP)
        share = np.arange(1, steps + 1) / steps
        smooth = share**3 * (10 - 15 * share + 6 * share**2)
        start = np.repeat(q[:1], 2 * rest, 0)
        ways = [np.concatenate([a + smooth[:, None] * (b - a), np.repeat(b[None], rest, 0)]) for a, b in pairwise(q)]
        positions, _ = self._driven(np.concatenate([start, *ways]))
        return positions[2 * rest - 1 :: steps + rest]

    def _driven(self, wanted: Array) -> tuple[Array, Array]:
        """All joint coordinates `(step, coordinate)` and their rates while servos follow `(step, joint)`."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self.motors] = wanted[0]
        model, data = self.model, self.data
        full = mujoco.mjtState.mjSTATE_FULLPHYSICS
        start = np.zeros(mujoco.mj_stateSize(model, full))
        mujoco.mj_getState(model, data, start, full)
        states: Any = rollout.rollout(model, [data], start[None], wanted[None])[0]
        # time, positions, velocities, …
        return states[0, :, 1 : 1 + model.nq], states[0, :, 1 + model.nq : 1 + model.nq + model.nv]

    def _seen(self, states: Array, motion: Motion) -> Simulated:
        model, data, setup = self.model, self.data, self.setup
        rotation, position = np.empty((len(states), 3, 3)), np.empty((len(states), 3))
        tip = model.site("tip").id
        for k, state in enumerate(states):
            data.qpos[:] = state
            mujoco.mj_kinematics(model, data)
            rotation[k], position[k] = data.site_xmat[tip].reshape(3, 3), data.site_xpos[tip]
        seen = setup.sensor
        return Simulated(motion, seen[:3, :3] @ rotation, position @ seen[:3, :3].T + seen[:3, 3])


def _soft_joints(effect: Hidden) -> tuple[str, ...]:
    if effect.name == "base_compliance":
        return "base1", "base2"
    return (_gear_name(effect),) if effect.name in GEARS else ()


def _gear_name(effect: Hidden) -> str:
    return f"{effect.name}{effect.number}"


def _given(effect: Hidden, load: float, first: bool) -> float:
    """By how much the spring of an effect gives way."""
    if effect.name == "base_compliance":
        return effect.values[0 if first else 1] * load
    if effect.name == "joint_compliance":
        return effect.values[0] * load
    return effect.values[0] * float(hardening(np.array(load / effect.fixed["torque_Nm"])))


def _hermite(times: Array, values: Array, rates: Array, at: Array) -> tuple[Array, Array]:
    """Values and rates between equal steps of time, by cubics."""
    step = times[1] - times[0]
    k = np.clip(((at - times[0]) / step).astype(int), 0, len(times) - 2)
    u = ((at - times[k]) / step)[:, None]
    rise, a, b = values[k + 1] - values[k], rates[k] * step, rates[k + 1] * step
    value = values[k] + u * (a + u * (3 * rise - 2 * a - b + u * (a + b - 2 * rise)))
    return value, (a + u * (2 * (3 * rise - 2 * a - b) + 3 * u * (a + b - 2 * rise))) / step


def _model(setup: Setup, hidden: Effects, payload: float) -> str:
    """The arm in MuJoCo's own words."""
    chain = setup.chain
    # play comes first: its bearing drags against the wall, and a spring beyond it carries the load alone
    gears = sorted((effect for effect in hidden if effect.name in GEARS), key=lambda effect: effect.name in SPRINGS)
    soft_base = next((effect for effect in hidden if effect.name == "base_compliance"), None)
    root = Element("mujoco")
    SubElement(root, "compiler", angle="radian", autolimits="true")
    option = SubElement(
        root, "option", timestep=f"{STEP}", integrator="discrete", gravity="0 0 -9.81", tolerance="1e-12"
    )
    SubElement(option, "flag", contact="disable")
    parent = SubElement(root, "worldbody")
    tendons, actuators = Element("tendon"), Element("actuator")
    if soft_base:
        for axis, c in enumerate(soft_base.values):
            parent = SubElement(parent, "body")
            # a spring of no compliance is a hinge that need not be there
            said = {"stiffness": f"{1 / c:.17g}"} if c > 0 else {"stiffness": "1e9"}
            turns = "1 0 0" if axis == 0 else "0 1 0"
            SubElement(parent, "joint", {"name": f"base{axis + 1}", "axis": turns, "damping": "100"} | said)
            _inertial(parent, 1e-3, np.zeros(3), 1e-3)
    for i, row in enumerate(chain.rows):
        turn = quaternion_from_rotation(rotation_from_rpy(*row[3:])[None])[0]
        parent = SubElement(parent, "body", pos=_text(row[:3]), quat=_text(turn))
        own = [effect for effect in gears if effect.number == i + 1]
        friction = {} if own else {"frictionloss": "0.3"}
        SubElement(
            parent, "joint", {"name": f"motor{i + 1}", "axis": "0 0 1", "armature": "0.1", "damping": "1"} | friction
        )
        servo = {"kp": f"{_SERVO:g}", "kv": f"{_SERVO / 20:g}"}
        SubElement(actuators, "position", {"joint": f"motor{i + 1}"} | servo)
        for effect in own:
            _inertial(parent, 1e-3, np.zeros(3), 1e-4)
            parent = SubElement(parent, "body")
            _gear(parent, tendons, effect)
        _inertial(parent, chain.mass[i], chain.center[i], max(1e-4, 2e-3 * chain.mass[i]))
    total = payload + sum(effect.values[0] for effect in hidden if effect.name == "payload_error")
    if total > 0:
        load = SubElement(parent, "body", pos=_text(setup.payload_center))
        _inertial(load, total, np.zeros(3), 1e-3 * total)
    tool = setup.tool
    seen = _text(quaternion_from_rotation(tool[None, :3, :3])[0])
    SubElement(parent, "site", name="tip", pos=_text(tool[:3, 3]), quat=seen)
    if len(tendons):
        root.append(tendons)
    root.append(actuators)
    return tostring(root, encoding="unicode")


def _gear(body: Element, tendons: Element, effect: Hidden) -> None:
    """What is between the motor and the link of a joint."""
    name, size, fixed = _gear_name(effect), effect.values[0], effect.fixed
    said: dict[str, str] = {"damping": "20"}
    if effect.name == "joint_compliance":
        said["stiffness"] = f"{1 / size:.17g}"
    elif effect.name == "hardening_spring":
        torque = fixed["torque_Nm"]
        said["stiffness"] = f"{torque / size:.17g} 0 {torque * HARDENING / size**3:.17g}"
    elif effect.name == "yielding_spring":
        torque = fixed["torque_Nm"]
        said["stiffness"] = f"{0.5 * torque / size:.17g}"
        slip = SubElement(tendons, "fixed", stiffness=f"{2 * torque / size:.17g}", springyield=f"{YIELD * size:.17g}")
        SubElement(slip, "joint", joint=name, coef="1")
    else:
        half = 0.5 * size
        gap = SubElement(tendons, "fixed", stiffness=f"{_FLANK:g}", springlength=f"{-half:.17g} {half:.17g}")
        SubElement(gap, "joint", joint=name, coef="1")
        # the bearing drags the link against the wall that the joint hangs on, and gravity pulls it
        drag = SubElement(
            tendons,
            "fixed",
            frictionloss=f"{fixed['friction_Nm']:.17g}",
            solimpfriction="0.9999 0.9999 0.001",
            solreffriction="0.002 1",
        )
        for joint in (f"motor{effect.number}", name):
            SubElement(drag, "joint", joint=joint, coef="1")
        said["damping"] = "2"
    SubElement(body, "joint", {"name": name, "axis": "0 0 1"} | said)


def _inertial(body: Element, mass: float, center: Array, inertia: float) -> None:
    SubElement(body, "inertial", mass=f"{mass:.17g}", pos=_text(center), diaginertia=_text([inertia] * 3))


def _text(numbers: Iterable[float]) -> str:
    return " ".join(f"{value:.17g}" for value in numbers)
