"""Arms with inertia, how they move, and what their motors exert: recursive Newton–Euler of the textbook, in NumPy.

Shares no code with the library. The sample comes first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import yaml

from benchmarks.concealed.chain import (
    MADE,
    Array,
    Chain,
    about_z,
    description_text,
    lite6,
    rotation_from_rpy,
    rotation_from_vector,
    seven,
)
from benchmarks.torque_trials.effects import AMBIENT, FAMILIES, NAMED, Hidden, Joint, Motion

_LITE6_INERTIA = (
    *([1451.64, 887.3, 1319.93], [1585.4, 5609.7, 4850.0], [886.1, 1578.5, 1846.77]),
    *([3705.0, 3045.5, 1541.3], [566.8, 507.7, 530.0], [77.26, 85.665, 148.14]),
)
"""1e-6 kg·m², the maker's."""
_LITE6_NOISE = (0.06, 0.08, 0.05, 0.02, 0.02, 0.015)
_SEVEN_NOISE = (0.25, 0.3, 0.2, 0.15, 0.06, 0.05, 0.03)
_SEVEN_SIZE = 0.09, 0.11, 0.2  # m, of the boxes whose inertia the links of the arm of seven joints have
_INERTIAL_SPREAD = 0.3  # relative, of the masses and inertias of drawn arms about the vendor's


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm with inertia."""

    chain: Chain  # its kinematics, masses and centres of mass
    # `(joint, 3, 3)` kg·m² of each link about its centre of mass, in the frame after the joint's rotation
    inertia: Array
    noise: Array  # `(joint,)` Nm, one standard deviation of what a torque sensor of its size reads
    velocity: float = np.pi  # rad/s that no joint exceeds
    acceleration: float = 20.0  # rad/s² that no joint exceeds

    def with_link(self, link: int, mass: float = 0.0, center: Array | None = None) -> "Arm":
        """The arm, one link of which is heavier by a mass at its centre, or has its centre elsewhere by a shift."""
        masses, centers = self.chain.mass.copy(), self.chain.center.copy()
        masses[link - 1] += mass
        if center is not None:
            centers[link - 1] += center
        return replace(self, chain=replace(self.chain, mass=masses, center=centers))


def draw_arm(name: str, rng: np.random.Generator) -> Arm:
    """A Lite 6 or an arm of seven joints as no second one is made: geometry, masses, centres and tensors vary."""
    chain = {"lite6": lite6, "seven": seven}[name]().moved(rng, *MADE)
    dof = chain.dof
    if name == "lite6":
        inertia = np.stack([np.diag(row) for row in _LITE6_INERTIA]) * 1e-6
        noise = np.array(_LITE6_NOISE)
    else:
        a, b, c = np.square(_SEVEN_SIZE)
        inertia = chain.mass[:, None, None] / 12 * np.diag([b + c, a + c, a + b])
        noise = np.array(_SEVEN_NOISE)
    mass = chain.mass * rng.uniform(1 - _INERTIAL_SPREAD, 1 + _INERTIAL_SPREAD, dof)
    center = chain.center + rng.normal(0, 5e-3, (dof, 3))
    turn = rotation_from_vector(rng.normal(0, 0.2, (dof, 3)))
    # one factor a link keeps a tensor that a body can have
    scaled = inertia * rng.uniform(1 - _INERTIAL_SPREAD, 1 + _INERTIAL_SPREAD, dof)[:, None, None]
    turned = turn @ scaled @ np.swapaxes(turn, 1, 2)
    return Arm(replace(chain, mass=mass, center=center), turned, noise * rng.uniform(0.7, 1.4, dof))


def inverse_dynamics(
    arm: Arm, q: Array, dq: Array, ddq: Array, gravity: Array, payload: Array | None = None, at: Array | None = None
) -> Array:
    """`(sample, joint)` Nm that the motors exert about +z of their joints (Luh, Walker and Paul, 1980).

    Args:
        arm: the arm; its frames are those of modified tables, each at the start of its link.
        q: `(sample, joint)` rad.
        dq: `(sample, joint)` rad/s.
        ddq: `(sample, joint)` rad/s².
        gravity: `(3,)` m/s² in the base's axes.
        payload: `(sample,)` kg, a point mass in the last frame; none where not given.
        at: `(3,)` m, where it is.
    """
    pulls = []
    bodies = move_links(arm, q, dq, ddq, gravity)
    for i, body in enumerate(bodies):
        force, torque = link_wrench(arm, body, i)
        if i == len(bodies) - 1 and payload is not None:
            place = np.zeros(3) if at is None else at
            load = payload[:, None] * _pushed(body, place)
            force, torque = force + load, torque + _cross(place, load)
        pulls.append((force, torque))
    return held(arm, bodies, pulls)


class Body(NamedTuple):
    """How a link's frame moves, in its own axes; all arrays with the sample first."""

    turn: Array  # `(sample, 3, 3)`, its axes in those of the frame before
    thrust: Array  # `(sample, 3)` m/s², the acceleration of its origin, gravity among it
    spin: Array  # `(sample, 3)` rad/s²
    rate: Array  # `(sample, 3)` rad/s


