"""The clearance between the links of an arm: capsules around them, their distances, and which pairs to test.

Capsules come from the arm's chain or from a URDF's collision geometry.
"""

import re
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
from numpy import typing as npt

from lite6jax.arms import frames, urdf
from lite6jax.arms.arm import Arm, sample_joints
from lite6jax.errors import InputError
from lite6jax.recordings import require_radians
from lite6jax.storage import exists, open_file

Floats = npt.NDArray[np.floating]
Segment = tuple[Floats, Floats, float]
"""A capsule in the frame of its shape: start, end, radius."""

SLENDERNESS = 20.0
"""Reach over radius where no radius is given: 4 cm on a Lite 6, 10 cm on a UR10e; an assumption, not a measurement."""
ALWAYS = 0.95
"""A pair that overlaps in more than this share of poses overlaps by construction (MoveIt's setup assistant does so)."""
_SAME_ARM = 0.02
"""m between the flanges of one arm as two files describe it: calibrations differ by less, other arms by more."""
_MESH_SIZE_LIMIT = 1 << 26
"""Bytes; a coarser mesh gives nearly the same capsule."""
_SAMPLES = 2048
_BLOCK = 4096
_VERTEX = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")


class Capsule(NamedTuple):
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
    start: Floats
    end: Floats
    radius: float


def chain_capsules(arm: Arm, radius: float | None = None, tool_point: npt.ArrayLike = (0.0, 0.0, 0.0)) -> list[Capsule]:
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

    A sphere and a cylinder are enclosed tightly; a box and a mesh by a capsule along their longest principal axis.
    Meshes are STL files, sought beside the URDF and, for package://, in the folders above it.

    Args:
        path: the URDF.
        arm: the arm that they are for, which is checked against the URDF's own; not where not given.
        base, tip: as of `read_urdf`.

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
    for link, element, T in urdf.links_of_chain(path, base, tip):
        name = element.get("name", "")
        for collision in element.findall("collision"):
            where = f"{path}: link {name!r}: collision"
            start, end, radius = _enclose_shape(path, collision, where)
            T_link_shape = T @ frames.transform_from_row(urdf.origin(collision, where))
            start, end = (T_link_shape[:3, :3] @ p + T_link_shape[:3, 3] for p in (start, end))
            capsules.append(Capsule(name, link, start, end, radius))
    if not capsules:
        raise InputError(f"{path}: no link of the chain has collision geometry; use capsules around the chain instead")
    return capsules


def _enclose_shape(path: str | Path, collision: ET.Element, where: str) -> Segment:
    shape = next(iter(collision.iterfind("geometry/*")), None)
    kind = "nothing" if shape is None else shape.tag

    def length(key: str) -> float:
        text = None if shape is None else shape.get(key)
        try:
            value = float(text or "")
        except ValueError:
            value = np.nan
        if not 0 < value < np.inf:
            raise InputError(f"{where}: {kind} {key} {text!r}; write a positive length in m")
        return value

    if shape is not None and kind == "sphere":
        return np.zeros(3), np.zeros(3), length("radius")
    if shape is not None and kind in ("cylinder", "capsule"):
        half = np.array([0.0, 0.0, length("length") / 2])
        return -half, half, length("radius")
    if shape is not None and kind == "box":
        size = urdf.vector(shape.get("size", ""), f"{where}: box size")
        if not (size > 0).all():
            raise InputError(f"{where}: box size {shape.get('size')!r}; write three positive lengths")
        return enclose_points(np.array([*product((-0.5, 0.5), repeat=3)]) * size)
    if shape is not None and kind == "mesh":
        scale = urdf.vector(shape.get("scale", "1 1 1"), f"{where}: mesh scale")
        return enclose_points(_read_stl(_mesh_file(path, shape.get("filename", ""), where), where) * scale)
    raise InputError(f"{where}: its geometry is {kind}; a box, cylinder, sphere or mesh is needed, or remove it")


def enclose_points(points: Floats) -> Segment:
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
    found = next(filter(exists, tried), None)
    if found is None:
        raise InputError(
            f"{where}: mesh {filename!r} is not there; put {Path(filename).name} beside the URDF, or use capsules"
            " around the chain"
        )
    return found


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


class SelfCollision(NamedTuple):
    """The capsules of an arm and the pairs of them that must stay apart.

    Attributes:
        arm: whose joints move the capsules.
        capsules: one or more on each link that has a shape.
        pairs: `(pair, 2)` capsules; never those of one link or of neighbours.
        disabled: the names of the pairs that overlap in nearly every pose and are not tested.
    """

    arm: Arm
    capsules: tuple[Capsule, ...]
    pairs: npt.NDArray[np.integer]
    disabled: tuple[tuple[str, str], ...]

    def clearance(self, joint_position: npt.ArrayLike) -> Floats:
        """The least distance between the surfaces of any pair, m, `(sample,)`: negative where they overlap.

        Args:
            joint_position: `(sample, joint)` rad.
        """
        q = np.asarray(joint_position, float)
        if len(self.pairs) == 0:
            return np.full(len(q), np.inf)
        return _pair_clearances(self.arm, self.capsules, self.pairs, q).min(0)


