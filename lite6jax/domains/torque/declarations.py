"""What is declared wrongly of torques: columns, signs, the direction of gravity, a joint's constant or gear ratio.

Each is shown by the weight and the motion of the arm, located, corrected and said.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from lite6jax.domains.torque.rows import TorqueRows, torque_rows
from lite6jax.effects.dynamic import bounds
from lite6jax.effects.dynamic.torque_effect import direction
from lite6jax.recordings.fault import DataFault

Array = NDArray[np.floating]

_CLEARLY = 9.0
"""Times by which a correction leaves less of the squares of a torque."""
_STRENGTH = 0.15
"""Relative deviation of gravity's strength up to which another direction of it is believed."""
_UPRIGHT = 0.1
"""rad from an axis of the base within which gravity points along it: arms stand, hang, or are mounted on a wall."""
_FACTORS = (0.45, 1.8)
"""Of the measured torque over the true one, beyond which it is no error of calibration but another constant: those of
motors of one series vary by some per cent, and gear ratios by factors."""
_SURE = 10.0
"""Standard deviations by which such a factor differs from one."""
_USUAL = 1.5
"""The factor, or one over it, within which at least half of the joints are: all together are rather other masses."""


class Declared(NamedTuple):
    """The rows as they are diagnosed.

    Attributes:
        data: corrected.
        found: what was wrong.
        ruled_out: what was tested for and is right.
    """

    data: TorqueRows
    found: tuple[DataFault, ...]
    ruled_out: tuple[DataFault, ...]


def as_declared(data: TorqueRows) -> Declared:
    """The rows with columns, signs, gravity and constants corrected as far as a rigid arm of known inertia shows.

    Reversed gravity is distinguished from reversed torques by the torques of accelerations.
    """
    ordered, columns = _in_order(data)
    turned = _with_gravity(data)
    if turned is not None and (not columns or _left(turned[0]) < _left(ordered)):
        data, columns = _in_order(turned[0])
        faults = [turned[1], *columns]
    else:
        data, faults = ordered, columns
    data, constants = _with_constants(data)
    faults += constants
    found = {fault.code for fault in faults}
    ruled_out = [
        DataFault(code, (), {})
        for code, others in (
            ("swapped_torques", {"swapped_torques", "reversed_torque"}),
            ("wrong_gravity", {"wrong_gravity"}),
            ("wrong_torque_constant", {"wrong_torque_constant"}),
        )
        if not found & others
    ]
    return Declared(data, tuple(faults), tuple(ruled_out))


def _rigid(data: TorqueRows) -> Array:
    return data.filter(data.bodies.dynamics(data.bodies.links).torque)


def _beside(data: TorqueRows, joint: int) -> Array:
    """`(sample, number)`, an orthonormal basis of what any joint, from 0, may add: offset, friction and rotor."""
    velocity = np.asarray(data.motion.joint_velocity)[joint, data.filter.kept]
    acceleration = np.asarray(data.motion.joint_acceleration)[joint, data.filter.kept]
    columns = np.stack(
        [np.ones(len(velocity)), velocity, direction(velocity, bool(data.arm.slides[joint])), acceleration]
    )
    return np.linalg.qr(columns.T)[0]


def _without(rows: Array, basis: Array) -> Array:
    return rows - (rows @ basis) @ basis.T


def _left(data: TorqueRows) -> float:
    """The sum over joints of the logarithm of the mean square that a rigid arm leaves, beside friction."""
    rest = data.measured - _rigid(data)
    squares = [np.mean(_without(row, _beside(data, j)) ** 2) for j, row in enumerate(rest)]
    return float(np.sum(np.log(np.maximum(squares, 1e-300))))


