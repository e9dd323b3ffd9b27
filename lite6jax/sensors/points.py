"""Sensors that read where one point of the tool is: in a socket, on a plane, from an anchor, along an axis.

Each class says all of its sensor: what it reads, what a sidecar declares of it, where a plan puts it, and how readings
are simulated.
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Generic, NamedTuple, Self, TypeVar, final

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.se3 import Frame
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.errors import InputError
from lite6jax.sensors.kinds import KINDS, Kind
from lite6jax.sensors.sensor import OwnNumber, Point, Sensor

S_co = TypeVar("S_co", bound=Sensor, covariant=True)

_STATIC = {"static": True}
"""Of fields that are no arrays."""
SOCKETS_APART = 0.05
"""m, of the two sockets of one plate, …"""
SOCKETS_KNOWN = 5e-5
"""… and its standard deviation."""
_PLANNED_PLATE = 0.08
"""m, half a plate's side, where touches are planned."""
_SIMULATED_PLATE = 0.25
"""Of the reach, half a plate's side, where they are simulated."""
_NORMALS = ((0.0, 0.0, 1.0), (1.0, 0.1, 0.1), (0.1, 1.0, 0.2))
"""Of plates, before they are of unit length: no two are parallel."""
_IN_FRONT = (-1.2, 1.2)
"""rad about the base, between which plates are planned."""
_BEHIND = 2.5
"""rad, where an anchor stands, …"""
_BEYOND = 1.6
"""… times as far away as a place within reach."""
_GAUGE_AT = 0.3
"""m, what a simulated gauge reads at the height of the base."""


class Rod(NamedTuple):
    """Two contacts whose distance is known: of the one before and of the one that follows it, and the distance.

    Attributes:
        parent: a contact.
        child: another, which no other rod leads to.
        length: m, as declared.
        noise: m, one sigma.
    """

    parent: int
    child: int
    length: float
    noise: float


class Declaration(NamedTuple):
    """What a recording and its sidecar say of a sensor.

    Attributes:
        settings: of the sidecar, a `RecordingSettings`.
        names: of the points, planes or anchors.
        group: `(sample,)` int, which of these a sample is of.
        value: `(sample,)` m, of distances or heights.
        noise: m, one sigma.
        source: what messages begin with.
    """

    settings: Any
    names: tuple[str, ...]
    group: NDArray[np.int64]
    value: Array
    noise: float
    source: str

    @property
    def whitener(self) -> Array:
        """The whitener of sensors of a point."""
        return np.full(2, 1 / self.noise)

    def places(self, coordinates: Mapping[str, Any]) -> tuple[Array, tuple[bool, ...]]:
        """The points `(3, place)` and which of them are unknown."""
        points = np.array([coordinates.get(name, (0.0, 0.0, 0.0)) for name in self.names], float).T
        return points, tuple(name not in coordinates for name in self.names)


class Simulated(NamedTuple, Generic[S_co]):
    """A drawn sensor with its samples.

    Attributes:
        sensor: with its true places.
        target: where the tool is to be led, `(sample, 4, 4)` in the arm's base frame; None where that is anywhere.
        error: of each reading, m, or px of a camera.
    """

    sensor: S_co
    target: Array | None
    error: Array


