"""A recording of poses and torques diagnosed in both domains, and what they say of the quantities that they share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, final

from lite6jax.arms.arm import Arm
from lite6jax.calibration.problem import Geometry
from lite6jax.calibration.source import arm_of, load_nominal, load_recording
from lite6jax.diagnosis.diagnose import diagnose
from lite6jax.diagnosis.estimates import DISAGREE, Known, difference_p_value, estimate_effect, side_entry
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import Diagnosis, DomainDiagnosis
from lite6jax.diagnosis.torque_diagnosis import diagnose_torques
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.effects.dynamic import BaseTilt, PayloadTorque, TorqueEffect, TorqueTimeOffset
from lite6jax.effects.effect import Effect
from lite6jax.effects.kinematic import GravityDirection, PayloadError, TimeOffset
from lite6jax.effects.user_effects import by_domain, require_effects
from lite6jax.errors import InputError
from lite6jax.progress import Stage
from lite6jax.recordings import Recording
from lite6jax.results import PublicResult

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
    """A quantity on which both domains depend, one of which at least has a finding that concerns it.

    Attributes:
        quantity: which.
        poses: what the poses say; None where they do not show it.
        torques: what the torques say.
        p_value: of a difference as large as theirs; None where one of them says nothing.
    """

    quantity: Quantity
    poses: Known | None
    torques: Known | None
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
        if _has(poses, kinematic) or _has(torques, dynamic):
            one, other = estimate_effect(poses, kinematic), estimate_effect(torques, dynamic)
            p = None if one is None or other is None else difference_p_value(one, other, sign)
            found.append(Shared(quantity, one, other, p))
    return tuple(found)


def _has(result: DomainDiagnosis[Any], effect: Effect) -> bool:
    return any(finding.effect == effect for finding in result.findings)
