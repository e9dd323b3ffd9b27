"""Hypotheses of what is wrong with data, of poses and of torques alike: each is several faults that it suspects.

Here stands what holds in every domain: the faults in the order in which they are undone, how one acts on the columns of
joints, and how hypotheses are joined. Which of them a domain looks for, and how it undoes them in its rows, say
`domains.pose.screening.changes` and `domains.torque.changes`; how likely they are, the modules `hypotheses` there. What
is decided becomes a `DataFault`.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, combinations
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.recordings.fault import DataFault

Array = NDArray[np.floating]
Hypothesis = tuple["SuspectedFault", ...]

GRAVITY = ("wrong_gravity", "no_gravity")
DECLARED = ("declared_frame", "declared_tool")
POSES = ("inverted_poses", "mirrored_sensor", "sensor_scale", "orientation_convention")
JOINTS = ("swapped_joints", "joint_unit", "mirrored_joint", "coupled_joint", "joint_turns")
"""Of joints beside poses: positions and torques are changed alike."""
POSITIONS = ("swapped_positions", "reversed_positions", "coupled_joint", "joint_zero")
"""Of joints beside torques: the positions alone, but for a coupling."""
TORQUES = ("swapped_torques", "reversed_torque", "wrong_torque_constant", "torque_unit")
_ORDER = (
    *(*GRAVITY, *DECLARED, *POSES),
    *("swapped_joints", "swapped_positions", "joint_unit", "mirrored_joint", "reversed_positions"),
    *("coupled_joint", "joint_turns", "joint_zero"),
    *TORQUES,
)
"""In which changes are made."""
_ONE_OF = (GRAVITY, POSES)
"""Of each, a hypothesis has one at most."""


@final
@dataclass(frozen=True)
class SuspectedFault:
    """One fault that data may have.

    Attributes:
        code: as of `DataFault`.
        joints: concerned, from 0; of an exchange two, of a coupling the joint and the one that it is coupled to.
        value: of a unit the factor of the column; of a coupling the factor of the other joint; of a zero what is added
            to the position, rad; of a constant the measured torque over the true one; of a mirrored sensor the axis
            that is reversed or the two that are exchanged; of a scale how many times too large positions are; of
            orientations the convention.
        gravity: `(3,)` m/s², as it acts.
    """

    code: str
    joints: tuple[int, ...] = ()
    value: float | str = 1.0
    gravity: tuple[float, ...] = ()

    @property
    def place(self) -> tuple[str, tuple[int, ...]]:
        """The code and the joints, whatever the value."""
        return self.code, self.joints

    @property
    def size(self) -> float:
        """The value, where it is a number."""
        return float(self.value)

    def of_positions(self, dof: int) -> tuple[Array, Array]:
        """`(joint, joint)` and `(joint,)` rad: positions are multiplied by the one, and the other is added."""
        A = np.eye(dof)
        b = np.zeros(dof)
        i, j = self._pair
        match self.code:
            case "swapped_joints" | "swapped_positions":
                A[[i, j]] = A[[j, i]]
            case "mirrored_joint" | "reversed_positions":
                A[i, i] = -1.0
            case "joint_unit":
                A[i, i] = self.size
            case "coupled_joint":
                A[i, j] = self.size
            case "joint_turns" | "joint_zero":
                b[i] = self.size
        return A, b

    def of_torques(self, dof: int) -> Array:
        """`(joint, joint)`, by which torques are multiplied."""
        T = np.eye(dof)
        i, j = self._pair
        match self.code:
            case "swapped_joints" | "swapped_torques":
                T[[i, j]] = T[[j, i]]
            case "mirrored_joint" | "reversed_torque":
                T[i, i] = -1.0
            case "wrong_torque_constant" | "torque_unit":
                T[i, i] = 1 / self.size
            case "coupled_joint":
                T = np.linalg.inv(self.of_positions(dof)[0]).T  # power stays the same
        return T

    @property
    def _pair(self) -> tuple[int, int]:
        """The first two of its joints; of one that one twice."""
        i, j = (*self.joints, *self.joints, 0, 0)[:2]
        return i, j


def joined(hypothesis: Hypothesis, more: Hypothesis) -> Hypothesis:
    """Both, in the order in which changes are made; each once."""
    return tuple(sorted({*hypothesis, *more}, key=lambda fault: (_ORDER.index(fault.code), fault.joints, fault.value)))


def compatible(hypothesis: Hypothesis, more: Hypothesis) -> bool:
    """Whether no change of one repeats or takes back one of the other."""
    made = {(fault.code, frozenset(fault.joints)) for fault in hypothesis}
    excluded = {code for fault in hypothesis for group in _ONE_OF if fault.code in group for code in group}
    return not any((fault.code, frozenset(fault.joints)) in made or fault.code in excluded for fault in more)


def places(hypothesis: Hypothesis) -> set[tuple[str, tuple[int, ...]]]:
    """Its faults by code and joints alone, whatever their values."""
    return {fault.place for fault in hypothesis}


def signs_of_sets(code: str, dof: int, most_joints: int) -> Iterator[Hypothesis]:
    """Reversed signs of any set of joints; of more than `most_joints` joints of one and of two: there are too many."""
    largest_set = dof if dof <= most_joints else 2
    for joints in chain.from_iterable(combinations(range(dof), count) for count in range(1, largest_set + 1)):
        yield tuple(SuspectedFault(code, (joint,)) for joint in joints)


def couplings(turning: Iterable[int]) -> Iterator[Hypothesis]:
    """Each of these joints coupled to a neighbour among them, in either sense."""
    listed_joints = [*turning]
    for i in listed_joints:
        for j in {i - 1, i + 1} & {*listed_joints}:
            yield from ((SuspectedFault("coupled_joint", (i, j), sign),) for sign in (1.0, -1.0))


def listed(several: Iterable[Iterable[DataFault]]) -> list[list[dict[str, Any]]]:
    """Hypotheses that were not told apart, as numbers of the fault that says so."""
    return [[{"fault": fault.code, **fault.numbers} for fault in faults] for faults in several]
