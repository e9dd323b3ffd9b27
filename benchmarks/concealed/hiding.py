"""What is hidden: an effect somewhere it can be, of so many thresholds, and all that is known of it beforehand."""

from dataclasses import asdict
from typing import Any

import numpy as np

from benchmarks.concealed import information
from benchmarks.concealed.chain import Array
from benchmarks.concealed.plain_physics import COORDINATES, OUTSIDE, Hidden, moments
from benchmarks.concealed.plans import Plan
from benchmarks.concealed.view import View, across, reported

_MOST_MOVED = 0.02
_MOST = {
    "payload_error": 1.0,
    "time_offset": 0.04,
    "joint_lag": 0.05,
    "joint_compliance": 1e-3,
    "base_compliance": 1e-3,
}
"""Sizes beyond which an effect is no small error any more: kg, s, rad/Nm; 20 mrad or 20 mm for the rest."""


def hide(plan: Plan, rng: np.random.Generator, view: View) -> tuple[Hidden, ...] | None:
    """Effects of the planned names and sizes; None where one of them is out of sight."""
    drawn: list[Hidden] = []
    for name in plan.effects:
        effect = _draw_effect(name, rng, view, plan.engine)
        if effect is None or any((effect.name, effect.site) == (o.name, o.site) for o in drawn):
            return None
        drawn.append(effect)
    hidden: tuple[Hidden, ...] = ()
    span = view.nuisance() if drawn else np.zeros((0, 0))
    for effect, times in zip(drawn, plan.sizes, strict=True):
        tried = (*hidden, effect)
        beside = [view.padded(view.columns(hidden, k)) for k in range(len(hidden))]
        spanned = np.concatenate([span, *beside], 1)
        if effect.name in OUTSIDE:
            spanned = _beyond_named(view, effect, spanned)
        found = information.threshold(view, tried, len(hidden), spanned)
        if found.seen < information.LEAST_SEEN or found.moved * times > _MOST_MOVED:
            return None
        sized = effect.scaled(found.size * times)
        if max(map(abs, sized.values[: sized.linear])) > _MOST.get(effect.name, 0.02):
            return None
        # bodies weigh something: an engine that is to carry less than nothing carries nothing, and truth would lie
        if plan.engine == "mujoco" and effect.name == "payload_error" and view.motion.payload.min() < -sized.values[0]:
            return None
        hidden = (*hidden, sized)
    return hidden


def _beyond_named(view: View, effect: Hidden, span: Array) -> Array:
    """The span with the named effect of the same joint that does most of what an effect outside the catalogue does.

    An effect outside counts by what is left of it when the catalogue has done its best.
    """
    g = view.padded(view.columns((effect.scaled(1e-3),), 0))
    alternatives = []
    for rival in information.candidates(view.setup.chain.dof, view.motion.curve is not None, bool(view.noise[1])):
        if rival.site == effect.site and rival.name not in ("joint_offset", "joint_coupling"):
            wider = np.concatenate([span, view.padded(view.columns((rival,), 0))], 1)
            alternatives.append((float(np.linalg.norm(across(wider, g))), wider))
    return min(alternatives, key=lambda pair: pair[0])[1]


def _draw_effect(name: str, rng: np.random.Generator, view: View, engine: str) -> Hidden | None:
    """Somewhere an effect can be, its values of the right proportions but not yet of a size."""
    dof, motion = view.setup.chain.dof, view.motion
    joint = int(rng.integers(1, dof + 1))
    q = motion.q[:, joint - 1]
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
            # whether the order is a number to be found: 1 and 2 are shapes of their own
            return Hidden(name, f"joint{joint}", (*values, order) if order > 2 else values, {"order": order})
        case "joint_coupling":
            source = int(rng.choice([k for k in range(1, dof + 1) if k != joint]))
            return Hidden(name, f"joint{joint}", (side,), {"source_joint": source})
        case "joint_compliance" | "base_compliance" | "hardening_spring" | "yielding_spring" | "link_compliance":
            site = {"base_compliance": "base", "link_compliance": f"link{joint}"}.get(name, f"joint{joint}")
            fixed = {}
            if name.endswith("spring"):
                load = np.abs(moments(view.setup.chain, motion.q, motion.payload, view.setup.payload_center)[0])
                fixed["torque_Nm"] = float(np.percentile(load[:, joint - 1, 2], 90))
                if fixed["torque_Nm"] < 0.05:
                    return None
            return Hidden(name, site, tuple(np.abs(rng.uniform(0.3, 1.0, size))), fixed)
        case "joint_backlash":
            fixed = {}
            if engine == "mujoco":
                load = np.abs(moments(view.setup.chain, motion.q, motion.payload, view.setup.payload_center)[0])
                fixed["drag_Nm"] = float(2 * load[:, joint - 1, 2].max() + 0.5)
                if fixed["drag_Nm"] > 8:
                    return None
            return Hidden(name, f"joint{joint}", (1.0,), fixed)
        case "joint_bump":
            fixed = {"centre": float(np.percentile(q, rng.uniform(20, 80))), "width": float(rng.uniform(0.15, 0.35))}
            return Hidden(name, f"joint{joint}", (side,), fixed)
        case "joint_step":
            return Hidden(name, f"joint{joint}", (side,), {"at": float(np.percentile(q, rng.uniform(25, 75)))})
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
            beside = _beyond_named(view, effect, beside)
        found = information.threshold(view, hidden, k, beside)
        rival = information.nearest_rival(view, hidden, k, beside) if effect.name not in OUTSIDE else None
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
                "rival": None if rival is None else asdict(rival),
            }
        )
    return said
