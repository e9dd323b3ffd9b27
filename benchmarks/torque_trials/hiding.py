"""What is hidden: an effect somewhere it can be, of so many thresholds, and all that is known of it beforehand."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.torque_trials import information, outside
from benchmarks.torque_trials.effects import NAMED, Hidden
from benchmarks.torque_trials.information import View, sizes_of
from benchmarks.torque_trials.outside import FAMILIES
from benchmarks.torque_trials.physics import rigid
from benchmarks.torque_trials.plans import Plan

_MOST = {
    "scale": 0.5,
    "coefficient": 0.4,
    "offset_s": 0.04,
    "lag_s": 0.04,
    "mass_kg": 1.0,
    "x_m": 0.05,
    "y_m": 0.05,
    "z_m": 0.05,
    "tilt_x_rad": 0.2,
    "tilt_y_rad": 0.2,
}
"""Sizes beyond which an effect is no small error any more."""
_LEAST_SEEN = 0.05
"""The share of what an effect does that the rest cannot do, below which a small error of the model would hide it."""
_MOST_MOVED = 1.0
"""Of the RMS of the joint's torque or, where that is small, of 20 times its noise, that an effect may add."""


_POSITIVE = ("viscous_friction", "coulomb_friction", "load_friction", "rotor_inertia")


def hide(plan: Plan, rng: np.random.Generator, view: View) -> tuple[Hidden, ...] | None:
    """Effects of the planned names and sizes; None where one of them is out of sight, or only large ones are seen."""
    hidden: tuple[Hidden, ...] = ()
    still = 3 if plan.edge == "resting joints" else 0
    for name, times in zip(plan.effects, plan.sizes, strict=True):
        effect = _drawn(name, rng, view, hidden, still)
        if effect is None or any((effect.name, effect.site) == (o.name, o.site) for o in hidden if not plan.edge):
            return None
        tried = (*hidden, effect)
        if "step_Nm" in effect.fixed:
            hidden = tried
            continue
        found = information.threshold(view, tried, len(hidden), _beside(view, tried, len(hidden)))
        if found.seen < _LEAST_SEEN:
            return None
        sized = effect.scaled(found.size * times, sizes_of(effect))
        if any(abs(sized.values[key]) > _MOST.get(key, np.inf) for key in sizes_of(sized)):
            return None
        if sized.name == "link_mass" and sized.values["mass_kg"] < -0.5 * view.setup.arm.chain.mass[sized.number - 1]:
            return None
        if sized.name == "payload_error" and view.motion.payload.min() + sized.values["mass_kg"] < 0:
            return None
        hidden = (*hidden, sized)
    added = np.sqrt(np.mean((view.torques(hidden) - view.torques(())) ** 2, 0))
    most = np.maximum(np.sqrt(np.mean(view.torques(()) ** 2, 0)), 20 * view.setup.arm.noise)
    return None if np.any(added > _MOST_MOVED * most) else hidden


def _beside(view: View, hidden: Sequence[Hidden], place: int) -> Array:
    """The columns of all that may vary beside one of the effects: the nuisance and the others.

    Beside an effect outside the catalogue this is all, too, that the catalogue may add to the same joint: it counts by
    what is left of it when the catalogue has done its best.
    """
    blocks = [view.span()]
    for k, other in enumerate(hidden):
        if k != place:
            blocks.append(view.columns(hidden, k, sizes_of(other)))
    if hidden[place].name in FAMILIES:
        blocks.append(information.ladder(view, hidden[place].number))
    return np.concatenate(blocks, 1)