@dataclass(frozen=True, eq=False)
class PointSensor(Sensor):
    """A sensor of the tool's point, at places of which some are unknown.

    Attributes:
        group: `(sample,)` int, which point, plane or anchor a sample is of; zero of an axis.
        names: of each of these.
        scaled: whether something in it has a known length, without which a chain of any size would fit.
        kind: what its column is called.
        source: `pose_source` in a sidecar.
        usual_noise: m, one sigma.
        usual_tool: the tool's point in the flange's frame, m, away from the last joint's axis.
        usual_places: how many places a plan has.
        advice: how to record more.
    """

    sampled = ("group",)
    names = ("axis",)
    scaled = True
    kind: ClassVar[Kind]
    source: ClassVar[str]
    usual_noise: ClassVar[float]
    usual_tool: ClassVar[Point]
    usual_places: ClassVar[int] = 2
    advice: ClassVar[str]
    group: Any
    whitener: Any
    joint_noise: float = field(default=0.0, kw_only=True, metadata=_STATIC)

    @classmethod
    @abstractmethod
    def from_declaration(cls, declaration: Declaration) -> Self:
        """The sensor of a recording, with what its sidecar declares of points, planes, anchors or the axis.

        Raises:
            InputError: a ring of known distances, or one place for several anchors.
        """

    @classmethod
    @abstractmethod
    def plan(cls, rng: np.random.Generator, reach: float, places: int, noise: float) -> Self:
        """A sensor whose places are unknown, about an arm of a reach, m, without samples.

        Args:
            rng: for the places.
            reach: of the arm.
            places: how many plates.
            noise: m, one sigma.
        """

    @classmethod
    @abstractmethod
    def simulate(
        cls, rng: np.random.Generator, samples: int, reach: float, noise: float, declared: float
    ) -> Simulated[Self]:
        """Draws a sensor with its places, what is read in each sample, and its errors.

        Args:
            rng: of all that is drawn.
            samples: how many.
            reach: of the arm, m.
            noise: m, one sigma of the errors.
            declared: m, the sigma that the sensor states.
        """

    @abstractmethod
    def declared(self) -> dict[str, Any]:
        """Its keys of a sidecar, as one is written: noise and known lengths, not where its places are."""

    @abstractmethod
    def record(self, tool: Array, error: Array) -> dict[str, Any]:
        """What a recording holds of tools `(sample, 4, 4)`, read with errors: `labels`, or the `value` `(sample,)`."""

    @abstractmethod
    def shown(self, tool: Array) -> Self:
        """The sensor with its unknowns as a tool `(sample, 4, 4)` shows them in closed form."""

    @abstractmethod
    def place(self, k: int) -> dict[str, list[float]]:
        """What of the point, plane or anchor `k` is known or was estimated, by name with its unit."""

    @property
    def quantity(self) -> str:
        return self.kind

    @property
    @abstractmethod
    def reads(self) -> str:
        """What it reads, in words, without the noise."""

    @property
    def phrase(self) -> str:
        unknown = ", whose places are unknown" if any(number.precision == 0 for number in self.own) else ""
        return f"{self.reads} to ±{1e3 * self.position_noise:.3g} mm{unknown}"

    @property
    def at(self) -> Array:
        """`(3, place)` m, where its places are; none of an axis."""
        return np.zeros((3, 0))

    @property
    def touched(self) -> bool:
        return KINDS[self.kind].touched

    def place_name(self, name: str) -> str:
        """A place in words, such as `contact a`."""
        label = KINDS[self.kind].label or self.kind
        return name if name == label else f"{label} {name}"

    @property
    def labels(self) -> list[str]:
        """The name of the place of each sample."""
        return [self.names[k] for k in self.group]

    def nearest(self, tool: Array) -> Integers:
        if not self.at.size:
            return np.zeros(len(tool), int)
        return np.argmin(np.sum((tool[:, None, :3, 3] - self.at.T) ** 2, 2), 1)

    def exact(self, tool: Array) -> Self:
        return replace(self, group=self.nearest(tool))

    def to_dict(self) -> dict[str, Any]:
        places = dict(zip(self.names, map(tuple, self.at.T.tolist()), strict=True)) if self.at.size else {}
        return super().to_dict() | {"places": places}

    def _of_each(self, free: tuple[bool, ...], tool: Array) -> list[tuple[int, Mask, Array]]:
        """The number of each place that is unknown, its samples, and there the tool's point `(sample, 3)`."""
        selections = ((int(k), np.asarray(self.group) == k) for k in np.flatnonzero(free))
        return [(k, selected, tool[selected, :3, 3]) for k, selected in selections]


