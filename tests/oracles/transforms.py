"""Rotations and transforms in plain NumPy and SciPy, over any leading axes."""

import numpy as np
from scipy.spatial.transform import Rotation


def rotate(axis, angle):
    """(…, 4, 4) rotations about "x", "y" or "z" by (…) rad."""
    T = np.zeros((*np.shape(angle), 4, 4))
    k = "xyz".index(axis)
    i, j = (k + 1) % 3, (k + 2) % 3
    T[..., i, i] = T[..., j, j] = np.cos(angle)
    T[..., j, i] = np.sin(angle)
    T[..., i, j] = -T[..., j, i]
    T[..., k, k] = T[..., 3, 3] = 1.0
    return T


def shift(x, y, z):
    """(4, 4) translation."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def displacement(twist):
    """(…, 4, 4): a translation x y z, then a rotation by the vector rx ry rz, of (…, 6) m and rad."""
    twist = np.asarray(twist, float)
    T = np.zeros((*twist.shape[:-1], 4, 4))
    T[..., :3, :3] = Rotation.from_rotvec(twist[..., 3:].reshape(-1, 3)).as_matrix().reshape(*twist.shape[:-1], 3, 3)
    T[..., :3, 3] = twist[..., :3]
    T[..., 3, 3] = 1.0
    return T


def origin_transform(row):
    """(…, 4, 4): Trans(x, y, z) Rz(yaw) Ry(pitch) Rx(roll) of (…, 6) x y z roll pitch yaw."""
    x, y, z, roll, pitch, yaw = np.moveaxis(np.asarray(row, float), -1, 0)
    T = rotate("z", yaw) @ rotate("y", pitch) @ rotate("x", roll)
    T[..., :3, 3] = np.stack([x, y, z], -1)
    return T


def random_transform(rng, distance):
    """(4, 4) of any rotation, and a translation with this standard deviation (m) along each axis."""
    T = shift(*distance * rng.standard_normal(3))
    T[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    return T


def quaternions(poses):
    """(sample, 4), scalar first, of (sample, 4, 4)."""
    return np.roll(Rotation.from_matrix(poses[:, :3, :3]).as_quat(), 1, axis=1)


def perturb_poses(rng, poses, position, orientation):
    """Poses (sample, 4, 4) as a sensor with these standard deviations (m, rad per axis) reads them."""
    noisy = poses.copy()
    noisy[:, :3, 3] += position * rng.standard_normal((len(poses), 3))
    turned = Rotation.from_rotvec(orientation * rng.standard_normal((len(poses), 3))).as_matrix()
    noisy[:, :3, :3] = poses[:, :3, :3] @ turned
    return noisy
