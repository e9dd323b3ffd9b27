"""Effects that look alike in a log of commands and measured joints, and what tells them apart."""

from typing import Any, NamedTuple, final


@final
class Resemblance(NamedTuple):
    """A group of effects that look alike.

    Attributes:
        effects: their names.
        alike: in which logs, a clause.
        told_apart: the motion, the load or the further quantity that tells them apart.
    """

    effects: tuple[str, ...]
    alike: str
    told_apart: str

    def describe(self, name: str) -> dict[str, Any]:
        """Describes one of its effects, as plain JSON values: the `effects` are the others."""
        others = [effect for effect in self.effects if effect != name]
        return {"effects": others, "alike": self.alike, "told_apart": self.told_apart}


IN_TRACKING = (
    Resemblance(
        ("time_offset", "command_delay", "servo_damping", "viscous_friction", "command_filter"),
        "while the motion is slow: the arm is late by the sum of all times",
        "fast sines, whose amplitude falls with a lag and a filter and stays with a delay; steps",
    ),
    Resemblance(
        ("servo_damping", "viscous_friction"),
        "in every log, unless a torque limit is reached or the servo feeds velocity forward",
        "torques or currents in the same log",
    ),
    Resemblance(
        ("servo_feedforward", "servo_damping", "command_delay"),
        "while the motion is slow: a feed-forward takes lag away",
        "fast sines and steps",
    ),
    Resemblance(
        ("servo_stiffness", "payload_error", "link_mass", "link_com", "base_tilt"),
        "in one posture with one load: the arm sags",
        "runs with several loads or a known mass; friction and inertia, which a stiffness scales and a load does not",
    ),
    Resemblance(
        ("encoder_offset", "servo_stiffness", "payload_error"),
        "while the load of the joint hardly changes: a constant error",
        "postures in which gravity's torque on the joint changes its sign",
    ),
    Resemblance(
        ("encoder_scale", "servo_stiffness", "joint_spring"),
        "while sin q is nearly q: an error in proportion to the angle",
        "angles beyond 1 rad, and another payload",
    ),
    Resemblance(
        ("rotor_inertia", "encoder_scale"),
        "in sines of one frequency: the amplitude is off by one share",
        "sines of several frequencies",
    ),
    Resemblance(
        ("servo_integral", "servo_stiffness", "encoder_offset"),
        "in long rests: no sag is left",
        "the first second after a move to another load",
    ),
    Resemblance(
        ("coulomb_friction", "dead_band", "backlash"),
        "while the command goes on in one direction: a constant error",
        "reversals, at which friction and play jump with the velocity and a dead band with the error; rests under "
        "load, in which friction holds and play does not",
    ),
    Resemblance(
        ("coulomb_friction", "load_friction"),
        "while the load of the joint is constant",
        "reversals under two loads",
    ),
    Resemblance(
        ("coulomb_friction", "stribeck_friction"),
        "while no reversal is slow",
        "reversals at creeping speed",
    ),
    Resemblance(
        ("rate_limit", "torque_limit", "torque_speed_limit"),
        "under one load: the joint moves no faster than at one speed",
        "the largest speed with and against gravity, or with two payloads",
    ),
    Resemblance(
        ("time_offset", "command_delay"),
        "in every log, where all joints have the same delay: it then counts as one number of the clock",
        "delays that differ from joint to joint, which no clock causes",
    ),
    Resemblance(
        ("clock_drift", "time_offset"),
        "in a short log",
        "a longer log, in which the times between commands and joints grow",
    ),
    Resemblance(
        ("payload_error", "link_mass", "link_com"),
        "while the joints beyond the link hardly turn: one mass at one distance",
        "large moves of the joints near the flange, and a payload of known mass",
    ),
    Resemblance(
        ("torque_ripple", "encoder_eccentricity"),
        "in slow motion under one stiffness: a wave of the angle",
        "the same angles passed quickly, where a torque no longer moves the joint and an encoder still errs",
    ),
    Resemblance(
        ("encoder_eccentricity", "encoder_scale", "servo_stiffness"),
        "over a small part of a turn",
        "most of a turn; another payload, which changes a sag and no encoder",
    ),
)
"""Of effects on how servos follow."""


def resemblances(name: str) -> tuple[Resemblance, ...]:
    """The groups that an effect on how servos follow is in."""
    return tuple(group for group in IN_TRACKING if name in group.effects)
