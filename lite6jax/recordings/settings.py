"""What a recording's columns cannot say about the arm, the sensor and the motion: the settings, and their values."""

import math
import os
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, asdict, dataclass, fields, replace
from datetime import date, datetime
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, get_args

from lite6jax.errors import InputError

JointSource = Literal["measured", "commanded", "unknown"]
PoseSource = Literal[
    "laser_tracker", "motion_capture", "camera", "controller_fk", "touch", "draw_wire", "height_gauge", "unknown"
]
Motion = Literal["static", "trajectory"]
TorqueSource = Literal["measured", "current", "estimated", "unknown"]
Inertial = Literal["declared", "unknown"] | float
PoseFrame = Literal["base", "unknown"]
Tool = Literal["none", "unknown"] | tuple[float, float, float, float, float, float]
Point = tuple[float, float, float]
Unknown = Literal["unknown"]

ARM_FILE_SUFFIXES = {".yaml", ".yml", ".json", ".urdf", ".xacro", ".xml"}
LONGEST_OFFSET_M = 5.0  # a tool or a payload further out than this was written in millimetres
SMALLEST_SIGMA, LARGEST_SIGMA = 1e-12, 1.0  # m or rad; beyond, squares of residuals over it lose all digits
LARGEST_GRAVITY = 100.0  # m/s²; that of no planet on which an arm stands
HIGHEST_TEMPERATURE = 1000.0
SMALLEST_TORQUE_SIGMA, LARGEST_TORQUE_SIGMA = 1e-9, 1e4  # Nm; the motors of the largest arms exert 1e5
LONGEST_LINE = 120  # of text that a certificate has room for
LARGEST_TORQUE_CONSTANT = 1e5  # Nm/A at the joint, gear included
LARGEST_PIXEL_NOISE = 100.0
LARGEST_BOARD = 10_000  # corners


@dataclass(frozen=True)
class FactoryUncertainty:
    """One sigma of every number of the factory calibration: m for lengths, rad for angles."""

    position_m: float
    rotation_rad: float


OF_READINGS = (
    *("contact_noise_m", "contact_distances", "contact_points", "plane_noise_m", "planes", "distance_noise_m"),
    *("anchor_m", "distance_offset", "axis_noise_m", "axis", "pixel_noise_px", "camera", "board", "points_m"),
)
"""Keys of readings that are no poses."""


@dataclass(frozen=True)
class KnownDistance:
    """The distance of two contacts, by their names, in m, and one sigma of it."""

    between: tuple[str, str]
    distance_m: float
    noise_m: float


@dataclass(frozen=True)
class KnownPlane:
    """A plane n · p = offset in the arm's base frame, with the normal n of any length."""

    normal: Point
    offset_m: float


@dataclass(frozen=True)
class CameraSettings:
    """A camera by OpenCV's model; lengths in pixels, `distortion` as k1, k2, p1, p2, k3.

    `mounted` is `fixed`, where it looks at a board on the flange, or `on_flange`, where it looks at a fixed board.
    """

    mounted: Literal["fixed", "on_flange"]
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    width: float = 0.0
    height: float = 0.0
    intrinsics: Literal["known", "refine"] = "known"