@final
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Contact(PointSensor):
    """The tool's point touches points: p − c.

    Attributes:
        points: `(3, contact)` m.
        names: of the contacts.
        free: for each, whether it is unknown.
        rods: the known distances, each after those that lead to its parent. A child's numbers are the length of its rod
            and two shifts across it, so that what is known of the distance is the prior of one number.
    """

    rows = 3
    kind = "contact"
    source = "touch"
    usual_noise = 1e-4
    usual_tool = (0.02, 0.0, 0.09)
    advice = "touch each socket at ten or more wrist orientations, and more than one socket"
    points: Any
    names: tuple[str, ...] = field(metadata=_STATIC)
    free: tuple[bool, ...] = field(metadata=_STATIC)
    rods: tuple[Rod, ...] = field(default=(), metadata=_STATIC)

    def readings(self, tool: Frame) -> jax.Array:
        return tool.origin - jnp.asarray(self.points)[:, self.group]

    @property
    def own(self) -> tuple[OwnNumber, ...]:
        points = np.asarray(self.points)
        unknowns: dict[int, tuple[OwnNumber, ...]] = {
            k: (OwnNumber(f"contact {name}", "m"),) * 3 for k, name in enumerate(self.names) if self.free[k]
        }
        for rod in self.rods:
            apart = float(np.linalg.norm(points[:, rod.child] - points[:, rod.parent]))
            name = f"contact {self.names[rod.child]}"
            length = OwnNumber(name, "m", rod.noise**-2.0, apart - rod.length)
            unknowns[rod.child] = (length, OwnNumber(name, "m"), OwnNumber(name, "m"))
        return tuple(number for k in sorted(unknowns) for number in unknowns[k])

    def moved(self, numbers: Any) -> "Contact":
        at = np.cumsum(self.free) - 1
        children = {rod.child for rod in self.rods}
        before = jnp.asarray(self.points)
        roots = np.array([free and k not in children for k, free in enumerate(self.free)])
        shift = jnp.asarray(numbers).reshape(-1, 3).T
        points = before + jnp.where(roots, shift[:, np.maximum(at, 0)], 0.0) if roots.any() else before
        for parent, child, _, _ in self.rods:
            rod = before[:, child] - before[:, parent]
            length = jnp.linalg.norm(rod)
            longer, *across = shift[:, at[child]]
            turned = rod + tangents(rod / length) @ jnp.stack(across)
            turned = (length + longer) * turned / jnp.linalg.norm(turned)
            points = points.at[:, child].set(points[:, parent] + turned)
        return replace(self, points=points)

    @property
    def scaled(self) -> bool:  # type: ignore[override]
        return bool(self.rods) or len(self.free) - sum(self.free) > 1

    def shown(self, tool: Array) -> "Contact":
        points = np.array(self.points)
        for k, _, p in self._of_each(self.free, tool):
            points[:, k] = np.median(p, 0)
        for rod in self.rods:  # two sockets are no nearer to each other than the rod is long
            apart = points[:, rod.child] - points[:, rod.parent]
            apart = apart if np.linalg.norm(apart) > 0.1 * rod.length else np.array([rod.length, 0.0, 0.0])
            points[:, rod.child] = points[:, rod.parent] + rod.length * apart / np.linalg.norm(apart)
        return replace(self, points=points)

    def place(self, k: int) -> dict[str, list[float]]:
        return {"point_m": np.asarray(self.points)[:, k].tolist()}

    @classmethod
    def from_declaration(cls, declaration: Declaration) -> Self:
        points, free = declaration.places(declaration.settings.contact_points or {})
        return cls(declaration.group, declaration.whitener, points, declaration.names, free, _rods(declaration, free))

    @classmethod
    def plan(cls, rng: np.random.Generator, reach: float, places: int, noise: float) -> Self:
        first = draw_points(rng, reach, _angles(places))
        along = rng.standard_normal((places, 3)) * [1, 1, 0.2]
        along = SOCKETS_APART * along / np.linalg.norm(along, axis=1, keepdims=True)
        return cls._of_plates(np.stack([first, first + along], 1), np.zeros(0, int), noise)

    @classmethod
    def simulate(
        cls, rng: np.random.Generator, samples: int, reach: float, noise: float, declared: float
    ) -> Simulated[Self]:
        plates = []
        for angle in (-0.6, 0.7):
            socket = draw_point(rng, reach, angle)
            along = rng.standard_normal(3)
            plates.append((socket, socket + SOCKETS_APART * along / np.linalg.norm(along)))
        group = np.arange(samples) * 2 * len(plates) // max(samples, 1)
        sensor = cls._of_plates(np.array(plates), group, declared)
        error = noise * rng.standard_normal((samples, 3))
        return Simulated(sensor, poses_at(sensor.at.T[group] + error), error)

    @classmethod
    def _of_plates(cls, sockets: Array, group: Any, noise: float) -> Self:
        """Takes plates with two sockets each `(plate, 2, 3)`, whose distance is known."""
        names = tuple(f"plate{k + 1}_{end}" for k in range(len(sockets)) for end in "ab")
        count = len(names)
        rods = tuple(Rod(k, k + 1, SOCKETS_APART, SOCKETS_KNOWN) for k in range(0, count, 2))
        return cls(group, np.full(2, 1 / noise), sockets.reshape(-1, 3).T, names, (True,) * count, rods)

    @property
    def at(self) -> Array:
        return np.asarray(self.points)

    @property
    def reads(self) -> str:
        return f"touches of {len(self.names)} sockets"

    def targets(self, rng: np.random.Generator, count: int, reach: float) -> Array:
        return poses_at(self.at.T[np.arange(count) % len(self.names)])

    def declared(self) -> dict[str, Any]:
        distances = [
            {
                "between": (self.names[rod.parent], self.names[rod.child]),
                "distance_m": rod.length,
                "noise_m": rod.noise,
            }
            for rod in self.rods
        ]
        return {"contact_noise_m": self.position_noise, "contact_distances": distances}

    def record(self, tool: Array, error: Array) -> dict[str, Any]:
        return {"labels": self.labels}


