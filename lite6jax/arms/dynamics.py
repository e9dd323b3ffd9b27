"""Rigid-body dynamics of a serial arm: the motors' torques, linear in ten parameters a link, and what they determine.

A link's ten parameters are a body's where its pseudo-inertia, the second moments of its mass in homogeneous
coordinates, is positive definite (P. Wensing, S. Kim, J.-J. Slotine, IEEE Robotics and Automation Letters 3(1), 2018).
Torques leave many directions of the parameters open. There consistent links stay as near as possible to reference
links, by the divergence tr(P₀⁻¹P) − log det(P₀⁻¹P) of each, which is convex and does not depend on units or frames
(T. Lee, P. Wensing, F. Park, IEEE Trans. Robotics 36(2), 2020).

Of a prismatic joint the position is in m, its derivatives likewise, and what the motor exerts is a force in N.

The sample is the last axis of every array, so that an operation is one vector instruction over samples. Equations:
R. Featherstone, Rigid Body Dynamics Algorithms (2008), section 5.3; the regressor: C. Atkeson, C. An and J. Hollerbach,
Int. J. Robotics Research 5(3), 1986.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy import typing as npt

from lite6jax.arms import frames, se3
from lite6jax.arms.arm import Arm
from lite6jax.arms.se3 import Turn, joint_turn
from lite6jax.array_types import Array, Integers
from lite6jax.deferred import ArrayLike, JaxArray, jit, jnp, lax
from lite6jax.errors import InputError
from lite6jax.few_shapes import filled_motion

PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
"""A link's inertial parameters: mass, kg; first moments, kg·m; inertia about the origin of its frame, kg·m²."""

# Of a link, what is kept before what is grouped with it: mz, Iyy and m are then grouped with parameters of the same
# link and of the previous one, as by Gautier and Khalil.
_PREFERENCE = [PARAMETERS.index(name) for name in ("Izz", "Ixx", "Ixy", "Ixz", "Iyz", "mx", "my", "mz", "Iyy", "m")]

INDEPENDENT = 1e-7
"""Of the longest column's norm: what a column must leave after the projection on those before it. A first axis that
is tilted by 1e-6 rad against gravity is noticed, rounding in the sixteenth digit is not."""

_CHUNK = 512
"""Samples at a time: their columns and what these are made of stay in a core's cache."""

_Vector = tuple[JaxArray, JaxArray, JaxArray]
"""Components, each (sample,), (joint, sample) or a number."""


def link_parameters(arm: Arm) -> Array:
    """(joint, 10) `PARAMETERS` of each link, about the origin and in the axes of the frame after its joint's motion.

    Torques are linear in them: the inertia about the origin is that about the centre of mass plus the parallel-axis
    term.

    Raises:
        InputError: the arm has no masses or no inertia tensors.
    """
    if arm.mass is None or arm.center_of_mass is None or arm.inertia is None:
        lacks = "masses" if arm.mass is None else "inertia tensors"
        raise InputError(
            f"arm {arm.name!r}: has no {lacks}, which torques need; give mass_kg, com_m and inertia_kg_m2 of every link"
        )
    about_origin = arm.inertia + frames.point_tensor(arm.mass, arm.center_of_mass)
    first = arm.mass[:, None] * arm.center_of_mass
    return np.hstack([arm.mass[:, None], first, frames.six_entries(about_origin)])


def declared_links(arm: Arm) -> Array:
    """(joint, 10), as `link_parameters`; zero of an arm whose masses are not declared."""
    if arm.mass is None:
        return np.zeros((arm.dof, 10))
    return link_parameters(arm)


class _Motion(NamedTuple):
    """The motion of a link's frame in its own axes; each component (sample,), or (link, sample) of all."""

    spin: _Vector  # angular velocity
    spin_rate: _Vector  # its derivative
    acceleration: _Vector  # of the frame's origin, less gravity


_Carry = tuple[JaxArray, _Vector, _Vector, _Motion]


