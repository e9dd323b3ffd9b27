"""Trees of links and joints, as URDF and MJCF have them: the chain between two links, and the arm that it is."""

import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.array_types import Array
from lite6jax.errors import InputError, InputWarning

SIZE_LIMIT = 1 << 23
"""Bytes of a file."""
MOVING = ("revolute", "continuous", "prismatic")
IDENTITY = np.eye(4)
_LONGEST_FINGER = 4
"""Joints: longer branches are arms."""
_SHOWN = 6
_JAW_JOINT = re.compile(r"^(?!.*(?:roll|yaw|pitch|rotat|wrist|arm|base)).*(?:grip|jaw|finger|claw|pinch)", re.I)
_JAW_LINK = re.compile(r"jaw|finger|claw", re.I)
_TOOL = re.compile(r"(?:^|[_\W])(?:tool\d?|tcp|eef?|end_?effector|tip|flange|gripper_frame|grasp)(?:$|[_\W])", re.I)
"""Names of what a gripper moves, of its joints, and of frames of the tool."""


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint between two links.

    Attributes:
        name: its name.
        kind: fixed, one of `MOVING`, or what no arm here has.
        parent: the name of the link that carries it.
        child: the name of the link that it moves.
        row: (6,) x y z roll pitch yaw, its origin in the parent link, m and rad.
        axis: (3,) a unit vector, there.
        limits: lower and upper, rad or m.
        refused: why no arm here has it, the predicate of a sentence; empty where one may.
    """

    name: str
    kind: str
    parent: str
    child: str
    row: Array
    axis: Array
    limits: tuple[float, float]
    refused: str = ""


class Tree(NamedTuple):
    """A tree, and the chain chosen in it.

    Attributes:
        joints: all joints, in the order of the file.
        links: what the file says of each link, by name.
        base: the name of the link whose frame is the base.
        tip: the name of the link whose frame is the flange.
        chain: the joints from base to tip.
        tip_named: whether the tip was named, and is not the only end.
    """

    joints: list[Joint]
    links: Mapping[str, Any]
    base: str
    tip: str
    chain: list[Joint]
    tip_named: bool

    @property
    def moving(self) -> list[Joint]:
        """The joints of the chain that are not fixed."""
        return _movable(self.chain)

    def carried(self, joint: Joint) -> list[tuple[str, Array]]:
        """The links that a joint of the chain moves and no later one, as `rigid_links`.

        Joints beside the chain, as those of a gripper's fingers, stand at zero.
        """
        chain_children = {moved.child for moved in self.moving}
        return _links_below(joint.child, [branch for branch in self.joints if branch.child not in chain_children])


def find_chain(
    path: str | Path,
    joints: list[Joint],
    links: Mapping[str, Any],
    base: str | None,
    tip: str | None,
    nouns: tuple[str, str] = ("link", "links"),
    beside: tuple[str, ...] = (),
) -> Tree:
    """The chain from `base` to `tip` of a tree; None for the only root or the only end.

    Each of the joints has another child. `nouns` is one link in the words of the file, and several; `beside` are
    further names that a tip may have.

    Raises:
        InputError: no such link, no joint that moves, several roots or ends.
    """
    above = {joint.child: joint for joint in joints}
    for name in (base, tip):
        if name is not None and name not in links:
            raise InputError(f"{path}: has no {nouns[0]} {name!r}; the {nouns[1]} are {', '.join(links)}")
    if base is None:
        roots = [link for link in links if link not in above]
        if len(roots) != 1:
            root_list = ", ".join(roots) or "none: the joints form a loop"
            raise InputError(f"{path}: has not one root {nouns[0]} ({root_list}); name one, {Path(path).name}#NAME:")
        base = roots[0]
    end = _only_end(path, base, links, above, beside) if tip is None else tip
    chain = _path(base, end, above)
    if chain is None:
        raise InputError(f"{path}: {end!r} is not below {base!r}; name another base or tip, {Path(path).name}#BASE:TIP")
    return Tree(joints, links, base, end, chain, tip is not None)


def _path(base: str, tip: str, above: Mapping[str, Joint]) -> list[Joint] | None:
    """The joints from base to tip; None where the tip is not below the base."""
    joints: list[Joint] = []
    while tip != base:
        if tip not in above or len(joints) > len(above):
            return None
        joints.append(above[tip])
        tip = above[tip].parent
    return joints[::-1]


def _movable(chain: list[Joint]) -> list[Joint]:
    return [joint for joint in chain if joint.kind != "fixed"]


def _only_end(
    path: str | Path, base: str, links: Mapping[str, Any], above: Mapping[str, Joint], beside: tuple[str, ...]
) -> str:
    parents = {joint.parent for joint in above.values()}
    chains = {leaf: _path(base, leaf, above) or [] for leaf in links if leaf not in parents}
    moving = {leaf: [joint.name for joint in _movable(chain)] for leaf, chain in chains.items()}
    longest = max(moving.values(), key=len, default=[])
    if not longest:
        raise InputError(f"{path}: no joint moves below {base!r}; name another, {Path(path).name}#NAME:")
    # A branch without a moving joint (a sensor's frame, a mesh) is no candidate, unless the chain ends there.
    candidates = [leaf for leaf, names in moving.items() if names == longest or names != longest[: len(names)]]
    tails = []
    for leaf in candidates:
        tail = IDENTITY
        for joint in chains[leaf]:
            tail = tail @ frames.transform_from_row(joint.row) if joint.kind == "fixed" else IDENTITY
        tails.append(tail)
    same_chain = all(moving[leaf] == longest for leaf in candidates)
    if same_chain and np.allclose(tails, tails[0], rtol=0, atol=1e-12):
        return candidates[0]
    chains = {leaf: _movable(chains[leaf]) for leaf in candidates}
    raise InputError(f"{path}: {_ends(Path(path).name, chains, beside)}")


def _ends(file: str, chains: Mapping[str, list[Joint]], beside: tuple[str, ...]) -> str:
    """Where the chain could end, and what to write for the likeliest: an arm before its gripper, or the longest.

    Of each link that could be the end `chains` has the joints that move.
    """
    names = {leaf: [joint.name for joint in joints] for leaf, joints in chains.items()}
    likeliest = last = max(names, key=lambda leaf: len(names[leaf]))
    longest = names[last]
    count = len(names[last])
    pairs = (enumerate(zip_longest(longest, joint_names)) for joint_names in names.values() if joint_names != longest)
    common = (next(number for number, (mine, theirs) in pair if mine != theirs) for pair in pairs)
    shared = min((number for number in common if number >= count - _LONGEST_FINGER), default=0)
    if count - shared <= min(_LONGEST_FINGER, shared - 1):  # fingers of one hand
        likeliest = chains[last][shared].parent
        count = shared
    order = {likeliest: count} | {leaf: len(joints) for leaf, joints in names.items()}
    listed = [f"{end} ({number} joint{'s' * (number != 1)})" for end, number in list(order.items())[:_SHOWN]]
    text = (
        f"the chain could end at {', '.join([*listed, *beside])}; say which as {file}#{likeliest}, or in convert with "
        f"--tip {likeliest}"
    )
    starts = [
        i for i in range(1, count) if any(n[:i] == longest[:i] and n[i] != longest[i] for n in names.values() if n[i:])
    ]
    if not starts:
        return text
    without = ", ".join(longest[: starts[-1]])
    start = chains[last][starts[-1]].parent
    return f"{text}; without {without}: {file}#{start}:{likeliest}, or --base {start} --tip {likeliest}"


def jaw(path: str | Path, tree: Tree) -> tuple[str, str]:
    """The link before a jaw in which a chain ends, and that in words; both empty where it ends in none.

    A jaw is known by the names of the last joints, or by a frame of the tool beside them.
    """
    moving = tree.moving
    arm = list(moving)
    while arm and (arm[-1].refused or _JAW_JOINT.search(arm[-1].name) or _JAW_LINK.search(arm[-1].child)):
        arm.pop()
    jaw_recognised = len(arm) < len(moving)
    if not jaw_recognised:
        arm = arm[:-1]
    if not arm:
        return "", ""
    first = moving[len(arm)]
    beside = [name for name, _ in rigid_links(first.parent, tree.joints) if name != first.parent and _TOOL.search(name)]
    if not beside and not jaw_recognised:
        return "", ""
    likely = (beside or [first.parent])[0]
    file = Path(path).name
    return likely, (
        f"{path}: the chain ends in {tree.tip} after {len(moving)} joints, and joint {first.name!r} seems to move a"
        f" jaw: the tip of the arm is likely {likely}, after {len(arm)} joints; name {file}#{likely} for it, or"
        f" {file}#{tree.tip} to keep the jaw"
    )


def rigid_links(link: str, joints: list[Joint]) -> list[tuple[str, Array]]:
    """A link and every link fixed to it, by name, each with its pose (4, 4) in the frame of the first."""
    return _links_below(link, [joint for joint in joints if joint.kind == "fixed"])


def _links_below(link: str, joints: list[Joint]) -> list[tuple[str, Array]]:
    """A link and all that joints lead to from it, by name, each with its pose (4, 4) in the frame of the first."""
    below: dict[str, list[Joint]] = {}
    for joint in joints:
        below.setdefault(joint.parent, []).append(joint)
    poses = []
    waiting = [(link, IDENTITY)]
    while waiting:
        name, T = waiting.pop()
        waiting += [(j.child, T @ frames.transform_from_row(j.row)) for j in below.get(name, [])]
        poses.append((name, T))
    return poses


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


def arm_of_chain(
    path: str | Path,
    tree: Tree,
    name: str,
    form: str,
    body_of: Callable[[str], frames.Body | None],
    drives: Mapping[str, Array],
) -> Arm:
    """The arm that a chain is; it has the name of the file where `name` is empty.

    Fixed joints are merged into the chain: those before the first joint into its frame, those after the last into
    `T_joint_flange`. A joint whose axis is not its z axis gets a frame whose z is that axis, so that every position of
    a joint keeps its value and sign. Links are lumped with the link that carries them, mass and inertia: those fixed to
    it, and those on moving joints beside the chain, such as fingers, where these joints are at zero. Inertia that is
    zero throughout is unknown. `body_of` says what a link is in its frame, and `drives` are fields of `Arm`.

    Raises:
        InputError: no joint that moves, or one that no arm here has; or as `Arm`.

    Warns:
        InputWarning: a tensor that no rigid body has, as published files have some; all inertia is then left out. Or a
            tip that was not named seems to be a jaw's.
    """
    if not tree.tip_named and (remark := jaw(path, tree)[1]):
        warnings.warn(remark, InputWarning, stacklevel=4)
    rows = []
    moving = tree.moving
    before = IDENTITY
    for place, joint in enumerate(tree.chain):
        T = frames.transform_from_row(joint.row)
        if joint.kind == "fixed":
            before = before @ T
            continue
        if joint.refused:
            raise InputError(f"{path}: joint {joint.name!r} {joint.refused} {_chain_without(path, tree, place)}")
        R = axis_frame(joint.axis)
        exact = np.array_equal(before, IDENTITY) and np.array_equal(R, IDENTITY)
        rows.append(joint.row if exact else frames.row_from_transform(before @ T @ R))
        before = R.T
    if not rows:
        raise InputError(
            f"{path}: no joint moves between {tree.base!r} and {tree.tip!r}; name another base or tip, "
            f"{Path(path).name}#BASE:TIP"
        )
    fields = _inertial(path, tree, body_of) | dict(drives)
    try:
        return Arm(
            name=name or Path(path).stem,
            kinematics=np.array(rows),
            joint_limits=np.array([joint.limits for joint in moving]),
            T_joint_flange=before,
            source=f"{form} {Path(path).name}, {tree.base} to {tree.tip}",
            sliding=tuple(i for i, joint in enumerate(moving) if joint.kind == "prismatic"),
            joint_names=tuple(joint.name for joint in moving),
            endless=tuple(i for i, joint in enumerate(moving) if joint.kind == "continuous"),
            **fields,
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _chain_without(path: str | Path, tree: Tree, place: int) -> str:
    """What to write for the longer chain beside the joint at a place of this one."""
    joint = tree.chain[place]
    before = _movable(tree.chain[:place])
    after = _movable(tree.chain[place + 1 :])
    option = f"--tip {joint.parent}"
    chain = joint.parent
    if len(after) > len(before) or not before:
        option = f"--base {joint.child}"
        chain = f"{joint.child}:{tree.tip}"
    elif tree.base in {tree_joint.child for tree_joint in tree.joints}:
        chain = f"{tree.base}:{joint.parent}"
    return f"name a chain without it with {option}, or as {Path(path).name}#{chain} where a file is named"


def _inertial(path: str | Path, tree: Tree, body_of: Callable[[str], frames.Body | None]) -> dict[str, Array]:
    """The fields of `Arm` that say what each moved link is with every link that it carries."""
    carried = [
        [
            frames.transform_body(body, axis_frame(joint.axis).T @ T)
            for name, T in tree.carried(joint)
            if (body := body_of(name)) is not None
        ]
        for joint in tree.moving
    ]
    if not any(carried):
        return {}
    links = [frames.lump(bodies) for bodies in carried]
    inertia_valid = True
    for joint, bodies, link in zip(tree.moving, carried, links, strict=True):
        if wrong := next(filter(None, (frames.defect(body.inertia) for body in (*bodies, link))), ""):
            inertia_valid = False
            warnings.warn(
                f"{path}: link {joint.child!r}: its inertia {wrong}; the inertia of this file is left out, correct it"
                " to diagnose torques",
                InputWarning,
                stacklevel=4,
            )
    mass, center, tensors = (np.array(column, float) for column in zip(*links, strict=True))
    fields = {"mass": mass, "center_of_mass": center}
    return fields | ({"inertia": tensors} if inertia_valid and tensors.any() else {})


def link_body(arm: Arm, i: int) -> frames.Body | None:
    """The link after an arm's joint `i`, from 0, without inertia where that is unknown; None without mass."""
    if arm.mass is None or arm.center_of_mass is None:
        return None
    tensor = np.zeros((3, 3)) if arm.inertia is None else arm.inertia[i]
    return frames.Body(float(arm.mass[i]), arm.center_of_mass[i], tensor)


def format_numbers(values: Array) -> str:
    """Numbers as an attribute of XML has them, exactly."""
    return " ".join(repr(float(value)) for value in values)
