"""The sentences about data faults of torque recordings, one for each code, found or not."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from lite6jax.arms.joint_units import joint_unit

Numbers = Mapping[str, Any]

NAMES = {
    "uneven_times": "Uneven times",
    "velocity_bias": "Velocity with a bias",
    "velocity_dead_zone": "Velocity with a dead zone",
    "torque_spikes": "Single torques far from their neighbours",
    "swapped_torques": "Swapped torque columns",
    "reversed_torque": "Torque of reversed sign",
    "swapped_positions": "Swapped columns of joint positions",
    "swapped_columns": "Swapped joints",
    "reversed_positions": "Position of reversed sign",
    "reversed_joint": "Joint of reversed sign",
    "coupled_positions": "Coupled joint positions",
    "joint_zero": "Joint with another zero",
    "wrong_gravity": "Gravity in another direction",
    "no_gravity": "Torques without gravity",
    "undecided_torques": "Undecided contradiction of torques",
    "wrong_torque_constant": "Wrong torque constant or gear ratio",
    "held_by_friction": "Joints held at rest by friction",
    "contact": "Contact",
    "estimated_torque": "Torques without noise",
}
"""Each fault in a few words."""


def _joints(numbers: Sequence[int]) -> str:
    *first, last = [str(number) for number in numbers]
    return f"joint {last}" if not first else f"joints {', '.join(first)} and {last}"


def _spikes(rows: Sequence[int], n: Numbers) -> str:
    torques = "1 torque is" if n["count"] == 1 else f"{n['count']} torques are"
    return (
        f"{torques} far from the row before and the row after ({_joints(n['joints'])}), which no motion causes. They "
        "were interpolated. Check the transmission of the torques."
    )


def _uneven(rows: Sequence[int], n: Numbers) -> str:
    steps = f"Time steps vary, most of them from {1e3 * n['from_s']:.3g} to {1e3 * n['to_s']:.3g} ms"
    if n["reason"] == "stamps":
        return (
            f"{steps}, but the positions are smooth over the number of the row: the stamps jitter, not the samples. "
            f"The times were made even, {n['rate_Hz']:.3g} a second."
        )
    gaps = "" if not n["gaps"] else f" {n['gaps']} gaps were too long to interpolate and begin a new run."
    doubt = ", ".join(f"{size:.2g}" for size in n["rms_Nm"])
    return (
        f"{steps}. The recording was resampled to {n['rate_Hz']:.3g} a second by interpolation. Every other torque is "
        f"within {doubt} Nm (RMS, by joint) of what its neighbours give, noise included.{gaps}"
    )


def _bias(rows: Sequence[int], n: Numbers) -> str:
    biases = ", ".join(f"{1e3 * bias:.2g}" for bias in n["bias_rad_per_s"])
    return (
        f"The velocity of {_joints(n['joints'])} has a bias of {biases} mrad/s (mm/s of a slide): it reads that where "
        "the position stands still, and exceeds the way gone by as much. It was subtracted."
    )


def _swapped(rows: Sequence[int], n: Numbers) -> str:
    pairs = ", ".join(f"tau{c} is that of joint {j}" for j, c in zip(n["joints"], n["columns"], strict=True))
    return f"The torque columns are swapped: {pairs}, by the weight and the motion of the arm. They were exchanged."


def _dead_zone(rows: Sequence[int], n: Numbers) -> str:
    widths = ", ".join(f"{1e3 * width:.2g} mrad/s" for width in n["width_rad_per_s"])
    return (
        f"The velocity of {_joints(n['joints'])} reads nothing below {widths}, while the positions go on. There the "
        "slope of the positions was taken."
    )


def _reversed(rows: Sequence[int], n: Numbers) -> str:
    return (
        f"The torque of {_joints(n['joints'])} has its sign reversed: it is the opposite of what the weight and the "
        "motion of the arm require. Its sign was changed. A torque is what the motor exerts about +z of its joint."
    )


def _swapped_positions(rows: Sequence[int], n: Numbers) -> str:
    return (
        f"The positions of {_joints(n['joints'])} are exchanged, the torques are not: these fit the arm with "
        "these columns exchanged. They were exchanged. Check the order of the columns."
    )


def _swapped_columns(rows: Sequence[int], n: Numbers) -> str:
    return (
        f"{_joints(n['joints']).capitalize()} are exchanged, positions and torques: torques fit the arm with these "
        "columns exchanged. They were exchanged. Check the order of the joints."
    )


def _reversed_positions(rows: Sequence[int], n: Numbers) -> str:
    return (
        f"The position of {_joints(n['joints'])} has its sign reversed, its torque has not: torques fit the arm with "
        "the opposite position. Its sign was changed. Positions count about +z of the joint in the description."
    )


def _reversed_joint(rows: Sequence[int], n: Numbers) -> str:
    return (
        f"Position and torque of {_joints(n['joints'])} have their signs reversed: the driver's axis points the other "
        "way than that of the description. The signs were changed. Correct the file, or the axis in the description."
    )


def _coupled_positions(rows: Sequence[int], n: Numbers) -> str:
    sign = "plus" if n["factor"] > 0 else "less"
    return (
        f"Torques fit the arm with the position of joint {n['joint']} {sign} that of joint {n['added_joint']}: the "
        "motors of both are coupled, and the file has the motor's angle. The sum was taken."
    )


def _joint_zero(rows: Sequence[int], n: Numbers) -> str:
    degrees = float(np.rad2deg(n["added_rad"]))
    return (
        f"The zero of joint {n['joint']} is off by {-degrees:.3g}° from the description's: torques fit the arm with "
        f"{degrees:+.3g}° added to its position. They were added. Check its encoder's zero, or the angle (90° are "
        "mostly another convention) at which the description has it."
    )


def _no_gravity(rows: Sequence[int], n: Numbers) -> str:
    return (
        "The torques do not hold the weight of the arm: gravity's share was subtracted, or the arm is balanced. They "
        "were compared without gravity, so that masses show in accelerations alone. Take the torques of the motors, or "
        "declare gravity_m_per_s2: [0, 0, 0] in the sidecar."
    )


def _undecided(rows: Sequence[int], n: Numbers) -> str:
    readings = "; or ".join(" and ".join(_CLAUSES[part["fault"]](part) for part in one) for one in n["alternatives"])
    return (
        f"The torques contradict the arm, and {len(n['alternatives'])} corrections explain that alike: {readings}. "
        "Nothing was corrected, so that what is found beside this is not to be trusted. Find out which it is, and "
        "correct the file."
    )


def _of_joints(what: str) -> Callable[[Numbers], str]:
    return lambda n: f"{what} of {_joints(n['joints'])}"


_CLAUSES: dict[str, Callable[[Numbers], str]] = {
    "swapped_torques": _of_joints("exchanged torques"),
    "reversed_torque": _of_joints("a reversed torque"),
    "swapped_positions": _of_joints("exchanged positions"),
    "swapped_columns": _of_joints("exchanged columns"),
    "reversed_positions": _of_joints("a reversed position"),
    "reversed_joint": _of_joints("reversed signs of position and torque"),
    "coupled_positions": lambda n: f"the position of joint {n['joint']} coupled to joint {n['added_joint']}",
    "joint_zero": lambda n: f"the zero of joint {n['joint']} off by {-np.rad2deg(n['added_rad']):.3g}°",
    "wrong_gravity": lambda n: f"gravity along ({', '.join(f'{g:g}' for g in n['found_m_per_s2'])}) m/s²",
    "no_gravity": lambda n: "torques without gravity",
    "wrong_torque_constant": lambda n: " and ".join(
        f"a factor of {factor:.3g} in the torque of joint {joint}"
        for joint, factor in zip(n["joints"], n["factors"], strict=True)
    ),
    "torque_unit": lambda n: "another unit of all torques",
}
"""What is wrong, of a fault's numbers, within a list of corrections that explain the torques alike."""


