"""What a sensor reads off the tool, with which noise, and how its reading changes as the tool moves."""

from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from typing import Any, Literal, final

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from lite6jax.errors import InputError
from lite6jax.sensors.camera import Lens, Mounted, seen_corners
from lite6jax.sensors.points import Axis, Contact, Distance, Plane, Rod
from lite6jax.sensors.sensor import OwnNumber
from lite6jax.sensors.sensor import Sensor as ReadingSensor

Array = NDArray[np.floating]
Quantity = Literal["position", "pose", "axis", "distance"]
Point = tuple[float, float, float]


class AnySensor(ABC):
    """What a plan reads with which noise.

    What derives from it has `rows`, how many numbers a reading has, a `phrase` that says it in words, and
    `joint_noise`, one standard deviation of each joint's read-out, rad; it reaches the reading through the arm.
    """

    quantity: Any
    rows: Any
    joint_noise: float

    @property
    def own(self) -> tuple[OwnNumber, ...]:
        """Its unknowns, each with a name of its own."""
        return ()

    @property
    @abstractmethod
    def phrase(self) -> str:
        """It in words."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """What it reads and how well, in SI units (px of a camera)."""

    @abstractmethod
    def slopes(self, tool: Array) -> Array:
        """How the whitened reading changes as tools `(sample, 4, 4)` in the sensor's coordinates shift and turn.

        Returns:
            `(row, 6, sample)`, standard deviations per m and rad; an orientation's as a rotation vector in the sensor's
            axes.
        """

    def by_own(self, tool: Array) -> Array:
        """How the whitened reading changes with its own unknowns, `(number, row, sample)`, per m or rad."""
        return np.zeros((0, self.rows, len(tool)))


@final
@dataclass(frozen=True)
class Sensor(AnySensor):
    """A sensor that stands still.

    Attributes:
        quantity: `position` (3 numbers), `pose` (6), the position along one `axis` (1: a dial gauge, an
            interferometer), or the `distance` to a point (1: a ball bar, a draw wire).
        position_noise: one standard deviation of a length, per axis, m.
        orientation_noise: one standard deviation of a turn, per axis, rad; of a pose only.
        direction: of the axis, a unit vector in the sensor's frame.
        center: the point that the distance is taken to, in the sensor's frame, m.
        joint_noise: one standard deviation of each joint's read-out, rad.

    Raises:
        InputError: noise that is not positive, no orientation noise for a pose, a direction of no length.
    """

    quantity: Quantity
    position_noise: float
    orientation_noise: float | None = None
    direction: Point = (0.0, 0.0, 1.0)
    center: Point = (0.0, 0.0, 0.0)
    joint_noise: float = 0.0

    def __post_init__(self) -> None:
        turns, posed, length = self.orientation_noise, self.quantity == "pose", float(np.linalg.norm(self.direction))
        for right, what in (
            (0 < self.position_noise < np.inf,
             f"position noise {self.position_noise}: give one standard deviation in m, above 0"),
            (not posed or (turns is not None and 0 < turns < np.inf),
             f"orientation noise {turns}: a sensor of poses needs one standard deviation in rad, above 0"),
            (posed or turns is None,
             f"orientation noise {turns}: a sensor of {self.quantity} measures no orientation; leave it out"),
            (0 <= self.joint_noise < np.inf,
             f"joint noise {self.joint_noise}: give one standard deviation in rad, not below 0"),
            (np.isfinite(self.center).all(), f"center {self.center}: give three finite numbers, in m"),
            (0 < length < np.inf, f"direction {self.direction}: give three numbers that are not all zero"),
        ):  # fmt: skip
            if not right:
                raise InputError(what)
        if abs(length - 1) > 1e-15:  # so that to normalise twice changes nothing
            object.__setattr__(self, "direction", tuple(float(c) / length for c in self.direction))

    @property
    def rows(self) -> int:
        return {"position": 3, "pose": 6, "axis": 1, "distance": 1}[self.quantity]

    @property
    def phrase(self) -> str:
        reads = {
            "position": "positions",
            "pose": "positions and orientations",
            "axis": "positions along one axis",
            "distance": "distances to a point",
        }[self.quantity]
        turns = f" and {np.rad2deg(self.orientation_noise):.2g} deg" if self.orientation_noise else ""
        return f"{reads} to ±{1e3 * self.position_noise:.3g} mm{turns}{' per axis' if self.rows > 1 else ''}"

    def with_noise(
        self, position: float | None = None, orientation: float | None = None, joint: float | None = None
    ) -> "Sensor":
        """The sensor with another noise (m, rad, rad); what is None stays."""
        given = {"position_noise": position, "orientation_noise": orientation, "joint_noise": joint}
        return replace(self, **{name: value for name, value in given.items() if value is not None})

    def to_dict(self) -> dict[str, Any]:
        concerns = {"direction": "axis", "center": "distance", "orientation_noise": "pose"}
        return {
            name: value for name, value in asdict(self).items() if concerns.get(name, self.quantity) == self.quantity
        }

    @property
    def noise(self) -> np.ndarray:
        """`(row,)` one standard deviation of each number, m or rad."""
        turns = [self.orientation_noise] * 3 if self.quantity == "pose" else []
        return np.array([self.position_noise] * (self.rows - len(turns)) + turns, float)

    def slopes(self, tool: Array) -> Array:
        if self.rows > 1:
            return np.repeat((np.eye(6)[: self.rows] / self.noise[:, None])[..., None], len(tool), 2)
        along = np.tile(self.direction, (len(tool), 1))
        if self.quantity == "distance":
            along = tool[:, :3, 3] - self.center
            along = along / np.linalg.norm(along, axis=1, keepdims=True)
        return np.concatenate([along, np.zeros_like(along)], 1).T[None] / self.position_noise


@final
@dataclass(frozen=True)
class PlacedReading(AnySensor):
    """A reading that is no pose, with unknowns of its own, as a `sensors.Sensor` of places that are planned.

    A sample is of the place that the tool's point is nearest to.

    Attributes:
        quantity: `contact`, `plane`, `distance` or `axis`, as in `sensors.points`.
        position_noise: one standard deviation of what is read, m.
        places: the name and the point, m in the base's frame: of a socket, in a plate, the anchor; one of an axis.
        normals: of each plate, or the axis.
        rods: of contacts whose distance is known, each with the one before it: its standard deviation, m.
        joint_noise: as of `Sensor`.
    """

    quantity: Literal["contact", "plane", "distance", "axis"]
    position_noise: float
    places: tuple[tuple[str, Point], ...]
    normals: tuple[Point, ...] = ()
    rods: tuple[tuple[int, float], ...] = ()
    joint_noise: float = 0.0

    @property
    def rows(self) -> int:
        return 3 if self.quantity == "contact" else 1

    @property
    def phrase(self) -> str:
        count = len(self.places)
        reads = {
            "contact": f"touches of {count} sockets",
            "plane": f"touches of {count} plates",
            "distance": "distances to an anchor",
            "axis": "heights along an axis",
        }[self.quantity]
        return f"{reads} to ±{1e3 * self.position_noise:.3g} mm, whose places are unknown"

    @cached_property
    def own(self) -> tuple[OwnNumber, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        found = self._at(np.zeros(1, int)).own
        names = [one.name for one in found]
        return tuple(
            one._replace(name=f"{one.name} {names[:k].count(one.name) + 1}") if names.count(one.name) > 1 else one
            for k, one in enumerate(found)
        )

    def nearest(self, tool: Array) -> NDArray[np.integer]:
        """The place `(sample,)` of tools `(sample, 4, 4)`."""
        apart = tool[:, None, :3, 3] - np.array([at for _, at in self.places])
        if self.quantity == "plane":
            return np.argmin(np.abs(np.sum(apart * np.array(self.normals), 2)), 1)
        return np.argmin(np.sum(apart**2, 2), 1)

    def _at(self, group: Any) -> ReadingSensor:
        """The sensor of samples at some places, all of which are unknown."""
        names, points = zip(*self.places, strict=True)
        places, free, unit = np.array(points).T, (True,) * len(names), np.full(2, 1 / self.position_noise)
        if self.quantity == "contact":
            rods = tuple(
                Rod(k - 1, k, float(np.linalg.norm(places[:, k] - places[:, k - 1])), std) for k, std in self.rods
            )
            return Contact(group, unit, places, names, free, rods)
        if self.quantity == "plane":
            return Plane(group, unit, np.array(self.normals).T, places, np.zeros(len(names)), names, free)
        value = np.zeros(len(group))
        if self.quantity == "distance":
            return Distance(group, unit, value, places, np.zeros(1), names, free)
        return Axis(group, unit, value, np.array(self.normals[0]), np.zeros(1), True)

    def slopes(self, tool: Array) -> Array:
        return self._at(self.nearest(tool)).slopes(tool) / self.position_noise

    def by_own(self, tool: Array) -> Array:
        return self._at(self.nearest(tool)).by_numbers(tool) / self.position_noise

    def to_dict(self) -> dict[str, Any]:
        return {"quantity": self.quantity, "position_noise": self.position_noise, "places": dict(self.places)}


@final
@dataclass(frozen=True)
class BoardView(AnySensor):
    """A camera that sees a board: the pose of the one in the other, with the covariance of its corners.

    Attributes:
        mounted: `fixed`, of the board on the flange in the camera's frame; `on_flange`, of the camera in the board's.
        pixel_noise: one standard deviation of a corner's pixel, px.
        lens: fx, fy, cx, cy, then k1, k2, p1, p2, k3.
        corners: m in the board's frame.
        joint_noise: as of `Sensor`.
    """

    mounted: Mounted
    pixel_noise: float
    lens: tuple[float, ...]
    corners: tuple[Point, ...]
    joint_noise: float = 0.0
    quantity = "images"
    rows = 6

    @property
    def phrase(self) -> str:
        where = "on the flange" if self.mounted == "on_flange" else "that stands"
        return f"images by a camera {where}, corners to ±{self.pixel_noise:.3g} px"

    def slopes(self, tool: Array) -> Array:
        """With J the slopes of the pixels that are seen, over their noise, and JᵀJ = UᵀU, it is U times the motion.

        A corner behind the camera or outside the picture, whose middle is the principal point, is not seen. Where too
        few are, it is zero.
        """
        lens, corners = Lens(np.array(self.lens[:4]), np.array(self.lens[4:])), np.array(self.corners)
        R, p = tool[:, :3, :3], tool[:, None, :3, 3]
        fixed = self.mounted == "fixed"
        depth = (corners @ np.swapaxes(R, 1, 2) + p if fixed else (corners - p) @ R)[..., 2]
        at, J = map(np.asarray, _corner_slopes(self.mounted, lens, corners, tool))
        seen = (depth > 0) & ((at > 0) & (at < 2 * lens.pinhole[2:])).all(2)
        J = np.where(seen[..., None, None], J / self.pixel_noise, 0.0).reshape(len(tool), -1, 6)
        U = np.asarray(jnp.linalg.cholesky(np.swapaxes(J, 1, 2) @ J, upper=True))
        U = np.where(np.isfinite(U).all((1, 2), keepdims=True), U, 0.0)
        return np.moveaxis(np.concatenate([U[..., :3], U[..., 3:] @ np.swapaxes(R, 1, 2)], 2), 0, -1)

    def to_dict(self) -> dict[str, Any]:
        return asdict(self) | {"quantity": self.quantity}


@partial(jax.jit, static_argnums=0)
def _corner_slopes(mounted: Mounted, lens: Lens, corners: Array, tool: Array) -> tuple[jax.Array, jax.Array]:
    """The pixels `(sample, corner, 2)` and their slopes `(sample, corner, 2, 6)`, turns in the moved axes."""

    def pixels(T: Any, twist: jax.Array) -> jax.Array:
        return seen_corners(mounted, lens, corners, T, twist)

    still = jnp.zeros(6)
    return jax.vmap(pixels, (0, None))(tool, still), jax.vmap(jax.jacfwd(pixels, 1), (0, None))(tool, still)


SENSORS = {
    "tracker": Sensor("position", 2e-5),
    "tracker_6d": Sensor("pose", 2e-5, 1e-4),
    "motion_capture": Sensor("pose", 2e-4, 1e-3),
    "camera": Sensor("pose", 5e-4, 2e-3),
    "dial_gauge": Sensor("axis", 5e-6),
    "ball_bar": Sensor("distance", 1e-6),
}
"""Sensors as they are usually declared, one standard deviation per axis: a laser tracker of 20 µm (with a 6-D target,
0.1 mrad), motion capture of 0.2 mm and 1 mrad, a camera on a target of 0.5 mm and 2 mrad, a dial gauge of 5 µm, a
telescoping ball bar of 1 µm. Orders of magnitude to plan with: pass the figures of your own."""


def sensor_named(name: str) -> Sensor:
    """One of `SENSORS`.

    Raises:
        InputError: another name.
    """
    if name not in SENSORS:
        raise InputError(f"sensor {name!r}: is none of {', '.join(SENSORS)}")
    return SENSORS[name]
