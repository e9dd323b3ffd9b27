"""The JSON of a diagnosis: codes and plain numbers in SI units. Nothing but this and `stored_uncertainty` writes it.

`lite6jax/diagnosis/2` is written; of version 1 the model is still read. Sentences are added by the report where a file
is written.
"""

import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lite6jax.checksum import KEY, verify, with_checksum
from lite6jax.diagnosis.discrimination import differ
from lite6jax.diagnosis.evidence_map import peak_to_peak
from lite6jax.diagnosis.folds import block_count
from lite6jax.diagnosis.result import Diagnosis, Rival
from lite6jax.diagnosis.schema import check_effect, check_model, check_parts
from lite6jax.diagnosis.stored_uncertainty import uncertainty_as_dict, uncertainty_from_dict
from lite6jax.diagnosis.uncertainty import uncertainty_of
from lite6jax.domains.pose.predict import DiagnosedArm, ReferenceOrigin
from lite6jax.effects.catalogue import kinds_of
from lite6jax.effects.composition import Physics
from lite6jax.effects.effect import Effect, require_kind
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.serialization import effect_as_dict, effect_from_dict
from lite6jax.effects.statics import inertia_of, with_mass_errors
from lite6jax.errors import InputError, InputWarning, command_line, require_type
from lite6jax.estimation.concentration import Concentration
from lite6jax.model import ArmModel
from lite6jax.recordings.sources import recording_file
from lite6jax.schema import RepeatedKeyError, unique_keys
from lite6jax.storage import exists, read_text, write_atomically

Array = NDArray[np.floating]

SCHEMA = "lite6jax/diagnosis/2"
SCHEMAS = (SCHEMA, "lite6jax/diagnosis/1")
"""Those that are read."""
_SIZE_LIMIT = 1 << 26
DAMAGED = "run `lite6jax diagnose` again"


