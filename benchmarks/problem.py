"""Simulated Lite 6 arms of the seed's tolerance and what a noisy sensor reads of them, in plain vectorised NumPy.

Nothing of the library is used but the bundled arm's nominal numbers: the chain is the tests' oracle, `tests.oracles`.
"""

from typing import NamedTuple

import numpy as np

from benchmarks.seed_way import sample_joints
from lite6jax.arms.description import load_bundled
from tests.oracles.arms import ASSEMBLY
from tests.oracles.chains import seed_poses, six_parameter_poses
from tests.oracles.transforms import perturb_poses

NOISE = (20e-6, 0.1e-3)
"""One standard deviation of a measured position (m) and orientation (rad), per axis."""
SCALE = (1 / NOISE[0], 1 / NOISE[1])
BLOCK = 50_000


class Measured(NamedTuple):
    """Simulated measurements."""

    kinematics: np.ndarray  # the true `(arm, 6, 6)`
    joint_position: np.ndarray  # `(arm, sample, 6)` rad
    pose: np.ndarray  # what the sensor reads, `(arm, sample, 4, 4)`


def simulated_arms(arms: int, seed: int) -> np.ndarray:
    """True six-parameter chains `(arm, 6, 6)`, each number normal about the Lite 6's with the seed's size as its sd."""
    spread = ASSEMBLY * np.random.default_rng(seed).standard_normal((arms, 6, 6))
    return load_bundled("lite6").kinematics + spread


def measured(arms: int, samples: int, seed: int) -> Measured:
    """Arms that each take their own joint positions, and their noisy poses."""
    rng = np.random.default_rng((seed, 1))
    kinematics = simulated_arms(arms, seed)
    joint_position = sample_joints(arms * samples, rng).reshape(arms, samples, 6)
    pose = np.empty((arms, samples, 4, 4))
    for arm in range(arms):
        for first in range(0, samples, BLOCK):
            part = slice(first, first + BLOCK)
            pose[arm, part] = perturb_poses(
                rng, six_parameter_poses(kinematics[arm], joint_position[arm, part]), *NOISE
            )
    return Measured(kinematics, joint_position, pose)


def chain_error(kinematics: np.ndarray, parameters: np.ndarray, joint_position: np.ndarray) -> float:
    """The largest difference in any entry of the flange pose of true chains `(arm, 6, 6)` and models `(arm, 28)`."""
    pairs = zip(kinematics, parameters, strict=True)
    return max(
        float(np.abs(six_parameter_poses(true, joint_position) - seed_poses(model, joint_position)).max())
        for true, model in pairs
    )
