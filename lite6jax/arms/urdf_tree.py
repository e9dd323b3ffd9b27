"""The tree of links and joints of a URDF: parsing it, and the path between two of its links."""

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax import storage
from lite6jax.arms import frames
from lite6jax.errors import InputError

Array = NDArray[np.floating]

SIZE_LIMIT = 1 << 23
LARGEST = 1e9
"""m, rad, kg; the squares of numbers far beyond are not finite."""
TURNING = ("revolute", "continuous")
MOVING = (*TURNING, "prismatic")
IDENTITY = np.eye(4)
SPRINGS = {"spring_stiffness": "springStiffness", "spring_reference": "springReference"}
"""Springs of a joint: names as an attribute of `dynamics`, which older versions wrote, and as Gazebo's extension."""


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint as the file describes it: its origin `row` in the parent link, m and rad, and its axis there."""

    name: str
    kind: str
    parent: str
    child: str
    row: Array  # (6,) x y z roll pitch yaw, as written
    axis: Array  # (3,) unit vector
    limits: tuple[float, float]
    mimics: str  # as words: another joint with multiplier and offset; empty where it does not
    dynamics: Mapping[str, str]  # the attributes of the element of this name, and `SPRINGS`, as written


class Tree(NamedTuple):
    """A parsed URDF, and the chain chosen in it.

    Attributes:
        robot: the root element.
        joints: all joints, in the order of the file.
        links: the elements of all links, by name.
        base: the name of the link whose frame is the base.
        tip: the name of the link whose frame is the flange.
        chain: the joints from base to tip.
        remark: what is to be said of a tip that was not named; empty where nothing is.
    """

    robot: ET.Element
    joints: list[Joint]
    links: dict[str, ET.Element]
    base: str
    tip: str
    chain: list[Joint]
    remark: str = ""


def read_tree(path: str | Path, base: str | None, tip: str | None) -> Tree:
    """The tree of a file with the chain from `base` to `tip`; None for the only root or the only end.

    Raises:
        InputError: as `urdf.read_urdf`, but for the joints' types.
    """
    robot = _parse(path)
    joints = [_joint(element, path, _springs(robot, element)) for element in robot.findall("joint")]
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
    end = _tip(path, base, tip, links, above)
    tree = Tree(robot, joints, links, base, end, _path(path, base, end, above))
    return tree._replace(remark=_jaw(path, tree)[1]) if tip is None else tree


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


def _springs(robot: ET.Element, joint: ET.Element) -> dict[str, str]:
    """What Gazebo's extensions say of a joint's spring."""
    own = [element for element in robot.findall("gazebo") if element.get("reference") == joint.get("name")]
    return {key: entry.text or "" for element in own for key, tag in SPRINGS.items() for entry in element.findall(tag)}


def _joint(element: ET.Element, path: str | Path, springs: Mapping[str, str]) -> Joint:
    name = _name(element, path)
    where = f"{path}: joint {name!r}"
    kind = element.get("type", "")
    parent, child = (attribute(element, tag, "link", where) for tag in ("parent", "child"))
    axis = np.array([1.0, 0.0, 0.0])  # URDF's default
    if (entry := element.find("axis")) is not None:
        axis = vector(entry.get("xyz", "1 0 0"), f"{where}: axis")
    length = math.sqrt(float(axis @ axis))
    if kind in MOVING and length < 1e-9:
        raise InputError(f"{where}: its axis has no direction; write a unit vector")
    limits = (-2 * math.pi, 2 * math.pi)
    if kind in ("revolute", "prismatic"):
        lower, upper = (
            scalar(attribute(element, "limit", key, where), f"{where}: {key}") for key in ("lower", "upper")
        )
        limits = (lower, upper)
    row = origin(element, where)
    mimics, dynamics = _mimics(element, where), element.find("dynamics")
    drive = {**({} if dynamics is None else dynamics.attrib), **springs}
    return Joint(name, kind, parent, child, row, axis / (length or 1.0), limits, mimics, drive)


def _mimics(element: ET.Element, where: str) -> str:
    """What a joint's <mimic> says."""
    if (entry := element.find("mimic")) is None:
        return ""
    multiplier, shift = (
        scalar(entry.get(key, default), f"{where}: mimic: {key}")
        for key, default in (("multiplier", "1"), ("offset", "0"))
    )
    beside = f" {shift:+g}" if shift else ""
    return f"{multiplier:g} times {entry.get('joint', 'another')!r}{beside}"