def _contact(rows: Sequence[int], n: Numbers) -> str:
    sizes = [f"{n[f'largest_{unit}']:.3g} {unit}" for unit in ("Nm", "N") if f"largest_{unit}" in n]
    return (
        f"From {n['from_s']:.2f} to {n['to_s']:.2f} s the arm was in contact with something: the torque of "
        f"{_joints(n['joints']) if n['joints'] else 'the arm'} differs by up to "
        f"{' and '.join(sizes)} from the model, in these rows only. They were left out."
    )


def _estimated(rows: Sequence[int], n: Numbers) -> str:
    shown = (
        "have neither noise nor any friction" if n.get("reason") == "no_friction" else "of the arm at rest are constant"
    )
    return (
        f"The torques {shown}: they are the controller's own model, not measurements. What is "
        "found is what that model lacks or has beyond this arm's. Record motor currents, or declare torque_source."
    )


def _gravity(rows: Sequence[int], n: Numbers) -> str:
    declared, found = (", ".join(f"{value:g}" for value in n[f"{name}_m_per_s2"]) for name in ("declared", "found"))
    return (
        f"Gravity is declared as ({declared}) m/s² in the base frame, and acts as ({found}) m/s²: the base is turned "
        f"by {np.rad2deg(n['tilt_rad']):.0f}° from what is declared, like that of an arm on a wall or a ceiling. The "
        f"gravity found was used. Declare gravity_m_per_s2: [{found}] in the sidecar."
    )


