"""Placeholders: rows in which joints or poses hold a mark, such as -1000 or what was read last, and no measurement.

What repeats exactly may be a mark (`recordings.placeholders`). It is one where the nominal arm, with frame and tool in
closed form, agrees with the other rows and misses these; home poses that are taken again and again agree.
"""

from pathlib import Path
from typing import NamedTuple, final

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.array_types import Integers, Mask
from lite6jax.calibration.source import declared_arm
from lite6jax.domains.faults import LIMIT_SLACK_RAD
from lite6jax.domains.pose.screening.screened import ScreenedPoses
from lite6jax.domains.pose.screening.thresholds import SUSPECT_REACH
from lite6jax.recordings import Recording
from lite6jax.recordings.alignment import flange_poses, frames_from_poses, median_distance
from lite6jax.recordings.columns.kinematics import CLOSE, FEWEST
from lite6jax.recordings.placeholders import Mark, possible_marks, without_marks

_MISSES = 10.0
"""Median errors by which the nominal arm misses a placeholder; outliers are nearer."""
_APART = 0.1
"""Share of the spread over which one value is seen; noise is far below."""
_MOST_BEYOND = 0.5
"""Share of the rows beyond limits below which these are placeholders; of more the limits are wrong."""

_POSES = ("joint_position", "position")
"""The arrays of a recording of poses in which marks are looked for."""


def leave_out_placeholders(state: ScreenedPoses) -> ScreenedPoses:
    """Without the rows in which joints or poses are marks; each mark is a fault of its own."""
    recording = state.recording
    assert recording.position is not None
    candidates = [mark for mark in possible_marks(recording) if mark.array in _POSES]
    if not candidates:
        return state
    evidence = _evidence(recording, state.arm)
    corrected, faults = without_marks(recording, candidates, lambda mark, rows, _: rows[evidence.convicts(mark, rows)])
    return state.with_faults(faults, corrected)


@final
class _Evidence(NamedTuple):
    """What shows that a row holds no measurement.

    Attributes:
        recording: of poses.
        missed: `(sample,)`, whether the nominal arm misses the pose grossly; None where it misses most of them.
        beyond: `(sample, joint)`, whether a joint is beyond its limits.
    """

    recording: Recording
    missed: Mask | None
    beyond: Mask

    def convicts(self, mark: Mark, rows: Integers) -> Mask:
        """Which of the rows of a mark hold no measurement."""
        all_rows = np.ones(len(rows), bool)
        none = np.zeros(len(rows), bool)
        if mark.array == "joint_position":
            column = slice(None) if mark.column is None else mark.column
            usual = np.mean(self.beyond[:, column]) < _MOST_BEYOND
            if mark.value is not None and usual and self.beyond[rows][:, column].all() and len(rows) > 1:
                return all_rows
        if self.missed is not None:
            missed = self.missed[rows]
            fewest = min(2, len(rows)) if mark.value is not None else 2
            if mark.column is not None or mark.value is None:
                fewest = max(fewest, len(rows) - 1)  # of what was read last, or of one column, one row may be right
            if missed.sum() < fewest or (mark.column is not None and len(rows) < 2):
                return none
            return missed if mark.column is None else all_rows
        if mark.column is None and len(rows) > 1 and self._contradicts(mark, rows):
            return all_rows
        return none

    def _contradicts(self, mark: Mark, rows: Integers) -> bool:
        """Tells whether the poses of the same joints, or the joints of the same pose, are far from each other."""
        joints = mark.array == "joint_position"
        counterpart = self.recording.position if joints else self.recording.joint_position
        assert counterpart is not None
        apart = np.linalg.norm(counterpart[rows] - np.median(counterpart[rows], axis=0), axis=1)
        return float(apart.max()) > _APART * median_distance(counterpart)


def _evidence(recording: Recording, arm: Arm | None) -> _Evidence:
    nominal = arm or declared_arm(recording.settings, Path(recording.source).parent)
    beyond = np.zeros(recording.joint_position.shape, bool)
    if nominal is None or nominal.dof != recording.dof:
        return _Evidence(recording, None, beyond)
    low, high = nominal.joint_limits.T
    beyond = recording.joint_position < low - LIMIT_SLACK_RAD
    beyond |= recording.joint_position > high + LIMIT_SLACK_RAD
    return _Evidence(recording, _missed(recording, nominal), beyond)


def _missed(recording: Recording, arm: Arm) -> Mask | None:
    """`(sample,)`, whether the nominal arm misses a pose grossly; None where it agrees with too few of them."""
    position = recording.position
    assert position is not None
    if recording.samples < FEWEST:
        return None
    flange = flange_poses(arm, recording.joint_position)
    T_sensor_base, T_flange_tool = frames_from_poses(flange, position, None, None, None)
    error = np.linalg.norm(position - (T_sensor_base @ flange @ T_flange_tool)[:, :3, 3], axis=1)
    usual = float(np.median(error))
    if usual > CLOSE * median_distance(position):
        return None
    return error > max(_MISSES * usual, SUSPECT_REACH * arm.reach)
