"""An arm in MuJoCo with its position servos: what an MJCF file says of them, and where MuJoCo takes its joints."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.arms.files import base_and_tip
from lite6jax.arms.mjcf import read_chain, require_mujoco
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.errors import InputError

_JOINT_TRANSMISSIONS = (0, 1)
"""mjTRN_JOINT and mjTRN_JOINTINPARENT."""
_FIXED_GAIN = 0
_AFFINE_BIAS = 1
_NO_DYNAMICS = 0
_FILTERS = (2, 3)
"""mjDYN_FILTER and mjDYN_FILTEREXACT."""
_LOCKED = 1e10
"""kg·m², the armature by which joints that are not the arm's stand still."""
_REACHED = 1 - 1e-6
"""Of its torque limit, from which a servo is at it."""
_SAME_GAIN = 1e-9
"""By which gain and bias of a position servo differ at most, relative."""
_LEAST_IMPEDANCE = 1e-4
"""mjMINIMP, and one less than mjMAXIMP."""


@final
@dataclass(frozen=True, eq=False)
class Simulator:
    """An arm of an MJCF file with a position servo at each joint.

    Attributes:
        path: the file, without base and tip.
        arm: its chain, masses, friction and rotors.
        stiffness: `(joint,)` Nm/rad.
        damping: `(joint,)` Nm·s/rad, of the servos alone.
        torque_limit: `(joint,)` Nm; infinite where there is none.
        time_constant: `(joint,)` s, of a low pass of the command.
        delay: s, of all commands.
        gravity: `(3,)` m/s² in the base frame.
        compensated: whether the weight of the arm is compensated.
        model: MuJoCo's.
        joints: `(joint,)` numbers of the joints in it.
        actuators: `(joint,)`, of their servos.
    """

    path: Path
    arm: Arm
    stiffness: Array
    damping: Array
    torque_limit: Array
    time_constant: Array
    delay: float
    gravity: Array
    compensated: bool
    model: Any
    joints: Integers
    actuators: Integers

    @property
    def timestep(self) -> float:
        """s."""
        return float(self.model.opt.timestep)

    @property
    def friction_hold(self) -> Array:
        """`(joint,)` kg·m²/s, load over the velocity at which a joint creeps while friction holds it."""
        model = self.model
        dofs = model.jnt_dofadr[self.joints]
        impedance = np.clip(model.dof_solimp[dofs, :2], _LEAST_IMPEDANCE, 1 - _LEAST_IMPEDANCE)
        time, ratio = model.dof_solref[dofs].T
        mass = impedance[:, 0] / (1 - impedance[:, 0]) / model.dof_invweight0[dofs]
        in_time = 2 / (impedance[:, 1] * np.maximum(time, 2 * self.timestep))
        direct = -ratio / impedance[:, 1]
        return mass * np.where(time > 0, in_time, direct)

    def rolled_out(
        self,
        command: Array,
        run: Integers,
        period: float,
        start: Array,
        interpolated: bool = False,
        timestep: float | None = None,
    ) -> "SimulatedMotion":
        """Where MuJoCo takes the joints, from rest at the start of each run.

        Joints of the file that are not the arm's stand still.

        Args:
            command: `(sample, joint)` rad, on an even grid, each held until the next.
            run: `(sample,)`, which changes where a run begins.
            period: s between samples.
            start: `(sample, joint)` rad, of which the first of each run counts.
            interpolated: whether commands go on a line to the next.
            timestep: s; that of the file where not given.
        """
        mujoco = require_mujoco(self.path)
        model = self._locked()
        if timestep is not None:
            model.opt.timestep = timestep
        step = float(model.opt.timestep)
        data = mujoco.MjData(model)
        qpos = model.jnt_qposadr[self.joints]
        dofs = model.jnt_dofadr[self.joints]
        controls = _control_addresses(model)[self.actuators]
        gear = model.actuator_gear[self.actuators, 0]
        filtered = model.actuator_dyntype[self.actuators] != _NO_DYNAMICS
        states = model.actuator_actadr[self.actuators][filtered]
        touching = np.zeros(len(command), bool)
        at_torque_limit = np.zeros(command.shape, bool)
        position = np.empty(command.shape)
        begins = np.r_[True, np.diff(run) != 0]
        taken = 0
        first = 0
        for sample in range(len(command)):
            if begins[sample]:
                first = sample
                taken = 0
                mujoco.mj_resetData(model, data)
                data.ctrl[controls] = gear * command[sample]
                mujoco.mj_step(model, data, nstep=int(np.ceil(self.delay / step)) + 1)  # fills buffers of delays
                data.qpos[:] = model.qpos0
                data.qvel[:] = 0.0
                data.act[:] = 0.0
                data.qpos[qpos] = start[sample]
                data.act[states] = (gear * command[sample])[filtered]
            ahead = (sample - first) * period - taken * step
            position[sample] = data.qpos[qpos] + ahead * data.qvel[dofs]
            touching[sample] = data.ncon > 0
            force = np.abs(data.qfrc_actuator[dofs])
            at_torque_limit[sample] = force > _REACHED * self.torque_limit
            steps = int(np.floor((sample + 1 - first) * period / step + 1e-6)) - taken
            last = sample + 1 == len(command) or begins[sample + 1]
            if not interpolated or last:
                data.ctrl[controls] = gear * command[sample]
                mujoco.mj_step(model, data, nstep=steps)
            else:
                for part in range(steps):
                    share = ((taken + part) * step - (sample - first) * period) / period
                    between = command[sample] + share * (command[sample + 1] - command[sample])
                    data.ctrl[controls] = gear * between
                    mujoco.mj_step(model, data)
            taken += steps
        limited = np.asarray(model.jnt_limited)[self.joints] != 0
        lower, upper = np.where(limited[:, None], model.jnt_range[self.joints], [-np.inf, np.inf]).T
        at_limit = np.any((position < lower) | (position > upper), 1)
        return SimulatedMotion(position, self._clipped(command), touching, at_limit, at_torque_limit)

    def _locked(self) -> Any:
        """MuJoCo's model with the joints that are not the arm's at a standstill."""
        model = copy.copy(self.model)
        others = np.setdiff1d(np.arange(model.nv), model.jnt_dofadr[self.joints])
        model.dof_armature[others] = _LOCKED
        model.dof_frictionloss[others] = 0.0
        return model

    def _clipped(self, command: Array) -> Mask:
        """`(sample,)`, where a command is outside the range to which MuJoCo clips it."""
        model = self.model
        controls = _control_addresses(model)[self.actuators]
        limited = np.asarray(model.actuator_ctrllimited)[controls] != 0
        lower, upper = np.where(limited[:, None], model.actuator_ctrlrange[controls], [-np.inf, np.inf]).T
        controlled = model.actuator_gear[self.actuators, 0] * command
        return np.any((controlled < lower) | (controlled > upper), 1)


