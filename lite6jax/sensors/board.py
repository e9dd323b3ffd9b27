"""A camera that sees a board: the pose of the one in the other, with the covariance of its corners.

A recording's images become poses by `lite6jax.sensors.camera`, and those are of a `PoseSensor`. What is here plans and
simulates them.
"""

from abc import ABC
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self, final

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from lite6jax.array_types import Array
from lite6jax.errors import InputError
from lite6jax.sensors.camera import Lens, Mounted, linearise_corners, project
from lite6jax.sensors.kinds import Kind
from lite6jax.sensors.points import Simulated, draw_point
from lite6jax.sensors.pose import PoseReading
from lite6jax.sensors.sensor import Point

BOARD = {"columns": 7, "rows": 5, "square_m": 0.02, "noise_m": 2e-5}
"""The usual board, as in a sidecar."""
PINHOLE = (1450.0, 1452.0, 958.0, 603.0)
"""fx, fy, cx, cy of the usual camera, px."""
DISTORTION = (-0.11, 0.09, 4e-4, -3e-4, -0.02)
PICTURE = (1920.0, 1200.0)
"""px, its width and height."""
_TILT = 0.6
"""rad, by which a board is turned from facing the camera."""


def board_corners() -> Array:
    """The corners `(corner, 3)` m of the usual board, in its frame."""
    k = np.arange(int(BOARD["columns"] * BOARD["rows"]))
    across = k % BOARD["columns"]
    down = k // BOARD["columns"]
    return np.stack([across * BOARD["square_m"], down * BOARD["square_m"], 0.0 * k], 1)