def _drawn(name: str, rng: np.random.Generator, view: View, before: Sequence[Hidden], still: int) -> Hidden | None:
    """Somewhere an effect can be; its values of the right proportions but not yet of a size."""
    dof, motion = view.setup.arm.chain.dof, view.motion
    if name in FAMILIES:
        found = outside.drawn(name, rng, rigid(view.setup, (), motion), view.setup.arm.noise)
        if found is None:
            return None
        side = float(rng.choice([-1.0, 1.0]))
        return Hidden(name, f"joint{found[0]}", {"size": 1.0 if FAMILIES[name].positive else side}, found[1])
    # a second ripple stands at the joint of the first
    joint = before[-1].number if before and before[-1].name == name else int(rng.integers(1 + still, dof + 1))
    site, side = f"joint{joint}", float(rng.choice([-1.0, 1.0]))
    q = motion.q[:, joint - 1]
    match name:
        case "stribeck_friction":
            return Hidden(name, site, {"stribeck_Nm": 1.0, "velocity_rad_per_s": float(rng.uniform(0.05, 0.3))})
        case "coupled_friction":
            joint = int(rng.choice([dof, dof, max(2, joint)]))
            viscous, dry = rng.uniform(0.2, 1.0, 2)
            values = {"viscous_Nm_s_per_rad": float(viscous), "coulomb_Nm": float(dry)}
            return Hidden(name, f"joint{joint}", values | {"source_joint": joint - 1.0})
        case "joint_spring":
            rest = float(np.percentile(q, rng.uniform(20, 80)))
            return Hidden(name, site, {"stiffness_Nm_per_rad": 1.0, "rest_rad": rest})
        case "torque_ripple":
            order = float(rng.choice([float(rng.integers(2, 13)), float(rng.integers(13, 61)), rng.uniform(2, 40)]))
            if any(abs(order - other.values.get("order", np.inf)) < 1 for other in before):
                return None
            phase = float(rng.uniform(-np.pi, np.pi))
            return Hidden(name, site, {"amplitude_Nm": 1.0, "order": order, "phase_rad": phase})
        case "link_com":
            return Hidden(name, f"link{joint}", dict(zip(("x_m", "y_m", "z_m"), 0.1 * rng.normal(size=3), strict=True)))
        case "base_tilt":
            return Hidden(name, "base", dict(zip(("tilt_x_rad", "tilt_y_rad"), rng.normal(size=2), strict=True)))
    (size,) = NAMED[name].sizes
    site = {"link_mass": f"link{joint}", "payload_error": "payload", "time_offset": "clock"}.get(name, site)
    return Hidden(name, site, {size: 1.0 if name in _POSITIVE else side})


def usual(view: View, hidden: Sequence[Hidden]) -> list[dict[str, Any]]:
    """What is not hidden but there, as all arms have it: without its threshold, its bound and its rivals."""
    said = []
    for effect in hidden:
        added = view.torques((effect,)) - view.torques(())
        numbers = {"parameters": dict(effect.values), "fixed": {}, "bound": {}, "size": None, "seen": None}
        moved = float(np.sqrt(np.mean(added**2)))
        said.append({"effect": effect.name, "site": effect.site, "moved_Nm": moved, "rival": None} | numbers)
    return said


def described(view: View, hidden: Sequence[Hidden]) -> list[dict[str, Any]]:
    """What is hidden, with its size in thresholds beside all the rest, its bound and its nearest rival."""
    named = all(effect.name not in FAMILIES for effect in hidden)
    limits = information.bounds(view, hidden) if named else [{} for _ in hidden]
    said = []
    for k, effect in enumerate(hidden):
        span = _beside(view, hidden, k)
        found = information.threshold(view, hidden, k, span)
        absent = [*hidden[:k], *hidden[k + 1 :]]
        added = view.torques(hidden) - view.torques(absent)
        rival = None if effect.name in FAMILIES else information.nearest_rival(view, hidden, k, span)
        said.append(
            {
                "effect": effect.name,
                "site": effect.site,
                "parameters": {name: float(value) for name, value in effect.values.items()},
                "fixed": {name: float(value) for name, value in effect.fixed.items()},
                "bound": limits[k],
                "size": 1 / found.size if found.size else None,
                "seen": found.seen,
                "moved_Nm": float(np.sqrt(np.mean(added**2))),
                "rival": None if rival is None else asdict(rival),
            }
        )
        if effect.name in FAMILIES:
            family = FAMILIES[effect.name]
            said[-1] |= {
                "drivers": family.drivers(effect.number, effect.fixed),
                "beside": list(family.beside),
                "nameless": family.nameless,
            }
    return said
