"""What is hidden in logs of commands: the effects of the public table, and families of physics that it lacks.

An effect changes numbers of joints or of the arm (`START`), by which `physics` rolls an arm out. Shares no code with
the library.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.concealed.chain import Array

Values = Mapping[str, float]
Numbers = dict[str, Array]
"""Numbers `(joint,)` by the names of `START`; those of the arm are the same at every joint."""

NEVER = 1e9  # a limit that is not reached
START: Values = {
    **dict.fromkeys(("stiffness", "damping", "rotor", "viscous", "coulomb"), 0.0),  # as declared
    **dict.fromkeys(("integral", "feedforward", "dead", "spring", "spring_torque"), 0.0),
    **dict.fromkeys(("delay", "filter", "stribeck", "load_friction"), 0.0),
    "stribeck_speed": 0.1,
    **dict.fromkeys(("rate", "limit"), NEVER),
    **dict.fromkeys(("droop", "ripple", "ripple_order", "ripple_phase"), 0.0),
    **dict.fromkeys(("link_mass", "center_x", "center_y", "center_z"), 0.0),  # beyond the declared ones
    **dict.fromkeys(("play", "offset", "scale", "sine", "cosine"), 0.0),
    **dict.fromkeys(("clock", "payload", "tilt_x", "tilt_y"), 0.0),  # of the arm
    # of families; lengths that divide are one
    **dict.fromkeys(("sticky", "sticky_centre", "one_way", "load_play", "warming", "sagging"), 0.0),
    **dict.fromkeys(("cable", "cable_centre", "cable_by", "cable_other"), 0.0),
    **dict.fromkeys(("compliance", "skipped", "rocking", "rocking_pulse", "rocking_way"), 0.0),
    "sticky_width": 1.0,
}
"""Numbers of joints and of the arm where nothing is hidden, SI units."""
SITES = {"time_offset": "clock", "clock_drift": "clock", "payload_error": "payload", "base_tilt": "base"}
"""Sites of effects that are of no joint."""
_OF_LINKS = ("link_mass", "link_com")


def site_of(name: str, joint: int) -> str:
    """The site of an effect of the table at a joint, from 1, or at the link that it moves."""
    return SITES.get(name, f"link{joint}" if name in _OF_LINKS else f"joint{joint}")


@dataclass(frozen=True)
class Hidden:
    """An effect at a site."""

    name: str  # a key of `NAMED` or `FAMILIES`
    site: str  # jointN, linkN, clock, payload or base
    values: Values  # its numbers under the names that the library reports; of a family, its `size`
    fixed: Values = field(default_factory=dict)  # what else belongs to its form, that nobody asks for

    @property
    def joint(self) -> int:
        """From 0, of a link the one that moves it; -1 where the site is neither."""
        return int("".join(filter(str.isdecimal, self.site)) or 0) - 1

    def moved(self, **values: float) -> "Hidden":
        """The same with some other numbers."""
        return replace(self, values={**self.values, **values})


@dataclass(frozen=True)
class Named:
    """An effect of the public table."""

    sizes: tuple[float, float]  # the least and the largest size that is drawn
    # its numbers at a size, with what was drawn for it: `side` (±1), `phase`, `speed`, and of the joint `fastest` rad/s
    # and `strongest` Nm where nothing is hidden, `stiffness` and `damping`
    values: Callable[[float, Values], dict[str, float]]
    alter: Callable[[Numbers, Any, Values], None]  # changes numbers at a joint, or at all joints
    arguments: Mapping[str, str]  # the numbers' names in the shared form of truths
    linear: int = 1  # in how many coordinates it is linear
    also: tuple[str, ...] = ()  # effects that no log of commands tells from it


def _add(**fields: str) -> Callable[[Numbers, Any, Values], None]:
    """Adds numbers to fields."""

    def alter(numbers: Numbers, i: Any, values: Values) -> None:
        for name, value in fields.items():
            numbers[name][i] += values[value]

    return alter


def _times(name: str) -> Callable[[Numbers, Any, Values], None]:
    def alter(numbers: Numbers, i: Any, values: Values) -> None:
        numbers[name][i] *= values["ratio"]

    return alter


def _least(name: str, value: str) -> Callable[[Numbers, Any, Values], None]:
    def alter(numbers: Numbers, i: Any, values: Values) -> None:
        numbers[name][i] = np.minimum(numbers[name][i], values[value])

    return alter


def _stribeck(numbers: Numbers, i: Any, values: Values) -> None:
    numbers["stribeck"][i] += values["stribeck_Nm"]
    numbers["stribeck_speed"][i] = values["velocity_rad_per_s"]


def _spring(numbers: Numbers, i: Any, values: Values) -> None:
    numbers["spring"][i] += values["stiffness_Nm_per_rad"]
    numbers["spring_torque"][i] -= values["stiffness_Nm_per_rad"] * values["rest_rad"]


def _ripple(numbers: Numbers, i: Any, values: Values) -> None:
    numbers["ripple"][i] += values["amplitude_Nm"]
    numbers["ripple_order"][i] = values["order"]
    numbers["ripple_phase"][i] = values["phase_rad"]


def _drooping(numbers: Numbers, i: Any, values: Values) -> None:
    numbers["limit"][i] = np.minimum(numbers["limit"][i], values["torque_Nm"])
    numbers["droop"][i] = values["droop_s_per_rad"]


def _wave(numbers: Numbers, i: Any, values: Values) -> None:
    numbers["sine"][i] += values["amplitude_rad"] * np.cos(values["phase_rad"])
    numbers["cosine"][i] += values["amplitude_rad"] * np.sin(values["phase_rad"])


def _one(name: str) -> Callable[[float, Values], dict[str, float]]:
    """A number that is the size."""
    return lambda size, drawn: {name: size}


def _signed(name: str) -> Callable[[float, Values], dict[str, float]]:
    return lambda size, drawn: {name: drawn["side"] * size}


def _of(name: str, unit: str) -> Callable[[float, Values], dict[str, float]]:
    """A number that is so many times one of the joint's."""
    return lambda size, drawn: {name: size * drawn[unit]}


