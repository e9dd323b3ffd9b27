"""Which rows of two recordings were taken at the same joint positions."""

import numpy as np
from scipy.spatial import KDTree

from lite6jax.errors import InputError
from lite6jax.recordings import Recording

SAME_JOINTS = 1e-3
"""rad within which two rows are of the same joint positions: an error beyond the rigid arm varies by a thousandth less
over such a distance."""
_NEIGHBOURS = 8
"""Nearest rows tried as partners of a row whose row number does not decide."""


def matched(recording: Recording, reference: Recording) -> tuple[Recording, Recording]:
    """The rows of both at the same joint positions, in the recording's order: by row number, otherwise the nearest.

    Args:
        recording: any.
        reference: of as many joints; its rows may have another order. Each is matched at most once.

    Raises:
        InputError: fewer than half of the shorter recording's rows have a partner.
    """
    _, i, j = np.intersect1d(recording.row, reference.row, return_indices=True)
    same = np.abs(recording.joint_position[i] - reference.joint_position[j]).max(1, initial=0.0) <= SAME_JOINTS
    partner = np.full(recording.samples, -1)
    partner[i[same]] = j[same]
    open_rows = np.flatnonzero(partner < 0)
    spare = np.setdiff1d(np.arange(reference.samples), partner)
    if open_rows.size and spare.size:
        count = min(_NEIGHBOURS, spare.size)
        nearest = KDTree(reference.joint_position[spare]).query(
            recording.joint_position[open_rows], k=count, p=np.inf, distance_upper_bound=SAME_JOINTS
        )
        distance, index = (np.reshape(part, (open_rows.size, count)) for part in nearest)
        taken = np.zeros(reference.samples, bool)
        for at in np.argsort(distance, axis=None, kind="stable"):
            row, k = divmod(int(at), count)
            if not np.isfinite(distance[row, k]):
                break
            candidate = spare[index[row, k]]
            if partner[open_rows[row]] < 0 and not taken[candidate]:
                partner[open_rows[row]], taken[candidate] = candidate, True
    rows = np.flatnonzero(partner >= 0)
    shorter = min(recording.samples, reference.samples)
    if 2 * rows.size < shorter:
        raise InputError(
            f"{reference.source}: {rows.size} of its {reference.samples} rows are at joint positions of the "
            f"{recording.samples} rows of {recording.source} (within {SAME_JOINTS:g} rad), but at least "
            f"{-(-shorter // 2)} are needed; give the same motion in both recordings"
        )
    return recording.select(rows), reference.select(partner[rows])
