"""What an effect is: a small pure function of a motion, with a site, drivers, numbers to fit and a neutral value."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple, Self, TypeVar, dataclass_transform, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.arm import joint_size, joint_unit
from lite6jax.deferred import JaxArray, jnp
from lite6jax.effects.deflection import Deflection, library_of, place_at_site
from lite6jax.effects.drivers import Driver, driver_of, joint_driver, place_of
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import Inertia, Loads
from lite6jax.errors import InputError

Kind = TypeVar("Kind", bound=type)

UNINFORMED_PHASE = np.pi / np.sqrt(3)
"""The standard deviation of an angle of which nothing is known."""


class Coordinate(NamedTuple):
    """A number of an effect that a fit moves; zero is neutral.

    Attributes:
        name: with its unit, such as `compliance_rad_per_Nm`.
        unit: such as `rad/Nm`; `1` for a ratio.
        typical: the size that real arms show, by which a fit scales it.
        spread: standard deviation of its prior about zero; infinite where its limits alone are one.
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

    def at_slide(self) -> "Coordinate":
        """That of a prismatic joint, given as that of a revolute one; `spread` was measured and stays as it is."""
        typical, lower, upper = (joint_size(size, self.unit, True) for size in (self.typical, self.lower, self.upper))
        name = joint_unit(self.name, True)
        unit = joint_unit(self.unit, True)
        return Coordinate(name, unit, typical, self.spread, lower, upper, self.linear)


def symmetric(name: str, unit: str, typical: float, limit: float, **further_fields: Any) -> Coordinate:
    """A `Coordinate` of either sign, at most `limit` in size."""
    return Coordinate(name, unit, typical, lower=-limit, upper=limit, **further_fields)


def positive(name: str, unit: str, typical: float, limit: float, **further_fields: Any) -> Coordinate:
    """A `Coordinate` that cannot be negative."""
    return Coordinate(name, unit, typical, lower=0.0, upper=limit, **further_fields)


class Estimate(NamedTuple):
    """A parameter's value and standard deviation."""

    value: float
    std: float


class SimulatorParameters(NamedTuple):
    """What holds the number of an effect in simulators; empty where nothing does.

    Attributes:
        mujoco: attributes of MJCF.
        isaac_lab: fields of actuators, of joints or of the scene in Isaac Lab.
        urdf: elements of URDF.
    """

    mujoco: str = ""
    isaac_lab: str = ""
    urdf: str = ""


@dataclass_transform(frozen_default=True)
def final_effect(kind: Kind) -> Kind:
    """The class of an effect as a final and frozen dataclass."""
    return final(dataclass(frozen=True)(kind))


def slides(effect: "Effect") -> bool:
    """Tells whether an effect is one of a prismatic joint."""
    return isinstance(effect, OfJoint) and effect.of_slide


