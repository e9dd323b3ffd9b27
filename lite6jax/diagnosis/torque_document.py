"""The JSON of a diagnosis of torques: codes and plain numbers in SI units. Only this module writes and reads it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lite6jax import checksum
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import LARGEST_MASS
from lite6jax.arms.entries import ANGLE_LIMIT, LENGTH_LIMIT
from lite6jax.diagnosis.document import DAMAGED, SCHEMA, check_sum, located, parsed_document
from lite6jax.diagnosis.heldout import fold_count
from lite6jax.diagnosis.result import Finding, Rival
from lite6jax.diagnosis.schema import FARTHEST, INPUTS, check_effect
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.domains.torque.predict import DiagnosedMotors
from lite6jax.effects.dynamic.catalogue import BUILT_IN
from lite6jax.effects.dynamic.unnamed import UnnamedTorque
from lite6jax.effects.serialization import effect_as_dict, effect_from_dict
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms, join
from lite6jax.recordings.settings import HIGHEST_TEMPERATURE, LARGEST_GRAVITY
from lite6jax.schema import array, flag, items, mapping, number, one_of, optional, plain, record, text, whole

Array = NDArray[np.floating]

_LARGEST_MOMENT = LARGEST_MASS * LENGTH_LIMIT
_POSITIVE = number(0.0)
_BY_JOINT = array(None, lower=0.0)
_ERRORS = record(
    {
        "heldout_torque_rms_Nm": _POSITIVE,
        "heldout_torque_p95_Nm": _POSITIVE,
        "heldout_torque_max_Nm": _POSITIVE,
        "heldout_torque_rms_by_joint_Nm": _BY_JOINT,
    },
    {"heldout_torque_mean_Nm": _POSITIVE},
)
_PLACE = {"effect": text, "site": text, "driver": text}
_RIVAL = record(
    {**_PLACE, "log_likelihood_gap": number(), "status": text}, {"source_joint": whole(1), "order": number()}
)
_FINDING = record(
    {
        **_PLACE,
        "parameters": mapping(record({"value": number(), "std": _POSITIVE})),
        "p_value": number(0.0, 1.0),
        "log_likelihood_gain": number(),
        "moves_rms_Nm": _POSITIVE,
        "confusable_with": items(_RIVAL),
    },
    {
        "nearest": record({**_PLACE, "share": number(0.0, 1.0)}),
        "statement": text,
        "peak_to_peak_Nm": _POSITIVE,
        "joints": items(whole(1)),
    },
)
_FAULT = record({"fault": text, "rows": items(whole(1)), "numbers": plain}, {"statement": text})
PARTS = {
    "schema": text,
    "domain": one_of("torque"),
    "verdict": one_of("consistent", "explained", "partly_explained", "unnamed", "unexplained", "undetermined"),
    "before": _ERRORS,
    "after": _ERRORS,
    "left": record({"torque_over_noise": optional(_BY_JOINT), "white": flag}),
    "withdrawn": items(record(_PLACE)),
    "samples": whole(1),
    "kept_samples": whole(1),
    "heldout_blocks": whole(1),
    "quick": flag,
    "inputs": INPUTS,
    "filter": record({"rate_Hz": _POSITIVE, "cutoff_Hz": _POSITIVE, "motion_cutoff_Hz": _POSITIVE, "every": whole(1)}),
    "noise": record({"declared_torque_Nm": optional(_BY_JOINT), "estimated_torque_Nm": _BY_JOINT}),
    "torque_source": text,
    "data_faults": items(_FAULT),
    "ruled_out": items(_FAULT),
    "findings": items(_FINDING),
    "nearest": optional(record({"effect": text, "site": text, "p_value": number(0.0, 1.0)})),
    "untestable": items(record(_PLACE, {"reason": text})),
    "confounded": items(record(_PLACE)),
    "nuisance": record({"numbers": whole(0), "relative_std": optional(_POSITIVE)}),
    checksum.KEY: text,
}
_MODEL = record(
    {
        "domain": one_of("torque"),
        "arm": text,
        "kinematics": array(None, 6, lower=-max(LENGTH_LIMIT, ANGLE_LIMIT), upper=max(LENGTH_LIMIT, ANGLE_LIMIT)),
        "T_joint_flange": array(4, 4, lower=-FARTHEST, upper=FARTHEST),
        "links": array(None, 10, lower=-_LARGEST_MOMENT, upper=_LARGEST_MOMENT),
        "payload_center": array(3, lower=-LENGTH_LIMIT, upper=LENGTH_LIMIT),
        "gravity": array(3, lower=-LARGEST_GRAVITY, upper=LARGEST_GRAVITY),
        "joint_limits": array(None, 2, lower=-FARTHEST, upper=FARTHEST),
        "reference_temperature_degC": number(-273.15, HIGHEST_TEMPERATURE),
        "effects": items(plain),
    }
)


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
        "before": _summary(found.before[:, kept]),
        "after": _summary(found.after[:, kept]),
        "left": {
            "torque_over_noise": None if found.over_noise is None else found.over_noise.tolist(),
            "white": found.fit.noise.white,
        },
        "withdrawn": [located(finding.effect) for finding in found.withdrawn],
        "samples": data.recording.samples,
        "kept_samples": int(kept.sum()),
        "heldout_blocks": fold_count(problem.samples, found.options),
        "quick": found.options.quick,
        "filter": {
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


def _summary(errors: Array) -> dict[str, Any]:
    """Of errors `(joint, sample)` Nm."""
    size = np.abs(errors)
    return {
        "heldout_torque_mean_Nm": float(size.mean()) if errors.size else 0.0,
        "heldout_torque_rms_Nm": float(np.sqrt(np.mean(errors**2))) if errors.size else 0.0,
        "heldout_torque_p95_Nm": float(np.percentile(size, 95)) if errors.size else 0.0,
        "heldout_torque_max_Nm": float(size.max(initial=0.0)),
        "heldout_torque_rms_by_joint_Nm": np.sqrt(np.mean(errors**2, 1)).tolist(),
    }


def _finding(found: TorqueDiagnosis, k: int) -> dict[str, Any]:
    finding, part = found.findings[k], found.fit.terms.slices[k]
    columns = found.problem.columns([finding.effect], finding.values, (found.fit.terms, found.fit.values))
    moved = np.tensordot(found.fit.values[part], columns, 1) * found.problem.noise[:, None]
    acts = np.abs(moved).max(1) > 0
    size: dict[str, Any] = {}
    if isinstance(finding.effect, UnnamedTorque):
        size["peak_to_peak_Nm"] = float(np.ptp(moved, axis=1).max())
    if finding.nearest is not None:
        rival, share = finding.nearest
        size["nearest"] = {**located(rival.effect), "share": share}
    return {
        **located(finding.effect),
        "parameters": {name: estimate._asdict() for name, estimate in finding.parameters.items()},
        **size,
        "p_value": finding.p_value,
        "log_likelihood_gain": finding.gain,
        "moves_rms_Nm": float(np.sqrt(np.mean(moved[acts] ** 2))) if acts.any() else 0.0,
        "joints": (1 + np.flatnonzero(acts)).tolist(),
        "confusable_with": [_rival(found, rival) for rival in _near(found, finding)],
    }


def _near(found: TorqueDiagnosis, finding: Finding) -> list[Rival]:
    """The rivals at other sites or of other names, the nearest first."""
    others = [rival for rival in finding.rivals if rival.effect not in found.fit.terms.terms]
    return sorted(others, key=lambda rival: rival.gap)


def _rival(found: TorqueDiagnosis, rival: Rival) -> dict[str, Any]:
    numbers = {key: getattr(rival.effect, key) for key in ("order", "source_joint") if hasattr(rival.effect, key)}
    known = {key: value for key, value in numbers.items() if value is not None}
    status = "rejected" if rival.gap >= found.options.engine.close else "undecided"
    return {**located(rival.effect), **known, "log_likelihood_gap": rival.gap, "status": status}


def _model(found: TorqueDiagnosis) -> dict[str, Any]:
    model = found.model
    return {
        "domain": "torque",
        "arm": model.arm.name,
        "kinematics": model.arm.kinematics.tolist(),
        "T_joint_flange": model.arm.T_joint_flange.tolist(),
        "links": model.links.tolist(),
        "payload_center": model.payload_center.tolist(),
        "gravity": model.gravity.tolist(),
        "joint_limits": model.arm.joint_limits.tolist(),
        "reference_temperature_degC": model.reference_temperature,
        "effects": [effect_as_dict(f.effect, f.values, f.covariance) for f in found.findings],
    }


def read_torque_model(path: str | Path) -> DiagnosedMotors:
    """The model in a file of a diagnosis of torques.

    Raises:
        InputError: no such file, not a diagnosis of torques, or something in it is missing or not possible.

    Warns:
        InputWarning: the file was changed after it was written.
    """
    document = parsed_document(path)
    model = torque_model_from_document(document, str(path))
    check_sum(document, path)
    return model


def read_torque_document(path: str | Path) -> dict[str, Any]:
    """A whole diagnosis of torques, for a report.

    Raises:
        InputError: as `read_torque_model`.

    Warns:
        InputWarning: as `read_torque_model`.
    """
    document = parsed_document(path)
    torque_model_from_document(document, str(path))
    check_sum(document, path)
    return document


def torque_model_from_document(document: Any, source: str = "diagnosis") -> DiagnosedMotors:
    """The model in a diagnosis of torques, as JSON holds it.

    Raises:
        InputError: not a diagnosis of torques, or something in it is missing or not possible.
    """
    if not is_of_torques(document):
        raise InputError(f"{source}: is no diagnosis of torques; give what `lite6jax diagnose --out` wrote of one")
    model: Mapping[str, Any] = document["model"]
    try:
        for key, value in document.items():
            if key != "model":
                if key not in PARTS:
                    raise InputError(f"the key {key!r} is unknown")
                PARTS[key](value, key)
        _MODEL(model, "model")
        arm = Arm(
            model["arm"],
            np.asarray(model["kinematics"], float),
            joint_limits=np.asarray(model["joint_limits"], float),
            T_joint_flange=np.asarray(model["T_joint_flange"], float),
        )
        links = np.asarray(model["links"], float)
        if links.shape != (arm.dof, 10):
            raise InputError(f"it has {arm.dof} joints, but links of the shape {links.shape}")
        pairs = [effect_from_dict(entry, BUILT_IN) for entry in model["effects"]]
        for effect, values in pairs:
            check_effect(effect, values, arm.dof)
        rms = [document[part]["heldout_torque_rms_Nm"] for part in ("before", "after")]
    except (InputError, KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{source}: its model is damaged ({error}); {DAMAGED}") from error
    return DiagnosedMotors(
        arm=arm,
        links=links,
        payload_center=np.asarray(model["payload_center"], float),
        gravity=np.asarray(model["gravity"], float),
        terms=Terms(tuple(effect for effect, _ in pairs)),
        values=join(values for _, values in pairs),
        reference_temperature=float(model["reference_temperature_degC"]),
        heldout_rms=(float(rms[0]), float(rms[1])),
    )


def is_of_torques(document: Any) -> bool:
    """Whether a document is a diagnosis of torques."""
    return (
        isinstance(document, dict)
        and document.get("schema") == SCHEMA
        and document.get("domain") == "torque"
        and isinstance(document.get("model"), dict)
    )
