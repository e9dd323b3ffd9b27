"""Families outside the catalogue of every place, drawn from seed 9101 on: half of a list that was split by lot."""

import numpy as np

from benchmarks.concealed.outside.family import (
    PRELOAD,
    ROCKING,
    TILT,
    Family,
    Z,
    bump,
    lagged,
    latch,
    play,
    signed_power,
    wound,
)

_FRINGE = 0.25
"""m from one wave of the depth to the next."""
_FADES = 0.2
"""m in which what steel does to a field fades."""
_SWITCHING = 0.15
"""In tens of K, to either side: where a fan turns on and off."""
_BRUSHED = 0.3
"""rad to either side of where hoses reach a mast."""

FAMILIES: dict[str, Family] = {
    # a controller makes up for a joint that drives this one along, but not for the play between the two
    "lost_motion": Family(
        "joint",
        "position/direction/travel of by",
        lambda m: play(m.q("by"), m["width"]) - m.q("by"),
        "by width",
        "joint_coupling",
    ),
    # the rubber boot of a joint is twisted along before it slips, and pulls back whichever way that was
    "dragged_boot": Family(
        "joint",
        "direction/position/travel",
        lambda m: -wound(m.q(), 3 * m["width"]),
        "width",
        "joint_backlash joint_scale",
    ),
    # the motor of a fast joint draws down the voltage of all, and the servo of another falls behind
    "sagging_supply": Family(
        "joint", "velocity, velocity/speed of by", lambda m: -m.dq() * np.abs(m.dq("by")), "by", "joint_lag"
    ),
    # a joint's pull cable runs over another joint, which slackens it as it turns, so that it stretches more
    "tensioned_cable": Family(
        "joint",
        "torque, position of by",
        lambda m: m.load() * m.q("by"),
        "by torque_Nm",
        "joint_compliance joint_coupling",
    ),
    # the load presses a worm to a flank, and warmth, by which the bronze wheel grows, moves the flanks apart
    "warm_flanks": Family(
        "joint",
        "torque, temperature",
        lambda m: np.tanh(ROCKING * m.load()) * m.s.warmth(),
        "torque_Nm",
        "joint_backlash joint_compliance joint_thermal_offset",
    ),
    # of the two windings of a resolver one is read late: it is behind by its speed, and more at some angles
    "lame_resolver": Family(
        "joint", "velocity, position", lambda m: -m.dq() * np.sin(m.q() + m["phase"]), "phase", "joint_lag"
    ),
    # an amplifier heats up and turns its current down, and the servo falls behind by more and more
    "tiring_amplifier": Family("joint", "velocity, time", lambda m: -m.dq() * m.share(), "span_s", "joint_lag"),
    # a wheel of nylon gives way to its load, but takes its time, so that earlier loads count as well
    "nylon_wheel": Family(
        "joint",
        "torque",
        lambda m: lagged(m.load(), m.s.time, m["relaxes_s"]),
        "torque_Nm relaxes_s",
        "joint_compliance",
    ),
    # the cover of a link catches the air, by the square of the speed at which another joint sweeps it round
    "sailing_cover": Family("link", "velocity of by", lambda m: signed_power(m.dq("by"), 2.0), "by", axes=TILT),
    # a loose loom falls over in a hollow link that is tilted far enough, and lies there until it is tilted back
    "flopping_loom": Family(
        "link", "moment x", lambda m: latch(m.moment("x"), PRELOAD), "moment_Nm", "link_compliance", (3,)
    ),
    # the tyres of a cart give way to the moment, but slowly, and come back as slowly
    "soft_tyres": Family(
        "base",
        "base moment y",
        lambda m: lagged(m.moment("y", "base_"), m.s.time, m["relaxes_s"]),
        "base_moment_y_Nm relaxes_s",
        "base_compliance",
        (4,),
    ),
    # a press nearby punches at its own pace, and lifts the floor for a short while each time
    "punching_press": Family(
        "base", "time", lambda m: np.maximum(m.wave("strokes"), 0.0) ** 8, "span_s strokes phase", "base_drift", (2,)
    ),
    # a gripper opens and shuts at its own pace, and the target on its finger goes to and fro
    "cycling_gripper": Family("tool", "time", lambda m: np.sign(m.wave()), "span_s turns phase", axes=(0, 1, 2)),
    # a lead trails behind the tool that a joint sweeps round, and pulls little more at full speed than at half
    "trailing_lead": Family(
        "tool", "velocity/direction of by", lambda m: np.tanh(m.dq("by") / m["hums"]), "by hums", axes=TILT
    ),
    # each of two hoses is dragged by a joint of its own and tugs at the tool by friction: the tugs add up
    "two_hoses": Family(
        "tool", "direction of by, direction of and", lambda m: m.side("by") + m.side("and"), "by and", axes=TILT
    ),
    # the clock by which a ranging sensor counts drifts from its rate, and its metre with it
    "drifting_clock": Family(
        "image", "time, measured position", lambda m: m.share(), "span_s", "sensor_drift", image=lambda p: p
    ),
    # fringes of a projector that are no pure sine leave waves in the depth, across the picture
    "moire_fringes": Family("image", "measured position x", image=lambda p: Z * np.sin(2 * np.pi * p[0] / _FRINGE)),
    # steel near its plane of origin bends the field of a magnetic tracker, and less by the distance from it
    "steel_bench": Family("image", "measured position z", image=lambda p: Z * np.exp(-np.abs(p[2]) / _FADES)),
    # a sensor's fan turns on where it is warm and off only where it is cooler, and its draught bends the stand
    "switching_fan": Family(
        "sensor", "temperature", lambda m: latch(m.s.warmth() - m["snaps"], _SWITCHING), "snaps", axes=(0, 1, 2)
    ),
    # hoses of the arm brush against the mast of a sensor, where a joint brings them near
    "brushed_mast": Family(
        "sensor", "position of by", lambda m: bump(m.q("by"), m["over"], _BRUSHED), "by over", axes=(0, 1, 2)
    ),
}
