"""Families of physics outside the catalogue: where each acts, on what it depends, and which of them are sealed.

Shares no code with the library; the names of drivers are those of its public documents. Every family is one number
times a signal without a unit, at a joint (an angle), at a link, the base, the tool or the sensor (one component of a
twist), or in the sensor's image (a shift that depends on the measured position).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain

import numpy as np

from benchmarks.concealed.chain import Array

Fixed = Mapping[str, float]
Drivers = tuple[tuple[str, ...], ...]
"""Each of these is a driver of the signal; one of several phrases is enough to name it."""

_OPENED: dict[int, tuple[str, ...]] = {
    0: (
        *("joint_bump", "joint_step", "hardening_spring", "yielding_spring", "joint_parabola", "squared_coupling"),
        *("squared_speed", "squared_warmth", "sticking_zone", "link_tilt_by_time", "link_tilt_by_warmth"),
        *("base_tilt_by_joint", "base_yaw_by_moment", "tool_turn_by_joint", "stretched_axis", "sensor_turn_by_time"),
    ),
    2321: (
        *("joint_product", "squared_bending", "tool_shift_by_warmth", "lens_distortion", "skewed_axes"),
        *("sensor_shift_by_warmth", "squared_drift"),
    ),
    2341: (
        *("eccentric_coupling", "worn_gear", "dragging_gear", "hose_pull", "gaping_flange", "rocking_base"),
        *("loose_clip", "creeping_glue", "swaying_sensor", "keystone"),
    ),
    2361: (
        *("soft_stop", "pulled_encoder", "flung_joint", "softening_link", "belt_pull", "preloaded_base"),
        *("loosening_clamp", "bent_beam"),
    ),
}
"""The families that have been looked at, by the first seed of a campaign that draws them without --sealed.

Campaigns of earlier seeds draw the families that were open then, so that a seed means the same trials for ever.
"""
_WARMER = 10.0
"""K: temperatures count in these."""
_AMBIENT = 25.0
"""°C."""
_LEAST_LOAD = 0.05
"""Nm below which a load is none."""
_PULLEY = 1.5
"""Turns of a pulley in one turn of the joint that drives it: between the orders that a wobbling axis has."""
_CREEP = 4.0
"""Time constants of a creep that a recording lasts."""
_ROCKING = 4.0
"""A moment of one part in so many of the load tips a base from one foot to another."""
_PRELOAD = 0.5
"""Of the load: the moment at which bolts that are tightened begin to give, or a detent does."""


@dataclass(frozen=True, eq=False)
class Signals:
    """What a signal can depend on; all arrays with the sample first.

    Attributes:
        q: `(sample, joint)` rad.
        dq: `(sample, joint)` rad/s.
        direction: `(sample, joint)`, -1, 0 or 1.
        time: `(sample,)` s.
        temperature: `(sample, joint)` °C.
        moment: `(sample, joint, 3)` Nm, of gravity about each frame's origin in its axes.
        base_moment: `(sample, 3)` Nm.
    """

    q: Array
    dq: Array
    direction: Array
    time: Array
    temperature: Array
    moment: Array
    base_moment: Array

    def warmth(self) -> Array:
        """`(sample,)`: the mean temperature above the ambient one, in tens of K."""
        return (self.temperature.mean(1) - _AMBIENT) / _WARMER


@dataclass(frozen=True)
class Family:
    """A family of physics.

    Attributes:
        place: joint, link, base, tool, sensor or image.
        number: the name of its one number, with its unit.
        signal: `(sample,)` by which the number is multiplied; None where it depends on the way between the samples or
            on the measured position.
        keys: what is drawn for it beside the site.
        axes: the components of a twist (x y z, then turns about them) among which one is drawn.
        drivers: on what the signal depends.
        beside: effects of the catalogue that are true beside an unnamed one at the same site: they are its straight
            part.
        sum_of: effects of the catalogue, at the same site, of which it is the sum: they are true together.
        loaded: whether it needs gravity's moments.
        moving: whether it needs velocities.
        warm: whether it needs temperatures that vary.
        skipping: whether "by" is never the next joint, whose axis would wobble by its own position.
    """

    place: str
    number: str
    signal: Callable[[Fixed, Signals], Array] | None
    keys: tuple[str, ...]
    drivers: Callable[[Fixed], Drivers]
    axes: tuple[int, ...] = ()
    beside: tuple[str, ...] = ()
    sum_of: tuple[str, ...] = ()
    loaded: bool = False
    moving: bool = False
    warm: bool = False
    skipping: bool = False


def _column(values: Array, fixed: Fixed, key: str = "joint") -> Array:
    return values[:, int(fixed[key]) - 1]


def _signed_power(values: Array, power: float) -> Array:
    return np.sign(values) * np.abs(values) ** power


def _bump(fixed: Fixed, s: Signals) -> Array:
    return np.exp(-0.5 * ((_column(s.q, fixed) - fixed["centre"]) / fixed["width"]) ** 2)


def _step(fixed: Fixed, s: Signals) -> Array:
    return (_column(s.q, fixed) > fixed["at"]).astype(float)


def _sticking(fixed: Fixed, s: Signals) -> Array:
    q = _column(s.q, fixed)
    return -_column(s.direction, fixed) * ((q > fixed["lower"]) & (q < fixed["upper"]))


def _torque(fixed: Fixed, s: Signals) -> Array:
    return _column(s.moment[..., 2], fixed) / fixed["torque_Nm"]


def _beyond(values: Array, free: float) -> Array:
    return np.sign(values) * np.maximum(np.abs(values) - free, 0.0)


def _tipped(fixed: Fixed, s: Signals) -> Array:
    load = _column(s.moment[..., 0], fixed, "flange") / fixed["flange_moment_Nm"]
    return np.sign(load) * (np.abs(load) > _PRELOAD)


def _own(quantity: str, key: str = "joint") -> Callable[[Fixed], Drivers]:
    """A quantity of the family's joint, or of the one that another key says."""
    return lambda fixed: ((f"{quantity} {int(fixed[key])}",),)