@dataclass(frozen=True)
class Effect(ABC):
    """Something a rigid arm with perfect encoders does not show. Frozen and hashable: a static argument of `jax.jit`.

    A final subclass is a frozen dataclass whose fields say where it acts; its numbers are not in it, but are given to
    its functions as `values` `(coordinate,)`, in the order of `coordinates`; at zero it changes nothing.

    Most effects state `at`, `quantities` and `numbers`, from which their site, drivers and coordinates follow in the
    units of their joint. Others define these properties themselves.
    """

    name: ClassVar[str]
    domain: ClassVar[str] = "kinematic"
    """The list that it is in: `kinematic` effects move the tool, `dynamic` ones add to the motors' torques, `tracking`
    ones are of servos and encoders."""
    specificity: ClassVar[int] = 14
    """Rank of its name among effects that the data do not distinguish; the least is reported."""
    common: ClassVar[bool] = False
    """Whether nearly every arm has it, if none of its numbers is chosen."""
    nonparametric: ClassVar[bool] = False
    """Whether it is a Gaussian process rather than a named effect."""
    at: ClassVar[str] = ""
    """Its site; `joint` or `link` where the field of that name says which."""
    quantities: ClassVar[tuple[str, ...]] = ()
    """What it depends on, as of a revolute joint, at its own joint or link; `velocity of joint 1` names another."""
    numbers: ClassVar[tuple[Coordinate, ...]] = ()
    """Its coordinates, as of a revolute joint. One that is also a field is none where that field is given."""
    fixed: ClassVar[str | None] = None
    """A field that is reported as a parameter too, without uncertainty."""
    plain: ClassVar[float | None] = None
    """The value of `fixed` in the simplest form of an effect, which is no number of it; None where there is none."""
    searched: ClassVar[bool] = False
    """Whether `fixed` is a number that a search chooses; None in the field makes it the last coordinate."""
    may_be_zero: ClassVar[bool] = False
    """Whether that number may be zero; else it is positive."""
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters()
    """Where simulators have it as a parameter."""

    def __post_init__(self) -> None:
        """Refuses a number that is chosen and not possible."""
        number = self._fixed_value if self.searched else None
        if number is None or number == self.plain or 0 < number < np.inf or (self.may_be_zero and number == 0):
            return
        accepted = "a positive number"
        if self.may_be_zero:
            accepted = "zero or a positive number"
        raise InputError(f"{self.label}: {self.own(self.fixed or '')} is {number:g}; give {accepted}")

    @property
    def periodic(self) -> bool:
        """Tells whether a spectrum of orders finds the chosen number, rather than a few values tried one by one."""
        return False

    @property
    def hysteretic(self) -> bool:
        """Tells whether it depends on the samples before, and not on the present motion alone."""
        return False

    @property
    def site(self) -> str:
        """`joint2`, `link3`, `links`, `base`, `tool`, `sensor`, `clock` or `payload`."""
        return f"{self.at}{vars(self).get(self.at, '')}"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The numbers that a fit moves."""
        free = (number for number in self.numbers if vars(self).get(number.name) is None)
        if slides(self):
            return tuple(number.at_slide() for number in free)
        return tuple(free)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        """What it depends on."""
        joint = vars(self).get(self.at, 0)
        drivers = []
        for phrase in self.quantities:
            if phrase[-1].isdecimal():
                drivers.append(driver_of(phrase))
            else:
                drivers.append(joint_driver(phrase, joint if place_of(phrase) else 0, slides(self)))
        return tuple(drivers)

    @final
    def own(self, name: str) -> str:
        """A name or unit of a revolute joint, as it is for the joint of this effect."""
        return joint_unit(name, slides(self))

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return len(self.coordinates)

    @property
    def label(self) -> str:
        """Name and site, such as `joint_compliance:joint2`."""
        return f"{self.name}:{self.site}"

    @property
    @final
    def linear(self) -> bool:
        """Tells whether what it adds is proportional to its numbers; columns are then computed once."""
        return not isinstance(self, Altering) and all(coordinate.linear for coordinate in self.coordinates)

    @property
    def usual(self) -> bool:
        """Tells whether nearly every arm has it as it is: its choice costs ln 2."""
        return self.common and self.chosen is None

    @property
    def chosen(self) -> float | None:
        """The number that a search chose from many instead of fitting it, or None."""
        return self.fixed_number if self.searched else None

    @property
    def fixed_number(self) -> float | None:
        """What the field `fixed` says; None where it says nothing or the simplest form, or there is none."""
        number = self._fixed_value
        return None if number == self.plain else number

    @property
    def _fixed_value(self) -> float | None:
        """What is in the field `fixed`; None where there is no such field."""
        return None if self.fixed is None else vars(self)[self.fixed]

    @property
    def rivals(self) -> "tuple[Effect, ...]":
        """The effects that it is always compared with."""
        return ()

    @property
    def includes(self) -> "tuple[Effect, ...]":
        """The effects that are this one with some of its numbers zero, or in its simplest form."""
        if self.fixed is None or self.plain in (None, self._fixed_value):
            return ()
        return (replace(self, **{self.fixed: self.plain}),)

    def released(self) -> "Effect":
        """The same effect with its chosen number as its last coordinate."""
        assert self.searched
        assert self.fixed is not None
        return replace(self, **{self.fixed: None})

    @final
    def held(self, number: float) -> Self:
        """The same effect with its chosen number fixed, within what it can be."""
        assert self.fixed is not None
        last = self.released().coordinates[-1]
        return replace(self, **{self.fixed: min(max(number, last.lower), last.upper)})

    # ------------------------------------------------------------------ what people read

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names of the parameters that people read: the coordinates and the fixed number, if nothing else."""
        names = tuple(coordinate.name for coordinate in self.coordinates)
        if self.fixed_number is None:
            return names
        return (*names, self.own(self.fixed or ""))

    def to_parameters(self, values: NDArray) -> tuple[NDArray, NDArray]:
        """The parameters of `values` `(coordinate,)`, and their derivatives `(parameter, coordinate)`."""
        number = [] if self.fixed_number is None else [self.fixed_number]
        return np.append(values, number), np.eye(len(values) + len(number), len(values))

    def from_parameters(self, given: Mapping[str, float]) -> NDArray:
        """The inverse, of parameters by name; those not given are zero.

        Raises:
            InputError: a number that is not possible, or another one than the fixed one.
        """
        number = self.fixed_number
        name = self.own(self.fixed or "")
        if number is not None and given.get(name, number) != number:
            raise InputError(
                f"{self.label}: {name} {given[name]:g} beside the fixed {name} {number:g}; give one of them"
            )
        return np.array([given.get(coordinate.name, 0.0) for coordinate in self.coordinates])

    @final
    def reported(self, values: ArrayLike, covariance: ArrayLike | None = None) -> dict[str, Estimate]:
        """The parameters that people read, with standard deviations to first order.

        Args:
            values: `(coordinate,)`.
            covariance: `(coordinate, coordinate)`; standard deviations are 0 without it.
        """
        values = np.asarray(values, float)
        parameters, jacobian = self.to_parameters(values)
        C = np.zeros((values.size, values.size)) if covariance is None else np.asarray(covariance, float)
        stds = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", jacobian, C, jacobian), 0.0))
        estimates = zip(self.parameters, parameters, stds, strict=True)
        return {
            name: Estimate(float(p), float(min(std, UNINFORMED_PHASE) if name == "phase_rad" else std))
            for name, p, std in estimates
        }

    @final
    def values_of(self, parameters: Mapping[str, float]) -> NDArray:
        """The values `(coordinate,)` of parameters by name, the inverse of `reported`; those not given are zero.

        Raises:
            InputError: an unknown name, none at all, or a number that is not finite or not possible.
        """
        names = self.parameters
        unknown = [name for name in parameters if name not in names]
        if unknown:
            raise InputError(f"{self.label}: has no {unknown[0]!r}; it takes {', '.join(names)}")
        if not parameters:
            raise InputError(f"{self.label}: no number is given; it takes {', '.join(names)}")
        for name, value in parameters.items():
            if not np.isfinite(value):
                raise InputError(f"{self.label}: {name} is {value}; give a finite number")
        return self.from_parameters(parameters)

    @property
    def joints_needed(self) -> int:
        """How many joints an arm has at least that can have this effect."""
        digits = "".join(character for character in self.site if character.isdecimal())
        return max([int(digits or 0), *(driver.place for driver in self.drivers)])


