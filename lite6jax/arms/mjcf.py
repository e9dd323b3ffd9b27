"""MJCF, MuJoCo's files: any chain of hinges and slides as a six-parameter arm with the same positions, and back.

MuJoCo compiles what is read, so that defaults, degrees, inertia of geometry and included files have their meaning.
"""

import re
import warnings
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lite6jax import storage
from lite6jax.arms import frames, inertia
from lite6jax.arms.arm import Arm
from lite6jax.arms.urdf_tree import SIZE_LIMIT, axis_frame
from lite6jax.errors import InputError, InputWarning

Array = NDArray[np.floating]

DRIVES = {
    "viscous_friction": "damping",
    "coulomb_friction": "frictionloss",
    "rotor_inertia": "armature",
    "spring_stiffness": "stiffness",
    "spring_rest": "springref",
}
"""Where a joint has the fields of `Arm`, in the same units."""
_NOT_A_NUMBER = re.compile(r"""["'\s](nan|inf)["'\s]""", re.IGNORECASE)


def read_mjcf(path: str | Path, base: str | None = None, tip: str | None = None) -> Arm:
    """The arm that an MJCF file describes.

    As `read_urdf`: bodies without joints are lumped with the body that carries them, mass and inertia, and those on
    moving joints beside the chain are omitted. Damping, friction loss, armature or stiffness that is zero throughout is
    unknown.

    Args:
        path: the file.
        base: the body whose frame is the arm's base; None for the world.
        tip: the body or site whose frame is the flange; None for the end of the only chain.

    Raises:
        InputError: the package mujoco is missing, MuJoCo refuses the file, a joint in the chain is neither hinge nor
            slide, or the tip is ambiguous.

    Warns:
        InputWarning: springs that are not linear, or compensated gravity, for which an arm has no place.
    """
    model = _compiled(path)
    tree = _Bodies(model)
    start = 0 if base is None else tree.body(path, base)
    end, T_body_flange = tree.tip(path, start, tip)
    bodies = tree.chain(start, end)
    if bodies is None:
        raise InputError(f"{path}: {tip!r} is not below {base or 'the world'!r}; name another --base or --tip")
    rows, links, joints = [], [], []
    before = np.eye(4)
    for body in bodies:
        before = before @ tree.T_parent[body]
        for joint in tree.joints[body]:
            name = model.joint(joint).name
            if model.jnt_type[joint] not in (_HINGE, _SLIDE):
                raise InputError(
                    f"{path}: joint {name!r} is neither hinge nor slide, which an arm here is made of; name a chain"
                    " without it with --base and --tip"
                )
            slides = model.jnt_type[joint] == _SLIDE
            zero = -model.qpos0[model.jnt_qposadr[joint]]
            anchor, R = np.eye(4), axis_frame(model.jnt_axis[joint])
            anchor[:3, 3] = model.jnt_pos[joint]
            reference = frames.transform_from_row([0, 0, zero, 0, 0, 0] if slides else [0, 0, 0, 0, 0, zero])
            rows.append(frames.row_from_transform(before @ anchor @ R @ reference))
            before = R.T @ np.linalg.inv(anchor)
            joints.append(joint)
            last = joint == tree.joints[body][-1]
            links.append(inertia.lumped(tree.fixed_to(body, before)) if last else _NOTHING)
    if not rows:
        raise InputError(
            f"{path}: no joint moves between the base and {tree.name(end)!r}; name another --base or --tip"
        )
    _warn_of_forces(path, model, joints, bodies)
    dofs = model.jnt_dofadr[joints]
    drives = {"viscous_friction": model.dof_damping, "coulomb_friction": model.dof_frictionloss}
    drives["rotor_inertia"] = model.dof_armature
    springs = {}
    if np.any(stiffness := np.array([np.ravel(model.jnt_stiffness[joint])[0] for joint in joints])):
        springs = {"spring_stiffness": stiffness, "spring_rest": model.qpos_spring[model.jnt_qposadr[joints]]}
    sliding = tuple(i for i, joint in enumerate(joints) if model.jnt_type[joint] == _SLIDE)
    widest = np.where(model.jnt_type[joints] == _SLIDE, 1.0, 2 * np.pi)[:, None] * [-1, 1]
    try:
        return Arm(
            name=_model_name(model) or Path(path).stem,
            kinematics=np.array(rows),
            joint_limits=np.where(model.jnt_limited[joints, None].astype(bool), model.jnt_range[joints], widest),
            T_joint_flange=before @ T_body_flange,
            mass=np.array([link.mass for link in links]),
            center_of_mass=np.array([link.center for link in links]),
            inertia=np.array([link.inertia for link in links]),
            source=f"MJCF {Path(path).name}, {tree.name(start)} to {tip or tree.name(end)}",
            sliding=sliding,
            joint_names=tuple(model.joint(joint).name for joint in joints),
            **{field: values[dofs] for field, values in drives.items() if values[dofs].any()},
            **springs,
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def write_mjcf(arm: Arm, path: str | Path, overwrite: bool = False) -> Path:
    """Writes the arm as MJCF: bodies `link1` … in the world, the flange a body on the last of them.

    `read_mjcf` returns it to rounding. A DH table and the source are omitted.

    Raises:
        InputError: the arm lacks inertia, or has a link that MuJoCo takes for massless or impossible; or as
            `storage.write_atomically`.
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
        six = inertia.six_entries(arm.inertia[i])
        body = {"mass": _floats(arm.mass[i : i + 1]), "pos": _floats(arm.center_of_mass[i])}
        ET.SubElement(parent, "inertial", body, fullinertia=_floats(six))
        drive = {key: values for field, key in DRIVES.items() if (values := getattr(arm, field)) is not None}
        given = {key: _floats(values[i : i + 1]) for key, values in drive.items()}
        joint = {"type": "slide" if arm.slides[i] else "hinge", "axis": "0 0 1", "range": _floats(arm.joint_limits[i])}
        ET.SubElement(parent, "joint", joint | given, name=f"joint{i + 1}")
    _add_body(parent, "flange", frames.row_from_transform(arm.T_joint_flange))
    ET.indent(root)
    return storage.write_atomically(path, ET.tostring(root, encoding="unicode") + "\n", overwrite)


_NOTHING = inertia.Body(0.0, np.zeros(3), np.zeros((3, 3)))
_SLIDE, _HINGE = 2, 3
"""mjJNT_SLIDE and mjJNT_HINGE."""
_LEAST = 1e-15
"""mjMINVAL."""


def _add_body(parent: ET.Element, name: str, row: Array) -> ET.Element:
    return ET.SubElement(parent, "body", name=name, pos=_floats(row[:3]), euler=_floats(row[3:]))


def _floats(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _mujoco(path: str | Path) -> ModuleType:
    try:
        import mujoco
    except ImportError as error:
        raise InputError(f"{path}: MJCF files take the package mujoco; pip install 'lite6jax[mjcf]'") from error
    return mujoco


def _compiled(path: str | Path) -> Any:
    """MuJoCo's model of a file; without meshes that are missing, where they say nothing of inertia."""
    text = storage.read_text(path, SIZE_LIMIT)
    if _NOT_A_NUMBER.search(text):
        raise InputError(f"{path}: has a number that is not finite; correct it")
    mujoco = _mujoco(path)
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        refused = error
    try:
        return _without_pictures(mujoco.MjSpec.from_file(str(path))).compile()
    except ValueError:
        problem = " ".join(str(refused).split()).removeprefix("Error: ")
        raise InputError(f"{path}: MuJoCo refuses it ({problem[:200]}); correct the file") from refused


def _without_pictures(spec: Any) -> Any:
    """A model without the geometry of bodies whose inertia is given, and without meshes, if no geometry is left."""
    for geom in list(spec.geoms):
        if geom.parent.explicitinertial or geom.parent.name == "world":
            spec.delete(geom)
    if not list(spec.geoms):
        for asset in [*spec.meshes, *spec.materials, *spec.textures]:
            spec.delete(asset)
    return spec


def _model_name(model: Any) -> str:
    """The model's name; "MuJoCo Model" is that of a file without one."""
    name = bytes(model.names).split(b"\0")[0].decode()
    return "" if name == "MuJoCo Model" or not name.isprintable() else name


def _warn_of_forces(path: str | Path, model: Any, joints: list[int], bodies: list[int]) -> None:
    sprung = [model.joint(joint).name for joint in joints if np.any(np.ravel(model.jnt_stiffness[joint])[1:])]
    floating = [model.body(body).name for body in bodies if model.body_gravcomp[body]]
    for names, what in (
        (sprung, "what is not linear of the springs of joints"),
        (floating, "the compensated gravity of bodies"),
    ):
        if names:
            warnings.warn(
                f"{path}: {what} {', '.join(names)} are left out, an arm has no place for them",
                InputWarning,
                stacklevel=3,
            )


class _Bodies:
    """The tree of a compiled model's bodies."""

    def __init__(self, model: Any) -> None:
        self.model = model
        count = model.nbody
        self.parent = [int(p) for p in model.body_parentid]
        self.children = [[c for c in range(1, count) if self.parent[c] == b] for b in range(count)]
        first, number = model.body_jntadr, model.body_jntnum
        self.joints = [list(range(first[b], first[b] + number[b])) for b in range(count)]
        self.T_parent = [_pose(p, R) for p, R in zip(model.body_pos, model.body_quat, strict=True)]

    def name(self, body: int) -> str:
        return self.model.body(body).name

    def body(self, path: str | Path, name: str) -> int:
        names = [self.name(body) for body in range(self.model.nbody)]
        if name not in names:
            raise InputError(f"{path}: has no body {name!r}; the bodies are {', '.join(filter(None, names))}")
        return names.index(name)

    def chain(self, base: int, tip: int) -> list[int] | None:
        """The bodies after `base` up to `tip`; None where the tip is not below the base."""
        found = []
        while tip != base:
            if tip == 0:
                return None
            found.append(tip)
            tip = self.parent[tip]
        return found[::-1]

    def moving(self, base: int, tip: int) -> list[int]:
        """The joints between two bodies."""
        return [joint for body in self.chain(base, tip) or [] for joint in self.joints[body]]

    def tip(self, path: str | Path, base: int, name: str | None) -> tuple[int, Array]:
        """The body at the end, and the flange in its frame."""
        sites = {self.model.site(s).name: s for s in range(self.model.nsite)}
        if name in sites:
            site = sites[name]
            pose = _pose(self.model.site_pos[site], self.model.site_quat[site])
            return int(self.model.site_bodyid[site]), pose
        if name is not None:
            return self.body(path, name), np.eye(4)
        below = [body for body in range(self.model.nbody) if self.chain(base, body) is not None]
        ends = {body: self.moving(base, body) for body in below if not self.children[body]}
        longest = max(ends.values(), key=len, default=[])
        if not longest:
            raise InputError(f"{path}: no joint moves below {self.name(base)!r}; name another --base")
        candidates = [body for body, joints in ends.items() if joints == longest or joints != longest[: len(joints)]]
        if len(candidates) > 1:
            names = [self.name(body) for body in candidates] + list(sites)
            raise InputError(
                f"{path}: the chain could end at {', '.join(filter(None, names))}; say which with --tip"
                f" {(first := next(filter(None, names), ''))}, or as {Path(path).name}#{first} where a file is named"
            )
        return candidates[0], np.eye(4)

    def fixed_to(self, body: int, T: Array) -> list[inertia.Body]:
        """A body and all that have no joint between it and them, in the axes to which T takes its coordinates."""
        model = self.model
        axes = _pose(model.body_ipos[body], model.body_iquat[body])
        own = inertia.Body(float(model.body_mass[body]), np.zeros(3), np.diag(model.body_inertia[body]))
        found = [inertia.moved(own, T @ axes)] if own.mass > 0 or own.inertia.any() else []
        for child in self.children[body]:
            if not self.joints[child]:
                found += self.fixed_to(child, T @ self.T_parent[child])
        return found


def _pose(position: Array, quaternion: Array) -> Array:
    """(4, 4) of a position, and a unit quaternion whose scalar is first."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    T = np.eye(4)
    T[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    T[:3, 3] = position
    return T
