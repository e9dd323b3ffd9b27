"""Which families are open and which are sealed: the list that fixes, with a seed, what a campaign draws."""

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.concealed.outside import places, vault, workshop
from benchmarks.concealed.outside.family import Family, Fixed, Signals

SEALED = float("inf")
"""For a family that has not been drawn with --sealed and looked at yet."""
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
    9101: " ".join(workshop.FAMILIES),
    SEALED: " ".join(vault.FAMILIES),
}
"""By the first seed of a campaign that draws them without --sealed, the names of families.

A seed draws the families that were open then, of those that are still there: what was too much like others has been
removed, so that seeds from 2321 to 9100 no longer mean the trials that they meant before. The order, too, decides what
a seed draws: new families go to the end. With --sealed, a seed from 2481 to 9100 draws the twenty of 9101 and no other.
"""
OPENED: dict[str, float] = {name: first for first, names in _NAMES.items() for name in names.split()}
"""By name, that seed."""

_WRITTEN = places.FAMILIES | workshop.FAMILIES | vault.FAMILIES
FAMILIES: dict[str, Family] = {name: _WRITTEN[name] for name in OPENED}
"""By name. A `power` of 2 is the family's; of 1 it is the named effect that comes nearest."""


def families(seed: int, sealed: bool = False) -> tuple[str, ...]:
    """The families that a campaign draws; where `sealed`, those that were put aside next.

    A new family is `SEALED` until it was drawn once with --sealed and looked at.
    """
    if not sealed:
        return tuple(name for name, first in OPENED.items() if first <= seed)
    following = min((first for first in OPENED.values() if first > seed), default=np.inf)
    return tuple(name for name, first in OPENED.items() if first == following)


def seen_shift(name: str, fixed: Fixed, s: Signals, position: Array) -> Array:
    """`(sample, 3)`: what an image shifts, of a number of 1, where the sensor has the point at `(sample, 3)` m."""
    family = FAMILIES[name]
    assert family.image is not None
    shift = family.image(position.T).T
    return shift if family.signal is None else shift * family.signal(fixed, s)[:, None]