def _together(*each: Callable[[Fixed], Drivers]) -> Callable[[Fixed], Drivers]:
    return lambda fixed: tuple(chain.from_iterable(drivers(fixed) for drivers in each))


def _phrases(*phrases: str) -> Callable[[Fixed], Drivers]:
    return lambda fixed: (phrases,)


_TEMPERATURE = _phrases("temperature")  # of the arm or of a joint: they rise together
_TIME = _phrases("time")
_POSITION = "position of joint"
_TORQUE = "gravity torque of joint"
_DIRECTION = "direction of motion of joint"
_VELOCITY = "velocity of joint"
_BY_JOINT = _own(_POSITION, "by")

FAMILIES: dict[str, Family] = {
    "joint_bump": Family("joint", "height_rad", _bump, ("centre", "width"), _own(_POSITION)),
    "joint_step": Family("joint", "height_rad", _step, ("at",), _own(_POSITION)),
    "hardening_spring": Family("joint", "turn_rad", None, ("torque_Nm",), _own(_TORQUE), loaded=True),
    "yielding_spring": Family(
        "joint",
        "turn_rad",
        None,
        ("torque_Nm",),
        _own(_TORQUE),
        sum_of=("joint_compliance", "joint_windup"),  # where it slips, a spring and a play of the load add up
        loaded=True,
    ),
    "joint_parabola": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: _column(s.q, fixed) ** fixed["power"],
        ("power",),
        _own(_POSITION),
        beside=("joint_scale", "joint_offset"),
    ),
    "squared_coupling": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: _column(s.q, fixed, "by") ** fixed["power"],
        ("by", "power"),
        _BY_JOINT,
        beside=("joint_coupling", "joint_offset"),
    ),
    "joint_product": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: _column(s.q, fixed, "by") * _column(s.q, fixed, "and"),
        ("by", "and"),
        _together(_BY_JOINT, _own(_POSITION, "and")),
        beside=("joint_coupling", "joint_offset"),
    ),
    "squared_speed": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: _signed_power(_column(s.dq, fixed), fixed["power"]),
        ("power",),
        _own(_VELOCITY),
        beside=("joint_lag",),
        moving=True,
    ),
    "squared_warmth": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: s.warmth() ** fixed["power"],
        ("power",),
        _TEMPERATURE,
        beside=("joint_thermal_offset", "joint_offset"),
        warm=True,
    ),
    "sticking_zone": Family(
        "joint",
        "turn_rad",
        _sticking,
        ("lower",),
        _together(_own(_DIRECTION), _own(_POSITION)),
        beside=("joint_backlash",),
    ),
    "link_tilt_by_time": Family(
        "link", "turn_rad", lambda fixed, s: s.time / fixed["span_s"], ("span_s",), _TIME, (3, 4)
    ),
    "link_tilt_by_warmth": Family("link", "turn_rad", lambda fixed, s: s.warmth(), (), _TEMPERATURE, (3, 4), warm=True),
    "squared_bending": Family(
        "link",
        "turn_rad",
        lambda fixed, s: (_column(s.moment[..., 0], fixed) / fixed["moment_Nm"]) ** fixed["power"],
        ("moment_Nm", "power"),
        _own("gravity moment x of link"),
        (3,),
        beside=("link_compliance",),
        loaded=True,
    ),
    "base_tilt_by_joint": Family(
        "base", "turn_rad", lambda fixed, s: _column(s.q, fixed, "by"), ("by",), _BY_JOINT, (3, 4)
    ),
    "base_yaw_by_moment": Family(
        "base",
        "turn_rad",
        lambda fixed, s: s.base_moment[:, 0] / fixed["base_moment_Nm"],
        ("base_moment_Nm",),
        _phrases("base moment x"),
        (5,),
        loaded=True,
    ),
    "tool_turn_by_joint": Family(
        "tool", "turn_rad", lambda fixed, s: _column(s.q, fixed, "by"), ("by",), _BY_JOINT, (3, 4)
    ),
    "tool_shift_by_warmth": Family(
        "tool", "shift_m", lambda fixed, s: s.warmth(), (), _TEMPERATURE, (0, 1, 2), warm=True
    ),
    "lens_distortion": Family(
        "image",
        "shift_m",
        None,
        (),
        _phrases("measured position"),
        beside=("measurement_scale",),
    ),
    "skewed_axes": Family("image", "shift_m", None, (), _phrases("measured position x", "measured position y")),
    "stretched_axis": Family(
        "image", "shift_m", None, (), _phrases("measured position x"), beside=("measurement_scale",)
    ),
    "sensor_turn_by_time": Family(
        "sensor",
        "turn_rad",
        lambda fixed, s: (s.time / fixed["span_s"]) ** fixed["power"],
        ("span_s", "power"),
        _TIME,
        (3, 4, 5),
        beside=("sensor_drift",),
    ),
    "sensor_shift_by_warmth": Family(
        "sensor", "shift_m", lambda fixed, s: s.warmth(), (), _TEMPERATURE, (0, 1, 2), warm=True
    ),
    "squared_drift": Family(
        "sensor",
        "shift_m",
        lambda fixed, s: (s.time / fixed["span_s"]) ** fixed["power"],
        ("span_s", "power"),
        _TIME,
        (0, 1, 2),
        beside=("sensor_drift", "base_drift"),
    ),
    # another joint's belt runs over a pulley that is out of centre
    "eccentric_coupling": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: np.sin(_PULLEY * _column(s.q, fixed, "by") + fixed["phase"]),
        ("by", "phase"),
        _BY_JOINT,
        beside=("joint_coupling", "joint_offset"),
        skipping=True,
    ),
    # a gear that is worn more and more along its turn gives way more and more
    "worn_gear": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: _torque(fixed, s) * _column(s.q, fixed),
        ("torque_Nm",),
        _together(_own(_TORQUE), _own(_POSITION)),
        beside=("joint_compliance", "joint_scale", "joint_offset"),
        loaded=True,
    ),
    # friction that grows with the load, whichever way it acts, holds a joint back
    "dragging_gear": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: -_column(s.direction, fixed) * np.abs(_torque(fixed, s)),
        ("torque_Nm",),
        _together(_own(_DIRECTION), _own(_TORQUE)),
        beside=("joint_backlash",),
        loaded=True,
    ),
    # a hose along the arm that stiffens as another joint bends it
    "hose_pull": Family(
        "link",
        "turn_rad",
        lambda fixed, s: _column(s.q, fixed, "by") ** 3,
        ("by",),
        _BY_JOINT,
        (3, 4),
        beside=("frame_offset",),
        skipping=True,
    ),
    # a flange with a loose bolt opens under a moment of one sign and stays shut under the other
    "gaping_flange": Family(
        "link",
        "turn_rad",
        lambda fixed, s: np.maximum(_column(s.moment[..., 1], fixed) / fixed["moment_y_Nm"], 0.0),
        ("moment_y_Nm",),
        _own("gravity moment y of link"),
        (4,),
        beside=("link_compliance", "frame_offset"),
        loaded=True,
    ),
    # a table one of whose feet is short
    "rocking_base": Family(
        "base",
        "turn_rad",
        lambda fixed, s: np.tanh(_ROCKING * s.base_moment[:, 1] / fixed["base_moment_y_Nm"]),
        ("base_moment_y_Nm",),
        _phrases("base moment y"),
        (4,),
        beside=("base_compliance", "frame_offset"),
        loaded=True,
    ),
    # a clip of the target lets go
    "loose_clip": Family(
        "tool",
        "shift_m",
        lambda fixed, s: (s.time > fixed["instant_s"]).astype(float),
        ("instant_s",),
        _TIME,
        (0, 1, 2),
        beside=("tool_offset",),
    ),
    # the target sinks into its glue until that is hard
    "creeping_glue": Family(
        "tool",
        "shift_m",
        lambda fixed, s: -np.expm1(-_CREEP * s.time / fixed["span_s"]),
        ("span_s",),
        _TIME,
        (2,),
        beside=("tool_offset",),
    ),
    # a tall tripod that sways
    "swaying_sensor": Family(
        "sensor",
        "shift_m",
        lambda fixed, s: np.sin(2 * np.pi * fixed["turns"] * s.time / fixed["span_s"] + fixed["phase"]),
        ("span_s", "turns", "phase"),
        _TIME,
        (0, 1, 2),
        beside=("sensor_drift", "base_drift"),
    ),
    # an image taken aslant: what is higher in it is smaller
    "keystone": Family("image", "shift_m", None, (), _phrases("measured position"), beside=("measurement_scale",)),
    # a rubber buffer pushes back from where a joint touches it
    "soft_stop": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: np.maximum(_column(s.q, fixed) - fixed["stop"], 0.0),
        ("stop",),
        _own(_POSITION),
        beside=("joint_scale", "joint_offset"),
    ),
    # a cable that another joint tightens pulls the disc of an encoder out of its centre
    "pulled_encoder": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: np.sin(_column(s.q, fixed) + fixed["phase"]) * _column(s.q, fixed, "by"),
        ("by", "phase"),
        _together(_own(_POSITION), _BY_JOINT),
        beside=("joint_harmonic", "joint_coupling", "joint_offset"),
        skipping=True,
    ),
    # what another joint swings round pulls outwards, and the gear gives way to it
    "flung_joint": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: _column(s.dq, fixed, "by") ** 2,
        ("by",),
        _own(_VELOCITY, "by"),
        beside=("joint_offset",),
        moving=True,
    ),
    # a link of plastic bends the more the warmer it is
    "softening_link": Family(
        "link",
        "turn_rad",
        lambda fixed, s: s.warmth() * _column(s.moment[..., 0], fixed) / fixed["moment_Nm"],
        ("moment_Nm",),
        _together(_TEMPERATURE, _own("gravity moment x of link")),
        (3,),
        beside=("link_compliance", "frame_offset"),
        loaded=True,
        warm=True,
    ),
    # the belt that drives another joint pulls a link to the side on which it is taut
    "belt_pull": Family(
        "link",
        "turn_rad",
        lambda fixed, s: _column(s.direction, fixed, "by"),
        ("by",),
        _own(_DIRECTION, "by"),
        (3, 4),
        beside=("frame_offset",),
        skipping=True,
    ),
    # a plate whose bolts hold it until the moment overcomes how tight they are
    "preloaded_base": Family(
        "base",
        "turn_rad",
        lambda fixed, s: _beyond(s.base_moment[:, 0] / fixed["base_moment_Nm"], _PRELOAD),
        ("base_moment_Nm",),
        _phrases("base moment x"),
        (3,),
        beside=("base_compliance", "frame_offset"),
        loaded=True,
    ),
    # a cable tugs at the target as a joint turns, and its clamp works loose
    "loosening_clamp": Family(
        "tool",
        "turn_rad",
        lambda fixed, s: s.time / fixed["span_s"] * _column(s.q, fixed, "by"),
        ("span_s", "by"),
        _together(_TIME, _BY_JOINT),
        (3, 4),
        beside=("tool_offset",),
    ),
    # air that is warmer on one side bends the sight, by the square of the distance
    "bent_beam": Family("image", "shift_m", None, (), _phrases("measured position"), beside=("measurement_scale",)),
    # a cable drum of plastic grows with warmth
    "swelling_drum": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: s.warmth() * _column(s.q, fixed),
        (),
        _together(_TEMPERATURE, _own(_POSITION)),
        beside=("joint_scale", "joint_thermal_offset", "joint_offset"),
        warm=True,
    ),
    # a belt jumps over a tooth of its pulley
    "skipped_tooth": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: (s.time > fixed["instant_s"]).astype(float),
        ("instant_s",),
        _TIME,
        beside=("joint_offset",),
    ),
    # cables wound round a joint rub the more, the further they are wound
    "rubbing_harness": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: -_column(s.direction, fixed) * np.abs(_column(s.q, fixed)),
        (),
        _together(_own(_DIRECTION), _own(_POSITION)),
        beside=("joint_backlash",),
    ),
    # a belt that wears stretches more and more under its load
    "tiring_belt": Family(
        "joint",
        "turn_rad",
        lambda fixed, s: _torque(fixed, s) * s.time / fixed["span_s"],
        ("torque_Nm", "span_s"),
        _together(_own(_TORQUE), _TIME),
        beside=("joint_compliance", "joint_offset"),
        loaded=True,
    ),
    # Coriolis's force, where two joints move at once, bends a link
    "whipped_link": Family(
        "link",
        "turn_rad",
        lambda fixed, s: _column(s.dq, fixed, "by") * _column(s.dq, fixed, "and"),
        ("by", "and"),
        _together(_own(_VELOCITY, "by"), _own(_VELOCITY, "and")),
        (3, 4),
        beside=("frame_offset",),
        moving=True,
    ),
    # a glued joint of a link holds until it is so warm that the glue softens
    "softening_glue": Family(
        "link",
        "turn_rad",
        lambda fixed, s: np.maximum(s.warmth() - fixed["softens"], 0.0),
        ("softens",),
        _TEMPERATURE,
        (3, 4),
        beside=("frame_offset",),
        warm=True,
    ),
    # a loose plate rocks over one edge or the other, and its middle rises both times
    "lifting_plate": Family(
        "base",
        "shift_m",
        lambda fixed, s: np.abs(s.base_moment[:, 0]) / fixed["base_moment_Nm"],
        ("base_moment_Nm",),
        _phrases("base moment x"),
        (2,),
        beside=("frame_offset",),
        loaded=True,
    ),
    # a table on wheels stays where the last jerk of a joint pushed it
    "wheeled_table": Family(
        "base",
        "shift_m",
        lambda fixed, s: _column(s.direction, fixed, "by"),
        ("by",),
        _own(_DIRECTION, "by"),
        (0, 1),
        beside=("frame_offset",),
    ),
    # a cable pulls at the tool when a joint has taken up its slack
    "taut_cable": Family(
        "tool",
        "turn_rad",
        lambda fixed, s: _beyond(_column(s.q, fixed, "by"), fixed["slack"]),
        ("by", "slack"),
        _BY_JOINT,
        (3, 4),
        beside=("tool_offset",),
    ),
    # a detent holds a tool upright until the moment tips it against a stop
    "tipping_tool": Family(
        "tool",
        "turn_rad",
        _tipped,
        ("flange", "flange_moment_Nm"),
        _own("gravity moment x of link", "flange"),
        (3,),
        beside=("tool_compliance", "tool_offset"),
        loaded=True,
    ),
    # a sensor stands on the arm's bench, which gives way as the arm leans over
    "shared_bench": Family(
        "sensor",
        "shift_m",
        lambda fixed, s: s.base_moment[:, 0] / fixed["base_moment_Nm"],
        ("base_moment_Nm",),
        _phrases("base moment x"),
        (0, 1, 2),
        loaded=True,
    ),
    # the circle on which a tracker reads its azimuth turns out of its centre
    "eccentric_circle": Family(
        "image", "shift_m", None, (), _phrases("measured position"), beside=("measurement_scale",)
    ),
}
"""By name. A `power` of 2 is the family's; of 1 it is the named effect that comes nearest."""


