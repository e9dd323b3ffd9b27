"""Errors on rows that were not used, and which findings hold there.

Of poses, screening, clock and linearisation are repeated without each block. Of the terms that a search of all rows
found, those are kept that the other rows support, with amplitudes, kernels and noise chosen anew. Which faults are
corrected rather than explained by physics, and at which rows frames jumped, is decided once, in all rows: a block that
holds the jump cannot be predicted without its row. The size of a jump is estimated anew.

Where these errors reject what was found, its terms are fitted again without shorter blocks that are spread over the
recording: a contiguous fifth may hold the only rows that show how a drift begins.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Protocol, cast

import numpy as np

from lite6jax.array_types import Array, Mask
from lite6jax.diagnosis.block_intervals import BLOCK_TIMES, block_stds
from lite6jax.diagnosis.explanation import Case, Decisions, explain
from lite6jax.diagnosis.fold_processes import work_on_folds
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import Finding, HeldOut, SearchedAgain, Withdrawn
from lite6jax.domains.base import DomainProblem
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.effects.effect import Effect
from lite6jax.effects.kernels import memory_of
from lite6jax.errors import InputError
from lite6jax.estimation.least_squares import Fit, relinearise
from lite6jax.estimation.noise import NoiseModel
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.recordings.sequence import contiguous_blocks
from lite6jax.search.scan import is_wander
from lite6jax.search.search import Selection, at_estimate
from lite6jax.search.state import State, fitted_again

_LARGEST_RISE = 1.01
"""Ratio of held-out position errors with and without effects, above which these are not kept.

It is what effects that only turn the tool cost in precision. Effects of many numbers may cost more.
"""
_LARGEST_EXCESS = 3.0
"""Ratio of held-out position errors to those of the fitted rows, above which effects are not kept.

It is 1 to 2 where a model is right, and more where functions follow the rows that they were fitted to.
"""
_CLEARLY_SMALLER = 1 / 3
"""Ratio of held-out position errors with and without effects below which effects are kept, if errors are not raised.

It is of the geometric mean over blocks. What predicts most of rows that were not used is there, as drift that a
block at an end continues.
"""
_SPREAD_BLOCKS = 5
"""Blocks over the recording that are held out together where the effects found are fitted again.

