"""The diagnosis of a recording: what is missing, how sure that is, and what it is worth on rows it did not see."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lite6jax.arms.arm import Arm
from lite6jax.diagnosis.discrimination import Separation, separations
from lite6jax.diagnosis.explanation import explain
from lite6jax.domains.pose.problem import Case, arm_moved
from lite6jax.domains.pose.screening.rows import Fault
from lite6jax.effects.catalogue import Untestable
from lite6jax.effects.effect import Effect
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.serialization import effect_as_dict
from lite6jax.fitting.problem import Geometry
from lite6jax.recordings import Recording
from lite6jax.search.final_estimates import stated
from lite6jax.search.forward import Selection

Array = NDArray[np.floating]
Verdict = Literal["consistent", "explained", "partly_explained", "unnamed"]

FOLDS = 5
_OUTLIER = 30.0
"""Squared whitened residual a number, over the scale, beyond which a row is a fault of the data."""
_AS_NOISE = 1.1


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What a recording shows.

    Attributes:
        case: the data.
        selection: the physics found in all of it.
        before: `(sample,)` m, held-out position errors with the nuisance alone.
        after: `(sample,)` m, with the physics that the other folds ask for.
        outliers: `(sample,)` bool, rows that no model explains, and those unseen; they are in no error above.
        untestable: what this recording cannot show, and why.
        faults: of the data, put right before the search.
        checked: easy causes that were looked for and are not there.
        separating: poses that would tell rivals apart.
    """

    case: Case
    selection: Selection
    before: Array
    after: Array
    outliers: NDArray[np.bool_]
    untestable: tuple[Untestable, ...]
    faults: tuple[Fault, ...] = ()
    checked: tuple[Fault, ...] = ()
    separating: tuple[Separation, ...] = ()

    @property
    def estimated_noise(self) -> float:
        """One standard deviation per axis of position, m, as the residuals have it."""
        return float(self.selection.fitted.residual.scale * self.case.noise[0])

    @cached_property
    def verdict(self) -> Verdict:
        """In one word."""
        steps = self.selection.steps
        if not steps:
            return "consistent"
        largest = max(steps, key=lambda step: step.score.gain)
        if largest.effect.name == "unnamed":
            return "unnamed"
        kept = ~self.outliers
        left = np.sqrt(np.mean(self.after[kept] ** 2) / 3)
        if self.case.declared and left < _AS_NOISE * self.case.noise[0]:
            return "explained"
        return "partly_explained"

    def to_dict(self) -> dict[str, Any]:
        """As `lite6jax/diagnosis/1`, plain numbers and words in SI units."""
        case, fitted = self.case, self.selection.fitted
        kept = ~self.outliers
        before, after = _summary(self.before[kept]), _summary(self.after[kept])
        findings = []
        for step, part in zip(self.selection.steps, fitted.physics.slices, strict=True):
            entry = effect_as_dict(step.effect, fitted.values[part], fitted.covariance[part, part])
            parameters = {name: {"value": e["value"], "std": e["std"]} for name, e in entry["parameters"].items()}
            findings.append(
                {
                    "effect": step.effect.name,
                    "site": step.effect.site,
                    "driver": " and ".join(driver.phrase for driver in step.effect.drivers) or "none",
                    "parameters": parameters,
                    "p_value": step.p,
                    "log_likelihood_gain": step.score.gain,
                    "heldout_rms_before_m": before["heldout_position_rms_m"],
                    "heldout_rms_after_m": after["heldout_position_rms_m"],
                    "confusable_with": [
                        {
                            "effect": rival.effect.name,
                            "site": rival.effect.site,
                            "log_likelihood_gap": rival.gap,
                            **{
                                key: getattr(rival.effect, key)
                                for key in ("order", "source_joint")
                                if hasattr(rival.effect, key)
                            },
                        }
                        for rival in step.rivals
                    ],
                    "statement": statement(step.effect, parameters),
                }
            )
        faults = [fault._asdict() for fault in self.faults]
        wild = self.outliers & case.seen
        if wild.any():
            rows = [int(row) for row in case.recording.row[wild]]
            faults.append(
                {
                    "fault": "outliers",
                    "rows": rows,
                    "statement": f"{len(rows)} rows stand out of what noise allows and count for little.",
                }
            )
        return {
            "schema": "lite6jax/diagnosis/1",
            "verdict": self.verdict,
            "before": before,
            "after": after,
            "heldout_rows": int(kept.sum()),
            "noise": {
                "declared_position_m": case.noise[0] if case.declared else None,
                "estimated_position_m": self.estimated_noise,
            },
            "data_faults": faults,
            "ruled_out": [{"fault": item.fault, "statement": item.statement} for item in self.checked],
            "findings": findings,
            "nearest": None
            if self.selection.nearest is None
            else {
                "effect": self.selection.nearest[0].name,
                "site": self.selection.nearest[0].site,
                "p_value": self.selection.nearest[1],
            },
            "separating_poses": [
                {"effects": list(item.effects), "joint_position_rad": item.joint_position.tolist()}
                for item in self.separating
            ],
            "untestable": [
                {"effect": item.effect.name, "site": item.effect.site, "reason": item.reason}
                for item in self.untestable
            ],
            "model": self.model(),
        }

    def model(self) -> dict[str, Any]:
        """All that a prediction needs."""
        case, fitted = self.case, self.selection.fitted
        arm = arm_moved(case, fitted.moved)
        settings = case.recording.settings
        inertia = case.inertia
        return {
            "arm": case.arm.name,
            "kinematics": np.asarray(arm.geometry).reshape(-1, 6).tolist(),
            "T_sensor_base": np.asarray(arm.T_sensor_base).tolist(),
            "T_flange_tool": np.asarray(arm.T_flange_tool).tolist(),
            "joint_limits": case.arm.joint_limits.tolist(),
            "orientation": case.rows == 6,
            "inertia": None
            if inertia is None
            else {name: np.asarray(value).tolist() for name, value in inertia._asdict().items()},
            "reference_temperature_degC": settings.reference_temperature_degC,
            "motion": case.recording.motion,
            "accelerated": case.motion.joint_acceleration is not None,
            "effects": [
                effect_as_dict(effect, fitted.values[part], fitted.covariance[part, part])
                for effect, part in zip(fitted.physics.effects, fitted.physics.slices, strict=True)
            ],
        }


