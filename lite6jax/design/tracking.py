"""What a log of commands tells of effects on how servos follow, before it is recorded.

The distance of two explanations is that of their read-outs in standard deviations of the noise, with all that is
unknown beside refitted. An effect of size a, whose model is at the distance d from the nearest model without it, has a
standard deviation of a / d or more, to first order (Cramér–Rao). The information of motions from rest to rest adds up.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, final

import numpy as np

from lite6jax.arms.dynamics import is_consistent, set_link_parameters
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.tracking.coupling import loads_along
from lite6jax.domains.tracking.model import TrackingModel, compose, roll_out
from lite6jax.domains.tracking.predict import DiagnosedServos
from lite6jax.domains.tracking.problem import TrackingProblem, candidates_beside, unknowns_of
from lite6jax.domains.tracking.rollout import hold_commands
from lite6jax.domains.tracking.rows import FLOOR, TrackingRows
from lite6jax.effects.catalogue import TRACKING_EFFECTS
from lite6jax.effects.dynamic import RotorInertia, ViscousFriction
from lite6jax.effects.effect import Effect, OfJoint
from lite6jax.effects.servo import (
    CommandDelay,
    CommandTimeOffset,
    Limit,
    ServoDamping,
    ServoFeedforward,
    ServoStiffness,
    TorqueSpeedLimit,
)
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording, RecordingSettings

NOISE = 1e-4
"""rad, one sigma of a read-out where none is declared: an assumption to plan with."""
_STEP = 0.002
"""s, of an integration step."""
_PAUSE = 5.0
"""s between two candidates of one rollout."""
_CHANGE = 0.02
"""Of a number of the nuisance, or of an effect, by which it is changed for a derivative."""
_PRIOR = 1.5**-2
"""Precision of the logarithm of a servo's unknown number, as in a diagnosis."""
_RIDGE = 1e-9
"""Of the largest diagonal entry, beside which a direction is no information."""
_SIZED = 2
"""Times that the size of an alternative is adapted to the effect that it may stand for."""
_LIMIT = 0.7
"""Of the largest speed or torque of all candidates: a limit that is reached."""


_SMOOTH = (
    CommandDelay,
    CommandTimeOffset,
    ServoStiffness,
    ServoDamping,
    ServoFeedforward,
    ViscousFriction,
    RotorInertia,
)
"""Effects on which read-outs depend smoothly: those that are alike are so to first order."""


class _Change(NamedTuple):
    """A column of the information: how read-outs change from one model to another, over `scale`."""

    before: TrackingModel
    after: TrackingModel
    joints: tuple[int, ...]
    scale: float = 1.0


class Alternatives(NamedTuple):
    """An effect, and another one that may stand for it.

    Attributes:
        effect: of a size that is given.
        values: `(coordinate,)` its numbers.
        number: which of them, of a size that is typical; None of an effect that was found.
        rival: the other one.
    """

    effect: Effect
    values: Array
    number: int | None
    rival: Effect


