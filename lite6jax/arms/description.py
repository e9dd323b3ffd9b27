"""Arm descriptions: YAML with a name, the six-parameter chain, and optionally limits, inertia, drives, DH, flange."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from lite6jax import storage
from lite6jax.arms import entries, frames
from lite6jax.arms.arm import Arm, joint_unit
from lite6jax.array_types import Array
from lite6jax.errors import InputError

DH = ("theta_off_rad", "d_m", "a_m", "alpha_rad")
_OPTIONAL = ("joint_limits_rad", "joint_limits", "inertial", "dynamics", "dh", "convention", "flange", "source")
_DRIVES = (
    ("friction", "viscous_Nm_s_per_rad", "viscous_friction"),
    ("friction", "coulomb_Nm", "coulomb_friction"),
    ("", "rotor_inertia_kg_m2", "rotor_inertia"),
    ("spring", "stiffness_Nm_per_rad", "spring_stiffness"),
    ("spring", "rest_rad", "spring_rest"),
)
"""Of a revolute joint's drive: the mapping within its entry, the key there, and the field of `Arm`."""

# rad, four turns: a larger limit is an angle in degrees.
LARGEST_LIMIT = 8 * np.pi

# m; a larger limit of a prismatic joint is in millimetres.
LARGEST_SHIFT = 100.0

# kg; a heavier link is in grams.
LARGEST_MASS = 1000.0


def read_description(path: str | Path) -> Arm:
    """An arm from its description.

    ```yaml
    name: my_arm
    kinematics:
      joint1: {x: 0.0, y: 0.0, z: 0.2433, roll: 0.0, pitch: 0.0, yaw: 0.0}  # m, rad; one row per joint
    joint_limits_rad: [[-3.1, 3.1]]
    inertial:
      link1: {mass_kg: 1.4, com_m: [0.0, 0.04, 0.0], inertia_kg_m2: [1.5e-3, 0.9e-3, 1.3e-3, 0.0, 0.0, 0.0]}
    dynamics:
      joint1: {friction: {viscous_Nm_s_per_rad: 0.1, coulomb_Nm: 0.2}, rotor_inertia_kg_m2: 0.01,
               spring: {stiffness_Nm_per_rad: 2.0, rest_rad: 0.0}}
    dh:
      joint1: {theta_off_rad: 0.0, d_m: 0.2433, a_m: 0.0, alpha_rad: 0.0}  # the published table, if any
    flange: {x: 0.0, y: 0.0, z: 0.0, roll: 0.0, pitch: 0.0, yaw: 0.0}  # after the last joint, or three rows of four
    source: where the numbers are from
    ```

    `name` and `kinematics` are required. Without `kinematics` the chain is that of `dh`, with `convention: modified` in
    Craig's convention. A joint with `type: prismatic` moves along its z: limits are then `joint_limits`, and its keys
    have the units of `joint_unit`. A link's centre of mass is in the frame after its joint's motion. Its inertia (ixx
    iyy izz ixy ixz iyz) is about the centre of mass in that frame's axes, and given for all links or none. Friction,
    rotor inertia and springs are zero where only another joint has them.

    Raises:
        InputError: as `storage.read_yaml`; a key missing or unknown, a value that is not a number, degrees for radians,
            millimetres for metres, or as `Arm`. The line names the file and the place.
    """
    return arm_from_description(storage.read_yaml(path), str(path))


