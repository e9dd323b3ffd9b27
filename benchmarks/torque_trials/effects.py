"""What is hidden in torques: the catalogue's effects by the formulas of its public table, and families it lacks.

Shares no code with the library. The sample comes first.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.concealed.outside.family import bump

Values = Mapping[str, float]
Curve = Callable[[Array], tuple[Array, Array, Array]]  # `(sample, joint)` rad, rad/s and rad/s² at `(sample,)` s
Drivers = list[list[str]]  # each of these is a driver; one of several phrases is enough to name it

SMOOTH = 2e-3  # rad/s within which a sign turns: sign(v) is tanh(v / SMOOTH)
AMBIENT = 25.0  # °C
_WARMER = 10.0  # K: families count temperatures in these
_LEAST_LOAD = 0.05  # Nm below which a load is none


@dataclass(frozen=True, eq=False)
class Motion:
    """What an arm does: arrays with the sample first."""

    time: Array  # `(sample,)` s
    q: Array  # `(sample, joint)` rad
    dq: Array  # `(sample, joint)` rad/s
    ddq: Array  # `(sample, joint)` rad/s²
    temperature: Array  # `(sample, joint)` °C
    payload: Array  # `(sample,)` kg, as declared
    curve: Curve  # the motion at any time
    # `(sample, joint)` Nm of the rigid bodies, once it is known
    load: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def later(self, offset: float) -> "Motion":
        """The motion that is so many seconds ahead, at the same times."""

        def curve(time: Array) -> tuple[Array, Array, Array]:
            return self.curve(time + offset)

        q, dq, ddq = curve(self.time)
        return replace(self, q=q, dq=dq, ddq=ddq, curve=curve)

    def thinned(self, every: int) -> "Motion":
        """Every so many samples of it."""
        names = ("time", "q", "dq", "ddq", "temperature", "payload")
        return replace(self, **{name: getattr(self, name)[::every] for name in names})


class Joint:
    """What happens at one joint; the numbers of an effect are its items.

    Attributes:
        numbers: of the effect.
        i: which joint, from 0.
        s: the motion, with its load.
        exerted: `(sample,)` Nm that the joint exerts without the effect.
        q: `(sample,)` rad.
        dq: `(sample,)` rad/s.
        load: `(sample,)` Nm.
    """

    def __init__(self, numbers: Values, i: int, s: Motion, exerted: Array | None = None):
        self.numbers, self.i, self.s = numbers, i, s
        self.q, self.dq, self.load = s.q[:, i], s.dq[:, i], s.load[:, i]
        self.exerted = self.load if exerted is None else exerted

    def __getitem__(self, name: str) -> float:
        return self.numbers[name]

    @property
    def sign(self) -> Array:
        """`(sample,)`: the direction of motion, smooth about rest."""
        return sign(self.dq)

    @property
    def warmth(self) -> Array:
        """`(sample,)` K above the ambient temperature."""
        return self.s.temperature[:, self.i] - AMBIENT


@dataclass(frozen=True)
class Hidden:
    """An effect at a site."""

    name: str  # a key of `NAMED` or `FAMILIES`
    site: str  # jointN, linkN, base, payload or clock
    values: Values  # its numbers under the names that the library reports; of a family, its `size`
    fixed: Values = field(default_factory=dict)  # what else belongs to its form, that nobody asks for

    @property
    def number(self) -> int:
        """Of the joint or link, counted from 1; 0 where the site is neither."""
        return int("".join(filter(str.isdecimal, self.site)) or 0)

    @property
    def sizes(self) -> tuple[str, ...]:
        """The numbers that say how large it is."""
        return NAMED[self.name].sizes if self.name in NAMED else ("size",)

    @property
    def estimated(self) -> tuple[str, ...]:
        """The numbers that a fit estimates."""
        return (*self.sizes, *NAMED[self.name].shapes) if self.name in NAMED else self.sizes

    def moved(self, **values: float) -> "Hidden":
        """The same with some other numbers."""
        return replace(self, values={**self.values, **values})

    def scaled(self, factor: float) -> "Hidden":
        """The same, so many times as large."""
        return self.moved(**{name: factor * self.values[name] for name in self.sizes})


def sign(velocity: Array) -> Array:
    """The direction of motion, smooth about rest."""
    return np.tanh(velocity / SMOOTH)


@dataclass(frozen=True)
class Named:
    """An effect of the catalogue."""

    sizes: tuple[str, ...]  # the numbers that say how large it is
    # what it adds to a joint's torque; None where it changes the arm, gravity, the payload or the clock
    torque: Callable[[Joint], Array] | None = None
    linear: int = 1  # in how many coordinates it is linear: a ripple of a known order in two
    shapes: tuple[str, ...] = ()  # its other numbers, which are estimated as well
    positive: bool = False  # whether its size is positive by physics


def _coupled(m: Joint) -> Array:
    """As either of two joints feels it: of the sum of their velocities."""
    both = m.dq + m.s.dq[:, int(m["source_joint"]) - 1]
    return m["viscous_Nm_s_per_rad"] * both + m["coulomb_Nm"] * sign(both)


NAMED: dict[str, Named] = {
    "viscous_friction": Named(("viscous_Nm_s_per_rad",), lambda m: m["viscous_Nm_s_per_rad"] * m.dq, positive=True),
    "coulomb_friction": Named(("coulomb_Nm",), lambda m: m["coulomb_Nm"] * m.sign, positive=True),
    "stribeck_friction": Named(
        ("stribeck_Nm",),
        lambda m: m["stribeck_Nm"] * np.exp(-((m.dq / m["velocity_rad_per_s"]) ** 2)) * m.sign,
        shapes=("velocity_rad_per_s",),
    ),
    "load_friction": Named(("coefficient",), lambda m: m["coefficient"] * np.abs(m.load) * m.sign, positive=True),
    "friction_temperature": Named(("viscous_Nm_s_per_rad_K",), lambda m: m["viscous_Nm_s_per_rad_K"] * m.warmth * m.dq),
    "coupled_friction": Named(("viscous_Nm_s_per_rad", "coulomb_Nm"), _coupled, 2),
    "torque_offset": Named(("offset_Nm",), lambda m: np.full(len(m.q), m["offset_Nm"])),
    "torque_scale": Named(("scale",)),
    "rotor_inertia": Named(("inertia_kg_m2",), lambda m: m["inertia_kg_m2"] * m.s.ddq[:, m.i], positive=True),
    "joint_spring": Named(
        ("stiffness_Nm_per_rad",), lambda m: m["stiffness_Nm_per_rad"] * (m.q - m["rest_rad"]), 2, ("rest_rad",)
    ),
    "torque_ripple": Named(
        ("amplitude_Nm",),
        lambda m: m["amplitude_Nm"] * np.sin(m["order"] * m.q + m["phase_rad"]),
        2,
        ("order", "phase_rad"),
    ),
    "link_mass": Named(("mass_kg",)),
    "link_com": Named(("x_m", "y_m", "z_m"), linear=3),
    "payload_error": Named(("mass_kg",)),
    "base_tilt": Named(("tilt_x_rad", "tilt_y_rad"), linear=2),
    "time_offset": Named(("offset_s",)),
    "torque_lag": Named(("lag_s",)),
    "link_inertia": Named(("inertia_kg_m2",), positive=True),
}
"""By name."""


@dataclass(frozen=True)
class Family:
    """A family of physics outside the catalogue."""

    torque: Callable[[Joint], Array]  # what a size of 1 adds to the torque of a joint
    on: str  # quantities on which it depends, of the joint itself or "of by"
    keys: tuple[str, ...] = ()  # what is drawn for it beside the joint
    # effects of the catalogue that are true beside an unnamed one of the same joint: its straight part
    beside: tuple[str, ...] = ()
    sum_of: tuple[str, ...] = ()  # effects of the catalogue, at the same joint, that describe it whole together
    warm: bool = False  # whether it needs temperatures that vary
    nameless: bool = False  # whether no curve over anything recorded can be it, so that only a wrong name is wrong
    # whether its size is positive by physics: friction takes energy, a spring pulls back, a sensor that saturates reads
    # less. Where it may also be negative, it is a change of something that is there.
    positive: bool = False

    def drivers(self, joint: int, fixed: Values) -> Drivers:
        """On what it depends at a joint (from 1), with the phrases that name each."""
        found = []
        for quantity, _, key in (each.partition(" of ") for each in self.on.split(", ")):
            of = int(fixed[key]) if key else joint
            said = [f"{word} of joint {of}" for word in _WORDS.get(quantity, (quantity,))]
            alone = {"time": ["time"], "temperature": [*said, "temperature"]}
            found.append(alone.get(quantity, said))
        return found


_WORDS = {
    "load": ("gravity torque", "load", "torque"),
    "direction": ("direction of motion", "direction", "velocity"),
    "velocity": ("velocity", "speed"),
    "travel": ("travel since reversal", "position"),
}


def _presliding(m: Joint) -> Array:
    bent = np.zeros(len(m.q))
    for k, step in enumerate(np.diff(m.q)):
        rest = np.sign(step)
        bent[k + 1] = rest + (bent[k] - rest) * np.exp(-abs(step) / m["bristle_rad"])
    return bent


_FRICTION = ("coulomb_friction", "viscous_friction", "stribeck_friction")
_SPRING = ("joint_spring", "torque_offset")

FAMILIES: dict[str, Family] = {
    # friction where the joint passes a place
    "sticky_zone": Family(
        lambda m: bump(m.q, m["centre"], m["width"]) * m.sign,
        *("position, direction", ("centre", "width"), _FRICTION),
        positive=True,
    ),
    # friction that grows with the square of the load
    "squared_load_friction": Family(
        lambda m: (m.load / m["load_Nm"]) ** 2 * m.sign,
        *("load, direction", ("load_Nm",), (*_FRICTION, "load_friction")),
        positive=True,
    ),
    # friction that another joint's load makes
    "cross_load_friction": Family(
        lambda m: np.abs(m.s.load[:, int(m["by"]) - 1]) / m["other_load_Nm"] * m.sign,
        *("load of by, direction", ("by", "other_load_Nm"), _FRICTION),
        positive=True,
    ),
    # a gear's mesh that ripples with two orders, the more the joint is loaded
    "loaded_ripple": Family(
        lambda m: m.load / m["load_Nm"] * (np.sin(m["order"] * m.q) + np.sin(m["second"] * m.q)),
        *("position, load", ("order", "second", "load_Nm"), ("torque_ripple", "torque_scale")),
    ),
    # an end stop of rubber: nothing before it, then the square of the way into it
    "soft_stop": Family(lambda m: np.maximum(0.0, m.q - m["at"]) ** 2, "position", ("at",), _SPRING, positive=True),
    # bristles that bend over an angle before they slide (P. Dahl, 1968), exact between samples
    "presliding": Family(_presliding, "direction, travel", ("bristle_rad",), (*_FRICTION, *_SPRING), positive=True),
    # viscous friction that is larger one way than the other: the part that is even in velocity
    "asymmetric_viscous": Family(
        lambda m: np.abs(m.dq), "velocity", beside=("viscous_friction", "coulomb_friction", "torque_offset")
    ),
    # friction of churned oil, which is viscous friction with an exponent of 2
    "squared_speed": Family(
        lambda m: m.dq * np.abs(m.dq), "velocity", beside=_FRICTION, sum_of=("viscous_friction",), positive=True
    ),
    # a current sensor that compresses what is beyond a knee
    "saturation": Family(
        lambda m: -np.sign(m.exerted) * np.maximum(0.0, np.abs(m.exerted) - m["knee_Nm"]),
        *("load", ("knee_Nm",), ("torque_scale",)),
        positive=True,
    ),
    # a sensor's gain that drifts in time
    "gain_drift": Family(lambda m: (m.s.time / m.s.time[-1] - 0.5) * m.exerted, "time, load", beside=("torque_scale",)),
    # what rounding to steps of a current adds
    "quantised": Family(
        lambda m: np.round(m.exerted / m["step_Nm"]) * m["step_Nm"] - m.exerted,
        *("load", ("step_Nm",)),
        nameless=True,
        positive=True,
    ),
    # a cable whose stiffness grows as it is drawn out
    "hardening_cable": Family(
        lambda m: (m.q - m["rest"]) * np.abs(m.q - m["rest"]), "position", ("rest",), _SPRING, positive=True
    ),
    # dry friction that falls or rises with temperature
    "warming_coulomb": Family(
        lambda m: m.warmth / _WARMER * m.sign,
        "temperature, direction",
        beside=(*_FRICTION, "friction_temperature"),
        warm=True,
    ),
    # viscous friction that is larger on one side of the joint
    "uneven_viscous": Family(lambda m: np.sin(m.q - m["centre"]) * m.dq, "position, velocity", ("centre",), _FRICTION),
    # dry friction that wears off in time
    "running_in": Family(
        lambda m: np.exp(-3 * m.s.time / m.s.time[-1]) * m.sign, "time, direction", beside=_FRICTION, positive=True
    ),
}
"""By name."""


def sealed(name: str) -> bool:
    """Whether a family is put aside for one last look: a third of them, by the SHA-256 of the name.

    The rule looks at one name alone, so that a new family moves no other.
    """
    return hashlib.sha256(name.encode()).digest()[0] % 3 == 0


OPEN = tuple(name for name in FAMILIES if not sealed(name))
SEALED = tuple(name for name in FAMILIES if sealed(name))


def draw_family(name: str, rng: np.random.Generator, s: Motion, noise: Array) -> tuple[int, dict[str, float]] | None:
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
