"""MJCF, MuJoCo's files: any chain of hinges and slides as a six-parameter arm with the same positions, and back.

MuJoCo compiles what is read, so that defaults, degrees, inertia of geometry and included files have their meaning.
"""

import re
import warnings
import xml.etree.ElementTree as ET
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from lite6jax import storage
from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.trees import SIZE_LIMIT, Joint, Tree, arm_of_chain, axis_frame, find_chain, format_numbers, jaw
from lite6jax.array_types import Array, Integers
from lite6jax.errors import InputError, InputWarning

_DRIVES = {
    "viscous_friction": "damping",
    "coulomb_friction": "frictionloss",
    "rotor_inertia": "armature",
    "spring_stiffness": "stiffness",
    "spring_rest": "springref",
}
"""Where a joint has the fields of `Arm`, in the same units."""
_KINDS = {2: "prismatic", 3: "revolute"}
"""Of mjJNT_SLIDE and mjJNT_HINGE."""
_LEAST = 1e-15
"""mjMINVAL."""
_NOT_A_NUMBER = re.compile(r"""["'\s](nan|inf)["'\s]""", re.IGNORECASE)


def read_mjcf(path: str | Path, base: str | None = None, tip: str | None = None) -> Arm:
    """The arm that an MJCF file describes between two of its bodies, as `arm_of_chain` has it.

    Damping, friction loss, armature or stiffness that is zero throughout is unknown.

    Args:
        path: the file.
        base: the body whose frame is the arm's base; None for the world.
        tip: the body or site whose frame is the flange; None for the end of the only chain.

    Raises:
        InputError: the package mujoco is missing, MuJoCo refuses the file, a joint in the chain is neither hinge nor
            slide, or the tip is ambiguous.

    Warns:
        InputWarning: springs that are not linear, or compensated gravity, for which an arm has no place; or as
            `read_urdf`.
    """
    return read_chain(path, base, tip)[0]


def read_chain(
    path: str | Path, base: str | None = None, tip: str | None = None, warn_of_gravity: bool = True
) -> tuple[Arm, Any, Integers]:
    """As `read_mjcf`, with MuJoCo's model and the numbers of its joints `(joint,)` that are those of the arm.

    Args:
        path: the file.
        base: as of `read_mjcf`.
        tip: likewise.
        warn_of_gravity: whether to warn of compensated gravity, for which an arm has no place.
    """
    model = _compiled(path)
    tree, links, numbers = _tree(path, model, base, tip)
    moving = np.array([numbers[joint.child] for joint in tree.moving], int)
    bodies = [*links]
    in_chain = [bodies.index(joint.child) for joint in tree.chain if joint.child in bodies[: model.nbody]]
    _warn_of_forces(path, model, moving, in_chain if warn_of_gravity else [])
    dofs = model.jnt_dofadr[moving]
    drives = {"viscous_friction": model.dof_damping, "coulomb_friction": model.dof_frictionloss}
    drives["rotor_inertia"] = model.dof_armature
    fields = {field: values[dofs] for field, values in drives.items() if values[dofs].any()}
    if np.any(stiffness := np.array([np.ravel(model.jnt_stiffness[j])[0] for j in moving])):
        fields |= {"spring_stiffness": stiffness, "spring_rest": model.qpos_spring[model.jnt_qposadr[moving]]}
    name = bytes(model.names).split(b"\0")[0].decode()
    name = "" if name == "MuJoCo Model" or not name.isprintable() else name  # the former is that of a file without one
    return arm_of_chain(path, tree, name, "MJCF", links.get, fields), model, moving


def tip_before_jaw(path: str | Path) -> str:
    """The body or site before the jaw in which the only chain of a file ends; empty where it ends in none."""
    return jaw(path, _tree(path, _compiled(path), None, None)[0])[0]


