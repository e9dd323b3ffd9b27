"""The JSON of a diagnosis: its schema, writing and reading; codes and numbers in SI units, of poses, torques, or both.

The schema types what a model needs; the rest is numbers of a report, looked at where a sentence is made of them.

Sentences are added by the report where a file is written.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, overload

import msgspec
import numpy as np
from msgspec import Meta
from msgspec.structs import asdict
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import LARGEST_MASS
from lite6jax.arms.entries import ANGLE_LIMIT, LENGTH_LIMIT
from lite6jax.domains.pose.predict import DiagnosedArm
from lite6jax.domains.torque.predict import DiagnosedMotors, pairs
from lite6jax.domains.tracking.predict import DiagnosedServos, FittedRange
from lite6jax.domains.uncertainty import RecordedRange, ReferenceOrigin, Uncertainty, freed
from lite6jax.effects.catalogue import POSE_EFFECTS, TORQUE_EFFECTS, TRACKING_EFFECTS, kinds_of
from lite6jax.effects.composition import Physics
from lite6jax.effects.effect import Effect, require_kind
from lite6jax.effects.serialization import effect_as_dict, effect_from_dict
from lite6jax.effects.servo import Servo
from lite6jax.effects.statics import inertia_of
from lite6jax.errors import InputError, command_line, require_type
from lite6jax.estimation.terms import Terms, join
from lite6jax.model import ArmModel
from lite6jax.recordings.files import recording_file
from lite6jax.recordings.settings import HIGHEST_TEMPERATURE, LARGEST_GRAVITY
from lite6jax.storage import Count, NonNegative, Number, Strict, check, exists, read_text, write_atomically

Array = NDArray[np.floating]

_FARTHEST = 1e4
"""m; a sensor stands no further from the arm, and nothing on a flange is larger."""
_LARGEST_MISFIT = 10.0
"""Multiples of the range of a number of an effect, beyond which it is damaged; estimates scatter about the range."""

Domain = Literal["poses", "torques", "tracking"]
Verdict = Literal["consistent", "explained", "partly_explained", "unnamed", "unexplained", "undetermined"]

_LARGEST_MOMENT = LARGEST_MASS * LENGTH_LIMIT
_BY_UNIT = {"m": LENGTH_LIMIT, "rad": ANGLE_LIMIT}
_Length = Annotated[float, Meta(ge=-LENGTH_LIMIT, le=LENGTH_LIMIT)]
_Angle = Annotated[float, Meta(ge=-ANGLE_LIMIT, le=ANGLE_LIMIT)]
_Far = Annotated[float, Meta(ge=-_FARTHEST, le=_FARTHEST)]
_Mass = Annotated[float, Meta(ge=-LARGEST_MASS, le=LARGEST_MASS)]
_Moment = Annotated[float, Meta(ge=-_LARGEST_MOMENT, le=_LARGEST_MOMENT)]
_Acceleration = Annotated[float, Meta(ge=-LARGEST_GRAVITY, le=LARGEST_GRAVITY)]
_Temperature = Annotated[float, Meta(ge=-273.15, le=HIGHEST_TEMPERATURE)]
_Point = tuple[_Length, _Length, _Length]
_Gravity = tuple[_Acceleration, _Acceleration, _Acceleration]
_Chain = list[tuple[_Length, _Length, _Length, _Angle, _Angle, _Angle]]
_Row = tuple[_Far, _Far, _Far, _Far]
_Transform = tuple[_Row, _Row, _Row, _Row]
_Limits = list[tuple[_Far, _Far]]
_Ranges = list[tuple[float, float]]
_Link = Annotated[list[_Moment], Meta(min_length=10, max_length=10)]


class Recorded(Strict):
    """Where a model was recorded; of torques with velocities and accelerations."""

    joint_range_rad: _Ranges
    joint_position_rad: list[list[float]]
    spacing_rad: NonNegative
    drivers: dict[str, tuple[float, float]]
    velocity_range_rad_per_s: _Ranges | None = None
    acceleration_range_rad_per_s2: _Ranges | None = None


class UncertaintyEntry(Strict):
    """How uncertain predictions are: fields of `Uncertainty`.

    Lists have a number for position (m) and orientation (rad) of poses, or for each joint (Nm, N of prismatic ones).
    """

    sites: list[tuple[str, Count, Count]]
    covariance: list[float]
    left: list[NonNegative]
    unseen: list[NonNegative]
    noise: list[NonNegative]
    recorded: Recorded
    typical: list[NonNegative] | None = None


class EstimatedInertia(Strict):
    """Masses and their centres as estimated, with the payload's centre and gravity."""

    mass: list[_Mass]
    center_of_mass: list[_Point]
    payload_center: _Point
    gravity: _Gravity