def _in_order(data: TorqueRows) -> tuple[TorqueRows, list[DataFault]]:
    """With each torque in the column of its joint and of its sign, as far as the rigid arm shows.

    Each column is compared with the torque of each joint, of either sign, beside an offset and friction. Another
    assignment than the declared one must leave far less of every torque that it moves, and another sign of its own.
    """
    rigid = _rigid(data)
    measured, joints = data.measured, len(rigid)
    velocity = np.asarray(data.motion.joint_velocity)[:, data.filter.kept]
    left = np.empty((2, joints, joints))
    for joint in range(joints):
        turned = direction(velocity[joint], data.arm.slides[joint])
        beside = np.stack([np.ones(rigid.shape[1]), velocity[joint], turned])
        basis = np.linalg.qr(beside.T)[0]
        for k, sign in enumerate((1.0, -1.0)):
            left[k, :, joint] = np.mean(_without(measured - sign * rigid[joint], basis) ** 2, 1)
    log_left = np.log(np.maximum(left, 1e-300))
    columns, place = linear_sum_assignment(log_left.min(0))
    every = np.arange(joints)
    order = np.empty(joints, int)
    order[place] = columns

    def better(order: NDArray[np.integer]) -> Array:
        return log_left[0, every, every] - log_left.min(0)[order, every]

    if (better(order)[order != every] < np.log(_CLEARLY)).any():
        order = every
    reversed_ = np.argmin(left[:, order, every], 0) == 1
    reversed_ &= (order != every) | (better(order) >= np.log(_CLEARLY))
    sign = np.where(reversed_, -1.0, 1.0)
    if not ((order != every) | reversed_).any():
        return data, []
    found = []
    swapped = [int(j) + 1 for j in np.flatnonzero(order != every)]
    if swapped:
        sources = [int(order[j - 1]) + 1 for j in swapped]
        found.append(DataFault("swapped_torques", (), {"joints": swapped, "columns": sources}))
    turned = [int(j) + 1 for j in np.flatnonzero(sign < 0)]
    if turned:
        found.append(DataFault("reversed_torque", (), {"joints": turned}))
    return replace(data, torque=sign[:, None] * data.torque[order]), found


def _with_gravity(data: TorqueRows) -> tuple[TorqueRows, DataFault] | None:
    """With gravity along another direction, where that is far from the declared one; None where it is not.

    Torques are linear in gravity: its three components are fitted beside friction, offsets and rotors, joints weighted
    by what is left of them. A small tilt is an effect on its own (`base_tilt`).
    """
    declared = data.bodies.gravity
    strength = float(np.linalg.norm(declared))
    if not strength:
        return None
    dynamics = data.bodies.dynamics(data.bodies.links)
    of_axes = np.stack([data.filter(dynamics.of_gravity(axis)) for axis in np.eye(3)])
    rest = data.measured - _rigid(data) + np.tensordot(declared, of_axes, 1)
    found, columns, rows, scale = _fitted(data, of_axes, rest)
    size = float(np.linalg.norm(found))
    tilt = float(np.arccos(np.clip(found @ declared / max(size * strength, 1e-300), -1, 1)))
    weighed = [
        sum(np.sum((r - gravity @ c) ** 2) / s**2 for r, c, s in zip(rows, columns, scale, strict=True))
        for gravity in (declared, found)
    ]
    if tilt <= bounds.TILT or abs(size / strength - 1) > _STRENGTH or weighed[0] < _CLEARLY * weighed[1]:
        return None
    along = found / size
    k = int(np.argmax(np.abs(along)))
    if np.arccos(min(abs(along[k]), 1.0)) < _UPRIGHT:
        along = np.sign(along[k]) * np.eye(3)[k]
    gravity = tuple(float(f"{value:.4g}") + 0.0 for value in strength * along)
    settings = replace(data.recording.settings, gravity_m_per_s2=gravity)
    corrected = torque_rows(replace(data.recording, settings=settings), data.arm, data.torque)
    numbers = {"declared_m_per_s2": declared.tolist(), "found_m_per_s2": list(gravity), "tilt_rad": tilt}
    return corrected, DataFault("wrong_gravity", (), numbers)