# ------------------------------------------------------------------ on poses


class Bending(Effect, ABC):
    """An effect that deflects the arm."""

    @abstractmethod
    def deflect(self, values: JaxArray, motion: Motion, loads: Loads | None) -> Deflection:
        """The deflection by `values` `(coordinate,)` in a motion."""


class FrameEffect(Bending, ABC):
    """An effect that displaces the frame at its site."""

    @abstractmethod
    def displace(self, values: JaxArray, motion: Motion, loads: Loads | None) -> JaxArray:
        """`(6, sample)`, the frame's twist."""

    @final
    def deflect(self, values: JaxArray, motion: Motion, loads: Loads | None) -> Deflection:
        """The twist at its site."""
        return place_at_site(motion.dof, self.site, self.displace(values, motion, loads))


class Altering(Effect, ABC):
    """An effect by which the arm's motion is another than the one declared, before loads and deflections follow."""

    @abstractmethod
    def alter(self, values: JaxArray, motion: Motion) -> Motion:
        """The motion as it really was."""

    @abstractmethod
    def beyond(self, values: JaxArray, motion: Motion) -> JaxArray:
        """`(sample,)` bool: where that takes what the motion does not hold, so that the prediction means nothing."""


class Loading(Altering, ABC):
    """An effect by which other loads act on the arm than those declared. It shows through compliances alone."""

    def alter(self, values: JaxArray, motion: Motion) -> Motion:
        """The motion as it is: most such effects are of masses or of gravity."""
        return motion

    def alter_inertia(self, values: JaxArray, inertia: Inertia) -> Inertia:
        """The masses and gravity as they really were; as declared where the motion alone is another."""
        return inertia

    @final
    def beyond(self, values: JaxArray, motion: Motion) -> JaxArray:
        """No row needs what the motion does not hold."""
        return jnp.zeros(motion.samples, bool)