class _Step(NamedTuple):
    """From the previous link's frame to this one's: a fixed shift and rotation, then the joint's rotation about z.

    Where the chain has prismatic joints, p contains the shift along z, which changes at the rates of `slide`.
    """

    R: JaxArray  # (3, 3)
    p: JaxArray  # (3,), or (3, sample) with prismatic joints
    cos: JaxArray  # (sample,)
    sin: JaxArray
    rate: JaxArray
    rate_change: JaxArray
    slide: tuple[JaxArray, JaxArray, JaxArray] | None = None  # (), whether it is prismatic; (sample,) m/s and m/s²

    def into(self, v: _Vector) -> _Vector:
        """A vector of the previous frame, in the axes of this one."""
        x, y, z = _product(self.R.T, v)
        return self.cos * x + self.sin * y, self.cos * y - self.sin * x, z

    def out_of(self, v: _Vector) -> _Vector:
        """A vector of this frame, in the axes of the previous one."""
        return _product(self.R, (self.cos * v[0] - self.sin * v[1], self.sin * v[0] + self.cos * v[1], v[2]))


def _steps(kinematics: JaxArray, joint: Turn, dq: JaxArray, ddq: JaxArray, sliding: tuple[int, ...]) -> _Step:
    """All steps, joint first. Loops over the joints are compiled as loops, for two reasons: unrolled, XLA would fuse
    every step into each of its uses, compute it anew there, and compile for a minute."""
    R = se3.rotation_from_rpy(kinematics[:, 3:])
    p = kinematics[:, :3]
    cos, sin, shift = joint
    if shift is None:
        return _Step(R, p, cos, sin, dq, ddq)
    slides = np.isin(np.arange(len(dq)), sliding)
    at = p[:, :, None] + R[:, :, 2, None] * shift[:, None]
    (turning, sliding_rate), (change, sliding_change) = (
        tuple(jnp.where(mask[:, None], rate, 0.0) for mask in (~slides, slides)) for rate in (dq, ddq)
    )
    return _Step(R, at, cos, sin, turning, change, (jnp.asarray(slides), sliding_rate, sliding_change))


def _product(M: JaxArray, v: _Vector) -> _Vector:
    x, y, z = (M[k, 0] * v[0] + M[k, 1] * v[1] + M[k, 2] * v[2] for k in range(3))
    return x, y, z


def _cross(a: _Vector | JaxArray, b: _Vector | JaxArray) -> _Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _sum(a: _Vector, b: _Vector) -> _Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _resting(gravity: JaxArray, samples: int) -> _Motion:
    """The base, at rest; gravity is an acceleration the other way."""
    zero = jnp.zeros(samples)
    return _Motion((zero, zero, zero), (zero, zero, zero), (zero - gravity[0], zero - gravity[1], zero - gravity[2]))


def _next(motion: _Motion, step: _Step) -> _Motion:
    """The motion of the link after a step."""
    centripetal = _cross(motion.spin, _cross(motion.spin, step.p))
    at_origin = _sum(motion.acceleration, _sum(_cross(motion.spin_rate, step.p), centripetal))
    x, y, z = step.into(motion.spin)
    ax, ay, az = step.into(motion.spin_rate)
    rate = (ax + y * step.rate, ay - x * step.rate, az + step.rate_change)
    acceleration = step.into(at_origin)
    if step.slide is not None:  # Coriolis' and its own
        _, v, a = step.slide
        acceleration = _sum(acceleration, (2 * y * v, -2 * x * v, a))
    return _Motion((x, y, z + step.rate), rate, acceleration)


def _rotation_rate(motion: _Motion) -> tuple[_Vector, _Vector, _Vector]:
    """The rows of [α]ₓ + [ω]ₓ², which takes a point of the link to its acceleration relative to the origin."""
    x, y, z = motion.spin
    ax, ay, az = motion.spin_rate
    return (
        (-y * y - z * z, x * y - az, x * z + ay),
        (x * y + az, -x * x - z * z, y * z - ax),
        (x * z - ay, y * z + ax, -x * x - y * y),
    )


