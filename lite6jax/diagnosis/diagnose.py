"""The diagnosis of poses: screen, explain, estimate finally, verify on held-out rows, design what to record next.

Of a recording that has torques too both domains are diagnosed, and what they say of the quantities that they share.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, final

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.calibration.problem import Geometry
from lite6jax.calibration.quality import ROUNDING
from lite6jax.calibration.source import arm_of, load_nominal, load_recording, with_arm
from lite6jax.diagnosis.discrimination import separating_poses
from lite6jax.diagnosis.estimates import DISAGREE, EffectEstimate, difference_p_value, estimate_effect, side_entry
from lite6jax.diagnosis.explanation import Case, explain
from lite6jax.diagnosis.heldout import fold_count, held_out_errors, held_out_folds, refitted_errors, verify
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import Diagnosis
from lite6jax.diagnosis.torque_diagnosis import TorqueDiagnosis, diagnose_torques
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.domains.pose.reference import compare
from lite6jax.domains.pose.rigid_arm import require_determined
from lite6jax.domains.pose.screening.screen import screen, screen_rows
from lite6jax.effects.dynamic import BaseTilt, PayloadTorque, TorqueEffect, TorqueTimeOffset
from lite6jax.effects.effect import Effect
from lite6jax.effects.kinematic import GravityDirection, PayloadError, TimeOffset
from lite6jax.effects.user_effects import by_domain, require_effects
from lite6jax.errors import InputError, require_type
from lite6jax.progress import Stage, entered, followed, part
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault, row_numbers
from lite6jax.results import PublicResult
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


# ------------------------------------------------------------------ poses and torques of one recording


Quantity = Literal["payload_mass", "gravity_direction", "clock_offset"]

_PAIRS: tuple[tuple[Quantity, Effect, TorqueEffect, float], ...] = (
    ("payload_mass", PayloadError(), PayloadTorque(), 1.0),
    # poses state by what gravity is turned, torques by what the base is: the opposite
    ("gravity_direction", GravityDirection(), BaseTilt(), -1.0),
    ("clock_offset", TimeOffset(), TorqueTimeOffset(), 1.0),
)
"""The effects of both domains that are one quantity, and the sign of the second over the first."""


@final
@dataclass(frozen=True, eq=False)
class Shared:
    """A quantity on which both domains depend, what each says of it, and the p-value of a difference as large.

    A domain that does not show it says None. A finding of one at least concerns it.
    """

    quantity: Quantity
    poses: EffectEstimate | None
    torques: EffectEstimate | None
    p_value: float | None

    @property
    def agree(self) -> bool | None:
        """Whether both say the same within their uncertainty; None where one of them says nothing."""
        return None if self.p_value is None else self.p_value >= DISAGREE

    def to_dict(self) -> dict[str, Any]:
        """Codes and numbers."""
        said: dict[str, Any] = {"quantity": self.quantity, "p_value": self.p_value, "agree": self.agree}
        return said | {"poses": side_entry(self.poses), "torques": side_entry(self.torques)}


@final
@dataclass(frozen=True, eq=False, repr=False)
class CombinedDiagnosis(PublicResult):
    """The diagnoses of the poses and of the torques of one recording.

    Attributes:
        poses: of the poses.
        torques: of the torques; None where these cannot be diagnosed.
        shared: quantities on which both depend and which a finding concerns.
        refused: why the torques cannot be diagnosed, with the remedy; None where they are.
    """

    poses: Diagnosis
    torques: TorqueDiagnosis | None
    shared: tuple[Shared, ...] = ()
    refused: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """The document: that of the poses, with that of the torques as `torques`.

        Everything that reads a diagnosis of poses reads it as one.
        """
        document = self.poses.to_dict()
        if self.torques is None:
            return document | {"torques_refused": self.refused}
        shared = [each.to_dict() for each in self.shared]
        return document | {"torques": self.torques.to_dict(), "shared": shared}


def diagnose_combined(
    recording: Recording | str | Path,
    arm: Arm | str | Path | None = None,
    *,
    reference: Recording | str | Path | None = None,
    geometry: Geometry = "declared",
    effects: Sequence[Effect] = (),
    options: Options | None = None,
    progress: Callable[[Stage], object] | None = None,
) -> CombinedDiagnosis:
    """Diagnoses the poses and the torques of a recording that has both.

    Torques that cannot be diagnosed (of an arm at rest, or without inertia) are left out with the reason.

    Args:
        recording: with poses and with torques or currents; or the path of its file.
        arm: the nominal arm, a bundled name or a file; from the sidecar, or recognised, where not given.
        reference: another recording, or its file, relative to which both are diagnosed as far as it has poses and
            torques.
        geometry: of the poses, as in `diagnose`.
        effects: a user's own, of either domain.
        options: thresholds.
        progress: called as each stage begins, of the poses and then of the torques.

    Raises:
        InputError: poses or torques only, or as `diagnose`.
    """
    arm = load_nominal(arm)
    recording = load_recording(recording, arm)
    if recording.position is None or not recording.has_torques:
        has = "torques and no poses" if recording.position is None else "poses and no torques"
        own = "diagnose_torques" if recording.position is None else "diagnose"
        raise InputError(f"{recording.source}: has {has}; call lite6jax.{own}")
    arm = arm or arm_of(recording)
    other = None if reference is None else load_recording(reference, arm)
    require_effects(effects)
    kinematic, dynamic = by_domain(effects)
    given: dict[str, Any] = {"options": options, "progress": progress}
    of_poses = other if other is not None and other.position is not None else None
    of_torques = other if other is not None and other.has_torques else None
    poses = diagnose(recording, arm, reference=of_poses, geometry=geometry, effects=kinematic, **given)
    try:
        torques = diagnose_torques(recording, arm, reference=of_torques, effects=dynamic, **given)
    except InputError as error:
        return CombinedDiagnosis(poses, None, refused=str(error))
    return CombinedDiagnosis(poses, torques, compare_domains(poses, torques))


def compare_domains(poses: Diagnosis, torques: TorqueDiagnosis) -> tuple[Shared, ...]:
    """The quantities that a finding of either concerns, each as both see it."""
    found = []
    for quantity, kinematic, dynamic, sign in _PAIRS:
        if poses.has(kinematic) or torques.has(dynamic):
            one, other = estimate_effect(poses, kinematic), estimate_effect(torques, dynamic)
            p = None if one is None or other is None else difference_p_value(one, other, sign)
            found.append(Shared(quantity, one, other, p))
    return tuple(found)