def move_links(arm: Arm, q: Array, dq: Array, ddq: Array, gravity: Array) -> list[Body]:
    """How the links of an arm move, from the base outwards; nothing here depends on what they weigh."""
    z = np.array([0.0, 0.0, 1.0])
    rate, spin, thrust = np.zeros((len(q), 3)), np.zeros((len(q), 3)), np.tile(-gravity, (len(q), 1))
    bodies = []
    for i, row in enumerate(arm.chain.rows):
        turn = rotation_from_rpy(*row[3:]) @ about_z(q[:, i])
        thrust = thrust + _cross(spin, row[:3]) + _cross(rate, _cross(rate, row[:3]))
        rate, spin, thrust = (np.einsum("sji,sj->si", turn, v) for v in (rate, spin, thrust))
        spin = spin + _cross(rate, z) * dq[:, i : i + 1] + z * ddq[:, i : i + 1]
        rate = rate + z * dq[:, i : i + 1]
        bodies.append(Body(turn, thrust, spin, rate))
    return bodies


def link_wrench(arm: Arm, body: Body, i: int) -> tuple[Array, Array]:
    """`(sample, 3)` N and Nm about its frame's origin that a link (from 0) asks for, in its own axes."""
    center, inertia = arm.chain.center[i], arm.inertia[i]
    force = arm.chain.mass[i] * _pushed(body, center)
    return force, body.spin @ inertia + _cross(body.rate, body.rate @ inertia) + _cross(center, force)


def held(arm: Arm, bodies: Sequence[Body], pulls: Sequence[tuple[Array, Array]]) -> Array:
    """`(sample, joint)` Nm that hold what the first links ask for, from the last of them inwards.

    Args:
        arm: the arm.
        bodies: how its links move.
        pulls: N and Nm of the links from the first on; links beyond ask for nothing.
    """
    exerted = np.zeros((len(bodies[0].rate), len(bodies)))
    force, torque = pulls[-1]
    for i in reversed(range(len(pulls))):
        exerted[:, i] = torque[:, 2]
        if i:
            carried, twisted = (np.einsum("sij,sj->si", bodies[i].turn, v) for v in (force, torque))
            own = pulls[i - 1]
            force, torque = own[0] + carried, own[1] + twisted + _cross(arm.chain.rows[i, :3], carried)
    return exerted


def _pushed(body: Body, at: Array) -> Array:
    """`(sample, 3)` m/s² of a point of a body."""
    return body.thrust + _cross(body.spin, at) + _cross(body.rate, _cross(body.rate, at))


