"""The diagnosis of poses: screen, explain, estimate finally, verify on held-out rows, design what to record next."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.calibration.problem import Geometry
from lite6jax.calibration.quality import ROUNDING
from lite6jax.calibration.source import load_nominal, load_recording, with_arm
from lite6jax.diagnosis.discrimination import separating_poses
from lite6jax.diagnosis.explanation import Case, explain
from lite6jax.diagnosis.heldout import fold_count, held_out_errors, held_out_folds, refitted_errors, verify
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import Diagnosis
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.domains.pose.reference import compare
from lite6jax.domains.pose.rigid_arm import require_determined
from lite6jax.domains.pose.screening.screen import screen, screen_rows
from lite6jax.effects.effect import Effect
from lite6jax.effects.user_effects import require_effects
from lite6jax.errors import InputError, require_type
from lite6jax.progress import Stage, entered, followed, part
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault, row_numbers
from lite6jax.search.final_estimates import final_estimates
from lite6jax.search.search import Selection


# A second thread gains little on matrices of this size, and costs many times as much where another job has a core.
@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose(
    recording: Recording | str | Path,
    arm: Arm | str | Path | None = None,
    *,
    reference: Recording | str | Path | None = None,
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
        reference: poses at the same joint positions, or the path of their file. What the recording has beyond them is
            then diagnosed; `against` of the result is the comparison.
        geometry: what is known of it, as in `fit`.
        effects: a user's own candidates, tested like the catalogue's.
        factory: the arm's calibration; from the sidecar where not given.
        options: thresholds; the documented ones where not given.
        progress: called as each stage begins: of all rows (part 0), and of those without each held-out block.

    Effects that raise the error on rows that were not used, or leave several times as much there as in those that they
    were fitted to, are not kept, unless they hold in shorter blocks without which they are fitted again: they are in
    `withdrawn` of the result.

    Raises:
        InputError: no measured poses, too few of them, or as `fit` and `compare`.
    """
    arm = load_nominal(arm)
    recording = load_recording(recording, arm)
    require_effects(effects)
    require_type("options", options, Options | None, "lite6jax.Options(…)")
    if recording.position is None and recording.has_torques:
        raise InputError(f"{recording.source}: has torques and no poses; call lite6jax.diagnose_torques")
    if reference is not None:
        seen = compare(recording, load_recording(reference, arm), arm, geometry)
        given: dict[str, Any] = {"geometry": seen.geometry, "factory": seen.factory, "effects": effects}
        found = diagnose(seen.recording, arm, **given, options=options, progress=progress)
        return replace(found, against=seen)
    options = options or Options()
    with followed(progress):
        recording = recording if arm is not None else with_arm(recording)
        rows = screen_rows(recording, options.screening)
        # what cannot be read at all ends here, before any process has begun
        begun = screen(rows.recording, arm, geometry, options.screening, factory=factory, coarse=True)
        require_determined(begun.rigid_arm)
        case = Case(rows.recording, arm, geometry, options, tuple(effects), factory)
        with part(0, 1 + fold_count(rows.recording.samples, options)):
            found = explain(case)
            selection = found.selection
            entered("estimating")
            selection = replace(selection, state=final_estimates(found.problem, selection.state, options.engine))
        folds = held_out_folds(found.problem, options)
        errors = held_out_errors(replace(case, among=selection.considered), found.final_decisions, folds)
        kept, of_all = ~_outliers(selection, options), selection
        verified = verify(of_all, errors, folds, kept, options, lambda spread: refitted_errors(of_all, spread, options))
        selection, errors = verified.selection, verified.errors
        with part(len(verified.folds) + 1, len(verified.folds) + 1):
            entered("planning")
            separating = separating_poses(selection, geometry, factory, options)
    problem = selection.problem
    assert isinstance(problem, PoseProblem)
    ruled_out: dict[str, DataFault] = {}
    for fault in (*rows.ruled_out, *found.screened.ruled_out):
        if fault.code not in {corrected.code for corrected in rows.found}:  # for which the corrected rows are screened
            ruled_out.setdefault(fault.code, fault)
    faults = (*rows.found, *found.screened.found)
    if not problem.valid.all():  # joints were not recorded at the instant of the pose
        without_joints = row_numbers(problem.recording.row[~problem.valid])
        faults = (*faults, DataFault("no_joints", without_joints, {"clock_offset_s": problem.clock_offset}))
    return Diagnosis(
        problem=problem,
        selection=selection,
        findings=verified.findings,
        before=errors.before,
        after=errors.after,
        faults=faults,
        ruled_out=tuple(ruled_out.values()),
        options=options,
        folds=tuple(verified.folds),
        withdrawn=verified.withdrawn,
        searched_again=verified.searched_again,
        outliers=_outliers(selection, options),
        separating=separating,
        turned=(errors.angle_before, errors.angle_after) if problem.rows == 6 else None,
    )


def _outliers(selection: Selection, options: Options) -> NDArray[np.bool_]:
    """`(sample,)`, rows that are far from the model, and rows without joints.

    A residual within the declared noise, or within the rounding of a file, is none, however small the others are.
    """
    problem, residuals = selection.problem, selection.state.fit.residuals
    assert isinstance(problem, PoseProblem)
    least = ROUNDING if (declared := problem.declared_noise[0]) is None else declared
    far = residuals.squares > options.outlier_squares * problem.rows
    return far & (np.sum(residuals.rows**2, 0) > (least / problem.noise[0]) ** 2) | ~problem.valid