def _side_of(name: str, unit: str) -> Callable[[float, Values], dict[str, float]]:
    """A number of either sign that is so many times one of the joint's."""
    return lambda size, drawn: {name: drawn["side"] * size * drawn[unit]}


def _below(name: str, most: str) -> Callable[[float, Values], dict[str, float]]:
    """A limit that is below what is reached without it."""
    return lambda size, drawn: {name: drawn[most] / (1 + size)}


def _shift(size: float, drawn: Values) -> dict[str, float]:
    """A displacement by so many metres: of its direction, `phase` is about the third axis, `rise` from the plane."""
    flat = size * float(np.cos(drawn["rise"]))
    x = flat * float(np.cos(drawn["phase"]))
    y = flat * float(np.sin(drawn["phase"]))
    return {"x_m": x, "y_m": y, "z_m": size * float(np.sin(drawn["rise"]))}


def _ratio(size: float, drawn: Values) -> dict[str, float]:
    return {"ratio": float(np.exp(drawn["side"] * size))}


NAMED: dict[str, Named] = {
    "time_offset": Named((1e-5, 0.1), _one("offset_s"), _add(delay="offset_s"), {"offset_s": "offset"}),
    "clock_drift": Named((1e-6, 0.05), _signed("rate"), _add(clock="rate"), {"rate": "rate"}),
    "command_delay": Named((1e-5, 0.1), _one("delay_s"), _add(delay="delay_s"), {"delay_s": "delay"}),
    "command_filter": Named(
        (1e-4, 0.2), _one("time_constant_s"), _add(filter="time_constant_s"), {"time_constant_s": "tau"}
    ),
    # below the speed of the motion: held commands are steps, which any limit delays, and nobody would call that one
    "rate_limit": Named(
        (1.0, 6.0),
        lambda size, drawn: {"velocity_rad_per_s": drawn["fastest"] / size},
        *(_least("rate", "velocity_rad_per_s"), {"velocity_rad_per_s": "v"}),
    ),
    "servo_stiffness": Named((1e-5, 1.5), _ratio, _times("stiffness"), {"ratio": "ratio"}),
    "servo_damping": Named((1e-5, 1.2), _ratio, _times("damping"), {"ratio": "ratio"}, also=("viscous_friction",)),
    "servo_integral": Named(
        (1e-4, 3.0),
        _of("integral_Nm_per_rad_s", "stiffness"),
        *(_add(integral="integral_Nm_per_rad_s"), {"integral_Nm_per_rad_s": "ki"}),
    ),
    "servo_feedforward": Named(
        (1e-5, 1.0),
        _of("feedforward_Nm_s_per_rad", "damping"),
        *(_add(feedforward="feedforward_Nm_s_per_rad"), {"feedforward_Nm_s_per_rad": "kf"}),
    ),
    "dead_band": Named((1e-6, 0.05), _one("half_width_rad"), _add(dead="half_width_rad"), {"half_width_rad": "w"}),
    "torque_limit": Named(
        (1e-3, 1.0), _below("torque_Nm", "strongest"), _least("limit", "torque_Nm"), {"torque_Nm": "torque"}
    ),
    "torque_speed_limit": Named(
        (1e-3, 1.0),
        lambda size, drawn: {"torque_Nm": drawn["strongest"] / (1 + size), "droop_s_per_rad": drawn["droop"]},
        _drooping,
        *({"torque_Nm": "torque", "droop_s_per_rad": "droop"}, 2),
    ),
    "viscous_friction": Named(
        (1e-5, 1.0),
        _of("viscous_Nm_s_per_rad", "damping"),
        _add(viscous="viscous_Nm_s_per_rad"),
        *({"viscous_Nm_s_per_rad": "b"}, 1, ("servo_damping",)),
    ),
    "coulomb_friction": Named(
        (1e-5, 0.5), _of("coulomb_Nm", "strongest"), _add(coulomb="coulomb_Nm"), {"coulomb_Nm": "c"}
    ),
    "stribeck_friction": Named(
        (1e-4, 0.5),
        lambda size, drawn: {"stribeck_Nm": size * drawn["strongest"], "velocity_rad_per_s": drawn["speed"]},
        *(_stribeck, {"stribeck_Nm": "s"}),
    ),
    "load_friction": Named((1e-5, 0.5), _one("coefficient"), _add(load_friction="coefficient"), {"coefficient": "mu"}),
    "rotor_inertia": Named(
        (1e-5, 1.5), _of("inertia_kg_m2", "rotor"), _add(rotor="inertia_kg_m2"), {"inertia_kg_m2": "I"}
    ),
    "joint_spring": Named(
        (1e-5, 0.5),
        lambda size, drawn: {"stiffness_Nm_per_rad": size * drawn["stiffness"], "rest_rad": drawn["rest"]},
        *(_spring, {"stiffness_Nm_per_rad": "k", "rest_rad": "rest"}, 2),
    ),
    "torque_ripple": Named(
        (1e-5, 0.5),
        lambda size, drawn: {
            "order": drawn["order"],
            "amplitude_Nm": size * drawn["strongest"],
            "phase_rad": drawn["phase"],
        },
        *(_ripple, {"order": "n", "amplitude_Nm": "A", "phase_rad": "phase"}, 2),
    ),
    "link_mass": Named((1e-5, 0.9), _side_of("mass_kg", "mass"), _add(link_mass="mass_kg"), {"mass_kg": "mass"}),
    "link_com": Named(
        (1e-6, 0.1),
        _shift,
        _add(center_x="x_m", center_y="y_m", center_z="z_m"),
        *({"x_m": "x", "y_m": "y", "z_m": "z"}, 3),
    ),
    "payload_error": Named((1e-5, 1.5), _one("mass_kg"), _add(payload="mass_kg"), {"mass_kg": "mass"}),
    "base_tilt": Named(
        (1e-6, 0.2),
        lambda size, drawn: {
            "tilt_x_rad": size * float(np.cos(drawn["phase"])),
            "tilt_y_rad": size * float(np.sin(drawn["phase"])),
        },
        *(_add(tilt_x="tilt_x_rad", tilt_y="tilt_y_rad"), {"tilt_x_rad": "rx", "tilt_y_rad": "ry"}, 2),
    ),
    "backlash": Named((1e-6, 0.05), _one("half_width_rad"), _add(play="half_width_rad"), {"half_width_rad": "w"}),
    "encoder_offset": Named((1e-6, 0.2), _signed("offset_rad"), _add(offset="offset_rad"), {"offset_rad": "o"}),
    "encoder_scale": Named((1e-6, 0.1), _signed("scale"), _add(scale="scale"), {"scale": "k"}),
    "encoder_eccentricity": Named(
        (1e-6, 0.1),
        lambda size, drawn: {"amplitude_rad": size, "phase_rad": drawn["phase"]},
        *(_wave, {"amplitude_rad": "A", "phase_rad": "phase"}, 2),
    ),
}
"""By name."""

