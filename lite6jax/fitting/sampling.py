"""The joint positions at which a calibration is fitted, and those at which its fit is checked."""

import numpy as np

from lite6jax.arms.arm import Arm

SAMPLES = 300
"""Joint positions that a calibration is fitted at."""
CHECK_SAMPLES = 1000
"""Other joint positions, at which the fitted model is compared with the calibration."""


def sample_within_limits(arm: Arm, samples: int, seed: int) -> np.ndarray:
    """Joint positions `(sample, joint)`, uniform inside the arm's limits."""
    lower, upper = arm.joint_limits.T
    return np.random.default_rng(seed).uniform(lower, upper, (samples, arm.dof))
