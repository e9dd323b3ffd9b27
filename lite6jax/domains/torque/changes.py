"""Faults that torques may have: what undoes them in the rows, and how they are reported."""

from dataclasses import replace
from typing import Any

import numpy as np

from lite6jax.array_types import Array, Integers
from lite6jax.domains.faults import GRAVITY, Hypothesis, SuspectedFault, places
from lite6jax.domains.torque.rows import TorqueRows, torque_rows
from lite6jax.recordings.fault import DataFault
from lite6jax.recordings.motion import with_joints

POSITIONS = ("swapped_positions", "reversed_positions", "coupled_joint", "joint_zero")
"""What hypotheses suspect beside gravity: of joints that are coupled, torques are as well."""
STEP = np.deg2rad(15.0)
"""rad between zeros that are tried; the best are refined."""
_SAME_ZERO = 1.5 * STEP
"""rad between zeros of a joint that are one: of neighbours on the grid the likelier is taken."""
_SAME_GRAVITY = 0.1
"""Relative difference of two gravities that are one."""


def undo(hypothesis: Hypothesis, data: TorqueRows) -> TorqueRows:
    """The rows without the faults of a hypothesis."""
    dof = data.arm.dof
    recording = data.recording
    A, b, T, gravity = maps(hypothesis, dof)
    settings = recording.settings
    if settings.torque_noise_Nm is not None:
        noise = np.sqrt(T**2 @ np.square(settings.torque_noise_Nm))
        settings = replace(settings, torque_noise_Nm=tuple(noise.tolist()))
    if gravity is not None:
        settings = replace(settings, gravity_m_per_s2=gravity)
    recording = replace(recording, settings=settings)
    if gravity is None and not any(change.code in POSITIONS for change in hypothesis):
        return replace(data, recording=recording, torque=T @ data.torque)
    return torque_rows(with_joints(recording, A, b), data.arm, T @ data.torque)


def maps(hypothesis: Hypothesis, dof: int) -> tuple[Array, Array, Array, tuple[float, ...] | None]:
    """What undoes a hypothesis: `A` and `b` of positions, `T` of torques, and gravity, None where that is declared."""
    A = np.eye(dof)
    b = np.zeros(dof)
    T = np.eye(dof)
    gravity = None
    for change in hypothesis:
        if change.code in GRAVITY:
            gravity = change.gravity
        matrix, added = change.of_positions(dof)
        A = matrix @ A
        b = matrix @ b + added
        T = change.of_torques(dof) @ T
    return A, b, T, gravity


def exchanges(order: Integers) -> list[SuspectedFault]:
    """Exchanges of two columns that put into place j the column `order[j]`."""
    now = list(range(len(order)))
    swaps = []
    for j, column in enumerate(order.tolist()):
        k = now.index(column)
        if k != j:
            swaps.append(SuspectedFault("swapped_torques", (j, k)))
            now[j], now[k] = now[k], now[j]
    return swaps


def turned_back(angle: float) -> float:
    """rad, the same direction, above −π and at most π."""
    return float(angle - 2 * np.pi * np.ceil(angle / (2 * np.pi) - 0.5))


def faults_in(hypothesis: Hypothesis) -> int:
    """How many faults a hypothesis has; a set of signs or constants, and joints with both signs reversed, are one."""
    sets = ("reversed_positions", "reversed_torque", "wrong_torque_constant", "torque_unit")
    several = {code: frozenset(c.joints for c in hypothesis if c.code == code) for code in sets}
    joints_coincide = bool(several["reversed_torque"]) and several["reversed_positions"] == several["reversed_torque"]
    return sum(map(bool, several.values())) - joints_coincide + sum(c.code not in sets for c in hypothesis)


def alike(a: Hypothesis, b: Hypothesis) -> bool:
    """Tells whether two hypotheses differ by little of a zero or of gravity's direction, or in a constant, alone."""
    if places(a) != places(b):
        return False
    for change in a:
        counterpart = next(c for c in b if c.place == change.place)
        if change.code == "joint_zero" and abs(turned_back(change.size - counterpart.size)) > _SAME_ZERO:
            return False
        if change.code == "coupled_joint" and change.value != counterpart.value:
            return False
        apart = np.linalg.norm(np.subtract(change.gravity, counterpart.gravity))
        if change.gravity and apart > _SAME_GRAVITY * np.linalg.norm(change.gravity):
            return False
    return True


def faults_of(hypothesis: Hypothesis, data: TorqueRows) -> list[DataFault]:
    """The faults of a hypothesis, those of one kind together, and of both columns of a joint."""
    joints_of = {
        code: [change.joints for change in hypothesis if change.code == code]
        for code in ("swapped_positions", "swapped_torques", "reversed_positions", "reversed_torque")
    }
    exchanged = {*joints_of["swapped_positions"]} & {*joints_of["swapped_torques"]}
    mirrored = {*joints_of["reversed_positions"]} & {*joints_of["reversed_torque"]}
    faults = [_of_gravity(change, data.bodies.gravity) for change in hypothesis if change.code in GRAVITY]
    if mirrored:
        faults.append(DataFault("reversed_joint", (), {"joints": sorted(1 + j for (j,) in mirrored)}))
    for change in hypothesis:
        fault = change.data_fault
        if change.code == "swapped_positions" and change.joints in exchanged:
            faults.append(replace(fault, code="swapped_columns"))
        elif change.code == "coupled_joint":
            faults.append(replace(fault, code="coupled_positions"))
        elif change.code in ("swapped_positions", "joint_zero"):
            faults.append(fault)
    order = np.arange(data.arm.dof)
    for i, j in joints_of["swapped_torques"]:
        if (i, j) not in exchanged:
            order[[i, j]] = order[[j, i]]
    moved = np.flatnonzero(order != np.arange(len(order)))
    if moved.size:
        numbers = {"joints": (1 + moved).tolist(), "columns": (1 + order[moved]).tolist()}
        faults.append(DataFault("swapped_torques", (), numbers))
    for code in ("reversed_torque", "reversed_positions"):
        if joints := sorted(1 + j for (j,) in joints_of[code] if (j,) not in mirrored):
            faults.append(DataFault(code, (), {"joints": joints}))
    return faults + _of_constants(hypothesis, data)


def _of_gravity(change: SuspectedFault, declared: Array) -> DataFault:
    """Gravity that is not as declared, or not there."""
    numbers: dict[str, Any] = {"declared_m_per_s2": declared.tolist()}
    if change.code == "wrong_gravity":
        cosine = float(declared @ change.gravity) / (np.linalg.norm(declared) * np.linalg.norm(change.gravity))
        numbers |= {"found_m_per_s2": list(change.gravity), "tilt_rad": float(np.arccos(np.clip(cosine, -1, 1)))}
    return DataFault(change.code, (), numbers)


def _of_constants(hypothesis: Hypothesis, data: TorqueRows) -> list[DataFault]:
    """Torques that are measured in other units, or by other constants."""
    constants = data.recording.settings.torque_constant_Nm_per_A
    if data.recording.joint_torque is not None:
        constants = None
    faults = []
    for code in ("wrong_torque_constant", "torque_unit"):
        if changes := [change for change in hypothesis if change.code == code]:
            numbers = {"joints": [1 + c.joints[0] for c in changes], "factors": [c.value for c in changes]}
            true = None if constants is None else [constants[c.joints[0]] / c.size for c in changes]
            faults.append(DataFault(code, (), numbers | {"constants_Nm_per_A": true}))
    return faults