# ------------------------------------------------------------------ of joints


@dataclass(frozen=True)
class OfJoint(Effect, ABC):
    """An effect at a joint, in the units of that joint: those of a prismatic joint follow from a revolute one's.

    Attributes:
        joint: counted from 1.
        of_slide: whether the joint is prismatic; a model, or the arm of a command, says it.
    """

    joint: int
    of_slide: bool = field(default=False, kw_only=True)

    at: ClassVar[str] = "joint"

    @property
    def joints(self) -> tuple[int, ...]:
        """The joints that it concerns, counted from 1: its own first."""
        return (self.joint,)

    @final
    def own_driver(self, quantity: str) -> Driver:
        """A quantity of this joint, such as `velocity`."""
        return joint_driver(quantity, self.joint, self.of_slide)

    @property
    def follows_own_motion(self) -> bool:
        """Tells whether it depends on the motion of its own joint alone."""
        motions = {self.own_driver(quantity) for quantity in ("velocity", "speed", "direction of motion")}
        return set(self.drivers) <= motions


@dataclass(frozen=True)
class JointEffect(OfJoint, Bending, ABC):
    """An effect that adds to one joint's position."""

    @abstractmethod
    def angle(self, values: JaxArray, motion: Motion, loads: Loads | None) -> JaxArray:
        """`(sample,)` rad, m of a prismatic joint, that add to what the encoder says."""

    @final
    def deflect(self, values: JaxArray, motion: Motion, loads: Loads | None) -> Deflection:
        """What adds at its joint."""
        return place_at_site(motion.dof, self.site, self.angle(values, motion, loads))


def require_kind(effect: Effect, sliding: tuple[int, ...]) -> None:
    """Refuses an effect of a revolute joint at one of the prismatic joints `sliding`, counted from 0, or the reverse.

    Raises:
        InputError: as said.
    """
    if not isinstance(effect, OfJoint):
        return
    joints = effect.joints
    mismatched = [joint for joint in joints if (joint - 1 in sliding) != effect.of_slide]
    if mismatched:
        effect_kind, joint_kind = ("prismatic", "revolute") if effect.of_slide else ("revolute", "prismatic")
        remedy = "joints of one kind" if len(mismatched) < len(joints) else f"of_slide={not effect.of_slide}"
        raise InputError(
            f"{effect.label}: is of a {effect_kind} joint, and joint {mismatched[0]} is {joint_kind}; give {remedy}"
        )


# ------------------------------------------------------------------ waves

_ROUNDING = 1e-12
"""Relative: an order is stored beside its inverse."""