@final
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Plane(PointSensor):
    """The tool's point touches planes: n · (p − c) − h.

    Attributes:
        normal: `(3, plane)`, unit.
        centre: `(3, plane)` m, a fixed point near the touches, about which a plane is turned.
        height: `(plane,)` m, of the plane above that.
        names: of the planes.
        free: for each, whether it is unknown.
    """

    rows = 1
    kind = "plane"
    source = "touch"
    usual_noise = 2e-5
    usual_tool = (0.0, 0.03, 0.06)
    usual_places = 3
    advice = "touch each plane at three or more places far apart, at several wrist orientations"
    normal: Any
    centre: Any
    height: Any
    names: tuple[str, ...] = field(metadata=_STATIC)
    free: tuple[bool, ...] = field(metadata=_STATIC)

    def readings(self, tool: Frame) -> jax.Array:
        normal, centre, height = (
            jnp.asarray(part)[..., self.group] for part in (self.normal, self.centre, self.height)
        )
        return (jnp.sum(normal * (tool.origin - centre), 0) - height)[None]

    @property
    def own(self) -> tuple[OwnNumber, ...]:
        names = [name for name, free in zip(self.names, self.free, strict=True) if free]
        kinds = (("normal of plane", "rad"), ("normal of plane", "rad"), ("height of plane", "m"))
        return tuple(OwnNumber(f"{kind} {name}", unit) for name in names for kind, unit in kinds)

    def moved(self, numbers: Any) -> "Plane":
        normal = jnp.asarray(self.normal)
        height = jnp.asarray(self.height)
        for k, step in zip(np.flatnonzero(self.free), jnp.asarray(numbers).reshape(-1, 3), strict=True):
            turned = normal[:, k] + tangents(normal[:, k]) @ step[:2]
            normal = normal.at[:, k].set(turned / jnp.linalg.norm(turned))
            height = height.at[k].add(step[2])
        return replace(self, normal=normal, height=height)

    @property
    def scaled(self) -> bool:  # type: ignore[override]
        return not all(self.free)

    def shown(self, tool: Array) -> "Plane":
        normal, centre, height = (np.array(part) for part in (self.normal, self.centre, self.height))
        for k, _, p in self._of_each(self.free, tool):
            centre[:, k] = p.mean(0)
            height[k] = 0.0
            normal[:, k] = np.linalg.svd(p - p.mean(0), full_matrices=True)[2][2]
        return replace(self, normal=normal, centre=centre, height=height)

    def place(self, k: int) -> dict[str, list[float]]:
        normal = np.asarray(self.normal)[:, k]
        offset = float(normal @ np.asarray(self.centre)[:, k] + np.asarray(self.height)[k])
        return {"normal": normal.tolist(), "offset_m": [offset]}

    @classmethod
    def from_declaration(cls, declaration: Declaration) -> Self:
        names = declaration.names
        planes = declaration.settings.planes or {}
        declared = np.array(
            [(*planes[name].normal, planes[name].offset_m) if name in planes else (0, 0, 1, 0) for name in names], float
        )
        normal, height = np.split(declared.T / np.linalg.norm(declared[:, :3], axis=1), [3])
        free = tuple(name not in planes for name in names)
        centre = np.zeros_like(normal)
        return cls(declaration.group, declaration.whitener, normal, centre, height[0], names, free)

    @classmethod
    def plan(cls, rng: np.random.Generator, reach: float, places: int, noise: float) -> Self:
        return cls._of_plates(draw_points(rng, reach, _angles(places)), np.zeros(0, int), noise)

    @classmethod
    def simulate(
        cls, rng: np.random.Generator, samples: int, reach: float, noise: float, declared: float
    ) -> Simulated[Self]:
        centres = draw_points(rng, reach, (0.0, 0.6, -0.9))
        group = np.arange(samples) % len(centres)
        sensor = cls._of_plates(centres, group, declared)
        error = noise * rng.standard_normal(samples)
        return Simulated(sensor, poses_at(sensor._touches(rng, group, _SIMULATED_PLATE * reach, error)), error)

    @classmethod
    def _of_plates(cls, centres: Array, group: Any, noise: float) -> Self:
        """Takes plates about centres `(plate, 3)`."""
        count = len(centres)
        tilted = np.array(_NORMALS)[np.arange(count) % len(_NORMALS)].T
        names = tuple(f"plate{k + 1}" for k in range(count))
        normal = tilted / np.linalg.norm(tilted, axis=0)
        return cls(group, np.full(2, 1 / noise), normal, centres.T, np.zeros(count), names, (True,) * count)

    @property
    def at(self) -> Array:
        return np.asarray(self.centre)

    @property
    def reads(self) -> str:
        return f"touches of {len(self.names)} plates"

    def nearest(self, tool: Array) -> Integers:
        apart = tool[:, None, :3, 3] - self.at.T
        return np.argmin(np.abs(np.sum(apart * np.asarray(self.normal).T, 2)), 1)

    def targets(self, rng: np.random.Generator, count: int, reach: float) -> Array:
        group = np.arange(count) % len(self.names)
        return poses_at(self._touches(rng, group, _PLANNED_PLATE, np.zeros(count)))

    def _touches(self, rng: np.random.Generator, group: Integers, half: float, error: Array) -> Array:
        """Points `(sample, 3)` drawn on plates of a half side, m, and off them by errors `(sample,)`, m."""
        normal = np.asarray(self.normal).T[group]
        aside = half * rng.uniform(-1, 1, (len(group), 3))
        return self.at.T[group] + (aside + normal * (error - np.sum(normal * aside, 1))[:, None])

    def declared(self) -> dict[str, Any]:
        return {"plane_noise_m": self.position_noise}

    def record(self, tool: Array, error: Array) -> dict[str, Any]:
        return {"labels": self.labels}


