"""What is wrong with a faulty torque recording: a contact, or signs, columns, zeros, units, turns, gravity, a register.

Shares no code with the library. The sample comes first.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.concealed.chain import Array, rotation_from_vector
from benchmarks.torque_trials.effects import Hidden
from benchmarks.torque_trials.physics import Arm, Motion, Setup, inverse_dynamics, rigid
from benchmarks.torque_trials.plans import Plan

_SEEN, _SEEN_NOISES = 0.3, 10.0
"""Of the torque of some joint, and of its noise, RMS: what a wrong position or gravity changes at least."""
_ZEROS = np.deg2rad([15.0, -15.0, 30.0, -45.0, 90.0, -90.0, 180.0])
_FACTORS = (0.1, 0.25, 4.0, 10.0)  # of a constant that is wrong in some joints
_CONSTANTS, _RATINGS = (4.0, 12.0), (8.0, 30.0)
"""Nm/A, and Nm of 100 per cent, of joints whose torques are currents or per cent."""
_BIAS = (0.005, 0.02)  # rad/s
_MASSES_OFF = 0.03
"""Relative, one standard deviation of the masses and centres of half the arms: descriptions are never exact."""


class Spoiled(NamedTuple):
    """What is read of a motion."""

    q: Array  # `(sample, joint)` rad
    dq: Array  # `(sample, joint)` rad/s
    torque: Array  # `(sample, joint)` Nm, or whatever it is
    joints: list[int]  # that the fault concerns, counted from 1
    # how large it is: `added_rad` that undoes a zero, `factors` of torques, `gravity_m_per_s2` as it acts
    numbers: dict[str, Any]
    rows: list[int]  # of a contact, from 0
    gravity: Array  # `(3,)` m/s², as it is declared
    turns: bool = False  # whether positions are from 0 to a turn


def friction(rng: np.random.Generator, setup: Setup, motion: Motion) -> tuple[Hidden, ...]:
    """Coulomb and viscous friction of every joint, some per cent of its torque each, as all real arms have."""
    size = np.maximum(np.std(rigid(setup, (), motion).load, axis=0), 20 * setup.arm.noise)
    share = rng.uniform(0.03, 0.15, (2, len(size)))
    fast = np.maximum(np.std(motion.dq, axis=0), 0.05)
    return tuple(
        Hidden(name, f"joint{j + 1}", {number: float(share[k, j] * size[j] / (fast[j] if k else 1.0))})
        for k, (name, number) in enumerate(
            (("coulomb_friction", "coulomb_Nm"), ("viscous_friction", "viscous_Nm_s_per_rad"))
        )
        for j in range(len(size))
    )


def describe_arm(rng: np.random.Generator, arm: Arm) -> Arm:
    """An arm as its description has it: exact in half the cases, else with masses and centres a little off."""
    if rng.random() < 0.5:
        return arm
    factor = 1 + _MASSES_OFF * np.clip(rng.normal(size=(arm.chain.dof, 2)), -2, 2)
    chain = replace(arm.chain, mass=arm.chain.mass * factor[:, 0], center=arm.chain.center * factor[:, 1:])
    return replace(arm, chain=chain, inertia=arm.inertia * factor[:, :1, None])


def spoil(
    plan: Plan, rng: np.random.Generator, setup: Setup, motion: Motion, read: tuple[Array, Array, Array]
) -> Spoiled | None:
    """What is read in place of joints, velocities and torques where something is wrong; None if nobody could tell."""
    q, dq, torque = read
    right = Spoiled(q, dq, torque, [], {}, [], setup.gravity)
    dof, noise, one = q.shape[1], setup.arm.noise, int(rng.integers(q.shape[1]))
    loud = np.argsort(-np.std(torque, axis=0) / noise)[: max(2, dof // 2)]  # of others nobody could tell
    some = np.sort(rng.permutation(loud)[: int(rng.integers(1, len(loud) + 1))])
    two = np.sort(rng.choice(loud, 2, replace=False))
    exchange, mirror, zero = np.eye(dof), np.eye(dof), np.zeros(dof)
    exchange[two] = exchange[two[::-1]]
    mirror[some, some] = -1.0

    def moved(A: Array, b: Array, T: Array, joints: NDArray[np.integer], numbers: dict[str, Any]) -> Spoiled | None:
        """Positions A q + b, and torques T τ, where the torques of the motion as it is read are clearly others."""
        as_read = _exerted(setup, motion, motion.q @ A.T + b, motion.dq @ A.T, motion.ddq @ A.T, setup.gravity)
        spoiled = right._replace(q=q @ A.T + b, dq=dq @ A.T, torque=torque @ T.T, numbers=numbers)
        changed = as_read - rigid(setup, (), motion).load @ T.T
        return spoiled._replace(joints=_numbers(joints)) if _shows(changed, torque, noise) else None

    match plan.fault:
        case "contact":
            pushed, rows = _touched(plan, rng, torque, noise)
            return right._replace(torque=pushed, rows=rows)
        case "swapped_torques":
            return right._replace(torque=torque @ exchange.T, joints=_numbers(two))
        case "reversed_torque":
            return right._replace(torque=torque * np.where(np.arange(dof) == loud[0], -1, 1), joints=_numbers(loud[:1]))
        case "swapped_columns":
            return moved(exchange, zero, exchange, two, {})
        case "reversed_positions":
            return moved(mirror, zero, np.eye(dof), some, {})
        case "reversed_joint":
            return moved(mirror, zero, mirror, some, {})
        case "joint_zero":
            off = float(rng.choice([rng.choice(_ZEROS), rng.uniform(0.2, 3.0) * rng.choice([-1.0, 1.0])]))
            zero[one] = -off
            return moved(np.eye(dof), zero, np.eye(dof), np.array([one]), {"added_rad": off})
        case "wrong_torque_constant":
            factor, few = float(rng.choice(_FACTORS)), some[: dof // 2]
            factors = np.where(np.isin(np.arange(dof), few), factor, 1.0)
            numbers = {"factors": [factor] * len(few)}
            return right._replace(torque=torque * factors, joints=_numbers(few), numbers=numbers)
        case "torque_unit":
            units = (1e3 * np.ones(dof), 1 / rng.uniform(*_CONSTANTS, dof), 100 / rng.uniform(*_RATINGS, dof))
            unit = units[int(rng.integers(len(units)))]
            return right._replace(torque=torque * unit, joints=[*range(1, dof + 1)], numbers={"factors": unit.tolist()})
        case "no_gravity":
            held = _exerted(setup, motion, motion.q, 0 * q, 0 * q, setup.gravity)
            return right._replace(torque=torque - held) if _shows(held, torque, noise) else None
        case "wrong_gravity":
            turned = rotation_from_vector(np.pi / 2 * rng.choice([1, 2]) * np.eye(3)[rng.integers(2)]) @ setup.gravity
            as_read = _exerted(setup, motion, motion.q, motion.dq, motion.ddq, turned)
            numbers = {"gravity_m_per_s2": setup.gravity.tolist()}
            spoiled = right._replace(gravity=turned, numbers=numbers)
            return spoiled if _shows(as_read - rigid(setup, (), motion).load, torque, noise) else None
        case "joint_turns":
            crossed = np.flatnonzero((np.diff(np.floor(q / (2 * np.pi)), axis=0) != 0).any(0))
            return right._replace(turns=True, joints=_numbers(crossed)) if crossed.size else None
        case "velocity_bias":
            joint = int(rng.choice(np.flatnonzero(np.ptp(motion.q, axis=0) == 0)))
            bias = float(rng.uniform(*_BIAS) * rng.choice([-1.0, 1.0]))
            return right._replace(dq=dq + bias * np.eye(dof)[joint], joints=[joint + 1])
        case "estimated_torque":
            return right._replace(torque=rigid(setup, (), motion).load)
    return right


def _exerted(setup: Setup, motion: Motion, q: Array, dq: Array, ddq: Array, gravity: Array) -> Array:
    return inverse_dynamics(setup.arm, q, dq, ddq, gravity, motion.payload, setup.payload_center)


def _shows(change: Array, torque: Array, noise: Array) -> bool:
    size = np.std(change, axis=0)
    return bool(((size > _SEEN * np.std(torque, axis=0)) & (size > _SEEN_NOISES * noise)).any())


def _numbers(joints: Any) -> list[int]:
    return [int(joint) + 1 for joint in joints]


def _touched(plan: Plan, rng: np.random.Generator, torque: Array, noise: Array) -> tuple[Array, list[int]]:
    """Someone pushes a link once: all joints before it feel it."""
    samples, dof = torque.shape
    length = round(rng.uniform(0.3, 1.0) * plan.rate)
    first = int(rng.integers(samples // 5, 4 * samples // 5 - length))
    last = int(rng.integers(2, dof + 1))
    push = rng.uniform(15, 40) * noise * rng.choice([-1.0, 1.0], dof) * rng.uniform(0.3, 1.0, dof)
    push[last:] = 0.0
    shape = np.sin(np.pi * (np.arange(length) + 0.5) / length)
    pushed = torque.copy()
    pushed[first : first + length] += shape[:, None] * push
    return pushed, list(range(first, first + length))