def attribute(element: ET.Element, tag: str, key: str, where: str) -> str:
    """The text of the attribute `key` of an element's child `tag`.

    Raises:
        InputError: the attribute is missing; the line begins with `where`.
    """
    entry = element.find(tag)
    value = None if entry is None else entry.get(key)
    if value is None:
        raise InputError(f'{where}: lacks <{tag} {key}="…">; add it')
    return value


def origin(element: ET.Element, where: str) -> Array:
    """(6,) x y z roll pitch yaw, m and rad, of an element's <origin>; zeros without one.

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
    return np.array([scalar(part, where) for part in parts])


def scalar(text: str, where: str) -> float:
    """The finite number of an attribute's text.

    Raises:
        InputError: not a finite number; the line begins with `where`.
    """
    try:
        value = float(text)
    except ValueError as error:
        raise InputError(f"{where} has {text!r}, which is not a number; correct it") from error
    if not math.isfinite(value):
        raise InputError(f"{where} has {text!r}, which is not finite; correct it")
    if abs(value) > LARGEST:
        raise InputError(f"{where} has {text!r}, which is beyond any arm; correct it")
    return value


def _base(path: str | Path, base: str | None, links: dict[str, ET.Element], above: dict[str, Joint]) -> str:
    if base is not None:
        if base not in links:
            raise InputError(f"{path}: has no link {base!r}; the links are {', '.join(links)}")
        return base
    roots = [link for link in links if link not in above]
    if len(roots) != 1:
        found = ", ".join(roots) or "none: the joints form a loop"
        raise InputError(f"{path}: has not one root link ({found}); name one with --base")
    return roots[0]


def _tip(path: str | Path, base: str, tip: str | None, links: dict[str, ET.Element], above: dict[str, Joint]) -> str:
    if tip is not None:
        if tip not in links:
            raise InputError(f"{path}: has no link {tip!r}; the links are {', '.join(links)}")
        return tip
    parents = {joint.parent for joint in above.values()}
    chains = {leaf: _path(path, base, leaf, above, missing_ok=True) for leaf in links if leaf not in parents}
    moving = {leaf: [j.name for j in chain if j.kind != "fixed"] for leaf, chain in chains.items()}
    longest = max(moving.values(), key=len, default=[])
    # A branch without a moving joint (a sensor's frame, a mesh) is no candidate, unless the chain ends there.
    candidates = [leaf for leaf, names in moving.items() if names == longest or names != longest[: len(names)]]
    poses = [_fixed_tail(chains[leaf]) for leaf in candidates]
    if not candidates or not longest:
        raise InputError(f"{path}: no joint moves below {base!r}; name another --base")
    same_chain = all(moving[leaf] == longest for leaf in candidates)
    if same_chain and all(np.allclose(pose, poses[0], rtol=0, atol=1e-12) for pose in poses):
        return candidates[0]
    raise InputError(f"{path}: {_ends(path, base, {leaf: chains[leaf] for leaf in candidates}, above)}")


def _ends(path: str | Path, base: str, chains: Mapping[str, list[Joint]], above: dict[str, Joint]) -> str:
    """Where the chain could end, and what to write for the likeliest: an arm before its gripper, or the longest."""
    moving = {leaf: [joint for joint in chain if joint.kind != "fixed"] for leaf, chain in chains.items()}
    # for each joint, "" for the base, the joints that move next, and how many move from each of them on
    onwards: dict[str, dict[str, int]] = {}
    for joints in moving.values():
        for i, joint in enumerate(joints):
            following = onwards.setdefault(joints[i - 1].name if i else "", {})
            following[joint.name] = max(following.get(joint.name, 0), len(joints) - i)
    ends = {leaf: len(joints) for leaf, joints in moving.items()}
    hands: dict[str, int] = {}
    for joints in moving.values():
        for i, joint in enumerate(joints[1:], 1):
            fingers = onwards[joints[i - 1].name].values()
            if len(fingers) > 1 and max(fingers) <= min(_LONGEST_FINGER, i - 1):
                hands.setdefault(joint.parent, i)
    last = max(moving, key=lambda leaf: len(moving[leaf]))
    through = [joint.parent for joint in chains[last] if joint.parent in hands]
    best = through[0] if through else last
    order = {best: (hands | ends)[best]} | hands | ends
    listed = ", ".join(f"{end} ({count} joint{'s' * (count != 1)})" for end, count in list(order.items())[:_SHOWN])
    file = Path(path).name
    said = f"say which with --tip {best}, or as {file}#{best} where a file is named"
    text = f"the chain could end at {listed}; {said}"
    chain = [joint for joint in _path(path, base, best, above) if joint.kind != "fixed"]
    starts = [i for i, joint in enumerate(chain) if i and len(onwards[chain[i - 1].name]) > 1]
    if not starts:
        return text
    without = ", ".join(joint.name for joint in chain[: starts[-1]])
    start = chain[starts[-1]].parent
    return f"{text}; without {without}: --base {start} --tip {best}, or {file}#{start}:{best}"


def tip_before_jaw(path: str | Path) -> str:
    """The link before the jaw in which the only chain of a file ends; empty where it ends in none.

    Raises:
        InputError: as `read_tree`.
    """
    return _jaw(path, read_tree(path, None, None))[0]


def _jaw(path: str | Path, tree: Tree) -> tuple[str, str]:
    """The link before a jaw, by the names of the last joints or by a frame of the tool; and that in words."""
    moving = [joint for joint in tree.chain if joint.kind != "fixed"]
    arm = list(moving)
    while arm and (arm[-1].mimics or _JAW_JOINT.search(arm[-1].name) or _JAW_LINK.search(arm[-1].child)):
        arm.pop()
    named = len(arm) < len(moving)
    if not named:
        arm.pop()
    if not arm:
        return "", ""
    first = moving[len(arm)]
    beside = [name for name, _ in fixed_to(first.parent, tree.joints) if name != first.parent and _TOOL.search(name)]
    if not beside and not named:
        return "", ""
    likely, file = (beside or [first.parent])[0], Path(path).name
    return likely, (
        f"{path}: the chain ends in {tree.tip} after {len(moving)} joints, and joint {first.name!r} seems to move a"
        f" jaw: the tip of the arm is likely {likely}, after {len(arm)} joints; name {file}#{likely} for it, or"
        f" {file}#{tree.tip} to keep the jaw"
    )


_JAW_JOINT = re.compile(
    r"^(?!.*(?:roll|yaw|pitch|rotat|wrist|arm|base)).*(?:grip|jaw|finger|claw|pinch)", re.IGNORECASE
)
_JAW_LINK = re.compile(r"jaw|finger|claw", re.IGNORECASE)
_TOOL = re.compile(
    r"(?:^|[_\W])(?:tool\d?|tcp|eef?|end_?effector|tip|flange|gripper_frame|grasp)(?:$|[_\W])", re.IGNORECASE
)
"""Names of what a gripper moves, of its joints, and of frames of the tool."""
_LONGEST_FINGER = 4
"""Joints: longer branches are arms."""
_SHOWN = 6


def _fixed_tail(chain: list[Joint]) -> Array:
    T = IDENTITY
    for joint in chain:
        T = T @ frames.transform_from_row(joint.row) if joint.kind == "fixed" else IDENTITY
    return T


def _path(path: str | Path, base: str, tip: str, above: dict[str, Joint], missing_ok: bool = False) -> list[Joint]:
    """The joints from base to tip; none where `missing_ok` and the tip is not below the base."""
    found: list[Joint] = []
    link = tip
    while link != base:
        if link not in above or len(found) > len(above):
            if missing_ok:
                return []
            raise InputError(f"{path}: {tip!r} is not below {base!r}; name another --base or --tip")
        found.append(above[link])
        link = above[link].parent
    return found[::-1]


def fixed_to(link: str, joints: list[Joint]) -> list[tuple[str, Array]]:
    """A link and every link fixed to it, by name, each with its pose (4, 4) in the frame of the first."""
    below: dict[str, list[Joint]] = {}
    for joint in joints:
        if joint.kind == "fixed":
            below.setdefault(joint.parent, []).append(joint)
    found, waiting = [], [(link, IDENTITY)]
    while waiting:
        name, T = waiting.pop()
        waiting += [(j.child, T @ frames.transform_from_row(j.row)) for j in below.get(name, [])]
        found.append((name, T))
    return found


def axis_frame(axis: Array) -> Array:
    """(4, 4) a rotation whose z is the axis; exact where the axis is ±x, ±y or ±z of the frame."""
    x, y, z = axis
    T = np.eye(4)
    if z < 0:  # relative to -z, so that the divisor below stays away from zero
        T[:3, :3] = axis_frame(-axis)[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    else:  # the shortest rotation that takes z to the axis
        T[:3, :3] = [
            [1 - x * x / (1 + z), -x * y / (1 + z), x],
            [-x * y / (1 + z), 1 - y * y / (1 + z), y],
            [-x, -y, z],
        ]
    return T + 0.0  # no minus zeros
