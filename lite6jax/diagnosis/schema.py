"""What the model in a document of a diagnosis may hold, of poses and of torques: keys, and types and ranges of values.

The rest of a document is numbers of a report, which are looked at where a sentence is made of them.
"""

import math
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.arms.description import LARGEST_MASS
from lite6jax.arms.entries import ANGLE_LIMIT, LENGTH_LIMIT
from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError
from lite6jax.recordings.settings import HIGHEST_TEMPERATURE, LARGEST_GRAVITY
from lite6jax.schema import Count, Number, Positive, Strict

FARTHEST = 1e4
"""m; a sensor stands no further from the arm, and nothing on a flange is larger."""
LARGEST_MISFIT = 10.0
"""Multiples of the range of a number of an effect, beyond which it is damaged; estimates scatter about the range."""

Verdict = Literal["consistent", "explained", "partly_explained", "unnamed", "unexplained", "undetermined"]

_LARGEST_MOMENT = LARGEST_MASS * LENGTH_LIMIT
_BY_UNIT = {"m": LENGTH_LIMIT, "rad": ANGLE_LIMIT}
_Length = Annotated[float, Meta(ge=-LENGTH_LIMIT, le=LENGTH_LIMIT)]
_Angle = Annotated[float, Meta(ge=-ANGLE_LIMIT, le=ANGLE_LIMIT)]
_Far = Annotated[float, Meta(ge=-FARTHEST, le=FARTHEST)]
_Mass = Annotated[float, Meta(ge=-LARGEST_MASS, le=LARGEST_MASS)]
_Moment = Annotated[float, Meta(ge=-_LARGEST_MOMENT, le=_LARGEST_MOMENT)]
_Acceleration = Annotated[float, Meta(ge=-LARGEST_GRAVITY, le=LARGEST_GRAVITY)]
_Temperature = Annotated[float, Meta(ge=-273.15, le=HIGHEST_TEMPERATURE)]
_Point = tuple[_Length, _Length, _Length]
_Gravity = tuple[_Acceleration, _Acceleration, _Acceleration]
_Chain = list[tuple[_Length, _Length, _Length, _Angle, _Angle, _Angle]]
_Row = tuple[_Far, _Far, _Far, _Far]
_Transform = tuple[_Row, _Row, _Row, _Row]
_Limits = list[tuple[_Far, _Far]]
_Ranges = list[tuple[float, float]]
_Link = Annotated[list[_Moment], Meta(min_length=10, max_length=10)]


class Recorded(Strict):
    """Where a model was recorded; of torques with velocities and accelerations."""

    joint_range_rad: _Ranges
    joint_position_rad: list[list[float]]
    spacing_rad: Positive
    drivers: dict[str, tuple[float, float]]
    velocity_range_rad_per_s: _Ranges | None = None
    acceleration_range_rad_per_s2: _Ranges | None = None


class PerAxis(Strict):
    """A standard deviation per axis."""

    position_m: Positive
    orientation_rad: Positive


class PoseUncertainty(Strict):
    """How uncertain predictions of poses are."""

    sites: list[tuple[str, Count, Count]]
    covariance: list[float]
    left: PerAxis
    unseen: PerAxis
    noise: PerAxis
    recorded: Recorded
    typical: PerAxis | None = None


class Inertia(Strict):
    """Masses as estimated."""

    mass: list[_Mass]
    center_of_mass: list[_Point]
    payload_center: _Point
    gravity: _Gravity


class PoseModel(Strict):
    """What predictions of poses need."""

    arm: str
    kinematics: _Chain
    T_sensor_base: _Transform
    T_flange_tool: _Transform
    orientation: bool
    inertia: Inertia | None
    reference_temperature_degC: _Temperature  # noqa: N815 (the key)
    motion: Literal["static", "trajectory"]
    effects: list[Any]
    prismatic_joints: tuple[Number, ...] = ()
    joint_limits: _Limits | None = None
    accelerated: bool = False
    uncertainty: PoseUncertainty | None = None


class PoseReference(msgspec.Struct):
    """The reference that a diagnosis of poses is relative to."""

    file: str
    rigid: bool


