"""Arms with servos: random ones of three to five joints, and ones with the masses of published descriptions.

Rigid bodies obey Newton's and Euler's laws in the world's axes, projected on the joints. Shares no code with the
library. The lane comes last: a lane is an arm in one motion with one set of numbers.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from benchmarks.concealed.chain import SIX, Array, Chain, description_text, rotation_from_rpy, rotation_from_vector

_DATA = Path(__file__).resolve().parents[2] / "lite6jax/arms/data"
"""Descriptions that are read as data: lengths, masses, centres and tensors."""
PUBLISHED = ("lite6", "ur5e", "xarm7")
GRAVITY = np.array([0.0, 0.0, -9.81])
_REACH = 0.9  # rad, that a motion keeps within about the middle of an arm
_POSTURES = 400  # random ones, of which loads and inertias are taken to size servos
_SAG = (0.008, 0.04)  # rad under the largest weight
_SLOWEST, _FASTEST = 18.0, 70.0  # rad/s, of a servo with what its joint moves
_DAMPED = (0.35, 0.9)  # of critical damping
_DECIMALS = 4  # of declared numbers, so that the arm is exactly as described


@dataclass(frozen=True, eq=False)
class Joints:
    """The numbers of servos, rotors and friction, each `(joint,)`."""

    stiffness: Array  # Nm/rad
    damping: Array  # Nm·s/rad
    rotor: Array  # kg·m²
    viscous: Array  # Nm·s/rad
    coulomb: Array  # Nm


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm as it is declared."""

    chain: Chain  # kinematics, masses, centres of mass
    inertia: Array  # `(joint, 3, 3)` kg·m² about each centre of mass, in the frame after the joint's rotation
    joints: Joints
    middle: Array  # `(joint,)` rad, about which it moves
    reach: Array  # `(joint,)` rad, to either side


class Bodies(NamedTuple):
    """Rigid bodies of lanes."""

    rows: Array  # `(joint, 6)` m and rad, the same in all lanes
    mass: Array  # `(joint, lane)` kg
    center: Array  # `(3, joint, lane)` m
    inertia: Array  # `(3, 3, joint, lane)` kg·m²

    @classmethod
    def of(
        cls, arm: Arm, payload: Array, at: Array, heavier: Array | float = 0.0, shifted: Array | float = 0.0
    ) -> "Bodies":
        """An arm that carries point masses `(lane,)` kg at a place `(3,)` m in its last frame.

        Its links are `heavier` by `(joint, lane)` kg, at their centres, which are `shifted` by `(3, joint, lane)` m.
        """
        dof = arm.chain.dof
        lanes = len(payload)
        mass = np.repeat(arm.chain.mass[:, None], lanes, 1) + heavier
        center = np.repeat(arm.chain.center.T[:, :, None], lanes, 2) + shifted
        inertia = np.repeat(np.moveaxis(arm.inertia, 0, 2)[..., None], lanes, 3)
        whole = mass[-1] + payload
        middle = (mass[-1] * center[:, -1] + payload * at[:, None]) / whole
        for part, place in ((mass[-1], center[:, -1]), (payload, np.repeat(at[:, None], lanes, 1))):
            way = place - middle
            squared = np.eye(3)[..., None] * np.sum(way**2, 0) - way[:, None] * way[None]
            inertia[:, :, dof - 1] = inertia[:, :, dof - 1] + part * squared
        mass[-1] = whole
        center[:, -1] = middle
        return cls(arm.chain.rows, mass, center, inertia)


_TURNED = np.array([1, 2, 0])  # of components


def _cross(a: Array, b: Array) -> Array:
    """Of vectors whose component comes first."""
    return (a * b[_TURNED] - a[_TURNED] * b)[_TURNED]


