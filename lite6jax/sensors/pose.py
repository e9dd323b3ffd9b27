"""Poses and points in a sensor's frame, as trackers and cameras measure them.

Their slopes are written out, not differentiated: a recording has up to a million of them, and the screening compiles
nothing.
"""

from dataclasses import dataclass, field, replace
from typing import Any, Self, final

import jax
import jax.numpy as jnp
import numpy as np
import scipy  # whose parts are imported where they are first used: `spatial` takes half a second

from lite6jax.arms.se3 import Frame, rotation_exp, rotation_log_components, transform
from lite6jax.array_types import Array
from lite6jax.sensors.sensor import OwnNumber, Sensor


@dataclass(frozen=True, eq=False)
class PoseReading(Sensor):
    """Poses or points of the tool in the sensor's frame, the sample last.

    Attributes:
        position: `(3, sample)` m.
        rotation: `(3, 3, sample)`; `(3, 3, 0)` where no orientation was measured.
        whitener: `(2,)` or `(row, row, sample)`, as in `Observations`.
        constants: `(number, row, sample)`, how poses move with constant errors of what measured them, as of a board.
        at: `(number,)`, where these are.
        mean: `(number,)`, of their prior.
        deviation: `(number,)`, one sigma of it.
        station: `(sample,)` int, from which station each was measured; empty of one alone.
        stations: `(station - 1, 4, 4)`, from the frame of each further station to that of the first. They are unknowns,
            six numbers each: a shift and a rotation vector by which its poses are displaced in the first one's frame.
        oriented: whether it measures orientations, of a sensor without samples.
    """

    sampled = ("position", "rotation", "constants", "station")
    position: Any
    rotation: Any
    whitener: Any
    constants: Any = field(default_factory=lambda: np.zeros((0, 0, 0)))
    at: Any = field(default_factory=lambda: np.zeros(0))
    mean: Any = field(default_factory=lambda: np.zeros(0))
    deviation: Any = field(default_factory=lambda: np.zeros(0))
    station: Any = field(default_factory=lambda: np.zeros(0, np.int64))
    stations: Any = field(default_factory=lambda: np.zeros((0, 4, 4)))
    oriented: bool = field(default=False, kw_only=True, metadata={"static": True})
    joint_noise: float = field(default=0.0, kw_only=True, metadata={"static": True})

    @property
    def rows(self) -> int:  # type: ignore[override]
        """Numbers that a sample has: 3 or 6."""
        return 6 if self.oriented or self.rotation.shape[-1] else 3

    @property
    def own(self) -> tuple[OwnNumber, ...]:
        """Its unknowns: the constant errors, and then the frames of further stations."""
        spread = np.asarray(self.deviation) ** -2.0
        off = np.asarray(self.at) - np.asarray(self.mean)
        constant = (OwnNumber("camera and board", "", *map(float, prior)) for prior in zip(spread, off, strict=True))
        frames = (
            OwnNumber(f"frame of station {k + 2}", unit) for k in range(len(self.stations)) for unit in _UNITS_OF_TWIST
        )
        return (*constant, *frames)

    @property
    def numbers(self) -> int:
        """How many unknowns it has."""
        return len(self.at) + 6 * len(self.stations)

    def moved(self, numbers: Any) -> Self:
        """With its unknowns displaced by `numbers`."""
        twists = numbers[len(self.at) :].reshape(-1, 6)
        return self._displaced(numbers, transform(rotation_exp(twists[:, 3:]), twists[:, :3]))

    def displaced(self, numbers: Array) -> Self:
        """`moved`; nothing is compiled."""
        twists = numbers[len(self.at) :].reshape(-1, 6)
        T = np.tile(np.eye(4), (len(twists), 1, 1))
        T[:, :3, :3] = scipy.spatial.transform.Rotation.from_rotvec(twists[:, 3:]).as_matrix()
        T[:, :3, 3] = twists[:, :3]
        return self._displaced(numbers, T)

    def _displaced(self, numbers: Any, frames: Any) -> Self:
        """With the constant errors changed by the first of `numbers`, and the stations displaced by `frames`."""
        constant = len(self.at)
        moved = replace(self, at=self.at + numbers[:constant]) if constant else self
        if len(self.stations):
            return replace(moved, stations=frames @ self.stations)
        return moved

    def in_first_frame(self) -> tuple[Any, Any]:
        """Position and rotation of every sample in the first station's frame."""
        if not len(self.stations):
            return self.position, self.rotation
        xp = self.position.__array_namespace__()
        T = xp.concat([xp.eye(4)[None], self.stations])[self.station]
        position = xp.einsum("sab,bs->as", T[:, :3, :3], self.position) + T[:, :3, 3].T
        if not self.rotation.shape[-1]:
            return position, self.rotation
        return position, xp.einsum("sab,bcs->acs", T[:, :3, :3], self.rotation)

    def readings(self, tool: Frame) -> jax.Array:
        """`differences` from what was measured, with the constant errors."""
        apart = differences(*self.in_first_frame(), tool)
        if len(self.at):
            return apart + jnp.tensordot(self.at, self.constants, 1)
        return apart

    def differences(self, tool: Array) -> Array:
        """`readings` of predicted tools `(sample, 4, 4)`."""
        position, rotation = self.in_first_frame()
        apart = tool[:, :3, 3].T - position
        if self.rows == 6:
            turned = _rotation_vector(np.einsum("abs,sac->bcs", rotation, tool[:, :3, :3]))
            apart = np.concatenate([apart, turned])
        if len(self.at):
            return apart + np.tensordot(self.at, self.constants, 1)
        return apart

    def columns(self, tool: Array, shift: Array, turn: Array | None = None) -> Array:
        """How differences `(…, row, sample)` change with shifts and turns `(…, 3, sample)` of tools, in sensor axes."""
        if self.rows == 3:
            return shift
        if turn is None:
            return np.concatenate([shift, np.zeros_like(shift)], -2)
        rotation = self.in_first_frame()[1] if len(self.stations) else self.rotation
        in_tool = np.einsum("abs,...as->...bs", rotation, turn)
        apart = _rotation_vector(np.einsum("abs,sac->bcs", rotation, tool[:, :3, :3]))
        return np.concatenate([shift, left_jacobian_inverse(apart, in_tool)], -2)

    def by_numbers(self, tool: Array) -> Array:
        """How differences change with its unknowns, `(number, row, sample)`."""
        constant = np.asarray(self.constants) if len(self.at) else np.zeros((0, self.rows, len(tool)))
        if not len(self.stations):
            return constant
        position = np.asarray(self.in_first_frame()[0])
        none = np.zeros((3, 3, len(tool)))
        axes = np.broadcast_to(np.eye(3)[..., None], none.shape)
        lever = np.cross(axes, position[None], axis=1)
        # a displaced measurement is a prediction that is displaced the other way
        twists = -self.columns(tool, np.concatenate([axes, lever]), np.concatenate([none, axes]))
        further = np.arange(1, len(self.stations) + 1)
        frames = np.where(self.station == further[:, None, None, None], twists, 0.0)
        return np.concatenate([constant, frames.reshape(-1, self.rows, len(tool))])

    def slopes(self, tool: Array) -> Array:
        """How differences `(row, 6, sample)` change with a shift and a turn of the tool; nothing is compiled."""
        none = np.zeros((3, 3, len(tool)))
        axes = np.broadcast_to(np.eye(3)[..., None], none.shape)
        return np.swapaxes(self.columns(tool, np.concatenate([axes, none]), np.concatenate([none, axes])), 0, 1)

    def exact(self, tool: Array) -> Self:
        rotation = np.moveaxis(tool[:, :3, :3], 0, -1) if self.rows == 6 else np.zeros((3, 3, 0))
        alone = replace(self, station=np.zeros(0, np.int64), stations=np.zeros((0, 4, 4)))  # one that was not moved
        return replace(alone, position=tool[:, :3, 3].T, rotation=rotation)


