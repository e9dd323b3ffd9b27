"""Changes of a recording, each a fault and what undoes it, and hypotheses that are several of them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.calibration.problem import TOLERANCE
from lite6jax.calibration.start import measured_rotations
from lite6jax.domains.pose.kinematics import unit_quaternions
from lite6jax.recordings import Recording
from lite6jax.recordings.motion import with_joints

Array = NDArray[np.floating]
Hypothesis = tuple["PoseFault", ...]

DECLARED = ("declared_frame", "declared_tool")
POSES = ("inverted_poses", "mirrored_sensor", "sensor_scale", "orientation_convention")
JOINTS = ("swapped_joints", "joint_unit", "mirrored_joint", "coupled_joint", "joint_turns")
CODES = (*DECLARED, *POSES, *JOINTS)
"""The faults, in the order in which their changes are made. Of two that fit alike the earlier kind is preferred: a
declaration is wrong more often than poses, and poses more often than joints."""
_NUMBERS = {
    "coupled_joint": "factor",
    "joint_turns": "added_rad",
    "mirrored_sensor": "axes",
    "sensor_scale": "factor",
    "orientation_convention": "convention",
}
"""What the value of a change is called."""
_SCALAR_LAST = [3, 0, 1, 2]


@final
@dataclass(frozen=True)
class PoseFault:
    """One fault, and what undoes it.

    Attributes:
        code: of `CODES`.
        joints: concerned, from 0: those swapped, or the joint and the one that it is coupled to.
        value: of a unit the factor of the column; of a coupling the factor of the other joint; of a zero what is
            added, rad; of a mirrored sensor the axis that is reversed or the two that are exchanged; of a scale how
            many times too large positions are; of orientations the convention.
    """

    code: str
    joints: tuple[int, ...] = ()
    value: float | str = 1.0

    @property
    def numbers(self) -> dict[str, Any]:
        """Of the fault, as in `DataFault`."""
        joints = [joint + 1 for joint in self.joints]
        if self.code == "swapped_joints":
            return {"joints": joints}
        numbers: dict[str, Any] = {"joint": joints[0]} if joints else {}
        if self.code == "joint_unit":
            numbers["unit"] = "deg" if float(self.value) < 1 else "rad"
        if self.code == "coupled_joint":
            numbers["added_joint"] = joints[1]
        name = _NUMBERS.get(self.code)
        return numbers if name is None else numbers | {name: self.value}

    def undone(self, recording: Recording) -> Recording:
        """The recording without the fault."""
        if self.code in DECLARED:
            free = {"pose_frame": "unknown"} if self.code == "declared_frame" else {"tool": "unknown"}
            return replace(recording, settings=replace(recording.settings, **free))
        if self.code in POSES:
            return self._poses(recording)
        return self._joints(recording)

    def _poses(self, recording: Recording) -> Recording:
        position = recording.position
        quaternion = recording.quaternion
        assert position is not None
        if self.code == "sensor_scale":
            return replace(recording, position=position / float(self.value))
        convention = str(self.value)
        if convention.endswith("scalar_last") and quaternion is not None:
            quaternion = quaternion[:, _SCALAR_LAST]
        R = measured_rotations(replace(recording, quaternion=quaternion))
        if self.code == "mirrored_sensor":
            M = _reflection(convention)
            position = position @ M
            R = None if R is None else M @ R @ M
        elif R is not None and (self.code == "inverted_poses" or convention.startswith("inverted")):
            R = np.swapaxes(R, 1, 2)
            if self.code == "inverted_poses":
                position = -np.einsum("sij,sj->si", R, position)
        return replace(recording, position=position, quaternion=None if R is None else unit_quaternions(R))

    def _joints(self, recording: Recording) -> Recording:
        """What is recorded of each joint, changed as its position is."""
        A = np.eye(recording.dof)
        b = np.zeros(recording.dof)
        i, j = (*self.joints, *self.joints)[:2]
        if self.code == "swapped_joints":
            A[[i, j]] = A[[j, i]]
        elif self.code == "mirrored_joint":
            A[i, i] = -1.0
        elif self.code == "joint_unit":
            A[i, i] = self.value
        elif self.code == "coupled_joint":
            A[i, j] = self.value
        else:
            b[i] = self.value
        effort = np.sign(A) if self.code != "coupled_joint" else np.linalg.inv(A).T  # power stays the same
        return with_joints(recording, A, b, effort)


def undo(hypothesis: Hypothesis, recording: Recording) -> Recording:
    """The recording without the faults of a hypothesis."""
    for change in hypothesis:
        recording = change.undone(recording)
    return recording


def single_changes(recording: Recording) -> Iterator[Hypothesis]:
    """Every simple hypothesis: each fault alone, and reversed signs of any set of joints."""
    dof = recording.dof
    turning = [i for i in range(dof) if i not in recording.sliding]
    if recording.touches is None:
        yield from _changes_of_poses(recording)
    for pair in combinations(range(dof), 2):
        yield (PoseFault("swapped_joints", pair),)
    largest_set = dof if dof <= 8 else 2  # of more joints there are too many sets
    for joints in chain.from_iterable(combinations(range(dof), count) for count in range(1, largest_set + 1)):
        yield tuple(PoseFault("mirrored_joint", (i,)) for i in joints)
    for i in turning:
        yield from ((PoseFault("joint_unit", (i,), factor),) for factor in (np.pi / 180, 180 / np.pi))
    for i in with_zeros(recording):
        for quarters in (2, -2, 1, -1):
            zero = PoseFault("joint_turns", (i,), quarters * np.pi / 2)
            yield (zero,)
            yield (PoseFault("mirrored_joint", (i,)), zero)
    for i in turning:
        for j in {i - 1, i + 1} & set(turning):
            yield from ((PoseFault("coupled_joint", (i, j), sign),) for sign in (1.0, -1.0))


def _changes_of_poses(recording: Recording) -> Iterator[Hypothesis]:
    """Wrong declarations and wrong poses."""
    settings = recording.settings
    if settings.pose_frame == "base":
        yield (PoseFault("declared_frame"),)
    if settings.tool != "unknown":
        yield (PoseFault("declared_tool"),)
    axes = ("x", "y", "z", "xy", "yz", "xz") if settings.pose_frame == "base" else ("z",)
    yield from ((PoseFault("mirrored_sensor", (), axis),) for axis in axes)
    if recording.quaternion is not None:
        yield (PoseFault("inverted_poses"),)
        for convention in ("inverted", "scalar_last", "inverted_scalar_last"):
            yield (PoseFault("orientation_convention", (), convention),)


def with_zeros(recording: Recording) -> list[int]:
    """The joints whose zeros the poses show: a free frame and a free tool take up those of the first and the last."""
    first = recording.settings.pose_frame != "base"
    last = recording.settings.tool == "unknown"
    return [i for i in range(int(first), recording.dof - int(last)) if i not in recording.sliding]


def is_estimated(change: PoseFault) -> bool:
    """Whether the value of a change is any number: a scale, or a zero that is off by no quarter turns."""
    if change.code == "sensor_scale":
        return True
    return change.code == "joint_turns" and float(change.value) not in np.pi / 2 * np.arange(-4, 5)


def rounded_to_quarters(angle: float) -> float:
    """An angle in rad, or the quarter turns that it is but for what a calibration corrects."""
    quarters = float(np.round(angle / (np.pi / 2)) * np.pi / 2)
    if quarters and abs(angle - quarters) < TOLERANCE["rad"]:
        return quarters
    return angle


def listed(several: Sequence[Hypothesis]) -> list[list[dict[str, Any]]]:
    """Hypotheses as numbers of a fault."""
    return [[{"fault": change.code, **change.numbers} for change in hypothesis] for hypothesis in several]


def added(hypothesis: Hypothesis, more: PoseFault) -> Hypothesis:
    """With one more change; a zero or a scale that is changed already is changed by both."""
    unchanged = [c for c in hypothesis if (c.code, c.joints) != (more.code, more.joints)]
    for change in hypothesis:
        if change not in unchanged and more.code == "joint_turns":
            more = replace(more, value=float(change.value) + float(more.value))
        elif change not in unchanged and more.code == "sensor_scale":
            more = replace(more, value=float(change.value) * float(more.value))
    return joined(tuple(unchanged), (more,))


def joined(hypothesis: Hypothesis, more: Hypothesis) -> Hypothesis:
    """Both, in the order in which changes are made; each once."""
    return tuple(sorted({*hypothesis, *more}, key=lambda c: (CODES.index(c.code), c.joints)))


def compatible(hypothesis: Hypothesis, more: Hypothesis) -> bool:
    """Whether no change of one repeats or takes back one of the other."""
    made = {(c.code, frozenset(c.joints)) for c in hypothesis}
    poses = {c.code for c in hypothesis if c.code in POSES}
    return not any((c.code, frozenset(c.joints)) in made or (c.code in POSES and poses) for c in more)


def contains(hypothesis: Hypothesis, part: Hypothesis) -> bool:
    """Whether a hypothesis is another with further changes, whatever their values: no other explanation then."""
    places = {(c.code, c.joints) for c in hypothesis}
    return places > {(c.code, c.joints) for c in part}


def simplicity(hypothesis: Hypothesis) -> tuple[int, int, tuple[int, ...]]:
    """The fewer the changes and the earlier their kind in `CODES`, the less."""
    ranks: dict[str, int] = {**dict.fromkeys(POSES, 1), **dict.fromkeys(DECLARED, 0)}
    of_kinds = sum(ranks.get(c.code, 2) for c in hypothesis)
    return len(hypothesis), of_kinds, tuple(CODES.index(c.code) for c in hypothesis)


def differ_by_turns(a: Hypothesis, b: Hypothesis) -> bool:
    """Whether two hypotheses differ by whole turns of joints, or by no more than a calibration corrects."""
    rest_a, rest_b = (tuple(c for c in h if c.code != "joint_turns") for h in (a, b))
    zeros_a, zeros_b = ({c.joints[0]: float(c.value) for c in h if c.code == "joint_turns"} for h in (a, b))
    apart = [(zeros_a.get(i, 0.0) - zeros_b.get(i, 0.0)) / (2 * np.pi) for i in {*zeros_a, *zeros_b}]
    return rest_a == rest_b and bool(np.allclose(apart, np.round(apart), atol=TOLERANCE["rad"] / (2 * np.pi)))


def _reflection(axes: str) -> Array:
    """`(3, 3)`: one axis reversed, or two exchanged."""
    M = np.eye(3)
    places = ["xyz".index(axis) for axis in axes]
    M[places] = M[places[::-1]] if len(places) > 1 else -M[places]
    return M
