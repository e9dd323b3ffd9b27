"""Tells whether a table computes orientations alone from the joints, beside positions of another source."""

from dataclasses import replace

import numpy as np

from lite6jax.arms import frames
from lite6jax.array_types import Array
from lite6jax.calibration.start import measured_rotations
from lite6jax.domains.pose.kinematics import Site
from lite6jax.domains.pose.rigid_arm import RigidArm
from lite6jax.model import ArmModel
from lite6jax.recordings.alignment import nearest_rotation
from lite6jax.recordings.sequence import spread_rows

_ROWS = 120
"""Spread over the recording, which tell an orientation that is computed from one that is measured."""
_NEAR = 0.1
"""rad, by which the table of an arm is off at most before it is fitted."""


def reproduced(arm: RigidArm) -> tuple[float, float]:
    """The median errors in rad of measured orientations by the table, and by one that is fitted to them alone.

    The frame and the tool of the orientations are free, whatever those of the positions are: they may be another's. Too
    few rows, and a table that is far off, are infinitely far.
    """
    thinned = arm.select(spread_rows(arm.samples, _ROWS))
    measured = measured_rotations(thinned.recording)
    assert measured is not None
    links = thinned.links.copy()
    links[:, :3, 3] = 0.0
    numbers = 3 * (len(links) + 1)
    if 3 * thinned.samples < 2 * numbers:
        return np.inf, np.inf
    turns = frames.chain(links, thinned.recording.joint_position, thinned.recording.sliding)
    turns[:, :3, 3] = 0.0
    T_frame = np.eye(4)
    T_tool = np.eye(4)
    T_frame[:3, :3], T_tool[:3, :3] = _frame_and_tool(turns[:, :3, :3], measured)
    rows = np.array([frames.row_from_transform(link) for link in links])
    unknown: list[Site] = [("base", 0, k) for k in (3, 4, 5)]
    unknown += [("link", j, k) for j in range(len(links) - 1) for k in (3, 4, 5)]
    unknown += [("tool", 0, k) for k in (3, 4, 5)]
    still = replace(thinned.recording, position=np.zeros((thinned.samples, 3)))
    turned = replace(
        thinned.with_poses(still),
        start=ArmModel(rows.ravel(), T_frame, T_tool),  # type: ignore[arg-type]
        unknown=tuple(unknown),
        precision=np.full(len(unknown), 1e-6),
        offset=np.zeros(len(unknown)),
        informative=np.zeros(len(unknown), bool),
    )
    by_table = float(np.median(turned.turn))
    if by_table > _NEAR:
        return by_table, np.inf
    freedom = (3 * thinned.samples / (3 * thinned.samples - numbers)) ** 0.5
    return by_table, freedom * float(np.median(turned.fitted(thinned.samples).turn))


def _frame_and_tool(R: Array, measured: Array) -> tuple[Array, Array]:
    """The rotations F and T `(3, 3)` of F R T = measured `(sample, 3, 3)`: F R = measured Tᵀ is linear in both."""
    count = len(R)
    columns = np.zeros((count, 3, 3, 18))
    for i in range(3):
        for k in range(3):
            # of the entry (i, k): sum over j of F[i, j] R[j, k] less measured[i, j] Tᵀ[j, k]
            columns[:, i, k, 3 * i : 3 * i + 3] = R[:, :, k]
            columns[:, i, k, 9 + k : 18 : 3] = -measured[:, i, :]
    _, _, Vt = np.linalg.svd(columns.reshape(-1, 18), full_matrices=False)
    F = Vt[-1][:9].reshape(3, 3)
    T = Vt[-1][9:].reshape(3, 3).T
    sign = np.sign(np.linalg.det(F)) or 1.0
    return nearest_rotation(sign * F), nearest_rotation(sign * T)
