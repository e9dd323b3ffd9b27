"""Families that were drawn with --sealed once, by seed 66601, before anybody had developed against them.

They are the other half of the list of `places.WORKSHOP`, up to `stitched_volume`, and those that were added at the end.
"""

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.concealed.outside.family import (
    PRELOAD,
    TILT,
    Family,
    X,
    Y,
    Z,
    base,
    beyond,
    image,
    joint,
    lagged,
    link,
    play,
    tool,
)

_STICKING = 0.4  # in tens of K: the growth that friction holds back
_SEAM = 0.05  # m to either side in which two volumes are blended
_SETTLED = 3.0  # time constants of a preload's loss that a recording lasts
_HELD = 0.4  # of the load: the moment that friction between two flanges holds


def _threefold(x: Array, y: Array) -> Array:
    return np.hypot(x, y) * np.cos(3 * np.arctan2(y, x))


FAMILIES: dict[str, Family] = {
    # an encoder's fine track has another pitch than it counts, until the coarse track puts that right
    "vernier_disc": joint(
        "position",
        lambda m: (m["turns"] * m.q() + m["phase"]) / (2 * np.pi) % 1.0,
        "turns phase",
        "joint_harmonic joint_scale",
    ),
    # of three planets in a gear one is loose, and the gear gives way to its load where that one should bear it
    "uneven_planets": joint(
        "torque, position",
        lambda m: m.load() * np.sin(3 * m.q() + m["phase"]),
        "torque_Nm phase",
        "joint_compliance joint_harmonic",
    ),
    # the pinion between two joints wedges where these turn against each other, and is free elsewhere
    "binding_pinion": joint("direction, direction of by", lambda m: (m.side() * m.side("by") < 0).astype(float), "by"),
    # two joints hang on one safety clutch, which slips as far as the sum of their loads is too much for it
    "shared_clutch": joint(
        "torque, torque of by",
        lambda m: beyond(m.load() + m.load("by"), PRELOAD),
        "by torque_Nm by_torque_Nm",
        "joint_compliance",
    ),
    # a motor slips behind its field, by its speed and the more, the harder it pulls either way
    "straining_motor": joint("velocity, torque", lambda m: -m.dq() * np.abs(m.load()), "torque_Nm", "joint_lag"),
    # a joint's cable rubs in a bend that the load of another joint pinches
    "pinched_cable": joint(
        "direction, torque of by", lambda m: -m.side() * np.abs(m.load("by")), "by by_torque_Nm", "joint_backlash"
    ),
    # the weights of another joint's overspeed brake fly out beyond a speed, either way, and press on the gear
    "flying_weights": joint(
        "velocity/speed of by", lambda m: np.maximum(np.abs(m.dq("by")) - m["hums"], 0.0), "by hums"
    ),
    # two joints turn a forearm about one direction, and it is flung outwards by the square of the sum
    "flung_forearm": link(
        "velocity of by, velocity of and", lambda m: (m.dq("by") + m.dq("and")) ** 2, "by and", axes=(0, 1)
    ),
    # the sides of a casting differ in thickness: the thin one is as warm as the air, the thick one warms later
    "thick_casting": link(
        "temperature", lambda m: m.s.warmth() - lagged(m.s.warmth(), m.s.time, m["span_s"] / 6), "span_s", axes=TILT
    ),
    # a hose along a link is under pressure at times, is stiff only then, and pulls as another joint bends it
    "pulsing_hose": link(
        "position of by, time", lambda m: (m.wave() > 0) * m.q("by"), "by span_s turns phase", axes=TILT
    ),
    # two lines to a link come over two other joints, and the one that is more taut pulls it aside
    "two_lines": link(
        "position of by, position of and", lambda m: np.maximum(m.q("by"), m.q("and")), "by and", axes=TILT
    ),
    # an open profile that its joint's load twists gives way to the side of what bends it, by the product
    "twisted_channel": link(
        "moment x, torque", lambda m: m.moment("x") * m.load(), "moment_Nm torque_Nm", "link_compliance", (4,)
    ),
    # a lamp beside an arm warms one side of a link, as far as another joint turns that side to it
    "sunlit_link": link(
        "position of by", lambda m: np.maximum(np.sin(m.q("by") + m["phase"]), 0.0), "by phase", axes=TILT
    ),
    # a stand on three legs is stiff over a leg and soft between two: three times in a turn of the moment
    "three_legged_stand": base(
        "base moment x, base moment y",
        lambda m: _threefold(m.moment("x", "base_"), m.moment("y", "base_")),
        "base_moment_Nm base_moment_y_Nm",
        "base_compliance",
        TILT,
    ),
    # a plinth that grows with warmth sticks to the floor, and moves on only when the strain overcomes that
    "sticking_plinth": base("temperature", lambda m: play(m.s.warmth(), _STICKING), axes=(0, 1)),
    # a warped plate stands on two opposite corners and rises on these or those, by the product of the moments
    "warped_plate": base(
        "base moment x, base moment y",
        lambda m: m.moment("x", "base_") * m.moment("y", "base_"),
        "base_moment_Nm base_moment_y_Nm",
        "base_compliance",
        (2,),
    ),
    # lines to the tool are twisted by the sum of two joints' turns, either way, and pull by its square
    "twisted_umbilical": tool(
        "position of by, position of and", lambda m: (m.q("by") + m.q("and")) ** 2, "by and", axes=TILT
    ),
    # a mount of rubber between flange and tool creeps under the moment and recovers
    "rubber_mount": tool(
        "moment x/tool moment x of flange",
        lambda m: lagged(m.moment("x", "flange_"), m.s.time, m["relaxes_s"]),
        "flange flange_moment_Nm relaxes_s",
        "tool_compliance",
        (3,),
    ),
    # the bar that holds a pair of cameras bows as it warms, and the more, the farther off, the nearer all seems
    "bowing_bar": image("temperature, measured position", lambda m: m.s.warmth(), image=lambda p: p * p[2]),
    # what two pairs of cameras see is stitched together along a seam, where one volume is higher
    "stitched_volume": image("measured position x", image=lambda p: Z * np.tanh(p[0] / _SEAM)),
    # of an amplifier's bridge the half that drives a joint forwards is weak, and the servo falls behind that way only
    "lopsided_bridge": joint("velocity", lambda m: -np.maximum(m.dq(), 0.0), beside=("joint_lag",)),
    # washers that press a split gear's halves apart settle, and the play that they took up opens
    "settling_preload": joint(
        "direction, time",
        lambda m: m.side() * np.expm1(-_SETTLED * m.share()),
        "span_s",
        beside=("joint_backlash",),
    ),
    # the current of another joint's motor, whichever way it turns, lifts the ground of an encoder's analogue signal
    "lifted_ground": joint("torque of by", lambda m: np.abs(m.load("by")), "by by_torque_Nm"),
    # a bearing's race is not flat, and what it bears moves along the axis as it turns, twice to and fro
    "wavy_race": link("position", lambda m: np.sin(2 * m.q() + m["phase"]), "phase", axes=(2,)),
    # a link's profile has principal axes askew to its sides, and bends about one side by the moment about the other
    "skew_profile": link("moment y", lambda m: m.moment("y"), "moment_y_Nm", axes=(3,)),
    # friction between two bolted flanges holds them until the moment has changed enough for them to slip
    "slipping_flange": link("moment x", lambda m: play(m.moment("x"), _HELD), "moment_Nm", "link_compliance", (3,)),
    # a bolt of a link shears off, and from then on the link bends under its load
    "sheared_bolt": link(
        "moment x, time",
        lambda m: m.moment("x") * (m.s.time > m["instant_s"]),
        "moment_Nm instant_s",
        "link_compliance",
        (3,),
    ),
    # a plain bearing's shaft climbs on its film of oil by its speed, either way, and less on oil that is warm and thin
    "oil_film": link("velocity/speed, temperature", lambda m: np.abs(m.dq()) * np.exp2(-m.s.warmth()), axes=(0, 1)),
    # a plate lies on hard floor on one side and hangs on long bolts on the other: only a moment that lifts it tilts it
    "one_sided_plate": base(
        "base moment y",
        lambda m: np.maximum(m.moment("y", "base_"), 0.0),
        "base_moment_y_Nm",
        "base_compliance",
        (4,),
    ),
    # a seal's friction heats the spindle that the last joint turns, which grows and shrinks after it
    "heated_spindle": tool(
        "velocity/speed of flange",
        lambda m: lagged(m.dq("flange") ** 2, m.s.time, m["relaxes_s"]),
        "flange relaxes_s",
        axes=(2,),
    ),
    # suction cups fold up while they hold a part, whichever way they point
    "folded_cups": tool("payload", lambda m: (m.s.payload > 0).astype(float), axes=(2,)),
    # a ranging sensor's distances count from a point that is not on its axes: all are too long by one length
    "misplaced_zero": image("measured position", image=lambda p: p / np.linalg.norm(p, axis=0)),
    # the axis about which a tracker's head nods is not square to that about which it turns
    "tilted_trunnion": image("measured position", image=lambda p: (Y * p[0] - X * p[1]) * p[2] / np.hypot(p[0], p[1])),
}
