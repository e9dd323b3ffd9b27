"""Arms of the generator: six numbers a joint, masses, limits; where their frames are; and the files that describe them.

Shares no code with the library: plain NumPy, the sample first.
"""

from dataclasses import dataclass, replace

import numpy as np
import yaml
from numpy.typing import NDArray

Array = NDArray[np.floating]
Poses = tuple[Array, Array]  # rotations `(sample, 3, 3)` and positions `(sample, 3)` m

SIX = ("x", "y", "z", "roll", "pitch", "yaw")
GRAVITY = np.array([0.0, 0.0, -9.81])
MADE = (8e-4, 2.6e-3)
"""m and rad: one standard deviation of every number of an arm as it is made; 3 mm at the flange, 5 mm at most."""


@dataclass(frozen=True, eq=False)
class Chain:
    """A serial arm of revolute joints."""

    name: str  # bundled with the library, or that of a description written beside the recording
    # `(joint, 6)` m and rad, the frame of each joint before it turns, in the frame after the joint before: R = Rz(yaw)
    # Ry(pitch) Rx(roll)
    rows: Array
    limits: Array  # `(joint, 2)` rad, that trials stay within
    mass: Array  # `(joint,)` kg of each link
    center: Array  # `(joint, 3)` m, its centre of mass in the frame after the joint's rotation
    bundled: bool = False  # whether the library knows it by name

    @property
    def dof(self) -> int:
        """The number of joints."""
        return len(self.rows)

    def moved(self, rng: np.random.Generator, position: float, rotation: float) -> "Chain":
        """The chain with every number off by chance, one standard deviation in m and rad."""
        return replace(self, rows=self.rows + rng.normal(size=self.rows.shape) * np.repeat([position, rotation], 3))

    def frames(self, q: Array) -> tuple[Array, Array]:
        """Rotations `(sample, joint, 3, 3)` and origins `(sample, joint, 3)` of the frames after each joint."""
        R, p = np.eye(3), np.zeros(3)
        rotations, origins = [], []
        for i, row in enumerate(self.rows):
            p = p + R @ row[:3]
            R = R @ rotation_from_rpy(*row[3:]) @ about_z(q[:, i])
            rotations.append(R)
            origins.append(np.broadcast_to(p, (len(q), 3)))
        return np.stack(rotations, 1), np.stack(origins, 1)


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """`(3, 3)`: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ about_y @ about_x


def about_z(angle: Array) -> Array:
    """`(sample, 3, 3)` turns about z."""
    R = np.zeros((len(angle), 3, 3))
    c, s = np.cos(angle), np.sin(angle)
    R[:, 0, 0], R[:, 0, 1], R[:, 1, 0], R[:, 1, 1], R[:, 2, 2] = c, -s, s, c, 1.0
    return R


def rotation_from_vector(w: Array) -> Array:
    """`(…, 3, 3)` of rotation vectors `(…, 3)` (Rodrigues)."""
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    K = np.zeros((*w.shape[:-1], 3, 3))
    x, y, z = np.moveaxis(w, -1, 0)
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -z, y, -x
    K[..., 1, 0], K[..., 2, 0], K[..., 2, 1] = z, -y, x
    return np.eye(3) + np.sinc(angle / np.pi) * K + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (K @ K)


def vector_from_rotation(R: Array) -> Array:
    """`(…, 3)` rotation vectors of rotations that are small, or at least no half turns."""
    skew = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1) / 2
    sine = np.linalg.norm(skew, axis=-1)
    angle = np.arctan2(sine, (np.trace(R, axis1=-2, axis2=-1) - 1) / 2)
    return skew * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 1.0)[..., None]


def quaternion_from_rotation(R: Array) -> Array:
    """`(sample, 4)`, scalar first, by the largest of the four (S. W. Shepperd, 1978)."""
    trace = np.trace(R, axis1=1, axis2=2)
    squares = np.column_stack([trace, np.diagonal(R, axis1=1, axis2=2)])
    q = np.empty((len(R), 4))
    for k, largest in enumerate(np.argmax(squares, 1)):
        M = R[k]
        if largest == 0:
            q[k] = 1 + trace[k], M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1]
        else:
            i = largest - 1
            j, l = (i + 1) % 3, (i + 2) % 3
            q[k, 0] = M[l, j] - M[j, l]
            q[k, 1 + i] = 1 + M[i, i] - M[j, j] - M[l, l]
            q[k, 1 + j], q[k, 1 + l] = M[j, i] + M[i, j], M[l, i] + M[i, l]
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def rows_from_dh(theta: Array, d: Array, a: Array, alpha: Array) -> Array:
    """`(joint, 6)` of a standard DH table: a joint's frame stands at the end of the link before."""
    rows = np.zeros((len(d), 6))
    for i in range(len(d)):
        R, p = np.eye(3), np.zeros(3)
        if i:
            # the fixed part behind the joint before: Trans_z(d) Rot_z(theta) Trans_x(a) Rot_x(alpha)
            turn = rotation_from_rpy(0, 0, theta[i - 1])
            p = np.array([0, 0, d[i - 1]]) + turn @ np.array([a[i - 1], 0, 0])
            R = turn @ rotation_from_rpy(alpha[i - 1], 0, 0)
        rows[i] = *p, np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(np.clip(R[2, 0], -1, 1)), np.arctan2(R[1, 0], R[0, 0])
    return rows


