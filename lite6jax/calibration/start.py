"""What fits start from: joint positions and poses of calibrated chains, and frames of recordings in closed form.

All of it is NumPy, so that nothing is compiled.
"""

from itertools import permutations, product
from typing import TYPE_CHECKING

import numpy as np
import scipy  # whose parts are imported where they are first used: `spatial` takes half a second
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.recordings.sequence import spread_rows

if TYPE_CHECKING:  # a fleet of calibrations does not import what recordings take
    from lite6jax.recordings import Recording

Array = NDArray[np.floating]

SAMPLES = 300
"""Joint positions that a calibration is fitted at."""
CHECK_SAMPLES = 1000
"""Other joint positions, at which the models of calibrations are compared: fitted, nominal, and of another arm."""

_ROUNDS = 12
_MOST_SAMPLES = 3000
_DETERMINED = 0.01
"""Least singular value over the largest: below, as in motions about two axes, nine cosines are not determined, from
which the rotation would come; it is 2e-4 for a positioner of two axes and above 0.1 for arms."""
_FEW = 40
"""Samples that tell rotations apart."""


def sample_within_limits(arm: Arm, samples: int, seed: int) -> Array:
    """Joint positions `(sample, joint)`, uniform inside the arm's limits."""
    lower, upper = arm.joint_limits.T
    return np.random.default_rng(seed).uniform(lower, upper, (samples, arm.dof))


def check_positions(arm: Arm, seed: int = 0) -> Array:
    """`CHECK_SAMPLES` joint positions beside those that are drawn by `seed`: by default the same in every command, so
    that a distance between two geometries is one number."""
    return sample_within_limits(arm, CHECK_SAMPLES, seed + 1)


def nominal_calibration(arm: Arm) -> FactoryCalibration:
    """The nominal chain, as the calibration of an arm that does not deviate."""
    return FactoryCalibration(arm.kinematics, arm, arm.T_joint_flange, arm.name)


def calibration_poses(calibration: FactoryCalibration, joint_position: Array) -> Array:
    """The calibrated chain's flange poses `(sample, 4, 4)`."""
    links = np.array([frames.transform_from_row(row) for row in calibration.kinematics])
    return frames.chain(links, joint_position, calibration.arm.sliding) @ calibration.T_joint_flange


def measured_rotations(recording: "Recording") -> Array | None:
    """The measured orientations `(sample, 3, 3)` of a recording, whose quaternions may have any norm; None without."""
    if recording.quaternion is None:
        return None
    return scipy.spatial.transform.Rotation.from_quat(recording.quaternion, scalar_first=True).as_matrix()


def declared_tool(recording: "Recording") -> Array:
    """`T_flange_tool` `(4, 4)` as the settings declare it, the identity where they declare none."""
    tool = recording.settings.tool
    if isinstance(tool, str):
        return np.eye(4)
    return frames.transform_from_row(tool)


def frames_from_recording(recording: "Recording", flange: Array, tool: Array | None) -> tuple[Array, Array]:
    """As `frames_from_poses`, with the sensor frame known where the settings say that it is the arm's base."""
    frame = np.eye(4) if recording.settings.pose_frame == "base" else None
    position = recording.position
    assert position is not None
    return frames_from_poses(flange, position, measured_rotations(recording), frame, tool)


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
    """Of the tool and the sensor frame, whose rotation is given."""
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