def arm_from_description(content: Any, where: str) -> Arm:
    """The arm of a parsed description `content`; `where` begins its messages. Raises as `read_description`."""
    by_table = isinstance(content, Mapping) and "dh" in content and "kinematics" not in content
    chain = "dh" if by_table else "kinematics"
    content = entries.mapping(content, f"{where}:", ("name", chain), tuple(key for key in _OPTIONAL if key != chain))
    for key in ("name", "source"):
        if not isinstance(content.get(key, ""), str):
            raise InputError(f"{where}: {key} is {content[key]!r}, which is not text; put it in quotes")
    convention = entries.convention(content.get("convention"), f"{where}: convention") or entries.STANDARD
    if by_table:
        kinematics, fields = _chain_of_table(content["dh"], convention, where)
        sliding = ()
    else:
        kinematics, _, sliding = entries.kinematics(content["kinematics"], where, typed=True)
        fields: dict[str, Any] = {"sliding": sliding}
        if convention == entries.MODIFIED:
            raise InputError(f"{where}: convention is modified, and dh beside kinematics is standard; leave dh out")
        if "dh" in content:
            fields["dh"] = _dh(content["dh"], where, len(kinematics))
    joints = len(kinematics)
    if "joint_limits" in content or "joint_limits_rad" in content:
        fields["joint_limits"] = _limits(content, where, joints, sliding)
    if "inertial" in content:
        fields |= _inertial(content["inertial"], where, joints)
    if "dynamics" in content:
        fields |= _dynamics(content["dynamics"], where, joints, sliding)
    if "flange" in content:
        fields["T_joint_flange"] = fields.get("T_joint_flange", np.eye(4)) @ _flange(content["flange"], where)
    try:
        return Arm(content["name"], kinematics, source=content.get("source", ""), **fields)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


FRANKA_JOINTS = 7
"""Of every arm whose file has the layout of franka_description; what follows them is fixed, up to the flange."""


def is_franka(content: Any) -> bool:
    """Tells whether the parsed content of a file has the layout of a `kinematics.yaml` of franka_description."""
    entries_of_joints = ()
    if isinstance(content, Mapping):
        entries_of_joints = content.values()
    return bool(entries_of_joints) and all(
        isinstance(entry, Mapping) and set(entry) == {"kinematic"} for entry in entries_of_joints
    )


def arm_from_franka(content: Mapping[str, Any], where: str) -> Arm:
    """The arm of a parsed `kinematics.yaml` of franka_description: joints 1 to 7, and the flange as the eighth.

    Its joint limits and masses stand in other files, and are not known.

    Raises:
        InputError: joints or numbers missing, or lengths of no arm.
    """
    table = {joint: entry["kinematic"] for joint, entry in content.items()}
    rows, _, _ = entries.kinematics(table, where)
    flange = np.eye(4)
    for row in rows[FRANKA_JOINTS:]:
        flange = flange @ frames.transform_from_row(row)
    source = f"{Path(where).name}, in the layout of franka_description"
    return Arm(Path(where).stem, rows[:FRANKA_JOINTS], T_joint_flange=flange, source=source)


def _limits(content: Mapping[str, Any], where: str, joints: int, sliding: tuple[int, ...]) -> Array:
    key = "joint_limits" if "joint_limits" in content else "joint_limits_rad"
    if "joint_limits" in content and "joint_limits_rad" in content:
        raise InputError(f"{where}: has joint_limits and joint_limits_rad; keep one")
    if sliding and key == "joint_limits_rad":
        raise InputError(
            f"{where}: joint_limits_rad, but joint{sliding[0] + 1} is prismatic; name the list joint_limits, in m for"
            " prismatic joints and rad for others"
        )
    value = content[key]
    if not isinstance(value, list) or len(value) != joints:
        raise InputError(f"{where}: {key} must list one [lower, upper] for each of the {joints} joints")
    limits = np.array([entries.numbers(row, f"{where}: joint{i + 1}'s limits", 2) for i, row in enumerate(value)])
    for i, row in enumerate(limits):
        largest = LARGEST_LIMIT
        remark = "many turns, so they seem to be in degrees; write radians"
        if i in sliding:
            largest = LARGEST_SHIFT
            remark = "beyond any arm, so they seem to be in millimetres; write metres"
        if np.abs(row).max() > largest:
            raise InputError(f"{where}: joint{i + 1}'s limits {row[0]:g} … {row[1]:g} are {remark}")
    return limits


