"""Faults that poses may have, and what undoes them in a recording."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from lite6jax.array_types import Array
from lite6jax.calibration.problem import TOLERANCE
from lite6jax.calibration.start import measured_rotations
from lite6jax.domains.faults import (
    DECLARED,
    POSES,
    Hypothesis,
    SuspectedFault,
    couplings,
    joined,
    signs_of_sets,
)
from lite6jax.domains.pose.kinematics import unit_quaternions
from lite6jax.recordings import Recording
from lite6jax.recordings.motion import with_joints

CODES = (
    *(*DECLARED, *POSES),
    *("swapped_joints", "joint_unit", "mirrored_joint", "coupled_joint", "joint_turns"),
)
"""The faults, in the order in which their changes are made. Of two that fit alike the earlier kind is preferred: a
declaration is wrong more often than poses, and poses more often than joints."""
_SCALAR_LAST = [3, 0, 1, 2]


def undo(hypothesis: Hypothesis, recording: Recording) -> Recording:
    """The recording without the faults of a hypothesis."""
    for change in hypothesis:
        if change.code == "declared_frame":
            recording = replace(recording, settings=replace(recording.settings, pose_frame="unknown"))
        elif change.code == "declared_tool":
            recording = replace(recording, settings=replace(recording.settings, tool="unknown"))
        elif change.code in POSES:
            recording = _with_other_poses(change, recording)
        else:
            A, b = change.of_positions(recording.dof)
            recording = with_joints(recording, A, b, change.of_torques(recording.dof))
    return recording


def _with_other_poses(change: SuspectedFault, recording: Recording) -> Recording:
    position = recording.position
    quaternion = recording.quaternion
    assert position is not None
    if change.code == "sensor_scale":
        return replace(recording, position=position / change.size)
    convention = str(change.value)
    if convention.endswith("scalar_last") and quaternion is not None:
        quaternion = quaternion[:, _SCALAR_LAST]
    R = measured_rotations(replace(recording, quaternion=quaternion))
    if change.code == "mirrored_sensor":
        M = _reflection(convention)
        position = position @ M
        R = None if R is None else M @ R @ M
    elif R is not None and (change.code == "inverted_poses" or convention.startswith("inverted")):
        R = np.swapaxes(R, 1, 2)
        if change.code == "inverted_poses":
            position = -np.einsum("sij,sj->si", R, position)
    return replace(recording, position=position, quaternion=None if R is None else unit_quaternions(R))


def single_changes(recording: Recording) -> Iterator[Hypothesis]:
    """Every simple hypothesis: each fault alone, and reversed signs of any set of joints."""
    dof = recording.dof
    turning = [i for i in range(dof) if i not in recording.sliding]
    if recording.touches is None:
        yield from _changes_of_poses(recording)
    for pair in combinations(range(dof), 2):
        yield (SuspectedFault("swapped_joints", pair),)
    yield from signs_of_sets("mirrored_joint", dof, most_joints=8)
    for i in turning:
        yield from ((SuspectedFault("joint_unit", (i,), factor),) for factor in (np.pi / 180, 180 / np.pi))
    for i in with_zeros(recording):
        for quarters in (2, -2, 1, -1):
            zero = SuspectedFault("joint_turns", (i,), quarters * np.pi / 2)
            yield (zero,)
            yield (SuspectedFault("mirrored_joint", (i,)), zero)
    yield from couplings(turning)


def _changes_of_poses(recording: Recording) -> Iterator[Hypothesis]:
    """Wrong declarations and wrong poses."""
    settings = recording.settings
    if settings.pose_frame == "base":
        yield (SuspectedFault("declared_frame"),)
    if settings.tool != "unknown":
        yield (SuspectedFault("declared_tool"),)
    axes = ("x", "y", "z", "xy", "yz", "xz") if settings.pose_frame == "base" else ("z",)
    yield from ((SuspectedFault("mirrored_sensor", (), axis),) for axis in axes)
    if recording.quaternion is not None:
        yield (SuspectedFault("inverted_poses"),)
        for convention in ("inverted", "scalar_last", "inverted_scalar_last"):
            yield (SuspectedFault("orientation_convention", (), convention),)


def with_zeros(recording: Recording) -> list[int]:
    """The joints whose zeros the poses show: a free frame and a free tool take up those of the first and the last."""
    first = recording.settings.pose_frame != "base"
    last = recording.settings.tool == "unknown"
    return [i for i in range(int(first), recording.dof - int(last)) if i not in recording.sliding]


def is_estimated(change: SuspectedFault) -> bool:
    """Tells whether the value of a change is any number: a scale, or a zero that is off by no quarter turns."""
    if change.code == "sensor_scale":
        return True
    return change.code == "joint_turns" and change.size not in np.pi / 2 * np.arange(-4, 5)


def added(hypothesis: Hypothesis, more: SuspectedFault) -> Hypothesis:
    """With one more change; a zero or a scale that is changed already is changed by both."""
    unchanged = [change for change in hypothesis if change.place != more.place]
    for change in hypothesis:
        if change not in unchanged and more.code == "joint_turns":
            more = replace(more, value=change.size + more.size)
        elif change not in unchanged and more.code == "sensor_scale":
            more = replace(more, value=change.size * more.size)
    return joined(tuple(unchanged), (more,))


def simplicity(hypothesis: Hypothesis) -> tuple[int, int, tuple[int, ...]]:
    """The fewer the changes and the earlier their kind in `CODES`, the less."""
    of_kinds = sum({"declaration": 0, "poses": 1}.get(change.kind.changes, 2) for change in hypothesis)
    return len(hypothesis), of_kinds, tuple(CODES.index(change.code) for change in hypothesis)


def differ_by_turns(a: Hypothesis, b: Hypothesis) -> bool:
    """Tells whether two hypotheses differ by whole turns of joints, or by no more than a calibration corrects."""
    rest_a, rest_b = (tuple(c for c in h if c.code != "joint_turns") for h in (a, b))
    zeros_a, zeros_b = ({c.joints[0]: c.size for c in h if c.code == "joint_turns"} for h in (a, b))
    apart = [(zeros_a.get(i, 0.0) - zeros_b.get(i, 0.0)) / (2 * np.pi) for i in {*zeros_a, *zeros_b}]
    return rest_a == rest_b and bool(np.allclose(apart, np.round(apart), atol=TOLERANCE["rad"] / (2 * np.pi)))


def _reflection(axes: str) -> Array:
    """`(3, 3)`: one axis reversed, or two exchanged."""
    M = np.eye(3)
    rows = ["xyz".index(axis) for axis in axes]
    M[rows] = M[rows[::-1]] if len(rows) > 1 else -M[rows]
    return M
