"""What a recording's columns cannot say about the arm, the sensor and the motion: the sidecar, a YAML file beside it.

Each key has a type, which msgspec checks, and words that say what to give.
"""

import math
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from datetime import date
from difflib import get_close_matches
from functools import reduce
from operator import or_
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

import msgspec
import yaml
from msgspec import Meta

from lite6jax import suffixes
from lite6jax.errors import InputError
from lite6jax.fields import field_values
from lite6jax.recordings.columns.column import IGNORED
from lite6jax.storage import exists, read_yaml, write_atomically

LONGEST_OFFSET_M = 5.0  # a tool or a payload further out than this was written in millimetres
# m or rad; beyond, squares of residuals over it lose all digits
SMALLEST_SIGMA = 1e-12
LARGEST_SIGMA = 1.0
LARGEST_GRAVITY = 100.0  # m/s²; that of no planet on which an arm stands
HIGHEST_TEMPERATURE = 1000.0

JointSource = Literal["measured", "commanded", "unknown"]
PoseSource = Literal[
    "laser_tracker", "motion_capture", "camera", "controller_fk", "touch", "draw_wire", "height_gauge", "unknown"
]
Motion = Literal["static", "trajectory"]
TorqueSource = Literal["measured", "current", "estimated", "unknown"]
PoseFrame = Literal["base", "unknown"]
Unknown = Literal["unknown"]
POSITIVE = "more than zero (leave it out where unknown)"

Line = Annotated[str, Meta(pattern=r"^(?=.*\S)[^\x00-\x1f\x7f-\x9f\u2028\u2029]*\Z")]
if TYPE_CHECKING:
    Name = str
else:
    Name = str | int  # YAML takes some names for numbers, which become text again
Point = tuple[float, float, float]
Sigma = Annotated[float, Meta(ge=SMALLEST_SIGMA, le=LARGEST_SIGMA)]
FromZero = Annotated[float, Meta(ge=0.0, le=LARGEST_SIGMA)]
Share = Annotated[float, Meta(ge=0.0, le=0.5)]
Length = Annotated[float, Meta(ge=-LONGEST_OFFSET_M, le=LONGEST_OFFSET_M)]
Angle = Annotated[float, Meta(ge=-2 * math.pi, le=2 * math.pi)]
Distance = Annotated[float, Meta(gt=0.0, le=LONGEST_OFFSET_M)]
Focal = Annotated[float, Meta(gt=0.0)]
Size = Annotated[float, Meta(ge=0.0)]
Gravity = Annotated[float, Meta(ge=-LARGEST_GRAVITY, le=LARGEST_GRAVITY)]
TorqueSigma = Annotated[float, Meta(ge=1e-9, le=1e4)]
Constant = Annotated[float, Meta(ge=-1e5, le=1e5)]
Probability = Annotated[float, Meta(ge=0.0, lt=1.0)]
Corners = Annotated[int, Meta(ge=1, le=10_000)]
Places = Mapping[str, Point]  # one of a least length within a union ends the process (msgspec 0.22)


class _Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A mapping with these keys and no others."""


class FactoryUncertainty(_Record, frozen=True):
    """One sigma of every number of the factory calibration: m for lengths, rad for angles."""

    position_m: Sigma
    rotation_rad: Sigma


class KnownDistance(_Record, frozen=True):
    """The distance of two contacts, by their names, in m, and one sigma of it."""

    between: tuple[Name, Name]
    distance_m: Distance
    noise_m: Sigma

    def __post_init__(self) -> None:
        msgspec.structs.force_setattr(self, "between", tuple(map(str, self.between)))
        if self.between[0] == self.between[1]:
            raise ValueError("between: give the names of two contacts")


class KnownPlane(_Record, frozen=True):
    """A plane n · p = offset in the arm's base frame, with the normal n of any length."""

    normal: Point
    offset_m: float

    def __post_init__(self) -> None:
        if not any(self.normal):
            raise ValueError("normal: has no direction")