@final
@dataclass(frozen=True, eq=False)
class CommandExperiment:
    """An arm with servos whose commands are to be designed.

    Attributes:
        model: the arm, its servos, and the effects that were found.
        declared: whether stiffness and damping of the servos are known.
        noise: `(joint,)` rad, one sigma of the read-outs.
        undecided: for each effect that was found, effects that may stand for it; none where all named effects are to be
            distinguished.
        recorded: the log that there is already.
        payloads: kg, with each of which the commands are recorded once.
        period: s between samples.
    """

    model: DiagnosedServos
    declared: bool
    noise: Array
    undecided: tuple[tuple[int, Effect], ...] = ()
    recorded: Recording | None = None
    payloads: tuple[float, ...] = ()
    period: float = 0.01

    @property
    def of_findings(self) -> bool:
        """Tells whether effects that were found are distinguished from others."""
        return bool(self.undecided)

    @property
    def carried(self) -> tuple[float, ...]:
        """kg, the payload of each recording to come."""
        return self.payloads or (self.model.payload,)

    # ------------------------------------------------------------------ rollouts

    def problem(self, command: Array, run: Integers, payload: float) -> TrackingProblem:
        """Commands `(sample, joint)` rad with the read-outs that the model predicts, as an estimation problem."""
        model = replace(self.model, payload=payload)
        bodies = model.bodies
        tracked = compose(TrackingModel(model.servo, bodies), model.terms, model.values, coupled=False)
        servo = tracked.servo
        place = command.T
        still = np.zeros_like(place)
        for _ in range(3):  # where servos hold the arm at rest, of which the first sample of a run counts
            place = (
                command.T
                - (bodies.torques(place, still, still) + servo.spring_torque[:, None])
                / np.asarray(servo.stiffness)[:, None]
            )
        wave = servo.sine[:, None] * np.sin(place) + servo.cosine[:, None] * np.cos(place)
        shown = place * (1 + servo.scale[:, None]) + servo.offset[:, None] + wave
        held = hold_commands(command, run, self.period, shown.T, None, model.interpolated, _STEP)
        loads = loads_along(bodies, held, command.T, still, still)
        readout, _ = roll_out(replace(tracked, driven=()), held, loads, None, coupled=False)
        # a rollout that its servos do not hold tells nothing
        readout = np.clip(np.nan_to_num(readout), -10.0, 10.0)
        recording = Recording.assembled(
            readout.T,
            time=self.period * np.arange(len(command)) + _PAUSE * run,
            commanded_position=command,
            payload=np.full(len(command), payload),
            run=run,
            settings=RecordingSettings(
                joint_source="measured", motion="trajectory", gravity_m_per_s2=tuple(model.gravity.tolist())
            ),
            source="commands",
        )
        arm = model.arm
        if arm.mass is None and model.links.any() and is_consistent(model.links):
            arm = set_link_parameters(arm, model.links)
        data = TrackingRows(recording, arm, bodies, held, readout, self.noise, model.servo, self.declared, False)
        unknowns = unknowns_of(data)
        everything = np.arange(len(command))
        valid = np.ones(len(command), bool)
        return TrackingProblem(data, everything, model.servo, unknowns, np.zeros(len(unknowns)), (), (), valid)

    def composed(self, problem: TrackingProblem, terms: Terms, values: Array) -> TrackingModel:
        """The model with some terms, along the loads of a motion."""
        return compose(TrackingModel(problem.servo, problem.data.bodies), terms, values, coupled=False)

    # ------------------------------------------------------------------ what is distinguished

    def alternatives(self, library: TrackingProblem) -> tuple[Alternatives, ...]:
        """Every pair that is to be distinguished; sizes of limits are those that candidates reach."""
        terms = self.model.terms
        if self.of_findings:
            pairs = []
            for k, rival in self.undecided:
                effect = terms.terms[k]
                assert isinstance(effect, Effect)
                pairs.append(Alternatives(effect, self.model.values[terms.slices[k]], None, rival))
            return tuple(pairs)
        present = set(terms.terms)
        named = [effect for effect in candidates_beside(library.data, library.unknowns) if effect not in present]
        # it is a torque limit where the speed does not matter
        named = [effect for effect in named if not isinstance(effect, TorqueSpeedLimit)]
        sized = {effect: _typical(library, effect) for effect in named}
        return tuple(
            Alternatives(effect, numbers, k, rival)
            for effect in named
            for k, numbers in enumerate(sized[effect])
            for rival in named
            if rival != effect and _meet(effect, rival)
        )


def _typical(library: TrackingProblem, effect: Effect) -> list[Array]:
    """`(coordinate,)` numbers of a usual size, for each number of an effect."""
    first = effect.coordinates[0].typical
    if isinstance(effect, Limit):
        first = 1 / (_LIMIT * library.largest(effect))
    steps = [first, *(coordinate.typical for coordinate in effect.coordinates[1:])]
    numbers = list(np.diag(steps))
    if isinstance(effect, TorqueSpeedLimit):  # without a limit, nothing falls with the speed
        numbers[1] = np.array(steps)
    return numbers


def _meet(effect: Effect, other: Effect) -> bool:
    """Tells whether two effects move one joint."""
    if isinstance(effect, OfJoint) and isinstance(other, OfJoint):
        return effect.joint == other.joint
    return True


# ------------------------------------------------------------------ information


class _Group(NamedTuple):
    """Pairs with the same background.

    Attributes:
        pairs: `(pair,)`, which these are.
        subjects: `(pair,)`, the column of the effect of each.
        rivals: `(pair, column)`, those of the other.
        background: columns that are refitted beside.
    """

    pairs: Integers
    subjects: Integers
    rivals: Integers
    background: Integers


