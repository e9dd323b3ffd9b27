"""Capsules around the links of an arm, from its chain or from a URDF's collision geometry."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final
from xml.etree import ElementTree as ET

import numpy as np
from numpy import typing as npt

from lite6jax.arms import frames, urdf, urdf_tree
from lite6jax.arms.arm import Arm, sample_joints
from lite6jax.errors import InputError
from lite6jax.storage import exists, open_file

SLENDERNESS = 20.0
"""Reach over radius where no radius is given: 4 cm on a Lite 6, 10 cm on a UR10e; an assumption, not a measurement."""
_SAME_ARM = 0.02
"""m between the flanges of one arm as two files describe it: calibrations differ by less, other arms by more."""
_MESH_SIZE_LIMIT = 1 << 26
"""Bytes; a coarser mesh gives nearly the same capsule."""


@final
@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within `radius` of a segment, in m, in the frame of the link that carries it.

    Attributes:
        name: one for messages.
        link: 0 is the base, in the base frame; i is what joint i moves, in the frame after its rotation.
        start: `(3,)`, one end of the segment.
        end: `(3,)`, the other.
        radius: of the capsule.
    """

    name: str
    link: int
    start: npt.NDArray[np.floating]
    end: npt.NDArray[np.floating]
    radius: float


def chain_capsules(
    arm: Arm, radius: float | None = None, tool_point: npt.ArrayLike | Sequence[float] = (0.0, 0.0, 0.0)
) -> list[Capsule]:
    """Straight capsules between successive joint origins, from the base to the tool: all that a bare chain tells.

    Args:
        arm: the chain. A link without length, two axes that meet, has no capsule of its own.
        radius: of all capsules, m; an assumption: a twentieth of the reach if not given.
        tool_point: `(3,)` m in the flange's frame, where the last capsule ends.

    Raises:
        InputError: a radius that is not positive.
    """
    radius = arm.reach / SLENDERNESS if radius is None else radius
    if not 0 < radius < np.inf:
        raise InputError(f"capsule radius {radius:g} m: give a positive length")
    tool = arm.T_joint_flange[:3, :3] @ np.asarray(tool_point, float) + arm.T_joint_flange[:3, 3]
    ends = [*arm.kinematics[:, :3], tool]
    names = ["base", *(f"link{i + 1}" for i in range(arm.dof))]
    return [
        Capsule(name, link, np.zeros(3), end, float(radius))
        for link, (name, end) in enumerate(zip(names, ends, strict=True))
        if np.linalg.norm(end) > 1e-6
    ]


def urdf_capsules(
    path: str | Path, arm: Arm | None = None, base: str | None = None, tip: str | None = None
) -> list[Capsule]:
    """Capsules that enclose a URDF's collision geometry, for the arm that `read_urdf` gives with the same arguments.

    Args:
        path: the URDF.
        arm: the arm that they are for, which is checked against the URDF's own; not where not given.
        base, tip: as of `read_urdf`.

    A sphere and a cylinder are enclosed tightly; a box and a mesh by a capsule along their longest principal axis.
    Meshes are STL files, sought beside the URDF and, for package://, in the folders above it.

    Raises:
        InputError: as `read_urdf`, no collision geometry, a shape of another kind or size, a mesh that is absent, too
            large or no STL.
    """
    if arm is not None:
        own = urdf.read_urdf(path, base, tip)
        q = sample_joints(arm.dof) if own.dof == arm.dof else None
        chains = [frames.chain(of.links, q, of.sliding)[:, :3, 3] for of in (own, arm) if q is not None]
        if not chains or np.abs(chains[0] - chains[1]).max() > _SAME_ARM:
            raise InputError(f"{path}: is of another arm than {arm.name}; give its own URDF, or name the tip")
    capsules: list[Capsule] = []
    for link, element, T in urdf.carried_links(path, base, tip):
        name = element.get("name", "")
        for collision in element.findall("collision"):
            where = f"{path}: link {name!r}: collision"
            start, end, radius = _enclosed(path, collision, where)
            T_link_shape = T @ frames.transform_from_row(urdf_tree.origin(collision, where))
            start, end = (T_link_shape[:3, :3] @ p + T_link_shape[:3, 3] for p in (start, end))
            capsules.append(Capsule(name, link, start, end, radius))
    if not capsules:
        raise InputError(f"{path}: no link of the chain has collision geometry; use capsules around the chain instead")
    return capsules


Segment = tuple[npt.NDArray[np.floating], npt.NDArray[np.floating], float]


