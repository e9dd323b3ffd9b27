"""Torques without a name: at one joint, a function of one driver or of two, also times its direction or its load."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, final

import numpy as np

from lite6jax.effects.bases import spline_basis
from lite6jax.effects.drivers import Driver, driver_of, joint_driver
from lite6jax.effects.dynamic.torque_effect import Array, Dynamics, JointTorque
from lite6jax.effects.effect import Coordinate
from lite6jax.effects.polynomials import Products, polynomial_basis, products_of
from lite6jax.effects.waves import wave_angle
from lite6jax.errors import InputError


@final
@dataclass(frozen=True)
class UnnamedTorque(JointTorque):
    """τ += Σ coefficient · f(driver), or that times the direction of motion of the joint, or times its load.

    The functions f of a spline are its level, 1, and its steps: the sums of all cubic B-splines from the second, the
    third, … on, which rise from 0 to 1. A step that no sample determines is zero by its prior, so that the curve
    continues there as a constant, as friction does at speeds that were not measured. With `orders`, the functions are
    the sine and cosine of each order of the driver, an angle; with `degree`, products of one or several drivers.

    Attributes:
        driver: the phrase of a `Driver`; of several, joined by " and ".
        lower: of the first driver's range, in its unit; beyond it the curve is constant.
        upper: of the first driver's range.
        pieces: the intervals of the spline, which has a level and two steps more than intervals.
        signed: whether the curve is multiplied by the direction of motion, as friction is.
        orders: of the waves, that are there instead of a spline; per turn, or per metre of a prismatic joint.
        spread: one standard deviation in Nm of the coefficients, or of a spline's level and of the sum of all its
            steps: the size of the joint's torque.
        degree: of polynomials, that are there instead of a spline; 0 for none.
        further: lower and upper of each further driver.
        full_load: in Nm, or N of a prismatic joint; where it is not 0, the curve is multiplied by the joint's load over
            this, as the ripple of a gear that grows with its load is.

    Raises:
        InputError: no such driver, or an empty range.
    """

    driver: str
    lower: float
    upper: float
    pieces: int = 8
    signed: bool = False
    orders: tuple[float, ...] = ()
    spread: float | None = None
    degree: int = 0
    further: tuple[float, ...] = ()
    full_load: float = 0.0

    name: ClassVar[str] = "unnamed"
    nonparametric: ClassVar[bool] = True
    specificity: ClassVar[int] = 17

    def __post_init__(self) -> None:
        several = len(self.of) - 1
        if not self.lower < self.upper or self.pieces < 1:
            raise InputError(
                f"unnamed:{self.site}: {self.pieces} pieces from {self.lower:g} to {self.upper:g} are no curve; give "
                "lower < upper and at least one piece"
            )
        if len(self.further) != 2 * several or (several and not self.degree):
            raise InputError(
                f"unnamed:{self.site}: {several + 1} drivers and {len(self.further)} further bounds; give lower and "
                "upper of each driver but the first, and a degree"
            )
        if self.full_load < 0 or (self.full_load and self.signed):
            raise InputError(
                f"unnamed:{self.site}: full_load {self.full_load:g} is not possible; give a positive one, without "
                "signed"
            )
        if self.degree and self.orders:
            raise InputError(f"unnamed:{self.site}: a degree beside orders; give one of them")

    @cached_property
    def of(self) -> tuple[Driver, ...]:
        """What the curve runs over."""
        return tuple(driver_of(phrase) for phrase in self.driver.split(" and "))

    @property
    def drivers(self) -> tuple[Driver, ...]:
        """What the curve runs over, and the direction of motion or the load where that multiplies it."""
        if self.full_load:
            return (*self.of, self.own_driver("gravity torque"))
        return (*self.of, self.own_driver("direction of motion")) if self.signed else self.of

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coefficients."""
        if self.orders:
            names = [f"{wave}_{order:g}" for order in self.orders for wave in ("sine", "cosine")]
        elif self.degree:
            names = [f"coefficient{i + 1}" for i in range(self.functions)]
        else:
            names = ["level", *(f"step{i + 1}" for i in range(self.functions - 1))]
        spreads = np.full(len(names), np.inf if self.spread is None else self.spread)
        if not (self.orders or self.degree):
            spreads[1:] /= np.sqrt(len(names) - 1)
        return tuple(
            self.number(f"{name}_Nm", "Nm", 0.1, float(spread)) for name, spread in zip(names, spreads, strict=True)
        )

    @property
    def functions(self) -> int:
        """How many functions of the drivers there are."""
        if self.degree:
            return len(self.products)
        return 2 * len(self.orders) or self.pieces + 3

    @property
    def products(self) -> Products:
        """Of the drivers; the constant alone where there is no degree."""
        return products_of(self.of, self.degree)

    def basis(self, dynamics: Dynamics) -> Array:
        """The functions that coefficients multiply, `(function, sample)`."""
        loads = dynamics.loads if any(driver.loaded for driver in self.drivers) else None
        values = np.stack([np.asarray(driver.values(dynamics.motion, loads)) for driver in self.of])
        found = self.functions_of(values)
        if self.full_load:
            return found * np.asarray(self.drivers[-1].values(dynamics.motion, loads)) / self.full_load
        return found * dynamics.direction(self.joint) if self.signed else found

    def functions_of(self, values: Array) -> Array:
        """The functions `(function, sample)` at values `(driver, sample)` of what the curve runs over."""
        if self.degree:
            ranges = np.array((self.lower, self.upper, *self.further)).reshape(-1, 2)
            return np.asarray(polynomial_basis(values, ranges, self.products))  # type: ignore[arg-type]
        if not self.orders:
            splines = np.asarray(spline_basis(values[0], self.lower, self.upper, self.pieces))  # type: ignore[arg-type]
            return splines[::-1].cumsum(0)[::-1]
        turned = np.array(self.orders)[:, None] * wave_angle(values[0], self.of_slide)
        return np.stack([np.sin(turned), np.cos(turned)], 1).reshape(self.functions, -1)

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        return values @ self.basis(dynamics)

    def curve(self, values: Array, driver: Array) -> Array:
        """The curve's value `(sample,)` Nm at values `(sample,)` or `(driver, sample)` of the driver, forwards."""
        return np.asarray(values) @ self.functions_of(np.atleast_2d(driver))


def waves(joint: int, q: Array, orders: Sequence[float] | Array, of_slide: bool = False) -> UnnamedTorque:
    """The curve of some orders of a joint's position `(sample,)` rad, or m of a prismatic joint."""
    return UnnamedTorque(
        joint,
        joint_driver("position", joint, of_slide).phrase,
        float(q.min()) - 1e-6,
        float(q.max()) + 1e-6,
        orders=tuple(float(order) for order in orders),
        of_slide=of_slide,
    )
