"""URDF files: any chain of revolute and prismatic joints as a six-parameter arm with the same positions, and back."""

import warnings
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lite6jax import storage
from lite6jax.arms import frames, inertia
from lite6jax.arms.arm import Arm
from lite6jax.arms.urdf_tree import (
    IDENTITY,
    MOVING,
    SPRINGS,
    Joint,
    Tree,
    attribute,
    axis_frame,
    fixed_to,
    origin,
    read_tree,
    scalar,
)
from lite6jax.errors import InputError, InputWarning

Array = NDArray[np.floating]

DRIVES = {
    "viscous_friction": "damping",
    "coulomb_friction": "friction",
    "spring_stiffness": "spring_stiffness",
    "spring_rest": "spring_reference",
}
"""What a `Joint` calls the fields of `Arm`; its element `dynamics` has those that URDF knows. URDF has no springs: they
are written as Gazebo's extensions (`SPRINGS`), which other programs ignore."""
UNLIMITED = 1000.0
"""N·m or N, and rad/s or m/s, of limits that are not known. With 0 Gazebo would hold the joint, and with less MoveIt
would take its magnitude as the limit."""


def read_urdf(path: str | Path, base: str | None = None, tip: str | None = None) -> Arm:
    """The arm that a URDF describes between two of its links.

    Fixed joints are merged into the chain: those before the first joint into its frame, those after the last into
    `T_joint_flange`. A joint whose axis is not its z axis gets a frame whose z is that axis, so that every position of
    a joint keeps its value and sign. Fixed links are lumped with the link that carries them, mass and inertia; links on
    moving joints beside the chain are omitted. Inertia that is zero throughout is unknown.

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
    tree = read_tree(path, base, tip)
    if tree.remark:
        warnings.warn(tree.remark, InputWarning, stacklevel=2)
    rows, limits, moving, axes = [], [], [], []
    before = IDENTITY
    for place, joint in enumerate(tree.chain):
        T_before_joint = frames.transform_from_row(joint.row)
        if joint.kind == "fixed":
            before = before @ T_before_joint
            continue
        if joint.kind not in MOVING or joint.mimics:
            what = f"is {joint.kind}"
            if joint.mimics:
                what = f"is coupled: it mimics {joint.mimics}"
            later = [after.kind for after in tree.chain[place + 1 :] if after.kind != "fixed"]
            flag, other = ("--base", joint.child) if len(later) > len(rows) else ("--tip", joint.parent)
            chain = f"{other}:{tip or ''}" if flag == "--base" else f"{base}:{other}" if base else other
            raise InputError(
                f"{path}: joint {joint.name!r} {what}; an arm here has revolute and prismatic joints that move on their"
                f" own, name a chain without it with {flag} {other}, or as {Path(path).name}#{chain} where a file is"
                " named"
            )
        R = axis_frame(joint.axis)
        exact = np.array_equal(before, IDENTITY) and np.array_equal(R, IDENTITY)
        rows.append(joint.row if exact else frames.row_from_transform(before @ T_before_joint @ R))
        limits.append(joint.limits)
        moving.append(joint)
        axes.append(R)
        before = R.T
    if not rows:
        raise InputError(f"{path}: no joint moves between {tree.base!r} and {tree.tip!r}; name another --base or --tip")
    fields = _inertial(path, [joint.child for joint in moving], axes, tree) | _drives(path, moving)
    try:
        return Arm(
            name=tree.robot.get("name") or Path(path).stem,
            kinematics=np.array(rows),
            joint_limits=np.array(limits),
            T_joint_flange=before,
            source=f"URDF {Path(path).name}, {tree.base} to {tree.tip}",
            sliding=tuple(i for i, joint in enumerate(moving) if joint.kind == "prismatic"),
            joint_names=tuple(joint.name for joint in moving),
            endless=tuple(i for i, joint in enumerate(moving) if joint.kind == "continuous"),
            **fields,
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def carried_links(
    path: str | Path, base: str | None = None, tip: str | None = None
) -> list[tuple[int, ET.Element, Array]]:
    """Every link that is fixed to the base or to a link of the chain of `read_urdf`, with its pose.

    Returns:
        for each link the joint that moves it, counted from 1, or 0 if it is fixed to the base; its element; and
        `T_frame_link` (4, 4) in the arm's frame after that joint's motion, or in the base frame.

    Raises:
        InputError: as `read_urdf`.
    """
    read_urdf(path, base, tip)
    tree = read_tree(path, base, tip)
    moving = [joint for joint in tree.chain if joint.kind != "fixed"]
    roots = [(0, tree.base, IDENTITY)]
    roots += [(i + 1, joint.child, axis_frame(joint.axis).T) for i, joint in enumerate(moving)]
    return [(number, tree.links[name], R @ T) for number, root, R in roots for name, T in fixed_to(root, tree.joints)]


def write_urdf(arm: Arm, path: str | Path, overwrite: bool = False) -> Path:
    """Writes the arm as a URDF from `base_link` to `flange`.

    `read_urdf` returns chain, limits, inertia, friction and springs exactly, and the flange's rotation to rounding. A
    DH table, rotor inertia and the source are omitted. Unknown inertia is written as zero, and efforts and velocities,
    which an `Arm` does not contain, as `UNLIMITED`. Where the arm has masses, `base_link` is fixed to a link `world`
    and has a mass too: Gazebo drops a link without mass together with all links that it carries.

    Raises:
        InputError: as `storage.write_atomically`.
    """
    robot = ET.Element("robot", name=arm.name)
    robot.append(ET.Comment(f" An effort or a velocity of {UNLIMITED:g} says that its limit is not known. "))
    _add_base(robot, arm)
    for i, row in enumerate(arm.kinematics):
        link = ET.SubElement(robot, "link", name=f"link{i + 1}")
        if arm.mass is not None and arm.center_of_mass is not None:
            element = ET.SubElement(link, "inertial")
            ET.SubElement(element, "origin", xyz=_floats(arm.center_of_mass[i]), rpy="0.0 0.0 0.0")
            ET.SubElement(element, "mass", value=repr(float(arm.mass[i])))
            six = np.zeros(6) if arm.inertia is None else inertia.six_entries(arm.inertia[i])
            ET.SubElement(element, "inertia", {k: repr(float(v)) for k, v in zip(inertia.SIX, six, strict=True)})
        lower, upper = (repr(float(limit)) for limit in arm.joint_limits[i])
        kind = "prismatic" if arm.slides[i] else "continuous" if i in arm.endless else "revolute"
        joint = _add_joint(robot, f"joint{i + 1}", kind, f"link{i}" if i else "base_link", f"link{i + 1}", row)
        ET.SubElement(joint, "axis", xyz="0 0 1")
        ET.SubElement(joint, "limit", lower=lower, upper=upper, effort=repr(UNLIMITED), velocity=repr(UNLIMITED))
        write_drives(arm, i, robot, joint)
    ET.SubElement(robot, "link", name="flange")
    flange = frames.row_from_transform(arm.T_joint_flange)
    _add_joint(robot, "flange_joint", "fixed", f"link{arm.dof}", "flange", flange)
    ET.indent(robot)
    text = '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"
    return storage.write_atomically(path, text, overwrite)


def write_drives(arm: Arm, i: int, robot: ET.Element, joint: ET.Element) -> None:
    """Writes friction and spring of an arm's joint `i`, from 0, into a URDF; what the arm does not know stays."""
    known = {key: values[i] for field, key in DRIVES.items() if (values := getattr(arm, field)) is not None}
    entry = joint.find("dynamics")
    for key, value in known.items():
        if key in SPRINGS:
            if entry is not None:
                entry.attrib.pop(key, None)
            _spring(robot, joint, SPRINGS[key]).text = repr(float(value))
            continue
        if entry is None:
            entry = ET.SubElement(joint, "dynamics")
        entry.set(key, repr(float(value)))


