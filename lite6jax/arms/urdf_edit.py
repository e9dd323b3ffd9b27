"""An existing URDF with the numbers of another arm of the same joints: its names, meshes and limits stay."""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lite6jax import storage
from lite6jax.arms import frames, inertia
from lite6jax.arms.arm import Arm
from lite6jax.arms.urdf import read_urdf, write_drives
from lite6jax.arms.urdf_tree import IDENTITY, SIZE_LIMIT, Joint, Tree, axis_frame, fixed_to, read_tree
from lite6jax.errors import InputError

Array = NDArray[np.floating]

SPRINGS_LEFT_OUT = "springs, but for Gazebo's extension <gazebo reference=…>"
"""What a URDF has no place for, of an arm with springs."""
_FAR = (0.02, 0.1)
"""m and rad, by which no joint of an arm deviates from its design."""
_SAME = 1e-12
"""m, rad: of a transform that does not change, the text stays as it is."""


def write_into_urdf(
    arm: Arm,
    robot: str | Path,
    path: str | Path,
    base: str | None = None,
    tip: str | None = None,
    overwrite: bool = False,
    with_flange: bool = True,
) -> tuple[Path, tuple[str, ...]]:
    """Writes a URDF in which the joints of a chain have the origins, inertia and drives of an arm.

    Names, axes, limits with efforts and velocities, meshes, other chains and comments stay. What follows the last joint
    changes in the last fixed joint. Where the arm has inertia, that of each link contains the links fixed to it, whose
    own is removed.

    Args:
        arm: the arm; what it does not know stays as the file has it.
        robot: the file to read.
        path: the file to write.
        base: the link whose frame is the base; None for the root.
        tip: the link whose frame is the flange; None for the end of the only chain.
        overwrite: whether the target may be replaced.
        with_flange: whether what follows the last joint changes.

    Returns:
        the path, and what the file has no place for, a phrase each.

    Raises:
        InputError: as `read_urdf`; another number of joints; joint frames that stand elsewhere by design, to which the
            meshes would not fit; or as `storage.write_atomically`.
    """
    old, tree = read_urdf(robot, base, tip), read_tree(robot, base, tip)
    if (old.dof, old.sliding) != (arm.dof, arm.sliding):
        slides = [", prismatic " + ", ".join(str(i + 1) for i in of.sliding) if of.sliding else "" for of in (old, arm)]
        raise InputError(
            f"{robot}: has {old.dof} joints from {tree.base} to {tree.tip}{slides[0]}, but {arm.name} has"
            f" {arm.dof}{slides[1]}"
        )
    text = storage.read_text(robot, SIZE_LIMIT)
    root = ET.fromstring(text, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))
    joints = {element.get("name"): element for element in root.findall("joint")}
    links = {element.get("name"): element for element in root.findall("link")}
    _require_same_frames(arm, old, robot)
    left_out = _place(arm, old, tree, joints, with_flange)
    turning = [joint for joint in tree.chain if joint.kind != "fixed"]
    for i, joint in enumerate(turning):
        write_drives(arm, i, root, joints[joint.name])
    if arm.mass is not None and arm.inertia is not None and not _same_bodies(arm, old):
        for i, joint in enumerate(turning):
            _weigh(arm, i, joint, tree, links)
    if arm.rotor_inertia is not None:
        left_out.append("rotor inertia")
    if arm.spring_stiffness is not None:
        left_out.append(SPRINGS_LEFT_OUT)
    content = '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
    return storage.write_atomically(path, content, overwrite), tuple(left_out)


def _require_same_frames(arm: Arm, old: Arm, robot: str | Path) -> None:
    for i, rows in enumerate(zip(arm.kinematics, old.kinematics, strict=True)):
        T, before = map(frames.transform_from_row, rows)
        moved, turned = np.linalg.norm(T[:3, 3] - before[:3, 3]), np.linalg.norm(T[:3, :3] - before[:3, :3])
        if moved > _FAR[0] or turned > _FAR[1]:
            raise InputError(
                f"{robot}: the frame of joint {i + 1} stands {1e3 * moved:.3g} mm and {turned:.2g} rad from that of "
                f"{arm.name}, which is no deviation of one arm; give the URDF of the description that was diagnosed"
            )


def _place(arm: Arm, old: Arm, tree: Tree, joints: dict[str | None, ET.Element], with_flange: bool) -> list[str]:
    """Sets the origins of joints; what has no place is returned."""
    before, i = IDENTITY, 0
    for joint in tree.chain:
        T = frames.transform_from_row(joint.row)
        if joint.kind == "fixed":
            before = before @ T
            continue
        R = axis_frame(joint.axis)
        wanted = frames.transform_from_row(arm.kinematics[i])
        if np.abs(wanted - frames.transform_from_row(old.kinematics[i])).max() > _SAME:
            _set_origin(joints[joint.name], np.linalg.inv(before) @ wanted @ R.T)
        before, i = R.T, i + 1
    if not with_flange or np.abs(arm.T_joint_flange - old.T_joint_flange).max() <= _SAME:
        return []
    last = tree.chain[-1]
    if last.kind != "fixed":
        return [f"what follows the last joint (no fixed joint leads to {tree.tip})"]
    T = frames.transform_from_row(last.row)
    _set_origin(joints[last.name], T @ np.linalg.inv(old.T_joint_flange) @ arm.T_joint_flange)
    return []


def _set_origin(element: ET.Element, T: Array) -> None:
    entry = element.find("origin")
    if entry is None:
        entry = ET.SubElement(element, "origin")
    row = frames.row_from_transform(T)
    entry.set("xyz", _floats(row[:3]))
    entry.set("rpy", _floats(row[3:]))


def _same_bodies(arm: Arm, old: Arm) -> bool:
    pairs = [(getattr(arm, field), getattr(old, field)) for field in ("mass", "center_of_mass", "inertia")]
    return all(b is not None and np.allclose(a, b, rtol=1e-12, atol=1e-15) for a, b in pairs)


def _weigh(arm: Arm, i: int, joint: Joint, tree: Tree, links: dict[str | None, ET.Element]) -> None:
    """Gives a link all the inertia that moves with its joint."""
    assert arm.mass is not None
    assert arm.center_of_mass is not None
    assert arm.inertia is not None
    body = inertia.moved(
        inertia.Body(float(arm.mass[i]), arm.center_of_mass[i], arm.inertia[i]), axis_frame(joint.axis)
    )
    for name, _ in fixed_to(joint.child, tree.joints):
        for entry in links[name].findall("inertial"):
            links[name].remove(entry)
    element = ET.SubElement(links[joint.child], "inertial")
    ET.SubElement(element, "origin", xyz=_floats(body.center), rpy="0.0 0.0 0.0")
    ET.SubElement(element, "mass", value=repr(body.mass))
    six = zip(inertia.SIX, inertia.six_entries(body.inertia), strict=True)
    ET.SubElement(element, "inertia", {key: repr(float(value)) for key, value in six})


def _floats(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)
