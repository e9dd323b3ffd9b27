"""Arm descriptions: YAML with a name, the six-parameter chain, and optionally limits, inertia, drives, DH, flange."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax import storage
from lite6jax.arms import entries, frames, inertia
from lite6jax.arms.arm import Arm
from lite6jax.arms.joint_units import joint_unit
from lite6jax.checksum import with_comment
from lite6jax.errors import InputError

DH = ("theta_off_rad", "d_m", "a_m", "alpha_rad")
OPTIONAL = ("joint_limits_rad", "joint_limits", "inertial", "dynamics", "dh", "convention", "flange", "source")


class Drive(NamedTuple):
    """How a description names what an arm knows of one joint's drive: keys and the fields of `Arm`."""

    friction: Mapping[str, str]
    rotor: str
    spring: Mapping[str, str]


REVOLUTE = Drive(
    {"viscous_Nm_s_per_rad": "viscous_friction", "coulomb_Nm": "coulomb_friction"},
    "rotor_inertia_kg_m2",
    {"stiffness_Nm_per_rad": "spring_stiffness", "rest_rad": "spring_rest"},
)
PRISMATIC = Drive(
    {joint_unit(key, True): field for key, field in REVOLUTE.friction.items()},
    joint_unit(REVOLUTE.rotor, True),
    {joint_unit(key, True): field for key, field in REVOLUTE.spring.items()},
)

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
    flange: {x: 0.0, y: 0.0, z: 0.0, roll: 0.0, pitch: 0.0, yaw: 0.0}  # after the last joint
    source: where the numbers are from
    ```

    `name` and `kinematics` are required; where `kinematics` is not given, the chain is that of `dh`, standard or with
    `convention: modified` Craig's, Rx(alpha) Tx(a) Rz(q + theta_off) Tz(d).

    A joint with `type: prismatic` beside its x … yaw moves along its z; the limits are then `joint_limits`, in m for
    prismatic joints and rad for others, and in `dynamics` its keys are `viscous_N_s_per_m`, `coulomb_N`,
    `rotor_mass_kg`, `stiffness_N_per_m` and `rest_m`, the rotor's mass being its inertia times the square of its turns
    per metre, rad²/m².

    A link's centre of mass is in the frame after its joint's motion; its inertia (ixx iyy izz ixy ixz iyz, the products
    with the tensor's sign) is about the centre of mass in that frame's axes, and given for all links or none. Friction,
    rotor inertia, reflected to the joint, and springs are zero where only another joint has them. `flange` may also be
    three rows of four numbers.

    Raises:
        InputError: as `storage.read_yaml`; a key missing or unknown, a value that is not a number, degrees for radians,
            millimetres for metres, or as `Arm`. The line names the file and the place.
    """
    return arm_from_description(storage.read_yaml(path), str(path))


def arm_from_description(content: Any, where: str) -> Arm:
    """The arm of a parsed description `content`; `where` begins its messages. Raises as `read_description`."""
    by_table = isinstance(content, Mapping) and "dh" in content and "kinematics" not in content
    chain = "dh" if by_table else "kinematics"
    content = entries.mapping(content, f"{where}:", ("name", chain), tuple(key for key in OPTIONAL if key != chain))
    for key in ("name", "source"):
        if not isinstance(content.get(key, ""), str):
            raise InputError(f"{where}: {key} is {content[key]!r}, which is not text; put it in quotes")
    convention = entries.convention(content.get("convention"), f"{where}: convention") or entries.STANDARD
    if by_table:
        kinematics, fields = _of_table(content["dh"], convention, where)
        sliding, joints = (), len(kinematics)
    else:
        table, sliding = entries.sliding(content["kinematics"], where)
        kinematics, _ = entries.kinematics(table, where)
        joints = len(kinematics)
        fields: dict[str, Any] = {"sliding": sliding}
        if convention == entries.MODIFIED:
            raise InputError(f"{where}: convention is modified, and dh beside kinematics is standard; leave dh out")
    for key in ("joint_limits_rad", "joint_limits"):
        if key in content:
            fields["joint_limits"] = _limits(content, key, where, joints, sliding)
    if "inertial" in content:
        fields["mass"], fields["center_of_mass"], fields["inertia"] = _inertial(content["inertial"], where, joints)
    if "dynamics" in content:
        fields |= _dynamics(content["dynamics"], where, joints, sliding)
    if "dh" in content and not by_table:
        fields["dh"] = _dh(content["dh"], where, joints)
    if "flange" in content:
        fields["T_joint_flange"] = fields.get("T_joint_flange", np.eye(4)) @ _flange(content["flange"], where)
    try:
        return Arm(content["name"], kinematics, source=content.get("source", ""), **fields)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _limits(
    content: Mapping[str, Any], key: str, where: str, joints: int, sliding: tuple[int, ...]
) -> NDArray[np.float64]:
    value = content[key]
    if "joint_limits" in content and "joint_limits_rad" in content:
        raise InputError(f"{where}: has joint_limits and joint_limits_rad; keep one")
    if sliding and key == "joint_limits_rad":
        raise InputError(
            f"{where}: joint_limits_rad, but joint{sliding[0] + 1} is prismatic; name the list joint_limits, in m for"
            " prismatic joints and rad for others"
        )
    if not isinstance(value, list) or len(value) != joints:
        raise InputError(f"{where}: {key} must list one [lower, upper] for each of the {joints} joints")
    limits = np.array([entries.numbers(row, f"{where}: joint{i + 1}'s limits", 2) for i, row in enumerate(value)])
    for i, row in enumerate(limits):
        if i in sliding and np.abs(row).max() > LARGEST_SHIFT:
            raise InputError(
                f"{where}: joint{i + 1}'s limits {row[0]:g} … {row[1]:g} are beyond any arm, so they seem to be in"
                " millimetres; write metres"
            )
        if i not in sliding and np.abs(row).max() > LARGEST_LIMIT:
            raise InputError(
                f"{where}: joint{i + 1}'s limits {row[0]:g} … {row[1]:g} are many turns, so they seem to be in degrees;"
                " write radians"
            )
    return limits


def _inertial(
    value: Any, where: str, joints: int
) -> tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating] | None]:
    names = [f"link{i + 1}" for i in range(joints)]
    links = entries.mapping(value, f"{where}: inertial", names)
    masses, centers, tensors = [], [], []
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
            gyration = np.sqrt(max(map(abs, tensors[-1])) / masses[-1]) if masses[-1] > 0 else 0.0
            if gyration > entries.LENGTH_LIMIT:
                raise InputError(
                    f"{place}: inertia_kg_m2 has a radius of gyration of {gyration:.3g} m, beyond any arm, so it seems"
                    " to be in kg mm²; write kg m²"
                )
    if tensors and len(tensors) < joints:
        lacking = next(name for name in names if "inertia_kg_m2" not in links[name])
        raise InputError(f"{where}: inertial: {lacking} lacks inertia_kg_m2, which other links have; give all or none")
    return np.array(masses), np.array(centers), inertia.tensor(tensors) if tensors else None


def _dynamics(value: Any, where: str, joints: int, sliding: tuple[int, ...]) -> dict[str, NDArray[np.floating]]:
    """The joints' drives by the field of `Arm`: those that any joint has."""
    names = [f"joint{i + 1}" for i in range(joints)]
    table = entries.mapping(value, f"{where}: dynamics", (), names)
    fields: dict[str, NDArray[np.floating]] = {}
    for i, name in enumerate(names):
        place, keys = f"{where}: dynamics: {name}", PRISMATIC if i in sliding else REVOLUTE
        drive = entries.mapping(table.get(name, {}), place, (), ("friction", keys.rotor, "spring"))
        friction = entries.mapping(drive.get("friction", {}), f"{place}: friction", (), tuple(keys.friction))
        given = [(keys.friction[key], number, f"{place}: friction: {key}") for key, number in friction.items()]
        given += [("rotor_inertia", drive[keys.rotor], f"{place}: {keys.rotor}")] if keys.rotor in drive else []
        if "spring" in drive:
            spring = entries.mapping(drive["spring"], f"{place}: spring", tuple(keys.spring))
            given += [(keys.spring[key], number, f"{place}: spring: {key}") for key, number in spring.items()]
        for field, number, at in given:
            fields.setdefault(field, np.zeros(joints))[i] = entries.number(number, at)
    return fields


def _dh(value: Any, where: str, joints: int) -> NDArray[np.float64]:
    table = entries.mapping(value, f"{where}: dh", [f"joint{i + 1}" for i in range(joints)])
    rows = []
    for i in range(joints):
        place = f"{where}: dh: joint{i + 1}"
        row = entries.mapping(table[f"joint{i + 1}"], place, DH)
        rows.append([entries.number(row[key], f"{place}: {key}") for key in DH])
    return np.array(rows)


def _of_table(value: Any, convention: str, where: str) -> tuple[NDArray[np.floating], dict[str, Any]]:
    """The chain of a DH table, and the fields of `Arm` that follow from it."""
    dh = _dh(value, where, len(value) if isinstance(value, Mapping) and value else 1)
    links, after = frames.links_from_dh(dh, convention)
    if not entries.within_reach(links):
        raise InputError(
            f"{where}: dh leads the flange farther than {entries.LENGTH_LIMIT:g} m from the base, so it seems to be in"
            " millimetres or degrees; write metres and radians"
        )
    if np.abs(links[:, :3, 3]).max() > entries.LENGTH_LIMIT:
        links = frames.aligned(links)
    fields: dict[str, Any] = {} if np.array_equal(after, np.eye(4)) else {"T_joint_flange": after}
    if convention == entries.STANDARD and not fields:
        fields["dh"] = dh
    return np.array([frames.row_from_transform(link) for link in links]), fields


def _flange(value: Any, where: str) -> NDArray[np.floating]:
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
    lines = [f"name: {_text(arm.name)}"]
    if arm.source:
        lines.append(f"source: {_text(arm.source)}")
    lines += ["kinematics:"]
    for i, row in enumerate(arm.kinematics):
        entry = entries.yaml_row(entries.SIX, row)
        lines.append(f"  joint{i + 1}: {entry.replace('{', '{type: prismatic, ', 1) if arm.slides[i] else entry}")
    lines.append("joint_limits:  # m for prismatic joints, rad for others" if arm.sliding else "joint_limits_rad:")
    lines += [f"  - {entries.yaml_list(row)}" for row in arm.joint_limits]
    if arm.mass is not None and arm.center_of_mass is not None:
        lines += ["inertial:"]
        for i, (mass, center) in enumerate(zip(arm.mass, arm.center_of_mass, strict=True)):
            body = f"mass_kg: {entries.yaml_number(mass)}, com_m: {entries.yaml_list(center)}"
            if arm.inertia is not None:
                body += f", inertia_kg_m2: {entries.yaml_list(inertia.six_entries(arm.inertia[i]))}"
            lines.append(f"  link{i + 1}: {{{body}}}")
    lines += _drive_lines(arm)
    if arm.dh is not None:
        lines += ["dh:"] + [f"  joint{i + 1}: {entries.yaml_row(DH, row)}" for i, row in enumerate(arm.dh)]
    if not np.array_equal(arm.T_joint_flange, np.eye(4)):
        row = frames.row_from_transform(arm.T_joint_flange)
        if np.array_equal(frames.transform_from_row(row), arm.T_joint_flange):
            lines.append(f"flange: {entries.yaml_row(entries.SIX, row)}")
        else:  # roll, pitch and yaw would not reproduce it exactly
            lines += ["flange:"] + [f"  - {entries.yaml_list(row)}" for row in arm.T_joint_flange[:3]]
    return storage.write_atomically(path, with_comment("\n".join(lines) + "\n"), overwrite)


def _drive_lines(arm: Arm) -> list[str]:
    lines = []
    for i in range(arm.dof):
        keys = PRISMATIC if arm.slides[i] else REVOLUTE
        friction = {key: values for key, field in keys.friction.items() if (values := getattr(arm, field)) is not None}
        spring = {key: values for key, field in keys.spring.items() if (values := getattr(arm, field)) is not None}
        drive = [f"friction: {_mapping(friction, i)}"] if friction else []
        drive += [] if arm.rotor_inertia is None else [f"{keys.rotor}: {entries.yaml_number(arm.rotor_inertia[i])}"]
        drive += [f"spring: {_mapping(spring, i)}"] if spring else []
        if drive:
            lines.append(f"  joint{i + 1}: {{{', '.join(drive)}}}")
    return ["dynamics:", *lines] if lines else []


def _mapping(table: Mapping[str, NDArray[np.floating]], i: int) -> str:
    return f"{{{', '.join(f'{key}: {entries.yaml_number(values[i])}' for key, values in table.items())}}}"


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)
