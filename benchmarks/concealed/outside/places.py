"""Families outside the catalogue that were drawn and looked at: of joints, links, the base, the tool, the sensor."""

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.concealed.outside.family import (
    PRELOAD,
    ROCKING,
    TILT,
    WARMER,
    Family,
    Scene,
    X,
    Y,
    Z,
    base,
    beyond,
    bump,
    column,
    image,
    joint,
    lagged,
    latch,
    link,
    play,
    sensor,
    signed_power,
    tool,
    wound,
)

_PULLEY = 1.5  # turns of a pulley in one turn of the joint that drives it: between the orders that a wobbling axis has
_TENSIONER = 0.2  # of the load: the torque at which the spring of a tensioner begins to give
_SHEATH = 0.3  # friction of a cable in its sheath, over a rad of the bend
_DEAD_POINT = 0.2  # rad to either side of a dead point in which a spring goes over it
_CREEP = 4.0  # time constants of a creep that a recording lasts
_ROLLS = 0.1  # of the load: the moment about which a ball begins to roll
_CYCLE = 0.4  # m of distance in which the error of a distance meter comes round
_GLASS = 1.5  # refractive index
_FRINGE = 0.25  # m from one wave of the depth to the next
_FADES = 0.2  # m in which what steel does to a field fades
_SWITCHING = 0.15  # in tens of K, to either side: where a fan turns on and off
_BRUSHED = 0.3  # rad to either side of where hoses reach a mast
_AXES = (0, 1, 2)


def _across(m: Scene, at: str = "") -> Array:
    """Gravity's moment about y, of the link or the flange, over the one about x that was drawn."""
    return column(m.s.moment[..., 1], m.fixed, at or "joint") / m[f"{at}_moment_Nm" if at else "moment_Nm"]


def _cyclic(distance: Array) -> Array:
    return np.sin(2 * np.pi * distance / _CYCLE) / distance


def _refracted(cosine: Array) -> Array:
    # along the normal of the pane (W. Snell, 1621); what is the same everywhere is the sensor's place
    return cosine / np.sqrt(_GLASS**2 - 1 + cosine**2)


