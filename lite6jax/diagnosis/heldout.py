"""Errors on rows that were not used: screening, clock, linearisation and search are repeated without each block.

Only which faults are corrected rather than explained by physics, and at which rows frames jumped, is decided once, in
all rows: a search beside every uncorrected fault would take each fold as long as the diagnosis itself, and a block that
holds the jump cannot be predicted without its row. The size of a jump is estimated anew.

Where these errors reject what was found, its terms are fitted again without shorter blocks that are spread over the
recording. A contiguous fifth may hold the only rows that show how a drift begins, and without it the search may select
another model of the same effect; neither says that the effect is not there.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.diagnosis.explanation import Decisions, explain
from lite6jax.diagnosis.fold_processes import RemoteWork, at_hand
from lite6jax.diagnosis.folds import side_by_side
from lite6jax.diagnosis.options import Options
from lite6jax.domains.pose.kinematics import unwhitened
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.domains.pose.screening.screened import Corrections
from lite6jax.effects.effect import Effect
from lite6jax.estimation.least_squares import Fit, relinearise
from lite6jax.estimation.problem import Mask, Problem
from lite6jax.fitting.problem import Geometry
from lite6jax.recordings import Recording
from lite6jax.search.search import Selection, at_estimate
from lite6jax.search.state import fitted_again

Array = NDArray[np.floating]


class HeldOut(NamedTuple):
    """Errors on held-out rows, `(sample,)` each.

    Attributes:
        before: m, of positions, with the nuisance alone.
        after: m, of positions, with the effects that a search of the other rows selects, or that are fitted to them.
        turned_before: of orientations, over their noise, with the nuisance alone; zero where none were measured.
        turned_after: likewise with the effects.
        angle_before: rad, of orientations, with the nuisance alone; zero where none were measured.
        angle_after: likewise with the effects.
        with_effects: bool, of rows without which there are effects.
    """

    before: Array
    after: Array
    turned_before: Array
    turned_after: Array
    angle_before: Array
    angle_after: Array
    with_effects: Mask

    def rejects(self, selection: Selection, kept: Mask, folds: Sequence[Mask], options: Options) -> bool:
        """Whether the effects of a selection do not hold on rows that were not used, of those `kept`."""
        state = selection.state
        numbers = max(state.fit.parameters - state.baseline.parameters, 0.0)
        return self.raised(kept, numbers, options) or self.overfitted(kept, selection, folds, options)

    def ratio(self, kept: Mask) -> float:
        """Of the root mean squares of position errors with effects and without, of the rows `kept`."""
        return _ratio(self.before[kept], self.after[kept])

    def ratio_of_folds(self, kept: Mask, folds: Sequence[Mask]) -> float:
        """The geometric mean of `ratio` over folds, weighted by their rows among `kept`.

        Errors differ in size from fold to fold: one fold in which a function meets values of its driver that it was not
        fitted to does not decide alone.
        """
        held = [rows for fold in folds if (rows := fold & kept).any()]
        if not held:
            return 1.0
        logs = [np.log(max(self.ratio(rows), 1e-300)) for rows in held]
        return float(np.exp(np.average(logs, weights=[rows.sum() for rows in held])))

    def raised(self, kept: Mask, numbers: float, options: Options) -> bool:
        """Whether effects of so many numbers raise the errors on rows that were not used.

        Position and orientation have scales of their own: it is the product of their ratios, as in the likelihood of
        Gaussian errors of unknown variance, that must not rise. Effects that show in the orientation alone may raise
        the error of positions by what they cost in precision. As if positions alone determined them, p numbers, in
        effect, add p / (3 · rows) to the variance of a prediction, and half of that to its standard deviation.
        """
        position = self.ratio(kept)
        turned = _ratio(self.turned_before[kept], self.turned_after[kept])
        cost = 1 + 0.5 * numbers / (3 * kept.sum())
        return position * turned > 1 or position > max(options.heldout_rise, cost)

    def overfitted(self, kept: Mask, selection: Selection, folds: Sequence[Mask], options: Options) -> bool:
        """Whether a model with effects describes the rows that it was fitted to, and no others.

        Rows that were not used are then off by `heldout_excess` times the errors of the fitted ones, and by a larger
        ratio than without the effects, where the arm's geometry alone may not follow from fewer rows. Effects that
        remove most of the error there are kept all the same: a drift is not known beyond the rows that show it. Blocks
        without which nothing was found do not count: they say that the other rows are few, and nothing of the effects.
        """
        if (tried := kept & self.with_effects).any():
            kept = tried
        if self.ratio_of_folds(kept, folds) < options.heldout_left:
            return False
        state = selection.state
        after = _times_fitted(self.after, selection.problem, state.fit, kept)
        before = _times_fitted(self.before, selection.reference, state.baseline, kept)
        return after > max(options.heldout_excess, before)


def held_out_errors(
    recording: Recording,
    arm: Arm | None,
    geometry: Geometry,
    options: Options,
    decisions: Decisions,
    folds: Sequence[Mask],
    effects: Sequence[Effect] = (),
    factory: FactoryCalibration | None = None,
) -> HeldOut:
    """The errors on every row, predicted from the other contiguous blocks; arguments as of `diagnose`.

    Args:
        recording: whose rows are in order, each once and in one unit; all faults are screened for in each fold.
        decisions: between faults and physics, of all rows.
        folds: those of `held_out_folds`.
    """
    given = (recording, arm, geometry, options, decisions, tuple(effects), factory)
    elsewhere = RemoteWork(held_out_table, given, _of_table)
    return _in_order(side_by_side(lambda held: _predicted(held, *given), folds, elsewhere), folds)


def held_out_ahead(
    recording: Recording,
    arm: Arm | None,
    geometry: Geometry,
    options: Options,
    folds: Sequence[Mask],
    effects: Sequence[Effect] = (),
    factory: FactoryCalibration | None = None,
) -> None:
    """Has other processes, where there are any, begin with the last folds before the decisions are known.

    Nearly all recordings are explained without a fault that resembles physics, which is supposed here. Arguments as of
    `held_out_errors`, which takes the results if the decisions are those.
    """
    if (others := at_hand()) is not None:
        given = (recording, arm, geometry, options, Decisions(Corrections(known_jumps=())), tuple(effects), factory)
        others.ahead(RemoteWork(held_out_table, given, _of_table), folds)


def held_out_table(held: Sequence[Mask], *given: Any) -> pa.Table:
    """The errors on one fold as a table, for another process."""
    (one,) = held
    return pa.table(_predicted(one, *given)._asdict())


def _of_table(table: pa.Table) -> HeldOut:
    """The inverse of `held_out_table`."""
    return HeldOut(*(table[name].to_numpy() for name in HeldOut._fields))


def _predicted(
    held: Mask,
    recording: Recording,
    arm: Arm | None,
    geometry: Geometry,
    options: Options,
    decisions: Decisions,
    effects: Sequence[Effect],
    factory: FactoryCalibration | None,
) -> HeldOut:
    """The errors on the rows of a fold, from the others."""
    found = explain(recording, arm, geometry, options, effects, factory, ~held, False, decisions)
    return _errors(found.selection, held)


def refitted_errors(selection: Selection, folds: Sequence[Mask], options: Options) -> HeldOut:
    """The errors on every row, predicted by the terms of all rows, whose numbers are fitted to the other blocks.

    Screening and clock are those of all rows; the point of linearisation and the frames are those of the other blocks.

    Args:
        selection: of all rows.
        folds: those of `spread_folds`.
        options: thresholds.
    """
    state, engine = selection.state, options.engine

    def predicted(held: Mask) -> HeldOut:
        training = state.baseline.training & ~held
        reference = problem = relinearise(selection.reference, engine, training)
        if selection.problem.preset[0].terms:
            problem = relinearise(selection.problem, engine, training)
        again = Selection(problem, reference, fitted_again(problem, reference, state, training, engine))
        return _errors(at_estimate(again, engine), held)

    return _in_order(side_by_side(predicted, folds), folds)


def _errors(selection: Selection, held: Mask) -> HeldOut:
    """Of the held-out rows: the problems of a fold, whose columns take a gigabyte of a real arm, end with it."""
    problem, reference, state = selection.problem, selection.reference, selection.state
    assert isinstance(reference, PoseProblem)
    assert isinstance(problem, PoseProblem)
    turned_before, angle_before = _turns(reference, state.baseline)
    turned_after, angle_after = _turns(problem, state.fit)
    before, after = _distance(reference, state.baseline), _distance(problem, state.fit)
    with_effects = np.full(held.size, bool(state.tested))
    errors = HeldOut(before, after, turned_before, turned_after, angle_before, angle_after, with_effects)
    return HeldOut._make(of_all[held] for of_all in errors)


def _in_order(parts: Sequence[HeldOut], folds: Sequence[Mask]) -> HeldOut:
    """Of all rows, from those of each fold."""
    order = np.argsort(np.concatenate([np.flatnonzero(held) for held in folds]))
    return HeldOut._make(np.concatenate(of_folds)[order] for of_folds in zip(*parts, strict=True))


def _distance(problem: PoseProblem, fit: Fit) -> Array:
    """`(sample,)` m between predicted and measured positions."""
    return np.linalg.norm(problem.position_errors(fit.nuisance, fit.terms, fit.values), axis=0)


def _times_fitted(errors: Array, problem: Problem, fit: Fit, kept: Mask) -> float:
    """Root mean square of position errors over that of the fitted rows, corrected for the degrees of freedom."""
    assert isinstance(problem, PoseProblem)
    share = fit.freedom / (problem.rows * fit.training.sum())
    fitted = np.sum(_distance(problem, fit)[kept] ** 2) / share
    return float(np.sqrt(np.sum(errors[kept] ** 2) / max(fitted, 1e-300)))


def _turns(problem: PoseProblem, fit: Fit) -> tuple[Array, Array]:
    """`(sample,)` between predicted and measured orientations, over their noise and in rad; zero where none were
    measured.
    """
    rows = problem.residual(fit.nuisance, fit.terms, fit.values)
    angles = unwhitened(rows, problem.measured.whitener)
    return np.linalg.norm(rows[3:], axis=0), np.linalg.norm(angles[3:], axis=0)


def _ratio(before: Array, after: Array) -> float:
    """Of the root mean squares; 1 where there was no error."""
    return float(np.linalg.norm(after) / np.linalg.norm(before)) if before.any() else 1.0
