"""The sentences about data faults of torque recordings, one for each code, found or not."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

Numbers = Mapping[str, Any]

NAMES = {
    "torque_spikes": "Single torques far from their neighbours",
    "swapped_torques": "Swapped torque columns",
    "reversed_torque": "Torque of reversed sign",
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


def _swapped(rows: Sequence[int], n: Numbers) -> str:
    pairs = ", ".join(f"tau{c} is that of joint {j}" for j, c in zip(n["joints"], n["columns"], strict=True))
    return f"The torque columns are swapped: {pairs}, by the weight and the motion of the arm. They were exchanged."


def _reversed(rows: Sequence[int], n: Numbers) -> str:
    return (
        f"The torque of {_joints(n['joints'])} has its sign reversed: it is the opposite of what the weight and the "
        "motion of the arm require. Its sign was changed. A torque is what the motor exerts about +z of its joint."
    )


def _contact(rows: Sequence[int], n: Numbers) -> str:
    return (
        f"From {n['from_s']:.2f} to {n['to_s']:.2f} s the arm was in contact with something: the torque of "
        f"{_joints(n['joints']) if n['joints'] else 'the arm'} differs by up to "
        f"{n['largest_Nm']:.3g} Nm from the model, in these rows only. They were left out."
    )


def _estimated(rows: Sequence[int], n: Numbers) -> str:
    return (
        "The torques of the arm at rest are constant: they are the controller's own model, not measurements. What is "
        "found is what that model lacks or has beyond this arm's. Record motor currents, or declare torque_source."
    )


FOUND: dict[str, Callable[[Sequence[int], Numbers], str]] = {
    "torque_spikes": _spikes,
    "swapped_torques": _swapped,
    "reversed_torque": _reversed,
    "contact": _contact,
    "estimated_torque": _estimated,
}
"""What is wrong and how it was corrected, of rows and numbers."""
RULED_OUT: dict[str, Callable[[Numbers], str]] = {
    "swapped_torques": lambda n: "No torque columns are swapped, and none has its sign reversed.",
}
"""Why a fault is not there."""
