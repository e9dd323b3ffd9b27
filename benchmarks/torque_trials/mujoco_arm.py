"""The same arms in MuJoCo, a second physics: its own inverse dynamics, damping, dry friction, armature and springs.

A controller drives the arm along a motion; what it exerts is what a sensor would read.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import mujoco as _mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.concealed.chain import Array, quaternion_from_rotation, rotation_from_rpy
from benchmarks.torque_trials.effects import Hidden
from benchmarks.torque_trials.physics import BODIES, Motion, Setup, change_bodies

mujoco: Any = _mujoco  # its names are made at run time, where no type checker sees them

STEP = 1e-3  # s
_BEFORE = 0.5  # s that the arm is driven before it is recorded
_BANDWIDTH = 150.0  # rad/s, of the controller's errors
_ATTRIBUTES = {
    "viscous_friction": {"damping": "viscous_Nm_s_per_rad"},
    "coulomb_friction": {"frictionloss": "coulomb_Nm"},
    "rotor_inertia": {"armature": "inertia_kg_m2"},
    "joint_spring": {"stiffness": "stiffness_Nm_per_rad", "springref": "rest_rad"},
}
"""Words of a joint, each with the number that it takes."""


class SimulatedArm:
    """An arm as MuJoCo has it, its hidden physics built in.

    Args:
        setup: the arm where it stands.
        hidden: among `plans.SIMULATED`.
        payload: kg at the flange, as declared.
    """

    def __init__(self, setup: Setup, hidden: Sequence[Hidden], payload: float):
        self.model = mujoco.MjModel.from_xml_string(_model(setup, hidden, payload))
        self.data = mujoco.MjData(self.model)

    def exerted(self, q: Array, dq: Array, ddq: Array) -> Array:
        """`(sample, joint)` Nm by MuJoCo's inverse dynamics."""
        found = np.empty_like(q)
        for k, (self.data.qpos[:], self.data.qvel[:], self.data.qacc[:]) in enumerate(zip(q, dq, ddq, strict=True)):
            mujoco.mj_inverse(self.model, self.data)
            found[k] = self.data.qfrc_inverse
        return found

    def driven(self, motion: Motion) -> tuple[Motion, Array]:
        """The motion that the arm makes of one that is wanted, and what its motors exert `(sample, joint)` Nm."""
        model, data = self.model, self.data
        every = round((motion.time[1] - motion.time[0]) / STEP)
        lead = round(_BEFORE / STEP)
        times = STEP * (np.arange((len(motion.time) - 1) * every + lead + 1) - lead)
        wanted, rates, accelerations = motion.curve(times)
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = wanted[0], rates[0]
        shape = (len(motion.time), model.nv)
        q, dq, ddq, torque = (np.empty(shape) for _ in range(4))
        driven, exerted = np.empty(model.nv), np.zeros(model.nv)
        for k in range(len(times)):
            mujoco.mj_forward(model, data)
            error, slip = wanted[k] - data.qpos, rates[k] - data.qvel
            mujoco.mj_mulM(model, data, driven, accelerations[k] + 2 * _BANDWIDTH * slip + _BANDWIDTH**2 * error)
            before, exerted = exerted, driven + data.qfrc_bias
            row, rest = divmod(k - lead, every)
            if rest == 0 and row >= 0:
                # a torque is held for a step: what moves the arm at this instant is between the last one and the next,
                # and either alone would be half a step early or late, which a diagnosis finds
                data.qfrc_applied[:] = torque[row] = (before + exerted) / 2
                mujoco.mj_forward(model, data)
                q[row], dq[row], ddq[row] = data.qpos, data.qvel, data.qacc
            data.qfrc_applied[:] = exerted
            mujoco.mj_step(model, data)
        splines = [CubicSpline(motion.time, values) for values in (q, dq, ddq)]

        def curve(at: Array) -> tuple[Array, Array, Array]:
            place, rate, change = (spline(at) for spline in splines)
            return place, rate, change

        return replace(motion, q=q, dq=dq, ddq=ddq, curve=curve), torque


def _model(setup: Setup, hidden: Sequence[Hidden], payload: float) -> str:
    changed, added = change_bodies(setup, hidden)
    arm, gravity = changed.arm, changed.gravity
    said: dict[int, dict[str, str]] = {}
    for effect in hidden:
        if effect.name not in BODIES:
            if effect.name not in _ATTRIBUTES:
                raise ValueError(f"MuJoCo cannot be given {effect.name}")
            own = {word: repr(float(effect.values[name])) for word, name in _ATTRIBUTES[effect.name].items()}
            said.setdefault(effect.number, {}).update(own)
    root = Element("mujoco")
    SubElement(root, "compiler", angle="radian", autolimits="false")
    # positions and velocities of Euler's steps are half a step apart
    option = SubElement(root, "option", timestep=repr(STEP), gravity=_text(gravity), integrator="RK4")
    SubElement(option, "flag", contact="disable")
    body = SubElement(root, "worldbody")
    for i, row in enumerate(arm.chain.rows):
        turn = quaternion_from_rotation(rotation_from_rpy(*row[3:])[None])[0]
        body = SubElement(body, "body", pos=_text(row[:3]), quat=_text(turn))
        SubElement(body, "joint", {"name": f"joint{i + 1}", "type": "hinge", "axis": "0 0 1", **said.get(i + 1, {})})
        mass, center, tensor = arm.chain.mass[i], arm.chain.center[i], arm.inertia[i]
        if i == arm.chain.dof - 1:
            mass, center, tensor = _lumped(mass, center, tensor, payload + added, setup.payload_center)
        entries = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]]
        SubElement(body, "inertial", pos=_text(center), mass=repr(float(mass)), fullinertia=_text(entries))
    return tostring(root, encoding="unicode")


def _lumped(mass: float, center: Array, tensor: Array, point: float, at: Array) -> tuple[float, Array, Array]:
    """Mass, centre and tensor about it of a body with a point mass (Steiner)."""
    whole = mass + point
    middle = (mass * center + point * at) / whole
    for share, place in ((mass, center), (point, at)):
        way = place - middle
        tensor = tensor + share * (way @ way * np.eye(3) - np.outer(way, way))
    return whole, middle, tensor


def _text(values: Sequence[float] | Array) -> str:
    return " ".join(repr(float(v)) for v in values)