def to_document(found: Diagnosis) -> dict[str, Any]:
    """The whole diagnosis as values that JSON can hold."""
    problem, kept, settings = found.problem, ~found.outliers, found.problem.recording.settings
    turned = (None, None) if found.turned is None else tuple(errors[kept] for errors in found.turned)
    before, after = _summary(found.before[kept], turned[0]), _summary(found.after[kept], turned[1])
    heldout = before["heldout_position_rms_m"], after["heldout_position_rms_m"]
    faults = [fault.to_dict() for fault in found.faults]
    outliers = found.outliers & problem.valid
    if outliers.any():
        faults.append({"fault": "outliers", "rows": problem.recording.row[outliers].tolist(), "numbers": {}})
    nearest = found.nearest
    return {
        "schema": SCHEMA,
        "verdict": found.verdict,
        "before": before,
        "after": after,
        "left": {
            "position_over_noise": found.left.position,
            "orientation_over_noise": found.left.orientation,
            "white": found.left.white,
            "acts_at": _acts_at(found.left.acts_at),
        },
        "quality": found.quality.to_dict(),
        "withdrawn": _withdrawn(found),
        "rows_needed": found.rows_needed if found.verdict == "undetermined" else None,
        "samples": problem.samples,
        "left_out": problem.recording.row[found.left_out].tolist(),
        "heldout_rows": int(kept.sum()),
        "heldout_blocks": block_count(found.folds),
        "searched_again": None if found.searched_again is None else found.searched_again.to_dict(),
        "quick": found.options.quick,
        "pose_source": settings.pose_source,
        "date": settings.date,
        "instrument": settings.instrument,
        "noise": {
            "declared_position_m": problem.declared_noise[0],
            "declared_orientation_rad": problem.declared_noise[1],
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
        "confounded": [located(effect) for effect in found.confounded],
        "nuisance": {
            "numbers": len(problem.frames),
            "parts": list(dict.fromkeys(name for name, _, _ in problem.frames)),
        },
        "model": _model(found),
    }


def _acts_at(where: Concentration | None) -> dict[str, Any] | None:
    return None if where is None else {"site": where.site, "share": where.share, "share_of_noise": where.expected}


def _withdrawn(found: Diagnosis) -> dict[str, Any] | None:
    if found.withdrawn is None:
        return None
    return {
        "effects": [located(finding.effect) for finding in found.withdrawn.findings],
        "heldout_position_rms_m": {"before": found.withdrawn.before, "after": found.withdrawn.after},
    }


def _finding(found: Diagnosis, k: int, before: float, after: float) -> dict[str, Any]:
    finding = found.findings[k]
    effect, size = finding.effect, {}
    if isinstance(effect, Unnamed):
        size = {"peak_to_peak": _peak_to_peak(found, k, effect), "effective_parameters": finding.effective_parameters}
    if finding.nearest is not None:
        rival, share = finding.nearest
        size |= {"nearest": {**located(rival.effect), "share": share}}
    if finding.input_share:
        size |= {"payload_share": finding.input_share}
    return {
        **located(effect),
        "parameters": {name: estimate._asdict() for name, estimate in finding.parameters.items()},
        **size,
        "p_value": finding.p_value,
        "log_likelihood_gain": finding.gain,
        "moves_rms_m": found.moves[k].position,
        "moves_rms_rad": found.moves[k].orientation,
        "heldout_rms_before_m": before,
        "heldout_rms_after_m": after,
        "confusable_with": [_rival(found, k, rival) for rival in finding.rivals],
    }


def _peak_to_peak(found: Diagnosis, k: int, effect: Unnamed) -> dict[str, dict[str, float]]:
    sizes: dict[str, dict[str, float]] = {}
    for i, name in enumerate(effect.components):
        unit = effect.coordinates[effect.part(i).start].unit
        end = name if unit == "1" else unit if len(effect.components) == 1 else f"{name}_{unit}"
        sizes[f"peak_to_peak_{end}"] = peak_to_peak(found, k, i)._asdict()
    return sizes


def located(effect: Effect) -> dict[str, Any]:
    return {"effect": effect.name, "site": effect.site, "driver": _driver(effect)}


def _driver(effect: Effect) -> str:
    return " and ".join(driver.phrase for driver in effect.drivers) or "none"


def _rival(found: Diagnosis, k: int, rival: Rival) -> dict[str, Any]:
    """A rival with its status: rejected, found itself, separable by the designed poses, undecided, or equivalent."""
    effect, labels = rival.effect, (found.findings[k].effect.label, rival.effect.label)
    if rival.gap >= found.options.engine.close:
        status = "rejected"
    elif effect in found.fit.terms.terms:
        status = "found"
    elif any(item.effects == labels for item in found.separating):
        status = "separable"
    elif effect.periodic and labels[0] == labels[1]:
        status = "undecided"  # another order of the same wave
    else:
        status = "undecided" if differ(found.selection, k, effect, found.options) else "equivalent"
    numbers = {key: getattr(effect, key) for key in ("order", "source_joint") if hasattr(effect, key)}
    return {**located(effect), **numbers, "log_likelihood_gap": rival.gap, "status": status}


def _model(found: Diagnosis) -> dict[str, Any]:
    """All that a prediction needs."""
    problem, fit = found.problem, found.fit
    arm, inertia, errors = problem.displaced(fit.nuisance), problem.inertia, problem.mass_errors(fit.nuisance)
    if inertia is not None and errors is not None:
        inertia = with_mass_errors(inertia, errors.links, errors.payload)
    physics = Physics(tuple(finding.effect for finding in found.findings))
    model = DiagnosedArm(
        model=arm,
        values=physics.join([finding.values for finding in found.findings]),
        inertia=inertia,
        joint_limits=None,
        arm=problem.arm.name,
        physics=physics,
        sliding=problem.arm.sliding,
    )
    prismatic = {"prismatic_joints": [joint + 1 for joint in model.sliding]} if model.sliding else {}
    return {
        "arm": problem.arm.name,
        "kinematics": np.asarray(arm.geometry).reshape(-1, 6).tolist(),
        **prismatic,
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
        "uncertainty": uncertainty_as_dict(uncertainty_of(found, model)),
    }


def _summary(errors: Array, turned: Array | None) -> dict[str, float]:
    """Of errors `(sample,)` m of positions and rad of orientations, where these were measured."""
    found = {}
    for name, unit, values in (("position", "m", errors), ("orientation", "rad", turned)):
        if values is not None:
            there = values if values.size else np.zeros(1)
            found[f"heldout_{name}_mean_{unit}"] = float(there.mean())
            found[f"heldout_{name}_rms_{unit}"] = float(np.sqrt(np.mean(there**2)))
            found[f"heldout_{name}_p95_{unit}"] = float(np.percentile(there, 95))
            found[f"heldout_{name}_max_{unit}"] = float(there.max())
    return found


def write_document(document: Mapping[str, Any], path: str | Path, overwrite: bool = False) -> Path:
    """Writes a document, with or without sentences, and its checksum.

    Raises:
        InputError: as `write_atomically`.
    """
    return write_atomically(path, document_text(document), overwrite)


def document_text(document: Mapping[str, Any]) -> str:
    """The text of a diagnosis file: the document with its checksum."""
    return _laid_out(with_checksum(document), "\n")


def _laid_out(value: Any, line: str) -> str:
    """A value of JSON, with a line for each entry of objects and lists, but one line for a list of numbers.

    A covariance is then a line for each of its rows, where `json` with an indent takes one for each of its numbers.

    Args:
        value: what `json` can write.
        line: what begins a line of the surrounding object or list.
    """
    if isinstance(value, dict) and value:
        entries = [f"{json.dumps(name)}: {_laid_out(entry, line + ' ')}" for name, entry in value.items()]
    elif isinstance(value, list | tuple) and any(isinstance(entry, dict | list | tuple) for entry in value):
        entries = [_laid_out(entry, line + " ") for entry in value]
    else:
        return json.dumps(value, allow_nan=False)
    first, last = "{}" if isinstance(value, dict) else "[]"
    return first + ",".join(f"{line} {entry}" for entry in entries) + line + last


def check_document(document: Any, path: str | Path) -> None:
    """Refuses what is no whole diagnosis of poses, for a report; effects of a user's own are not needed.

    Args:
        document: all of it, as JSON holds it.
        path: what messages begin with.

    Raises:
        InputError: not a diagnosis of this version, or something in it is missing or not possible.
    """
    if (
        not isinstance(document, dict)
        or document.get("schema") != SCHEMA
        or not isinstance(document.get("model"), dict)
    ):
        raise InputError(f"{path}: is no diagnosis ({SCHEMA}); give what `lite6jax diagnose --out` wrote")
    try:
        check_parts(document)
        check_model(document["model"])
    except InputError as error:
        raise InputError(f"{path}: is damaged ({error}); {DAMAGED}") from error


def read_model(path: str | Path, effects: tuple[Effect, ...] = ()) -> DiagnosedArm:
    """The model in a diagnosis file.

    Args:
        path: what `diagnose` wrote.
        effects: a user's own, where the model has them.

    Raises:
        InputError: no such file, not a diagnosis, or something in it is missing or not possible.

    Warns:
        InputWarning: the file was changed after it was written.
    """
    require_type("path", path, str | Path, "the path of a diagnosis (.json)")
    document = parsed_document(path)
    model = model_from_document(document, effects, str(path))
    check_sum(document, path)
    return model


def parsed_document(path: str | Path) -> Any:
    """A document as JSON holds it.

    Raises:
        InputError: no such file, no JSON, or a recording, with the command that diagnoses it.
    """
    if recording_file(path) is not None and exists(path):
        made = command_line("diagnose", path, "--out", Path(path).with_suffix(".json"))
        raise InputError(f"{path}: is a recording and no diagnosis; give what `{made}` writes")
    try:
        document = json.loads(read_text(path, _SIZE_LIMIT), object_pairs_hook=unique_keys)
    except InputError:
        raise
    except RepeatedKeyError as error:
        raise InputError(f"{path}: the key {error} is given twice; {DAMAGED}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is no JSON ({error}); give what `lite6jax diagnose --out` wrote") from error
    return document


def check_sum(document: Mapping[str, Any], path: str | Path) -> None:
    """Warns of a document that was changed after it was written, or that does not say so."""
    if document.get("schema") == SCHEMA and KEY not in document:
        warnings.warn(
            f"{path}: has no checksum, so that it is not known whether it was edited", InputWarning, stacklevel=3
        )
    verify(document, path)


def model_from_document(document: Any, effects: tuple[Effect, ...] = (), source: str = "diagnosis") -> DiagnosedArm:
    """The model in a diagnosis of version 1 or 2, as JSON holds it.

    Args:
        document: all of it.
        effects: a user's own, where the model has them.
        source: what messages begin with.

    Raises:
        InputError: not a diagnosis, or something in it is missing or not possible.
    """
    if (
        not isinstance(document, dict)
        or document.get("schema") not in SCHEMAS
        or not isinstance(document.get("model"), dict)
    ):
        raise InputError(
            f"{source}: is no diagnosis ({' or '.join(SCHEMAS)} with a model); give what `lite6jax diagnose --out` "
            "wrote"
        )
    model: dict[str, Any] = document["model"]
    try:
        check_parts(document, whole=document["schema"] == SCHEMA)
        check_model(model)
        kinematics = np.asarray(model["kinematics"], float)
        frames = [np.asarray(model[name], float) for name in ("T_sensor_base", "T_flange_tool")]
    except (InputError, KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise InputError(f"{source}: its model is damaged ({error}); {DAMAGED}") from error
    try:
        sliding = tuple(joint - 1 for joint in model.get("prismatic_joints", ()))
        pairs = [effect_from_dict(entry, kinds_of(effects)) for entry in model["effects"]]
        for effect, values in pairs:
            check_effect(effect, values, len(kinematics))
            require_kind(effect, sliding)
        physics = Physics(tuple(effect for effect, _ in pairs))
        masses = model["inertia"]
        inertia = None if masses is None else inertia_of(**{k: np.asarray(v, float) for k, v in masses.items()})
        if inertia is not None and len(inertia.mass) != len(kinematics):
            raise ValueError(f"it has {len(kinematics)} joints, but {len(inertia.mass)} masses")
        return DiagnosedArm(
            arm=model["arm"],
            model=ArmModel(kinematics.ravel(), *frames),  # type: ignore[arg-type]
            physics=physics,
            values=physics.join([value for _, value in pairs]),
            inertia=inertia,
            joint_limits=_limits(model.get("joint_limits"), len(kinematics)),
            orientation=model["orientation"],
            reference_temperature=float(model["reference_temperature_degC"]),
            motion=model["motion"],
            accelerated=model.get("accelerated", False),
            heldout_rms=_heldout(document),
            reference=_origin(document.get("against")),
            uncertainty=uncertainty_from_dict(model.get("uncertainty"), physics, len(kinematics)),
            sliding=sliding,
        )
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{source}: its model is damaged ({error}); {DAMAGED}") from error


def _limits(limits: Any, joints: int) -> Array | None:
    if limits is None:
        return None
    array = np.asarray(limits, float)
    if array.shape != (joints, 2) or not (array[:, 0] < array[:, 1]).all():
        raise ValueError("joint_limits are not the lower and the upper one of each joint")
    return array


def _heldout(document: Mapping[str, Any]) -> tuple[float, float] | None:
    before, after = (document.get(part, {}).get("heldout_position_rms_m") for part in ("before", "after"))
    return None if before is None or after is None else (float(before), float(after))


def _origin(entry: Mapping[str, Any] | None) -> ReferenceOrigin | None:
    if entry is None:
        return None
    rigid = entry.get("rigid")
    if not isinstance(rigid, bool | None):
        raise ValueError("whether the reference is rigid is neither true nor false")
    return ReferenceOrigin(str(entry.get("file", "")), rigid, str(entry.get("statement", "")))