class PoseDocument(msgspec.Struct, kw_only=True):
    """What is read of a diagnosis of poses beside its report."""

    model: PoseModel
    before: dict[str, Positive] = msgspec.field(default_factory=dict)
    after: dict[str, Positive] = msgspec.field(default_factory=dict)
    against: PoseReference | None = None


class TorqueUncertainty(Strict):
    """How uncertain predictions of torques are."""

    inertial: bool
    covariance: list[float]
    left_Nm: list[Positive]  # noqa: N815 (the key)
    unseen_Nm: list[Positive]  # noqa: N815 (the key)
    noise_Nm: list[Positive]  # noqa: N815 (the key)
    recorded: Recorded


class TorqueModel(Strict):
    """What predictions of torques need; `drives` has the fields `DRIVE_FIELDS` of an arm."""

    domain: Literal["torque"]
    arm: str
    kinematics: _Chain
    T_joint_flange: _Transform
    links: list[_Link]
    payload_center: _Point
    gravity: _Gravity
    joint_limits: _Limits
    reference_temperature_degC: _Temperature  # noqa: N815 (the key)
    effects: list[Any]
    prismatic_joints: tuple[Number, ...] = ()
    uncertainty: TorqueUncertainty | None = None
    drives: dict[str, list[float]] = msgspec.field(default_factory=dict)


class TorqueReference(msgspec.Struct):
    """The reference that a diagnosis of torques is compared with."""

    file: str
    by: Literal["rows", "effects"]


class TorqueDocument(msgspec.Struct, kw_only=True):
    """What is read of a diagnosis of torques beside its report."""

    model: TorqueModel
    against: TorqueReference | None = None


# ------------------------------------------------------------------ what types do not say


def check_pose_model(model: PoseModel) -> None:
    """Refuses transforms that are none, prismatic joints that the chain does not have, and negative masses.

    The lengths of lists that depend on each other, and the effects of the model, are checked where they are read.

    Raises:
        InputError: the message begins with the place.
    """
    for name in ("T_sensor_base", "T_flange_tool"):
        T = np.array(getattr(model, name), float)
        if not (frames.is_rotation(T[:3, :3]) and np.allclose(T[3], [0.0, 0.0, 0.0, 1.0], rtol=0, atol=1e-12)):
            raise InputError(f"model.{name} is no rigid transform")
    prismatic = model.prismatic_joints
    if prismatic != tuple(sorted(set(prismatic))) or any(joint > len(model.kinematics) for joint in prismatic):
        raise InputError("model.prismatic_joints are not joints of its chain in order")
    if model.inertia is not None:
        # the last mass contains by how much the payload is lighter than declared
        masses, known = model.inertia.mass, model.uncertainty
        lighter = known is not None and any(site[0] == "payload" for site in known.sites)
        for i, mass in enumerate(masses):
            if mass < 0 and not (lighter and i == len(masses) - 1):
                raise InputError(f"model.inertia.mass[{i}] is {mass:.6g}, which is negative")


def check_effect(effect: Effect, values: NDArray[np.floating], joints: int) -> None:
    """Refuses an effect that an arm of so many joints does not have, or numbers far beyond what they can be.

    Raises:
        InputError: the message begins with the effect.
    """
    if effect.joints_needed > joints:
        raise InputError(
            f"{effect.label}: is of an arm of {effect.joints_needed} joints or more, and this one has {joints}"
        )
    for coordinate, value in zip(effect.coordinates, values, strict=True):
        lower, upper = coordinate.lower, coordinate.upper
        if math.isfinite(lower) and math.isfinite(upper) and not effect.nonparametric:
            slack = LARGEST_MISFIT * (upper - lower)
        else:  # a coefficient of a curve
            slack, lower, upper = 0.0, *(sign * _BY_UNIT.get(coordinate.unit, math.inf) for sign in (-1, 1))
        if not lower - slack <= value <= upper + slack:
            bounds = f"between {lower - slack:.6g} and {upper + slack:.6g}"
            raise InputError(f"{effect.label}: {coordinate.name} is {value:.6g}, which is not {bounds}")
