"""URDF in and out: any chain of revolute joints as a six-parameter arm, with the same joint angles."""

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lite6jax import storage
from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.errors import InputError

Array = NDArray[np.floating]

SIZE_LIMIT = 1 << 23
_TURNING = ("revolute", "continuous")
_IDENTITY = np.eye(4)


@dataclass(frozen=True, eq=False)
class _Joint:
    name: str
    kind: str
    parent: str
    child: str
    row: Array  # (6,) x y z roll pitch yaw, as written
    axis: Array  # (3,) unit vector
    limits: tuple[float, float]
    mimics: bool


def read_urdf(path: str | Path, base: str | None = None, tip: str | None = None) -> Arm:
    """The arm that a URDF describes between two of its links.

    Fixed joints are folded into the chain: those before the first joint into its frame, those after the last into
    `T_joint_flange`. A joint that turns about another axis than its z gets a frame whose z is that axis, so that every
    joint angle keeps its value and sign. The masses of fixed links count to the link that carries them; what hangs on a
    further moving joint beside the chain is left out.

    Args:
        path: the file.
        base: the link whose frame is the arm's base; the root of the tree if not given.
        tip: the link whose frame is the flange; if not given, the end of the tree's only chain.

    Raises:
        InputError: not a URDF, a document type or entities in it, unexpanded xacro, a joint in the chain that does not
            turn or that mimics another, or several links that the tip could be. The line names the file, the joint or
            link, and the remedy.
    """
    robot, joints, links, base, tip, path_down = _tree(path, base, tip)

    rows, limits, turning, axes = [], [], [], []
    before = _IDENTITY
    for joint in path_down:
        T_before_joint = frames.transform_from_row(joint.row)
        if joint.kind == "fixed":
            before = before @ T_before_joint
            continue
        if joint.kind not in _TURNING or joint.mimics:
            what = "mimics another" if joint.mimics else f"is {joint.kind}"
            raise InputError(
                f"{path}: joint {joint.name!r} {what}; an arm here has revolute joints only, name a chain without it"
                " with base and tip"
            )
        R = _axis_frame(joint.axis)
        exact = np.array_equal(before, _IDENTITY) and np.array_equal(R, _IDENTITY)
        rows.append(joint.row if exact else frames.row_from_transform(before @ T_before_joint @ R))
        limits.append(joint.limits)
        turning.append(joint)
        axes.append(R)
        before = R.T
    if not rows:
        raise InputError(f"{path}: no joint turns between {base!r} and {tip!r}; name another base or tip")
    mass, center_of_mass = _inertial(path, [joint.child for joint in turning], axes, links, joints)
    try:
        return Arm(
            name=robot.get("name") or Path(path).stem,
            kinematics=np.array(rows),
            joint_limits=np.array(limits),
            T_joint_flange=before,
            mass=mass,
            center_of_mass=center_of_mass,
            source=f"URDF {Path(path).name}, {base} to {tip}",
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def carried_links(
    path: str | Path, base: str | None = None, tip: str | None = None
) -> list[tuple[int, ET.Element, Array]]:
    """Every link that the base or a joint of the chain carries, as `read_urdf` counts them, with its pose.

    Returns:
        for each link the joint that moves it, counted from 1, or 0 for what is fixed to the base; its element; and
        `T_frame_link` (4, 4) in the arm's frame after that joint's rotation, or in the base's.

    Raises:
        InputError: as `read_urdf`.
    """
    read_urdf(path, base, tip)
    _, joints, links, base, _, path_down = _tree(path, base, tip)
    turning = [joint for joint in path_down if joint.kind != "fixed"]
    roots = [(0, base, _IDENTITY)]
    roots += [(i + 1, joint.child, _axis_frame(joint.axis).T) for i, joint in enumerate(turning)]
    return [(number, links[name], R @ T) for number, root, R in roots for name, T in _carried(root, joints)]


def write_urdf(arm: Arm, path: str | Path, overwrite: bool = False) -> Path:
    """Writes the arm as a URDF from `base_link` to `flange`.

    `read_urdf` gives back chain, limits and masses exactly, and the flange's rotation to rounding; a DH table and the
    source have no place in a URDF. Inertia tensors, efforts and velocities, which an `Arm` does not know, are written
    as zero.

    Raises:
        InputError: as `storage.write_atomically`.
    """
    robot = ET.Element("robot", name=arm.name)
    ET.SubElement(robot, "link", name="base_link")
    for i, row in enumerate(arm.kinematics):
        link = ET.SubElement(robot, "link", name=f"link{i + 1}")
        if arm.mass is not None and arm.center_of_mass is not None:
            inertial = ET.SubElement(link, "inertial")
            ET.SubElement(inertial, "origin", xyz=_floats(arm.center_of_mass[i]), rpy="0.0 0.0 0.0")
            ET.SubElement(inertial, "mass", value=repr(float(arm.mass[i])))
            ET.SubElement(inertial, "inertia", dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0.0"))
        lower, upper = (repr(float(limit)) for limit in arm.joint_limits[i])
        joint = _add_joint(robot, f"joint{i + 1}", "revolute", f"link{i}" if i else "base_link", f"link{i + 1}", row)
        ET.SubElement(joint, "axis", xyz="0 0 1")
        ET.SubElement(joint, "limit", lower=lower, upper=upper, effort="0.0", velocity="0.0")
    ET.SubElement(robot, "link", name="flange")
    flange = frames.row_from_transform(arm.T_joint_flange)
    _add_joint(robot, "flange_joint", "fixed", f"link{arm.dof}", "flange", flange)
    ET.indent(robot)
    text = '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"
    return storage.write_atomically(path, text, overwrite)


def _add_joint(robot: ET.Element, name: str, kind: str, parent: str, child: str, row: Array) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "origin", xyz=_floats(row[:3]), rpy=_floats(row[3:]))
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    return joint


def _floats(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _tree(
    path: str | Path, base: str | None, tip: str | None
) -> tuple[ET.Element, list[_Joint], dict[str, ET.Element], str, str, list[_Joint]]:
    """The robot, its joints and links, and the names of base and tip with the joints between them."""
    robot = _parse(path)
    joints = [_joint(element, path) for element in robot.findall("joint")]
    links = {_name(element, path): element for element in robot.findall("link")}
    above = {joint.child: joint for joint in joints}
    if len(above) != len(joints):
        twice = next(joint for joint in joints if above[joint.child] is not joint)
        raise InputError(f"{path}: the link {twice.child!r} has two parents; a URDF is a tree, remove one joint")
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise InputError(f"{path}: joint {joint.name!r} names the link {link!r}, which is not there; add it")
    base = _base(path, base, links, above)
    tip = _tip(path, base, tip, links, above)
    path_down = _path(path, base, tip, above)
    return robot, joints, links, base, tip, path_down


def _parse(path: str | Path) -> ET.Element:
    text = storage.read_text(path, SIZE_LIMIT)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"{path}: declares a document type or entities, which a URDF needs none of; remove them")
    try:
        robot = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        line = getattr(error, "position", (0,))[0]
        raise InputError(f"{path}: line {line}: not valid XML ({error}); a URDF is needed here") from error
    values = (value for element in robot.iter() for value in element.attrib.values())
    if any("xacro" in element.tag for element in robot.iter()) or any("${" in v or "$(" in v for v in values):
        raise InputError(f"{path}: is xacro, not yet a URDF; expand it first: xacro {Path(path).name} > arm.urdf")
    if robot.tag != "robot":
        raise InputError(f"{path}: its root is <{robot.tag}>, not <robot>; a URDF is needed here")
    return robot


def _name(element: ET.Element, path: str | Path) -> str:
    name = element.get("name")
    if not name:
        raise InputError(f"{path}: a {element.tag} has no name; give it one")
    return name


def _joint(element: ET.Element, path: str | Path) -> _Joint:
    name = _name(element, path)
    where = f"{path}: joint {name!r}"
    kind = element.get("type", "")
    parent, child = (_attribute(element, tag, "link", where) for tag in ("parent", "child"))
    axis = np.array([1.0, 0.0, 0.0])  # URDF's default
    if (entry := element.find("axis")) is not None:
        axis = vector(entry.get("xyz", "1 0 0"), f"{where}: axis")
    length = math.sqrt(float(axis @ axis))
    if kind in _TURNING and length < 1e-9:
        raise InputError(f"{where}: its axis has no direction; write a unit vector")
    limits = (-2 * math.pi, 2 * math.pi)
    if kind == "revolute":
        lower, upper = (
            _scalar(_attribute(element, "limit", key, where), f"{where}: {key}") for key in ("lower", "upper")
        )
        limits = (lower, upper)
    row = origin(element, where)
    return _Joint(name, kind, parent, child, row, axis / (length or 1.0), limits, element.find("mimic") is not None)


def _attribute(element: ET.Element, tag: str, key: str, where: str) -> str:
    entry = element.find(tag)
    value = None if entry is None else entry.get(key)
    if value is None:
        raise InputError(f'{where}: lacks <{tag} {key}="…">; add it')
    return value


def origin(element: ET.Element, where: str) -> Array:
    """(6,) x y z roll pitch yaw, m and rad, of an element's <origin>; zeros where there is none.

    Raises:
        InputError: not three numbers each; the line begins with `where`.
    """
    entry = element.find("origin")
    if entry is None:
        return np.zeros(6)
    return np.concatenate([vector(entry.get(key, "0 0 0"), f"{where}: origin {key}") for key in ("xyz", "rpy")])


def vector(text: str, where: str) -> Array:
    """(3,) numbers of an attribute's text.

    Raises:
        InputError: not three finite numbers; the line begins with `where`.
    """
    parts = text.split()
    if len(parts) != 3:
        raise InputError(f"{where} is {text!r}; write three numbers")
    return np.array([_scalar(part, where) for part in parts])


def _scalar(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError as error:
        raise InputError(f"{where} has {text!r}, which is not a number; correct it") from error
    if not math.isfinite(value):
        raise InputError(f"{where} has {text!r}, which is not finite; correct it")
    return value


def _base(path: str | Path, base: str | None, links: dict[str, ET.Element], above: dict[str, _Joint]) -> str:
    if base is not None:
        if base not in links:
            raise InputError(f"{path}: has no link {base!r}; the links are {', '.join(links)}")
        return base
    roots = [link for link in links if link not in above]
    if len(roots) != 1:
        found = ", ".join(roots) or "none: the joints form a loop"
        raise InputError(f"{path}: has not one root link ({found}); name one with base")
    return roots[0]


def _tip(path: str | Path, base: str, tip: str | None, links: dict[str, ET.Element], above: dict[str, _Joint]) -> str:
    if tip is not None:
        if tip not in links:
            raise InputError(f"{path}: has no link {tip!r}; the links are {', '.join(links)}")
        return tip
    parents = {joint.parent for joint in above.values()}
    chains = {leaf: _path(path, base, leaf, above, missing_ok=True) for leaf in links if leaf not in parents}
    moving = {leaf: [j.name for j in chain if j.kind != "fixed"] for leaf, chain in chains.items()}
    longest = max(moving.values(), key=len, default=[])
    # A branch without a joint of its own (a sensor's frame, a mesh) is no rival, unless it ends where the chain ends.
    rivals = [leaf for leaf, names in moving.items() if names == longest or names != longest[: len(names)]]
    poses = [_fixed_tail(chains[leaf]) for leaf in rivals]
    if not rivals or not longest:
        raise InputError(f"{path}: no joint moves below {base!r}; name another base")
    same_chain = all(moving[leaf] == longest for leaf in rivals)
    if same_chain and all(np.allclose(pose, poses[0], rtol=0, atol=1e-12) for pose in poses):
        return rivals[0]
    raise InputError(
        f"{path}: the chain could end at {', '.join(rivals)}; name one with tip"
        f" (in a file name: {Path(path).name}#{rivals[0]})"
    )


def _fixed_tail(chain: list[_Joint]) -> Array:
    T = _IDENTITY
    for joint in chain:
        T = T @ frames.transform_from_row(joint.row) if joint.kind == "fixed" else _IDENTITY
    return T


def _path(path: str | Path, base: str, tip: str, above: dict[str, _Joint], missing_ok: bool = False) -> list[_Joint]:
    """The joints from base to tip."""
    found: list[_Joint] = []
    link = tip
    while link != base:
        if link not in above or len(found) > len(above):
            if missing_ok:
                return []
            raise InputError(f"{path}: {tip!r} is not below {base!r}; name another base or tip")
        found.append(above[link])
        link = above[link].parent
    return found[::-1]


def _axis_frame(axis: Array) -> Array:
    """(4, 4) a rotation whose z is the axis; exact where the axis is one of the frame's own."""
    x, y, z = axis
    T = np.eye(4)
    if z < 0:  # from -z, so that the quotient below stays away from zero
        T[:3, :3] = _axis_frame(-axis)[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    else:  # the shortest turn that takes z there
        T[:3, :3] = [
            [1 - x * x / (1 + z), -x * y / (1 + z), x],
            [-x * y / (1 + z), 1 - y * y / (1 + z), y],
            [-x, -y, z],
        ]
    return T + 0.0  # no minus zeros


def _inertial(
    path: str | Path, moved: list[str], axes: list[Array], links: dict[str, ET.Element], joints: list[_Joint]
) -> tuple[Array, Array] | tuple[None, None]:
    """(joint,) kg and (joint, 3) m: each moved link with all that is fixed to it."""
    if all(link.find("inertial") is None for link in links.values()):
        return None, None
    mass, center_of_mass = [], []
    for link, R in zip(moved, axes, strict=True):
        found: list[tuple[float, Array]] = []
        for name, T in _carried(link, joints):
            if (inertial := links[name].find("inertial")) is not None:
                where = f"{path}: link {name!r}: inertial"
                kg = _scalar(_attribute(inertial, "mass", "value", where), f"{where}: mass")
                found.append((kg, R[:3, :3].T @ (T[:3, :3] @ origin(inertial, where)[:3] + T[:3, 3])))
        total = sum(kg for kg, _ in found)
        mass.append(total)
        if len(found) == 1:
            center_of_mass.append(found[0][1])
        else:
            center_of_mass.append(sum((kg * center for kg, center in found), np.zeros(3)) / (total or 1.0))
    return np.array(mass), np.array(center_of_mass)


def _carried(link: str, joints: list[_Joint]) -> list[tuple[str, Array]]:
    """A link and all that is fixed to it, each with its pose in the link's frame."""
    below: dict[str, list[_Joint]] = {}
    for joint in joints:
        if joint.kind == "fixed":
            below.setdefault(joint.parent, []).append(joint)
    found, waiting = [], [(link, _IDENTITY)]
    while waiting:
        name, T = waiting.pop()
        waiting += [(j.child, T @ frames.transform_from_row(j.row)) for j in below.get(name, [])]
        found.append((name, T))
    return found
