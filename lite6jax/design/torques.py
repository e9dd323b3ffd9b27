"""What motions determine of an arm's dynamics through the torques of its joints, and which motion to make.

Joint torques depend linearly on ten numbers of each link, and on four of each joint's friction and rotor.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

from lite6jax.arms.arm import Arm, joint_size, joint_sizes, joint_unit
from lite6jax.arms.dynamics import regressor
from lite6jax.design.determination import BaseParameter, Determination, determination_of, narrow_joints
from lite6jax.design.motions import (
    ACCELERATION,
    VELOCITY,
    Excitation,
    Motion,
    MotionRoom,
    MotionSearch,
    Trajectory,
    ascend,
    random_motions,
)
from lite6jax.effects.dynamic.torque_effect import direction
from lite6jax.errors import InputError

Array = NDArray[np.floating]

LINK = ("m", "m·cx", "m·cy", "m·cz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
"""The parameters of a link in the order of `arms.dynamics`, inertia about the origin of its frame."""
JOINT = ("viscous", "Coulomb", "offset", "rotor inertia")
"""The parameters of a joint's friction and drive."""
JOINT_UNITS = ("Nm·s/rad", "Nm", "Nm", "kg·m²")
"""Their units, of a revolute joint."""
_JOINT_SIZES = (1.0, 1.0, 1.0, 0.1)
_POWERS = (0, *[1] * 3, *[2] * 6)
"""Of a length, in each parameter of a link."""
NOISE = 0.05
"""Nm, one standard deviation of a joint's torque where none is declared, 0.5 N of a prismatic joint: an assumption to
plan with."""
GRAVITY = (0.0, 0.0, -9.81)
"""m/s² in the base's frame."""
WELL = 0.1
"""Of a base parameter's typical size, one standard deviation above which it is weakly determined."""
_STANDING = (4, 7, 8, 9, 6, 1, 2, 3, 5, 0)
"""Of a link, those that stand for a base parameter come first (W. Khalil, E. Dombre, 2002, 9.4.2): Iyy, m·cz and m
are carried by others."""
_UNKNOWN_MASS = 1.0
"""kg, of each link of an arm that declares none, as a scale of what is worth determining."""
_SHORTEST = 0.1
"""Of the reach: the lever arm of a link whose axes meet, as a scale."""
_BLOCK = 2048
"""Samples whose columns are computed at a time."""
_STATES = 300
"""Random states that show all that any motion of an arm determines: at least four times as many rows as unknowns."""


