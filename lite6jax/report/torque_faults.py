"""The sentences about data faults of torque recordings, by code, found or not."""

from collections.abc import Callable, Sequence

import numpy as np

from lite6jax.arms.arm import joint_unit
from lite6jax.report.words import Numbers, Wording, be, counted, joints_named


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
        f"The velocity of {joints_named(n['joints'])} has a bias of {biases} mrad/s (mm/s of a slide): it reads that "
        "where the position stands still, and exceeds the way gone by as much. It was subtracted."
    )


def _dead_zone(rows: Sequence[int], n: Numbers) -> str:
    widths = ", ".join(f"{1e3 * width:.2g} mrad/s" for width in n["width_rad_per_s"])
    return (
        f"The velocity of {joints_named(n['joints'])} reads nothing below {widths}, while the positions go on. There "
        "the slope of the positions was taken."
    )


def _spikes(rows: Sequence[int], n: Numbers) -> str:
    return (
        f"{counted(n['count'], 'torque')} {be(n['count'])} far from the row before and the row after "
        f"({joints_named(n['joints'])}), which no motion causes. They were interpolated. Check the transmission of the "
        "torques."
    )


def _swapped(rows: Sequence[int], n: Numbers) -> str:
    pairs = ", ".join(f"tau{c} is that of joint {j}" for j, c in zip(n["joints"], n["columns"], strict=True))
    return f"The torque columns are swapped: {pairs}, by the weight and the motion of the arm. They were exchanged."


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


def _undecided(rows: Sequence[int], n: Numbers) -> str:
    readings = "; or ".join(" and ".join(_CLAUSES[part["fault"]](part) for part in one) for one in n["alternatives"])
    return (
        f"The torques contradict the arm, and {len(n['alternatives'])} corrections explain that alike: {readings}. "
        "Nothing was corrected, so that what is found beside this is not to be trusted. Find out which it is, and "
        "correct the file."
    )


_CLAUSES: dict[str, Callable[[Numbers], str]] = {
    "swapped_torques": lambda n: f"exchanged torques of {joints_named(n['joints'])}",
    "reversed_torque": lambda n: f"a reversed torque of {joints_named(n['joints'])}",
    "swapped_positions": lambda n: f"exchanged positions of {joints_named(n['joints'])}",
    "swapped_columns": lambda n: f"exchanged columns of {joints_named(n['joints'])}",
    "reversed_positions": lambda n: f"a reversed position of {joints_named(n['joints'])}",
    "reversed_joint": lambda n: f"reversed signs of position and torque of {joints_named(n['joints'])}",
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
        f"{joints_named(n['joints']) if n['joints'] else 'the arm'} differs by up to {' and '.join(sizes)} from the "
        "model, in these rows only. They were left out."
    )


def _estimated(rows: Sequence[int], n: Numbers) -> str:
    without = n.get("reason") == "no_friction"
    shown = "have neither noise nor any friction" if without else "of the arm at rest are constant"
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
    subject, it = "Torques are", "They were divided by these factors"
    if len(n["joints"]) == 1:
        subject, it = "A torque is", "It was divided by this"
    return f"{subject} not what the weight and the motion of the arm require, but {said} as much. {it}. {remedy}"


def _held(rows: Sequence[int], n: Numbers) -> str:
    pairs = zip(n["joints"], n["std_Nm"], strict=True)
    slides = n.get("prismatic_joints", ())
    bands = ", ".join(f"{std:.2g} {joint_unit('Nm', joint in slides)} at joint {joint}" for joint, std in pairs)
    return (
        "At rest, friction holds a joint wherever it stands, and the torque is indeterminate within a band (one sigma: "
        f"{bands}). These rows have little weight for {joints_named(n['joints'])}. Record more motion."
    )


FAULTS: dict[str, Wording] = {
    "uneven_times": Wording("Uneven times", _uneven),
    "velocity_bias": Wording("Velocity with a bias", _bias),
    "velocity_dead_zone": Wording("Velocity with a dead zone", _dead_zone),
    "torque_spikes": Wording("Single torques far from their neighbours", _spikes),
    "swapped_torques": Wording(
        "Swapped torque columns", _swapped, "No torque columns are swapped, and none has its sign reversed."
    ),
    "reversed_torque": Wording(
        "Torque of reversed sign",
        "The torque of {joints} has its sign reversed: it is the opposite of what the weight and the motion of the arm "
        "require. Its sign was changed. A torque is what the motor exerts about +z of its joint.",
    ),
    "swapped_positions": Wording(
        "Swapped columns of joint positions",
        "The positions of {joints} are exchanged, the torques are not: these fit the arm with these columns exchanged. "
        "They were exchanged. Check the order of the columns.",
    ),
    "swapped_columns": Wording(
        "Swapped joints",
        "{Joints} are exchanged, positions and torques: torques fit the arm with these columns exchanged. They were "
        "exchanged. Check the order of the joints.",
    ),
    "reversed_positions": Wording(
        "Position of reversed sign",
        "The position of {joints} has its sign reversed, its torque has not: torques fit the arm with the opposite "
        "position. Its sign was changed. Positions count about +z of the joint in the description.",
    ),
    "reversed_joint": Wording(
        "Joint of reversed sign",
        "Position and torque of {joints} have their signs reversed: the driver's axis points the other way than that "
        "of the description. The signs were changed. Correct the file, or the axis in the description.",
    ),
    "coupled_positions": Wording("Coupled joint positions", _coupled_positions),
    "joint_zero": Wording(
        "Joint with another zero",
        _joint_zero,
        "No joint has another zero, sign or place than in the description, as far as torques show.",
    ),
    "wrong_gravity": Wording(
        "Gravity in another direction",
        _gravity,
        "Gravity acts along the declared direction, but for a tilt of the base.",
    ),
    "no_gravity": Wording(
        "Torques without gravity",
        "The torques do not hold the weight of the arm: gravity's share was subtracted, or the arm is balanced. They "
        "were compared without gravity, so that masses show in accelerations alone. Take the torques of the motors, or "
        "declare gravity_m_per_s2: [0, 0, 0] in the sidecar.",
    ),
    "undecided_torques": Wording("Undecided contradiction of torques", _undecided),
    "wrong_torque_constant": Wording(
        "Wrong torque constant or gear ratio",
        _constant,
        "No torque differs by a factor, as another torque constant or gear ratio causes.",
    ),
    "held_by_friction": Wording("Joints held at rest by friction", _held),
    "contact": Wording("Contact", _contact),
    "estimated_torque": Wording("Torques without noise", _estimated),
}
