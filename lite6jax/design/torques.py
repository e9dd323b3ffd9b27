"""What motions determine of an arm's dynamics through the torques of its joints, and which motion to make.

Joint torques depend linearly on ten numbers of each link, and on four of each joint's friction and rotor.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from threadpoolctl import threadpool_limits

from lite6jax.arms.arm import Arm, joint_size, joint_sizes, joint_unit
from lite6jax.arms.dynamics import regressor
from lite6jax.array_types import Array, Mask
from lite6jax.design.determination import (
    BaseParameter,
    Determination,
    accumulate_root,
    determination_of,
    each_block,
    narrow_joints,
)
from lite6jax.design.motions import (
    ACCELERATION,
    VELOCITY,
    JointTrajectory,
    MotionRoom,
    ascend,
    per_joint,
    random_motions,
)
from lite6jax.effects.dynamic import DIRECTION_SPEED
from lite6jax.errors import InputError

JOINT = ("viscous", "Coulomb", "offset", "rotor inertia")
"""The parameters of a joint's friction and drive."""
JOINT_UNITS = ("Nm·s/rad", "Nm", "Nm", "kg·m²")
"""Their units, of a revolute joint."""
_JOINT_SIZES = (1.0, 1.0, 1.0, 0.1)
_LINK = {"m": 0, "m·cx": 1, "m·cy": 1, "m·cz": 1, "Ixx": 2, "Iyy": 2, "Izz": 2, "Ixy": 2, "Ixz": 2, "Iyz": 2}
"""The parameters of a link in the order of `arms.dynamics`, inertia about the origin of its frame, and the power of a
length in each."""
_STANDING = (4, 7, 8, 9, 6, 1, 2, 3, 5, 0)
"""Of a link, those that stand for a base parameter come first (W. Khalil, E. Dombre, 2002, 9.4.2): Iyy, m·cz and m
are carried by others."""
NOISE = 0.05
"""Nm, one standard deviation of a joint's torque where none is declared, 0.5 N of a prismatic joint: an assumption to
plan with."""
GRAVITY = (0.0, 0.0, -9.81)
"""m/s² in the base's frame."""
WELL = 0.1
"""Of a base parameter's typical size, one standard deviation above which it is weakly determined."""
_UNKNOWN_MASS = 1.0
"""kg, of each link of an arm that declares none, as a scale of what is worth determining."""
_SHORTEST = 0.1
"""Of the reach: the lever arm of a link whose axes meet, as a scale."""
_BLOCK = 2048
"""Samples whose columns are computed at a time: the regressor is compiled once for an arm of as many joints."""
_STATES = 300
"""Random states that show all that any motion of an arm determines: at least four times as many rows as unknowns."""


