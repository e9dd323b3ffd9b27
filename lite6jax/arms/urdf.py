"""URDF files: any chain of revolute and prismatic joints as a six-parameter arm with the same positions, and back."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from lite6jax import storage
from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.trees import (
    IDENTITY,
    MOVING,
    SIZE_LIMIT,
    Joint,
    Tree,
    arm_of_chain,
    axis_frame,
    find_chain,
    format_numbers,
    jaw,
    link_body,
    rigid_links,
)
from lite6jax.array_types import Array
from lite6jax.errors import InputError

LimitKey = Literal["effort", "velocity"]

LARGEST = 1e9
"""m, rad, kg; the squares of numbers far beyond are not finite."""
UNLIMITED = 1000.0
"""N·m or N, and rad/s or m/s, of limits that are not known. With 0 Gazebo would hold the joint, and with less MoveIt
would take its magnitude as the limit."""
SPRINGS_LEFT_OUT = "springs, but for Gazebo's extension <gazebo reference=…>"
"""What a URDF has no place for, of an arm with springs."""
_DYNAMICS = {"viscous_friction": "damping", "coulomb_friction": "friction"}
"""The attributes of a joint's <dynamics> by the fields of `Arm`."""
_SPRINGS = {"spring_stiffness": "springStiffness", "spring_rest": "springReference"}
"""URDF has no springs: the elements of Gazebo's extension of a joint, which other programs ignore."""
_FAR = (0.02, 0.1)
"""m and rad, by which no joint of an arm deviates from its design."""
_SAME = 1e-12
"""m, rad: of a transform that does not change, the text stays as it is."""


def read_urdf(path: str | Path, base: str | None = None, tip: str | None = None) -> Arm:
    """The arm that a URDF describes between two of its links, as `arm_of_chain` has it.

    Args:
        path: the file.
        base: the link whose frame is the arm's base; None for the root of the tree.
        tip: the link whose frame is the flange; None for the end of the only chain of the tree.

    Raises:
        InputError: not a URDF, a document type or entities in it, unexpanded xacro, a joint in the chain that is
            neither revolute nor prismatic or that mimics another, or an ambiguous tip. The line names the file, the
            joint or link, and the remedy.

    Warns:
        InputWarning: a tensor that no rigid body has, as published files have some; all inertia is then left out. Or
            a tip that was not named is a jaw's.
    """
    return _read(path, base, tip)[0]


def tip_before_jaw(path: str | Path) -> str:
    """The link before the jaw in which the only chain of a file ends; empty where it ends in none."""
    return jaw(path, _tree(path, None, None)[0])[0]


def _tree(path: str | Path, base: str | None, tip: str | None) -> tuple[Tree, ET.Element]:
    """The chain, and the root element of the file, comments included."""
    robot = _parse(path)
    joints = [_joint(element, path) for element in robot.findall("joint")]
    links = {_name(element, path): element for element in robot.findall("link")}
    children = [joint.child for joint in joints]
    if len(set(children)) != len(joints):
        twice = next(child for i, child in enumerate(children) if child in children[:i])
        raise InputError(f"{path}: the link {twice!r} has two parents; a URDF is a tree, remove one joint")
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise InputError(f"{path}: joint {joint.name!r} names the link {link!r}, which is not there; add it")
    return find_chain(path, joints, links, base, tip), robot


def _read(path: str | Path, base: str | None, tip: str | None) -> tuple[Arm, Tree, ET.Element]:
    """The arm, the chain that it is, and the root element."""
    tree, robot = _tree(path, base, tip)
    drives = _drives(path, robot, tree.moving)
    return arm_of_chain(path, tree, robot.get("name", ""), "URDF", partial(_body_of, path, tree), drives), tree, robot


