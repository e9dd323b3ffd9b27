"""What a diagnosis of poses and one of torques of the same recording both depend on, and whether they agree on it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from lite6jax.diagnosis.result import Diagnosis
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.effects.dynamic.bodies import BaseTilt, LinkCom, LinkMass, PayloadBody, PayloadTorque
from lite6jax.effects.dynamic.motors import TorqueTimeOffset
from lite6jax.effects.dynamic.torque_effect import TorqueEffect
from lite6jax.effects.effect import Effect, Estimate
from lite6jax.effects.kinematic.joints import JointCompliance
from lite6jax.effects.kinematic.surroundings import TimeOffset
from lite6jax.effects.kinematic.weights import GravityDirection, PayloadError
from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.problem import LinearisedProblem
from lite6jax.estimation.terms import Terms

Array = NDArray[np.floating]
Quantity = Literal["payload_mass", "gravity_direction", "clock_offset", "load"]

DISAGREE = 0.0027
"""The probability of a difference by chance, three standard deviations, below which two estimates disagree."""
_VAGUE = 30.0
"""Typical sizes beyond which the standard deviation of an estimate says that a recording does not show it."""
_PAIRS: tuple[tuple[Quantity, Effect, TorqueEffect, float], ...] = (
    ("payload_mass", PayloadError(), PayloadTorque(), 1.0),
    # poses state by what gravity is turned, torques by what the base is: the opposite
    ("gravity_direction", GravityDirection(), BaseTilt(), -1.0),
    ("clock_offset", TimeOffset(), TorqueTimeOffset(), 1.0),
)
"""The effects of both domains that are one quantity, and the sign of the second over the first."""
_WEIGHTS = (LinkMass, LinkCom, PayloadTorque, PayloadBody, BaseTilt)
"""Effects by which other loads act on the joints than those of the declared arm."""


class Known(NamedTuple):
    """What one domain says of a quantity.

    Attributes:
        found: whether it is a finding; otherwise it was estimated beside the findings.
        values: `(number,)`.
        covariance: `(number, number)`.
        parameters: the same with their names.
    """

    found: bool
    values: Array
    covariance: Array
    parameters: dict[str, Estimate]


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
        for name, known in (("poses", self.poses), ("torques", self.torques)):
            said[name] = None
            if known is not None:
                parameters = {key: estimate._asdict() for key, estimate in known.parameters.items()}
                said[name] = {"found": known.found, "parameters": parameters}
        return said | ({} if self.joint is None else {"joint": self.joint})


def shared_by(poses: Diagnosis, torques: TorqueDiagnosis) -> tuple[Shared, ...]:
    """The quantities that a finding of either concerns, each as both see it."""
    found = []
    for quantity, kinematic, dynamic, sign in _PAIRS:
        if not any(_finding(result, effect) for result, effect in ((poses, kinematic), (torques, dynamic))):
            continue
        one, other = known_of(poses, kinematic), known_of(torques, dynamic)
        p = None if one is None or other is None else difference_p_value(one, other, sign)
        found.append(Shared(quantity, one, other, p))
    # what the poses found of the loads themselves, the compliance rests on already
    known_to_poses = tuple(dynamic for _, kinematic, dynamic, _ in _PAIRS if _finding(poses, kinematic))
    for finding in poses.findings:
        if isinstance(finding.effect, JointCompliance):
            load = _load(torques, finding.effect.joint, known_to_poses)
            if load is not None:
                own = Known(True, finding.values, finding.covariance, finding.parameters)
                std = float(np.sqrt(load.covariance[0, 0]))
                z = (float(load.values[0]) - 1) / max(float(np.hypot(std, _assumed(poses))), 1e-12)
                found.append(Shared("load", own, load, float(chdtrc(1, z**2)), finding.effect.joint))
    return tuple(found)


def _finding(result: Diagnosis | TorqueDiagnosis, effect: Effect) -> bool:
    return any(finding.effect == effect for finding in result.findings)


def known_of(result: Diagnosis | TorqueDiagnosis, effect: Effect) -> Known | None:
    """What a result says of an effect: as it was found, or fitted beside all that was; None where it is not shown.

    Of an effect with an order or a speed that a search chose, its size is what is compared.
    """
    for finding in result.findings:
        if finding.effect == effect or (effect.choice is not None and finding.effect.label == effect.label):
            return _of(True, finding.effect, finding.values, finding.covariance)
    candidates: tuple[Effect, ...] = result.problem.candidates
    if (effect not in candidates and effect.choice is None) or effect in result.confounded:
        return None
    beside = fitted_beside(result, effect)
    part = beside.terms.slices[-1]
    values, covariance = beside.values[part], beside.covariance[part, part]
    typical = np.array([number.typical for number in effect.coordinates])
    std = np.sqrt(np.diagonal(covariance))
    if not np.isfinite(std).all() or (std > _VAGUE * typical).any():
        return None
    return _of(False, effect, values, covariance)


def fitted_beside(
    result: Diagnosis | TorqueDiagnosis, effect: Effect, replaced: Callable[[Effect], bool] = lambda other: False
) -> Fit:
    """The fit of a result with an effect more, the last of its terms, and without those that this one replaces."""
    at = result.fit
    kept = [not (isinstance(term, Effect) and replaced(term)) for term in at.terms.terms]
    rest, values = at.terms.part(at.values, kept)
    terms, start = Terms((*rest.terms, effect)), np.append(values, np.zeros(effect.size))
    problem: LinearisedProblem = result.problem
    return fit(problem, terms, result.options.engine, start, at.nuisance, at.training, at.noise)


def _of(found: bool, effect: Effect, values: Array, covariance: Array) -> Known:
    parameters = effect.reported(values, covariance)
    if effect.choice is not None:
        size = next(iter(parameters.values())) if "amplitude_Nm" not in parameters else parameters["amplitude_Nm"]
        values, covariance = np.array([size.value]), np.array([[size.std**2]])
    return Known(found, values, covariance, parameters)


def difference_p_value(one: Known, other: Known, sign: float = 1.0) -> float:
    """Of a difference as large as theirs, both being normal.

    Args:
        one: the first.
        other: the second.
        sign: of the second over the first.
    """
    off = one.values - sign * other.values
    together = one.covariance + other.covariance
    return float(chdtrc(len(off), off @ np.linalg.pinv(together) @ off))


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


def _assumed(poses: Diagnosis) -> float:
    """The relative uncertainty of masses that the intervals of the poses contain already."""
    return float(poses.problem.recording.settings.inertial_uncertainty)
