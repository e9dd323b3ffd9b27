"""What an effect may be taken for: other names, the same function at other sites, functions by other drivers.

All from the generator's own derivatives, whitened by the sensor's true noise, as in `information`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, combinations

import numpy as np

from benchmarks.campaigns.judgement import is_driven
from benchmarks.campaigns.threshold import Rival, across, apart, beyond
from benchmarks.concealed.chain import Array
from benchmarks.concealed.outside import FAMILIES
from benchmarks.concealed.outside.family import Drivers
from benchmarks.concealed.plain_physics import Hidden, poses, signals_of
from benchmarks.concealed.view import View, source

_EQUAL, _EQUAL_ROWS = 0.03, 150
"""The share by which sites may differ that are called equal: axes that an arm's maker meant to be one are not quite."""
_STEADY = "squared_drift"
"""The family that does a power of the time, of 0 the same at every sample, at any site."""
_POWERS = 3
"""Of a driver: a function that is to stand in for another is a polynomial of this degree."""
_NEARER = 1.0
"""Standard deviations by which two names of a site have to come nearer than one to be what an effect is taken for."""
_COMPARED_ROWS = 400
"""Of a recording, evenly chosen, on which functions are compared; each counts for as many as it stands for."""


def candidates(dof: int, moving: bool, orientation: bool) -> Iterator[Hidden]:
    """What an effect may be taken for: the catalogue, each site on its own."""
    joints = range(1, dof + 1)
    for joint in joints:
        for name in ("joint_offset", "joint_scale", "joint_compliance", "joint_backlash"):
            yield Hidden(name, f"joint{joint}", (0.0,))
        if moving:
            yield Hidden("joint_lag", f"joint{joint}", (0.0,))
        for order in (1.0, 2.0):
            yield Hidden("joint_harmonic", f"joint{joint}", (0.0, 0.0), {"order": order})
        for other in joints:
            if other != joint:
                yield Hidden("joint_coupling", f"joint{joint}", (0.0,), {"source_joint": other})
        yield Hidden("link_compliance", f"link{joint}", (0.0, 0.0))
        yield Hidden("frame_offset", f"link{joint}", (0.0,) * 6)
        if joint < dof:
            yield Hidden("link_thermal_expansion", f"link{joint}", (0.0,))
    yield Hidden("link_thermal_expansion", "links", (0.0,))
    yield Hidden("frame_offset", "base", (0.0,) * 6)
    yield Hidden("base_compliance", "base", (0.0, 0.0))
    yield Hidden("base_drift", "base", (0.0,) * 3)
    yield Hidden("tool_offset", "tool", (0.0,) * (6 if orientation else 3))
    yield Hidden("measurement_scale", "sensor", (0.0,))
    if moving:
        yield Hidden("time_offset", "clock", (0.0,))


def nearest_rival(view: View, hidden: tuple[Hidden, ...], place: int, span: Array) -> Rival:
    """Which other candidate explains most of one of the hidden effects, beside the columns of all that may vary.

    Columns are taken where all effects are as they are: elsewhere, what cancels here would leave what effects do to
    each other.
    """
    absent = (*hidden[:place], *hidden[place + 1 :])
    g = view.difference(poses(view.setup, absent, view.motion), poses(view.setup, hidden, view.motion))
    left = beyond(span)
    rest = left(view.padded(g[:, None]))[:, 0]
    best = Rival("", "", float(np.linalg.norm(rest)))
    for name, site, columns in _names(view, hidden, hidden[place]):
        best = best.or_nearer(name, site, apart(rest, columns, left(columns)))
    return best


def _names(view: View, there: tuple[Hidden, ...], effect: Hidden) -> Iterator[tuple[str, str, Array]]:
    """Name, site and columns of the candidates other than `effect`, beside `there`."""
    for rival in candidates(view.setup.chain.dof, view.motion.curve is not None, bool(view.noise[1])):
        order = effect.fixed.get("order")
        same = (rival.name, rival.site) == (effect.name, effect.site)
        if not same or dict(rival.fixed) != ({} if order is None else {"order": order}) | source(effect):
            yield rival.name, rival.site, view.padded(view.columns((*there, rival), len(there)))


