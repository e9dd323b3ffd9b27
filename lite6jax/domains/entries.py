"""The model of a diagnosis as values of JSON: what models of every domain have, its writing, its reading and checks.

A domain adds its own fields in a subclass of `ModelEntry`, and reads a model in a subclass of `Document`.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Generic, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from lite6jax.arms.arm import Arm
from lite6jax.arms.description import LARGEST_MASS
from lite6jax.arms.entries import ANGLE_LIMIT, LENGTH_LIMIT
from lite6jax.array_types import Array
from lite6jax.domains.uncertainty import RecordedRange, ReferenceOrigin, Uncertainty, freed
from lite6jax.effects.catalogue import kinds_of
from lite6jax.effects.effect import Effect, require_kind
from lite6jax.effects.serialization import effect_as_dict, effect_from_dict
from lite6jax.errors import InputError
from lite6jax.recordings.settings import HIGHEST_TEMPERATURE, LARGEST_GRAVITY
from lite6jax.storage import Count, NonNegative, Number, Strict

M = TypeVar("M", bound="ModelEntry")

_FARTHEST = 1e4
"""m; a sensor stands no further from the arm, and nothing on a flange is larger."""
_LARGEST_MISFIT = 10.0
"""Multiples of the range of a number of an effect, beyond which it is damaged; estimates scatter about the range."""
_ROUNDING = 1e-9
"""Of the largest covariance, by which rounding may make a variance of zero negative."""
_RANGES = ("joint_range_rad", "velocity_range_rad_per_s", "acceleration_range_rad_per_s2")
"""Of what was recorded; of poses the first alone."""

_LARGEST_MOMENT = LARGEST_MASS * LENGTH_LIMIT
_BY_UNIT = {"m": LENGTH_LIMIT, "rad": ANGLE_LIMIT}
_Length = Annotated[float, Meta(ge=-LENGTH_LIMIT, le=LENGTH_LIMIT)]
Angle = Annotated[float, Meta(ge=-ANGLE_LIMIT, le=ANGLE_LIMIT)]
_Far = Annotated[float, Meta(ge=-_FARTHEST, le=_FARTHEST)]
Mass = Annotated[float, Meta(ge=-LARGEST_MASS, le=LARGEST_MASS)]
_Moment = Annotated[float, Meta(ge=-_LARGEST_MOMENT, le=_LARGEST_MOMENT)]
_Acceleration = Annotated[float, Meta(ge=-LARGEST_GRAVITY, le=LARGEST_GRAVITY)]
_Temperature = Annotated[float, Meta(ge=-273.15, le=HIGHEST_TEMPERATURE)]
Point = tuple[_Length, _Length, _Length]
Gravity = tuple[_Acceleration, _Acceleration, _Acceleration]
Chain = list[tuple[_Length, _Length, _Length, Angle, Angle, Angle]]
_Row = tuple[_Far, _Far, _Far, _Far]
Transform = tuple[_Row, _Row, _Row, _Row]
Limits = list[tuple[_Far, _Far]]
Ranges = list[tuple[float, float]]
Link = Annotated[list[_Moment], Meta(min_length=10, max_length=10)]


class Recorded(Strict):
    """Where a model was recorded; of torques with velocities and accelerations."""

    joint_range_rad: Ranges
    joint_position_rad: list[list[float]]
    spacing_rad: NonNegative
    drivers: dict[str, tuple[float, float]]
    velocity_range_rad_per_s: Ranges | None = None
    acceleration_range_rad_per_s2: Ranges | None = None


class UncertaintyEntry(Strict):
    """How uncertain predictions are: fields of `Uncertainty`.

    Lists have a number for position (m) and orientation (rad) of poses, or for each joint (Nm, N of prismatic ones).
    """

    sites: list[tuple[str, Count, Count]]
    covariance: list[float]
    left: list[NonNegative]
    unseen: list[NonNegative]
    noise: list[NonNegative]
    recorded: Recorded
    typical: list[NonNegative] | None = None


class ModelEntry(Strict, kw_only=True):
    """What predictions of every domain need."""

    arm: str
    kinematics: Chain
    reference_temperature_degC: _Temperature  # noqa: N815 (the key)
    effects: list[Any]
    prismatic_joints: tuple[Number, ...] = ()
    joint_limits: Limits | None = None
    uncertainty: UncertaintyEntry | None = None

    @property
    def joints(self) -> int:
        """How many the arm has."""
        return len(self.kinematics)

    @property
    def sliding(self) -> tuple[int, ...]:
        """The prismatic joints, counted from 0."""
        return tuple(joint - 1 for joint in self.prismatic_joints)


class JointModelEntry(ModelEntry, kw_only=True):
    """What predictions of what joints do need, of their torques or of how they follow commands."""

    T_joint_flange: Transform
    links: list[Link]
    payload_center: Point
    gravity: Gravity

    def declared_arm(self, **drives: Any) -> Arm:
        """The arm, with what is known of its drives, by the fields `DRIVE_FIELDS`."""
        limits = np.asarray(self.joint_limits, float)
        flange = np.asarray(self.T_joint_flange, float)
        kinematics = np.asarray(self.kinematics, float)
        return Arm(self.arm, kinematics, sliding=self.sliding, T_joint_flange=flange, joint_limits=limits, **drives)


class Document(msgspec.Struct, Generic[M], kw_only=True):
    """What is read of a diagnosis of a domain beside its report.

    Attributes:
        model: the fields of the domain's model.
        against: the reference that it is relative to; None where there is none.
        catalogue: the effects that a model of the domain may have, by name.
    """

    catalogue: ClassVar[Mapping[str, type[Effect]]]

    model: M
    against: ReferenceOrigin | None = None

    @property
    def origin(self) -> ReferenceOrigin | None:
        """The reference that the model is relative to; None where it contains all that the recording shows."""
        if self.against is None or self.against.basis == "effects":
            return None
        return self.against

    def unknown_effect(self, effects: Sequence[Effect]) -> str | None:
        """The name of an effect of the model that is neither in the catalogue nor among a user's `effects`; or None."""
        kinds = kinds_of(effects, self.catalogue)
        for entry in self.model.effects:
            if isinstance(entry, Mapping) and isinstance(name := entry.get("effect"), str) and name not in kinds:
                return name
        return None

    def restored_effects(self, effects: Sequence[Effect]) -> tuple[tuple[Effect, ...], list[Array]]:
        """The effects of the model, and their numbers; `effects` are a user's own.

        Raises:
            InputError: the arm does not have such an effect, or a number is far beyond what it can be.
        """
        return _effects(self.model.effects, kinds_of(effects, self.catalogue), self.model.joints, self.model.sliding)

    def restored(self, effects: Sequence[Effect]) -> Any:
        """The model; `effects` are a user's own.

        Raises:
            InputError: something in it is not possible; as may be other errors of damaged values.
        """
        raise NotImplementedError


