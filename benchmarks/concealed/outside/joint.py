"""Families outside the catalogue that add an angle to a joint."""

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.concealed.outside.family import (
    BY_JOINT,
    DIRECTION,
    POSITION,
    TEMPERATURE,
    TIME,
    TORQUE,
    VELOCITY,
    Family,
    Fixed,
    Signals,
    beyond,
    bump,
    column,
    either,
    own,
    signed_power,
    together,
    torque,
)

_PULLEY = 1.5
"""Turns of a pulley in one turn of the joint that drives it: between the orders that a wobbling axis has."""
_TENSIONER = 0.2
"""Of the load: the torque at which the spring of a tensioner begins to give."""
_SHEATH = 0.3
"""Friction of a cable in its sheath, over a rad of the bend."""
_DEAD_POINT = 0.2
"""rad to either side of a dead point in which a spring goes over it."""


def _bump(fixed: Fixed, s: Signals) -> Array:
    return bump(column(s.q, fixed), fixed["centre"], fixed["width"])


def _step(fixed: Fixed, s: Signals) -> Array:
    return (column(s.q, fixed) > fixed["at"]).astype(float)


def _sticking(fixed: Fixed, s: Signals) -> Array:
    q = column(s.q, fixed)
    return -column(s.direction, fixed) * ((q > fixed["lower"]) & (q < fixed["upper"]))