def _constant(rows: Sequence[int], n: Numbers) -> str:
    pairs = zip(n["joints"], n["factors"], strict=True)
    said = " and ".join(f"that of joint {joint} {factor:g} times" for joint, factor in pairs)
    remedy = "Check the gear ratio and the torque constant from which the torques were computed."
    if n["constants_Nm_per_A"] is not None:
        constants = zip(n["joints"], n["constants_Nm_per_A"], strict=True)
        declared = " and ".join(f"{constant:.3g} for joint {joint}" for joint, constant in constants)
        remedy = f"Declare torque_constant_Nm_per_A {declared}, or check the gear ratio in it."
    one = len(n["joints"]) == 1
    subject, it = (
        ("A torque is", "It was divided by this") if one else ("Torques are", "They were divided by these factors")
    )
    return f"{subject} not what the weight and the motion of the arm require, but {said} as much. {it}. {remedy}"


def _held(rows: Sequence[int], n: Numbers) -> str:
    pairs = zip(n["joints"], n["std_Nm"], strict=True)
    slides = n.get("prismatic_joints", ())
    bands = ", ".join(f"{std:.2g} {joint_unit('Nm', joint in slides)} at joint {joint}" for joint, std in pairs)
    return (
        "At rest, friction holds a joint wherever it stands, and the torque is indeterminate within a band (one sigma: "
        f"{bands}). These rows have little weight for {_joints(n['joints'])}. Record more motion."
    )


FOUND: dict[str, Callable[[Sequence[int], Numbers], str]] = {
    "uneven_times": _uneven,
    "velocity_bias": _bias,
    "velocity_dead_zone": _dead_zone,
    "torque_spikes": _spikes,
    "swapped_torques": _swapped,
    "reversed_torque": _reversed,
    "swapped_positions": _swapped_positions,
    "swapped_columns": _swapped_columns,
    "reversed_positions": _reversed_positions,
    "reversed_joint": _reversed_joint,
    "coupled_positions": _coupled_positions,
    "joint_zero": _joint_zero,
    "wrong_gravity": _gravity,
    "no_gravity": _no_gravity,
    "undecided_torques": _undecided,
    "wrong_torque_constant": _constant,
    "held_by_friction": _held,
    "contact": _contact,
    "estimated_torque": _estimated,
}
"""What is wrong and how it was corrected, of rows and numbers."""
RULED_OUT: dict[str, Callable[[Numbers], str]] = {
    "swapped_torques": lambda n: "No torque columns are swapped, and none has its sign reversed.",
    "wrong_gravity": lambda n: "Gravity acts along the declared direction, but for a tilt of the base.",
    "wrong_torque_constant": lambda n: (
        "No torque differs by a factor, as another torque constant or gear ratio causes."
    ),
    "joint_zero": lambda n: "No joint has another zero, sign or place than in the description, as far as torques show.",
}
"""Why a fault is not there."""