@dataclass(frozen=True, eq=False)
class Camera(PoseReading, ABC):
    """The board's pose in the camera, or the camera's in the board; of positions and orientations, without samples.

    Attributes:
        pixel_noise: one standard deviation of a corner's pixel, px.
        corners: `(corner, 3)` m in the board's frame.
        stands: `(4, 4)`, where what stands is in the arm's base frame.
        mounted: `fixed`, of the board on the flange in the camera's frame; `on_flange`, of the camera in the board's.
    """

    kind: ClassVar[Kind] = "camera"
    source: ClassVar[str] = "camera"
    usual_noise: ClassVar[float] = 0.15
    usual_places: ClassVar[int] = 1
    advice: ClassVar[str] = "take images at wrist orientations that differ by 30 degrees and more, about two axes"
    mounted: ClassVar[Mounted]
    usual_tool: ClassVar[Point]
    pixel_noise: Any = field(default=0.15, kw_only=True)
    corners: Any = field(default_factory=board_corners, kw_only=True)
    stands: Any = field(default_factory=lambda: np.eye(4), kw_only=True)

    @classmethod
    def _usual(cls, noise: float, stands: Array) -> Self:
        none = np.zeros((3, 0)), np.zeros((3, 3, 0)), np.ones(2)
        return cls(*none, oriented=True, pixel_noise=noise, stands=stands)

    @classmethod
    def plan(cls, rng: np.random.Generator, reach: float, places: int, noise: float) -> Self:
        """The usual camera and board, one of which stands somewhere about an arm of a reach, m; noise in px."""
        return cls._usual(noise, cls._draw_views(rng, 1, reach)[1])

    @classmethod
    def simulate(
        cls, rng: np.random.Generator, samples: int, reach: float, noise: float, declared: float
    ) -> Simulated[Self]:
        """As `PointSensor.simulate`, of noise in px; the board is not printed exactly."""
        corners = board_corners()
        printed = corners + BOARD["noise_m"] * rng.standard_normal(corners.shape)
        views, stands = cls._draw_views(rng, samples, reach)
        target = stands @ (views if cls.mounted == "fixed" else np.linalg.inv(views))
        error = noise * rng.standard_normal((samples, len(corners), 2))
        return Simulated(replace(cls._usual(declared, stands), corners=printed), target, error)

    @classmethod
    def _draw_views(cls, rng: np.random.Generator, samples: int, reach: float) -> tuple[Array, Array]:
        """Poses of a board in sight of a camera `(sample, 4, 4)`, and where what stands is in the arm's base."""
        fixed = cls.mounted == "fixed"
        middle = board_corners().mean(0)
        facing = np.diag([1.0, -1.0, -1.0])  # the board's z towards the camera
        turn = Rotation.from_rotvec(_TILT * rng.uniform(-1, 1, (samples, 3)) * [1, 1, 2]).as_matrix()
        wide = 0.3 * reach if fixed else 0.1
        far = (0.9 if fixed else 0.35) + wide * rng.uniform(-1, 1, samples)
        board_poses = np.tile(np.eye(4), (samples, 1, 1))
        board_poses[:, :3, :3] = facing @ turn
        aside = wide * rng.uniform(-1, 1, (samples, 2))
        board_poses[:, :3, 3] = np.concatenate([aside, far[:, None]], 1) - board_poses[:, :3, :3] @ middle
        centre = draw_point(rng, reach, 0.0)
        stands = np.eye(4)
        if fixed:  # looks along −x at the arm
            stands[:3, :3] = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
            stands[:3, 3] = centre + np.array([0.9, 0.0, 0.0])
        else:  # the board lies on the table, its z upwards
            stands[:3, 3] = centre * [1, 1, 0.2] - middle
        return board_poses, stands

    def targets(self, rng: np.random.Generator, count: int, reach: float) -> Array:
        """Poses in sight, in the sensor's frame."""
        views = self._draw_views(rng, count, reach)[0]
        return views if self.mounted == "fixed" else np.linalg.inv(views)

    @property
    def lens(self) -> Lens:
        """The lens of the usual camera."""
        return Lens(np.array(PINHOLE), np.array(DISTORTION))

    @property
    def quantity(self) -> str:
        return "images"

    @property
    def phrase(self) -> str:
        where = "on the flange" if self.mounted == "on_flange" else "that stands"
        return f"images by a camera {where}, corners to ±{self.pixel_noise:.3g} px"

    def to_dict(self) -> dict[str, Any]:
        return {
            "quantity": self.quantity,
            "mounted": self.mounted,
            "pixel_noise": self.pixel_noise,
            "lens": (*PINHOLE, *DISTORTION),
            "corners": tuple(map(tuple, np.asarray(self.corners).tolist())),
            "joint_noise": self.joint_noise,
        }

    def declared(self) -> dict[str, Any]:
        """Its keys of a sidecar, as one is written; the board's are those of its drawing."""
        pinhole = dict(zip(("fx", "fy", "cx", "cy"), PINHOLE, strict=True))
        picture = dict(zip(("width", "height"), PICTURE, strict=True))
        camera = {"mounted": self.mounted, **pinhole, "distortion": DISTORTION, **picture}
        return {"pixel_noise_px": self.pixel_noise, "camera": camera, "board": BOARD}

    def with_noise(
        self, position: float | None = None, orientation: float | None = None, joint: float | None = None
    ) -> Self:
        if position is not None or orientation is not None:
            raise InputError("position and orientation noise: a camera has that of its corners in pixels; leave it out")
        return super().with_noise(joint=joint)

    def record(self, tool: Array, error: Array) -> dict[str, Any]:
        """The `pixels` `(sample, corner, 2)` of tools `(sample, 4, 4)` in the arm's base, NaN where none is seen."""
        in_camera = np.linalg.inv(self.stands) @ tool
        if self.mounted == "on_flange":
            in_camera = np.linalg.inv(tool) @ self.stands
        points = self.corners @ np.swapaxes(in_camera[:, :3, :3], 1, 2) + in_camera[:, None, :3, 3]
        pixels = np.asarray(project(self.lens, jnp.asarray(points))) + error
        inside = (pixels > 0).all(2) & (pixels < PICTURE).all(2)
        pixels[~inside | (points[..., 2] <= 0)] = np.nan
        return {"pixels": pixels}

    def exact(self, tool: Array) -> Self:
        """The sensor with a sample for each tool, and the whitener that the corners in sight give it.

        With J the slopes of their pixels, over their noise, and JᵀJ = UᵀU, the whitener is U. A corner behind the
        camera or outside the picture, whose middle is the principal point, is not seen. Where too few are, it is zero.
        """
        R = tool[:, :3, :3]
        p = tool[:, None, :3, 3]
        fixed = self.mounted == "fixed"
        depth = (self.corners @ np.swapaxes(R, 1, 2) + p if fixed else (self.corners - p) @ R)[..., 2]
        # residuals of pixels at zero are the pixels
        none = np.zeros((*depth.shape, 2))
        still = np.zeros((len(tool), 6))
        at, J = map(np.asarray, linearise_corners(self.mounted, self.lens, self.corners, none, tool, still))
        visible = (depth > 0) & ((at > 0) & (at < 2 * self.lens.pinhole[2:])).all(2)
        J = np.where(visible[..., None, None], J / self.pixel_noise, 0.0).reshape(len(tool), -1, 6)
        U = np.asarray(jnp.linalg.cholesky(np.swapaxes(J, 1, 2) @ J, upper=True))
        U = np.where(np.isfinite(U).all((1, 2), keepdims=True), U, 0.0)
        return replace(super().exact(tool), whitener=np.moveaxis(U, 0, -1))


@final
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class FixedCamera(Camera):
    """A camera that stands, and a board on the flange."""

    mounted = "fixed"
    usual_tool = (0.02, 0.0, 0.03)


@final
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class FlangeCamera(Camera):
    """A camera on the flange, and a board that lies."""

    mounted = "on_flange"
    usual_tool = (0.04, 0.0, 0.03)