def _body_of(path: str | Path, tree: Tree, name: str) -> frames.Body | None:
    """What a link of the file is in its own frame; None where the file does not say it."""
    element = tree.links[name].find("inertial")
    if element is None:
        return None
    where = f"{path}: link {name!r}: inertial"
    kg = scalar(_attribute(element, "mass", "value", where), f"{where}: mass")
    entry = element.find("inertia")
    six = [0.0 if entry is None else scalar(entry.get(key, "0"), f"{where}: {key}") for key in frames.TENSOR_ENTRIES]
    body = frames.Body(kg, np.zeros(3), frames.tensor(six))
    return frames.transform_body(body, frames.transform_from_row(origin(element, where)))


def _parse(path: str | Path) -> ET.Element:
    text = storage.read_text(path, SIZE_LIMIT)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"{path}: declares a document type or entities, which a URDF needs none of; remove them")
    try:
        robot = ET.fromstring(text, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))
    except (ET.ParseError, ValueError) as error:
        line = error.position[0] if isinstance(error, ET.ParseError) else 0
        raise InputError(f"{path}: line {line}: not valid XML ({error}); a URDF is needed here") from error
    elements = [element for element in robot.iter() if isinstance(element.tag, str)]  # a comment's tag is a function
    values = [value for element in elements for value in element.attrib.values()]
    if any("xacro" in element.tag for element in elements) or any("${" in v or "$(" in v for v in values):
        raise InputError(f"{path}: is xacro, not yet a URDF; expand it first: xacro {Path(path).name} > arm.urdf")
    if robot.tag != "robot":
        raise InputError(f"{path}: its root is <{robot.tag}>, not <robot>; a URDF is needed here")
    return robot


def _name(element: ET.Element, path: str | Path) -> str:
    name = element.get("name")
    if not name:
        raise InputError(f"{path}: a {element.tag} has no name; give it one")
    return name


def _joint(element: ET.Element, path: str | Path) -> Joint:
    name = _name(element, path)
    kind = element.get("type", "")
    where = f"{path}: joint {name!r}"
    refused = f"is {kind};"
    parent, child = (_attribute(element, tag, "link", where) for tag in ("parent", "child"))
    axis = np.array([1.0, 0.0, 0.0])  # URDF's default
    if (entry := element.find("axis")) is not None:
        axis = vector(entry.get("xyz", "1 0 0"), f"{where}: axis")
    length = math.sqrt(float(axis @ axis))
    if kind in MOVING and length < 1e-9:
        raise InputError(f"{where}: its axis has no direction; write a unit vector")
    limits = (-2 * math.pi, 2 * math.pi)
    if kind in ("revolute", "prismatic"):
        bounds = {key: _attribute(element, "limit", key, where) for key in ("lower", "upper")}
        limits = (scalar(bounds["lower"], f"{where}: lower"), scalar(bounds["upper"], f"{where}: upper"))
    if (entry := element.find("mimic")) is not None:
        multiplier = scalar(entry.get("multiplier", "1"), f"{where}: mimic: multiplier")
        shift = scalar(entry.get("offset", "0"), f"{where}: mimic: offset")
        beside = f" {shift:+g}" if shift else ""
        refused = f"is coupled: it mimics {multiplier:g} times {entry.get('joint', 'another')!r}{beside};"
    elif kind in (*MOVING, "fixed"):
        refused = ""
    if refused:
        refused += " an arm here has revolute and prismatic joints that move on their own,"
    return Joint(name, kind, parent, child, origin(element, where), axis / (length or 1.0), limits, refused)


def _drives(path: str | Path, robot: ET.Element, moving: list[Joint]) -> dict[str, Array]:
    """The fields of `Arm` that the joints' dynamics elements and springs give; a joint without one has none."""
    dynamics = []
    elements = _joint_elements(robot)
    for joint in moving:
        entry = elements[joint.child].find("dynamics")
        attributes = {}
        if entry is not None:
            attributes = {field: entry.get(key) for field, key in _DYNAMICS.items()}
        for extension in _extensions(robot, elements[joint.child]):
            attributes |= {field: e.text for field, tag in _SPRINGS.items() for e in extension.findall(tag)}
        dynamics.append(attributes)
    fields: dict[str, Array] = {}
    for field, key in (_DYNAMICS | _SPRINGS).items():
        if any(attributes.get(field) is not None for attributes in dynamics):
            where = [f"{path}: joint {joint.name!r}: dynamics: {key}" for joint in moving]
            fields[field] = np.array(
                [scalar(attributes.get(field) or "0", at) for attributes, at in zip(dynamics, where, strict=True)]
            )
    if "spring_stiffness" in fields:
        fields.setdefault("spring_rest", np.zeros(len(moving)))
    else:
        fields.pop("spring_rest", None)
    return fields