@final
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PoseSensor(PoseReading):
    """A laser tracker, motion capture, or another sensor of positions or poses with the same noise everywhere.

    Attributes:
        source: `pose_source` of its recordings.
    """

    source: str = field(default="unknown", kw_only=True, metadata={"static": True})

    @property
    def reads_poses(self) -> bool:
        return True

    @property
    def quantity(self) -> str:
        return "pose" if self.rows == 6 else "position"

    @property
    def orientation_noise(self) -> float | None:
        """One standard deviation of a turn, per axis, rad; None where no orientation is measured."""
        return float(f"{1 / self.whitener[1]:.15g}") if self.rows == 6 else None

    @property
    def phrase(self) -> str:
        sigma = f"±{1e3 * self.position_noise:.3g} mm"
        if self.orientation_noise is None:
            return f"positions to {sigma} per axis"
        return f"positions and orientations to {sigma} and {np.rad2deg(self.orientation_noise):.2g} deg per axis"

    def to_dict(self) -> dict[str, Any]:
        turns = {} if self.orientation_noise is None else {"orientation_noise": self.orientation_noise}
        return super().to_dict() | turns


_UNITS_OF_TWIST = ("m", "m", "m", "rad", "rad", "rad")


def differences(position: Any, rotation: Any, tool: Frame) -> jax.Array:
    """Predicted minus measured `(row, sample)`: m in sensor axes, and rotation vectors in the measured tool's axes."""
    shift = tool.origin - position
    if rotation.shape[-1] == 0:
        return shift
    R = rotation
    axes = tool[:3]
    relative = [
        [R[0, i] * axes[j][0] + R[1, i] * axes[j][1] + R[2, i] * axes[j][2] for j in range(3)] for i in range(3)
    ]
    return jnp.concatenate([shift, jnp.stack(rotation_log_components(relative))])


def _rotation_vector(R: Array) -> Array:
    """Rotation vectors `(3, sample)` of rotations `(3, 3, sample)`: the axis times the angle by its sine and cosine.

    Near half a turn, where the sine says nothing of the axis, they are SciPy's.
    """
    sines = 0.5 * np.stack([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = np.linalg.norm(sines, axis=0)
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1)
    vector = sines * np.where(sine > 0, np.arctan2(sine, cosine) / np.maximum(sine, np.finfo(float).tiny), 1.0)
    half = cosine < -0.9
    if half.any():
        vector[:, half] = scipy.spatial.transform.Rotation.from_matrix(np.moveaxis(R[..., half], -1, 0)).as_rotvec().T
    return vector


def left_jacobian_inverse(vector: Any, rows: Any) -> Any:
    """J_l⁻¹(e) v = v − ½ e × v + γ e × (e × v) (T. Barfoot, State Estimation for Robotics, 7.80).

    Its transpose is that of −e. Array code of NumPy and of JAX alike.

    Args:
        vector: e, `(3, sample)` rad.
        rows: v, `(…, 3, sample)`.
    """
    xp = vector.__array_namespace__()
    angle2 = xp.sum(vector**2, 0)
    small = angle2 < 1e-4
    safe = xp.where(small, 1.0, angle2)
    angle = xp.sqrt(safe)
    exact = 1 / safe - (1 + xp.cos(angle)) / (2 * angle * xp.sin(angle))
    gamma = xp.where(small, 1 / 12 + angle2 / 720 + angle2**2 / 30240, exact)
    once = xp.cross(vector, rows, axis=-2)
    return rows - 0.5 * once + gamma * xp.cross(vector, once, axis=-2)