AT_LEAST = ("rate_limit",)
"""What does much wherever it does anything: the size that is planned is the least."""
FREE_SERVO = ("servo_stiffness", "servo_damping")
"""What is fitted before anything else where the servo is unknown, and `viscous_friction` with it."""


@dataclass(frozen=True)
class Family:
    """A family of physics outside the table: one number, `size`, times a form."""

    sizes: tuple[float, float]  # the least and the largest size that is drawn
    unit: str  # what a size of 1 is: a number of the joint, or `one`
    alter: Callable[[Numbers, Any, float, Values], None]  # changes numbers by a size and what is fixed
    on: str  # quantities on which it depends, of the joint itself or "of by"
    keys: tuple[str, ...] = ()  # what is drawn for it beside the joint
    # effects of the table that are true beside an unnamed one of the same joint: its straight part
    beside: tuple[str, ...] = ()
    nameless: bool = False  # whether no curve over anything recorded can be it, so that only a wrong name is wrong
    site: str = "joint"  # or clock, or base

    def drivers(self, joint: int, fixed: Values) -> list[list[str]]:
        """On what it depends at a joint (from 1), with the phrases that name each."""
        drivers = []
        for quantity, _, key in (each.partition(" of ") for each in self.on.split(", ") if each):
            of = int(fixed[key]) if key else joint
            phrases = [f"{word} of joint {of}" for word in _WORDS.get(quantity, (quantity,))]
            drivers.append([quantity] if quantity in ("time", "temperature") else phrases)
        return drivers


