"""A recording of poses and torques diagnosed in both domains, and what they say of the quantities that they share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from lite6jax.arms.arm import Arm
from lite6jax.checksum import with_checksum
from lite6jax.diagnosis.diagnose import diagnose
from lite6jax.diagnosis.document import to_document
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.reference_diagnosis import diagnose_against
from lite6jax.diagnosis.result import Diagnosis
from lite6jax.diagnosis.shared import Shared, shared_by
from lite6jax.diagnosis.torque_diagnosis import diagnose_torques
from lite6jax.diagnosis.torque_document import to_torque_document
from lite6jax.diagnosis.torque_reference import TorqueComparison, diagnose_torques_against
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.domains.pose.reference import ReferenceComparison
from lite6jax.effects.effect import Effect
from lite6jax.effects.user_effects import by_domain, require_effects
from lite6jax.errors import InputError
from lite6jax.fitting.problem import Geometry
from lite6jax.fitting.source import arm_of, load_nominal, load_recording
from lite6jax.progress import Stage
from lite6jax.recordings import Recording
from lite6jax.results import PublicResult


@final
@dataclass(frozen=True, eq=False, repr=False)
class CombinedDiagnosis(PublicResult):
    """The diagnoses of the poses and of the torques of one recording.

    Attributes:
        poses: of the poses.
        torques: of the torques; None where these cannot be diagnosed.
        shared: quantities on which both depend and which a finding concerns.
        refused: why the torques cannot be diagnosed, with the remedy; None where they are.
        against: how the poses, and the torques, were compared with those of a reference; None where they were not.
    """

    poses: Diagnosis
    torques: TorqueDiagnosis | None
    shared: tuple[Shared, ...] = ()
    refused: str | None = None
    against: tuple[ReferenceComparison | None, TorqueComparison | None] = (None, None)

    def to_dict(self) -> dict[str, Any]:
        """The document: that of the poses, with that of the torques as `torques`, and a checksum.

        Everything that reads a diagnosis of poses reads it as one.
        """
        document = to_document(self.poses)
        if self.against[0] is not None:
            document["against"] = self.against[0].to_dict()
        if self.torques is None:
            return with_checksum(document | {"torques_refused": self.refused})
        torques = to_torque_document(self.torques)
        if self.against[1] is not None:
            torques["against"] = self.against[1].to_dict()
        return with_checksum(document | {"torques": torques, "shared": [each.to_dict() for each in self.shared]})


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
    reference = None if reference is None else load_recording(reference, arm)
    require_effects(effects)
    kinematic, dynamic = by_domain(effects)
    seen: ReferenceComparison | None = None
    compared: TorqueComparison | None = None
    if reference is not None and reference.position is not None:
        poses, seen = diagnose_against(
            recording, reference, arm, geometry=geometry, effects=kinematic, options=options, progress=progress
        )
    else:
        poses = diagnose(recording, arm, geometry=geometry, effects=kinematic, options=options, progress=progress)
    try:
        if reference is not None and reference.has_torques:
            torques, compared = diagnose_torques_against(
                recording, reference, arm, effects=dynamic, options=options, progress=progress
            )
        else:
            torques = diagnose_torques(recording, arm, effects=dynamic, options=options, progress=progress)
    except InputError as error:
        return CombinedDiagnosis(poses, None, refused=str(error), against=(seen, None))
    return CombinedDiagnosis(poses, torques, shared_by(poses, torques), against=(seen, compared))