def _inertial(value: Any, where: str, joints: int) -> dict[str, Array]:
    """The fields of `Arm` that say what its links are."""
    names = [f"link{i + 1}" for i in range(joints)]
    links = entries.mapping(value, f"{where}: inertial", names)
    masses = []
    centers = []
    tensors = []
    for name in names:
        place = f"{where}: inertial: {name}"
        link = entries.mapping(links[name], place, ("mass_kg", "com_m"), ("inertia_kg_m2",))
        masses.append(entries.number(link["mass_kg"], f"{place}: mass_kg"))
        centers.append(entries.numbers(link["com_m"], f"{place}: com_m", 3))
        if masses[-1] > LARGEST_MASS:
            raise InputError(f"{place}: mass_kg is {masses[-1]:g}, heavier than any arm, so it seems to be in grams")
        if max(map(abs, centers[-1])) > entries.LENGTH_LIMIT:
            raise InputError(f"{place}: com_m is {centers[-1]}, beyond any arm, so it seems to be in millimetres")
        if "inertia_kg_m2" in link:
            tensors.append(entries.numbers(link["inertia_kg_m2"], f"{place}: inertia_kg_m2", 6))
            gyration = 0.0
            if masses[-1] > 0:
                gyration = np.sqrt(max(map(abs, tensors[-1])) / masses[-1])
            if gyration > entries.LENGTH_LIMIT:
                raise InputError(
                    f"{place}: inertia_kg_m2 has a radius of gyration of {gyration:.3g} m, beyond any arm, so it seems"
                    " to be in kg mm²; write kg m²"
                )
    if tensors and len(tensors) < joints:
        lacking = next(name for name in names if "inertia_kg_m2" not in links[name])
        raise InputError(f"{where}: inertial: {lacking} lacks inertia_kg_m2, which other links have; give all or none")
    fields = {"mass": np.array(masses), "center_of_mass": np.array(centers)}
    return fields | ({"inertia": frames.tensor(tensors)} if tensors else {})


def _dynamics(value: Any, where: str, joints: int, sliding: tuple[int, ...]) -> dict[str, Array]:
    """The joints' drives by the field of `Arm`: those that any joint has."""
    names = [f"joint{i + 1}" for i in range(joints)]
    table = entries.mapping(value, f"{where}: dynamics", (), names)
    fields: dict[str, Array] = {}
    for i, name in enumerate(names):
        keys = [(group, joint_unit(key, i in sliding), field) for group, key, field in _DRIVES]
        tops = tuple(dict.fromkeys(group or key for group, key, _ in keys))
        place = f"{where}: dynamics: {name}"
        drive = entries.mapping(table.get(name, {}), place, (), tops)
        for group in ("friction", "spring"):
            group_keys = tuple(key for within, key, _ in keys if within == group)
            if group in drive:
                entries.mapping(
                    drive[group], f"{place}: {group}", *((group_keys, ()) if group == "spring" else ((), group_keys))
                )
        for group, key, field in keys:
            section, at = (drive.get(group, {}), f"{place}: {group}") if group else (drive, place)
            if key in section:
                fields.setdefault(field, np.zeros(joints))[i] = entries.number(section[key], f"{at}: {key}")
    return fields


def _dh(value: Any, where: str, joints: int) -> Array:
    names = [f"joint{i + 1}" for i in range(joints)]
    table = entries.mapping(value, f"{where}: dh", names)
    return np.array([entries.row(table[name], f"{where}: dh: {name}", DH) for name in names])


def _chain_of_table(value: Any, convention: str, where: str) -> tuple[Array, dict[str, Any]]:
    """The chain of a DH table, and the fields of `Arm` that follow from it."""
    dh = _dh(value, where, len(value) if isinstance(value, Mapping) and value else 1)
    links, after = frames.links_from_dh(dh, convention)
    if not entries.is_reachable(links):
        raise InputError(
            f"{where}: dh leads the flange farther than {entries.LENGTH_LIMIT:g} m from the base, so it seems to be in"
            " millimetres or degrees; write metres and radians"
        )
    if np.abs(links[:, :3, 3]).max() > entries.LENGTH_LIMIT:
        links = frames.align_frames(links)
    fields: dict[str, Any] = {} if np.array_equal(after, np.eye(4)) else {"T_joint_flange": after}
    if convention == entries.STANDARD and not fields:
        fields["dh"] = dh
    return frames.row_from_transform(links), fields


def _flange(value: Any, where: str) -> Array:
    if isinstance(value, Mapping):
        return frames.transform_from_row(entries.six_numbers(value, f"{where}: flange"))
    if not isinstance(value, list) or len(value) != 3:
        raise InputError(f"{where}: flange must be x y z roll pitch yaw by name, or three rows of four numbers")
    rows = [entries.numbers(row, f"{where}: flange row {i + 1}", 4) for i, row in enumerate(value)]
    if max(abs(row[3]) for row in rows) > entries.LENGTH_LIMIT:
        raise InputError(
            f"{where}: flange is further out than any arm's, so it seems to be in millimetres; write metres"
        )
    return np.array([*rows, [0.0, 0.0, 0.0, 1.0]])


