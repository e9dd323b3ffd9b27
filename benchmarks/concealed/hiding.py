"""What is hidden: an effect somewhere it can be, of so many thresholds, and all that is known of it beforehand."""

from dataclasses import asdict, replace
from typing import Any

import numpy as np

from benchmarks.campaigns.threshold import LEAST_SEEN, across
from benchmarks.concealed import information, outside, rivals
from benchmarks.concealed.chain import Array
from benchmarks.concealed.plain_physics import COORDINATES, OUTSIDE, Hidden, moments, signals_of
from benchmarks.concealed.plans import Plan
from benchmarks.concealed.view import View, reported

_MOST_MOVED = 0.02
_LOADED = 0.5
"""Nm from which a joint is loaded."""
_FRICTION = (0.1, 3.0)
"""Nm between which the friction of a joint's bearing is drawn."""
_MOST = {
    "payload_error": 1.0,
    "time_offset": 0.04,
    "joint_lag": 0.05,
    "joint_compliance": 1e-3,
    "link_compliance": 1e-3,
    "base_compliance": 1e-3,
    "link_thermal_expansion": 1e-4,
}
"""Sizes beyond which an effect is no small error any more, or of no material: kg, s, rad/Nm, 1/K (plastics); 20 mrad or
20 mm for the rest."""


def hide(plan: Plan, rng: np.random.Generator, view: View) -> tuple[Hidden, ...] | None:
    """Effects of the planned names and sizes; None where one of them is out of sight."""
    drawn: list[Hidden] = []
    for name in plan.effects:
        # what the edge is made of stands at one joint: two harmonics, or a backlash beside a compliance
        at = drawn[0].number if drawn and plan.edge in ("two harmonics", "loaded backlash") else 0
        effect = _draw_effect(name, rng, view, plan, at)
        if effect is not None and name == "joint_harmonic" and at:
            effect = _another_order(effect, drawn[0], rng)
        if effect is None or any((effect.name, effect.site, effect.fixed) == (o.name, o.site, o.fixed) for o in drawn):
            return None
        drawn.append(effect)
    hidden: tuple[Hidden, ...] = ()
    span = view.nuisance() if drawn else np.zeros((0, 0))
    for effect, times in zip(drawn, plan.sizes, strict=True):
        tried = (*hidden, effect)
        beside = [view.padded(view.columns(hidden, k)) for k in range(len(hidden))]
        spanned = np.concatenate([span, *beside], 1)
        if effect.name in OUTSIDE:
            spanned = beyond_named(view, effect, spanned)
        found = information.threshold(view, tried, len(hidden), spanned)
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
    form = outside.straight(effect.fixed)
    if form is not None:
        line = replace(effect, values=(0.0,), fixed=form)
        span = np.concatenate([span, view.padded(view.columns((line,), 0))], 1)
    named = [
        rival
        for rival in rivals.candidates(view.setup.chain.dof, view.motion.curve is not None, bool(view.noise[1]))
        if rival.site == effect.site and rival.name not in ("joint_offset", "joint_coupling")
    ]
    there = replace(effect, values=(0.0,))
    blocks = [view.columns((other,), 0) for other in (there, *named)]
    whole = view.padded(np.concatenate(blocks, 1))
    lengths = np.linalg.norm(whole, axis=0)
    left = across(span, whole / np.where(lengths > 0, lengths, 1.0))
    g, rest, first = left[:, :1], span, 1
    least = np.inf
    for block in blocks[1:]:
        own = left[:, first : first + block.shape[1]]
        first += block.shape[1]
        directions, sizes, _ = np.linalg.svd(own, full_matrices=False)
        directions = directions[:, sizes > LEAST_SEEN**2]
        missing = float(np.linalg.norm(g - directions @ (directions.T @ g)))
        if missing < least:
            least, rest = missing, np.concatenate([span, directions], 1)
    return rest


def _another_order(effect: Hidden, first: Hidden, rng: np.random.Generator) -> Hidden:
    """A second harmonic of the same joint: of order 2 beside 1, or another order of a gear."""
    order = first.fixed["order"]
    second = 3 - order if order <= 2 else order + float(rng.integers(2, 40))
    return replace(effect, values=(*effect.values[:2], *((second,) if order > 2 else ())), fixed={"order": second})


