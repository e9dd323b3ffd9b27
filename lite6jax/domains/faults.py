"""Faults of the data, in every domain: what each changes, how hypotheses of them are sought, and what a screening says.

A hypothesis is a tuple of suspected faults. `KINDS` says of each what it does to the columns. A domain lists its simple
hypotheses, undoes one in its data and weighs what is left: that is its `Ranking`, of which `search` and `simplest`
take the best. A fault of rows is found by a test of its own. What was decided are `DataFault`s in a `Screened`; their
prior probability is `data_fault` of `estimation.prior`, and their words are in `report.faults`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from typing import Any, Generic, Literal, Protocol, Self, TypeVar, final

import numpy as np

from lite6jax.array_types import Array
from lite6jax.estimation.prior import PRIOR, Prior
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault, row_numbers

Hypothesis = tuple["SuspectedFault", ...]
Data = TypeVar("Data")


# ------------------------------------------------------------------ what a fault changes


@final
@dataclass(frozen=True)
class Kind:
    """What undoes a fault.

    Attributes:
        changes: the quantity that is wrong; "joints" are positions and torques of joints alike, power staying the same.
        operation: what is done to its columns, where they are those of joints.
        number: what the value of a fault is called in a `DataFault`.
    """

    changes: Literal["gravity", "declaration", "poses", "joints", "positions", "torques"]
    operation: Literal["", "exchange", "reverse", "multiply", "divide", "couple", "add"] = ""
    number: str = ""


KINDS: Mapping[str, Kind] = {
    "wrong_gravity": Kind("gravity"),
    "no_gravity": Kind("gravity"),
    "declared_frame": Kind("declaration"),
    "declared_tool": Kind("declaration"),
    "inverted_poses": Kind("poses"),
    "mirrored_sensor": Kind("poses", number="axes"),
    "sensor_scale": Kind("poses", number="factor"),
    "orientation_convention": Kind("poses", number="convention"),
    "swapped_joints": Kind("joints", "exchange"),
    "swapped_positions": Kind("positions", "exchange"),
    "joints_swapped": Kind("positions", "exchange"),
    "joint_unit": Kind("positions", "multiply", "unit"),
    "mirrored_joint": Kind("joints", "reverse"),
    "reversed_positions": Kind("positions", "reverse"),
    "joint_sign": Kind("positions", "reverse"),
    "coupled_joint": Kind("joints", "couple", "factor"),
    "joint_turns": Kind("positions", "add", "added_rad"),
    "joint_zero": Kind("positions", "add", "added_rad"),
    "degrees": Kind("positions", "divide"),
    "gear": Kind("positions", "divide", "ratio"),
    "swapped_torques": Kind("torques", "exchange"),
    "reversed_torque": Kind("torques", "reverse"),
    "wrong_torque_constant": Kind("torques", "divide"),
    "torque_unit": Kind("torques", "divide"),
}
"""By code, in the order in which changes are made. Positions of logs of commands are read-outs or commands."""

GRAVITY, DECLARED, POSES = (
    tuple(code for code, kind in KINDS.items() if kind.changes == quantity)
    for quantity in ("gravity", "declaration", "poses")
)
_ONE_OF = (GRAVITY, POSES)
"""Of each, a hypothesis has one at most."""


@final
@dataclass(frozen=True)
class SuspectedFault:
    """One fault that data may have.

    Attributes:
        code: as of `DataFault`, one of `KINDS`.
        joints: concerned, from 0; of an exchange two, of a coupling the joint and the one that it is coupled to.
        value: of a unit the factor of the column; of a coupling the factor of the other joint; of a zero what is added
            to the position, rad; of a constant the measured torque over the true one; of a gear the column over the
            true position; of a mirrored sensor the axis that is reversed or the two that are exchanged; of a scale how
            many times too large positions are; of orientations the convention.
        gravity: `(3,)` m/s², as it acts.
    """

    code: str
    joints: tuple[int, ...] = ()
    value: float | str = 1.0
    gravity: tuple[float, ...] = ()

    @property
    def kind(self) -> Kind:
        """What undoes it."""
        return KINDS[self.code]

    @property
    def place(self) -> tuple[str, tuple[int, ...]]:
        """The code and the joints, whatever the value."""
        return self.code, self.joints

    @property
    def size(self) -> float:
        """The value, where it is a number."""
        return float(self.value)

    @property
    def data_fault(self) -> DataFault:
        """What is reported of it, where it is undone alone."""
        joints = [joint + 1 for joint in self.joints]
        if self.kind.operation == "exchange":
            return DataFault(self.code, (), {"joints": joints})
        numbers: dict[str, Any] = {"joint": joints[0]} if joints else {}
        if self.kind.operation == "couple":
            numbers["added_joint"] = joints[1]
        if self.code == "joint_unit":
            numbers["unit"] = "deg" if self.size < 1 else "rad"
        elif self.kind.number:
            numbers[self.kind.number] = self.value
        return DataFault(self.code, (), numbers)

    def of_positions(self, dof: int) -> tuple[Array, Array]:
        """`(joint, joint)` and `(joint,)` rad: positions are multiplied by the one, and the other is added."""
        if self.kind.changes in ("joints", "positions"):
            return self._of_columns(dof)
        return np.eye(dof), np.zeros(dof)

    def of_torques(self, dof: int) -> Array:
        """`(joint, joint)`, by which torques are multiplied."""
        if self.kind.changes == "torques":
            return self._of_columns(dof)[0]
        if self.kind.changes == "joints":
            return np.linalg.inv(self._of_columns(dof)[0]).T  # power stays the same
        return np.eye(dof)

    def _of_columns(self, dof: int) -> tuple[Array, Array]:
        """What its operation multiplies columns by, and what it adds to them."""
        A = np.eye(dof)
        b = np.zeros(dof)
        i, j = (*self.joints, *self.joints, 0, 0)[:2]
        match self.kind.operation:
            case "exchange":
                A[[i, j]] = A[[j, i]]
            case "reverse":
                A[i, i] = -1.0
            case "multiply":
                A[i, i] = self.size
            case "divide":
                A[i, i] = 1 / self.size
            case "couple":
                A[i, j] = self.size
            case "add":
                b[i] = self.size
        return A, b


# ------------------------------------------------------------------ hypotheses


def joined(hypothesis: Hypothesis, more: Hypothesis) -> Hypothesis:
    """Both, in the order in which changes are made; each once."""
    order = list(KINDS)
    return tuple(sorted({*hypothesis, *more}, key=lambda fault: (order.index(fault.code), fault.joints, fault.value)))


def compatible(hypothesis: Hypothesis, more: Hypothesis) -> bool:
    """Tells whether no change of one repeats or takes back one of the other."""
    made = {(fault.code, frozenset(fault.joints)) for fault in hypothesis}
    excluded = {code for fault in hypothesis for group in _ONE_OF if fault.code in group for code in group}
    return not any((fault.code, frozenset(fault.joints)) in made or fault.code in excluded for fault in more)


def places(hypothesis: Hypothesis) -> frozenset[tuple[str, tuple[int, ...]]]:
    """Its faults by code and joints alone, whatever their values."""
    return frozenset(fault.place for fault in hypothesis)


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
    """Hypotheses that were not told apart, each as its faults, as numbers of the fault that says so."""
    return [[{"fault": fault.code, **fault.numbers} for fault in faults] for faults in several]


LIMIT_SLACK_RAD = 0.01
"""rad that a joint may be beyond its limits, as controllers stop a little late."""


def rounded_to_quarters(angle: float, tolerance: float) -> float:
    """An angle in rad, or the quarter turns, but no turn, that it is within a tolerance."""
    quarters = float(np.round(angle / (np.pi / 2)) * np.pi / 2)
    return quarters if quarters and abs(angle - quarters) < tolerance else angle


def whole_turns(recording: Recording, without_turns: Array) -> DataFault | None:
    """Joints and rows whose positions are others than these, which have no whole turns; None where there are none."""
    turned = np.abs(without_turns - recording.joint_position) > 1.0
    if not turned.any():
        return None
    joints = (1 + np.flatnonzero(turned.any(0))).tolist()
    return DataFault("joint_turns", row_numbers(recording.row[turned.any(1)]), {"joints": joints})


# ------------------------------------------------------------------ how they are compared


class Ranking(Protocol):
    """How a domain compares hypotheses before the best are fitted: the less their cost, the nearer they are."""

    @property
    def most_changes(self) -> int:
        """How many simple ones are joined at most."""
        ...

    def simple(self, changes: int) -> Sequence[Hypothesis]:
        """Those that are joined to others of so many changes."""
        ...

    def costs(self, hypotheses: Sequence[Hypothesis]) -> dict[Hypothesis, float]:
        """The cost of each."""
        ...

    def refined(self, costs: Mapping[Hypothesis, float], origins: Sequence[Hypothesis]) -> list[Hypothesis]:
        """More hypotheses, with numbers that are fitted: of the best of new ones, and of those that they extend."""
        ...

    def nearest(self, costs: Mapping[Hypothesis, float]) -> list[Hypothesis]:
        """The best of some, to which others are joined next."""
        ...

    def suffices(self, nearest: Hypothesis, cost: float, before: float) -> bool:
        """Tells whether to stop: `nearest` costs `cost`, and with one change less the least cost was `before`."""
        ...


def search(ranking: Ranking, costs: Mapping[Hypothesis, float]) -> dict[Hypothesis, float]:
    """Costs of hypotheses, of few changes first, of more where these do not suffice; those of `costs` are given."""
    compared = dict(costs)
    nearest: list[Hypothesis] = [()]
    for changes in range(ranking.most_changes):
        simple = ranking.simple(changes)
        extended = (joined(h, more) for h in nearest for more in simple if compatible(h, more))
        new = ranking.costs([h for h in dict.fromkeys(extended) if h not in compared])
        if not new:
            break
        new |= ranking.costs(ranking.refined(new, nearest))
        before = min(compared.values(), default=np.inf)
        nearest = ranking.nearest(new)
        compared |= new
        best = min(new, key=lambda h: new[h])
        if not nearest or ranking.suffices(best, new[best], before):
            break
    return compared


def fault_cost(recording: Recording, prior: Prior = PRIOR) -> float:
    """nats that a data fault costs a priori, by the probabilities of explanations."""
    return prior.given(recording.settings.prior or {}).cost("data_fault")


def distinct(hypotheses: Iterable[Hypothesis], alike: Callable[[Hypothesis, Hypothesis], bool]) -> list[Hypothesis]:
    """Those that are like none before them."""
    different: list[Hypothesis] = []
    for hypothesis in hypotheses:
        if not any(alike(hypothesis, earlier) for earlier in different):
            different.append(hypothesis)
    return different


def simplest(hypotheses: Sequence[Hypothesis], simplicity: Callable[[Hypothesis], Any]) -> list[Hypothesis]:
    """The hypotheses of least `simplicity` among some that fit alike; what others add to one of them does not show."""
    ranks = {h: simplicity(h) for h in hypotheses}
    least = min(ranks.values())
    simple = [h for h in hypotheses if ranks[h] == least]
    return [h for h in simple if not any(places(rival) < places(h) for rival in simple)]


# ------------------------------------------------------------------ what a screening says


@dataclass(frozen=True, eq=False)
class Screened(Generic[Data]):
    """Data on their way through a screening, and as they are diagnosed.

    Attributes:
        data: corrected so far.
        found: the faults, in the order in which they were corrected.
        ruled_out: faults that were tested for and are not there.
    """

    data: Data
    found: tuple[DataFault, ...] = ()
    ruled_out: tuple[DataFault, ...] = ()

    def count(self, code: str) -> int:
        """How many faults of a code were found."""
        return sum(fault.code == code for fault in self.found)

    def with_faults(self, faults: Iterable[DataFault], data: Data | None = None) -> Self:
        """With faults found, and corrected in the data where these are given."""
        new = tuple(faults)
        codes = {fault.code for fault in new}
        ruled_out = tuple(fault for fault in self.ruled_out if fault.code not in codes)
        corrected = self.data if data is None else data
        return replace(self, data=corrected, found=(*self.found, *new), ruled_out=ruled_out)

    def rule_out(self, *codes: str, **numbers: Any) -> Self:
        """With faults ruled out by the same numbers, but for those of which one was found before."""
        ruled_out = (DataFault(code, (), numbers) for code in codes if not self.count(code))
        return replace(self, ruled_out=(*self.ruled_out, *ruled_out))
