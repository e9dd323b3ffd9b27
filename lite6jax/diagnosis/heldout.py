"""Errors on rows that were not used, and which findings hold there.

Of poses, screening, clock, linearisation and search are repeated without each block. Only which faults are corrected
rather than explained by physics, and at which rows frames jumped, is decided once, in all rows: a search beside every
uncorrected fault would take each fold as long as the diagnosis itself, and a block that holds the jump cannot be
predicted without its row. The size of a jump is estimated anew.

Where these errors reject what was found, its terms are fitted again without shorter blocks that are spread over the
recording. A contiguous fifth may hold the only rows that show how a drift begins, and without it the search may select
another model of the same effect; neither says that the effect is not there.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from lite6jax.diagnosis.explanation import Case, Decisions, explain
from lite6jax.diagnosis.fold_processes import work_on_folds
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import Finding, SearchedAgain, Withdrawn
from lite6jax.domains.pose.kinematics import unwhitened
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError
from lite6jax.estimation.least_squares import Fit, relinearise
from lite6jax.estimation.noise import NoiseModel
from lite6jax.estimation.problem import Mask, Problem
from lite6jax.recordings.sequence import contiguous_blocks
from lite6jax.search.search import Selection, at_estimate
from lite6jax.search.state import State, fitted_again

Array = NDArray[np.floating]

# ------------------------------------------------------------------ blocks of rows


def held_out_folds(problem: PoseProblem, options: Options) -> list[Mask]:
    """The blocks `(sample,)` that are held out, one after the other.

    Raises:
        InputError: no row can be held back, because the others would be too few for the unknowns.
    """
    recording, unknowns = problem.recording, problem.undeclared + 1
    needed = -(-unknowns // recording.numbers_per_sample)
    if recording.samples <= needed:
        raise InputError(
            f"{recording.source}: {recording.samples} samples are what {unknowns} numbers to determine need, so that "
            f"none can be held back; record at least {needed + 1}"
        )
    return recording.contiguous_folds(fold_count(problem.samples, options, needed))


def fold_count(samples: int, options: Options, needed: int = 0) -> int:
    """How many blocks of so many rows are held out: more than usual where the other rows would be fewer than `needed`,
    and at most one for each row.
    """
    count = min(options.folds, samples)
    while count < samples and samples - -(-samples // count) < needed:
        count += 1
    return count


def spread_folds(folds: Sequence[Mask], noise: NoiseModel, options: Options) -> list[Mask]:
    """As many sets of rows `(sample,)` as these contiguous ones, each of up to `spread_blocks` blocks over all rows.

    A block is several autocorrelation times of the noise long, so that the rows beside it do not know its noise.
    """
    count, samples = len(folds), folds[0].size
    long = max(options.block_times * model.time if model.share else 1.0 for model in noise.models)
    blocks = contiguous_blocks(samples, count * int(np.clip(samples / long / count, 1, options.spread_blocks)))
    return [np.any(blocks[number::count], 0) for number in range(count)]


# ------------------------------------------------------------------ which findings hold


class HeldOutErrors(Protocol):
    """Errors on held-out rows, of poses or of torques: a tuple of arrays with the sample last."""

    @property
    def before(self) -> Array: ...
    @property
    def after(self) -> Array: ...
    def ratio(self, selection: Selection, kept: Mask, folds: Sequence[Mask]) -> float: ...
    def rejects(self, selection: Selection, kept: Mask, folds: Sequence[Mask], options: Options) -> bool: ...
    def without_effects(self) -> Any: ...


E = TypeVar("E", bound=HeldOutErrors)


def errors_of_folds(
    errors: Callable[..., E], given: tuple[Any, ...], folds: Sequence[Mask], anywhere: bool = True
) -> E:
    """The errors on all rows.

    Args:
        errors: on the rows of a fold; a function of a module where other processes may call it.
        given: to it besides the fold.
        folds: which have each row once.
        anywhere: whether other processes may take a part.
    """
    parts: list[Any] = work_on_folds(errors, given, folds, anywhere)
    order = np.argsort(np.concatenate([np.flatnonzero(held) for held in folds]))
    return parts[0]._make(np.concatenate(each, -1)[..., order] for each in zip(*parts, strict=True))


class Verification(NamedTuple):
    """What holds on rows that were not used; attributes as of a diagnosis, with `errors` on `folds`."""

    selection: Selection
    errors: Any
    folds: Sequence[Mask]
    findings: tuple[Finding, ...]
    withdrawn: Withdrawn | None = None
    searched_again: SearchedAgain | None = None


def verify(
    selection: Selection,
    errors: E,
    folds: Sequence[Mask],
    kept: Mask,
    options: Options,
    refitted: Callable[[Sequence[Mask]], E],
) -> Verification:
    """The findings of a selection, unless both a search and a fit without some rows reject them.

    Args:
        selection: of all rows.
        errors: on contiguous blocks, each searched without.
        folds: these.
        kept: `(sample,)`, the rows that count.
        options: thresholds.
        refitted: the errors on other folds, by the terms of the selection fitted to the other rows.
    """
    state, findings = selection.state, []
    for tested, numbers in zip(state.tested, state.fit.terms.slices, strict=True):
        assert isinstance(tested.term, Effect)
        others = tuple(one for one in tested.alternatives if isinstance(one.term, Effect))
        values, covariance = state.fit.values[numbers], state.fit.covariance[numbers, numbers]
        gain, std, share = tested.gain, tested.chosen_std, tested.input_share
        findings.append(Finding(tested.term, values, covariance, tested.p_value, gain, others, std, share))
    found = tuple(findings)
    if not found or not errors.rejects(selection, kept, folds, options):
        return Verification(selection, errors, folds, found)
    spread = spread_folds(folds, state.fit.noise, options)
    again = refitted(spread)
    if again.rejects(selection, kept, spread, options):
        sizes = (float(np.sqrt(np.mean(each[..., kept] ** 2))) for each in (errors.before, errors.after))
        # the nuisance alone, as it was fitted without the effects
        bare = replace(selection, problem=selection.reference, state=State(state.baseline, state.baseline))
        return Verification(bare, errors.without_effects(), folds, (), Withdrawn(found, *sizes))
    searched_again = SearchedAgain(len(folds), errors.ratio(selection, kept, folds))
    return Verification(selection, again, spread, found, searched_again=searched_again)


# ------------------------------------------------------------------ errors of poses


class HeldOut(NamedTuple):
    """Errors of poses on held-out rows, `(sample,)` each.

    Attributes:
        before: m, of positions, with the nuisance alone.
        after: m, of positions, with the effects that a search of the other rows selects, or that are fitted to them.
        placed_before: of positions, over their noise, with the nuisance alone. A camera sees depth worse than the rest.
        placed_after: likewise with the effects.
        turned_before: of orientations, over their noise, with the nuisance alone; zero where none were measured.
        turned_after: likewise with the effects.
        angle_before: rad, of orientations, with the nuisance alone; zero where none were measured.
        angle_after: likewise with the effects.
        with_effects: bool, of rows without which there are effects.
    """

    before: Array
    after: Array
    placed_before: Array
    placed_after: Array
    turned_before: Array
    turned_after: Array
    angle_before: Array
    angle_after: Array
    with_effects: Mask

    def without_effects(self) -> "HeldOut":
        """The errors of the nuisance alone, before and after."""
        return self._replace(
            after=self.before,
            placed_after=self.placed_before,
            turned_after=self.turned_before,
            angle_after=self.angle_before,
        )

    def rejects(self, selection: Selection, kept: Mask, folds: Sequence[Mask], options: Options) -> bool:
        """Whether the effects of a selection do not hold on rows that were not used, of those `kept`."""
        state = selection.state
        numbers = max(state.fit.parameters - state.baseline.parameters, 0.0)
        return self.raised(kept, numbers, options) or self.overfitted(kept, selection, folds, options)

    def ratio(self, selection: Selection, kept: Mask, folds: Sequence[Mask]) -> float:
        """Of the root mean squares of position errors with effects and without, of the rows `kept`."""
        return _ratio(self.before[kept], self.after[kept])

    def raised(self, kept: Mask, numbers: float, options: Options) -> bool:
        """Whether effects of so many numbers raise the errors on rows that were not used.

        Position and orientation have scales of their own: it is the product of their ratios, as in the likelihood of
        Gaussian errors of unknown variance, that must not rise. Effects that show in the orientation alone may raise
        the error of positions by what they cost in precision. As if positions alone determined them, p numbers, in
        effect, add p / (3 · rows) to the variance of a prediction, and half of that to its standard deviation.
        """
        position = _ratio(self.placed_before[kept], self.placed_after[kept])
        turned = _ratio(self.turned_before[kept], self.turned_after[kept])
        cost = 1 + 0.5 * numbers / (3 * kept.sum())
        return position * turned > 1 or position > max(options.heldout_rise, cost)

    def overfitted(self, kept: Mask, selection: Selection, folds: Sequence[Mask], options: Options) -> bool:
        """Whether a model with effects describes the rows that it was fitted to, and no others.

        Rows that were not used are then off by `heldout_excess` times the errors of the fitted ones, and by a larger
        ratio than without the effects, where the arm's geometry alone may not follow from fewer rows. Effects that
        remove most of the error there are kept all the same: a drift is not known beyond the rows that show it. Blocks
        without which nothing was found do not count: they say that the other rows are few, and nothing of the effects.
        Errors differ in size from fold to fold, so it is the geometric mean of the ratios over folds that counts.
        """
        if (tried := kept & self.with_effects).any():
            kept = tried
        held = [rows for fold in folds if (rows := fold & kept).any()]
        if held:
            logs = [np.log(max(_ratio(self.placed_before[rows], self.placed_after[rows]), 1e-300)) for rows in held]
            if np.exp(np.average(logs, weights=[rows.sum() for rows in held])) < options.heldout_left:
                return False

        def times_fitted(errors: Array, problem: Problem, fit: Fit) -> float:
            """Root mean square over that of the fitted rows, corrected for the degrees of freedom."""
            assert isinstance(problem, PoseProblem)
            share = fit.freedom / (problem.rows * fit.training.sum())
            fitted = np.sum(_sizes(problem, fit)[1][kept] ** 2) / share
            return float(np.sqrt(np.sum(errors[kept] ** 2) / max(fitted, 1e-300)))

        state = selection.state
        before = times_fitted(self.placed_before, selection.reference, state.baseline)
        return times_fitted(self.placed_after, selection.problem, state.fit) > max(options.heldout_excess, before)


def held_out_errors(case: Case, decisions: Decisions, folds: Sequence[Mask]) -> HeldOut:
    """The errors on every row, predicted from the other contiguous blocks.

    Args:
        case: whose rows are in order, each once and in one unit; all faults are screened for in each fold.
        decisions: between faults and physics, of all rows.
        folds: those of `held_out_folds`.
    """
    return errors_of_folds(errors_of_search, (case, decisions), folds)


def errors_of_search(held: Mask, case: Case, decisions: Decisions) -> HeldOut:
    """The errors on the rows of a fold, from a search of the others."""
    return _errors(explain(replace(case, training=~held, thorough=False), decisions).selection, held)


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

    return errors_of_folds(predicted, (), folds, anywhere=False)


def _errors(selection: Selection, held: Mask) -> HeldOut:
    """Of the held-out rows: the problems of a fold, whose columns take a gigabyte of a real arm, end with it."""
    problem, reference, state = selection.problem, selection.reference, selection.state
    assert isinstance(reference, PoseProblem)
    assert isinstance(problem, PoseProblem)
    parts = zip(_sizes(reference, state.baseline), _sizes(problem, state.fit), strict=True)
    errors = HeldOut(*(size for pair in parts for size in pair), with_effects=np.full(held.size, bool(state.tested)))
    return HeldOut._make(of_all[held] for of_all in errors)


def _sizes(problem: PoseProblem, fit: Fit) -> tuple[Array, ...]:
    """`(sample,)` each, of the errors of a fit, in the order of `HeldOut`: positions in m and over their noise,
    orientations over their noise and in rad; zero of what was not measured.
    """
    rows = problem.residual(fit.nuisance, fit.terms, fit.values)
    errors = unwhitened(rows, problem.measured.whitener)
    return tuple(np.linalg.norm(part, axis=0) for part in (errors[:3], rows[:3], rows[3:], errors[3:]))


def _ratio(before: Array, after: Array) -> float:
    """Of the root mean squares; 1 where there was no error."""
    return float(np.linalg.norm(after) / np.linalg.norm(before)) if before.any() else 1.0
