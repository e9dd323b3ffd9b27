"""What a diagnosis of either domain says of one effect, and whether two agree."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from lite6jax.diagnosis.result import DomainDiagnosis
from lite6jax.effects.dynamic import BaseTilt, PayloadTorque, TorqueEffect, TorqueTimeOffset
from lite6jax.effects.effect import Effect, Estimate
from lite6jax.effects.kinematic import GravityDirection, PayloadError, TimeOffset
from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.terms import Terms

Array = NDArray[np.floating]

DISAGREE = 0.0027
"""The probability of a difference by chance, three standard deviations, below which two estimates disagree."""
_VAGUE = 30.0
"""Typical sizes beyond which the standard deviation of an estimate says that a recording does not show it."""


class EffectEstimate(NamedTuple):
    """What one domain says of a quantity: its values `(number,)`, their covariance, and the same with their names.

    What is not `found` was estimated beside the findings.
    """

    found: bool
    values: Array
    covariance: Array
    parameters: dict[str, Estimate]


def side_entry(said: EffectEstimate | None) -> dict[str, Any] | None:
    """What one side says of a quantity, as values that JSON can hold."""
    if said is None:
        return None
    return {"found": said.found, "parameters": {key: e._asdict() for key, e in said.parameters.items()}}


def estimate_effect(result: DomainDiagnosis[Any], effect: Effect) -> EffectEstimate | None:
    """What a result says of an effect: as it was found, or fitted beside all that was; None where it is not shown.

    Of an effect with an order, a speed or an exponent that a search chose, its size is what is compared.
    """
    for finding in result.findings:
        if finding.effect == effect or (effect.searched and finding.effect.label == effect.label):
            return _of(True, finding.effect, finding.values, finding.covariance)
    candidates: tuple[Effect, ...] = result.problem.candidates
    if (effect not in candidates and not effect.searched) or effect in result.confounded:
        return None
    beside = fit_with_effect(result, effect)
    numbers = beside.terms.slices[-1]
    values, covariance = beside.values[numbers], beside.covariance[numbers, numbers]
    typical = np.array([each.typical for each in effect.coordinates])
    std = np.sqrt(np.diagonal(covariance))
    if not np.isfinite(std).all() or (std > _VAGUE * typical).any():
        return None
    return _of(False, effect, values, covariance)


def fit_with_effect(
    result: DomainDiagnosis[Any], effect: Effect, replaced: Callable[[Effect], bool] = lambda other: False
) -> Fit:
    """The fit of a result with an effect more, the last of its terms, and without those that this one replaces."""
    at = result.fit
    kept = [not (isinstance(term, Effect) and replaced(term)) for term in at.terms.terms]
    rest, values = at.terms.part(at.values, kept)
    terms, start = Terms((*rest.terms, effect)), np.append(values, np.zeros(effect.size))
    return fit(result.problem, terms, result.options.engine, start, at.nuisance, at.training, at.noise)


def _of(found: bool, effect: Effect, values: Array, covariance: Array) -> EffectEstimate:
    parameters = effect.reported(values, covariance)
    if effect.searched:
        size = next(iter(parameters.values())) if "amplitude_Nm" not in parameters else parameters["amplitude_Nm"]
        values, covariance = np.array([size.value]), np.array([[size.std**2]])
    return EffectEstimate(found, values, covariance, parameters)


def difference_p_value(one: EffectEstimate, other: EffectEstimate, sign: float = 1.0) -> float:
    """Of a difference as large as theirs, both being normal; `sign` is that of the second over the first."""
    off = one.values - sign * other.values
    together = one.covariance + other.covariance
    return float(chdtrc(len(off), off @ np.linalg.pinv(together) @ off))


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


def compare_domains(poses: DomainDiagnosis[Any], torques: DomainDiagnosis[Any]) -> tuple[Shared, ...]:
    """The quantities that a finding of either concerns, each as both see it."""
    found = []
    for quantity, kinematic, dynamic, sign in _PAIRS:
        if poses.has(kinematic) or torques.has(dynamic):
            one, other = estimate_effect(poses, kinematic), estimate_effect(torques, dynamic)
            p = None if one is None or other is None else difference_p_value(one, other, sign)
            found.append(Shared(quantity, one, other, p))
    return tuple(found)