class Model(Strict, kw_only=True):
    """What predictions of poses and of torques both need."""

    arm: str
    kinematics: _Chain
    reference_temperature_degC: _Temperature  # noqa: N815 (the key)
    effects: list[Any]
    prismatic_joints: tuple[Number, ...] = ()
    joint_limits: _Limits | None = None
    uncertainty: UncertaintyEntry | None = None


class PoseModel(Model, kw_only=True):
    """What predictions of poses need."""

    T_sensor_base: _Transform
    T_flange_tool: _Transform
    orientation: bool
    inertia: EstimatedInertia | None
    motion: Literal["static", "trajectory"]
    accelerated: bool = False

    def __post_init__(self) -> None:
        """Checks what one number alone does not show; of torques an `Arm` does that."""
        joints = len(self.kinematics)
        prismatic = self.prismatic_joints
        limits = self.joint_limits
        if prismatic != tuple(sorted(set(prismatic))) or any(joint > joints for joint in prismatic):
            raise ValueError("prismatic_joints are not joints of its chain in order")
        if limits is not None and not (len(limits) == joints and all(lower < upper for lower, upper in limits)):
            raise ValueError("joint_limits are not the lower and the upper one of each joint")
        for name, rows in (("T_sensor_base", self.T_sensor_base), ("T_flange_tool", self.T_flange_tool)):
            T = np.array(rows, float)
            if not (frames.is_rotation(T[:3, :3]) and np.allclose(T[3], [0.0, 0.0, 0.0, 1.0], rtol=0, atol=1e-12)):
                raise ValueError(f"{name} is no rigid transform")
        # the last mass contains by how much the payload is lighter than declared
        masses = [] if self.inertia is None else self.inertia.mass
        uncertainty = self.uncertainty
        lighter = uncertainty is not None and any(site[0] == "payload" for site in uncertainty.sites)
        for i, mass in enumerate(masses[:-1] if lighter else masses):
            if mass < 0:
                raise ValueError(f"inertia.mass[{i}] is {mass:.6g}, which is negative")


class TorqueModel(Model, kw_only=True):
    """What predictions of torques need; `drives` has the fields `DRIVE_FIELDS` of an arm."""

    T_joint_flange: _Transform
    links: list[_Link]
    payload_center: _Point
    gravity: _Gravity
    drives: dict[str, list[float]] = msgspec.field(default_factory=dict)


class TrackingModelEntry(Model, kw_only=True):
    """What predictions of joints from commands need; `servo` has the numbers of each joint, without the effects."""

    T_joint_flange: _Transform
    links: list[_Link]
    payload_center: _Point
    payload_kg: _Mass
    gravity: _Gravity
    compensated: bool
    servo: dict[str, list[float]]
    step_s: Annotated[float, Meta(gt=0.0, le=1.0)]
    interpolated: bool
    velocity_range_rad_per_s: _Ranges
    weight_range_Nm: _Ranges  # noqa: N815 (the key)

    def __post_init__(self) -> None:
        """Checks that every servo has all numbers of each joint."""
        joints = len(self.kinematics)
        if set(self.servo) != set(Servo._fields) or any(len(numbers) != joints for numbers in self.servo.values()):
            raise ValueError("servo does not have a number of each kind for each joint")
        lists = (self.links, self.velocity_range_rad_per_s, self.weight_range_Nm)
        if any(len(part) != joints for part in lists):
            raise ValueError(f"it has {joints} joints, but other numbers of links or ranges")


class PoseDocument(msgspec.Struct, kw_only=True):
    """What is read of a diagnosis of poses beside its report."""

    model: PoseModel
    before: dict[str, NonNegative] = msgspec.field(default_factory=dict)
    after: dict[str, NonNegative] = msgspec.field(default_factory=dict)
    against: ReferenceOrigin | None = None