class Dynamics:
    """What rigid bodies ask of their joints.

    Args:
        bodies: of lanes.
    """

    def __init__(self, bodies: Bodies):
        self.bodies = bodies
        self._turns = [rotation_from_rpy(*row[3:]).T.copy() for row in bodies.rows]
        dof = len(bodies.rows)
        self._before = np.tril(np.ones((dof, dof)))[:, :, None]  # joint k moves link i where k is not beyond i

    def terms(self, q: Array, dq: Array, gravity: Array) -> tuple[Array, Array]:
        """The mass matrix `(joint, joint, lane)` kg·m², and `(joint, lane)` Nm of gravity and velocities.

        Args:
            q: `(joint, lane)` rad.
            dq: likewise, rad/s.
            gravity: `(3, lane)` m/s².
        """
        rows, mass, center, inertia = self.bodies
        dof, lanes = q.shape
        axes = np.empty((3, 3, dof, lanes))  # an axis of the link, a component in the world
        origins = np.empty((3, dof, lanes))
        turn = np.repeat(np.eye(3)[..., None], lanes, 2)
        origin = np.zeros((3, lanes))
        cosine, sine = np.cos(q), np.sin(q)
        for i in range(dof):
            flat = turn.reshape(3, -1)
            origin = origin + (rows[i, :3] @ flat).reshape(3, -1)
            x, y, z = (self._turns[i] @ flat).reshape(3, 3, -1)
            turn = np.empty((3, 3, lanes))
            turn[0] = cosine[i] * x + sine[i] * y
            turn[1] = cosine[i] * y - sine[i] * x
            turn[2] = z
            axes[:, :, i] = turn
            origins[:, i] = origin
        z = axes[2]
        offset = np.einsum("acil,ail->cil", axes, center)
        along = _cross(z[:, None], (origins + offset)[:, :, None] - origins[:, None]) * self._before
        about = np.broadcast_to(z[:, None], along.shape) * self._before
        tensor = np.einsum("acil,abil->cbil", axes, inertia)
        tensor = np.einsum("cbil,bdil->cdil", tensor, axes)
        twisted = np.einsum("cdil,dikl->cikl", tensor, about)
        matrix = np.einsum("cijl,cikl->jkl", mass[:, None] * along, along) + np.einsum("cijl,cikl->jkl", about, twisted)

        rate = np.cumsum(z * dq, 1)
        slower = np.concatenate([np.zeros((3, 1, lanes)), rate[:, :-1]], 1)
        spin = np.cumsum(_cross(slower, z) * dq, 1)
        step = np.diff(origins, axis=1)
        carried = _cross(spin[:, :-1], step) + _cross(rate[:, :-1], _cross(rate[:, :-1], step))
        thrust = np.concatenate([np.zeros((3, 1, lanes)), np.cumsum(carried, 1)], 1) - gravity[:, None]
        thrust = thrust + _cross(spin, offset) + _cross(rate, _cross(rate, offset))
        momentum = np.einsum("cdil,dil->cil", tensor, rate)
        torque = np.einsum("cdil,dil->cil", tensor, spin) + _cross(rate, momentum)
        bias = np.einsum("cijl,cil->jl", along, mass * thrust) + np.einsum("cijl,cil->jl", about, torque)
        return matrix, bias


# ------------------------------------------------------------------ which arms there are


def draw_arm(name: str, rng: np.random.Generator, gravity: Array) -> Arm:
    """An arm and its servos, which suit its weight and inertia.

    Args:
        name: `serial3` … `serial5`, or one of `PUBLISHED`.
        rng: of the trial.
        gravity: `(3,)` m/s².
    """
    chain, inertia, middle = _published(name, rng) if name in PUBLISHED else _serial(int(name[-1]), rng)
    reach = np.minimum(np.ptp(chain.limits, axis=1) / 2 - 0.1, _REACH)
    zero = np.zeros(chain.dof)
    bare = Arm(chain, inertia, Joints(*[zero] * 5), middle, reach)
    dynamics = Dynamics(Bodies.of(bare, np.zeros(_POSTURES), np.zeros(3)))
    q = middle[:, None] + reach[:, None] * rng.uniform(-1, 1, (chain.dof, _POSTURES))
    matrix, weight = dynamics.terms(q, 0 * q, np.repeat(gravity[:, None], _POSTURES, 1))
    heaviest = np.abs(weight).max(1)
    moved = np.einsum("jjl->jl", matrix).max(1)
    return replace(bare, joints=_draw_joints(rng, heaviest, moved))


