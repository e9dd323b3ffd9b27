"""What an effect is: a small pure function of a motion, with a site, drivers, numbers to fit and a neutral value."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.arm import joint_size, joint_unit
from lite6jax.deferred import Array, jnp
from lite6jax.effects.deflection import Deflection, place_at_joint
from lite6jax.effects.drivers import Driver
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import Inertia, Loads
from lite6jax.errors import InputError


class Coordinate(NamedTuple):
    """A number of an effect that a fit moves; zero is neutral.

    Attributes:
        name: with its unit, such as `compliance_rad_per_Nm`.
        unit: such as `rad/Nm`; `1` for a ratio.
        typical: the size that real arms show, by which a fit scales it.
        spread: standard deviation of its prior about zero; infinite where there is none.
        lower: the least value that is physically possible.
        upper: the largest value that is physically possible.
        linear: whether the deflection is proportional to it.
    """

    name: str
    unit: str
    typical: float
    spread: float = np.inf
    lower: float = -np.inf
    upper: float = np.inf
    linear: bool = True


class Estimate(NamedTuple):
    """A parameter's value and standard deviation."""

    value: float
    std: float


class Reporting(NamedTuple):
    """How an effect's coordinates, in which it is smooth at neutral, relate to the parameters that people read.

    Attributes:
        names: of an effect, the names of the parameters.
        parameters: of an effect and `values` `(coordinate,)`, the parameters and their derivatives
            `(parameter, coordinate)`.
        values: the inverse, of an effect and parameters by name; those not given are zero.
    """

    names: "Callable[[Effect], tuple[str, ...]]"
    parameters: "Callable[[Effect, NDArray], tuple[NDArray, NDArray]]"
    values: "Callable[[Effect, Mapping[str, float]], NDArray]"


def _coordinate_names(effect: "Effect") -> tuple[str, ...]:
    return tuple(coordinate.name for coordinate in effect.coordinates)


DIRECT = Reporting(
    names=_coordinate_names,
    parameters=lambda effect, values: (values, np.eye(len(values))),
    values=lambda effect, given: np.array([given.get(name, 0.0) for name in _coordinate_names(effect)]),
)
"""The coordinates are the parameters."""


def with_field(field: str) -> Reporting:
    """The coordinates, and after them a number that is a field of the effect where it is fixed, without uncertainty.

    Args:
        field: its name as a field and as a parameter; None there says that it is a coordinate, or that it is none.
    """

    def names(effect: "Effect") -> tuple[str, ...]:
        return (*_coordinate_names(effect), *(() if getattr(effect, field) is None else (effect.own(field),)))

    def parameters(effect: "Effect", values: NDArray) -> tuple[NDArray, NDArray]:
        fixed = [number for number in (getattr(effect, field),) if number is not None]
        return np.append(values, fixed), np.eye(len(values) + len(fixed), len(values))

    def values(effect: "Effect", given: Mapping[str, float]) -> NDArray:
        fixed, name = getattr(effect, field), effect.own(field)
        if fixed is not None and given.get(name, fixed) != fixed:
            raise InputError(
                f"{effect.label}: {name} {given[name]:g} beside the fixed {name} {fixed:g}; give one of them"
            )
        return DIRECT.values(effect, given)

    return Reporting(names, parameters, values)


def slides(effect: "Effect") -> bool:
    """Whether an effect is one of a prismatic joint."""
    return bool(getattr(effect, "of_slide", False))


class Choice(NamedTuple):
    """A number of an effect that a search chooses from a spectrum, such as a harmonic's order.

    Attributes:
        number: of an effect, its chosen number; None where it is free.
        searched: of an effect, whether the number is one of many: the first orders have names of their own.
        released: the same effect with the number as its last coordinate.
        held: the same effect with the number fixed.
        periodic: whether a spectrum of orders finds it, rather than a few values that are tried one by one.
    """

    number: "Callable[[Effect], float | None]"
    searched: "Callable[[Effect], bool]"
    released: "Callable[[Effect], Effect]"
    held: "Callable[[Effect, float], Effect]"
    periodic: bool = False


