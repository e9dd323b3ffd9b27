"""The JSON of a diagnosis of torques: codes and plain numbers in SI units. Only this module writes and reads it."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import DRIVE_FIELDS, Arm
from lite6jax.arms.joint_units import by_kind
from lite6jax.diagnosis.document import DAMAGED, SCHEMA, check_sum, located, parsed_document
from lite6jax.diagnosis.folds import block_count
from lite6jax.diagnosis.result import Finding, Rival
from lite6jax.diagnosis.schema import check_effect
from lite6jax.diagnosis.stored_uncertainty import covariance_from, drivers_from, lower_triangle
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.diagnosis.torque_schema import RANGES, check_torques
from lite6jax.domains.torque.description import Description, described
from lite6jax.domains.torque.predict import DiagnosedMotors
from lite6jax.domains.torque.uncertainty import RecordedMotion, TorqueUncertainty, with_free_numbers
from lite6jax.effects.dynamic.catalogue import torque_kinds_of
from lite6jax.effects.dynamic.unnamed import UnnamedTorque
from lite6jax.effects.effect import Effect, require_kind, slides
from lite6jax.effects.serialization import effect_as_dict, effect_from_dict
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms, join

Array = NDArray[np.floating]


def to_torque_document(found: TorqueDiagnosis) -> dict[str, Any]:
    """The whole diagnosis as values that JSON can hold."""
    problem, kept = found.problem, found.problem.valid
    data, chosen = problem.data, problem.data.filter
    raw = problem.noise * np.sqrt(chosen.every)
    nearest = found.nearest
    return {
        "schema": SCHEMA,
        "domain": "torque",
        "verdict": found.verdict,
        "before": _summary(found.before[:, kept], data.arm.slides),
        "after": _summary(found.after[:, kept], data.arm.slides),
        "left": {
            "torque_over_noise": None if found.over_noise is None else found.over_noise.tolist(),
            "white": found.fit.noise.white,
        },
        "withdrawn": [located(finding.effect) for finding in found.withdrawn],
        "samples": data.recording.samples,
        "kept_samples": int(kept.sum()),
        "heldout_blocks": block_count(found.folds),
        "searched_again": None if found.searched_again is None else found.searched_again.to_dict(),
        "quick": found.options.quick,
        "filter": None
        if data.recording.motion == "static"
        else {
            "rate_Hz": chosen.rate,
            "cutoff_Hz": chosen.cutoff,
            "motion_cutoff_Hz": data.motion_cutoff,
            "every": chosen.every,
        },
        "noise": {
            "declared_torque_Nm": raw.tolist() if problem.declared else None,
            "estimated_torque_Nm": (raw * found.fit.scale).tolist(),
        },
        "torque_source": data.recording.settings.torque_source,
        "date": data.recording.settings.date,
        "instrument": data.recording.settings.instrument,
        "data_faults": [fault.to_dict() for fault in found.faults],
        "ruled_out": [fault.to_dict() for fault in found.ruled_out],
        "findings": [_finding(found, k) for k in range(len(found.findings))],
        "nearest": None
        if nearest is None
        else {"effect": nearest[0].name, "site": nearest[0].site, "p_value": nearest[1]},
        "untestable": [
            {"effect": item.effect.name, "site": item.effect.site, "driver": item.driver.phrase}
            for item in found.untestable
        ],
        "confounded": [located(effect) for effect in found.confounded],
        "nuisance": {"numbers": len(problem.precision), "relative_std": problem.relative_std},
        "model": _model(found),
    }


_STATISTICS: Mapping[str, Callable[[Array], Any]] = {
    "mean": lambda size: size.mean() if size.size else 0.0,
    "rms": lambda size: np.sqrt(np.mean(size**2)) if size.size else 0.0,
    "p95": lambda size: np.percentile(size, 95) if size.size else 0.0,
    "max": lambda size: size.max(initial=0.0),
}


def _summary(errors: Array, slides: NDArray[np.bool_]) -> dict[str, Any]:
    """Of errors `(joint, sample)` Nm: over revolute joints, and in N over those that slide."""
    each = [
        by_kind(f"heldout_torque_{name}_Nm", np.abs(errors), slides, statistic)
        for name, statistic in _STATISTICS.items()
    ]
    whole = {key: value for kinds in each for key, value in kinds.items()}
    return {**whole, "heldout_torque_rms_by_joint_Nm": np.sqrt(np.mean(errors**2, 1)).tolist()}


def _finding(found: TorqueDiagnosis, k: int) -> dict[str, Any]:
    finding, part = found.findings[k], found.fit.terms.slices[k]
    columns = found.problem.columns([finding.effect], finding.values, (found.fit.terms, found.fit.values))
    moved = np.tensordot(found.fit.values[part], columns, 1) * found.problem.sigma
    acts, slides = np.abs(moved).max(1) > 0, found.problem.data.arm.slides
    where = acts if acts.any() else np.ones_like(acts)
    size: dict[str, Any] = {}
    if isinstance(finding.effect, UnnamedTorque):
        size[finding.effect.own("peak_to_peak_Nm")] = float(np.ptp(moved, axis=1).max())
        description = described(found.problem, finding.effect.joint, moved)
        size |= {} if description is None else {"described_by": _description(description)}
    if finding.nearest is not None:
        rival, share = finding.nearest
        size["nearest"] = {**located(rival.effect), "share": share}
    return {
        **located(finding.effect),
        "parameters": {name: estimate._asdict() for name, estimate in finding.parameters.items()},
        **size,
        "p_value": finding.p_value,
        "log_likelihood_gain": finding.gain,
        **by_kind("moves_rms_Nm", moved[where], slides[where], lambda torque: np.sqrt(np.mean(torque**2))),
        "joints": (1 + np.flatnonzero(acts)).tolist(),
        "confusable_with": [_rival(found, rival) for rival in _near(found, finding)],
    }


def _description(found: Description) -> dict[str, Any]:
    named = [
        {**located(effect), "parameters": {effect.coordinates[0].name: float(value)}}
        for effect, value in zip(found.effects, found.values, strict=True)
    ]
    return {"share": found.share, "effects": named}


def _near(found: TorqueDiagnosis, finding: Finding) -> list[Rival]:
    """The rivals that the model does not have, the nearest first."""
    others = [rival for rival in finding.rivals if rival.effect not in found.fit.terms.terms]
    return sorted(others, key=lambda rival: rival.gap)


def _rival(found: TorqueDiagnosis, rival: Rival) -> dict[str, Any]:
    repeats = "period_m" if slides(rival.effect) else "order"
    numbers = {key: getattr(rival.effect, key, None) for key in (repeats, "source_joint")}
    known = {key: value for key, value in numbers.items() if value is not None}
    status = "rejected" if rival.gap >= found.options.engine.close else "undecided"
    return {**located(rival.effect), **known, "log_likelihood_gap": rival.gap, "status": status}


def _model(found: TorqueDiagnosis) -> dict[str, Any]:
    model = found.model
    declared = {field: getattr(model.arm, field) for field in DRIVE_FIELDS}
    drives = {field: values.tolist() for field, values in declared.items() if values is not None}
    return {
        "domain": "torque",
        "arm": model.arm.name,
        "kinematics": model.arm.kinematics.tolist(),
        "T_joint_flange": model.arm.T_joint_flange.tolist(),
        "links": model.links.tolist(),
        **({"drives": drives} if drives else {}),
        **({"prismatic_joints": [joint + 1 for joint in model.arm.sliding]} if model.arm.sliding else {}),
        "payload_center": model.payload_center.tolist(),
        "gravity": model.gravity.tolist(),
        "joint_limits": model.arm.joint_limits.tolist(),
        "reference_temperature_degC": model.reference_temperature,
        "effects": [effect_as_dict(f.effect, f.values, f.covariance) for f in found.findings],
        "uncertainty": None if model.uncertainty is None else _uncertainty(model.uncertainty),
    }


def _uncertainty(known: TorqueUncertainty) -> dict[str, Any]:
    recorded = known.recorded
    return {
        "inertial": known.inertial,
        "covariance": lower_triangle(known.covariance),
        "left_Nm": known.left.tolist(),
        "unseen_Nm": known.unseen.tolist(),
        "noise_Nm": known.noise.tolist(),
        "curves_Nm": list(known.curves),
        "recorded": {
            **{name: part.tolist() for name, part in zip(RANGES, recorded.ranges, strict=True)},
            "joint_position_rad": recorded.positions.tolist(),
            "spacing_rad": recorded.spacing,
            "drivers": {phrase: list(bounds) for phrase, bounds in recorded.drivers.items()},
        },
    }


def read_torque_model(path: str | Path, effects: Sequence[Effect] = ()) -> DiagnosedMotors:
    """The model of the torques in a diagnosis file.

    Args:
        path: what `diagnose` wrote of torques, or of poses and torques.
        effects: a user's own, where the model has them.

    Raises:
        InputError: no such file, not a diagnosis of torques, or something in it is missing or not possible.

    Warns:
        InputWarning: the file was changed after it was written.
    """
    document = parsed_document(path)
    model = torque_model_from_document(document, effects, str(path))
    check_sum(document, path)
    return model


def check_torque_document(document: Any, path: str | Path) -> None:
    """Refuses what holds no whole diagnosis of torques, for a report; effects of a user's own are not needed.

    Args:
        document: of torques, or of poses and torques, as JSON holds it.
        path: what messages begin with.

    Raises:
        InputError: not a diagnosis of torques, or something in it is missing or not possible.
    """
    torques = _required(document, str(path))
    try:
        check_torques(torques)
    except InputError as error:
        raise InputError(f"{path}: is damaged ({error}); {DAMAGED}") from error


def torque_model_from_document(
    document: Any, effects: Sequence[Effect] = (), source: str = "diagnosis"
) -> DiagnosedMotors:
    """The model in a diagnosis of torques, or of poses and torques, as JSON holds it.

    Args:
        document: all of it.
        effects: a user's own, where the model has them.
        source: what messages begin with.

    Raises:
        InputError: not a diagnosis of torques, or something in it is missing or not possible.
    """
    document = _required(document, source)
    model: Mapping[str, Any] = document["model"]
    try:
        check_torques(document)
        drives: dict[str, Any] = {field: np.asarray(row, float) for field, row in model.get("drives", {}).items()}
        arm = Arm(
            model["arm"],
            np.asarray(model["kinematics"], float),
            joint_limits=np.asarray(model["joint_limits"], float),
            T_joint_flange=np.asarray(model["T_joint_flange"], float),
            sliding=tuple(joint - 1 for joint in model.get("prismatic_joints", ())),
            **drives,
        )
        links = np.asarray(model["links"], float)
        if links.shape != (arm.dof, 10):
            raise InputError(f"it has {arm.dof} joints, but links of the shape {links.shape}")
        pairs = [effect_from_dict(entry, torque_kinds_of(effects)) for entry in model["effects"]]
        for effect, values in pairs:
            check_effect(effect, values, arm.dof)
            require_kind(effect, arm.sliding)
        terms, values = Terms(tuple(effect for effect, _ in pairs)), join(values for _, values in pairs)
        uncertainty = _uncertainty_from(model.get("uncertainty"), terms, values, arm.dof)
    except (InputError, KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{source}: its model is damaged ({error}); {DAMAGED}") from error
    return DiagnosedMotors(
        arm=arm,
        links=links,
        payload_center=np.asarray(model["payload_center"], float),
        gravity=np.asarray(model["gravity"], float),
        terms=terms,
        values=values,
        reference_temperature=float(model["reference_temperature_degC"]),
        relative_to=_relative_to(document),
        uncertainty=uncertainty,
    )


def _required(document: Any, source: str) -> dict[str, Any]:
    torques = of_torques(document)
    if torques is None:
        raise InputError(f"{source}: is no diagnosis of torques; give what `lite6jax diagnose --out` wrote of one")
    return torques


def _relative_to(document: Mapping[str, Any]) -> str | None:
    against = document.get("against", {})
    return against["file"] if against.get("by") == "rows" else None


def _uncertainty_from(entry: Any, terms: Terms, values: Array, joints: int) -> TorqueUncertainty | None:
    """The inverse of `_uncertainty`, checked; None of a document without it."""
    if entry is None:
        return None
    C = covariance_from(entry["covariance"], 10 * joints * entry["inertial"] + with_free_numbers(terms, values)[0].size)
    left, unseen, noise = (np.asarray(entry[f"{name}_Nm"], float) for name in ("left", "unseen", "noise"))
    recorded, curves = entry["recorded"], tuple(entry["curves_Nm"])
    ranges = np.asarray([recorded[name] for name in RANGES], float)
    positions = np.asarray(recorded["joint_position_rad"], float)
    whole = ranges.shape == (3, joints, 2) and positions.ndim == 2 and positions.shape[1] == joints and len(positions)
    if not whole or any(part.shape != (joints,) for part in (left, unseen, noise)):
        raise ValueError("its uncertainty is not one of this arm")
    if len(curves) != len(terms.terms):
        raise ValueError("its curves are not one for each effect")
    motion = RecordedMotion(ranges, positions, float(recorded["spacing_rad"]), drivers_from(recorded, ranges))
    return TorqueUncertainty(entry["inertial"], C, left, unseen, noise, curves, motion)


def is_of_torques(document: Any) -> bool:
    """Whether a document is a diagnosis of torques alone."""
    return (
        isinstance(document, dict)
        and document.get("schema") == SCHEMA
        and document.get("domain") == "torque"
        and isinstance(document.get("model"), dict)
    )


def of_torques(document: Any) -> dict[str, Any] | None:
    """The diagnosis of torques that a document is, or that stands in one of poses; None where there is none."""
    if is_of_torques(document):
        return document
    inside = document.get("torques") if isinstance(document, dict) else None
    return inside if is_of_torques(inside) else None