class TorqueDocument(msgspec.Struct, kw_only=True):
    """What is read of a diagnosis of torques beside its report."""

    model: TorqueModel
    against: ReferenceOrigin | None = None


class TrackingDocument(msgspec.Struct, kw_only=True):
    """What is read of a diagnosis of commands and joints beside its report."""

    model: TrackingModelEntry
    against: ReferenceOrigin | None = None


AnyDocument = PoseDocument | TorqueDocument | TrackingDocument
AnyModel = DiagnosedArm | DiagnosedMotors | DiagnosedServos
_DOCUMENTS: Mapping[Domain, type[AnyDocument]] = {
    "poses": PoseDocument,
    "torques": TorqueDocument,
    "tracking": TrackingDocument,
}
_CATALOGUES: Mapping[type[AnyDocument], Mapping[str, type[Effect]]] = {
    PoseDocument: POSE_EFFECTS,
    TorqueDocument: TORQUE_EFFECTS,
    TrackingDocument: TRACKING_EFFECTS,
}
"""The effects that a model of a domain may have, by name."""
_FAMILY = "lite6jax/diagnosis/"
SCHEMA = f"{_FAMILY}3"
DAMAGED = "run `lite6jax diagnose` again"
_SIZE_LIMIT = 1 << 26
_ROUNDING = 1e-9
"""Of the largest covariance, by which rounding may make a variance of zero negative."""
_RANGES = ("joint_range_rad", "velocity_range_rad_per_s", "acceleration_range_rad_per_s2")
"""Of what was recorded; of poses the first alone."""


def effect_entry(effect: Effect) -> dict[str, Any]:
    """Which effect, where, and of what."""
    driver = " and ".join(driver.phrase for driver in effect.drivers) or "none"
    return {"effect": effect.name, "site": effect.site, "driver": driver}


# ------------------------------------------------------------------ models as values of JSON


def model_entry(model: AnyModel, covariances: Sequence[Array]) -> dict[str, Any]:
    """A model as values that JSON can hold, with covariances of the numbers of each effect."""
    parts: Sequence[tuple[Effect, slice]]
    if isinstance(model, DiagnosedMotors):
        arm = model.arm
        parts = pairs(model.terms)
        drives = {field: values.tolist() for field, values in arm.drives.items()}
        domain_fields: dict[str, Any] = {
            "arm": arm.name,
            "kinematics": arm.kinematics.tolist(),
            "T_joint_flange": arm.T_joint_flange.tolist(),
            "links": model.links.tolist(),
            **({"drives": drives} if drives else {}),
            "payload_center": model.payload_center.tolist(),
            "gravity": model.gravity.tolist(),
            "joint_limits": arm.joint_limits.tolist(),
        }
    elif isinstance(model, DiagnosedServos):
        parts = list(zip(model.terms.terms, model.terms.slices, strict=True))  # type: ignore[arg-type]
        domain_fields = {
            "arm": model.arm.name,
            "kinematics": np.asarray(model.arm.kinematics).tolist(),
            "T_joint_flange": model.arm.T_joint_flange.tolist(),
            "links": model.links.tolist(),
            "payload_center": model.payload_center.tolist(),
            "payload_kg": model.payload,
            "gravity": model.gravity.tolist(),
            "compensated": model.compensated,
            "servo": {name: np.asarray(numbers).tolist() for name, numbers in model.servo._asdict().items()},
            "step_s": model.step,
            "interpolated": model.interpolated,
            "velocity_range_rad_per_s": model.ranges.velocity.tolist(),
            "weight_range_Nm": model.ranges.weight.tolist(),
            "joint_limits": model.arm.joint_limits.tolist(),
        }
    else:
        limits, masses = model.joint_limits, model.inertia
        parts = list(zip(model.physics.effects, model.physics.slices, strict=True))
        domain_fields = {
            "arm": model.arm,
            "kinematics": np.asarray(model.model.geometry).reshape(-1, 6).tolist(),
            "T_sensor_base": np.asarray(model.model.T_sensor_base).tolist(),
            "T_flange_tool": np.asarray(model.model.T_flange_tool).tolist(),
            "joint_limits": None if limits is None else np.asarray(limits).tolist(),
            "orientation": model.orientation,
            "inertia": masses and {name: np.asarray(value).tolist() for name, value in masses._asdict().items()},
            "motion": model.motion,
            "accelerated": model.accelerated,
        }
    return {
        **domain_fields,
        **({"prismatic_joints": [joint + 1 for joint in model.sliding]} if model.sliding else {}),
        "reference_temperature_degC": model.reference_temperature,
        "effects": [
            effect_as_dict(effect, model.values[at], C) for (effect, at), C in zip(parts, covariances, strict=True)
        ],
        "uncertainty": model.uncertainty and _uncertainty_entry(model.uncertainty),
    }