@dataclass(frozen=True)
class BoardSettings:
    """A board of inner corners: corner i is at column i mod `columns`, `square_m` apart; one sigma of its print."""

    columns: int
    rows: int
    square_m: float
    noise_m: float = 0.0

    @property
    def points(self) -> tuple[Point, ...]:
        """Of each corner, m in the board's frame."""
        count = self.columns * self.rows
        return tuple((i % self.columns * self.square_m, i // self.columns * self.square_m, 0.0) for i in range(count))


@dataclass(frozen=True)
class RecordingSettings:
    """What a sidecar declares; the defaults are those of a recording without one.

    Lengths in m, angles in rad, one sigma for each noise, `tool` as x y z roll pitch yaw (R = Rz Ry Rx).
    `inertial_uncertainty` is one sigma of masses, and of the lever arms of their centres, relative to them, where poses
    are explained. `inertial` is what holds where torques are: the numbers of the arm's description ("declared"), those
    of no description ("unknown"), or its numbers with a relative standard deviation. `torque_noise_Nm` and
    `torque_constant_Nm_per_A` have a number per joint. `date`, of the measurement (YYYY-MM-DD), and `instrument`, a
    line, stand on a certificate. Of these two, of torque constants, of `arm`, `motion` and of each noise of a sensor,
    None is what is not declared.
    Of readings that are no poses: a noise of each kind, and what is known of the points, planes, anchors and axes, in
    the arm's base frame. Points of contacts are in a frame of their own where all are given and `pose_frame` is
    unknown.
    `arm` and `factory_calibration` are kept as written: `arm_reference` and `factory_path` resolve them.

    Raises:
        InputError: a value of the wrong type, not finite, negative where that has no meaning, or not a listed one.
    """

    arm: str | None = None
    factory_calibration: str | None = None
    factory_uncertainty: FactoryUncertainty | None = None
    joint_source: JointSource = "unknown"
    joint_noise_rad: float = 0.0
    pose_source: PoseSource = "unknown"
    motion: Motion | None = None
    pose_frame: PoseFrame = "unknown"
    tool: Tool = "unknown"
    position_noise_m: float | None = None
    orientation_noise_rad: float | None = None
    payload_com_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reference_temperature_degC: float = 25.0  # noqa: N815 (the sidecar's key)
    gravity_m_per_s2: tuple[float, float, float] = (0.0, 0.0, -9.81)
    inertial_uncertainty: float = 0.1
    payload_uncertainty_kg: float = 0.0
    torque_source: TorqueSource = "unknown"
    torque_noise_Nm: tuple[float, ...] | None = None  # noqa: N815 (the sidecar's key)
    inertial: Inertial = "declared"
    torque_constant_Nm_per_A: tuple[float, ...] | None = None  # noqa: N815 (the sidecar's key)
    contact_noise_m: float | None = None
    contact_distances: tuple[KnownDistance, ...] = ()
    contact_points: Mapping[str, Point] | None = None
    plane_noise_m: float | None = None
    planes: Mapping[str, KnownPlane] | None = None
    distance_noise_m: float | None = None
    anchor_m: Unknown | Point | Mapping[str, Point] = "unknown"
    distance_offset: Literal["none", "unknown"] = "none"
    axis_noise_m: float | None = None
    axis: Unknown | Point = "unknown"
    pixel_noise_px: float | None = None
    camera: CameraSettings | None = None
    board: BoardSettings | None = None
    points_m: tuple[Point, ...] | None = None
    date: str | None = None
    instrument: str | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None and field.default is None:
                continue
            object.__setattr__(self, field.name, parse_setting(field.name, value))
        if self.factory_uncertainty and not self.factory_calibration:
            raise InputError(
                "factory_uncertainty: belongs to a factory_calibration; add that key or leave this one out"
            )

    @property
    def arm_is_file(self) -> bool:
        """Whether `arm` is the path of a description, not the name of a bundled arm."""
        return self.arm is not None and _names_a_file(self.arm)

    def arm_reference(self, folder: str | Path) -> str | Path:
        """The bundled arm's name, or the description's path when `folder` holds the sidecar.

        Raises:
            InputError: no arm is declared.
        """
        if self.arm is None:
            raise InputError("no arm is declared; name it with --arm, or `arm:` in the sidecar")
        return Path(folder) / self.arm if self.arm_is_file else self.arm

    def factory_path(self, folder: str | Path) -> Path | None:
        """The factory calibration's path when `folder` holds the sidecar; None where there is none."""
        return Path(folder) / self.factory_calibration if self.factory_calibration else None

    def require_joints(self, joints: int, source: str) -> None:
        """Refuses lists with a number per joint that are of an arm with another number of joints.

        Raises:
            InputError: as said; the message begins with `source`.
        """
        for key in ("torque_noise_Nm", "torque_constant_Nm_per_A"):
            given = getattr(self, key)
            if given is not None and len(given) != joints:
                raise InputError(
                    f"{source}: recording.{key} has {len(given)} numbers for {joints} joints; give one per joint"
                )

    def moved(self, old_folder: str | Path, new_folder: str | Path) -> "RecordingSettings":
        """The same settings for a sidecar in another folder: relative paths still lead to the same files."""
        if Path(old_folder).resolve() == Path(new_folder).resolve():
            return self

        def follow(path: str) -> str:
            there = Path(old_folder).resolve() / path
            return (
                path
                if Path(path).is_absolute()
                else Path(os.path.relpath(there, Path(new_folder).resolve())).as_posix()
            )

        return replace(
            self,
            arm=follow(self.arm) if self.arm is not None and self.arm_is_file else self.arm,
            factory_calibration=follow(self.factory_calibration) if self.factory_calibration else None,
        )


def declared_settings(settings: RecordingSettings | None, arm: Any, declared: Mapping[str, Any]) -> RecordingSettings:
    """Settings with single keys replaced, as `Recording.from_arrays` takes them.

    Args:
        settings: the defaults where not given.
        arm: an `Arm`, or what names one; the settings' own where None.
        declared: keys of the sidecar to their values; arrays serve as lists.

    Raises:
        InputError: an unknown key (with the nearest accepted one) or an unusable value.
    """
    reject_unknown("", declared, _KINDS)
    keys = {key: value.tolist() if hasattr(value, "tolist") else value for key, value in declared.items()}
    if arm is not None:
        keys["arm"] = str(getattr(arm, "name", arm))
    parsed = {key: None if value is None else parse_setting(key, value) for key, value in keys.items()}
    return replace(settings or RecordingSettings(), **parsed)


@dataclass(frozen=True)
class _Kind:
    """How a value is read, and the accepted forms in words. `parse` raises ValueError, with a remedy or empty."""

    parse: Callable[[Any], Any]
    form: str


def parse_setting(key: str, value: Any) -> Any:
    """The value of a key of `RecordingSettings`, as a sidecar or an argument gives it.

    Raises:
        InputError: it is not accepted; the message begins with the key.
    """
    kind = _KINDS[key]
    try:
        return kind.parse(value)
    except InputError:  # says its own place
        raise
    except ValueError as error:
        raise InputError(f"{key}: {shown(value)} is not accepted{error}; give {kind.form}") from error


def form_of(key: str) -> str:
    """The accepted forms of a key of `RecordingSettings`, in words."""
    return _KINDS[key].form


def reject_unknown(place: str, given: Mapping[Any, Any], accepted: Iterable[str]) -> None:
    """Refuses a key that is not accepted, with the nearest one that is.

    Raises:
        InputError: as said; the message begins with `place` and the key.
    """
    accepted = list(accepted)
    for key in given:
        if key not in accepted:
            nearest = get_close_matches(str(key), accepted, n=1)
            remedy = f"did you mean {nearest[0]}?" if nearest else f"accepted: {', '.join(accepted)}"
            raise InputError(f"{place}{str(key)[:60]}: unknown key; {remedy}")


def shown(value: Any) -> str:
    """A value in a message, shortened."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _names_a_file(arm: str) -> bool:
    return "/" in arm or "\\" in arm or Path(arm.partition("#")[0]).suffix.lower() in ARM_FILE_SUFFIXES


def _text(value: Any) -> str:
    if not isinstance(value, str) or not value.strip() or not value.isprintable():
        raise ValueError
    return value


def _line(value: Any) -> str:
    if len(_text(value)) > LONGEST_LINE:
        raise ValueError(f" (over {LONGEST_LINE} characters)")
    return value.strip()


def _day(value: Any) -> str:
    if isinstance(value, datetime):
        raise ValueError(" (a time of day)")
    if isinstance(value, date):  # as YAML reads a day without quotes
        return value.isoformat()
    if not re.fullmatch(r"\d{4}-\d\d-\d\d", _text(value), re.ASCII):
        raise ValueError
    try:
        return date.fromisoformat(value).isoformat()
    except ValueError:
        raise ValueError(" (no such day)") from None


def _path(value: Any) -> str:
    if not _names_a_file(_text(value)):
        raise ValueError(" (it has no suffix)")
    return value


def _number(value: Any) -> float:
    # YAML 1.1 reads 1e-5, which people write, as text: only 1.0e-5 is a number to it
    if isinstance(value, str) and re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+", value):
        value = float(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError
    try:
        number = float(value)
    except OverflowError:
        raise ValueError(" (not finite)") from None
    if not math.isfinite(number):
        raise ValueError(" (not finite)")
    return number


Parse = Callable[[Any], Any]


def _up_to(most: float, remark: str = "") -> Parse:
    """Reads a number from 0."""

    def read(value: Any) -> float:
        if (number := _number(value)) < 0:
            raise ValueError(" (negative)")
        if number > most:
            raise ValueError(f" (above {most:g}{remark})")
        return number

    return read


def _positive(least: float, most: float, remark: str = "") -> Parse:
    """Reads a number above 0 and within bounds."""

    def read(value: Any) -> float:
        if (number := _number(value)) <= 0:
            raise ValueError(" (not positive)")
        if not least <= number <= most:
            raise ValueError(f" (not from {least:g} to {most:g}{remark})")
        return number

    return read


_ratio = _up_to(0.5, ": per cent?")
_sigma = _positive(SMALLEST_SIGMA, LARGEST_SIGMA)
_pixels = _positive(SMALLEST_SIGMA, LARGEST_PIXEL_NOISE)
_length = _positive(SMALLEST_SIGMA, LONGEST_OFFSET_M, ": millimetres?")


def _temperature(value: Any) -> float:
    if not -273.15 <= (number := _number(value)) <= HIGHEST_TEMPERATURE:
        raise ValueError(f" (not from -273.15 to {HIGHEST_TEMPERATURE:g})")
    return number


def _torque_constant(value: Any) -> float:
    if not 0 < abs(number := _number(value)) <= LARGEST_TORQUE_CONSTANT:
        raise ValueError(" (zero)" if number == 0 else f" (beyond {LARGEST_TORQUE_CONSTANT:g})")
    return number


def _listed(parse: Parse, fewest: int = 1, most: int = 1 << 20) -> Parse:
    """Reads a list of so many values."""

    def read(value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list | tuple) or not fewest <= len(value) <= most:
            raise ValueError
        return tuple(parse(part) for part in value)

    return read


_point = _listed(_number, 3, 3)


def _gravity(value: Any) -> Point:
    if max(map(abs, gravity := _point(value))) > LARGEST_GRAVITY:
        raise ValueError(f" (over {LARGEST_GRAVITY:g} m/s^2)")
    return gravity


def _offset(value: Any) -> Point:
    if math.hypot(*(offset := _point(value))) > LONGEST_OFFSET_M:
        raise ValueError(f" (over {LONGEST_OFFSET_M:g} m long: millimetres?)")
    return offset


def _direction(value: Any) -> Point:
    if not math.hypot(*(direction := _point(value))) > 0:
        raise ValueError(" (no direction)")
    return direction


def _record(kind: type, place: str, **parse: Parse) -> Parse:
    """Reads a mapping with the fields of a dataclass; those without a default are needed."""

    def read(value: Any) -> Any:
        given = asdict(value) if isinstance(value, kind) else value
        if not isinstance(given, Mapping):
            raise ValueError
        reject_unknown(place, given, parse)
        lacking = [f.name for f in fields(kind) if f.default is MISSING and f.name not in given]
        if lacking:
            raise ValueError(f" (without {lacking[0]})")
        found = {}
        for key, part in given.items():
            try:
                found[key] = parse[key](part)
            except ValueError as error:
                raise ValueError(f" (at {key}{error})") from None
        return kind(**found)

    return read


def _by_name(parse: Parse) -> Parse:
    def read(value: Any) -> dict[str, Any]:
        if not isinstance(value, Mapping) or not value:
            raise ValueError
        return {str(name): parse(part) for name, part in value.items()}

    return read


def _choice(*accepted: str) -> Parse:
    def read(value: Any) -> str:
        if not isinstance(value, str) or value not in accepted:
            raise ValueError
        return value

    return read


def _distortion(value: Any) -> tuple[float, ...]:
    if not isinstance(value, list | tuple) or len(value) not in (4, 5):
        raise ValueError(" (give k1, k2, p1, p2 and perhaps k3)")
    return tuple(_number(part) for part in value) + (0.0,) * (5 - len(value))


def _corners(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= LARGEST_BOARD:
        raise ValueError
    return value


def _pair(value: Any) -> tuple[str, str]:
    if not isinstance(value, list | tuple) or len({*map(str, value)}) != 2 or len(value) != 2:
        raise ValueError(" (give the names of two contacts)")
    return str(value[0]), str(value[1])


_uncertainty = _record(FactoryUncertainty, "factory_uncertainty.", position_m=_sigma, rotation_rad=_sigma)
_distances = _listed(_record(KnownDistance, "knowndistance: ", between=_pair, distance_m=_length, noise_m=_sigma), 0)
_planes = _by_name(_record(KnownPlane, "knownplane: ", normal=_direction, offset_m=_number))
_camera = _record(
    CameraSettings,
    "camera: ",
    mounted=_choice("fixed", "on_flange"),
    **dict.fromkeys(("fx", "fy"), _positive(0.0, math.inf)),
    **dict.fromkeys(("cx", "cy"), _number),
    **dict.fromkeys(("width", "height"), _up_to(math.inf)),
    distortion=_distortion,
    intrinsics=_choice("known", "refine"),
)
_board = _record(
    BoardSettings, "board: ", columns=_corners, rows=_corners, square_m=_length, noise_m=_up_to(LARGEST_SIGMA)
)


def _anchor(value: Any) -> Any:
    return _by_name(_point)(value) if isinstance(value, Mapping) else value if value == "unknown" else _point(value)


def _axis(value: Any) -> Any:
    return value if value == "unknown" else _direction(value)


def _inertial(value: Any) -> Inertial:
    if value in ("declared", "unknown"):
        return value
    if (number := _ratio(value)) == 0:
        raise ValueError(" (zero: write declared)")
    return number


def _tool(value: Any) -> Tool:
    if value in ("none", "unknown"):
        return value
    if isinstance(value, str):
        try:
            value = [float(part) for part in value.split()]
        except ValueError:
            raise ValueError from None
    tool = _listed(_number, 6, 6)(value)
    _offset(tool[:3])
    if max(map(abs, tool[3:])) > 2 * math.pi:
        raise ValueError(" (an angle beyond one turn: degrees?)")
    return tool


def _one_of(choices: Any) -> _Kind:
    *first, last = accepted = get_args(choices)
    return _Kind(_choice(*accepted), f"{', '.join(first)} or {last}")


_KINDS: dict[str, _Kind] = {
    "arm": _Kind(_text, "a bundled arm's name, or the path of an arm description relative to the sidecar"),
    "factory_calibration": _Kind(_path, "the path of the arm's own six-parameter file, relative to the sidecar"),
    "factory_uncertainty": _Kind(
        _uncertainty,
        "{position_m: 1.0e-5, rotation_rad: 1.0e-5}, both positive (leave it out where the file holds exactly)",
    ),
    "joint_source": _one_of(JointSource),
    "joint_noise_rad": _Kind(_up_to(LARGEST_SIGMA), "one sigma in rad, zero or more"),
    "pose_source": _one_of(PoseSource),
    "motion": _one_of(Motion),
    "pose_frame": _one_of(PoseFrame),
    "tool": _Kind(_tool, "none, unknown, or six numbers [x, y, z, roll, pitch, yaw] in m and rad"),
    "position_noise_m": _Kind(_sigma, "one sigma in m, more than zero (leave it out where unknown)"),
    "orientation_noise_rad": _Kind(_sigma, "one sigma in rad, more than zero (leave it out where unknown)"),
    "payload_com_m": _Kind(_offset, "three numbers [x, y, z] in m"),
    "reference_temperature_degC": _Kind(_temperature, "a finite number in degrees Celsius"),
    "gravity_m_per_s2": _Kind(_gravity, "three numbers [x, y, z] in m/s^2"),
    "inertial_uncertainty": _Kind(_ratio, "one sigma relative to the masses, from 0 to 0.5, such as 0.1"),
    "payload_uncertainty_kg": _Kind(_up_to(1000.0), "one sigma in kg, zero or more"),
    "torque_source": _one_of(TorqueSource),
    "torque_noise_Nm": _Kind(
        _listed(_positive(SMALLEST_TORQUE_SIGMA, LARGEST_TORQUE_SIGMA)),
        "a list with one sigma in N m per joint, each more than zero (leave it out where unknown)",
    ),
    "inertial": _Kind(
        _inertial, "declared, unknown (they are fitted), or a relative uncertainty up to 0.5, such as 0.1"
    ),
    "torque_constant_Nm_per_A": _Kind(
        _listed(_torque_constant), "a list with one number in N m per A for each joint, none zero"
    ),
    "contact_noise_m": _Kind(_sigma, "one sigma in m of the touched point about its contact, more than zero"),
    "contact_distances": _Kind(_distances, "a list of {between: [a, b], distance_m: 0.05, noise_m: 5.0e-5}"),
    "contact_points": _Kind(_by_name(_point), "contacts by name, each with [x, y, z] in m"),
    "plane_noise_m": _Kind(_sigma, "one sigma in m of the touched point from its plane, more than zero"),
    "planes": _Kind(
        _planes,
        "planes by name, each with {normal: [x, y, z], offset_m: 0.0}",
    ),
    "distance_noise_m": _Kind(_sigma, "one sigma in m, more than zero"),
    "anchor_m": _Kind(_anchor, "unknown, [x, y, z] in m, or anchors by name with [x, y, z] each"),
    "distance_offset": _Kind(_choice("none", "unknown"), "none or unknown"),
    "axis_noise_m": _Kind(_sigma, "one sigma in m, more than zero"),
    "axis": _Kind(_axis, "unknown, or a direction [x, y, z]"),
    "pixel_noise_px": _Kind(
        _positive(SMALLEST_SIGMA, LARGEST_PIXEL_NOISE), "one sigma in pixels of a corner along each axis, such as 0.15"
    ),
    "camera": _Kind(
        _camera, "{mounted: fixed or on_flange, fx, fy, cx, cy, distortion: [k1, k2, p1, p2, k3], width, height}"
    ),
    "board": _Kind(_board, "{columns: 7, rows: 5, square_m: 0.02, noise_m: 2.0e-5}"),
    "points_m": _Kind(_listed(_point, 0), "a list of the corners' [x, y, z] in m"),
    "date": _Kind(_day, "a day as YYYY-MM-DD, such as 2026-11-21"),
    "instrument": _Kind(_line, f"one line of at most {LONGEST_LINE} characters"),
}
