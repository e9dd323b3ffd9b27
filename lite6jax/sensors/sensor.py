"""What every sensor is: a function of the tool's pose with unknowns of its own, differentiated automatically.

Fits, plans, simulations and reports take a sensor by this one class. A sensor of a recording has its samples. One of a
plan has none: `exact` gives it a sample for each tool. One of a simulation is drawn with its samples.
"""

from abc import ABC, abstractmethod
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np

from lite6jax.arms.se3 import Frame, cross
from lite6jax.array_types import Array, Integers
from lite6jax.errors import InputError

Point = tuple[float, float, float]


class OwnNumber(NamedTuple):
    """An unknown of a sensor.

    Attributes:
        name: such as `contact a` or `normal of plate1`.
        unit: m or rad.
        precision: one over the variance of its prior; zero where nothing is known.
        offset: from the prior's mean to where it is.
    """

    name: str
    unit: str
    precision: float = 0.0
    offset: float = 0.0


def whiten(whitener: Any, rows: Any) -> Any:
    """Rows `(row, sample)` over the noise, by `(2,)` or `(row, row, sample)`."""
    if whitener.ndim == 1:
        return jnp.repeat(whitener, 3)[: rows.shape[0], None] * rows
    return jnp.sum(whitener * rows, 1)


def positive_noise(name: str, sigma: float, unit: str) -> float:
    """A standard deviation that is positive and finite.

    Raises:
        InputError: it is not.
    """
    if not 0 < sigma < np.inf:
        raise InputError(f"{name} {sigma}: give one standard deviation in {unit}, above 0")
    return sigma


