"""Families of physics outside the catalogue: what each adds to a torque, on what it depends, which are sealed."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.torque_trials.effects import Scene, Values, sign
from benchmarks.torque_trials.motion import AMBIENT

Drivers = list[list[str]]
"""Each of these is a driver; one of several phrases is enough to name it."""

_WARMER = 10.0
"""K: temperatures count in these."""
_LEAST_LOAD = 0.05
"""Nm below which a load is none."""
_FRICTION = ("coulomb_friction", "viscous_friction", "stribeck_friction")


@dataclass(frozen=True)
class Family:
    """A family of physics.

    Attributes:
        torque: what a number of 1 adds to the torque of a joint that exerts the `(sample,)` last given without it;
            also of the form's other numbers, the joint (from 0), the scene.
        drivers: on what it depends, of the joint (from 1) and the form's other numbers.
        keys: what is drawn for it beside the joint.
        beside: effects of the catalogue that are true beside an unnamed one of the same joint: its straight part.
        warm: whether it needs temperatures that vary.
        nameless: whether no curve over anything recorded can be it, so that only a wrong name is wrong.
        positive: whether its number is positive by physics: friction takes energy, a spring pulls back, a sensor that
            saturates reads less. Where it may also be negative, it is a change of something that is there.
    """

    torque: Callable[[Values, int, Scene, Array], Array]
    drivers: Callable[[int, Values], Drivers]
    keys: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    warm: bool = False
    nameless: bool = False
    positive: bool = False


def _own(*quantities: str) -> Callable[[int, Values], Drivers]:
    """Drivers that are quantities of the joint itself."""
    return lambda joint, fixed: [_of(quantity, joint) for quantity in quantities]


_WORDS = {
    "load": ("gravity torque", "load", "torque"),
    "direction": ("direction of motion", "direction", "velocity"),
    "velocity": ("velocity", "speed"),
    "travel": ("travel since reversal", "position"),
}


def _of(quantity: str, joint: int) -> list[str]:
    if quantity == "time":
        return [quantity]
    said = [f"{word} of joint {joint}" for word in _WORDS.get(quantity, (quantity,))]
    return [*said, "temperature"] if quantity == "temperature" else said


def sticky_zone(fixed: Values, joint: int, s: Scene, exerted: Array) -> Array:
    """Friction where the joint passes a place."""
    near = np.exp(-0.5 * ((s.q[:, joint] - fixed["centre"]) / fixed["width"]) ** 2)
    return near * sign(s.dq[:, joint])


def squared_load_friction(fixed: Values, joint: int, s: Scene, exerted: Array) -> Array:
    """Friction that grows with the square of the load."""
    return (s.load[:, joint] / fixed["load_Nm"]) ** 2 * sign(s.dq[:, joint])


def cross_load_friction(fixed: Values, joint: int, s: Scene, exerted: Array) -> Array:
    """Friction that another joint's load makes."""
    return np.abs(s.load[:, int(fixed["by"]) - 1]) / fixed["other_load_Nm"] * sign(s.dq[:, joint])


def loaded_ripple(fixed: Values, joint: int, s: Scene, exerted: Array) -> Array:
    """A gear's mesh that ripples with two orders, the more the joint is loaded."""
    mesh = np.sin(fixed["order"] * s.q[:, joint]) + np.sin(fixed["second"] * s.q[:, joint])
    return s.load[:, joint] / fixed["load_Nm"] * mesh


def soft_stop(fixed: Values, joint: int, s: Scene, exerted: Array) -> Array:
    """An end stop of rubber: nothing before it, then the square of the way into it."""
    return np.maximum(0.0, s.q[:, joint] - fixed["at"]) ** 2


def presliding(fixed: Values, joint: int, s: Scene, exerted: Array) -> Array:
    """Dahl's friction: bristles that bend over an angle before they slide (1968), exact between samples."""
    way = np.diff(s.q[:, joint])
    bent = np.zeros(len(s.q))
    for k, step in enumerate(way):
        rest = np.sign(step)
        bent[k + 1] = rest + (bent[k] - rest) * np.exp(-abs(step) / fixed["bristle_rad"])
    return bent


def asymmetric_viscous(fixed: Values, joint: int, s: Scene, exerted: Array) -> Array:
    """Viscous friction that is larger one way than the other: the part that is even in velocity."""
    return np.abs(s.dq[:, joint])


def squared_speed(fixed: Values, joint: int, s: Scene, exerted: Array) -> Array:
    """Friction of churned oil."""
    return s.dq[:, joint] * np.abs(s.dq[:, joint])


def saturation(fixed: Values, joint: int, s: Scene, exerted: Array) -> Array:
    """A current sensor that compresses what is beyond a knee."""
    return -np.sign(exerted) * np.maximum(0.0, np.abs(exerted) - fixed["knee_Nm"])


def gain_drift(fixed: Values, joint: int, s: Scene, exerted: Array) -> Array:
    """A sensor's gain that drifts in time."""
    return (s.time / s.time[-1] - 0.5) * exerted


def quantised(fixed: Values, joint: int, s: Scene, exerted: Array) -> Array:
    """What rounding to steps of a current adds."""
    return np.round(exerted / fixed["step_Nm"]) * fixed["step_Nm"] - exerted