def _joint_elements(robot: ET.Element) -> dict[str, ET.Element]:
    """The elements of all joints, by the link that they move."""
    return {child.get("link", ""): joint for joint in robot.findall("joint") for child in joint.findall("child")}


def _extensions(robot: ET.Element, joint: ET.Element) -> list[ET.Element]:
    """Gazebo's extensions of a joint."""
    return [element for element in robot.findall("gazebo") if element.get("reference") == joint.get("name")]


def _attribute(element: ET.Element, tag: str, key: str, where: str) -> str:
    entry = element.find(tag)
    value = None if entry is None else entry.get(key)
    if value is None:
        raise InputError(f'{where}: lacks <{tag} {key}="…">; add it')
    return value


def origin(element: ET.Element, where: str) -> Array:
    """(6,) x y z roll pitch yaw, m and rad, of an element's <origin>; zeros without one."""
    entry = element.find("origin")
    if entry is None:
        return np.zeros(6)
    return np.concatenate([vector(entry.get(key, "0 0 0"), f"{where}: origin {key}") for key in ("xyz", "rpy")])


def vector(text: str, where: str) -> Array:
    """(3,) finite numbers of an attribute's text."""
    parts = text.split()
    if len(parts) != 3:
        raise InputError(f"{where} is {text!r}; write three numbers")
    return np.array([scalar(part, where) for part in parts])


def scalar(text: str, where: str) -> float:
    """The finite number of an attribute's text."""
    try:
        value = float(text)
    except ValueError as error:
        raise InputError(f"{where} has {text!r}, which is not a number; correct it") from error
    if not math.isfinite(value):
        raise InputError(f"{where} has {text!r}, which is not finite; correct it")
    if abs(value) > LARGEST:
        raise InputError(f"{where} has {text!r}, which is beyond any arm; correct it")
    return value


def write_urdf(
    arm: Arm, path: str | Path, overwrite: bool = False, limits: Mapping[LimitKey, Array] | None = None
) -> Path:
    """Writes the arm as a URDF from `base_link` to `flange`.

    `read_urdf` returns chain, limits, inertia, friction and springs exactly, and the flange's rotation to rounding. A
    DH table, rotor inertia and the source are omitted. Unknown inertia is written as zero. Efforts and velocities,
    which an `Arm` does not contain, are those of `limits` `(joint,)` in Nm and rad/s, and `UNLIMITED` where it has no
    finite number. Where the arm has masses, `base_link` is fixed to a link `world`
    and has a mass too: Gazebo drops a link without mass together with all links that it carries.

    Raises:
        InputError: as `storage.write_atomically`.
    """
    robot = ET.Element("robot", name=arm.name)
    robot.append(ET.Comment(f" An effort or a velocity of {UNLIMITED:g} says that its limit is not known. "))
    base = ET.Element("link", name="base_link")
    if arm.mass is not None:
        ET.SubElement(robot, "link", name="world")
        _add_joint(robot, "world_joint", "fixed", "world", "base_link", np.zeros(6))
        base.append(ET.Comment(" Stands still: any mass would do, and without one Gazebo drops the whole arm. "))
        _set_body(base, frames.Body(1.0, np.zeros(3), 0.01 * np.eye(3)))
    robot.append(base)
    for i, row in enumerate(arm.kinematics):
        link = ET.SubElement(robot, "link", name=f"link{i + 1}")
        if (body := link_body(arm, i)) is not None:
            _set_body(link, body)
        lower, upper = (repr(float(limit)) for limit in arm.joint_limits[i])
        kind = "continuous" if i in arm.endless else "revolute"
        if arm.slides[i]:
            kind = "prismatic"
        joint = _add_joint(robot, f"joint{i + 1}", kind, f"link{i}" if i else "base_link", f"link{i + 1}", row)
        ET.SubElement(joint, "axis", xyz="0 0 1")
        ET.SubElement(joint, "limit", lower=lower, upper=upper, effort=repr(UNLIMITED), velocity=repr(UNLIMITED))
        _set_limits(joint, limits, i)
        _set_drive(robot, joint, arm, i)
    ET.SubElement(robot, "link", name="flange")
    flange = frames.row_from_transform(arm.T_joint_flange)
    _add_joint(robot, "flange_joint", "fixed", f"link{arm.dof}", "flange", flange)
    ET.indent(robot)
    return _write(robot, path, overwrite)


