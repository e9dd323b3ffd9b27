"""What is wrong where torques contradict the arm grossly: signs, columns, zeros, constants, or gravity.

A hypothesis is a tuple of changes, each a fault and what undoes it. All are ranked by a penalised likelihood of what
the rigid arm as declared leaves beside friction that takes power, and the best by their evidence beside other masses, a
payload, springs and scales. Of those within the prior's cost of a fault of the best one, the one of fewest faults is
taken; several of as few are listed. It has to exceed the recording as it is declared by as much.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, combinations, product
from typing import NamedTuple, final

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import nnls

from lite6jax.array_types import Array
from lite6jax.domains.faults import (
    GRAVITY,
    Hypothesis,
    Screened,
    SuspectedFault,
    couplings,
    distinct,
    fault_cost,
    joined,
    listed,
    places,
    search,
    signs_of_sets,
    simplest,
)
from lite6jax.domains.torque.changes import POSITIONS, STEP, alike, faults_in, faults_of, turned_back, undo
from lite6jax.domains.torque.likelihood import Samples, Scored
from lite6jax.domains.torque.rows import TorqueRows
from lite6jax.effects.dynamic import TILT, direction
from lite6jax.estimation.noise import autocorrelation_time
from lite6jax.estimation.projection import orthonormal, outside, unit_rows
from lite6jax.recordings.fault import DataFault

_EXPLAINED = 0.1
"""Of a joint's torque, RMS, from which a second change is sought: what most arms have beside leaves as much."""
_CLEARLY = 1.5
"""Times by which a hypothesis leaves less of the torque of a joint, RMS."""
_BEAM = 6
"""Hypotheses that are joined with further changes; of those that differ in numbers alone the likeliest."""
_COMPARED = 8
"""Hypotheses of which the evidence is computed."""
_NOISELESS = 1e-3
"""Of a joint's torque: the noise of one that was computed, at most."""
_FRICTIONLESS = 5e-3
"""Of a joint's torque, RMS: friction, and what a rigid arm leaves, of one that was computed, at most."""


