"""Simulated Lite 6 arms of the seed's tolerance and what a noisy sensor reads of them, in plain vectorised NumPy.

Nothing of the library is used but the bundled arm's nominal numbers: what checks the answers shares no code with them.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.seed_way import D2, sample_joints
from lite6jax.arms.bundled import load_bundled

TOLERANCE = np.array([0.8e-3] * 3 + [np.deg2rad(0.15)] * 3)
"""One standard deviation of each number of a calibration, m and rad: the seed's "about 0.8 mm and 0.15 degrees"."""
NOISE = (20e-6, 0.1e-3)
"""One standard deviation of a measured position (m) and orientation (rad), per axis."""
SCALE = (1 / NOISE[0], 1 / NOISE[1])
BLOCK = 50_000


class Measured(NamedTuple):
    """Simulated measurements.

    Attributes:
        kinematics: the true `(arm, 6, 6)`.
        joint_position: `(arm, sample, 6)` rad.
        pose: what the sensor reads, `(arm, sample, 4, 4)`.
    """

    kinematics: np.ndarray
    joint_position: np.ndarray
    pose: np.ndarray


def simulated_arms(arms: int, seed: int) -> np.ndarray:
    """True six-parameter chains `(arm, 6, 6)`, each number of them normal about the Lite 6's."""
    spread = TOLERANCE * np.random.default_rng(seed).standard_normal((arms, 6, 6))
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
            pose[arm, part] = _noisy(six_parameter_poses(kinematics[arm], joint_position[arm, part]), rng)
    return Measured(kinematics, joint_position, pose)


def _noisy(pose: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    spin = Rotation.from_rotvec(NOISE[1] * rng.standard_normal((len(pose), 3))).as_matrix()
    pose[:, :3, :3] = pose[:, :3, :3] @ spin
    pose[:, :3, 3] += NOISE[0] * rng.standard_normal((len(pose), 3))
    return pose


def turns(axis: str, angle: np.ndarray) -> np.ndarray:
    """`(…, 4, 4)` rotations about one axis."""
    T = np.zeros((*np.shape(angle), 4, 4))
    k = "xyz".index(axis)
    i, j = (k + 1) % 3, (k + 2) % 3
    T[..., i, i] = T[..., j, j] = np.cos(angle)
    T[..., j, i] = np.sin(angle)
    T[..., i, j] = -T[..., j, i]
    T[..., k, k] = T[..., 3, 3] = 1.0
    return T


def shift(x: float, y: float, z: float) -> np.ndarray:
    """(4, 4) translation."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def six_parameter_poses(kinematics: np.ndarray, joint_position: np.ndarray) -> np.ndarray:
    """Flange poses `(sample, 4, 4)` of a six-parameter chain `(6, 6)` at `(sample, 6)` rad."""
    T = np.eye(4)
    for (x, y, z, roll, pitch, yaw), q in zip(kinematics, joint_position.T, strict=True):
        T = T @ shift(x, y, z) @ turns("z", yaw) @ turns("y", pitch) @ turns("x", roll) @ turns("z", q)
    return T


def hayati_links(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The fixed parts of the seed's model `(28,)`: base (4, 4), and what follows each joint's rotation (6, 4, 4)."""
    table = np.insert(parameters[4:27], D2, 0.0).reshape(6, 4)
    return dh_links(parameters[:4], table, np.array([0.0, parameters[27], 0.0, 0.0, 0.0, 0.0]))


def dh_links(base: np.ndarray, table: np.ndarray, beta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same of base (x, y, roll, pitch), a table (6, 4) of theta_off, d, a, alpha and a beta a joint (6,)."""
    x, y, roll, pitch = base
    links = [
        turns("z", theta) @ shift(a, 0, d) @ turns("x", alpha) @ turns("y", tilt)
        for (theta, d, a, alpha), tilt in zip(table, beta, strict=True)
    ]
    return shift(x, y, 0) @ turns("y", pitch) @ turns("x", roll), np.stack(links)


def dh_poses(base: np.ndarray, links: np.ndarray, joint_position: np.ndarray) -> np.ndarray:
    """Flange poses `(sample, 4, 4)` of base ∏ Rz(q) link at `(sample, 6)` rad."""
    T = base
    for fixed, q in zip(links, joint_position.T, strict=True):
        T = T @ turns("z", q) @ fixed
    return T


def hayati_poses(parameters: np.ndarray, joint_position: np.ndarray) -> np.ndarray:
    """Flange poses `(sample, 4, 4)` of the seed's model `(28,)`."""
    return dh_poses(*hayati_links(parameters), joint_position)


def chain_error(kinematics: np.ndarray, parameters: np.ndarray, joint_position: np.ndarray) -> float:
    """The largest difference in any entry of the flange pose of true chains `(arm, 6, 6)` and models `(arm, 28)`."""
    pairs = zip(kinematics, parameters, strict=True)
    return max(
        float(np.abs(six_parameter_poses(true, joint_position) - hayati_poses(model, joint_position)).max())
        for true, model in pairs
    )