@partial(jit, static_argnames="sliding")
def regressor(
    kinematics: ArrayLike,
    q: ArrayLike,
    dq: ArrayLike,
    ddq: ArrayLike,
    gravity: ArrayLike,
    sliding: tuple[int, ...] = (),
) -> JaxArray:
    """The matrix that takes all links' inertial parameters to the joints' torques.

    Args:
        kinematics: (joint, 6) x y z roll pitch yaw of each joint's frame in the previous one, m and rad.
        q: (joint, sample) rad; `dq` rad/s and `ddq` rad/s² likewise.
        gravity: (3,) m/s² in the base frame.
        sliding: the prismatic joints, counted from 0.

    Returns:
        (joint, 10 × joint, sample) such that `inverse_dynamics` is its product with the parameters, link after link.
    """
    kinematics = jnp.asarray(kinematics, float)
    gravity = jnp.asarray(gravity, float)
    motion = jnp.stack([jnp.asarray(value, float) for value in (q, dq, ddq)])
    joints, samples = motion.shape[1:]
    size = min(samples, _CHUNK)

    def fill(k: ArrayLike, filled: JaxArray) -> JaxArray:
        start = jnp.minimum(k * size, samples - size)  # the last chunk overlaps the one before
        chunk = lax.dynamic_slice_in_dim(motion, start, size, 2)
        steps = _steps(kinematics, joint_turn(chunk[0], sliding), chunk[1], chunk[2], sliding)
        columns = _columns(*_link_motions(steps, gravity))
        for c, column in enumerate(columns):
            filled = lax.dynamic_update_slice(filled, column[:, :, None], (0, 0, c, start))
        return filled

    filled = lax.fori_loop(0, -(-samples // size), fill, jnp.zeros((joints, joints, 10, samples)))
    return filled.reshape(joints, 10 * joints, samples)


def _link_motions(steps: _Step, gravity: JaxArray) -> tuple[_Vector, _Vector, _Motion]:
    """The motion of each link, (link, sample); of each joint and link the joint's axis, and the velocity of the link's
    origin per unit of the joint's rate: (joint, link, sample), zero for joints that do not move the link."""
    joints, samples = steps.cos.shape
    zero = jnp.zeros((joints, samples))
    nothing: _Vector = (zero, zero, zero)

    def walk(carry: _Carry, step: _Step) -> tuple[_Carry, _Carry]:
        number, axis, velocity, motion = carry
        shifted = step.into(_sum(velocity, _cross(axis, step.p)))
        is_current = (jnp.arange(joints) == number)[:, None]
        x, y, z = step.into(axis)
        if step.slide is None:
            turned = (x, y, jnp.where(is_current, 1.0, z))
        else:
            slides, _, _ = step.slide
            turned = (x, y, jnp.where(is_current & ~slides, 1.0, z))
            shifted = (*shifted[:2], jnp.where(is_current & slides, 1.0, shifted[2]))
        carry = (number + 1, turned, shifted, _next(motion, step))
        return carry, carry

    start = (jnp.zeros((), int), nothing, nothing, _resting(gravity, samples))
    _, axis, velocity, motion = lax.scan(walk, start, steps)[1]
    return _joint_first(axis), _joint_first(velocity), motion


def _joint_first(v: _Vector) -> _Vector:
    return jnp.swapaxes(v[0], 0, 1), jnp.swapaxes(v[1], 0, 1), jnp.swapaxes(v[2], 0, 1)


def _columns(axis: _Vector, velocity: _Vector, motion: _Motion) -> list[JaxArray]:
    """Ten (joint, link, sample) torques about the joints' axes, one per unit of each of a link's parameters.

    By virtual work: the link's inertial force times the velocity of its origin, plus its moment times the axis.
    """
    D = _rotation_rate(motion)
    a = motion.acceleration
    w = motion.spin
    dw = motion.spin_rate
    turned = _cross(a, axis)
    u = _cross(axis, w)
    mass = velocity[0] * a[0] + velocity[1] * a[1] + velocity[2] * a[2]
    first = [velocity[0] * D[0][k] + velocity[1] * D[1][k] + velocity[2] * D[2][k] + turned[k] for k in range(3)]
    moments = [axis[k] * dw[k] + u[k] * w[k] for k in range(3)]
    products = [axis[k] * dw[m] + axis[m] * dw[k] + u[k] * w[m] + u[m] * w[k] for k, m in ((0, 1), (0, 2), (1, 2))]
    return [mass, *first, *moments, *products]


@partial(jit, static_argnames="sliding")
def inverse_dynamics(
    kinematics: ArrayLike,
    parameters: ArrayLike,
    q: ArrayLike,
    dq: ArrayLike,
    ddq: ArrayLike,
    gravity: ArrayLike,
    sliding: tuple[int, ...] = (),
) -> JaxArray:
    """The torques that the motors exert about +z of the joints, without friction, rotor inertia or payload.

    A motor that holds a load up exerts the negative of gravity's torque.

    Args:
        kinematics: `(joint, 6)` m and rad, the six-parameter chain.
        parameters: `(joint, 10)` `PARAMETERS` of each link, as `link_parameters` gives them.
        q: `(joint, sample)` rad.
        dq: `(joint, sample)` rad/s.
        ddq: `(joint, sample)` rad/s².
        gravity: `(3,)` m/s² in the base frame, such as (0, 0, -9.81).
        sliding: the prismatic joints, counted from 0.

    Returns:
        `(joint, sample)` N·m, and N along +z of prismatic joints.
    """
    kinematics, q, dq, ddq, gravity = (jnp.asarray(value, float) for value in (kinematics, q, dq, ddq, gravity))
    steps = _steps(kinematics, joint_turn(q, sliding), dq, ddq, sliding)

    def outwards(motion: _Motion, step: _Step) -> tuple[_Motion, _Motion]:
        motion = _next(motion, step)
        return motion, motion

    def inwards(load: tuple[_Vector, _Vector], link: tuple[_Step, _Motion, JaxArray]) -> tuple[Any, JaxArray]:
        (force, moment), (step, motion, (m, hx, hy, hz, xx, yy, zz, xy, xz, yz)) = load, link
        first = (hx, hy, hz)
        a = motion.acceleration
        M = jnp.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        x, y, z = (row[0] * hx + row[1] * hy + row[2] * hz for row in _rotation_rate(motion))
        force = _sum(force, (m * a[0] + x, m * a[1] + y, m * a[2] + z))
        momentum_rate = _sum(_product(M, motion.spin_rate), _cross(motion.spin, _product(M, motion.spin)))
        moment = _sum(moment, _sum(momentum_rate, _cross(first, a)))
        before = step.out_of(force)
        effort = moment[2] if step.slide is None else jnp.where(step.slide[0], force[2], moment[2])
        return (before, _sum(step.out_of(moment), _cross(step.p, before))), effort

    resting = _resting(gravity, q.shape[1])
    motions = lax.scan(outwards, resting, steps)[1]
    links = (steps, motions, jnp.asarray(parameters, float))
    return lax.scan(inwards, (resting.spin, resting.spin), links, reverse=True)[1]


def recorded_torques(
    kinematics: npt.ArrayLike,
    parameters: npt.ArrayLike,
    motion: Iterable[npt.ArrayLike],
    gravity: npt.ArrayLike,
    sliding: tuple[int, ...] = (),
) -> Array:
    """`inverse_dynamics` of a motion, three `(joint, sample)`, in NumPy: compiled for few numbers of samples."""
    filled, samples = filled_motion(motion)
    return np.asarray(inverse_dynamics(kinematics, parameters, *filled, gravity, sliding))[..., :samples]


def recorded_regressor(
    kinematics: npt.ArrayLike, motion: Iterable[npt.ArrayLike], gravity: npt.ArrayLike, sliding: tuple[int, ...] = ()
) -> Array:
    """`regressor` of a motion, as of `recorded_torques`."""
    filled, samples = filled_motion(motion)
    return np.ascontiguousarray(np.asarray(regressor(kinematics, *filled, gravity, sliding))[..., :samples])


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """The identifiable combinations of the inertial parameters of all links.

    With β = `grouping` x, x being `link_parameters(arm).ravel()`, torques are `regressor[:, independent] β`.

    Attributes:
        independent: (base,) the places in x of one parameter of each combination, in ascending order.
        grouping: (base, 10 × joint) the coefficients; 1 at the combination's own parameter, 0 at those of others.
        basis: (10 × joint, base) an orthonormal basis of the identifiable directions: the rows of `grouping` span it.
    """

    independent: Integers
    grouping: Array
    basis: Array

    @property
    def size(self) -> int:
        """The number of base parameters: 36 for six joints in general, 43 for seven."""
        return len(self.independent)

    def values(self, parameters: npt.ArrayLike) -> Array:
        """(base,) the combinations' values for links' parameters (joint, 10)."""
        return self.grouping @ np.asarray(parameters, float).ravel()


def base_parameters(kinematics: npt.ArrayLike, gravity: npt.ArrayLike, sliding: tuple[int, ...] = ()) -> BaseParameters:
    """The base parameters of a chain, by the regressor of random motion.

    The columns that are independent of those before them, links from the base outwards, follow from a QR decomposition;
    every other column is a combination of them (M. Gautier, J. Robotic Systems 8(4), 1991). A chain measured rather
    than designed has more of them where its first axis is not quite along gravity.

    Args:
        kinematics: (joint, 6) x y z roll pitch yaw of each joint's frame in the previous one, m and rad.
        gravity: (3,) m/s² in the base frame; it decides what the first joints' links show at rest.
        sliding: the prismatic joints, counted from 0.
    """
    kinematics = np.asarray(kinematics, float)
    joints = len(kinematics)
    rng = np.random.default_rng(0)
    samples = 16 * joints + 32
    q = rng.uniform(-np.pi, np.pi, (joints, samples))
    dq, ddq = 2 * rng.standard_normal((2, joints, samples))
    W = np.asarray(regressor(kinematics, q, dq, ddq, np.asarray(gravity, float), sliding))
    W = np.moveaxis(W, 2, 0).reshape(-1, 10 * joints)

    order = (10 * np.arange(joints)[:, None] + _PREFERENCE).ravel()
    independent = np.sort(order[_independent(W[:, order])])
    grouping = np.linalg.lstsq(W[:, independent], W, rcond=None)[0]
    grouping[np.abs(grouping) < 1e-9] = 0.0  # rounding, in kg m^±2 of an arm of metres
    grouping[:, independent] = np.eye(len(independent))
    basis, _ = np.linalg.qr(grouping.T)
    return BaseParameters(independent, grouping, basis)


def _independent(W: Array) -> Integers:
    """The places of the columns that are no combination of those before them (Gram–Schmidt, twice).

    A QR decomposition without pivots would take the rounding of a dependent column for a direction.
    """
    independent: list[int] = []
    Q = np.zeros((len(W), 0))
    threshold = INDEPENDENT * np.linalg.norm(W, axis=0).max()
    for k, column in enumerate(W.T):
        remainder = column - Q @ (Q.T @ column)
        remainder -= Q @ (Q.T @ remainder)
        if np.linalg.norm(remainder) > threshold:
            independent.append(k)
            Q = np.column_stack([Q, remainder / np.linalg.norm(remainder)])
    return np.array(independent, int)


_THIN = 1e-6
"""Of the largest: what the eigenvalues of a reference link's pseudo-inertia have at least, a point mass included."""
_NEAR = 1e-4
"""Weight of the divergence beside the chi-square of the change where no links have the base parameters exactly: small,
so that the chi-square is nearly the smallest possible; not zero, which flat or infinitely heavy bodies would reach."""
_STEPS = 200


def consistent_links(base: BaseParameters, values: npt.ArrayLike, reference: npt.ArrayLike) -> tuple[Array, bool]:
    """The links (joint, 10) that are bodies, have the given base parameters and are nearest to reference links.

    Where no bodies have these base parameters, those of the links are as near to them as positivity allows, relative to
    what the reference links make of each combination.

    Args:
        base: of the arm's chain.
        values: (base,) the base parameters.
        reference: (joint, 10) inertial parameters of links that are bodies, such as `bodies_near` gives.

    Returns:
        the links, and whether they have the base parameters that were asked for, to rounding.

    Raises:
        InputError: reference links that are no bodies.
    """
    values = np.asarray(values, float)
    reference = np.asarray(reference, float)
    if not is_consistent(reference):
        raise InputError("the reference links are no bodies; give such as bodies_near gives")
    # in coordinates in which every reference link's pseudo-inertia is the identity
    roots = np.linalg.cholesky(pseudo_inertia(reference))
    to_parameters = _block_diagonal(np.stack([_parameters_of(root @ _SYMMETRIC @ root.T).T for root in roots]))
    G = base.grouping @ to_parameters
    Q, R = np.linalg.qr(G.T)
    C = Q.T
    d = np.linalg.solve(R.T, values)
    start = np.tile(_coordinates(np.eye(4)), len(reference))
    y = _constrained(start, C, d)
    exact = True
    if y is None:
        whitened = np.linalg.inv(np.linalg.cholesky(G @ G.T))
        nearest = _penalised(start, whitened @ G, whitened @ values)
        y = _constrained(nearest, C, d)
        y, exact = (nearest, False) if y is None else (y, True)
    return (to_parameters @ y).reshape(-1, 10), exact


def bodies_near(parameters: npt.ArrayLike) -> Array:
    """(joint, 10) links whose pseudo-inertias are those of `parameters` (joint, 10), made positive."""
    P = pseudo_inertia(parameters)
    scale, vectors = np.linalg.eigh(P)
    floor = np.where(scale[:, -1:] > 0, _THIN * scale[:, -1:], _THIN)
    return _parameters_of((vectors * np.maximum(scale, floor)[:, None, :]) @ np.swapaxes(vectors, 1, 2))


def set_link_parameters(arm: Arm, parameters: npt.ArrayLike) -> Arm:
    """The arm with the masses, centres of mass and inertia tensors of links (joint, 10), which must be bodies."""
    parameters = np.asarray(parameters, float)
    if parameters.shape != (arm.dof, 10) or not is_consistent(parameters):
        raise InputError(f"arm {arm.name!r}: these links are no bodies; take such as consistent_links gives")
    mass = parameters[:, 0]
    center = parameters[:, 1:4] / parameters[:, :1]
    about_center = frames.tensor(parameters[:, 4:]) - frames.point_tensor(mass, center)
    return replace(arm, mass=mass, center_of_mass=center, inertia=about_center)


def pseudo_inertia(parameters: npt.ArrayLike) -> Array:
    """(joint, 4, 4) second moments of the mass of links (joint, 10): ∫ρ (x, y, z, 1)(x, y, z, 1)ᵀ dV."""
    parameters = np.asarray(parameters, float)
    tensor = frames.tensor(parameters[:, 4:])
    P = np.empty((len(parameters), 4, 4))
    P[:, :3, :3] = 0.5 * np.trace(tensor, axis1=1, axis2=2)[:, None, None] * np.eye(3) - tensor
    P[:, :3, 3] = P[:, 3, :3] = parameters[:, 1:4]
    P[:, 3, 3] = parameters[:, 0]
    return P


def is_consistent(parameters: npt.ArrayLike) -> bool:
    """Tells whether every link (joint, 10) is a body: its pseudo-inertia is positive definite."""
    return _positive(pseudo_inertia(parameters))


def _positive(P: Array) -> bool:
    try:
        np.linalg.cholesky(P)
    except np.linalg.LinAlgError:
        return False
    return bool(np.isfinite(P).all())


def _parameters_of(P: Array) -> Array:
    """(..., 10) inertial parameters of pseudo-inertias (..., 4, 4)."""
    second = P[..., :3, :3]
    tensor = np.trace(second, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - second
    return np.concatenate([P[..., 3:, 3], P[..., :3, 3], frames.six_entries(tensor)], -1)


_I, _J = np.triu_indices(4)
_SYMMETRIC = np.zeros((10, 4, 4))
"""(10, 4, 4) an orthonormal basis of the symmetric matrices."""
_SYMMETRIC[range(10), _I, _J] = _SYMMETRIC[range(10), _J, _I] = np.where(_I == _J, 1.0, np.sqrt(0.5))


def _coordinates(Q: Array) -> Array:
    return np.einsum("kab,...ab->...k", _SYMMETRIC, Q)


def _matrices(y: Array) -> Array:
    return np.einsum("jk,kab->jab", y.reshape(-1, 10), _SYMMETRIC)


def _block_diagonal(blocks: Array) -> Array:
    """(10 × joint, 10 × joint) of the blocks (joint, 10, 10)."""
    out = np.zeros((len(blocks), 10, len(blocks), 10))
    diagonal = np.arange(len(blocks))
    out[diagonal, :, diagonal] = blocks
    return out.reshape(10 * len(blocks), -1)


def _divergence(y: Array) -> tuple[float, Array, Array]:
    """Σ tr Q − log det Q with its gradient and Hessian."""
    Q = _matrices(y)
    inverse = np.linalg.inv(Q)
    value = np.trace(Q, axis1=1, axis2=2).sum() - np.linalg.slogdet(Q)[1].sum()
    gradient = _coordinates(np.eye(4) - inverse).ravel()
    Hessian = _block_diagonal(np.stack([_coordinates(q @ _SYMMETRIC @ q) for q in inverse]))
    return float(value), gradient, Hessian


def _constrained(y: Array, C: Array, d: Array) -> Array | None:
    """The y of least divergence with C y = d, C of orthonormal rows; None where there seems to be none.

    Newton's method from a start that need not satisfy the constraint (S. Boyd, L. Vandenberghe, Convex Optimization,
    2004, section 10.3).
    """
    multiplier = np.zeros(len(d))

    def residual(y: Array, multiplier: Array) -> Array:
        return np.concatenate([_divergence(y)[1] + C.T @ multiplier, C @ y - d])

    for _ in range(_STEPS):
        gradient, Hessian = _divergence(y)[1:]
        system = np.block([[Hessian, C.T], [C, np.zeros((len(d), len(d)))]])
        solved = np.linalg.solve(system, np.concatenate([-gradient, d - C @ y]))
        step = solved[: len(y)]
        turn = solved[len(y) :] - multiplier
        before = np.linalg.norm(residual(y, multiplier))
        length = 1.0
        while length > 1e-8:
            if _positive(_matrices(y + length * step)):
                after = np.linalg.norm(residual(y + length * step, multiplier + length * turn))
                if after <= (1 - 0.01 * length) * before or after < 1e-11 * (1 + np.linalg.norm(d)):
                    break
            length *= 0.5
        else:
            break
        y = y + length * step
        multiplier = multiplier + length * turn
        if length == 1.0 and np.linalg.norm(step) < 1e-9 * np.linalg.norm(y):
            break
    if np.linalg.norm(C @ y - d) <= 1e-12 * (1 + np.linalg.norm(d)):
        return y
    return None


def _penalised(y: Array, A: Array, b: Array) -> Array:
    """The y of least ½|A y − b|² + weight × divergence, for weights that fall to `_NEAR` / 2."""
    for weight in 10.0 ** np.arange(6, np.log10(_NEAR / 2) - 0.5, -1):
        for _ in range(_STEPS):
            value, gradient, Hessian = _divergence(y)
            slope = A.T @ (A @ y - b) + weight * gradient
            objective = 0.5 * np.sum((A @ y - b) ** 2) + weight * value
            step = np.linalg.solve(A.T @ A + weight * Hessian, -slope)
            fall = -slope @ step
            length = 1.0
            while length > 1e-10:
                candidate = y + length * step
                if _positive(_matrices(candidate)):
                    cost = 0.5 * np.sum((A @ candidate - b) ** 2) + weight * _divergence(candidate)[0]
                    if cost <= objective - 0.01 * length * fall:
                        y = candidate
                        break
                length *= 0.5
            if length <= 1e-10 or fall < 1e-6 * weight:
                break
    return y
