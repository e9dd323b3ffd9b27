"""The JSON of a diagnosis, `lite6jax/diagnosis/2`: codes and plain numbers in SI units; this module writes it.

Reading is `domains.pose.predict.model_from_document`, for the model, of versions 1 and 2. Sentences are
added by the report where a file is written.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lite6jax.diagnosis.discrimination import differ
from lite6jax.diagnosis.evidence_map import peak_to_peak
from lite6jax.diagnosis.result import Diagnosis, Rival
from lite6jax.effects.effect import Effect
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.serialization import effect_as_dict

SCHEMA = "lite6jax/diagnosis/2"


def to_document(found: Diagnosis) -> dict[str, Any]:
    """All that a diagnosis says, as JSON holds it."""
    problem, kept = found.problem, ~found.outliers
    before, after = _summary(found.before[kept]), _summary(found.after[kept])
    heldout = before["heldout_position_rms_m"], after["heldout_position_rms_m"]
    faults = [fault.to_dict() for fault in found.faults]
    wild = found.outliers & problem.valid
    if wild.any():
        faults.append({"fault": "outliers", "rows": problem.recording.row[wild].tolist(), "numbers": {}})
    nearest = found.nearest
    return {
        "schema": SCHEMA,
        "verdict": found.verdict,
        "before": before,
        "after": after,
        "samples": problem.samples,
        "heldout_rows": int(kept.sum()),
        "noise": {
            "declared_position_m": problem.noise[0] if problem.declared else None,
            "estimated_position_m": found.estimated_noise,
        },
        "data_faults": faults,
        "ruled_out": [fault.to_dict() for fault in found.ruled_out],
        "findings": [_finding(found, k, *heldout) for k in range(len(found.findings))],
        "nearest": None
        if nearest is None
        else {"effect": nearest[0].name, "site": nearest[0].site, "p_value": nearest[1]},
        "separating_poses": [
            {"effects": list(item.effects), "joint_position_rad": item.joint_position.tolist()}
            for item in found.separating
        ],
        "untestable": [
            {"effect": item.effect.name, "site": item.effect.site, "driver": item.driver.phrase}
            for item in found.untestable
        ],
        "confounded": [_located(effect) for effect in found.confounded],
        "nuisance": {
            "numbers": len(problem.unknown),
            "parts": list(dict.fromkeys(name for name, _, _ in problem.unknown)),
        },
        "model": _model(found),
    }


def _finding(found: Diagnosis, k: int, before: float, after: float) -> dict[str, Any]:
    finding = found.findings[k]
    effect, size = finding.effect, {}
    if isinstance(effect, Unnamed):
        size = {"peak_to_peak": {f"peak_to_peak_{effect.coordinates[0].unit}": peak_to_peak(found, k)._asdict()}}
    return {
        **_located(effect),
        "parameters": {name: estimate._asdict() for name, estimate in finding.parameters.items()},
        **size,
        "p_value": finding.p_value,
        "log_likelihood_gain": finding.gain,
        "heldout_rms_before_m": before,
        "heldout_rms_after_m": after,
        "confusable_with": [_rival(found, k, rival) for rival in finding.rivals],
    }


def _located(effect: Effect) -> dict[str, Any]:
    return {"effect": effect.name, "site": effect.site, "driver": _driver(effect)}


def _driver(effect: Effect) -> str:
    return " and ".join(driver.phrase for driver in effect.drivers) or "none"


def _rival(found: Diagnosis, k: int, rival: Rival) -> dict[str, Any]:
    """A rival with its status: rejected, itself found, separable by the poses designed, equivalent in such, or open."""
    effect, labels = rival.effect, (found.findings[k].effect.label, rival.effect.label)
    if rival.gap >= found.options.engine.close:
        status = "rejected"
    elif effect in found.fit.terms.terms:
        status = "found"
    elif any(item.effects == labels for item in found.separating):
        status = "separable"
    else:
        status = "undecided" if differ(found.selection, k, effect, found.options) else "equivalent"
    numbers = {key: getattr(effect, key) for key in ("order", "source_joint") if hasattr(effect, key)}
    return {**_located(effect), **numbers, "log_likelihood_gap": rival.gap, "status": status}


def _model(found: Diagnosis) -> dict[str, Any]:
    """All that a prediction needs."""
    problem, fit = found.problem, found.fit
    arm, inertia = problem.displaced(fit.nuisance), problem.inertia
    return {
        "arm": problem.arm.name,
        "kinematics": np.asarray(arm.geometry).reshape(-1, 6).tolist(),
        "T_sensor_base": np.asarray(arm.T_sensor_base).tolist(),
        "T_flange_tool": np.asarray(arm.T_flange_tool).tolist(),
        "joint_limits": problem.arm.joint_limits.tolist(),
        "orientation": problem.rows == 6,
        "inertia": None
        if inertia is None
        else {name: np.asarray(value).tolist() for name, value in inertia._asdict().items()},
        "reference_temperature_degC": problem.recording.settings.reference_temperature_degC,
        "motion": problem.recording.motion,
        "accelerated": found.inertial_loads,
        "effects": [effect_as_dict(f.effect, f.values, f.covariance) for f in found.findings],
    }


def _summary(errors: NDArray[np.floating]) -> dict[str, float]:
    names = ("heldout_position_rms_m", "heldout_position_p95_m", "heldout_position_max_m")
    if not errors.size:
        return dict.fromkeys(names, 0.0)
    values = (np.sqrt(np.mean(errors**2)), np.percentile(errors, 95), errors.max())
    return dict(zip(names, map(float, values), strict=True))