def _tree(
    path: str | Path, model: Any, base: str | None, tip: str | None
) -> tuple[Tree, dict[str, frames.Body | None], dict[str, int]]:
    """The chain, the bodies by name (those of the model first), and the numbers of the joints that move links."""
    bodies = [model.body(b).name or f"(body {b})" for b in range(model.nbody)]
    links: dict[str, frames.Body | None] = {name: _body(model, b) for b, name in enumerate(bodies)}
    joints: list[Joint] = []
    numbers: dict[str, int] = {}  # in MuJoCo's model, of the joint that moves a link
    for b, body in enumerate(bodies[1:], 1):
        parent = bodies[model.body_parentid[b]]
        T = _pose(model.body_pos[b], model.body_quat[b])
        first = model.body_jntadr[b]
        count = model.body_jntnum[b]
        for j in range(first, first + count):
            # the link that a joint moves has its frame at the joint's anchor; the body's own frame is fixed to it
            anchor = frames.transform_from_row([*model.jnt_pos[j], 0, 0, 0])
            is_body_frame = j == first + count - 1 and not model.jnt_pos[j].any()
            link = body if is_body_frame else f"{body} at {model.joint(j).name}"
            joints.append(_joint(model, j, parent, link, T @ anchor))
            numbers[link], parent, T = j, link, np.linalg.inv(anchor)
        if parent != body:
            joints.append(_fixed(parent, body, T))
    sites = {model.site(s).name: s for s in range(model.nsite)}
    if tip is not None and tip in sites and tip not in links:
        s = sites[tip]
        joints.append(_fixed(bodies[model.site_bodyid[s]], tip, _pose(model.site_pos[s], model.site_quat[s])))
        links[tip] = None
    tree = find_chain(path, joints, links, base or bodies[0], tip, ("body", "bodies"), tuple(filter(None, sites)))
    return tree, links, numbers


def _body(model: Any, b: int) -> frames.Body | None:
    """What a body is, in its frame; None where it is nothing."""
    moments = np.diag(model.body_inertia[b])
    if model.body_mass[b] <= 0 and not moments.any():
        return None
    body = frames.Body(float(model.body_mass[b]), np.zeros(3), moments)
    return frames.transform_body(body, _pose(model.body_ipos[b], model.body_iquat[b]))


def _joint(model: Any, j: int, parent: str, child: str, T: Array) -> Joint:
    """A joint at its reference, in a frame at T (4, 4) in that of its parent."""
    kind = _KINDS.get(int(model.jnt_type[j]), "")
    R = axis_frame(model.jnt_axis[j])
    zero = -model.qpos0[model.jnt_qposadr[j]]
    widest = 2 * np.pi
    reference = [0, 0, 0, 0, 0, zero]
    if kind == "prismatic":
        reference = [0, 0, zero, 0, 0, 0]
        widest = 1.0
    row = frames.row_from_transform(T @ R @ frames.transform_from_row(reference) @ R.T)
    lower, upper = model.jnt_range[j] if model.jnt_limited[j] else (-widest, widest)
    refused = "is neither hinge nor slide, which an arm here is made of;"
    if kind:
        refused = ""
    axis = np.array(model.jnt_axis[j])
    return Joint(model.joint(j).name, kind, parent, child, row, axis, (float(lower), float(upper)), refused)


def _fixed(parent: str, child: str, T: Array) -> Joint:
    return Joint("", "fixed", parent, child, frames.row_from_transform(T), np.array([0.0, 0.0, 1.0]), (0.0, 0.0))


def _warn_of_forces(path: str | Path, model: Any, joints: Integers, bodies: list[int]) -> None:
    sprung = [model.joint(joint).name for joint in joints if np.any(np.ravel(model.jnt_stiffness[joint])[1:])]
    floating = [model.body(body).name for body in bodies if model.body_gravcomp[body]]
    for forces, names in (
        ("what is not linear of the springs of joints", sprung),
        ("the compensated gravity of bodies", floating),
    ):
        if names:
            warnings.warn(
                f"{path}: {forces} {', '.join(names)} are left out, an arm has no place for them",
                InputWarning,
                stacklevel=4,
            )


def require_mujoco(path: str | Path) -> Any:
    """MuJoCo's package, for a file to be read, or to be written and read back.

    Raises:
        InputError: it is missing.
    """
    try:
        return import_module("mujoco")
    except ImportError as error:
        raise InputError(f"{path}: MJCF files take the package mujoco; pip install 'lite6jax[mjcf]'") from error