def _uncertainty_entry(uncertainty: Uncertainty) -> dict[str, Any]:
    C, recorded = uncertainty.covariance, uncertainty.recorded
    ranges = zip(_RANGES, (recorded.joints, recorded.velocities, recorded.accelerations), strict=True)
    lists = {
        "left": uncertainty.left,
        "unseen": uncertainty.unseen,
        "noise": uncertainty.noise,
        "typical": uncertainty.typical,
    }
    return {
        "sites": [list(site) for site in uncertainty.sites],
        "covariance": C[np.tril_indices(len(C))].tolist(),  # row by row
        **{name: None if part is None else np.asarray(part, float).tolist() for name, part in lists.items()},
        "recorded": {
            **{name: limits.tolist() for name, limits in ranges if limits is not None},
            "joint_position_rad": recorded.positions.tolist(),
            "spacing_rad": recorded.spacing,
            "drivers": {phrase: list(bounds) for phrase, bounds in recorded.drivers.items()},
        },
    }


# ------------------------------------------------------------------ models from values of JSON


def model_from_document(
    document: Any, effects: Sequence[Effect] = (), source: str = "diagnosis", domain: Domain | None = None
) -> AnyModel:
    """The model in a diagnosis, as JSON holds it.

    Args:
        document: all of it.
        effects: a user's own, where the model has them.
        source: what messages begin with.
        domain: of which the model is, as of `read_model`.

    Raises:
        InputError: not a diagnosis of the domain, effects of a user's own that are not given, or something in it is
            missing or not possible.
    """
    read = _read(document, domain or domain_of(document), source)
    _require_known(read, effects, source)
    with _refuse_damage(source):
        return _model(read, effects)