@final
@dataclass(frozen=True, eq=False)
class TorqueExperiment:
    """What an arm's torques depend on, how well they are measured, and what any motion at all determines of it.

    Attributes:
        arm: its geometry; masses, where it has them, only say which standard deviations are small.
        noise: `(joint,)` one standard deviation of each joint's torque, white: Nm, N of a prismatic joint. Made of one
            number, of prismatic joints at `arms.arm.LEVER`, or one per joint; `NOISE` where not given.
        gravity: `(3,)` m/s² in the base's frame.
        inertial: whether the links' parameters are unknown; else only those of the joints are.

    Raises:
        InputError: noise that is not positive or is of another number of joints, or gravity that is not three numbers.
    """

    arm: Arm
    noise: Any = None
    gravity: Any = GRAVITY
    inertial: bool = True

    def __post_init__(self) -> None:
        noise = NOISE if self.noise is None else self.noise
        object.__setattr__(self, "noise", per_joint(self.arm, noise, "torque noise", "Nm", "standard deviation"))
        g = np.asarray(self.gravity, float)
        if g.shape != (3,) or not np.isfinite(g).all():
            raise InputError(f"gravity {np.asarray(self.gravity).tolist()}: give three finite numbers in m/s²")
        object.__setattr__(self, "gravity", g)

    @cached_property
    def parameters(self) -> list[tuple[str, str, float]]:
        """Name, unit and typical size of the unknown ones: of a link by its mass and the distance to the next joint."""
        arm = self.arm
        mass = np.full(arm.dof, _UNKNOWN_MASS) if arm.mass is None else arm.mass
        mass = np.maximum(mass, 1e-3 * mass.max(initial=_UNKNOWN_MASS))
        ahead = np.vstack([arm.kinematics[1:, :3], arm.T_joint_flange[:3, 3]])
        lever = np.maximum(np.linalg.norm(ahead, axis=1), _SHORTEST * arm.reach)
        links = [
            (f"link{i + 1} {name}", ("kg", "kg·m", "kg·m²")[power], float(mass[i] * lever[i] ** power))
            for i in range(arm.dof if self.inertial else 0)
            for name, power in _LINK.items()
        ]
        return links + [
            (f"joint{i + 1} {name}", joint_unit(unit, slides), joint_size(size, unit, slides))
            for i, slides in enumerate(arm.slides.tolist())
            for name, unit, size in zip(JOINT, JOINT_UNITS, _JOINT_SIZES, strict=True)
        ]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknown parameters, `link3 m·cx` … `joint2 Coulomb`."""
        return tuple(name for name, _, _ in self.parameters)

    @property
    def scale(self) -> Array:
        """`(column,)` their typical sizes, SI."""
        return np.array([size for _, _, size in self.parameters])

    def columns(self, motion: JointTrajectory) -> jax.Array:
        """Whitened torques per SI unit of the unknown parameters, `(joint, column, sample)`; plain JAX."""
        q, dq, ddq = map(jnp.asarray, motion)
        dof, samples = q.shape
        speed = joint_sizes(DIRECTION_SPEED, "rad/s", self.arm.slides)[:, None]
        joint_columns = jnp.stack([dq, jnp.tanh(dq / speed), jnp.ones_like(q), ddq], 1)
        joints = jnp.zeros((dof, dof, *joint_columns.shape[1:])).at[np.arange(dof), np.arange(dof)].set(joint_columns)
        columns = joints.reshape(dof, -1, samples)
        if self.inertial:
            links = regressor(self.arm.kinematics, q, dq, ddq, self.gravity, self.arm.sliding)
            columns = jnp.concatenate([links, columns], 1)
        return columns / self.noise[:, None, None]

    def root(self, motion: JointTrajectory) -> Array:
        """`accumulate_root` of the torques of a motion, in typical sizes."""

        def rows(*parts: Array) -> Array:
            return np.asarray(self.columns(JointTrajectory(*(part.T for part in parts)))).swapaxes(0, 1)

        parts = [np.asarray(part).T for part in motion]
        return self.scale * accumulate_root(each_block(rows, parts, _BLOCK), len(self.names))

    @cached_property
    def possible(self) -> Determination:
        """What any motion determines, found numerically at random states.

        The grouping is that of M. Gautier (ICRA 1990): columns are taken link by link from the base, those that depend
        on the ones before add to them what they share.
        """
        rng = np.random.default_rng(0)
        states = [
            rng.uniform(-size, size, (self.arm.dof, _STATES)) * joint_sizes(1.0, unit, self.arm.slides)[:, None]
            for size, unit in ((np.pi, "rad"), (VELOCITY, "rad/s"), (ACCELERATION, "rad/s²"))
        ]
        links = 10 * self.arm.dof if self.inertial else 0
        order = [*(first + i for first in range(0, links, 10) for i in _STANDING), *range(links, len(self.names))]
        units = [unit for _, unit, _ in self.parameters]
        return determination_of(self.root(JointTrajectory(*states)), self.names, units, self.scale, _STATES, order)

    @property
    def base(self) -> tuple[BaseParameter, ...]:
        """The base parameters that motions determine."""
        return self.possible.base

    @property
    def base_scale(self) -> Array:
        """`(base,)` their typical sizes, SI."""
        return np.array([item.scale for item in self.base])

    @property
    def confounded(self) -> dict[str, tuple[str, ...]]:
        """The base parameters of each parameter that is only determined with others."""
        dependencies = self.possible.dependencies
        return {d.name: tuple(name for name, _, _ in d.partners) for d in dependencies if d.partners}

    @property
    def silent(self) -> tuple[str, ...]:
        """Names of parameters that change no torque."""
        return tuple(d.name for d in self.possible.dependencies if not d.partners)


@final
@dataclass(frozen=True, eq=False)
class TorqueIdentification:
    """What a motion determines.

    Attributes:
        model: the unknowns, and what any motion of the arm determines of them.
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

    model: TorqueExperiment
    samples: int
    span: Array
    determined: Mask
    standard_deviation: Array
    condition: float
    log_determinant: float
    at_rest: bool
    notes: tuple[str, ...] = ()

    @cached_property
    def weak(self) -> Mask:
        """`(base,)`: determined no better than to a tenth of their typical size."""
        return self.determined & (self.standard_deviation > WELL * self.model.base_scale)

    def narrow(self) -> list[tuple[int, float]]:
        """Joints, counted from 0, that hardly move, and their range in rad, or in m of prismatic joints."""
        return narrow_joints(self.span, self.model.arm.slides)

    @property
    def deviations(self) -> dict[str, float]:
        """The standard deviation of each base parameter that is determined, SI."""
        base_deviations = zip(self.model.base, self.standard_deviation, self.determined, strict=True)
        return {item.name: float(deviation) for item, deviation, is_determined in base_deviations if is_determined}

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain numbers and words, in SI units, for a JSON file."""
        model = self.model
        return {
            "schema": "lite6jax/torque_identification/1",
            "arm": model.arm.name,
            "samples": self.samples,
            "torque_noise_Nm": model.noise.tolist(),
            "gravity_m_per_s2": model.gravity.tolist(),
            "rank": int(self.determined.sum()),
            "rank_possible": len(model.base),
            "condition": self.condition if np.isfinite(self.condition) else None,
            "log_determinant": self.log_determinant if np.isfinite(self.log_determinant) else None,
            "base_parameters": [
                {
                    "name": item.name,
                    "terms": dict(item.terms),
                    "unit": item.unit,
                    "std": self.deviations.get(item.name),
                    "typical": item.scale,
                    "weak": bool(weak),
                }
                for item, weak in zip(model.base, self.weak, strict=True)
            ],
            "only_with_others": {name: list(carriers) for name, carriers in model.confounded.items()},
            "without_effect": list(model.silent),
            "notes": list(self.notes),
        }


def identify_torques(
    model: TorqueExperiment, motion: JointTrajectory, *, notes: tuple[str, ...] = ()
) -> TorqueIdentification:
    """What a motion determines of an arm's base parameters and friction, and how well.

    Args:
        model: the unknowns and the noise.
        motion: `(joint, sample)` each; its accelerations free of noise, as of a zero-phase filter.
        notes: said with the result.

    Raises:
        InputError: another number of joints, numbers that are not finite, or a motion too short: fewer torques than
            there are unknowns.
    """
    arm = model.arm
    base = model.base
    for name, part in zip(motion._fields, map(np.asarray, motion), strict=True):
        if part.ndim != 2 or len(part) != arm.dof or part.shape != np.shape(motion.q):
            raise InputError(f"motion: {name} has the shape {part.shape}; {arm.name} takes ({arm.dof}, sample)")
        if not np.isfinite(part).all():
            raise InputError(f"motion: {name} has a number that is not finite; leave those samples out")
    samples = motion.q.shape[1]
    fewest_samples = -(-len(base) // arm.dof)
    if samples < fewest_samples:
        raise InputError(
            f"motion: {samples} samples of {arm.dof} torques for {len(base)} unknowns; record {fewest_samples} samples "
            "or more"
        )
    free = model.possible.free
    R = model.root(motion)[:, free] * (model.base_scale / model.scale[free])
    names = [item.name for item in base]
    determination = determination_of(R, names, [item.unit for item in base], model.base_scale, samples)
    # of those on which others depend only the sum with these is determined
    entangled = {name for dependency in determination.dependencies for name, _, _ in dependency.partners}
    determined = determination.free & np.array([name not in entangled for name in names])
    sizes = np.linalg.svd(R[:, determined], compute_uv=False) if determined.any() else np.full(1, np.nan)
    return TorqueIdentification(
        model=model,
        samples=samples,
        span=np.ptp(np.asarray(motion.q), axis=1),
        determined=determined,
        standard_deviation=np.where(determined, determination.standard_deviation, np.inf),
        condition=float(sizes[0] / sizes[-1]),
        log_determinant=float(2 * np.sum(np.log(determination.singular_values)))
        if determination.free.all()
        else -np.inf,
        at_rest=not np.any(motion.dq),
        notes=notes,
    )


@final
@dataclass(frozen=True, eq=False)
class TorquePlan:
    """A motion whose torques determine an arm's parameters, and what random motions of the same limits determine.

    Attributes:
        room: where it may be.
        free: `(joint, 2 harmonics)`, the designed motion as `room.move` takes it.
        time: `(sample,)` s, from 0 to one period.
        motion: `(joint, sample)` each, from rest to rest; NumPy.
        identification: what it determines.
        random: what each of the random motions determines.
    """

    room: MotionRoom
    free: Array
    time: Array
    motion: JointTrajectory
    identification: TorqueIdentification
    random: tuple[TorqueIdentification, ...]

    @property
    def random_log_determinant(self) -> Array:
        """`(draw,)`, of the random motions."""
        return np.array([identification.log_determinant for identification in self.random])

    def gain(self, log_determinant: float) -> float:
        """How many times smaller standard deviations are than of that determinant, in the geometric mean."""
        count = len(self.identification.model.base)
        return float(np.exp((self.identification.log_determinant - log_determinant) / (2 * count)))


def record_motion(room: MotionRoom, free: Array) -> tuple[Array, JointTrajectory]:
    """The times `(sample,)` s of the recorded samples of one period, both ends among them, and the motion; NumPy."""
    time = np.arange(room.samples + 1) * room.duration / room.samples
    return time, JointTrajectory(*(np.asarray(part) for part in room.move(free, time)))


@threadpool_limits.wrap(limits=1, user_api="blas")  # sums of products depend on the threads
def plan_motion(
    model: TorqueExperiment, room: MotionRoom, *, seed: int = 0, draws: int = 50, starts: int = 2, steps: int = 150
) -> TorquePlan:
    """The motion with the largest information determinant about base parameters and friction that the room allows.

    J. Swevers et al. (1997) minimise the determinant of the covariance likewise; here by gradient, from the best of
    random motions.

    Args:
        model: the unknowns and the noise.
        room: limits, obstacles, duration.
        seed: of the random motions.
        draws: random motions, with which the best is compared too.
        starts: ascents, from the best of these.
        steps: of each ascent.

    Raises:
        InputError: no room for a motion.
    """

    stands = np.flatnonzero(model.possible.free)

    def log_determinant(motion: JointTrajectory) -> jax.Array:
        columns = model.columns(motion)[:, stands] * model.base_scale[:, None]
        rows = jnp.moveaxis(columns, 1, 0).reshape(len(stands), -1)
        return jnp.linalg.slogdet(rows @ rows.T * (room.samples / motion.q.shape[1]))[1]

    drawn = random_motions(room, seed, draws)
    random = [identify_torques(model, record_motion(room, free)[1]) for free in drawn]
    ranked = sorted(range(draws), key=lambda i: -random[i].log_determinant)
    free, _, _ = ascend(room, log_determinant, [drawn[i] for i in ranked[: max(starts, 1)]], steps)
    time, motion = record_motion(room, free)
    return TorquePlan(room, free, time, motion, identify_torques(model, motion), tuple(random))
