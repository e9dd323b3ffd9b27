"""The pipeline of a diagnosis of torques: screen, filter, search, estimate finally, cross-validate."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lite6jax.arms.arm import Arm
from lite6jax.diagnosis.diagnose import findings_of, without_effects
from lite6jax.diagnosis.fold_processes import RemoteWork
from lite6jax.diagnosis.folds import fold_count, side_by_side, spread_folds
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import SearchedAgain
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.domains.torque.linearisation import linearised, with_likely_prior
from lite6jax.domains.torque.problem import TorqueProblem, torque_problem
from lite6jax.domains.torque.screening import contacts, screen_torques
from lite6jax.effects.dynamic.torque_effect import TorqueEffect
from lite6jax.effects.user_effects import require_effects
from lite6jax.errors import require_type
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.problem import Mask, Problem
from lite6jax.fitting.source import declared_arm_of, load_nominal, load_recording, with_calibration
from lite6jax.progress import Stage, entered, followed, part
from lite6jax.recordings import Recording
from lite6jax.recordings.sequence import contiguous_blocks
from lite6jax.search.final_estimates import final_estimates
from lite6jax.search.search import Selection, search
from lite6jax.search.state import fitted_again

Array = NDArray[np.floating]

_FOLDS = 10
"""Of static postures at least."""


@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose_torques(
    recording: Recording | str | Path,
    arm: Arm | str | Path | None = None,
    *,
    effects: Sequence[TorqueEffect] = (),
    options: Options | None = None,
    progress: Callable[[Stage], object] | None = None,
) -> TorqueDiagnosis:
    """Locates, names, models and verifies what makes motor torques depart from the inverse dynamics of the arm.

    Args:
        recording: a trajectory with times and torques, or currents with their torque constants, in SI units; or the
            path of its file. Of static postures gravity alone is compared: offsets, scales, masses, centres of mass,
            payload, tilt.
        arm: the declared arm, a bundled name or a file; from the sidecar where not given. Its chain is that of the
            factory calibration, where the sidecar declares one.
        effects: a user's own candidates, tested like the catalogue's.
        options: thresholds; the documented ones where not given.
        progress: called as each stage begins.

    Effects that raise the error on rows that were not used are not kept, unless they hold in shorter blocks without
    which they are fitted again: they are in `withdrawn` of the result.

    Raises:
        InputError: no arm is declared; no torques, no times, gaps in most of them, an arm at rest, or another unit.
    """
    require_effects(effects)
    require_type("options", options, Options | None, "lite6jax.Options(…)")
    options = options or Options()
    arm = load_nominal(arm)
    recording = load_recording(recording, arm)
    with followed(progress):
        arm = with_calibration(arm or declared_arm_of(recording), recording)
        with part(0, 1 + options.folds):
            entered("screening")
            screened = screen_torques(recording, arm)
            whole = with_likely_prior(torque_problem(screened.data, effects), options.engine)
            problem = linearised(whole, options.engine)
            pushed, events = contacts(problem, options.engine)
            problem = replace(problem, valid=~pushed)
            problem = linearised(problem, options.engine, ~pushed) if pushed.any() else problem
            selection = search(problem, options.engine)
            problem = selection.problem
            assert isinstance(problem, TorqueProblem)
            entered("estimating")
            selection = replace(selection, state=final_estimates(problem, selection.state, options.engine))
        # postures are few and independent: a model of half of them says little of the rest
        few = recording.motion == "static"
        count = fold_count(problem.samples, replace(options, folds=max(options.folds, _FOLDS)) if few else options)
        folds = contiguous_blocks(problem.samples, count)
        whole = replace(whole, valid=problem.valid)
        before, after = _searched_without(whole, folds, options, selection.saturated)
        findings = findings_of(selection)
        withdrawn, searched_again = (), None
        if findings and (ratio := _ratio(before, after, problem, folds)) > options.heldout_rise:
            state, spread = selection.state, spread_folds(folds, selection.state.fit.noise, options)

            def refitted(there: TorqueProblem, training: Mask) -> Selection:
                return Selection(there, there, fitted_again(there, there, state, training, options.engine))

            of_folds = side_by_side(partial(_errors_without, whole, options, refitted), spread)
            errors = _in_order(of_folds, spread, whole)
            if _ratio(*errors, problem, spread) > options.heldout_rise:
                withdrawn, selection, findings = findings, without_effects(selection), ()
            else:
                (before, after), searched_again, folds = errors, SearchedAgain(len(folds), ratio), spread
    return TorqueDiagnosis(
        problem=problem,
        selection=selection,
        findings=findings,
        before=before,
        after=after if findings else before,
        faults=(*screened.found, *events),
        ruled_out=screened.ruled_out,
        options=options,
        folds=tuple(folds),
        withdrawn=withdrawn,
        searched_again=searched_again,
    )


def _searched_without(
    problem: TorqueProblem, folds: Sequence[Mask], options: Options, saturated: bool
) -> tuple[Array, Array]:
    """Errors `(joint, sample)` Nm on every sample, from a search of the other blocks, without and with effects.

    Whether terms are selected forward or from the saturated model is decided once, in all samples.
    """
    given = (problem, options, saturated)
    elsewhere = RemoteWork(held_out_table, given, partial(_of_table, joints=problem.rows))
    return _in_order(side_by_side(lambda held: _errors_of_search(held, *given), folds, elsewhere), folds, problem)


def held_out_table(held: Sequence[Mask], *given: Any) -> pa.Table:
    """The errors on one fold as a table, for another process: of each joint without effects, and then with them."""
    (one,) = held
    return pa.table({str(k): row for k, row in enumerate(np.concatenate(_errors_of_search(one, *given)))})


def _of_table(table: pa.Table, joints: int) -> tuple[Array, Array]:
    """The inverse of `held_out_table`."""
    rows = np.array([table[str(k)].to_numpy() for k in range(2 * joints)])
    return rows[:joints], rows[joints:]


def _errors_of_search(held: Mask, problem: TorqueProblem, options: Options, saturated: bool) -> tuple[Array, Array]:
    """As `_errors_without`, with the model that a search of the other samples selects."""

    def searched(there: TorqueProblem, training: Mask) -> Selection:
        return search(there, options.engine, training, thorough=False, saturated=saturated)

    return _errors_without(problem, options, searched, held)


def _errors_without(
    problem: TorqueProblem, options: Options, model: Callable[[TorqueProblem, Mask], Selection], held: Mask
) -> tuple[Array, Array]:
    """Errors `(joint, held)` Nm on the samples of a fold, from the others, without and with effects.

    The filter spreads a sample over its neighbours: those beside a held-out block are not used either.

    Args:
        problem: not linearised.
        options: thresholds.
        model: of the problem linearised at the training samples, and of these.
        held: `(sample,)`, the fold.
    """
    near = np.convolve(held, np.ones(3), "same") > 0
    training = ~near & problem.valid
    there = linearised(problem, options.engine, training)
    found = model(there, training)
    state = found.state
    return _errors(found.reference, state.baseline)[:, held], _errors(found.problem, state.fit)[:, held]


def _in_order(
    of_folds: Sequence[tuple[Array, Array]], folds: Sequence[Mask], problem: TorqueProblem
) -> tuple[Array, Array]:
    """The errors `(joint, sample)` on all samples, of those of each fold."""
    before, after = np.zeros((2, problem.rows, problem.samples))
    for held, (without, with_effects) in zip(folds, of_folds, strict=True):
        before[:, held], after[:, held] = without, with_effects
    return before, after


def _ratio(before: Array, after: Array, problem: TorqueProblem, folds: Sequence[Mask]) -> float:
    """Held-out errors with effects over those without: the mean of the logarithms over folds.

    Of errors whose variance is unknown and differs from fold to fold that is the ratio of likelihoods: one in which a
    curve meets what it was never fitted to does not decide alone.
    """
    ratios = []
    for fold in folds:
        held = fold & problem.valid
        if held.any():
            size = problem.sigma[:, held]
            squares = [float(np.sum((errors[:, held] / size) ** 2)) for errors in (before, after)]
            ratios.append(0.5 * np.log(max(squares[1], 1e-300) / max(squares[0], 1e-300)))
    return float(np.exp(np.mean(ratios)))


def _errors(problem: Problem, fit: Fit) -> Array:
    assert isinstance(problem, TorqueProblem)
    return problem.residual(fit.nuisance, fit.terms, fit.values) * problem.sigma