def write_into_urdf(
    arm: Arm,
    robot: str | Path,
    path: str | Path,
    base: str | None = None,
    tip: str | None = None,
    overwrite: bool = False,
    with_flange: bool = True,
    limits: Mapping[LimitKey, Array] | None = None,
) -> list[str]:
    """Writes a URDF in which the joints of a chain have the origins, inertia and drives of an arm.

    Names, axes, limits with efforts and velocities, meshes, other chains and comments stay, and so does what the arm
    does not know. `limits` `(joint,)` replace efforts in Nm and velocities in rad/s where they are finite. What follows
    the last joint changes in the last fixed joint, if it is to change. Where the arm has inertia, that of each link
    contains the links fixed to it, whose own is removed; links on joints beside the chain keep theirs.

    Returns:
        what the file has no place for, a phrase each.

    Raises:
        InputError: as `read_urdf` of `robot`; another number of joints; joint frames that stand elsewhere by design, to
            which the meshes would not fit; or as `storage.write_atomically`.
    """
    old, tree, root = _read(robot, base, tip)
    if (old.dof, old.sliding) != (arm.dof, arm.sliding):
        slides = [", prismatic " + ", ".join(str(i + 1) for i in of.sliding) if of.sliding else "" for of in (old, arm)]
        raise InputError(
            f"{robot}: has {old.dof} joints from {tree.base} to {tree.tip}{slides[0]}, but {arm.name} has"
            f" {arm.dof}{slides[1]}"
        )
    for i, (T, before) in enumerate(zip(arm.links, old.links, strict=True), 1):
        moved = np.linalg.norm(T[:3, 3] - before[:3, 3])
        turned = np.linalg.norm(T[:3, :3] - before[:3, :3])
        if moved > _FAR[0] or turned > _FAR[1]:
            raise InputError(
                f"{robot}: the frame of joint {i} stands {1e3 * moved:.3g} mm and {turned:.2g} rad from that of "
                f"{arm.name}, which is no deviation of one arm; give the URDF of the description that was diagnosed"
            )
    elements = _joint_elements(root)
    left_out = []
    before = IDENTITY
    i = 0
    for joint in tree.chain:
        if joint.kind == "fixed":
            before = before @ frames.transform_from_row(joint.row)
            continue
        R = axis_frame(joint.axis)
        if np.abs(arm.links[i] - old.links[i]).max() > _SAME:
            _set_origin(elements[joint.child], np.linalg.inv(before) @ arm.links[i] @ R.T)
        _set_drive(root, elements[joint.child], arm, i)
        _set_limits(elements[joint.child], limits, i)
        before = R.T
        i = i + 1
    last = tree.chain[-1]
    if with_flange and np.abs(arm.T_joint_flange - old.T_joint_flange).max() > _SAME:
        if last.kind == "fixed":
            T = frames.transform_from_row(last.row) @ np.linalg.inv(old.T_joint_flange) @ arm.T_joint_flange
            _set_origin(elements[last.child], T)
        else:
            left_out.append(f"what follows the last joint (no fixed joint leads to {tree.tip})")
    bodies = [(arm.mass, old.mass), (arm.center_of_mass, old.center_of_mass), (arm.inertia, old.inertia)]
    present = [(values, was) for values, was in bodies if values is not None]
    are_same = all(was is not None and np.allclose(values, was, rtol=1e-12, atol=1e-15) for values, was in present)
    if len(present) == len(bodies) and not are_same:
        for i, joint in enumerate(tree.moving):
            fixed = {name for name, _ in rigid_links(joint.child, tree.joints)}
            beside = [
                frames.transform_body(body, T)
                for name, T in tree.carried(joint)
                if name not in fixed and (body := _body_of(robot, tree, name)) is not None
            ]
            for name in fixed:
                for entry in tree.links[name].findall("inertial"):
                    tree.links[name].remove(entry)
            if (body := link_body(arm, i)) is not None:
                carried_body = frames.transform_body(body, axis_frame(joint.axis))
                reduced = frames.lump([carried_body, *(frames.Body(-b.mass, b.center, -b.inertia) for b in beside)])
                _set_body(tree.links[joint.child], reduced)
    left_out += ["rotor inertia"] if arm.rotor_inertia is not None else []
    left_out += [SPRINGS_LEFT_OUT] if arm.spring_stiffness is not None else []
    _write(root, path, overwrite)
    return left_out