@final
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Distance(PointSensor):
    """The tool's point is at distances from anchors: ‖p − a‖ + c − d.

    Attributes:
        value: d, `(sample,)` m.
        anchors: a, `(3, anchor)` m.
        constant: c, `(1,)` m.
        names: of the anchors.
        free: for each, whether it is unknown.
        offset_free: whether the constant is unknown.
    """

    rows = 1
    kind = "distance"
    source = "draw_wire"
    usual_noise = 5e-5
    usual_tool = (0.01, -0.02, 0.05)
    advice = "record it at poses over the whole workspace"
    sampled = ("group", "value")
    value: Any
    anchors: Any
    constant: Any
    names: tuple[str, ...] = field(metadata=_STATIC)
    free: tuple[bool, ...] = field(metadata=_STATIC)
    offset_free: bool = field(default=False, metadata=_STATIC)

    def readings(self, tool: Frame) -> jax.Array:
        apart = tool.origin - jnp.asarray(self.anchors)[:, self.group]
        return (jnp.sqrt(jnp.sum(apart**2, 0) + 1e-18) + self.constant - self.value)[None]

    @property
    def own(self) -> tuple[OwnNumber, ...]:
        names = [name for name, free in zip(self.names, self.free, strict=True) if free]
        unknowns = [OwnNumber(self.place_name(name), "m") for name in names for _ in range(3)]
        return tuple(unknowns + [OwnNumber("constant of the distances", "m")] * self.offset_free)

    def moved(self, numbers: Any) -> "Distance":
        numbers = jnp.asarray(numbers)
        free = np.flatnonzero(self.free)
        shift = numbers[: 3 * len(free)].reshape(-1, 3).T
        constant = self.constant + numbers[-1] if self.offset_free else self.constant
        return replace(self, anchors=jnp.asarray(self.anchors).at[:, free].add(shift), constant=constant)

    def shown(self, tool: Array) -> "Distance":
        anchors = np.array(self.anchors)
        for k, selected, p in self._of_each(self.free, tool):
            d = np.asarray(self.value)[selected]
            A = np.concatenate([2 * p, -np.ones((len(p), 1))], 1)  # 2 p·a − |a|² = |p|² − d²
            anchors[:, k] = np.linalg.lstsq(A, np.sum(p**2, 1) - d**2, rcond=1e-9)[0][:3]
        return replace(self, anchors=anchors)

    def place(self, k: int) -> dict[str, list[float]]:
        offset = {}
        if self.offset_free:
            offset = {"constant_m": np.asarray(self.constant).tolist()}
        return {"anchor_m": np.asarray(self.anchors)[:, k].tolist(), **offset}

    @classmethod
    def from_declaration(cls, declaration: Declaration) -> Self:
        declared = declaration.settings.anchor_m
        names = declaration.names
        anchors = {} if declared == "unknown" else declared
        if isinstance(declared, tuple):
            anchors = dict.fromkeys(names, declared)
        if isinstance(declared, tuple) and len(names) > 1:
            raise InputError(
                f"{declaration.source}: has anchors {', '.join(names)} and one place for all; write anchor_m as "
                f"{{{names[0]}: [x, y, z], ...}}, or unknown"
            )
        points, free = declaration.places(anchors)
        offset_free = declaration.settings.distance_offset == "unknown"
        return cls(
            declaration.group, declaration.whitener, declaration.value, points, np.zeros(1), names, free, offset_free
        )

    @classmethod
    def to_point(cls, center: Any, noise: float, free: bool = False) -> Self:
        """Without samples, to one anchor `(3,)` m."""
        group = np.zeros(0, int)
        anchor = np.array(center, float)[:, None]
        return cls(group, np.full(2, 1 / noise), np.zeros(0), anchor, np.zeros(1), ("anchor",), (free,))

    @classmethod
    def plan(cls, rng: np.random.Generator, reach: float, places: int, noise: float) -> Self:
        *_, anchor = draw_points(rng, reach, (*_angles(places), _BEHIND))
        return cls.to_point(_BEYOND * anchor, noise, free=True)

    @classmethod
    def simulate(
        cls, rng: np.random.Generator, samples: int, reach: float, noise: float, declared: float
    ) -> Simulated[Self]:
        sensor = cls.to_point(_BEYOND * draw_point(rng, reach, _BEHIND), declared, free=True)
        return Simulated(sensor, None, noise * rng.standard_normal(samples))

    @property
    def at(self) -> Array:
        return np.asarray(self.anchors)

    @property
    def reads(self) -> str:
        return "distances to an anchor" if any(self.free) else "distances to a point"

    def to_dict(self) -> dict[str, Any]:
        if any(self.free):
            return super().to_dict()
        return Sensor.to_dict(self) | {"center": tuple(self.at[:, 0].tolist())}

    def exact(self, tool: Array) -> Self:
        group = self.nearest(tool)
        apart = np.linalg.norm(tool[:, :3, 3] - self.at.T[group], axis=1)
        return replace(self, group=group, value=apart + np.asarray(self.constant))

    def declared(self) -> dict[str, Any]:
        return {"distance_noise_m": self.position_noise}

    def record(self, tool: Array, error: Array) -> dict[str, Any]:
        return {"value": self.exact(tool).value + error}


