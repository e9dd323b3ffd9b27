"""Sensors that read where one point of the tool is: in a socket, on a plane, from an anchor, along an axis."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.se3 import Frame
from lite6jax.sensors.sensor import OwnNumber, Sensor

Array = NDArray[np.floating]


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


@final
@partial(
    jax.tree_util.register_dataclass,
    data_fields=["group", "whitener", "points"],
    meta_fields=["names", "free", "rods"],
)
@dataclass(frozen=True, eq=False)
class Contact(Sensor):
    """The tool's point touches points: p − c.

    Attributes:
        points: `(3, contact)` m.
        names: of the contacts.
        free: for each, whether it is unknown.
        rods: the known distances, each after those that lead to its parent. A child's numbers are the length of its rod
            and two shifts across it, so that what is known of the distance is the prior of one number.
    """

    rows = 3
    group: Any
    whitener: Any
    points: Any
    names: tuple[str, ...]
    free: tuple[bool, ...]
    rods: tuple[Rod, ...] = ()

    def readings(self, tool: Frame) -> jax.Array:
        return tool.origin - jnp.asarray(self.points)[:, self.group]

    @property
    def own(self) -> tuple[OwnNumber, ...]:
        points = np.asarray(self.points)
        found: dict[int, tuple[OwnNumber, ...]] = {
            k: (OwnNumber(f"contact {name}", "m"),) * 3 for k, name in enumerate(self.names) if self.free[k]
        }
        for rod in self.rods:
            apart = float(np.linalg.norm(points[:, rod.child] - points[:, rod.parent]))
            name = f"contact {self.names[rod.child]}"
            length = OwnNumber(name, "m", rod.noise**-2.0, apart - rod.length)
            found[rod.child] = (length, OwnNumber(name, "m"), OwnNumber(name, "m"))
        return tuple(one for k in sorted(found) for one in found[k])

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

    def place(self, k: int) -> dict[str, list[float]]:
        return {"point_m": np.asarray(self.points)[:, k].tolist()}


@final
@partial(
    jax.tree_util.register_dataclass,
    data_fields=["group", "whitener", "normal", "centre", "height"],
    meta_fields=["names", "free"],
)
@dataclass(frozen=True, eq=False)
class Plane(Sensor):
    """The tool's point touches planes: n · (p − c) − h.

    Attributes:
        normal: `(3, plane)`, unit.
        centre: `(3, plane)` m, a fixed point near the touches, about which a plane is turned.
        height: `(plane,)` m, of the plane above that.
        names: of the planes.
        free: for each, whether it is unknown.
    """

    rows = 1
    group: Any
    whitener: Any
    normal: Any
    centre: Any
    height: Any
    names: tuple[str, ...]
    free: tuple[bool, ...]

    def readings(self, tool: Frame) -> jax.Array:
        normal, centre, height = (
            jnp.asarray(part)[..., self.group] for part in (self.normal, self.centre, self.height)
        )
        return (jnp.sum(normal * (tool.origin - centre), 0) - height)[None]

    @property
    def own(self) -> tuple[OwnNumber, ...]:
        names = [name for name, free in zip(self.names, self.free, strict=True) if free]
        kinds = (("normal of plane", "rad"), ("normal of plane", "rad"), ("height of plane", "m"))
        return tuple(OwnNumber(f"{what} {name}", unit) for name in names for what, unit in kinds)

    def moved(self, numbers: Any) -> "Plane":
        normal, height = jnp.asarray(self.normal), jnp.asarray(self.height)
        for k, step in zip(np.flatnonzero(self.free), jnp.asarray(numbers).reshape(-1, 3), strict=True):
            turned = normal[:, k] + tangents(normal[:, k]) @ step[:2]
            normal = normal.at[:, k].set(turned / jnp.linalg.norm(turned))
            height = height.at[k].add(step[2])
        return replace(self, normal=normal, height=height)

    def place(self, k: int) -> dict[str, list[float]]:
        normal = np.asarray(self.normal)[:, k]
        offset = float(normal @ np.asarray(self.centre)[:, k] + np.asarray(self.height)[k])
        return {"normal": normal.tolist(), "offset_m": [offset]}


@final
@partial(
    jax.tree_util.register_dataclass,
    data_fields=["group", "whitener", "value", "anchors", "constant"],
    meta_fields=["names", "free", "offset_free"],
)
@dataclass(frozen=True, eq=False)
class Distance(Sensor):
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
    group: Any
    whitener: Any
    value: Any
    anchors: Any
    constant: Any
    names: tuple[str, ...]
    free: tuple[bool, ...]
    offset_free: bool = False

    def readings(self, tool: Frame) -> jax.Array:
        apart = tool.origin - jnp.asarray(self.anchors)[:, self.group]
        return (jnp.sqrt(jnp.sum(apart**2, 0) + 1e-18) + self.constant - self.value)[None]

    @property
    def own(self) -> tuple[OwnNumber, ...]:
        names = [name for name, free in zip(self.names, self.free, strict=True) if free]
        found = [OwnNumber(f"anchor {name}", "m") for name in names for _ in range(3)]
        return tuple(found + [OwnNumber("constant of the distances", "m")] * self.offset_free)

    def moved(self, numbers: Any) -> "Distance":
        numbers, free = jnp.asarray(numbers), np.flatnonzero(self.free)
        shift = numbers[: 3 * len(free)].reshape(-1, 3).T
        constant = self.constant + numbers[-1] if self.offset_free else self.constant
        return replace(self, anchors=jnp.asarray(self.anchors).at[:, free].add(shift), constant=constant)

    def select(self, samples: Any) -> "Distance":
        return replace(super().select(samples), value=self.value[samples])

    def place(self, k: int) -> dict[str, list[float]]:
        offset = {"constant_m": np.asarray(self.constant).tolist()} if self.offset_free else {}
        return {"anchor_m": np.asarray(self.anchors)[:, k].tolist(), **offset}


@final
@partial(
    jax.tree_util.register_dataclass,
    data_fields=["group", "whitener", "value", "direction", "constant"],
    meta_fields=["free"],
)
@dataclass(frozen=True, eq=False)
class Axis(Sensor):
    """The tool's point is at heights along an axis: n · p + c − h.

    Attributes:
        value: h, `(sample,)` m.
        direction: n, `(3,)`, unit.
        constant: c, `(1,)` m.
        free: whether the direction is unknown.
    """

    rows = 1
    group: Any
    whitener: Any
    value: Any
    direction: Any
    constant: Any
    free: bool

    def readings(self, tool: Frame) -> jax.Array:
        return (jnp.sum(jnp.asarray(self.direction)[:, None] * tool.origin, 0) + self.constant - self.value)[None]

    @property
    def own(self) -> tuple[OwnNumber, ...]:
        return (OwnNumber("constant of the axis", "m"), *(OwnNumber("direction of the axis", "rad"),) * 2 * self.free)

    def moved(self, numbers: Any) -> "Axis":
        numbers, direction = jnp.asarray(numbers), jnp.asarray(self.direction)
        if self.free:
            turned = direction + tangents(direction) @ numbers[1:3]
            direction = turned / jnp.linalg.norm(turned)
        return replace(self, constant=self.constant + numbers[:1], direction=direction)

    def select(self, samples: Any) -> "Axis":
        return replace(super().select(samples), value=self.value[samples])

    @property
    def names(self) -> tuple[str, ...]:
        """Of what there is but one of."""
        return ("axis",)

    def place(self, k: int) -> dict[str, list[float]]:
        return {"direction": np.asarray(self.direction).tolist(), "constant_m": np.asarray(self.constant).tolist()}


def tangents(direction: Any) -> jax.Array:
    """Two unit vectors across a unit one, `(3, 2)`."""
    least = jnp.eye(3)[jnp.argmin(jnp.abs(direction))]
    first = jnp.cross(direction, least)
    first = first / jnp.linalg.norm(first)
    return jnp.stack([first, jnp.cross(direction, first)], 1)
