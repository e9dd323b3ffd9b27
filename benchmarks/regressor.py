"""The regressor of inverse dynamics of a 6R arm over many samples, against Pinocchio's, called sample by sample."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import numpy as np
import pinocchio

from benchmarks.measure import Record, disagreement, median_time
from lite6jax.arms import dynamics
from lite6jax.arms.description import load_bundled
from tests.oracles.pinocchio_dynamics import pinocchio_model, pinocchio_regressor

pin: Any = pinocchio  # a compiled module, which a type checker cannot look into
GRAVITY = np.array([0.0, 0.0, -9.81])
WITHIN = 1e-10
"""N·m per unit of a parameter."""


def regressor(samples: int = 100_000, repeats: int = 5) -> Iterator[Record]:
    """Median seconds of each, in one process, and their ratio; the loop also stores what it computes."""
    arm = load_bundled("lite6")
    rng = np.random.default_rng(6)
    lower, upper = arm.joint_limits.T[:, :, None]
    q = rng.uniform(lower, upper, (arm.dof, samples))
    dq, ddq = rng.normal(0, 1, (2, arm.dof, samples))
    ours = partial(dynamics.regressor, arm.kinematics, q, dq, ddq, GRAVITY)
    model = pinocchio_model(arm.kinematics, arm.mass, arm.center_of_mass, arm.inertia, GRAVITY)
    theirs = partial(pinocchio_loop, model, q, dq, ddq)

    first, matrix = median_time(lambda: jax.block_until_ready(ours()), 1)
    checked = min(samples, 1000)
    reference = pinocchio_regressor(model, *(part[:, :checked] for part in (q, dq, ddq)))
    wrong = disagreement(np.asarray(matrix[:, :, :checked]), reference, WITHIN, "the regressor")
    work = f"regressor, {samples} samples"
    seconds, _ = median_time(lambda: jax.block_until_ready(ours()), repeats)
    loop, _ = median_time(theirs, max(1, repeats // 2))
    yield Record(work, "lite6jax", "first call, with compilation", first, "s", "lower", wrong)
    yield Record(work, "lite6jax", "wall time", seconds, "s", "lower", wrong)
    yield Record(work, "Pinocchio, a loop", "wall time", loop, "s", "lower")
    yield Record(work, "lite6jax", "of Pinocchio's loop", seconds / loop, "×", "lower", wrong)


def pinocchio_loop(model: Any, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    """(sample, joint, 10 × joint) as Pinocchio has them."""
    data, joints, samples = model.createData(), *q.shape
    rows = [np.ascontiguousarray(part.T) for part in (q, dq, ddq)]
    stored = np.empty((samples, joints, 10 * joints))
    for k in range(samples):
        stored[k] = pin.computeJointTorqueRegressor(model, data, rows[0][k], rows[1][k], rows[2][k])
    return stored