def write_arm(arm: Arm, path: str | Path, overwrite: bool = False) -> Path:
    """Writes the arm's description; `read_description` returns every number exactly.

    Raises:
        InputError: as `storage.write_atomically`.
    """
    joints = [f"joint{i + 1}" for i in range(arm.dof)]
    content: dict[str, Any] = {"name": arm.name} | ({"source": arm.source} if arm.source else {})
    content["kinematics"] = {
        joint: ({"type": entries.TYPES[1]} if slides else {}) | _row_mapping(entries.SIX, row)
        for joint, slides, row in zip(joints, arm.slides, arm.kinematics, strict=True)
    }
    content["joint_limits" if arm.sliding else "joint_limits_rad"] = arm.joint_limits.tolist()
    if arm.mass is not None and arm.center_of_mass is not None:
        tensors = {}
        if arm.inertia is not None:
            tensors = {"inertia_kg_m2": frames.six_entries(arm.inertia)}
        columns = {"mass_kg": arm.mass, "com_m": arm.center_of_mass} | tensors
        content["inertial"] = {
            f"link{i + 1}": {key: column[i].tolist() for key, column in columns.items()} for i in range(arm.dof)
        }
    drives = {joint: _drive(arm, i) for i, joint in enumerate(joints)}
    content |= {"dynamics": drives} if any(drives.values()) else {}
    if arm.dh is not None:
        content["dh"] = {joint: _row_mapping(DH, row) for joint, row in zip(joints, arm.dh, strict=True)}
    if not np.array_equal(arm.T_joint_flange, np.eye(4)):
        row = frames.row_from_transform(arm.T_joint_flange)
        exact = np.array_equal(frames.transform_from_row(row), arm.T_joint_flange)
        content["flange"] = _row_mapping(entries.SIX, row) if exact else arm.T_joint_flange[:3].tolist()
    return entries.write_yaml(content, path, overwrite, flow=None)


def _drive(arm: Arm, i: int) -> dict[str, Any]:
    """What the arm knows of joint `i`, from 0, as `_dynamics` reads it."""
    drive: dict[str, Any] = {}
    drives = arm.drives
    for group, key, field in _DRIVES:
        if field in drives:
            within = drive.setdefault(group, {}) if group else drive
            within[joint_unit(key, bool(arm.slides[i]))] = float(drives[field][i])
    return drive


def _row_mapping(keys: tuple[str, ...], values: Array) -> dict[str, float]:
    return dict(zip(keys, values.tolist(), strict=True))


# ------------------------------------------------------------------ the arms that come with the library


_DATA = Path(__file__).parent / "data"

# The same model from another file of the vendor: excluded when the model of a calibration is recognised.
VARIANTS = ("lite6_ros",)

_MAKERS = {"lite6": "UFACTORY", "uf": "UFACTORY", "xarm": "UFACTORY", "ur": "Universal Robots"}
"""By how the name of an arm begins."""


@cache
def bundled_arms() -> tuple[str, ...]:
    """The names of the bundled arms, in alphabetical order."""
    return tuple(sorted(path.stem for path in _DATA.glob("*.yaml")))


def maker_of(name: str) -> str:
    """Who makes the bundled arm of this name; empty of any other arm."""
    return next((maker for start, maker in _MAKERS.items() if name in bundled_arms() and name.startswith(start)), "")


def bundled_of(joints: int) -> list[Arm]:
    """The bundled models of so many joints, in alphabetical order; of each one table."""
    arms = [load_bundled(name) for name in bundled_arms() if name not in VARIANTS]
    return [arm for arm in arms if arm.dof == joints]


@cache
def load_bundled(name: str) -> Arm:
    """A bundled arm by its name; refuses another one with a list of the names."""
    if name not in bundled_arms():
        raise InputError(f"no bundled arm {name!r}; {entries.suggestion(name, bundled_arms())}")
    return read_description(_DATA / f"{name}.yaml")
