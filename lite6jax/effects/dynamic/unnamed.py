"""Torques without a name: at one joint, a Gaussian process of one driver or of two."""

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from lite6jax.effects.dynamic.torque_effect import Array, Dynamics, JointTorque
from lite6jax.effects.effect import Coordinate
from lite6jax.effects.nonparametric import Process, require_process


@final
@dataclass(frozen=True)
class UnnamedTorque(Process, JointTorque):
    """τ += Σ coefficient · φ(drivers): a Gaussian process of one driver or of two.

    Friction that no name describes is a product with the direction of motion, such as "smooth*line" of "speed of
    joint 2 and direction of motion of joint 2".

    Attributes:
        driver, lower, upper, kernel, further, spread, rolloff: as of `Process`; spread in Nm, or N.

    Raises:
        InputError: no such driver or kernel, or an empty range.
    """

    driver: str
    lower: float
    upper: float
    kernel: str = "smooth"
    further: tuple[float, ...] = ()
    spread: float | None = None
    rolloff: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        require_process(self.label, self.driver, self.kernel, self.bounds, self.rolloff)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coefficients."""
        return self._coordinates

    @cached_property
    def _coordinates(self) -> tuple[Coordinate, ...]:
        deviation = np.inf if self.spread is None else self.spread
        return tuple(self.number(f"coefficient{k + 1}_Nm", "Nm", 0.1, deviation) for k in range(self.functions))

    @property
    def is_friction(self) -> bool:
        """Whether it depends on the motion of its own joint alone, as friction does."""
        own = [self.own_driver(quantity) for quantity in ("velocity", "speed", "direction of motion")]
        return set(self.drivers) <= set(own)

    def values_in(self, dynamics: Dynamics) -> Array:
        """The values of the drivers, `(driver, sample)`."""
        loads = dynamics.loads if any(driver.loaded for driver in self.drivers) else None
        return np.stack([np.asarray(driver.values(dynamics.motion, loads)) for driver in self.drivers])

    def functions_of(self, dynamics: Dynamics) -> Array:
        """The functions that coefficients multiply, `(function, sample)`."""
        return np.asarray(self.functions_at(self.values_in(dynamics), dynamics.motion.run))  # type: ignore[arg-type]

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        return values @ self.functions_of(dynamics)
