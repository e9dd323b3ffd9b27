"""The numbers that joint torques depend on linearly: ten of each link, and four of each joint's friction and rotor."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.dynamics import regressor
from lite6jax.arms.joint_units import joint_size, joint_sizes, joint_unit
from lite6jax.design.torque.fourier import Motion
from lite6jax.effects.dynamic.torque_effect import direction
from lite6jax.errors import InputError

Matrix = NDArray[np.floating]

LINK = ("m", "m·cx", "m·cy", "m·cz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
"""The parameters of a link in the order of `arms.dynamics`, inertia about the origin of its frame."""
JOINT = ("viscous", "Coulomb", "offset", "rotor inertia")
"""The parameters of a joint's friction and drive."""
NOISE = 0.05
"""Nm, one standard deviation of a joint's torque where none is declared, 0.5 N of a prismatic joint: an assumption to
plan with."""
GRAVITY = (0.0, 0.0, -9.81)
"""m/s² in the base's frame."""

BLOCK = 2048
"""Samples whose columns are computed at a time."""

_UNITS = ("kg", *["kg·m"] * 3, *["kg·m²"] * 6)
JOINT_UNITS = ("Nm·s/rad", "Nm", "Nm", "kg·m²")
"""Their units, of a revolute joint."""
_KEPT_FIRST = (4, 7, 8, 9, 6, 1, 2, 3, 5, 0)
"""Of a link, those that stand for a base parameter come first (W. Khalil, E. Dombre, 2002, 9.4.2): Iyy, m·cz and m
are carried by others."""
_UNKNOWN_MASS = 1.0
"""kg, of each link of an arm that declares none, as a scale of what is worth determining."""
_SHORTEST = 0.1
"""Of the reach: the lever arm of a link whose axes meet, as a scale."""
_JOINT_SCALE = (1.0, 1.0, 1.0, 0.1)


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
    noise: Matrix
    gravity: Matrix
    inertial: bool = True

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknown parameters: `link3 m·cx` … `joint2 Coulomb`."""
        links = [f"link{i + 1} {name}" for i in range(self.arm.dof) for name in LINK]
        joints = [f"joint{i + 1} {name}" for i in range(self.arm.dof) for name in JOINT]
        return (*(links if self.inertial else []), *joints)

    @property
    def units(self) -> tuple[str, ...]:
        """SI units of the unknown parameters."""
        joints = (joint_unit(unit, slides) for slides in self.arm.slides.tolist() for unit in JOINT_UNITS)
        return (*(_UNITS * self.arm.dof if self.inertial else ()), *joints)

    @property
    def scale(self) -> Matrix:
        """`(column,)` typical sizes in SI units: of a link by its mass and the distance to the next joint."""
        sizes = list(zip(_JOINT_SCALE, JOINT_UNITS, strict=True))
        joints = np.array([joint_size(*size, slides) for slides in self.arm.slides.tolist() for size in sizes])
        if not self.inertial:
            return joints
        mass = np.full(self.arm.dof, _UNKNOWN_MASS) if self.arm.mass is None else self.arm.mass
        mass = np.maximum(mass, 1e-3 * mass.max(initial=_UNKNOWN_MASS))
        ahead = np.vstack([self.arm.kinematics[1:, :3], self.arm.T_joint_flange[:3, 3]])
        lever = np.maximum(np.linalg.norm(ahead, axis=1), _SHORTEST * self.arm.reach)
        links = [m * length**power for m, length in zip(mass, lever, strict=True) for power in (0, *[1] * 3, *[2] * 6)]
        return np.append(links, joints)

    @property
    def order(self) -> list[int]:
        """Columns in the order in which they stand for what they are confounded with: links before joints."""
        links = 10 * self.arm.dof if self.inertial else 0
        kept = [10 * link + i for link in range(self.arm.dof) for i in _KEPT_FIRST] if links else []
        return [*kept, *range(links, links + 4 * self.arm.dof)]

    def columns(self, motion: Motion, chosen: NDArray[np.integer] | None = None, scale: Matrix | None = None) -> Matrix:
        """Whitened torques per unit of the unknown parameters, `(joint, column, sample)`; NumPy.

        Args:
            motion: of any samples.
            chosen: indices of the parameters; all where not given.
            scale: SI, the unit of each chosen parameter; SI where not given.
        """
        found = [joint_columns(self.arm, Motion(*(np.asarray(part) for part in motion)))]
        if self.inertial:
            found.insert(0, link_columns(self.arm, motion, self.gravity))
        chosen = np.arange(len(self.names)) if chosen is None else chosen
        scale = np.ones(len(chosen)) if scale is None else scale
        return np.concatenate(found, 1)[:, chosen] * (scale[:, None] / self.noise[:, None, None])

    def root(self, motion: Motion) -> Matrix:
        """`(column, column)` upper triangular R with RᵀR = the information of a motion about the unknowns."""
        R = np.zeros((0, len(self.names)))
        for some in in_blocks(motion):
            rows = self.columns(some).transpose(0, 2, 1).reshape(-1, R.shape[1])
            R = np.linalg.qr(np.vstack([R, rows])).R
        return R


def link_columns(arm: Arm, motion: Motion, gravity: Matrix) -> Matrix:
    """Torques per unit of each link's parameters `LINK`, `(joint, 10 joint, sample)`; NumPy.

    In blocks of one size, so that the regressor is compiled once for an arm of as many joints.
    """
    found = []
    for some in in_blocks(motion):
        short = BLOCK - some.q.shape[1]
        padded = (np.pad(part, ((0, 0), (0, short))) for part in some)
        found.append(np.asarray(regressor(arm.kinematics, *padded, gravity, arm.sliding))[..., : BLOCK - short])
    return found[0] if len(found) == 1 else np.concatenate(found, -1)


def in_blocks(motion: Motion) -> Iterator[Motion]:
    """The motion in pieces of `BLOCK` samples, the last with what is left."""
    for start in range(0, motion.q.shape[1], BLOCK):
        yield Motion(*(np.asarray(part)[:, start : start + BLOCK] for part in motion))


def joint_columns(arm: Arm, motion: Motion) -> Matrix:
    """Torques per unit of each joint's parameters `JOINT`, `(joint, 4 joint, sample)`: on its own joint alone."""
    q, dq, ddq = (np.asarray(part) for part in motion)
    own = np.stack([dq, direction(dq, arm.slides), np.ones_like(q), ddq], 1)
    found = np.zeros((len(q), len(q), *own.shape[1:]))
    found[np.arange(len(q)), np.arange(len(q))] = own
    return found.reshape(len(q), -1, q.shape[1])


def torque_model(
    arm: Arm, noise: ArrayLike | None = None, gravity: ArrayLike = GRAVITY, inertial: bool = True
) -> TorqueModel:
    """A `TorqueModel`.

    Args:
        arm: geometry suffices.
        noise: Nm, one number, of prismatic joints at `arms.joint_units.LEVER`, or one per joint, Nm or N; `NOISE` where
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
