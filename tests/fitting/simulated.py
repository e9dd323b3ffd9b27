"""A simulated arm in plain NumPy: the independent side of the fit's tests, sharing no code with the library."""

import numpy as np

# The seed's table: theta_off, d, a, alpha per joint.
LITE6 = np.array(
    [
        [0, 0.2433, 0, -np.pi / 2],
        [-np.pi / 2, 0, 0.2, np.pi],
        [-np.pi / 2, 0, 0.087, np.pi / 2],
        [0, 0.2276, 0, np.pi / 2],
        [0, 0, 0, -np.pi / 2],
        [0, 0.0615, 0, 0],
    ]
)
LIMITS = np.deg2rad([(-360, 360), (-150, 150), (-3.5, 300), (-360, 360), (-124, 124), (-360, 360)])


def rotation(axis: str, angle) -> np.ndarray:
    """Rotations `(..., 3, 3)` about one axis."""
    c, s = np.cos(angle), np.sin(angle)
    o, i = np.zeros_like(c), np.ones_like(c)
    rows = {
        "x": [[i, o, o], [o, c, -s], [o, s, c]],
        "y": [[c, o, s], [o, i, o], [-s, o, c]],
        "z": [[c, -s, o], [s, c, o], [o, o, i]],
    }[axis]
    return np.stack([np.stack([np.asarray(v) for v in row], -1) for row in rows], -2)


def pose(R: np.ndarray, p) -> np.ndarray:
    """Rigid transforms `(..., 4, 4)`."""
    p = np.broadcast_to(np.asarray(p, float), (*R.shape[:-2], 3))
    T = np.zeros((*R.shape[:-2], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, p, 1
    return T


def nominal() -> np.ndarray:
    """The seed's 28 parameters of the nominal arm."""
    return np.concatenate([np.zeros(4), np.delete(LITE6.ravel(), 5), [0.0]])


def is_length() -> np.ndarray:
    """Which of the 28 are lengths: base x, y and every d and a."""
    table = np.tile([False, True, True, False], (6, 1))
    return np.concatenate([[True, True, False, False], np.delete(table.ravel(), 5), [False]])


def perturbed(rng: np.random.Generator, length: float = 0.8e-3, angle: float = np.deg2rad(0.15)) -> np.ndarray:
    """A made arm: nominal with the seed's tolerance."""
    return nominal() + rng.normal(size=28) * np.where(is_length(), length, angle)


def flange(x: np.ndarray, q: np.ndarray) -> np.ndarray:
    """`T_base_flange` `(sample, 4, 4)` as the seed writes it, as a product of matrices."""
    table = np.insert(x[4:27], 5, 0.0).reshape(6, 4)
    T = pose(rotation("y", x[3]) @ rotation("x", x[2]), [x[0], x[1], 0.0])
    T = np.broadcast_to(T, (len(q), 4, 4))
    for i, (theta, d, a, alpha) in enumerate(table):
        A = pose(rotation("z", q[:, i] + theta), [0, 0, 0]) @ pose(rotation("x", alpha), [a, 0, d])
        if i == 1:
            A = A @ pose(rotation("y", x[27]), [0, 0, 0])
        T = T @ A
    return T


def small_rotation(vector: np.ndarray) -> np.ndarray:
    """Rotations `(sample, 3, 3)` of rotation vectors (Rodrigues)."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None] + 1e-300
    x, y, z = np.moveaxis(vector, -1, 0)
    o = np.zeros_like(x)
    K = np.stack([np.stack(r, -1) for r in ([o, -z, y], [z, o, -x], [-y, x, o])], -2) / angle
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def random_pose(rng: np.random.Generator, distance: float) -> np.ndarray:
    """A rigid transform with any rotation and a translation of some metres."""
    Q, R = np.linalg.qr(rng.normal(size=(3, 3)))
    Q = Q * np.sign(np.diag(R))
    Q[:, 0] *= np.linalg.det(Q)
    return pose(Q, distance * rng.normal(size=3))


def quaternion(R: np.ndarray) -> np.ndarray:
    """Scalar-first quaternions, by the eigenvector of Bar-Itzhack's matrix: slow, and unlike the library's way."""
    out = []
    for M in R:
        K = np.array(
            [
                [M[0, 0] - M[1, 1] - M[2, 2], M[1, 0] + M[0, 1], M[2, 0] + M[0, 2], M[2, 1] - M[1, 2]],
                [M[1, 0] + M[0, 1], M[1, 1] - M[0, 0] - M[2, 2], M[2, 1] + M[1, 2], M[0, 2] - M[2, 0]],
                [M[2, 0] + M[0, 2], M[2, 1] + M[1, 2], M[2, 2] - M[0, 0] - M[1, 1], M[1, 0] - M[0, 1]],
                [M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1], M[0, 0] + M[1, 1] + M[2, 2]],
            ]
        )
        v = np.linalg.eigh(K)[1][:, -1]
        out.append([v[3], v[0], v[1], v[2]])
    return np.array(out)


def sample(rng: np.random.Generator, count: int) -> np.ndarray:
    """Joint positions inside the limits."""
    return rng.uniform(LIMITS[:, 0], LIMITS[:, 1], (count, 6))