class Sensor(ABC):
    """A sensor that reads a function of the tool's pose; a pytree, whose last array axis is the sample.

    What derives from it is a frozen dataclass.

    Attributes:
        rows: numbers that a sample has.
        sampled: names of the fields whose last axis is the sample; empty arrays are none.
        whitener: `(2,)` of one over the noise of positions and orientations, or `(row, row, sample)`.
        joint_noise: one standard deviation of each joint's read-out, rad, where it is planned for; it reaches the
            reading through the arm. The whitener of a recording has it already.
    """

    rows: int
    sampled: ClassVar[tuple[str, ...]]
    whitener: Any
    joint_noise: float = 0.0

    @abstractmethod
    def readings(self, tool: Frame) -> jax.Array:
        """Predicted minus measured readings `(row, sample)` m, where the tool is at `tool` in the base's frame."""

    @abstractmethod
    def moved(self, numbers: Any) -> Self:
        """The sensor with its own unknowns moved by `numbers`, in the order of `own`."""

    @property
    @abstractmethod
    def own(self) -> tuple[OwnNumber, ...]:
        """Its unknowns."""

    @abstractmethod
    def exact(self, tool: Array) -> Self:
        """The sensor with a sample for each tool `(sample, 4, 4)` in its frame, which reads this tool without error.

        A tool is read at the place that it is nearest to.
        """

    @property
    @abstractmethod
    def quantity(self) -> str:
        """What it reads, in a word."""

    @property
    @abstractmethod
    def phrase(self) -> str:
        """What it reads and how well, for reports."""

    @property
    def reads_poses(self) -> bool:
        """Tells whether it reads where the tool is, in a frame of its own; others read touches, distances or planes."""
        return False

    @property
    def position_noise(self) -> float:
        """One standard deviation of a length, m."""
        return float(f"{1 / self.whitener[0]:.15g}")  # as it was given, but for rounding

    def to_dict(self) -> dict[str, Any]:
        """What it reads and how well, in SI units (px of a camera)."""
        return {"quantity": self.quantity, "position_noise": self.position_noise, "joint_noise": self.joint_noise}

    def with_noise(
        self, position: float | None = None, orientation: float | None = None, joint: float | None = None
    ) -> Self:
        """The sensor with another noise (m, rad, rad); what is None stays.

        Raises:
            InputError: noise that is not positive, or of an orientation that is not measured.
        """
        whitener = np.array(self.whitener, float)
        if position is not None:
            whitener[0] = 1 / positive_noise("position noise", position, "m")
        if orientation is not None:
            if self.rows != 6:
                raise InputError(
                    f"orientation noise {orientation}: a sensor of {self.quantity} measures no orientation; leave it "
                    "out"
                )
            whitener[1] = 1 / positive_noise("orientation noise", orientation, "rad")
        if joint is not None and not 0 <= joint < np.inf:
            raise InputError(f"joint noise {joint}: give one standard deviation in rad, not below 0")
        return replace(self, whitener=whitener, joint_noise=self.joint_noise if joint is None else joint)  # type: ignore[type-var]

    # -------------------------------------------------------------- plans and simulations

    def nearest(self, tool: Array) -> Integers:
        """The place `(sample,)` that tools `(sample, 4, 4)` are nearest to; zero of what has but one."""
        return np.zeros(len(tool), int)

    def targets(self, rng: np.random.Generator, count: int, reach: float) -> Array | None:
        """Where the tool is to be, `(count, 4, 4)` in the sensor's frame, of each place as often.

        Only the positions count where the reading is of a point. None where the tool may be anywhere.
        """
        return None

    @property
    def touched(self) -> bool:
        """Tells whether being at a place is the reading, so that a plan knows it."""
        return False

    @property
    def turned(self) -> bool:
        """Tells whether the orientation of the tool matters at its targets."""
        return self.rows == 6

    def columns_of_plan(self, tool: Array) -> tuple[Array, Array]:
        """How whitened readings of tools `(sample, 4, 4)` change.

        Returns:
            `(row, 6, sample)` with a shift and a turn of the tool, standard deviations per m and rad, and
            `(number, row, sample)` with the sensor's own unknowns.
        """
        exact = self.exact(tool)
        by_numbers = np.moveaxis(exact.by_numbers(tool), 0, 1)
        return exact.over_noise(exact.slopes(tool)), np.moveaxis(exact.over_noise(by_numbers), 1, 0)

    def over_noise(self, changes: Array) -> Array:
        """Changes of readings `(row, number, sample)` over the noise."""
        whitener = np.asarray(self.whitener)
        if whitener.ndim == 1:
            return np.repeat(whitener, 3)[: len(changes), None, None] * changes
        return np.einsum("rcs,cks->rks", whitener, changes)

    @property
    def numbers(self) -> int:
        """How many unknowns it has."""
        return len(self.own)

    def residual(self, tool: Frame) -> jax.Array:
        """Readings over their noise, predicted minus measured, `(row, sample)`."""
        return whiten(self.whitener, self.readings(tool))

    def select(self, samples: Any) -> Self:
        """Some of the samples."""
        parts = {name: part[..., samples] for name, part in self._of_samples().items()}
        return replace(self, **parts)  # type: ignore[type-var]

    def reading_as(self, source: Self) -> Self:
        """The sensor with its unknowns where they are, and the samples of another of its kind."""
        return replace(self, **source._of_samples())  # type: ignore[type-var]

    def _of_samples(self) -> dict[str, Any]:
        values = vars(self)
        samples = {name: values[name] for name in self.sampled if values[name].shape[-1]}
        if self.whitener.ndim == 1:
            return samples
        return samples | {"whitener": self.whitener}

    # -------------------------------------------------------------- on the host

    def differences(self, tool: Array) -> Array:
        """`readings` of tools `(sample, 4, 4)`."""
        return np.asarray(_readings(self, host_frame(tool)))

    def displaced(self, numbers: Array) -> Self:
        """`moved`, compiled."""
        return jax.tree.map(np.asarray, _moved(self, numbers))

    def slopes(self, tool: Array) -> Array:
        """How readings `(row, 6, sample)` change with a shift and a turn of the tool, in the base's axes."""
        return np.asarray(_slopes(self, host_frame(tool)))

    def columns(self, tool: Array, shift: Array, turn: Array | None = None) -> Array:
        """How readings `(…, row, sample)` change with shifts and turns `(…, 3, sample)` of tools, in base axes."""
        S = self.slopes(tool)
        changes = np.einsum("ris,...is->...rs", S[:, :3], shift)
        return (
            changes if turn is None or not S[:, 3:].any() else changes + np.einsum("ris,...is->...rs", S[:, 3:], turn)
        )

    def by_numbers(self, tool: Array) -> Array:
        """How readings change with its own unknowns, `(number, row, sample)`."""
        if not self.numbers:
            return np.zeros((0, self.rows, len(tool)))
        return np.asarray(_by_numbers(self, self.numbers, host_frame(tool)))


def host_frame(tool: Array) -> Frame:
    """The frame of `(sample, 4, 4)`."""
    parts = np.moveaxis(tool[:, :3], 0, -1)
    return Frame(parts[:, 0], parts[:, 1], parts[:, 2], parts[:, 3])  # type: ignore[arg-type]


@jax.jit
def _readings(sensor: Sensor, tool: Frame) -> jax.Array:
    return sensor.readings(tool)


@jax.jit
def _moved(sensor: Sensor, numbers: Any) -> Sensor:
    return sensor.moved(numbers)


@jax.jit
def _slopes(sensor: Sensor, tool: Frame) -> jax.Array:
    def at(twist: jax.Array) -> jax.Array:
        turn = twist[3:, None]
        axes = (axis + cross(jnp.broadcast_to(turn, axis.shape), axis) for axis in tool[:3])
        x, y, z = axes
        return sensor.readings(Frame(x, y, z, tool.origin + twist[:3, None]))

    return jnp.swapaxes(jax.jacfwd(at)(jnp.zeros(6)), 1, 2)


@partial(jax.jit, static_argnums=1)
def _by_numbers(sensor: Sensor, count: int, tool: Frame) -> jax.Array:
    by = jax.jacfwd(lambda numbers: sensor.moved(numbers).readings(tool))(jnp.zeros(count))
    return jnp.moveaxis(by, -1, 0)