def _cross(a: Array, b: Array) -> Array:
    """`(sample, 3)` of vectors of which either may be one for all; NumPy's own takes thrice the time."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], -1)


def arm_text(arm: Arm) -> str:
    """The description of an arm: kinematics, limits, masses, centres and tensors."""
    said = yaml.safe_load(description_text(arm.chain))
    for i, tensor in enumerate(arm.inertia):
        numbers = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]]
        said["inertial"][f"link{i + 1}"]["inertia_kg_m2"] = [float(v) for v in numbers]
    return yaml.safe_dump(said, sort_keys=False)


# ------------------------------------------------------------------ how they move

_SINES = 5
_REACH = 1.5  # rad, the most that a joint moves to either side of its middle
_SLACK = 0.9  # the share of its limits that a motion uses at most


def draw_motion(
    rng: np.random.Generator,
    arm: Arm,
    rate: float,
    seconds: float,
    speed: float = 1.0,
    warming: bool = False,
    payload: float = 0.0,
    resting: int = 0,
) -> Motion:
    """A motion of five sines a joint within the limits of position, velocity and acceleration.

    Frequencies are `speed` times the usual ones; where it is `warming`, each joint grows warmer in its own way, and
    cooler again; so many of the first joints are `resting`.
    """
    time = np.arange(round(rate * seconds)) / rate
    dof = arm.chain.dof
    lower, upper = np.maximum(arm.chain.limits[:, 0], -np.pi), np.minimum(arm.chain.limits[:, 1], 1.7 * np.pi)
    middle, reach = (lower + upper) / 2, np.minimum((upper - lower) / 2, _REACH)
    highest = rng.uniform(0.4, 1.0)
    pulse = 2 * np.pi * rng.uniform(0.05, highest, (_SINES, dof)) * speed
    amplitude = rng.dirichlet([2.0] * _SINES, dof).T * rng.uniform(0.6, _SLACK, dof) * reach
    for limit, power in ((arm.velocity, 1), (arm.acceleration, 2)):
        amplitude *= np.minimum(1.0, _SLACK * limit / np.sum(amplitude * pulse**power, 0))
    amplitude[:, :resting] = 0.0
    phase = rng.uniform(-np.pi, np.pi, (_SINES, dof))

    def curve(at: Array) -> tuple[Array, Array, Array]:
        angle = pulse * at[:, None, None] + phase
        sine, cosine = np.sin(angle), np.cos(angle)
        return (
            middle + np.sum(amplitude * sine, 1),
            np.sum(amplitude * pulse * cosine, 1),
            -np.sum(amplitude * pulse**2 * sine, 1),
        )

    temperature = np.full((len(time), dof), AMBIENT)
    if warming:
        turns, start = rng.uniform(1.0, 2.5, dof), rng.uniform(-np.pi, np.pi, dof)
        grown = rng.uniform(6, 15, dof) * (1 - np.exp(-3 * time[:, None] / time[-1]))
        waves = np.sin(2 * np.pi * turns * time[:, None] / time[-1] + start) - np.sin(start)
        temperature = temperature + grown + rng.uniform(2, 4, dof) * waves
    temperature = temperature + rng.normal(0, 0.05, temperature.shape)
    return Motion(time, *curve(time), temperature, np.full(len(time), payload), curve)


# ------------------------------------------------------------------ what is hidden in them

BODIES = ("link_mass", "link_com", "link_inertia", "payload_error", "base_tilt")
RIGID = (*BODIES, "time_offset")  # the effects that change what the rigid bodies ask for


@dataclass(frozen=True, eq=False)
class Setup:
    """An arm where it stands."""

    arm: Arm  # the arm as it is, but for what is hidden
    gravity: Array  # `(3,)` m/s² in the base's axes, as declared
    payload_center: Array  # `(3,)` m in the last frame


def torques(setup: Setup, hidden: Sequence[Hidden], motion: Motion, known: Motion | None = None) -> Array:
    """`(sample, joint)` Nm as a sensor without noise reads them.

    Friction and springs add to what the rigid bodies ask for (which may be `known` already); what is outside
    to both; then come a sensor's scale and the lag of what it shows.
    """
    scene = known or rigid(setup, hidden, motion)
    exerted = scene.load.copy()
    for effect in hidden:
        torque = NAMED[effect.name].torque if effect.name in NAMED else None
        if torque is None:
            continue
        joints = {effect.number, int(effect.values.get("source_joint", effect.number))}
        for joint in joints:
            # the other joint of a pair feels the same
            sibling = effect if joint == effect.number else effect.moved(source_joint=float(effect.number))
            exerted[:, joint - 1] += torque(Joint(sibling.values, joint - 1, scene))
    for effect in hidden:
        if effect.name in FAMILIES:
            joint = effect.number - 1
            added = FAMILIES[effect.name].torque(Joint(effect.fixed, joint, scene, exerted[:, joint]))
            exerted[:, joint] += effect.values["size"] * added
    for effect in hidden:
        if effect.name == "torque_scale":
            exerted[:, effect.number - 1] *= 1 + effect.values["scale"]
    for joint in {effect.number - 1 for effect in hidden if effect.name == "torque_lag"}:
        late = [effect for effect in hidden if effect.name == "torque_lag" and effect.number - 1 == joint]
        others = tuple(effect for effect in hidden if effect not in late)
        before = motion.later(-sum(effect.values["lag_s"] for effect in late))
        exerted[:, joint] = torques(setup, others, before)[:, joint]
    return exerted


def rigid(setup: Setup, hidden: Sequence[Hidden], motion: Motion) -> Motion:
    """The motion that the torques belong to, with what the rigid bodies ask for."""
    changed, added = change_bodies(setup, hidden)
    for effect in hidden:
        if effect.name == "time_offset":
            motion = motion.later(effect.values["offset_s"])
    q, dq, ddq, payload = motion.q, motion.dq, motion.ddq, motion.payload + added
    load = inverse_dynamics(changed.arm, q, dq, ddq, changed.gravity, payload, setup.payload_center)
    return replace(motion, load=load)


def change_bodies(setup: Setup, hidden: Sequence[Hidden]) -> tuple[Setup, float]:
    """The arm with its hidden masses, centres and tilt, and what its payload weighs more than declared, kg."""
    arm, gravity, added = setup.arm, setup.gravity, 0.0
    for effect in hidden:
        values = effect.values
        match effect.name:
            case "link_mass":
                arm = arm.with_link(effect.number, mass=values["mass_kg"])
            case "link_com":
                arm = arm.with_link(effect.number, center=np.array([values[f"{axis}_m"] for axis in "xyz"]))
            case "link_inertia":
                about_axis = np.zeros_like(arm.inertia)
                about_axis[effect.number - 1, 2, 2] = values["inertia_kg_m2"]
                arm = replace(arm, inertia=arm.inertia + about_axis)
            case "payload_error":
                added += values["mass_kg"]
            case "base_tilt":
                tilt = rotation_from_vector(np.array([values["tilt_x_rad"], values["tilt_y_rad"], 0.0]))
                gravity = tilt.T @ gravity
    return replace(setup, arm=arm, gravity=gravity), added
