"""Families of physics outside the catalogue: where each acts, on what it depends, and which of them are sealed.

What a seed draws is fixed by the list of the families here.
"""

from collections.abc import Callable

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.concealed.outside import places, vault
from benchmarks.concealed.outside.family import Family, Fixed, Motion, column

SEALED = float("inf")  # for a family that has not been drawn with --sealed and looked at yet
_NAMES: dict[float, str] = {
    0: "joint_bump joint_step hardening_spring yielding_spring joint_parabola squared_coupling squared_speed "
    "squared_warmth sticking_zone link_tilt_by_time link_tilt_by_warmth base_tilt_by_joint "
    "base_yaw_by_moment tool_turn_by_joint stretched_axis sensor_turn_by_time",
    2321: "lens_distortion sensor_shift_by_warmth squared_drift",
    2341: "eccentric_coupling dragging_gear loose_clip creeping_glue swaying_sensor",
    2361: "soft_stop pulled_encoder softening_link preloaded_base bent_beam",
    2381: "whipped_link wheeled_table tipping_tool shared_bench eccentric_circle",
    2411: "thinning_grease fading_friction bowed_link swung_trolley",
    2431: "cracked_tooth starved_servo slack_bevel wandering_disc dented_bearing snapping_casing humming_link "
    "passing_truck rattling_ball cold_hose cyclic_ranger",
    2451: "warming_mesh sprung_tensioner nested_shafts meshing_wrist thrusting_helix short_umbilical "
    "leaking_table gel_pads parting_changer flowing_glue shaken_tripod",
    2481: "clamped_ring bent_sheath flipping_pull parting_pinion flattened_tube buckling_plate "
    "breathing_springs opening_chuck glass_pane",
    9101: " ".join(places.WORKSHOP),
    66602: " ".join(vault.FAMILIES),
}
"""By the first seed of a campaign that draws them without --sealed, the names of families.

A seed draws the families that were open then, of those that are still there: what was too much like others has been
removed, so that seeds from 2321 to 9100 no longer mean the trials that they meant before. The order, too, decides what
a seed draws: new families go to the end. With --sealed, a seed from 2481 to 9100 draws the twenty of 9101 and no other,
and one from 9101 to 66601 the thirty-three of 66602.
"""
OPENED: dict[str, float] = {name: first for first, names in _NAMES.items() for name in names.split()}
"""By name, that seed."""

_WRITTEN = places.FAMILIES | vault.FAMILIES
FAMILIES: dict[str, Family] = {name: _WRITTEN[name] for name in OPENED}
"""By name. A `power` of 2 is the family's; of 1 it is the named effect that comes nearest."""


_LEAST_LOAD = 0.05  # Nm below which a load is none
_UNIFORM = {"turns": (1.5, 3.5), "phase": (-np.pi, np.pi), "width": (0.15, 0.35), "strokes": (5.0, 9.0)}
"""Between which numbers of a form are drawn; instants by the length of the recording."""
_INSTANTS = {"instant_s": (0.3, 0.7), "passes_s": (0.06, 0.15)}
_REACHED: dict[str, tuple[float, float, Callable[[Fixed, Motion], Array]]] = {
    "centre": (20, 80, lambda form, s: column(s.q, form)),
    "at": (25, 75, lambda form, s: column(s.q, form)),
    "stop": (55, 80, lambda form, s: column(s.q, form)),
    "over": (35, 65, lambda form, s: column(s.q, form, "by")),
    "slack": (30, 60, lambda form, s: np.abs(column(s.q, form, "by"))),
    "buckles": (30, 60, lambda form, s: s.warmth()),
    "snaps": (35, 65, lambda form, s: s.warmth()),
    "fades": (20, 50, lambda form, s: np.abs(column(s.dq, form))),
    "limit": (40, 70, lambda form, s: np.abs(column(s.dq, form))),
}
"""Percentiles between which one is drawn of what the arm does, so that it comes there."""
_LOADS: dict[str, Callable[[Fixed, Motion], Array]] = {
    "torque_Nm": lambda form, s: column(s.moment[..., 2], form),
    "moment_Nm": lambda form, s: column(s.moment[..., 0], form),
    "moment_y_Nm": lambda form, s: column(s.moment[..., 1], form),
    "by_torque_Nm": lambda form, s: column(s.moment[..., 2], form, "by"),
    "flange_moment_Nm": lambda form, s: s.moment[:, -1, 0],
    "base_moment_Nm": lambda form, s: s.base_moment[:, 0],
    "base_moment_y_Nm": lambda form, s: s.base_moment[:, 1],
}
"""Of which a form counts in the 90th percentile."""