_AXES = {
    "x": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "-x": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "-y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}
"""Rotations that turn z into another axis of a frame."""
_SIGNS = ("reversed_torque", "reversed_positions")
"""Of which a joint without weight may show only that one is there: its friction would exert power."""
_OF_JOINTS = ("reversed_sign", "reversed_joint", "swapped_columns", "coupled_positions", "joint_axis")
"""Faults beside which no zero of a joint is ruled out."""
_RULED_OUT = {
    "swapped_torques": {"swapped_torques", "reversed_torque", *_OF_JOINTS[:3]},
    "wrong_gravity": set(GRAVITY),
    "wrong_torque_constant": {"wrong_torque_constant", "torque_unit"},
    "joint_zero": {*POSITIONS, *_OF_JOINTS},
}
"""What is said not to be there, and the faults of which none is there then."""
_RANK = 1e-9
"""Of the length of a column, below which what others leave of it is rounding."""
_FELT = 0.01
"""Of a joint's torque, RMS: what another gravity changes at least, where it is a hypothesis."""


def correct_faults(state: Screened[TorqueRows]) -> Screened[TorqueRows]:
    """The rows corrected by the hypothesis that is taken; unchanged where none is, or where several are as likely."""
    data = state.data
    rows, compared = _compare(Samples(data))
    likeliest = compared.hypotheses
    faults: list[DataFault] = []
    # several faults at once may be one of the description
    doubtful = rows.suspicious(rows.declared) and [faults_in(h) for h in likeliest] != [1]
    if doubtful and (axis := _other_axis(rows, compared.evidence)) is not None:
        faults = [axis]
    elif len(likeliest) == 1:
        faults = faults_of(likeliest[0], data)
        if compared.signs_alike:
            faults = [replace(fault, code="reversed_sign") if fault.code in _SIGNS else fault for fault in faults]
        data = undo(likeliest[0], data)
    elif likeliest:
        alternatives = listed(faults_of(hypothesis, data) for hypothesis in likeliest)
        faults = [DataFault("undecided_torques", (), {"alternatives": alternatives})]
    doubted = {
        fault["fault"] for f in faults for hypothesis in f.numbers.get("alternatives", ()) for fault in hypothesis
    }
    doubted |= {fault.code for fault in faults}
    absent = [code for code, rival_codes in _RULED_OUT.items() if not doubted & rival_codes]
    return state.with_faults(faults, data).rule_out(*absent)


def correct_signs(state: Screened[TorqueRows]) -> Screened[TorqueRows]:
    """The rows with the signs of joints whose friction would exert power, where no inertial number is known.

    Each joint is fitted by any arm's torques, an offset and friction: of a wrong sign, friction that takes power leaves
    more than friction that exerts it. Whether the positions are reversed or the torques, all joints together show.
    """
    data = state.data
    required = fault_cost(data.recording)
    joints = [joint for joint in range(data.arm.dof) if _power_gain(data, joint) > required + np.log(data.arm.dof)]
    if not joints:
        return state
    misfits = {}
    for code in _SIGNS:
        hypothesis = tuple(SuspectedFault(code, (joint,)) for joint in joints)
        misfits[code] = _left_by_any_arm(undo(hypothesis, data))
    torque, positions = (misfits[code] for code in _SIGNS)
    apart = torque - positions
    code = "reversed_sign" if abs(apart) < required else _SIGNS[int(apart > 0)]
    undone = "reversed_torque"
    if code == "reversed_positions":
        undone = "reversed_positions"
    corrected = undo(tuple(SuspectedFault(undone, (joint,)) for joint in joints), data)
    return state.with_faults([DataFault(code, (), {"joints": [joint + 1 for joint in joints]})], corrected)


def _of_any_arm(data: TorqueRows, joint: int) -> tuple[Array, Array]:
    """Columns `(number, sample)` of a joint's torque: by inertial numbers and an offset, and by friction."""
    velocity = np.asarray(data.motion.joint_velocity)[joint, data.filter.kept]
    free = np.vstack([data.regressor[joint], np.ones_like(velocity)])
    return free, np.vstack([velocity, direction(velocity, data.arm.slides[joint])])


def _power_gain(data: TorqueRows, joint: int) -> float:
    """Log-likelihood by which friction that exerts power explains a joint better than one that takes it."""
    free, friction = _of_any_arm(data, joint)
    basis = orthonormal(unit_rows(free), _RANK)
    torque = outside(data.measured[joint][None], basis)[0]
    columns = outside(friction, basis)
    squares = [nnls(sign * columns.T, torque)[1] ** 2 for sign in (1.0, -1.0)]
    takes, exerts = (max(square, 1e-300) for square in squares)
    numbers = nnls(-columns.T, torque)[0]
    counted = len(torque) / autocorrelation_time((torque + numbers @ columns)[None])
    return 0.5 * counted * float(np.log(takes / exerts))


def _left_by_any_arm(data: TorqueRows) -> float:
    """Negative log-likelihood of the torques of all joints beside the inertial numbers that explain them best."""
    columns_of_joints = [_of_any_arm(data, joint) for joint in range(data.arm.dof)]
    spread = np.maximum(np.std(data.measured, axis=1), 1e-300)
    shared = np.hstack([free[:-1] / scale for (free, _), scale in zip(columns_of_joints, spread, strict=True)])
    lengths = np.linalg.norm(shared, axis=1)
    shared = shared[lengths > 0] / lengths[lengths > 0, None]
    blocks = [
        np.vstack([free[-1:], friction]) / scale
        for (free, friction), scale in zip(columns_of_joints, spread, strict=True)
    ]
    columns = np.vstack([shared, np.asarray(block_diag(*blocks))])
    torque = np.hstack([row / scale for row, scale in zip(data.measured, spread, strict=True)])
    residuals = outside(torque[None], orthonormal(unit_rows(columns), _RANK))[0].reshape(data.measured.shape)
    counted = residuals.shape[1] / autocorrelation_time(residuals)
    return 0.5 * counted * float(np.sum(np.log(np.maximum(np.mean(residuals**2, axis=1), 1e-300))))


def _other_axis(rows: Samples, evidence: float) -> DataFault | None:
    """The joint that turns about another axis of its frame than described; None where none exceeds that evidence."""
    threshold = max(evidence, rows.evidence(())) + rows.required + np.log(len(_AXES) * rows.dof)
    fault = None
    for joint in (i for i in range(rows.dof) if i not in rows.data.arm.sliding):
        for name, R in _AXES.items():
            turned = rows.with_axis(joint, R)
            scored = turned.scored(())
            if scored.hypothesis or (scored.left > rows.declared.left / _CLEARLY).all():
                continue
            if (turned_evidence := turned.evidence(())) > threshold:
                threshold = turned_evidence
                fault = DataFault("joint_axis", (), {"joint": joint + 1, "axis": name})
    return fault


def computed_torque(data: TorqueRows) -> bool:
    """Tells whether no joint has noise or friction: a controller computes that by a model, and no motor exerts it.

    The links may be others than declared. A sensor's noise, or a current's, is several times `_NOISELESS`, and friction
    of a gear some per cent of its torque.
    """
    rows = data.measured
    regressors = data.regressor
    size = np.maximum(np.std(rows, axis=1), 1e-300)
    steps = np.diff(data.torque, 3, axis=1) / np.sqrt(20.0)  # of white noise, its standard deviation
    if (1.4826 * np.median(np.abs(steps), 1) > _NOISELESS * size).any() or rows.shape[1] < 2 * regressors.shape[1]:
        return False
    dq = np.asarray(data.motion.joint_velocity)[:, data.filter.kept]
    ddq = np.asarray(data.motion.joint_acceleration)[:, data.filter.kept]
    for row, X, v, a, slides, usual in zip(rows, regressors, dq, ddq, data.arm.slides, size, strict=True):
        columns = np.vstack([direction(v, slides), v, X, np.ones_like(v), a])
        scale = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
        numbers = np.linalg.lstsq((columns / scale[:, None]).T, row, rcond=1e-9)[0]
        friction = numbers[:2] / np.sqrt(len(row))
        residual_rms = float(np.sqrt(np.mean((row - numbers @ (columns / scale[:, None])) ** 2)))
        if np.abs(friction).max() > _FRICTIONLESS * usual or residual_rms > _FRICTIONLESS * usual:
            return False
    return True


def single_changes(data: TorqueRows) -> Iterator[Hypothesis]:
    """Every simple hypothesis about positions and gravity; torques are assigned to joints for each of them."""
    dof = data.arm.dof
    sliding = data.arm.sliding
    turning = [i for i in range(dof) if i not in sliding]
    declared = data.bodies.gravity
    strength = float(np.linalg.norm(declared))
    if strength:
        yield (SuspectedFault("no_gravity", gravity=(0.0, 0.0, 0.0)),)
        for axis in chain(np.eye(3), -np.eye(3)):
            if np.linalg.norm(strength * axis - declared) > TILT * strength:
                yield (SuspectedFault("wrong_gravity", gravity=tuple((strength * axis + 0.0).tolist())),)
    for pair in combinations(range(dof), 2):
        yield (SuspectedFault("swapped_positions", pair),)
    yield from signs_of_sets("reversed_positions", dof, most_joints=7)
    yield from couplings(turning)
    for i in turning:
        steps = (*(k * STEP for k in range(1, round(2 * np.pi / STEP))), STEP / 3, -STEP / 3)
        yield from ((SuspectedFault("joint_zero", (i,), turned_back(step)),) for step in steps)


def _conventions(data: TorqueRows) -> Iterator[Hypothesis]:
    """Zeros of two joints that are off by quarters of a turn, as those of two conventions are."""
    quarters = [k * np.pi / 2 for k in (-1, 1, 2)]
    for pair in combinations([i for i in range(data.arm.dof) if i not in data.arm.sliding], 2):
        for values in product(quarters, repeat=2):
            yield tuple(SuspectedFault("joint_zero", (i,), float(value)) for i, value in zip(pair, values, strict=True))


class _Compared(NamedTuple):
    """How the hypotheses of a recording compare.

    Attributes:
        hypotheses: the one to be taken; none where nothing is wrong or explains it, several that cannot be told apart.
        evidence: of the best of them.
        signs_alike: whether the positions of the joints whose torques are reversed may be so instead.
    """

    hypotheses: tuple[Hypothesis, ...] = ()
    evidence: float = -np.inf
    signs_alike: bool = False


def _compare(rows: Samples) -> tuple[Samples, _Compared]:
    """The samples with the noise that the likeliest hypothesis leaves, and how the hypotheses compare in it."""
    declared = rows.declared
    if not rows.suspicious(declared):
        return rows, _Compared()
    ranked = _PenalisedLikelihoods(rows)
    search(ranked, ranked.costs([()]))
    least = sorted(ranked.scored.values(), key=lambda scored: scored.cost)[:_COMPARED]
    contenders = [s.hypothesis for s in least if s.hypothesis and (s.left < declared.left / _CLEARLY).any()]
    if not contenders:
        return rows, _Compared()
    rows = rows.about(contenders[0])
    evidence = {h: rows.evidence(h) - rows.price(h) for h in contenders}
    best = max(evidence.values())
    threshold = rows.evidence(()) + rows.required
    if best < threshold:
        return rows, _Compared()
    likely = [h for h in evidence if evidence[h] >= max(best - rows.required, threshold)]
    likely.sort(key=lambda h: -evidence[h])
    tied = distinct(simplest(likely, lambda h: (faults_in(h), rows.beyond_limits(h))), alike)
    signs_alike = len(tied) > 1 and len({_without_signs(h) for h in tied}) == 1
    if signs_alike:
        tied = [min(tied, key=lambda h: sum(c.code == "reversed_positions" for c in h))]
    if len(tied) > 1:
        return rows, _Compared(tuple(tied), best)
    common = _with_one_constant(tied[0])
    evidence[common] = rows.evidence(common) - rows.price(common)
    chosen = max(tied[0], common, key=lambda h: evidence[h])
    return rows, _Compared((chosen,), evidence[chosen], signs_alike)


def _without_signs(hypothesis: Hypothesis) -> tuple[Hypothesis, tuple[int, ...]]:
    """Its changes of other kinds, and the joints of which a position or a torque is reversed."""
    joints = sorted(change.joints[0] for change in hypothesis if change.code in _SIGNS)
    return tuple(change for change in hypothesis if change.code not in _SIGNS), tuple(joints)


def _with_one_constant(hypothesis: Hypothesis) -> Hypothesis:
    """With the median of its constants for all of these joints: one error in one place is one number."""
    constants = [c.size for c in hypothesis if c.code == "wrong_torque_constant"]
    if len(constants) < 2:
        return hypothesis
    median = float(f"{np.median(constants):.3g}")
    return tuple(replace(c, value=median) if c.code == "wrong_torque_constant" else c for c in hypothesis)


@final
class _PenalisedLikelihoods:
    """Hypotheses about positions and gravity by a penalised likelihood, each with the changes of torques that fit it.

    Attributes:
        scored: by hypothesis.
    """

    most_changes = 2

    def __init__(self, rows: Samples) -> None:
        self.scored: dict[Hypothesis, Scored] = {}
        self._rows = rows
        self._simple = [h for h in single_changes(rows.data) if h[0].code not in GRAVITY or rows.feels(h, _FELT)]

    def simple(self, changes: int) -> Sequence[Hypothesis]:
        """Single changes, and at first two zeros."""
        return self._simple if changes else [*self._simple, *_conventions(self._rows.data)]

    def costs(self, hypotheses: Sequence[Hypothesis]) -> dict[Hypothesis, float]:
        """Negative log-likelihoods, with what changes cost."""
        new = {h: self._rows.scored(h) for h in hypotheses}
        self.scored |= new
        return {h: scored.cost for h, scored in new.items()}

    def refined(self, costs: Mapping[Hypothesis, float], origins: Sequence[Hypothesis]) -> list[Hypothesis]:
        """With zeros and a direction of gravity that fit best."""
        zeros: dict[Hypothesis, Hypothesis] = {}  # of those that differ in zeros alone the best
        for h in sorted(costs, key=lambda h: costs[h]):
            zeros.setdefault(tuple(replace(c, value=0.0) if c.code == "joint_zero" else c for c in h), h)
        refined = [self._rows.refined(h) for h in [h for key, h in zeros.items() if key != h][: 2 * _BEAM]]
        for h in origins:
            turned = self._rows.gravity_found(h)
            if turned is not None:
                refined.append(joined(tuple(c for c in h if c.code not in GRAVITY), (turned,)))
        return refined

    def nearest(self, costs: Mapping[Hypothesis, float]) -> list[Hypothesis]:
        """The best, of those that differ in numbers alone the first."""
        likeliest: dict[frozenset[tuple[str, tuple[int, ...]]], Hypothesis] = {}
        for h in sorted(costs, key=lambda h: costs[h]):
            likeliest.setdefault(places(h), h)
        return [*likeliest.values()][:_BEAM]

    def suffices(self, nearest: Hypothesis, cost: float, before: float) -> bool:
        """Tells whether it leaves little of all torques, or is not clearly likelier."""
        return not self._rows.suspicious(self.scored[nearest], _EXPLAINED) or cost > before - self._rows.required
