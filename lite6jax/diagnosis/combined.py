"""A recording of poses and torques diagnosed in both domains, and what they say of the quantities that they share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, final

import numpy as np
from scipy.special import chdtrc

from lite6jax.arms.arm import Arm
from lite6jax.calibration.problem import Geometry
from lite6jax.calibration.source import arm_of, load_nominal, load_recording
from lite6jax.diagnosis.diagnose import diagnose, diagnose_against
from lite6jax.diagnosis.estimates import DISAGREE, Known, difference_p_value, estimate_effect, side_entry
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import Diagnosis, DomainDiagnosis
from lite6jax.diagnosis.torque_diagnosis import diagnose_torques, diagnose_torques_against
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.effects.dynamic.bodies import BaseTilt, LinkCom, LinkMass, PayloadBody, PayloadTorque
from lite6jax.effects.dynamic.motors import TorqueTimeOffset
from lite6jax.effects.dynamic.torque_effect import TorqueEffect
from lite6jax.effects.effect import Effect, Estimate
from lite6jax.effects.kinematic.joints import JointCompliance
from lite6jax.effects.kinematic.surroundings import TimeOffset
from lite6jax.effects.kinematic.weights import GravityDirection, PayloadError
from lite6jax.effects.user_effects import by_domain, require_effects
from lite6jax.errors import InputError
from lite6jax.progress import Stage
from lite6jax.recordings import Recording
from lite6jax.results import PublicResult

Quantity = Literal["payload_mass", "gravity_direction", "clock_offset", "load"]

_PAIRS: tuple[tuple[Quantity, Effect, TorqueEffect, float], ...] = (
    ("payload_mass", PayloadError(), PayloadTorque(), 1.0),
    # poses state by what gravity is turned, torques by what the base is: the opposite
    ("gravity_direction", GravityDirection(), BaseTilt(), -1.0),
    ("clock_offset", TimeOffset(), TorqueTimeOffset(), 1.0),
)
"""The effects of both domains that are one quantity, and the sign of the second over the first."""
_WEIGHTS = (LinkMass, LinkCom, PayloadTorque, PayloadBody, BaseTilt)
"""Effects by which other loads act on the joints than those of the declared arm."""


@final
@dataclass(frozen=True, eq=False)
class Shared:
    """A quantity on which both domains depend, one of which at least has a finding that concerns it.

    Attributes:
        quantity: which.
        poses: what the poses say; None where they do not show it.
        torques: what the torques say; of a load, what the joint carries over what the declared arm would load it with.
        p_value: of a difference as large as theirs; None where one of them says nothing.
        joint: of a load, counted from 1.
    """

    quantity: Quantity
    poses: Known | None
    torques: Known | None
    p_value: float | None
    joint: int | None = None

    @property
    def agree(self) -> bool | None:
        """Whether both say the same within their uncertainty; None where one of them says nothing."""
        return None if self.p_value is None else self.p_value >= DISAGREE

    def to_dict(self) -> dict[str, Any]:
        """Codes and numbers."""
        said: dict[str, Any] = {"quantity": self.quantity, "p_value": self.p_value, "agree": self.agree}
        said |= {"poses": side_entry(self.poses), "torques": side_entry(self.torques)}
        return said | ({} if self.joint is None else {"joint": self.joint})


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
    of_poses: dict[str, Any] = {"geometry": geometry, "effects": kinematic, "options": options, "progress": progress}
    of_torques: dict[str, Any] = {"effects": dynamic, "options": options, "progress": progress}
    if other is None or other.position is None:
        poses = diagnose(recording, arm, **of_poses)
    else:
        poses = diagnose_against(recording, other, arm, **of_poses)
    try:
        if other is None or not other.has_torques:
            torques = diagnose_torques(recording, arm, **of_torques)
        else:
            torques = diagnose_torques_against(recording, other, arm, **of_torques)
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
    # what the poses found of the loads themselves, the compliance rests on already
    known_to_poses = tuple(dynamic for _, kinematic, dynamic, _ in _PAIRS if _has(poses, kinematic))
    assumed = poses.problem.recording.settings.inertial_uncertainty  # which the intervals of the poses contain
    for finding in poses.findings:
        if isinstance(finding.effect, JointCompliance):
            load = _load(torques, finding.effect.joint, known_to_poses)
            if load is not None:
                own = Known(True, finding.values, finding.covariance, finding.parameters)
                std = float(np.hypot(np.sqrt(load.covariance[0, 0]), assumed))
                z = (float(load.values[0]) - 1) / max(std, 1e-12)
                found.append(Shared("load", own, load, float(chdtrc(1, z**2)), finding.effect.joint))
    return tuple(found)


def _has(result: DomainDiagnosis[Any], effect: Effect) -> bool:
    return any(finding.effect == effect for finding in result.findings)


def _load(torques: TorqueDiagnosis, joint: int, left_out: tuple[Effect, ...]) -> Known | None:
    """The torque of the arm's weight and motion at a joint over that of the declared arm, as the torques show it.

    None where the torques do not tell: no finding but those left out changes the loads, or the declared arm loads the
    joint with nothing.
    """
    problem, at = torques.problem, torques.fit
    declared = problem.data.bodies.dynamics(problem.data.bodies.links).torque[joint - 1]
    changed = [
        (effect, part)
        for effect, part in zip(at.terms.terms, at.terms.slices, strict=True)
        if isinstance(effect, _WEIGHTS) and effect not in left_out
    ]
    if not changed or not declared.any():
        return None
    numbers = np.concatenate([np.arange(part.start, part.stop) for _, part in changed])
    units = np.concatenate(
        [[effect.torque(unit, problem.dynamics)[joint - 1] for unit in np.eye(effect.size)] for effect, _ in changed]
    )
    slopes = units @ declared / (declared @ declared)
    ratio = 1 + float(slopes @ at.values[numbers])
    variance = float(slopes @ at.covariance[np.ix_(numbers, numbers)] @ slopes)
    named = {"load_ratio": Estimate(ratio, float(np.sqrt(max(variance, 0.0))))}
    return Known(True, np.array([ratio]), np.array([[variance]]), named)