def _draw_joints(rng: np.random.Generator, heaviest: Array, moved: Array) -> Joints:
    """Servos of joints that carry so many Nm and move so many kg·m² at most."""
    dof = len(moved)
    rotor = np.maximum(moved * rng.uniform(0.05, 0.4, dof), 0.004)
    inertia = moved + rotor
    stiffness = np.clip(heaviest / rng.uniform(*_SAG, dof), inertia * _SLOWEST**2, inertia * _FASTEST**2)
    damping = 2 * rng.uniform(*_DAMPED, dof) * np.sqrt(stiffness * inertia)
    viscous = damping * rng.uniform(0.02, 0.1, dof)
    coulomb = stiffness * rng.uniform(2e-4, 1.2e-3, dof)
    return Joints(*(np.round(each, _DECIMALS) for each in (stiffness, damping, rotor, viscous, coulomb)))


def _serial(dof: int, rng: np.random.Generator) -> tuple[Chain, Array, Array]:
    """A random arm: neighbouring axes parallel or at right angles, links of 0.1 to 0.35 m that taper."""
    rows = np.zeros((dof, 6))
    rows[0, 2] = rng.uniform(0.1, 0.3)
    for i in range(1, dof):
        rows[i, :3] = rng.uniform(-0.03, 0.03, 3)
        rows[i, 0 if i > 1 else 2] += rng.uniform(0.1, 0.35) * (1 if i > 1 else 0.3)
        right_angled = i == 1 or rng.random() < 0.5
        rows[i, 3] = rng.choice([-1.0, 1.0]) * np.pi / 2 if right_angled else 0.0
        rows[i, 3:] += rng.normal(0, 0.02, 3)
    mass = rng.uniform(0.8, 3.0) * 0.7 ** np.arange(dof) * rng.uniform(0.7, 1.3, dof)
    center = np.zeros((dof, 3))
    center[:-1] = 0.5 * rows[1:, :3]
    center[-1, 0] = rng.uniform(0.04, 0.1)
    center += rng.normal(0, 0.01, (dof, 3))
    length = np.linalg.norm(center, axis=1) + 0.05
    box = np.stack([np.full(dof, 0.3), rng.uniform(0.7, 1.0, dof), rng.uniform(0.7, 1.0, dof)], 1)
    sides = mass[:, None] * length[:, None] ** 2 / 3 * box
    turn = rotation_from_vector(rng.normal(0, 0.2, (dof, 3)))
    inertia = turn @ (sides[:, :, None] * np.eye(3)) @ np.swapaxes(turn, 1, 2)
    limits = np.tile([-np.pi, np.pi], (dof, 1))
    middle = rng.uniform(-0.6, 0.6, dof)
    return Chain(f"serial{dof}", rows, limits, mass, center), inertia, middle


def _published(name: str, rng: np.random.Generator) -> tuple[Chain, Array, Array]:
    """A published arm, whose lengths are off by parts of a millimetre."""
    text = yaml.safe_load((_DATA / f"{name}.yaml").read_text())
    rows = np.array([[joint[key] for key in SIX] for joint in text["kinematics"].values()], float)
    rows[:, :3] += rng.normal(0, 5e-4, (len(rows), 3))
    links = list(text["inertial"].values())[: len(rows)]
    mass = np.array([link["mass_kg"] for link in links], float)
    center = np.array([link["com_m"] for link in links], float)
    inertia = np.stack([_tensor(link["inertia_kg_m2"]) for link in links])
    limits = np.array(text["joint_limits_rad"], float)
    lower = np.maximum(limits[:, 0], -np.pi)
    upper = np.minimum(limits[:, 1], 1.7 * np.pi)
    middle = (lower + upper) / 2 + rng.uniform(-0.3, 0.3, len(rows))
    return Chain(name, rows, np.stack([lower, upper], 1), mass, center), inertia, middle


def _tensor(numbers: list[float]) -> Array:
    xx, yy, zz, xy, xz, yz = numbers
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], float)


def arm_text(arm: Arm) -> str:
    """The description of an arm: kinematics, limits, inertia, friction and rotors."""
    description = yaml.safe_load(description_text(arm.chain))
    description["dynamics"] = {}
    for i, tensor in enumerate(arm.inertia):
        numbers = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]]
        description["inertial"][f"link{i + 1}"]["inertia_kg_m2"] = [float(value) for value in numbers]
        friction = {
            "viscous_Nm_s_per_rad": float(arm.joints.viscous[i]),
            "coulomb_Nm": float(arm.joints.coulomb[i]),
        }
        description["dynamics"][f"joint{i + 1}"] = {
            "friction": friction,
            "rotor_inertia_kg_m2": float(arm.joints.rotor[i]),
        }
    return yaml.safe_dump(description, sort_keys=False)
