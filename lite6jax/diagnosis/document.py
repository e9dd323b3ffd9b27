"""The JSON of a diagnosis: codes and plain numbers in SI units, of poses, of torques, or of both.

`lite6jax/diagnosis/2` is written; of version 1 the model of poses is still read. Sentences are added by the report
where a file is written.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import DRIVE_FIELDS, Arm
from lite6jax.diagnosis.schema import RANGES, TORQUE_DOCUMENT, check_effect, check_poses
from lite6jax.domains.pose.predict import DiagnosedArm, ReferenceOrigin
from lite6jax.domains.torque.predict import DiagnosedMotors, link_sites, with_free_numbers
from lite6jax.domains.uncertainty import RecordedRange, Uncertainty, freed
from lite6jax.effects.catalogue import kinds_of
from lite6jax.effects.composition import Physics
from lite6jax.effects.dynamic.catalogue import torque_kinds_of
from lite6jax.effects.effect import Effect, require_kind
from lite6jax.effects.serialization import effect_as_dict, effect_from_dict
from lite6jax.effects.statics import inertia_of
from lite6jax.errors import InputError, command_line, require_type
from lite6jax.estimation.terms import Terms, join
from lite6jax.model import ArmModel
from lite6jax.recordings.files import recording_file
from lite6jax.schema import RepeatedKeyError, check, unique_keys
from lite6jax.storage import exists, read_text, write_atomically

Array = NDArray[np.floating]

SCHEMA = "lite6jax/diagnosis/2"
SCHEMAS = (SCHEMA, "lite6jax/diagnosis/1")
"""Those that are read."""
DAMAGED = "run `lite6jax diagnose` again"
_SIZE_LIMIT = 1 << 26
_ROUNDING = 1e-9
"""Of the largest covariance, by which rounding may make a variance of zero negative."""
_AXES = ("position_m", "orientation_rad")
_WRONG = (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError)
"""What a damaged document leads to where it is read."""


def effect_entry(effect: Effect) -> dict[str, Any]:
    """Which effect, where, and of what."""
    driver = " and ".join(driver.phrase for driver in effect.drivers) or "none"
    return {"effect": effect.name, "site": effect.site, "driver": driver}


# ------------------------------------------------------------------ models as values of JSON


def pose_model_entry(model: DiagnosedArm, covariances: Sequence[Array]) -> dict[str, Any]:
    """A model of poses as values that JSON can hold.

    Args:
        model: all that a prediction needs.
        covariances: of the numbers of each effect.
    """
    pairs = zip(model.physics.effects, model.physics.slices, covariances, strict=True)
    limits, known = model.joint_limits, model.uncertainty
    uncertainty = None
    if known is not None:
        left, unseen, noise = (_per_axis(part) for part in (known.left, known.unseen, known.noise))
        uncertainty = {
            "sites": [list(site) for site in known.sites],
            "covariance": _lower_triangle(known.covariance),
            "left": left,
            "unseen": unseen,
            "noise": noise,
            "typical": None if known.typical is None else _per_axis(known.typical),
            "recorded": _recorded_entry(known.recorded),
        }
    return {
        "arm": model.arm,
        "kinematics": np.asarray(model.model.geometry).reshape(-1, 6).tolist(),
        **_prismatic(model.sliding),
        "T_sensor_base": np.asarray(model.model.T_sensor_base).tolist(),
        "T_flange_tool": np.asarray(model.model.T_flange_tool).tolist(),
        "joint_limits": None if limits is None else np.asarray(limits).tolist(),
        "orientation": model.orientation,
        "inertia": None
        if model.inertia is None
        else {name: np.asarray(value).tolist() for name, value in model.inertia._asdict().items()},
        "reference_temperature_degC": model.reference_temperature,
        "motion": model.motion,
        "accelerated": model.accelerated,
        "effects": [effect_as_dict(effect, model.values[part], C) for effect, part, C in pairs],
        "uncertainty": uncertainty,
    }


def torque_model_entry(model: DiagnosedMotors, covariances: Sequence[Array]) -> dict[str, Any]:
    """A model of torques as values that JSON can hold; arguments as of `pose_model_entry`."""
    arm, known = model.arm, model.uncertainty
    declared = {field: getattr(arm, field) for field in DRIVE_FIELDS}
    drives = {field: values.tolist() for field, values in declared.items() if values is not None}
    pairs = zip(model.terms.terms, model.terms.slices, covariances, strict=True)
    uncertainty = None
    if known is not None:
        uncertainty = {
            "inertial": bool(known.sites),
            "covariance": _lower_triangle(known.covariance),
            "left_Nm": np.asarray(known.left).tolist(),
            "unseen_Nm": np.asarray(known.unseen).tolist(),
            "noise_Nm": np.asarray(known.noise).tolist(),
            "recorded": _recorded_entry(known.recorded),
        }
    return {
        "domain": "torque",
        "arm": arm.name,
        "kinematics": arm.kinematics.tolist(),
        "T_joint_flange": arm.T_joint_flange.tolist(),
        "links": model.links.tolist(),
        **({"drives": drives} if drives else {}),
        **_prismatic(arm.sliding),
        "payload_center": model.payload_center.tolist(),
        "gravity": model.gravity.tolist(),
        "joint_limits": arm.joint_limits.tolist(),
        "reference_temperature_degC": model.reference_temperature,
        "effects": [effect_as_dict(effect, model.values[part], C) for effect, part, C in pairs],  # type: ignore[arg-type]
        "uncertainty": uncertainty,
    }


def _prismatic(sliding: Sequence[int]) -> dict[str, Any]:
    return {"prismatic_joints": [joint + 1 for joint in sliding]} if sliding else {}


def _per_axis(std: Sequence[float] | Array) -> dict[str, float]:
    return dict(zip(_AXES, map(float, std), strict=True))


def _lower_triangle(covariance: Array) -> list[float]:
    return covariance[np.tril_indices(len(covariance))].tolist()


def _recorded_entry(recorded: RecordedRange) -> dict[str, Any]:
    ranges = zip(RANGES, (recorded.joints, recorded.velocities, recorded.accelerations), strict=True)
    return {
        **{name: limits.tolist() for name, limits in ranges if limits is not None},
        "joint_position_rad": recorded.positions.tolist(),
        "spacing_rad": recorded.spacing,
        "drivers": {phrase: list(bounds) for phrase, bounds in recorded.drivers.items()},
    }


# ------------------------------------------------------------------ models from values of JSON


def model_from_document(document: Any, effects: Sequence[Effect] = (), source: str = "diagnosis") -> DiagnosedArm:
    """The model in a diagnosis of poses of version 1 or 2, as JSON holds it.

    Args:
        document: all of it.
        effects: a user's own, where the model has them.
        source: what messages begin with.

    Raises:
        InputError: not a diagnosis, or something in it is missing or not possible.
    """
    if not _has_model(document, SCHEMAS):
        raise InputError(
            f"{source}: is no diagnosis ({' or '.join(SCHEMAS)} with a model); give what `lite6jax diagnose --out` "
            "wrote"
        )
    model: dict[str, Any] = document["model"]
    try:
        check_poses(document, whole=document["schema"] == SCHEMA)
    except (InputError, *_WRONG) as error:
        raise InputError(f"{source}: its model is damaged ({error}); {DAMAGED}") from error
    try:
        kinematics = np.asarray(model["kinematics"], float)
        frames = [np.asarray(model[name], float) for name in ("T_sensor_base", "T_flange_tool")]
        joints, sliding = len(kinematics), tuple(joint - 1 for joint in model.get("prismatic_joints", ()))
        found, numbers = _effects(model, kinds_of(effects), joints, sliding)
        physics, masses = Physics(found), model["inertia"]
        inertia = None if masses is None else inertia_of(**{k: np.asarray(v, float) for k, v in masses.items()})
        if inertia is not None and len(inertia.mass) != joints:
            raise ValueError(f"it has {joints} joints, but {len(inertia.mass)} masses")
        limits = model.get("joint_limits")
        if limits is not None:
            limits = np.asarray(limits, float)
            if limits.shape != (joints, 2) or not (limits[:, 0] < limits[:, 1]).all():
                raise ValueError("joint_limits are not the lower and the upper one of each joint")
        rms = [document.get(stage, {}).get("heldout_position_rms_m") for stage in ("before", "after")]
        against = document.get("against")
        if against is not None:
            file, said = (str(against.get(key, "")) for key in ("file", "statement"))
            against = ReferenceOrigin(file, against.get("rigid"), said)
        return DiagnosedArm(
            arm=model["arm"],
            model=ArmModel(kinematics.ravel(), *frames),  # type: ignore[arg-type]
            physics=physics,
            values=physics.join(numbers),
            inertia=inertia,
            joint_limits=limits,
            orientation=model["orientation"],
            reference_temperature=float(model["reference_temperature_degC"]),
            motion=model["motion"],
            accelerated=model.get("accelerated", False),
            heldout_rms=None if None in rms else (float(rms[0]), float(rms[1])),
            reference=against,
            uncertainty=_pose_uncertainty(model.get("uncertainty"), found, joints),
            sliding=sliding,
        )
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    except _WRONG as error:
        raise InputError(f"{source}: its model is damaged ({error}); {DAMAGED}") from error


def torque_model_from_document(
    document: Any, effects: Sequence[Effect] = (), source: str = "diagnosis"
) -> DiagnosedMotors:
    """The model in a diagnosis of torques, or of poses and torques, as JSON holds it; arguments as above.

    Raises:
        InputError: not a diagnosis of torques, or something in it is missing or not possible.
    """
    document = _torques_in(document, source)
    model: Mapping[str, Any] = document["model"]
    try:
        check(document, TORQUE_DOCUMENT)
        drives: dict[str, Any] = {field: np.asarray(row, float) for field, row in model.get("drives", {}).items()}
        arm = Arm(
            model["arm"],
            np.asarray(model["kinematics"], float),
            joint_limits=np.asarray(model["joint_limits"], float),
            T_joint_flange=np.asarray(model["T_joint_flange"], float),
            sliding=tuple(joint - 1 for joint in model.get("prismatic_joints", ())),
            **drives,
        )
        links, against = np.asarray(model["links"], float), document.get("against", {})
        if len(links) != arm.dof:
            raise InputError(f"it has {arm.dof} joints, but links of the shape {links.shape}")
        found, numbers = _effects(model, torque_kinds_of(effects), arm.dof, arm.sliding)
        terms, values = Terms(found), join(numbers)
        return DiagnosedMotors(
            arm=arm,
            links=links,
            payload_center=np.asarray(model["payload_center"], float),
            gravity=np.asarray(model["gravity"], float),
            terms=terms,
            values=values,
            reference_temperature=float(model["reference_temperature_degC"]),
            relative_to=against["file"] if against.get("by") == "rows" else None,
            uncertainty=_torque_uncertainty(model.get("uncertainty"), terms, values, arm.dof),
        )
    except (InputError, *_WRONG) as error:
        raise InputError(f"{source}: its model is damaged ({error}); {DAMAGED}") from error


def _effects(
    model: Mapping[str, Any], kinds: Mapping[str, type[Effect]], joints: int, sliding: tuple[int, ...]
) -> tuple[tuple[Effect, ...], list[Array]]:
    """The effects of a model of so many joints, and their numbers."""
    pairs = [effect_from_dict(entry, kinds) for entry in model["effects"]]
    for effect, values in pairs:
        check_effect(effect, values, joints)
        require_kind(effect, sliding)
    return tuple(effect for effect, _ in pairs), [values for _, values in pairs]


def _pose_uncertainty(entry: Any, effects: Sequence[Effect], joints: int) -> Uncertainty | None:
    """The uncertainty of a model of poses, whose keys and types have been checked; None of a document without it."""
    if entry is None:
        return None
    sites = tuple((name, j, k) for name, j, k in entry["sites"])
    sizes = {"base": (1, 6), "link": (joints, 6), "tool": (1, 6), "mass": (joints, 4), "payload": (1, 1)}
    if any(name not in sizes or not (j < sizes[name][0] and k < sizes[name][1]) for name, j, k in sites):
        raise ValueError("a site of its uncertainty is none of this arm")

    def axes(part: Mapping[str, float] | None) -> Array | None:
        return None if part is None else np.array([part[axis] for axis in _AXES], float)

    left, unseen, noise = (
        np.array([entry[name][axis] for axis in _AXES], float) for name in ("left", "unseen", "noise")
    )
    C = _covariance(entry["covariance"], len(sites) + sum(freed(effect).size for effect in effects))
    recorded, typical = _recorded(entry["recorded"], joints), axes(entry.get("typical"))
    return Uncertainty(sites, C, left, unseen, noise, recorded, typical)


def _torque_uncertainty(entry: Any, terms: Terms, values: Array, joints: int) -> Uncertainty | None:
    """As `_pose_uncertainty`, of a model of torques."""
    if entry is None:
        return None
    sites = link_sites(joints) if entry["inertial"] else ()
    left, unseen, noise = (np.asarray(entry[f"{name}_Nm"], float) for name in ("left", "unseen", "noise"))
    if any(part.shape != (joints,) for part in (left, unseen, noise)):
        raise ValueError("its uncertainty is not one of this arm")
    C = _covariance(entry["covariance"], len(sites) + with_free_numbers(terms, values)[0].size)
    return Uncertainty(sites, C, left, unseen, noise, _recorded(entry["recorded"], joints))


def _covariance(triangle: Any, size: int) -> Array:
    """The covariance `(size, size)` of its lower triangle, row by row."""
    triangle = np.asarray(triangle, float)
    if triangle.shape != (size * (size + 1) // 2,):
        raise ValueError(f"its covariance is not one of {size} numbers")
    C = np.zeros((size, size))
    C[np.tril_indices(size)] = triangle
    if (np.diagonal(C) < -_ROUNDING * np.abs(triangle).max(initial=0.0)).any():
        raise ValueError("a variance of its uncertainty is negative")
    return C + np.tril(C, -1).T


def _recorded(entry: Mapping[str, Any], joints: int) -> RecordedRange:
    """Where a model of so many joints was recorded."""
    ranges = [np.asarray(entry[name], float) for name in RANGES if name in entry]
    positions = np.asarray(entry["joint_position_rad"], float)
    if any(limits.shape != (joints, 2) for limits in ranges) or positions.shape != (len(positions) or 1, joints):
        raise ValueError("its recorded range is not one of this arm")
    drivers = {phrase: (float(lower), float(upper)) for phrase, (lower, upper) in entry["drivers"].items()}
    if any((part[:, 0] > part[:, 1]).any() for part in ranges) or any(
        lower > upper for lower, upper in drivers.values()
    ):
        raise ValueError("a recorded range of its uncertainty ends before it begins")
    return RecordedRange(ranges[0], positions, float(entry["spacing_rad"]), drivers, *ranges[1:])


# ------------------------------------------------------------------ files


def write_document(document: Mapping[str, Any], path: str | Path, overwrite: bool = False) -> Path:
    """Writes a document, with or without sentences.

    Raises:
        InputError: as `write_atomically`.
    """
    return write_atomically(path, document_text(document), overwrite)


def document_text(document: Mapping[str, Any]) -> str:
    """The text of a diagnosis file."""
    return _laid_out(dict(document), "\n")


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


def read_model(path: str | Path, effects: Sequence[Effect] = ()) -> DiagnosedArm:
    """The model of the poses in a diagnosis file.

    Args:
        path: what `diagnose` wrote.
        effects: a user's own, where the model has them.

    Raises:
        InputError: no such file, not a diagnosis, or something in it is missing or not possible.
    """
    require_type("path", path, str | Path, "the path of a diagnosis (.json)")
    document = parse_document(path)
    return model_from_document(document, effects, str(path))


def read_torque_model(path: str | Path, effects: Sequence[Effect] = ()) -> DiagnosedMotors:
    """The model of the torques in a diagnosis file, of torques or of poses and torques; otherwise as `read_model`.

    Raises:
        InputError: as `read_model`; a diagnosis of poses alone.
    """
    document = parse_document(path)
    return torque_model_from_document(document, effects, str(path))


def parse_document(path: str | Path) -> Any:
    """A document as JSON holds it.

    Raises:
        InputError: no such file, no JSON, or a recording, with the command that diagnoses it.
    """
    if recording_file(path) is not None and exists(path):
        made = command_line("diagnose", path, "--out", Path(path).with_suffix(".json"))
        raise InputError(f"{path}: is a recording and no diagnosis; give what `{made}` writes")
    try:
        return json.loads(read_text(path, _SIZE_LIMIT), object_pairs_hook=unique_keys)
    except InputError:
        raise
    except RepeatedKeyError as error:
        raise InputError(f"{path}: the key {error} is given twice; {DAMAGED}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is no JSON ({error}); give what `lite6jax diagnose --out` wrote") from error


def check_document(document: Any, path: str | Path) -> None:
    """Refuses what is no whole diagnosis of this version, for a report; effects of a user's own are not needed.

    Args:
        document: of poses, of torques or of both, as JSON holds it.
        path: what messages begin with.

    Raises:
        InputError: not a diagnosis of this version, or something in it is missing or not possible.
    """
    torques = find_torques(document)
    if not _has_model(document, (SCHEMA,)):
        raise InputError(f"{path}: is no diagnosis ({SCHEMA}); give what `lite6jax diagnose --out` wrote")
    try:
        if torques is not document:
            check_poses(document)
        if torques is not None or "torques" in document:
            check(_torques_in(document, str(path)), TORQUE_DOCUMENT)
    except InputError as error:
        raise InputError(f"{path}: is damaged ({error}); {DAMAGED}") from error


def is_of_torques(document: Any) -> bool:
    """Whether a document is a diagnosis of torques alone."""
    return _has_model(document, (SCHEMA,)) and document.get("domain") == "torque"


def find_torques(document: Any) -> dict[str, Any] | None:
    """The diagnosis of torques that a document is, or that stands in one of poses; None where there is none."""
    if is_of_torques(document):
        return document
    inside = document.get("torques") if isinstance(document, dict) else None
    return inside if is_of_torques(inside) else None


def _has_model(document: Any, schemas: Sequence[str]) -> bool:
    return isinstance(document, dict) and document.get("schema") in schemas and isinstance(document.get("model"), dict)


def _torques_in(document: Any, source: str) -> dict[str, Any]:
    torques = find_torques(document)
    if torques is None:
        raise InputError(f"{source}: is no diagnosis of torques; give what `lite6jax diagnose --out` wrote of one")
    return torques
