"""Families outside the catalogue that move the tool on the flange."""

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.concealed.outside.family import (
    BY_JOINT,
    CREEP,
    DIRECTION,
    PRELOAD,
    SPEED,
    TEMPERATURE,
    TIME,
    VELOCITY,
    Family,
    Fixed,
    Signals,
    beyond,
    column,
    either,
    own,
    together,
)

_ROLLS = 0.1
"""Of the load: the moment about which a ball begins to roll."""


def _tipped(fixed: Fixed, s: Signals) -> Array:
    load = column(s.moment[..., 0], fixed, "flange") / fixed["flange_moment_Nm"]
    return np.sign(load) * (np.abs(load) > PRELOAD)


def _rolled(fixed: Fixed, s: Signals) -> Array:
    x, y = (column(s.moment[..., axis], fixed, "flange") / fixed["flange_moment_Nm"] for axis in (0, 1))
    return y / np.sqrt(x**2 + y**2 + _ROLLS**2)


def _parted(fixed: Fixed, s: Signals) -> Array:
    x, y = (column(s.moment[..., axis], fixed, "flange") / fixed["flange_moment_Nm"] for axis in (0, 1))
    return np.maximum(np.hypot(x, y) - PRELOAD, 0.0)


def _sagging(fixed: Fixed, s: Signals) -> Array:
    load = column(s.moment[..., 0], fixed, "flange") / fixed["flange_moment_Nm"]
    return column(s.dq, fixed, "flange") ** 2 * load


FAMILIES: dict[str, Family] = {
    "tool_turn_by_joint": Family(
        "tool", "turn_rad", lambda fixed, s: column(s.q, fixed, "by"), ("by",), BY_JOINT, (3, 4)
    ),
    "tool_shift_by_warmth": Family(
        "tool", "shift_m", lambda fixed, s: s.warmth(), (), TEMPERATURE, (0, 1, 2), warm=True
    ),
    # a clip of the target lets go
    "loose_clip": Family(
        "tool",
        "shift_m",
        lambda fixed, s: (s.time > fixed["instant_s"]).astype(float),
        ("instant_s",),
        TIME,
        (0, 1, 2),
        beside=("tool_offset",),
    ),
    # the target sinks into its glue until that is hard
    "creeping_glue": Family(
        "tool",
        "shift_m",
        lambda fixed, s: -np.expm1(-CREEP * s.time / fixed["span_s"]),
        ("span_s",),
        TIME,
        (2,),
        beside=("tool_offset",),
    ),
    # a cable tugs at the target as a joint turns, and its clamp works loose
    "loosening_clamp": Family(
        "tool",
        "turn_rad",
        lambda fixed, s: s.time / fixed["span_s"] * column(s.q, fixed, "by"),
        ("span_s", "by"),
        together(TIME, BY_JOINT),
        (3, 4),
        beside=("tool_offset",),
    ),
    # a cable pulls at the tool when a joint has taken up its slack
    "taut_cable": Family(
        "tool",
        "turn_rad",
        lambda fixed, s: beyond(column(s.q, fixed, "by"), fixed["slack"]),
        ("by", "slack"),
        BY_JOINT,
        (3, 4),
        beside=("tool_offset",),
    ),
    # a detent holds a tool upright until the moment tips it against a stop
    "tipping_tool": Family(
        "tool",
        "turn_rad",
        _tipped,
        ("flange", "flange_moment_Nm"),
        own("gravity moment x of link", "flange"),
        (3,),
        beside=("tool_compliance", "tool_offset"),
        loaded=True,
    ),
    # a slender probe is flung outwards as the last joint spins it
    "flung_probe": Family(
        "tool",
        "shift_m",
        lambda fixed, s: column(s.dq, fixed, "flange") ** 2,
        ("flange",),
        either(VELOCITY, SPEED, key="flange"),
        (0, 1),
        beside=("tool_offset",),
        moving=True,
    ),
    # a target slides aside in its magnetic nest by its weight
    "sliding_nest": Family(
        "tool",
        "shift_m",
        lambda fixed, s: column(s.moment[..., 1], fixed, "flange") / fixed["flange_moment_y_Nm"],
        ("flange", "flange_moment_y_Nm"),
        own("gravity moment y of link", "flange"),
        (0,),
        beside=("tool_offset",),
        loaded=True,
    ),
    # a ball that is loose in its cup lies at the rim, on the side to which its weight rolls it
    "rattling_ball": Family(
        "tool",
        "shift_m",
        _rolled,
        ("flange", "flange_moment_Nm"),
        together(own("gravity moment x of link", "flange"), own("gravity moment y of link", "flange")),
        (0,),
        beside=("tool_offset",),
        loaded=True,
    ),
    # a hose that is stiff when cold and soft when warm pulls at the tool as a joint bends it
    "cold_hose": Family(
        "tool",
        "turn_rad",
        lambda fixed, s: np.exp(-s.warmth()) * column(s.q, fixed, "by"),
        ("by",),
        together(TEMPERATURE, BY_JOINT),
        (3, 4),
        beside=("tool_offset",),
        warm=True,
    ),
    # magnets hold a tool changer together until a moment of any direction levers it open
    "parting_changer": Family(
        "tool",
        "shift_m",
        _parted,
        ("flange", "flange_moment_Nm"),
        together(own("gravity moment x of link", "flange"), own("gravity moment y of link", "flange")),
        (2,),
        beside=("tool_offset",),
        loaded=True,
    ),
    # soft glue under the target flows as long as the recording lasts, and the faster the warmer it is
    "flowing_glue": Family(
        "tool",
        "shift_m",
        lambda fixed, s: s.warmth() * s.time / fixed["span_s"],
        ("span_s",),
        together(TEMPERATURE, TIME),
        (0, 1),
        beside=("tool_offset",),
        warm=True,
    ),
    # a tool that is loose in its bayonet climbs the ramp as the last joint turns one way, and slides back the other way
    "climbing_bayonet": Family(
        "tool",
        "shift_m",
        lambda fixed, s: column(s.direction, fixed, "flange"),
        ("flange",),
        own(DIRECTION, "flange"),
        (2,),
        beside=("tool_offset",),
    ),
    # the jaws of a chuck are flung outwards as the last joint spins it, and what they hold sags
    "opening_chuck": Family(
        "tool",
        "turn_rad",
        _sagging,
        ("flange", "flange_moment_Nm"),
        together(either(VELOCITY, SPEED, key="flange"), own("gravity moment x of link", "flange")),
        (3,),
        beside=("tool_compliance", "tool_offset"),
        loaded=True,
        moving=True,
    ),
}
