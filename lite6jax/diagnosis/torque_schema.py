"""What a document of a diagnosis of torques may hold: keys, types and ranges."""

from collections.abc import Mapping
from typing import Any

from lite6jax import checksum
from lite6jax.arms.arm import DRIVE_FIELDS
from lite6jax.arms.description import LARGEST_MASS
from lite6jax.arms.entries import ANGLE_LIMIT, LENGTH_LIMIT
from lite6jax.diagnosis.schema import FARTHEST, INPUTS, SEARCHED_AGAIN
from lite6jax.errors import InputError
from lite6jax.recordings.settings import HIGHEST_TEMPERATURE, LARGEST_GRAVITY
from lite6jax.schema import Check, array, flag, items, mapping, number, one_of, optional, plain, record, text, whole

_LARGEST_MOMENT = LARGEST_MASS * LENGTH_LIMIT
_POSITIVE = number(0.0)
_BY_JOINT = array(None, lower=0.0)
_STATISTICS = ("mean", "rms", "p95", "max")
_UNITS = ("Nm", "N")
"""Of torques of revolute joints, and of forces of prismatic ones."""
_ERRORS = record(
    {"heldout_torque_rms_by_joint_Nm": _BY_JOINT},
    {f"heldout_torque_{name}_{unit}": _POSITIVE for name in _STATISTICS for unit in _UNITS},
)
_PLACE = {"effect": text, "site": text, "driver": text}
_RIVAL = record(
    {**_PLACE, "log_likelihood_gap": number(), "status": text},
    {"source_joint": whole(1), "order": number(), "period_m": number()},
)
_FINDING = record(
    {
        **_PLACE,
        "parameters": mapping(record({"value": number(), "std": _POSITIVE})),
        "p_value": number(0.0, 1.0),
        "log_likelihood_gain": number(),
        "confusable_with": items(_RIVAL),
    },
    {
        "nearest": record({**_PLACE, "share": number(0.0, 1.0)}),
        "described_by": record(
            {"share": number(0.0, 1.0), "effects": items(record({**_PLACE, "parameters": mapping(number())}))}
        ),
        "statement": text,
        **{f"{name}_{unit}": _POSITIVE for name in ("moves_rms", "peak_to_peak") for unit in _UNITS},
        "joints": items(whole(1)),
    },
)
_FAULT = record({"fault": text, "rows": items(whole(1)), "numbers": plain}, {"statement": text})
PARTS: Mapping[str, Check] = {
    "schema": text,
    "domain": one_of("torque"),
    "verdict": one_of("consistent", "explained", "partly_explained", "unnamed", "unexplained", "undetermined"),
    "before": _ERRORS,
    "after": _ERRORS,
    "left": record({"torque_over_noise": optional(_BY_JOINT), "white": flag}),
    "withdrawn": items(record(_PLACE)),
    "samples": whole(1),
    "kept_samples": whole(1),
    "heldout_blocks": whole(1),
    "searched_again": SEARCHED_AGAIN,
    "quick": flag,
    "inputs": INPUTS,
    "filter": optional(
        record({"rate_Hz": _POSITIVE, "cutoff_Hz": _POSITIVE, "motion_cutoff_Hz": _POSITIVE, "every": whole(1)})
    ),
    "noise": record({"declared_torque_Nm": optional(_BY_JOINT), "estimated_torque_Nm": _BY_JOINT}),
    "torque_source": text,
    "date": optional(text),
    "instrument": optional(text),
    "data_faults": items(_FAULT),
    "ruled_out": items(_FAULT),
    "findings": items(_FINDING),
    "nearest": optional(record({"effect": text, "site": text, "p_value": number(0.0, 1.0)})),
    "untestable": items(record(_PLACE, {"reason": text})),
    "confounded": items(record(_PLACE)),
    "nuisance": record({"numbers": whole(0), "relative_std": optional(_POSITIVE)}),
    "against": record(
        {"file": text, "by": one_of("rows", "effects")},
        {
            "rows": whole(0),
            "matched_rows": whole(0),
            "apart_rms_by_joint_Nm": _BY_JOINT,
            "reference_rms_by_joint_Nm": _BY_JOINT,
            "differences": items(plain),
            "statement": text,
        },
    ),
    checksum.KEY: text,
}
"""The keys beside the model."""
RANGES = ("joint_range_rad", "velocity_range_rad_per_s", "acceleration_range_rad_per_s2")
"""Of the motion that was recorded."""
_UNCERTAINTY = record(
    {
        "inertial": flag,
        "covariance": array(None),
        "left_Nm": _BY_JOINT,
        "unseen_Nm": _BY_JOINT,
        "noise_Nm": _BY_JOINT,
        "curves_Nm": items(optional(_POSITIVE)),
        "recorded": record(
            {
                **dict.fromkeys(RANGES, array(None, 2)),
                "joint_position_rad": array(None, None),
                "spacing_rad": _POSITIVE,
                "drivers": mapping(array(2)),
            }
        ),
    }
)
_MODEL = record(
    {
        "domain": one_of("torque"),
        "arm": text,
        "kinematics": array(None, 6, lower=-max(LENGTH_LIMIT, ANGLE_LIMIT), upper=max(LENGTH_LIMIT, ANGLE_LIMIT)),
        "T_joint_flange": array(4, 4, lower=-FARTHEST, upper=FARTHEST),
        "links": array(None, 10, lower=-_LARGEST_MOMENT, upper=_LARGEST_MOMENT),
        "payload_center": array(3, lower=-LENGTH_LIMIT, upper=LENGTH_LIMIT),
        "gravity": array(3, lower=-LARGEST_GRAVITY, upper=LARGEST_GRAVITY),
        "joint_limits": array(None, 2, lower=-FARTHEST, upper=FARTHEST),
        "reference_temperature_degC": number(-273.15, HIGHEST_TEMPERATURE),
        "effects": items(plain),
    },
    {
        "prismatic_joints": items(whole(1)),
        "uncertainty": optional(_UNCERTAINTY),
        "drives": record({}, dict.fromkeys(DRIVE_FIELDS, array(None))),
    },
)


def check_torques(document: Mapping[str, Any]) -> None:
    """Refuses a document in which something is of another type, impossible or unknown.

    The lengths of lists that depend on each other, and the effects of the model, are checked where they are read.

    Raises:
        InputError: the message begins with the place.
    """
    for key, value in document.items():
        if key == "model":
            continue
        if key not in PARTS:
            raise InputError(f"the key {key!r} is unknown")
        PARTS[key](value, key)
    _MODEL(document["model"], "model")
