"""What a document of a diagnosis may hold, of poses and of torques: its keys, and the types and ranges of values."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.arms.arm import DRIVE_FIELDS
from lite6jax.arms.description import LARGEST_MASS
from lite6jax.arms.entries import ANGLE_LIMIT, LENGTH_LIMIT
from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError
from lite6jax.recordings.settings import HIGHEST_TEMPERATURE, LARGEST_GRAVITY
from lite6jax.schema import ESTIMATE, PLACE, Count, Number, Positive, Share, check, record

FARTHEST = 1e4
"""m; a sensor stands no further from the arm, and nothing on a flange is larger."""
LARGEST_MISFIT = 10.0
"""Multiples of the range of a number of an effect, beyond which it is damaged; estimates scatter about the range."""
RANGES = ("joint_range_rad", "velocity_range_rad_per_s", "acceleration_range_rad_per_s2")
"""Of what was recorded; of poses the first alone."""

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
_AtMostOne: Any = Annotated[float, Meta(le=1.0)]
_Point = tuple[_Length, _Length, _Length]
_Gravity = tuple[_Acceleration, _Acceleration, _Acceleration]
_Chain = list[tuple[_Length, _Length, _Length, _Angle, _Angle, _Angle]]
_Row = tuple[_Far, _Far, _Far, _Far]
_Transform = tuple[_Row, _Row, _Row, _Row]
_Limits = list[tuple[_Far, _Far]]
_Ranges = list[tuple[float, float]]
_Link = Annotated[list[_Moment], Meta(min_length=10, max_length=10)]

_PLACED = record(PLACE)
_FAULT = record({"fault": str, "rows": list[Number], "numbers": Any}, {"statement": str})
_FILE = record({"role": str, "file": str, "sha256": str})
_UNTESTABLE = record(PLACE, {"reason": str})
_RIVAL = record(
    {"effect": str, "site": str, "log_likelihood_gap": float},
    {
        "driver": str,
        "status": Literal["rejected", "found", "separable", "undecided", "equivalent"],
        "order": float | None,
        "source_joint": Number | None,
        "component": str,
        "period_m": float,
    },
)
_DESCRIBING = record(PLACE | {"parameters": dict[str, float]})
_FINDING = PLACE | {"parameters": dict[str, ESTIMATE], "p_value": Share, "log_likelihood_gain": float}
_FURTHER = {"confusable_with": list[_RIVAL], "nearest": record(PLACE | {"share": Share}), "statement": str}
_SHARED: dict[str, Any] = {
    "schema": str,
    "verdict": Verdict,
    "samples": Number,
    "heldout_blocks": Number,
    "searched_again": record({"blocks": Number, "heldout_ratio": Positive}) | None,
    "quick": bool,
    "inputs": list[_FILE],
    "date": str | None,
    "instrument": str | None,
    "data_faults": list[_FAULT],
    "ruled_out": list[_FAULT],
    "nearest": record({"effect": str, "site": str, "p_value": Share}) | None,
    "untestable": list[_UNTESTABLE],
    "confounded": list[_PLACED],
}
"""Keys of both domains."""

# ------------------------------------------------------------------ poses

_STATISTICS = ("mean", "rms", "p95", "max")
_ERRORS = record(
    {},
    {
        f"heldout_{name}_{statistic}_{unit}": Positive
        for name, unit in (("position", "m"), ("orientation", "rad"))
        for statistic in _STATISTICS
    },
)
_PER_AXIS = record({"position_m": Positive, "orientation_rad": Positive})
_RECORDED: dict[str, Any] = {
    "joint_range_rad": _Ranges,
    "joint_position_rad": list[list[float]],
    "spacing_rad": Positive,
    "drivers": dict[str, tuple[float, float]],
}
_POSE_UNCERTAINTY = record(
    {
        "sites": list[tuple[str, Count, Count]],
        "covariance": list[float],
        **dict.fromkeys(("left", "unseen", "noise"), _PER_AXIS),
        "recorded": record(_RECORDED),
    },
    {"typical": _PER_AXIS | None},
)
_INERTIA = record(
    {"mass": list[_Mass], "center_of_mass": list[_Point], "payload_center": _Point, "gravity": _Gravity},
)
POSE_MODEL = record(
    {
        "arm": str,
        "kinematics": _Chain,
        "T_sensor_base": _Transform,
        "T_flange_tool": _Transform,
        "orientation": bool,
        "inertia": _INERTIA | None,
        "reference_temperature_degC": _Temperature,
        "motion": Literal["static", "trajectory"],
        "effects": list[Any],
    },
    {
        "prismatic_joints": list[Number],
        "joint_limits": _Limits | None,
        "accelerated": bool,
        "uncertainty": _POSE_UNCERTAINTY | None,
    },
)
_POSE_FINDING = record(
    _FINDING,
    {
        **_FURTHER,
        "moves_rms_m": Positive,
        "moves_rms_rad": Positive | None,
        "heldout_rms_before_m": Positive,
        "heldout_rms_after_m": Positive,
        "peak_to_peak": dict[str, ESTIMATE],
        "effective_parameters": float,
        "payload_share": Share,
    },
)
_SIDE = record({"found": bool, "parameters": dict[str, ESTIMATE]})
_SEPARATING = record({"effects": list[str], "joint_position_rad": list[list[float]]})
_COMMON = record(
    {
        "quantity": Literal["payload_mass", "gravity_direction", "clock_offset", "load"],
        "poses": _SIDE | None,
        "torques": _SIDE | None,
        "p_value": Share | None,
        "agree": bool | None,
    },
    {"joint": Number, "statement": str},
)
_WITHDRAWN = record(
    {"effects": list[_PLACED], "heldout_position_rms_m": record({"before": Positive, "after": Positive})}
)
_READ: dict[str, Any] = {"before": _ERRORS, "after": _ERRORS}
POSE_DOCUMENT = record(
    {"model": POSE_MODEL},
    {
        **_SHARED,
        **_READ,
        "left": record(
            {"position_over_noise": Positive | None, "orientation_over_noise": Positive | None, "white": bool},
            {"acts_at": record({"site": str, "share": Share, "share_of_noise": Share}) | None},
        ),
        "quality": record(
            {
                "verdict": Literal["good", "above_noise", "bad"],
                "reason": Literal["too_far", "unrelated"] | None,
                "error_m": Positive | None,
                "limit_m": Positive,
                "explained_share": _AtMostOne | None,
            }
        ),
        "withdrawn": _WITHDRAWN | None,
        "rows_needed": Number | None,
        "left_out": list[Number],
        "heldout_rows": Count,
        "pose_source": str,
        "noise": record(
            {"declared_position_m": Positive | None, "estimated_position_m": Positive},
            {"declared_orientation_rad": Positive | None},
        ),
        "findings": list[_POSE_FINDING],
        "separating_poses": list[_SEPARATING],
        "nuisance": record({"numbers": Count, "parts": list[str]}),
        "against": record(
            {"file": str},
            {
                **dict.fromkeys(("rows", "matched_rows"), Count),
                **dict.fromkeys(("position_rms_m", "position_max_m", "left_position_rms_m"), Positive),
                "reproduced": bool,
                "rigid": bool | None,
                **dict.fromkeys(("differences", "notes"), list[Any]),
                "statement": str,
            },
        ),
        "torques": Any,  # a whole document, which is checked by itself
        "torques_refused": str,
        "shared": list[_COMMON],
    },
)

# ------------------------------------------------------------------ torques

_UNITS = ("Nm", "N")
"""Of torques of revolute joints, and of forces of prismatic ones."""
_BY_JOINT = list[Positive]
_TORQUE_ERRORS = record(
    {"heldout_torque_rms_by_joint_Nm": _BY_JOINT},
    {f"heldout_torque_{name}_{unit}": Positive for name in _STATISTICS for unit in _UNITS},
)
_FILTER = record({"rate_Hz": Positive, "cutoff_Hz": Positive, "motion_cutoff_Hz": Positive, "every": Number})
_TORQUE_UNCERTAINTY = record(
    {
        "inertial": bool,
        "covariance": list[float],
        **dict.fromkeys(("left_Nm", "unseen_Nm", "noise_Nm"), _BY_JOINT),
        "recorded": record(_RECORDED | dict.fromkeys(RANGES, _Ranges)),
    }
)
TORQUE_MODEL = record(
    {
        "domain": Literal["torque"],
        "arm": str,
        "kinematics": _Chain,
        "T_joint_flange": _Transform,
        "links": list[_Link],
        "payload_center": _Point,
        "gravity": _Gravity,
        "joint_limits": _Limits,
        "reference_temperature_degC": _Temperature,
        "effects": list[Any],
    },
    {
        "prismatic_joints": list[Number],
        "uncertainty": _TORQUE_UNCERTAINTY | None,
        "drives": record({}, dict.fromkeys(DRIVE_FIELDS, list[float])),
    },
)
_TORQUE_FINDING = record(
    _FINDING,
    {
        **_FURTHER,
        "described_by": record({"share": Share, "effects": list[_DESCRIBING]}),
        **{f"{name}_{unit}": Positive for name in ("moves_rms", "peak_to_peak") for unit in _UNITS},
        "joints": list[Number],
    },
)
TORQUE_DOCUMENT = record(
    {"model": TORQUE_MODEL},
    {
        **_SHARED,
        "domain": Literal["torque"],
        "before": _TORQUE_ERRORS,
        "after": _TORQUE_ERRORS,
        "left": record({"torque_over_noise": _BY_JOINT | None, "white": bool}),
        "withdrawn": list[_PLACED],
        "kept_samples": Number,
        "filter": _FILTER | None,
        "noise": record({"declared_torque_Nm": _BY_JOINT | None, "estimated_torque_Nm": _BY_JOINT}),
        "torque_source": str,
        "findings": list[_TORQUE_FINDING],
        "nuisance": record({"numbers": Count, "relative_std": Positive | None}),
        "against": record(
            {"file": str, "by": Literal["rows", "effects"]},
            {
                **dict.fromkeys(("rows", "matched_rows"), Count),
                **dict.fromkeys(("apart_rms_by_joint_Nm", "reference_rms_by_joint_Nm"), _BY_JOINT),
                "differences": list[Any],
                "statement": str,
            },
        ),
    },
)

# ------------------------------------------------------------------ what types do not say


def check_poses(document: Mapping[str, Any], whole: bool = True) -> None:
    """Refuses a diagnosis of poses in which something is of another type, impossible or unknown.

    The lengths of lists that depend on each other, and the effects of the model, are checked where they are read.

    Args:
        document: with a model.
        whole: whether everything is checked; else the model and the errors alone.

    Raises:
        InputError: the message begins with the place.
    """
    model = document["model"]
    if whole:
        check(document, POSE_DOCUMENT)
    else:
        check({key: document[key] for key in ("model", *_READ) if key in document}, POSE_DOCUMENT)
    for name in ("T_sensor_base", "T_flange_tool"):
        T = np.array(model[name], float)
        if not (frames.is_rotation(T[:3, :3]) and np.allclose(T[3], [0.0, 0.0, 0.0, 1.0], rtol=0, atol=1e-12)):
            raise InputError(f"model.{name} is no rigid transform")
    prismatic = model.get("prismatic_joints", [])
    if prismatic != sorted(set(prismatic)) or any(joint > len(model["kinematics"]) for joint in prismatic):
        raise InputError("model.prismatic_joints are not joints of its chain in order")
    if model["inertia"] is not None:
        # the last mass contains by how much the payload is lighter than declared
        masses, uncertainty = model["inertia"]["mass"], model.get("uncertainty")
        lighter = uncertainty is not None and any(site[0] == "payload" for site in uncertainty["sites"])
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