def nearest_to_outside(view: View, effect: Hidden, sites: Sequence[str], drivers: Drivers) -> Rival:
    """What an effect outside the catalogue is most easily taken for: a name, two of one site, or another function.

    That is a function elsewhere or of another driver. Orders of gears and wind-up are not among the names, so that the
    distance is an upper limit.

    Functions are polynomials of degree `_POWERS` of any driver: of an angle, or of one component of a twist. One of the
    effect's drivers is enough, at one of its `equal_sites`, for a function to be no other.
    """
    g = view.difference(poses(view.setup, (), view.motion), poses(view.setup, (effect,), view.motion))
    # linearised without the effect: beside a tool that turns, an offset of the tool would itself turn, and mimic it
    left = beyond(view.nuisance())
    rest = left(view.padded(g[:, None]))[:, 0]
    best = Rival("", "", float(np.linalg.norm(rest)))
    of_sites: dict[str, list[tuple[str, Array, Array]]] = {}
    for name, site, columns in chain(_names(view, (), effect), _names_of_time_and_warmth(view), _wobbles(view)):
        seen = left(columns)
        best = best.or_nearer(name, site, apart(rest, columns, seen))
        of_sites.setdefault(site, []).append((name, columns, seen))
    for site, names in of_sites.items():
        for (one, *first), (other, *second) in combinations(names, 2):
            distance = apart(rest, *map(np.hstack, zip(first, second, strict=True)))
            if distance < best.apart - _NEARER:
                best = Rival(f"{one} and {other}", site, distance)
    few, kept = view.thinned(_COMPARED_ROWS)
    left = beyond(few.nuisance())
    # computed in all rows and then thinned: how far a spring has yielded depends on the whole way
    g = g.reshape(len(view.motion.q), -1)[kept].ravel() * (view.noise[0] / few.noise[0])
    rest = left(few.padded(g[:, None]))[:, 0]
    functions = [(name, _powers(values)) for name, values in _recorded(few).items()]
    width = _POWERS + 1
    for site, axis in _components(view.setup.chain.dof):
        there = [k for k, (name, _) in enumerate(functions) if not (site in sites and is_driven(name, drivers))]
        if site != "sensor":
            there = [k for k in there if not functions[k][0].startswith("measured")]
        moved = few.columns((Hidden(_STEADY, site, (0.0,), {"span_s": 1.0, "power": 0.0, "axis": axis}),), 0)
        each = np.repeat(np.hstack([functions[k][1] for k in there]), len(moved) // len(few.motion.q), 0)
        columns = few.padded(moved * each)
        seen = left(columns)
        for place, k in enumerate(there):
            block = slice(width * place, width * (place + 1))
            distance = apart(rest, columns[:, block], seen[:, block])
            best = best.or_nearer(f"function of {functions[k][0]}", site, distance)
    return best


def _names_of_time_and_warmth(view: View) -> Iterator[tuple[str, str, Array]]:
    """Name, site and columns of effects by time and temperature that are not among `candidates`.

    A warm-up is a straight line and a parabola of the time: what an exponential is before it ends.
    """
    length = float(view.motion.time[-1]) or 1.0

    def powers(site: str, axis: float, *degrees: int) -> Array:
        forms = ({"span_s": length, "power": float(degree), "axis": axis} for degree in degrees)
        columns = [view.columns((Hidden(_STEADY, site, (0.0,), form),), 0) for form in forms]
        return view.padded(np.concatenate(columns, 1))

    for number in range(1, view.setup.chain.dof + 1):
        warm = Hidden("squared_warmth", f"joint{number}", (0.0,), {"joint": float(number), "power": 1.0})
        yield "joint_thermal_offset", warm.site, view.padded(view.columns((warm,), 0))
        yield "joint_warm_up", warm.site, powers(warm.site, 0.0, 1, 2)
    yield "sensor_drift", "sensor", np.concatenate([powers("sensor", float(axis), 1) for axis in range(6)], 1)


def _wobbles(view: View) -> Iterator[tuple[str, str, Array]]:
    """Name, site and columns of wobbling axes: before a joint turns, its frame tilts by waves of its angle."""
    for number in range(1, view.setup.chain.dof + 1):
        angle = view.motion.q[:, number - 1]
        forms = ({"span_s": 1.0, "power": 0.0, "axis": axis} for axis in (3.0, 4.0))
        about_x, about_y = (view.columns((Hidden(_STEADY, f"link{number}", (0.0,), form),), 0) for form in forms)
        each = len(about_x) // len(angle)
        c, s = np.repeat(np.cos(angle), each)[:, None], np.repeat(np.sin(angle), each)[:, None]
        # a tilt before the rotation, by what it is after it
        before = np.hstack([c * about_x - s * about_y, s * about_x + c * about_y])
        waves = (np.repeat(wave(order * angle), each)[:, None] for order in (1, 2) for wave in (np.sin, np.cos))
        yield "axis_wobble", f"joint{number}", view.padded(np.hstack([before * wave for wave in waves]))


def _components(dof: int) -> Iterator[tuple[str, float]]:
    """Where a function may act: an angle of a joint, a component of a twist at a link, the base, the tool, the sensor.

    A turn of a link about its z is the angle of its joint.
    """
    for number in range(1, dof + 1):
        yield f"joint{number}", 0.0
        yield from ((f"link{number}", float(axis)) for axis in range(5))
    yield from ((site, float(axis)) for site in ("base", "tool", "sensor") for axis in range(6))


def _recorded(view: View) -> dict[str, Array]:
    """`(sample,)` of all that a function may depend on, under the names of the library's public documents."""
    setup, motion = view.setup, view.motion
    s = signals_of(setup, motion)
    found = {"time": s.time, "temperature": s.warmth()}
    for number in range(1, setup.chain.dof + 1):
        i = number - 1
        found |= {
            f"position of joint {number}": s.q[:, i],
            f"velocity of joint {number}": s.dq[:, i],
            f"direction of motion of joint {number}": s.direction[:, i],
            f"gravity torque of joint {number}": s.moment[:, i, 2],
            f"gravity moment x of link {number}": s.moment[:, i, 0],
            f"gravity moment y of link {number}": s.moment[:, i, 1],
        }
    position = poses(setup, (), motion)[1]
    for axis, name in enumerate("xyz"):
        found |= {f"base moment {name}": s.base_moment[:, axis], f"measured position {name}": position[:, axis]}
    return {name: values for name, values in found.items() if np.ptp(values) > 0}


def _powers(values: Array) -> Array:
    """`(sample, power)` of a driver, brought between -1 and 1."""
    low, high = values.min(), values.max()
    return ((2 * values - low - high) / (high - low))[:, None] ** np.arange(_POWERS + 1)


def equal_sites(view: View, effect: Hidden) -> list[str]:
    """The sites where the same function of the same driver moves what is seen in the same way; the effect's own first.

    The base may move or the sensor, the tool or the link that carries it: no recording tells these apart.
    """
    dof, own = view.setup.chain.dof, effect.site
    if FAMILIES[effect.name].place == "image":
        return [own]
    thin = replace(view, motion=view.motion.thinned(_EQUAL_ROWS))
    fixed = effect.fixed
    span = thin.nuisance()
    g = across(span, thin.padded(thin.columns((effect,), 0)))
    found = [own]
    for site in (*(f"{place}{k}" for k in range(1, dof + 1) for place in ("joint", "link")), "base", "tool", "sensor"):
        if site == own:
            continue
        axes = (None,) if site.startswith("joint") else range(6)
        forms = [fixed if axis is None else {**fixed, "axis": float(axis)} for axis in axes]
        moved = [thin.columns((replace(effect, site=site, fixed=form),), 0) for form in forms]
        columns = across(span, thin.padded(np.concatenate(moved, 1)))
        lengths = np.linalg.norm(columns, axis=0)
        # what frames, tool or geometry can do as well is rounding, and would fit anything
        columns = columns[:, lengths > 1e-6 * max(np.linalg.norm(m) for m in moved)]
        if np.linalg.norm(across(columns, g)) < _EQUAL * np.linalg.norm(g):
            found.append(site)
    return found