def self_collision(arm: Arm, capsules: Sequence[Capsule] | None = None) -> SelfCollision:
    """What must be apart on an arm: all pairs of links but neighbours, and but those that overlap nearly always.

    Args:
        arm: whose limits say which poses there are.
        capsules: `chain_capsules` if not given.
    """
    capsules = tuple(chain_capsules(arm) if capsules is None else capsules)
    pairs = [
        (i, j)
        for i, a in enumerate(capsules)
        for j, b in enumerate(capsules[:i])
        if abs(a.link - b.link) > 1 and a.radius + b.radius > 0
    ]
    if not pairs:
        return SelfCollision(arm, capsules, np.zeros((0, 2), np.int64), ())
    lower, upper = arm.joint_limits.T
    q = lower + (upper - lower) * (sample_joints(arm.dof, _SAMPLES) / (2 * np.pi) + 0.5)
    always = np.mean(_pair_clearances(arm, capsules, np.array(pairs), q) < 0, axis=1) > ALWAYS
    disabled = tuple((capsules[j].name, capsules[i].name) for (i, j), off in zip(pairs, always, strict=True) if off)
    return SelfCollision(arm, capsules, np.array(pairs)[~always], disabled)


def link_frames(arm: Arm, joint_position: npt.ArrayLike) -> Floats:
    """The frames after each joint's rotation, and the flange's: `T_base_link` `(joint + 1, 3, 4, sample)`.

    Args:
        arm: the chain.
        joint_position: `(sample, joint)` rad.

    Raises:
        InputError: joint positions in degrees.
    """
    require_radians(joint_position, arm.joint_limits)
    _, *walked = frames.walk(arm.links, np.asarray(joint_position, float), arm.sliding)
    return np.moveaxis(np.stack([*walked, walked[-1] @ arm.T_joint_flange])[:, :, :3], 1, -1)


def segment_distance(p1: npt.ArrayLike, q1: npt.ArrayLike, p2: npt.ArrayLike, q2: npt.ArrayLike) -> Floats:
    """The distance between segments p1 q1 and p2 q2; each end `(3, …)`, points and parallels included.

    The least of what each end is from the other segment and, where the common perpendicular of the lines meets both
    segments, of its length (C. Ericson, Real-Time Collision Detection, 2005, 5.1.9, its cases taken at once). Lines
    within 1 µrad of parallel are left to their ends: nothing is divided by what rounding made.
    """
    p1, q1, p2, q2 = (np.asarray(p, float) for p in (p1, q1, p2, q2))
    d1, d2, between = q1 - p1, q2 - p2, p2 - p1
    a, e, n = np.sum(d1 * d1, 0), np.sum(d2 * d2, 0), np.cross(d1, d2, axis=0)
    n2 = np.sum(n * n, 0)
    oblique = n2 > 1e-12 * a * e
    safe = np.where(oblique, n2, 1.0)
    s, t = (np.sum(np.cross(between, d, axis=0) * n, 0) / safe for d in (d2, d1))
    meets = oblique & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    squares = [np.where(meets, np.sum(between * n, 0) ** 2 / safe, np.inf)]
    for p, start, d, length2 in ((p1, p2, d2, e), (q1, p2, d2, e), (p2, p1, d1, a), (q2, p1, d1, a)):
        to = p - start
        along = np.clip(np.sum(to * d, 0) / np.where(length2 > 0, length2, 1.0), 0.0, 1.0)
        squares.append(np.sum((to - along * d) ** 2, 0))
    return np.sqrt(np.min(squares, 0))


def _pair_clearances(arm: Arm, capsules: Sequence[Capsule], pairs: npt.NDArray[np.integer], q: npt.ArrayLike) -> Floats:
    """Each pair's distance of surfaces, m, `(pair, sample)`."""
    q = np.asarray(q, float)
    found = np.empty((len(pairs), len(q)))
    for some in (slice(first, first + _BLOCK) for first in range(0, len(q), _BLOCK)):
        walked = list(frames.walk(arm.links, q[some], arm.sliding))
        ends = [
            [walked[one.link][..., :3, :3] @ end + walked[one.link][..., :3, 3] for end in (one.start, one.end)]
            for one in capsules
        ]
        for k, (i, j) in enumerate(pairs):
            distance = segment_distance(*(end.T for end in (*ends[i], *ends[j])))
            found[k, some] = distance - capsules[i].radius - capsules[j].radius
    return found