def tried(field: str, lower: float, released: "Callable[[Effect], Effect] | None" = None, unit: str = "1") -> Choice:
    """A number that is a field of the effect and is tried at a few values, while the rest is linear.

    Args:
        field: its name; None there says that it is not fixed.
        lower: the least that it can be when it is fixed.
        released: of an effect, the same with the number as its last coordinate; that with None in the field where not
            given.
        unit: of `lower`, at a revolute joint.
    """
    return Choice(
        number=lambda effect: getattr(effect, field),
        searched=lambda effect: getattr(effect, field) is not None,
        released=released or (lambda effect: replace(effect, **{field: None})),
        held=lambda effect, number: replace(effect, **{field: max(number, joint_size(lower, unit, slides(effect)))}),
    )


UNINFORMED_PHASE = np.pi / np.sqrt(3)
"""The standard deviation of an angle of which nothing is known."""


@dataclass(frozen=True)
class Effect(ABC):
    """Something a rigid arm with perfect encoders does not show. Frozen and hashable: a static argument of `jax.jit`.

    A final subclass is a frozen dataclass whose fields say where it acts; its numbers are not in it, but are given to
    its functions as `values` `(coordinate,)`, in the order of `coordinates`; at zero it changes nothing.
    """

    name: ClassVar[str]
    domain: ClassVar[str] = "kinematic"
    """What it acts on: `kinematic` effects move the tool, `dynamic` ones add to the motors' torques."""
    specificity: ClassVar[int] = 14
    """Rank of its name among effects that the data do not distinguish; the least is reported."""
    usual: ClassVar[bool] = False
    """Whether nearly every arm has it: its choice costs ln 2."""
    nonparametric: ClassVar[bool] = False
    """Whether it is a Gaussian process rather than a named effect."""
    choice: ClassVar[Choice | None] = None
    reporting: ClassVar[Reporting] = DIRECT
    special_cases: "ClassVar[Callable[[Any], tuple[Effect, ...]] | None]" = None
    """Of an effect, those that are this one with some of its numbers zero; None where there are none."""

    counted: "ClassVar[Callable[[Any], int] | None]" = None
    """How many numbers it has, where thousands of such effects are counted; None to count its coordinates."""

    @property
    @abstractmethod
    def site(self) -> str:
        """`joint2`, `link3`, `links`, `base`, `tool`, `sensor`, `clock` or `payload`."""

    @property
    @abstractmethod
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The numbers that a fit moves."""

    @property
    @abstractmethod
    def drivers(self) -> tuple[Driver, ...]:
        """What it depends on."""

    @final
    def own(self, name: str) -> str:
        """A name or unit of a revolute joint, as it is for the joint of this effect."""
        return joint_unit(name, slides(self))

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return len(self.coordinates) if self.counted is None else self.counted(self)

    @property
    def label(self) -> str:
        """Name and site, such as `joint_compliance:joint2`."""
        return f"{self.name}:{self.site}"

    @property
    @final
    def linear(self) -> bool:
        """Whether what it adds is proportional to its numbers; columns are then computed once."""
        return not isinstance(self, Altering) and all(coordinate.linear for coordinate in self.coordinates)

    @property
    @final
    def periodic(self) -> bool:
        """Whether a spectrum of orders finds it."""
        return self.choice is not None and self.choice.periodic

    @property
    @final
    def chosen(self) -> float | None:
        """The number that a search chose from many instead of fitting it, or None."""
        return self.choice.number(self) if self.choice is not None and self.choice.searched(self) else None

    @property
    @final
    def includes(self) -> "tuple[Effect, ...]":
        """The effects that are this one with some of its numbers zero."""
        return () if self.special_cases is None else self.special_cases(self)

    @final
    def released(self) -> "Effect":
        """The same effect with its chosen number as its last coordinate."""
        assert self.choice is not None
        return self.choice.released(self)

    @final
    def held(self, number: float) -> "Effect":
        """The same effect with its chosen number fixed."""
        assert self.choice is not None
        return self.choice.held(self, number)

    def reported(self, values: ArrayLike, covariance: ArrayLike | None = None) -> dict[str, Estimate]:
        """The parameters that people read, with standard deviations to first order.

        Args:
            values: `(coordinate,)`.
            covariance: `(coordinate, coordinate)`; standard deviations are 0 without it.
        """
        values = np.asarray(values, float)
        parameters, jacobian = self.reporting.parameters(self, values)
        C = np.zeros((values.size, values.size)) if covariance is None else np.asarray(covariance, float)
        std = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", jacobian, C, jacobian), 0.0))
        names = self.reporting.names(self)
        std = [min(s, UNINFORMED_PHASE) if name == "phase_rad" else s for name, s in zip(names, std, strict=True)]
        return {name: Estimate(float(p), float(s)) for name, p, s in zip(names, parameters, std, strict=True)}

    def values_of(self, parameters: Mapping[str, float]) -> NDArray:
        """The values `(coordinate,)` of parameters by name, the inverse of `reported`; those not given are zero.

        Raises:
            InputError: an unknown name, none at all, or a number that is not finite or not possible.
        """
        names = self.reporting.names(self)
        unknown = [name for name in parameters if name not in names]
        if unknown:
            raise InputError(f"{self.label}: has no {unknown[0]!r}; it takes {', '.join(names)}")
        if not parameters:
            raise InputError(f"{self.label}: no number is given; it takes {', '.join(names)}")
        for name, value in parameters.items():
            if not np.isfinite(value):
                raise InputError(f"{self.label}: {name} is {value}; give a finite number")
        return self.reporting.values(self, parameters)

    @property
    def joints_needed(self) -> int:
        """How many joints an arm has at least that can have this effect."""
        digits = "".join(character for character in self.site if character.isdecimal())
        return max([int(digits or 0), *(driver.place for driver in self.drivers)])


class Bending(Effect, ABC):
    """An effect that deflects the arm."""

    @abstractmethod
    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        """The deflection by `values` `(coordinate,)` in a motion."""


class Altering(Effect, ABC):
    """An effect by which the arm's motion is another than the one declared, before loads and deflections follow."""

    @abstractmethod
    def alter(self, values: Array, motion: Motion) -> Motion:
        """The motion as it really was."""

    @abstractmethod
    def beyond(self, values: Array, motion: Motion) -> Array:
        """`(sample,)` bool: where that takes what the motion does not hold, so that the prediction means nothing."""


