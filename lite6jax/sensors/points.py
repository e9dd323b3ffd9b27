"""Sensors that read where one point of the tool is: in a socket, on a plane, from an anchor, along an axis."""

from abc import abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Self, final

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.se3 import Frame
from lite6jax.sensors.sensor import OwnNumber, SensorModel

Array = NDArray[np.floating]

_STATIC = {"static": True}
"""Of fields that are no arrays."""


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


@dataclass(frozen=True, eq=False)
class PointSensor(SensorModel):
    """A sensor of the tool's point, at places of which some are unknown.

    Attributes:
        group: `(sample,)` int, which point, plane or anchor a sample is of; zero of an axis.
        names: of each of these.
        scaled: whether something in it has a known length, without which a chain of any size would fit.
    """

    sampled = ("group",)
    names = ("axis",)
    scaled = True
    group: Any
    whitener: Any

    @abstractmethod
    def shown(self, tool: Array) -> Self:
        """The sensor with its unknowns as a tool `(sample, 4, 4)` shows them in closed form."""

    @abstractmethod
    def place(self, k: int) -> dict[str, list[float]]:
        """What of the point, plane or anchor `k` is known or was estimated, by name with its unit."""

    def _of_each(self, free: tuple[bool, ...], tool: Array) -> list[tuple[int, NDArray[np.bool_], Array]]:
        """Of each place that is unknown its number, its samples, and there the tool's point `(sample, 3)`."""
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
        unknowns = [OwnNumber(f"anchor {name}", "m") for name in names for _ in range(3)]
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
    """

    rows = 1
    sampled = ("group", "value")
    value: Any
    direction: Any
    constant: Any
    free: bool = field(metadata=_STATIC)

    def readings(self, tool: Frame) -> jax.Array:
        return (jnp.sum(jnp.asarray(self.direction)[:, None] * tool.origin, 0) + self.constant - self.value)[None]

    @property
    def own(self) -> tuple[OwnNumber, ...]:
        return (OwnNumber("constant of the axis", "m"), *(OwnNumber("direction of the axis", "rad"),) * 2 * self.free)

    def moved(self, numbers: Any) -> "Axis":
        numbers = jnp.asarray(numbers)
        direction = jnp.asarray(self.direction)
        if self.free:
            turned = direction + tangents(direction) @ numbers[1:3]
            direction = turned / jnp.linalg.norm(turned)
        return replace(self, constant=self.constant + numbers[:1], direction=direction)

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


def tangents(direction: Any) -> jax.Array:
    """Two unit vectors across a unit one, `(3, 2)`."""
    transverse = jnp.eye(3)[jnp.argmin(jnp.abs(direction))]
    first = jnp.cross(direction, transverse)
    first = first / jnp.linalg.norm(first)
    return jnp.stack([first, jnp.cross(direction, first)], 1)
