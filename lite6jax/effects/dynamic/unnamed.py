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

    def functions_of(self, dynamics: Dynamics) -> Array:
        """The functions that coefficients multiply, `(function, sample)`."""
        loads = dynamics.loads if any(driver.loaded for driver in self.drivers) else None
        values = [np.asarray(driver.values(dynamics.motion, loads)) for driver in self.drivers]
        return np.asarray(self.functions_at(np.stack(values), dynamics.motion.run))  # type: ignore[arg-type]

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        return values @ self.functions_of(dynamics)