@final
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Axis(PointSensor):
    """The tool's point is at heights along an axis: n · p + c − h.

    Attributes:
        value: h, `(sample,)` m.
        direction: n, `(3,)`, unit.
        constant: c, `(1,)` m.
        free: whether the direction is unknown.
        constant_free: whether the constant is.
    """

    rows = 1
    kind = "axis"
    source = "height_gauge"
    usual_noise = 2e-5
    usual_tool = (0.02, 0.0, 0.05)
    advice = "record heights at poses over the whole workspace"
    sampled = ("group", "value")
    value: Any
    direction: Any
    constant: Any
    free: bool = field(metadata=_STATIC)
    constant_free: bool = field(default=True, metadata=_STATIC)

    def readings(self, tool: Frame) -> jax.Array:
        return (jnp.sum(jnp.asarray(self.direction)[:, None] * tool.origin, 0) + self.constant - self.value)[None]

    @property
    def own(self) -> tuple[OwnNumber, ...]:
        constant = (OwnNumber("constant of the axis", "m"),) * self.constant_free
        return (*constant, *(OwnNumber("direction of the axis", "rad"),) * 2 * self.free)

    def moved(self, numbers: Any) -> "Axis":
        numbers = jnp.asarray(numbers)
        direction = jnp.asarray(self.direction)
        if self.free:
            turned = direction + tangents(direction) @ numbers[-2:]
            direction = turned / jnp.linalg.norm(turned)
        constant = self.constant + numbers[:1] if self.constant_free else self.constant
        return replace(self, constant=constant, direction=direction)

    def shown(self, tool: Array) -> "Axis":
        p = tool[:, :3, 3]
        direction = np.array(self.direction)
        value = np.asarray(self.value)
        if self.free:
            direction = np.linalg.lstsq(p - p.mean(0), value - value.mean(), rcond=1e-9)[0]
            direction = direction / max(float(np.linalg.norm(direction)), 1e-9)
        return replace(self, direction=direction, constant=np.array([np.median(value - p @ direction)]))

    def place(self, k: int) -> dict[str, list[float]]:
        return {"direction": np.asarray(self.direction).tolist(), "constant_m": np.asarray(self.constant).tolist()}

    @classmethod
    def from_declaration(cls, declaration: Declaration) -> Self:
        free = declaration.settings.axis == "unknown"
        direction = np.array((0.0, 0.0, 1.0) if free else declaration.settings.axis, float)
        direction = direction / np.linalg.norm(direction)
        return cls(declaration.group, declaration.whitener, declaration.value, direction, np.zeros(1), free)

    @classmethod
    def along(cls, direction: Any, noise: float, constant: float = 0.0, constant_free: bool = False) -> Self:
        """Without samples, along a known direction `(3,)` of any length."""
        unit = np.array(direction, float)
        length = np.linalg.norm(unit)
        if abs(length - 1) > 1e-15:  # so that to normalise twice changes nothing
            unit = unit / length
        group = np.zeros(0, int)
        return cls(group, np.full(2, 1 / noise), np.zeros(0), unit, np.array([constant]), False, constant_free)

    @classmethod
    def plan(cls, rng: np.random.Generator, reach: float, places: int, noise: float) -> Self:
        return replace(cls.along((0.0, 0.0, 1.0), noise, constant_free=True), free=True)

    @classmethod
    def simulate(
        cls, rng: np.random.Generator, samples: int, reach: float, noise: float, declared: float
    ) -> Simulated[Self]:
        sensor = cls.along((0.0, 0.0, 1.0), declared, _GAUGE_AT, constant_free=True)
        return Simulated(sensor, None, noise * rng.standard_normal(samples))

    @property
    def reads(self) -> str:
        return "heights along an axis" if self.constant_free else "positions along one axis"

    def exact(self, tool: Array) -> Self:
        value = tool[:, :3, 3] @ np.asarray(self.direction) + np.asarray(self.constant)
        return replace(self, group=self.nearest(tool), value=value)

    def to_dict(self) -> dict[str, Any]:
        return Sensor.to_dict(self) | {"direction": np.asarray(self.direction).tolist()}

    def declared(self) -> dict[str, Any]:
        return {"axis_noise_m": self.position_noise, "axis": np.asarray(self.direction).tolist()}

    def record(self, tool: Array, error: Array) -> dict[str, Any]:
        return {"value": self.exact(tool).value + error}


