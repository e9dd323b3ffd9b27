"""What a diagnosis document may hold: keys, types and ranges, with the checks that an `Arm` has."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lite6jax import checksum
from lite6jax.arms import frames
from lite6jax.arms.description import LARGEST_MASS
from lite6jax.arms.entries import ANGLE_LIMIT, LENGTH_LIMIT
from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError
from lite6jax.recordings.settings import HIGHEST_TEMPERATURE, LARGEST_GRAVITY
from lite6jax.schema import (
    Check,
    array,
    flag,
    items,
    mapping,
    number,
    one_of,
    optional,
    plain,
    record,
    text,
    whole,
)

FARTHEST = 1e4
"""m; a sensor stands no further from the arm, and nothing on a flange is larger."""
LARGEST_MISFIT = 10.0
"""Multiples of the range of a number of an effect, beyond which it is damaged; estimates scatter about the range."""

_LARGEST = (LENGTH_LIMIT, ANGLE_LIMIT)
_BY_UNIT = {"m": LENGTH_LIMIT, "rad": ANGLE_LIMIT}
_POSITIVE = number(0.0)
_SHARE = number(0.0, 1.0)
_ERRORS = record(
    {},
    {
        f"heldout_{name}_{statistic}_{unit}": _POSITIVE
        for name, unit in (("position", "m"), ("orientation", "rad"))
        for statistic in ("mean", "rms", "p95", "max")
    },
)
INPUTS = items(record({"role": text, "file": text, "sha256": text}))
"""Of both kinds of documents: the files that were read."""
_ESTIMATE = record({"value": number(), "std": _POSITIVE})
_PLACE: Mapping[str, Check] = {"effect": text, "site": text, "driver": text}
_FAULT = record({"fault": text, "rows": items(whole(1)), "numbers": plain}, {"statement": text})
_RIVAL = record(
    {"effect": text, "site": text, "log_likelihood_gap": number()},
    {
        "driver": text,
        "status": one_of("rejected", "found", "separable", "undecided", "equivalent"),
        "order": optional(number()),
        "source_joint": optional(whole(1)),
    },
)
_FINDING = record(
    {**_PLACE, "parameters": mapping(_ESTIMATE), "p_value": number(0.0, 1.0), "log_likelihood_gain": number()},
    {
        "moves_rms_m": _POSITIVE,
        "moves_rms_rad": optional(_POSITIVE),
        "heldout_rms_before_m": _POSITIVE,
        "heldout_rms_after_m": _POSITIVE,
        "confusable_with": items(_RIVAL),
        "peak_to_peak": mapping(_ESTIMATE),
        "effective_parameters": number(),
        "payload_share": _SHARE,
        "nearest": record({**_PLACE, "share": number(0.0, 1.0)}),
        "statement": text,
    },
)
SEARCHED_AGAIN = optional(record({"blocks": whole(1), "heldout_ratio": _POSITIVE}))
_PARTS: Mapping[str, Check] = {
    "schema": text,
    "verdict": one_of("consistent", "explained", "partly_explained", "unnamed", "unexplained", "undetermined"),
    "before": _ERRORS,
    "after": _ERRORS,
    "left": record(
        {"position_over_noise": optional(_POSITIVE), "orientation_over_noise": optional(_POSITIVE), "white": flag},
        {"acts_at": optional(record({"site": text, "share": _SHARE, "share_of_noise": _SHARE}))},
    ),
    "quality": record(
        {
            "verdict": one_of("good", "above_noise", "bad"),
            "reason": optional(one_of("too_far", "unrelated")),
            "error_m": optional(_POSITIVE),
            "limit_m": _POSITIVE,
            "explained_share": optional(number(upper=1.0)),
        }
    ),
    "withdrawn": optional(
        record(
            {
                "effects": items(record(_PLACE)),
                "heldout_position_rms_m": record({"before": _POSITIVE, "after": _POSITIVE}),
            }
        )
    ),
    "rows_needed": optional(whole(1)),
    "samples": whole(1),
    "left_out": items(whole(1)),
    "heldout_rows": whole(0),
    "heldout_blocks": whole(1),
    "searched_again": SEARCHED_AGAIN,
    "quick": flag,
    "pose_source": text,
    "date": optional(text),
    "instrument": optional(text),
    "inputs": INPUTS,
    "noise": record(
        {"declared_position_m": optional(_POSITIVE), "estimated_position_m": _POSITIVE},
        {"declared_orientation_rad": optional(_POSITIVE)},
    ),
    "data_faults": items(_FAULT),
    "ruled_out": items(_FAULT),
    "findings": items(_FINDING),
    "nearest": optional(record({"effect": text, "site": text, "p_value": number(0.0, 1.0)})),
    "separating_poses": items(record({"effects": items(text), "joint_position_rad": array(None, None)})),
    "untestable": items(record(_PLACE, {"reason": text})),
    "confounded": items(record(_PLACE)),
    "nuisance": record({"numbers": whole(0), "parts": items(text)}),
    "against": record(
        {"file": text},
        {
            **{key: whole(0) for key in ("rows", "matched_rows")},
            **dict.fromkeys(("position_rms_m", "position_max_m", "left_position_rms_m"), _POSITIVE),
            "reproduced": flag,
            "rigid": optional(flag),
            "differences": items(plain),
            "notes": items(plain),
            "statement": text,
        },
    ),
    "torques": plain,  # whose own schema is that of a diagnosis of torques
    "torques_refused": text,
    "shared": items(
        record(
            {
                "quantity": one_of("payload_mass", "gravity_direction", "clock_offset", "load"),
                "poses": optional(record({"found": flag, "parameters": mapping(_ESTIMATE)})),
                "torques": optional(record({"found": flag, "parameters": mapping(_ESTIMATE)})),
                "p_value": optional(number(0.0, 1.0)),
                "agree": optional(flag),
            },
            {"joint": whole(1), "statement": text},
        )
    ),
    checksum.KEY: text,
}
_READ = ("before", "after")
_PER_AXIS = record({"position_m": _POSITIVE, "orientation_rad": _POSITIVE})


def _site(value: Any, place: str) -> None:
    """A number of the nuisance: what it is of, of which joint or frame, and which number of that."""
    items(plain, 3)(value, place)
    for k, check in enumerate((text, whole(0), whole(0))):
        check(value[k], f"{place}[{k}]")


_UNCERTAINTY = record(
    {
        "sites": items(_site),
        "covariance": array(None),
        "left": _PER_AXIS,
        "unseen": _PER_AXIS,
        "noise": _PER_AXIS,
        "curves": items(optional(_PER_AXIS)),
        "recorded": record(
            {
                "joint_range_rad": array(None, 2),
                "joint_position_rad": array(None, None),
                "spacing_rad": _POSITIVE,
                "drivers": mapping(array(2)),
            }
        ),
    },
    {"typical": optional(_PER_AXIS)},
)
_MODEL = record(
    {
        "arm": text,
        "kinematics": array(None, 6),
        "T_sensor_base": array(4, 4, lower=-FARTHEST, upper=FARTHEST),
        "T_flange_tool": array(4, 4, lower=-FARTHEST, upper=FARTHEST),
        "orientation": flag,
        "inertia": optional(
            record(
                {
                    "mass": array(None, lower=-LARGEST_MASS, upper=LARGEST_MASS),
                    "center_of_mass": array(None, 3, lower=-LENGTH_LIMIT, upper=LENGTH_LIMIT),
                    "payload_center": array(3, lower=-LENGTH_LIMIT, upper=LENGTH_LIMIT),
                    "gravity": array(3, lower=-LARGEST_GRAVITY, upper=LARGEST_GRAVITY),
                }
            )
        ),
        "reference_temperature_degC": number(-273.15, HIGHEST_TEMPERATURE),
        "motion": one_of("static", "trajectory"),
        "effects": items(plain),
    },
    {
        "prismatic_joints": items(whole(1)),
        "joint_limits": optional(array(None, 2, lower=-FARTHEST, upper=FARTHEST)),
        "accelerated": flag,
        "uncertainty": optional(_UNCERTAINTY),
    },
)


def check_parts(document: Mapping[str, Any], whole: bool = True) -> None:
    """Refuses a document in which something beside the model is of another type, impossible or unknown.

    Args:
        document: all of it.
        whole: whether all parts are checked; else only those that are read, as of version 1, whose others differ.

    Raises:
        InputError: the message begins with the place.
    """
    for key, value in document.items():
        if key == "model" or not (whole or key in _READ):
            continue
        if key not in _PARTS:
            raise InputError(f"the key {key!r} is unknown")
        _PARTS[key](value, key)


def check_model(model: Mapping[str, Any]) -> None:
    """Refuses a model with numbers or types that none has.

    The lengths of its lists that depend on each other, and the numbers of its effects, are checked where they are read.

    Raises:
        InputError: the message begins with the place.
    """
    _MODEL(model, "model")
    for i, row in enumerate(model["kinematics"]):
        for k, value in enumerate(row):
            number(-_LARGEST[k // 3], _LARGEST[k // 3])(value, f"model.kinematics[{i}][{k}]")
    for name in ("T_sensor_base", "T_flange_tool"):
        T = np.array(model[name], float)
        if not (frames.is_rotation(T[:3, :3]) and np.allclose(T[3], [0.0, 0.0, 0.0, 1.0], rtol=0, atol=1e-12)):
            raise InputError(f"model.{name} is no rigid transform")
    prismatic = model.get("prismatic_joints", [])
    if prismatic != sorted(set(prismatic)) or any(joint > len(model["kinematics"]) for joint in prismatic):
        raise InputError("model.prismatic_joints are not joints of its chain in order")
    if model["inertia"] is not None:
        _check_masses(model)


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
        number(lower - slack, upper + slack)(float(value), f"{effect.label}: {coordinate.name}")


def _check_masses(model: Mapping[str, Any]) -> None:
    """No mass is negative, but the last where it contains by how much the payload is lighter than declared."""
    masses, uncertainty = model["inertia"]["mass"], model.get("uncertainty")
    lighter = uncertainty is not None and any(site[:1] == ["payload"] for site in uncertainty["sites"])
    for i, mass in enumerate(masses):
        if mass < 0 and not (lighter and i == len(masses) - 1):
            raise InputError(f"model.inertia.mass[{i}] is {mass:.6g}, which is negative")
