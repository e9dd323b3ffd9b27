"""The joint positions at which a calibration is fitted, and those at which its fit is checked."""

import numpy as np

from lite6jax.arms.arm import Arm

SAMPLES = 300
"""Joint positions that a calibration is fitted at."""
CHECK_SAMPLES = 1000
"""Other joint positions, at which the models of calibrations are compared: fitted, nominal, and of another arm."""


def sample_within_limits(arm: Arm, samples: int, seed: int) -> np.ndarray:
    """Joint positions `(sample, joint)`, uniform inside the arm's limits."""
    lower, upper = arm.joint_limits.T
    return np.random.default_rng(seed).uniform(lower, upper, (samples, arm.dof))


def check_positions(arm: Arm, seed: int = 0) -> np.ndarray:
    """`CHECK_SAMPLES` joint positions beside those that are drawn by `seed`: by default the same in every command, so
    that a distance between two geometries is one number."""
    return sample_within_limits(arm, CHECK_SAMPLES, seed + 1)