def _draw_effect(name: str, rng: np.random.Generator, view: View, plan: Plan, at: int = 0) -> Hidden | None:
    """Somewhere an effect can be, or at a joint; its values of the right proportions but not yet of a size."""
    dof, motion = view.setup.chain.dof, view.motion
    if name in OUTSIDE:
        found = outside.drawn(name, rng, signals_of(view.setup, motion))
        # a spring gives way to the load, never against it
        side = 1.0 if name.endswith("spring") else float(rng.choice([-1.0, 1.0]))
        return None if found is None else Hidden(name, found[0], (side,), found[1])
    joint = at or int(rng.integers(1, dof + 1))
    size = len(COORDINATES[name])
    side = float(rng.choice([-1.0, 1.0]))
    values = tuple(rng.normal(size=size))
    match name:
        case "joint_harmonic":
            phase = rng.uniform(-np.pi, np.pi)
            order = float(
                rng.choice([1.0, 2.0, float(rng.integers(3, 13)), float(rng.integers(20, 121)), rng.uniform(3, 100)])
            )
            values = (np.cos(phase), np.sin(phase))
            if plan.edge == "two harmonics":
                order = float(rng.choice([1.0, 2.0])) if rng.random() < 0.5 else float(rng.integers(20, 81))
            # whether the order is a number to be found: 1 and 2 are shapes of their own
            return Hidden(name, f"joint{joint}", (*values, order) if order > 2 else values, {"order": order})
        case "joint_coupling":
            source = int(rng.choice([k for k in range(1, dof + 1) if k != joint]))
            return Hidden(name, f"joint{joint}", (side,), {"source_joint": source})
        case "joint_compliance" | "base_compliance" | "link_compliance":
            site = {"base_compliance": "base", "link_compliance": f"link{joint}"}.get(name, f"joint{joint}")
            return Hidden(name, site, tuple(np.abs(rng.uniform(0.3, 1.0, size))))
        case "joint_backlash":
            fixed = {}
            if plan.edge == "loaded backlash":
                load = moments(view.setup.chain, motion.q, motion.payload, view.setup.payload_center)[0]
                if np.percentile(np.abs(load[:, joint - 1, 2]), 90) < _LOADED:
                    return None
            if plan.engine == "mujoco" or plan.edge == "loaded backlash":
                # of a joint's bearing, whatever the load: which flank the gear rests on is left to the forces
                fixed["friction_Nm"] = float(np.exp(rng.uniform(*np.log(_FRICTION))))
            return Hidden(name, f"joint{joint}", (1.0,), fixed)
        case "link_thermal_expansion":
            site = "links" if rng.random() < 0.5 else f"link{rng.integers(1, dof)}"
            return Hidden(name, site, (1.0,))
        case "frame_offset":
            site = "base" if rng.random() < 0.2 else f"link{joint}"
            return Hidden(name, site, values)
        case "tool_offset":
            return Hidden(name, "tool", values[:3])
        case "measurement_scale" | "time_offset" | "payload_error" | "base_drift":
            site = {"measurement_scale": "sensor", "time_offset": "clock", "payload_error": "payload"}.get(name, "base")
            return Hidden(name, site, (side,) if size == 1 else values)
    return Hidden(name, f"joint{joint}", (1.0,) if name == "joint_lag" else (side,))


def described(view: View, hidden: tuple[Hidden, ...]) -> list[dict[str, Any]]:
    """What is hidden, with its size in thresholds beside all the rest, its bound and its nearest rival."""
    if not hidden:
        return []
    span = view.nuisance(hidden)
    columns = [view.padded(view.columns(hidden, k)) for k in range(len(hidden))]
    named = all(effect.name not in OUTSIDE for effect in hidden)
    limits = information.bounds(view, hidden) if named else [{} for _ in hidden]
    said = []
    for k, effect in enumerate(hidden):
        beside = np.concatenate([span, *columns[:k], *columns[k + 1 :]], 1)
        if effect.name in OUTSIDE:
            beside = beyond_named(view, effect, view.nuisance())
        found = information.threshold(view, hidden, k, beside)
        if effect.name in OUTSIDE:
            family = outside.FAMILIES[effect.name]
            drivers, sites = family.drivers(effect.fixed), rivals.equal_sites(view, effect)
            rival = rivals.nearest_to_outside(view, effect, sites, drivers)
            of_family = {
                "drivers": [list(phrases) for phrases in drivers],
                "sites": sites,
                "beside": list(family.beside),
                "sum_of": list(family.sum_of),
            }
        else:
            rival, of_family = rivals.nearest_rival(view, hidden, k, beside), {}
        said.append(
            {
                "effect": effect.name,
                "site": effect.site,
                "fixed": {name: float(value) for name, value in effect.fixed.items()},
                "parameters": reported(effect),
                "bound": limits[k],
                "size": 1 / found.size,
                "seen": found.seen,
                "moved_m": found.moved / found.size,
                "rival": asdict(rival),
            }
            | of_family
        )
    return said