JOINT: dict[str, Family] = {
    "joint_bump": joint(
        *("position", lambda m: bump(m.q(), m["centre"], m["width"]), "centre width"), height=True, beside=()
    ),
    "joint_step": joint(*("position", lambda m: (m.q() > m["at"]).astype(float), "at"), height=True, beside=()),
    "hardening_spring": joint("torque", None, "torque_Nm", beside=()),
    # where it slips, a spring and a play of the load add up
    "yielding_spring": joint("torque", None, "torque_Nm", beside=(), sum_of=("joint_compliance", "joint_windup")),
    "joint_parabola": joint("position", lambda m: m.q() ** m["power"], "power", "joint_scale"),
    "squared_coupling": joint(
        *("position of by", lambda m: m.q("by") ** m["power"], "by power", "joint_coupling"), any_other=True
    ),
    "squared_speed": joint(*("velocity", lambda m: signed_power(m.dq(), m["power"]), "power"), beside=("joint_lag",)),
    "squared_warmth": joint("temperature", lambda m: m.s.warmth() ** m["power"], "power", "joint_thermal_offset"),
    "sticking_zone": joint(
        *("direction, position", lambda m: -m.side() * ((m.q() > m["lower"]) & (m.q() < m["upper"])), "lower"),
        beside=("joint_backlash",),
    ),
    # another joint's belt runs over a pulley that is out of centre
    "eccentric_coupling": joint(
        "position of by", lambda m: np.sin(_PULLEY * m.q("by") + m["phase"]), "by phase", "joint_coupling"
    ),
    # friction that grows with the load, whichever way it acts, holds a joint back
    "dragging_gear": joint(
        *("direction, torque", lambda m: -m.side() * np.abs(m.load()), "torque_Nm"), beside=("joint_backlash",)
    ),
    # a rubber buffer pushes back from where a joint touches it
    "soft_stop": joint("position", lambda m: np.maximum(m.q() - m["stop"], 0.0), "stop", "joint_scale"),
    # a cable that another joint tightens pulls the disc of an encoder out of its centre
    "pulled_encoder": joint(
        *("position, position of by", lambda m: np.sin(m.q() + m["phase"]) * m.q("by"), "by phase"),
        "joint_harmonic joint_coupling",
    ),
    # grease thins as it warms, and the drive lags less behind
    "thinning_grease": joint("velocity, temperature", lambda m: m.dq() * m.s.warmth(), beside=("joint_lag",)),
    # dry friction holds a joint back when it creeps, and fades as it runs (R. Stribeck, 1902)
    "fading_friction": joint(
        *("velocity/direction", lambda m: -m.side() * np.exp(-np.abs(m.dq()) / m["fades"]), "fades"),
        beside=("joint_backlash", "joint_lag"),
    ),
    # a tooth with a crack at its root gives way to the load while it is in mesh
    "cracked_tooth": joint(
        *("torque, position", lambda m: m.load() * bump(m.q(), m["centre"], m["width"])),
        *("torque_Nm centre width", "joint_compliance"),
    ),
    # an amplifier runs out of voltage above a speed, and the servo falls behind
    "starved_servo": joint("velocity", lambda m: -beyond(m.dq(), m["limit"]), "limit", beside=("joint_lag",)),
    # a bevel gear that two motors turn together has play, which their sum takes up
    "slack_bevel": joint(
        *("velocity/direction, velocity/direction of by", lambda m: -np.sign(m.dq() + m.dq("by")), "by"),
        beside=("joint_backlash",),
    ),
    # the disc of an encoder slides out of its centre, as its glue gives
    "wandering_disc": joint(
        "time, position", lambda m: m.share() * np.sin(m.q() + m["phase"]), "span_s phase", "joint_harmonic"
    ),
    # the housing of a gear grows with warmth more than its wheels, and their play with it
    "warming_mesh": joint("direction, temperature", lambda m: -m.side() * m.s.warmth(), beside=("joint_backlash",)),
    # the roller that tightens a belt is held by a spring, and gives way where its strand bears the load
    "sprung_tensioner": joint(
        "torque", lambda m: np.maximum(m.load() - _TENSIONER, 0.0), "torque_Nm", "joint_compliance"
    ),
    # of shafts that run one in another, with grease between, one drags the other along
    "nested_shafts": joint("velocity of by", lambda m: m.dq("by"), "by", any_other=True, beside=()),
    # a wheel of a wrist that is out of centre meshes with one that another joint turns: their difference counts
    "meshing_wrist": joint(
        *("position, position of by", lambda m: np.sin(m.q() - m.q("by") + m["phase"]), "by phase"),
        "joint_harmonic joint_coupling",
    ),
    # the ring of an encoder, clamped at two points, goes oval as it warms
    "clamped_ring": joint(
        *("temperature, position", lambda m: m.s.warmth() * np.sin(2 * m.q() + m["phase"]), "phase"),
        "joint_harmonic joint_thermal_offset",
    ),
    # a pull cable runs in a sheath that another joint bends, and rubs in it the more (L. Euler, 1769)
    "bent_sheath": joint(
        *("direction, position of by", lambda m: m.side() * np.expm1(-_SHEATH * np.abs(m.q("by"))), "by"),
        any_other=True,
        beside=("joint_backlash",),
    ),
    # the spring of a dress pack goes over its dead point as another joint turns, and pulls the other way
    "flipping_pull": joint(
        *("position of by", lambda m: np.tanh((m.q("by") - m["over"]) / _DEAD_POINT), "by over"), "joint_coupling"
    ),
}
LINK: dict[str, Family] = {
    "link_tilt_by_time": link("time", lambda m: m.share(), "span_s", axes=TILT, beside=()),
    "link_tilt_by_warmth": link("temperature", lambda m: m.s.warmth(), axes=TILT, beside=()),
    # a link of plastic bends the more the warmer it is
    "softening_link": link(
        "temperature, moment x",
        lambda m: m.s.warmth() * column(m.s.moment[..., 0], m.fixed) / m["moment_Nm"],
        *("moment_Nm", "link_compliance", (3,)),
    ),
    # Coriolis's force, where two joints move at once, bends a link
    "whipped_link": link(
        *("velocity of by, velocity of and", lambda m: m.dq("by") * m.dq("and"), "by and", "", TILT), any_other=True
    ),
    # a link bows where one of its ends is warmer than the other
    "bowed_link": link(
        "temperature",
        lambda m: (m.s.temperature[:, int(m["joint"])] - m.s.temperature[:, int(m["joint"]) - 1]) / WARMER,
        axes=TILT,
        drivers_of=lambda fixed: tuple((f"temperature of joint {int(fixed['joint']) + end}",) for end in (0, 1)),
    ),
    # the balls of a bearing are pressed into their races, ever less by more load (H. Hertz, 1881)
    "dented_bearing": link(
        "moment x", lambda m: signed_power(m.moment("x"), 2 / 3), "moment_Nm", "link_compliance", (3,)
    ),
    # a casing screwed down under stress snaps over where it is warm enough, and back
    "snapping_casing": link("temperature", lambda m: (m.s.warmth() > m["snaps"]).astype(float), "snaps", axes=TILT),
    # at one speed another joint's motor makes a link hum, and a loose fit sits aside while it does
    "humming_link": link(
        *("velocity/speed of by", lambda m: bump(np.abs(m.dq("by")), m["hums"], m["band"]), "by hums"),
        axes=TILT,
        any_other=True,
    ),
    # the slanting teeth of a gear push its shaft to one end or the other of the play along its axis
    "thrusting_helix": link("torque", lambda m: np.tanh(ROCKING * m.load()), "torque_Nm", axes=(2,)),
    # a bundle of lines along the arm is too short, and two other joints take up its slack together
    "short_umbilical": link(
        *("position of by, position of and", lambda m: beyond(m.q("by") + m.q("and"), m["slack"])),
        *("by and slack", "", TILT),
    ),
    # the flanks of its teeth push a pinion, whose motor rides on its link, out of mesh, whichever way the load acts
    "parting_pinion": link("torque", lambda m: np.abs(m.load()), "torque_Nm", axes=(0, 1)),
    # a thin tube goes oval as it bends, whichever way, and bends the more (L. G. Brazier, 1927)
    "flattened_tube": link(
        *("moment x, moment y", lambda m: m.moment("x") * (m.moment("x") ** 2 + _across(m) ** 2), "moment_Nm"),
        *("link_compliance", (3,)),
    ),
}
BASE: dict[str, Family] = {
    "base_tilt_by_joint": base("position of by", lambda m: m.q("by"), "by", axes=TILT, beside=()),
    "base_yaw_by_moment": base(
        "base moment x", lambda m: m.moment("x", "base_"), "base_moment_Nm", axes=(5,), beside=()
    ),
    # a plate whose bolts hold it until the moment overcomes how tight they are
    "preloaded_base": base(
        *("base moment x", lambda m: beyond(m.moment("x", "base_"), PRELOAD), "base_moment_Nm"),
        *("base_compliance", (3,)),
    ),
    # a table on wheels stays where the last jerk of a joint pushed it
    "wheeled_table": base("direction of by", lambda m: m.side("by"), "by", axes=(0, 1)),
    # a light trolley is drawn to where the arm points as joint 1 swings it round
    "swung_trolley": base(
        *("velocity, position", lambda m: m.s.dq[:, 0] ** 2 * np.cos(m.s.q[:, 0])),
        axes=(0,),
        drivers_of=lambda fixed: (("velocity of joint 1", "speed of joint 1"), ("position of joint 1",)),
    ),
    # a truck that drives by bends the floor for a while
    "passing_truck": base(
        "time", lambda m: bump(m.s.time, m["instant_s"], m["passes_s"]), "instant_s passes_s", axes=TILT
    ),
    # a table on air sinks as its cushions leak, until the valve fills them again
    "leaking_table": base(
        *("time", lambda m: (m["turns"] * m.s.time / m["span_s"] + m["phase"] / (2 * np.pi)) % 1.0),
        *("span_s turns phase", "base_drift", (2,)),
    ),
    # pads of gel give way to what moves above them, and twice as far for every ten degrees
    "gel_pads": base(
        *("temperature, velocity of by", lambda m: np.exp2(m.s.warmth()) * m.dq("by"), "by"), axes=TILT, beside=()
    ),
    # a plate that is bolted down all round grows with warmth, and buckles where the bolts no longer keep it flat
    "buckling_plate": base(
        *("temperature", lambda m: np.sqrt(np.maximum(m.s.warmth() - m["buckles"], 0.0)), "buckles"), axes=TILT
    ),
    # springs of air under a table are now softer and now stiffer, as a compressor comes and goes
    "breathing_springs": base(
        "base moment x, time",
        lambda m: m.moment("x", "base_") * np.sin(2 * np.pi * m["turns"] * m.s.time / m["span_s"] + m["phase"]),
        *("base_moment_Nm span_s turns phase", "base_compliance", (3,)),
    ),
}
TOOL: dict[str, Family] = {
    "tool_turn_by_joint": tool("position of by", lambda m: m.q("by"), "by", axes=TILT, beside=()),
    # a clip of the target lets go
    "loose_clip": tool("time", lambda m: (m.s.time > m["instant_s"]).astype(float), "instant_s", axes=_AXES),
    # the target sinks into its glue until that is hard
    "creeping_glue": tool("time", lambda m: -np.expm1(-_CREEP * m.s.time / m["span_s"]), "span_s", axes=(2,)),
    # a detent holds a tool upright until the moment tips it against a stop
    "tipping_tool": tool(
        "moment x of flange",
        lambda m: np.sign(m.moment("x", "flange_")) * (np.abs(m.moment("x", "flange_")) > PRELOAD),
        *("flange flange_moment_Nm", "tool_compliance", (3,)),
    ),
    # a ball that is loose in its cup lies at the rim, on the side to which its weight rolls it
    "rattling_ball": tool(
        "moment x of flange, moment y of flange",
        lambda m: _across(m, "flange") / np.sqrt(m.moment("x", "flange_") ** 2 + _across(m, "flange") ** 2 + _ROLLS**2),
        "flange flange_moment_Nm",
        axes=(0,),
    ),
    # a hose that is stiff when cold and soft when warm pulls at the tool as a joint bends it
    "cold_hose": tool("temperature, position of by", lambda m: np.exp(-m.s.warmth()) * m.q("by"), "by", axes=TILT),
    # magnets hold a tool changer together until a moment of any direction levers it open
    "parting_changer": tool(
        "moment x of flange, moment y of flange",
        lambda m: np.maximum(np.hypot(m.moment("x", "flange_"), _across(m, "flange")) - PRELOAD, 0.0),
        "flange flange_moment_Nm",
        axes=(2,),
    ),
    # soft glue under the target flows as long as the recording lasts, and the faster the warmer it is
    "flowing_glue": tool("temperature, time", lambda m: m.s.warmth() * m.s.time / m["span_s"], "span_s", axes=(0, 1)),
    # the jaws of a chuck are flung outwards as the last joint spins it, and what they hold sags
    "opening_chuck": tool(
        "velocity/speed of flange, moment x of flange",
        lambda m: m.dq("flange") ** 2 * m.moment("x", "flange_"),
        *("flange flange_moment_Nm", "tool_compliance", (3,)),
    ),
}
SENSOR: dict[str, Family] = {
    "lens_distortion": image("measured position", image=lambda p: p * (p**2).sum(0)),
    "stretched_axis": image("measured position x", image=lambda p: X * p[0]),
    "sensor_turn_by_time": sensor("time", lambda m: m.share() ** m["power"], "span_s power", "sensor_drift", (3, 4, 5)),
    "sensor_shift_by_warmth": sensor("temperature", lambda m: m.s.warmth(), axes=_AXES),
    "squared_drift": sensor(
        "time", lambda m: m.share() ** m["power"], "span_s power", "sensor_drift base_drift", _AXES
    ),
    # a tall tripod that sways
    "swaying_sensor": sensor(
        *("time", lambda m: np.sin(2 * np.pi * m["turns"] * m.s.time / m["span_s"] + m["phase"])),
        *("span_s turns phase", "sensor_drift base_drift", _AXES),
    ),
    # air that is warmer on one side bends the sight, by the square of the distance
    "bent_beam": image("measured position", image=lambda p: Z * (p**2).sum(0)),
    # a sensor stands on the arm's bench, which gives way as the arm leans over
    "shared_bench": sensor("base moment x", lambda m: m.moment("x", "base_"), "base_moment_Nm", axes=_AXES),
    # the circle on which a tracker reads its azimuth turns out of its centre: by the sine, square to the sight
    "eccentric_circle": image("measured position", image=lambda p: (Y * p[0] - X * p[1]) * p[1] / np.hypot(p[0], p[1])),
    # light that strays in a distance meter mixes with its signal, and the error comes round with the phase
    "cyclic_ranger": image("measured position", image=lambda p: p * _cyclic(np.linalg.norm(p, axis=0))),
    # the head of a sensor nods in its clamp while two joints shake the floor
    "shaken_tripod": sensor(
        *("velocity/speed of by, velocity/speed of and", lambda m: m.dq("by") ** 2 + m.dq("and") ** 2),
        "by and",
        axes=TILT,
    ),
    # a sensor looks through a pane of glass, which brings what is aslant behind it nearer than what is straight
    "glass_pane": image("measured position", image=lambda p: Z * _refracted(p[2] / np.linalg.norm(p, axis=0))),
}
WORKSHOP: dict[str, Family] = {
    # a controller makes up for a joint that drives this one along, but not for the play between the two
    "lost_motion": joint(
        "position/direction/travel of by",
        lambda m: play(m.q("by"), m["width"]) - m.q("by"),
        "by width",
        "joint_coupling",
    ),
    # the rubber boot of a joint is twisted along before it slips, and pulls back whichever way that was
    "dragged_boot": joint(
        "direction/position/travel", lambda m: -wound(m.q(), 3 * m["width"]), "width", "joint_backlash joint_scale"
    ),
    # the motor of a fast joint draws down the voltage of all, and the servo of another falls behind
    "sagging_supply": joint(
        "velocity, velocity/speed of by", lambda m: -m.dq() * np.abs(m.dq("by")), "by", "joint_lag"
    ),
    # a joint's pull cable runs over another joint, which slackens it as it turns, so that it stretches more
    "tensioned_cable": joint(
        "torque, position of by", lambda m: m.load() * m.q("by"), "by torque_Nm", "joint_compliance joint_coupling"
    ),
    # the load presses a worm to a flank, and warmth, by which the bronze wheel grows, moves the flanks apart
    "warm_flanks": joint(
        "torque, temperature",
        lambda m: np.tanh(ROCKING * m.load()) * m.s.warmth(),
        "torque_Nm",
        "joint_backlash joint_compliance joint_thermal_offset",
    ),
    # of the two windings of a resolver one is read late: it is behind by its speed, and more at some angles
    "lame_resolver": joint("velocity, position", lambda m: -m.dq() * np.sin(m.q() + m["phase"]), "phase", "joint_lag"),
    # an amplifier heats up and turns its current down, and the servo falls behind by more and more
    "tiring_amplifier": joint("velocity, time", lambda m: -m.dq() * m.share(), "span_s", "joint_lag"),
    # a wheel of nylon gives way to its load, but takes its time, so that earlier loads count as well
    "nylon_wheel": joint(
        "torque", lambda m: lagged(m.load(), m.s.time, m["relaxes_s"]), "torque_Nm relaxes_s", "joint_compliance"
    ),
    # the cover of a link catches the air, by the square of the speed at which another joint sweeps it round
    "sailing_cover": link("velocity of by", lambda m: signed_power(m.dq("by"), 2.0), "by", axes=TILT),
    # a loose loom falls over in a hollow link that is tilted far enough, and lies there until it is tilted back
    "flopping_loom": link("moment x", lambda m: latch(m.moment("x"), PRELOAD), "moment_Nm", "link_compliance", (3,)),
    # the tyres of a cart give way to the moment, but slowly, and come back as slowly
    "soft_tyres": base(
        "base moment y",
        lambda m: lagged(m.moment("y", "base_"), m.s.time, m["relaxes_s"]),
        "base_moment_y_Nm relaxes_s",
        "base_compliance",
        (4,),
    ),
    # a press nearby punches at its own pace, and lifts the floor for a short while each time
    "punching_press": base(
        "time", lambda m: np.maximum(m.wave("strokes"), 0.0) ** 8, "span_s strokes phase", "base_drift", (2,)
    ),
    # a gripper opens and shuts at its own pace, and the target on its finger goes to and fro
    "cycling_gripper": tool("time", lambda m: np.sign(m.wave()), "span_s turns phase", axes=_AXES),
    # a lead trails behind the tool that a joint sweeps round, and pulls little more at full speed than at half
    "trailing_lead": tool("velocity/direction of by", lambda m: np.tanh(m.dq("by") / m["hums"]), "by hums", axes=TILT),
    # each of two hoses is dragged by a joint of its own and tugs at the tool by friction: the tugs add up
    "two_hoses": tool("direction of by, direction of and", lambda m: m.side("by") + m.side("and"), "by and", axes=TILT),
    # the clock by which a ranging sensor counts drifts from its rate, and its metre with it
    "drifting_clock": image(
        "time, measured position", lambda m: m.share(), "span_s", "sensor_drift", image=lambda p: p
    ),
    # fringes of a projector that are no pure sine leave waves in the depth, across the picture
    "moire_fringes": image("measured position x", image=lambda p: Z * np.sin(2 * np.pi * p[0] / _FRINGE)),
    # steel near its plane of origin bends the field of a magnetic tracker, and less by the distance from it
    "steel_bench": image("measured position z", image=lambda p: Z * np.exp(-np.abs(p[2]) / _FADES)),
    # a sensor's fan turns on where it is warm and off only where it is cooler, and its draught bends the stand
    "switching_fan": sensor("temperature", lambda m: latch(m.s.warmth() - m["snaps"], _SWITCHING), "snaps", axes=_AXES),
    # hoses of the arm brush against the mast of a sensor, where a joint brings them near
    "brushed_mast": sensor("position of by", lambda m: bump(m.q("by"), m["over"], _BRUSHED), "by over", axes=_AXES),
}
"""Half of a list that was split by lot, drawn from seed 9101 on; of every place."""
FAMILIES: dict[str, Family] = JOINT | LINK | BASE | TOOL | SENSOR | WORKSHOP