@final
@dataclass(frozen=True, eq=False)
class SimulatedMotion:
    """A rollout by MuJoCo.

    Attributes:
        position: `(sample, joint)` rad.
        clipped: `(sample,)` bool, where a command is outside its range.
        touching: likewise, where bodies touch.
        at_limit: likewise, where a joint is beyond the end of its range.
        at_torque_limit: `(sample, joint)` bool, where a servo exerts all it may.
    """

    position: Array
    clipped: Mask
    touching: Mask
    at_limit: Mask
    at_torque_limit: Mask


def read_simulator(name: str | Path) -> Simulator:
    """The arm and the servos of an MJCF file; `model.xml#tip` and `model.xml#base:tip` name a chain of several.

    A servo is `<position>`, or a `<general>` actuator with the same gain and bias, at each joint.

    Raises:
        InputError: as `read_mjcf`; or a joint without an actuator, or with several, or one that is no position servo.
    """
    file, base, tip = base_and_tip(str(name))
    require_mujoco(file)
    arm, model, joints = read_chain(file, base, tip, warn_of_gravity=False)
    names = [model.joint(joint).name or f"(joint {joint})" for joint in joints]
    if arm.sliding:
        raise InputError(
            f"{file}: joint {names[arm.sliding[0]]!r} is prismatic, whose commands are not diagnosed; end the chain "
            f"before it, {Path(file).name}#NAME"
        )
    actuators = np.array([_servo_of(file, model, joint, text) for joint, text in zip(joints, names, strict=True)])
    gear = model.actuator_gear[actuators, 0]
    delays = np.asarray(model.actuator_delay)[actuators]
    if np.ptp(delays) > 0:
        raise InputError(f"{file}: its actuators have several delays, and a log has one; give each the same delay")
    of_actuators = gear**2
    armature = of_actuators * model.actuator_armature[actuators]
    if armature.any():
        known = 0.0 if arm.rotor_inertia is None else arm.rotor_inertia
        arm = replace(arm, rotor_inertia=known + armature)
    filtered = model.actuator_dyntype[actuators] != _NO_DYNAMICS
    return Simulator(
        path=Path(file),
        arm=arm,
        stiffness=of_actuators * model.actuator_gainprm[actuators, 0],
        damping=of_actuators * (model.actuator_damping[actuators] - model.actuator_biasprm[actuators, 2]),
        torque_limit=_torque_limits(file, model, joints, actuators, names),
        time_constant=np.where(filtered, model.actuator_dynprm[actuators, 0], 0.0),
        delay=float(delays[0]),
        gravity=_gravity(model, base),
        compensated=_is_compensated(file, model, joints),
        model=model,
        joints=joints,
        actuators=actuators,
    )


