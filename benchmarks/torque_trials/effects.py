"""The catalogue's effects, each by the formula of its public table; `outside` has those that it does not have."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.torque_trials.motion import AMBIENT

Values = Mapping[str, float]

SMOOTH = 2e-3
"""rad/s within which a sign turns: sign(v) is tanh(v / SMOOTH)."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What the motors of an arm work on: arrays with the sample first.

    Attributes:
        time: `(sample,)` s.
        q: `(sample, joint)` rad.
        dq: `(sample, joint)` rad/s.
        ddq: `(sample, joint)` rad/s².
        temperature: `(sample, joint)` °C.
        load: `(sample, joint)` Nm of the rigid bodies.
    """

    time: Array
    q: Array
    dq: Array
    ddq: Array
    temperature: Array
    load: Array


@dataclass(frozen=True)
class Hidden:
    """An effect at a site.

    Attributes:
        name: a key of `NAMED` or of the families outside.
        site: jointN, linkN, base, payload or clock.
        values: its numbers under the names that the library reports.
        fixed: what else belongs to its form, that nobody asks for.
    """

    name: str
    site: str
    values: Values
    fixed: Values = field(default_factory=dict)

    @property
    def number(self) -> int:
        """Of the joint or link, counted from 1; 0 where the site is neither."""
        return int("".join(filter(str.isdecimal, self.site)) or 0)

    def moved(self, **values: float) -> "Hidden":
        """The same with some other numbers."""
        return replace(self, values={**self.values, **values})

    def scaled(self, factor: float, sizes: tuple[str, ...]) -> "Hidden":
        """The same, so many times as large in the numbers that say how large it is."""
        return self.moved(**{name: factor * self.values[name] for name in sizes})


@dataclass(frozen=True)
class Named:
    """An effect of the catalogue.

    Attributes:
        sizes: the numbers that say how large it is.
        linear: in how many coordinates it is linear: a ripple of a known order in two.
        shapes: its other numbers, which are estimated as well.
        torque: what it adds to a joint's torque; None where it changes the arm, gravity, the payload or the clock.
    """

    sizes: tuple[str, ...]
    linear: int = 1
    shapes: tuple[str, ...] = ()
    torque: Callable[[Values, int, Scene], Array] | None = None


def sign(velocity: Array) -> Array:
    """The direction of motion, smooth about rest."""
    return np.tanh(velocity / SMOOTH)


def viscous_friction(values: Values, joint: int, s: Scene) -> Array:
    """b·q̇."""
    return values["viscous_Nm_s_per_rad"] * s.dq[:, joint]


def coulomb_friction(values: Values, joint: int, s: Scene) -> Array:
    """c·sign(q̇)."""
    return values["coulomb_Nm"] * sign(s.dq[:, joint])


def stribeck_friction(values: Values, joint: int, s: Scene) -> Array:
    """s·exp(−(q̇/v)²)·sign(q̇)."""
    velocity = s.dq[:, joint]
    return values["stribeck_Nm"] * np.exp(-((velocity / values["velocity_rad_per_s"]) ** 2)) * sign(velocity)


def load_friction(values: Values, joint: int, s: Scene) -> Array:
    """μ·|τ_rigid|·sign(q̇)."""
    return values["coefficient"] * np.abs(s.load[:, joint]) * sign(s.dq[:, joint])


def friction_temperature(values: Values, joint: int, s: Scene) -> Array:
    """k·(T − T₀)·q̇."""
    return values["viscous_Nm_s_per_rad_K"] * (s.temperature[:, joint] - AMBIENT) * s.dq[:, joint]


def coupled_friction(values: Values, joint: int, s: Scene) -> Array:
    """b·(q̇_N + q̇_M) + c·sign(q̇_N + q̇_M), as either joint feels it."""
    both = s.dq[:, joint] + s.dq[:, int(values["source_joint"]) - 1]
    return values["viscous_Nm_s_per_rad"] * both + values["coulomb_Nm"] * sign(both)


def torque_offset(values: Values, joint: int, s: Scene) -> Array:
    """A constant."""
    return np.full(len(s.time), values["offset_Nm"])


def rotor_inertia(values: Values, joint: int, s: Scene) -> Array:
    """I·q̈."""
    return values["inertia_kg_m2"] * s.ddq[:, joint]


def joint_spring(values: Values, joint: int, s: Scene) -> Array:
    """k·(q − q₀)."""
    return values["stiffness_Nm_per_rad"] * (s.q[:, joint] - values["rest_rad"])


def torque_ripple(values: Values, joint: int, s: Scene) -> Array:
    """A·sin(n·q + φ)."""
    return values["amplitude_Nm"] * np.sin(values["order"] * s.q[:, joint] + values["phase_rad"])


NAMED: dict[str, Named] = {
    "viscous_friction": Named(("viscous_Nm_s_per_rad",), torque=viscous_friction),
    "coulomb_friction": Named(("coulomb_Nm",), torque=coulomb_friction),
    "stribeck_friction": Named(("stribeck_Nm",), shapes=("velocity_rad_per_s",), torque=stribeck_friction),
    "load_friction": Named(("coefficient",), torque=load_friction),
    "friction_temperature": Named(("viscous_Nm_s_per_rad_K",), torque=friction_temperature),
    "coupled_friction": Named(("viscous_Nm_s_per_rad", "coulomb_Nm"), 2, torque=coupled_friction),
    "torque_offset": Named(("offset_Nm",), torque=torque_offset),
    "torque_scale": Named(("scale",)),
    "rotor_inertia": Named(("inertia_kg_m2",), torque=rotor_inertia),
    "joint_spring": Named(("stiffness_Nm_per_rad",), 2, ("rest_rad",), joint_spring),
    "torque_ripple": Named(("amplitude_Nm",), 2, ("order", "phase_rad"), torque_ripple),
    "link_mass": Named(("mass_kg",)),
    "link_com": Named(("x_m", "y_m", "z_m"), 3),
    "payload_error": Named(("mass_kg",)),
    "base_tilt": Named(("tilt_x_rad", "tilt_y_rad"), 2),
    "time_offset": Named(("offset_s",)),
    "torque_lag": Named(("lag_s",)),
}
"""By name."""