def effect_entry(effect: Effect) -> dict[str, Any]:
    """Which effect, where, and of what: of nothing recorded where it wanders by itself."""
    driver = " and ".join(driver.phrase for driver in effect.drivers if not driver.is_order) or "none"
    return {"effect": effect.name, "site": effect.site, "driver": driver}


def joint_fields(model: Any) -> dict[str, Any]:
    """The fields of `JointModelEntry` that are its own, and its chain; of a `JointModel` with bodies."""
    arm = model.arm
    return {
        "arm": arm.name,
        "kinematics": np.asarray(arm.kinematics).tolist(),
        "T_joint_flange": arm.T_joint_flange.tolist(),
        "links": model.links.tolist(),
        "payload_center": model.payload_center.tolist(),
        "gravity": model.gravity.tolist(),
        "joint_limits": arm.joint_limits.tolist(),
    }


def shared_fields(model: Any, parts: Sequence[tuple[Effect, slice]], covariances: Sequence[Array]) -> dict[str, Any]:
    """The fields that models of every domain have.

    Args:
        model: its `sliding`, `reference_temperature`, `values` and `uncertainty`.
        parts: its effects, with the places of their numbers in `values`.
        covariances: of the numbers of each effect.
    """
    return {
        **({"prismatic_joints": [joint + 1 for joint in model.sliding]} if model.sliding else {}),
        "reference_temperature_degC": model.reference_temperature,
        "effects": [
            effect_as_dict(effect, model.values[at], C) for (effect, at), C in zip(parts, covariances, strict=True)
        ],
        "uncertainty": model.uncertainty and _uncertainty_entry(model.uncertainty),
    }


def _uncertainty_entry(uncertainty: Uncertainty) -> dict[str, Any]:
    C = uncertainty.covariance
    recorded = uncertainty.recorded
    ranges = zip(_RANGES, (recorded.joints, recorded.velocities, recorded.accelerations), strict=True)
    lists = {
        "left": uncertainty.left,
        "unseen": uncertainty.unseen,
        "noise": uncertainty.noise,
        "typical": uncertainty.typical,
    }
    return {
        "sites": [list(site) for site in uncertainty.sites],
        "covariance": C[np.tril_indices(len(C))].tolist(),  # row by row
        **{name: None if part is None else np.asarray(part, float).tolist() for name, part in lists.items()},
        "recorded": {
            **{name: limits.tolist() for name, limits in ranges if limits is not None},
            "joint_position_rad": recorded.positions.tolist(),
            "spacing_rad": recorded.spacing,
            "drivers": {phrase: list(bounds) for phrase, bounds in recorded.drivers.items()},
        },
    }


