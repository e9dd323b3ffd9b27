"""What a diagnosis of a domain says of one effect, and whether two agree."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
from threadpoolctl import threadpool_limits

from lite6jax.array_types import Array
from lite6jax.diagnosis.agreement import Agreement, EffectEstimate, compare_estimates
from lite6jax.diagnosis.gains import compare_gains
from lite6jax.diagnosis.result import DomainDiagnosis
from lite6jax.domains.base import DomainName
from lite6jax.domains.torque.predict import read_driver
from lite6jax.domains.torque.problem import TorqueProblem
from lite6jax.effects.dynamic import BaseTilt, PayloadTorque, TorqueTimeOffset, UnnamedTorque
from lite6jax.effects.effect import Effect, Estimate
from lite6jax.effects.kinematic import GravityDirection, PayloadError, TimeOffset
from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.terms import Terms

_VAGUE = 30.0
"""Typical sizes beyond which the standard deviation of an estimate says that a recording does not show it."""


def estimate_effect(result: DomainDiagnosis[Any], effect: Effect) -> EffectEstimate | None:
    """What a result says of an effect: as it was found, or fitted beside all that was; None where it is not shown.

    Of an effect with an order, a speed or an exponent that a search chose, its size is what is compared.
    """
    for finding in result.findings:
        if finding.effect == effect or (effect.searched and finding.effect.label == effect.label):
            return _of(True, finding.effect, finding.values, finding.larger_covariance)
    candidates: tuple[Effect, ...] = result.problem.candidates
    if (effect not in candidates and not effect.searched) or effect in result.confounded:
        return None
    beside = fit_with_effect(result, effect)
    numbers = beside.terms.slices[-1]
    values = beside.values[numbers]
    covariance = beside.covariance[numbers, numbers]
    typical = np.array([coordinate.typical for coordinate in effect.coordinates])
    std = np.sqrt(np.diagonal(covariance))
    if not np.isfinite(std).all() or (std > _VAGUE * typical).any():
        return None
    return _of(False, effect, values, covariance)


def fit_with_effect(
    result: DomainDiagnosis[Any], effect: Effect, replaced: Callable[[Effect], bool] = lambda term: False
) -> Fit:
    """The fit of a result with an effect more, the last of its terms, and without those that this one replaces."""
    at = result.fit
    term_mask = [not (isinstance(term, Effect) and replaced(term)) for term in at.terms.terms]
    remaining_terms, values = at.terms.part(at.values, term_mask)
    terms = Terms((*remaining_terms.terms, effect))
    start = np.append(values, np.zeros(effect.size))
    return fit(result.problem, terms, result.options.engine, start, at.nuisance, at.training, at.noise)


def _of(is_finding: bool, effect: Effect, values: Array, covariance: Array) -> EffectEstimate:
    parameters = effect.reported(values, covariance)
    if effect.searched:
        size = next(iter(parameters.values())) if "amplitude_Nm" not in parameters else parameters["amplitude_Nm"]
        values = np.array([size.value])
        covariance = np.array([[size.std**2]])
    return EffectEstimate(is_finding, values, covariance, parameters)


# ------------------------------------------------------------------ two domains of one recording


class _OneQuantity(NamedTuple):
    """Effects of two domains that are one quantity, and the sign of the second over the first."""

    quantity: str
    first: Effect
    second: Effect
    sign: float = 1.0


_SHARED: dict[tuple[DomainName, DomainName], tuple[_OneQuantity, ...]] = {
    ("poses", "torques"): (
        _OneQuantity("payload_mass", PayloadError(), PayloadTorque()),
        # poses state by what gravity is turned, torques by what the base is: the opposite
        _OneQuantity("gravity_direction", GravityDirection(), BaseTilt(), -1.0),
        _OneQuantity("clock_offset", TimeOffset(), TorqueTimeOffset()),
    ),
    ("torques", "tracking"): (
        _OneQuantity("payload_mass", PayloadTorque(), PayloadTorque()),
        _OneQuantity("gravity_direction", BaseTilt(), BaseTilt()),
    ),
}
_FURTHER: dict[tuple[DomainName, DomainName], tuple[Callable[..., Iterable[Agreement]], ...]] = {
    ("torques", "tracking"): (compare_gains,)
}
"""What is compared beside quantities that are one effect of each."""


@threadpool_limits.wrap(limits=1, user_api="blas")
def compare_domains(first: DomainDiagnosis[Any], second: DomainDiagnosis[Any]) -> tuple[Agreement, ...]:
    """The quantities that a finding of either concerns, each as both see it; of torques and commands also the gains."""
    sides = (first.domain, second.domain)
    agreements = []
    for shared in _SHARED.get(sides, ()):
        if first.has(shared.first) or second.has(shared.second):
            estimates = {
                first.domain: estimate_effect(first, shared.first),
                second.domain: estimate_effect(second, shared.second),
            }
            agreements.append(compare_estimates({"quantity": shared.quantity}, estimates, shared.sign))
    for compare in _FURTHER.get(sides, ()):
        agreements += compare(first, second)
    return tuple(agreements)


# ------------------------------------------------------------------ torques of two recordings


_VISIBLE = 1e-3
"""Size of a torque over that of the most visible one, by unit of a direction of a function's numbers, from which rows
show it."""


@final
@dataclass(frozen=True, eq=False)
class EffectComparison:
    """How a recording was compared with a reference of another motion: effect by effect, each as both show it."""

    file: str
    effects: tuple[Agreement, ...]

    def to_dict(self) -> dict[str, Any]:
        """Codes and numbers."""
        return {
            "file": self.file,
            "basis": "effects",
            "differences": [difference.to_dict() for difference in self.effects],
        }


def compare_effects(found: DomainDiagnosis[TorqueProblem], other: DomainDiagnosis[TorqueProblem]) -> EffectComparison:
    """Each effect that either of two recordings shows, as both do; p-values are family-wise over all."""
    shown: dict[tuple[object, ...], Effect] = {}
    for finding in (*found.findings, *other.findings):
        shown.setdefault(_function(finding.effect), finding.effect)
    compared = []
    for effect in shown.values():
        of = {"effect": effect.name, "site": effect.site}
        if effect.nonparametric:
            assert isinstance(effect, UnnamedTorque)
            of["driver"] = effect.driver
            estimate, reference_estimate = _curves(effect, found, other)
        else:
            estimate = estimate_effect(found, effect)
            reference_estimate = estimate_effect(other, effect)
        compared.append(
            compare_estimates(of, {"recording": estimate, "reference": reference_estimate}, compared=len(shown))
        )
    return EffectComparison(Path(other.recording.source).name, tuple(compared))


def _function(effect: Effect) -> tuple[object, ...]:
    """What two findings have in common that are compared: the name, or the driver of a function without one."""
    if effect.nonparametric:
        return (effect.site, effect.drivers)
    return (effect.label,)


def _curves(
    effect: UnnamedTorque, result: DomainDiagnosis[TorqueProblem], reference: DomainDiagnosis[TorqueProblem]
) -> tuple[EffectEstimate | None, EffectEstimate | None]:
    """A function without a name as both results show it: its values on the rows whose drivers both have in range.

    A result that has another function of the same drivers is fitted with this one in its place.
    """
    problem = result.problem
    drivers = _driven(result, effect)
    reference_drivers = _driven(reference, effect)
    common = np.zeros(problem.samples, bool)
    if drivers is not None and reference_drivers is not None:
        low = reference_drivers.min(1, keepdims=True)
        high = reference_drivers.max(1, keepdims=True)
        common = np.all((drivers >= low) & (drivers <= high), 0)
    functions = (problem.columns([effect]) * problem.sigma)[:, effect.joint - 1, common].T
    if not functions.any():
        identity = np.eye(effect.size)
        curve, reference_curve = (
            _fitted_curve(diagnosis, effect, identity) if diagnosis.has(effect) else None
            for diagnosis in (result, reference)
        )
        return curve, reference_curve
    # the directions that these rows show, each a root mean square of the torque along it
    _, sizes, V = np.linalg.svd(functions / np.sqrt(common.sum()), full_matrices=False)
    visible = sizes > _VISIBLE * sizes[0]
    along = sizes[visible, None] * V[visible]
    return _fitted_curve(result, effect, along), _fitted_curve(reference, effect, along)


def _driven(result: DomainDiagnosis[TorqueProblem], effect: UnnamedTorque) -> Array | None:
    """`(driver, sample)` of the rows of a result; None where it does not have all drivers of an effect."""
    data = result.problem.data
    dynamics = result.problem.dynamics
    values = [row for driver in effect.drivers if (row := read_driver(driver, dynamics)) is not None]
    if len(values) < len(effect.drivers):
        return None
    return np.stack(values)[:, data.filter.kept][:, result.problem.chosen]


def _fitted_curve(result: DomainDiagnosis[TorqueProblem], effect: UnnamedTorque, along: Array) -> EffectEstimate:
    """A function's numbers in a result along some directions `(direction, number)`, with the size of the function."""
    at = result.fit
    if not result.has(effect):
        at = fit_with_effect(result, effect, lambda term: _function(term) == _function(effect))
    numbers = at.terms.slices[at.terms.terms.index(effect)]
    values = along @ at.values[numbers]
    covariance = along @ at.covariance[numbers, numbers] @ along.T
    size = float(np.sqrt(values @ values))
    std = float(np.sqrt(values @ covariance @ values)) / max(size, 1e-300)
    return EffectEstimate(result.has(effect), values, covariance, {"rms_Nm": Estimate(size, std)})