class CameraSettings(_Record, frozen=True):
    """A camera by OpenCV's model; lengths in pixels, `distortion` as k1, k2, p1, p2 and perhaps k3.

    `mounted` is `fixed`, where it looks at a board on the flange, or `on_flange`, where it looks at a fixed board.
    """

    mounted: Literal["fixed", "on_flange"]
    fx: Focal
    fy: Focal
    cx: float
    cy: float
    distortion: Annotated[tuple[float, ...], Meta(min_length=4, max_length=5)] = (0.0, 0.0, 0.0, 0.0, 0.0)
    width: Size = 0.0
    height: Size = 0.0
    intrinsics: Literal["known", "refine"] = "known"

    def __post_init__(self) -> None:
        if len(self.distortion) == 4:
            msgspec.structs.force_setattr(self, "distortion", (*self.distortion, 0.0))


class BoardSettings(_Record, frozen=True):
    """A board of inner corners: corner i is at column i mod `columns`, `square_m` apart; one sigma of its print."""

    columns: Corners
    rows: Corners
    square_m: Distance
    noise_m: FromZero = 0.0

    @property
    def points(self) -> tuple[Point, ...]:
        """The points of each corner, m in the board's frame."""
        count = self.columns * self.rows
        return tuple((i % self.columns * self.square_m, i // self.columns * self.square_m, 0.0) for i in range(count))


Rate = Annotated[float, Meta(ge=0.0, le=1e7)]
PerJoint = Annotated[tuple[Rate, ...], Meta(min_length=1)]


class ServoSettings(_Record, frozen=True, omit_defaults=True):
    """Position servos with a stiffness and a damping of each joint, the delay of all, and how commands are held.

    A torque limit and the time constant of a low pass of the command, of each joint, where there are such.
    """

    stiffness_Nm_per_rad: PerJoint  # noqa: N815 (the sidecar's key)
    damping_Nm_s_per_rad: PerJoint  # noqa: N815 (the sidecar's key)
    delay_s: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    hold: Literal["previous", "interpolated"] = "previous"
    gravity_compensation: bool = False
    torque_limit_Nm: PerJoint | None = None  # noqa: N815 (the sidecar's key)
    time_constant_s: PerJoint | None = None

    def __post_init__(self) -> None:
        for name, numbers in (
            ("stiffness_Nm_per_rad", self.stiffness_Nm_per_rad),
            ("torque_limit_Nm", self.torque_limit_Nm),
        ):
            if 0.0 in (numbers or ()):
                raise ValueError(f"{name}: is zero")


@dataclass(frozen=True)
class RecordingSettings:
    """What a sidecar declares; the defaults are those of a recording without one.

    Beside the type of each key stands what it accepts, in the words of messages; of listed words these are enough.

    Lengths in m, angles in rad, one sigma for each noise, `tool` as x y z roll pitch yaw (R = Rz Ry Rx).
    `inertial_uncertainty` is one sigma of masses, and of the lever arms of their centres, relative to them, where poses
    are explained. `inertial` is what holds where torques are: the numbers of the arm's description ("declared"), those
    of no description ("unknown"), or its numbers with a relative standard deviation. `date`, of the measurement, and
    `instrument` stand on a certificate. None is what is not declared.
    Of readings that are no poses: a noise of each kind, and what is known of the points, planes, anchors and axes, in
    the arm's base frame. Points of contacts are in a frame of their own where all are given and `pose_frame` is
    unknown.
    `arm` and `factory_calibration` are kept as written: `arm_reference` and `factory_path` resolve them.

    Raises:
        InputError: a value of the wrong type, not finite, out of its range, or not a listed one.
    """

    arm: Annotated[
        Line | None,
        "a bundled arm's name, or the path of an arm description relative to the sidecar",
    ] = None
    factory_calibration: Annotated[
        Line | None, "the path of the arm's own six-parameter file, relative to the sidecar"
    ] = None
    factory_uncertainty: Annotated[
        FactoryUncertainty | None,
        "{position_m: 1.0e-5, rotation_rad: 1.0e-5}, both positive (leave it out where the file holds exactly)",
    ] = None
    joint_source: JointSource = "unknown"
    joint_noise_rad: Annotated[FromZero, "one sigma in rad, zero or more"] = 0.0
    pose_source: PoseSource = "unknown"
    motion: Motion | None = None
    pose_frame: PoseFrame = "unknown"
    tool: Annotated[
        Literal["none", "unknown"] | tuple[Length, Length, Length, Angle, Angle, Angle],
        "none, unknown, or six numbers [x, y, z, roll, pitch, yaw] in m and rad, not in mm and degrees",
    ] = "unknown"
    position_noise_m: Annotated[Sigma | None, f"one sigma in m, {POSITIVE}"] = None
    orientation_noise_rad: Annotated[Sigma | None, f"one sigma in rad, {POSITIVE}"] = None
    payload_com_m: Annotated[tuple[Length, Length, Length], "three numbers [x, y, z] in m, not in mm"] = (0.0, 0.0, 0.0)
    reference_temperature_degC: Annotated[  # noqa: N815 (the sidecar's key)
        float, Meta(ge=-273.15, le=HIGHEST_TEMPERATURE), "a finite number in degrees Celsius"
    ] = 25.0
    gravity_m_per_s2: Annotated[
        tuple[Gravity, Gravity, Gravity],
        "three numbers [x, y, z] in m/s^2",
    ] = (0.0, 0.0, -9.81)
    inertial_uncertainty: Annotated[
        Share, "one sigma relative to the masses, from 0 to 0.5, such as 0.1, not per cent"
    ] = 0.1
    payload_uncertainty_kg: Annotated[float, Meta(ge=0.0, le=1000.0), "one sigma in kg, zero or more"] = 0.0
    torque_source: TorqueSource = "unknown"
    torque_noise_Nm: Annotated[  # noqa: N815 (the sidecar's key)
        TorqueSigma | Annotated[tuple[TorqueSigma, ...], Meta(min_length=1)] | None,
        "one sigma in N m of all joints, or a list with one per joint, more than zero (leave it out where unknown)",
    ] = None
    inertial: Annotated[
        Literal["declared", "unknown"] | Annotated[float, Meta(gt=0.0, le=0.5)],
        "declared, unknown (they are fitted), or a relative uncertainty up to 0.5, such as 0.1, not per cent",
    ] = "declared"
    torque_constant_Nm_per_A: Annotated[  # noqa: N815 (the sidecar's key)
        Annotated[tuple[Constant, ...], Meta(min_length=1)] | None,
        "a list with one number in N m per A for each joint, none zero",
    ] = None
    command: Annotated[
        Literal["position", "velocity"],
        "position or velocity; commands of torque are diagnosed as torques: name their columns tau1_Nm ..., and leave "
        "this key out",
    ] = "position"
    servo: Annotated[
        Unknown | ServoSettings,
        "unknown, or {stiffness_Nm_per_rad: [...], damping_Nm_s_per_rad: [...], delay_s: 0.0, hold: previous or "
        "interpolated, gravity_compensation: false, torque_limit_Nm: [...], time_constant_s: [...]}, with one number "
        "per joint, in N m, rad and s; all but the first two may be left out",
    ] = "unknown"
    contact_noise_m: Annotated[
        Sigma | None, "one sigma in m of the touched point about its contact, more than zero"
    ] = None
    contact_distances: Annotated[
        tuple[KnownDistance, ...],
        "a list of {between: [a, b], distance_m: 0.05, noise_m: 5.0e-5}, in m, not in mm",
    ] = ()
    contact_points: Annotated[Places | None, "contacts by name, each with [x, y, z] in m"] = None
    plane_noise_m: Annotated[Sigma | None, "one sigma in m of the touched point from its plane, more than zero"] = None
    planes: Annotated[
        Mapping[str, KnownPlane] | None, "planes by name, each with {normal: [x, y, z], offset_m: 0.0}"
    ] = None
    distance_noise_m: Annotated[Sigma | None, f"one sigma in m, {POSITIVE}"] = None
    anchor_m: Annotated[Unknown | Point | Places, "unknown, [x, y, z] in m, or anchors by name with [x, y, z] each"] = (
        "unknown"
    )
    distance_offset: Literal["none", "unknown"] = "none"
    axis_noise_m: Annotated[Sigma | None, f"one sigma in m, {POSITIVE}"] = None
    axis: Annotated[Unknown | Point, "unknown, or a direction [x, y, z]"] = "unknown"
    pixel_noise_px: Annotated[
        Annotated[float, Meta(ge=SMALLEST_SIGMA, le=100.0)] | None,
        "one sigma in pixels of a corner along each axis, such as 0.15",
    ] = None
    camera: Annotated[
        CameraSettings | None,
        "{mounted: fixed or on_flange, fx, fy, cx, cy, distortion: [k1, k2, p1, p2, k3], width, height}",
    ] = None
    board: Annotated[BoardSettings | None, "{columns: 7, rows: 5, square_m: 0.02, noise_m: 2.0e-5}"] = None
    points_m: Annotated[tuple[Point, ...] | None, "a list of the corners' [x, y, z] in m"] = None
    prior: Annotated[
        Mapping[str, Probability] | None,
        "probabilities of explanations by name, {calibration_off: 0.05}; `lite6jax effects --prior` lists them",
    ] = None
    date: Annotated[str | None, "a day as YYYY-MM-DD, such as 2026-11-21"] = None
    instrument: Annotated[Annotated[Line, Meta(max_length=120)] | None, "one line of at most 120 characters"] = None

    def __post_init__(self) -> None:
        values = field_values(self)
        for field in fields(self):
            value = values[field.name]
            if value is not None or field.default is not None:
                object.__setattr__(self, field.name, parse_setting(field.name, value))
        if self.factory_uncertainty and not self.factory_calibration:
            raise InputError(
                "factory_uncertainty: belongs to a factory_calibration; add that key or leave this one out"
            )

    @property
    def arm_is_file(self) -> bool:
        """Tells whether `arm` is the path of a description, not the name of a bundled arm."""
        arm = self.arm or ""
        return "/" in arm or "\\" in arm or Path(arm.partition("#")[0]).suffix.lower() in suffixes.ARM_FILES

    def arm_reference(self, folder: str | Path) -> str | Path:
        """The bundled arm's name, or the description's path when `folder` holds the sidecar.

        Raises:
            InputError: no arm is declared.
        """
        if self.arm is None:
            raise InputError("no arm is declared; name it with `arm=NAME`, or `arm:` in the sidecar")
        return Path(folder) / self.arm if self.arm_is_file else self.arm

    def factory_path(self, folder: str | Path) -> Path | None:
        """The factory calibration's path when `folder` holds the sidecar; None where there is none."""
        return Path(folder) / self.factory_calibration if self.factory_calibration else None

    def for_joints(self, joints: int, source: str) -> "RecordingSettings":
        """The same settings with a number for each joint, where one was given for all.

        Raises:
            InputError: lists that are of another number of joints; the message begins with `source`.
        """
        noise = self.torque_noise_Nm
        noises = (float(noise),) * joints if isinstance(noise, float | int) else noise
        per_joint = self if noises is noise else replace(self, torque_noise_Nm=noises)
        constants = self.torque_constant_Nm_per_A
        for key, numbers in (("torque_noise_Nm", noises), ("torque_constant_Nm_per_A", constants)):
            if numbers is not None and len(numbers) != joints:
                raise InputError(
                    f"{source}: recording.{key} has {len(numbers)} numbers for {joints} joints; give one per joint"
                )
        if isinstance(self.servo, ServoSettings):
            servo = self.servo
            for key, numbers in (
                ("stiffness_Nm_per_rad", servo.stiffness_Nm_per_rad),
                ("damping_Nm_s_per_rad", servo.damping_Nm_s_per_rad),
                ("torque_limit_Nm", servo.torque_limit_Nm),
                ("time_constant_s", servo.time_constant_s),
            ):
                if numbers is not None and len(numbers) != joints:
                    raise InputError(
                        f"{source}: recording.servo.{key} has {len(numbers)} numbers for {joints} joints; give one per "
                        "joint"
                    )
        return per_joint

    def moved(self, old_folder: str | Path, new_folder: str | Path) -> "RecordingSettings":
        """The same settings for a sidecar in another folder: relative paths still lead to the same files."""
        old = Path(old_folder).resolve()
        new = Path(new_folder).resolve()
        paths = {"arm": self.arm if self.arm_is_file else None, "factory_calibration": self.factory_calibration}
        relative = {key: path for key, path in paths.items() if path and not Path(path).is_absolute() and old != new}
        moved = {key: Path(os.path.relpath(old / path, new)).as_posix() for key, path in relative.items()}
        return replace(self, **moved)


def _split_hint(hint: Any) -> tuple[Any, str]:
    """The type of a value that is declared, for msgspec, and what it accepts in words."""
    annotations = ()
    if get_origin(hint) is Annotated:
        annotations = hint.__metadata__
    words = next((annotation for annotation in annotations if isinstance(annotation, str)), "")
    kind = hint.__origin__ if annotations == (words,) else hint
    if NoneType in get_args(kind):
        kind = reduce(or_, (member for member in get_args(kind) if member is not NoneType))
    return kind, words


KEYS: Mapping[str, tuple[Any, str]] = {
    key: _split_hint(hint) for key, hint in get_type_hints(RecordingSettings, include_extras=True).items()
}
"""Of each key the type of its value, and what it accepts in words; of listed words these are enough."""
OF_READINGS = (
    *("contact_noise_m", "contact_distances", "contact_points", "plane_noise_m", "planes", "distance_noise_m"),
    *("anchor_m", "distance_offset", "axis_noise_m", "axis", "pixel_noise_px", "camera", "board", "points_m"),
)
"""Keys of readings that are no poses."""


def parse_setting(key: str, value: Any) -> Any:
    """The value of a key of `RecordingSettings`, as a sidecar or an argument gives it.

    Raises:
        InputError: it is not accepted; the message begins with the key.
    """
    try:
        plain = msgspec.to_builtins(value, str_keys=True, enc_hook=lambda array: array.tolist())
        if key == "tool" and isinstance(plain, str) and " " in plain.strip():
            plain = plain.split()
        # YAML 1.1 reads 1e-5, which people write, as text: msgspec takes it for a number where it is not strict
        parsed: Any = msgspec.convert(plain, KEYS[key][0], strict=False)
        if key == "date":
            parsed = date.fromisoformat(parsed).isoformat()
        if parsed == {}:
            raise ValueError("empty")
        if (key == "axis" and not any(parsed)) or (key == "torque_constant_Nm_per_A" and 0.0 in parsed):
            raise ValueError("zero")
        if not _is_finite(parsed):
            raise ValueError("not finite")
    except (ValueError, TypeError, AttributeError) as error:
        reason = str(error).replace("`", "").replace(" - at $", ", at ").replace("Expected", "expected")
        explained = any(word in reason for word in (", got", "enum", "regex", "isoformat"))  # by what is to be given
        reason = "" if explained else f" ({reason})"
        raise InputError(f"{key}: {_shorten(value)} is not accepted{reason}; give {form_of(key)}") from error
    return parsed


def form_of(key: str) -> str:
    """The accepted forms of a key of `RecordingSettings`, in words."""
    kind, form = KEYS[key]
    *first, last = map(str, get_args(kind) or [""])
    return form or f"{', '.join(first)} or {last}"


def declared_settings(settings: RecordingSettings | None, arm: Any, declared: Mapping[str, Any]) -> RecordingSettings:
    """Settings with single keys replaced, as `Recording.from_arrays` takes them.

    Args:
        settings: the defaults where not given.
        arm: an `Arm`, or what names one; the settings' own where None.
        declared: keys of the sidecar to their values; arrays serve as lists.

    Raises:
        InputError: an unknown key (with the nearest accepted one) or an unusable value.
    """
    _reject_unknown("", declared, KEYS)
    keys = {**declared, **({} if arm is None else {"arm": str(getattr(arm, "name", arm))})}
    parsed = {key: None if value is None else parse_setting(key, value) for key, value in keys.items()}
    return replace(settings or RecordingSettings(), **parsed)


def _reject_unknown(place: str, content: Mapping[Any, Any], accepted: Iterable[str]) -> None:
    for key in content:
        if key not in accepted:
            nearest = get_close_matches(str(key), accepted, n=1)
            remedy = f"did you mean {nearest[0]}?" if nearest else f"accepted: {', '.join(accepted)}"
            raise InputError(f"{place}{str(key)[:60]}: unknown key; {remedy}")


def _shorten(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _is_finite(value: Any) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, msgspec.Struct):
        value = msgspec.structs.astuple(value)
    inside = value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ()
    return all(map(_is_finite, inside))


# ------------------------------------------------------------------ the sidecar


class Sidecar(NamedTuple):
    """What stands beside a recording.

    Attributes:
        settings: of the arm, the sensor and the motion.
        columns: of columns with names of their own, the documented names, or `ignore`.
        complete: whether the recording of an arm was completed; True where that is not said.
    """

    settings: RecordingSettings
    columns: Mapping[str, str]
    complete: bool = True


GROWING = ".growing.csv"
"""The suffix of the rows of a `.parquet` recording that is not complete yet."""


def growing_path(recording: str | Path) -> Path:
    """Where the rows of a `.parquet` recording stand until it is complete."""
    return Path(recording).with_suffix(GROWING)


def sidecar_path(recording: str | Path) -> Path:
    """Where the sidecar of a recording stands: the same stem, `.yaml`; of a folder, beside it."""
    path = Path(recording)
    if not os.path.isdir(path):
        path = path.with_suffix("") if path.name.endswith(GROWING) else path
        return path.with_suffix(".yaml")
    absolute = path if path.name not in ("", "..") else Path(os.path.abspath(path))  # such as the folder one is in
    return absolute.parent / f"{absolute.name}.yaml"


def read_settings(path: str | Path) -> RecordingSettings:
    """The settings in a sidecar; the defaults where the file does not exist.

    Raises:
        InputError: as `read_sidecar`.
    """
    return read_sidecar(path).settings


def list_sidecar_files(recording: str | Path) -> Iterator[tuple[str, Path]]:
    """What a recording is read with besides its own file: its sidecar, and the arm and the calibration that it names.

    Yields:
        the role, `settings`, `arm` or `calibration`, and the path; nothing where there is no sidecar.

    Raises:
        InputError: as `read_sidecar`, after the sidecar itself was named.
    """
    sidecar = sidecar_path(recording)
    if not exists(sidecar):
        return
    yield "settings", sidecar
    settings = read_settings(sidecar)
    if settings.arm_is_file:
        yield "arm", Path(str(settings.arm_reference(sidecar.parent)).partition("#")[0])
    if (calibration := settings.factory_path(sidecar.parent)) is not None:
        yield "calibration", calibration


def read_sidecar(path: str | Path) -> Sidecar:
    """What a sidecar says; the defaults where the file does not exist.

    Raises:
        InputError: not YAML, tags, alias bombs, an unknown key (with the nearest accepted one) or an unusable value.
    """
    path = Path(path)
    if not exists(path):
        if exists(path.with_suffix(".yml")):
            raise InputError(f"{path.with_suffix('.yml')}: a sidecar ends in .yaml; rename it to {path.name}")
        return Sidecar(RecordingSettings(), {})
    content = read_yaml(path)
    if not isinstance(content, dict) or not {"recording", "columns"} & set(content):
        raise InputError(f"{path}: is not a sidecar; give the key `recording:` with the settings below it")
    _reject_unknown(f"{path}: ", content, ["recording", "columns", "account"])
    settings, columns = ({} if (section := content.get(key)) is None else section for key in ("recording", "columns"))
    for key, section, lines in (
        ("recording", settings, "key: value"),
        ("columns", columns, "name in the table: q1_rad"),
    ):
        if not isinstance(section, dict):
            raise InputError(f"{path}: {key}: {_shorten(section)} is not a mapping; write `{lines}` lines below it")
    for name, meaning in columns.items():
        if not isinstance(meaning, str):
            raise InputError(
                f"{path}: columns.{str(name)[:60]}: {_shorten(meaning)} is no name of a column; write one such as "
                f"q1_rad, or {IGNORED}"
            )
    settings = _with_tip_in_arm(settings, path)
    _reject_unknown(f"{path}: recording.", settings, KEYS)
    for key, value in settings.items():
        if value is None:
            raise InputError(f"{path}: recording.{key}: has no value; give {form_of(key)}, or leave the key out")
    try:
        declared = RecordingSettings(**{key: parse_setting(key, value) for key, value in settings.items()})
    except InputError as error:
        raise InputError(f"{path}: recording.{error}") from error
    account = content.get("account")
    complete = not isinstance(account, dict) or account.get("complete") is not False
    return Sidecar(declared, {str(name): meaning.strip() for name, meaning in columns.items()}, complete)


def _with_tip_in_arm(settings: Mapping[Any, Any], path: Path) -> dict[Any, Any]:
    """The keys of `recording` with the arm `robot.urdf#tool0` in place of `arm: robot.urdf` and `tip: tool0`."""
    content = dict(settings)
    if "tip" not in content:
        return content
    tip = content.pop("tip")
    arm = content.get("arm")
    if not isinstance(tip, str) or not tip.strip():
        raise InputError(f"{path}: recording.tip: {_shorten(tip)} is not accepted; give the name of a link")
    if not isinstance(arm, str) or Path(arm).suffix.lower() not in suffixes.ARM_XML:
        raise InputError(
            f"{path}: recording.tip: names where the chain of a URDF or MJCF file ends; give the path of one as arm, "
            "without #, or leave tip out"
        )
    return {**content, "arm": f"{arm}#{tip.strip()}"}


def write_settings(
    settings: RecordingSettings,
    path: str | Path,
    overwrite: bool = False,
    account: Mapping[str, Any] | None = None,
) -> Path:
    """Writes a sidecar that `read_settings` reads back exactly.

    Declared keys are written even at their default; those of readings that are no poses only where they differ from it.

    Args:
        settings: what it declares.
        path: the file.
        overwrite: whether it may be replaced.
        account: what the recording of an arm says about itself: plain numbers and phrases, of which only `complete` is
            read back.

    Raises:
        InputError: the file exists and `overwrite` is false, or it cannot be written.
    """
    declared = {}
    values = field_values(settings)
    for field in fields(settings):
        value = values[field.name]
        if value is not None and not (field.name in OF_READINGS and value == field.default):
            declared[field.name] = value
    content = {"recording": declared} | ({} if account is None else {"account": dict(account)})
    text = yaml.safe_dump(
        msgspec.to_builtins(content), sort_keys=False, default_flow_style=None, width=120, allow_unicode=True
    )
    return write_atomically(path, text, overwrite)
