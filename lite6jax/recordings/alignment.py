"""How nominal poses of an arm's flange lie beside measured ones: the sensor's frame and the tool, in closed form.

All of it is NumPy, so that nothing is compiled.
"""

from itertools import permutations, product

import numpy as np
import scipy  # whose parts are imported where they are first used: `spatial` takes half a second

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.array_types import Array
from lite6jax.recordings.sequence import spread_rows

FINEST_SENSOR_M = 2e-5
"""Above, an error may be a sensor's noise."""
COMPUTED_M = 2e-6
"""Below, it is none: controllers compute in single precision too."""
LEAST_TRAVEL_M = 0.02
"""Of positions of which is said that they are computed."""
_ROUNDS = 12
_MOST_SAMPLES = 3000
_DETERMINED = 0.01
"""Least singular value over the largest: below, as in motions about two axes, nine cosines are not determined, from
which the rotation would come; it is 2e-4 for a positioner of two axes and above 0.1 for arms."""
_FEW = 40
"""Samples that tell rotations apart."""


def frames_from_poses(
    flange: Array, position: Array, rotation: Array | None, frame: Array | None, tool: Array | None
) -> tuple[Array, Array]:
    """The sensor frame and the tool that carry nominal flange poses to measured ones.

    With both unknown, p_k = A y_k − b − R_k t is linear in A = R_sensor_baseᵀ, b = A t_sensor_base and the tool's
    translation t; A is projected on the rotations and the rest solved again. Samples are reweighted (Cauchy, scale from
    the median) so that outliers have little weight.

    Args:
        flange: nominal `T_base_flange` `(sample, 4, 4)`.
        position: measured, `(sample, 3)` m, sensor frame.
        rotation: measured, `(sample, 3, 3)`, or None.
        frame: `T_sensor_base` `(4, 4)`, or None where unknown.
        tool: `T_flange_tool` `(4, 4)`, or None where unknown; its rotation is the identity where none was measured.

    Returns:
        `T_sensor_base` and `T_flange_tool`, `(4, 4)` each.
    """
    if len(flange) > _MOST_SAMPLES:
        chosen = spread_rows(len(flange), _MOST_SAMPLES)
        flange = flange[chosen]
        position = position[chosen]
        rotation = None if rotation is None else rotation[chosen]
    R = flange[:, :3, :3]
    p = flange[:, :3, 3]
    weight = np.ones(len(p))
    T_frame = np.eye(4) if frame is None else frame.copy()
    T_tool = np.eye(4) if tool is None else tool.copy()
    determined = frame is not None or tool is not None or _cosines(R, p, position, weight)[1] > _DETERMINED
    if not determined:
        T_frame[:3, :3], T_tool[:3, 3], T_frame[:3, 3] = _best_of_many(R, p, position)
    for k in range(_ROUNDS):
        if frame is None and tool is None:
            if determined and k < _ROUNDS // 2:
                T_frame[:3, :3] = nearest_rotation(_cosines(R, p, position, weight)[0]).T
            else:
                T_frame[:3, :3] = _turned_frame(R, p, position, weight, T_frame, T_tool)
            T_tool[:3, 3], T_frame[:3, 3] = _translations(R, p, position, weight, T_frame[:3, :3])
        elif frame is None:
            T_frame = _registration(p + R @ T_tool[:3, 3], position, weight)
        elif tool is None:
            position_in_base = (position - T_frame[:3, 3]) @ T_frame[:3, :3]
            T_tool[:3, 3] = _solve(R, position_in_base - p, weight)
        distance = np.linalg.norm(_missed(R, p, position, T_frame, T_tool), axis=1)
        scale = max(float(np.median(distance)), 1e-9)
        weight = 1 / (1 + (distance / (2 * scale)) ** 2)
    if tool is None and rotation is not None:
        relative = np.swapaxes(T_frame[:3, :3] @ R, 1, 2) @ rotation
        T_tool[:3, :3] = nearest_rotation(np.einsum("s,sij->ij", weight, relative))
    return T_frame, T_tool


def nearest_rotation(M: Array) -> Array:
    """The rotation `(3, 3)` nearest to a matrix."""
    U, _, Vt = np.linalg.svd(M)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt


def _cosines(R: Array, p: Array, position: Array, weight: Array) -> tuple[Array, float]:
    """The nine of the base's axes in the sensor's, and how well they are determined, from 1 down to 0."""
    center = position.mean(0)
    size = max(float(np.abs(position - center).max()), 1e-9)
    rows = np.zeros((len(p), 3, 15))
    for i in range(3):
        rows[:, i, 3 * i : 3 * i + 3] = (position - center) / size
        rows[:, i, 9 + i] = -1.0
    rows[:, :, 12:] = -R
    A = (np.sqrt(weight)[:, None, None] * rows).reshape(-1, 15)
    solution, _, _, singular = np.linalg.lstsq(A, (np.sqrt(weight)[:, None] * p).ravel(), rcond=1e-9)
    determined = float(singular[-1] / singular[0]) if A.shape[0] >= 15 else 0.0
    return solution[:9].reshape(3, 3), determined


