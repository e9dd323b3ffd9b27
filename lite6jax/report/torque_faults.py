"""The sentences about data faults of torque recordings, one for each code, found or not."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from lite6jax.arms.joint_units import joint_unit

Numbers = Mapping[str, Any]

NAMES = {
    "uneven_times": "Uneven times",
    "torque_spikes": "Single torques far from their neighbours",
    "swapped_torques": "Swapped torque columns",
    "reversed_torque": "Torque of reversed sign",
    "wrong_gravity": "Gravity in another direction",
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


def _swapped(rows: Sequence[int], n: Numbers) -> str:
    pairs = ", ".join(f"tau{c} is that of joint {j}" for j, c in zip(n["joints"], n["columns"], strict=True))
    return f"The torque columns are swapped: {pairs}, by the weight and the motion of the arm. They were exchanged."


def _reversed(rows: Sequence[int], n: Numbers) -> str:
    return (
        f"The torque of {_joints(n['joints'])} has its sign reversed: it is the opposite of what the weight and the "
        "motion of the arm require. Its sign was changed. A torque is what the motor exerts about +z of its joint."
    )


def _contact(rows: Sequence[int], n: Numbers) -> str:
    sizes = [f"{n[f'largest_{unit}']:.3g} {unit}" for unit in ("Nm", "N") if f"largest_{unit}" in n]
    return (
        f"From {n['from_s']:.2f} to {n['to_s']:.2f} s the arm was in contact with something: the torque of "
        f"{_joints(n['joints']) if n['joints'] else 'the arm'} differs by up to "
        f"{' and '.join(sizes)} from the model, in these rows only. They were left out."
    )


def _estimated(rows: Sequence[int], n: Numbers) -> str:
    return (
        "The torques of the arm at rest are constant: they are the controller's own model, not measurements. What is "
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
    return (
        f"A torque is not what the weight and the motion of the arm require, but {said} as much. It was divided by "
        f"this. {remedy}"
    )


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
    "torque_spikes": _spikes,
    "swapped_torques": _swapped,
    "reversed_torque": _reversed,
    "wrong_gravity": _gravity,
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
}
"""Why a fault is not there."""
