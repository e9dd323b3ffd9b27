"""The pipeline of a diagnosis: screen, explain, estimate finally, cross-validate, design what to record next."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.diagnosis.discrimination import separating_poses
from lite6jax.diagnosis.explanation import explain
from lite6jax.diagnosis.folds import fold_count, held_out_folds, likely_folds, spread_folds
from lite6jax.diagnosis.heldout import HeldOut, held_out_ahead, held_out_errors, refitted_errors
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import Diagnosis, Finding, Rival, SearchedAgain, Withdrawn
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.domains.pose.screening.screen import screen, screen_rows
from lite6jax.effects.effect import Effect
from lite6jax.effects.user_effects import require_effects
from lite6jax.errors import InputError, require_type
from lite6jax.fitting.problem import Geometry
from lite6jax.fitting.quality import ROUNDING
from lite6jax.fitting.source import load_nominal, load_recording, with_arm
from lite6jax.progress import Stage, entered, followed, part
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault, row_numbers
from lite6jax.search.final_estimates import final_estimates
from lite6jax.search.search import Selection
from lite6jax.search.state import State


# A second thread gains little on matrices of this size, and costs many times as much where another job has a core.
@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose(
    recording: Recording | str | Path,
    arm: Arm | str | Path | None = None,
    *,
    geometry: Geometry = "declared",
    effects: Sequence[Effect] = (),
    factory: FactoryCalibration | None = None,
    options: Options | None = None,
    progress: Callable[[Stage], object] | None = None,
) -> Diagnosis:
    """Locates, names, models and verifies what makes a recording depart from the arm's model: effects and data faults.

    Args:
        recording: measured poses in SI units, or the path of their file.
        arm: the nominal arm, a bundled name or a file; from the sidecar, or recognised, where not given.
        geometry: what is known of it, as in `fit`.
        effects: a user's own candidates, tested like the catalogue's.
        factory: the arm's calibration; from the sidecar where not given.
        options: thresholds; the documented ones where not given.
        progress: called as each stage begins: of all rows (part 0), and of those without each held-out block.

    Effects that raise the error on rows that were not used, or leave several times as much there as in those that they
    were fitted to, are not kept, unless they hold in shorter blocks without which they are fitted again: they are in
    `withdrawn` of the result.

    Raises:
        InputError: no measured poses, too few of them, or as `fit`.
    """
    arm = load_nominal(arm)
    recording = load_recording(recording, arm)
    require_effects(effects)
    require_type("options", options, Options | None, "lite6jax.Options(…)")
    if recording.position is None and recording.has_torques:
        raise InputError(f"{recording.source}: has torques and no poses; call lite6jax.diagnose_torques")
    options = options or Options()
    with followed(progress):
        recording = recording if arm is not None else with_arm(recording)
        rows = screen_rows(recording, options.screening)
        # what cannot be read at all ends here, before any process has begun
        screen(rows.recording, arm, geometry, options.screening, factory=factory, coarse=True)
        if (likely := likely_folds(rows.recording, options)) is not None:
            held_out_ahead(rows.recording, arm, geometry, options, likely, effects, factory)
        with part(0, 1 + fold_count(rows.recording.samples, options)):
            found = explain(rows.recording, arm, geometry, options, effects, factory)
            selection = found.selection
            entered("estimating")
            selection = replace(selection, state=final_estimates(found.problem, selection.state, options.engine))
        folds = held_out_folds(found.problem, options)
        decisions = found.final_decisions
        held_out = held_out_errors(rows.recording, arm, geometry, options, decisions, folds, effects, factory)
        findings, withdrawn, searched_again = findings_of(selection), None, None
        outliers = _outliers(selection, options)
        if findings and held_out.rejects(selection, ~outliers, folds, options):
            spread = spread_folds(folds, selection.state.fit.noise, options)
            refitted = refitted_errors(selection, spread, options)
            if refitted.rejects(selection, ~outliers, spread, options):
                withdrawn = Withdrawn(
                    findings, *(_rms(errors[~outliers]) for errors in (held_out.before, held_out.after))
                )
                selection, findings = without_effects(selection), ()
                outliers = _outliers(selection, options)
            else:
                searched_again = SearchedAgain(len(folds), held_out.ratio(~outliers))
                held_out, folds = refitted, spread
        with part(len(folds) + 1, len(folds) + 1):
            entered("planning")
            separating = separating_poses(selection, geometry, factory, options)
    problem = selection.problem
    assert isinstance(problem, PoseProblem)
    return Diagnosis(
        problem=problem,
        selection=selection,
        findings=findings,
        before=held_out.before,
        after=held_out.before if withdrawn else held_out.after,
        outliers=outliers,
        faults=(*rows.found, *found.screened.found, *_without_joints(problem)),
        ruled_out=_ruled_out(rows.found, (*rows.ruled_out, *found.screened.ruled_out)),
        separating=separating,
        options=options,
        folds=tuple(folds),
        withdrawn=withdrawn,
        searched_again=searched_again,
        turned=_turned(held_out, withdrawn is not None) if problem.rows == 6 else None,
    )


def _turned(held_out: HeldOut, withdrawn: bool) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """The held-out errors of orientations, before and after."""
    return held_out.angle_before, held_out.angle_before if withdrawn else held_out.angle_after


def _outliers(selection: Selection, options: Options) -> NDArray[np.bool_]:
    """`(sample,)`, rows that are far from the model, and rows without joints.

    A residual within the declared noise, or within the rounding of a file, is none, however small the others are.
    """
    problem, residuals = selection.problem, selection.state.fit.residuals
    assert isinstance(problem, PoseProblem)
    least = ROUNDING if (declared := problem.recording.settings.position_noise_m) is None else declared
    far = residuals.squares > options.outlier_squares * problem.rows
    return far & (np.sum(residuals.rows**2, 0) > (least / problem.noise[0]) ** 2) | ~problem.valid


def without_effects(selection: Selection) -> Selection:
    """The selection of nothing: the nuisance alone, as it was fitted without the effects."""
    baseline = selection.state.baseline
    return replace(selection, problem=selection.reference, state=State(baseline, baseline))


def _rms(errors: NDArray[np.floating]) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def findings_of(selection: Selection) -> tuple[Finding, ...]:
    state, findings = selection.state, []
    for tested, numbers in zip(state.tested, state.fit.terms.slices, strict=True):
        assert isinstance(tested.term, Effect)
        rivals = tuple(Rival(a.term, a.gap) for a in tested.alternatives if isinstance(a.term, Effect))
        values, covariance = state.fit.values[numbers], state.fit.covariance[numbers, numbers]
        gain, std, share = tested.score.gain, tested.chosen_std, tested.input_share
        findings.append(Finding(tested.term, values, covariance, tested.p_value, gain, rivals, std, share))
    return tuple(findings)


def _ruled_out(found: tuple[DataFault, ...], ruled_out: tuple[DataFault, ...]) -> tuple[DataFault, ...]:
    """Each once: the faults of rows are screened for again in the corrected recording, where there are none."""
    first: dict[str, DataFault] = {}
    for fault in ruled_out:
        first.setdefault(fault.code, fault)
    corrected = {fault.code for fault in found}
    return tuple(fault for code, fault in first.items() if code not in corrected)


def _without_joints(problem: PoseProblem) -> tuple[DataFault, ...]:
    """Rows whose joints were not recorded at the instant of the pose."""
    if problem.valid.all():
        return ()
    rows = row_numbers(problem.recording.row[~problem.valid])
    return (DataFault("no_joints", rows, {"clock_offset_s": problem.clock_offset}),)