def _enclosed(path: str | Path, collision: ET.Element, where: str) -> Segment:
    """A shape's capsule in its own frame: start, end, radius."""
    shape = next(iter(collision.iterfind("geometry/*")), None)
    kind = "nothing" if shape is None else shape.tag
    if shape is not None and kind == "sphere":
        return np.zeros(3), np.zeros(3), _length(shape, "radius", where)
    if shape is not None and kind in ("cylinder", "capsule"):
        half = np.array([0.0, 0.0, _length(shape, "length", where) / 2])
        return -half, half, _length(shape, "radius", where)
    if shape is not None and kind == "box":
        size = urdf_tree.vector(shape.get("size", ""), f"{where}: box size")
        if not (size > 0).all():
            raise InputError(f"{where}: box size {shape.get('size')!r}; write three positive lengths")
        corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
        return enclosing_capsule(corners * size)
    if shape is not None and kind == "mesh":
        scale = urdf_tree.vector(shape.get("scale", "1 1 1"), f"{where}: mesh scale")
        return enclosing_capsule(_read_stl(_mesh_file(path, shape.get("filename", ""), where), where) * scale)
    raise InputError(f"{where}: its geometry is {kind}; a box, cylinder, sphere or mesh is needed, or remove it")


def _length(shape: ET.Element, key: str, where: str) -> float:
    try:
        value = float(shape.get(key, ""))
    except ValueError:
        value = np.nan
    if not 0 < value < np.inf:
        raise InputError(f"{where}: {shape.tag} {key} {shape.get(key)!r}; write a positive length in m")
    return value


def enclosing_capsule(points: npt.NDArray[np.floating]) -> Segment:
    """Start, end and radius of a capsule along the longest principal axis of points `(point, 3)`, that holds them all.

    Its axis passes through the middle of their extents, and its ends are drawn in as far as the caps allow.
    """
    _, axes = np.linalg.eigh(np.cov(points.T))
    along = points @ axes
    middle = (along.min(0) + along.max(0)) / 2
    radial = np.hypot(*(along - middle)[:, :2].T)
    radius = float(radial.max())
    cap = np.sqrt(radius**2 - radial**2)
    last, first = np.max(along[:, 2] - cap), np.min(along[:, 2] + cap)
    if last < first:
        last = first = (first + last) / 2
    start, end = (axes @ [middle[0], middle[1], z] for z in (first, last))
    return start, end, radius


def _mesh_file(path: str | Path, filename: str, where: str) -> Path:
    folder = Path(path).resolve().parent
    package, _, rest = filename.removeprefix("package://").partition("/")
    if filename.startswith("package://"):
        tried = [folder / rest, *(above / package / rest for above in (folder, *folder.parents))]
        tried += [above / rest for above in folder.parents if above.name == package]
    else:
        tried = [folder / filename.removeprefix("file://")]
    tried.append(folder / Path(filename).name)
    if Path(filename).suffix.lower() != ".stl":
        raise InputError(
            f"{where}: mesh {filename!r} is no STL file; convert it to STL, or use capsules around the chain"
        )
    for candidate in tried:
        if exists(candidate):
            return candidate
    raise InputError(
        f"{where}: mesh {filename!r} is not there; put {Path(filename).name} beside the URDF, or use capsules around"
        " the chain"
    )


_VERTEX = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")


def _read_stl(path: Path, where: str) -> npt.NDArray[np.float64]:
    """The vertices `(vertex, 3)` of a binary or ASCII STL file."""
    try:
        with open_file(path) as file:
            content = file.read(_MESH_SIZE_LIMIT + 1)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    if len(content) > _MESH_SIZE_LIMIT:
        raise InputError(f"{where}: {path}: larger than {_MESH_SIZE_LIMIT} bytes; give a coarser mesh")
    triangles = int.from_bytes(content[80:84], "little")
    if len(content) >= 84 and len(content) == 84 + 50 * triangles:  # some binary files begin with "solid", too
        facets = np.frombuffer(content, np.uint8, offset=84).reshape(-1, 50)
        vertices = np.ascontiguousarray(facets[:, 12:48]).view("<f4").reshape(-1, 3).astype(float)
    else:
        try:
            vertices = np.array(_VERTEX.findall(content), float).reshape(-1, 3)
        except ValueError:
            vertices = np.zeros((0, 3))
    if len(vertices) < 3 or not np.isfinite(vertices).all():
        raise InputError(f"{where}: {path}: not an STL mesh with triangles; export it anew as binary STL")
    return vertices