# A second thread gains little on matrices of this size, and costs many times as much where another job has a core.
@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose(
    recording: Recording,
    arm: Arm | None = None,
    *,
    geometry: Geometry = "declared",
    effects: Sequence[Effect] = (),
    progress: Callable[[int], object] | None = None,
) -> Diagnosis:
    """Locates, names, models and verifies what a recording shows that the arm's model does not have.

    Args:
        recording: measured poses.
        arm: the nominal arm; from the sidecar where not given.
        geometry: what is known of it, as in `fit`.
        effects: a user's own, tested for like the catalogue's.
        progress: called with 1 for each of the `FOLDS` + 1 searches.

    Raises:
        InputError: as `examine` and `case_of`.
    """
    explanation = explain(recording, arm, geometry, effects)
    examined, search, selection = explanation.examined, explanation.search, explanation.selection
    selection = stated(selection)
    recording = examined.recording
    case = search.case
    if progress:
        progress(1)
    outliers = (selection.fitted.residual.squares > _OUTLIER * case.rows) | ~case.seen
    before, after = np.zeros(case.samples), np.zeros(case.samples)
    for held in recording.contiguous_folds(min(FOLDS, max(2, case.samples // 10))):
        part = search.run(~held)
        for errors, seen, fitted in ((before, part.plain, part.baseline), (after, case, part.fitted)):
            missed = seen.position_errors(fitted.moved, fitted.physics, fitted.values)
            errors[held] = np.sqrt(np.sum(missed**2, 0))[held]
        if progress:
            progress(1)
    return Diagnosis(
        case,
        selection,
        before,
        after,
        outliers,
        search.missing,
        (*examined.faults, *_unseen(case)),
        examined.checked,
        separations(selection, geometry),
    )


def statement(effect: Effect, parameters: dict[str, dict[str, float]]) -> str:
    """One sentence a person understands."""
    shown = ", ".join(
        f"{name} {entry['value']:.4g} ± {entry['std']:.1g}" for name, entry in list(parameters.items())[:3]
    )
    driver = " and ".join(d.phrase for d in effect.drivers)
    if isinstance(effect, Unnamed):
        driver += " and of its past" if effect.memory else ""
        return f"Something real at {effect.site}, a function of {driver}, that no entry of the catalogue explains."
    return (
        f"{effect.name.replace('_', ' ').capitalize()} at {effect.site}{f', by {driver}' if driver else ''}: {shown}."
    )


def _unseen(case: Case) -> tuple[Fault, ...]:
    if case.seen.all():
        return ()
    rows = tuple(int(row) for row in case.recording.row[~case.seen])
    return (
        Fault(
            "no_joints",
            rows,
            f"{len(rows)} rows are left out: the clocks differ by {case.clock:.4g} s, and what the joints did at the "
            "instants that these poses show was not recorded. Let the joints' recording start earlier and end later.",
        ),
    )


def _summary(errors: Array) -> dict[str, float]:
    if not errors.size:
        return dict.fromkeys(("heldout_position_rms_m", "heldout_position_p95_m", "heldout_position_max_m"), 0.0)
    return {
        "heldout_position_rms_m": float(np.sqrt(np.mean(errors**2))),
        "heldout_position_p95_m": float(np.percentile(errors, 95)),
        "heldout_position_max_m": float(errors.max()),
    }