def _control_addresses(model: Any) -> Integers:
    """Where in `ctrl` the command of each actuator is."""
    return np.asarray(model.actuator_ctrladr)


def _servo_of(file: str, model: Any, joint: int, name: str) -> int:
    """The position servo of a joint."""
    at_joint = np.isin(model.actuator_trntype, _JOINT_TRANSMISSIONS) & (model.actuator_trnid[:, 0] == joint)
    numbers = np.flatnonzero(at_joint)
    remedy = f'<position joint="{name}" kp="…" kv="…"/>'
    if not len(numbers):
        raise InputError(
            f"{file}: joint {name!r} has no actuator; add {remedy}, or leave the simulator out and declare servo: in "
            "the sidecar"
        )
    if len(numbers) > 1:
        raise InputError(f"{file}: joint {name!r} has {len(numbers)} actuators; leave one there, {remedy}")
    number = int(numbers[0])
    why = _why_no_servo(model, number)
    if why:
        raise InputError(
            f"{file}: the actuator of joint {name!r} is no position servo: {why}; write {remedy} in its place"
        )
    return number


def _why_no_servo(model: Any, number: int) -> str:
    """What an actuator has that position servos have not; empty where it is one."""
    gain = float(model.actuator_gainprm[number, 0])
    offset, position, velocity = model.actuator_biasprm[number, :3]
    if model.actuator_ctrlnum[number] != 1:
        return "it has several controls"
    if model.actuator_gaintype[number] != _FIXED_GAIN or gain <= 0:
        return "its gain is not a positive number"
    if model.actuator_biastype[number] != _AFFINE_BIAS or abs(gain + position) > _SAME_GAIN * gain:
        return "its force is not kp (command - position)"
    if offset or velocity > 0:
        return "its bias has a constant, or a negative damping"
    if model.actuator_dyntype[number] not in (_NO_DYNAMICS, *_FILTERS):
        return "its activation is no filter"
    if not model.actuator_gear[number, 0]:
        return "its gear is zero"
    return ""


def _torque_limits(file: str, model: Any, joints: Integers, actuators: Integers, names: Sequence[str]) -> Array:
    """`(joint,)` Nm, the lesser of what actuator and joint allow; refuses ranges that are not symmetric."""
    gear = np.abs(model.actuator_gear[actuators, 0])
    of_actuator = np.where(
        (np.asarray(model.actuator_forcelimited)[actuators] != 0)[:, None],
        gear[:, None] * model.actuator_forcerange[actuators],
        [-np.inf, np.inf],
    )
    of_joint = np.where(
        (np.asarray(model.jnt_actfrclimited)[joints] != 0)[:, None], model.jnt_actfrcrange[joints], [-np.inf, np.inf]
    )
    lower = np.maximum(of_actuator[:, 0], of_joint[:, 0])
    upper = np.minimum(of_actuator[:, 1], of_joint[:, 1])
    unequal = ~np.isclose(-lower, upper, rtol=1e-6) | (upper <= 0)
    if unequal.any():
        name = names[int(np.argmax(unequal))]
        raise InputError(
            f"{file}: the torque of joint {name!r} is limited to {lower[unequal][0]:g} and {upper[unequal][0]:g} Nm; "
            "give a forcerange of the same size in either direction"
        )
    return upper


def _gravity(model: Any, base: str | None) -> Array:
    """`(3,)` m/s² in the frame of the base."""
    gravity = np.array(model.opt.gravity)
    if base is None:
        return gravity
    mujoco = require_mujoco("")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data.body(base).xmat.reshape(3, 3).T @ gravity


def _is_compensated(file: str, model: Any, joints: Integers) -> bool:
    """Tells whether the weight of all bodies that the arm moves is compensated; refuses where that of some is."""
    moved = {int(model.jnt_bodyid[joints[0]])}
    for body in range(model.nbody):
        if int(model.body_parentid[body]) in moved and body:
            moved.add(body)
    heavy = [body for body in sorted(moved) if model.body_mass[body] > 0]
    shares = np.array([model.body_gravcomp[body] for body in heavy])
    if np.allclose(shares, 0.0):
        return False
    if np.allclose(shares, 1.0):
        return True
    raise InputError(
        f"{file}: gravcomp of the bodies of the arm is from {shares.min():g} to {shares.max():g}; give all of them 0 "
        "or 1"
    )
