"""What every sensor is: a function of the tool's pose with unknowns of its own, differentiated automatically."""

from abc import ABC, abstractmethod
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.se3 import Frame, cross

Array = NDArray[np.floating]


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


class SensorModel(ABC):
    """A sensor that reads a function of the tool's pose; a pytree, whose last array axis is the sample.

    What derives from it is a frozen dataclass.

    Attributes:
        rows: numbers that a sample has.
        sampled: names of the fields whose last axis is the sample; empty arrays are none.
        whitener: `(2,)` of one over the noise of positions and orientations, or `(row, row, sample)`.
    """

    rows: int
    sampled: ClassVar[tuple[str, ...]]
    whitener: Any

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
        samples = {name: part for name in self.sampled if (part := getattr(self, name)).shape[-1]}
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
def _readings(sensor: SensorModel, tool: Frame) -> jax.Array:
    return sensor.readings(tool)


@jax.jit
def _moved(sensor: SensorModel, numbers: Any) -> SensorModel:
    return sensor.moved(numbers)


@jax.jit
def _slopes(sensor: SensorModel, tool: Frame) -> jax.Array:
    def at(twist: jax.Array) -> jax.Array:
        turn = twist[3:, None]
        axes = (axis + cross(jnp.broadcast_to(turn, axis.shape), axis) for axis in tool[:3])
        x, y, z = axes
        return sensor.readings(Frame(x, y, z, tool.origin + twist[:3, None]))

    return jnp.swapaxes(jax.jacfwd(at)(jnp.zeros(6)), 1, 2)


@partial(jax.jit, static_argnums=1)
def _by_numbers(sensor: SensorModel, count: int, tool: Frame) -> jax.Array:
    by = jax.jacfwd(lambda numbers: sensor.moved(numbers).readings(tool))(jnp.zeros(count))
    return jnp.moveaxis(by, -1, 0)