def _effects(
    entries: Sequence[Any], kinds: Mapping[str, type[Effect]], joints: int, sliding: tuple[int, ...]
) -> tuple[tuple[Effect, ...], list[Array]]:
    """The effects of a model of so many joints, and their numbers.

    Raises:
        InputError: the arm does not have such an effect, or a number is far beyond what it can be.
    """
    pairs = [effect_from_dict(entry, kinds) for entry in entries]
    for effect, values in pairs:
        if effect.joints_needed > joints:
            needed = f"is of an arm of {effect.joints_needed} joints or more, and this one has {joints}"
            raise InputError(f"{effect.label}: {needed}")
        for coordinate, value in zip(effect.coordinates, values, strict=True):
            lower = coordinate.lower
            upper = coordinate.upper
            if math.isfinite(lower) and math.isfinite(upper) and not effect.nonparametric:
                slack = _LARGEST_MISFIT * (upper - lower)
            else:  # a coefficient of a curve
                slack, lower, upper = 0.0, *(sign * _BY_UNIT.get(coordinate.unit, math.inf) for sign in (-1, 1))
            if not lower - slack <= value <= upper + slack:
                bounds = f"between {lower - slack:.6g} and {upper + slack:.6g}"
                raise InputError(f"{effect.label}: {coordinate.name} is {value:.6g}, which is not {bounds}")
        require_kind(effect, sliding)
    return tuple(effect for effect, _ in pairs), [values for _, values in pairs]


def restored_uncertainty(
    model: ModelEntry, effects: Sequence[Effect], sizes: Mapping[str, tuple[int, int]], quantities: int
) -> Uncertainty | None:
    """The uncertainty of a model with effects; None of a document without it.

    Args:
        model: whose.
        effects: of the model.
        sizes: by each kind of nuisance, at how many places it is, and how many numbers each place has.
        quantities: of a prediction that have an error of their own.
    """
    entry = model.uncertainty
    if entry is None:
        return None
    if any(name not in sizes or not (j < sizes[name][0] and k < sizes[name][1]) for name, j, k in entry.sites):
        raise ValueError("a site of its uncertainty is none of this arm")
    lists = [entry.left, entry.unseen, entry.noise, *([] if entry.typical is None else [entry.typical])]
    if any(len(part) != quantities for part in lists):
        raise ValueError("its uncertainty is not one of this arm")
    size = len(entry.sites) + sum(freed(effect).size for effect in effects)
    if len(entry.covariance) != size * (size + 1) // 2:
        raise ValueError(f"its covariance is not one of {size} numbers")
    C = np.zeros((size, size))
    C[np.tril_indices(size)] = entry.covariance
    if (np.diagonal(C) < -_ROUNDING * np.abs(C).max(initial=0.0)).any():
        raise ValueError("a variance of its uncertainty is negative")
    C += np.tril(C, -1).T
    model_error, unseen, noise, *typical = map(np.array, lists)
    return Uncertainty(
        tuple(entry.sites), C, model_error, unseen, noise, _recorded(entry.recorded, model.joints), *typical
    )


def _recorded(entry: Recorded, joints: int) -> RecordedRange:
    """Where a model of so many joints was recorded."""
    recorded_ranges = (entry.joint_range_rad, entry.velocity_range_rad_per_s, entry.acceleration_range_rad_per_s2)
    ranges = [None if part is None else np.asarray(part, float) for part in recorded_ranges]
    present_ranges = [part for part in ranges if part is not None]
    positions = np.asarray(entry.joint_position_rad, float)
    if any(part.shape != (joints, 2) for part in present_ranges) or positions.shape != (len(positions) or 1, joints):
        raise ValueError("its recorded range is not one of this arm")
    ends = [*(tuple(pair) for part in present_ranges for pair in part), *entry.drivers.values()]
    if any(lower > upper for lower, upper in ends):
        raise ValueError("a recorded range of its uncertainty ends before it begins")
    assert ranges[0] is not None
    return RecordedRange(ranges[0], positions, entry.spacing_rad, entry.drivers, *ranges[1:])