class _Columns(NamedTuple):
    """The columns of an experiment, as changes of a model, and what pairs are made of them.

    Attributes:
        changes: functions of a problem, since loads differ from motion to motion.
        groups: of pairs.
        prior: `(column,)`, precision.
    """

    changes: Sequence[Any]
    groups: tuple[_Group, ...]
    prior: Array


@final
class Information:
    """What logs of commands tell of the alternatives of an experiment.

    Args:
        experiment: the arm, and what is to be distinguished.
        library: candidates, along which sizes are chosen.
        sized: a motion along which alternatives have the size with which they resemble what was found.
    """

    def __init__(self, experiment: CommandExperiment, library: TrackingProblem, sized: TrackingProblem) -> None:
        self.experiment = experiment
        self.alternatives = experiment.alternatives(library)
        self._unknowns = library.unknowns
        self._columns = self._of_findings(sized) if experiment.of_findings else self._of_names()

    # ------------------------------------------------------------------ columns

    def _joints(self, effect: Effect) -> tuple[int, ...]:
        joints = range(self.experiment.model.dof)
        return (effect.joint - 1,) if isinstance(effect, OfJoint) else tuple(joints)

    def _nuisance(self, first: int) -> tuple[list[Any], Integers]:
        """Columns of unknown servos, and their numbers."""

        def change_of(unknown: Any) -> Any:
            def change(problem: TrackingProblem) -> _Change:
                before = self._whole(problem)
                base = TrackingModel(
                    problem.servo._replace(
                        **{
                            unknown.field: np.asarray(problem.servo._asdict()[unknown.field])
                            * np.where(np.arange(problem.rows) == unknown.joint, np.exp(_CHANGE), 1.0)
                        }
                    ),
                    problem.data.bodies,
                )
                terms = self.experiment.model.terms
                after = compose(base, terms, self.experiment.model.values, coupled=False)
                return _Change(before, after, (unknown.joint,), _CHANGE)

            return change

        changes = [change_of(unknown) for unknown in self._unknowns]
        return changes, np.arange(first, first + len(changes))

    def _whole(self, problem: TrackingProblem) -> TrackingModel:
        model = self.experiment.model
        return self.experiment.composed(problem, model.terms, model.values)

    def _added(
        self,
        base: tuple[Terms, Array],
        effect: Effect,
        values: Array,
        start: Array | None = None,
        scale: float = 1.0,
    ) -> Any:
        """The change by an effect beside others, from its `start` or from none, over a `scale`."""
        terms, numbers = base
        both = Terms((*terms.terms, effect))

        def change(problem: TrackingProblem) -> _Change:
            before = self.experiment.composed(problem, terms, numbers)
            if start is not None:
                before = self.experiment.composed(problem, both, np.concatenate([numbers, start]))
            after = self.experiment.composed(problem, both, np.concatenate([numbers, values]))
            return _Change(before, after, self._joints(effect), scale)

        return change

    def _of_names(self) -> _Columns:
        """All named effects at typical sizes: every number beside every other one, and the unknown servos."""
        model = self.experiment.model
        base = model.terms, model.values
        numbers: dict[tuple[Effect, int], int] = {}
        changes: list[Any] = []
        for pair in self.alternatives:
            assert pair.number is not None
            if (pair.effect, pair.number) not in numbers:
                numbers[pair.effect, pair.number] = len(changes)
                smaller = _CHANGE if isinstance(pair.effect, _SMOOTH) else 1.0
                changes.append(self._added(base, pair.effect, smaller * pair.values, scale=smaller))
        more, background = self._nuisance(len(changes))
        by_size: dict[int, list[int]] = {}
        for place, pair in enumerate(self.alternatives):
            by_size.setdefault(pair.rival.size, []).append(place)
        groups = []
        for size, places in by_size.items():
            subjects = [numbers[self.alternatives[p].effect, self.alternatives[p].number or 0] for p in places]
            rivals = [[numbers[self.alternatives[p].rival, k] for k in range(size)] for p in places]
            groups.append(_Group(np.array(places), np.array(subjects), np.array(rivals), background))
        prior = np.r_[np.zeros(len(changes)), np.full(len(more), _PRIOR)]
        return _Columns([*changes, *more], tuple(groups), prior)

    def _of_findings(self, sized: TrackingProblem) -> _Columns:
        """Effects that were found: what each moves, beside its alternative, the other findings, and unknown servos."""
        model = self.experiment.model
        changes: list[Any] = []
        groups = []
        more, nuisance = self._nuisance(0)
        changes += more
        for place, (pair, (k, _)) in enumerate(zip(self.alternatives, self.experiment.undecided, strict=True)):
            terms = model.terms
            others = terms.part(model.values, [number != k for number in range(len(terms.terms))])
            subject = len(changes)
            changes.append(self._added(others, pair.effect, pair.values))
            rivals = self._resembling(sized, others, pair)
            columns = np.arange(len(changes), len(changes) + len(rivals))
            changes += rivals
            beside = len(changes)
            for effect, part in others[0].pairs:
                assert isinstance(effect, Effect)
                at = others[1][part]
                rest = others[0].part(others[1], [term != effect for term in others[0].terms])
                if effect.nonparametric:  # a curve of many numbers: its size alone is refitted
                    changes.append(self._added(rest, effect, (1 + _CHANGE) * at, at))
                    continue
                for number, coordinate in enumerate(effect.coordinates):
                    step = max(_CHANGE * abs(at[number]), _CHANGE * coordinate.typical)
                    moved = at + step * np.eye(effect.size)[number]
                    changes.append(self._added(rest, effect, moved, at))
            background = np.r_[nuisance, np.arange(beside, len(changes))]
            groups.append(_Group(np.array([place]), np.array([subject]), columns[None], background))
        prior = np.r_[np.full(len(more), _PRIOR), np.zeros(len(changes) - len(more))]
        return _Columns(changes, tuple(groups), prior)

    def _resembling(self, sized: TrackingProblem, others: tuple[Terms, Array], pair: Alternatives) -> list[Any]:
        """The changes by an alternative at the size at which it resembles an effect most, and about that size."""
        effect = pair.rival
        steps = _typical(sized, effect)
        subject = self._signatures(sized, [self._added(others, pair.effect, pair.values)(sized)])[0].ravel()
        for _ in range(_SIZED):
            rows = self._signatures(sized, [self._added(others, effect, step)(sized) for step in steps])
            columns = rows.reshape(len(steps), -1)
            squares = columns @ columns.T
            squares[np.diag_indices(len(steps))] += _RIDGE * max(float(np.max(np.diag(squares))), 1e-30)
            factors = np.linalg.solve(squares, columns @ subject)
            if len(steps) > 1:
                break
            coordinate = effect.coordinates[0]
            size = float(np.clip(factors[0], 0.1, 10.0) if factors[0] > 0 else np.clip(factors[0], -10.0, -0.1))
            wanted = float(np.clip(size * steps[0][0], coordinate.lower, coordinate.upper))
            if wanted == 0.0:  # it cannot have that sign
                break
            steps = [np.array([wanted])]
        added = [self._added(others, effect, step) for step in steps]
        if len(steps) == 1:
            added.append(self._added(others, effect, (1 + 5 * _CHANGE) * steps[0], steps[0]))
        return added

    def _signatures(self, problem: TrackingProblem, changes: Sequence[_Change]) -> Array:
        """`(column, joint, sample)`, how read-outs change, over the noise."""
        states: dict[Any, Any] = {}
        pairs = []
        for number, change in enumerate(changes):
            for joint in change.joints:
                ends = [problem.state_of(model, joint) for model in (change.before, change.after)]
                for state in ends:
                    states.setdefault(state.key, state)
                pairs.append((number, joint, ends[0].key, ends[1].key))
        place = {key: row for row, key in enumerate(states)}
        rolled = np.clip(np.nan_to_num(problem.rolled(list(states.values()))), -10.0, 10.0)
        columns = np.zeros((len(changes), problem.rows, problem.data.commands.samples))
        for number, joint, before, after in pairs:
            difference = rolled[place[after]] - rolled[place[before]]
            columns[number, joint] = difference / (changes[number].scale * problem.noise[joint])
        return columns

    # ------------------------------------------------------------------ motions

    def of_problem(self, problem: TrackingProblem, counted: Mask) -> Array:
        """`(run, column, column)`, the information of each run of a motion; `counted` are its samples that count."""
        columns = self._signatures(problem, [change(problem) for change in self._columns.changes])
        run = np.unique(problem.data.recording.run, return_inverse=True)[1]
        matrices = np.zeros((int(run.max()) + 1, len(columns), len(columns)))
        acts = np.abs(columns).max(2) > 0
        for joint in range(problem.rows):
            here = np.flatnonzero(acts[:, joint])
            part = columns[here, joint]
            for number in range(len(matrices)):
                rows = part[:, (run == number) & counted]
                matrices[number][np.ix_(here, here)] += rows @ rows.T
        return matrices

    def squares(self, matrices: Array) -> Array:
        """Squared distances `(…, pair)` of information `(…, column, column)`."""
        squared = np.zeros((*matrices.shape[:-2], len(self.alternatives)))
        whole = matrices + np.diag(self._columns.prior)
        for group in self._columns.groups:
            rest = _beside(whole, group.background)
            own = rest[..., group.subjects, group.subjects]
            between = rest[..., group.rivals, group.subjects[:, None]]
            inner = rest[..., group.rivals[:, :, None], group.rivals[:, None, :]]
            squared[..., group.pairs] = np.maximum(own - _explained(inner, between), 0.0)
        return squared

    def moved(self, matrices: Array) -> Array:
        """Squares `(…, pair)` of what each effect moves beside the unknown servos and other findings alone."""
        squared = np.zeros((*matrices.shape[:-2], len(self.alternatives)))
        whole = matrices + np.diag(self._columns.prior)
        for group in self._columns.groups:
            rest = _beside(whole, group.background)
            squared[..., group.pairs] = np.maximum(rest[..., group.subjects, group.subjects], 0.0)
        return squared