def _spring(robot: ET.Element, joint: ET.Element, tag: str) -> ET.Element:
    """The element of Gazebo's extension of a joint."""
    own = [element for element in robot.findall("gazebo") if element.get("reference") == joint.get("name")]
    found = next((entry for element in own if (entry := element.find(tag)) is not None), None)
    if found is not None:
        return found
    return ET.SubElement(own[-1] if own else ET.SubElement(robot, "gazebo", reference=joint.get("name", "")), tag)


def _add_base(robot: ET.Element, arm: Arm) -> None:
    base = ET.Element("link", name="base_link")
    if arm.mass is not None:
        ET.SubElement(robot, "link", name="world")
        _add_joint(robot, "world_joint", "fixed", "world", "base_link", np.zeros(6))
        base.append(ET.Comment(" Stands still: any mass would do, and without one Gazebo drops the whole arm. "))
        element = ET.SubElement(base, "inertial")
        ET.SubElement(element, "mass", value="1.0")
        ET.SubElement(element, "inertia", dict(zip(inertia.SIX, ("0.01", "0.01", "0.01", "0", "0", "0"), strict=True)))
    robot.append(base)


def _add_joint(robot: ET.Element, name: str, kind: str, parent: str, child: str, row: Array) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "origin", xyz=_floats(row[:3]), rpy=_floats(row[3:]))
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    return joint