None is then all that shows how a drift begins.
"""

# ------------------------------------------------------------------ blocks of rows


def held_out_folds(problem: PoseProblem, options: Options) -> list[Mask]:
    """The blocks `(sample,)` that are held out, one after the other.

    Raises:
        InputError: no row can be held back, because the others would be too few for the unknowns.
    """
    recording = problem.recording
    unknowns = problem.undeclared + 1
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


def spread_folds(folds: Sequence[Mask], noise: NoiseModel, memory: float = np.inf) -> list[Mask]:
    """As many sets of rows `(sample,)` as these contiguous ones, each of up to `_SPREAD_BLOCKS` blocks over all rows.

    A block is several autocorrelation times of the noise long, so that the rows beside it do not know its noise; and,
    where that allows, half the memory of what wanders by itself, so that these rows know something of it.
    """
    count = len(folds)
    samples = folds[0].size
    long = max(BLOCK_TIMES * model.time if model.share else 1.0 for model in noise.models)
    most = max(_SPREAD_BLOCKS, int(2 * samples / memory / count))
    blocks = contiguous_blocks(samples, count * int(np.clip(samples / long / count, 1, most)))
    return [np.any(blocks[number::count], 0) for number in range(count)]


# ------------------------------------------------------------------ errors on them


def errors_of_folds(
    errors: Callable[..., HeldOut], given: tuple[Any, ...], folds: Sequence[Mask], anywhere: bool = True
) -> HeldOut:
    """The errors on all rows, of which folds have each once; arguments as of `work_on_folds`."""
    parts = work_on_folds(errors, given, folds, anywhere)
    order = np.argsort(np.concatenate([np.flatnonzero(fold) for fold in folds]))
    return HeldOut._make(np.concatenate(field_parts, -1)[..., order] for field_parts in zip(*parts, strict=True))


def errors_of_selection(selection: Selection, held: Mask) -> HeldOut:
    """The errors on the rows `(sample,)` of a fold, by a model of the others.

    Only these are kept: the problems of a fold, whose columns take a gigabyte of a real arm, end with it.
    """
    state = selection.state
    pairs = zip(_errors(selection.reference, state.baseline), _errors(selection.problem, state.fit), strict=True)
    errors = HeldOut(*(size for pair in pairs for size in pair), with_effects=np.full(held.size, bool(state.tested)))
    return HeldOut._make(of_all[..., held] for of_all in errors)


def errors_of_refit(held: Mask, selection: Selection, options: EngineOptions) -> HeldOut:
    """The errors on the rows `(sample,)` of a fold, by the terms of a selection fitted to the others."""
    problem = selection.problem
    training = problem.valid & ~held
    again = fitted_again(problem, problem, selection.state, training, options)
    return errors_of_selection(Selection(problem, problem, again), held)


def _errors(problem: Problem, fit: Fit) -> tuple[Array, Array]:
    """As `DomainProblem.errors`, of a fit."""
    return cast(DomainProblem, problem).errors(fit.nuisance, fit.terms, fit.values)


# ------------------------------------------------------------------ which findings hold


class Judgement(NamedTuple):
    """A judgement whether errors on held-out rows reject effects, and the ratio of those with and without effects."""

    rejects: bool
    ratio: float


class Judge(Protocol):
    """How a domain judges effects."""

    def __call__(self, errors: HeldOut, selection: Selection, kept: Mask, folds: Sequence[Mask]) -> Judgement:
        """Judges whether errors of folds reject the effects of a selection; `kept` `(sample,)`: the rows that count."""
        ...


class Verification(NamedTuple):
    """What holds on rows that were not used: fields of a diagnosis."""

    selection: Selection
    errors: HeldOut
    folds: Sequence[Mask]
    findings: tuple[Finding, ...]
    withdrawn: Withdrawn | None = None
    searched_again: SearchedAgain | None = None


def verify(
    selection: Selection,
    errors: HeldOut,
    folds: Sequence[Mask],
    kept: Mask,
    refitted: Callable[[Sequence[Mask]], HeldOut],
    judge: Judge,
) -> Verification:
    """The findings of a selection of all rows, unless errors on contiguous and on spread rows reject them.

    Args:
        selection: of all rows.
        errors: on contiguous `folds`, by the terms that the other rows support.
        folds: these.
        kept: `(sample,)`, the rows that count.
        refitted: the errors on other folds, by the terms of the selection fitted to the other rows.
        judge: of the domain.
    """
    state = selection.state
    findings = []
    by_blocks = block_stds(selection)
    for tested, numbers, block_std in zip(state.tested, state.fit.terms.slices, by_blocks, strict=True):
        assert isinstance(tested.term, Effect)
        alternatives = tuple(alternative for alternative in tested.alternatives if isinstance(alternative.term, Effect))
        values = state.fit.values[numbers]
        covariance = state.fit.covariance[numbers, numbers]
        gain = tested.gain
        std = tested.chosen_std
        share = tested.input_share
        findings.append(
            Finding(tested.term, values, covariance, tested.p_value, gain, alternatives, std, share, block_std)
        )
    selected_findings = tuple(findings)
    searched = judge(errors, selection, kept, folds) if selected_findings else Judgement(False, 1.0)
    if not searched.rejects:
        return Verification(selection, errors, folds, selected_findings)
    memories = [memory_of(tested.term.rolloff) for tested in state.tested if is_wander(tested.term)]
    spread = spread_folds(folds, state.fit.noise, min(memories, default=np.inf) * folds[0].size)
    again = refitted(spread)
    if judge(again, selection, kept, spread).rejects:
        # the nuisance alone, as it was fitted without the effects
        bare = replace(selection, problem=selection.reference, state=State(state.baseline, state.baseline))
        return Verification(bare, errors.without_effects(), folds, (), Withdrawn(selected_findings, errors, kept))
    return Verification(selection, again, spread, selected_findings, None, SearchedAgain(len(folds), searched.ratio))


def judge_by_folds(errors: HeldOut, selection: Selection, kept: Mask, folds: Sequence[Mask]) -> Judgement:
    """By the geometric mean over folds of the errors with effects over those without.

    The variance of errors is unknown and differs between folds, so each ratio is one of likelihoods, and no fold
    decides alone.
    """
    pairs = [(errors.before_over_noise[:, rows], errors.after_over_noise[:, rows]) for rows in _rows_of(folds, kept)]
    logs = [[np.log(max(float(np.linalg.norm(fold_errors)), 1e-150)) for fold_errors in pair] for pair in pairs]
    ratio = float(np.exp(np.mean([after - before for before, after in logs])))
    return Judgement(ratio > _LARGEST_RISE, ratio)


def judge_poses(errors: HeldOut, selection: Selection, kept: Mask, folds: Sequence[Mask]) -> Judgement:
    """By whether effects raise the errors of rows that were not used, or describe none but those that were."""
    numbers = max(selection.state.fit.parameters - selection.state.baseline.parameters, 0.0)
    rejects = raises(errors, kept, numbers) or is_overfitted(errors, selection, kept, folds)
    return Judgement(rejects, _ratio(errors.before[0, kept], errors.after[0, kept]))


def _rows_of(folds: Sequence[Mask], counted: Mask) -> list[Mask]:
    """`(sample,)` each, the rows of folds that count; without folds that have none."""
    return [rows for fold in folds if (rows := fold & counted).any()]


def raises(errors: HeldOut, kept: Mask, numbers: float) -> bool:
    """Tells whether effects of so many numbers raise the errors on rows that were not used.

    The product of the ratios of position and orientation must not rise, as in the likelihood of Gaussian errors of
    unknown variance. Effects that show in the orientation alone may raise the error of positions by what they cost in
    precision: p numbers add p / (3 · rows) to the variance of a prediction, half of that to its standard deviation.
    """
    pairs = zip(errors.before_over_noise[:, kept], errors.after_over_noise[:, kept], strict=True)
    position, turned = (_ratio(before, after) for before, after in pairs)
    cost = 1 + 0.5 * numbers / (3 * kept.sum())
    return position * turned > 1 or position > max(_LARGEST_RISE, cost)


def is_overfitted(errors: HeldOut, selection: Selection, kept: Mask, folds: Sequence[Mask]) -> bool:
    """Tells whether a model with effects describes the rows that it was fitted to, and no others.

    Rows that were not used are then off by `_LARGEST_EXCESS` times the errors of the fitted ones, and by a larger ratio
    than without the effects. Effects that remove most of the error there (in the geometric mean over folds) are kept
    all the same: a drift is not known beyond the rows that show it. Blocks without which nothing was found do not
    count: they say that the other rows are few.
    """
    before, _ = errors.before_over_noise
    after, _ = errors.after_over_noise
    if (searched_rows := kept & errors.with_effects).any():
        kept = searched_rows
    if fold_rows := _rows_of(folds, kept):
        logs = [np.log(max(_ratio(before[rows], after[rows]), 1e-300)) for rows in fold_rows]
        if np.exp(np.average(logs, weights=[rows.sum() for rows in fold_rows])) < _CLEARLY_SMALLER:
            return False

    def times_fitted(of_all: Array, problem: Problem, fit: Fit) -> float:
        """Root mean square over that of the fitted rows, corrected for the degrees of freedom.

        Fitted rows know what wandered while they were recorded, and others cannot: that is in the errors of both.
        """
        share = fit.freedom / (problem.rows * fit.training.sum())
        fitted = np.sum(_errors(problem, _without_wandering(fit))[1][0, kept] ** 2) / share
        return float(np.sqrt(np.sum(of_all[kept] ** 2) / max(fitted, 1e-300)))

    state = selection.state
    bare = times_fitted(before, selection.reference, state.baseline)
    return times_fitted(after, selection.problem, state.fit) > max(_LARGEST_EXCESS, bare)


def _without_wandering(fit: Fit) -> Fit:
    """The same numbers, but zero of what wanders by itself."""
    values = fit.values.copy()
    for term, part in fit.terms.pairs:
        if is_wander(term):
            values[part] = 0.0
    return replace(fit, values=values)


def _ratio(before: Array, after: Array) -> float:
    """Ratio of the root mean squares; 1 where there was no error."""
    return float(np.linalg.norm(after) / np.linalg.norm(before)) if before.any() else 1.0


# ------------------------------------------------------------------ errors of poses


def errors_of_supported(held: Mask, case: Case, decisions: Decisions) -> HeldOut:
    """The errors on the rows `(sample,)` of a fold, by what the others support of the decisions of all rows."""
    explanation = explain(replace(case, training=~held), decisions)
    return errors_of_selection(explanation.selection, held)


def refitted_errors(selection: Selection, folds: Sequence[Mask], options: Options) -> HeldOut:
    """The errors on every row, predicted by the terms of all rows, whose numbers are fitted to the other blocks.

    Screening and clock are those of all rows; the point of linearisation and the frames are those of the other blocks.
    """
    state = selection.state
    engine = options.engine

    def predicted(fold: Mask) -> HeldOut:
        training = state.baseline.training & ~fold
        reference = problem = relinearise(selection.reference, engine, training)
        if selection.problem.preset[0].terms:
            problem = relinearise(selection.problem, engine, training)
        again = Selection(problem, reference, fitted_again(problem, reference, state, training, engine))
        return errors_of_selection(at_estimate(again, engine), fold)

    return errors_of_folds(predicted, (), folds, anywhere=False)