def lite6() -> Chain:
    """A Lite 6 as its maker publishes it (243.3, 200, 87, 227.6 and 61.5 mm), with its masses."""
    quarter = np.pi / 2
    rows = [
        [0, 0, 0.2433, 0, 0, 0],
        [0, 0, 0, quarter, -quarter, np.pi],
        [0.2, 0, 0, -np.pi, 0, quarter],
        [0.087, -0.2276, 0, quarter, 0, 0],
        [0, 0, 0, quarter, 0, 0],
        [0, 0.0615, 0, -quarter, 0, 0],
    ]
    center = [
        *([-0.36, 41.95, -2.5], [179, 0, 58.4], [72, -35.7, -1]),
        *([-2, -28.5, -81.3], [0, 10, 1.9], [0, -1.94, -10.2]),
    ]
    degrees = [[-360, 360], [-150, 150], [-3.5, 300], [-360, 360], [-124, 124], [-360, 360]]
    mass = np.array([1.411, 1.34, 0.953, 1.284, 0.804, 0.13])
    return Chain("lite6", np.array(rows, float), np.deg2rad(degrees), mass, np.array(center) * 1e-3, bundled=True)


def lite6_ros() -> Chain:
    """A Lite 6 as the maker's ROS package has it: 243.5, 200.2, 227.61 and 62.5 mm, angles of four decimals."""
    published = lite6()
    rows = published.rows.copy()
    rows[0, 2], rows[2, 0], rows[3, 1], rows[5, 1] = 0.2435, 0.2002, -0.22761, 0.0625
    rows[:, 3:] = np.round(rows[:, 3:], 4)
    return replace(published, name="lite6_ros", rows=rows)


def seven() -> Chain:
    """An arm of seven joints, each at a right angle to the one before, 1.2 m long."""
    rows = np.zeros((7, 6))
    rows[0, 2], rows[2, 1], rows[4, 1], rows[6, 1] = 0.34, -0.4, -0.39, -0.12
    rows[6, 0] = 0.08
    rows[1::2, 3], rows[2::2, 3] = -np.pi / 2, np.pi / 2
    limits = np.deg2rad([[-170, 170], [-120, 120]] * 3 + [[-175, 175]])
    center = [[0, -0.03, -0.07], [0.0, 0.06, 0.04], [0, 0.03, -0.07], [0, 0.07, 0.03], [0, 0.02, -0.08], [0, 0, 0.01]]
    mass = np.array([3.9, 3.8, 2.9, 2.6, 1.7, 1.6, 0.4])
    return Chain("seven", rows, limits, mass, np.array([*center, [0, 0, 0.02]]))


def draw_six(rng: np.random.Generator) -> Chain:
    """A random arm of six joints: no two neighbouring axes in one line, lengths and masses of a small arm."""
    alpha = np.array([np.pi / 2, 0, np.pi / 2, -np.pi / 2, np.pi / 2, 0]) * rng.choice([-1.0, 1.0], 6)
    d = np.array([0.2, 0.05, 0.05, 0.3, 0.05, 0.1]) * rng.uniform(0.5, 1.5, 6) * rng.choice([1, 1, 1, -1], 6)
    a = np.array([0.05, 0.35, 0.08, 0.02, 0.02, 0]) * rng.uniform(0.5, 1.5, 6)
    rows = rows_from_dh(rng.uniform(-np.pi, np.pi, 6), d, a, alpha)
    rows[0, 2] += 0.2
    limits = np.stack([-rng.uniform(1.8, 3.1, 6), rng.uniform(1.8, 3.1, 6)], 1)
    mass = np.array([4.0, 4.5, 3.0, 2.0, 1.2, 0.5]) * rng.uniform(0.6, 1.4, 6)
    center = rng.uniform(-0.08, 0.08, (6, 3))
    center[:-1] += 0.4 * rows[1:, :3]
    return Chain("six", rows, limits, mass, center)


def factory_text(rows: Array) -> str:
    """A factory calibration in the vendor's form."""
    return yaml.safe_dump({"kinematics": _kinematics(rows)}, sort_keys=False)


def description_text(chain: Chain) -> str:
    """A description of the nominal arm: kinematics, limits and masses."""
    inertial = {
        f"link{i + 1}": {"mass_kg": float(m), "com_m": [float(v) for v in c]}
        for i, (m, c) in enumerate(zip(chain.mass, chain.center, strict=True))
    }
    limits = [[float(v) for v in row] for row in chain.limits]
    said = {"name": chain.name, "kinematics": _kinematics(chain.rows), "joint_limits_rad": limits, "inertial": inertial}
    return yaml.safe_dump(said, sort_keys=False)


def _kinematics(rows: Array) -> dict[str, dict[str, float]]:
    return {f"joint{i + 1}": dict(zip(SIX, map(float, row), strict=True)) for i, row in enumerate(rows)}