def _floats(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _inertial(path: str | Path, moved: list[str], axes: list[Array], tree: Tree) -> dict[str, Array]:
    """The fields of `Arm` that say what each moved link is with every link fixed to it; none without inertial elements.

    Files without figures write tensors of zeros: then the inertia is unknown.
    """
    if all(link.find("inertial") is None for link in tree.links.values()):
        return {}
    links = []
    for link, R in zip(moved, axes, strict=True):
        fixed = [
            inertia.moved(_body(element, f"{path}: link {name!r}: inertial"), R.T @ T)
            for name, T in fixed_to(link, tree.joints)
            if (element := tree.links[name].find("inertial")) is not None
        ]
        links.append(inertia.lumped(fixed))
        if wrong := next((wrong for body in (*fixed, links[-1]) if (wrong := inertia.defect(body.inertia))), ""):
            warnings.warn(
                f"{path}: link {link!r}: its inertia {wrong}; the inertia of this file is left out, correct it to"
                " diagnose torques",
                InputWarning,
                stacklevel=3,
            )
            links[-1] = links[-1]._replace(inertia=np.full((3, 3), np.nan))
    fields = {"mass": np.array([link.mass for link in links]), "center_of_mass": np.array([b.center for b in links])}
    tensors = np.array([link.inertia for link in links])
    return fields | ({"inertia": tensors} if np.isfinite(tensors).all() and tensors.any() else {})


def _body(element: ET.Element, where: str) -> inertia.Body:
    """What an inertial element describes, in the frame of its link."""
    kg = scalar(attribute(element, "mass", "value", where), f"{where}: mass")
    entry = element.find("inertia")
    six = [0.0 if entry is None else scalar(entry.get(key, "0"), f"{where}: {key}") for key in inertia.SIX]
    body = inertia.Body(kg, np.zeros(3), inertia.tensor(six))
    return inertia.moved(body, frames.transform_from_row(origin(element, where)))


def _drives(path: str | Path, moving: list[Joint]) -> dict[str, Array]:
    """The fields of `Arm` that the joints' dynamics elements and springs give; a joint without one has none."""
    fields: dict[str, Array] = {}
    for field, key in DRIVES.items():
        given = [joint.dynamics.get(key) for joint in moving]
        if any(text is not None for text in given):
            where = [f"{path}: joint {joint.name!r}: dynamics: {key}" for joint in moving]
            fields[field] = np.array([scalar(text or "0", at) for text, at in zip(given, where, strict=True)])
    if "spring_stiffness" in fields:
        fields.setdefault("spring_rest", np.zeros(len(moving)))
    else:
        fields.pop("spring_rest", None)
    return fields
