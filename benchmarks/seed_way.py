"""The seed's way for one arm: SciPy least squares with finite differences over a Python loop of 4 × 4 matrices.

A script that stands alone, as the seed's does, so that its wall time is that of NumPy, SciPy and the fit:
`python seed_way.py ARM.yaml --out model.json`. Our own code after the seed's description.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

LIMITS_DEG = np.array([(-360, 360), (-150, 150), (-3.5, 300), (-360, 360), (-124, 124), (-360, 360)])
TABLE = np.array(
    [
        (0, 0.2433, 0, -np.pi / 2),
        (-np.pi / 2, 0, 0.2, np.pi),
        (-np.pi / 2, 0, 0.087, np.pi / 2),
        (0, 0.2276, 0, np.pi / 2),
        (0, 0, 0, -np.pi / 2),
        (0, 0.0615, 0, 0),
    ]
)
"""The published nominal table of the Lite 6: theta_off (rad), d (m), a (m), alpha (rad)."""
D2 = 5  # where d2, which is zero, stands in the flat table
NOMINAL = np.concatenate([np.zeros(4), np.delete(TABLE.ravel(), D2), [0.0]])
"""x, y, roll, pitch; theta_off, d, a, alpha a joint without d2; beta2."""
LEVER = 0.1  # m a radian counts


def rotation(axis: int, angle: float) -> np.ndarray:
    """(4, 4) rotation about x, y or z."""
    T, (i, j) = np.eye(4), ((1, 2), (2, 0), (0, 1))[axis]
    T[i, i] = T[j, j] = np.cos(angle)
    T[j, i] = np.sin(angle)
    T[i, j] = -T[j, i]
    return T


def translation(x: float, y: float, z: float) -> np.ndarray:
    """(4, 4) translation."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def factory_pose(kinematics: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(4, 4) flange pose of a six-parameter chain `(6, 6)` at `q` (6,) rad."""
    T = np.eye(4)
    for (x, y, z, roll, pitch, yaw), angle in zip(kinematics, q, strict=True):
        origin = translation(x, y, z) @ rotation(2, yaw) @ rotation(1, pitch) @ rotation(0, roll)
        T = T @ origin @ rotation(2, angle)
    return T


def link(theta: float, d: float, a: float, alpha: float) -> np.ndarray:
    """Rz(theta) Tz(d) Tx(a) Rx(alpha)."""
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]])


def effective_pose(parameters: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(4, 4) flange pose of the effective model `(28,)`."""
    x, y, roll, pitch = parameters[:4]
    T = translation(x, y, 0) @ rotation(1, pitch) @ rotation(0, roll)
    for i, (theta, d, a, alpha) in enumerate(np.insert(parameters[4:27], D2, 0.0).reshape(6, 4)):
        T = T @ link(q[i] + theta, d, a, alpha)
        if i == 1:
            T = T @ rotation(1, parameters[27])
    return T


def logarithm(R: np.ndarray) -> np.ndarray:
    """(3,) rotation vector of a rotation by less than 180 degrees."""
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = np.linalg.norm(axis) / 2
    angle = np.arctan2(sine, (np.trace(R) - 1) / 2)
    return axis / 2 if sine < 1e-12 else angle / (2 * sine) * axis


def fit(
    joint_position: np.ndarray, poses: np.ndarray, scale: tuple[float, float] = (1.0, LEVER), tolerance: float = 1e-15
) -> np.ndarray:
    """Parameters `(28,)` from joint positions `(sample, 6)` rad and flange poses `(sample, 4, 4)`.

    Args:
        joint_position: rad.
        poses: m.
        scale: what position (1/m) and orientation (1/rad) residuals are multiplied by.
        tolerance: relative, of step, cost and gradient.
    """

    def residuals(parameters: np.ndarray) -> np.ndarray:
        rows = []
        for q, T in zip(joint_position, poses, strict=True):
            predicted = effective_pose(parameters, q)
            rows.append(scale[0] * (predicted[:3, 3] - T[:3, 3]))
            rows.append(scale[1] * logarithm(T[:3, :3].T @ predicted[:3, :3]))
        return np.concatenate(rows)

    return least_squares(residuals, NOMINAL, x_scale="jac", xtol=tolerance, ftol=tolerance, gtol=tolerance).x


def sample_joints(count: int, rng: np.random.Generator) -> np.ndarray:
    """`(count, 6)` rad, uniform inside the limits."""
    lower, upper = np.deg2rad(LIMITS_DEG).T
    return rng.uniform(lower, upper, (count, 6))


def as_table(parameters: np.ndarray) -> dict:
    """The seed's JSON table, mm and degrees."""
    x, y, roll, pitch = parameters[:4]
    rows = np.insert(parameters[4:27], D2, 0.0).reshape(6, 4) * [180 / np.pi, 1e3, 1e3, 180 / np.pi]
    tilt = np.rad2deg([roll, pitch])
    return {
        "units": "mm and deg",
        "base": {"x": x * 1e3, "y": y * 1e3, "z": 0.0, "roll": tilt[0], "pitch": tilt[1], "yaw": 0.0},
        "dh": [
            {"joint": i + 1, **dict(zip(("theta_off", "d", "a", "alpha"), map(float, row), strict=True))}
            for i, row in enumerate(rows)
        ],
        "beta_joint2": float(np.rad2deg(parameters[27])),
    }


def main() -> None:
    """Nominal difference, fit to 300 samples, check on 1000 fresh ones, table."""
    import yaml

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("calibration", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    joints = yaml.safe_load(options.calibration.read_text())["kinematics"]
    names = ("x", "y", "z", "roll", "pitch", "yaw")
    kinematics = np.array([[joints[f"joint{i}"][name] for name in names] for i in range(1, 7)], float)
    fresh = sample_joints(1000, np.random.default_rng(1))

    def shift(parameters: np.ndarray, q: np.ndarray) -> float:
        return float(np.linalg.norm(effective_pose(parameters, q)[:3, 3] - factory_pose(kinematics, q)[:3, 3]))

    def spin(parameters: np.ndarray, q: np.ndarray) -> float:
        relative = factory_pose(kinematics, q)[:3, :3].T @ effective_pose(parameters, q)[:3, :3]
        return float(np.linalg.norm(logarithm(relative)))

    print(f"nominal against calibration: at most {max(shift(NOMINAL, q) for q in fresh) * 1e3:.3f} mm")
    sampled = sample_joints(300, np.random.default_rng(0))
    parameters = fit(sampled, np.array([factory_pose(kinematics, q) for q in sampled]))
    position = max(shift(parameters, q) for q in fresh)
    angle = max(spin(parameters, q) for q in fresh)
    print(f"effective model against calibration: at most {position * 1e3:.1e} mm, {np.rad2deg(angle):.1e} deg")
    table = as_table(parameters)
    for row in table["dh"]:
        print("".join(f"{value:12.5f}" for value in row.values()))
    options.out.write_text(json.dumps(table, indent=2))


if __name__ == "__main__":
    main()
