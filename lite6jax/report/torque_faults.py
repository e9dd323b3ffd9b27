"""The sentences about data faults of torque recordings, one for each code, found or not."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

Numbers = Mapping[str, Any]

NAMES = {
    "torque_spikes": "Single torques far from their neighbours",
    "swapped_torques": "Swapped torque columns",
    "reversed_torque": "Torque of reversed sign",
    "contact": "Contact",
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
        "motion of the arm require. It was turned. A torque is what the motor exerts about +z of its joint."
    )


def _contact(rows: Sequence[int], n: Numbers) -> str:
    return (
        f"From {n['from_s']:.2f} to {n['to_s']:.2f} s something else pushed the arm: the torque of "
        f"{_joints(n['joints']) if n['joints'] else 'the arm'} is up to {n['largest_Nm']:.3g} Nm from the model, once and "
        "nowhere else. These rows were left out."
    )


FOUND: dict[str, Callable[[Sequence[int], Numbers], str]] = {
    "torque_spikes": _spikes,
    "swapped_torques": _swapped,
    "reversed_torque": _reversed,
    "contact": _contact,
}
"""What is wrong and how it was corrected, of rows and numbers."""
RULED_OUT: dict[str, Callable[[Numbers], str]] = {
    "swapped_torques": lambda n: "No torque columns are swapped, and none has its sign reversed.",
}
"""Why a fault is not there."""
