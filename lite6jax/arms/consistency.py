"""Physical consistency: the links that real bodies can be and that have given base parameters.

A link's ten inertial parameters are a body's where its pseudo-inertia, the second moments of its mass in homogeneous
coordinates, is positive definite (P. Wensing, S. Kim, J.-J. Slotine, IEEE Robotics and Automation Letters 3(1), 2018).
Torques leave many directions of the parameters open; there the links stay as near as possible to reference links, by
the divergence tr(P₀⁻¹P) − log det(P₀⁻¹P) of each, which is convex and does not depend on units or frames (T. Lee,
P. Wensing, F. Park, IEEE Trans. Robotics 36(2), 2020).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

from lite6jax.arms import inertia
from lite6jax.arms.arm import Arm
from lite6jax.arms.dynamics import BaseParameters
from lite6jax.errors import InputError

Array = NDArray[np.floating]

THIN = 1e-6
"""Of the largest: what the eigenvalues of a reference link's pseudo-inertia have at least, a point mass included."""
NEAR = 1e-4
"""Weight of the divergence beside the chi-square of the change where no links have the base parameters exactly: small,
so that the chi-square is nearly the smallest possible; not zero, which flat or infinitely heavy bodies would reach."""
_STEPS = 200


@dataclass(frozen=True, eq=False)
class ConsistentLinks:
    """Links that real bodies can be.

    Attributes:
        parameters: (joint, 10) `dynamics.PARAMETERS` of each link.
        exact: whether they have the base parameters that were asked for, to rounding; otherwise no bodies have.
        change: (base,) by how much their base parameters differ from those.
        chi_square: of that change, by the base parameters' covariance; 0 where exact.
    """

    parameters: Array
    exact: bool
    change: Array
    chi_square: float


def consistent_links(
    base: BaseParameters, values: ArrayLike, reference: ArrayLike, covariance: ArrayLike | None = None
) -> ConsistentLinks:
    """The physically consistent links that have the given base parameters and are nearest to reference links.

    Where no bodies have these base parameters, those of the links are as near to them as positivity allows.

    Args:
        base: of the arm's chain.
        values: (base,) the base parameters.
        reference: (joint, 10) inertial parameters of links that are bodies, such as `bodies_near` gives.
        covariance: (base, base) of `values`, positive definite; None for one in which every combination is determined
            equally well, relative to what the reference links make of it.

    Raises:
        InputError: a shape that does not fit, or reference links that are no bodies.
    """
    values, reference = np.asarray(values, float), np.asarray(reference, float)
    joints = base.grouping.shape[1] // 10
    if values.shape != (base.size,) or reference.shape != (joints, 10):
        raise InputError(
            f"base parameters {values.shape} and reference links {reference.shape} do not fit a chain of {joints} links"
            f" with {base.size} base parameters; give ({base.size},) and ({joints}, 10)"
        )
    if not is_consistent(reference):
        raise InputError("the reference links are no bodies; give such as bodies_near gives")
    # in coordinates in which every reference link's pseudo-inertia is the identity
    roots = np.linalg.cholesky(pseudo_inertia(reference))
    to_parameters: Array = _block_diagonal([_parameters_of(root @ _SYMMETRIC @ root.T).T for root in roots])
    G: Array = np.asarray(base.grouping @ to_parameters)
    if covariance is None:
        whitened = np.linalg.inv(np.linalg.cholesky(G @ G.T))
    else:
        covariance = np.asarray(covariance, float)
        if covariance.shape != (base.size, base.size):
            raise InputError(f"the covariance has the shape {covariance.shape}; it must be {(base.size, base.size)}")
        whitened = np.linalg.inv(np.linalg.cholesky(covariance))
    Q, R = np.linalg.qr(G.T)
    C, d = Q.T, np.linalg.solve(R.T, values)

    start = np.tile(_coordinates(np.eye(4)), joints)
    y = _constrained(start, C, d)
    if y is None:
        nearest = _penalised(start, whitened @ G, whitened @ values)
        y = _constrained(nearest, C, d)
        y, exact = (nearest, False) if y is None else (y, True)
    else:
        exact = True
    parameters = (to_parameters @ y).reshape(joints, 10)
    change = base.values(parameters) - values
    chi_square = 0.0 if exact else float(np.sum((whitened @ change) ** 2))
    return ConsistentLinks(parameters, exact, change, chi_square)


def bodies_near(parameters: ArrayLike) -> Array:
    """(joint, 10) links whose pseudo-inertias are those of `parameters` (joint, 10), made positive."""
    P = pseudo_inertia(parameters)
    scale, vectors = np.linalg.eigh(P)
    least = np.where(scale[:, -1:] > 0, THIN * scale[:, -1:], THIN)
    return _parameters_of((vectors * np.maximum(scale, least)[:, None, :]) @ np.swapaxes(vectors, 1, 2))


