"""Other ways to fit the same arm to the same whitened residual, each in a few lines of our own code.

A rival takes one arm's joint positions `(sample, 6)` and measured poses `(sample, 4, 4)` and returns the seed's 28
parameters, from the nominal ones. SciPy runs MINPACK's Levenberg–Marquardt, its fastest method here, but for the seed's
way, which takes the default as the seed does.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
import pinocchio
from jax import Array
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks import seed_way
from benchmarks.problem import SCALE
from benchmarks.seed_way import D2, NOMINAL
from lite6jax.arms.chains import HayatiForm
from lite6jax.arms.se3 import rotation_log
from lite6jax.fitting.residual import Observations, observe, residuals
from lite6jax.model import ModelForm, arm_model
from tests.oracles.chains import hayati_links, seed_model, seed_poses

TOLERANCE = 1e-12
"""Of step and cost, relative: tight enough to agree to 1e-9, loose enough that no rival runs in place."""
pin: Any = pinocchio  # a compiled module, which a type checker cannot look into

Solve = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Rival(NamedTuple):
    """A way to fit.

    Attributes:
        name: for the table.
        solve: one arm's parameters.
        arms: of a fleet, how many it is given; the slower, the fewer.
        compiles: whether its first call is to be kept out of the timing.
    """

    name: str
    solve: Solve
    arms: int
    compiles: bool = False


def minimise(function: Callable[[np.ndarray], np.ndarray], jacobian: Any = "2-point") -> np.ndarray:
    """SciPy from the nominal parameters."""
    return least_squares(
        function, NOMINAL, jac=jacobian, method="lm", x_scale="jac", xtol=TOLERANCE, ftol=TOLERANCE, gtol=TOLERANCE
    ).x


def whitened(predicted: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Residuals `(6 × sample,)` of poses `(sample, 4, 4)`."""
    relative = np.swapaxes(measured[:, :3, :3], 1, 2) @ predicted[:, :3, :3]
    spin = Rotation.from_matrix(relative).as_rotvec()
    return np.concatenate([SCALE[0] * (predicted[:, :3, 3] - measured[:, :3, 3]), SCALE[1] * spin], 1).ravel()


def python_loop(joint_position: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """The seed's way."""
    return seed_way.fit(joint_position, pose, SCALE, TOLERANCE)


def vectorised_numpy(joint_position: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """SciPy with finite differences over NumPy arrays of all samples."""
    return minimise(lambda x: whitened(seed_poses(x, joint_position), pose))


def pinocchio_chain(joint_position: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """SciPy with finite differences over Pinocchio's forward kinematics, whose placements are the parameters."""
    model = pin.Model()
    for i in range(6):
        model.addJoint(i, pin.JointModelRZ(), pin.SE3.Identity(), f"joint{i + 1}")
    data = model.createData()
    predicted = np.empty_like(pose)

    def function(x: np.ndarray) -> np.ndarray:
        base, links = hayati_links(*seed_model(x))
        for i, fixed in enumerate([base, *links[:-1]]):
            model.jointPlacements[i + 1] = pin.SE3(fixed)
        for k, q in enumerate(joint_position):
            pin.forwardKinematics(model, data, q)
            predicted[k] = data.oMi[6].homogeneous
        return whitened(predicted @ links[-1], pose)

    return minimise(function)


FORM = ModelForm(HayatiForm(6, (1,)))


@jax.jit
def _residuals(parameters: Array, observed: Observations) -> Array:
    return residuals(FORM, arm_model(parameters), observed).reshape(-1)


_jacobian = jax.jit(jax.jacfwd(_residuals))


def jax_jacobian(joint_position: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """SciPy with the forward-mode Jacobian of the library's residual."""
    weight = jnp.ones(len(pose))
    blocks = observe(FORM, jnp.asarray(joint_position), jnp.asarray(pose), weight, jnp.array(SCALE), len(pose))
    observed = jax.tree.map(lambda leaf: leaf[0], blocks)
    return minimise(lambda x: np.asarray(_residuals(x, observed)), lambda x: np.asarray(_jacobian(x, observed)))


def naive_pose(parameters: Array, q: Array) -> Array:
    """(4, 4) flange pose, a product of matrices as one would first write it in JAX."""

    def turn(axis: int, angle: Array) -> Array:
        i, j = ((1, 2), (2, 0), (0, 1))[axis]
        c, s = jnp.cos(angle), jnp.sin(angle)
        return jnp.eye(4).at[i, i].set(c).at[j, j].set(c).at[j, i].set(s).at[i, j].set(-s)

    def move(x: Array | float, y: Array | float, z: Array | float) -> Array:
        return jnp.eye(4).at[:3, 3].set(jnp.stack([jnp.asarray(v, float) for v in (x, y, z)]))

    T = move(parameters[0], parameters[1], 0.0) @ turn(1, parameters[3]) @ turn(0, parameters[2])
    table = jnp.insert(parameters[4:27], D2, 0.0).reshape(6, 4)
    for i in range(6):
        theta, d, a, alpha = table[i]
        T = T @ turn(2, q[i] + theta) @ move(a, 0.0, d) @ turn(0, alpha)
        if i == 1:
            T = T @ turn(1, parameters[27])
    return T


def _naive_residuals(parameters: Array, data: tuple[Array, Array]) -> Array:
    joint_position, pose = data
    predicted = jax.vmap(partial(naive_pose, parameters))(joint_position)
    relative = jnp.swapaxes(pose[:, :3, :3], 1, 2) @ predicted[:, :3, :3]
    shift = predicted[:, :3, 3] - pose[:, :3, 3]
    return jnp.concatenate([SCALE[0] * shift, SCALE[1] * rotation_log(relative)], 1)


def _optimistix(joint_position: Array, pose: Array) -> Array:
    # its default, a QR of all residuals, takes twice as long for one arm, and under vmap eight times
    linear = lx.Normal(lx.Cholesky())
    solver = optx.LevenbergMarquardt(rtol=TOLERANCE, atol=TOLERANCE, linear_solver=linear)
    data, options = (joint_position, pose), {"jac": "fwd"}
    return optx.least_squares(_naive_residuals, solver, jnp.asarray(NOMINAL), data, options=options, throw=False).value


_optimistix_one = jax.jit(_optimistix)
_optimistix_many = jax.jit(jax.vmap(_optimistix))


def plain_optimistix(joint_position: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """optimistix' Levenberg–Marquardt over the naive chain."""
    return np.asarray(_optimistix_one(joint_position, pose))


def plain_optimistix_fleet(joint_position: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """The same, `vmap`ped over the arms: `(arm, 28)`."""
    return np.asarray(_optimistix_many(joint_position, pose))


SEED = Rival("seed's way", python_loop, 1)
VECTORISED = Rival("SciPy, vectorised NumPy", vectorised_numpy, 2)
PINOCCHIO = Rival("SciPy, Pinocchio chain", pinocchio_chain, 1)
JACOBIAN = Rival("SciPy, JAX Jacobian", jax_jacobian, 4, compiles=True)
OPTIMISTIX = Rival("plain optimistix", plain_optimistix, 1, compiles=True)
RIVALS = (SEED, VECTORISED, PINOCCHIO, JACOBIAN, OPTIMISTIX)