def _model(read: AnyDocument, effects: Sequence[Effect]) -> AnyModel:
    model = read.model
    against = read.against
    torques = isinstance(read, TorqueDocument)
    joints = len(model.kinematics)
    sliding = tuple(joint - 1 for joint in model.prismatic_joints)
    kinds = kinds_of(effects, _CATALOGUES[type(read)])
    kinematics = np.asarray(model.kinematics, float)
    arm = None
    if isinstance(model, TorqueModel):
        torque_fields = {"T_joint_flange": model.T_joint_flange, "joint_limits": model.joint_limits, **model.drives}
        fields: dict[str, Any] = {name: np.asarray(part, float) for name, part in torque_fields.items()}
        arm = Arm(model.arm, kinematics, sliding=sliding, **fields)
        if len(model.links) != joints:
            raise ValueError(f"it has {joints} joints, but links of the shape {np.shape(model.links)}")
    model_effects, numbers = _effects(model.effects, kinds, joints, sliding)
    if isinstance(model, TrackingModelEntry):
        return DiagnosedServos(
            arm=Arm(
                model.arm,
                kinematics,
                sliding=sliding,
                T_joint_flange=np.asarray(model.T_joint_flange, float),
                joint_limits=np.asarray(model.joint_limits, float),
            ),
            servo=Servo(**{name: np.asarray(numbers_of, float) for name, numbers_of in model.servo.items()}),
            links=np.asarray(model.links, float),
            payload_center=np.asarray(model.payload_center, float),
            payload=model.payload_kg,
            gravity=np.asarray(model.gravity, float),
            compensated=model.compensated,
            terms=Terms(model_effects),
            values=join(numbers),
            step=model.step_s,
            interpolated=model.interpolated,
            ranges=FittedRange(
                np.asarray(model.velocity_range_rad_per_s, float), np.asarray(model.weight_range_Nm, float)
            ),
            reference_temperature=model.reference_temperature_degC,
        )
    shared: dict[str, Any] = {
        "values": join(numbers),
        "reference_temperature": model.reference_temperature_degC,
        "reference": None if against is None or against.basis == "effects" else against,
        "uncertainty": _uncertainty(model.uncertainty, model_effects, joints, torques),
    }
    if isinstance(model, TorqueModel):
        assert arm is not None
        return DiagnosedMotors(
            arm=arm,
            links=np.asarray(model.links, float),
            payload_center=np.asarray(model.payload_center, float),
            gravity=np.asarray(model.gravity, float),
            terms=Terms(model_effects),
            **shared,
        )
    assert isinstance(read, PoseDocument)
    before, after = (stage.get("heldout_position_rms_m") for stage in (read.before, read.after))
    inertia = None
    if model.inertia is not None:
        inertia = inertia_of(**{name: np.asarray(row, float) for name, row in asdict(model.inertia).items()})
        if len(inertia.mass) != joints:
            raise ValueError(f"it has {joints} joints, but {len(inertia.mass)} masses")
    return DiagnosedArm(
        arm=model.arm,
        model=ArmModel(
            kinematics.ravel(),  # type: ignore[arg-type]
            np.asarray(model.T_sensor_base, float),  # type: ignore[arg-type]
            np.asarray(model.T_flange_tool, float),  # type: ignore[arg-type]
        ),
        physics=Physics(model_effects),
        inertia=inertia,
        joint_limits=None if model.joint_limits is None else np.asarray(model.joint_limits, float),
        orientation=model.orientation,
        motion=model.motion,
        accelerated=model.accelerated,
        heldout_rms=None if before is None or after is None else (before, after),
        sliding=sliding,
        **shared,
    )


def _require_known(read: AnyDocument, effects: Sequence[Effect], source: str) -> None:
    """Refuses a model with effects that are neither in the catalogue nor given.

    Raises:
        InputError: as said; the file of these effects is the remedy.
    """
    kinds = kinds_of(effects, _CATALOGUES[type(read)])
    entries = (entry for entry in read.model.effects if isinstance(entry, Mapping))
    names = [name for entry in entries if isinstance(name := entry.get("effect"), str) and name not in kinds]
    if not names:
        return
    reason = "the file that was given has none of this name" if effects else "the catalogue has none of this name"
    raise InputError(
        f"{source}: its model has the effect {names[0][:60]!r}, and {reason}; give the file of effects with which it "
        "was diagnosed, --effects FILE.py (in Python effects=load_effects(FILE))"
    )