class Wave(OfJoint, ABC):
    """An effect A·sin(n·q + φ) with the order n, or A·sin(2π·q/p + φ) along a prismatic joint, with the period p.

    Its coordinates are A cos φ and A sin φ, in which it is linear, and after them n where the field `order` does not
    fix it. Along a prismatic joint n counts cycles per metre, and people read p = 1/n, such as the lead of a screw.
    """

    order: float | None
    fixed: ClassVar[str | None] = "order"
    searched: ClassVar[bool] = True
    amplitude: ClassVar[Coordinate]
    """As of a revolute joint, its name without a prefix, such as `_rad`."""

    @property
    @final
    def periodic(self) -> bool:
        """A spectrum of orders finds it."""
        return True

    @property
    @final
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Those of sine and cosine, and the order where it is not fixed."""
        amplitude = self.amplitude.at_slide() if self.of_slide else self.amplitude
        waves = tuple(amplitude._replace(name=wave + amplitude.name) for wave in ("sine", "cosine"))
        order = Coordinate("order", "1/m" if self.of_slide else "1", 0.1, lower=0.0, linear=False)
        return waves if self.order is not None else (*waves, order)

    @final
    def order_in(self, values: Any) -> Any:
        """The order, as it is fixed or as the last of `values`."""
        return values[-1] if self.order is None else self.order

    @final
    def of_position(self, values: JaxArray, position: JaxArray) -> JaxArray:
        """`(sample,)`, by `values` `(coordinate,)` at positions of the joint."""
        turned = self.order_in(values) * wave_angle(position, self.of_slide)
        xp = library_of(turned)
        return values[0] * xp.sin(turned) + values[1] * xp.cos(turned)

    @property
    @final
    def parameters(self) -> tuple[str, ...]:
        """Order or period, amplitude and phase."""
        return ("period_m" if self.of_slide else "order", self.own("amplitude" + self.amplitude.name), "phase_rad")

    @final
    def to_parameters(self, values: NDArray) -> tuple[NDArray, NDArray]:
        """As of any effect."""
        order = self.order_in(values)
        sine, cosine = values[:2]
        size = np.hypot(sine, cosine)
        phase = np.arctan2(cosine, sine)
        jacobian = np.zeros((3, values.size))
        jacobian[0, 2:] = 1.0
        if self.of_slide:  # of no order, as of an effect that is neutral, there is no period
            order = 1 / order if order else 0.0
            jacobian[0, 2:] = -(order**2)
        # at no amplitude the phase is anything: a huge derivative, which `reported` takes for no knowledge
        along = np.array([sine, cosine]) / size if size else np.array([1.0, 0.0])
        jacobian[1, :2] = along
        jacobian[2, :2] = np.array([-along[1], along[0]]) / max(size, 1e-300)
        return np.array([order, size, np.pi if phase == -np.pi else phase]), jacobian

    @final
    def from_parameters(self, given: Mapping[str, float]) -> NDArray:
        """As of any effect."""
        repeats, amplitude, _ = self.parameters
        fixed = self.order
        if fixed is not None and self.of_slide:
            fixed = 1 / fixed
        if repeats not in given and fixed is None:
            of_slide = "no period is given; say after which length the force repeats, as period_m=0.005"
            of_turn = "no order is given; say how often the error comes in a turn, as order=2"
            raise InputError(f"{self.label}: {of_slide if self.of_slide else of_turn}")
        number = given.get(repeats, fixed)
        assert number is not None
        if self.of_slide and not number > 0:
            raise InputError(f"{self.label}: {repeats} is {number:g}; give a positive length")
        if fixed is not None and abs(number - fixed) > _ROUNDING * abs(fixed):
            raise InputError(
                f"{self.label}: {repeats} {number:g} beside the fixed {repeats} {fixed:g}; give one of them"
            )
        size = given.get(amplitude, 0.0)
        phase = given.get("phase_rad", 0.0)
        if size < 0:
            raise InputError(f"{self.label}: {amplitude} is {size:g}; make it positive and add pi to phase_rad")
        order = [] if fixed is not None else [1 / number if self.of_slide else number]
        return np.array([size * np.cos(phase), size * np.sin(phase), *order])


def wave_angle(position: Any, of_slide: bool) -> Any:
    """The angle in rad of which an order counts the waves: a joint's position, or one turn a metre of a slide."""
    return 2 * np.pi * position if of_slide else position