def hardening_cable(fixed: Values, joint: int, s: Scene, exerted: Array) -> Array:
    """A cable whose stiffness grows as it is drawn out."""
    way = s.q[:, joint] - fixed["rest"]
    return way * np.abs(way)


def warming_coulomb(fixed: Values, joint: int, s: Scene, exerted: Array) -> Array:
    """Dry friction that falls or rises with temperature."""
    return (s.temperature[:, joint] - AMBIENT) / _WARMER * sign(s.dq[:, joint])


def uneven_viscous(fixed: Values, joint: int, s: Scene, exerted: Array) -> Array:
    """Viscous friction that is larger on one side of the joint."""
    return np.sin(s.q[:, joint] - fixed["centre"]) * s.dq[:, joint]


def running_in(fixed: Values, joint: int, s: Scene, exerted: Array) -> Array:
    """Dry friction that wears off in time."""
    return np.exp(-3 * s.time / s.time[-1]) * sign(s.dq[:, joint])


def _by_other(joint: int, fixed: Values) -> Drivers:
    return [_of("load", int(fixed["by"])), *_own("direction")(joint, fixed)]


FAMILIES: dict[str, Family] = {
    "sticky_zone": Family(sticky_zone, _own("position", "direction"), ("centre", "width"), _FRICTION, positive=True),
    "squared_load_friction": Family(
        squared_load_friction, _own("load", "direction"), ("load_Nm",), (*_FRICTION, "load_friction"), positive=True
    ),
    "cross_load_friction": Family(cross_load_friction, _by_other, ("by", "other_load_Nm"), _FRICTION, positive=True),
    "loaded_ripple": Family(
        loaded_ripple, _own("position", "load"), ("order", "second", "load_Nm"), ("torque_ripple", "torque_scale")
    ),
    "soft_stop": Family(soft_stop, _own("position"), ("at",), ("joint_spring", "torque_offset"), positive=True),
    "presliding": Family(
        presliding,
        _own("direction", "travel"),
        ("bristle_rad",),
        (*_FRICTION, "joint_spring", "torque_offset"),
        positive=True,
    ),
    "asymmetric_viscous": Family(
        asymmetric_viscous, _own("velocity"), beside=("viscous_friction", "coulomb_friction", "torque_offset")
    ),
    "squared_speed": Family(squared_speed, _own("velocity"), beside=_FRICTION, positive=True),
    "saturation": Family(saturation, _own("load"), ("knee_Nm",), ("torque_scale",), positive=True),
    "gain_drift": Family(gain_drift, _own("time", "load"), beside=("torque_scale",)),
    "quantised": Family(quantised, _own("load"), ("step_Nm",), nameless=True, positive=True),
    "hardening_cable": Family(
        hardening_cable, _own("position"), ("rest",), ("joint_spring", "torque_offset"), positive=True
    ),
    "warming_coulomb": Family(
        warming_coulomb, _own("temperature", "direction"), beside=(*_FRICTION, "friction_temperature"), warm=True
    ),
    "uneven_viscous": Family(uneven_viscous, _own("position", "velocity"), ("centre",), _FRICTION),
    "running_in": Family(running_in, _own("time", "direction"), beside=_FRICTION, positive=True),
}
"""By name."""


def sealed(name: str) -> bool:
    """Whether a family is put aside for one last look: a third of them, by the SHA-256 of the name.

    The rule looks at one name alone, so that a new family moves no other.
    """
    return hashlib.sha256(name.encode()).digest()[0] % 3 == 0


OPEN = tuple(name for name in FAMILIES if not sealed(name))
SEALED = tuple(name for name in FAMILIES if sealed(name))


def drawn(name: str, rng: np.random.Generator, s: Scene, noise: Array) -> tuple[int, dict[str, float]] | None:
    """A joint (from 1) of a family and what else belongs to its form; None where no load acts that it needs."""
    dof = s.q.shape[1]
    joint = int(rng.integers(1, dof + 1))
    fixed: dict[str, float] = {}
    q, load = s.q[:, joint - 1], np.abs(s.load)
    found: dict[str, Callable[[], Any]] = {
        **dict.fromkeys(("centre", "at", "rest"), lambda: np.percentile(q, rng.uniform(25, 75))),
        "width": lambda: rng.uniform(0.1, 0.25) * np.ptp(q),
        "order": lambda: rng.integers(3, 13),
        "second": lambda: fixed["order"] + rng.integers(2, 9),
        "bristle_rad": lambda: rng.uniform(0.05, 0.2) * np.ptp(q),
        "knee_Nm": lambda: np.percentile(load[:, joint - 1], rng.uniform(50, 75)),
        "step_Nm": lambda: rng.uniform(1.0, 4.0) * noise[joint - 1],
        "by": lambda: rng.choice([k for k in range(1, dof + 1) if k != joint]),
        "other_load_Nm": lambda: np.percentile(load[:, int(fixed["by"]) - 1], 90),
        "load_Nm": lambda: np.percentile(load[:, joint - 1], 90),
    }
    for key in FAMILIES[name].keys:
        fixed[key] = float(found[key]())
    needed = [value for key, value in fixed.items() if key in ("knee_Nm", "load_Nm", "other_load_Nm")]
    return None if any(value < _LEAST_LOAD for value in needed) else (joint, fixed)