def draw_form(name: str, rng: np.random.Generator, s: Motion) -> tuple[str, dict[str, float]] | None:
    """A site of a family and what else belongs to its form; None where no load acts that it needs."""
    family, dof = FAMILIES[name], s.q.shape[1]
    joint = int(rng.integers(1, dof + 1))
    # the last link is the flange, to which the tool is fixed
    if family.place == "link":
        joint = int(rng.integers(1, dof))
    fixed = {"joint": float(joint)} if family.place in ("joint", "link") else {}
    # a base that tilts by joint 1 is an axis of joint 1 that wobbles, a tool that turns by the last joint likewise
    held = {"base": 1, "tool": dof}.get(family.place, joint)
    others = rng.permutation([k for k in range(1, dof + 1) if k != held])
    if family.place in ("joint", "link") and not family.any_other:
        others = others[others != joint + 1]
    for key in family.keys.split():
        here, more = {"joint": float(joint), **fixed}, {}
        match key:
            case "by" | "and":
                found = float(others[int(key == "and")])
            case "power":
                found = 2.0
            case "span_s":
                found = float(s.time[-1])
            case "flange":
                found = float(dof)
            case "hums":
                speed = np.abs(column(s.dq, fixed, "by"))
                more = {"band": float(rng.uniform(0.1, 0.2) * np.percentile(speed, 95))}
                found = float(np.percentile(speed, rng.uniform(35, 75)))
            case "relaxes_s":
                # some poses at rest, or as long as it takes to come somewhere else
                found = float(rng.uniform(2.0, 6.0) * max(s.time[1] - s.time[0], 0.3))
            case "lower":
                start = rng.uniform(10, 50)
                found, upper = map(float, np.percentile(column(s.q, here), (start, start + 35)))
                more = {"upper": upper}
            case _ if key in _UNIFORM:
                found = float(rng.uniform(*_UNIFORM[key]))
            case _ if key in _INSTANTS:
                found = float(rng.uniform(*_INSTANTS[key]) * s.time[-1])
            case _ if key in _REACHED:
                low, high, values = _REACHED[key]
                found = float(np.percentile(values(here, s), rng.uniform(low, high)))
            case _:
                found = float(np.percentile(np.abs(_LOADS[key](here, s)), 90))
                if found < _LEAST_LOAD:
                    return None
        fixed |= {key: found} | more
    if family.axes:
        fixed["axis"] = float(rng.choice(family.axes))
    site = {"joint": f"joint{joint}", "link": f"link{joint}", "image": "sensor"}.get(family.place, family.place)
    return site, fixed


def families(seed: int, sealed: bool = False) -> tuple[str, ...]:
    """The families that a campaign draws; where `sealed`, those that were put aside next.

    A new family is `SEALED` until it was drawn once with --sealed and looked at.

    Raises:
        ValueError: none is put aside after the seed.
    """
    if not sealed:
        return tuple(name for name, first in OPENED.items() if first <= seed)
    following = min((first for first in OPENED.values() if first > seed), default=np.inf)
    names = tuple(name for name, first in OPENED.items() if first == following)
    if not names:
        raise ValueError(f"seed {seed}: all families were looked at before it; give an earlier one, or write new ones")
    return names