def _beside(matrices: Array, background: Integers) -> Array:
    """Information `(…, column, column)` with the background refitted."""
    if not len(background):
        return matrices
    inner = matrices[..., background[:, None], background]
    across = matrices[..., background, :]
    size = np.maximum(np.max(np.diagonal(inner, axis1=-2, axis2=-1), -1), 1e-30)
    regular = inner + (_RIDGE * size)[..., None, None] * np.eye(len(background))
    return matrices - np.swapaxes(across, -1, -2) @ np.linalg.solve(regular, across)


def _explained(inner: Array, between: Array) -> Array:
    """`bᵀ A⁻¹ b` of `(…, column, column)` and `(…, column)`."""
    size = np.maximum(np.max(np.diagonal(inner, axis1=-2, axis2=-1), -1), 1e-30)
    regular = inner + (_RIDGE * size)[..., None, None] * np.eye(inner.shape[-1])
    solved = np.linalg.solve(regular, between[..., None])[..., 0]
    return np.sum(between * solved, -1)


# ------------------------------------------------------------------ from a diagnosis


def undecided_of(document: Mapping[str, Any], model: DiagnosedServos) -> tuple[tuple[int, Effect], ...]:
    """The named effects that may stand for each finding in a diagnosis, by the number of the finding.

    Raises:
        InputError: the document has effects that the catalogue has not.
    """
    undecided = []
    labels = [effect.label for effect in model.terms.terms]  # type: ignore[attr-defined]
    for finding in document["findings"]:
        k = labels.index(f"{finding['effect']}:{finding['site']}")
        for rival in finding["confusable_with"]:
            if rival["status"] != "undecided" or rival["effect"] == "unnamed":
                continue
            kind = TRACKING_EFFECTS.get(rival["effect"])
            if kind is None:
                raise InputError(f"{rival['effect'][:60]!r}: is no effect on how servos follow; diagnose the log again")
            joint = rival["site"].removeprefix("joint")
            effect = kind(int(joint)) if joint.isdecimal() else kind()  # type: ignore[call-arg]
            if effect not in model.terms.terms:
                undecided.append((k, effect))
    return tuple(undecided)


def noise_of(document: Mapping[str, Any]) -> Array:
    """`(joint,)` rad, the noise in a diagnosis, what is left included."""
    return np.maximum(np.asarray(document["noise"]["estimated"]["joint_rad"], float), FLOOR)