def _best_of_many(R: Array, p: Array, position: Array) -> tuple[Array, Array, Array]:
    """The sensor frame's rotation and both translations from the best of many rotations, on some of the samples."""
    subset = spread_rows(len(p), _FEW)
    R = R[subset]
    p = p[subset]
    position = position[subset]
    weight = np.ones(len(subset))
    quarter_turns = (
        np.eye(3)[list(order)] * signs for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)
    )
    outcomes = []
    for start in (turn for turn in quarter_turns if np.linalg.det(turn) > 0):
        T_frame = np.eye(4)
        T_tool = np.eye(4)
        T_frame[:3, :3] = start
        for _ in range(_ROUNDS // 2):
            T_tool[:3, 3], T_frame[:3, 3] = _translations(R, p, position, weight, T_frame[:3, :3])
            T_frame[:3, :3] = _turned_frame(R, p, position, weight, T_frame, T_tool)
        T_tool[:3, 3], T_frame[:3, 3] = _translations(R, p, position, weight, T_frame[:3, :3])
        missed = np.median(np.linalg.norm(_missed(R, p, position, T_frame, T_tool), axis=1))
        outcomes.append((float(missed), len(outcomes), T_frame, T_tool))
    _, _, T_frame, T_tool = min(outcomes, key=lambda outcome: outcome[:2])
    return T_frame[:3, :3], T_tool[:3, 3], T_frame[:3, 3]


def _missed(R: Array, p: Array, position: Array, T_frame: Array, T_tool: Array) -> Array:
    """Measured minus predicted positions `(sample, 3)`, sensor axes."""
    return position - (p + R @ T_tool[:3, 3]) @ T_frame[:3, :3].T - T_frame[:3, 3]


def _translations(R: Array, p: Array, position: Array, weight: Array, R_frame: Array) -> tuple[Array, Array]:
    """Translations of the tool and the sensor frame, whose rotation is given."""
    columns = np.concatenate([R_frame @ R, np.broadcast_to(np.eye(3), R.shape)], 2)
    translations = _solve(columns, position - p @ R_frame.T, weight)
    return translations[:3], translations[3:]


def _turned_frame(R: Array, p: Array, position: Array, weight: Array, T_frame: Array, T_tool: Array) -> Array:
    """A Gauss–Newton step of the sensor frame's rotation, with both translations free."""
    turned = (p + R @ T_tool[:3, 3]) @ T_frame[:3, :3].T
    spins = np.cross(np.eye(3), turned[:, None]).swapaxes(1, 2)
    columns = np.concatenate([spins, T_frame[:3, :3] @ R, np.broadcast_to(np.eye(3), R.shape)], 2)
    step = _solve(columns, position - turned - T_frame[:3, 3], weight)[:3]
    return scipy.spatial.transform.Rotation.from_rotvec(step).as_matrix() @ T_frame[:3, :3]


def _registration(points: Array, position: Array, weight: Array) -> Array:
    """The rigid transform that carries points to positions (Kabsch, Acta Cryst. A32, 1976)."""
    w = weight / weight.sum()
    a = w @ points
    b = w @ position
    T = np.eye(4)
    T[:3, :3] = nearest_rotation(np.einsum("s,si,sj->ij", w, position - b, points - a))
    T[:3, 3] = b - T[:3, :3] @ a
    return T


def _solve(columns: Array, target: Array, weight: Array) -> Array:
    """Weighted least squares of `(sample, 3, unknown)` columns; the shortest solution where it is not unique."""
    root = np.sqrt(weight)[:, None]
    A = (root[:, :, None] * columns).reshape(-1, columns.shape[2])
    return np.linalg.lstsq(A, (root * target).reshape(-1), rcond=1e-9)[0]


# ------------------------------------------------------------------ of an arm


def computed_by_controller(error: float, position: Array, joint: Array) -> bool:
    """Tells whether an arm reproduces positions as only the controller's own computation from the joints is reproduced.

    Args:
        error: m, the median distance of the positions from those of the arm's kinematics.
        position: `(sample, 3)` m.
        joint: `(sample, joint)` rad, and m of prismatic joints.
    """
    spread = median_distance(position)
    step = float(np.hypot(digit_step(position), angle_step(joint) * spread * joint.shape[1] ** 0.5))
    return spread > LEAST_TRAVEL_M and error <= min(max(COMPUTED_M, step), FINEST_SENSOR_M)


def is_below_sensors(error: float, position: Array) -> bool:
    """Tells whether a fitted table is nearer to positions `(sample, 3)` m than any sensor measures an arm."""
    return median_distance(position) > LEAST_TRAVEL_M and error <= COMPUTED_M


def angle_step(joint: Array) -> float:
    """The place of the last digit of joints `(sample, joint)` in rad, as they were written in rad or in degrees."""
    return float(max(digit_step(joint), np.deg2rad(digit_step(np.rad2deg(joint)))))


def digit_step(values: Array) -> float:
    """The place of the last digit with which numbers are written, such as 0.001; 0 beyond the ninth."""
    finite = values[np.isfinite(values)]
    finite = finite[:: max(len(finite) // 1000, 1)]
    digits = (k for k in range(10) if np.allclose(finite, np.round(finite, k), rtol=0, atol=1e-3 * 10.0**-k))
    place = next(digits, None)
    return 0.0 if place is None else 10.0**-place


def median_distance(position: Array) -> float:
    """m, of positions `(sample, 3)` from their median."""
    return float(np.median(np.linalg.norm(position - np.median(position, axis=0), axis=1)))


def flange_poses(arm: Arm, joint: Array) -> Array:
    """Nominal `T_base_flange` `(sample, 4, 4)` at joints `(sample, joint)` in SI units."""
    return frames.chain(arm.links, joint, arm.sliding) @ arm.T_joint_flange


def match_poses(flange: Array, position: Array) -> tuple[float, Array]:
    """The median error in m of positions `(sample, 3)` with frame and tool in closed form, and `T_sensor_base`."""
    T_sensor_base, T_flange_tool = frames_from_poses(flange, position, None, None, None)
    missed = position - (T_sensor_base @ flange @ T_flange_tool)[:, :3, 3]
    return float(np.median(np.linalg.norm(missed, axis=1))), T_sensor_base