def with_link_parameters(arm: Arm, parameters: ArrayLike) -> Arm:
    """The arm with the masses, centres of mass and inertia tensors of these links, (joint, 10).

    Raises:
        InputError: links that are no bodies.
    """
    parameters = np.asarray(parameters, float)
    if parameters.shape != (arm.dof, 10) or not is_consistent(parameters):
        raise InputError(f"arm {arm.name!r}: these links are no bodies; take such as consistent_links gives")
    mass, center = parameters[:, 0], parameters[:, 1:4] / parameters[:, :1]
    about_center = inertia.tensor(parameters[:, 4:]) - inertia.point_tensor(mass, center)
    return replace(arm, mass=mass, center_of_mass=center, inertia=about_center)


def pseudo_inertia(parameters: ArrayLike) -> Array:
    """(joint, 4, 4) second moments of the mass of links (joint, 10): ∫ρ (x, y, z, 1)(x, y, z, 1)ᵀ dV."""
    parameters = np.asarray(parameters, float)
    tensor = inertia.tensor(parameters[:, 4:])
    P = np.empty((len(parameters), 4, 4))
    P[:, :3, :3] = 0.5 * np.trace(tensor, axis1=1, axis2=2)[:, None, None] * np.eye(3) - tensor
    P[:, :3, 3] = P[:, 3, :3] = parameters[:, 1:4]
    P[:, 3, 3] = parameters[:, 0]
    return P


def is_consistent(parameters: ArrayLike) -> bool:
    """Whether every link (joint, 10) is a body: its pseudo-inertia is positive definite."""
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
    return np.concatenate([P[..., 3:, 3], P[..., :3, 3], inertia.six_entries(tensor)], -1)


_PAIRS = np.triu_indices(4)


def _symmetric_basis() -> Array:
    basis = np.zeros((10, 4, 4))
    for k, (i, j) in enumerate(zip(*_PAIRS, strict=True)):
        basis[k, i, j] = basis[k, j, i] = 1.0 if i == j else np.sqrt(0.5)
    return basis


_SYMMETRIC = _symmetric_basis()
"""(10, 4, 4) an orthonormal basis of the symmetric matrices."""


def _coordinates(Q: Array) -> Array:
    return np.einsum("kab,...ab->...k", _SYMMETRIC, Q)


def _matrices(y: Array) -> Array:
    return np.einsum("jk,kab->jab", y.reshape(-1, 10), _SYMMETRIC)


def _block_diagonal(blocks: list[Array]) -> Array:
    return np.asarray(block_diag(*blocks))


def _divergence(y: Array) -> tuple[float, Array, Array]:
    """Σ tr Q − log det Q with its gradient and Hessian."""
    Q = _matrices(y)
    inverse = np.linalg.inv(Q)
    value = np.trace(Q, axis1=1, axis2=2).sum() - np.linalg.slogdet(Q)[1].sum()
    gradient = _coordinates(np.eye(4) - inverse).ravel()
    Hessian = _block_diagonal([_coordinates(q @ _SYMMETRIC @ q) for q in inverse])
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
        step, turn = solved[: len(y)], solved[len(y) :] - multiplier
        before, length = np.linalg.norm(residual(y, multiplier)), 1.0
        while length > 1e-8:
            if _positive(_matrices(y + length * step)):
                after = np.linalg.norm(residual(y + length * step, multiplier + length * turn))
                if after <= (1 - 0.01 * length) * before or after < 1e-11 * (1 + np.linalg.norm(d)):
                    break
            length *= 0.5
        else:
            break
        y, multiplier = y + length * step, multiplier + length * turn
        if length == 1.0 and np.linalg.norm(step) < 1e-9 * np.linalg.norm(y):
            break
    return y if np.linalg.norm(C @ y - d) <= 1e-12 * (1 + np.linalg.norm(d)) else None


def _penalised(y: Array, A: Array, b: Array) -> Array:
    """The y of least ½|A y − b|² + weight × divergence, for weights that fall to `NEAR` / 2."""
    for weight in 10.0 ** np.arange(6, np.log10(NEAR / 2) - 0.5, -1):
        for _ in range(_STEPS):
            value, gradient, Hessian = _divergence(y)
            slope, left = A.T @ (A @ y - b) + weight * gradient, 0.5 * np.sum((A @ y - b) ** 2) + weight * value
            step = np.linalg.solve(A.T @ A + weight * Hessian, -slope)
            fall, length = -slope @ step, 1.0
            while length > 1e-10:
                trial = y + length * step
                if _positive(_matrices(trial)):
                    cost = 0.5 * np.sum((A @ trial - b) ** 2) + weight * _divergence(trial)[0]
                    if cost <= left - 0.01 * length * fall:
                        y = trial
                        break
                length *= 0.5
            if length <= 1e-10 or fall < 1e-6 * weight:
                break
    return y
