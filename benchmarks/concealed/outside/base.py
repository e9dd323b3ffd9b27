"""Families outside the catalogue that move the base."""

import numpy as np

from benchmarks.concealed.outside.family import (
    BY_JOINT,
    DIRECTION,
    PRELOAD,
    TEMPERATURE,
    TIME,
    VELOCITY,
    Family,
    beyond,
    bump,
    column,
    own,
    phrases,
    together,
)

FAMILIES: dict[str, Family] = {
    "base_tilt_by_joint": Family(
        "base", "turn_rad", lambda fixed, s: column(s.q, fixed, "by"), ("by",), BY_JOINT, (3, 4)
    ),
    "base_yaw_by_moment": Family(
        "base",
        "turn_rad",
        lambda fixed, s: s.base_moment[:, 0] / fixed["base_moment_Nm"],
        ("base_moment_Nm",),
        phrases("base moment x"),
        (5,),
        loaded=True,
    ),
    # a plate whose bolts hold it until the moment overcomes how tight they are
    "preloaded_base": Family(
        "base",
        "turn_rad",
        lambda fixed, s: beyond(s.base_moment[:, 0] / fixed["base_moment_Nm"], PRELOAD),
        ("base_moment_Nm",),
        phrases("base moment x"),
        (3,),
        beside=("base_compliance", "frame_offset"),
        loaded=True,
    ),
    # a table on wheels stays where the last jerk of a joint pushed it
    "wheeled_table": Family(
        "base",
        "shift_m",
        lambda fixed, s: column(s.direction, fixed, "by"),
        ("by",),
        own(DIRECTION, "by"),
        (0, 1),
        beside=("frame_offset",),
    ),
    # a light trolley is drawn to where the arm points as joint 1 swings it round
    "swung_trolley": Family(
        "base",
        "shift_m",
        lambda fixed, s: s.dq[:, 0] ** 2 * np.cos(s.q[:, 0]),
        (),
        together(phrases("velocity of joint 1", "speed of joint 1"), phrases("position of joint 1")),
        (0,),
        beside=("frame_offset",),
        moving=True,
    ),
    # a truck that drives by bends the floor for a while
    "passing_truck": Family(
        "base",
        "turn_rad",
        lambda fixed, s: bump(s.time, fixed["instant_s"], fixed["passes_s"]),
        ("instant_s", "passes_s"),
        TIME,
        (3, 4),
        beside=("frame_offset",),
    ),
    # a table on air sinks as its cushions leak, until the valve fills them again
    "leaking_table": Family(
        "base",
        "shift_m",
        lambda fixed, s: (fixed["turns"] * s.time / fixed["span_s"] + fixed["phase"] / (2 * np.pi)) % 1.0,
        ("span_s", "turns", "phase"),
        TIME,
        (2,),
        beside=("base_drift", "frame_offset"),
    ),
    # pads of gel give way to what moves above them, and twice as far for every ten degrees
    "gel_pads": Family(
        "base",
        "turn_rad",
        lambda fixed, s: np.exp2(s.warmth()) * column(s.dq, fixed, "by"),
        ("by",),
        together(TEMPERATURE, own(VELOCITY, "by")),
        (3, 4),
        moving=True,
        warm=True,
    ),
    # a plate that is bolted down all round grows with warmth, and buckles where the bolts no longer keep it flat
    "buckling_plate": Family(
        "base",
        "turn_rad",
        lambda fixed, s: np.sqrt(np.maximum(s.warmth() - fixed["buckles"], 0.0)),
        ("buckles",),
        TEMPERATURE,
        (3, 4),
        beside=("frame_offset",),
        warm=True,
    ),
    # springs of air under a table are now softer and now stiffer, as a compressor comes and goes
    "breathing_springs": Family(
        "base",
        "turn_rad",
        lambda fixed, s: (
            s.base_moment[:, 0]
            / fixed["base_moment_Nm"]
            * np.sin(2 * np.pi * fixed["turns"] * s.time / fixed["span_s"] + fixed["phase"])
        ),
        ("base_moment_Nm", "span_s", "turns", "phase"),
        together(phrases("base moment x"), TIME),
        (3,),
        beside=("base_compliance", "frame_offset"),
        loaded=True,
    ),
}
