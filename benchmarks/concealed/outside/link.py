"""Families outside the catalogue that move a link's frame."""

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.concealed.outside.family import (
    BY_JOINT,
    POSITION,
    ROCKING,
    SPEED,
    TEMPERATURE,
    TIME,
    TORQUE,
    VELOCITY,
    WARMER,
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


def _gradient(fixed: Fixed, s: Signals) -> Array:
    near = int(fixed["joint"]) - 1
    return (s.temperature[:, near + 1] - s.temperature[:, near]) / WARMER


def _flattened(fixed: Fixed, s: Signals) -> Array:
    x, y = (column(s.moment[..., axis], fixed) / fixed["moment_Nm"] for axis in (0, 1))
    return x * (x**2 + y**2)


FAMILIES: dict[str, Family] = {
    "link_tilt_by_time": Family(
        "link", "turn_rad", lambda fixed, s: s.time / fixed["span_s"], ("span_s",), TIME, (3, 4)
    ),
    "link_tilt_by_warmth": Family("link", "turn_rad", lambda fixed, s: s.warmth(), (), TEMPERATURE, (3, 4), warm=True),
    # a link of plastic bends the more the warmer it is
    "softening_link": Family(
        "link",
        "turn_rad",
        lambda fixed, s: s.warmth() * column(s.moment[..., 0], fixed) / fixed["moment_Nm"],
        ("moment_Nm",),
        together(TEMPERATURE, own("gravity moment x of link")),
        (3,),
        beside=("link_compliance", "frame_offset"),
        loaded=True,
        warm=True,
    ),
    # Coriolis's force, where two joints move at once, bends a link
    "whipped_link": Family(
        "link",
        "turn_rad",
        lambda fixed, s: column(s.dq, fixed, "by") * column(s.dq, fixed, "and"),
        ("by", "and"),
        together(own(VELOCITY, "by"), own(VELOCITY, "and")),
        (3, 4),
        beside=("frame_offset",),
        moving=True,
    ),
    # a link bows where one of its ends is warmer than the other
    "bowed_link": Family(
        "link",
        "turn_rad",
        _gradient,
        (),
        lambda fixed: tuple((f"temperature of joint {int(fixed['joint']) + end}",) for end in (0, 1)),
        (3, 4),
        beside=("frame_offset",),
        warm=True,
    ),
    # the balls of a bearing are pressed into their races, ever less by more load (H. Hertz, 1881)
    "dented_bearing": Family(
        "link",
        "turn_rad",
        lambda fixed, s: signed_power(column(s.moment[..., 0], fixed) / fixed["moment_Nm"], 2 / 3),
        ("moment_Nm",),
        own("gravity moment x of link"),
        (3,),
        beside=("link_compliance", "frame_offset"),
        loaded=True,
    ),
    # a casing screwed down under stress snaps over where it is warm enough, and back
    "snapping_casing": Family(
        "link",
        "turn_rad",
        lambda fixed, s: (s.warmth() > fixed["snaps"]).astype(float),
        ("snaps",),
        TEMPERATURE,
        (3, 4),
        beside=("frame_offset",),
        warm=True,
    ),
    # at one speed another joint's motor makes a link hum, and a loose fit sits aside while it does
    "humming_link": Family(
        "link",
        "turn_rad",
        lambda fixed, s: bump(np.abs(column(s.dq, fixed, "by")), fixed["hums"], fixed["band"]),
        ("by", "hums"),
        either(VELOCITY, SPEED, key="by"),
        (3, 4),
        beside=("frame_offset",),
        moving=True,
    ),
    # the slanting teeth of a gear push its shaft to one end or the other of the play along its axis
    "thrusting_helix": Family(
        "link",
        "shift_m",
        lambda fixed, s: np.tanh(ROCKING * torque(fixed, s)),
        ("torque_Nm",),
        own(TORQUE),
        (2,),
        beside=("frame_offset",),
        loaded=True,
    ),
    # a bundle of lines along the arm is too short, and two other joints take up its slack together
    "short_umbilical": Family(
        "link",
        "turn_rad",
        lambda fixed, s: beyond(column(s.q, fixed, "by") + column(s.q, fixed, "and"), fixed["slack"]),
        ("by", "and", "slack"),
        together(BY_JOINT, own(POSITION, "and")),
        (3, 4),
        beside=("frame_offset",),
        skipping=True,
    ),
    # the flanks of its teeth push a pinion, whose motor rides on its link, out of mesh, whichever way the load acts
    "parting_pinion": Family(
        "link",
        "shift_m",
        lambda fixed, s: np.abs(torque(fixed, s)),
        ("torque_Nm",),
        own(TORQUE),
        (0, 1),
        beside=("frame_offset",),
        loaded=True,
    ),
    # a thin tube goes oval as it bends, whichever way, and bends the more (L. G. Brazier, 1927)
    "flattened_tube": Family(
        "link",
        "turn_rad",
        _flattened,
        ("moment_Nm",),
        together(own("gravity moment x of link"), own("gravity moment y of link")),
        (3,),
        beside=("link_compliance", "frame_offset"),
        loaded=True,
    ),
}
