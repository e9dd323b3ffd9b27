"""The torques of a recording relative to a reference recording: what has changed, or what a simulator lacks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.shared import DISAGREE, Known, difference_p_value, fitted_beside, known_of
from lite6jax.diagnosis.torque_diagnosis import diagnose_torques
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.domains.torque.families import driver_values
from lite6jax.domains.torque.reference import RowComparison, compare_rows
from lite6jax.effects.dynamic.torque_effect import TorqueEffect
from lite6jax.effects.dynamic.unnamed import UnnamedTorque
from lite6jax.effects.effect import Effect, Estimate
from lite6jax.fitting.source import declared_arm_of, with_calibration
from lite6jax.progress import Stage
from lite6jax.recordings import Recording

Array = NDArray[np.floating]

_VISIBLE = 1e-3
"""Size of a torque over that of the most visible one, by unit of a direction of a function's numbers, from which rows
show it."""


@final
@dataclass(frozen=True, eq=False)
class EffectDifference:
    """An effect that one of two recordings shows, as each shows it.

    Attributes:
        effect: which.
        here: in the recording; None where it does not show it.
        there: in the reference.
        p_value: of a difference as large, family-wise over all effects that are compared; None where one is silent.
    """

    effect: TorqueEffect
    here: Known | None
    there: Known | None
    p_value: float | None

    def to_dict(self) -> dict[str, Any]:
        """Codes and numbers."""
        sides = {
            name: None
            if known is None
            else {"found": known.found, "parameters": {key: e._asdict() for key, e in known.parameters.items()}}
            for name, known in (("recording", self.here), ("reference", self.there))
        }
        differs = None if self.p_value is None else self.p_value < DISAGREE
        place = {"effect": self.effect.name, "site": self.effect.site}
        if isinstance(self.effect, UnnamedTorque):
            place["driver"] = " times ".join(driver.phrase for driver in self.effect.drivers)
        return {**place, **sides, "p_value": self.p_value, "differs": differs}


@final
@dataclass(frozen=True, eq=False)
class TorqueComparison:
    """How a recording was compared with its reference.

    Of the same motion row by row: then the findings are what the recording has beyond the reference. Of different
    motions effect by effect: then they are those of the recording, beside those of the reference.

    Attributes:
        file: the reference's name.
        rows: the comparison row by row; None where the motions differ.
        effects: the comparison effect by effect; none where the motion is the same.
    """

    file: str
    rows: RowComparison | None
    effects: tuple[EffectDifference, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Codes and numbers in SI units."""
        if self.rows is None:
            return {"file": self.file, "by": "effects", "differences": [each.to_dict() for each in self.effects]}
        return {
            "file": self.file,
            "by": "rows",
            "rows": self.rows.rows,
            "matched_rows": self.rows.matched,
            "apart_rms_by_joint_Nm": self.rows.apart.tolist(),
            "reference_rms_by_joint_Nm": self.rows.from_model.tolist(),
        }


def diagnose_torques_against(
    recording: Recording,
    reference: Recording,
    arm: Arm | None = None,
    *,
    effects: Sequence[TorqueEffect] = (),
    options: Options | None = None,
    progress: Callable[[Stage], object] | None = None,
) -> tuple[TorqueDiagnosis, TorqueComparison]:
    """Compares the torques of a recording with those of a reference, and diagnoses what the recording has beyond it.

    Where both hold the same motion, their difference is diagnosed. Otherwise each is diagnosed on its own, and what
    either shows is compared, with the uncertainty of both.

    Args:
        recording: with torques.
        reference: torques of the same arm, or of a simulator.
        arm: the declared arm; from the recording's sidecar where not given.
        effects: a user's own, as in `diagnose_torques`.
        options: thresholds.
        progress: as in `diagnose_torques`.

    Raises:
        InputError: as `compare_rows` and `diagnose_torques`.
    """
    arm = arm or declared_arm_of(recording)

    def diagnosed(side: Recording) -> TorqueDiagnosis:
        return diagnose_torques(side, arm, effects=effects, options=options, progress=progress)

    by_rows = compare_rows(recording, reference, with_calibration(arm, recording))
    if by_rows is not None:
        return diagnosed(by_rows.recording), TorqueComparison(by_rows.file, by_rows)
    found, other = diagnosed(recording), diagnosed(reference)
    shown: dict[tuple[object, ...], TorqueEffect] = {}
    for finding in (*found.findings, *other.findings):
        assert isinstance(finding.effect, TorqueEffect)
        shown.setdefault(_function(finding.effect), finding.effect)
    differences = [_difference(effect, found, other, len(shown)) for effect in shown.values()]
    return found, TorqueComparison(Path(reference.source).name, None, tuple(differences))


