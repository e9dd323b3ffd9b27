"""Kinematics in plain NumPy, sharing no code with the library: the oracle of the tests, and the arms they run on."""

import numpy as np
from scipy.spatial.transform import Rotation

# The seed's nominal table: theta_off (deg), d (mm), a (mm), alpha (deg).
LITE6_TABLE = [
    (0, 243.3, 0, -90),
    (-90, 0, 200, 180),
    (-90, 0, 87, 90),
    (0, 227.6, 0, 90),
    (0, 0, 0, -90),
    (0, 61.5, 0, 0),
]
LITE6_DH = np.array([(np.deg2rad(t), d / 1000, a / 1000, np.deg2rad(alpha)) for t, d, a, alpha in LITE6_TABLE])

# The seed's size of a calibration: about 0.8 mm and 0.15 degrees in each number.
ASSEMBLY = np.array([0.8e-3] * 3 + [np.deg2rad(0.15)] * 3)


def rotate(axis, angle):
    """(4, 4) rotation about "x", "y" or "z"."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler(axis, angle).as_matrix()
    return T


def shift(x, y, z):
    """(4, 4) translation."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def product(*factors):
    """The product of transforms, from the left."""
    T = np.eye(4)
    for factor in factors:
        T = T @ factor
    return T


def origin_transform(row):
    """Trans(x, y, z) Rz(yaw) Ry(pitch) Rx(roll) of x y z roll pitch yaw."""
    x, y, z, roll, pitch, yaw = row
    return product(shift(x, y, z), rotate("z", yaw), rotate("y", pitch), rotate("x", roll))


def six_parameter_poses(kinematics, positions):
    """(sample, 4, 4) of (joint, 6) and (sample, joint)."""
    T = np.broadcast_to(np.eye(4), (len(positions), 4, 4))
    for row, q in zip(kinematics, np.asarray(positions).T, strict=True):
        T = T @ origin_transform(row) @ np.stack([rotate("z", angle) for angle in q])
    return T


def hayati_poses(base, dh, betas, positions):
    """(sample, 4, 4); `base` x, y, roll, pitch, `dh` (joint, 4), `betas` {joint from 0: beta}."""
    x, y, roll, pitch = base
    poses = []
    for q in positions:
        T = product(shift(x, y, 0), rotate("y", pitch), rotate("x", roll))
        for i, (theta, d, a, alpha) in enumerate(dh):
            T = product(T, rotate("z", q[i] + theta), shift(0, 0, d), shift(a, 0, 0), rotate("x", alpha))
            if i in betas:
                T = T @ rotate("y", betas[i])
        poses.append(T)
    return np.array(poses)


def random_kinematics(rng, dof):
    """(joint, 6) of an arm with no two axes parallel but by chance."""
    return np.hstack([rng.uniform(-0.5, 0.5, (dof, 3)), rng.uniform(-np.pi, np.pi, (dof, 3))])


def perturbed(rng, kinematics, size=1.0):
    """A calibration of the seed's size about `kinematics`."""
    return kinematics + size * ASSEMBLY * rng.uniform(-1, 1, np.shape(kinematics))


def random_positions(rng, samples, dof):
    """(sample, joint) over the full circle."""
    return rng.uniform(-np.pi, np.pi, (samples, dof))


def perturb_poses(rng, poses, position, orientation):
    """Poses as a sensor with these standard deviations (m, rad per axis) reads them."""
    noisy = poses.copy()
    noisy[:, :3, 3] += position * rng.standard_normal((len(poses), 3))
    turned = Rotation.from_rotvec(orientation * rng.standard_normal((len(poses), 3))).as_matrix()
    noisy[:, :3, :3] = poses[:, :3, :3] @ turned
    return noisy