class Loading(Altering, ABC):
    """An effect by which other loads act on the arm than those declared. It shows through compliances alone."""

    @abstractmethod
    def alter_inertia(self, values: Array, inertia: Inertia) -> Inertia:
        """The masses and gravity as they really were."""

    @final
    def beyond(self, values: Array, motion: Motion) -> Array:
        """No row needs what the motion does not hold."""
        return jnp.zeros(motion.samples, bool)


@dataclass(frozen=True)
class JointEffect(Bending, ABC):
    """An effect that adds to one joint's position.

    Attributes:
        joint: counted from 1.
    """

    joint: int

    of_slide: ClassVar[bool | None] = False
    """Whether the joint is prismatic; None for either."""

    @abstractmethod
    def angle(self, values: Array, motion: Motion, loads: Loads | None) -> Array:
        """`(sample,)` rad, m of a prismatic joint, that add to what the encoder says."""

    @property
    @final
    def site(self) -> str:
        """`jointN`."""
        return f"joint{self.joint}"

    @final
    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        """What adds at its joint."""
        return Deflection(joint=place_at_joint(motion.dof, self.joint, self.angle(values, motion, loads)))


def require_kind(effect: Effect, sliding: tuple[int, ...]) -> None:
    """Refuses an effect of a revolute joint at one of the prismatic joints `sliding`, counted from 0, or the reverse.

    Raises:
        InputError: as said.
    """
    of_slide = getattr(effect, "of_slide", None)
    if of_slide is None:
        return
    acting = ("joint",) if isinstance(effect, JointEffect) else ("joint", "source_joint")
    joints = [getattr(effect, name) for name in acting if hasattr(effect, name)]
    others = [joint for joint in joints if (joint - 1 in sliding) != of_slide]
    if not others:
        return
    own, other = ("prismatic", "revolute") if of_slide else ("revolute", "prismatic")
    if isinstance(effect, JointEffect):
        prefix = "joint_" if of_slide else "slide_"
        remedy = f"an effect whose name begins with {prefix} (`lite6jax effects` lists them)"
    else:
        remedy = "joints of one kind" if len(others) < len(joints) else f"of_slide={not of_slide}"
    raise InputError(f"{effect.label}: is of a {own} joint, and joint {others[0]} is {other}; give {remedy}")