POINT_SENSORS: Mapping[Kind, type[PointSensor]] = {sensor.kind: sensor for sensor in (Contact, Plane, Distance, Axis)}
"""By their kind."""


def draw_point(rng: np.random.Generator, reach: float, angle: float) -> Array:
    """A point `(3,)` m within reach, in front of the arm at an angle about its base."""
    radius = reach * rng.uniform(0.45, 0.6)
    height = reach * rng.uniform(0.1, 0.4)
    return np.array([radius * np.cos(angle), radius * np.sin(angle), height])


def draw_points(rng: np.random.Generator, reach: float, angles: Sequence[float]) -> Array:
    """`draw_point` at each angle, `(place, 3)`."""
    return np.array([draw_point(rng, reach, angle) for angle in angles])


def _angles(places: int) -> Sequence[float]:
    """Angles about the base at which plates are planned."""
    return np.linspace(*_IN_FRONT, places).tolist() if places > 1 else [0.0]


def poses_at(points: Array) -> Array:
    """Poses `(sample, 4, 4)` at points `(sample, 3)`, not turned."""
    T = np.tile(np.eye(4), (len(points), 1, 1))
    T[:, :3, 3] = points
    return T


def _rods(declaration: Declaration, free: tuple[bool, ...]) -> tuple[Rod, ...]:
    """The known distances as a forest: each contact hangs on one before it.

    Raises:
        InputError: a ring of distances, or one between contacts of which both are known.
    """
    names = declaration.names
    place = {name: k for k, name in enumerate(names)}
    remaining = [
        distance for distance in declaration.settings.contact_distances if set(distance.between) <= place.keys()
    ]
    rods: list[Rod] = []
    reached = {k for k in range(len(names)) if not free[k]}
    while remaining:
        at = next(
            (distance for distance in remaining if {place[name] for name in distance.between} & reached), remaining[0]
        )
        remaining.remove(at)
        a, b = (place[name] for name in at.between)
        a, b = (b, a) if b in reached and a not in reached else (a, b)
        if b in reached:
            raise InputError(
                f"{declaration.source}: the distance of contacts {at.between[0]} and {at.between[1]} closes a ring of "
                "known ones; give the coordinates of all contacts as contact_points instead"
            )
        reached |= {a, b}
        rods.append(Rod(a, b, at.distance_m, at.noise_m))
    return tuple(rods)


def tangents(direction: Any) -> jax.Array:
    """Two unit vectors across a unit one, `(3, 2)`."""
    transverse = jnp.eye(3)[jnp.argmin(jnp.abs(direction))]
    first = jnp.cross(direction, transverse)
    first = first / jnp.linalg.norm(first)
    return jnp.stack([first, jnp.cross(direction, first)], 1)