FAMILIES: dict[str, Family] = {
    "joint_bump": Family("joint", "height_rad", _bump, ("centre", "width"), own(POSITION)),
    "joint_step": Family("joint", "height_rad", _step, ("at",), own(POSITION)),
    "hardening_spring": Family("joint", "turn_rad", None, ("torque_Nm",), own(TORQUE), loaded=True),
    "yielding_spring": Family(
        "joint",
        "turn_rad",
        None,
        ("torque_Nm",),
        own(TORQUE),
        sum_of=("joint_compliance", "joint_windup"),  # where it slips, a spring and a play of the load add up
        loaded=True,
    ),
    "joint_parabola": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: column(s.q, fixed) ** fixed["power"],
        ("power",),
        own(POSITION),
        beside=("joint_scale", "joint_offset"),
    ),
    "squared_coupling": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: column(s.q, fixed, "by") ** fixed["power"],
        ("by", "power"),
        BY_JOINT,
        beside=("joint_coupling", "joint_offset"),
    ),
    "squared_speed": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: signed_power(column(s.dq, fixed), fixed["power"]),
        ("power",),
        own(VELOCITY),
        beside=("joint_lag",),
        moving=True,
    ),
    "squared_warmth": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: s.warmth() ** fixed["power"],
        ("power",),
        TEMPERATURE,
        beside=("joint_thermal_offset", "joint_offset"),
        warm=True,
    ),
    "sticking_zone": Family(
        "joint",
        "turn_rad",
        _sticking,
        ("lower",),
        together(own(DIRECTION), own(POSITION)),
        beside=("joint_backlash",),
    ),
    # another joint's belt runs over a pulley that is out of centre
    "eccentric_coupling": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: np.sin(_PULLEY * column(s.q, fixed, "by") + fixed["phase"]),
        ("by", "phase"),
        BY_JOINT,
        beside=("joint_coupling", "joint_offset"),
        skipping=True,
    ),
    # friction that grows with the load, whichever way it acts, holds a joint back
    "dragging_gear": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: -column(s.direction, fixed) * np.abs(torque(fixed, s)),
        ("torque_Nm",),
        together(own(DIRECTION), own(TORQUE)),
        beside=("joint_backlash",),
        loaded=True,
    ),
    # a rubber buffer pushes back from where a joint touches it
    "soft_stop": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: np.maximum(column(s.q, fixed) - fixed["stop"], 0.0),
        ("stop",),
        own(POSITION),
        beside=("joint_scale", "joint_offset"),
    ),
    # a cable that another joint tightens pulls the disc of an encoder out of its centre
    "pulled_encoder": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: np.sin(column(s.q, fixed) + fixed["phase"]) * column(s.q, fixed, "by"),
        ("by", "phase"),
        together(own(POSITION), BY_JOINT),
        beside=("joint_harmonic", "joint_coupling", "joint_offset"),
        skipping=True,
    ),
    # grease thins as it warms, and the drive lags less behind
    "thinning_grease": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: column(s.dq, fixed) * s.warmth(),
        (),
        together(own(VELOCITY), TEMPERATURE),
        beside=("joint_lag",),
        moving=True,
        warm=True,
    ),
    # dry friction holds a joint back when it creeps, and fades as it runs (R. Stribeck, 1902)
    "fading_friction": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: -column(s.direction, fixed) * np.exp(-np.abs(column(s.dq, fixed)) / fixed["fades"]),
        ("fades",),
        either(VELOCITY, DIRECTION),  # of a moving joint the direction is the sign of the velocity
        beside=("joint_backlash", "joint_lag"),
        moving=True,
    ),
    # a tooth with a crack at its root gives way to the load while it is in mesh
    "cracked_tooth": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: torque(fixed, s) * _bump(fixed, s),
        ("torque_Nm", "centre", "width"),
        together(own(TORQUE), own(POSITION)),
        beside=("joint_compliance", "joint_offset"),
        loaded=True,
    ),
    # an amplifier runs out of voltage above a speed, and the servo falls behind
    "starved_servo": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: -beyond(column(s.dq, fixed), fixed["limit"]),
        ("limit",),
        own(VELOCITY),
        beside=("joint_lag",),
        moving=True,
    ),
    # a bevel gear that two motors turn together has play, which their sum takes up
    "slack_bevel": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: -np.sign(column(s.dq, fixed) + column(s.dq, fixed, "by")),
        ("by",),
        together(either(VELOCITY, DIRECTION), either(VELOCITY, DIRECTION, key="by")),
        beside=("joint_backlash",),
        moving=True,
        skipping=True,
    ),
    # the disc of an encoder slides out of its centre, as its glue gives
    "wandering_disc": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: s.time / fixed["span_s"] * np.sin(column(s.q, fixed) + fixed["phase"]),
        ("span_s", "phase"),
        together(TIME, own(POSITION)),
        beside=("joint_harmonic", "joint_offset"),
    ),
    # the housing of a gear grows with warmth more than its wheels, and their play with it
    "warming_mesh": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: -column(s.direction, fixed) * s.warmth(),
        (),
        together(own(DIRECTION), TEMPERATURE),
        beside=("joint_backlash",),
        warm=True,
    ),
    # the roller that tightens a belt is held by a spring, and gives way where its strand bears the load
    "sprung_tensioner": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: np.maximum(torque(fixed, s) - _TENSIONER, 0.0),
        ("torque_Nm",),
        own(TORQUE),
        beside=("joint_compliance", "joint_offset"),
        loaded=True,
    ),
    # of shafts that run one in another, with grease between, one drags the other along
    "nested_shafts": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: column(s.dq, fixed, "by"),
        ("by",),
        own(VELOCITY, "by"),
        moving=True,
    ),
    # a wheel of a wrist that is out of centre meshes with one that another joint turns: their difference counts
    "meshing_wrist": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: np.sin(column(s.q, fixed) - column(s.q, fixed, "by") + fixed["phase"]),
        ("by", "phase"),
        together(own(POSITION), BY_JOINT),
        beside=("joint_harmonic", "joint_coupling", "joint_offset"),
        skipping=True,
    ),
    # the ring of an encoder, clamped at two points, goes oval as it warms
    "clamped_ring": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: s.warmth() * np.sin(2 * column(s.q, fixed) + fixed["phase"]),
        ("phase",),
        together(TEMPERATURE, own(POSITION)),
        beside=("joint_harmonic", "joint_thermal_offset", "joint_offset"),
        warm=True,
    ),
    # a pull cable runs in a sheath that another joint bends, and rubs in it the more (L. Euler, 1769)
    "bent_sheath": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: column(s.direction, fixed) * np.expm1(-_SHEATH * np.abs(column(s.q, fixed, "by"))),
        ("by",),
        together(own(DIRECTION), BY_JOINT),
        beside=("joint_backlash",),
    ),
    # the spring of a dress pack goes over its dead point as another joint turns, and pulls the other way
    "flipping_pull": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: np.tanh((column(s.q, fixed, "by") - fixed["over"]) / _DEAD_POINT),
        ("by", "over"),
        BY_JOINT,
        beside=("joint_coupling", "joint_offset"),
        skipping=True,
    ),
}