@final
@dataclass(frozen=True, eq=False)
class TorqueModel:
    """What an arm's torques depend on, and how well they are measured.

    Attributes:
        arm: its geometry; masses, where it has them, only say which standard deviations are small.
        noise: `(joint,)` Nm, N of a prismatic joint, one standard deviation of each joint's torque, white.
        gravity: `(3,)` m/s² in the base's frame.
        inertial: whether the links' parameters are unknown; else only those of the joints are.
    """

    arm: Arm
    noise: Array
    gravity: Array
    inertial: bool = True

    @cached_property
    def _parameters(self) -> list[tuple[str, str, float]]:
        """Name, SI unit and typical size of each: of a link by its mass and the distance to the next joint."""
        arm = self.arm
        mass = np.full(arm.dof, _UNKNOWN_MASS) if arm.mass is None else arm.mass
        mass = np.maximum(mass, 1e-3 * mass.max(initial=_UNKNOWN_MASS))
        ahead = np.vstack([arm.kinematics[1:, :3], arm.T_joint_flange[:3, 3]])
        lever = np.maximum(np.linalg.norm(ahead, axis=1), _SHORTEST * arm.reach)
        links = [
            (f"link{i + 1} {name}", ("kg", "kg·m", "kg·m²")[power], float(mass[i] * lever[i] ** power))
            for i in range(arm.dof)
            for name, power in zip(LINK, _POWERS, strict=True)
        ]
        joints = [
            (f"joint{i + 1} {name}", joint_unit(unit, slides), joint_size(size, unit, slides))
            for i, slides in enumerate(arm.slides.tolist())
            for name, unit, size in zip(JOINT, JOINT_UNITS, _JOINT_SIZES, strict=True)
        ]
        return [*(links if self.inertial else []), *joints]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknown parameters: `link3 m·cx` … `joint2 Coulomb`."""
        return tuple(name for name, _, _ in self._parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """SI units of the unknown parameters."""
        return tuple(unit for _, unit, _ in self._parameters)

    @property
    def scale(self) -> Array:
        """`(column,)` typical sizes in SI units."""
        return np.array([size for _, _, size in self._parameters])

    @property
    def order(self) -> list[int]:
        """Columns in the order in which they stand for what they are confounded with: links before joints."""
        links = 10 * self.arm.dof if self.inertial else 0
        of_links = [first + i for first in range(0, links, 10) for i in _STANDING]
        return [*of_links, *range(links, links + 4 * self.arm.dof)]

    def columns(self, motion: Motion, chosen: NDArray[np.integer] | None = None, scale: Array | None = None) -> Array:
        """Whitened torques per unit of the unknown parameters, `(joint, column, sample)`; NumPy.

        Args:
            motion: of any samples.
            chosen: indices of the parameters; all where not given.
            scale: SI, the unit of each chosen parameter; SI where not given.
        """
        q, dq, ddq = (np.asarray(part) for part in motion)
        dof, samples = q.shape
        own = np.stack([dq, direction(dq, self.arm.slides), np.ones_like(q), ddq], 1)
        joints = np.zeros((dof, dof, *own.shape[1:]))
        joints[np.arange(dof), np.arange(dof)] = own
        links = [link_columns(self.arm, motion, self.gravity)] if self.inertial else []
        chosen = np.arange(len(self.names)) if chosen is None else chosen
        scale = np.ones(len(chosen)) if scale is None else scale
        found = np.concatenate([*links, joints.reshape(dof, -1, samples)], 1)
        return found[:, chosen] * (scale[:, None] / self.noise[:, None, None])

    def root(self, motion: Motion) -> Array:
        """`(column, column)` upper triangular R with RᵀR = the information of a motion about the unknowns."""
        R = np.zeros((0, len(self.names)))
        for some in _in_blocks(motion):
            rows = self.columns(some).transpose(0, 2, 1).reshape(-1, R.shape[1])
            R = np.linalg.qr(np.vstack([R, rows])).R
        return R


def torque_model(
    arm: Arm, noise: ArrayLike | None = None, gravity: ArrayLike = GRAVITY, inertial: bool = True
) -> TorqueModel:
    """A `TorqueModel`.

    Args:
        arm: geometry suffices.
        noise: Nm, one number, of prismatic joints at `arms.arm.LEVER`, or one per joint, Nm or N; `NOISE` where
            not given.
        gravity: `(3,)` m/s² in the base's frame.
        inertial: whether the links' parameters are unknown.

    Raises:
        InputError: noise that is not positive or is of another number of joints, or gravity that is not three numbers.
    """
    values = np.atleast_1d(np.asarray(NOISE if noise is None else noise, float))
    if values.shape not in ((1,), (arm.dof,)) or not (np.isfinite(values).all() and (values > 0).all()):
        raise InputError(
            f"torque noise {' '.join(f'{v:g}' for v in values.ravel())} Nm: give one standard deviation above 0, or"
            f" {arm.dof} of them"
        )
    g = np.asarray(gravity, float)
    if g.shape != (3,) or not np.isfinite(g).all():
        raise InputError(f"gravity {np.asarray(gravity).tolist()}: give three finite numbers in m/s²")
    each = joint_sizes(float(values[0]), "Nm", arm.slides) if values.shape == (1,) else values.copy()
    return TorqueModel(arm, each, g, inertial)


def link_columns(arm: Arm, motion: Motion, gravity: Array) -> Array:
    """Torques per unit of each link's parameters `LINK`, `(joint, 10 joint, sample)`; NumPy.

    In blocks of one size, so that the regressor is compiled once for an arm of as many joints.
    """
    found = []
    for some in _in_blocks(motion):
        short = _BLOCK - some.q.shape[1]
        padded = (np.pad(part, ((0, 0), (0, short))) for part in some)
        found.append(np.asarray(regressor(arm.kinematics, *padded, gravity, arm.sliding))[..., : _BLOCK - short])
    return found[0] if len(found) == 1 else np.concatenate(found, -1)


def _in_blocks(motion: Motion) -> Iterator[Motion]:
    """The motion in parts of `_BLOCK` samples, the last with what is left."""
    for start in range(0, motion.q.shape[1], _BLOCK):
        yield Motion(*(np.asarray(part)[:, start : start + _BLOCK] for part in motion))


@final
@dataclass(frozen=True, eq=False)
class Structure:
    """What any motion at all of an arm determines.

    Attributes:
        model: its unknowns.
        determination: of them, by random states.
    """

    model: TorqueModel
    determination: Determination

    @property
    def free(self) -> NDArray[np.integer]:
        """`(base,)` columns that stand for the base parameters."""
        return np.flatnonzero(self.determination.free)

    @property
    def base(self) -> tuple[BaseParameter, ...]:
        """The base parameters, in the same order."""
        return self.determination.base

    @cached_property
    def scale(self) -> Array:
        """`(base,)` their typical sizes, SI."""
        return np.array([item.scale for item in self.base])

    @property
    def confounded(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """Of each parameter that is only determined with others: its name, and the base parameters it is in."""
        dependencies = self.determination.dependencies
        return tuple((d.name, tuple(name for name, _, _ in d.partners)) for d in dependencies if d.partners)

    @property
    def silent(self) -> tuple[str, ...]:
        """Names of parameters that change no torque."""
        return tuple(d.name for d in self.determination.dependencies if not d.partners)

    @property
    def inertial(self) -> int:
        """How many base parameters are of links."""
        return sum(item.name.startswith("link") for item in self.base)


def structure_of(model: TorqueModel, seed: int = 0) -> Structure:
    """What any motion determines, found numerically at random states.

    The grouping is that of M. Gautier (ICRA 1990): columns are taken link by link from the base, those that depend on
    the ones before add to them what they share.
    """
    rng = np.random.default_rng(seed)
    states = [
        rng.uniform(-size, size, (model.arm.dof, _STATES)) * joint_sizes(1.0, unit, model.arm.slides)[:, None]
        for size, unit in ((np.pi, "rad"), (VELOCITY, "rad/s"), (ACCELERATION, "rad/s²"))
    ]
    root = model.root(Motion(*states)) * model.scale
    return Structure(model, determination_of(root, model.names, model.units, model.scale, _STATES, model.order))


@final
@dataclass(frozen=True, eq=False)
class TorqueIdentification:
    """What a motion determines.

    Attributes:
        structure: what any motion of the arm determines.
        samples: of the motion.
        span: `(joint,)` rad, m of prismatic joints, over which each joint moves.
        determined: `(base,)` bool, which base parameters this motion determines apart from the others.
        standard_deviation: `(base,)` SI; infinite where not determined.
        condition: of the whitened regressor of the base parameters determined, in their typical sizes.
        log_determinant: of the information about all base parameters in their typical sizes; −inf unless all are
            determined.
        at_rest: whether the arm stands still in all samples.
        notes: what was assumed, a sentence each.
    """

    structure: Structure
    samples: int
    span: Array
    determined: NDArray[np.bool_]
    standard_deviation: Array
    condition: float
    log_determinant: float
    at_rest: bool
    notes: tuple[str, ...] = ()

    @property
    def model(self) -> TorqueModel:
        """The unknowns."""
        return self.structure.model

    @cached_property
    def weak(self) -> NDArray[np.bool_]:
        """`(base,)`: determined no better than to a tenth of their typical size."""
        return self.determined & (self.standard_deviation > WELL * self.structure.scale)

    def narrow(self) -> list[tuple[int, float]]:
        """Joints, counted from 0, that hardly move, and their range in rad, or in m of prismatic joints."""
        return narrow_joints(self.span, self.model.arm.slides)

    def deviation_of(self, joint: int, kind: str) -> float | None:
        """One standard deviation of a joint's parameter, SI; None where it is only determined with others or not."""
        name = f"joint{joint + 1} {kind}"
        for item, deviation, there in zip(self.structure.base, self.standard_deviation, self.determined, strict=True):
            if item.name == name:
                return float(deviation) if there else None
        return None

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain numbers and words, in SI units, for a JSON file."""
        structure = self.structure
        base = zip(structure.base, self.standard_deviation, self.determined, self.weak, strict=True)
        return {
            "schema": "lite6jax/torque_identification/1",
            "arm": self.model.arm.name,
            "samples": self.samples,
            "torque_noise_Nm": self.model.noise.tolist(),
            "gravity_m_per_s2": self.model.gravity.tolist(),
            "rank": int(self.determined.sum()),
            "rank_possible": len(structure.base),
            "condition": self.condition if np.isfinite(self.condition) else None,
            "log_determinant": self.log_determinant if np.isfinite(self.log_determinant) else None,
            "base_parameters": [
                {
                    "name": item.name,
                    "terms": dict(item.terms),
                    "unit": item.unit,
                    "std": float(deviation) if there else None,
                    "typical": item.scale,
                    "weak": bool(weak),
                }
                for item, deviation, there, weak in base
            ],
            "only_with_others": {name: list(carriers) for name, carriers in structure.confounded},
            "without_effect": list(structure.silent),
            "notes": list(self.notes),
        }


def identify_torques(
    model: TorqueModel, motion: Motion, *, structure: Structure | None = None, notes: tuple[str, ...] = ()
) -> TorqueIdentification:
    """What a motion determines of an arm's base parameters and friction, and how well.

    Args:
        model: from `torque_model`.
        motion: `(joint, sample)` each; its accelerations free of noise, as of a zero-phase filter.
        structure: `structure_of(model)` where known.
        notes: said with the result.

    Raises:
        InputError: another number of joints, numbers that are not finite, or a motion too short: fewer torques than
            there are unknowns.
    """
    structure, arm = structure or structure_of(model), model.arm
    for name, part in zip(motion._fields, map(np.asarray, motion), strict=True):
        if part.ndim != 2 or len(part) != arm.dof or part.shape != np.shape(motion.q):
            raise InputError(f"motion: {name} has the shape {part.shape}; {arm.name} takes ({arm.dof}, sample)")
        if not np.isfinite(part).all():
            raise InputError(f"motion: {name} has a number that is not finite; leave those samples out")
    samples, base = motion.q.shape[1], structure.base
    least = -(-len(base) // arm.dof)
    if samples < least:
        raise InputError(
            f"motion: {samples} samples of {arm.dof} torques for {len(base)} unknowns; record {least} samples or more"
        )
    R = model.root(motion)[:, structure.free] * structure.scale
    names = [item.name for item in base]
    found = determination_of(R, names, [item.unit for item in base], structure.scale, samples)
    # of those on which others depend only the sum with these is determined
    entangled = {name for dependency in found.dependencies for name, _, _ in dependency.partners}
    determined = found.free & np.array([name not in entangled for name in names])
    sizes = np.linalg.svd(R[:, determined], compute_uv=False) if determined.any() else np.full(1, np.nan)
    return TorqueIdentification(
        structure=structure,
        samples=samples,
        span=np.ptp(np.asarray(motion.q), axis=1),
        determined=determined,
        standard_deviation=np.where(determined, found.standard_deviation, np.inf),
        condition=float(sizes[0] / sizes[-1]),
        log_determinant=float(2 * np.sum(np.log(found.singular_values))) if found.free.all() else -np.inf,
        at_rest=not np.any(motion.dq),
        notes=notes,
    )


@final
@dataclass(frozen=True, eq=False)
class TorquePlan:
    """A motion whose torques determine an arm's parameters, and what random motions of the same limits determine.

    Attributes:
        room: where it may be.
        trajectory: the designed one.
        identification: what it determines.
        random: what each of the random motions determines.
        steps: of the ascents that led to a better motion.
    """

    room: MotionRoom
    trajectory: Trajectory
    identification: TorqueIdentification
    random: tuple[TorqueIdentification, ...]
    steps: int

    @property
    def random_log_determinant(self) -> Array:
        """`(draw,)`, of the random motions."""
        return np.array([found.log_determinant for found in self.random])

    @property
    def random_condition(self) -> Array:
        """`(draw,)`, of the random motions."""
        return np.array([found.condition for found in self.random])

    @property
    def random_deviation(self) -> Array:
        """`(base,)` SI: the median standard deviation of each base parameter over the random motions."""
        return np.median([found.standard_deviation for found in self.random], axis=0)

    def gain(self, log_determinant: float) -> float:
        """How many times smaller standard deviations are than of that determinant, in the geometric mean."""
        count = len(self.identification.structure.base)
        return float(np.exp((self.identification.log_determinant - log_determinant) / (2 * count)))


@threadpool_limits.wrap(limits=1, user_api="blas")  # sums of products depend on the threads
def plan_motion(model: TorqueModel, room: MotionRoom, search: MotionSearch) -> TorquePlan:
    """The motion with the largest information determinant about base parameters and friction that the room allows.

    J. Swevers et al. (1997) minimise the determinant of the covariance likewise; here by gradient, from the best of
    random motions.

    Args:
        model: the unknowns and the noise.
        room: limits, obstacles, duration.
        search: random motions and ascents.

    Raises:
        InputError: no room for a motion.
    """
    structure = structure_of(model)
    columns = partial(model.columns, chosen=structure.free, scale=structure.scale)
    drawn = random_motions(room, search.seed, search.draws)
    excitation = Excitation(room, columns)
    values = np.array([excitation.value(free) for free in drawn])
    best = [drawn[i] for i in np.argsort(-values, kind="stable")[: max(search.starts, 1)]]
    ends = [ascend(excitation, start, search.steps) for start in best]
    free, _, _ = max(ends, key=lambda end: end[1])
    steps = sum(improved for _, _, improved in ends)
    own, *random = (
        identify_torques(model, room.trajectory(each).motion, structure=structure) for each in (free, *drawn)
    )
    return TorquePlan(room, room.trajectory(free), own, tuple(random), steps)