def _fitted(data: TorqueRows, columns: Array, rest: Array) -> tuple[Array, list[Array], list[Array], Array]:
    """Numbers of columns `(number, joint, sample)` that explain torques `(joint, sample)` beside offset and friction.

    Returns:
        the numbers; columns and torques of each joint without what offset and friction can do; and `(joint,)` Nm, what
        is left, by which joints are weighted.
    """
    bases = [_beside(data, j) for j in range(len(rest))]
    moved = [_without(columns[:, j], basis) for j, basis in enumerate(bases)]
    rows = [_without(row, basis) for row, basis in zip(rest, bases, strict=True)]
    floor = 1e-6 + 1e-3 * np.std(data.measured, axis=1)
    found, scale = np.zeros(len(columns)), np.ones(len(rest))
    for _ in range(4):
        A = np.concatenate([c / s for c, s in zip(moved, scale, strict=True)], 1)
        b = np.concatenate([r / s for r, s in zip(rows, scale, strict=True)])
        found = np.linalg.lstsq(A.T, b, rcond=None)[0]
        left = [np.sqrt(np.mean((r - found @ c) ** 2)) for r, c in zip(rows, moved, strict=True)]
        scale = np.maximum(left, floor)
    return found, moved, rows, scale


def _left_by_masses(data: TorqueRows) -> Array:
    """`(joint,)` Nm, what other masses and centres of mass of the links, and of a payload on the last, leave."""
    of_links = data.regressor.reshape(len(data.measured), -1, 10, data.regressor.shape[-1])
    columns = np.moveaxis(of_links[:, :, :4], 0, 2).reshape(-1, *data.measured.shape)
    return _fitted(data, columns, data.measured - _rigid(data))[3]


def _with_constants(data: TorqueRows) -> tuple[TorqueRows, list[DataFault]]:
    """With the torques of single joints divided by a factor that is no error of calibration: see `_FACTORS`.

    A factor that other masses, or another payload, explain as well is none.
    """
    rigid = _rigid(data)
    factor, sure = np.ones(len(rigid)), np.zeros(len(rigid), bool)
    left = np.ones(len(rigid))
    for j, (own, row) in enumerate(zip(rigid, data.measured, strict=True)):
        basis = _beside(data, j)
        x, y = _without(own, basis), _without(row, basis)
        if not x @ x:
            continue
        k = float(x @ y / (x @ x))
        squares = float(np.mean((y - k * x) ** 2)), float(np.mean((y - x) ** 2))
        sure[j] = abs(k - 1) > _SURE * np.sqrt(squares[0] / (x @ x)) and squares[1] > _CLEARLY * squares[0]
        factor[j] = k if sure[j] else 1.0
        left[j] = squares[0] if sure[j] else squares[1]
    other = sure & (factor > 0) & ((factor < _FACTORS[0]) | (factor > _FACTORS[1]))
    usual = (factor > 1 / _USUAL) & (factor < _USUAL)
    if not other.any() or 2 * usual.sum() < len(rigid):
        return data, []
    if np.sum(np.log(_left_by_masses(data))) < np.sum(0.5 * np.log(np.maximum(left, 1e-300))):
        return data, []
    factor = np.array([float(f"{k:.2g}") if wrong else 1.0 for k, wrong in zip(factor, other, strict=True)])
    joints = np.flatnonzero(other)
    settings = data.recording.settings
    if settings.torque_noise_Nm is not None:
        settings = replace(settings, torque_noise_Nm=tuple((np.array(settings.torque_noise_Nm) / factor).tolist()))
    numbers = {
        "joints": (1 + joints).tolist(),
        "factors": factor[joints].tolist(),
        "constants_Nm_per_A": None
        if data.recording.joint_torque is not None or settings.torque_constant_Nm_per_A is None
        else (np.array(settings.torque_constant_Nm_per_A)[joints] / factor[joints]).tolist(),
    }
    recording = replace(data.recording, settings=settings)
    corrected = replace(data, recording=recording, torque=data.torque / factor[:, None])
    return corrected, [DataFault("wrong_torque_constant", (), numbers)]
