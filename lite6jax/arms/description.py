"""Arm descriptions: YAML with a name, the six-parameter chain, and optionally limits, masses, DH table and flange."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lite6jax import storage
from lite6jax.arms import entries, frames
from lite6jax.arms.arm import Arm
from lite6jax.checksum import with_comment
from lite6jax.errors import InputError

DH = ("theta_off_rad", "d_m", "a_m", "alpha_rad")
OPTIONAL = ("joint_limits_rad", "inertial", "dh", "flange", "source")

# rad, four turns: a larger limit is an angle in degrees.
LARGEST_LIMIT = 8 * np.pi

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
      link1: {mass_kg: 1.4, com_m: [0.0, 0.04, 0.0]}  # in the frame after the joint's rotation
    dh:
      joint1: {theta_off_rad: 0.0, d_m: 0.2433, a_m: 0.0, alpha_rad: 0.0}  # the published table, if any
    flange: {x: 0.0, y: 0.0, z: 0.0, roll: 0.0, pitch: 0.0, yaw: 0.0}  # after the last joint
    source: where the numbers are from
    ```

    `name` and `kinematics` are required. `flange` may also be three rows of four numbers.

    Raises:
        InputError: as `storage.read_yaml`; a key missing or unknown, a value that is not a number, degrees for radians,
            millimetres for metres, or as `Arm`. The line names the file and the place.
    """
    return arm_from_description(storage.read_yaml(path), str(path))


def arm_from_description(content: Any, where: str) -> Arm:
    """The arm of a parsed description `content`; `where` begins its messages. Raises as `read_description`."""
    content = entries.mapping(content, f"{where}:", ("name", "kinematics"), OPTIONAL)
    for key in ("name", "source"):
        if not isinstance(content.get(key, ""), str):
            raise InputError(f"{where}: {key} is {content[key]!r}, which is not text; put it in quotes")
    kinematics, _ = entries.kinematics(content["kinematics"], where)
    joints = len(kinematics)
    fields: dict[str, Any] = {}
    if "joint_limits_rad" in content:
        fields["joint_limits"] = _limits(content["joint_limits_rad"], where, joints)
    if "inertial" in content:
        fields["mass"], fields["center_of_mass"] = _inertial(content["inertial"], where, joints)
    if "dh" in content:
        fields["dh"] = _dh(content["dh"], where, joints)
    if "flange" in content:
        fields["T_joint_flange"] = _flange(content["flange"], where)
    try:
        return Arm(content["name"], kinematics, source=content.get("source", ""), **fields)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _limits(value: Any, where: str, joints: int) -> NDArray[np.float64]:
    if not isinstance(value, list) or len(value) != joints:
        raise InputError(f"{where}: joint_limits_rad must list one [lower, upper] for each of the {joints} joints")
    limits = np.array([entries.numbers(row, f"{where}: joint{i + 1}'s limits", 2) for i, row in enumerate(value)])
    for i, row in enumerate(limits):
        if np.abs(row).max() > LARGEST_LIMIT:
            raise InputError(
                f"{where}: joint{i + 1}'s limits {row[0]:g} … {row[1]:g} are many turns, so they seem to be in degrees;"
                " write radians"
            )
    return limits


def _inertial(value: Any, where: str, joints: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    links = entries.mapping(value, f"{where}: inertial", [f"link{i + 1}" for i in range(joints)])
    masses, centers = [], []
    for i in range(joints):
        place = f"{where}: inertial: link{i + 1}"
        link = entries.mapping(links[f"link{i + 1}"], place, ("mass_kg", "com_m"))
        masses.append(entries.number(link["mass_kg"], f"{place}: mass_kg"))
        centers.append(entries.numbers(link["com_m"], f"{place}: com_m", 3))
        if masses[-1] > LARGEST_MASS:
            raise InputError(f"{place}: mass_kg is {masses[-1]:g}, heavier than any arm, so it seems to be in grams")
        if max(map(abs, centers[-1])) > entries.LENGTH_LIMIT:
            raise InputError(f"{place}: com_m is {centers[-1]}, beyond any arm, so it seems to be in millimetres")
    return np.array(masses), np.array(centers)


def _dh(value: Any, where: str, joints: int) -> NDArray[np.float64]:
    table = entries.mapping(value, f"{where}: dh", [f"joint{i + 1}" for i in range(joints)])
    rows = []
    for i in range(joints):
        place = f"{where}: dh: joint{i + 1}"
        row = entries.mapping(table[f"joint{i + 1}"], place, DH)
        rows.append([entries.number(row[key], f"{place}: {key}") for key in DH])
    return np.array(rows)


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
    lines += [f"  joint{i + 1}: {entries.yaml_row(entries.SIX, row)}" for i, row in enumerate(arm.kinematics)]
    lines += ["joint_limits_rad:"] + [f"  - {entries.yaml_list(row)}" for row in arm.joint_limits]
    if arm.mass is not None and arm.center_of_mass is not None:
        lines += ["inertial:"]
        for i, (mass, center) in enumerate(zip(arm.mass, arm.center_of_mass, strict=True)):
            lines.append(f"  link{i + 1}: {{mass_kg: {entries.yaml_number(mass)}, com_m: {entries.yaml_list(center)}}}")
    if arm.dh is not None:
        lines += ["dh:"] + [f"  joint{i + 1}: {entries.yaml_row(DH, row)}" for i, row in enumerate(arm.dh)]
    if not np.array_equal(arm.T_joint_flange, np.eye(4)):
        row = frames.row_from_transform(arm.T_joint_flange)
        if np.array_equal(frames.transform_from_row(row), arm.T_joint_flange):
            lines.append(f"flange: {entries.yaml_row(entries.SIX, row)}")
        else:  # roll, pitch and yaw would not reproduce it exactly
            lines += ["flange:"] + [f"  - {entries.yaml_list(row)}" for row in arm.T_joint_flange[:3]]
    return storage.write_atomically(path, with_comment("\n".join(lines) + "\n"), overwrite)


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)
