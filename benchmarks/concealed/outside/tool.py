"""Families outside the catalogue that move the tool on the flange."""

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.concealed.outside.family import (
    BY_JOINT,
    CREEP,
    PRELOAD,
    SPEED,
    TEMPERATURE,
    TIME,
    VELOCITY,
    Family,
    Fixed,
    Signals,
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