def _compiled(path: str | Path) -> Any:
    """MuJoCo's model of a file; without meshes that are missing, where they say nothing of inertia."""
    text = storage.read_text(path, SIZE_LIMIT)
    if _NOT_A_NUMBER.search(text):
        raise InputError(f"{path}: has a number that is not finite; correct it")
    mujoco = require_mujoco(path)
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        refused = error
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        for geom in list(spec.geoms):
            if geom.parent.explicitinertial or geom.parent.name == "world":
                spec.delete(geom)
        if not list(spec.geoms):
            for asset in [*spec.meshes, *spec.materials, *spec.textures]:
                spec.delete(asset)
        return spec.compile()
    except ValueError:
        problem = " ".join(str(refused).split()).removeprefix("Error: ")
        raise InputError(f"{path}: MuJoCo refuses it ({problem[:200]}); correct the file") from refused


def _pose(position: Array, quaternion: Array) -> Array:
    """(4, 4) of a position, and a quaternion whose scalar is first."""
    T = np.eye(4)
    R = np.empty(9)
    import_module("mujoco").mju_quat2Mat(R, quaternion / np.linalg.norm(quaternion))
    T[:3, :3], T[:3, 3] = R.reshape(3, 3), position
    return T


def write_mjcf(arm: Arm, path: str | Path, overwrite: bool = False) -> Path:
    """Writes the arm as MJCF: bodies `link1` … in the world, the flange a body on the last of them.

    `read_mjcf` returns it to rounding. A DH table and the source are omitted.

    Raises:
        InputError: as `mjcf_tree`, or `storage.write_atomically`.
    """
    return write_tree(mjcf_tree(arm, path), path, overwrite)


def write_tree(root: ET.Element, path: str | Path, overwrite: bool = False) -> Path:
    """Writes the elements of a file.

    Raises:
        InputError: as `storage.write_atomically`.
    """
    ET.indent(root)
    return storage.write_atomically(path, ET.tostring(root, encoding="unicode") + "\n", overwrite)


def mjcf_tree(arm: Arm, path: str | Path) -> ET.Element:
    """The elements of the file that `write_mjcf` writes.

    Args:
        arm: with inertia.
        path: that errors name.

    Raises:
        InputError: the arm lacks inertia, or has a link that MuJoCo takes for massless or impossible.
    """
    if arm.mass is None or arm.center_of_mass is None or arm.inertia is None:
        raise InputError(
            f"{path}: MuJoCo needs the mass and inertia of every link, which {arm.name} lacks; give inertia_kg_m2"
            " in its description, or write a .urdf"
        )
    moments = np.linalg.eigvalsh(arm.inertia)
    refused = (arm.mass < _LEAST) | (moments[:, 0] < _LEAST) | (moments[:, 2] > moments[:, 0] + moments[:, 1])
    if refused.any():
        raise InputError(
            f"{path}: MuJoCo takes link{int(np.argmax(refused)) + 1} of {arm.name} for massless or impossible; its mass"
            " and principal moments must be positive, and none larger than the sum of the others"
        )
    root = ET.Element("mujoco", model=arm.name)
    ET.SubElement(root, "compiler", angle="radian", eulerseq="XYZ", autolimits="true")
    parent = ET.SubElement(root, "worldbody")
    for i, row in enumerate(arm.kinematics):
        parent = _add_body(parent, f"link{i + 1}", row)
        link = {"mass": format_numbers(arm.mass[i : i + 1]), "pos": format_numbers(arm.center_of_mass[i])}
        ET.SubElement(parent, "inertial", link, fullinertia=format_numbers(frames.six_entries(arm.inertia[i])))
        drives = arm.drives
        drive_attributes = {
            key: format_numbers(drives[field][i : i + 1]) for field, key in _DRIVES.items() if field in drives
        }
        joint = {
            "type": "slide" if arm.slides[i] else "hinge",
            "axis": "0 0 1",
            "range": format_numbers(arm.joint_limits[i]),
        }
        ET.SubElement(parent, "joint", joint | drive_attributes, name=f"joint{i + 1}")
    _add_body(parent, "flange", frames.row_from_transform(arm.T_joint_flange))
    return root


def _add_body(parent: ET.Element, name: str, row: Array) -> ET.Element:
    return ET.SubElement(parent, "body", name=name, pos=format_numbers(row[:3]), euler=format_numbers(row[3:]))
