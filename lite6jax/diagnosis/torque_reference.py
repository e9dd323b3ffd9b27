"""The torques of a recording relative to a reference recording: what has changed, or what a simulator lacks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.shared import DISAGREE, Known, difference_p_value, known_of
from lite6jax.diagnosis.torque_diagnosis import diagnose_torques
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.domains.torque.reference import RowComparison, compare_rows
from lite6jax.effects.dynamic.torque_effect import TorqueEffect
from lite6jax.fitting.recognition import declared_arm_of, with_calibration
from lite6jax.progress import Stage
from lite6jax.recordings import Recording

Array = NDArray[np.floating]


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
        return {"effect": self.effect.name, "site": self.effect.site, **sides, "p_value": self.p_value,
                "differs": differs}  # fmt: skip


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
    named: list[TorqueEffect] = []
    for finding in (*found.findings, *other.findings):
        assert isinstance(finding.effect, TorqueEffect)
        if not finding.effect.nonparametric and finding.effect.label not in [effect.label for effect in named]:
            named.append(finding.effect)
    differences = [_difference(effect, found, other, len(named)) for effect in named]
    return found, TorqueComparison(Path(reference.source).name, None, tuple(differences))


def _difference(
    effect: TorqueEffect, found: TorqueDiagnosis, other: TorqueDiagnosis, compared: int
) -> EffectDifference:
    here, there = known_of(found, effect), known_of(other, effect)
    p = None
    if here is not None and there is not None:
        p = min(1.0, compared * difference_p_value(here, there))
    return EffectDifference(effect, here, there, p)