_WORDS = {
    "load": ("gravity torque", "load", "torque"),
    "direction": ("direction of motion", "direction", "velocity"),
    "velocity": ("velocity", "speed", "direction of motion"),
}
_FRICTION = ("coulomb_friction", "viscous_friction", "stribeck_friction", "load_friction", "servo_damping")
_SERVO = ("servo_stiffness", "servo_damping", "command_delay", "rotor_inertia")


def _set(name: str, **others: str) -> Callable[[Numbers, Any, float, Values], None]:
    """Adds the size to a field, and sets others to what is fixed."""

    def alter(numbers: Numbers, i: Any, size: float, fixed: Values) -> None:
        numbers[name][i] += size
        for field_name, key in others.items():
            numbers[field_name][i] = fixed[key]

    return alter


FAMILIES: dict[str, Family] = {
    # viscous friction that falls as oil warms
    "warming_friction": Family((1e-5, 0.6), "damping", _set("warming"), "time, velocity", beside=_FRICTION),
    # dry friction where the joint passes a place
    "sticky_zone": Family(
        (1e-5, 1.0),
        "strongest",
        _set("sticky", sticky_centre="centre", sticky_width="width"),
        *("position, direction", ("centre", "width"), _FRICTION),
    ),
    # play between drive and read-out that widens under load
    "loaded_backlash": Family((1e-7, 0.02), "per_load", _set("load_play"), "load, direction", beside=("backlash",)),
    # dry friction of one direction only
    "one_way_friction": Family(
        (1e-5, 0.5), "strongest", _set("one_way"), "direction", beside=(*_FRICTION, "encoder_offset")
    ),
    # a servo that weakens as its supply sags
    "sagging_supply": Family((1e-5, 0.6), "one", _set("sagging"), "time", beside=_SERVO),
    # a cable drawn out by two joints
    "cable_drag": Family(
        (1e-5, 0.6),
        "stiffness",
        _set("cable", cable_centre="centre", cable_by="by", cable_other="other"),
        *("position, position of by", ("centre", "by", "other"), ("joint_spring", "encoder_offset")),
    ),
    # an elastic gear between a motor and the link on which the encoder sits
    "flexible_drive": Family((0.01, 0.6), "one", _set("compliance"), "velocity", beside=_SERVO, nameless=True),
    # a generator of commands that skips: the one before is sent again
    "skipping_commands": Family((1e-3, 0.5), "one", _set("skipped"), "", nameless=True, site="clock"),
    # a base that rocks to and fro, on a vehicle or a bench
    "rocking_base": Family(
        (1e-4, 2.0),
        "one",
        _set("rocking", rocking_pulse="pulse", rocking_way="phase"),
        "",
        ("pulse", "phase"),
        nameless=True,
        site="base",
    ),
}
"""By name."""


def sealed(name: str) -> bool:
    """Whether a family is put aside for one last look: a third of them, by the SHA-256 of the name."""
    return hashlib.sha256(f"tracking {name}".encode()).digest()[0] % 3 == 0


OPEN = tuple(name for name in FAMILIES if not sealed(name))
SEALED = tuple(name for name in FAMILIES if sealed(name))


def altered(start: Numbers, hidden: tuple[Hidden, ...]) -> Numbers:
    """Numbers with what is hidden."""
    numbers = {name: values.copy() for name, values in start.items()}
    for effect in hidden:
        at = effect.joint if effect.joint >= 0 else slice(None)
        if effect.name in NAMED:
            NAMED[effect.name].alter(numbers, at, effect.values)
        else:
            FAMILIES[effect.name].alter(numbers, at, effect.values["size"], effect.fixed)
    return numbers
