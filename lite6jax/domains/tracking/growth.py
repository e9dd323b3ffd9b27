"""Names of what acts at each joint, chosen by rollouts on rows that they were not fitted to.

Simulations of a real arm are wrong by milliradians, far more than its encoders: each of a dozen names then explains
some of that error, by hundreds of nats of evidence. What counts is whether a name predicts. So each name of each joint
is fitted to a part of the rows of each run and rolled out in the others, and one that lowers these errors by little is
none.

Along loads that are given joints are decoupled: each has its fit, and the rollouts of all joints, names and steps are
lanes of one call.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import final

import numpy as np

from lite6jax.array_types import Array, Mask
from lite6jax.domains.tracking.problem import RolloutCache, TrackingProblem
from lite6jax.domains.tracking.rows import TrackingRows
from lite6jax.effects.dynamic import CoulombFriction, RotorInertia
from lite6jax.effects.effect import Effect, OfJoint
from lite6jax.effects.servo import Limit, RateLimit
from lite6jax.estimation.noise import autocorrelation_time
from lite6jax.estimation.terms import Term, Terms

_WORTH = 0.1
"""Share of a joint's errors in held-out rows by which a name lowers them at least: in other motions less does not
show."""
_USUALLY_WORTH = 0.01
"""The same of the names that describe any servo."""
_MARGIN = 3.0
"""Log odds that a name gains in held-out rows, beyond the cost of its choice."""
_NEAR = 0.01
"""Of the limits of a number, within which it is at one of them: a name that takes a number there stands for another."""
_USUAL = (CoulombFriction, RotorInertia)
"""Names that describe a servo of which nothing is known, as its stiffness and damping do: a simulator's file seldom
has these numbers of a real arm."""
_STIFFNESSES = (3.0, 15.0, 80.0, 400.0)
"""Nm/rad, from joints of small hobby servos to those of arms: from these a fit starts where a stiffness is none."""
_STIFFEST = 1e4
"""Nm/rad, from which a stiffness is none: then the joint follows by its lag alone, whatever acts on it."""
_BESIDE_RATE_LIMIT = (0.3, 3.0)
"""Of the stiffness that fits best without a limit of the rate: from these a fit with one starts too."""
_SCREENED = 2
"""Steps of the fit of every name."""
_LIKELIEST = 4
"""Names of each joint that are fitted without some rows."""
_STEPS = 8
"""Steps of such a fit."""
_DAMPING = (0.1, 1.0, 10.0, 100.0)
"""Of the damping of the step before: those of the steps that are tried."""
_FIRST_DAMPING = 1e-2
_LEAST_DAMPING = 1e-8
_MOST_DAMPING = 1.0
"""Of a step that improves nothing, up to which shorter ones are tried."""
_CONVERGED = 1e-4
"""Share of the sum of squares that a last step gains."""
_FARTHEST = 1.0
"""By which the logarithm of a number changes in one step at most."""
_MOST = 8
"""Names of a joint."""
_GRIPS_IN_TURN = 2
"""Times that the grip is sought beside names, and names are fitted beside the grip."""


@final
@dataclass(frozen=True, eq=False)
class NamedJoint:
    """A joint with names.

    Attributes:
        joint: from 0.
        terms: what acts there beside its servo.
        numbers: `(number,)`, the unknown numbers of the servo, from the point of linearisation, and those of terms.
        readout: `(sample,)` rad, rolled out.
        error: rad RMS in held-out rows, of fits without these; in all rows where none has been held out.
        parts: `(number,)` of the fit without each fold.
    """

    joint: int
    terms: Terms
    numbers: Array
    readout: Array
    error: float = np.inf
    parts: tuple[Array, ...] = field(default=())


class _Lanes:
    """Fits of many models of joints, in step."""

    def __init__(self, problem: TrackingProblem) -> None:
        self.problem = problem
        self.unknowns = [
            [k for k, unknown in enumerate(problem.unknowns) if unknown.joint == joint] for joint in range(problem.rows)
        ]
        self.measured = problem.measured

    def rolled(self, wanted: Sequence[tuple[int, Terms, Array]]) -> list[Array]:
        """Read-outs `(variant, sample)` of joints with terms and numbers `(variant, number)`."""
        problem = self.problem
        states = []
        for joint, terms, variants in wanted:
            for numbers in variants:
                count = len(self.unknowns[joint])
                nuisance = np.zeros(len(problem.unknowns))
                nuisance[self.unknowns[joint]] = numbers[:count]
                model = problem.model(nuisance, terms, numbers[count:])
                states.append(problem.state_of(model, joint))
        if not states:
            return []
        readouts = problem.rolled(states)[:, problem.chosen]
        ends = np.cumsum([0, *(len(variants) for *_, variants in wanted)])
        return [readouts[first:last] for first, last in pairwise(ends)]

    def fitted(self, models: Sequence[NamedJoint], masks: Sequence[Mask], most: int) -> list[NamedJoint]:
        """Models fitted to some samples each by Levenberg–Marquardt steps; their error is that in these samples."""
        current = list(models)
        damping = [_FIRST_DAMPING] * len(models)
        squares = [
            self.squares(model.joint, model.readout[None], mask)[0] for model, mask in zip(models, masks, strict=True)
        ]
        active = list(range(len(models)))
        columns = dict[int, Array]()  # of the models that no step has changed since
        for _ in range(most):
            if not active:
                break
            moved = [k for k in active if k not in columns]
            steps = [self._derivative_steps(current[k]) for k in moved]
            changed = [
                (current[k].joint, current[k].terms, current[k].numbers + np.diag(step))
                for k, step in zip(moved, steps, strict=True)
            ]
            for k, step, readouts in zip(moved, steps, self.rolled(changed), strict=True):
                columns[k] = np.nan_to_num((readouts - current[k].readout)[:, masks[k]] / step[:, None])
            trials = []
            for k in active:
                model = current[k]
                residual = (self.measured[model.joint] - model.readout)[masks[k]]
                trials.append(self._steps_from(model, columns[k], residual, damping[k]))
            asked = [(current[k].joint, current[k].terms, trial) for k, trial in zip(active, trials, strict=True)]
            going = []
            for k, trial, readouts in zip(active, trials, self.rolled(asked), strict=True):
                model = current[k]
                sums = self.squares(model.joint, readouts, masks[k])
                best = int(np.argmin(sums))
                if not sums[best] < squares[k]:
                    damping[k] *= _DAMPING[-1]
                    if damping[k] <= _MOST_DAMPING:
                        going.append(k)
                    continue
                if sums[best] < (1 - _CONVERGED) * squares[k]:
                    going.append(k)
                del columns[k]
                squares[k] = sums[best]
                damping[k] = max(damping[k] * _DAMPING[best], _LEAST_DAMPING)
                current[k] = replace(model, numbers=trial[best], readout=readouts[best])
            active = going
        counts = [max(int(mask.sum()), 1) for mask in masks]
        return [
            replace(model, error=float(np.sqrt(total / count)))
            for model, total, count in zip(current, squares, counts, strict=True)
        ]

    def squares(self, joint: int, readouts: Array, mask: Mask) -> Array:
        """Sums of squared errors `(variant,)`."""
        sums = np.sum((readouts - self.measured[joint])[:, mask] ** 2, 1)
        return np.where(np.isfinite(sums), sums, np.inf)

    def _derivative_steps(self, model: NamedJoint) -> Array:
        """By how much each number is changed for a derivative, `(number,)`."""
        count = len(self.unknowns[model.joint])
        steps = [0.02] * count
        values = model.numbers[count:]
        for term, part in model.terms.pairs:
            assert isinstance(term, Effect)
            steps += [self.problem.step_of(term, k, float(at)) for k, at in enumerate(values[part])]
        return np.array(steps)

    def _steps_from(self, model: NamedJoint, columns: Array, residual: Array, damping: float) -> Array:
        """The numbers `(variant, number)` after steps of several dampings, within the limits of terms."""
        size = np.maximum(np.linalg.norm(columns, axis=1), 1e-12)
        unit = columns / size[:, None]
        information = unit @ unit.T
        pull = unit @ residual
        count = len(self.unknowns[model.joint])
        limits = [pair for term in model.terms.terms for pair in self.problem.limits(term)]
        lower, upper = np.array(limits, float).reshape(-1, 2).T
        trials = []
        for factor in _DAMPING:
            damped = information + damping * factor * np.eye(len(size))
            step = np.linalg.lstsq(damped, pull, rcond=1e-12)[0] / size
            numbers = model.numbers + np.r_[np.clip(step[:count], -_FARTHEST, _FARTHEST), step[count:]]
            numbers[count:] = np.clip(numbers[count:], lower, upper)
            trials.append(numbers)
        return np.array(trials)

    def without(self, model: NamedJoint, left_out: Collection[Term]) -> NamedJoint:
        """A model without some of its names, with the numbers that it has, not rolled out."""
        count = len(self.unknowns[model.joint])
        kept = [term not in left_out for term in model.terms.terms]
        terms, values = model.terms.part(model.numbers[count:], kept)
        return NamedJoint(model.joint, terms, np.concatenate([model.numbers[:count], values]), model.readout)

    def at_numbers(self, models: Sequence[NamedJoint]) -> list[NamedJoint]:
        """Models rolled out at their numbers."""
        readouts = self.rolled([(model.joint, model.terms, model.numbers[None]) for model in models])
        return [replace(model, readout=of_model[0]) for model, of_model in zip(models, readouts, strict=True)]

    def judged(self, models: Sequence[NamedJoint], folds: Sequence[Mask], valid: Mask) -> list[NamedJoint]:
        """Models with their errors in the rows of folds, by fits without these."""
        asked = []
        masks = []
        for model in models:
            for place, fold in enumerate(folds):
                numbers = model.parts[place] if model.parts else model.numbers
                asked.append(replace(model, numbers=numbers))
                masks.append(valid & ~fold)
        parts = self.fitted(self.at_numbers(asked), masks, _STEPS)
        judged = []
        for k, model in enumerate(models):
            of_folds = parts[k * len(folds) : (k + 1) * len(folds)]
            squares = [
                self.squares(model.joint, part.readout[None], fold & valid)[0]
                for part, fold in zip(of_folds, folds, strict=True)
            ]
            count = sum(int((fold & valid).sum()) for fold in folds)
            error = float(np.sqrt(np.sum(squares) / count))
            judged.append(replace(model, error=error, parts=tuple(part.numbers for part in of_folds)))
        return judged

    def stiffness(self, model: NamedJoint) -> float:
        """Nm/rad, of the servo of a model."""
        linearised_at = float(self.problem.servo.stiffness[model.joint])
        for number, k in zip(model.numbers, self.unknowns[model.joint], strict=False):
            if self.problem.unknowns[k].field == "stiffness":
                return linearised_at * float(np.exp(number))
        return linearised_at

    def of_stiffnesses(self, model: NamedJoint, beside_rate_limit: bool = False) -> list[NamedJoint]:
        """A model and the same with other stiffnesses, where its own may say little; not rolled out.

        Beside no load, or a limit that it lacks, a joint follows as well by any large stiffness: then nothing else that
        acts on it would show. A limit of the rate makes a servo seem softer or stiffer than it is. All unknown numbers
        over the stiffness stay.
        """
        present = self.stiffness(model)
        others = [factor * present for factor in _BESIDE_RATE_LIMIT] if beside_rate_limit else []
        if present > _STIFFEST:
            others += _STIFFNESSES
        models = [model]
        for stiffness in others:
            numbers = model.numbers.copy()
            numbers[: len(self.unknowns[model.joint])] += np.log(stiffness / present)
            models.append(replace(model, numbers=numbers))
        return models

    # -------------------------------------------------------------- names

    def is_better(self, model: NamedJoint, simpler: NamedJoint) -> bool:
        """Tells whether a model predicts so much better than one with fewer names that these are worth their choice.

        Errors of neighbouring rows are alike: what counts is how often the residual begins anew.
        """
        error = (simpler.readout - self.measured[model.joint])[self.problem.valid]
        independent = len(error) / autocorrelation_time(error[None])
        gain = independent * np.log(simpler.error / model.error)
        if _chosen(model.terms) == _chosen(simpler.terms):
            return bool(model.error < (1 - _USUALLY_WORTH) * simpler.error)
        return bool(model.error < (1 - _WORTH) * simpler.error and gain > _MARGIN + np.log(self.choices))

    def at_limits(self, model: NamedJoint) -> set[Term]:
        """The names of which a number is at one of its limits."""
        values = model.numbers[len(self.unknowns[model.joint]) :]
        at_limits = set[Term]()
        for term, part in model.terms.pairs:
            assert isinstance(term, Effect)
            bounds = zip(values[part], self.problem.limits(term), term.coordinates, strict=True)
            for value, (lower, upper), number in bounds:
                if value >= upper - _NEAR * abs(upper) or value <= lower + _NEAR * max(abs(lower), number.typical):
                    at_limits.add(term)
        return at_limits

    @cached_property
    def choices(self) -> int:
        """Names of a joint."""
        return max(len(self.names_of(0)), 1)

    def names_of(self, joint: int) -> list[Effect]:
        """All names that act at a joint alone, from 0."""
        return [
            name
            for name in (*self.problem.candidates, *self.problem.shaped)
            if isinstance(name, OfJoint) and name.joint == joint + 1
        ]

    def begun(self, model: NamedJoint) -> list[tuple[Terms, list[Array]]]:
        """Sets of terms with one more name each, and the numbers from the best of which a fit starts."""
        present = set(model.terms.terms) | {more for term in model.terms.terms for more in term.includes}
        labels = {term.label for term in model.terms.terms}
        count = len(self.unknowns[model.joint])
        begun = []
        for name in self.names_of(model.joint):
            if name in present or name.label in labels:
                continue
            kept = [term not in name.includes for term in model.terms.terms]
            terms, values = model.terms.part(model.numbers[count:], kept)
            more = Terms((*terms.terms, name))
            is_limit = isinstance(name, Limit)
            for servo in self.of_stiffnesses(model, isinstance(name, RateLimit)):
                of_name = self.problem.starts(name, self.stiffness(servo))
                starts = [np.concatenate([servo.numbers[:count], values, start]) for start in of_name]
                if is_limit:  # what is best before the fit says little of what is best after it
                    begun += [(more, [start]) for start in starts]
                else:
                    begun.append((more, starts))
        return begun


def _chosen(terms: Terms) -> list[Term]:
    """The terms that not every joint has."""
    return [term for term in terms.terms if not isinstance(term, _USUAL)]


@final
@dataclass(frozen=True, eq=False)
class NamedServos:
    """Servos with names of all joints.

    Attributes:
        problem: with the grip of each joint that friction holds.
        nuisance: `(number,)`, the unknown numbers of servos.
        terms: the names.
        values: `(terms.size,)`, their numbers.
    """

    problem: TrackingProblem
    nuisance: Array
    terms: Terms
    values: Array


def grown(problem: TrackingProblem, folds: Sequence[Mask], enough: float, finer: TrackingRows) -> NamedServos:
    """Unknown servos with names of all joints.

    Args:
        problem: of unknown servos, linearised near what fits best without names.
        folds: `(sample,)` each, the rows that are held out.
        enough: rad RMS, errors below which a joint has no further names.
        finer: the rows in shorter steps of integration.
    """
    lanes = _Lanes(problem)
    valid = problem.valid
    bare = [(joint, Terms(), np.zeros((1, len(lanes.unknowns[joint])))) for joint in range(problem.rows)]
    models = [
        NamedJoint(joint, terms, variants[0], readouts[0])
        for (joint, terms, variants), readouts in zip(bare, lanes.rolled(bare), strict=True)
    ]
    models = lanes.fitted(models, [valid] * len(models), _STEPS)
    models = lanes.judged(models, folds, valid)
    growing = [model.joint for model in models if model.error > enough]
    for model in _with_usual(lanes, [models[joint] for joint in growing], folds):
        simpler = models[model.joint]
        is_alike = model.error < (1 + _USUALLY_WORTH) * simpler.error
        if lanes.is_better(model, simpler) or (is_alike and lanes.stiffness(simpler) > _STIFFEST):
            models[model.joint] = model
    lanes, models = _in_likeliest_grip(lanes, models, folds)
    growing = _beyond_steps(lanes, finer, [model for model in models if model.error > enough])
    while growing:
        better = _with_one_more(lanes, [models[joint] for joint in growing], folds)
        large = []
        for model in better:
            if lanes.is_better(model, models[model.joint]):
                models[model.joint] = model
                if model.error > enough and len(model.terms.terms) < _MOST:
                    large.append(model)
        growing = _beyond_steps(lanes, finer, large)
    models = _without_idle(lanes, models, folds)
    lanes, models = _in_likeliest_grip(lanes, models, folds)
    models = lanes.fitted(models, [valid] * len(models), 2 * _STEPS)
    models = lanes.fitted([_within(lanes, model) for model in models], [valid] * len(models), 2 * _STEPS)
    return _together(lanes, models)


def _beyond_steps(lanes: _Lanes, finer: TrackingRows, models: Sequence[NamedJoint]) -> list[int]:
    """The joints, from 0, of models whose errors are larger than what shorter steps of integration change.

    A name more would describe what the steps miss of those that are there, such as the instants at which a limit acts.
    """
    others = _Lanes(replace(lanes.problem, data=finer, known=RolloutCache()))
    valid = lanes.problem.valid
    joints = []
    for model, same in zip(models, others.at_numbers(models), strict=True):
        apart = np.sqrt(np.mean((same.readout - model.readout)[valid] ** 2))
        if model.error > apart:
            joints.append(model.joint)
    return joints


def _together(lanes: _Lanes, models: Sequence[NamedJoint]) -> NamedServos:
    """The models of all joints as one."""
    nuisance = np.zeros(len(lanes.problem.unknowns))
    values = []
    terms: list[Term] = []
    for model in models:
        count = len(lanes.unknowns[model.joint])
        nuisance[lanes.unknowns[model.joint]] = model.numbers[:count]
        values.append(model.numbers[count:])
        terms += model.terms.terms
    return NamedServos(lanes.problem, nuisance, Terms(tuple(terms)), np.concatenate(values))


def _in_likeliest_grip(
    lanes: _Lanes, models: Sequence[NamedJoint], folds: Sequence[Mask]
) -> tuple[_Lanes, list[NamedJoint]]:
    """Models fitted beside the grip by which friction holds each joint, and that grip beside the models, in turn.

    A grip is taken where it lowers the errors of its joint in held-out rows by `_WORTH`: real joints hardly creep.
    """
    valid = lanes.problem.valid
    everywhere = [valid] * len(models)
    chosen = list(models)
    for _ in range(_GRIPS_IN_TURN):
        servos = _together(lanes, chosen)
        gripped = servos.problem.in_likeliest_grip(servos.nuisance, servos.terms, servos.values)
        if gripped is servos.problem:
            break
        others = _Lanes(gripped)
        whole = [replace(model, parts=()) for model in chosen]
        before = lanes.judged(lanes.fitted(whole, everywhere, _STEPS), folds, valid)
        trials = others.judged(others.fitted(others.at_numbers(whole), everywhere, _STEPS), folds, valid)
        grip = np.array(lanes.problem.servo.grip)
        chosen = before
        worth = [k for k, trial in enumerate(trials) if trial.error < (1 - _WORTH) * before[k].error]
        if not worth:
            break
        for k in worth:
            chosen[k] = trials[k]
            grip[trials[k].joint] = gripped.servo.grip[trials[k].joint]
        lanes = _Lanes(replace(lanes.problem, servo=lanes.problem.servo._replace(grip=grip)))
    return lanes, chosen


def _with_usual(lanes: _Lanes, models: Sequence[NamedJoint], folds: Sequence[Mask]) -> list[NamedJoint]:
    """Models each with all names that nearly every joint has."""
    if not models:
        return []
    valid = lanes.problem.valid
    begun = []
    for model in models:
        usual = [
            name for name in lanes.names_of(model.joint) if isinstance(name, _USUAL) and name not in model.terms.terms
        ]
        terms = Terms((*model.terms.terms, *usual))
        values = np.zeros(terms.size - model.terms.size)
        begun += [
            replace(start, terms=terms, numbers=np.concatenate([start.numbers, values]), parts=())
            for start in lanes.of_stiffnesses(model)
        ]
    fitted = lanes.fitted(lanes.at_numbers(begun), [valid] * len(begun), _STEPS)
    return lanes.judged(_of_usual_stiffness(lanes, fitted), folds, valid)


def _of_usual_stiffness(lanes: _Lanes, models: Sequence[NamedJoint]) -> list[NamedJoint]:
    """The model of each joint with the least errors; of several with hardly larger ones that with the usual stiffness.

    That is the median of the best models of all joints: where only ratios to the stiffness are known, servos of one arm
    are alike.
    """
    best = {model.joint: model for model in _best_of_joints(models)}
    usual = float(np.median([lanes.stiffness(model) for model in best.values()]))
    chosen = []
    for joint, likeliest in best.items():
        alike = [
            model for model in models if model.joint == joint and model.error <= (1 + _USUALLY_WORTH) * likeliest.error
        ]
        chosen.append(min(alike, key=lambda model: abs(np.log(lanes.stiffness(model) / usual))))
    return chosen


def _with_one_more(lanes: _Lanes, models: Sequence[NamedJoint], folds: Sequence[Mask]) -> list[NamedJoint]:
    """Models each with the name that predicts best, where there is any."""
    valid = lanes.problem.valid
    begun = [(model, terms, starts) for model in models for terms, starts in lanes.begun(model)]
    readouts = lanes.rolled([(model.joint, terms, np.array(starts)) for model, terms, starts in begun])
    trials = []
    for (model, terms, starts), of_starts in zip(begun, readouts, strict=True):
        best = int(np.argmin(lanes.squares(model.joint, of_starts, valid)))
        trials.append(NamedJoint(model.joint, terms, starts[best], of_starts[best]))
    screened = _best_of_names(lanes.fitted(trials, [valid] * len(trials), _SCREENED))
    likeliest = []
    for model in models:
        of_joint = sorted((one for one in screened if one.joint == model.joint), key=lambda one: one.error)
        likeliest += of_joint[:_LIKELIEST]
    likeliest = lanes.fitted(likeliest, [valid] * len(likeliest), _STEPS)
    before = {model.joint: lanes.at_limits(model) for model in models}
    likeliest = [model for model in likeliest if lanes.at_limits(model) <= before[model.joint]]
    return _best_of_joints(lanes.judged(likeliest, folds, valid))


def _within(lanes: _Lanes, model: NamedJoint) -> NamedJoint:
    """A model without the names, other than usual ones, that went to their limits at last."""
    beyond = lanes.at_limits(model) & set(_chosen(model.terms))
    if not beyond:
        return model
    return lanes.at_numbers([lanes.without(model, beyond)])[0]


def _best_of_joints(models: Sequence[NamedJoint]) -> list[NamedJoint]:
    best: dict[int, NamedJoint] = {}
    for model in models:
        if model.joint not in best or model.error < best[model.joint].error:
            best[model.joint] = model
    return list(best.values())


def _best_of_names(models: Sequence[NamedJoint]) -> list[NamedJoint]:
    """The model with the least error for each joint and set of names."""
    best: dict[tuple[int, Terms], NamedJoint] = {}
    for model in models:
        key = model.joint, model.terms
        if key not in best or model.error < best[key].error:
            best[key] = model
    return list(best.values())


def _without_idle(lanes: _Lanes, models: Sequence[NamedJoint], folds: Sequence[Mask]) -> list[NamedJoint]:
    """Models without the names that later ones made idle."""
    chosen = {model.joint: model for model in models}
    waiting = [model for model in models if len(_chosen(model.terms)) > 1]
    while waiting:
        smaller = [lanes.without(model, {name}) for model in waiting for name in _chosen(model.terms)]
        trials = lanes.at_numbers(smaller)
        trials = lanes.fitted(trials, [lanes.problem.valid] * len(trials), _STEPS)
        waiting = []
        for model in _best_of_joints(lanes.judged(trials, folds, lanes.problem.valid)):
            if not lanes.is_better(chosen[model.joint], model):
                chosen[model.joint] = model
                if len(_chosen(model.terms)) > 1:
                    waiting.append(model)
    return [chosen[joint] for joint in sorted(chosen)]
