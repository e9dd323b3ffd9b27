"""What a sensor reads off the tool, with which noise, and how its reading changes as the tool moves."""

from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Literal, final

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from lite6jax.errors import InputError
from lite6jax.sensors.camera import Lens, Mounted, linearise_corners
from lite6jax.sensors.points import Plane, PointSensor
from lite6jax.sensors.sensor import OwnNumber

Array = NDArray[np.floating]
Quantity = Literal["position", "pose", "axis", "distance"]
Point = tuple[float, float, float]


class PlannedSensor(ABC):
    """A sensor for planning: what it reads, and with which noise; `lite6jax.sensors` has those of recordings.

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
        """What it is called in reports."""

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
class Sensor(PlannedSensor):
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
        turns = self.orientation_noise
        posed = self.quantity == "pose"
        length = float(np.linalg.norm(self.direction))
        for right, message in (
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
                raise InputError(message)
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
        noises = {"position_noise": position, "orientation_noise": orientation, "joint_noise": joint}
        return replace(self, **{name: value for name, value in noises.items() if value is not None})

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
@dataclass(frozen=True, eq=False)
class PlacedReading(PlannedSensor):
    """A reading that is no pose, with unknowns of its own: a sensor of `sensors.points` whose places are planned.

    A sample is of the place that the tool's point is nearest to.

    Attributes:
        reading: with one sample of each place, all of which are unknown; its own noise is not used.
        places: the name and the point, m in the base's frame: of a socket, in a plate, the anchor; one of an axis.
        position_noise: one standard deviation of what is read, m.
        joint_noise: as of `Sensor`.
    """

    reading: PointSensor
    places: tuple[tuple[str, Point], ...]
    position_noise: float
    joint_noise: float = 0.0

    @property
    def quantity(self) -> str:
        """`contact`, `plane`, `distance` or `axis`."""
        return type(self.reading).__name__.lower()

    @property
    def rows(self) -> int:
        return self.reading.rows

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
        names = [number.name for number in self.reading.own]
        return tuple(
            number._replace(name=f"{number.name} {names[:k].count(number.name) + 1}")
            if names.count(number.name) > 1
            else number
            for k, number in enumerate(self.reading.own)
        )

    def nearest(self, tool: Array) -> NDArray[np.integer]:
        """The place `(sample,)` of tools `(sample, 4, 4)`."""
        apart = tool[:, None, :3, 3] - np.array([at for _, at in self.places])
        if isinstance(self.reading, Plane):
            return np.argmin(np.abs(np.sum(apart * self.reading.normal.T, 2)), 1)
        return np.argmin(np.sum(apart**2, 2), 1)

    def slopes(self, tool: Array) -> Array:
        return self.reading.select(self.nearest(tool)).slopes(tool) / self.position_noise

    def by_own(self, tool: Array) -> Array:
        return self.reading.select(self.nearest(tool)).by_numbers(tool) / self.position_noise

    def to_dict(self) -> dict[str, Any]:
        noise = {"position_noise": self.position_noise, "joint_noise": self.joint_noise}
        return {"quantity": self.quantity, **noise, "places": dict(self.places)}


@final
@dataclass(frozen=True)
class BoardView(PlannedSensor):
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
        lens = Lens(np.array(self.lens[:4]), np.array(self.lens[4:]))
        corners = np.array(self.corners)
        R = tool[:, :3, :3]
        p = tool[:, None, :3, 3]
        fixed = self.mounted == "fixed"
        depth = (corners @ np.swapaxes(R, 1, 2) + p if fixed else (corners - p) @ R)[..., 2]
        # residuals of pixels at zero are the pixels
        at, J = map(np.asarray, linearise_corners(self.mounted, lens, corners, np.zeros((*depth.shape, 2)), tool))
        visible = (depth > 0) & ((at > 0) & (at < 2 * lens.pinhole[2:])).all(2)
        J = np.where(visible[..., None, None], J / self.pixel_noise, 0.0).reshape(len(tool), -1, 6)
        U = np.asarray(jnp.linalg.cholesky(np.swapaxes(J, 1, 2) @ J, upper=True))
        U = np.where(np.isfinite(U).all((1, 2), keepdims=True), U, 0.0)
        return np.moveaxis(np.concatenate([U[..., :3], U[..., 3:] @ np.swapaxes(R, 1, 2)], 2), 0, -1)

    def to_dict(self) -> dict[str, Any]:
        return asdict(self) | {"quantity": self.quantity}


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
telescoping ball bar of 1 µm. Orders of magnitude to plan with: pass your own figures."""


def sensor_named(name: str) -> Sensor:
    """One of `SENSORS`.

    Raises:
        InputError: another name.
    """
    if name not in SENSORS:
        raise InputError(f"sensor {name!r}: is none of {', '.join(SENSORS)}")
    return SENSORS[name]