def families(seed: int, sealed: bool = False) -> tuple[str, ...]:
    """The families that a campaign draws; where `sealed`, those that were put aside next.

    A new family is in none of `_OPENED` until it was drawn once with --sealed and looked at.
    """
    since = {name: first for first, names in _OPENED.items() for name in names}
    opened = {name: since.get(name, np.inf) for name in FAMILIES}
    if not sealed:
        return tuple(name for name, first in opened.items() if first <= seed)
    following = min((first for first in opened.values() if first > seed), default=np.inf)
    return tuple(name for name, first in opened.items() if first == following)


def drawn(name: str, rng: np.random.Generator, s: Signals) -> tuple[str, dict[str, float]] | None:
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
    if family.skipping:
        others = others[others != joint + 1]
    q = s.q[:, joint - 1]
    for key in family.keys:
        match key:
            case "by" | "and":
                fixed[key] = float(others[int(key == "and")])
            case "power":
                fixed[key] = 2.0
            case "span_s":
                fixed[key] = float(s.time[-1])
            case "instant_s":
                fixed[key] = float(rng.uniform(0.3, 0.7) * s.time[-1])
            case "turns":
                fixed[key] = float(rng.uniform(1.5, 3.5))
            case "phase":
                fixed[key] = float(rng.uniform(-np.pi, np.pi))
            case "centre":
                fixed[key] = float(np.percentile(q, rng.uniform(20, 80)))
            case "width":
                fixed[key] = float(rng.uniform(0.15, 0.35))
            case "at":
                fixed[key] = float(np.percentile(q, rng.uniform(25, 75)))
            case "stop":
                fixed[key] = float(np.percentile(q, rng.uniform(55, 80)))
            case "slack":
                fixed[key] = float(np.percentile(np.abs(_column(s.q, fixed, "by")), rng.uniform(30, 60)))
            case "softens":
                fixed[key] = float(np.percentile(s.warmth(), rng.uniform(30, 60)))
            case "flange":
                fixed[key] = float(dof)
            case "lower":
                start = rng.uniform(10, 50)
                fixed |= {"lower": float(np.percentile(q, start)), "upper": float(np.percentile(q, start + 35))}
            case _:
                load = {
                    "torque_Nm": s.moment[:, joint - 1, 2],
                    "moment_Nm": s.moment[:, joint - 1, 0],
                    "moment_y_Nm": s.moment[:, joint - 1, 1],
                    "flange_moment_Nm": s.moment[:, -1, 0],
                    "base_moment_Nm": s.base_moment[:, 0],
                    "base_moment_y_Nm": s.base_moment[:, 1],
                }[key]
                fixed[key] = float(np.percentile(np.abs(load), 90))
                if fixed[key] < _LEAST_LOAD:
                    return None
    if family.axes:
        fixed["axis"] = float(rng.choice(family.axes))
    site = {"joint": f"joint{joint}", "link": f"link{joint}", "image": "sensor"}.get(family.place, family.place)
    return site, fixed


def straight(fixed: Fixed) -> dict[str, float] | None:
    """The form of the named effect that is the straight line of a family; None where there is none."""
    return {**fixed, "power": 1.0} if "power" in fixed else None


def seen_shift(name: str, position: Array) -> Array:
    """`(sample, 3)`: what an image shifts, of a number of 1, where the sensor has the point at `(sample, 3)` m."""
    x, y, z = position.T
    match name:
        case "lens_distortion":
            return position * (x**2 + y**2 + z**2)[:, None]
        case "skewed_axes":
            return np.column_stack([y, np.zeros((len(x), 2))])
        case "stretched_axis":
            return np.column_stack([x, np.zeros((len(x), 2))])
        case "keystone":
            return np.column_stack([x * y, y**2, np.zeros(len(x))])
        case "bent_beam":
            return np.column_stack([np.zeros((len(x), 2)), x**2 + y**2 + z**2])
        case "eccentric_circle":
            # off by the sine of the azimuth, square to the line of sight
            sine = y / np.hypot(x, y)
            return np.column_stack([-y * sine, x * sine, np.zeros(len(x))])
    raise KeyError(name)