@contextmanager
def _refuse_damage(source: str) -> Iterator[None]:
    """Within, what is not possible in a document is an error of the input."""
    try:
        yield
    except (InputError, KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise InputError(f"{source}: its model is damaged ({error}); {DAMAGED}") from error


def _effects(
    entries: Sequence[Any], kinds: Mapping[str, type[Effect]], joints: int, sliding: tuple[int, ...]
) -> tuple[tuple[Effect, ...], list[Array]]:
    """The effects of a model of so many joints, and their numbers.

    Raises:
        InputError: the arm does not have such an effect, or a number is far beyond what it can be.
    """
    pairs = [effect_from_dict(entry, kinds) for entry in entries]
    for effect, values in pairs:
        if effect.joints_needed > joints:
            needed = f"is of an arm of {effect.joints_needed} joints or more, and this one has {joints}"
            raise InputError(f"{effect.label}: {needed}")
        for coordinate, value in zip(effect.coordinates, values, strict=True):
            lower, upper = coordinate.lower, coordinate.upper
            if math.isfinite(lower) and math.isfinite(upper) and not effect.nonparametric:
                slack = _LARGEST_MISFIT * (upper - lower)
            else:  # a coefficient of a curve
                slack, lower, upper = 0.0, *(sign * _BY_UNIT.get(coordinate.unit, math.inf) for sign in (-1, 1))
            if not lower - slack <= value <= upper + slack:
                bounds = f"between {lower - slack:.6g} and {upper + slack:.6g}"
                raise InputError(f"{effect.label}: {coordinate.name} is {value:.6g}, which is not {bounds}")
        require_kind(effect, sliding)
    return tuple(effect for effect, _ in pairs), [values for _, values in pairs]


def _uncertainty(
    entry: UncertaintyEntry | None, effects: Sequence[Effect], joints: int, torques: bool
) -> Uncertainty | None:
    """The uncertainty of a model with effects; None of a document without it."""
    if entry is None:
        return None
    sizes = {"base": (1, 6), "link": (joints, 6), "tool": (1, 6), "mass": (joints, 4), "payload": (1, 1)}
    sizes = {"inertia": (joints, 10)} if torques else sizes
    if any(name not in sizes or not (j < sizes[name][0] and k < sizes[name][1]) for name, j, k in entry.sites):
        raise ValueError("a site of its uncertainty is none of this arm")
    lists = [entry.left, entry.unseen, entry.noise, *([] if entry.typical is None else [entry.typical])]
    if any(len(part) != (joints if torques else 2) for part in lists):
        raise ValueError("its uncertainty is not one of this arm")
    size = len(entry.sites) + sum(freed(effect).size for effect in effects)
    if len(entry.covariance) != size * (size + 1) // 2:
        raise ValueError(f"its covariance is not one of {size} numbers")
    C = np.zeros((size, size))
    C[np.tril_indices(size)] = entry.covariance
    if (np.diagonal(C) < -_ROUNDING * np.abs(C).max(initial=0.0)).any():
        raise ValueError("a variance of its uncertainty is negative")
    C += np.tril(C, -1).T
    model_error, unseen, noise, *typical = map(np.array, lists)
    return Uncertainty(tuple(entry.sites), C, model_error, unseen, noise, _recorded(entry.recorded, joints), *typical)


def _recorded(entry: Recorded, joints: int) -> RecordedRange:
    """Where a model of so many joints was recorded."""
    recorded_ranges = (entry.joint_range_rad, entry.velocity_range_rad_per_s, entry.acceleration_range_rad_per_s2)
    ranges = [None if part is None else np.asarray(part, float) for part in recorded_ranges]
    present_ranges = [part for part in ranges if part is not None]
    positions = np.asarray(entry.joint_position_rad, float)
    if any(part.shape != (joints, 2) for part in present_ranges) or positions.shape != (len(positions) or 1, joints):
        raise ValueError("its recorded range is not one of this arm")
    ends = [*(tuple(pair) for part in present_ranges for pair in part), *entry.drivers.values()]
    if any(lower > upper for lower, upper in ends):
        raise ValueError("a recorded range of its uncertainty ends before it begins")
    assert ranges[0] is not None
    return RecordedRange(ranges[0], positions, entry.spacing_rad, entry.drivers, *ranges[1:])


# ------------------------------------------------------------------ files


def write_document(document: Mapping[str, Any], path: str | Path, overwrite: bool = False) -> Path:
    """Writes a document, with or without sentences.

    Raises:
        InputError: as `write_atomically`.
    """
    return write_atomically(path, document_text(document), overwrite)


def document_text(document: Any, line: str = "\n") -> str:
    """The text of a diagnosis file, with a line for each entry of objects and lists, but one for a list of numbers.

    A covariance is then a line for each of its rows. `line` begins a line of the surrounding object or list.
    """
    if isinstance(document, dict) and document:
        entries = [f"{json.dumps(name)}: {document_text(entry, line + ' ')}" for name, entry in document.items()]
    elif isinstance(document, list | tuple) and any(isinstance(entry, dict | list | tuple) for entry in document):
        entries = [document_text(entry, line + " ") for entry in document]
    else:
        return json.dumps(document, allow_nan=False)
    first, last = "{}" if isinstance(document, dict) else "[]"
    return first + ",".join(f"{line} {entry}" for entry in entries) + line + last


@overload
def read_model(path: str | Path, effects: Sequence[Effect] = (), *, domain: None = None) -> AnyModel: ...
@overload
def read_model(path: str | Path, effects: Sequence[Effect] = (), *, domain: Literal["poses"]) -> DiagnosedArm: ...
@overload
def read_model(path: str | Path, effects: Sequence[Effect] = (), *, domain: Literal["torques"]) -> DiagnosedMotors: ...
@overload
def read_model(path: str | Path, effects: Sequence[Effect] = (), *, domain: Literal["tracking"]) -> DiagnosedServos: ...
def read_model(path: str | Path, effects: Sequence[Effect] = (), *, domain: Domain | None = None) -> AnyModel:
    """The model in a diagnosis file: of the poses where they were diagnosed, else of the torques, or of the servos.

    Args:
        path: what `diagnose` wrote.
        effects: a user's own, where the model has them.
        domain: "poses" or "torques", to have the model of that one of a diagnosis of both; or "tracking".

    Raises:
        InputError: no such domain or file, not a diagnosis of the domain, or something in it is missing or not
            possible.
    """
    require_type("path", path, str | Path, "the path of a diagnosis (.json)")
    require_domain(domain)
    return model_from_document(parse_document(path), effects, str(path), domain)


def require_domain(domain: object) -> None:
    """Refuses what names no domain.

    Raises:
        InputError: as said.
    """
    if domain not in (None, "poses", "torques", "tracking"):
        raise InputError(f'domain={domain!r}: is none; give "poses", "torques" or "tracking", or leave it out')


def parse_document(path: str | Path) -> Any:
    """A document as JSON holds it.

    Raises:
        InputError: no such file, no JSON, a diagnosis of another schema, or a recording, with the command that
            diagnoses it.
    """
    if recording_file(path) is not None and exists(path):
        made = command_line("diagnose", path, "--out", Path(path).with_suffix(".json"))
        raise InputError(f"{path}: is a recording and no diagnosis; give what `{made}` writes")
    text = read_text(path, _SIZE_LIMIT)
    try:
        document = msgspec.json.decode(text)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise InputError(f"{path}: is no JSON ({error}); give what `lite6jax diagnose --out` wrote") from error
    schema = document.get("schema") if isinstance(document, dict) else None
    if str(schema).startswith(_FAMILY) and schema != SCHEMA:
        raise InputError(
            f"{path}: is a diagnosis of the schema {schema}, and {SCHEMA} is read; diagnose the recording again"
        )
    return document


def check_document(document: Any, path: str | Path) -> None:
    """Refuses what is no diagnosis or has no whole model, for a report; effects of a user's own are not needed.

    Raises:
        InputError: as `model_from_document`.
    """
    if not is_of_torques(document):
        _read(document, domain_of(document), str(path))
    if is_of_torques(document) or "torques" in document:
        _read(document, "torques", str(path))


def is_of_torques(document: Any) -> bool:
    """Whether a document is a diagnosis of torques alone."""
    return isinstance(document, dict) and document.get("domain") == "torques"


def is_of_tracking(document: Any) -> bool:
    """Whether a document is a diagnosis of commands and measured joints."""
    return isinstance(document, dict) and document.get("domain") == "tracking"


def domain_of(document: Any) -> Domain:
    """The domain of a document, or of the poses in it."""
    if is_of_tracking(document):
        return "tracking"
    return "torques" if is_of_torques(document) else "poses"


def find_torques(document: Any) -> dict[str, Any] | None:
    """The diagnosis of torques that a document is, or that stands in one of poses; None where there is none."""
    if is_of_torques(document):
        return document
    inside = document.get("torques") if isinstance(document, dict) else None
    return inside if is_of_torques(inside) else None


def _read(document: Any, domain: Domain, source: str) -> AnyDocument:
    """A document of a domain by its schema; of torques also that in one of poses."""
    torques = domain == "torques"
    part = find_torques(document) if torques else document
    if not (isinstance(part, dict) and part.get("schema") == SCHEMA and isinstance(part.get("model"), dict)):
        kind, wrote = (f"of {domain}", " of one") if domain != "poses" else (f"({SCHEMA} with a model)", "")
        raise InputError(f"{source}: is no diagnosis {kind}; give what `lite6jax diagnose --out` wrote{wrote}")
    if domain_of(part) != domain:
        raise InputError(f"{source}: is a diagnosis of {domain_of(part)}; give one of {domain}")
    with _refuse_damage(source):
        return check(part, _DOCUMENTS[domain])