def _write(robot: ET.Element, path: str | Path, overwrite: bool) -> Path:
    content = '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"
    return storage.write_atomically(path, content, overwrite)


def _add_joint(robot: ET.Element, name: str, kind: str, parent: str, child: str, row: Array) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "origin", xyz=format_numbers(row[:3]), rpy=format_numbers(row[3:]))
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    return joint


def _set_origin(joint: ET.Element, T: Array) -> None:
    entry = joint.find("origin")
    if entry is None:
        entry = ET.SubElement(joint, "origin")
    row = frames.row_from_transform(T)
    entry.set("xyz", format_numbers(row[:3]))
    entry.set("rpy", format_numbers(row[3:]))


def _set_body(link: ET.Element, body: frames.Body) -> None:
    """Says what a link without an inertial element is."""
    element = ET.SubElement(link, "inertial")
    ET.SubElement(element, "origin", xyz=format_numbers(body.center), rpy="0.0 0.0 0.0")
    ET.SubElement(element, "mass", value=repr(float(body.mass)))
    six = zip(frames.TENSOR_ENTRIES, frames.six_entries(body.inertia), strict=True)
    ET.SubElement(element, "inertia", {key: repr(float(value)) for key, value in six})


def _set_limits(joint: ET.Element, limits: Mapping[LimitKey, Array] | None, i: int) -> None:
    """Writes effort and velocity of joint `i`, from 0, where they are known."""
    for key, values in (limits or {}).items():
        if np.isfinite(values[i]):
            entry = joint.find("limit")
            if entry is None:
                entry = ET.SubElement(joint, "limit")
            entry.set(key, repr(float(values[i])))


def _set_drive(robot: ET.Element, joint: ET.Element, arm: Arm, i: int) -> None:
    """Writes friction and spring of an arm's joint `i`, from 0; what the arm does not know stays."""
    entry = joint.find("dynamics")
    extensions = _extensions(robot, joint)
    drives = arm.drives
    for field, key in (_DYNAMICS | _SPRINGS).items():
        if field not in drives:
            continue
        value = repr(float(drives[field][i]))
        if field in _DYNAMICS:
            if entry is None:
                entry = ET.SubElement(joint, "dynamics")
            entry.set(key, value)
            continue
        spring = next((spring_entry for e in extensions if (spring_entry := e.find(key)) is not None), None)
        if spring is None:
            extensions = extensions or [ET.SubElement(robot, "gazebo", reference=joint.get("name", ""))]
            spring = ET.SubElement(extensions[-1], key)
        spring.text = value
