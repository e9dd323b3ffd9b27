"""A torque recording less a reference recording of the same motion: a simulator, or the same arm at an earlier time."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from lite6jax.arms.arm import Arm, as_revolute
from lite6jax.array_types import Array, Mask
from lite6jax.domains.torque.rows import bodies_of, require_joints
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.recordings.sequence import interpolate_columns, run_segments

SAME_STATE = (5e-3, 5e-2)
"""rad and rad/s by which the states of two recordings of one motion differ at most, in nearly all rows: controllers
track a motion that well, and gravity's torque changes little over it. Of prismatic joints 0.5 mm and 5 mm/s."""
_NEARLY = 0.9
"""Of the rows, that are to be in the same state."""


@final
@dataclass(frozen=True, eq=False)
class RowComparison:
    """A recording and a reference in the same motion.

    Attributes:
        file: the reference's name.
        rows: of the recording.
        matched: of these, in the same state as the reference at the same time.
        apart: `(joint,)` Nm RMS between the torques of both.
        from_model: `(joint,)` Nm RMS between the reference and the declared rigid arm.
        recording: the matched rows, with the torques of the declared rigid arm plus the difference of both recordings:
            what both have cancels, whatever it is.
    """

    file: str
    rows: int
    matched: int
    apart: Array
    from_model: Array
    recording: Recording

    def to_dict(self) -> dict[str, Any]:
        """Codes and numbers in SI units."""
        return {
            "file": self.file,
            "basis": "rows",
            "rows": self.rows,
            "matched_rows": self.matched,
            "apart_rms_by_joint_Nm": self.apart.tolist(),
            "reference_rms_by_joint_Nm": self.from_model.tolist(),
        }


def compare_rows(recording: Recording, reference: Recording, arm: Arm) -> RowComparison | None:
    """The comparison row by row; None where the two do not hold the same motion.

    The reference is interpolated in time, run by run, at the times of the recording since the beginning of each run.

    Args:
        recording: with torques and times.
        reference: likewise, of as many joints.
        arm: the declared arm.

    Raises:
        InputError: another number of joints, no torques or times, or as `bodies_of`.
    """
    if reference.dof != recording.dof:
        raise InputError(
            f"{reference.source}: has {reference.dof} joints, but {recording.source} {recording.dof}; give that arm's"
        )
    for side in (recording, reference):
        require_joints(side, arm)
    recording = recording.sorted_by_time()
    matched = _at_times_of(recording, reference.sorted_by_time(), arm.slides)
    if matched is None:
        return None
    matching, torque = matched
    bodies, _, _ = bodies_of(recording, arm)
    declared = bodies.dynamics(bodies.links).declared.T
    measured = recording.torques()
    settings = recording.settings
    noise = [side.settings.torque_noise_Nm for side in (recording, reference)]
    if noise[0] is not None:
        settings = replace(settings, torque_noise_Nm=tuple(np.hypot(noise[0], noise[1] or 0.0).tolist()))
    if arm.mass is not None and arm.inertia is not None:
        settings = replace(settings, inertial="declared")  # it is in what was put in place of what both have
    corrected = replace(recording, joint_torque=declared + measured - torque, motor_current=None, settings=settings)
    return RowComparison(
        file=Path(reference.source).name,
        rows=recording.samples,
        matched=int(matching.sum()),
        apart=np.sqrt(np.mean((measured - torque)[matching] ** 2, 0)),
        from_model=np.sqrt(np.mean((torque - declared)[matching] ** 2, 0)),
        recording=corrected.select(matching),
    )


def _at_times_of(recording: Recording, reference: Recording, slides: Mask) -> tuple[Mask, Array] | None:
    """Which rows are in the reference's state, and its torques `(sample, joint)` then; None where it is another motion.

    Rows of another state would be gaps in time: the ends of runs may be cut, but within a run nearly all rows match.
    """
    torque = reference.torques()
    if recording.time is None or reference.time is None:
        return None
    segments = run_segments(recording.run)
    reference_segments = run_segments(reference.run)
    if segments[-1] != reference_segments[-1]:
        return None
    matching = np.zeros(recording.samples, bool)
    at = np.zeros_like(recording.joint_position)
    states = [(side.joint_position, side.velocities()) for side in (recording, reference)]
    for run in np.unique(segments):
        rows = np.flatnonzero(segments == run)
        reference_rows = np.flatnonzero(reference_segments == run)
        since, reference_times = (
            side[part] - side[part[0]] for side, part in ((recording.time, rows), (reference.time, reference_rows))
        )
        at[rows] = interpolate_columns(since, reference_times, torque[reference_rows])
        near = (since >= reference_times[0]) & (since <= reference_times[-1])
        for mine, its, tolerance, unit in zip(*states, SAME_STATE, ("rad", "rad/s"), strict=True):
            away = np.abs(mine[rows] - interpolate_columns(since, reference_times, its[reference_rows]))
            near &= as_revolute(away.T, unit, slides).max(0) <= tolerance
        if near.mean() < _NEARLY:
            return None
        first, last = np.flatnonzero(near)[[0, -1]]
        matching[rows[first : last + 1]] = True
    return matching, at
