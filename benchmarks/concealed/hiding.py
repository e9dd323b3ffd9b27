"""What is hidden: an effect somewhere it can be, of so many thresholds, and all that is known of it beforehand.

Thresholds, Cramér–Rao bounds, and what an effect may be taken for: other names, the same function at other sites,
functions by other drivers. All from the generator's own derivatives (central differences of `plain_physics.poses`),
whitened by the sensor's true noise, and seen only across what the recording leaves open: sensor frame, tool, geometry.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from itertools import chain, combinations
from typing import Any

import numpy as np

from benchmarks.campaigns import detection
from benchmarks.campaigns.detection import LEAST_SEEN, Rival, Threshold, apart, project_out, projector
from benchmarks.campaigns.judgement import is_driven
from benchmarks.concealed import outside
from benchmarks.concealed.chain import Array
from benchmarks.concealed.outside import FAMILIES
from benchmarks.concealed.outside.family import Drivers
from benchmarks.concealed.plain_physics import COORDINATES, OUTSIDE, Effects, Hidden, loaded, moments, poses
from benchmarks.concealed.plans import Plan
from benchmarks.concealed.view import View, reported, reported_slopes, source

_MOST_MOVED = 0.02
_LOADED = 0.5  # Nm from which a joint is loaded
_FRICTION = (0.1, 3.0)  # Nm between which the friction of a joint's bearing is drawn
_SITES = {
    "base_compliance": "base",
    "base_drift": "base",
    "measurement_scale": "sensor",
    "time_offset": "clock",
    "payload_error": "payload",
    "tool_offset": "tool",
}
"""Where an effect is that is at no joint and no link."""
_MOST = {
    "payload_error": 1.0,
    "time_offset": 0.04,
    "joint_lag": 0.05,
    "link_thermal_expansion": 1e-4,
    **dict.fromkeys(("joint_compliance", "link_compliance", "base_compliance"), 1e-3),
}
"""Sizes beyond which an effect is no small error any more, or of no material: kg, s, rad/Nm, 1/K (plastics); 20 mrad or
20 mm for the rest."""
_EQUAL, _EQUAL_ROWS = 0.03, 150
"""The share by which effects of equal sites may differ: axes that coincide in a design do so only nearly in an arm."""
_STEADY = "squared_drift"  # the family that moves a site by a power of the time; of power 0 it is constant
_POWERS = 3  # of a driver: a function that is to stand in for another is a polynomial of this degree
_NEARER = 1.0
"""Standard deviations by which two names of a site have to come nearer than one to be what an effect is taken for."""
_COMPARED_ROWS = 400
"""Of a recording, evenly chosen, on which functions are compared; each counts for as many as it stands for."""


def hide(plan: Plan, rng: np.random.Generator, view: View) -> Effects | None:
    """Effects of the planned names and sizes; None where one of them is out of sight."""
    drawn: list[Hidden] = []
    for name in plan.effects:
        # what the edge is made of stands at one joint: two harmonics, or a backlash beside a compliance
        at = drawn[0].number if drawn and plan.edge in ("two harmonics", "loaded backlash") else 0
        effect = _draw_effect(name, rng, view, plan, at)
        if effect is not None and name == "joint_harmonic" and at:
            # of order 2 beside 1, or another order of a gear
            first = drawn[0].fixed["order"]
            second = 3 - first if first <= 2 else first + float(rng.integers(2, 40))
            values = (*effect.values[:2], *((second,) if first > 2 else ()))
            effect = replace(effect, values=values, fixed={"order": second})
        if effect is None or any((effect.name, effect.site, effect.fixed) == (o.name, o.site, o.fixed) for o in drawn):
            return None
        drawn.append(effect)
    hidden: Effects = ()
    span = view.nuisance() if drawn else np.zeros((0, 0))
    for effect, times in zip(drawn, plan.sizes, strict=True):
        tried = (*hidden, effect)
        beside = [view.padded(view.columns(hidden, k)) for k in range(len(hidden))]
        spanned = np.concatenate([span, *beside], 1)
        if effect.name in OUTSIDE:
            spanned = beyond_named(view, effect, spanned)
        found = detection_threshold(view, tried, len(hidden), spanned)
        if found.seen < LEAST_SEEN or found.moved * times > _MOST_MOVED:
            return None
        sized = effect.scaled(found.size * times)
        if max(map(abs, sized.values[: sized.linear])) > _MOST.get(effect.name, 0.02):
            return None
        # an axis that is upright but for its making bears next to nothing: what turns it visibly is no spring of a gear
        torques = [value for key, value in sized.fixed.items() if key.endswith("torque_Nm")]
        if any(abs(sized.values[0]) > _MOST["joint_compliance"] * torque for torque in torques):
            return None
        # no arm carries less than nothing: an engine would carry nothing, and truth would lie
        if effect.name == "payload_error" and view.motion.payload.min() < -sized.values[0]:
            return None
        hidden = (*hidden, sized)
    return hidden


def beyond_named(view: View, effect: Hidden, span: Array) -> Array:
    """The span with the named effect of the same site that does most of what an effect outside the catalogue does.

    An effect outside counts by what is left of it when the catalogue has done its best.

    Args:
        view: of the recording.
        effect: outside the catalogue.
        span: the columns of all that may vary beside it, where nothing is hidden, as all columns here: elsewhere, what
            cancels would leave what effects do to each other.
    """
    if "power" in effect.fixed:
        # the form of the named effect that is the straight line of the family
        line = replace(effect, values=(0.0,), fixed={**effect.fixed, "power": 1.0})
        span = np.concatenate([span, view.padded(view.columns((line,), 0))], 1)
    absent = ("joint_offset", "joint_coupling")
    named = (rival for rival in candidates(view) if rival.site == effect.site and rival.name not in absent)
    blocks = [view.columns((other,), 0) for other in (replace(effect, values=(0.0,)), *named)]
    whole = view.padded(np.concatenate(blocks, 1))
    lengths = np.linalg.norm(whole, axis=0)
    left = project_out(span, whole / np.where(lengths > 0, lengths, 1.0))
    g, *named = np.split(left, np.cumsum([block.shape[1] for block in blocks])[:-1], 1)
    rest, least = span, np.inf
    for own in named:
        directions, sizes, _ = np.linalg.svd(own, full_matrices=False)
        directions = directions[:, sizes > LEAST_SEEN**2]
        missing = float(np.linalg.norm(g - directions @ (directions.T @ g)))
        if missing < least:
            least, rest = missing, np.concatenate([span, directions], 1)
    return rest


def _draw_effect(name: str, rng: np.random.Generator, view: View, plan: Plan, at: int = 0) -> Hidden | None:
    """Somewhere an effect can be, or at a joint; its values of the right proportions but not yet of a size."""
    dof, motion = view.setup.chain.dof, view.motion
    if name in OUTSIDE:
        found = outside.draw_form(name, rng, loaded(view.setup, motion))
        # a spring gives way to the load, never against it
        side = 1.0 if name.endswith("spring") else float(rng.choice([-1.0, 1.0]))
        return None if found is None else Hidden(name, found[0], (side,), found[1])
    joint = at or int(rng.integers(1, dof + 1))
    size = len(COORDINATES[name])
    side = float(rng.choice([-1.0, 1.0]))
    drawn = tuple(rng.normal(size=size))
    values, site, fixed = (side,) if size == 1 else drawn, _SITES.get(name, f"joint{joint}"), {}
    match name:
        case "joint_harmonic":
            phase = rng.uniform(-np.pi, np.pi)
            order = float(
                rng.choice([1.0, 2.0, float(rng.integers(3, 13)), float(rng.integers(20, 121)), rng.uniform(3, 100)])
            )
            if plan.edge == "two harmonics":
                order = float(rng.choice([1.0, 2.0])) if rng.random() < 0.5 else float(rng.integers(20, 81))
            # whether the order is a number to be found: 1 and 2 are shapes of their own
            values, fixed = (np.cos(phase), np.sin(phase), *((order,) if order > 2 else ())), {"order": order}
        case "joint_coupling":
            fixed = {"source_joint": int(rng.choice([k for k in range(1, dof + 1) if k != joint]))}
        case "joint_compliance" | "base_compliance" | "link_compliance":
            site = f"link{joint}" if name == "link_compliance" else site
            values = tuple(np.abs(rng.uniform(0.3, 1.0, size)))
        case "joint_backlash":
            values = (1.0,)
            if plan.edge == "loaded backlash":
                load = moments(view.setup.chain, motion.q, motion.payload, view.setup.payload_center)[0]
                if np.percentile(np.abs(load[:, joint - 1, 2]), 90) < _LOADED:
                    return None
            if plan.engine == "mujoco" or plan.edge == "loaded backlash":
                # of a joint's bearing, whatever the load: which flank the gear rests on is left to the forces
                fixed["friction_Nm"] = float(np.exp(rng.uniform(*np.log(_FRICTION))))
        case "link_thermal_expansion":
            values, site = (1.0,), "links" if rng.random() < 0.5 else f"link{rng.integers(1, dof)}"
        case "frame_offset":
            site = "base" if rng.random() < 0.2 else f"link{joint}"
        case "tool_offset":
            values = drawn[:3]
        case "joint_lag":
            values = (1.0,)
    return Hidden(name, site, values, fixed)


def describe(view: View, hidden: Effects) -> list[dict[str, Any]]:
    """What is hidden, with its size in thresholds beside all the rest, its bound and its nearest rival."""
    if not hidden:
        return []
    span = view.nuisance(hidden)
    columns = [view.padded(view.columns(hidden, k)) for k in range(len(hidden))]
    named = all(effect.name not in OUTSIDE for effect in hidden)
    limits = bounds(view, hidden) if named else [{} for _ in hidden]
    said = []
    for k, effect in enumerate(hidden):
        if effect.name in OUTSIDE:
            beside, family = beyond_named(view, effect, view.nuisance()), FAMILIES[effect.name]
            drivers, sites = family.drivers(effect.fixed), equal_sites(view, effect)
            rival = nearest_to_outside(view, effect, sites, drivers)
            more = {"drivers": drivers, "sites": sites, "beside": family.true_beside, "sum_of": family.sum_of}
        else:
            beside = np.concatenate([span, *columns[:k], *columns[k + 1 :]], 1)
            rival, more = nearest_rival(view, hidden, k, beside), {}
        found = detection_threshold(view, hidden, k, beside)
        about = {
            "effect": effect.name,
            "site": effect.site,
            "fixed": {key: float(value) for key, value in effect.fixed.items()},
        }
        about |= {"parameters": reported(effect), "bound": limits[k], "size": 1 / found.size, "seen": found.seen}
        said.append(about | {"moved_m": found.moved / found.size, "rival": asdict(rival)} | more)
    return said


def detection_threshold(view: View, hidden: Effects, place: int, span: Array) -> Threshold:
    """Of one of the hidden effects, the direction of its values given, across the columns of all that may vary."""
    effect, others = hidden[place], (*hidden[:place], *hidden[place + 1 :])
    # small enough for a derivative
    unit = 1e-3 if effect.name in ("time_offset", "payload_error") else 1e-4
    absent, there = (poses(view.setup, each, view.motion) for each in (others, (*others, effect.scaled(unit))))
    g = view.padded(view.difference(absent, there)[:, None] / unit)[:, 0]
    moved = np.sqrt(np.mean(np.sum((there[1] - absent[1]) ** 2, 1))) / unit
    return detection.threshold(g, span, 1 if effect.name in OUTSIDE else effect.linear, float(moved))


def bounds(view: View, hidden: Effects) -> list[dict[str, float]]:
    """The Cramér–Rao bound of every reported number: one standard deviation of the best unbiased estimate."""
    if not hidden:
        return []
    blocks = [view.padded(view.columns(hidden, k)) for k in range(len(hidden))]
    found = project_out(view.nuisance(hidden), np.concatenate(blocks, 1))
    covariance = np.linalg.pinv(found.T @ found, rcond=1e-14, hermitian=True)
    out, ends = [], np.cumsum([len(effect.values) for effect in hidden])
    for effect, end in zip(hidden, ends, strict=True):
        own = covariance[end - len(effect.values) : end, end - len(effect.values) : end]
        names, J = reported_slopes(effect)
        variances = np.einsum("ia,ab,ib->i", J, own, J)
        out.append(dict(zip(names, np.sqrt(np.maximum(variances, 0)).tolist(), strict=True)))
    return out


# ------------------------------------------------------------------ what an effect may be taken for


def candidates(view: View) -> Iterator[Hidden]:
    """What an effect may be taken for: the catalogue, each site on its own."""
    dof, moving, orientation = view.setup.chain.dof, view.motion.curve is not None, bool(view.noise[1])
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


def nearest_rival(view: View, hidden: Effects, place: int, span: Array) -> Rival:
    """Which other candidate explains most of one of the hidden effects, beside the columns of all that may vary.

    Columns are taken where all effects are as they are: elsewhere, what cancels here would leave what effects do to
    each other.
    """
    absent = (*hidden[:place], *hidden[place + 1 :])
    g = view.difference(poses(view.setup, absent, view.motion), poses(view.setup, hidden, view.motion))
    return detection.nearest(view.padded(g[:, None])[:, 0], span, _names(view, hidden, hidden[place]))


def _names(view: View, there: Effects, effect: Hidden) -> Iterator[tuple[str, str, Array]]:
    """Name, site and columns of the candidates other than `effect`, beside `there`."""
    for rival in candidates(view):
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
    left = projector(view.nuisance())
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
    left = projector(few.nuisance())
    # computed in all rows and then thinned: how far a spring has yielded depends on the whole way
    g = g.reshape(len(view.motion.q), -1)[kept].ravel() * (view.noise[0] / few.noise[0])
    rest = left(few.padded(g[:, None]))[:, 0]
    functions = []
    for name, values in _recorded(few).items():
        low, high = values.min(), values.max()
        functions.append((name, ((2 * values - low - high) / (high - low))[:, None] ** np.arange(_POWERS + 1)))
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
    s = loaded(setup, motion)
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
    g = project_out(span, thin.padded(thin.columns((effect,), 0)))
    found = [own]
    for site in (*(f"{place}{k}" for k in range(1, dof + 1) for place in ("joint", "link")), "base", "tool", "sensor"):
        if site == own:
            continue
        axes = (None,) if site.startswith("joint") else range(6)
        forms = [fixed if axis is None else {**fixed, "axis": float(axis)} for axis in axes]
        moved = [thin.columns((replace(effect, site=site, fixed=form),), 0) for form in forms]
        columns = project_out(span, thin.padded(np.concatenate(moved, 1)))
        lengths = np.linalg.norm(columns, axis=0)
        # what frames, tool or geometry can do as well is rounding, and would fit anything
        columns = columns[:, lengths > 1e-6 * max(np.linalg.norm(m) for m in moved)]
        if np.linalg.norm(project_out(columns, g)) < _EQUAL * np.linalg.norm(g):
            found.append(site)
    return found