def _function(effect: Effect) -> tuple[object, ...]:
    """What two findings have in common that are compared: the name, or the driver of a function without one."""
    return (effect.site, effect.drivers) if effect.nonparametric else (effect.label,)


def _difference(
    effect: TorqueEffect, found: TorqueDiagnosis, other: TorqueDiagnosis, compared: int
) -> EffectDifference:
    if isinstance(effect, UnnamedTorque):
        here, there = _curves(effect, found, other)
    else:
        here, there = known_of(found, effect), known_of(other, effect)
    p = None
    if here is not None and there is not None:
        p = min(1.0, compared * difference_p_value(here, there))
    return EffectDifference(effect, here, there, p)


def _curves(effect: UnnamedTorque, found: TorqueDiagnosis, other: TorqueDiagnosis) -> tuple[Known | None, Known | None]:
    """A function without a name as both results show it: its values on the rows whose drivers both have in range.

    A result that has another function of the same drivers is fitted with this one in its place.
    """
    problem, own, its = found.problem, _driven(found, effect), _driven(other, effect)
    common = np.zeros(problem.samples, bool)
    if own is not None and its is not None:
        low, high = its.min(1, keepdims=True), its.max(1, keepdims=True)
        common = np.all((own >= low) & (own <= high), 0)
    functions = (problem.columns([effect]) * problem.sigma)[:, effect.joint - 1, common].T if common.any() else None
    if functions is None or not functions.any():
        whole = np.eye(effect.size)
        here, there = (_fitted_curve(each, effect, whole) if _has(each, effect) else None for each in (found, other))
        return here, there
    # the directions that these rows show, each a root mean square of the torque along it
    _, sizes, V = np.linalg.svd(functions / np.sqrt(common.sum()), full_matrices=False)
    seen = sizes > _VISIBLE * sizes[0]
    along = sizes[seen, None] * V[seen]
    return _fitted_curve(found, effect, along), _fitted_curve(other, effect, along)


def _has(result: TorqueDiagnosis, effect: UnnamedTorque) -> bool:
    return any(finding.effect == effect for finding in result.findings)


def _driven(result: TorqueDiagnosis, effect: UnnamedTorque) -> Array | None:
    """`(driver, sample)` of the rows of a result; None where it does not have all drivers of an effect."""
    data, dynamics = result.problem.data, result.problem.dynamics
    values = [row for driver in effect.of if (row := driver_values(driver, dynamics)) is not None]
    if len(values) < len(effect.of):
        return None
    return np.stack(values)[:, data.filter.kept][:, result.problem.chosen]


def _fitted_curve(result: TorqueDiagnosis, effect: UnnamedTorque, along: Array) -> Known:
    """A function's numbers in a result along some directions `(direction, number)`, with the size of the function."""
    at = result.fit
    if not _has(result, effect):
        at = fitted_beside(result, effect, lambda term: _function(term) == _function(effect))
    part = at.terms.slices[at.terms.terms.index(effect)]
    values, covariance = along @ at.values[part], along @ at.covariance[part, part] @ along.T
    size = float(np.sqrt(values @ values))
    std = float(np.sqrt(values @ covariance @ values)) / max(size, 1e-300)
    return Known(_has(result, effect), values, covariance, {"rms_Nm": Estimate(size, std)})
